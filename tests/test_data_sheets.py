"""A sensor from its data sheet: the same frames however it is given, and the numbers that a
simulated measurement returns.
"""

import json
import re
import warnings
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import command
from helpers.tiny import rows, tiny, tiny_toml, toml_of

import pixsim
from pixsim.cli.options import SceneOptions
from pixsim.measure.datasheet import datasheet_settings, make_datasheet
from pixsim.sensor.reading import Readout
from pixsim.sensor.unit_slips import unit_slips
from pixsim.studies import run
from pixsim.studies.files import load_study
from pixsim.studies.prepare import check_technologies, prepare
from pixsim.studies.sensors import sensor_layer
from pixsim.viewer.settings_file import packaged_sensors, run_settings, settings_layer

SHEET = {
    "pitch_um": 30.0, "full_well_e": 12000.0, "read_noise_e": 6.5, "dark_current_e_per_s": 125.0, "quantum_efficiency": 0.6,
    "bits": 12, "prnu": 0.01, "offset_fpn": 0.001,
}  # fmt: skip
# The same numbers, bit for bit, in the words of a data sheet.
WORDS = {name: SHEET[name] for name in ("pitch_um", "full_well_e", "quantum_efficiency", "bits")} | {
    "temporal_dark_noise_e": 6.5, "dark_current": {"e_per_s": 125.0, "at_c": 27.0}, "prnu_percent": 1.0, "dsnu_e": 12.0,
}  # fmt: skip
# Mismatch of the layout, hot pixels, a split read noise and a gain.
AMPLIFIED = {
    "pitch_um": 6.0, "full_well_e": 12_000.0, "read_noise_e": 3.0, "read_noise_after_gain_e": 40.0, "dark_current_e_per_s": 900.0,
    "quantum_efficiency": 0.6, "bits": 12, "prnu_um": 0.06, "dn_per_e": 0.3, "hot_pixel_fraction": 0.01, "hot_pixel_median": 30.0,
    "hot_pixel_spread": 1.0,
}  # fmt: skip
SMALL = "--resolution 48 --display.dots 64 --seed 3"


def file_of(path: Path, pixel: dict) -> Path:
    path.write_text(
        "[pixel]\n" + "".join(f"{name} = {toml_of(value)}\n" for name, value in pixel.items()),
        encoding="utf-8",
    )
    return path


def options_of(pixel: dict, name: str = "--pixel") -> list[str]:
    words = []
    for key, value in pixel.items():
        option = f"{name}.{key.replace('_', '-')}"
        words += options_of(value, option) if isinstance(value, dict) else [option, str(value)]
    return words


def ways(pixel: dict, folder: Path) -> dict[str, list[object]]:
    """Arguments of a command that give the sensor as a file, as options, as both, and as two files,
    each with a half of it.
    """
    folder.mkdir(exist_ok=True)
    first_half, second_half = (dict(list(pixel.items())[start::2]) for start in (0, 1))
    whole, first, second = (
        file_of(folder / f"{n}.toml", part)
        for n, part in enumerate((pixel, first_half, second_half))
    )
    return {
        "file": ["--config", whole],
        "options": options_of(pixel),
        "both": ["--config", first, *options_of(second_half)],
        "files": ["--config", first, "--config", second],
        "none": ["--config", whole, "--pixel.technology", "none"],
    }


@pytest.mark.parametrize(
    ("pixel", "gain_db", "names"),
    [
        pytest.param(SHEET, 0.0, ("file", "options", "both", "files", "none"), id="fields"),
        pytest.param(WORDS, 0.0, ("file", "options", "files"), id="words", marks=pytest.mark.slow),
        pytest.param(AMPLIFIED, 12.0, ("file", "options"), id="amplified"),
    ],
)
def test_run_same_sensor_in_every_way_gives_same_frame(
    pixel: dict, gain_db: float, names: tuple[str, ...], tmp_path: Path
) -> None:
    frames = {}
    line = f"run csf {SMALL} --exposure.gain-db {gain_db} --json"
    for name in names:
        arguments = ways(pixel, tmp_path / "sheets")[name]
        with warnings.catch_warnings(action="always"):
            code, out, err = command(line, *arguments, "--out", tmp_path / name)
        assert code == 0, err
        score = json.loads(out)
        sensor = score["pixel"]["technology"], score["fill_factor"], score["assumption"]
        assert sensor == ("none", 1.0, "")
        frames[name] = pixsim.read_frame(tmp_path / name / "raw.exr")
    irradiance = pixsim.read_exr(tmp_path / "file/irradiance.exr")
    parts = {
        "camera": pixsim.Camera.model_validate(score["camera"]),
        "exposure": pixsim.Exposure(gain_db=gain_db),
        "display": pixsim.Display(dots=64),
    }
    same = SHEET if pixel is WORDS else pixel
    for technology in ({}, {"technology": None}, {"technology": "none"}):
        python = pixsim.evaluate(
            irradiance, pixel=pixsim.Pixel(**same, **technology), **parts, seed=3
        )
        frames[f"python {technology}"] = python.frame
    assert frames["file"].dn.std() > 10, "a frame with noise and detail"
    if "dn_per_e" in pixel:
        assert frames["file"].dn_per_e == pytest.approx(
            pixel["dn_per_e"] * 10 ** (gain_db / 20), rel=1e-6
        )
    for name, frame in frames.items():
        assert np.array_equal(frame.dn, frames["file"].dn), name


def test_study_has_the_same_sensor_in_every_way(tmp_path: Path) -> None:
    """Rows follow from the record of the study alone."""
    plan = tmp_path / "plan.toml"
    plan.write_text(tiny_toml(technologies=["0.35um"]), encoding="utf-8")
    study = load_study(plan, config=file_of(tmp_path / "sheet.toml", SHEET))
    first, second = (dict(list(SHEET.items())[start::2]) for start in (0, 1))
    files = [file_of(tmp_path / "first.toml", first), file_of(tmp_path / "second.toml", second)]
    assert load_study(plan, pixel=SHEET) == study
    assert load_study(plan, config=files) == study
    assert load_study(plan, config=files[0], pixel=second) == study


def test_later_layer_replaces_value_under_another_word(tmp_path: Path) -> None:
    """An option in a data sheet's words replaces the file's field, and the other way round."""
    for pixel, name, other in (
        (SHEET, "temporal_dark_noise_e", "read_noise_e"),
        (WORDS, "read_noise_e", "temporal_dark_noise_e"),
    ):
        sensor = run_settings(file_of(tmp_path / "a.toml", pixel), {"pixel": {name: 9.0}}).pixel
        assert (getattr(sensor, name), getattr(sensor, other), sensor.technology) == (
            9.0,
            None,
            "none",
        )


# --- Round trip of published data sheets
# -------------------------------------------------------------------------------

SHEETS = Path(__file__).parent / "data/sheets"
WITHIN = 0.02  # of a number, or 3 standard errors
# The wavelength of the quantum efficiency, nm, and the quantity that the sheet calls dynamic range:
# saturation over threshold as in EMVA 1288, or the full well over the temporal dark noise. Sheet ->
# wavelength of its quantum efficiency, nm.
PUBLISHED = {
    "imx174": 525.0,
    "cmv4000": 550.0,
    "gsense400bsi": 400.0,
    "gsense4040bsi": 550.0,
    "hwk4123": 470.0,
    "imx530": 530.0,
    "imx455": 460.8023,
    "thorlabs_cs165": 550.0,
}
# Ratios that sheets state beside the numbers that make them, dB. Sources:
# https://fhotolab.fherb.de/2016/09/07/ sony-exmor-sensoren-dateblattrekonstruktion-imx157/ (73dB,
# 45,12dB); "CMV4000 Technical Reference for Star Tracker Design", based on CMV4000 datasheet v7-00
# (60 dB);
# https://image-sensors-world.blogspot.com/2015/04/towerjazz-and-gpixel-announce-bsi-cmos.html (DR
# of 96dB, of the full well over the noise).
STATED_DB = {
    "imx174": {"DR": 73.0, "SNR_max": 45.12},
    "cmv4000": {"DR": 60.0},
    "gsense400bsi": {"DR_ISO": 96.0},
}


PACKAGED = packaged_sensors()


def test_each_number_of_a_sheet_has_its_source() -> None:
    """A comment above it names who published it, or that it is an assumption."""
    assert {path.stem for path in SHEETS.glob("*.toml")} == set(PUBLISHED)
    assert {"imx363", "imx477"} <= set(PACKAGED)
    for path in (*SHEETS.glob("*.toml"), *PACKAGED.values()):
        lines = path.read_text(encoding="utf-8").splitlines()
        bare = [
            line
            for above, line in pairwise(lines)
            if re.match(r"\w+ = ", line) and not above.startswith("#")
        ]
        given = ("name =", "collector =")  # no numbers
        if path.parent == SHEETS:
            given = (*given, "temperature_k")  # of the sheet's own numbers
        assert not [line for line in bare if not line.startswith(given)], path.name


def test_packaged_sensor_is_its_file_wherever_a_settings_file_stands() -> None:
    """In a run, a comparison, a study and a data sheet."""
    name, path = "imx477", PACKAGED["imx477"]
    expected = run_settings(path, {}).pixel
    assert run_settings(name, {}).pixel == expected
    assert sensor_layer(name).table == settings_layer(path).table
    assert (
        load_study("pixel-size", config=name).pixel == load_study("pixel-size", config=path).pixel
    )
    assert datasheet_settings(name, [], None, None, None).pixel == expected


def expected_numbers(pixel: pixsim.Pixel, name: str) -> dict[str, float]:
    """Symbol of the data sheet -> the number that was given."""
    nm = PUBLISHED[name]
    readout = Readout.of(pixsim.derive(pixel))
    expected = {
        "K": pixel.gain_e_per_dn and 1 / pixel.gain_e_per_dn,
        "η": 100 * float(readout.physics.quantum_efficiency(nm)),
        "σ_d": pixel.temporal_dark_noise_e,
        # Of a full well beyond the ADC's range nothing can be measured but that range.
        "μ_e.sat": pixel.saturation_capacity_e or min(pixel.full_well_e, readout.adc_range_e),
        **STATED_DB.get(name, {}),
        "PRNU_1288": pixel.prnu_percent,
        "DSNU_1288": pixel.dsnu_e,
        "μ_I.mean": (
            pixel.dark_current.e_per_s if pixel.dark_current else pixel.dark_current_e_per_s
        ),
        "ϑ_d": pixel.dark_current and pixel.dark_current.doubling_k,
    }
    return {symbol: value for symbol, value in expected.items() if value is not None}


# A second each, and with no property that the others lack.
MORE_OF_A_KIND = ("cmv4000", "gsense4040bsi", "imx530", "imx455", "gsense400bsi", "hwk4123")


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=pytest.mark.slow) if n in MORE_OF_A_KIND else n for n in PUBLISHED],
)
def test_datasheet_returns_published_numbers(name: str) -> None:
    """False alarms: 0.3 % a number of 3 standard errors; most are far within 2 %. Nothing warns."""
    pixel = SceneOptions([SHEETS / f"{name}.toml"]).settings().pixel
    assert (pixel.technology, pixel.assumption) == ("none", "")
    sheet = make_datasheet(pixel, wavelength_nm=PUBLISHED[name])
    entries = {entry.symbol: entry for entry in sheet.entries}
    # Steps of 10.8 e- hide a noise of 4 e-: EMVA 1288 gives an upper bound only.
    assert sheet.transfer.limited == (name == "thorlabs_cs165")
    for symbol, value in expected_numbers(pixel, name).items():
        entry = entries[symbol]
        if sheet.transfer.limited and symbol == "σ_d":
            assert value < entry.measured < 1.1 * value, "an upper bound"
            continue
        assert abs(entry.measured - value) <= max(WITHIN * value, 3 * entry.standard_error), (
            symbol,
            value,
            entry,
        )


def test_published_sheets_have_no_unit_slips() -> None:
    for path in SHEETS.glob("*.toml"):
        assert not unit_slips(SceneOptions([path]).settings().pixel), path.name


def noted(call: Callable[[], object]) -> list[str]:
    """Notes on pixels."""
    with warnings.catch_warnings(record=True, action="always") as caught:
        call()
    texts = [str(warning.message).removesuffix(".") for warning in caught]
    return [text for text in texts if text.startswith("pixel: ")]


@pytest.mark.parametrize(
    ("pixel", "count"),
    [
        (SHEET, 0),
        (SHEET | {"full_well_e": 12.0, "prnu": 0.2}, 2),
        (SHEET | {"gain_e_per_dn": 0.4}, 1),
    ],
    ids=["sheet", "units", "gain"],
)
def test_unit_slips_are_noted_by_every_entry(pixel: dict, count: int) -> None:
    slips = unit_slips(pixsim.Pixel(**pixel))
    assert len(slips) == count
    light = pixsim.SpectralImage([550.0], 10.0, 30.0, data=np.full((90, 90, 1), 1e-3))
    camera, display = pixsim.Camera(), pixsim.Display(dots=64, white_cd_per_m2=100.0)
    assert (
        noted(lambda: pixsim.evaluate(light, camera, pixsim.Pixel(**pixel), display=display))
        == slips
    )
    tables = {"scene": {"file": "csf"}, "pixel": pixel, "display": {"dots": 64}}
    assert noted(lambda: run.prepare(run_settings((), tables))) == slips, "before a render"
    sheet = {name: value for name, value in pixel.items() if name != "pitch_um"}
    sheet |= {"data_sheet_pitch_um": 30.0}
    sizes = {"values_um": [15.0, 21.0, 30.0, 42.0, 60.0]}
    assert noted(lambda: prepare(tiny(technologies=["none"], pixel=sheet, pitch=sizes))) == slips


# --- Several sensors
# ----------------------------------------------------------------------------------------------------

OTHER: dict = SHEET | {"pitch_um": 20.0, "full_well_e": 30000.0, "bits": 14}
# As many samples, whichever sensor comes first.
ONE_RENDER = {
    "pitch": {"min_um": 10.0, "max_um": 60.0, "values_um": [15.0, 21.0, 30.0, 42.0, 60.0]}, "tolerance_delta_e": 100.0,
    "scene": {"parameters": {"max_lp_per_mm": 20.0}},
}  # fmt: skip


def numbers(folder: Path, technology: str | None = None) -> list[list[str]]:
    """Rows without key, technology and check."""
    return [
        list(row.values())[2:-1] for row in rows(folder) if technology in (None, row["technology"])
    ]


def test_study_of_data_sheets_gives_curves_of_each_alone(tmp_path: Path) -> None:
    """Each scaled from its own pitch, under the stem of its file; an option replaces a value of
    both.
    """
    plan, alone = tmp_path / "own.toml", tmp_path / "alone.toml"
    plan.write_text(
        tiny_toml(technologies=["one.toml", "other.toml"], **ONE_RENDER), encoding="utf-8"
    )
    alone.write_text(tiny_toml(**ONE_RENDER), encoding="utf-8")
    paths = [
        file_of(tmp_path / f"{name}.toml", pixel)
        for name, pixel in (("one", SHEET), ("other", OTHER))
    ]
    result = pixsim.study(plan, tmp_path / "both", pixel={"bits": 11}, jobs=1)
    assert all(f"{name}: " in repr(result) for name in ("one", "other"))
    for path in paths:
        pixsim.study(alone, tmp_path / path.stem, config=path, pixel={"bits": 11}, jobs=1)
        expected = numbers(tmp_path / path.stem)
        assert len(expected) == 10
        assert numbers(tmp_path / "both", str(path)) == expected
    wells_e = [
        float(row["full_well_e"]) for row in rows(tmp_path / "both") if row["pitch_um"] == "30.0"
    ]
    assert wells_e == pytest.approx([12000.0] * 2 + [30000.0 * (30 / 20) ** 2] * 2)


def test_studies_of_sheets_that_do_not_go_together_are_refused(tmp_path: Path) -> None:
    files = [
        str(file_of(tmp_path / f"{name}.toml", pixel))
        for name, pixel in (("one", SHEET), ("same", SHEET), ("other", OTHER))
    ]
    one, same, other = files
    study = load_study("pixel-size", technologies=[one, other])
    assert study.open_range_um == (5.0, 120.0), "a quarter of the smaller, four times the larger"
    with pytest.raises(pixsim.PixsimError, match="same data sheet; allowed: each data sheet once"):
        check_technologies(load_study("pixel-size", technologies=[one, same]))
    with pytest.raises(pixsim.PixsimError, match=r"pitch\.min_um: got no value"):
        prepare(load_study("pixel-size", technologies=[one, "0.35um"]))
