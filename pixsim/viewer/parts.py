"""What a picture's ΔE is made of: noise, mosaic, crosstalk, colour error and blur, each left out in turn.

In this order, on which they depend: the whole; without noise, fixed pattern, codes of the ADC, and noise reduction with the blur
that it makes; without the mosaic, every pixel knowing each channel as that channel's pixels would record it there; without
crosstalk of colours, where the light of neighbours passed this pixel's filter, and without shading; without colour error, with
channels that are the observer's. What is left then is the blur of lens, pixels, neighbours and display, and the display's codes.

The matrix takes crosstalk of colours apart. That amplifies noise, which belongs to noise, and it sharpens, so that crosstalk's own
part is small and may be below 0.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from pixsim.base.arrays import Array
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.sensor.collection import Collection, ColourCollection, collection_of, read_as_one
from pixsim.sensor.colour import Layout
from pixsim.sensor.crosstalk import share_with_neighbours
from pixsim.sensor.integration import (
    M2_PER_UM2,
    Moves,
    array_on,
    centred_pixels,
    diffracted,
    diffusion_of,
    illumination_of,
    integrate_pixels,
)
from pixsim.sensor.motion import STANDING, LightSpectrum, Moving
from pixsim.sensor.pixel import PixelPhysics
from pixsim.sensor.readout import Frame, integration_time_s, lasting, make_frame
from pixsim.viewer.develop import white_y, xyz_weights
from pixsim.viewer.develop_steps import developed
from pixsim.viewer.score import ImagingChain, PreparedScene, shown


@dataclass(frozen=True)
class Parts:
    """Parts of a mean ΔE; they add up to it.

    noise, mosaic, crosstalk, colour_error, blur : what leaving them out, in this order, takes off; blur is what is left
    dots_per_pixel : along a side; dots larger than pixels average their noise
    """

    mean_delta_e: float
    noise: float
    mosaic: float
    crosstalk: float
    colour_error: float
    blur: float
    dots_per_pixel: float

    def as_dict(self) -> dict[str, float]:
        """Return the parts as in score.json and parts.csv."""
        return asdict(self)


def delta_e_parts(
    irradiance: SpectralImage, camera: Camera, physics: PixelPhysics, light: PreparedScene, chain: ImagingChain, *key: object
) -> Parts:
    """Return the parts of the mean ΔE of one sensor and frame.

    light, chain : of the pixel
    key : of the sensor and the frame, as of `ImagingChain.simulate`
    """
    screen, moving = chain.screen, chain.moving
    whole = chain.simulate(*key).mean_delta_e
    time_s = integration_time_s(chain.exposure, chain.physics, float(chain.signal_e_per_s.max()))
    still = noiseless_frame(chain, time_s)
    steps = [whole, undenoised(chain).score_frame(still).mean_delta_e]
    if light.rendition is not None:
        own = replace(chain, collection=None, rendition=light.rendition, whites_e_per_s=light.whites_e_per_s(physics))
        pixels = centred_pixels(light.array_um, physics)
        planes = [
            at_every_pixel(one.rate_e_per_s_um2, light, physics, collection_of(channel, one.illumination, pixels), moving) / white
            for one, channel, white in zip(light.lights, physics.channels, light.whites_e_per_s_um2, strict=True)
        ]
        blur = diffusion_of(physics)
        mean = collection_of(physics, illumination_of(irradiance, camera, physics), pixels)
        seen = diffracted(irradiance, camera, list(xyz_weights(irradiance)), blur)
        white = white_y(irradiance, camera, screen.display) * M2_PER_UM2
        observed = [at_every_pixel(rate, light, physics, mean, moving) / white for rate in seen]
        # Without a stack, channels record their own light only.
        recorded = (_mixed_at_every_pixel(light, physics, chain), chain.matrix) if chain.collection else (planes, own.matrix)
        for channels, matrix in (recorded, (planes, own.matrix), (observed, light.rendition.to_display)):
            c = own.developing(still, matrix)
            picture = own.toned(own.mixed_on_dots(developed(list(channels), c), c))
            steps.append(float(screen.delta_e_of(shown(picture, screen.display)).mean()))
    else:
        steps += [steps[-1]] * 3
    noise, mosaic, crosstalk, colour_error = (before - after for before, after in pairwise(steps))
    dots = 1.0 if screen.dot_um is None else chain.physics.read_pitch_um / screen.dot_um
    return Parts(whole, noise, mosaic, crosstalk, colour_error, steps[-1], dots)


def undenoised(chain: ImagingChain) -> ImagingChain:
    """Return a chain whose development takes no noise away."""
    return replace(chain, develop=chain.develop.model_copy(update={"denoise": "none"})) if chain.develop.denoises else chain


def noiseless_frame(chain: ImagingChain, integration_s: float) -> Frame:
    """Return the frame of the mean electrons, without noise, fixed pattern and rounding; as of a well without end."""
    exposure = lasting(chain.exposure, integration_s)
    empty = np.zeros(chain.signal_e_per_s.shape, np.int32)
    frame = make_frame(empty, 0.0, chain.signal_e_per_s, chain.physics, exposure)
    return replace(frame, corrected_e=(chain.signal_e_per_s * integration_s).astype(np.float32))


def _array(light: PreparedScene, physics: PixelPhysics) -> tuple[tuple[int, int], tuple[float, float], tuple[float, float] | None]:
    """Return `array_on` of the pixels."""
    picture_um = [count * light.sample_pitch_um for count in light.rate_e_per_s_um2.shape]
    return array_on(picture_um, light.array_um, physics)


def at_every_pixel(
    rate: Array,
    light: PreparedScene,
    physics: PixelPhysics,
    collection: Collection | None,
    moving: Moving = STANDING,
    *,
    shares: bool = True,
) -> Array:
    """Return the mean light on every pixel, (rows, columns), as one channel would see it everywhere, without shading.

    moving : how it moves over the pixels
    shares : whether pixels around collect light of each other
    """
    side_um = physics.photodiode_side_um if collection is None else collection.aperture_side_um
    mean = _means(rate, light, physics, side_um, moving)
    if collection is not None and shares:
        rows, columns = mean.shape
        mean = share_with_neighbours(mean, collection.shares) / collection.on_axis / collection.relative((rows, columns))
    side = physics.as_read.bin_side
    return read_as_one(mean, side) / side**2


def _means(rate: Array, light: PreparedScene, physics: PixelPhysics, side_um: float, moving: Moving) -> Array:
    """Return the mean of a rate over the aperture of every pixel, (rows, columns)."""
    _, size_um, first_um = _array(light, physics)
    moves = Moves(LightSpectrum(rate), moving, physics.as_read.bin_side) if moving.is_on else None
    options: dict[str, Any] = {"size_um": size_um, "first_um": first_um, "moves": moves}
    return integrate_pixels(rate, light.sample_pitch_um, physics.pitch_um, side_um, **options) / side_um**2


def _mixed_at_every_pixel(light: PreparedScene, physics: PixelPhysics, chain: ImagingChain) -> list[Array]:
    """Return what each channel records at every pixel, 1 for white, with the light of neighbours through their filters.

    The neighbours are those of the channel's pixels in the unit cell, in the mean over them.
    """
    collection = chain.collection
    assert isinstance(collection, ColourCollection)
    means = [
        _means(one.rate_e_per_s_um2, light, physics, each.aperture_side_um, chain.moving)
        for one, each in zip(light.lights, collection.each, strict=True)
    ]
    planes, side = [], physics.as_read.bin_side
    for weights in neighbours(collection.layout):
        recorded, even = (
            sum(
                share_with_neighbours(values, each.shares * weight)
                for values, each, weight in zip(of_channels, collection.each, weights, strict=True)
                if weight.any()
            )
            for of_channels in (means, [np.full(means[0].shape, rate) for rate in collection.rates])
        )
        recorded, even = read_as_one(np.asarray(recorded), side), read_as_one(np.asarray(even), side)
        planes.append(recorded / (even if chain.shading is not None else even[even.shape[0] // 2, even.shape[1] // 2]))
    return planes


def neighbours(layout: Layout) -> Array:
    """Return how often the pixels around one of each channel have each channel, (C, C, 5, 5): the pixel's, its neighbour's, where.

    The places are those of `share_with_neighbours`: [dy + 2, dx + 2] is dy rows above and dx columns to the left.
    """
    count = len(layout.channels)
    if layout.is_stacked:
        return np.asarray(np.eye(count)[:, :, None, None] * np.ones((5, 5)))
    cell = layout.numbers(layout.period)
    found = np.empty((count, count, 5, 5))
    for dy, dx in np.ndindex(5, 5):
        moved = np.roll(cell, (dy - 2, dx - 2), axis=(0, 1))
        for own, other in np.ndindex(count, count):
            found[own, other, dy, dx] = np.mean(moved[cell == own] == other)
    return found
