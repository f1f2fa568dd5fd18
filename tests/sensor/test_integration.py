"""Light to mean electrons: integration over photodiodes, its spline and strips, where pixels lie,
and the spectrum of the light.

Conservation and closed forms at the extremes of pitch and size: pixsim.verification.extreme_cases.
"""

import math
from collections.abc import Callable

import numpy as np
import pytest
from helpers.claims import Claim, check
from helpers.statistics import seeded
from scipy.constants import c as light_speed, h as planck
from scipy.interpolate import BSpline, make_interp_spline

from pixsim import Camera, Pixel, SpectralImage
from pixsim.sensor import integration
from pixsim.sensor.integration import (
    any_hard_edge,
    first_edge_um,
    integrate_axis,
    integrate_pixels,
    limit_overshoot,
    mean_signal_rate,
    pixel_count,
    ringing_cells,
    running_integral,
)
from pixsim.sensor.pixel import derive

DIE_UM = 2713.6
HALVES = np.array([1.5, 2.5, 3.5])
NM = np.array([420.0, 530.0, 660.0])
WIDTH_NM = np.array([40.0, 60.0, 50.0])


def cell_means(antiderivative: Callable, n: int, length: float) -> np.ndarray:
    """Exact means of a function over n equal cells of [0, length]."""
    return np.asarray(np.diff(antiderivative(np.linspace(0, length, n + 1))) * n / length)


def spline_of(samples: np.ndarray, degree: int = 5) -> BSpline:
    """Running integral of samples (n, columns) by SciPy."""
    running = np.concatenate([np.zeros((1, samples.shape[1])), np.cumsum(samples, axis=0)])
    return make_interp_spline(np.arange(len(samples) + 1.0), running, k=degree, axis=0)


def rising(x):
    """Antiderivative of a smooth function, whose spline errs by 1.3e-10."""
    return 3 * x - 10 * np.cos(x / 10 + 0.4)


def grating_contrast(f_number: float) -> float:
    """Of a grating at 0.3 of 2 sin α/λ behind a lens, with tan α = 1/(2 N (1 + |m|)); an even number
    of half periods is reflected smoothly.
    """
    camera = Camera(f_number=f_number)
    sin_alpha = math.sin(math.atan(1 / (2 * camera.working_f_number)))
    pitch_um = 1e3 * 16 / (0.3 * 2 * sin_alpha / 550e-6) / 512
    cosine = np.cos(2 * np.pi * 16 * (np.arange(512) + 0.5) / 512)
    factors = [[1e-3]], [np.tile(1 + 0.5 * cosine, (4, 1))]
    light = SpectralImage([550.0], 10.0, pitch_um, factors=factors)
    rate = integration.diffracted_rate(light, camera, derive(Pixel()))
    return float(2 * (rate * cosine).mean() / rate.mean() / 0.5)


def limited_crests(low: np.ndarray) -> np.ndarray:
    """Integrals over 0.2 of a sinusoid of 5 samples a period with troughs at zero, limited."""
    waves = cell_means(lambda x: x - np.cos(OMEGA * x) / OMEGA, 200, 200.0)[:, None]
    edges = np.concatenate([low, low + 0.2])
    return np.diff(np.split(limit_overshoot(spline_of(waves)(edges), waves, edges), 2), axis=0)[
        0, :, 0
    ]


OMEGA = 2 * np.pi / 5
CRESTS = np.arange(20.0, 180.0, 0.37)
EDGE = np.repeat([[1000.0], [1.0]], 5, axis=0) * np.ones(8)
STEEP = np.exp(np.linspace(0, 7 * np.log(10), 200))[:, None] * np.ones(8)
PHOTODIODES = [
    # Of cells of 1, 1, 1, 5, 5, 5 at half of the third to the fifth: light of a cell of 1 beside 5
    # is 0 to 7, and half of the cell above it holds at most all, of a cell of 5 between 1.5 and 3.5.
    Claim(
        "an overshoot is limited to half of the range of a cell and its neighbours beyond that range",
        lambda: [
            limit_overshoot(np.full((3, 1), running), np.repeat([[1.0], [5.0]], 3, axis=0), HALVES)[
                :, 0
            ]
            for running in (-100.0, 100.0)
        ],
        [[1.5, 2.0, 4.5], [1.5, 3.0, 6.5]],
    ),
    *(
        Claim(
            f"pixels of {pitch_um:g} µm are centred and conserve light",
            lambda pitch_um=pitch_um: integrate_pixels(
                np.tile(cell_means(rising, 60, 60.0), (60, 1)), 1.0, pitch_um, pitch_um
            ).sum(axis=1),
            np.full(
                int(60 / pitch_um),
                pitch_um
                * np.diff(rising(30 + int(60 / pitch_um) * pitch_um / 2 * np.array([-1, 1])))[0],
            ),
            rtol=1e-9,
            why="the spline; half a sample off centre gives 8e-4",
        )
        for pitch_um in (np.pi, 3.1, 0.77)
    ),
    *(
        Claim(
            f"a picture of {samples.shape} in thirds conserves light",
            lambda samples=samples: (
                integrate_pixels(samples, 1.0, 1 / 3, 1 / 3)
                .reshape(samples.shape[0], 3, samples.shape[1], 3)
                .sum(axis=(1, 3))
            ),
            samples,
            rtol=1e-13,
        )
        for samples in (
            seeded(0).uniform(0.5, 1.5, shape) for shape in ((1, 1), (1, 9), (9, 1), (2, 3))
        )
    ),
    *(
        Claim(
            f"the contrast of a grating at f/{f_number:g} is the OTF of the lens",
            lambda f_number=f_number: grating_contrast(f_number),
            2 / math.pi * (math.acos(0.3) - 0.3 * math.sqrt(1 - 0.3**2)),
            rtol=1e-6,
            why="float32; a cut-off of 2 tan α/λ would be 12 % off at f/1",
        )
        for f_number in (1.0, 8.0)
    ),
    # 1e7 times over 200 samples; neighbours differ by 8 %.
    Claim(
        "integrals both ways are exact beside light that is much brighter",
        lambda: integrate_pixels(STEEP, 1.0, 1.0, 1.0, running_integral(STEEP)),
        STEEP,
        rtol=1e-12,
    ),
    Claim(
        "a hard edge is a ratio of neighbours above 100",
        lambda: [any_hard_edge(np.array([[10.0], [1.0], [ratio]])) for ratio in (99.0, 101.0)],
        [0, 1],
    ),
    Claim(
        "a picture with a hard edge down or across has splines of its columns alone",
        lambda: [
            running_integral(samples).both_ways
            for samples in (EDGE, EDGE.T, np.minimum(EDGE, 50.0), np.minimum(EDGE, 50.0).T)
        ],
        [0, 0, 1, 1],
    ),
    # 999/10 · 0.43^n above 1e-5 of 1000 and of 1.
    Claim(
        "cells that ring above 1e-5 of the bright and of the dark side of an edge",
        lambda: np.sum(
            np.split(ringing_cells(np.repeat([[1000.0], [1.0]], 40, axis=0)), 2), axis=(1, 2)
        ),
        [math.ceil(math.log(share / 99.9) / math.log(0.43)) for share in (1e-2, 1e-5)],
    ),
    Claim(
        "the limit keeps resolved crests",
        lambda: limited_crests(CRESTS),
        0.2 - (np.cos(OMEGA * (CRESTS + 0.2)) - np.cos(OMEGA * CRESTS)) / OMEGA,
        atol=4e-4,
        why="0.1 % of a crest; without room for crests the limit would cut 12 %",
    ),
]

# --- Photodiodes


@pytest.mark.parametrize(
    ("frequency_lp_per_mm", "tolerance"), [(5.0, 1e-5), (33.333, 1e-5), (60.0, 3e-4)]
)
@pytest.mark.parametrize(
    ("pitch_um", "fill_factor"), [(5.3, 0.05), (6.5, 0.31), (7.77, 1.0), (15.0, 0.73)]
)
def test_contrast_of_a_wave_is_the_sinc_of_the_photodiode(
    frequency_lp_per_mm: float, tolerance: float, pitch_um: float, fill_factor: float
) -> None:
    """Measured: at 60 lp/mm 0.022 % for the 1.2 µm photodiode. A cubic spline errs by 0.55 %, plain
    area weights by 15 %.
    """
    omega = 2e-3 * np.pi * frequency_lp_per_mm
    side_um = pitch_um * math.sqrt(fill_factor)
    line = cell_means(lambda x: x - 0.5 / omega * np.cos(omega * x + 0.3), 1024, DIE_UM)
    pixels = integrate_pixels(np.tile(line, (8, 1)), DIE_UM / 1024, pitch_um, side_um)[0]
    x = DIE_UM / 2 + (np.arange(pixels.size) - (pixels.size - 1) / 2) * pitch_um
    sinc = np.sinc(frequency_lp_per_mm * side_um * 1e-3)
    expected = side_um**2 * (1 + 0.5 * sinc * np.sin(omega * x + 0.3))
    inside = slice(3, -3)
    check(
        "pixels",
        pixels[inside],
        expected[inside],
        atol=0.5 * side_um**2 * tolerance,
        why="the spline",
    )


# --- The spline, in strips


def smooth(shape: tuple[int, int], seed: int = 1) -> np.ndarray:
    return 1 + np.cumsum(seeded(seed).uniform(-0.01, 0.01, shape), axis=1)


SMOOTH = smooth((33, 50))
STARS = smooth((30, 41))
STARS[7, 5] = 1e6
STARS[12:20, 11] = 1e-9


@pytest.mark.parametrize("samples", [SMOOTH, STARS, SMOOTH.astype(np.float32)])
@pytest.mark.parametrize(("pitch_um", "side_um"), [(0.7, 0.5), (3.1, 3.1)])
def test_strips_and_stored_integrals_change_nothing(
    monkeypatch: pytest.MonkeyPatch, samples: np.ndarray, pitch_um: float, side_um: float
) -> None:
    whole = integrate_pixels(samples.astype(float), 1.0, pitch_um, side_um)
    assert running_integral(samples).both_ways == (samples is not STARS)
    for columns in (integration.STRIP_COLUMNS, 3):
        monkeypatch.setattr(integration, "STRIP_COLUMNS", columns)
        for running in (None, running_integral(samples)):
            pixels = integrate_pixels(samples, 1.0, pitch_um, side_um, running)
            np.testing.assert_allclose(pixels, whole, rtol=0, atol=1e-13 * whole.max())


# --- High-contrast edges


@pytest.mark.parametrize("contrast", [1e3, 1e10])
@pytest.mark.parametrize("side_um", [0.3, 1.0, 2.3])
def test_hard_edge_does_not_ring(contrast: float, side_um: float) -> None:
    """Beyond the cell behind the edge each side has its own light: 1e-5 of a cell's is left,
    1.6e-5 of a small photodiode's, and 80 eps of the bright half.
    """
    line = np.repeat([1.0, 1 / contrast], [40, 40]) * np.ones((3, 1))
    low = np.arange(0.05, 80 - side_um, side_um)
    integrals = integrate_axis(line, 1.0, low, low + side_um, 1)
    assert integrals.min() >= 0
    rounding = 40 * 80 * 2.2e-16
    np.testing.assert_allclose(integrals[:, low > 41], side_um / contrast, rtol=2e-5, atol=rounding)
    np.testing.assert_allclose(integrals[:, low + side_um < 39], side_um, rtol=2e-5)


@pytest.mark.parametrize("pitch_um", [0.6, 1.7, 4.1])
def test_charts_of_hard_edges_have_no_negative_electrons_and_all_of_their_light(
    pitch_um: float,
) -> None:
    """Checks, lines and points of 1000 : 0.001 in both directions, with photodiodes that fill their
    pixels; these end within cells of the border, where light may lie anywhere.
    """
    samples = np.where(seeded(4).random((41, 41)) < 0.4, 1000.0, 0.001)
    samples[:, 10:20] = np.where(np.arange(10) % 2, 1000.0, 0.001)
    pixels = integrate_pixels(samples, 1.0, pitch_um, pitch_um)
    assert pixels.min() >= 0
    half = len(pixels) * pitch_um / 2
    covered = np.minimum(np.arange(1.0, 42.0), 20.5 + half) - np.maximum(
        np.arange(41.0), 20.5 - half
    )
    inside = np.clip(covered, 0, 1)
    assert pixels.sum() == pytest.approx(
        inside @ samples @ inside, abs=(1 - inside[0]) * 82 * 1000.0 + 1e-6
    )


# Where photodiodes begin, around an edge at 50; under smaller ones 10 : 1 rings below zero.
LOW = np.arange(40.0, 60.0, 0.37)
SIDE = 1.3


def edge_of_ten(patch: tuple[float, ...] = (), at: int = 0) -> np.ndarray:
    """A line with an edge of 10 : 1 at 50, and fine detail, with other light from a sample on."""
    line = np.where(np.arange(150) < 50, 10.0, 1.0) * np.tile([1.0, 1.1, 0.9], 50)
    line[at : at + len(patch)] = patch
    return line[:, None]


@pytest.mark.parametrize("patch", [(1000.0, 0.001) * 4, (0.0, 1e6), (-3.0, 1000.0, 0.001)])
def test_what_is_far_away_does_not_change_an_edge(patch: tuple[float, ...]) -> None:
    """In the same line, 40 cells away, the spline has 1e-14 of it; in another column nothing, to
    the bit. Limited everywhere, an edge of 10 : 1 would move by 1.6 %.
    """
    alone = integrate_axis(edge_of_ten(), 1.0, LOW, LOW + SIDE, 0)
    spline = spline_of(edge_of_ten())
    np.testing.assert_allclose(alone, spline(LOW + SIDE) - spline(LOW), atol=1e-12)
    np.testing.assert_allclose(
        integrate_axis(edge_of_ten(patch, 100), 1.0, LOW, LOW + SIDE, 0),
        alone,
        rtol=0,
        atol=1e-9 * 9 * SIDE,
    )
    columns = np.hstack([edge_of_ten(), edge_of_ten(patch, 45)])
    both = integrate_axis(columns, 1.0, LOW, LOW + SIDE, 0)
    np.testing.assert_array_equal(both[:, :1], alone)
    assert both[:, 1].min() >= min(0.0, *patch)


def test_ringing_cells_reach_as_far_as_the_ring_shows() -> None:
    """Where the limit stops, the spline of the edge is off by 1e-5 of the light or less; it does
    not stop far beyond.
    """
    line = np.repeat([1000.0, 1.0], [60, 60])[:, None]
    rings = ringing_cells(line)[:, 0]
    part = np.linspace(0.0, 1.0, 21)
    spline = spline_of(line)
    moved = spline(np.arange(120)[:, None] + part)[..., 0] - spline(np.arange(120.0)) - part * line
    worst = np.abs(moved).max(axis=1) / line[:, 0]
    assert worst[~rings].max() < 1e-5
    assert worst[rings].min() > 1e-6
    assert np.array_equal(ringing_cells(line[::-1])[::-1, 0], rings)
    assert not ringing_cells(np.repeat([90.0, 1.0], [60, 60])[:, None]).any()


def test_limit_acts_at_an_edge_beside_a_little_negative_light() -> None:
    """Rounding, or what a blur rings below zero, does not switch the limit off (the spline has
    -80); none acts where a signed picture changes sign.
    """
    line = np.repeat([1000.0, 0.0], [60, 60])[:, None]
    line[60:64, 0] = -0.3, 0.1, -0.03, 0.01
    low = np.arange(60.0, 70.0, 0.25)
    integrals = integrate_axis(line, 1.0, low, low + 0.25, 0)
    assert integrals.min() >= -0.3 * 0.25 * (1 + 1e-9)
    assert integrals.sum() == pytest.approx(line[60:70].sum(), abs=1e-9)
    wave = np.sin(np.arange(150.0) * 2 * np.pi / 6 + 1e-3)[:, None]
    expected = spline_of(wave)(LOW + SIDE) - spline_of(wave)(LOW)
    np.testing.assert_allclose(integrate_axis(wave, 1.0, LOW, LOW + SIDE, 0), expected, atol=1e-12)


# --- Where pixels lie


@pytest.mark.parametrize("registration", [0.0, 0.25, 0.5, 0.5 + 1e-9, 0.75, 0.999])
def test_a_pixel_border_lies_at_the_registration_from_the_centre(registration: float) -> None:
    """And as many whole pixels as fit are on each side, for even and odd numbers of them."""
    for length_um in seeded(1).uniform(5.0, 100.0, 50).tolist():
        count = pixel_count(length_um, 3.7, registration)
        first_um = first_edge_um(length_um, count, 3.7, registration)
        borders = (first_um - length_um / 2) / 3.7 - registration
        assert borders == pytest.approx(round(borders), abs=1e-9)
        uncovered_um = np.array([first_um, length_um - first_um - count * 3.7])
        assert -1e-9 <= uncovered_um.min() <= uncovered_um.max() < 3.7


def waves(x: np.ndarray) -> np.ndarray:
    """Running integral of light that waves with a period of 23 µm."""
    return 3 * x - 20 / np.pi * np.cos(2 * np.pi * x / 23.0 + 0.4)


@pytest.mark.parametrize(
    "colour",
    [None, {"pattern": "rggb", "sensitivities": "Nikon_D5100", "peak_quantum_efficiency": 0.5}],
)
def test_signal_is_the_light_at_the_registered_places(colour: dict | None) -> None:
    """The pixels' own intervals of the running integral, in the ratio of their light, which is the
    same for all pixels of a channel; 0.01 pixel off gives 1e-3.
    """
    borders = np.linspace(0.0, 120.0, 161)
    plane = np.outer(2 * np.diff(waves(borders / 2)), np.diff(waves(borders)))
    image = SpectralImage([550.0], 10.0, 0.75, data=plane[..., None], header={"diffraction": False})
    options = {"pitch_um": 6.5, "infrared_cut_nm": 700.0, "colour": colour}
    physics = derive(Pixel(**options, registration=(0.3, 0.8)))
    signal = mean_signal_rate(image, Camera(die_mm=0.12), physics)
    assert signal.shape == (18, 17)  # on either side of the centre 10 and 8, 9 and 8
    half = physics.photodiode_side_um / 2
    y = 60 + 6.5 * (0.8 + np.arange(-10, 8) + 0.5)
    x = 60 + 6.5 * (0.3 + np.arange(-9, 8) + 0.5)
    down = 2 * (waves((y + half) / 2) - waves((y - half) / 2))
    ratio = signal / np.outer(down, waves(x + half) - waves(x - half))
    for row, column in np.ndindex(2, 2):
        channel = ratio[row::2, column::2]
        np.testing.assert_allclose(channel, channel[0, 0], rtol=1e-6)


# --- Electrons


@pytest.mark.parametrize("diffraction", [True, False])
def test_factors_of_both_signs_give_the_electrons_of_their_bands(diffraction: bool) -> None:
    """Spectra as a fit of few pulses gives them, while the light that they add up to is positive:
    float32 of terms that cancel to a quarter, and the OTF's table.
    """
    pictures = np.cumsum(seeded(9).uniform(0.2, 1, (4, 48, 48)), axis=0) / 4
    spectra = np.linalg.inv(np.tril(np.ones((4, 4)))).T @ seeded(8).uniform(1e-3, 4e-3, (4, 3))
    assert spectra.min() < -1e-3
    header = {"diffraction": diffraction}
    factored = SpectralImage(NM, WIDTH_NM, 4.0, factors=(spectra, pictures), header=header)
    general = SpectralImage(NM, WIDTH_NM, 4.0, data=factored.data, header=header)
    physics = derive(Pixel(pitch_um=8.0))
    rates = [mean_signal_rate(image, Camera(), physics) for image in (factored, general)]
    np.testing.assert_allclose(*rates, rtol=1e-5)
    general.header["diffraction"] = not diffraction
    assert np.abs(mean_signal_rate(general, Camera(), physics) / rates[1] - 1).max() > 1e-3


def per_joule(nm: float, within=None, **options) -> float:
    """Electrons of a joule of light in a band of 10 nm."""
    image = SpectralImage([nm], 10.0, 1.0, data=np.ones((1, 1, 1)), within=within)
    physics = derive(Pixel(pitch_um=8.0, **options))
    return float(integration.electrons_per_joule(physics, image)[0]) / 10


def electrons(efficiency: float, nm) -> float:
    return float(np.sum(efficiency * np.asarray(nm) * 1e-9 / (planck * light_speed)))


NODES_NM = 645.5 + np.arange(10.0)
LINE_NM = np.where(np.arange(10) == 5, 650.0, NODES_NM)
SAMPLES = SpectralImage(
    np.arange(405.0, 700.0, 10),
    10.0,
    20.0,
    data=seeded(0).uniform(0.5, 1.5, (4, 4, 30)).astype(np.float32),
)
WEIGHT = integration.electrons_per_joule(derive(Pixel(pitch_um=20.0)), SAMPLES) * 1e-12
ENDS = np.sort(seeded(2).uniform(0, 1, 50))
BANDS = [
    *(
        Claim(
            f"the spline of {n} samples is SciPy's",
            lambda n=n: integrate_axis(smooth((n, 3)), 1.0, n * ENDS[:25], n * ENDS[25:], 0),
            spline_of(smooth((n, 3)), degree)(n * ENDS[25:])
            - spline_of(smooth((n, 3)), degree)(n * ENDS[:25]),
            atol=4e-15 * n,
        )
        for n, degree in ((1, 1), (2, 1), (3, 3), (4, 3), (5, 5), (6, 5), (301, 5))
    ),
    *(
        Claim(
            f"a laser at {nm:g} nm, beside the centre of its band, {technology}",
            lambda nm=nm, technology=technology: per_joule(
                530.0, ([[nm]], [[1.0]]), technology=technology
            ),
            electrons(derive(Pixel(technology=technology)).quantum_efficiency(nm), nm),
            rtol=1e-6,
        )
        for technology in ("0.35um", "4t-bsi")
        for nm in (526.0, 534.5)
    ),
    *(
        Claim(
            f"light that fills its band, cut at {cut_nm:g} nm",
            lambda cut_nm=cut_nm: per_joule(650.0, quantum_efficiency=0.5, infrared_cut_nm=cut_nm),
            electrons(0.5 * share, 650.0),
            rtol=1e-12,
        )
        for cut_nm, share in ((640, 0.0), (646, 0.1), (653, 0.8), (655, 1.0), (700, 1.0))
    ),
    *(
        Claim(
            f"the same in ten parts, cut at {cut_nm:g} nm",
            lambda cut_nm=cut_nm: per_joule(
                650.0,
                ([NODES_NM], [np.full(10, 0.1)]),
                quantum_efficiency=0.5,
                infrared_cut_nm=cut_nm,
            ),
            electrons(0.05, NODES_NM[cut_nm > NODES_NM]),
            rtol=1e-12,
        )
        for cut_nm in (646, 653)
    ),
    *(
        Claim(
            f"a line at 650 nm, cut at {cut_nm:g} nm",
            lambda cut_nm=cut_nm: per_joule(
                650.0, ([LINE_NM], [np.eye(10)[5]]), quantum_efficiency=0.5, infrared_cut_nm=cut_nm
            ),
            electrons(0.5 * below, 650.0),
            rtol=1e-12,
        )
        for cut_nm, below in ((651, 1.0), (649, 0.0))
    ),
    Claim(
        "a picture has a blur of its own where its spectrum meets a response",
        lambda: [
            weight
            for _, weight, _ in integration._blurred_lights(
                SpectralImage(
                    [500.0, 600.0],
                    10.0,
                    1.0,
                    factors=([[0.0, 2.0], [3.0, 0.0]], np.ones((2, 4, 4))),
                ),
                np.array([0.0, 5.0]),
                np.ones(2),
                integration.Tiling(400.0, 0.0, 0.0),
            )
        ],
        [[0.0, 10.0]],
    ),
    Claim(
        "samples are summed in float64",
        lambda: integration.ideal_rate(SAMPLES, derive(Pixel(pitch_um=20.0))),
        [[math.fsum(WEIGHT * sample) for sample in row] for row in SAMPLES.data.astype(float)],
        rtol=1e-14,
    ),
    Claim(
        "a border at the centre of an even number of pixels is the centred array, to the bit",
        lambda: mean_signal_rate(
            SAMPLES, Camera(die_mm=0.08), derive(Pixel(pitch_um=20.0, registration=(0.0, 0.0)))
        ),
        mean_signal_rate(SAMPLES, Camera(die_mm=0.08), derive(Pixel(pitch_um=20.0))),
    ),
    Claim(
        "nine rows on a picture of ten are centred: a rise has the value at their centres",
        lambda: integrate_pixels(
            np.tile(np.arange(10.0)[:, None] + 0.5, (1, 12)), 1.0, 1.0, 1.0, size_um=(9.0, 12.0)
        ),
        np.tile(np.arange(1.0, 10.0)[:, None], (1, 12)),
        rtol=1e-12,
    ),
    *(
        Claim(
            f"rows of a film of 10 µm on a die of {height_mm} mm",
            lambda height_mm=height_mm: (
                mean_signal_rate(
                    SpectralImage([550.0], 10.0, 1.0, data=np.ones((10, 12, 1))),
                    Camera(
                        die_mm=0.012,
                        die_height_mm=height_mm,
                        focal_length_mm=0.05,
                        object_distance_m=1.0,
                    ),
                    derive(Pixel(technology="4t-bsi", pitch_um=1.0)),
                ).shape
            ),
            (rows, 12),
        )
        for height_mm, rows in ((None, 10), (0.0095, 9), (0.02, 10))
    ),
]


@pytest.mark.parametrize("claim", PHOTODIODES + BANDS, ids=str)
def test_closed_forms_of_integration(claim: Claim) -> None:
    claim.check()
