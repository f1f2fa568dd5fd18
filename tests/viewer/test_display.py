"""The display from electrons to displayed luminance: scale, rasters, means over dots, codes; the
white of a scene that states none, and dark pixels that are clipped at 0 DN; and limits of the whole score.
"""

import math
import warnings

import numpy as np
import pytest
from helpers.chains import imaging, imaging_chain
from helpers.claims import Claim
from hypothesis import given, settings, strategies as st

from pixsim import (
    Camera,
    Display,
    Exposure,
    Pixel,
    SpectralImage,
    evaluate,
    read_irradiance,
    run,
    write_npz,
)
from pixsim.light.spectral import DIFFUSER, DIFFUSER_W, d65
from pixsim.optics import irradiance_factor
from pixsim.optics.diffraction import square_aperture_mtf
from pixsim.sensor.integration import mean_signal_rate
from pixsim.sensor.pixel import derive
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import Frame, read_out, sample_sensor
from pixsim.viewer import display as displays, screen
from pixsim.viewer.dark_clip import clip_note, clips_dark, dark_clip

NM = np.arange(400.0, 721.0, 10)
DIE_UM = 678.4  # 128 dots of 5.3 µm
DISPLAY = Display(dots=128)
CAMERA = Camera(die_mm=1e-3 * DIE_UM)
REPEATABLE = settings(derandomize=True, database=None, deadline=None, max_examples=15)


def light(picture: np.ndarray, camera: Camera = CAMERA, **header) -> SpectralImage:
    """Return light of D65 from a chart of 1000 cd/m² at 1: E = L τ π/(1 + 4N²(1 + m)²)."""
    unit = SpectralImage(NM, 10.0, 1.0, factors=(d65(NM), np.ones((1, 1, 1))))
    f_number = camera.f_number * (1 + camera.magnification)
    white_lx = 1000.0 * camera.transmittance * np.pi / (1 + 4 * f_number**2)
    spectrum = d65(NM) * white_lx / unit.illuminance_lx()[0, 0]
    header = {"luminance_cd_per_m2": 1000.0} | header
    return SpectralImage(
        NM,
        10.0,
        1e3 * camera.die_mm / picture.shape[1],
        factors=(spectrum, picture[None]),
        header=header,
    )


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
    return displays.frame_luminance(
        noise_free(electrons, pitch_um), size_um, 1000.0, display, edges_um
    )


def ideal_on_dots(
    irradiance: SpectralImage, display: Display = DISPLAY, border_um: float = 0.0
) -> np.ndarray:
    edges_um = displays.dot_edges_um((DIE_UM, DIE_UM), 6.5, display, border_um)
    return displays.ideal_luminance(imaging(CAMERA, Pixel(), display=display), irradiance, edges_um)


HALF = np.random.default_rng(2).uniform(100, 1000, (64, 128))
SQUARE = np.random.default_rng(3).uniform(100, 1000, (256, 256))
NEAREST = Display(dots=128, interpolation="nearest")
PIXEL_DOTS = Display(raster="one_to_one")
HALF_UM = DIE_UM / 2, DIE_UM
NOISE = 1000 + 50 * np.random.default_rng(4).standard_normal((256, 256))
# Least light of each code of 8 bits, by the gamma of 2.2.
BORDERS = ((np.arange(255) + 0.5) / 255) ** 2.2
CLAIMS = [
    *(
        Claim(
            f"nothing is clipped without noise below 0, {name}",
            lambda fields=fields: (
                dark_clip(readout_of(fields), TIME_S, 1e4)["too_bright_e"]
                + clips_dark(dark_clip(readout_of(fields), TIME_S, 1e4))
            ),
            0.0,
            atol=1e-9,
        )
        for name, fields in {
            "no noise": {"read_noise_e": 0},
            "DSNU": {"read_noise_e": 0, "dark_current_e_per_s": 1e5, "dsnu": 1.0},
            "noise 30 σ above 0": {"read_noise_e": 10, "dark_current_e_per_s": 1e4, "dsnu": 0},
            "nothing varies": {"read_noise_e": 0, "dark_current_e_per_s": 0},
        }.items()
    ),
    Claim(
        "bins of light without a border of codes have one code, the others are searched",
        lambda: np.flatnonzero(np.isnan(displays._light_of_bins(2.2, 255, False))),
        np.unique((BORDERS * (displays._light_of_bins(2.2, 255, False).size - 1)).astype(int)),
    ),
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
    *(
        Claim(
            f"codes of 31 bits of {dn_per_e:g} DN/e-, and {dark_e:g} e-, fit float32 or not",
            lambda dn_per_e=dn_per_e, dark_e=dark_e: displays.fits_single(
                Frame(np.zeros((1, 1)), np.zeros((1, 1)), 1.0, dn_per_e, 64, dark_e, 5.3, 31, 0.0),
                1.0,
            ),
            fits,
        )
        for dn_per_e, dark_e, fits in ((1e3, 0.0, 1), (1e-22, 0.0, 0), (1e3, 2e30, 0))
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
    luminance = displays.frame_luminance(
        noise_free(electrons, 10.6, dark_e=12.3), (DIE_UM, DIE_UM), white_e, DISPLAY, edges_um
    )
    np.testing.assert_allclose(luminance, 1.0, rtol=2e-6)
    np.testing.assert_allclose(displays.ideal_luminance(view, irradiance, edges_um), 1.0, rtol=1e-6)


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


@pytest.mark.parametrize("interpolation", ["nearest", "linear", "cubic", "quintic"])
@pytest.mark.parametrize(("pitch_um", "share"), [(6.5, 0.8), (15.0, 0.5)])
def test_interpolation_mtf_is_the_contrast_of_gratings(
    interpolation: str, pitch_um: float, share: float
) -> None:
    """At shares of the Nyquist frequency: amplitudes on the dots over those on the pixels.

    A mean over eight phases cancels images of the spectrum that fall close by on the raster: up to
    2e-4 is left.
    """
    die_um = 2713.6
    display = Display(dots=512).model_copy(update={"interpolation": interpolation})
    count = int(die_um / pitch_um * (1 + 1e-9))
    x_um = (np.arange(count) - (count - 1) / 2) * pitch_um
    dots_um = ((np.arange(512) + 0.5) / 512 - 0.5) * die_um
    window = np.sin(np.pi * (np.arange(512) + 0.5) / 512) ** 4  # without borders and mean
    frequency_cy_per_mm = share * 500 / pitch_um
    rad_per_um = 2e-3 * np.pi * frequency_cy_per_mm
    amplitudes = []
    for phase in np.arange(8) * np.pi / 4:
        electrons = np.tile(1000.0 + 500.0 * np.cos(rad_per_um * x_um + phase), (8, 1))
        luminance = on_dots(electrons, pitch_um, display, (8 * pitch_um, die_um))[0]
        wave = np.exp(-1j * (rad_per_um * dots_um + phase))
        amplitudes.append(4 * (window * (luminance - 1) * wave).sum() / window.sum())
    mtf = displays.interpolation_mtf(frequency_cy_per_mm, pitch_um, interpolation)
    expected = float(mtf * square_aperture_mtf(frequency_cy_per_mm, die_um / 512))
    assert np.abs(np.mean(amplitudes)) == pytest.approx(expected, abs=5e-4)


@pytest.mark.parametrize(("samples", "atol"), [(256, 1e-7), (200, 1e-5)])
def test_ideal_picture_is_the_mean_over_dots(samples: int, atol: float) -> None:
    """Of 300 + 100 sin(x/20): to float32 for dots of whole samples, else to the quintic spline."""

    def integral(x_um: np.ndarray) -> np.ndarray:
        return 300 * x_um - 2000 * np.cos(x_um / 20)

    edges_um = np.linspace(0, DIE_UM, samples + 1)
    means = np.diff(integral(edges_um)) / np.diff(edges_um)
    dots_um = np.linspace(0, DIE_UM, 129)
    np.testing.assert_allclose(
        ideal_on_dots(light(np.tile(means, (samples, 1)) / 500)),
        np.tile(np.diff(integral(dots_um)) / np.diff(dots_um) / 500, (128, 1)),
        atol=atol,
    )


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
        assert mean * (high - low) == pytest.approx(float(heights @ np.diff(places)), abs=1e-12)


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
    expected = (np.rint(np.clip(luminance, 0.0, 1.0) ** (1 / gamma) * top) / top) ** gamma
    np.testing.assert_array_equal(
        displays.shown_luminance(luminance, Display(gamma=gamma, bits=bits)), expected
    )


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_only_whole_arrays_are_overwritten(dtype) -> None:
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
    def poisson(self, lam, size=None) -> np.ndarray:
        return np.asarray(lam, float)


def test_perfect_pixels_converge_to_the_ideal_picture() -> None:
    """Without noise and diffraction ΔE falls with the square of the pitch: 4 times by halving it,
    measured 3.92 and 3.96.
    """
    irradiance = light(grating(1024), diffraction=False)
    mean_delta_e = []
    for pitch_um in (10.6, 5.3, 2.65):
        chain = imaging_chain(
            irradiance,
            CAMERA,
            Pixel(pitch_um=pitch_um, **PERFECT),
            Exposure(max_integration_s=1000),
            Display(dots=128, bits=16),
            border_um=15.0,
        )
        seed = np.random.default_rng(0)
        frame = chain.capture_with(seed, NoShotNoise(seed.bit_generator), seed)
        mean_delta_e.append(chain.development.score(frame).mean_delta_e)
    np.testing.assert_allclose(np.divide(mean_delta_e[:-1], mean_delta_e[1:]), 4, atol=0.2)


def test_light_on_the_border_changes_no_score() -> None:
    """A border of 22.5 µm is five dots of 5.3 µm; diffraction takes a little light inwards."""
    irradiance = light(grating())
    np.testing.assert_allclose(
        ideal_on_dots(irradiance, border_um=22.5), ideal_on_dots(irradiance)[5:-5, 5:-5], rtol=1e-12
    )
    score = evaluate(irradiance, CAMERA, Pixel(pitch_um=15.0), display=DISPLAY)
    assert score.delta_e.shape == score.image.shape == (118, 118)
    assert score.border_um == pytest.approx((26.5, 26.5))
    bright = grating() * np.where(np.arange(256) < 2, 3, 1)
    other = evaluate(light(bright), CAMERA, Pixel(pitch_um=15.0), display=DISPLAY)
    np.testing.assert_allclose(other.ideal, score.ideal, rtol=1e-12)


# --- the white of a scene that states none


WIDE_NM = np.arange(405.0, 900.0, 10.0)
WHITE_CAMERA = Camera(focal_length_mm=4.0, die_mm=0.32)
WHITE_DISPLAY = Display(dots=64)
LIGHTS = {
    "daylight": d65(WIDE_NM),
    "2856 K": WIDE_NM**-5.0 / np.expm1(1.4388e7 / WIDE_NM / 2856),
    "LED of 850 nm": 30 * np.exp(-(((WIDE_NM - 850) / 20) ** 2)) + d65(WIDE_NM) / 100,
}
SILICON = {"technology": "4t-bsi", "pitch_um": 5.0}
PIXELS = {
    "paper": Pixel(pitch_um=8.0),
    "silicon": Pixel(**SILICON),
    "colour": Pixel(
        **SILICON,
        infrared_cut_nm=650.0,
        colour={"pattern": "rggb", "sensitivities": "Nikon_D700", "peak_quantum_efficiency": 0.5},
    ),
}


def picture(spectrum: np.ndarray) -> SpectralImage:
    """Return a ramp with noise, whose white nothing states."""
    relative = np.linspace(0.02, 1.0, 64) * np.random.default_rng(1).uniform(0.9, 1.1, (64, 64))
    data = 1e-3 * relative[:, :, None] * spectrum / spectrum.max()
    return SpectralImage(WIDE_NM, 10.0, 5.0, data=data, header={"diffraction": False})


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("sensor", PIXELS)
def test_at_most_one_per_cent_is_beyond_an_estimated_white(light: str, sensor: str) -> None:
    """And more than that beyond the next smaller number of two digits."""
    image = picture(LIGHTS[light])
    settings = imaging(WHITE_CAMERA, PIXELS[sensor], display=WHITE_DISPLAY)
    with pytest.warns(UserWarning, match="does not define its white"):
        white = screen.white_header([(settings, image)])["luminance_cd_per_m2"]
    unit = 10.0 ** (math.floor(math.log10(white)) - 1)
    shares = []
    for cd_per_m2 in (white, white - unit):
        view = settings.changed(
            display=WHITE_DISPLAY.model_copy(update={"white_cd_per_m2": cd_per_m2})
        )
        _, ideal = screen.ideal_on_dots(view, image, screen.colour_chart_of(view, image))
        shares.append(screen.fraction_beyond_white(ideal))
    assert shares[0] <= 0.01 < shares[1]


def test_run_and_evaluate_take_one_white(tmp_path) -> None:
    write_npz(tmp_path / "light.npz", picture(LIGHTS["2856 K"]))
    with pytest.warns(UserWarning, match="does not define its white"):
        score = evaluate(
            read_irradiance(tmp_path / "light.npz", WHITE_CAMERA),
            WHITE_CAMERA,
            PIXELS["silicon"],
            display=WHITE_DISPLAY,
            seed=3,
        )
    result = run(
        tmp_path / "light.npz",
        camera={"focal_length_mm": 4.0, "die_mm": 0.32},
        pixel=SILICON,
        display={"dots": 64},
        seed=3,
    )
    assert result.mean_delta_e == score.mean_delta_e


def test_sensors_share_the_largest_of_their_whites() -> None:
    views = [
        (imaging(WHITE_CAMERA, pixel, display=WHITE_DISPLAY), picture(LIGHTS["2856 K"]))
        for pixel in PIXELS.values()
    ]
    with pytest.warns(UserWarning, match="the largest of these sensors'"):
        white = screen.white_header(views)["luminance_cd_per_m2"]
    with warnings.catch_warnings(action="ignore"):
        whites = [screen.white_header([view])["luminance_cd_per_m2"] for view in views]
    assert white == max(whites) > 1.2 * min(whites)


@pytest.mark.parametrize(
    ("nm", "entry"),
    [
        (WIDE_NM[:29], "luminance_cd_per_m2"),
        (WIDE_NM[31:], "luminance_cd_per_m2"),  # 0.105 lm/W
        (WIDE_NM[42:], "white_w_per_m2_sr"),
    ],
)
def test_white_plate_states_luminance_or_radiance(nm: np.ndarray, entry: str) -> None:
    """Of a reflectance of ½ in equal power: Σ over the bands, in the visible and the infrared."""
    image = SpectralImage(
        nm,
        10.0,
        5.0,
        data=np.ones((8, 8, nm.size)),
        header={DIFFUSER: {DIFFUSER_W: np.full(nm.size, 3.0).tolist(), "distance_m": 1.0}},
    )
    display = Display(white="diffuser", diffuser_reflectance=0.5)
    white = screen.white_header(
        [(imaging(WHITE_CAMERA, PIXELS["silicon"], display=display), image)]
    )
    expected = 0.5 * 3.0 * 10.0 * nm.size
    if entry == "luminance_cd_per_m2":
        expected = 0.5 * 3.0 * float(image.luminous_weight().sum())
    assert white[entry] == pytest.approx(expected, rel=1e-8)
    level = screen.LightLevel.of(image, screen.with_white(display, white), [0.02, 0.01])
    assert (level.white, level.shortest_s, level.longest_s) == (white[entry], 0.01, 0.02)


# --- light that nobody sees


INFRARED_PIXEL = Pixel(
    technology="4t-bsi",
    pitch_um=4.0,
    quantum_efficiency=[[400, 0.6], [1000, 0.2]],
    black_level_dn=60,
    stack={"enabled": False},
)


def infrared(scale: float = 1.0, **header) -> SpectralImage:
    """Return detail in light around 940 nm."""
    y, x = np.mgrid[:64, :64]
    detail = 0.5 + 0.4 * np.sin(x / 4) * np.cos(y / 6)
    data = detail[..., None] * np.array([0.5, 1.0, 0.5]) * 0.01 * scale
    header = {"diffraction": False} | header
    return SpectralImage([930.0, 940.0, 950.0], 10.0, 4.0, data=data, header=header)


def test_white_of_infrared_light_is_a_radiance() -> None:
    """Near that of the brightest light, E/(π sin²α); stated by display or light it gives the same
    score, and half of it in half of the light the same ideal picture.
    """
    camera = Camera(die_mm=0.256)
    with pytest.warns(UserWarning, match=r"W m⁻² sr⁻¹"):
        white = screen.white_header(
            [(imaging(camera, INFRARED_PIXEL, display=Display(dots=32)), infrared())]
        )["white_w_per_m2_sr"]
    factor = float(irradiance_factor(camera.f_number, 0.0, camera.magnification))
    brightest = float(infrared().data.sum(axis=2).max()) * 10 / factor
    assert 0.85 * brightest < white < 1.1 * brightest
    scores = [
        evaluate(
            infrared(scale, **header), camera, INFRARED_PIXEL, display=Display(dots=32, **fields)
        )
        for scale, header, fields in (
            (1.0, {}, {"white_w_per_m2_sr": white}),
            (1.0, {"white_w_per_m2_sr": white}, {}),
            (0.5, {}, {"white_w_per_m2_sr": white / 2}),
        )
    ]
    assert scores[0].mean_delta_e == scores[1].mean_delta_e
    np.testing.assert_array_equal(scores[2].ideal, scores[0].ideal)


# --- dark pixels


SHAPE = 4, 100_000  # most of it columns, so that their offsets average too
TIME_S = 0.03
SHEET = {
    "technology": "none",
    "pitch_um": 3.75,
    "full_well_e": 10500,
    "read_noise_e": 2.3,
    "dark_current_e_per_s": 3,
    "quantum_efficiency": 0.62,
    "bits": 12,
    "dsnu": 0.2,
    "black_level_dn": 0,
}


def readout_of(fields: dict) -> Readout:
    return Readout.of(derive(Pixel(**SHEET | fields)))


@pytest.mark.parametrize(
    "fields",
    [
        {},
        {"offset_fpn": 0.002, "column_fpn": 0.002, "bits": 14, "black_level_dn": 20},
        {"dark_current_e_per_s": 1000, "dsnu": 1.0, "read_noise_e": 30},
        {"dark_current_e_per_s": 30, "dsnu": 0.5, "read_noise_e": 0.4, "bits": 16},
        {"dark_current_e_per_s": 5e3, "dsnu": 0, "read_noise_e": 160, "bits": 14},
        {
            "dark_current_e_per_s": 600,
            "read_noise_e": 12,
            "hot_pixel_fraction": 0.3,
            "hot_pixel_median": 5.0,
            "hot_pixel_spread": 0.5,
        },
    ],
    ids=["read noise", "offsets", "DSNU", "single electrons", "much dark charge", "hot pixels"],
)
@pytest.mark.parametrize("subexposures", [1, 3])
def test_dark_clip_is_that_of_frames(fields: dict, subexposures: int) -> None:
    """Codes at 0 and their mean, within 5 σ of columns (1 of 10⁵ seeds fails one): about 2 %.
    Rounding alone moves the mean by nothing above σ of 0.8 DN.
    """
    readout = readout_of(fields).burst(subexposures)
    clip = dark_clip(readout, TIME_S, 1e4)
    single = readout.burst(1)
    sensor = sample_sensor(single, SHAPE, np.random.default_rng(1))
    dn = read_out(np.zeros(SHAPE), TIME_S / subexposures, sensor, np.random.default_rng(2))
    dark_e = single.dark_current_e_per_s * TIME_S / subexposures
    excess_e = (dn - single.adc.black_level_dn) / single.dn_per_e - dark_e
    expected = clip["at_zero_fraction"], clip["too_bright_e"] / subexposures
    for values, mean in zip((dn == 0, excess_e), expected, strict=True):
        columns = values.mean(axis=0)
        assert columns.mean() == pytest.approx(
            mean, abs=5 * (columns.std(ddof=1) / math.sqrt(columns.size))
        )
    assert clip["too_bright_e"] > 0.01 * clip["spread_e"]


@pytest.mark.parametrize(
    "fields", [{"offset_fpn": 0.002}, {"technology": "4t-bsi", "pitch_um": 1.0}]
)
def test_least_black_level_avoids_clipping(fields: dict) -> None:
    """φ(6) - 6Φ(-6) = 1.6e-10 of the spread is left; a third of that level clips."""
    clip = dark_clip(readout_of(fields), TIME_S, 1e4)
    least_dn = clip["least_black_level_dn"]
    assert clips_dark(clip)
    assert f"pixel.black_level_dn = {least_dn}" in str(
        clip_note(clip, Pixel(**SHEET | fields).model_dump())
    )
    for factor, low, high in ((1, 0, 2e-10), (1 / 3, 1e-3, 1)):
        clip = dark_clip(readout_of(fields | {"black_level_dn": factor * least_dn}), TIME_S, 1e4)
        assert low <= clip["too_bright_e"] / clip["spread_e"] <= high


def test_dark_clip_is_the_light_of_a_black_area() -> None:
    """Dots of 25 × 25 pixels, so that the display's own clip has no effect: luminance and ΔE.

    160 000 clipped normal values, of which the spread is 1.5 times their mean: 0.4 %, and 5 σ.
    """
    camera = Camera(die_mm=0.64)
    display = Display(dots=16, bits=16, white_cd_per_m2=1000.0)
    exposure = Exposure(integration_s=5e-4)
    dark = SpectralImage(
        [550.0], 10.0, 40.0, data=np.zeros((16, 16, 1)), header={"diffraction": False}
    )
    pixel = Pixel(technology="4t-bsi", pitch_um=1.6, column_fpn=0, stack={"enabled": False})
    settings = imaging(camera, pixel, exposure, display)
    white_e = displays.white_rate(settings, dark) * settings.physics.photodiode_area_um2 * 5e-4
    clip = dark_clip(settings.readout, 5e-4, white_e)
    score = evaluate(dark, camera, pixel, exposure, display)
    assert score.image.mean() == pytest.approx(clip["of_display_white"], rel=0.02)
    assert score.mean_delta_e == pytest.approx(clip["lightness"], rel=0.02)
    assert clip["lightness"] > 5
