"""Noise budgets: variances add up to that of frames, parts of ΔE to the whole, and a cause that is
not there takes off nothing.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.chains import imaging_chain

from pixsim import Camera, Develop, Display, Exposure, Motion, Pixel, SpectralImage
from pixsim.light.spectral import colour_matching, d65, luminous_weight
from pixsim.optics import irradiance_factor
from pixsim.sensor import noise
from pixsim.sensor.collection import Collection, ColourCollection
from pixsim.sensor.colour import Layout
from pixsim.sensor.noise import SOURCES, NoiseSource
from pixsim.sensor.pixel import derive
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import frame_variance_dn2
from pixsim.viewer.every_pixel import neighbours
from pixsim.viewer.noise_budget import (
    APERTURE,
    BLUR,
    COLOUR_ERROR,
    CROSSTALK,
    DARK,
    FLICKER,
    LENS,
    MOSAIC,
    MOTION,
    NOISE,
    REDUCTION,
    ROUNDING,
    SAMPLING,
    SHOT,
    VEIL,
    NoiseBudget,
    finer_adc,
    noise_budget,
    noiseless_frame,
    without_denoising,
)

SIDE = 256
SAMPLE_UM = 2.0
TIME_S = 0.02
CAMERA = Camera(die_mm=SIDE * SAMPLE_UM / 1e3)
DISPLAY = Display(dots=64, bits=16, white_cd_per_m2=2e3)
# Sources of like size: rounding by 10 bits is 4 e-.
ALL: dict[str, Any] = {
    "technology": "4t-bsi",
    "pitch_um": 2.0,
    "bits": 10,
    "full_well_e": 14_000.0,
    "black_level_dn": 200,
    "quantum_efficiency": 0.5,
    "read_noise_e": 12.0,
    "row_noise_e": 9.0,
    "dark_current_e_per_s": 9e3,
    "prnu": 0.004,
    "dsnu": 0.15,
    "offset_fpn": 8e-4,
    "column_fpn": 6e-4,
    "stack": {"enabled": False},
}
QUIET: dict[str, Any] = {
    **dict.fromkeys(("prnu", "dsnu", "read_noise_e", "row_noise_e"), 0),
    **dict.fromkeys(("dark_current_e_per_s", "offset_fpn", "column_fpn"), 0),
}
Y, X = np.mgrid[:SIDE, :SIDE]
PICTURE = 0.006 * (0.75 + 0.25 * np.sin(X / 5 + Y / 9))[..., None]
LIGHT = SpectralImage([550.0], 10.0, SAMPLE_UM, data=PICTURE)
SHARP = SpectralImage([550.0], 10.0, SAMPLE_UM, data=PICTURE, header={"diffraction": False})


def budget_of(image: SpectralImage = LIGHT, *, pixel: Any = None, **settings: Any) -> NoiseBudget:
    arguments = {"camera": CAMERA, "display": DISPLAY, "exposure": Exposure(integration_s=TIME_S)}
    chain = imaging_chain(image, pixel=Pixel(**ALL | (pixel or {})), **arguments | settings)
    budget = noise_budget(chain, image, "budget", 1)
    total = sum(budget.delta_e.values()) + budget.remainder_delta_e
    assert total == pytest.approx(budget.mean_delta_e, abs=1e-12)
    return budget


def test_variances_add_up_to_that_of_frames() -> None:
    """All sources at once, of like size, within 2 %: half a standard error of 256 columns and rows
    of 12 sensors.
    """
    chain = imaging_chain(LIGHT, CAMERA, Pixel(**ALL), Exposure(integration_s=TIME_S), DISPLAY)
    frames = [chain.capture("frames", number) for number in range(12)]
    noise_e = [
        (frame.dn - frame.black_level_dn) / frame.dn_per_e - frame.mean_dark_e - frame.mean_e
        for frame in frames
    ]
    budget = budget_of()
    sources = {source.name for source in SOURCES if source.name != "reset noise"}
    assert {*budget.electrons_e} == {ROUNDING, DARK, SHOT, *sources}
    assert min(budget.electrons_e.values()) > 0.05 * max(budget.electrons_e.values())
    assert budget.total_e**2 == pytest.approx(np.mean(np.square(noise_e)), rel=0.02)
    assert budget.measured_e == pytest.approx(budget.total_e, rel=0.05)
    closed_dn2 = frame_variance_dn2(frames[0].mean_e, TIME_S, chain.readout).mean()
    squares_e2 = sum(electrons_e**2 for electrons_e in budget.electrons_e.values())
    expected_e2 = closed_dn2 / chain.readout.dn_per_e**2
    np.testing.assert_allclose([budget.total_e**2, squares_e2], expected_e2, rtol=1e-12)


def test_causes_that_are_not_there_take_off_nothing() -> None:
    """Without noise and diffraction sampling and aperture are left; a veil changes no other cause."""
    quiet = budget_of(SHARP, pixel=QUIET)
    assert [*quiet.electrons_e] == [ROUNDING, SHOT]
    assert VEIL not in quiet.delta_e
    assert quiet.delta_e[SAMPLING] > 0.01
    np.testing.assert_allclose([quiet.delta_e[LENS], quiet.remainder_delta_e], 0, atol=1e-9)
    blurred = budget_of(pixel=QUIET)
    veil = CAMERA.model_copy(update={"veiling_glare": 0.05})
    veiled = budget_of(pixel=QUIET, camera=veil)
    assert blurred.delta_e[LENS] > 0.01
    assert veiled.delta_e[VEIL] > 0.1
    for name in (LENS, SAMPLING, APERTURE):
        assert veiled.delta_e[name] == pytest.approx(blurred.delta_e[name], abs=1e-5)
    fine = budget_of(pixel=QUIET, display=DISPLAY.model_copy(update={"raster": "one_to_one"}))
    assert SAMPLING not in fine.delta_e
    assert fine.remainder_delta_e == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("pattern", [None, "rggb"])
def test_noise_reduction_has_the_blur_of_the_expected_frame(pattern: str | None) -> None:
    """And leaves mosaic, colour and blur as they are without it. To rounding."""
    colour = {"pattern": pattern, "sensitivities": "Sony_ILCE-7M4", "peak_quantum_efficiency": 0.5}
    data = PICTURE * np.array([0.3, 0.4, 0.3])
    image = SpectralImage([450.0, 550.0, 620.0], 60.0, SAMPLE_UM, data=data)
    settings: dict[str, Any] = {"pixel": {"colour": colour} if pattern else {}}
    settings["exposure"] = Exposure(integration_s=5e-5)
    plain = budget_of(image, **settings)
    develop = Develop(denoise="wiener_bound")
    reduced = budget_of(image, develop=develop, **settings)

    pixel = Pixel(**ALL | settings["pixel"])
    chain = imaging_chain(image, CAMERA, pixel, settings["exposure"], DISPLAY, develop=develop)
    frame = noiseless_frame(chain, 5e-5)
    blurred = chain.development.score(frame).mean_delta_e
    blur = blurred - without_denoising(chain).development.score(frame).mean_delta_e
    assert blur > 0.05
    assert reduced.delta_e[REDUCTION] == pytest.approx(blur, abs=1e-12)
    others = {name: value for name, value in plain.delta_e.items() if name not in plain.electrons_e}
    assert {name: reduced.delta_e[name] for name in others} == pytest.approx(others, abs=1e-9)


def test_motion_takes_off_what_it_adds() -> None:
    """What a moving picture has more than a still one, on the same part of the scene."""
    still, moving = (
        budget_of(
            pixel=QUIET, border_um=40.0, motion=Motion(image_um_per_s=(speed, 0.0), margin_um=20.0)
        )
        for speed in (0.0, 400.0)
    )
    assert MOTION not in still.delta_e
    assert moving.delta_e[MOTION] > 0.05
    others = {name: value for name, value in still.delta_e.items() if name not in still.electrons_e}
    assert {name: moving.delta_e[name] for name in others} == pytest.approx(others, abs=1e-4)


def test_flicker_is_the_first_cause() -> None:
    """The others are those of the steady exposure."""
    lamp = Exposure(
        integration_s=TIME_S / 8, frames=8, flicker_hz=100.0, flicker_depth=0.9, line_time_us=10,
        shutter="rolling",
    )  # fmt: skip
    budget = budget_of(exposure=lamp)
    steady = budget_of(exposure=lamp.steady)
    assert next(iter(budget.delta_e)) == FLICKER
    expected = {FLICKER: budget.mean_delta_e - steady.mean_delta_e} | steady.delta_e
    assert budget.delta_e == pytest.approx(expected, abs=1e-12)


def test_new_source_has_its_line(monkeypatch: pytest.MonkeyPatch) -> None:
    new = NoiseSource("a new source", lambda _: 30.0, is_temporal=True)
    monkeypatch.setattr(noise, "SOURCES", (*SOURCES, new))
    budget = budget_of(pixel=QUIET)
    assert budget.electrons_e["a new source"] == pytest.approx(30, rel=1e-12)
    assert budget.delta_e["a new source"] > 0


def test_finer_adc_has_the_same_range() -> None:
    readout = Readout.of(derive(Pixel(**ALL))).at(Exposure(gain_db=12.0))
    finer = finer_adc(readout)
    assert finer.adc_range_e == pytest.approx(readout.adc_range_e, rel=2**-9)
    assert finer.dn_per_e / readout.dn_per_e == pytest.approx(256, rel=1e-12)
    black_e = [adc.adc.black_level_dn / adc.dn_per_e for adc in (finer, readout)]
    assert black_e[0] == pytest.approx(black_e[1], rel=1e-12)
    assert finer_adc(replace(readout, adc=replace(readout.adc, bits=24))).adc.bits == 31


# --- parts of colour


COLOUR_NM = np.arange(402.5, 700.0, 5.0)
COLOUR_CAMERA = Camera(die_mm=0.1)
FILTERS = {
    k: [[float(x), float(0.5 * np.exp(-(((x - c) / 45) ** 2)))] for x in range(400, 701, 10)]
    for k, c in zip("RGB", (600, 540, 460), strict=True)
}
OBSERVER = {
    k: np.stack([nm, curve / 4], axis=1).tolist()
    for nm in [np.arange(400.0, 701.0)]
    for k, curve in zip("RGB", (colour_matching(nm) / nm[:, None] * 400).T, strict=True)
}


def parts(colour: dict[str, Any] | None, **fields: Any) -> dict[str, float]:
    """Return the parts of waves of two colours."""
    wave = np.sin(X[:64, :64] / 4 + Y[:64, :64] / 9)
    planes = np.array([0.5 + 0.4 * wave, 0.5 - 0.4 * wave], np.float32)
    spectra = 0.2 + 0.6 * np.array([COLOUR_NM > 580, COLOUR_NM < 500])
    factor = float(irradiance_factor(4.0, 0.0, COLOUR_CAMERA.magnification))
    lumens = luminous_weight(COLOUR_NM, np.full(COLOUR_NM.size, 5.0)) @ d65(COLOUR_NM)
    white = d65(COLOUR_NM) * 1e3 * factor / lumens
    header = {"lamp_w_per_m2_sr_nm": white.tolist()}
    factors = spectra * white, planes
    image = SpectralImage(COLOUR_NM, 5.0, 100 / 64, factors=factors, header=header)
    bare = {"technology": "4t-bsi", "pitch_um": 2.0, "stack": {"enabled": False}, "bits": 16}
    pixel = Pixel(**bare | {"colour": colour} | fields)
    display = Display(dots=40, bits=16, white_cd_per_m2=1e3)
    develop = Develop(matrix="least_squares")
    chain = imaging_chain(image, COLOUR_CAMERA, pixel, display=display, develop=develop)
    budget = noise_budget(chain, image, "parts", 1)
    assert sum(budget.parts.values()) == pytest.approx(budget.mean_delta_e, abs=1e-12)
    return budget.parts


def test_each_part_of_colour_has_its_cause() -> None:
    """The observer's channels have no colour error and the same blur; pixels with all channels no
    mosaic; grey ones neither.
    """
    noisy = {"read_noise_e": 100.0}
    whole = parts({"quantum_efficiencies": FILTERS}, **noisy)
    assert min(whole[part] for part in (NOISE, MOSAIC, COLOUR_ERROR, BLUR)) > 0.02
    assert whole[CROSSTALK] == 0.0
    exact = parts({"quantum_efficiencies": OBSERVER}, **noisy)
    assert exact[COLOUR_ERROR] == pytest.approx(0, abs=2e-3)
    assert exact[BLUR] == pytest.approx(whole[BLUR], rel=1e-12)
    layers = parts({"pattern": "stacked", "quantum_efficiencies": FILTERS}, **noisy)
    assert layers[MOSAIC] == pytest.approx(0, abs=1e-6)
    assert layers[COLOUR_ERROR] == pytest.approx(whole[COLOUR_ERROR], rel=1e-9)
    grey = parts(None, quantum_efficiency=0.5, **noisy)
    assert [grey[MOSAIC], grey[CROSSTALK], grey[COLOUR_ERROR]] == [0.0, 0.0, 0.0]


def test_crosstalk_between_colours_is_no_colour_error() -> None:
    """The matrix takes it apart, which sharpens: the part is below 0, and more blur is left."""
    stack = {"height_um": 4.0, "index": 1.5, "microlens": "none"}
    colour = {"quantum_efficiencies": FILTERS}
    alone, mixed = (
        parts(colour, stack=stack | {"crosstalk": c}, **QUIET, reset_noise_factor=0)
        for c in (0.0, 0.1)
    )
    assert mixed[COLOUR_ERROR] == pytest.approx(alone[COLOUR_ERROR], rel=0.05)
    assert mixed[MOSAIC] == pytest.approx(alone[MOSAIC], rel=0.1)
    assert mixed[CROSSTALK] < 2 * alone[CROSSTALK] < 0
    assert mixed[BLUR] > alone[BLUR] + 0.01


@pytest.mark.parametrize(
    "colour",
    [{"pattern": "grbg"}, {"pattern": "quad_rggb"}, {"matrix": ["RGB", "GGR"]},
     {"pattern": "stacked"}],
    ids=str,
)  # fmt: skip
def test_neighbours_share_what_the_mosaic_collects(colour: dict[str, Any]) -> None:
    """Of uniform light, channel by channel."""
    pixel = Pixel(
        technology="4t-bsi", pitch_um=2.0, colour=colour | {"quantum_efficiencies": FILTERS}
    )
    layout = Layout.unbinned(pixel)
    assert layout is not None
    around = neighbours(layout)
    np.testing.assert_allclose(around.sum(axis=1), 1, rtol=1e-12)
    shares = np.random.default_rng(1).uniform(0, 1, (3, 5, 5))
    collections = tuple(Collection(kernel[None, None], kernel.sum(), 2.0) for kernel in shares)
    collection = ColourCollection(layout, collections, (1.0, 2.0, 3.0), 2.0)
    mixing_um2 = (around * shares).sum(axis=(2, 3)) * 2.0**2
    np.testing.assert_allclose(mixing_um2, collection.mixing_um2, rtol=1e-12)
