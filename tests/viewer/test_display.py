"""The display from electrons to displayed luminance: scale, rasters, means over dots, codes; and
limits of the whole score.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from helpers.chains import imaging, imaging_chain
from helpers.claims import Claim
from hypothesis import given, settings, strategies as st

from pixsim import Camera, Display, Exposure, Pixel, SpectralImage
from pixsim.light.spectral import d65
from pixsim.optics.diffraction import square_aperture_mtf
from pixsim.sensor.integration import mean_signal_rate
from pixsim.sensor.pixel import derive
from pixsim.sensor.readout import Frame
from pixsim.viewer import display as displays
from pixsim.viewer.evaluate import evaluate

NM = np.arange(400.0, 721.0, 10)
DIE_UM = 678.4  # 128 dots of 5.3 µm
DISPLAY = Display(dots=128)
CAMERA = Camera(die_mm=1e-3 * DIE_UM)
REPEATABLE = settings(derandomize=True, database=None, deadline=None, max_examples=15)


def light(picture: np.ndarray, camera: Camera = CAMERA, **header: Any) -> SpectralImage:
    """Return light of D65 from a chart of 1000 cd/m² at 1: E = L τ π/(1 + 4N²(1 + m)²)."""
    unit = SpectralImage(NM, 10.0, 1.0, factors=(d65(NM), np.ones((1, 1, 1))))
    f_number = camera.f_number * (1 + camera.magnification)
    white_lx = 1000.0 * camera.transmittance * np.pi / (1 + 4 * f_number**2)
    spectrum = d65(NM) * white_lx / unit.illuminance_lx()[0, 0]
    pitch_um = 1e3 * camera.die_mm / picture.shape[1]
    header = {"luminance_cd_per_m2": 1000.0} | header
    return SpectralImage(NM, 10.0, pitch_um, factors=(spectrum, picture[None]), header=header)


def noise_free(electrons: np.ndarray, pitch_um: float, dark_e: float = 0.0) -> Frame:
    """Return a frame that the ADC has rounded to 1e-3 e-, with a black level of 64 DN."""
    dn = np.rint((electrons + dark_e) * 1e3 + 64).astype(np.int32)
    return Frame(dn, electrons, 1.0, 1e3, 64, dark_e, pitch_um, 31, 0.0)


def on_dots(
    electrons: np.ndarray,
    pitch_um: float,
    display: Display = DISPLAY,
    size_um: tuple[float, float] = (DIE_UM, DIE_UM),
) -> np.ndarray:
    """Return the luminance of a frame on all dots, in a white of 1000 e-."""
    edges_um = displays.dot_edges_um(size_um, pitch_um, display, 0.0)
    frame = noise_free(electrons, pitch_um)
    return displays.frame_luminance(frame, size_um, 1000.0, display, edges_um)


def ideal_on_dots(
    irradiance: SpectralImage, display: Display = DISPLAY, border_um: float = 0.0
) -> np.ndarray:
    """Return the ideal luminance on the dots."""
    edges_um = displays.dot_edges_um((DIE_UM, DIE_UM), 6.5, display, border_um)
    return displays.ideal_luminance(imaging(CAMERA, Pixel(), display=display), irradiance, edges_um)


HALF = np.random.default_rng(2).uniform(100, 1000, (64, 128))
SQUARE = np.random.default_rng(3).uniform(100, 1000, (256, 256))
NEAREST = Display(dots=128, interpolation="nearest")
PIXEL_DOTS = Display(raster="one_to_one")
HALF_UM = DIE_UM / 2, DIE_UM
NOISE = 1000 + 50 * np.random.default_rng(4).standard_normal((256, 256))
CLAIMS = [
    Claim(
        "white of the display replaces that of the scene",
        lambda: ideal_on_dots(light(np.ones((64, 64))), Display(dots=128, white_cd_per_m2=500)),
        np.full((128, 128), 2.0),
        rtol=1e-6,
        why="float32",
    ),
    *(
        Claim(
            f"pixels of a dot are unchanged, {display.raster} {display.interpolation}",
            lambda display=display: on_dots(HALF, 5.3, display, HALF_UM),
            HALF / 1000,
            atol=1e-6,
            why="the ADC rounds to 5e-7 of white",
        )
        for display in (NEAREST, PIXEL_DOTS, Display(raster="one_to_one", interpolation="cubic"))
    ),
    *(
        Claim(
            f"dots conserve the mean of {pixels} pixels",
            lambda pixels=pixels: on_dots(SQUARE[:pixels, :pixels], DIE_UM / pixels).mean(),
            SQUARE[:pixels, :pixels].mean() / 1000,
            atol=1e-6,
            why="the ADC rounds to 5e-7 of white",
        )
        for pixels in (90, 129, 256)
    ),
    Claim(
        "dots of four pixels are their means",
        lambda: on_dots(SQUARE, 2.65, NEAREST),
        SQUARE.reshape(128, 2, 128, 2).mean(axis=(1, 3)) / 1000,
        atol=1e-6,
        why="the ADC rounds to 5e-7 of white",
    ),
    *(
        Claim(
            f"axes are alike, {pixels} pixels",
            lambda pixels=pixels: (
                on_dots(SQUARE[:pixels, :pixels].T, DIE_UM / pixels).T
                - on_dots(SQUARE[:pixels, :pixels], DIE_UM / pixels)
            ),
            np.zeros((128, 128)),
            atol=1e-13,
        )
        for pixels in (90, 150)
    ),
    *(
        Claim(
            f"noise of four pixels a dot, {display.interpolation}",
            lambda display=display: on_dots(NOISE, 2.65, display).std(),
            0.05 * weight,
            rtol=5 / math.sqrt(2 * 128**2),
            why="5 σ of 128² dots, 2.8 %: 6e-7 false alarms; 5 % are found in all seeds",
        )
        # Four equal pixels; lines between pixels weigh 1, 7, 7, 1 sixteenths an axis.
        for display, weight in ((NEAREST, 0.5), (DISPLAY, 2 * (7**2 + 1) / 16**2))
    ),
    *(
        Claim(
            f"{dots} dots are left out for a border of {border_um:g} µm",
            lambda border_um=border_um: np.concatenate(
                displays.dot_edges_um(HALF_UM, 6.5, DISPLAY, border_um)
            ),
            5.3 * np.concatenate([np.arange(dots, 65 - dots), np.arange(dots, 129 - dots)]),
            atol=1e-9,
        )
        for border_um, dots in ((0.0, 0), (1e-6, 1), (5.3 * (1 + 1e-12), 1), (5.31, 2), (15.0, 3))
    ),
    Claim(
        "pixels as dots are centred and have no border",
        lambda: np.concatenate(displays.dot_edges_um(HALF_UM, 6.5, PIXEL_DOTS, 15.0)),
        np.concatenate(
            [
                (DIE_UM / 2 - 52 * 6.5) / 2 + 6.5 * np.arange(53),
                (DIE_UM - 104 * 6.5) / 2 + 6.5 * np.arange(105),
            ]
        ),
        atol=1e-9,
    ),
]


@pytest.mark.parametrize("claim", CLAIMS, ids=str)
def test_closed_forms(claim: Claim) -> None:
    claim.check()


# --- scale


@pytest.mark.parametrize(("f_number", "transmittance"), [(4.0, 1.0), (1.4, 0.8)])
def test_white_is_one(f_number: float, transmittance: float) -> None:
    """In the frame, to the ADC's rounding of 1e-6, and in the ideal picture, to float32."""
    camera = CAMERA.model_copy(
        update={"f_number": f_number, "transmittance": transmittance, "object_distance_m": 0.1}
    )
    physics = derive(Pixel(pitch_um=10.6))
    irradiance = light(np.ones((64, 64)), camera)
    electrons = mean_signal_rate(irradiance, camera, physics) * 0.01
    view = imaging(camera, physics.pixel, display=DISPLAY)
    white_e = displays.white_rate(view, irradiance) * 0.01 * physics.photodiode_area_um2
    edges_um = displays.dot_edges_um((DIE_UM, DIE_UM), 10.6, DISPLAY, 0.0)
    frame = noise_free(electrons, 10.6, dark_e=12.3)
    luminance = displays.frame_luminance(frame, (DIE_UM, DIE_UM), white_e, DISPLAY, edges_um)
    np.testing.assert_allclose(luminance, 1.0, rtol=2e-6)
    ideal = displays.ideal_luminance(view, irradiance, edges_um)
    np.testing.assert_allclose(ideal, 1.0, rtol=1e-6)


# --- rasters


@pytest.mark.parametrize("pitch_um", [1.7, 6.5, 15.0])
def test_pictures_keep_their_position(pitch_um: float) -> None:
    """A ramp survives means and lines between pixels; up to 1.5 pixels at the border are constant,
    and pixels that a dot's border cuts.
    """
    count = int(DIE_UM / pitch_um)
    x_um = DIE_UM / 2 + (np.arange(count) - (count - 1) / 2) * pitch_um
    luminance = on_dots(np.tile(500 + x_um, (count, 1)), pitch_um)[64]
    dots_um = (np.arange(128) + 0.5) * 5.3
    atol = 1e-6 if pitch_um > 5.3 else pitch_um / 4000
    np.testing.assert_allclose(luminance[4:-4], (500 + dots_um[4:-4]) / 1000, atol=atol)
    assert luminance.mean() == pytest.approx((500 + DIE_UM / 2) / 1000, abs=1e-6)


# --- blur of the display


def displayed_contrast(frequency_cy_per_mm: float, pitch_um: float, interpolation: Any) -> float:
    """Return the amplitude of a grating on the dots over its amplitude on the pixels.

    A mean over eight phases cancels images of the spectrum that fall close by on the raster.
    """
    die_um = 2713.6
    display = Display(dots=512).model_copy(update={"interpolation": interpolation})
    count = int(die_um / pitch_um * (1 + 1e-9))
    x_um = (np.arange(count) - (count - 1) / 2) * pitch_um
    dots_um = ((np.arange(512) + 0.5) / 512 - 0.5) * die_um
    window = np.sin(np.pi * (np.arange(512) + 0.5) / 512) ** 4  # without borders and mean
    rad_per_um = 2e-3 * np.pi * frequency_cy_per_mm
    amplitudes = []
    for phase in np.arange(8) * np.pi / 4:
        grating = 1000.0 + 500.0 * np.cos(rad_per_um * x_um + phase)
        electrons = np.tile(grating, (8, 1))
        luminance = on_dots(electrons, pitch_um, display, (8 * pitch_um, die_um))[0]
        wave = np.exp(-1j * (rad_per_um * dots_um + phase))
        amplitudes.append(4 * (window * (luminance - 1) * wave).sum() / window.sum())
    return float(np.abs(np.mean(amplitudes)))


@pytest.mark.parametrize("interpolation", ["nearest", "linear", "cubic", "quintic"])
@pytest.mark.parametrize(("pitch_um", "share"), [(6.5, 0.8), (15.0, 0.5)])
def test_interpolation_mtf_is_the_contrast_of_gratings(
    interpolation: str, pitch_um: float, share: float
) -> None:
    """At shares of the Nyquist frequency; images of the spectrum leave up to 2e-4 on the dots."""
    frequency = share * 500 / pitch_um
    mtf = displays.interpolation_mtf(frequency, pitch_um, interpolation)
    expected = float(mtf * square_aperture_mtf(frequency, 2713.6 / 512))
    assert displayed_contrast(frequency, pitch_um, interpolation) == pytest.approx(
        expected, abs=5e-4
    )


@pytest.mark.parametrize(("samples", "atol"), [(256, 1e-7), (200, 1e-5)])
def test_ideal_picture_is_the_mean_over_dots(samples: int, atol: float) -> None:
    """Of 300 + 100 sin(x/20): to float32 for dots of whole samples, else to the quintic spline."""

    def integral(x_um: np.ndarray) -> np.ndarray:
        return 300 * x_um - 2000 * np.cos(x_um / 20)

    edges_um = np.linspace(0, DIE_UM, samples + 1)
    means = np.diff(integral(edges_um)) / np.diff(edges_um)
    ideal = ideal_on_dots(light(np.tile(means, (samples, 1)) / 500))
    dots_um = np.linspace(0, DIE_UM, 129)
    expected = np.diff(integral(dots_um)) / np.diff(dots_um) / 500
    np.testing.assert_allclose(ideal, np.tile(expected, (128, 1)), atol=atol)


def test_ideal_picture_conserves_light_at_an_edge() -> None:
    """One dot takes the step, and nothing is below 0."""
    line = np.where(np.arange(200) < 77, 1e-4, 1.0)
    ideal = ideal_on_dots(light(np.tile(line, (200, 1))))
    edge = int(77 / 200 * 128)
    assert ideal.mean() == pytest.approx(line.mean(), rel=1e-6)
    assert ideal.min() > 0
    np.testing.assert_allclose(ideal[:, : edge - 2], 1e-4, rtol=0.01)
    np.testing.assert_allclose(ideal[:, edge + 3 :], 1.0, rtol=0.01)


# --- means along an axis


@REPEATABLE
@given(degree=st.sampled_from([0, 1]), count=st.integers(1, 60), dots=st.integers(1, 40))
def test_average_axis_is_the_exact_integral(degree: int, count: int, dots: int) -> None:
    """The trapezoidal rule between all bends and jumps, also beyond the outermost values."""
    rng = np.random.default_rng(count)
    values = rng.normal(size=count)
    edges = np.sort(rng.uniform(-2, count + 1, dots + 1))
    means = displays.average_axis(values, 1.0, -0.5, edges, degree, 0)
    bends = np.arange(-3, count + 3) + (0.5 if degree == 0 else 0.0)
    for low, high, mean in zip(edges[:-1], edges[1:], means, strict=True):
        places = np.concatenate([[low], bends[(bends > low) & (bends < high)], [high]])
        middle = (places[1:] + places[:-1]) / 2
        if degree:
            heights = np.interp(middle, np.arange(count), values)
        else:
            heights = values[np.clip(np.rint(middle).astype(int), 0, count - 1)]
        integral = float(heights @ np.diff(places))
        assert mean * (high - low) == pytest.approx(integral, abs=1e-12)


@REPEATABLE
@given(degree=st.sampled_from([0, 1, 3]), count=st.sampled_from([1, 2, 3, 4, 3000]))
def test_part_and_whole_have_one_mean(degree: int, count: int) -> None:
    """Means of two halves of an interval, weighted with their widths, are that of the whole."""
    values = np.random.default_rng(count).normal(size=(count, 2))
    edges = np.linspace(-0.3 * math.pi, count + 0.7, 39)
    edges[1::2] += 0.01
    parts = displays.average_axis(values, 1.0, 0.0, edges, degree, 0)
    whole = displays.average_axis(values, 1.0, 0.0, edges[::2], degree, 0)
    joined = (parts * np.diff(edges)[:, None]).reshape(-1, 2, 2).sum(axis=1)
    np.testing.assert_allclose(joined / np.diff(edges[::2])[:, None], whole, atol=1e-11)


# --- codes


@pytest.mark.parametrize(
    ("gamma", "bits"), [(2.2, 8), (1.0, 1), (0.45, 10), (1.8, 14), (0.01, 8), (100.0, 8)]
)
def test_the_nearest_code_is_displayed(gamma: float, bits: int) -> None:
    """On both sides of each border of codes and of bins, clipped to 0 … 1; bit for bit."""
    top = 2**bits - 1
    codes = np.unique(np.linspace(0, top - 1, 2000).astype(int))
    bins = np.arange(displays.MAX_BINS + 1) / displays.MAX_BINS
    borders = np.concatenate([((codes + 0.5) / top) ** gamma, bins, [7.0]])
    luminance = np.concatenate([np.nextafter(borders, 8.0), borders, np.nextafter(borders, -1.0)])
    inside = np.clip(luminance, 0.0, 1.0)
    expected = (np.rint(inside ** (1 / gamma) * top) / top) ** gamma
    displayed = displays.shown_luminance(luminance, Display(gamma=gamma, bits=bits))
    np.testing.assert_array_equal(displayed, expected)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_only_whole_arrays_are_overwritten(dtype: Any) -> None:
    luminance = np.random.default_rng(3).uniform(-0.1, 1.1, (600, 500)).astype(dtype)
    expected = displays.shown_luminance(luminance, Display())
    read_only = luminance.copy()
    read_only.flags.writeable = False
    for picture, is_overwritten in (
        (luminance.copy(), True),
        (np.asfortranarray(luminance), False),
        (read_only, False),
    ):
        displayed = displays.shown_luminance(picture, Display(), in_place=True)
        np.testing.assert_array_equal(displayed, expected)
        assert np.shares_memory(displayed, picture) is is_overwritten


# --- the whole score


def grating(samples: int = 256) -> np.ndarray:
    """Return 10 lp/mm of contrast 0.5."""
    phase = 2e-2 * np.pi * DIE_UM * (np.arange(samples) + 0.5) / samples
    return np.tile(0.5 * (1 + 0.5 * np.sin(phase)), (samples, 1))


PERFECT = {
    "fill_factor": 1.0,
    "quantum_efficiency": 1.0,
    "full_well_e": 1e9,
    "dark_current_e_per_s": 0,
    "bits": 24,
    **dict.fromkeys(
        ("read_noise_e", "reset_noise_factor", "prnu", "dsnu", "offset_fpn", "column_fpn"), 0
    ),
}


class NoShotNoise(np.random.Generator):
    def poisson(self, lam: Any, size: Any = None) -> np.ndarray:
        return np.asarray(lam, float)


def test_perfect_pixels_converge_to_the_ideal_picture() -> None:
    """Without noise and diffraction ΔE falls with the square of the pitch: 4 times by halving it,
    measured 3.92 and 3.96.
    """
    irradiance = light(grating(1024), diffraction=False)
    display = Display(dots=128, bits=16)
    mean_delta_e = []
    for pitch_um in (10.6, 5.3, 2.65):
        pixel = Pixel(pitch_um=pitch_um, **PERFECT)
        exposure = Exposure(max_integration_s=1000)
        chain = imaging_chain(irradiance, CAMERA, pixel, exposure, display, border_um=15.0)
        seed = np.random.default_rng(0)
        frame = chain.capture_with(seed, NoShotNoise(seed.bit_generator), seed)
        mean_delta_e.append(chain.development.score(frame).mean_delta_e)
    ratios = np.divide(mean_delta_e[:-1], mean_delta_e[1:])
    np.testing.assert_allclose(ratios, 4, atol=0.2)


def test_scores_depend_on_the_seed_only() -> None:
    irradiance = light(grating(64))
    first, again, other = (
        evaluate(irradiance, CAMERA, Pixel(), display=DISPLAY, seed=seed).delta_e
        for seed in (3, np.int64(3), 4)
    )
    np.testing.assert_array_equal(first, again)
    assert np.mean(first != other) > 0.9


def test_light_on_the_border_changes_no_score() -> None:
    """A border of 22.5 µm is five dots of 5.3 µm; diffraction takes a little light inwards."""
    irradiance = light(grating())
    inside = ideal_on_dots(irradiance)[5:-5, 5:-5]
    np.testing.assert_allclose(ideal_on_dots(irradiance, border_um=22.5), inside, rtol=1e-12)
    score = evaluate(irradiance, CAMERA, Pixel(pitch_um=15.0), display=DISPLAY)
    assert score.delta_e.shape == score.image.shape == (118, 118)
    assert score.border_um == pytest.approx((26.5, 26.5))
    bright = grating()
    bright[:, :2] *= 3
    other = evaluate(light(bright), CAMERA, Pixel(pitch_um=15.0), display=DISPLAY)
    np.testing.assert_allclose(other.ideal, score.ideal, rtol=1e-12)
