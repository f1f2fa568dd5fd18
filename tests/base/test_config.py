"""Settings files for runs and studies, sensors from data sheets, and messages of invalid
settings.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.base.layers import Layer
from pixsim.base.records import checked
from pixsim.cli.options import SceneOptions
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.integration import pixels_along
from pixsim.sensor.pixel import derive, fill_factor_law
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.reading import Readout
from pixsim.sensor.spread import sheet_uncertainty
from pixsim.studies.design import pixel_of, study_pitches_um
from pixsim.studies.files import load_study
from pixsim.studies.settings import Study, with_data_sheets
from pixsim.viewer.dark_clip import clip_note, clips_dark, dark_clip
from pixsim.viewer.setting import Run

SHEET = """
[pixel]
pitch_um = 4.0
full_well_e = 12000
read_noise_e = 2.5
dark_current_e_per_s = 8
quantum_efficiency = 0.6
bits = 12

[camera]
die_mm = 2.0
f_number = 2.8
"""

TIME_S = 1e-3  # so short that dark charge does not matter


def written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def study_of(text: str, folder: Path, study: str = "pixel-size") -> pixsim.Study:
    return load_study(study, written(folder / "sensor.toml", text))


def test_study_layers_data_sheet_becomes_the_sensor(tmp_path: Path) -> None:
    study = study_of(SHEET, tmp_path)
    assert study.technologies == ("none",)
    assert (study.camera.die_mm, study.camera.f_number, study.pixel.bits) == (2.0, 2.8, 12)
    pitches_um = study_pitches_um(study, "none")
    assert pitches_um[[0, -1]] == pytest.approx([1.0, 16.0])
    wells_e = [
        pixsim.derive(pixel_of(study, "none", pitch_um)).full_well_e
        for pitch_um in pitches_um.tolist()
    ]
    np.testing.assert_allclose(wells_e, 12000 * (pitches_um / 4) ** 2, rtol=1e-12)
    with_range = written(
        tmp_path / "own.toml", 'name = "own"\n[pitch]\nmin_um = 2\nmax_um = 6\ncount = 5\n'
    )
    pitches_um = study_pitches_um(study_of(SHEET, tmp_path, str(with_range)), "none")
    np.testing.assert_allclose(pitches_um, np.geomspace(2, 6, 5), atol=5e-5)


def test_study_layers_technology_replaces_that_of_study(tmp_path: Path) -> None:
    study = study_of(
        '[pixel]\ntechnology = "0.25um"\npitch_um = 7\nbits = 11\n[scene]\nresolution = 128\n',
        tmp_path,
    )
    assert (study.technologies, study.pixel.bits) == (("0.25um",), 11)
    assert study.scene.parameters["resolution"] == 128
    assert study.pixel.data_sheet_pitch_um is None


def test_study_incomplete_data_sheet_raises() -> None:
    table = {
        "name": "a",
        "technologies": ["none"],
        "pixel": {"full_well_e": 1e4, "read_noise_e": 2, "dark_current_e_per_s": 1},
    }
    with pytest.raises(ValueError, match=r"missing: data_sheet_pitch_um, quantum_efficiency"):
        Study.model_validate(table)
    table["pixel"] |= {"quantum_efficiency": 0.5, "data_sheet_pitch_um": 3.0}
    np.testing.assert_allclose(
        study_pitches_um(Study.model_validate(table), "none")[[0, -1]], [0.75, 12.0]
    )
    with pytest.raises(ValueError, match=r"'none' is the data sheet of \[pixel\]; give it alone"):
        Study.model_validate(table | {"technologies": ["none", "0.35um"]})


def test_load_study_takes_files_and_parameters(tmp_path: Path) -> None:
    path = written(tmp_path / "sensor.toml", SHEET)
    study = load_study("pixel-size", [path], {"luminance_cd_per_m2": 3.0, "resolution": 64})
    assert study.scene.parameters == {"luminance_cd_per_m2": 3.0, "resolution": 64}
    assert study.technologies == ("none",)
    assert load_study("pixel-size", str(path)) == load_study("pixel-size", [path]), (
        "one file needs no list"
    )
    with pytest.raises(pixsim.PixsimError, match=r"config: got with a Study"):
        pixsim.study(study, tmp_path / "out", config=[path])


# --- How far its numbers may be wrong
# ------------------------------------------------------------------------------------

UNCERTAIN = SHEET.replace(
    "[camera]",
    """[pixel.uncertainty]
read_noise_e = { sd = 0.2 }
full_well_e = { range = [10000, 15000], distribution = "lognormal" }
quantum_efficiency = { range = [0.5, 0.65] }

[camera]""",
)


def test_sheet_uncertainty_leaves_pixel_plain(tmp_path: Path) -> None:
    """Runs and studies have the same sensor with and without it, however the file is given."""
    plain, uncertain = (
        written(tmp_path / "plain.toml", SHEET),
        written(tmp_path / "uncertain.toml", UNCERTAIN),
    )
    assert settings_of(uncertain) == settings_of(plain)
    assert study_of(UNCERTAIN, tmp_path) == study_of(SHEET, tmp_path)
    for path in (plain, uncertain):
        written(path, path.read_text(encoding="utf-8").partition("[camera]")[0])
    both = checked(
        Study,
        with_data_sheets([Layer({"name": "a", "technologies": [str(plain), str(uncertain)]})], {}),
    )
    assert both.sensors[str(plain)] == both.sensors[str(uncertain)]
    assert sheet_uncertainty(plain) == {}
    spreads = sheet_uncertainty(uncertain)
    assert {name: spread.kind for name, spread in spreads.items()} == {
        "read_noise_e": "normal", "full_well_e": "lognormal", "quantum_efficiency": "uniform",
    }  # fmt: skip
    assert (spreads["read_noise_e"].sd, spreads["full_well_e"].range) == (0.2, (10000, 15000))


@pytest.mark.parametrize(
    ("written_as", "instead", "message"),
    [
        (
            "read_noise_e = { sd",
            "readnoise_e = { sd",
            r"pixel\.uncertainty: got 'readnoise_e'; .*Did you mean 'read_noise_e'",
        ),
        (
            "read_noise_e = { sd",
            "bits = { sd",
            r"pixel\.uncertainty: got 'bits'; allowed: quantum_efficiency",
        ),
        (
            "read_noise_e = { sd",
            "dsnu_e = { sd",
            r"dsnu_e: got a spread without its number; allowed: a number dsnu_e in \[pixel\]",
        ),
        (
            "sd = 0.2",
            "sd = 0",
            r"uncertainty\.read_noise_e: sd: got 0; allowed: greater than or equal to 1e-30",
        ),
        (
            "sd = 0.2",
            "sdd = 0.2",
            r"sdd: unknown name; allowed: sd, range, distribution\. Did you mean 'sd'",
        ),
        ("sd = 0.2", "sd = 0.2, range = [1, 3]", "got both sd and range"),
        ("sd = 0.2", "", "got neither sd nor range"),
        ("{ sd = 0.2 }", "0.2", r"read_noise_e: got 0\.2; allowed: a table.*\{ sd = 0\.2 \}"),
        ("sd = 0.2", "range = [2, 2]", r"range = \[2, 2\]; allowed: low < high"),
        (
            "sd = 0.2",
            "range = [-1, 3]",
            r"read_noise_e: read_noise_e: got -1\.0; allowed: greater than or equal to 0",
        ),
        (
            "sd = 0.2",
            "range = [3, 4]",
            r"range = \[3, 4\]; allowed: low <= 2\.5 \(the number\) <= high",
        ),
        (
            "sd = 0.2",
            'sd = 1, distribution = "gauss"',
            r"distribution: got 'gauss'; allowed: 'uniform', 'normal' or 'lognormal'",
        ),
        (
            "[10000, 15000]",
            "[0, 15000]",
            r"range = \[0, 15000\] of a lognormal distribution; allowed: low > 0",
        ),
        ("[0.5, 0.65]", "[0.5, 1.2]", r"quantum_efficiency: .*got 1\.2"),
        (
            "quantum_efficiency = 0.6",
            "quantum_efficiency = [[400, 0.3], [550, 0.6]]",
            "A curve cannot be uncertain; give a number",
        ),
    ],
)
def test_sheet_uncertainty_invalid_raises(
    written_as: str, instead: str, message: str, tmp_path: Path
) -> None:
    """By every command that reads the file, also those that do not use it."""
    assert UNCERTAIN.count(written_as) == 1
    path = written(tmp_path / "sensor.toml", UNCERTAIN.replace(written_as, instead))
    with pytest.raises(PixsimError, match=message) as caught:
        sheet_uncertainty(path)
    assert str(path) in str(caught.value)
    with pytest.raises(PixsimError, match=message):
        settings_of(path)


# --- A sensor from its data sheet
# --------------------------------------------------------------------------------------


CURVE = (
    "wavelength (nm), quantum efficiency\n# measured\n400, 0.30\n550, 0.60\n700, 0.40\n900, 0.00\n"
)
CURVED = SHEET.replace("quantum_efficiency = 0.6", 'quantum_efficiency = "qe.csv"')


def settings_of(path: Path) -> Run:
    return SceneOptions([path]).settings()


@pytest.fixture
def sheet(tmp_path: Path) -> Path:
    (tmp_path / "data sheet").mkdir()
    written(tmp_path / "data sheet/qe.csv", CURVE)
    return written(tmp_path / "data sheet/my_sensor.toml", CURVED)


def test_data_sheet_sets_all_values(sheet: Path) -> None:
    """`test_run_same_sensor_in_every_way_gives_same_frame` has the way from a file to a frame."""
    readout = Readout.of(derive(settings_of(sheet).pixel))
    assert readout.physics.pixel.technology == "none"
    assert (readout.full_well_e, readout.physics.fill_factor, readout.physics.pixel.pitch_um) == (
        12000.0,
        1.0,
        4.0,
    )
    assert (
        readout.physics.reset_noise_e,
        readout.physics.offset_fpn_e,
        readout.physics.column_fpn_e,
    ) == (0.0, 0.0, 0.0)
    assert (readout.read_noise_e, readout.dark_current_e_per_s) == (2.5, 8.0)


@pytest.mark.parametrize(
    "missing",
    ["pitch_um", "full_well_e", "read_noise_e", "dark_current_e_per_s", "quantum_efficiency"],
)
def test_incomplete_data_sheet_states_the_technology_that_is_assumed(
    missing: str, sheet: Path
) -> None:
    text = "\n".join(row for row in CURVED.splitlines() if not row.startswith(missing)).replace(
        "pitch_um = 4.0", "pitch_um = 6.0"
    )
    written(sheet, text)
    words = f"technology 0.35um assumed, without {missing}"
    pixel = settings_of(sheet).pixel
    assert words in repr(pixel)
    assert (pixel.assumption, pixel.technology) == (words, "0.35um")


@pytest.mark.parametrize(
    "missing", ["full_well_e", "read_noise_e", "dark_current_e_per_s", "quantum_efficiency"]
)
def test_study_layers_incomplete_data_sheet_states_technology(missing: str, sheet: Path) -> None:
    written(sheet, "\n".join(row for row in CURVED.splitlines() if not row.startswith(missing)))
    with pytest.warns(
        UserWarning, match=rf"no technology and not {missing}, .* the study's technology 4t-bsi"
    ):
        study = load_study("pixel-size", sheet)
    assert (study.technologies, study.pixel.data_sheet_pitch_um) == (
        ("4t-bsi",),
        None if missing == "all" else 4.0,
    )


def test_resolve_file_prefers_folder_of_config(
    sheet: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    written(Path("qe.csv"), "400,0.1\n500,0.1\n")
    assert settings_of(sheet).pixel.quantum_efficiency[0] == (400.0, 0.3)
    study = written(sheet.parent / "s.toml", 'name = "s"\n')
    written(sheet.parent / "s.quick.toml", '[pixel]\nquantum_efficiency = "qe.csv"\n')
    assert load_study(study, quick=True).pixel.quantum_efficiency[0] == (400.0, 0.3)


# --- Precedence of study, files and options
# -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("stated", "kept"),
    [("lux", {"lux": 500.0}), ("luminance_cd_per_m2", {"luminance_cd_per_m2": 500.0})],
)
def test_illuminance_of_the_user_replaces_the_luminance_of_a_study(tmp_path, stated, kept):
    """By a file's [scene] and by an option; `pixel-size` states a luminance."""
    path = written(tmp_path / "light.toml", f"[scene]\n{stated} = 500.0\n")
    for study in (
        load_study("pixel-size", path),
        load_study("pixel-size", parameters={stated: 500.0}),
    ):
        assert study.scene.parameters == kept


def test_study_layers_files_and_options_override_quick(tmp_path: Path) -> None:
    """What --quick sets of `modern` is a technology, too, which must not replace the data sheet."""
    paths = [written(tmp_path / "sensor.toml", SHEET)]
    study = load_study("modern", paths, quick=True)
    assert (study.technologies, study.pitch.count) == (("none",), 10)
    study_path = written(tmp_path / "own.toml", 'name = "own"\n')
    quick = (
        "repeats = 2\nscene = { parameters = { resolution = 32, spp = 4 } }\ncamera = { f_number ="
        " 8 }\n"
    )
    written(tmp_path / "own.quick.toml", quick)
    study = load_study(study_path, paths, parameters={"resolution": 96}, quick=True)
    assert study.scene.parameters == {"resolution": 96, "spp": 4}
    assert (study.camera.f_number, study.repeats) == (2.8, 2)


def test_files_of_study_settings_are_layers(tmp_path: Path) -> None:
    """Later files win, also over a sensor's; another name leaves the random streams of the first
    file.
    """
    sheet, axis = (
        written(tmp_path / "sensor.toml", SHEET),
        written(tmp_path / "axis.toml", AXIS_LAYER),
    )
    last = written(
        tmp_path / "last.toml",
        'name = "last"\nstreams = "other"\n[camera]\nf_number = 11\n[pitch]\nmin_um = 2\n',
    )
    study = load_study("chen2000", [sheet, axis])
    assert (study.name, study.stream_name, study.repeats, study.technologies) == (
        "lenses",
        "chen2000",
        3,
        ("none",),
    )
    assert (study.axis[0].values, study.camera.f_number, study.seed) == ((2.8, 4), 8, 2000)
    assert "camera.f_number" not in study.sources
    study = load_study("chen2000", [axis, sheet, last])
    assert (study.name, study.stream_name, study.camera.f_number) == ("last", "other", 11)
    assert load_study("chen2000", [axis, sheet]).camera.f_number == 2.8
    sizes = written(
        tmp_path / "sizes.toml", 'name = "sizes"\npitch = { values_um = [6, 7, 8, 9, 10] }\n'
    )
    assert load_study("chen2000", [sizes, last]).pitch.values_um is None, (
        "a range takes the place of a list"
    )
    scene = written(tmp_path / "scene.toml", 'name = "s"\nscene = { file = "still_life" }\n')
    assert load_study("pixel-size", scene).scene.parameters == {}


AXIS_LAYER = """name = "lenses"
repeats = 3
camera = { f_number = 8 }
[[axis]]
name = "lens"
set = "camera.f_number"
values = [2.8, 4]
alone = true
"""


@pytest.mark.parametrize(
    ("text", "sizes", "sensors"),
    [
        ("", 8, 4),
        ("repeats = 2\npitch = { count = 5 }\n", 5, 2),
        ("repeats = 5\npitch = { values_um = [6, 7, 8, 9, 10, 11, 12, 13, 14] }\n", 9, 4),
    ],
)
def test_quick_without_a_file_of_its_own_is_at_most_8_sizes_of_4_sensors(
    text: str, sizes: int, sensors: int, tmp_path: Path
) -> None:
    study = load_study(written(tmp_path / "s.toml", f'name = "s"\n{text}'), quick=True)
    assert (study_pitches_um(study, "0.35um").size, study.repeats) == (sizes, sensors)


def test_study_layers_measured_well_scales_with_area(tmp_path: Path) -> None:
    text = '[pixel]\ntechnology = "0.35um"\npitch_um = 6.5\nfull_well_e = 40000\n'
    study = study_of(text, tmp_path)
    assert study.pixel.data_sheet_pitch_um == 6.5
    area_um2 = (
        fill_factor_law([6.5, 13.0], pixsim.load_technology("0.35um")) * np.array([6.5, 13.0]) ** 2
    )
    well_e = pixsim.derive(pixel_of(study, "0.35um", 13.0)).full_well_e
    assert well_e == pytest.approx(40000 * area_um2[1] / area_um2[0], rel=1e-12)
    assert (
        study_of(
            text.replace("full_well_e = 40000", "bits = 12"), tmp_path
        ).pixel.data_sheet_pitch_um
        is None
    )


@pytest.mark.parametrize(
    ("options", "gain_db", "message"),
    [
        # σ of 2.5 e- is 0.85 DN where 12000 e- are 4095: Φ(0.59), and Φ(-0.59) + Φ(-1.76) +
        # Φ(-2.93) = 0.32 DN.
        (
            {},
            0,
            (
                "clips dark noise: 72 % of dark pixels are at 0 DN, which raises the dark mean by"
                " 0.93 e-"
            ),
        ),
        ({"black_level_dn": 7}, 0, ""),
        # With offsets: σ is 24.1 e- or 8.2 DN, and the level 0.87 of it; σφ(0.87) - 7.1 Φ(-0.87) =
        # 0.88 DN.
        (
            {"black_level_dn": 7, "offset_fpn": 0.002},
            *(0, "21 % of dark pixels are at 0 DN, which raises the dark mean by 2.6 e-"),
        ),
        ({"black_level_dn": 50, "offset_fpn": 0.002}, 0, ""),
        ({"offset_fpn": 0.2}, 0, "avoiding this takes more bits (pixel.bits)"),
        ({"offset_fpn": 0.02}, 20, "avoiding this takes less gain (exposure.gain_db)"),
        # With reset noise and offsets of a technology.
        ({"technology": "0.35um"}, 0, "set pixel.black_level_dn = 15 to avoid this"),
        ({"technology": "0.35um", "black_level_dn": 15}, 0, ""),
    ],
)
def test_low_black_level_gives_note(
    options: dict[str, object], gain_db: float, message: str
) -> None:
    """How notes reach a page, and the terminal: `test_run_notes_reach_score_page_and_json`, and
    that of studies.
    """
    sheet = {"bits": 10} if "technology" in options else tomllib.loads(SHEET)["pixel"]
    pixel = Pixel.model_validate(sheet | options)
    dark = dark_clip(Readout.of(derive(pixel)).at(Exposure(gain_db=gain_db)), TIME_S, 1e4)
    assert clips_dark(dark) == bool(message)
    assert not message or message in clip_note(dark, pixel.model_dump())


# --- The die from its pixels
# --------------------------------------------------------------------------------------------


def test_settings_pixels_and_pitch_give_the_die(tmp_path: Path) -> None:
    """In one file, in two, or with options, as text too; pixels_along counts the same pixels."""
    pixel, camera = "[pixel]\npitch_um = 3.45\n", "[camera]\npixels = [2448, 2048]\n"
    one, other = written(tmp_path / "one.toml", pixel), written(tmp_path / "other.toml", camera)
    both = written(tmp_path / "both.toml", pixel + camera)
    for settings in (
        SceneOptions([both]).settings(),
        SceneOptions([one, other]).settings(),
        SceneOptions([one]).settings(camera={"pixels": "2448x2048"}),
        SceneOptions([other]).settings(pixel={"pitch_um": "3.45"}),
    ):
        assert (settings.camera.die_mm, settings.camera.die_height_mm) == (8.4456, 7.0656)
        assert [pixels_along(1e3 * side, 3.45) for side in (8.4456, 7.0656)] == [2448, 2048]
        camera_of_scene = settings.camera.over(pixsim.Camera())
        assert (camera_of_scene.die_mm, camera_of_scene.height_mm) == (8.4456, 7.0656)
    assert pixsim.Camera(die_mm=3.0).height_mm == 3.0


@pytest.mark.parametrize(
    ("die", "off_um"),
    [("die_mm", 1.7), ("die_mm", -1.8), ("die_height_mm", 1.7), ("die_height_mm", 1.8)],
)
def test_settings_pixels_with_another_die_raises(die: str, off_um: float, tmp_path: Path) -> None:
    """Half a pixel, 1.725 µm, is the limit; the given die then stands."""
    given = {"die_mm": 8.4456, "die_height_mm": 7.0656}[die] + 1e-3 * off_um
    text = f"[pixel]\npitch_um = 3.45\n[camera]\npixels = [2448, 2048]\n{die} = {given!r}\n"
    path = written(tmp_path / "sensor.toml", text)
    if abs(off_um) < 1.725:
        assert getattr(SceneOptions([path]).settings().camera, die) == given
    else:
        with pytest.raises(
            PixsimError, match=rf"camera\.{die} = .* by more than half a pixel; give one of them"
        ):
            SceneOptions([path]).settings()


def test_study_layers_pixels_keep_the_die_at_every_pitch(tmp_path: Path) -> None:
    """The die is that of the sheet's own pitch, whether a data sheet or a technology; and of the
    study's own [pixel].
    """
    for text in (SHEET.replace("die_mm = 2.0", "pixels = [500, 400]"), '[pixel]\ntechnology = "4t-bsi"\npitch_um = 4.0\n[camera]\n'
                 "pixels = [500, 400]\n"):  # fmt: skip
        study = study_of(text, tmp_path)
        assert (study.camera.die_mm, study.camera.die_height_mm, study.camera.pixels) == (
            2.0,
            1.6,
            None,
        )
    table = {"name": "a", "pixel": {"data_sheet_pitch_um": 4.0}, "camera": {"pixels": [500, 400]}}
    assert Study.model_validate(table).camera.die_height_mm == 1.6
    with pytest.raises(ValueError, match="needs the pitch of the sensor"):
        Study.model_validate(table | {"pixel": {}})
