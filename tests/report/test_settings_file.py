"""settings.toml of a run, a study and a comparison: one command makes the same numbers again, from
another folder; templates and schemas agree with the records.
"""

import json
import re
import shlex
import tomllib
from functools import partial
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from helpers.commands import command, output_of
from helpers.sheets import two_sheets
from helpers.tiny import tiny_toml
from pydantic import BaseModel

import pixsim
from pixsim.base.toml import packaged, read_toml
from pixsim.cli import options
from pixsim.report.templates import json_schema, template
from pixsim.scene.charts import siemens_star, write_chart
from pixsim.scene.packaged import packaged_scenes
from pixsim.sensor.pixel_options import DATA_SHEET
from pixsim.viewer.setting import Run

SHEET = """
[pixel]
pitch_um = 12.0
full_well_e = 12000
read_noise_e = 2.5
dark_current_e_per_s = 8
quantum_efficiency = "qe.csv"
bits = 12
[camera]
die_mm = 1.5
"""
DARK = 'axis = [{ name = "dark", range_of = "dsnu", alone = true }]\n'
DUSK = '[[condition]]\nname = "dusk"\nset.exposure.max_integration_s = 0.01\n'


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with sensors, a curve, a technology, a chart, a picture's light, and studies."""
    folder = tmp_path / "desk"
    folder.mkdir()
    (folder / "sheet.toml").write_text(SHEET, encoding="utf-8")
    (folder / "qe.csv").write_text("400,0.3\n550,0.6123456789012345\n700,0.4\n", encoding="utf-8")
    (folder / "mine.toml").write_bytes(packaged("data/technologies")["0.35um"].read_bytes())
    (folder / "mine.xml").write_bytes(packaged_scenes()["csf"].read_bytes())
    write_chart(folder / "star.exr", siemens_star(64, 64))
    light = (
        np.linspace(1e-3, 5e-3, 48)[:, None, None] * np.linspace(0.2, 1, 48)[:, None] * np.ones(31)
    )
    pixsim.write_npz(
        folder / "light.npz",
        pixsim.SpectralImage(np.arange(400.0, 701.0, 10.0), 10.0, 31.25, data=light),
    )
    (folder / "tiny.toml").write_text(tiny_toml(), encoding="utf-8")
    (folder / "layers.toml").write_text(f"{DARK}{DUSK}", encoding="utf-8")
    (folder / "dusk.toml").write_text(
        f'name = "s"\n{DUSK}[[condition]]\nname = "day"\nset.camera.f_number = 4.0\n',
        encoding="utf-8",
    )
    two_sheets(folder)
    monkeypatch.chdir(folder)
    return folder


def command_in(folder: Path) -> str:
    """The command in the head of settings.toml, without the name of the program."""
    (line,) = [
        text
        for text in (folder / "settings.toml").read_text(encoding="utf-8").splitlines()
        if text.startswith("# pixsim ")
    ]
    return shlex.join(shlex.split(line)[2:])


RUN_FILES = ("raw.exr", "delta_e.exr", "image.png", "ideal.png")
SCORE = ("mean_delta_e", "camera", "exposure", "display", "seed", "render_noise", "dark")
PAIR = (
    "compare quiet.toml 'noisy one.toml' --scene slanted_edge --display.dots 32 --resolution 48"
    " --repeats 2 --variant scalar_spectral"
)
REPEATED = "compare sensors/quiet.toml sensors/noisy_one.toml"
COMPARED = ("scores", "difference", "interval_delta_e", "film_delta_e", "scored_dots", "display")


@pytest.mark.parametrize(
    ("line", "head", "files", "numbers"),
    [
        ("run csf --config sheet.toml --window 1.1 --camera.f-number 5.6 --seed 3 --resolution 48 --render-noise 10",
         "run --config settings.toml", RUN_FILES, SCORE),
        ("run mine.xml --pixel.technology mine.toml -D chart=star.exr -D spp=4 --camera.die-mm 1 --variant scalar_spectral --full "
         "--resolution 32 --display.dots 64 --render-noise 10", "run --config settings.toml --full", RUN_FILES, SCORE),
        ("run light.npz --config sheet.toml --seed 2", "run --config settings.toml", RUN_FILES, SCORE[:5]),
        pytest.param(f"{PAIR} --study dusk.toml", f"{REPEATED} --study settings.toml --repeats 2", (),
         (*COMPARED, "conditions", "probability_a_better", "displays", "verdicts"), marks=pytest.mark.slow),
    ],
)  # fmt: skip
def test_command_of_settings_makes_the_same_numbers(
    line: str,
    head: str,
    files: tuple[str, ...],
    numbers: tuple[str, ...],
    desk: Path,
    tmp_path: Path,
    monkeypatch,
) -> None:
    """The command in settings.toml, in its folder, gives every number again, bit for bit, also
    after that is moved with the files that it names.
    """
    options = "--irradiance none" if line.startswith("run") else "--jobs 1"
    out, again = desk / "out", tmp_path / "again"
    output_of(f"{line} {options} --out out")
    out = desk.rename(tmp_path / "moved") / "out"
    repeat = command_in(out)
    assert repeat.startswith(head)
    monkeypatch.chdir(out)
    output_of(f"{repeat} {options} --out {again}")
    for name in files:
        assert (again / name).read_bytes() == (out / name).read_bytes(), name
    first, second = (
        json.loads(next(folder.glob("*e.json")).read_text(encoding="utf-8"))
        for folder in (out, again)
    )
    assert {name: second[name] for name in numbers} == {name: first[name] for name in numbers}
    settings, settings_again = (
        (folder / "settings.toml").read_text(encoding="utf-8").replace('"../moved/', '"../')
        for folder in (out, again)
    )
    assert tomllib.loads(settings_again) == tomllib.loads(settings)
    assert "qe.csv" not in settings, "values, not files"
    if "--window" in line:
        assert first["display"]["dots"] == 91  # the sheet's pixels across, 1.1 mm / 12 µm


@pytest.mark.slow
def test_settings_of_a_study_make_the_same_numbers_in_another_folder(
    desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Layers and ranges stand there as values, beside a condition; files by their whole paths."""
    options = {"pixel": {"technology": "mine.toml"}, "parameters": {"chart": "star.exr", "spp": 4}}
    layers = {"config": "layers.toml", "window_mm": 0.9, "render_noise": 10.0}
    study = partial(pixsim.study, variant="scalar_spectral", jobs=1)
    result = study("tiny.toml", "out", **options, **layers)
    monkeypatch.chdir(tmp_path)
    Path("settings.toml").write_text(result.settings_toml, encoding="utf-8")
    again = study("settings.toml", "again")
    delta_e, delta_e_again = ([curve.delta_e for curve in each.curves] for each in (result, again))
    np.testing.assert_array_equal(delta_e_again, delta_e)
    assert len(np.unique(delta_e)) == np.size(delta_e), "what a case sets is used"
    assert tomllib.loads(again.settings_toml) == tomllib.loads(result.settings_toml)


def test_run_settings_after_time_limit_do_not_depend_on_the_clock(
    desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The limit ends the first run after its first two renders; its noise as the target ends the
    second one there too.
    """
    scene, same = "run macbeth --variant scalar_spectral --irradiance none", tmp_path / "again"
    output_of(
        f"{scene} --config sheet.toml --resolution 32 -D spp=4 --render-noise 0.001 --max-seconds"
        " 1e-9 --out out"
    )
    monkeypatch.setenv("PIXSIM_CACHE_GIB", "0")
    output_of(
        f"run --variant scalar_spectral --irradiance none --config out/settings.toml --out {same}"
    )
    first, again = (
        json.loads((folder / "score.json").read_text(encoding="utf-8"))
        for folder in (desk / "out", same)
    )
    assert (first["render_noise"]["ended_by"], again["render_noise"]["ended_by"]) == (
        "max_seconds",
        "target",
    )
    assert (same / "raw.exr").read_bytes() == (desk / "out/raw.exr").read_bytes()


RECORDS = {"sensor": Run, "study": pixsim.Study}


def uncommented(text: str) -> dict:
    """The table of a template with all commented fields set."""
    return tomllib.loads(re.sub(r"^# (\w+ = )", r"\1", text, flags=re.MULTILINE))


def dotted(table: dict, record: type[BaseModel], path: str = "") -> set[str]:
    """Dotted names of the fields of a table; all fields of an inner record if the table does not
    list them.
    """
    names = set()
    for name, value in table.items():
        kind = record.model_fields[name].annotation
        inner = isinstance(kind, type) and issubclass(kind, BaseModel)
        names |= (
            dotted(value if isinstance(value, dict) else kind.model_fields, kind, f"{path}{name}.")
            if inner
            else {path + name}
        )
    return names


@pytest.mark.parametrize("kind", RECORDS)
def test_template_has_every_field_and_is_valid(kind: str) -> None:
    text = template(kind)
    record = RECORDS[kind]
    assert dotted(uncommented(text), record) == dotted(record.model_fields, record)
    record.model_validate(tomllib.loads(text))


def test_template_shows_defaults_of_record() -> None:
    """A commented field shows the default of its record."""
    table = uncommented(template("study"))
    defaults = pixsim.Study(name="x").model_dump(mode="json")
    for name in ("seed", "max_repeats", "iso_delta_e", "paper"):
        assert table[name] == defaults[name], name
    for name in ("gamma", "dots"):
        assert table["display"][name] == defaults["display"][name], name


def test_template_sensor_is_data_sheet(tmp_path: Path) -> None:
    path = tmp_path / "my_sensor.toml"
    command("template sensor -o", path)
    settings = options.SceneOptions([path]).settings()
    assert settings.pixel.technology == "none"
    assert all(getattr(settings.pixel, name) is not None for name in DATA_SHEET)
    physics = pixsim.derive(settings.pixel)
    assert (physics.reset_noise_e, physics.offset_fpn_e, physics.fill_factor) == (0.0, 0.0, 1.0)


@pytest.mark.parametrize("kind", RECORDS)
def test_json_schema_agrees_with_record(kind: str) -> None:
    schema = json_schema(kind)
    check = jsonschema.Draft202012Validator(schema)
    everything = uncommented(template(kind))
    assert not list(check.iter_errors(everything))
    for table, values in (
        ("pixel", {"bits": 99}),
        ("pixel", {"uncertainty": {"prnu": {"sd": -1}}}),
        ("display", {"gama": 2.2}),
        ("camera", {"f_number": -1.0}),
    ):
        assert list(check.iter_errors(everything | {table: everything[table] | values})), values
    # A base is read with the file
    assert set(schema["properties"]) - {"base"} == set(RECORDS[kind].model_fields)


@pytest.mark.parametrize("path", packaged("data/studies").values(), ids=lambda path: path.stem)
def test_json_schema_accepts_packaged_studies(path: Path) -> None:
    jsonschema.Draft202012Validator(json_schema("study")).validate(read_toml(path))


@pytest.mark.parametrize("kind", ["sensor", "study"])
def test_commands_write_template_and_schema(kind: str) -> None:
    assert command(f"template {kind}") == (0, template(kind), "")
    assert json.loads(command(f"schema {kind}")[1]) == json_schema(kind)


def test_template_of_a_packaged_study_is_its_file() -> None:
    _, out, _ = command("template study --of pixel-size")
    text = packaged("data/studies")["pixel-size"].read_text(encoding="utf-8")
    assert out.partition("\n")[2].strip() == text.strip()
