"""The packaged scenes and their spectra as files: against standards, in stock Mitsuba, and with the
edits of scenes/README.md, each of which changes the picture as physics predicts.
"""

import re
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import colour
import numpy as np
import pytest
from helpers.edits import END, FOLDER, VARIANT, edited
from numpy.typing import ArrayLike
from PIL import Image

import pixsim
from pixsim.light import spectral
from pixsim.scene.guard.inspector import open_scene
from pixsim.scene.mitsuba import import_mitsuba, mitsuba_session, parse
from pixsim.scene.plan import make_render_plan
from pixsim.scene.tree import REFERENCES

SCENES = ["cornell_box", "line_lamp", "macbeth", "still_life"]
LAMPS = ["d65", "a", "fl11", "led_b3", "laser_532nm"]
COS_45 = 0.5**0.5
SIZE = 64
SEED = 1
FINE_NM = np.arange(360.0, 830.01, 0.05)
# Four pulses, triangles 2 nm wide at half height: Mitsuba carries four wavelengths a ray and puts
# one in each, so that colours have no noise.
LINES_NM = np.array([450.0, 530.0, 610.0, 690.0])
PULSE_NM = 2.0


def pulse(centre_nm: float) -> dict:
    """Ends at 0: the film's table of wavelengths joins the ends of its responses by straight
    lines.
    """
    low, high = centre_nm - PULSE_NM, centre_nm + PULSE_NM
    return {"type": "regular", "wavelength_min": low, "wavelength_max": high, "values": "0, 1, 0"}


def photometric() -> dict:
    """683 ȳ(λ) at every nm: radiance through it is cd/m²."""
    values = ", ".join(map(repr, spectral.luminous_weight(np.arange(360.0, 831.0), 1.0).tolist()))
    return {"type": "regular", "wavelength_min": 360, "wavelength_max": 830, "values": values}


def specfilm(size: tuple[int, int], bands: dict[str, dict]) -> dict:
    """Describe a film in float32 with a channel for each response."""
    parts = {"component_format": "float32", "rfilter": {"type": "box"}}
    return {"type": "specfilm", "width": size[1], "height": size[0], **parts, **bands}


def rendered(
    path: Path,
    responses: list[dict],
    spp: int,
    size: int,
    crop: tuple[int, int, int, int] | None,
    **parameters,
):
    """∫ radiance × response dλ, (H, W, responses) float64, by Mitsuba alone. crop: first column,
    first row, columns, rows.
    """
    values = {name: str(value) for name, value in parameters.items()}
    state = parse(open_scene(path, values).text, VARIANT)
    (sensor,) = (node.props for node in state.nodes if node.type.name == "Sensor")
    lens = {key: sensor[key] for key in sensor.keys() if sensor.type(key).name not in REFERENCES}  # noqa: SIM118
    bands = {f"band_{index:02d}": response for index, response in enumerate(responses)}
    names = ("crop_offset_x", "crop_offset_y", "crop_width", "crop_height")
    bands |= zip(names, crop or (0, 0, size, size), strict=True)
    film = specfilm((size, size), bands)
    with mitsuba_session(VARIANT) as mi:
        scene = mi.load_file(str(path), **values)
        sampler = {"type": "multijitter", "sample_count": spp}
        eye = mi.load_dict({"type": "thinlens", **lens, "film": film, "sampler": sampler})
        return np.asarray(mi.render(scene, sensor=eye, seed=SEED), float)


def radiance(
    path: Path,
    spp: int = 16,
    size: int = SIZE,
    crop: tuple[int, int, int, int] | None = None,
    **parameters,
):
    """Radiance at the four LINES_NM, (H, W, 4), W m⁻² sr⁻¹ nm⁻¹."""
    return rendered(path, [pulse(nm) for nm in LINES_NM], spp, size, crop, **parameters) / PULSE_NM


@cache
def packaged(name: str):
    """Return the radiance of a packaged scene with its default parameters; do not modify it."""
    return radiance(FOLDER / f"{name}.xml")


@cache
def table(name: str) -> np.ndarray:
    """Return wavelengths (nm) and values of a packaged table, (2, n)."""
    return np.loadtxt(FOLDER / "spectra" / f"{name}.spd").T


def spectrum(name: str, wavelength_nm) -> np.ndarray:
    """Return a packaged table as Mitsuba reads it: linear between its points, 0 outside."""
    return np.interp(wavelength_nm, *table(name), left=0.0, right=0.0)


def in_pulses(name: str) -> np.ndarray:
    """Return the mean over each pulse, (4,)."""
    from_centre = np.linspace(-PULSE_NM, PULSE_NM, 401)
    weight = 1 - np.abs(from_centre) / PULSE_NM
    return (spectrum(name, LINES_NM[:, None] + from_centre) * weight).sum(axis=1) / weight.sum()


def luminous_flux(*names: str) -> float:
    """683 ∫ȳ Π spectra dλ."""
    product = np.prod([spectrum(name, FINE_NM) for name in names], axis=0)
    return float((product * spectral.luminous_weight(FINE_NM, 0.05)).sum())


PATCHES = [f"macbeth/{path.stem}" for path in sorted((FOLDER / "spectra/macbeth").glob("*.spd"))]


def patch(index: int, size: int = SIZE) -> tuple[slice, slice]:
    """Return rows and columns well inside one of the 6 × 4 patches of macbeth.xml."""
    row, column = divmod(index, 6)
    rows = slice(int((row + 0.15) * size / 4), int((row + 0.85) * size / 4))
    return rows, slice(int(np.ceil((column + 0.2) * size / 6)), int((column + 0.8) * size / 6))


# --- The steps of scenes/README.md ---


class Step(NamedTuple):
    """Edits of a scene's XML, or parameters."""

    scene: str
    edits: list[tuple[str, str]]
    parameters: dict[str, str]


def read_steps() -> dict[str, Step]:
    steps = {}
    text = (FOLDER / "README.md").read_text(encoding="utf-8")
    pattern = r"<!-- step: (\w+) (\w+) -->\n(.*?)(?=<!-- step:|\Z)"
    for name, scene, body in re.findall(pattern, text, re.DOTALL):
        xml = re.findall(r"```xml\n(.*?)```", body, re.DOTALL)
        commands = re.findall(rf"```sh\npixsim run {scene} (.*)\n```", body)
        assert (len(xml), len(commands)) in ((2, 0), (1, 0), (0, 1)), name
        edits = [(before, after) for before, after in pairwise([END, *xml][-2:])]
        steps[name] = Step(scene, edits, dict(re.findall(r"-D (\w+)=(\S+)", "".join(commands))))
    return steps


STEPS = read_steps()


def stepped(name: str, folder: Path, *edits: tuple[str, str]) -> np.ndarray:
    """Return the radiance of a scene with a step of its README, and further edits."""
    step = STEPS[name]
    return radiance(edited(folder, step.scene, *step.edits, *edits), **step.parameters)


def test_every_step_has_a_test() -> None:
    names = {name.removeprefix("test_step_") for name in globals() if name.startswith("test_step_")}
    assert names | RATIOS.keys() | {name for name, *_ in BLURS if name} == set(STEPS)


# --- Packaged scenes ---


@pytest.mark.parametrize("name", SCENES)
def test_packaged_scenes_render_in_stock_mitsuba(name: str, here: Path) -> None:
    mi = import_mitsuba(VARIANT)
    picture = np.asarray(mi.render(mi.load_file(str(FOLDER / f"{name}.xml"), resolution=16, spp=4)))
    assert np.isfinite(picture).all()
    assert np.count_nonzero(picture.sum(axis=2)) > 250


# A place, from where it is seen, and how a white diffuser there is turned: on the table, on the
# floor, or on a chart
PLACES_OF_LUX = {
    "still_life": ((0, 1e-4, -0.03), (0, 0.01, -0.035), 'x="1" angle="-90"'),
    "cornell_box": ((0, -0.2999, 1.1), (0, -0.28, 1.095), 'x="1" angle="-90"'),
}


@pytest.mark.parametrize("name", SCENES)
def test_lux_is_the_illuminance_at_the_place_that_the_scene_states(name: str) -> None:
    # A white diffuser there, a millimetre wide, has 500/π cd/m². From 8 seeds the noise is .22 %
    # under FL11's lines, and the mean is within .02 %.
    text = pixsim.load_scene(name, lux=500, variant=VARIANT).text().text
    place, origin, turned = PLACES_OF_LUX.get(
        name, ((0, 0, 1 - 1e-4), (0, 0, 0.9), 'y="1" angle="180"')
    )
    diffuser = f"""<shape type="rectangle"><transform name="to_world"><scale value="5e-4"/>
        <rotate {turned}/><translate value="{str(place)[1:-1]}"/></transform>
        <bsdf type="diffuse"><spectrum name="reflectance" value="1"/></bsdf></shape></scene>"""
    meter = {
        "type": "radiancemeter",
        "origin": origin,
        "direction": np.subtract(place, origin).tolist(),
        "film": specfilm((1, 1), {"y": photometric()}),
        "sampler": {"type": "independent", "sample_count": 1 << 16},
    }
    with mitsuba_session(VARIANT) as mi:
        scene = mi.load_string(text.replace("</scene>", diffuser))
        radiance_lit = mi.render(scene, sensor=mi.load_dict(meter), seed=SEED)
        assert np.asarray(radiance_lit).item() == pytest.approx(500 / np.pi, rel=0.01)


# --- Spectra ---


def test_packaged_reflectances_match_standards() -> None:
    measured = colour.SDS_COLOURCHECKERS["ISO 17321-1"]
    assert len(PATCHES) == 24
    for name, (colour_name, standard) in zip(PATCHES, measured.items(), strict=True):
        words = re.sub(r" 9\.5|\(.*", "", colour_name).strip()
        assert name[11:] == re.sub(r"\W+", "_", words)
        expected = [360, *standard.wavelengths, 830], standard.values[[0, *range(81), -1]]
        np.testing.assert_allclose(table(name), expected, atol=1e-9)


@pytest.mark.parametrize("name", LAMPS[:4])
def test_packaged_lamps_match_standards(name: str) -> None:
    # Files have six digits. CIE's table of A has six too; the file has its formula.
    standard = colour.SDS_ILLUMINANTS[name.upper().replace("_", "-")]
    inside = standard.wavelengths >= 360
    values = spectrum(name, standard.wavelengths[inside])
    expected = standard.values[inside] / standard.values[inside].max()
    np.testing.assert_allclose(values / values.max(), expected, rtol=1e-5, atol=1e-8)


# ASTM G173-03, global, W m⁻² nm⁻¹, as pvlib's documentation prints it, and a black body
RANGE_NM = np.array([500.0, 800.0, 1100.0])
TO_1100_NM = {
    "sunlight": np.array([1.5451, 1.0725, 0.48577]),
    "halogen": RANGE_NM**-5.0 / np.expm1(1.438776877e7 / (3200 * RANGE_NM)),
}


@pytest.mark.parametrize("name", TO_1100_NM)
def test_lamps_go_on_to_1100_nm(name: str) -> None:
    values = spectrum(name, RANGE_NM)
    expected = TO_1100_NM[name] / TO_1100_NM[name][0]
    np.testing.assert_allclose(values / values[0], expected, rtol=2e-5)  # six digits
    assert table(name)[0][-1] == 1100


@pytest.mark.parametrize("name", [*LAMPS, *TO_1100_NM])
def test_lamps_at_45_degrees_make_white_1000_cd_per_m2(name: str) -> None:
    # Five digits, and ȳ bends a little between its nanometres, most under the laser.
    assert luminous_flux(name) * COS_45 / np.pi == pytest.approx((1000.0), rel=2e-4)


@pytest.mark.parametrize("lamp", ["led_850nm", "halogen", "sunlight"])
def test_materials_of_yard_say_what_they_are_to_1100_nm(lamp: str) -> None:
    for path in FOLDER.glob("spectra/measured/*.spd"):
        wavelength_nm, value = table(f"measured/{path.stem}")
        np.testing.assert_array_equal(wavelength_nm, [360, *range(400, 1101, 10)])
        assert 0 < value.min() <= value.max() < 1
    scene = pixsim.load_scene("yard", resolution=16, lamp=f"spectra/{lamp}.spd")
    plan = make_render_plan(scene, pixel=pixsim.Pixel(technology="4t-bsi", pitch_um=4.0))
    assert plan.light.bands.edges_nm[-1] == 1100
    assert not [note for note in plan.warnings if "reflectance" in note]


# --- macbeth and line_lamp ---


def test_macbeth_patches_match_tables() -> None:
    # From 4 seeds the largest of these 96 errors is 0.07 %: a slope within a pulse of 2 nm. The
    # most alike of the patches, two greys, differ by 40 %.
    picture = packaged("macbeth")
    for index, name in enumerate(PATCHES):
        expected = in_pulses("d65") * in_pulses(name) * COS_45 / np.pi
        light = picture[patch(index)].mean(axis=(0, 1))
        np.testing.assert_allclose(light, expected, rtol=2e-3, err_msg=name)


CORNERS = {(0, 0): 1.0, (0, 1): 0.6, (1, 0): 0.3, (1, 1): 0.1}


def quarter(picture: np.ndarray, row: int, column: int) -> np.ndarray:
    """Return the mean of a quarter of the chart, over the radiance of a perfect diffuser."""
    rows, columns = (slice(4 + 24 * place, 18 + 24 * place) for place in (row, column))
    white = picture[np.s_[51:61, 51:61]].mean(axis=(0, 1)) / 0.9
    return np.asarray(picture[rows, columns].mean(axis=(0, 1)) / white)


# --- The edits ---


def around(row: float, column: float, half: float = 0.02) -> tuple[slice, slice]:
    """Return rows and columns of a square; place and half side are fractions of the picture."""
    rows, columns = (
        slice(round((place - half) * SIZE), round((place + half) * SIZE) + 1)
        for place in (row, column)
    )
    return rows, columns


A_OVER_D65 = in_pulses("a") / in_pulses("d65")
# step: (where, radiance over radiance before, relative or absolute tolerance)
RATIOS: dict[str, list[tuple[object, ArrayLike, float]]] = {
    # Of patches, as test_macbeth_patches_match_tables has them
    "another_lamp": [(patch(6), A_OVER_D65, 2e-3), (patch(12), A_OVER_D65, 2e-3)],
    "another_reflectance": [
        (patch(0), np.array([0.1, 0.1, 0.8, 0.8]) / in_pulses(PATCHES[0]), 2e-3),
        (patch(1), 1, 1e-5),
    ],
    # The same rays: only the digits of the two spectra differ.
    "stronger_lamp": [(np.s_[:, :], 2, 2e-4)],
    # Reflectances at normal incidence, silver to gold: .97/.39 at 450 nm, .98/.97 at 690 nm
    # (Johnson and Christy, 1972)
    "another_metal": [((*around(0.29, 0.73, 0.05), [0, 3]), [2.5, 1.0], 0.15)],
    # Black glass; the wall has 121 pixels with noise of 1.5 %.
    "another_material": [(around(0.53, 0.66), 0, 0.0), (around(0.10, 0.85, 0.08), 1, 0.06)],
}


@pytest.mark.parametrize("name", RATIOS)
def test_radiance_after_a_step_over_that_before(name: str, tmp_path: Path) -> None:
    after = stepped(name, tmp_path)
    before = packaged(STEPS[name].scene)
    for place, expected, tolerance in RATIOS[name]:
        ratio = after[place].mean(axis=(0, 1)) / before[place].mean(axis=(0, 1))
        np.testing.assert_allclose(ratio, np.broadcast_to(expected, ratio.shape), rtol=tolerance)


def test_step_another_chart(tmp_path: Path) -> None:
    picture = stepped("another_chart", tmp_path)
    left, right = picture[8:40, 3:16].mean(axis=(0, 1)), picture[8:40, 32:45].mean(axis=(0, 1))
    np.testing.assert_allclose(left / right, 0.1, rtol=1e-2)  # of the slanted edge


def test_step_coloured_bitmap(tmp_path: Path) -> None:
    # Rec. 709's luminances, and IEC 61966-2-1 of grey 128. Mitsuba's smooth spectra meet them to .3
    # %; from 6 seeds, noise of .1 %.
    quarters = np.array([[(255, 0, 0), (0, 255, 0)], [(0, 0, 255), (128, 128, 128)]], np.uint8)
    Image.fromarray(quarters).resize((64, 64), Image.Resampling.NEAREST).save(
        tmp_path / "photo.png"
    )
    path = edited(tmp_path, "line_lamp", *STEPS["coloured_bitmap"].edits)
    picture = rendered(path, [photometric()], 64, SIZE, None, lamp="spectra/d65.spd")
    values = [quarter(picture, *place).item() for place in CORNERS]
    assert values == pytest.approx([0.2126, 0.7152, 0.0722, 0.2159], rel=0.01)


def test_step_lamp_and_room(tmp_path: Path) -> None:
    # The same rays carry either: only float32 differs. The room's light is weak, but there.
    room = radiance(FOLDER / "still_life.xml", lamp_scale=1e-9).mean(axis=(0, 1))
    both = packaged("still_life").mean(axis=(0, 1))
    assert 0.03 < (room / both).min() < (room / both).max() < 0.3
    lamp = stepped("lamp_and_room", tmp_path).mean(axis=(0, 1)) / 2
    np.testing.assert_allclose(lamp + room, both, rtol=1e-4)


def test_step_second_lamp(tmp_path: Path) -> None:
    # A path meets one of two lamps by chance. From 4 seeds the largest error of a patch is .08 %.
    first = '<vector name="direction" x="0" y="-1" z="1"/>\n        <spectrum name="irradiance" '
    dark = (f'{first}filename="$lamp"', f'{first}value="0"')
    second = stepped("second_lamp", tmp_path, dark)
    total = second + packaged("macbeth")
    both = stepped("second_lamp", tmp_path)
    means = [
        [picture[place].mean(axis=(0, 1)) for place in map(patch, range(24))]
        for picture in (both, total)
    ]
    np.testing.assert_allclose(*means, rtol=3e-3)


def test_step_another_object(tmp_path: Path) -> None:
    # A ball of reflectance 0.5 is brightest 45° down its side, of which a pixel spans 9°; it has a
    # shadow, and sends less than 1 % to the corners.
    lit = stepped("another_object", tmp_path)
    ball = (lit / (in_pulses("d65") * COS_45 / np.pi))[22:42, 22:42].mean(axis=2)
    assert ball.max() == pytest.approx(0.5 / COS_45, rel=0.015)
    assert ball.argmax() // 20 < 10
    ratio = lit / packaged("macbeth")
    assert ratio[43:48, 26:30].max() < 0.2
    corners = [ratio[patch(corner)].mean() for corner in (0, 5, 18, 23)]
    assert corners == pytest.approx([1] * 4, rel=0.01)


def test_step_another_instance(tmp_path: Path) -> None:
    """Its head, by the camera's geometry, is yellow, diluted by the table's light."""
    after, before = (
        picture[around(0.672, 0.856)].mean(axis=(0, 1))
        for picture in (stepped("another_instance", tmp_path), packaged("still_life"))
    )
    yellow = in_pulses("d65") * in_pulses("macbeth/16_yellow")
    assert after[2] / after[0] == pytest.approx(yellow[2] / yellow[0], rel=0.25)
    assert before[2] / before[0] < 0.3 * after[2] / after[0]


# --- Focus ---


SUN_M, PAWN_M = 0.1393, 0.0701  # of the sun and the stem of the front pawn, along the camera's axis
LENS = {"focus_distance": 0.1, "aperture_radius": 0.000689285714}


def blur_px(path: Path, row: float, column: float, **parameters: str) -> float:
    """Radius of the disc of confusion at an upright edge, in pixels of a picture 512 pixels wide:
    fitted at 450 nm.
    """
    from scipy.optimize import curve_fit

    crop = round(column * 512) - 14, round(row * 512) - 4, 28, 8
    profile = radiance(path, spp=256, size=512, crop=crop, **parameters)[:, :, 0].mean(axis=0)

    def edge(x, left, step, slope, at, radius):
        """Return the part of a disc beyond a straight edge, mean over each pixel, on slightly
        uneven light.
        """
        t = np.clip((x[:, None] + np.linspace(-0.5, 0.5, 21) - at) / radius, -1, 1)
        share = 0.5 + (t * np.sqrt(1 - t**2) + np.arcsin(t)) / np.pi
        return left + slope * x + step * share.mean(axis=1)

    start = profile[0], profile[-1] - profile[0], 0.0, 13.5, 3.0
    return abs(float(curve_fit(edge, np.arange(28.0), profile, start)[0][-1]))


SUN_EDGE, PAWN_EDGE = (0.115, 0.303), (0.785, 0.218)
# 2000 samples a column: from 6 seeds the fit scatters by 2 to 3 %. The sun's rim bends by .15
# pixel, the pawn is round.
BLUR_GATE = 0.12


# step, edge, its distance and a tolerance in pixels: of the sun in focus the pixels are left, and
# its rim
BLURS = [
    ("", SUN_EDGE, SUN_M, 0.0),
    ("", PAWN_EDGE, PAWN_M, 0.0),
    ("another_focus", SUN_EDGE, SUN_M, 1.0),
    ("another_focus", PAWN_EDGE, PAWN_M, 0.0),
    ("wider_aperture", SUN_EDGE, SUN_M, 0.0),
]


@pytest.mark.parametrize(("name", "edge", "distance_m", "atol_px"), BLURS)
def test_blur_out_of_focus_is_that_of_the_lens(
    name: str, edge: tuple[float, float], distance_m: float, atol_px: float
) -> None:
    parameters = STEPS[name].parameters if name else {}
    lens = LENS | {key: float(value) for key, value in parameters.items()}
    miss = abs(distance_m - lens["focus_distance"]) / distance_m
    field = 2 * lens["focus_distance"] * np.tan(np.radians(37.34378) / 2)
    expected_px = lens["aperture_radius"] * miss / field * 512
    blur = blur_px(FOLDER / "still_life.xml", *edge, **parameters)
    assert blur == pytest.approx(expected_px, rel=BLUR_GATE, abs=atol_px)
