"""Records and settings: validation, content hash and the geometry of the camera; files of runs and
studies, and sensors from data sheets.
"""

from copy import deepcopy
from operator import attrgetter
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

import pixsim
from pixsim.base.hashes import content_hash
from pixsim.base.layers import Layer
from pixsim.base.records import checked
from pixsim.cli.options import SceneOptions
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.lens_options import TracedLens
from pixsim.sensor.integration import pixels_along
from pixsim.sensor.spread import sheet_uncertainty
from pixsim.studies.design import pixel_of, study_pitches_um
from pixsim.studies.files import load_study
from pixsim.studies.settings import Study, with_data_sheets
from pixsim.viewer.merging import merge
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


def test_load_study_takes_files_and_parameters(tmp_path: Path) -> None:
    path = written(tmp_path / "sensor.toml", SHEET)
    study = load_study("pixel-size", str(path), {"luminance_cd_per_m2": 3.0, "resolution": 64})
    assert study.scene.parameters == {"luminance_cd_per_m2": 3.0, "resolution": 64}
    assert study.technologies == ("none",)


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
    table = {"name": "a", "technologies": [str(plain), str(uncertain)]}
    both = checked(Study, with_data_sheets([Layer(table)], {}))
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
    with pytest.raises(pixsim.PixsimError, match=message) as caught:
        sheet_uncertainty(path)
    assert str(path) in str(caught.value)
    with pytest.raises(pixsim.PixsimError, match=message):
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


@pytest.mark.parametrize(
    "missing",
    ["pitch_um", "full_well_e", "read_noise_e", "dark_current_e_per_s", "quantum_efficiency"],
)
def test_incomplete_data_sheet_states_the_technology_that_is_assumed(
    missing: str, sheet: Path
) -> None:
    """In a run, and in a study, which has the pitches."""
    lines = [line for line in CURVED.splitlines() if not line.startswith(missing)]
    written(sheet, "\n".join(lines).replace("pitch_um = 4.0", "pitch_um = 6.0"))
    words = f"technology 0.35um assumed, without {missing}"
    pixel = settings_of(sheet).pixel
    assert words in repr(pixel)
    assert (pixel.assumption, pixel.technology) == (words, "0.35um")
    if missing != "pitch_um":
        with pytest.warns(UserWarning, match=f"not {missing}, .* the study's technology 4t-bsi"):
            study = load_study("pixel-size", sheet)
        assert (study.technologies, study.pixel.data_sheet_pitch_um) == (("4t-bsi",), 6.0)


def test_resolve_file_prefers_folder_of_config(sheet: Path, here: Path) -> None:
    written(Path("qe.csv"), "400,0.1\n500,0.1\n")
    assert settings_of(sheet).pixel.quantum_efficiency[0] == (400.0, 0.3)
    study = written(sheet.parent / "s.toml", 'name = "s"\n')
    written(sheet.parent / "s.quick.toml", '[pixel]\nquantum_efficiency = "qe.csv"\n')
    assert load_study(study, quick=True).pixel.quantum_efficiency[0] == (400.0, 0.3)


# --- Precedence of study, files and options
# -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["lux", "luminance_cd_per_m2"])
def test_illuminance_of_the_user_replaces_the_luminance_of_a_study(
    name: str, tmp_path: Path
) -> None:
    """By a file's [scene] and by an option; `pixel-size` states a luminance."""
    path = written(tmp_path / "light.toml", f"[scene]\n{name} = 500.0\n")
    assert load_study("pixel-size", path).scene.parameters == {name: 500.0}
    option = {name: 500.0}
    assert load_study("pixel-size", parameters=option).scene.parameters == option


def test_study_layers_files_and_options_override_quick(tmp_path: Path) -> None:
    """What --quick sets of `modern` is a technology, too, which must not replace the data sheet."""
    paths = [written(tmp_path / "sensor.toml", SHEET)]
    study = load_study("modern", paths, quick=True)
    assert (study.technologies, study.pitch.count) == (("none",), 10)
    study_path = written(tmp_path / "own.toml", 'name = "own"\n')
    written(
        tmp_path / "own.quick.toml",
        "repeats = 2\nscene.parameters = { resolution = 32, spp = 4 }\ncamera.f_number = 8\n",
    )
    study = load_study(study_path, paths, parameters={"resolution": 96}, quick=True)
    assert study.scene.parameters == {"resolution": 96, "spp": 4}
    assert (study.camera.f_number, study.repeats) == (2.8, 2)


AXIS_LAYER = """name = "lenses"
repeats = 3
camera = { f_number = 8 }
[[axis]]
name = "lens"
set = "camera.f_number"
values = [2.8, 4]
alone = true
"""


LAYERS = {
    "sheet": SHEET,
    "axis": AXIS_LAYER,
    "last": """name = "last"
streams = "other"
camera.f_number = 11
pitch.min_um = 2
""",
    "sizes": 'name = "sizes"\npitch = { values_um = [6, 7, 8, 9, 10] }\n',
    "scene": 'name = "s"\nscene = { file = "still_life" }\n',
}


@pytest.mark.parametrize(
    ("name", "files", "expected"),
    [
        # Another name leaves the random streams of the first file.
        ("chen2000", ["sheet", "axis"], {"name": "lenses", "stream_name": "chen2000", "repeats": 3, "seed": 2000}),
        ("chen2000", ["sheet", "axis"], {"technologies": ("none",), "camera.f_number": 8}),
        ("chen2000", ["axis", "sheet"], {"camera.f_number": 2.8}),
        ("chen2000", ["axis", "sheet", "last"], {"name": "last", "stream_name": "other", "camera.f_number": 11}),
        ("chen2000", ["sizes", "last"], {"pitch.values_um": None}),  # a range takes the place of a list
        ("pixel-size", ["scene"], {"scene.parameters": {}}),
    ],
)  # fmt: skip
def test_files_of_study_settings_are_layers(
    name: str, files: list[str], expected: dict[str, object], tmp_path: Path
) -> None:
    """Later files win, also over a sensor's."""
    study = load_study(name, [written(tmp_path / f"{file}.toml", LAYERS[file]) for file in files])
    assert {field: attrgetter(field)(study) for field in expected} == expected
    assert "camera.f_number" not in study.sources


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


def test_study_layers_measured_well_has_the_pitch_of_its_sheet(tmp_path: Path) -> None:
    """So it scales with the area; without a well the pitch is that of the study."""
    for words, pitch_um in (("full_well_e = 40000", 6.5), ("bits = 12", None)):
        text = f'[pixel]\ntechnology = "0.35um"\npitch_um = 6.5\n{words}\n'
        assert study_of(text, tmp_path).pixel.data_sheet_pitch_um == pitch_um


# --- The die from its pixels
# --------------------------------------------------------------------------------------------


PITCH, PIXELS = "[pixel]\npitch_um = 3.45\n", "[camera]\npixels = [2448, 2048]\n"


@pytest.mark.parametrize(
    ("texts", "options"),
    [
        ([PITCH + PIXELS], {}),
        ([PITCH, PIXELS], {}),
        ([PITCH], {"camera": {"pixels": "2448x2048"}}),
        ([PIXELS], {"pixel": {"pitch_um": "3.45"}}),
    ],
)
def test_settings_pixels_and_pitch_give_the_die(
    texts: list[str], options: dict[str, dict[str, str]], tmp_path: Path
) -> None:
    """In one file, in two, or with options, as text too; pixels_along counts the same pixels."""
    paths = [written(tmp_path / f"{number}.toml", text) for number, text in enumerate(texts)]
    camera = SceneOptions(paths).settings(**options).camera
    assert (camera.die_mm, camera.die_height_mm) == (8.4456, 7.0656)
    assert [pixels_along(1e3 * side, 3.45) for side in (8.4456, 7.0656)] == [2448, 2048]
    over = camera.over(pixsim.Camera())
    assert (over.die_mm, over.height_mm) == (8.4456, 7.0656)


@pytest.mark.parametrize(
    ("die", "off_um"),
    [("die_mm", 1.7), ("die_mm", -1.8), ("die_height_mm", 1.7), ("die_height_mm", 1.8)],
)
def test_settings_pixels_with_another_die_raises(die: str, off_um: float, tmp_path: Path) -> None:
    """Half a pixel, 1.725 µm, is the limit; the given die then stands."""
    given = {"die_mm": 8.4456, "die_height_mm": 7.0656}[die] + 1e-3 * off_um
    path = written(tmp_path / "sensor.toml", f"{PITCH}{PIXELS}{die} = {given!r}\n")
    if abs(off_um) < 1.725:
        assert getattr(SceneOptions([path]).settings().camera, die) == given
    else:
        with pytest.raises(
            pixsim.PixsimError,
            match=rf"camera\.{die} = .* by more than half a pixel; give one of them",
        ):
            SceneOptions([path]).settings()


def test_study_layers_pixels_keep_the_die_at_every_pitch(tmp_path: Path) -> None:
    """The die is that of the sheet's own pitch, whether a data sheet or a technology; and of the
    study's own [pixel].
    """
    pixels = "[camera]\npixels = [500, 400]\n"
    sheet = SHEET.replace("die_mm = 2.0", "pixels = [500, 400]")
    for text in (sheet, f'[pixel]\ntechnology = "4t-bsi"\npitch_um = 4.0\n{pixels}'):
        camera = study_of(text, tmp_path).camera
        assert (camera.die_mm, camera.die_height_mm, camera.pixels) == (2.0, 1.6, None)
    table = {"name": "a", "pixel": {"data_sheet_pitch_um": 4.0}, "camera": {"pixels": [500, 400]}}
    assert Study.model_validate(table).camera.die_height_mm == 1.6


# --- Records
# ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "record", [Camera, CameraOptions, pixsim.Display, pixsim.Exposure, pixsim.Pixel, Run]
)
def test_record_is_frozen(record):
    with pytest.raises(ValidationError, match="frozen"):
        setattr(record(), next(iter(record.model_fields)), 1.0)


def test_content_hash_ignores_the_order_of_keys_alone():
    one = pixsim.Pixel.model_validate({"pitch_um": 5.3, "bits": 12})
    other = pixsim.Pixel.model_validate({"bits": 12, "pitch_um": 5.3, "technology": "0.35um"})
    assert one.content_hash == other.content_hash
    # BLAKE2b of the text {"a":1}, 8 bytes: `printf '{"a":1}' | b2sum -l 64`.
    assert content_hash({"a": 1}) == "1f8c00645b7df6ce"
    # Digits below single precision, the order of a list and the kind of a value count.
    contents = [[1.0, 2.0], [2.0, 1.0], 1.0, 1.0 + 1e-15, "1", 1]
    assert len(set(map(content_hash, contents))) == len(contents)


def test_content_hash_depends_on_every_field():
    values = Camera(die_height_mm=2.0, veiling_glare=0.1, veiling_glare_outside=0.1).model_dump()
    numbers = [{name: 0.99 * n} for name, n in values.items() if isinstance(n, float)]
    lens = TracedLens(file="phone", focal_length_mm=3.86, f_number=4, field_mm=1.9, content="0")
    others = [
        {"chief_ray_angle": [[0, 0], [2, 20]]},
        {"fall_off": [[0, 1], [2, 0.5]]},
        {"lens": lens},
    ]
    hashes = {Camera(**change).content_hash for change in ({}, *numbers, *others)}
    assert len(hashes) == 1 + len(Camera.model_fields)


@pytest.mark.parametrize(
    ("base", "over", "merged"),
    [
        ({"a": {"b": 1, "c": 2}, "d": 1}, {"a": {"b": 3}}, {"a": {"b": 3, "c": 2}, "d": 1}),
        ({"a": {"b": 1}}, {"c": {"d": 2}}, {"a": {"b": 1}, "c": {"d": 2}}),
        ({"a": {"b": 1}}, {"a": 2}, {"a": 2}),
        ({"a": 2}, {"a": {"b": 1}}, {"a": {"b": 1}}),
    ],
)
def test_merge_later_values_take_precedence(base, over, merged):
    before = deepcopy(base)
    assert (merge(base, over), base) == (merged, before)


@pytest.mark.parametrize(
    "camera",
    [
        Camera(),
        Camera(focal_length_mm=50, f_number=1.4, die_mm=36, object_distance_m=0.45),
        Camera(focal_length_mm=4.5, object_distance_m=1e4),
        Camera(focal_length_mm=10, object_distance_m=0.0101),
    ],
)
def test_camera_obeys_thin_lens_equation(camera):
    u_mm, v_mm, f_mm = (
        1e3 * camera.object_distance_m,
        camera.image_distance_mm,
        camera.focal_length_mm,
    )
    assert 1 / u_mm + 1 / v_mm == pytest.approx(1 / f_mm, rel=1e-12)
    assert camera.magnification == pytest.approx(v_mm / u_mm, rel=1e-12)
    assert camera.working_f_number == pytest.approx(
        v_mm / (2e3 * camera.aperture_radius_m), rel=1e-12
    )
    assert np.tan(np.radians(camera.fov_deg / 2)) == pytest.approx(
        camera.die_mm / 2 / v_mm, rel=1e-12
    )
    back = Camera.from_lens_geometry(
        camera.fov_deg, camera.aperture_radius_m, camera.object_distance_m, camera.die_mm
    )
    assert back.model_dump(exclude_none=True) == pytest.approx(
        camera.model_dump(exclude_none=True), rel=1e-9
    )
    # The chart that fills the die is the die over the magnification.
    assert 2e3 * camera.chart_half_width_m * camera.magnification == pytest.approx(
        camera.die_mm, rel=1e-12
    )
