"""What a frame's noise and its mean ΔE are made of, cause by cause: each is switched off in turn, and stays off.

Light that flickers first, which is steady for all else. Then noise, from the codes back to the light: rounding by the ADC, each
source of `pixsim.sensor.noise` from the last to the first, shot noise of dark charge, and that of light; then noise reduction, for
what it blurs. Then what `delta_e_parts` tells of colours: mosaic, crosstalk and shading, colour error. Then motion, and the blur
in the order of the light: veiling glare, lens, light and charge of neighbours, sampling and the display's interpolation, and the
pixel's aperture. What is left is the remainder.

Variances add: those of all causes together are that of the frame. Contributions to ΔE do not: where several faults hide one
another, a cause takes off more the later it is switched off, and one that is nearly nothing may take off a little less than 0, by
the random numbers of another draw.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from pixsim.base.arrays import Array, mixed
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.optics.camera_lens import LENS_HEADER, ideal_light, without_lens
from pixsim.sensor.collection import collection_of
from pixsim.sensor.integration import (
    M2_PER_UM2,
    centred_pixels,
    diffracted,
    diffusion_of,
    electrons_per_joule,
    illumination_of,
    integrate_pixels,
)
from pixsim.sensor.motion import STANDING, Moving
from pixsim.sensor.noise import variances_e2, without_source
from pixsim.sensor.pixel import PixelPhysics
from pixsim.sensor.quantities import MAX_CODE_BITS
from pixsim.sensor.readout import Frame, lasting
from pixsim.viewer.develop import white_y, xyz_weights
from pixsim.viewer.develop_steps import developed
from pixsim.viewer.display import means_on_dots, white_rate
from pixsim.viewer.parts import Parts, at_every_pixel, delta_e_parts, noiseless_frame
from pixsim.viewer.score import ImagingChain, PreparedScene, shown

REDUCTION = "noise reduction"
SHOT, DARK, ROUNDING = "shot noise of light", "shot noise of dark charge", "rounding by the ADC"
SAMPLING, APERTURE = "sampling and interpolation", "pixel aperture"
FLICKER, MOTION, VEIL, LENS, NEIGHBOURS = "flicker of the light", "motion", "veiling glare", "lens", "neighbours"
MORE_BITS = 8  # of an ADC that rounds 256 times finer


@dataclass(frozen=True)
class NoiseBudget:
    """Noise in electrons, and mean ΔE, by cause.

    electrons_e : cause -> standard deviation, the root of the mean square over the values of a frame
    total_e : of all of them, by the closed forms
    measured_e : of the frame: its difference from the mean electrons
    render_e : of the light by its render, which the ideal picture has too; no part of the others
    mean_delta_e : of the frame
    delta_e : cause -> what switching it off takes off the mean ΔE, in this order
    remainder_delta_e : that is left without all of them
    """

    electrons_e: dict[str, float]
    total_e: float
    measured_e: float
    render_e: float
    mean_delta_e: float
    delta_e: dict[str, float]
    remainder_delta_e: float

    def as_dict(self) -> dict[str, Any]:
        """Return the budget as in score.json."""
        return asdict(self)

    def rows(self) -> Iterator[tuple[str, float | None, float]]:
        """Yield each cause with its electrons, None for those of blur and colour, and its ΔE."""
        for cause, delta_e in self.delta_e.items():
            yield cause, self.electrons_e.get(cause), delta_e


def noise_budget(
    irradiance: SpectralImage, camera: Camera, physics: PixelPhysics, light: PreparedScene, chain: ImagingChain, *key: object
) -> NoiseBudget:
    """Return the noise budget of one sensor and frame.

    light, chain : of the pixel
    key : of the sensor and the frame, as of `ImagingChain.simulate`
    """
    if chain.exposure.flickers:
        whole = chain.simulate(*key).mean_delta_e
        steady = noise_budget(irradiance, camera, physics, light, replace(chain, exposure=chain.exposure.steady), *key)
        delta_e = {FLICKER: whole - steady.mean_delta_e} | steady.delta_e
        return replace(steady, mean_delta_e=whole, delta_e=delta_e)
    frame = chain.capture(*key)
    time_s = frame.integration_s
    variances = variances_of(chain, time_s)
    measured = (frame.dn - frame.black_level_dn) / frame.dn_per_e - frame.mean_dark_e - frame.mean_e
    still = noiseless_frame(chain, time_s)
    parts = delta_e_parts(irradiance, camera, physics, light, chain, *key)
    reduced = chain.score_frame(still).mean_delta_e - parts.mean_delta_e + parts.noise if chain.develop.denoises else 0.0
    noise = delta_e_of_noise(chain, frame, parts, variances, reduced, key)
    others = {"mosaic": parts.mosaic, "crosstalk and shading": parts.crosstalk, "colour error": parts.colour_error}
    blur, remainder = delta_e_of_blur(irradiance, camera, physics, light, chain, still, parts.blur)
    coloured = others if light.rendition is not None else {}
    return NoiseBudget(
        electrons_e={name: math.sqrt(value) for name, value in variances.items()},
        total_e=math.sqrt(sum(variances.values())),
        measured_e=float(np.sqrt(np.mean(np.square(measured)))),
        render_e=render_noise_of(irradiance) * float(np.sqrt(np.mean(np.square(frame.mean_e)))),
        mean_delta_e=parts.mean_delta_e,
        delta_e=noise | ({REDUCTION: reduced} if chain.develop.denoises else {}) | coloured | blur,
        remainder_delta_e=remainder,
    )


def render_noise_of(irradiance: SpectralImage) -> float:
    """Return the noise of a render relative to its light; 0 where the light states none."""
    stated = irradiance.header.get("render_noise")
    relative = stated.get("relative") if isinstance(stated, dict) else None
    return relative if isinstance(relative, float) else 0.0


def variances_of(chain: ImagingChain, integration_s: float) -> dict[str, float]:
    """Return the variance of a frame by each cause of noise, the mean over its values in electrons squared, in their order.

    Valid where nothing clips: at 0 DN and at the well a frame varies less.
    """
    p, light_e = chain.physics, chain.signal_e_per_s * integration_s
    dark_e = p.dark_current_e_per_s * integration_s
    of_sources = {name: float(np.mean(value)) for name, value in variances_e2(p, light_e=light_e, dark_e=dark_e).items()}
    of_dark = {DARK: dark_e} if dark_e > 0 else {}
    found = {name: value for name, value in reversed(of_sources.items()) if value > 0} | of_dark
    return {ROUNDING: p.rounding_variance_dn2 / p.dn_per_e**2} | found | {SHOT: float(np.mean(light_e))}


def finer_adc(physics: PixelPhysics) -> PixelPhysics:
    """Return the pixel with an ADC of the same range that rounds 256 times finer, as far as codes have the bits."""
    more = min(MORE_BITS, MAX_CODE_BITS - physics.code_bits)
    finer = {"bits": physics.pixel.bits + more, "black_level_dn": physics.pixel.black_level_dn * 2**more}
    gain_e_per_dn = physics.amplification / physics.dn_per_e / 2**more
    return replace(physics, pixel=physics.pixel.model_copy(update=finer), gain_e_per_dn=gain_e_per_dn)


def delta_e_of_noise(
    chain: ImagingChain, frame: Frame, parts: Parts, variances: dict[str, float], reduced: float, key: tuple[object, ...]
) -> dict[str, float]:
    """Return what each cause of noise takes off the mean ΔE, in the order of `variances`; with `reduced` it is `Parts.noise`.

    reduced : what leaving out noise reduction takes off then
    """
    exposure = lasting(chain.exposure, frame.integration_s)
    physics, steps = chain.physics, [parts.mean_delta_e]
    for name in variances:
        if name == SHOT:
            steps.append(parts.mean_delta_e - parts.noise + reduced)
            continue
        if name == ROUNDING:
            physics = finer_adc(physics)
        elif name == DARK:
            physics = replace(physics, dark_current_e_per_s=0.0)
        else:
            physics = without_source(physics, name)
        steps.append(replace(chain, physics=physics, exposure=exposure).simulate(*key).mean_delta_e)
    return {name: before - after for name, (before, after) in zip(variances, pairwise(steps), strict=True)}


def delta_e_of_blur(
    irradiance: SpectralImage,
    camera: Camera,
    physics: PixelPhysics,
    light: PreparedScene,
    chain: ImagingChain,
    still: Frame,
    whole: float,
) -> tuple[dict[str, float], float]:
    """Return what each cause of blur takes off the mean ΔE of a picture without noise and colour error, and what is left.

    whole : that mean ΔE
    """
    screen, rendition = chain.screen, light.rendition
    if rendition is None:
        weights = [electrons_per_joule(physics, irradiance)]
        white = white_rate(irradiance, camera, physics, screen.display)
    else:
        weights, white = list(xyz_weights(irradiance)), white_y(irradiance, camera, screen.display) * M2_PER_UM2
    blur, pixels = diffusion_of(physics), centred_pixels(light.array_um, physics)
    collection = collection_of(physics, illumination_of(irradiance, camera, physics), pixels)
    matrix = np.ones((1, 1)) if rendition is None else rendition.to_display

    def delta_e_on(light: Array) -> float:
        return float(screen.delta_e_of(shown(chain.toned(light), screen.display)).mean())

    def of_pixels(rates: list[Array], shares: bool, moving: Moving = STANDING) -> float:
        planes = [at_every_pixel(rate, light, physics, collection, moving, shares=shares) / white for rate in rates]
        c = chain.developing(still, None if rendition is None else matrix)
        return delta_e_on(chain.mixed_on_dots(developed(planes, c), c))

    names: list[str] = []
    steps = [whole]

    def step(name: str, left: float) -> None:
        names.append(name)
        steps.append(left)

    if rendition is None and collection is not None:
        step("shading", of_pixels(diffracted(irradiance, camera, weights, blur), True, chain.moving))
    if chain.moving.is_on:
        step(MOTION, of_pixels(diffracted(irradiance, camera, weights, blur), True))
    if camera.veiling_glare:
        step(VEIL, of_pixels(diffracted(irradiance, camera.without_veil, weights, blur), True))
    sharp = ideal_light(irradiance, camera)
    header = {name: value for name, value in sharp.header.items() if name != LENS_HEADER} | {"diffraction": False}
    sharp = sharp.with_planes(sharp.whole.planes, header=header, margin=sharp.margin)
    rates = diffracted(sharp, without_lens(camera).without_veil, weights, blur)
    step(LENS, of_pixels(rates, True))
    if collection is not None or blur is not None:
        rates = diffracted(sharp, without_lens(camera).without_veil, weights, None)
        step(NEIGHBOURS, of_pixels(rates, False))
    side_um = physics.photodiode_side_um if collection is None else collection.aperture_side_um
    if screen.display.raster == "fixed_size":
        averaged = [integrate_pixels(rate, light.sample_pitch_um, light.sample_pitch_um, side_um) / side_um**2 for rate in rates]
        step(SAMPLING, delta_e_on(on_dots(averaged, light, chain, matrix, white)))
    step(APERTURE, delta_e_on(on_dots(rates, light, chain, matrix, white)))
    return {name: before - after for name, (before, after) in zip(names, pairwise(steps), strict=True)}, steps[-1]


def on_dots(rates: list[Array], light: PreparedScene, chain: ImagingChain, matrix: Array, white: float) -> Array:
    """Return the light of the display's dots, (H, W) or (3, H, W), of rates (H, W) that no pixel samples, 1 for white."""
    means = [means_on_dots(rate, light.sample_pitch_um, chain.screen.dot_edges_um) / white for rate in rates]
    return means[0] if chain.rendition is None else mixed(matrix, means)
