"""The steps of development: their order, what each does to signal and noise, and that nothing is
done where they are off.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.chains import imaging_chain
from helpers.tiny import tiny

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.light.spectral import SpectralImage
from pixsim.optics import irradiance_factor
from pixsim.optics.camera import Camera
from pixsim.sensor.correction_options import Correction
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.readout import Frame, make_frame
from pixsim.studies.files import settings_text
from pixsim.viewer.chain import ImagingChain
from pixsim.viewer.demosaic import remosaic
from pixsim.viewer.denoising import wiener
from pixsim.viewer.develop_options import Develop
from pixsim.viewer.develop_steps import (
    DISPLAYED,
    PLANES,
    RAW,
    STEPS,
    developed_planes,
    noise_covariance,
    noise_of_expected_e2,
    white_noise_e2,
)
from pixsim.viewer.display_options import Display
from pixsim.viewer.screen import display_image
from pixsim.viewer.sharpening import noise_gain, unsharp_mask, unsharp_response
from pixsim.viewer.tone import reinhard, toned

SIDE, SAMPLE_UM = 128, 2.0
CAMERA = Camera(die_mm=1e-3 * SIDE * SAMPLE_UM, focal_length_mm=0.4)
NM = np.arange(420.0, 700.0, 40.0)
TIME_S = 1e-3
QUAD = ("RRGG", "RRGG", "GGBB", "GGBB")


def curves() -> dict[str, Any]:
    nm = np.arange(400.0, 721.0, 20.0)
    peaks = {"R": 600.0, "G": 540.0, "B": 460.0}
    return {
        name: np.stack([nm, 0.02 + 0.5 * np.exp(-(((nm - at) / 45) ** 2))], axis=1).tolist()
        for name, at in peaks.items()
    }


def sensor(colour: str | dict[str, Any] = "", **fields: Any) -> Pixel:
    sheet = {
        "pitch_um": 2.0,
        "full_well_e": 20000,
        "read_noise_e": 6.0,
        "quantum_efficiency": 0.6,
        "bits": 14,
    }
    sheet |= {"black_level_dn": 200, "dark_current_e_per_s": 0.0}
    if colour:
        own = {"pattern": colour} if isinstance(colour, str) else colour
        sheet |= {"colour": {"quantum_efficiencies": curves(), **own}}
    return Pixel(**sheet | fields)


def scene(picture: np.ndarray) -> SpectralImage:
    """Grey light of an equal spectrum, 1 for the scene's white of 1000 cd/m², without
    diffraction.
    """
    lux = (
        1e3
        * float(irradiance_factor(CAMERA.f_number, 0.0, CAMERA.magnification))
        * CAMERA.transmittance
    )
    widths = np.full(NM.size, 40.0)
    own = {
        "factors": (np.ones((1, NM.size)), picture[None].astype(np.float32)),
        "header": {"diffraction": False},
    }
    unit = SpectralImage(NM, widths, SAMPLE_UM, **own)
    spectrum = np.full((1, NM.size), lux / float(unit.luminous_weight().sum()))
    own = {
        "factors": (spectrum, own["factors"][1]),
        "header": {"diffraction": False, "luminance_cd_per_m2": 1e3},
    }
    return SpectralImage(NM, widths, SAMPLE_UM, **own)


def detailed() -> np.ndarray:
    """A grating, an edge and a spot, 0.1 to 0.9 of white."""
    y, x = np.mgrid[:SIDE, :SIDE] / SIDE
    picture = 0.5 + 0.2 * np.sin(2 * np.pi * 12 * x) * (y < 0.5) + 0.25 * ((x > 0.6) & (y > 0.5))
    return np.asarray(picture - 0.3 * (np.hypot(x - 0.25, y - 0.75) < 0.1))


DISPLAY = Display(dots=SIDE, samples_per_deg=23.0)


def chain_of(
    develop: dict[str, Any],
    colour: str | dict[str, Any] = "",
    picture: np.ndarray | None = None,
    display: Display = DISPLAY,
    exposure: dict[str, Any] | None = None,
    **fields: Any,
) -> ImagingChain:
    own = scene(detailed() if picture is None else picture), CAMERA, sensor(colour, **fields)
    return imaging_chain(
        *own, Exposure(**exposure or {"integration_s": TIME_S}), display, develop=Develop(**develop)
    )


def noiseless(chain: ImagingChain) -> Frame:
    """The frame of the mean electrons, without rounding."""
    frame = make_frame(
        np.zeros(chain.signal_e_per_s.shape, np.int32),
        0.0,
        chain.signal_e_per_s,
        chain.readout,
        Exposure(integration_s=TIME_S),
    )
    return replace(frame, corrected_e=chain.signal_e_per_s * TIME_S)


# --- the registry
# ----------------------------------------------------------------------------------------------------------------


def test_steps_stand_in_the_order_of_what_they_work_on() -> None:
    kinds = [step.works_on for step in STEPS.values()]
    assert kinds == sorted(kinds, key=[RAW, PLANES, DISPLAYED].index)
    assert [name for name, step in STEPS.items() if step.works_on == RAW] == [
        "denoise",
        "white_balance",
        "remosaic",
        "demosaic",
    ]


@pytest.mark.parametrize("colour", ["", "rggb"])
def test_steps_that_are_off_change_no_bit(colour: str) -> None:
    """Also where their other settings are given."""
    off = {
        "denoise": "nlm",
        "denoise_strength": 0.0,
        "sharpen_radius_px": 3.0,
        "tone_gamma": 3.0,
        "remosaic": True,
    }
    plain, idle = chain_of({}, colour), chain_of(off, colour)
    for one, other in zip(
        (plain.capture("a"), plain.screen.ideal),
        (idle.capture("a"), idle.screen.ideal),
        strict=True,
    ):
        pixels, others = (each.dn if isinstance(each, Frame) else each for each in (one, other))
        np.testing.assert_array_equal(pixels, others)
    np.testing.assert_array_equal(
        plain.development.light(plain.capture("a")), idle.development.light(plain.capture("a"))
    )


# --- noise reduction
# -------------------------------------------------------------------------------------------------------------


def smooth(plane: np.ndarray, strength: float) -> np.ndarray:
    """A mean over 3 × 3 pixels, from which parts that differ by more than three deviations are left
    out: an adaptive filter.
    """
    padded = np.pad(plane, 1, mode="reflect")
    near = np.stack(
        [padded[y : y + plane.shape[0], x : x + plane.shape[1]] for y in range(3) for x in range(3)]
    )
    alike = np.abs(near - plane) < 3 * strength
    return np.asarray((near * alike).sum(axis=0) / alike.sum(axis=0))


@pytest.mark.parametrize("colour", ["", "rggb", "stacked"])
@pytest.mark.parametrize(
    "denoise",
    ["wiener_bound", "nlm", "wavelet", smooth],
    ids=["wiener_bound", "nlm", "wavelet", "function"],
)
def test_denoised_frames_are_nearer_to_the_expected_light(
    colour: str, denoise: str | Callable[..., Any]
) -> None:
    """And, in the mean over an even half of the frame, as bright: nothing is lost to the
    transforms. σ of the mean is 0.1 %.
    """
    chain = chain_of({"denoise": denoise}, colour, picture=np.clip(detailed(), 0.35, 0.75))
    frame, expected = chain.capture("frame"), chain.signal_e_per_s * TIME_S
    plain = replace(chain, imaging=chain.imaging.changed(develop=Develop()))
    errors = []
    for each in (chain, plain):
        c = each.development.undeveloped(frame, None)
        raw = (
            STEPS["denoise"].apply(frame.estimate_e, c) if c.develop.denoises else frame.estimate_e
        )
        errors.append(float(np.mean((raw - expected) ** 2)))
        assert raw.mean() == pytest.approx(expected.mean(), rel=3e-3)
    assert errors[0] < 0.8 * errors[1]


def test_no_filter_of_the_list_beats_the_bound_in_mean_square_error_of_even_noise() -> None:
    """'wiener_bound' has the least error of linear filters: also of unsharp masks that blur, which
    are of its kind.
    """
    chain = chain_of({"denoise": "wiener_bound"})
    frame, expected = chain.capture("bound"), chain.signal_e_per_s * TIME_S
    bound = STEPS["denoise"].apply(frame.estimate_e, chain.development.undeveloped(frame, None))
    least = float(np.mean((bound - expected) ** 2))
    for amount, sigma in ((0.9, 0.5), (0.9, 1.0), (0.5, 1.0), (0.7, 3.0)):
        blurred = frame.estimate_e - amount * (
            unsharp_mask(frame.estimate_e, 1.0, sigma) - frame.estimate_e
        )
        assert least < float(np.mean((blurred - expected) ** 2))


ALL_CORRECTIONS = {"dark_frames": 4, "flat_frames": 8, "column_clamp": 8}


@pytest.mark.parametrize(
    ("colour", "correction"),
    [
        ("", {}),
        ("rggb", {}),
        ("", {"dark_frames": 4}),
        ("", ALL_CORRECTIONS),
        ("rggb", ALL_CORRECTIONS),
    ],
    ids=str,
)
def test_bound_leaves_the_error_that_it_states(colour: str, correction: dict[str, Any]) -> None:
    """∫ SN/(S + N) of raw planes, over sensors with fixed patterns, as a correction leaves them:
    within 5 %.

    16 sensors of 128² pixels tell it to 1 %; the closed form of the residual is of first order in
    PRNU, and takes the flat frames of all channels for as bright as those of the brightest.
    """
    fields = {
        "prnu": 0.02,
        "dsnu": 0.2,
        "dark_current_e_per_s": 5e4,
        "offset_fpn": 5e-4,
        "column_fpn": 5e-4,
        "row_noise_e": 4.0,
    }
    chain = chain_of({"denoise": "wiener_bound"}, colour, **fields)
    chain = replace(chain, imaging=chain.imaging.changed(correction=Correction(**correction)))
    expected, errors = chain.signal_e_per_s * TIME_S, []
    c = chain.development.undeveloped(noiseless(chain), None)
    for number in range(16):
        raw = STEPS["denoise"].apply(chain.capture("bound", number).estimate_e, replace(c))
        errors.append(float(np.mean((raw - expected) ** 2)))
    variance, column_e2, row_e2 = noise_of_expected_e2(
        expected, chain.readout, TIME_S, chain.imaging.correction
    )
    stated = [
        wiener.mean_square_error(
            wiener.signal_power(light),
            wiener.noise_power(own, column_variance=column_e2, row_variance=row_e2),
        )
        for light, own in zip(c.channel_planes(expected), c.channel_planes(variance), strict=True)
    ]
    assert np.mean(errors) == pytest.approx(np.mean(stated), rel=0.05)


def chroma_noise(planes: list[np.ndarray]) -> float:
    inner = np.s_[8:-8, 8:-8]
    return float(
        np.std(planes[0][inner] - planes[1][inner]) + np.std(planes[2][inner] - planes[1][inner])
    )


def test_noise_reduction_before_demosaicing_leaves_less_chroma_noise() -> None:
    """Behind it, the noise of neighbours is alike, and a filter that is told the noise of a pixel
    takes it for detail.
    """
    from pixsim.viewer.denoising.filters import denoised_plane

    chain = chain_of({"denoise": "nlm"}, "rggb", picture=np.full((SIDE, SIDE), 0.5))
    frame = chain.capture("chroma")
    first = developed_planes(chain.development.undeveloped(frame, None))
    planes = developed_planes(
        replace(chain, imaging=chain.imaging.changed(develop=Develop())).development.undeveloped(
            frame, None
        )
    )
    own_e2, white_e = (
        white_noise_e2(chain.readout, TIME_S, chain.imaging.correction),
        np.array(chain.whites_e_per_s) * TIME_S,
    )
    last = [
        denoised_plane(plane * white, own_e2, "nlm") / white
        for plane, white in zip(planes, white_e, strict=True)
    ]
    assert chroma_noise(first) < 0.8 * chroma_noise(last)
    assert chroma_noise(last) < chroma_noise(planes)


def test_known_noise_is_that_of_dark_frames() -> None:
    """White temporal noise with dark charge, by differences of frames of one sensor, in electrons.
    2 σ of 20 frames is 0.4 %.
    """
    chain = chain_of({}, picture=np.full((SIDE, SIDE), 1e-6), dark_current_e_per_s=3e4, dsnu_e=20.0)
    dark = (
        chain.capture("noise").estimate_e,
        *(frame.estimate_e for frame in chain.further_frames(21, "noise")),
    )
    variance = float(np.var(np.diff(dark, axis=0), axis=(1, 2)).mean()) / 2
    known = (
        white_noise_e2(chain.readout, TIME_S, chain.imaging.correction)
        + chain.readout.dark_current_e_per_s * TIME_S
    )
    assert variance == pytest.approx(known, rel=0.01)


@pytest.mark.parametrize(("denoise", "least"), [("nlm", 17), ("wavelet", 8)])
def test_frames_too_small_for_the_window_are_refused(denoise: str, least: int) -> None:
    chain = chain_of(
        {"denoise": denoise},
        pitch_um=SIDE * SAMPLE_UM / (least - 1),
        display=Display(dots=16, raster="one_to_one"),
    )
    with pytest.raises(PixsimError, match=rf"denoise '{denoise}'.*{least} pixels or more"):
        chain.simulate("small")


# --- sharpening
# ------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("amount", "sigma"), [(0.5, 0.6), (2.0, 1.0), (1.0, 4.0)])
def test_unsharp_mask_has_its_response_and_moves_no_phase(amount: float, sigma: float) -> None:
    """1 + a(1 - G), with G = exp(-2π²σ²f²) within what sampling and the cut at 4 σ leave, 0.8 % at
    σ = 0.6 px.
    """
    x = np.arange(240)
    for period in (6, 12, 40):
        wave = np.cos(2 * np.pi * (x - 120) / period) * np.ones((40, 1))
        gain = 1 + amount * (1 - math.exp(-2 * (math.pi * sigma / period) ** 2))
        np.testing.assert_allclose(
            unsharp_mask(wave, amount, sigma)[:, 120],
            unsharp_response(1 / period, amount, sigma),
            rtol=1e-12,
        )
        inner = np.s_[:, 60:-60]
        np.testing.assert_allclose(
            unsharp_mask(wave, amount, sigma)[inner], gain * wave[inner], atol=0.008 * amount
        )


def test_noise_gain_of_sharpening_is_that_of_white_noise() -> None:
    """Of 10⁶ normal values; their correlation makes 0.3 % of the gain 3 σ."""
    noise = np.random.default_rng(1).standard_normal((1000, 1000))
    for amount, sigma in ((1.0, 0.5), (2.0, 1.5)):
        assert unsharp_mask(noise, amount, sigma).std() == pytest.approx(
            noise_gain(amount, sigma), rel=3e-3
        )


def test_radius_on_the_display_is_that_in_pixels_of_any_size() -> None:
    """At f cy/deg on a display of s dots a degree the blur has σ = s/(2πf) dots, whatever the
    pixels.
    """
    for pitch_um in (2.0, 4.0):
        chain = chain_of(
            {"sharpen_amount": 1.0, "sharpen_radius_cy_per_deg": 2.5}, pitch_um=pitch_um
        )
        assert chain.development.sharpen_px * pitch_um == pytest.approx(
            23.0 / (2 * math.pi * 2.5) * SAMPLE_UM
        )
    wide = chain_of({"sharpen_amount": 1.0, "sharpen_radius_cy_per_deg": 1e-3})
    with pytest.raises(PixsimError, match=r"sharpen_radius_cy_per_deg.*up to 100 pixels"):
        wide.simulate("wide")


# --- tone
# ------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "curve", ["gamma", "srgb", "reinhard", ((0.0, 0.0), (0.2, 0.5), (2.0, 1.0))], ids=str
)
@pytest.mark.parametrize("colour", ["", "stacked"])
@pytest.mark.filterwarnings("ignore:.*brighter than display white")
def test_ideal_picture_has_the_tone_curve_and_no_sharpening(curve: Any, colour: str) -> None:
    """Without noise an even scene is shown as the ideal one, up to twice as bright as white; the
    ideal is not sharpened.
    """
    develop = {"tone_curve": curve, "tone_gamma": 1.4, "tone_white": 2.0}
    for level in (0.05, 0.5, 1.9):
        even = np.full((SIDE, SIDE), level)
        chain = chain_of(
            develop, colour, picture=even, exposure={"integration_s": TIME_S}, full_well_e=1e6
        )
        image = display_image(chain.development.light(noiseless(chain)), DISPLAY)
        np.testing.assert_allclose(image, chain.screen.ideal, atol=2 / 255 if colour else 1e-9)
        linear = float(
            np.asarray(chain_of({}, colour, picture=even, full_well_e=1e6).screen.ideal).mean()
        )
        assert abs(float(image.mean()) - linear) > 1e-3 or level > 1
    sharp = chain_of(develop | {"sharpen_amount": 3.0}, colour)
    np.testing.assert_array_equal(sharp.screen.ideal, chain_of(develop, colour).screen.ideal)


def test_tone_curves_are_values_that_the_display_decodes() -> None:
    """Gamma of the display's is none; a table of sRGB is sRGB, of IEC 61966-2-1: value 0.5 is light
    0.21404.
    """
    light = np.linspace(0.0, 1.0, 257)[None]
    np.testing.assert_allclose(
        toned(light, Develop(tone_curve="gamma", tone_gamma=DISPLAY.gamma), DISPLAY),
        light,
        atol=1e-12,
    )
    srgb = toned(light, Develop(tone_curve="srgb"), DISPLAY)
    assert np.interp(0.21404, light[0], srgb[0]) == pytest.approx(0.5**DISPLAY.gamma, abs=1e-4)
    table = list(zip(light[0].tolist(), (srgb[0] ** (1 / DISPLAY.gamma)).tolist(), strict=True))
    np.testing.assert_allclose(toned(light, Develop(tone_curve=table), DISPLAY), srgb, atol=1e-12)
    assert toned(light, Develop(), DISPLAY) is light


def test_operator_keeps_order_and_colour() -> None:
    """Reinhard's has the slope 1 at 0, and shows its white as white; all primaries of a dot have
    one factor.
    """
    luminance = np.linspace(0.0, 4.0, 100)
    found = reinhard(luminance, 4.0)
    assert (np.diff(found) > 0).all()
    assert found[-1] == pytest.approx(1.0)
    assert reinhard(1e-9, 4.0) == pytest.approx(1e-9)
    light = np.random.default_rng(2).uniform(0.1, 3.0, (3, 5, 5))
    ratio = toned(light, Develop(tone_curve="reinhard"), DISPLAY) / light
    np.testing.assert_allclose(ratio, np.broadcast_to(ratio[0], ratio.shape), rtol=1e-12)


def test_a_scene_beyond_white_is_not_said_to_clip_behind_an_operator() -> None:
    bright = 3.0 * detailed()
    with pytest.warns(UserWarning, match="brighter than display white"):
        chain_of({}, picture=bright)
    chain_of({"tone_curve": "reinhard"}, picture=bright)  # a warning would be an error


# --- quad mosaics
# ----------------------------------------------------------------------------------------------------------------


def test_remosaic_of_planes_is_exact_and_keeps_its_samples() -> None:
    """A linear course of each channel: each new sample is that of its place; edges but the last two
    pixels included.
    """
    y, x = np.mgrid[:24, :28].astype(float)
    planes = {"R": 1 + 0.1 * y + 0.02 * x, "G": 5 - 0.03 * y + 0.07 * x, "B": 0.05 * x - 0.02 * y}
    letters, single = (
        np.tile([list(row) for row in cell], reps)
        for cell, reps in ((QUAD, (6, 7)), (("RG", "GB"), (12, 14)))
    )
    mosaic, wanted = (
        sum(np.where(where == name, plane, 0.0) for name, plane in planes.items())
        for where in (letters, single)
    )
    found = remosaic(mosaic, QUAD)
    inner = np.s_[3:-3, 3:-3]
    np.testing.assert_allclose(found[inner], wanted[inner], rtol=1e-12)
    np.testing.assert_array_equal(found[letters == single], mosaic[letters == single])
    assert np.isfinite(found).all()
    with pytest.raises(PixsimError, match="2 × 2 equal pixels"):
        remosaic(mosaic, "rggb")


def test_remosaiced_quad_shows_more_detail_than_its_own_interpolation_and_than_binning() -> None:
    """A grey grating of eight pixels a period, by the noiseless picture's error: full resolution is
    worth its mosaic.
    """
    x = np.arange(SIDE)
    picture = 0.5 + 0.3 * np.sin(2 * np.pi * x / 8) * np.ones((SIDE, 1))
    errors = {}
    for name, develop, binning in (
        ("remosaic", {"remosaic": True, "demosaic": "malvar2004"}, False),
        ("interpolate", {}, False),
        ("binning", {}, True),
    ):
        chain = chain_of(develop, {"pattern": "quad_rggb", "binning": binning}, picture=picture)
        light = chain.development.light(noiseless(chain))
        errors[name] = float(
            np.mean((np.moveaxis(light, 0, -1)[4:-4, 4:-4] - chain.screen.ideal[4:-4, 4:-4]) ** 2)
        )
    assert errors["remosaic"] < errors["interpolate"]
    assert errors["remosaic"] < errors["binning"]


# --- covariance
# ------------------------------------------------------------------------------------------------------------------


def test_covariance_behind_a_filter_is_that_of_the_matrices() -> None:
    """The mean over places of Dᵀ F² D, with the DCT-II as a matrix."""
    from scipy.fft import dct

    from pixsim.viewer.develop_steps import autocorrelation

    factors = np.random.default_rng(3).uniform(size=(5, 7))
    down, across = (dct(np.eye(count), axis=0, norm="ortho") for count in factors.shape)
    whole = np.einsum("ky,lx,kl,kv,lu->yxvu", down, across, factors**2, down, across)
    for dy, dx in np.ndindex(5, 7):
        pairs = [whole[y, x, y + dy, x + dx] for y in range(5 - dy) for x in range(7 - dx)]
        assert autocorrelation(factors)[4 + dy, 6 + dx] == pytest.approx(np.mean(pairs), abs=1e-14)


@pytest.mark.parametrize(
    ("colour", "develop", "gate"),
    [
        ("", {}, 0.01),
        ("stacked", {"sharpen_amount": 1.0}, 0.03),
        # Interpolation knows no borders, where the filter leaves more of the noise of planes of 64
        # × 64.
        ("rggb", {"demosaic": "bilinear"}, 0.04),
    ],
)
def test_covariance_behind_the_bound_is_that_of_frames(
    colour: str, develop: dict[str, Any], gate: float
) -> None:
    """Sixty frames of even light through the filter of a picture: what is linear passes noise as it
    passes a picture.
    """
    develop = {"denoise": "wiener_bound", **develop}
    chain, even = (
        chain_of(develop, colour),
        chain_of(develop, colour, picture=np.full((SIDE, SIDE), 0.5)),
    )
    still = noiseless(chain)
    levels = np.full((1, len(chain.whites_e_per_s)), 0.5)
    expected = noise_covariance(chain.development.undeveloped(still, None), levels, None)[0]
    found = np.zeros_like(expected)
    for number in range(60):
        noise = even.capture("through", number).estimate_e - even.signal_e_per_s * TIME_S
        planes = np.stack(
            developed_planes(
                replace(chain.development.undeveloped(replace(still, corrected_e=noise), None))
            )
        )
        found += np.einsum("cyx,dyx->cd", planes, planes) / planes[0].size / 60
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert found / scale == pytest.approx(expected / scale, abs=gate)


@pytest.mark.parametrize(
    "develop",
    [
        {"sharpen_amount": 2.0},
        {"denoise": "wiener_bound"},
        {"denoise": "wiener_bound", "sharpen_amount": 1.0},
    ],
)
def test_linear_steps_and_dots_create_no_information(develop: dict[str, Any]) -> None:
    """d′ of the ideal linear observer, by matrices: of the dots behind the steps at most that of
    the raw frame, and less of fewer.

    Sharpening alone can be undone, so that nothing is lost on as many dots as pixels.
    """
    side = 12
    picture = np.kron(np.random.default_rng(5).uniform(0.3, 0.7, (side, side)), np.ones((2, 2)))
    y, x = np.mgrid[:side, :side]
    target = 8.0 * (np.hypot(y - 5.5, x - 6.0) < 2.5)
    found = {}
    for dots in (24, 8):
        camera = Camera(die_mm=1e-3 * 2 * side * SAMPLE_UM, focal_length_mm=0.4)
        display = Display(dots=dots, raster="fixed_size" if dots == 8 else "one_to_one")
        own = (
            scene(picture),
            camera,
            sensor(pitch_um=2 * SAMPLE_UM),
            Exposure(integration_s=TIME_S),
            display,
        )
        chain = imaging_chain(*own, develop=Develop(**develop))
        still = noiseless(chain)
        signal_e = chain.signal_e_per_s * TIME_S
        variance = signal_e + white_noise_e2(chain.readout, TIME_S, chain.imaging.correction)
        columns = []
        for place in np.ndindex(side, side):
            one = np.zeros((side, side))
            one[place] = 1.0
            columns.append(chain.development.light(replace(still, corrected_e=one)).ravel())
        steps = np.array(columns).T
        behind = steps @ target.ravel()
        covariance = steps @ (variance.ravel()[:, None] * steps.T)
        found[dots] = math.sqrt(behind @ np.linalg.lstsq(covariance, behind, rcond=1e-12)[0])
        raw = pixsim.metrics.detectability(target, variance)
        assert found[dots] <= raw * (1 + 1e-9)
    if develop.keys() == {"sharpen_amount"}:
        assert found[24] == pytest.approx(raw, rel=1e-6)
    assert found[8] < 0.99 * raw


def same(plane: np.ndarray, strength: float) -> np.ndarray:
    return plane


def test_noise_aware_matrix_knows_noise_that_linear_filters_reduce() -> None:
    """With less noise in the channels it amplifies more of it; filters that adapt to the picture
    count as none.
    """
    exposure = {"integration_s": 3e-5}
    bare, bound, adaptive = (
        float(
            (
                chain_of(
                    {"matrix": "noise_aware", "denoise": name}, "rggb", exposure=exposure
                ).development.matrix
                ** 2
            ).sum()
        )
        for name in ("none", "wiener_bound", same)
    )
    assert bound > 1.02 * bare
    assert adaptive == bare


# --- settings
# --------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"denoise": "bm3d"}, r"denoise.*none, wiener_bound, nlm, wavelet.*given in Python"),
        ({"denoise_strength": -0.1}, "denoise_strength"),
        ({"sharpen_amount": 1e30}, "sharpen_amount"),
        (
            {"sharpen_amount": 1.0, "sharpen_radius_px": 1.0, "sharpen_radius_cy_per_deg": 3.0},
            "state the same quantity",
        ),
        ({"tone_curve": [[0, 0], [0.5, 0.7], [1, 0.6]]}, "brighter stays brighter"),
        ({"tone_curve": [[0, 0], [0.5, 0.7], [0.5, 0.8]]}, "light that rises"),
        ({"tone_curve": [[0, 0], [1, 255]]}, "Divide values of codes"),
        ({"tone_curve": [[0, 0.5], [1, 0.5]]}, "increasing values"),
        ({"tone_curve": "linear"}, "does not exist"),
    ],
)
def test_what_cannot_be_is_refused(fields: dict[str, Any], words: str) -> None:
    with pytest.raises(PixsimError, match=words):
        Develop(**fields)


def test_functions_come_from_python_only(tmp_path: Any) -> None:
    """A file, and what a result's settings.toml states, names none; a function travels with its
    code.
    """
    (tmp_path / "own.toml").write_text('[develop]\ndenoise = "shutil:rmtree"\n')
    with pytest.raises(PixsimError, match=r"own.toml.*got .shutil:rmtree.*given in Python"):
        pixsim.run("flat", config=tmp_path / "own.toml")
    one, other = (Develop(denoise=each) for each in (same, smooth))
    assert one.content_hash != other.content_hash
    assert Develop.model_validate(one.model_dump(mode="json")).denoise == one.denoise


def test_result_of_a_function_is_checked() -> None:
    for function, words in (
        (lambda plane, strength: plane[1:], "shape"),
        (lambda plane, strength: plane / 0, "returns"),
    ):
        with pytest.raises(PixsimError, match=words), np.errstate(all="ignore"):
            chain_of({"denoise": function}).simulate("own")


def test_tone_curve_lies_next_to_its_file(tmp_path: Any) -> None:
    (tmp_path / "curve.csv").write_text("light,value\n0,0\n0.2,0.5\n1,1\n")
    (tmp_path / "own.toml").write_text('[develop]\ntone_curve = "curve.csv"\n')
    result = pixsim.run(
        "flat",
        config=tmp_path / "own.toml",
        resolution=32,
        display={"dots": 32},
        pixel={"pitch_um": 42.4},
    )
    assert result.settings.develop.tone_curve == ((0.0, 0.0), (0.2, 0.5), (1.0, 1.0))
    assert "Tone curve of a table" in result._repr_html_()


def test_axis_over_the_development_of_a_study_shares_its_frames(tmp_path: Any) -> None:
    """Strength, tone curve and sharpening are axes; each has the ideal picture of its own tone
    curve, and says what is on.
    """
    axes = [{"name": "strength", "set": "develop.denoise_strength", "values": [0.0, 1.0]}]
    axes += [{"name": "tone", "set": "develop.tone_curve", "values": ["none", "reinhard"]}]
    plan = tiny(axis=axes, develop={"denoise": "wavelet", "sharpen_amount": 0.5})
    result = pixsim.study(plan, tmp_path / "study")
    found = {tuple(curve.at.values()): curve for curve in result.curves}
    least = {at: float(curve.mean().min()) for at, curve in found.items()}
    assert len(set(least.values())) == 4
    assert (
        "denoised (wavelet), sharpened, tone curve reinhard"
        in found[1.0, "reinhard"].case.developed
    )
    assert 'denoise = "wavelet"' in settings_text(plan, "study")


@pytest.mark.filterwarnings("ignore:.*")
def test_function_denoises_in_the_workers_of_a_study(tmp_path: Any) -> None:
    """One that is local here, in two processes, gives the rows of one process; settings.toml names
    it, and no file may.
    """

    def local(plane: np.ndarray, strength: float) -> np.ndarray:
        return smooth(plane, strength)

    plan = tiny(develop={"denoise": local})
    folders = [tmp_path / "1", tmp_path / "2"]
    rows = [pixsim.study(plan, folder, jobs=int(folder.name)).to_csv() for folder in folders]
    assert rows[0] == rows[1]
    assert rows[0] != pixsim.study(tiny(), tmp_path / "plain").to_csv()
    assert "local#" in settings_text(plan, "study")
