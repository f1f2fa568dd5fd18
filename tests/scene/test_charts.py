"""Charts and targets: the packaged ones against their definitions, a user's picture, the CSF chart in
colour, and the light of targets in closed form.
"""

import math
from collections.abc import Callable
from pathlib import Path

import colour
import numpy as np
import pytest
from helpers.edits import edited, load
from helpers.tiff import tiff
from PIL import Image

import pixsim
from pixsim.light.exr import read_channels, write_channels
from pixsim.light.spectral import colour_matching, photopic_efficiency
from pixsim.optics.camera_light import camera_factor
from pixsim.scene import charts
from pixsim.scene.colour_chart import (
    MEAN,
    PRIMARIES,
    PROJECTOR_M,
    modulation,
    primaries,
    primaries_xyz,
    slide,
    write_colour_chart,
)
from pixsim.scene.mitsuba import import_mitsuba
from pixsim.scene.own_chart import GREY, read_luminance, with_border
from pixsim.scene.plan import make_render_plan
from pixsim.scene.scene import Scene
from pixsim.scene.target import Target, disc_cover
from pixsim.scene.variants import variant
from pixsim.viewer.develop import xyz_weights
from pixsim.viewer.scielab import OPPONENT_FROM_XYZ, XYZ_FROM_OPPONENT

SHIPPED = Path(__file__).parents[2] / "scenes" / "charts"


# --- Packaged charts ---


def frequencies_lp_per_mm(x: np.ndarray, wave: np.ndarray, die_mm: float) -> tuple[np.ndarray, ...]:
    """Return half a cycle between neighbouring zeros as frequencies, and the places between."""
    before = np.flatnonzero(np.diff(np.sign(wave)))
    zeros = x[before] + np.diff(x)[before] * wave[before] / (wave[before] - wave[before + 1])
    return 0.5 / (np.diff(zeros) * die_mm), (zeros[1:] + zeros[:-1]) / 2


@pytest.mark.parametrize("die_mm", [2.7136, 5.0])
def test_csf_value_phase_derivative_is_frequency(die_mm):
    x = np.linspace(0, 1, 400_001)[1:]
    result, middle = frequencies_lp_per_mm(x, charts.csf_value(x, 1.0, die_mm) - 0.5125, die_mm)
    # f(middle) is the mean of an exponential but for (3.5 Δx)²/24, 1.2 % in the first half cycle,
    # 1e-5 in the last.
    bound = (np.log(1000 / 30) * 0.5 / (result * die_mm)) ** 2 / 24 + 1e-5
    assert result.size > 48 * die_mm / 2.7136
    assert np.all(np.abs(result / charts.csf_frequency_lp_per_mm(middle) - 1) < 1.1 * bound)


@pytest.mark.parametrize(("highest_lp_per_mm", "die_mm"), [(60.0, 5.0), (12.0, 36.0)])
def test_csf_file_begins_at_2_7_cycles_and_ends_at_its_frequency(
    highest_lp_per_mm, die_mm, tmp_path, monkeypatch
):
    monkeypatch.setenv("PIXSIM_CACHE_DIR", str(tmp_path))
    path = charts.csf_file(highest_lp_per_mm, die_mm)
    assert charts.csf_file(highest_lp_per_mm, die_mm) == path, "the same content has the same file"
    assert list(tmp_path.rglob("*.exr")) == [path]
    (texels,) = read_channels(path)[0].values()
    width = texels.shape[1]
    assert min(max(8192, 32 * highest_lp_per_mm * die_mm - 1), 32767) <= width <= 32768
    header = {"scene": "csf.xml", "parameters": {"max_lp_per_mm": repr(highest_lp_per_mm)}}
    expected = charts.csf_frequency_on_sensor(header, die_mm)
    assert expected([0.0, 1.0]) == pytest.approx([2.7136 / die_mm, highest_lp_per_mm], rel=1e-12)
    places = (np.arange(width) + 0.5) / width
    wave = texels[-1].astype(float) - 0.5125
    frequency, x = frequencies_lp_per_mm(places, wave, die_mm)
    # Half cycles from linear zeros of texels: 1 % where a cycle has 26 of them, and of curvature in
    # the long first ones.
    assert np.abs(frequency[3:] / expected(x[3:]) - 1).max() < 0.01


def test_slanted_edge_is_5_degrees():
    texels = charts.slanted_edge(400, 400).astype(float)
    # Where the edge crosses each row, from the row's dark area; coverage is counted in 8 × 8
    # points: 1/16 texel.
    crossing = 400 * (1 - (texels - 0.1).mean(axis=1) / 0.9)
    slope, _ = np.polyfit(np.arange(400), crossing, 1)
    assert np.degrees(np.arctan(-slope)) == pytest.approx(5.0, abs=0.01)
    assert crossing.mean() == pytest.approx(200, abs=0.1)
    # One edge only, from dark to bright: every row rises all the way.
    assert (texels[200, 0], texels[200, -1]) == pytest.approx((0.1, 1.0))
    assert np.diff(texels, axis=1).min() >= 0


def test_siemens_star_has_72_cycles():
    texels = read_channels(SHIPPED / "siemens_star.exr")[0]["Y"]
    angle = np.radians(np.arange(0, 360, 0.05) + 0.02)
    place = np.floor([512 - 400 * np.sin(angle), 512 + 400 * np.cos(angle)]).astype(int)
    bright = texels[tuple(place)] > 0.5125
    assert np.count_nonzero(bright != np.roll(bright, 1)) == 2 * 72
    # The first sector above the positive x axis is bright.
    assert (texels[502, 912], texels[522, 912]) == pytest.approx((1.0, 0.025))


@pytest.mark.parametrize(
    "kind",
    [
        # 64 points for each of a million texels
        pytest.param(kind, marks=[pytest.mark.slow] if kind == "siemens_star" else [])
        for kind in charts.CHARTS
    ],
)
def test_packaged_textures_equal_make_chart(kind):
    channels, _ = read_channels(SHIPPED / f"{kind}.exr")
    assert list(channels) == ["Y"]
    np.testing.assert_array_equal(channels["Y"], charts.make_chart(kind))


# --- A picture of the user ---


RGB = np.random.default_rng(1).integers(0, 65536, (20, 30, 3)).astype(np.uint16)
EIGHT = (RGB >> 8).astype(np.uint8)
LIGHT = (RGB / 6e4).astype(np.float32)
PALETTE = np.array([[[0, 0, 0], [200, 30, 10]], [[255, 255, 255], [10, 200, 90]]], np.uint8)


WEIGHTS = np.array([0.2126, 0.7152, 0.0722])  # Rec. ITU-R BT.709-6


def decoded(values: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1, written out."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def write_exr_channels(path: Path, values: np.ndarray) -> None:
    """A grey picture has a channel of depth, too."""
    planes = [values, values] if values.ndim == 2 else np.moveaxis(values, 2, 0)
    names = ("Y", "depth") if values.ndim == 2 else "RGB"
    write_channels(path, dict(zip(names, planes, strict=True)), {})


WRITERS: dict[str, Callable[[Path, np.ndarray], None]] = {
    "Pillow": lambda path, values: Image.fromarray(values).save(path),
    "palette": lambda path, values: (
        Image.fromarray(values).convert("P", palette=Image.Palette.ADAPTIVE).save(path)
    ),
    "Mitsuba": lambda path, values: (
        import_mitsuba(variant.choose().variant)
        .Bitmap(np.ascontiguousarray(values))
        .write(str(path))
    ),
    "pixsim": write_exr_channels,
}


# suffix, program that writes it, what it writes, and the error of the format: RGBE has 8 bits of
# the largest
FORMATS = [
    ("png", "Pillow", EIGHT[:, :, 0], 0.0),
    ("png", "Pillow", RGB[:, :, 0], 0.0),
    ("png", "Pillow", EIGHT, 0.0),
    ("png", "Mitsuba", RGB, 0.0),
    ("png", "Pillow", np.dstack([EIGHT, np.full((20, 30), 255, np.uint8)]), 0.0),
    ("png", "palette", PALETTE, 0.0),
    ("tiff", "Pillow", EIGHT, 0.0),
    ("tif", "Pillow", RGB[:, :, 0], 0.0),
    ("exr", "pixsim", LIGHT, 0.0),
    ("exr", "pixsim", LIGHT[:, :, 0], 0.0),
    ("hdr", "Mitsuba", LIGHT, float(LIGHT.max()) / 128),
]


@pytest.mark.parametrize(("suffix", "program", "values", "error"), FORMATS)
def test_luminance_of_every_format(
    suffix: str, program: str, values: np.ndarray, error: float, tmp_path: Path
) -> None:
    path = tmp_path / f"a.{suffix}"
    WRITERS[program](path, values)
    has_codes = values.dtype.kind == "u"
    linear = values / np.iinfo(values.dtype).max if has_codes else values
    for is_linear, light in ((True, linear), (False, decoded(linear) if has_codes else linear)):
        expected = light if light.ndim == 2 else light[:, :, :3] @ WEIGHTS
        luminance = read_luminance(path, linear=is_linear)
        np.testing.assert_allclose(luminance, expected, rtol=1e-6, atol=error + 1e-9)


def test_what_is_lost_of_a_picture_is_said(tmp_path: Path) -> None:
    tiff(tmp_path / "deep.tif", RGB.astype("<u2"), 2)
    with pytest.warns(UserWarning, match="is read with 8 of its 16 bits"):
        read_luminance(tmp_path / "deep.tif")


def test_a_turned_jpeg_is_upright(tmp_path: Path) -> None:
    # JPEG keeps uniform areas to a code, 2 %; a camera held upright writes the turn into its
    # metadata (EXIF 6: turn right).
    codes = np.repeat(np.array([[40, 200]], np.uint8), 16, axis=1).repeat(16, axis=0)
    metadata = Image.Exif()
    metadata[0x0112] = 6
    Image.fromarray(codes).save(tmp_path / "a.jpg", quality=100, exif=metadata)
    luminance = read_luminance(tmp_path / "a.jpg")
    assert luminance.shape == (32, 16)
    np.testing.assert_allclose(luminance[[4, 28], 4], decoded(np.array([40, 200]) / 255), rtol=0.02)


@pytest.mark.parametrize(
    ("aspect", "shape"), [(1.0, (30, 30)), (1.5, (20, 30)), (3.0, (20, 60)), (0.5, (60, 30))]
)
def test_border_keeps_the_aspect_and_states_its_share(
    aspect: float, shape: tuple[int, int]
) -> None:
    texels, share = with_border(np.ones((20, 30), np.float32), aspect)
    assert (texels.shape, share) == (shape, pytest.approx(1 - 600 / texels.size))
    assert ((texels == 1).sum(), (texels == np.float32(GREY)).sum()) == (600, texels.size - 600)
    np.testing.assert_array_equal(texels, texels[::-1, ::-1])  # centred


def write_picture(path: Path) -> Path:
    """A picture of 20 × 40: the left half is white, the right one dark."""
    codes = np.repeat(np.array([[255, 60]], np.uint8), 20, axis=1).repeat(20, axis=0)
    path.parent.mkdir(exist_ok=True)
    Image.fromarray(codes).save(path)
    return path


def test_picture_is_seen_with_its_border(tmp_path: Path) -> None:
    # White, dark and the grey border in proportion; the picture stands upright in the middle of the
    # die. Multijitter at 4 samples: 0.3 %.
    scene = load("csf", chart=write_picture(tmp_path / "mine.png"), resolution=32, spp=4)
    with pytest.warns(UserWarning, match=r"'mine\.png' keeps its aspect: 50 % of the chart"):
        light = pixsim.render(scene)
    assert light.header["parameters"]["chart"] == "mine.png"
    camera = scene.camera()
    lens = (camera.image_distance_mm, camera.f_number, camera.magnification)
    lx = light.illuminance_lx() / pixsim.optics.field_factor(light.shape, light.pitch_um, *lens)
    white = lx[10:22, 4:12].mean()
    parts = [lx[10:22, 20:28].mean(), lx[:6].mean(), lx[26:].mean()]
    dark = float(decoded(np.array(60 / 255)))
    np.testing.assert_allclose(parts / white, [dark, GREY, GREY], rtol=5e-3)


def test_scene_hash_of_a_picture_depends_on_its_content_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not on its folder, nor on that of the cache."""
    hashes = []
    for folder in ("a", "b", "c"):
        path = write_picture(tmp_path / folder / "mine.png")
        monkeypatch.setenv("PIXSIM_CACHE_DIR", str(tmp_path / folder / "cache"))
        hashes.append(load("csf", chart=path, chart_linear=folder == "c").content_hash)
    assert hashes[0] == hashes[1] != hashes[2]


# --- The CSF chart in colour ---


RED_GREEN, BLUE_YELLOW = modulation(-XYZ_FROM_OPPONENT[:, 1]), modulation(XYZ_FROM_OPPONENT[:, 2])


def test_primaries_are_a_display_whose_white_is_d65() -> None:
    """1000 cd/m² of D65 within the 5 nm table, and chromaticities by colour-science."""
    nm, radiance = primaries()
    assert 683.002 * 5 * (photopic_efficiency(nm) @ radiance).sum() == pytest.approx(1000, rel=2e-3)
    xyz = primaries_xyz()
    white = xyz.sum(axis=1)
    assert white[:2] / white.sum() == pytest.approx([0.3127, 0.3290], abs=1e-4)
    expected = colour.MSDS_DISPLAY_PRIMARIES["Apple Studio Display"]
    expected_xyz = colour_matching(expected.wavelengths).T @ expected.values
    chromaticities = [values[:2] / values.sum(axis=0) for values in (xyz, expected_xyz)]
    np.testing.assert_allclose(*chromaticities, atol=2e-3)


@pytest.mark.parametrize(("change", "channel", "first"), [(RED_GREEN, 1, 0), (BLUE_YELLOW, 2, 2)])
def test_slides_change_one_opponent_channel_within_the_gamut(
    change: np.ndarray, channel: int, first: int
) -> None:
    # The two others are constant to the float32 of the slides, and one slide has the contrast of
    # the grey chart.
    grey = charts.csf(256, 32)
    slides = np.stack([slide(share, grey) for share in change.tolist()])
    assert 0 <= slides.min() < slides.max() <= 1
    np.testing.assert_allclose(slides[first], grey, atol=1e-7)
    opponent = np.einsum("ij,jyx->iyx", OPPONENT_FROM_XYZ @ primaries_xyz(), slides.astype(float))
    others = np.delete(opponent, channel, axis=0)
    np.testing.assert_allclose(others - others[:, :1, :1], 0, atol=1e-6)
    correlation = np.corrcoef(opponent[channel].ravel(), grey.ravel())[0, 1]
    assert abs(correlation) == pytest.approx(1, abs=1e-6)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A red-green chart of few cycles, which 64 samples resolve; its name would be markup."""
    path = tmp_path_factory.mktemp("charts") / "a & 'b'.xml"
    slides = write_colour_chart(path, RED_GREEN, "red-green", width=256, height=64, die_mm=0.2)
    assert [file.name for file in slides] == [f"a & 'b'_{name}.exr" for name in PRIMARIES]
    return path


@pytest.mark.parametrize("die_height_mm", [None, 1.3568])
def test_scene_gives_three_spectra_times_three_slides(
    written: Path, die_height_mm: float | None
) -> None:
    # Upright, on dies of two shapes, to 1 % of the mean: the texture between its texels, and the
    # noise of 16 samples. A picture that is mirrored or upside down errs by half.
    camera = pixsim.Camera(die_height_mm=die_height_mm)
    image = pixsim.render(load(written, resolution=64), camera)
    rows = 64 if die_height_mm is None else 32
    spectra, pictures = image.factors
    lens = camera_factor(camera, image.shape, image.pitch_um) * camera.transmittance
    nm, radiance = primaries()
    full = 683.002 * 5 * photopic_efficiency(nm) @ radiance
    lights = pictures * (spectra @ image.luminous_weight() / full)[:, None, None] / lens
    for light, name in zip(lights, PRIMARIES, strict=True):
        texels = read_channels(written.with_name(f"{written.stem}_{name}.exr"))[0]["Y"]
        expected = texels.reshape(rows, -1, 64, 4).mean(axis=(1, 3))
        np.testing.assert_allclose(light, expected, atol=0.01 * MEAN)


def test_white_of_the_chart_is_that_of_its_lamps(written: Path) -> None:
    # 1000 cd/m² with the chromaticity of D65, to the 6 digits of the scene and CIE's steps of 5 nm.
    image = pixsim.render(load(written, resolution=16), pixsim.Camera(die_mm=0.2))
    assert image.header["white_lamps"] == list(PRIMARIES)
    # Of a screen, by a lamp of intensity 1 through a slide of 1
    xyz = 683.002 * xyz_weights(image) @ image.white_spectrum / (math.pi * PROJECTOR_M**2)
    np.testing.assert_allclose(xyz, 1000 / 0.3290 * np.array([0.3127, 0.3290, 0.3583]), rtol=1e-3)


FILM = 128
# A narrow field, so that the fall-off is 1e-4 at the ends of the longest bar.
CAMERA = pixsim.Camera(focal_length_mm=100, die_mm=2.56, object_distance_m=1.0)
SAMPLE_UM = 20.0  # 2.56 mm / 128


def light(scene: Scene, camera: pixsim.Camera = CAMERA) -> np.ndarray:
    """Illuminance of the film's cells, (H, W) lx."""
    plan = make_render_plan(scene, camera, exact=True)
    assert plan.samples.exact
    return pixsim.render(scene, camera, plan=plan).illuminance_lx().astype(float)


def target(film: int = FILM, **parameters: object) -> Scene:
    return load("target", **parameters).with_resolution(film)


def difference(film: int = FILM, **parameters: object) -> np.ndarray:
    """What the target adds to the light, (H, W) lx."""
    scene = target(film, **parameters)
    return light(scene) - light(scene.with_parameters(contrast=0))


@pytest.mark.parametrize("contrast", [-1, -0.1, 0.01, 3.0])
def test_target_light_is_linear_in_contrast(contrast):
    light_lx = difference(size_um=3.3 * SAMPLE_UM, contrast=contrast)
    # Two float32 of an illuminance, each rounded to 6e-8.
    np.testing.assert_allclose(
        light_lx,
        contrast * difference(size_um=3.3 * SAMPLE_UM, contrast=1),
        atol=2.5e-7 * light(target(contrast=0)).max() * max(1, abs(contrast)),
    )


@pytest.mark.parametrize("parameters", [{}, {"shape": "bar", "size_um": 3}, {"shape": "edge"}])
def test_target_without_contrast_is_even_field(parameters: dict) -> None:
    """Bit for bit the light of the scene flat, which has no target, whatever the target would
    be.
    """
    flat = light(load("flat").with_resolution(FILM))
    np.testing.assert_array_equal(light(target(contrast=0, **parameters)), flat)


def test_disc_cover_of_each_cell():
    """Against chords: ∫ of the disc's height within a cell, by the midpoint rule; cells of other
    sides, beside the middle.
    """
    rows, columns, radius = np.linspace(-3.1, 4.0, 8), np.linspace(-4.0, 3.3, 12), 2.6
    middle = -4.0 + 7.3 / 220_000 * (np.arange(220_000) + 0.5)
    height = np.sqrt(np.maximum(radius**2 - middle**2, 0.0))
    inside = np.diff(np.clip(rows[:, None], -height, height), axis=0) / np.diff(rows)[:, None]
    expected = inside.reshape(7, 11, 20_000).mean(axis=2)
    # The midpoint rule errs by (step)^1.5 where the circle's height begins.
    np.testing.assert_allclose(disc_cover(rows, columns, radius), expected, atol=1e-6)


@pytest.mark.parametrize("film", [FILM, FILM - 1])
def test_target_is_centred_and_signed(film: int) -> None:
    light_lx = difference(film, size_um=7.3 * SAMPLE_UM, contrast=0.5)
    assert light_lx.min() >= 0
    # Turned by half a turn and by a quarter, mirrored
    np.testing.assert_allclose(
        [light_lx[::-1, ::-1], light_lx.T], [light_lx] * 2, atol=1e-6 * light_lx.max()
    )


@pytest.mark.parametrize("distance_m", [1.0, 2.0])
def test_sizes_in_scene_angle_and_sensor_agree(distance_m: float) -> None:
    """20 mm at 1 m are 20 mrad from the lens, and on the sensor the magnification times as much."""
    camera = CAMERA.model_copy(update={"object_distance_m": distance_m})
    expected = light(target(size_mm=20.0 * distance_m, contrast=0.3), camera)
    for size in ({"size_mrad": 20.0}, {"size_um": 20e3 * distance_m * camera.magnification}):
        np.testing.assert_allclose(light(target(**size, contrast=0.3), camera), expected, rtol=2e-7)


@pytest.mark.parametrize(("film", "samples"), [(FILM, 0.2), (FILM - 1, 3.7), (FILM, 25.0)])
@pytest.mark.parametrize(
    ("shape", "area", "widths"),
    [("disc", math.pi / 4, None), ("bar", 5.0, None), ("bar", 2.0, 2.0), ("lines", 1.0, None)],
)
def test_light_of_a_target_is_its_area_times_the_irradiance(
    shape: str, area: float, widths: float | None, samples: float, film: int
) -> None:
    # Its flux, π L sin²α times its area on the sensor, for targets from a fifth of a film sample
    # on, on or between samples. The fall-off takes 1e-4 of the longest bar; float32 holds 6e-8 of
    # the background, 2e-6 of the smallest disc.
    size_um = samples * SAMPLE_UM
    fields: dict = {"shape": shape, "size_um": size_um}
    if widths is not None:
        fields["length_um"] = widths * size_um
    if shape == "lines":  # which are as bright as the field, so that their gap is a bar
        fields["line_contrast"] = 0
    light_lx = difference(film, contrast=-1, luminance_cd_per_m2=1000, **fields)
    cone = 1 + 4 * CAMERA.f_number**2 * (1 + CAMERA.magnification) ** 2
    cells = area * (size_um / (CAMERA.die_um[1] / film)) ** 2
    assert light_lx.sum() == pytest.approx(-math.pi * 1000 / cone * cells, rel=1.5e-4)


@pytest.mark.parametrize(
    ("parameters", "lit"),
    [
        ({"shape": "bar", "size_um": 4 * SAMPLE_UM}, np.s_[54:74, 62:66]),
        ({"shape": "edge"}, np.s_[:, FILM // 2 :]),
        (
            {"shape": "lines", "size_um": 4 * SAMPLE_UM, "length_um": 6 * SAMPLE_UM},
            np.s_[61:67, 62:66],
        ),
    ],
)
def test_bars_and_edges_have_a_direction(parameters: dict, lit: tuple[slice, slice]) -> None:
    """A vertical bar is 5 times as tall as wide; the target of an edge is right, or below."""
    upright, lying = (
        difference(contrast=1, direction=direction, **parameters)
        for direction in ("vertical", "horizontal")
    )
    expected = np.zeros((FILM, FILM), bool)
    expected[lit] = True
    np.testing.assert_array_equal(upright > 0, expected)
    np.testing.assert_allclose(lying, upright.T, rtol=1e-6)


@pytest.mark.parametrize("width_mm", [2.0, 1.3])
def test_lines_are_half_of_a_part_and_their_gap_is_as_bright_as_the_part(width_mm: float) -> None:
    """In cells of 1 mm, of a field of 13 or 20 periods."""
    drawn = Target(shape="lines", size_mm=width_mm, line_contrast=3.0, reflectance=0.2)
    field = drawn.texels((16, 52), (16.0, 52.0), width_mm, 4.0)
    assert field[0].mean() == pytest.approx(0.2 * (1 + 3 / 2), rel=1e-6)
    assert field[0, 25:27] == pytest.approx(0.2 * (1 + 3 * min(width_mm / 2, 1)), rel=1e-6)
    np.testing.assert_allclose(field[6:10, 25:27], 0.2, rtol=1e-6)


def test_target_of_an_edited_xml_is_drawn(tmp_path: Path) -> None:
    """A given size takes the place of the file's."""
    contrast = ('"contrast" value="-0.1"', '"contrast" value="0.4"')
    size = ('name="size_mm" value="20"', 'name="size_um" value="60"')
    scene = load(edited(tmp_path, "target", contrast, size)).with_resolution(FILM)
    stated = target(contrast=0.4, size_um=60)
    np.testing.assert_array_equal(light(scene), light(stated))
    assert scene.target == stated.target == Target(contrast=0.4, size_um=60)
    assert scene.content_hash != target().content_hash
    assert load(scene.path, size_mm=3).target == Target(contrast=0.4, size_mm=3)
