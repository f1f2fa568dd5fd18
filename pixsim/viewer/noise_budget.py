"""Noise and mean ΔE of a frame by cause: each cause is switched off in turn, and stays off.

Light that flickers first, which is steady for all else. Then noise, from the codes back to the
light: rounding by the ADC, each source of `pixsim.sensor.noise` from the last to the first, shot
noise of dark charge, and shot noise of light; then noise reduction, for what it blurs.

Then colour. Without the mosaic, every pixel knows each channel as that channel's pixels would
record it there. Without crosstalk and shading, no light of neighbours has passed other filters.
Without colour error, the channels are X, Y and Z of the observer. The matrix takes crosstalk of
colours apart. That amplifies noise, which belongs to noise, and it sharpens, so that the part of
crosstalk is small and may be below 0.

Then motion, and the blur in the order of the light: veiling glare, lens, light and charge of
neighbours, sampling and the display's interpolation, and the pixel's aperture. What is left is the
remainder.

Variances add: the variances of all causes sum to the variance of the frame. Contributions to ΔE do
not: where several faults hide one another, a cause takes off more the later it is switched off, and
one that is nearly nothing may take off a little less than 0, by the random numbers of another draw.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from pixsim.base.arrays import Array, mixed
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera_lens import LENS_HEADER, ideal_light, without_lens
from pixsim.sensor.collection import ColourCollection, collection_of
from pixsim.sensor.integration import (
    M2_PER_UM2,
    centred_pixels,
    diffracted,
    diffusion_of,
    electrons_per_joule,
    illumination_of,
    integrate_pixels,
)
from pixsim.sensor.merge import merged_variance_e2
from pixsim.sensor.motion import NO_IMAGE_MOTION, ImageMotion
from pixsim.sensor.noise import SOURCES, variances_e2, without_source
from pixsim.sensor.quantities import MAX_CODE_BITS
from pixsim.sensor.reading import Adc, Readout, with_all
from pixsim.sensor.readout import Frame, make_frame, with_shared_time
from pixsim.viewer.chain import ImagingChain
from pixsim.viewer.develop import white_y, xyz_weights
from pixsim.viewer.develop_steps import developed
from pixsim.viewer.display import means_on_dots, white_rate
from pixsim.viewer.every_pixel import at_every_pixel, mixed_at_every_pixel
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.scene_light import PreparedScene
from pixsim.viewer.screen import display_image

FLICKER = "flicker of the light"
REDUCTION = "noise reduction"
SHOT = "shot noise of light"
DARK = "shot noise of dark charge"
ROUNDING = "rounding by the ADC"
MOSAIC = "mosaic"
CROSSTALK = "crosstalk and shading"
COLOUR_ERROR = "colour error"
_SHADING = "shading"
MOTION = "motion"
VEIL = "veiling glare"
LENS = "lens"
_NEIGHBOURS = "neighbours"
SAMPLING = "sampling and interpolation"
APERTURE = "pixel aperture"
NOISE = "noise"
BLUR = "blur"
_MORE_BITS = 8  # of an ADC that rounds 256 times finer
# Each cause with the mean ΔE that is left without it and those before it.
Steps = Iterator[tuple[str, float]]


@dataclass(frozen=True)
class NoiseBudget:
    """Noise in electrons, and mean ΔE, by cause.

    electrons_e : cause -> standard deviation, the root of the mean square over the values of a
        frame
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

    @property
    def parts(self) -> dict[str, float]:
        """The mean ΔE by kinds of causes, which add up to it: noise, what colours cost, and blur
        with the remainder.
        """
        sums = dict.fromkeys((NOISE, MOSAIC, CROSSTALK, COLOUR_ERROR, BLUR), 0.0)
        for cause, delta_e in self.delta_e.items():
            sums[self.part_of(cause)] += delta_e
        sums[BLUR] += self.remainder_delta_e
        return sums

    def part_of(self, cause: str) -> str:
        """Return the kind of a cause, a name of `parts`."""
        if cause in (MOSAIC, CROSSTALK, COLOUR_ERROR):
            return cause
        return NOISE if cause in self.electrons_e or cause in (FLICKER, REDUCTION) else BLUR

    def rows(self) -> Iterator[tuple[str, float | None, float]]:
        """Yield each cause with its standard deviation in electrons, None for blur and colour, and
        its ΔE.
        """
        for cause, delta_e in self.delta_e.items():
            yield cause, self.electrons_e.get(cause), delta_e


def noise_budget(chain: ImagingChain, irradiance: SpectralImage, *key: object) -> NoiseBudget:
    """Return the noise budget of one sensor and frame.

    irradiance : from which the chain's scene was prepared
    key : of the sensor and the frame, for `ImagingChain.simulate`
    """
    if chain.exposure.flickers:
        mean_delta_e = chain.simulate(*key).mean_delta_e
        steady = noise_budget(replace(chain, exposure=chain.exposure.steady), irradiance, *key)
        delta_e = {FLICKER: mean_delta_e - steady.mean_delta_e} | steady.delta_e
        return replace(steady, mean_delta_e=mean_delta_e, delta_e=delta_e)
    frame = chain.capture(*key)
    time_s = frame.integration_s
    variances_e2 = _variances_of(chain, time_s)
    if chain.readout.readings:
        noise_e = frame.estimate_e - frame.mean_e
    else:
        charge_e = (frame.dn - frame.black_level_dn) / frame.dn_per_e
        noise_e = charge_e - frame.mean_dark_e - frame.mean_e
    noiseless = noiseless_frame(chain, time_s)

    # The reduction of ΔE by each cause, after the causes before it.
    mean_delta_e = chain.development.score(frame).mean_delta_e
    steps = [
        *_noise_steps(chain, noiseless, variances_e2, key),
        *_colour_steps(chain, irradiance, noiseless),
        *_blur_steps(chain, irradiance, noiseless),
    ]
    delta_e = {}
    remaining_delta_e = mean_delta_e
    for cause, without_delta_e in steps:
        delta_e[cause] = remaining_delta_e - without_delta_e
        remaining_delta_e = without_delta_e

    mean_e = float(np.sqrt(np.mean(np.square(frame.mean_e))))
    return NoiseBudget(
        electrons_e={cause: math.sqrt(value) for cause, value in variances_e2.items()},
        total_e=math.sqrt(sum(variances_e2.values())),
        measured_e=float(np.sqrt(np.mean(np.square(noise_e)))),
        render_e=_render_noise_of(irradiance) * mean_e,
        mean_delta_e=mean_delta_e,
        delta_e=delta_e,
        remainder_delta_e=remaining_delta_e,
    )


def noiseless_frame(chain: ImagingChain, integration_s: float) -> Frame:
    """Return the frame of the mean electrons, without noise, fixed pattern and rounding, and of a
    well without end.
    """
    exposure = with_shared_time(chain.exposure, integration_s)
    empty = np.zeros(chain.signal_e_per_s.shape, np.int32)
    frame = make_frame(empty, 0.0, chain.signal_e_per_s, chain.readout, exposure)
    return replace(frame, corrected_e=(chain.signal_e_per_s * integration_s).astype(np.float32))


def without_denoising(chain: ImagingChain) -> ImagingChain:
    """Return a chain whose development takes no noise away."""
    develop = chain.imaging.develop.model_copy(update={"denoise": "none"})
    return replace(chain, imaging=chain.imaging.changed(develop=develop))


def _render_noise_of(irradiance: SpectralImage) -> float:
    """Return the noise of a render relative to its light; 0 where the light states none."""
    stated = irradiance.header.get("render_noise")
    relative = stated.get("relative") if isinstance(stated, dict) else None
    return relative if isinstance(relative, float) else 0.0


def _variances_of(chain: ImagingChain, integration_s: float) -> dict[str, float]:
    """Return the variance of a frame by each cause of noise, the mean over its values in electrons
    squared, in their order.

    Valid where nothing clips: at 0 DN and at the well a frame varies less.
    """
    readout = chain.readout
    light_e = chain.signal_e_per_s * integration_s
    dark_e = readout.dark_current_e_per_s * integration_s
    if readout.readings:
        return _merged_variances(readout, light_e, integration_s)

    # From the codes back to the light.
    variances = {ROUNDING: readout.rounding_variance_dn2 / readout.dn_per_e**2}
    sources = variances_e2(readout, light_e=light_e, dark_e=dark_e)
    for name, value in reversed(sources.items()):
        mean_e2 = float(np.mean(value))
        if mean_e2 > 0:
            variances[name] = mean_e2
    if dark_e > 0:
        variances[DARK] = dark_e
    variances[SHOT] = float(np.mean(light_e))
    return variances


def _merged_variances(readout: Readout, light_e: Array, integration_s: float) -> dict[str, float]:
    """Return the variance of merged readings by each cause of noise, as the causes are left out one
    after the other.
    """
    names = [ROUNDING, *(source.name for source in reversed(SOURCES)), DARK]
    merged = partial(
        merged_variance_e2, signal_e=light_e, integration_s=integration_s, fixed_pattern=True
    )
    variances: dict[str, float] = {}
    remaining_e2 = float(np.mean(merged(readout)))
    for name in names:
        readout = _without(readout, name)
        without_e2 = float(np.mean(merged(readout)))
        if remaining_e2 > without_e2:
            variances[name] = remaining_e2 - without_e2
        remaining_e2 = without_e2
    variances[SHOT] = remaining_e2
    return variances


def _without(readout: Readout, cause: str) -> Readout:
    """Return a readout without a cause of noise, which is not shot noise."""
    if cause == ROUNDING:
        return finer_adc(readout)
    if cause == DARK:
        return readout.with_physics(dark_current_e_per_s=0.0)
    return without_source(readout, cause)


def finer_adc(readout: Readout) -> Readout:
    """Return the readout with an ADC of the same range that rounds 256 times finer, as far as codes
    have the bits.
    """
    return with_all(readout, _finer_adc)


def _finer_adc(readout: Readout) -> Readout:
    adc = readout.adc
    more_bits = min(_MORE_BITS, MAX_CODE_BITS - readout.code_bits)
    finer = Adc(
        adc.bits + more_bits,
        adc.black_level_dn * 2**more_bits,
        gain_e_per_dn=readout.amplification / readout.dn_per_e / 2**more_bits,
    )
    return replace(readout, adc=finer)


def _noise_steps(
    chain: ImagingChain, noiseless: Frame, causes: Iterable[str], key: tuple[object, ...]
) -> Steps:
    """Yield each cause of noise, in their order, and noise reduction, with the mean ΔE that is
    left.
    """
    exposure = with_shared_time(chain.exposure, noiseless.integration_s)
    readout = chain.readout
    for cause in causes:
        if cause == SHOT:
            yield cause, chain.development.score(noiseless).mean_delta_e
            continue
        readout = _without(readout, cause)
        quieter = replace(chain, readout=readout, exposure=exposure)
        yield cause, quieter.simulate(*key).mean_delta_e
    if chain.imaging.develop.denoises:
        yield REDUCTION, without_denoising(chain).development.score(noiseless).mean_delta_e


def _delta_e_of_planes(
    planes: Sequence[Array], matrix: Array | None, chain: ImagingChain, noiseless: Frame
) -> float:
    """Return the mean ΔE of channels that every pixel knows, each (rows, columns) and 1 for
    white.
    """
    undeveloped = chain.development.undeveloped(noiseless, matrix)
    dots = chain.development.mixed_on_dots(developed(list(planes), undeveloped), undeveloped)
    return _delta_e_of_dots(dots, chain)


def _delta_e_of_dots(dots: Array, chain: ImagingChain) -> float:
    """Return the mean ΔE of the light of the display's dots, (H, W) or (3, H, W), 1 for white."""
    image = display_image(chain.development.toned(dots), chain.screen.display)
    return float(chain.screen.delta_e_map(image).mean())


def _colour_steps(chain: ImagingChain, irradiance: SpectralImage, noiseless: Frame) -> Steps:
    """Yield mosaic, crosstalk with shading, and colour error, with the mean ΔE that is left;
    nothing for grey sensors.
    """
    imaging = chain.imaging
    scene = chain.scene
    physics = imaging.physics
    assert scene is not None
    if scene.colour_chart is None:
        return
    whites = scene.whites_e_per_s(physics)
    unmixed = replace(
        chain, collection=None, colour_chart=scene.colour_chart, whites_e_per_s=whites
    )

    # Each channel at every pixel, by its own filter alone.
    pixels = centred_pixels(scene.array_um, physics)
    unmixed_planes = []
    for light, channel, white in zip(
        scene.lights, physics.channels, scene.whites_e_per_s_um2, strict=True
    ):
        collection = collection_of(channel, light.illumination, pixels)
        rate = at_every_pixel(
            light.rate_e_per_s_um2, scene, physics, collection, chain.image_motion
        )
        unmixed_planes.append(rate / white)

    # Without a stack, channels record no other light.
    if chain.collection is None:
        recorded = unmixed_planes
        matrix = unmixed.development.matrix
    else:
        assert isinstance(chain.collection, ColourCollection)
        is_shaded = chain.development.shading is not None
        recorded = mixed_at_every_pixel(
            scene, physics, chain.collection, chain.image_motion, is_shaded=is_shaded
        )
        matrix = chain.development.matrix
    yield MOSAIC, _delta_e_of_planes(recorded, matrix, unmixed, noiseless)
    yield (
        CROSSTALK,
        _delta_e_of_planes(unmixed_planes, unmixed.development.matrix, unmixed, noiseless),
    )

    # The observer's X, Y and Z in place of the channels.
    weights, white = _observer_weights(chain.development.imaging, irradiance)
    illumination = illumination_of(irradiance, imaging.camera, physics)
    collection = collection_of(physics, illumination, pixels)
    rates = diffracted(irradiance, imaging.camera, weights, diffusion_of(physics))
    observed = [
        at_every_pixel(rate, scene, physics, collection, chain.image_motion) / white
        for rate in rates
    ]
    yield (
        COLOUR_ERROR,
        _delta_e_of_planes(observed, scene.colour_chart.to_display, unmixed, noiseless),
    )


def _observer_weights(imaging: Imaging, irradiance: SpectralImage) -> tuple[list[Array], float]:
    """Return the weights of the light's bands, for X, Y and Z or a grey sensor's electrons, and the
    rate of display white per µm².
    """
    physics = imaging.physics
    if physics.layout is None:
        return [electrons_per_joule(physics, irradiance)], white_rate(imaging, irradiance)
    white = white_y(irradiance, imaging.camera, imaging.display)
    return list(xyz_weights(irradiance)), white * M2_PER_UM2


def _blur_steps(chain: ImagingChain, irradiance: SpectralImage, noiseless: Frame) -> Steps:
    """Yield each cause of blur with the mean ΔE that is left, of a picture without noise and colour
    error.
    """
    scene = chain.scene
    camera = chain.imaging.camera
    physics = chain.imaging.physics
    assert scene is not None
    weights, white = _observer_weights(chain.development.imaging, irradiance)
    matrix = None if scene.colour_chart is None else scene.colour_chart.to_display
    diffusion = diffusion_of(physics)
    pixels = centred_pixels(scene.array_um, physics)
    collection = collection_of(physics, illumination_of(irradiance, camera, physics), pixels)

    def delta_e_of_pixels(
        rates: list[Array], *, shares: bool = True, image_motion: ImageMotion = NO_IMAGE_MOTION
    ) -> float:
        planes = [
            at_every_pixel(rate, scene, physics, collection, image_motion, shares=shares) / white
            for rate in rates
        ]
        return _delta_e_of_planes(planes, matrix, chain, noiseless)

    # Shading, motion and veil, of the light behind the lens.
    if scene.colour_chart is None and collection is not None:
        rates = diffracted(irradiance, camera, weights, diffusion)
        yield _SHADING, delta_e_of_pixels(rates, image_motion=chain.image_motion)
    if chain.image_motion.is_on:
        rates = diffracted(irradiance, camera, weights, diffusion)
        yield MOTION, delta_e_of_pixels(rates)
    if camera.veiling_glare:
        rates = diffracted(irradiance, camera.without_veil, weights, diffusion)
        yield VEIL, delta_e_of_pixels(rates)

    # The lens, then light and charge of neighbours.
    sharp = _without_lens_blur(ideal_light(irradiance, camera))
    sharp_camera = without_lens(camera).without_veil
    rates = diffracted(sharp, sharp_camera, weights, diffusion)
    yield LENS, delta_e_of_pixels(rates)
    if collection is not None or diffusion is not None:
        rates = diffracted(sharp, sharp_camera, weights, None)
        yield _NEIGHBOURS, delta_e_of_pixels(rates, shares=False)

    # Sampling and interpolation, then the aperture of a pixel.
    side_um = physics.photodiode_side_um if collection is None else collection.aperture_side_um
    sample_um = scene.sample_pitch_um
    if chain.screen.display.raster == "fixed_size":
        averaged = [
            integrate_pixels(rate, sample_um, sample_um, side_um) / side_um**2 for rate in rates
        ]
        yield SAMPLING, _delta_e_of_dots(on_dots(averaged, scene, chain, matrix, white), chain)
    yield APERTURE, _delta_e_of_dots(on_dots(rates, scene, chain, matrix, white), chain)


def _without_lens_blur(irradiance: SpectralImage) -> SpectralImage:
    """Return light whose header names no lens and no diffraction."""
    header = {name: value for name, value in irradiance.header.items() if name != LENS_HEADER}
    header["diffraction"] = False
    return irradiance.with_planes(irradiance.whole.planes, header=header, margin=irradiance.margin)


def on_dots(
    rates: list[Array],
    scene: PreparedScene,
    chain: ImagingChain,
    matrix: Array | None,
    white: float,
) -> Array:
    """Return the light of the display's dots, (H, W) or (3, H, W), of rates (H, W) that no pixel
    samples, 1 for white.

    matrix : from X, Y and Z to the display's primaries, or None for a grey sensor
    """
    means = [
        means_on_dots(rate, scene.sample_pitch_um, chain.screen.dot_edges_um) / white
        for rate in rates
    ]
    return means[0] if matrix is None else mixed(matrix, means)
