"""The display from electrons to shown luminance: scale, rasters, averaging, codes; and limits of
the whole score.
"""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
from helpers.chains import imaging, imaging_chain

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.light.spectral import SpectralImage, d65
from pixsim.optics.camera import Camera
from pixsim.optics.diffraction import square_aperture_mtf
from pixsim.scene.plan import make_render_plan
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.integration import mean_signal_rate
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.readout import Frame
from pixsim.viewer import display as displays
from pixsim.viewer.display_options import Display
from pixsim.viewer.evaluate import evaluate

NM = np.arange(400.0, 721.0, 10)
DIE_MM = 0.6784  # a quarter of the usual die: 128 dots of 5.3 µm
SMALL = Display(dots=128)
CAMERA = Camera(die_mm=DIE_MM)


def irradiance_of(
    picture: np.ndarray, camera: Camera = CAMERA, general: bool = False, known: bool = True
) -> SpectralImage:
    """A D65-lit chart of 1000 cd/m² at value 1, seen through the camera without fall-off: E = L τ
    π/(1 + 4N²(1+m)²).
    """
    image = SpectralImage(NM, 10.0, 1.0, factors=(d65(NM), np.ones((1, 1, 1))))
    n_w = camera.f_number * (1 + camera.magnification)
    white_lx = 1000.0 * camera.transmittance * np.pi / (1 + 4 * n_w**2)
    spectrum = d65(NM) * white_lx / image.illuminance_lx()[0, 0]
    light = (
        {"data": picture[:, :, None] * spectrum}
        if general
        else {"factors": (spectrum, picture[None])}
    )
    header = {"luminance_cd_per_m2": 1000.0} if known else {}
    return SpectralImage(NM, 10.0, 1e3 * camera.die_mm / picture.shape[1], header=header, **light)


def noise_free(
    electrons: np.ndarray, pitch_um: float, mean_dark_e: float = 0.0, black_level_dn: float = 0.0
) -> Frame:
    """A frame that the ADC has only rounded, to 1e-3 e-."""
    dn = np.rint((electrons + mean_dark_e) * 1e3 + black_level_dn).astype(np.int32)
    return Frame(dn, electrons, 1.0, 1e3, black_level_dn, mean_dark_e, pitch_um, 31, 0.0)


def on_dots(
    frame: Frame,
    size_um: tuple[float, float],
    white_e: float,
    display: Display,
    border_um: float = 0.0,
) -> np.ndarray:
    """`frame_luminance` on all dots, or without a border."""
    edges_um = displays.dot_edges_um(size_um, frame.pitch_um, display, border_um)
    return displays.frame_luminance(frame, size_um, white_e, display, edges_um)


def ideal_on_dots(
    irradiance: SpectralImage,
    display: Display,
    camera: Camera = CAMERA,
    pitch_um: float = 6.5,
    border_um: float = 0.0,
) -> np.ndarray:
    """`ideal_luminance` on all dots, or without a border."""
    edges_um = displays.dot_edges_um(
        displays.picture_size_um(irradiance), pitch_um, display, border_um
    )
    return displays.ideal_luminance(
        imaging(camera, Pixel(pitch_um=pitch_um), display=display), irradiance, edges_um
    )


# --- Scale ---


@pytest.mark.parametrize("general", [False, True], ids=["factors", "data"])
@pytest.mark.parametrize(("f_number", "transmittance"), [(4.0, 1.0), (1.4, 0.8)])
def test_frame_luminance_of_white_is_one(general, f_number, transmittance):
    camera = Camera(
        die_mm=DIE_MM, f_number=f_number, transmittance=transmittance, object_distance_m=0.1
    )
    physics = derive(Pixel(pitch_um=10.6))
    irradiance = irradiance_of(np.ones((64, 64)), camera, general)
    electrons = mean_signal_rate(irradiance, camera, physics) * 0.01
    white_e = (
        displays.white_rate(imaging(camera, physics.pixel, display=SMALL), irradiance)
        * 0.01
        * physics.photodiode_area_um2
    )
    frame = noise_free(electrons, 10.6, mean_dark_e=12.3, black_level_dn=64)
    shown = on_dots(frame, displays.picture_size_um(irradiance), white_e, SMALL)
    # Rounding of the ADC: 0.0005 e- of more than 1000; float32 in the irradiance: 1e-7.
    assert white_e > 1000
    np.testing.assert_allclose(shown, 1.0, rtol=2e-6)
    np.testing.assert_allclose(ideal_on_dots(irradiance, SMALL, camera, 10.6), 1.0, rtol=1e-6)


def test_ideal_luminance_display_white_takes_precedence():
    shown = ideal_on_dots(irradiance_of(np.ones((64, 64))), Display(dots=128, white_cd_per_m2=500))
    np.testing.assert_allclose(shown, 2.0, rtol=1e-6)


def test_white_cd_per_m2_unknown_raises():
    with pytest.raises(
        PixsimError, match=r"white_cd_per_m2: got no value.*Display\(white_cd_per_m2="
    ):
        displays.white_cd_per_m2(irradiance_of(np.ones((4, 4)), known=False), Display())


def test_to_xyz_grey_has_d65_white():
    np.testing.assert_allclose(
        displays.to_xyz(np.array([[0.5]])), [[[47.5235, 50.0, 54.4415]]], rtol=1e-12
    )


# --- Rasters ---


@pytest.mark.parametrize(
    ("pitch_um", "shape"), [(5.3, (64, 128)), (6.5, (52, 104)), (1.7, (199, 399))]
)
def test_frame_luminance_shape_by_raster(pitch_um, shape):
    picture = np.random.default_rng(1).uniform(100, 1000, shape)
    size_um = (339.2, 678.4)
    for raster, expected in (("fixed_size", (64, 128)), ("one_to_one", shape)):
        display = Display(dots=128, raster=raster)
        assert on_dots(noise_free(picture, pitch_um), size_um, 1000.0, display).shape == expected
        ideal = ideal_on_dots(irradiance_of(np.ones((32, 64))), display)
        assert ideal.shape == ((64, 128) if raster == "fixed_size" else (52, 104))


# Lines between pixel centres are blurred by their mean over a dot, also where pixels and dots
# coincide.
@pytest.mark.parametrize(
    ("raster", "interpolation"),
    [
        ("fixed_size", "nearest"),
        ("one_to_one", "nearest"),
        ("one_to_one", "linear"),
        ("one_to_one", "cubic"),
    ],
)
def test_frame_luminance_pixel_of_dot_size_is_unchanged(raster, interpolation):
    picture = np.random.default_rng(2).uniform(100, 1000, (64, 128))
    display = Display(dots=128, raster=raster, interpolation=interpolation)
    shown = on_dots(noise_free(picture, 5.3), (339.2, 678.4), 1000.0, display)
    # The frame holds 0.001 e-, half of it rounding, of 1000.
    np.testing.assert_allclose(shown, picture / 1000, atol=1e-6)


@pytest.mark.parametrize("interpolation", ["nearest", "linear"])
def test_frame_luminance_noise_is_continuous_in_pitch(interpolation):
    # The mean over a dot of lines between pixels weighs 1, 6, 1 eighths an axis where they coincide
    # (a spread of 0.59) and about 0.50 averaged over all phases; pixels as they are 1 and 2/3, and
    # a reading at the dots' centres 1 and 2/3 as well.
    noise = 1000 + 50 * np.random.default_rng(8).standard_normal((128, 128))
    display = SMALL.model_copy(update={"interpolation": interpolation})

    def spread(pitch_um: float) -> float:
        n = int(678.4 / pitch_um * (1 + 1e-9))
        return float(
            on_dots(noise_free(noise[:n, :n], pitch_um), (678.4, 678.4), 1000.0, display)[
                8:-8, 8:-8
            ].std()
        )

    if interpolation == "linear":
        assert spread(5.3053) == pytest.approx(spread(5.3), rel=0.2)
    else:
        assert spread(5.3053) < 0.75 * spread(5.3)  # why lines are the default


@pytest.mark.parametrize("pixels", [129, 200, 256, 1000])
def test_frame_luminance_conserves_mean(pixels):
    picture = np.random.default_rng(3).uniform(100, 1000, (pixels // 2, pixels))
    pitch_um = 678.4 / pixels
    size_um = (pitch_um * (pixels // 2), 678.4)
    shown = on_dots(noise_free(picture, pitch_um), size_um, 1000.0, SMALL)
    assert shown.shape[1] == 128
    assert shown.mean() == pytest.approx(picture.mean() / 1000, abs=1e-6)
    if pixels == 256:
        shown = on_dots(
            noise_free(picture, pitch_um),
            size_um,
            1000.0,
            SMALL.model_copy(update={"interpolation": "nearest"}),
        )
        blocks = picture[: 2 * (pixels // 4)].reshape(64, 2, 128, 2).mean(axis=(1, 3))
        np.testing.assert_allclose(shown, blocks / 1000, atol=1e-6)


@pytest.mark.parametrize(
    ("interpolation", "weight"), [("nearest", 0.5), ("linear", 2 * (7**2 + 1) / 16**2)]
)
def test_frame_luminance_noise_falls_with_pixels_per_dot(interpolation, weight):
    # Four equal pixels a dot halve the noise; the dot's mean of lines between pixels weighs 1, 7,
    # 7, 1 sixteenths an axis. 16 384 dots (neighbours share little): 5σ is 2.8 % (6e-7 false
    # alarms).
    display = SMALL.model_copy(update={"interpolation": interpolation})
    picture = 1000 + 50 * np.random.default_rng(4).standard_normal((256, 256))
    shown = on_dots(noise_free(picture, 2.65), (678.4, 678.4), 1000.0, display)
    assert shown.std() == pytest.approx(0.05 * weight, rel=5 / np.sqrt(2 * 16384))


@pytest.mark.parametrize("pitch_um", [1.7, 3.3, 6.5, 9.7, 15.0])
def test_frame_luminance_maps_by_position(pitch_um):
    # A linear picture survives averaging and linear interpolation; the array is centred and leaves
    # a border uncovered.
    n = int(678.4 / pitch_um)
    x_um = 339.2 + (np.arange(n) - (n - 1) / 2) * pitch_um
    picture = np.tile(500 + x_um, (n, 1))
    shown = on_dots(noise_free(picture, pitch_um), (678.4, 678.4), 1000.0, SMALL)
    dots_um = (np.arange(128) + 0.5) * 5.3
    inside = slice(4, -4)  # up to one pixel and a half at the border is held constant
    tolerance = (
        1e-6 if pitch_um > 5.3 else pitch_um / 4000
    )  # pixels cut by a dot's border count as constant
    np.testing.assert_allclose(shown[64, inside], (500 + dots_um[inside]) / 1000, atol=tolerance)
    assert shown[64].mean() == pytest.approx((500 + 339.2) / 1000, abs=1e-6)  # centred


# --- What the display blurs ---


def shown_contrast(frequency_cy_per_mm: float, pitch_um: float, display: Display) -> float:
    """Return the amplitude of a grating on the dots over its amplitude on the pixels.

    A mean over eight phases of the grating, so that images of the spectrum that fall close by on
    the dots' raster cancel.
    """
    die_um, mean, amplitude = 2713.6, 1000.0, 500.0
    pixels = int(die_um / pitch_um * (1 + 1e-9))
    x_um = (np.arange(pixels) - (pixels - 1) / 2) * pitch_um
    dots_um = ((np.arange(display.dots) + 0.5) / display.dots - 0.5) * die_um
    window = (
        np.sin(np.pi * (np.arange(display.dots) + 0.5) / display.dots) ** 4
    )  # keeps the borders and the mean out
    actual = []
    for phase in np.arange(8) * np.pi / 4:
        grating = mean + amplitude * np.cos(2e-3 * np.pi * frequency_cy_per_mm * x_um + phase)
        frame = noise_free(np.tile(grating, (8, 1)), pitch_um)
        shown = on_dots(frame, (8 * pitch_um, die_um), mean, display)[0]
        wave = np.exp(-1j * (2e-3 * np.pi * frequency_cy_per_mm * dots_um + phase))
        actual.append((window * (shown - 1) * wave).sum() / window.sum() * 2 * mean / amplitude)
    return float(np.abs(np.mean(actual)))


@pytest.mark.parametrize("interpolation", ["nearest", "linear", "cubic", "quintic"])
@pytest.mark.parametrize("pitch_um", [3.3, 6.5, 9.7, 15.0])
@pytest.mark.parametrize("of_nyquist", [0.2, 0.5, 0.8])
def test_interpolation_mtf_matches_shown_grating(interpolation, pitch_um, of_nyquist):
    frequency = of_nyquist * 1e3 / (2 * pitch_um)
    display = Display(dots=512).model_copy(update={"interpolation": interpolation})
    dot_um = 2713.6 / 512
    expected = displays.interpolation_mtf(frequency, pitch_um, interpolation) * square_aperture_mtf(
        frequency, dot_um
    )
    # Images at a multiple of 1/pitch plus the frequency keep the phase: on the dots they leave up
    # to 2e-4.
    assert shown_contrast(frequency, pitch_um, display) == pytest.approx(float(expected), abs=5e-4)


def test_interpolation_mtf_limits():
    frequency = np.linspace(0, 1e3 / 6.5, 200)
    curves = [
        displays.interpolation_mtf(frequency, 6.5, item) for item in ("linear", "cubic", "quintic")
    ]
    for mtf in curves:
        assert mtf[[0, -1]] == pytest.approx(
            [1, 0], abs=1e-12
        )  # a grating of one cycle a pixel is a flat field on the pixels
        assert (np.diff(mtf) < 1e-12).all()
    below = frequency < 1e3 / 13
    assert (np.diff(curves, axis=0)[:, below] >= -1e-12).all(), (
        "a higher degree is nearer to the ideal low-pass"
    )
    with pytest.raises(
        PixsimError, match="interpolation: got 'sinc'; allowed: nearest, linear, cubic"
    ):
        displays.interpolation_mtf(10.0, 6.5, "sinc")


@pytest.mark.parametrize("samples", [256, 200])
def test_ideal_luminance_is_mean_over_dot(samples):
    def running(x_um: np.ndarray) -> np.ndarray:
        return 300 * x_um - 2000 * np.cos(x_um / 20)

    means = np.diff(running(edges := np.linspace(0, 678.4, samples + 1))) / np.diff(edges)
    ideal = ideal_on_dots(irradiance_of(np.tile(means, (samples, 1)) / 500), SMALL)
    dots = np.linspace(0, 678.4, 129)
    exact = np.diff(running(dots)) / np.diff(dots) / 500
    # Dots of two samples: sums of them, float32. Of 1.56 samples: the quintic spline's error.
    np.testing.assert_allclose(
        ideal, np.tile(exact, (128, 1)), atol=1e-7 if samples == 256 else 1e-5
    )


def test_ideal_luminance_conserves_light_at_edge():
    """Where dots cut the samples at an edge, one dot takes the step; the sum stays, and nothing is
    below zero.
    """
    line = np.where(np.arange(200) < 77, 1e-4, 1.0)
    ideal = ideal_on_dots(irradiance_of(np.tile(line, (200, 1))), SMALL)
    assert ideal.mean() == pytest.approx(line.mean(), rel=1e-6)
    assert ideal.min() > 0
    edge = int(77 / 200 * 128)
    np.testing.assert_allclose(ideal[:, : edge - 2], 1e-4, rtol=0.01)
    np.testing.assert_allclose(ideal[:, edge + 3 :], 1.0, rtol=0.01)


# --- The frame that is scored ---


@pytest.mark.parametrize(
    ("border_um", "cut"),
    [(0.0, 0), (1e-6, 1), (5.2999, 1), (5.3, 1), (5.3 * (1 + 1e-12), 1), (5.31, 2), (15.0, 3)],
)
def test_dot_edges_um_fixed_size_omits_border(border_um, cut):
    rows, columns = displays.dot_edges_um((339.2, 678.4), 6.5, SMALL, border_um)
    np.testing.assert_allclose(rows, 5.3 * np.arange(cut, 65 - cut), atol=1e-9)
    np.testing.assert_allclose(columns, 5.3 * np.arange(cut, 129 - cut), atol=1e-9)


def test_dot_edges_um_one_to_one_has_no_border():
    rows, columns = displays.dot_edges_um((339.2, 678.4), 6.5, Display(raster="one_to_one"), 15.0)
    assert (rows.size, columns.size) == (53, 105)
    assert columns[0] == pytest.approx((678.4 - 104 * 6.5) / 2)


def test_dot_edges_um_border_too_wide_raises():
    with pytest.raises(
        PixsimError,
        match=r"pixel\.pitch_um: got pixels whose border of 400 µm.* allowed: a .* below 333\.9 µm",
    ):
        displays.dot_edges_um((678.4, 678.4), 400.0, SMALL, 400.0)


def test_evaluate_scores_only_inside_border():
    """The scored dots are dots of the whole raster, and light outside them does not change the
    score.
    """
    irradiance = irradiance_of(grating())
    whole = ideal_on_dots(irradiance, SMALL)
    np.testing.assert_allclose(
        ideal_on_dots(irradiance, SMALL, border_um=22.5), whole[5:-5, 5:-5], rtol=1e-12
    )
    score = evaluate(irradiance, CAMERA, Pixel(pitch_um=15.0), display=SMALL)
    assert score.delta_e.shape == score.ideal.shape == score.image.shape == (118, 118)
    assert score.border_um == pytest.approx((26.5, 26.5))  # of 22.5 µm, in whole dots of 5.3 µm
    beyond = irradiance.factors[1].copy()
    beyond[:, :, :2] *= (
        # light on the first dot alone, which is not scored; diffraction takes a little of it
        # inwards
        3
    )
    brighter = SpectralImage(
        NM,
        10.0,
        irradiance.pitch_um,
        header=irradiance.header,
        factors=(irradiance.factors[0], beyond),
    )
    np.testing.assert_array_equal(
        evaluate(brighter, CAMERA, Pixel(pitch_um=15.0), display=SMALL).ideal, score.ideal
    )


def test_simulate_one_pixel_fewer_adds_no_seam():
    """400 or 399 pixels across the die: with 399 a strip as wide as a pixel has none.

    Perfect pixels, so that only the geometry differs. With all dots, the first column goes from
    0.42 to 1.12 and the mean rises by 1.4 %; what is left is the phase of pixels and gratings at
    the ends.
    """
    camera, line = Camera(), grating(1024)[0]
    light = irradiance_of(np.tile(line, (64, 1)), camera)
    ends, mean = [], []
    for pitch_um in (6.7840, 6.7847):
        pixel = Pixel(pitch_um=pitch_um, **PERFECT)
        chain = imaging_chain(light, camera, pixel, LONG, border_um=15.0)
        map_ = chain.simulate("seam").delta_e
        assert map_.shape[1] == 506
        ends.append([map_[:, 0].mean(), map_[:, -1].mean()])
        mean.append(map_.mean())
    np.testing.assert_allclose(ends[1], ends[0], atol=0.02)
    assert mean[1] == pytest.approx(mean[0], rel=3e-3)


# --- Codes ---


@pytest.mark.parametrize("bits", [1, 4, 8, 12, 16])
@pytest.mark.parametrize("gamma", [1.0, 2.2])
def test_shown_luminance_rounds_to_nearest_code(bits, gamma):
    display = Display(bits=bits, gamma=gamma)
    luminance = np.linspace(0, 1, 5001)
    shown = displays.shown_luminance(luminance, display)
    top = 2**bits - 1
    steps = top * (shown ** (1 / gamma) - luminance ** (1 / gamma))
    assert 0.4 < np.abs(steps).max() < 0.5 + 1e-9
    # What is shown once stays as it is.
    np.testing.assert_array_equal(displays.shown_luminance(shown, display), shown)
    levels = (np.arange(top + 1) / top) ** gamma
    np.testing.assert_allclose(displays.shown_luminance(levels, display), levels, rtol=1e-12)


# --- The whole score ---


def grating(samples: int = 256) -> np.ndarray:
    """10 lp/mm, contrast 0.5 (deeper troughs are filtered to black, where CIELAB magnifies
    everything).
    """
    phase = 2 * np.pi * 10 * DIE_MM * (np.arange(samples) + 0.5) / samples
    return np.tile(0.5 * (1 + 0.5 * np.sin(phase)), (samples, 1))


LONG = Exposure(max_integration_s=1000)
QUIET = dict.fromkeys(
    ("read_noise_e", "reset_noise_factor", "prnu", "dsnu", "offset_fpn", "column_fpn"), 0
)
PERFECT = {
    "fill_factor": 1.0,
    "quantum_efficiency": 1.0,
    "full_well_e": 1e9,
    "dark_current_e_per_s": 0,
    "bits": 24,
    **QUIET,
}


class NoShotNoise(np.random.Generator):
    def poisson(self, lam, size=None):
        return np.asarray(lam, float)


@pytest.fixture(scope="module")
def csf() -> tuple[SpectralImage, Camera]:
    """The packaged chart on a film of 1024², computed without samples, behind a lens without
    diffraction.
    """
    scene = pixsim.load_scene("csf", resolution=1024)
    irradiance = pixsim.render(scene, scene.camera(), plan=make_render_plan(scene, exact=True))
    irradiance.header["diffraction"] = False
    return irradiance, scene.camera()


@pytest.mark.parametrize(
    ("bits", "finest_um", "most"),
    [pytest.param(16, 0.53, 1.5e-3, marks=pytest.mark.slow), (8, 1.325, 0.01)],
)
def test_score_frame_ideal_pixels_converge_to_ideal_image(csf, bits, finest_um, most):
    """No noise, no diffraction, no gaps: what is left is the mean over pixels and the lines between
    them, which goes with pitch².

    The frame of a study up to 15 µm. Found with 16 bits .0948, .0249, .0063 at 5.3, 2.65, 1.33 µm
    and .0010 at .53 µm; with 8 bits .0968, .0264 and .0070: codes that round another way.
    """
    irradiance, camera = csf
    display, actual = Display(bits=bits), {}
    for pitch_um in {5.3, 2.65, 1.325, finest_um}:
        pixel = Pixel(pitch_um=pitch_um, **PERFECT)
        chain = imaging_chain(irradiance, camera, pixel, LONG, display, border_um=15.0)
        frame = chain.capture_with(
            seed := np.random.default_rng(0), NoShotNoise(seed.bit_generator), seed
        )
        actual[pitch_um] = chain.development.score(frame).mean_delta_e
    assert 0 < actual[finest_um] <= most
    for pitch_um in (5.3, 2.65):
        assert 3.3 < actual[pitch_um] / actual[pitch_um / 2] < 4.5


def test_evaluate_every_flaw_raises_delta_e():
    irradiance = irradiance_of(grating())
    pixel = {"pitch_um": 5.3, **PERFECT}

    def mean_delta_e(**flaw) -> float:
        return evaluate(
            irradiance, CAMERA, Pixel(**pixel | flaw), Exposure(max_integration_s=10), SMALL
        ).mean_delta_e

    clean = mean_delta_e()
    for flaw in (
        {"prnu": 0.1},
        {"offset_fpn": 0.02},
        {"column_fpn": 0.01},
        {"bits": 4},
        {"pitch_um": 21.2},
        {"full_well_e": 200},
    ):
        # Found 0.44 without a flaw, 0.9 to 7.3 with one.
        assert mean_delta_e(**flaw) > 1.5 * clean, flaw


def test_evaluate_depends_on_seed_only():
    irradiance = irradiance_of(grating(64))
    one, same, other = (
        evaluate(irradiance, CAMERA, Pixel(), display=SMALL, seed=seed).delta_e
        for seed in (3, np.int64(3), 4)
    )
    np.testing.assert_array_equal(one, same)
    assert np.mean(one != other) > 0.9


# --- Weights and limits ---


@pytest.mark.parametrize("degree", [0, 1])
@pytest.mark.parametrize(("n", "dots"), [(1, 4), (2, 9), (7, 3), (40, 64), (500, 31)])
def test_average_axis_matches_exact_integral(degree, n, dots):
    """Against the trapezoidal rule between all bends and jumps, which is exact, also beyond the
    outermost values.
    """
    rng = np.random.default_rng(n)
    values = rng.normal(size=n)
    edges = np.sort(rng.uniform(-2, n + 1, dots + 1))
    bends = np.arange(-3, n + 3) + (0.5 if degree == 0 else 0.0)
    actual = displays.average_axis(values, 1.0, -0.5, edges, degree, 0)
    for low, high, mean in zip(edges[:-1], edges[1:], actual, strict=True):
        at = np.concatenate([[low], bends[(bends > low) & (bends < high)], [high]])
        if degree:
            line = np.interp(at, np.arange(n), values)
            parts = (line[1:] + line[:-1]) / 2
        else:
            parts = values[np.clip(np.rint((at[1:] + at[:-1]) / 2).astype(int), 0, n - 1)]
        assert mean == pytest.approx(
            (parts * np.diff(at)).sum() / (high - low), abs=1e-12 / (high - low)
        )


def test_frame_luminance_transposes_with_picture():
    picture = np.random.default_rng(9).uniform(100, 1000, (90, 90))
    for pixels in (90, 150):  # more dots than pixels, and fewer
        pitch_um = 678.4 / pixels
        shown, turned = (
            on_dots(noise_free(item, pitch_um), (pitch_um * 90,) * 2, 1000.0, SMALL)
            for item in (picture, picture.T)
        )
        np.testing.assert_allclose(shown, turned.T, rtol=1e-13)


# --- Extremes of light, of the display, and of frames ---


SHORT_NM = np.array([365.0, 375.0, 385.0])  # below the 0.35 µm process's response


def even(nm, spectrum, **header):
    """An even field of one spectrum on the default axis, white at 1000 cd/m²."""
    return SpectralImage(
        nm,
        10.0,
        20.0,
        factors=(spectrum, np.ones((1, 6, 6))),
        header={"luminance_cd_per_m2": 1000.0, **header},
    )


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("image", "options"),
    [
        (even(SHORT_NM, np.ones(3)), {}),
        (even(np.array([550.0]), np.zeros(1)), {}),
        (even(np.array([550.0]), np.ones(1), lamp_w_per_m2_sr_nm=[0.0]), {}),
        (
            SpectralImage(
                SHORT_NM,
                10.0,
                20.0,
                data=np.ones((6, 6, 3)),
                header={"luminance_cd_per_m2": 1000.0},
            ),
            {},
        ),
        (even(np.array([550.0]), np.ones(1)), {"infrared_cut_nm": 1.0}),
        *(
            (even(np.array([550.0]), np.ones(1), luminance_cd_per_m2=white), {})
            for white in (1e-320, 1e-300, 1e300)
        ),
    ],
)
def test_evaluate_white_without_electrons_raises(image, options):
    with pytest.raises(
        PixsimError, match=r"the scene's white: got .*both the sensor and the eye respond"
    ):
        evaluate(image, Camera(die_mm=0.12), Pixel(pitch_um=10.0, **options))


@pytest.mark.parametrize("white", [1e-12, 1e-3, 1e15])
def test_evaluate_extreme_white_is_finite(white):
    image = even(np.array([550.0]), np.full(1, 1e-3))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*brighter than display white")
        score = evaluate(
            image, Camera(die_mm=0.12), Pixel(pitch_um=10.0), display=Display(white_cd_per_m2=white)
        )
    assert np.all(np.isfinite(score.delta_e))


def test_evaluate_black_picture_is_black():
    nm = np.arange(405.0, 700.0, 10)
    image = SpectralImage(
        nm,
        10.0,
        20.0,
        factors=(d65(nm), np.zeros((1, 6, 6))),
        header={"luminance_cd_per_m2": 1000.0},
    )
    score = evaluate(
        image, Camera(die_mm=0.12), Pixel(pitch_um=10.0, dark_current_e_per_s=0.0, read_noise_e=0.0)
    )
    assert np.all(score.frame.mean_e == 0)
    assert np.all(score.ideal == 0)


@pytest.mark.parametrize("raster", ["one_to_one", "fixed_size"])
def test_evaluate_pixel_larger_than_picture_raises(raster):
    wide = SpectralImage(
        [550.0], 10.0, 1.3, data=np.ones((2, 40, 1)), header={"luminance_cd_per_m2": 1e9}
    )
    with pytest.raises(PixsimError, match=r"pixel\.pitch_um: got 6\.5; allowed: at most the die"):
        evaluate(wide, Camera(die_mm=0.052), Pixel(), display=Display(raster=raster))


@pytest.mark.parametrize("raster", ["one_to_one", "fixed_size"])
@pytest.mark.parametrize("dots", [8, 512])
def test_evaluate_single_pixel(raster, dots):
    pixel = Pixel(pitch_um=60.0, full_well_e=1e12, bits=24, **QUIET)
    light = SpectralImage(
        [550.0], 10.0, 20.0, data=np.ones((3, 3, 1)), header={"luminance_cd_per_m2": 1e9}
    )
    display = Display(raster=raster, dots=dots)
    if raster == "fixed_size":  # it is all border
        with pytest.raises(PixsimError, match=r"leaves none of the .* dots"):
            evaluate(light, Camera(die_mm=0.06), pixel, display=display)
        return
    score = evaluate(light, Camera(die_mm=0.06), pixel, display=display)
    assert score.frame.dn.shape == score.delta_e.shape == (1, 1)
    assert np.ptp(score.image) == 0


def test_evaluate_too_many_dots_raises():
    tall = SpectralImage(
        [550.0], 10.0, 10.0, data=np.ones((20_000, 1, 1)), header={"luminance_cd_per_m2": 1e9}
    )
    message = (
        r"display\.dots: got 512 across a picture of 10 µm × 200000 µm: 5240 million dots; allowed"
    )
    with pytest.raises(PixsimError, match=message):
        evaluate(tall, Camera(die_mm=0.01), Pixel())


@pytest.mark.parametrize(
    ("gamma", "bits"), [(2.2, 8), (1.0, 1), (0.45, 10), (1.8, 14), (0.01, 8), (100.0, 8)]
)
def test_shown_luminance_is_the_nearest_code_beside_every_border(gamma, bits):
    """Luminances on both sides of each border of codes and of bins of luminance, by the definition
    in float64.
    """
    top = 2**bits - 1
    codes = np.unique(np.linspace(0, top - 1, 2000).astype(int))
    borders = np.concatenate(
        [((codes + 0.5) / top) ** gamma, np.arange(displays.MAX_BINS + 1) / displays.MAX_BINS]
    )
    luminance = np.concatenate([np.nextafter(borders, 2.0), borders, np.nextafter(borders, -1.0)])
    clipped = np.clip(luminance, 0.0, 1.0)
    expected = (np.rint(clipped ** (1 / gamma) * top) / top) ** gamma
    np.testing.assert_array_equal(
        displays.shown_luminance(luminance, Display(gamma=gamma, bits=bits)), expected
    )


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_shown_luminance_in_place_overwrites_whole_arrays_only(dtype):
    luminance = (
        np.random.default_rng(3).uniform(-0.1, 1.1, (600, 500)).astype(dtype)
    )  # more than a strip
    expected = displays.shown_luminance(luminance, Display())
    kept = luminance.copy()
    kept.flags.writeable = False
    for own, is_overwritten in (
        (luminance.copy(), True),
        (np.asfortranarray(luminance), False),
        (kept, False),
    ):
        shown = displays.shown_luminance(own, Display(), in_place=True)
        np.testing.assert_array_equal(shown, expected)
        assert np.shares_memory(shown, own) is is_overwritten
        assert np.array_equal(own, luminance) is not is_overwritten


@pytest.mark.parametrize(
    "edges_um",
    [np.ones((2, 3)), np.zeros(0), np.array(1.0), np.array([1.0]), np.array([0.0, 2.0, 1.0])],
)
def test_on_dots_invalid_edges_raise(edges_um):
    with pytest.raises(PixsimError, match=r"edges_um(\[1\])?: got"):
        pixsim.display.on_dots(
            np.ones((4, 4)), 1.0, (4.0, 4.0), Display(), (np.arange(5.0), edges_um)
        )


@pytest.mark.parametrize("gamma", [0.01, 0.1, 1.0, 10.0, 100.0])
@pytest.mark.parametrize("bits", [1, 8, 16])
def test_shown_luminance_keeps_black_and_white(gamma, bits):
    shown = displays.shown_luminance(
        np.array([[-1.0, 0.0, 1.0, 7.0]]), Display(gamma=gamma, bits=bits)
    )
    np.testing.assert_array_equal(shown, [[0.0, 0.0, 1.0, 1.0]])


@pytest.mark.parametrize("degree", [0, 1, 3])
@pytest.mark.parametrize("n", [1, 2, 3, 4, 20000])
def test_average_axis_of_constant_is_constant(degree, n):
    edges_um = np.linspace(
        -0.3 * math.pi, n + 0.7, 38
    )  # beyond the outermost centres on both sides
    actual = displays.average_axis(np.full((n, 2), 3.7), 1.0, 0.0, edges_um, degree, axis=0)
    # Differences of an integral up to n: its roundings over a dot's width.
    assert np.abs(actual / 3.7 - 1).max() < 1e-15 * (10 + n)


@pytest.mark.parametrize("interpolation", ["linear", "nearest", "cubic"])
@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (7, 1)])
def test_frame_luminance_single_row_or_pixel(interpolation, shape):
    dn = np.random.default_rng(0).integers(10, 900, shape).astype(np.int32)
    frame = Frame(dn, dn.astype(float), 1.0, 1.0, 0.0, 0.0, 5.0, 10, 0.0)
    size_um = 5.0 * shape[0], 5.0 * shape[1]
    display = Display(dots=64, interpolation=interpolation)
    shown = displays.frame_luminance(
        frame, size_um, 1000.0, display, displays.dot_edges_um(size_um, 5.0, display, 0.0)
    )
    assert shown.shape[1] == 64
    assert np.all(np.isfinite(shown))
    if interpolation != "cubic":  # a cubic overshoots; the others neither gain nor lose light
        assert shown.mean() == pytest.approx(dn.mean() / 1000, rel=1e-12)


# --- Colour ---


def test_rgb_to_xyz_grey_is_the_grey_display():
    grey = np.linspace(0, 1, 12).reshape(3, 4)
    xyz = displays.rgb_to_xyz(np.repeat(grey[:, :, None], 3, axis=2))
    np.testing.assert_allclose(xyz, displays.to_xyz(grey), rtol=1e-12, atol=0)


def test_rgb_to_xyz_primaries_have_the_chromaticities_of_srgb():
    """And the display's white for all three; the luminances are those of IEC 61966-2-1 to four
    digits.
    """
    xyz = displays.rgb_to_xyz(np.eye(3))
    np.testing.assert_allclose(
        xyz[:, :2] / xyz.sum(axis=1, keepdims=True),
        [[0.64, 0.33], [0.30, 0.60], [0.15, 0.06]],
        rtol=1e-12,
    )
    np.testing.assert_allclose(xyz.sum(axis=0), displays.WHITE_XYZ, rtol=1e-14)
    np.testing.assert_allclose(xyz[:, 1], [21.26, 71.52, 7.22], atol=0.01)
    np.testing.assert_allclose(xyz @ displays.RGB_FROM_XYZ.T, np.eye(3), atol=1e-14)
    for values in (np.eye(3), np.eye(3)[None], np.eye(3)[0]):
        single = displays.rgb_to_xyz(values.astype(np.float32))
        assert single.dtype == np.float32
        np.testing.assert_allclose(
            single, displays.rgb_to_xyz(values), rtol=1e-7
        )  # one rounding of the matrix


def test_out_of_gamut_share_counts_colours_not_high_lights():
    inside = [[1.0, 0.0, 0.5], [0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [-1e-12, 1.0, 1.0]]
    bright = [[1.5, 1.5, 1.5], [1.01, 1.0, 1.0]]
    outside = [[-0.01, 0.5, 0.5], [1.1, 0.2, 0.2], [3.0, 3.0, -0.1]]
    assert displays.out_of_gamut_share(np.array(inside + bright)) == 0
    assert displays.out_of_gamut_share(np.array(outside)) == 1
    assert displays.out_of_gamut_share(np.array([inside[:3], outside])) == 0.5
    assert [displays.out_of_gamut_share(np.array(one)) for one in inside + bright + outside] == [
        0.0
    ] * 6 + [1.0] * 3
    for values in (np.ones((3, 2)), np.ones((0, 3)), np.array(1.0)):
        with pytest.raises(PixsimError, match="Move the three values last"):
            displays.out_of_gamut_share(values)
