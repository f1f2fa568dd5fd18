"""Studies: rows computed and stored, independent of workers, threads, order and interruptions."""

import html
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.commands import command
from helpers.tiny import PITCHES_UM, WHOLE_CHART, keys, rows, tiny as tiny_study, tiny_toml

import pixsim
from pixsim.base import cache
from pixsim.base.arrays import stream
from pixsim.base.files import FOLDER_VARIABLE
from pixsim.base.toml import packaged, read_toml
from pixsim.report.curve import optimum_line
from pixsim.report.study import light_against_detail, report_files
from pixsim.sensor.readout import Frame
from pixsim.studies import evaluate as rows_module
from pixsim.studies.design import imaging_of, technology_of
from pixsim.studies.files import load_study
from pixsim.studies.prepare import prepare
from pixsim.studies.result import StudyResult

OWN = {"repeats": 3, "seed": 1}
TINY_TOML = tiny_toml(**OWN)
SHEET = {
    "full_well_e": 1e4,
    "read_noise_e": 2,
    "dark_current_e_per_s": 1,
    "quantum_efficiency": 0.5,
    "data_sheet_pitch_um": 3,
}
FIVE_UM = [*PITCHES_UM[:4], PITCHES_UM[5]]  # the frame that is scored follows from the largest


def tiny(**over: object) -> pixsim.Study:
    return tiny_study(**OWN | over)


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[StudyResult, Path]:
    """The tiny study from Python, in this process."""
    folder = tmp_path_factory.mktemp("done")
    return pixsim.study(tiny(), folder, jobs=1), folder


def test_study_has_row_per_pitch_and_sensor(done: tuple[StudyResult, Path]) -> None:
    result, folder = done
    table = rows(folder)
    assert [(float(r["pitch_um"]), int(r["repeat"])) for r in table] == [
        (p, r) for p in PITCHES_UM for r in range(3)
    ]
    assert len(set(keys(folder))) == 18
    curve = result.curves[0]
    np.testing.assert_array_equal(curve.delta_e.ravel(), [float(r["mean_delta_e"]) for r in table])
    assert len(np.unique(curve.delta_e)) == 18, "no two sensors are the same"
    best = curve.optimum
    assert best.inside
    assert (
        best.within_2_percent_um[0]
        <= best.within_1_percent_um[0]
        < best.pitch_um
        < best.within_1_percent_um[1]
    )
    # The fitted minimum can lie below the lowest point, not above its mean by more than the fit
    # smooths.
    assert best.mean_delta_e == pytest.approx(curve.delta_e.mean(axis=1).min(), rel=0.06)


@pytest.fixture(scope="module")
def by_command(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same study from a file, by the command, in this process."""
    folder = tmp_path_factory.mktemp("command")
    toml = folder / "tiny.toml"
    toml.write_text(TINY_TOML, encoding="utf-8")
    code, message, _ = command(f"study {toml} --out {folder / 'out'} --jobs 1")
    assert code == 0
    (folder / "stdout").write_text(message, encoding="utf-8")
    return folder


def test_study_command_writes_files_and_prints_optimum(
    by_command: Path, done: tuple[StudyResult, Path]
) -> None:
    out = by_command / "out"
    assert {path.name for path in out.iterdir()} == {
        *("results.csv", "settings.toml", "summary.json", "report.html", "pixsim.json", "figures")
    }
    figures = {path.name for path in (out / "figures").iterdir()}
    assert {"delta_e_against_pitch.svg", "contact_sheet_0.35um.png"} <= figures
    assert {name for name in figures if not name.endswith((".svg", ".csv"))} == {
        "contact_sheet_0.35um.png"
    }
    assert {f"figures/{name}" for name in figures} <= report_files(done[0].study)
    assert (out / "results.csv").read_bytes() == (done[1] / "results.csv").read_bytes()
    message = (by_command / "stdout").read_text(encoding="utf-8")
    headline, _, close = optimum_line(done[0].curves[0]).partition("; ")
    assert headline in message
    assert close
    assert message.rstrip().endswith("report.html")


def test_study_notes_reach_result_summary_page_and_json(tmp_path: Path) -> None:
    """Once each, and from a resumed study too."""
    over: dict[str, Any] = {"display": {"white_cd_per_m2": 40.0}, "pixel": {"bits": 8}}
    toml = tmp_path / "tiny.toml"
    toml.write_text(tiny_toml(**over), encoding="utf-8")
    code, message, err = command(f"study {toml} --out {tmp_path / 'out'} --jobs 1 --json")
    assert code == 0
    summary = json.loads(message)
    texts = [note["text"] for note in summary["notes"]]
    bright, is_open, dark = texts
    assert "of the ideal image is brighter than display white" in bright
    assert "the interval is open" in is_open
    assert "the black level of 0 DN clips dark noise" in dark
    assert (
        json.loads((tmp_path / "out/summary.json").read_text(encoding="utf-8"))["notes"]
        == summary["notes"]
    )
    page = html.unescape((tmp_path / "out/report.html").read_text(encoding="utf-8"))
    assert all(note in page for note in texts)
    assert f"warning: {bright}" in err
    # Each speaks to its caller.
    expected = [
        note.replace("--display.white-cd-per-m2", "Display(white_cd_per_m2=…)") for note in texts
    ]
    for folder in ("python", "out"):
        with pytest.warns(UserWarning, match="brighter than display white"):
            notes = pixsim.study(tiny_study(**over), tmp_path / folder, jobs=1).as_dict()["notes"]
        assert [note["text"] for note in notes] == expected


# 0: whole; 4: within the last number, which still reads as one (lines end in \r\n); 60: in an
# earlier column; 2000: rows are gone.
@pytest.mark.parametrize("cut_bytes", [0, 4, 60, 2000])
def test_study_truncated_file_is_completed(
    cut_bytes: int,
    done: tuple[StudyResult, Path],
    tmp_path: Path,
    evaluations: list[Frame],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    whole = (done[1] / "results.csv").read_bytes()
    kept = whole[: len(whole) - cut_bytes]
    (tmp_path / "results.csv").write_bytes(kept)
    if not cut_bytes:
        monkeypatch.setattr(
            "pixsim.viewer.scene_light.ideal_facts",
            lambda *_: pytest.fail("an ideal image was computed"),
        )
    again = pixsim.study(tiny(), tmp_path, jobs=1)
    assert (tmp_path / "results.csv").read_bytes() == whole
    assert len(evaluations) == 18 - (kept.count(b"\n") - 1)
    assert again.as_dict() == done[0].as_dict()
    assert not list(tmp_path.glob(".*"))


NUMBERS = {
    "dark_current_na_per_cm2": 30.0, "dsnu": 0.6, "column_fpn": 0.003, "peak_quantum_efficiency": 0.2,
    "node_capacitance_ff": 2.5, "voltage_swing_v": 0.9, "fill_factor_limit": 0.8, "feature_size_um": 0.34,
}  # fmt: skip


@pytest.mark.slow
def test_study_process_numbers_equal_file(tmp_path: Path) -> None:
    """Bit for bit, from the pitches to the pictures of the report: a technology of the same name
    has the same random streams.
    """
    table = read_toml(packaged("data/technologies")["0.35um"])
    lines = ['name = "0.35um"']
    for name, entry in table.items():
        if isinstance(entry, dict):
            value = json.dumps(NUMBERS.get(name, entry["value"]))
            lines += [f"[{name}]", f"value = {value}", 'confidence = "D"', 'source = "here"']
    (tmp_path / "own.toml").write_text("\n".join(lines), encoding="utf-8")
    few = {"repeats": 2, "pitch": {"min_fill_factor": 0.1, "count": 5, "values_um": None}}
    by_file = pixsim.study(
        tiny(**few, technologies=(str(tmp_path / "own.toml"),)), tmp_path / "file", jobs=1
    )
    study = tiny(**few, process={"0.35um": NUMBERS})
    by_study = pixsim.study(study, tmp_path / "study", jobs=1)
    # All but the key, the path of the technology and the check of the row.
    mine, theirs = (
        [list(row.values())[2:-1] for row in rows(tmp_path / name)] for name in ("study", "file")
    )
    assert mine == theirs
    one, other = by_file.curves[0], by_study.curves[0]
    assert one.feature_size_um == other.feature_size_um == 0.34
    pitch_um = float(one.pitch_um[2])
    mine, theirs = (
        r.scores(c.technology, pitch_um, 1)[0] for r, c in ((by_study, other), (by_file, one))
    )
    np.testing.assert_array_equal(mine.delta_e, theirs.delta_e)
    assert light_against_detail(by_study, other).csv == light_against_detail(by_file, one).csv
    imaging = imaging_of(study, by_study.camera, "0.35um", pitch_um)
    assert imaging.physics.full_well_e == mine.physics.full_well_e == theirs.physics.full_well_e
    # And it is another study than the one without them.
    pixsim.study(tiny(**few), tmp_path / "plain", jobs=1)
    assert not set(keys(tmp_path / "plain")) & set(keys(tmp_path / "study"))


def test_load_study_resolves_files_next_to_it(tmp_path: Path) -> None:
    """And overrides that leave one out leave its numbers out too."""
    (tmp_path / "mine.toml").write_bytes(packaged("data/technologies")["0.35um"].read_bytes())
    own = 'name = "own"\ntechnologies = ["mine.toml", "0.25um"]\nprocess."mine.toml".dsnu = 0.1\n'
    (tmp_path / "study.toml").write_text(own, encoding="utf-8")
    (tmp_path / "study.quick.toml").write_text('technologies = ["0.25um"]\n', encoding="utf-8")
    study = load_study(tmp_path / "study.toml")
    assert technology_of(study, str(tmp_path / "mine.toml")).dsnu == 0.1
    assert technology_of(study, "0.25um").dsnu == 0.3
    quick = load_study(tmp_path / "study.toml", quick=True)
    assert (quick.technologies, quick.process) == (("0.25um",), {})


# --- Fields of the pixel as options
# ------------------------------------------------------------------------------------


def test_load_study_pixel_options_take_precedence(tmp_path: Path) -> None:
    """And are as good as the same numbers in a file."""
    table = '[sources]\n"pixel.bits" = "assumed"\n"pixel.prnu" = "stated"\n'
    text = f'name = "own"\n[pixel]\nbits = 8\n{table}'
    (tmp_path / "own.toml").write_text(text, encoding="utf-8")
    (tmp_path / "own.quick.toml").write_text("pixel = { bits = 9 }\n", encoding="utf-8")
    (tmp_path / "sensor.toml").write_text("[pixel]\nbits = 11\nprnu = 0.02\n", encoding="utf-8")
    study = load_study(
        tmp_path / "own.toml", tmp_path / "sensor.toml", pixel={"bits": "12"}, quick=True
    )
    assert (study.pixel.bits, study.pixel.prnu, study.sources) == (12, 0.02, {})
    plain, scaled = tmp_path / "plain.toml", tmp_path / "scaled.toml"
    plain.write_text(TINY_TOML + "pixel = { response = 'literal', bits = 8 }\n", encoding="utf-8")
    scaled.write_text(
        TINY_TOML + "pixel = { response = 'scaled', bits = 8, prnu = 0.01 }\n", encoding="utf-8"
    )
    assert (
        load_study(plain)
        != load_study(scaled)
        == load_study(plain, pixel={"response": "scaled", "prnu": "0.01"})
    )


def test_load_study_option_completes_data_sheet(tmp_path: Path) -> None:
    """As with `pixsim run`."""
    text = (
        "[pixel]\npitch_um = 4\nfull_well_e = 12000\ndark_current_e_per_s = 1\nquantum_efficiency ="
        " 0.6\n"
    )
    (tmp_path / "sensor.toml").write_text(text, encoding="utf-8")
    study = load_study("pixel-size", tmp_path / "sensor.toml", pixel={"read_noise_e": 2.0})
    assert (study.technologies, study.pixel.read_noise_e, study.pixel.data_sheet_pitch_um) == (
        ("none",),
        2.0,
        4.0,
    )
    with pytest.warns(
        UserWarning, match="not read_noise_e, which come from the study's technology 4t-bsi"
    ):
        assert load_study("pixel-size", tmp_path / "sensor.toml").technologies == ("4t-bsi",)


@pytest.mark.parametrize(
    ("pixel", "message"),
    [
        (
            {"pitch_um": 3.0},
            (
                r"pixel\.pitch_um: got '3\.0' for a study; allowed: the pitch of a data"
                r" sheet.*pitch\.values_um"
            ),
        ),
        ({"response": "scald"}, r"pixel\.response: got 'scald'; allowed: 'scaled' or 'literal'"),
        ({"respons": "scaled"}, r"pixel\.respons: unknown name; .*Did you mean 'response'"),
    ],
)
def test_load_study_invalid_pixel_option_raises(pixel: dict[str, object], message: str) -> None:
    with pytest.raises(pixsim.PixsimError, match=message):
        load_study("chen2000", pixel=pixel)
    with pytest.raises(pixsim.PixsimError, match="pixel: got with a Study"):
        pixsim.study(tiny(), "out", pixel=pixel)


@pytest.mark.slow
def test_study_changed_texture_is_recomputed(tmp_path: Path, evaluations: list[Frame]) -> None:
    chart = tmp_path / "chart.exr"
    scene = {"parameters": {"chart": str(chart)}}
    study = tiny(repeats=2, pitch={"values_um": FIVE_UM}, scene=scene)
    counts = []
    for dark in (0.1, 0.1, 0.2):
        pixsim.write_chart(chart, np.kron([[dark, 1.0]], np.ones((16, 8))).astype(np.float32))
        pixsim.study(study, tmp_path / "out", jobs=1)
        counts.append(len(evaluations))
        evaluations.clear()
    assert counts == [10, 0, 10]
    assert len(rows(tmp_path / "out")) == 10, "rows of the old texture are gone"


def test_study_extension_computes_difference_only(
    done: tuple[StudyResult, Path], tmp_path: Path, evaluations: list[Frame]
) -> None:
    (tmp_path / "results.csv").write_bytes((done[1] / "results.csv").read_bytes())
    pixsim.study(tiny(repeats=4, technologies=("0.35um", "0.25um")), tmp_path, jobs=1)
    assert len(evaluations) == 6 * 1 + 6 * 4  # one more sensor of the old process, four of the new
    assert set(keys(done[1])) < set(keys(tmp_path))


FLICKER = {"frames": 4, "flicker_hz": 100.0, "flicker_depth": 0.9, "integration_s": 0.012}
COLOUR = {"sensitivities": "Nikon_D5100", "peak_quantum_efficiency": 0.5}
FRAMES = {
    "grey": {"exposure": {"integration_s": 1.0}},
    "burst": {
        "exposure": FLICKER,
        "pixel": {"colour": COLOUR, "full_well_e": 700},
        "technologies": ("4t-bsi",),
    },
}


@pytest.mark.parametrize("kind", FRAMES)
def test_study_cached_frames_same_bytes(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Overexposed, so that some pixels are saturated: they are stored with the frame, since its DN
    do not show them.
    """
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "cache"))
    study = tiny(
        repeats=2,
        pitch={"values_um": PITCHES_UM[1:]},
        resolution=128,
        **WHOLE_CHART,
        **FRAMES[kind],
    )
    results = tmp_path / "out/results.csv"

    def evaluated() -> bytes:
        results.unlink(missing_ok=True)
        pixsim.study(study, results.parent, jobs=1)
        return results.read_bytes()

    def frames() -> dict[str, dict[str, Any]]:
        return {
            path.stem: cache.arrays("frames", path.stem) or {}
            for path in (tmp_path / "cache/frames").iterdir()
        }

    cold = evaluated()
    assert all(0.3 < float(row["saturated_fraction"]) < 0.999 for row in rows(results.parent))
    with (
        monkeypatch.context() as patch
    ):  # neither frames nor the light behind them are computed again
        patch.setattr(rows_module, "chain_of", lambda *_: pytest.fail("light on the pixels"))
        assert evaluated() == cold
    whole = frames()
    for name, kept in whole.items():
        cache.store_arrays(
            "frames", name, {part: item for part, item in kept.items() if item.ndim == 2}
        )  # without fractions
    assert evaluated() == cold
    assert {name: set(kept) for name, kept in frames().items()} == {
        name: set(kept) for name, kept in whole.items()
    }


def test_stream_depends_on_key_only() -> None:
    count = 100_000
    first = stream("study", 1, "0.35um", 6.5, 0, "frame").normal(size=count)
    np.random.default_rng().normal(size=7)
    np.testing.assert_array_equal(
        first, stream("study", 1, "0.35um", 6.5, 0, "frame").normal(size=count)
    )
    others = [
        ("study", 1, "0.35um", 6.5, 1, "frame"),
        ("study", 1, "0.35um", 6.5, 0, "sensor"),
        ("study", 1, "0.35um", 6.5000001, 0, "frame"),
        ("study", 10, ".35um", 6.5, 0, "frame"),
        ("study", "1", "0.35um", 6.5, 0, "frame"),
    ]
    for key in others:  # the correlation of independent streams has a standard deviation of 1/√n
        assert abs(np.corrcoef(first, stream(*key).normal(size=count))[0, 1]) < 5 / np.sqrt(
            count
        ), key


@pytest.mark.parametrize(
    ("over", "count", "shared"),
    [
        # Some of the pitches, others among them, backwards, up to the same largest one.
        ({"pitch": {"values_um": [PITCHES_UM[-1], 11.0, 9.9, 8.5, 7.7, 6.0]}}, 18, 4 * 3),
        # Neither keys nor random streams of 0.35 µm depend on what 0.25 µm has.
        ({"technologies": ("0.35um", "0.25um"), "process": {"0.25um": {"dsnu": 0.6}}}, 36, 6 * 3),
        # Fewer sizes and sensors change how much is done, not what.
        ({"repeats": 2, "pitch": {"values_um": FIVE_UM}}, 10, 5 * 2),
    ],
    ids=["other pitches", "another process", "fewer"],
)
def test_study_row_depends_on_its_sensor_only(
    over: dict[str, Any], count: int, shared: int, done: tuple[StudyResult, Path], tmp_path: Path
) -> None:
    pixsim.study(tiny(**over), tmp_path, jobs=1)
    before, now = rows(done[1]), rows(tmp_path)
    assert (len(now), sum(row in before for row in now)) == (count, shared)


@pytest.mark.parametrize(
    ("over", "message"),
    [
        ({"pitch": {"values_um": [5.0, 6, 7, 8, 9]}}, r"5\b.*5\.135 µm"),
        ({"pitch": {"values_um": [6, 7, 8, 9, 1357]}}, r"1357.*1356\.8 µm"),
        ({"technologies": ("0.35um", "0.3um")}, r"0\.3um"),
        ({"technologies": ("0.35um", "0.35um")}, r"0\.35um"),
        (
            {"process": {"0.25um": {"dsnu": 0.1}}},
            r"process: got '0\.25um'; allowed: technologies of the study: 0\.35um",
        ),
        (
            {"process": {"0.35um": {"dsn": 0.1}}},
            r"process\.0\.35um: got 'dsn'; allowed: .*Did you mean 'dsnu'",
        ),
        (
            {"process": {"0.35um": {"dsnu": -0.1}}},
            r"process\.0\.35um: dsnu: got -0\.1; allowed: greater",
        ),
        (
            {"process": {"0.35um": {"voltage_swing_v": 9.0}}},
            r"voltage_swing_v = 9 exceeds reset_voltage_v = 2\.2",
        ),
        (
            {"process": {"0.35um": {"fill_factor_zero_pitch_features": 16.0}}},
            r"pitch_um: got 5\.3; allowed: above 5\.6",
        ),
        ({"process": {"0.35um": {"dsnu": float("nan")}}}, r"(?s)process.*dsnu.*finite"),
        (
            {"target_ci_um": 0.01, "max_evaluations": 17},
            r"max_evaluations: got 17; allowed: at least 18, .*Raise it, or lower repeats",
        ),
        (
            {"technologies": ("none",), "pixel": SHEET, "process": {"none": {"dsnu": 0.1}}},
            r"process\.none: got dsnu; .*Put them into \[pixel\]",
        ),
    ],
)
def test_study_invalid_input_raises_before_render(over: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        prepare(tiny(**over))


def test_study_minimum_at_end_is_no_optimum(tmp_path: Path) -> None:
    """In bright light small pixels are not yet short of photons; in the dark only the largest will
    do.
    """
    for luminance, end_um, values in (
        (1e4, 8.0, [8, 9, 10, 11, 12]),
        (1.0, 7.0, [5.2, 5.5, 6, 6.5, 7]),
    ):
        study = tiny(
            repeats=2,
            scene={"parameters": {"luminance_cd_per_m2": luminance}},
            pitch={"values_um": values},
        )
        best = pixsim.study(study, tmp_path / str(end_um), jobs=1).curves[0].optimum
        assert (best.inside, best.pitch_um) == (False, pytest.approx(end_um))


def test_quick_sets_what_options_leave() -> None:
    assert load_study("chen2000", quick=True).technologies == ("0.35um",)
    study = load_study("chen2000", pixel={"technology": "0.25um"}, quick=True)
    assert (study.technologies, study.repeats) == (("0.25um",), 4)
