"""Light to mean electrons: integration over photodiodes, its spline and strips, and the spectrum of
the light.

Conservation and closed forms at the extremes of pitch and size: pixsim.verification.extreme_cases.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers.blur import point_spread
from scipy.constants import c as light_speed, h as planck
from scipy.interpolate import make_interp_spline

from pixsim.base.errors import PixsimError
from pixsim.light.spectral import SpectralImage, photons_per_joule
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.camera_lens import Tiling, camera_with_lens, fitted_wavefronts
from pixsim.optics.field_blur import ChannelWavefronts
from pixsim.optics.lens_options import LensOptions
from pixsim.sensor import integration
from pixsim.sensor.integration import (
    integrate_axis,
    integrate_pixels,
    limit_overshoot,
    mean_signal_rate,
    real_lens_rate,
    ringing_cells,
    running_integral,
)
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel

DIE_UM = 2713.6
NM, WIDTH_NM = np.array([420.0, 530.0, 660.0]), np.array([40.0, 60.0, 50.0])


def seeded(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


def cell_means(antiderivative, n: int, length: float) -> np.ndarray:
    """Return exact means of a function over n equal cells of [0, length]."""
    return np.diff(antiderivative(np.linspace(0, length, n + 1))) * n / length


# --- Photodiodes ---


@pytest.mark.parametrize("pitch_um", [np.pi, np.sqrt(2), 3.1, 0.77])
def test_integrate_pixels_any_pitch_is_centred_and_conserves(pitch_um):
    n, length_um = 60, 60.0

    def antiderivative(x):
        return 3 * x - 10 * np.cos(x / 10 + 0.4)

    line = cell_means(antiderivative, n, length_um)
    count = int(length_um / pitch_um)
    low, high = length_um / 2 - count * pitch_um / 2, length_um / 2 + count * pitch_um / 2
    expected = antiderivative(high) - antiderivative(low)
    rows = integrate_pixels(np.tile(line, (n, 1)), 1.0, pitch_um, pitch_um)
    assert rows.shape == (count, count)
    # The function is smooth on this grid; its spline errs by 1.3e-10. Half a sample off centre
    # gives 8e-4.
    np.testing.assert_allclose(rows.sum(axis=1), expected * pitch_um, rtol=1e-9)
    np.testing.assert_allclose(rows.sum(axis=0)[0], rows[:, 0].sum(), rtol=1e-12)


@pytest.mark.parametrize("frequency_lp_per_mm", [5.0, 20.0, 33.333, 60.0])
@pytest.mark.parametrize(
    ("pitch_um", "fill_factor"), [(2.0, 0.9), (5.3, 0.05), (6.5, 0.31), (7.77, 1.0), (15.0, 0.73)]
)
def test_integrate_pixels_sinusoid_contrast_is_sinc(frequency_lp_per_mm, pitch_um, fill_factor):
    omega, contrast, side_um = (
        2e-3 * np.pi * frequency_lp_per_mm,
        0.5,
        pitch_um * np.sqrt(fill_factor),
    )
    line = cell_means(lambda x: x - contrast / omega * np.cos(omega * x + 0.3), 1024, DIE_UM)
    pixels = integrate_pixels(np.tile(line, (8, 1)), DIE_UM / 1024, pitch_um, side_um)[0]
    x = DIE_UM / 2 + (np.arange(pixels.size) - (pixels.size - 1) / 2) * pitch_um
    waves = np.stack([np.ones_like(x), np.sin(omega * x), np.cos(omega * x)], axis=1)
    mean, sine, cosine = np.linalg.lstsq(waves, pixels, rcond=None)[0]
    sinc = np.sinc(frequency_lp_per_mm * side_um * 1e-3)
    # Measured: at 60 lp/mm 0.022 % for the 1.2 µm photodiode and 0.007 % for the others, 6e-6 at 33
    # lp/mm and below. A cubic spline errs by 0.55 %, plain area weights by 15 %.
    tolerance = 3e-4 if frequency_lp_per_mm > 50 else 1e-5
    assert np.hypot(sine, cosine) / mean == pytest.approx(contrast * sinc, rel=tolerance)
    assert mean == pytest.approx(side_um**2, rel=1e-4)


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (2, 3)])
def test_integrate_pixels_tiny_picture_conserves(shape):
    picture = np.random.default_rng(0).uniform(0.5, 1.5, shape)
    whole = integrate_pixels(picture, 1.0, 1.0, 1.0)
    np.testing.assert_allclose(whole, picture, rtol=1e-14)
    parts = integrate_pixels(picture, 1.0, 1 / 3, 1 / 3)
    assert parts.shape == (3 * shape[0], 3 * shape[1])
    np.testing.assert_allclose(
        parts.reshape(shape[0], 3, shape[1], 3).sum(axis=(1, 3)), picture, rtol=1e-13
    )


@pytest.mark.parametrize("pitch_um", [1e-310, 1e-12, 1e-5])
def test_integrate_pixels_too_many_pixels_raises(pitch_um):
    # 1e-310 µm was an OverflowError: infinity has no integer.
    with pytest.raises(PixsimError, match=r"pixel.pitch_um: got .*at most"):
        integration.pixel_count(DIE_UM, pitch_um)
    with pytest.raises(PixsimError, match=r"pitch_um: got 11; allowed: at most the die, 10"):
        integrate_pixels(np.ones((10, 20)), 1.0, 11.0, 5.0)


# --- The spline, in strips ---


def smooth(shape: tuple[int, int], seed: int = 1) -> np.ndarray:
    return 1 + np.cumsum(np.random.default_rng(seed).uniform(-0.01, 0.01, shape), axis=1)


def mixed(shape: tuple[int, int] = (30, 41)) -> np.ndarray:
    """Return a smooth picture with a star and an edge in some columns and rows."""
    picture = smooth(shape)
    picture[7, 5] = 1e6
    picture[12:20, 11] = 1e-9
    return picture


def by_scipy(samples: np.ndarray, degree: int):
    running = np.concatenate([np.zeros((1, samples.shape[1])), np.cumsum(samples, axis=0)])
    return make_interp_spline(np.arange(len(samples) + 1.0), running, k=degree, axis=0)


@pytest.mark.parametrize(
    ("n", "degree"), [(1, 1), (2, 1), (3, 3), (4, 3), (5, 5), (6, 5), (40, 5), (301, 5)]
)
def test_spline_matches_scipy(n, degree):
    samples = smooth((n, 3))
    spline, at = by_scipy(samples, degree), np.sort(np.random.default_rng(2).uniform(0, n, 50))
    result = integrate_axis(samples, 1.0, at[:25], at[25:], 0)
    np.testing.assert_allclose(result, spline(at[25:]) - spline(at[:25]), rtol=0, atol=4e-15 * n)


@pytest.mark.parametrize("picture", [smooth((33, 50)), mixed()], ids=["smooth", "edges"])
@pytest.mark.parametrize(("pitch_um", "side_um"), [(0.7, 0.5), (3.1, 3.1)])
def test_integrate_pixels_strips_are_equal(monkeypatch, picture, pitch_um, side_um):
    whole = integrate_pixels(picture, 1.0, pitch_um, side_um)
    stored = integrate_pixels(picture, 1.0, pitch_um, side_um, running_integral(picture))
    monkeypatch.setattr(integration, "STRIP_COLUMNS", 3)
    in_strips = integrate_pixels(picture, 1.0, pitch_um, side_um)
    stored_in_strips = integrate_pixels(picture, 1.0, pitch_um, side_um, running_integral(picture))
    for result in (in_strips, stored_in_strips, stored):
        assert np.abs(result - whole).max() < 1e-13 * np.abs(whole).max()


def test_integrate_pixels_float32_needs_strip_memory_only(monkeypatch):
    picture = smooth((20, 9)).astype(np.float32)
    monkeypatch.setattr(integration, "STRIP_COLUMNS", 2)
    np.testing.assert_array_equal(
        integrate_pixels(picture, 1.0, 2.3, 1.1),
        integrate_pixels(picture.astype(float), 1.0, 2.3, 1.1),
    )


# --- High-contrast edges ---


@pytest.mark.parametrize("contrast", [1e3, 1e6, 1e10])
@pytest.mark.parametrize("side_um", [0.3, 0.7, 1.0, 2.3])
def test_integrate_pixels_hard_edge_does_not_ring(contrast, side_um):
    line = np.repeat([1.0, 1 / contrast], [40, 40]) * np.ones((3, 1))
    centres = np.arange(side_um / 2 + 0.05, 80 - side_um / 2, side_um)
    result = integrate_axis(line, 1.0, centres - side_um / 2, centres + side_um / 2, 1)
    assert result.min() >= 0
    # Beyond the cell behind the edge each side has its own light; 1e-5 of a cell's is left, 1.6e-5
    # of a small photodiode's.
    dark, bright = centres - side_um / 2 > 41, centres + side_um / 2 < 39
    np.testing.assert_allclose(
        result[:, dark], side_um / contrast, rtol=2e-5, atol=40 * 80 * 2.2e-16
    )  # 80 eps of the bright half
    np.testing.assert_allclose(result[:, bright], side_um, rtol=2e-5)


def test_limit_overshoot_conserves_sum():
    stars = np.zeros((40, 40))
    stars[10, 12] = stars[11, 30] = stars[33, 5] = 1e6
    result = integrate_pixels(stars, 1.0, 0.8, 0.8)
    assert result.min() >= 0
    # Clipped after the fact, what rang below zero came on top: 92 % too much.
    assert result.sum() == pytest.approx(stars.sum(), rel=1e-9)


def test_limit_overshoot_keeps_resolved_crests():
    """The sinusoid has 5 samples per period and troughs at zero; the limit acts on all of it."""
    n, omega = 200, 2 * np.pi / 5
    waves = np.diff(np.arange(n + 1) - np.cos(omega * np.arange(n + 1.0)) / omega)
    at = np.arange(20.0, 180.0, 0.37)
    edges = np.concatenate([at, at + 0.2])
    running = by_scipy(waves[:, None], 5)(edges)
    low, high = np.split(limit_overshoot(running, waves[:, None], edges)[:, 0], 2)
    exact = 0.2 - (np.cos(omega * (at + 0.2)) - np.cos(omega * at)) / omega
    # Of a crest, 0.4: the spline's own error is 0.06 %; without room for crests the limit would cut
    # 12 %.
    np.testing.assert_allclose(high - low, exact, atol=1e-3 * 0.4)


AT, SIDE = (
    np.arange(40.0, 60.0, 0.37),
    1.3,
)  # where photodiodes begin, around an edge at 50: under smaller ones 10 : 1 rings below zero


def edge_of_ten(patch: tuple[float, ...] = (), at: int = 0) -> np.ndarray:
    """Return a line with an edge of 10 : 1 at 50, and fine detail, with other light from a sample
    on.
    """
    line = np.where(np.arange(150) < 50, 10.0, 1.0) * np.tile([1.0, 1.1, 0.9], 50)
    line[at : at + len(patch)] = patch
    return line[:, None]


@pytest.mark.parametrize("patch", [(1000.0, 0.001) * 4, (0.0, 1e6), (-3.0, 1000.0, 0.001)])
def test_what_is_far_away_does_not_change_an_edge(patch: tuple[float, ...]) -> None:
    """In the same line, 40 cells away, the spline has 1e-14 of it; limited everywhere, an edge of
    10 : 1 would move by 1.6 %.
    """
    alone, beside = (
        integrate_axis(line, 1.0, AT, AT + SIDE, 0)
        for line in (edge_of_ten(), edge_of_ten(patch, 100))
    )
    spline = by_scipy(edge_of_ten(), 5)
    np.testing.assert_allclose(alone, spline(AT + SIDE) - spline(AT), atol=1e-12)
    assert np.abs(beside - alone).max() < 1e-9 * 9 * SIDE
    both = np.hstack([edge_of_ten(), edge_of_ten(patch, 45)])  # in another column, to the bit
    np.testing.assert_array_equal(integrate_axis(both, 1.0, AT, AT + SIDE, 0)[:, :1], alone)
    assert integrate_axis(both, 1.0, AT, AT + SIDE, 0)[:, 1].min() >= min(0.0, *patch)


def test_ringing_cells_reach_as_far_as_the_ring_shows() -> None:
    """Where the limit stops, the spline of the edge itself is off by 1e-5 of the light or less; it
    does not stop far beyond.
    """
    line = np.repeat([1000.0, 1.0], [60, 60])[:, None]
    rings = ringing_cells(line)[:, 0]
    spline, part = by_scipy(line, 5), np.linspace(0.0, 1.0, 21)
    moved = spline(np.arange(120)[:, None] + part)[..., 0] - spline(np.arange(120.0)) - part * line
    worst = np.abs(moved).max(axis=1) / line[:, 0]
    assert worst[~rings].max() < 1e-5
    assert worst[rings].min() > 1e-6
    assert not ringing_cells(np.repeat([90.0, 1.0], [60, 60])[:, None]).any()


def test_limit_acts_at_an_edge_beside_a_little_negative_light() -> None:
    """Rounding, or what a blur rings below zero, does not switch the limit off; none acts where a
    signed picture changes sign.
    """
    line = np.repeat([1000.0, 0.0], [60, 60])[:, None]
    line[60:64, 0] = -0.3, 0.1, -0.03, 0.01
    result = integrate_axis(line, 1.0, np.arange(60.0, 70.0, 0.25), np.arange(60.25, 70.1, 0.25), 0)
    assert result.min() >= -0.3 * 0.25 * (1 + 1e-9)  # the spline has -80
    assert result.sum() == pytest.approx(line[60:70].sum(), abs=1e-9)
    wave = np.sin(np.arange(150.0) * 2 * np.pi / 6 + 1e-3)[:, None]
    spline = by_scipy(wave, 5)
    np.testing.assert_allclose(
        integrate_axis(wave, 1.0, AT, AT + SIDE, 0), spline(AT + SIDE) - spline(AT), atol=1e-12
    )


@pytest.mark.parametrize("below_zero", [False, True])
def test_integrate_axis_decides_for_each_column(monkeypatch, below_zero):
    """An edge in one column, and light below zero in another, leave all others as they are; columns
    are asked for once.
    """
    picture, edges = smooth((30, 12)), np.arange(0.0, 29.0, 0.37)
    picture[7, 11] = 1e6
    if below_zero:
        picture[3, 5] = -0.1
    spline = by_scipy(picture, 5)
    plain = spline(edges + 0.3) - spline(edges)
    monkeypatch.setattr(integration, "STRIP_COLUMNS", 3)
    change = np.abs(integrate_axis(picture, 1.0, edges, edges + 0.3, 0) - plain).max(axis=0)
    assert change[:11].max() < (0.1 if below_zero else 1e-13)
    assert np.delete(change[:11], 5).max() < 1e-13
    assert change[11] > 1e3


@pytest.mark.parametrize("pitch_um", [0.6, 1.7, 4.1])
def test_charts_of_hard_edges_have_no_negative_electrons_and_all_of_their_light(
    pitch_um: float,
) -> None:
    """Checks, lines and points of 1000 : 0.001 in both directions, with photodiodes that fill their
    pixels.
    """
    rng = seeded(4)
    chart = np.where(rng.random((41, 41)) < 0.4, 1000.0, 0.001)
    chart[:, 10:20] = np.where(np.arange(10) % 2, 1000.0, 0.001)
    pixels = integrate_pixels(chart, 1.0, pitch_um, pitch_um)
    assert pixels.min() >= 0
    side = len(pixels) * pitch_um
    inside = np.clip(
        np.minimum(np.arange(1.0, 42.0), 20.5 + side / 2)
        - np.maximum(np.arange(41.0), 20.5 - side / 2),
        0,
        1,
    )
    # The pixels end within cells of the border, where light may lie anywhere.
    assert pixels.sum() == pytest.approx(
        inside @ chart @ inside, abs=(1 - inside[0]) * 82 * 1000.0 + 1e-6
    )


# --- Electrons ---


def test_mean_signal_rate_is_independent_of_oversampling():
    def picture(n: int) -> np.ndarray:
        y = cell_means(lambda x: x + 40 * np.sin(x / 100), n, DIE_UM)
        return y[:, None] * cell_means(lambda x: x - 25 * np.cos(x / 60), n, DIE_UM)

    rates = []
    for n in (256, 1024):
        irradiance = SpectralImage(
            NM, WIDTH_NM, DIE_UM / n, factors=([[1e-3, 2e-3, 4e-3]], [picture(n)])
        )
        rates.append(mean_signal_rate(irradiance, Camera(), derive(Pixel(pitch_um=9.1))))
    coarse, fine = rates
    assert coarse.shape == fine.shape == (298, 298)
    # Measured: the sum 1.2e-6, pixels 2.8e-5 of the mean, in the outermost rows 5.6e-4 (the
    # picture's slope is cut there).
    assert coarse.sum() == pytest.approx(fine.sum(), rel=1e-5)
    assert np.abs(coarse - fine)[3:-3, 3:-3].max() < 1e-4 * fine.mean()
    assert np.abs(coarse - fine).max() < 1e-3 * fine.mean()


@pytest.mark.parametrize("f_number", [1.0, 1.8, 8.0])
def test_diffracted_rate_grating_contrast_is_otf(f_number):
    """At 0.3 of 2 sin α/λ, with tan α = 1/(2 N (1 + |m|)): a cut-off of 2 tan α/λ would be 12 % off
    at f/1.
    """
    camera, wavelength_mm, n = Camera(f_number=f_number), 550e-6, 512
    sin_alpha = np.sin(np.arctan(1 / (2 * camera.working_f_number)))
    periods = 16
    pitch_um = 1e3 * periods / (0.3 * 2 * sin_alpha / wavelength_mm) / n
    cosine = np.cos(
        2 * np.pi * periods * (np.arange(n) + 0.5) / n
    )  # an even number of half periods: reflected smoothly
    light = SpectralImage(
        [550.0], 10.0, pitch_um, factors=([[1e-3]], [np.tile(1 + 0.5 * cosine, (4, 1))])
    )
    rate = integration.diffracted_rate(light, camera, derive(Pixel()))
    contrast = 2 * (rate * cosine).mean() / rate.mean() / 0.5
    otf = 2 / np.pi * (np.arccos(0.3) - 0.3 * np.sqrt(1 - 0.3**2))
    assert contrast == pytest.approx(otf, rel=1e-6)  # float32 pictures


def test_mean_signal_rate_factored_equals_general():
    rng = seeded(8)
    spectra, pictures = rng.uniform(1e-3, 4e-3, (2, 3)), rng.uniform(0.2, 1, (2, 48, 48))
    factored = SpectralImage(NM, WIDTH_NM, 4.0, factors=(spectra, pictures))
    general = SpectralImage(NM, WIDTH_NM, 4.0, data=np.einsum("rb,ryx->yxb", spectra, pictures))
    physics = derive(Pixel(pitch_um=8.0))
    one, other = (mean_signal_rate(image, Camera(), physics) for image in (factored, general))
    # Two convolutions with white-light OTFs against three with one band each; float32 and the OTF's
    # table.
    np.testing.assert_allclose(one, other, rtol=1e-6)


@pytest.mark.parametrize("diffraction", [True, False])
def test_mean_signal_rate_negative_factors_cancel(diffraction):
    rng = seeded(9)
    # Spectra as a fit of few pulses gives them: large, of both signs, while the light that they add
    # up to is positive.
    pictures = np.cumsum(rng.uniform(0.2, 1, (4, 48, 48)), axis=0) / 4
    spectra = np.linalg.inv(np.tril(np.ones((4, 4)))).T @ rng.uniform(1e-3, 4e-3, (4, 3))
    assert spectra.min() < -1e-3
    header = {"diffraction": diffraction}
    factored = SpectralImage(NM, WIDTH_NM, 4.0, factors=(spectra, pictures), header=header)
    assert factored.data.min() > 0
    general = SpectralImage(NM, WIDTH_NM, 4.0, data=factored.data, header=header)
    physics = derive(Pixel(pitch_um=8.0))
    one, other = (mean_signal_rate(image, Camera(), physics) for image in (factored, general))
    assert one.min() > 0
    # float32 of terms that cancel to a quarter, and the OTF's table.
    np.testing.assert_allclose(one, other, rtol=1e-5)
    unblurred = SpectralImage(
        NM, WIDTH_NM, 4.0, factors=(spectra, pictures), header={"diffraction": not diffraction}
    )
    assert (
        np.abs(mean_signal_rate(unblurred, Camera(), physics) / one - 1).max() > 1e-3
    )  # so diffraction does count


def per_joule(options: dict, nm: float, within: tuple | None = None) -> float:
    """Electrons s⁻¹ m⁻² of 1 W m⁻² in a band of 10 nm."""
    image = SpectralImage([nm], 10.0, 1.0, data=np.ones((1, 1, 1)), within=within)
    return (
        float(integration.electrons_per_joule(derive(Pixel(pitch_um=8.0, **options)), image)[0])
        / 10
    )


@pytest.mark.parametrize("laser_nm", [526.0, 532.0, 534.5])
@pytest.mark.parametrize("technology", ["0.35um", "4t-bsi"])
def test_electrons_per_joule_laser_off_band_centre(technology, laser_nm):
    physics, options = (
        derive(Pixel(pitch_um=8.0, technology=technology)),
        {"technology": technology},
    )
    exact = float(physics.quantum_efficiency(laser_nm)) * laser_nm * 1e-9 / (planck * light_speed)
    assert per_joule(options, 530.0, ([[laser_nm]], [[1.0]])) == pytest.approx(exact, rel=1e-6)
    # Without being told it is taken at the band's centre: 0.2 % and more off.
    centre = float(physics.quantum_efficiency(530.0)) * float(photons_per_joule(530.0))
    assert per_joule(options, 530.0) == pytest.approx(centre, rel=1e-6)
    assert abs(centre / exact - 1) > 2e-3


@pytest.mark.parametrize(
    ("cut_nm", "share"),
    [(640, 0.0), (645, 0.0), (646, 0.1), (650, 0.5), (653, 0.8), (655, 1.0), (700, 1.0)],
)
def test_electrons_per_joule_infrared_cut_inside_band(cut_nm, share):
    options = {"quantum_efficiency": 0.5, "infrared_cut_nm": cut_nm}
    # Light that is even over the band: at its centre, times the part below the cut.
    assert per_joule(options, 650.0) == pytest.approx(
        0.5 * share * 650e-9 / (planck * light_speed), rel=1e-12
    )
    # The same in ten parts: the photons of a joule at each.
    nodes = 645.5 + np.arange(10)
    expected = 0.5 * nodes[nodes < cut_nm].sum() / 10 * 1e-9 / (planck * light_speed)
    assert per_joule(options, 650.0, ([nodes], [np.full(10, 0.1)])) == pytest.approx(
        expected, rel=1e-12
    )


@pytest.mark.parametrize(("cut_nm", "below"), [(651.0, 1.0), (649.0, 0.0)])
def test_electrons_per_joule_infrared_cut_near_line(cut_nm, below):
    # A line at 650.0 in parts of 1 nm: a cut a nanometre beside it takes all of it or nothing.
    nodes = 645.5 + np.arange(10)
    nodes[5] = 650.0
    seen = per_joule(
        {"quantum_efficiency": 0.5, "infrared_cut_nm": cut_nm}, 650.0, ([nodes], [np.eye(10)[5]])
    )
    assert seen == pytest.approx(below * 0.5 * 650e-9 / (planck * light_speed), rel=1e-12)


def test_mean_signal_rate_sums_in_float64():
    nm = np.arange(405.0, 700.0, 10)
    data = np.random.default_rng(0).uniform(0.5, 1.5, (8, 8, nm.size)).astype(np.float32)
    image, physics = SpectralImage(nm, 10.0, 20.0, data=data), derive(Pixel(pitch_um=20.0))
    weight = integration.electrons_per_joule(physics, image) * 1e-12
    result = integration.ideal_rate(image, physics)
    assert result.dtype == np.float64
    np.testing.assert_allclose(
        result, [[math.fsum(weight * one) for one in row] for row in data.astype(float)], rtol=1e-14
    )


def test_integrate_pixels_smaller_array_is_centred() -> None:
    """Nine rows on a picture of ten: a linear rise is exact under the spline, so each row has the
    value at its centre.
    """
    rise = np.tile(np.arange(10.0)[:, None] + 0.5, (1, 12))
    pixels = integrate_pixels(rise, 1.0, 1.0, 1.0, size_um=(9.0, 12.0))
    np.testing.assert_allclose(pixels, np.tile(np.arange(1.0, 10.0)[:, None], (1, 12)), rtol=1e-12)


@pytest.mark.parametrize(
    ("die_height_mm", "rows"), [(None, 10), (0.009, 9), (0.0095, 9), (0.02, 10)]
)
def test_capture_beyond_the_die_has_pixels_of_the_die(
    die_height_mm: float | None, rows: int
) -> None:
    """A film of whole samples may end beyond the die; a smaller picture has fewer pixels than the
    die.
    """
    camera = Camera(
        die_mm=0.012, die_height_mm=die_height_mm, focal_length_mm=0.05, object_distance_m=1.0
    )
    light = SpectralImage([550.0], 10.0, 1.0, data=np.ones((10, 12, 1), np.float32))
    physics = derive(Pixel(technology="4t-bsi", pitch_um=1.0))
    assert mean_signal_rate(light, camera, physics).shape == (rows, 12)


def test_each_colour_is_blurred_by_the_psf_of_its_own_light() -> None:
    """A point through a singlet as three channels see it, against the PSFs of all bands by the
    shares of each channel.
    """
    nm, cells, pitch_um = np.arange(420.0, 661.0, 20.0), 33, 12.0
    camera = camera_with_lens(
        Camera(die_mm=3.0, object_distance_m=5.0),
        CameraOptions(f_number=8.0),
        LensOptions(file="singlet", focal_length_mm=20.0),
    )
    channels = [np.exp(-(((nm - middle) / 35) ** 2)) for middle in (460.0, 540.0, 610.0)]
    tiling = Tiling(400.0, cells * pitch_um, 0.0, wavelengths=6, nodes=9)
    picture, place = np.zeros((129, 129), np.float32), (92, 32)
    picture[place] = 1.0
    image = SpectralImage(nm, 20.0, pitch_um, factors=(np.ones((1, nm.size)), picture[None]))
    at_um = [(place[axis] - 64) * pitch_um for axis in (1, 0)]
    fronts = fitted_wavefronts(camera, tuple(nm.tolist()), tiling.nodes)
    single = [
        point_spread(ChannelWavefronts([front], np.ones(1)), *at_um, pitch_um, cells).kernel
        for front in fronts
    ]
    around = tuple(slice(middle - cells // 2, middle + cells // 2 + 1) for middle in place)
    found = []
    for weight in channels:
        right = sum(share * psf for share, psf in zip(weight / weight.sum(), single, strict=True))
        found.append(real_lens_rate(image, camera, tiling, weight, None)[around] / weight.sum())
        assert np.linalg.norm(found[-1] - right) < 0.03 * np.linalg.norm(right)
    assert np.linalg.norm(found[0] - found[2]) > 0.3 * np.linalg.norm(found[2])
