"""The mean electrons of every pixel in each channel, as a sensor without a mosaic would record
them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pixsim.base.arrays import Array
from pixsim.sensor.collection import Collection, ColourCollection, bin_pixels
from pixsim.sensor.colour import Layout
from pixsim.sensor.crosstalk import share_with_neighbours
from pixsim.sensor.integration import MovingPicture, array_on, integrate_pixels
from pixsim.sensor.motion import NO_IMAGE_MOTION, ImageMotion, LightSpectrum
from pixsim.sensor.pixel import PixelPhysics
from pixsim.viewer.scene_light import PreparedScene


def at_every_pixel(
    rate: Array,
    light: PreparedScene,
    physics: PixelPhysics,
    collection: Collection | None,
    image_motion: ImageMotion = NO_IMAGE_MOTION,
    *,
    shares: bool = True,
) -> Array:
    """Return the mean rate of one channel at every pixel, (rows, columns), without shading.

    moving : how it moves over the pixels
    shares : whether pixels around collect light of each other
    """
    side_um = physics.photodiode_side_um if collection is None else collection.aperture_side_um
    mean = _aperture_means(rate, light, physics, side_um, image_motion)
    if collection is not None and shares:
        rows, columns = mean.shape
        mean = (
            share_with_neighbours(mean, collection.shares)
            / collection.on_axis
            / collection.relative((rows, columns))
        )
    side = physics.pixel.bin_side
    return bin_pixels(mean, side) / side**2


def _aperture_means(
    rate: Array,
    light: PreparedScene,
    physics: PixelPhysics,
    side_um: float,
    image_motion: ImageMotion,
) -> Array:
    """Return the mean of a rate over the aperture of every pixel, (rows, columns)."""
    picture_um = [count * light.sample_pitch_um for count in light.rate_e_per_s_um2.shape]
    _, size_um, first_um = array_on(picture_um, light.array_um, physics)
    moving_picture = (
        MovingPicture(LightSpectrum(rate), image_motion, physics.pixel.bin_side)
        if image_motion.is_on
        else None
    )
    total = integrate_pixels(
        rate,
        light.sample_pitch_um,
        physics.pitch_um,
        side_um,
        size_um=size_um,
        first_um=first_um,
        moving_picture=moving_picture,
    )
    return total / side_um**2


def mixed_at_every_pixel(
    light: PreparedScene,
    physics: PixelPhysics,
    collection: ColourCollection,
    image_motion: ImageMotion,
    *,
    is_shaded: bool,
) -> list[Array]:
    """Return what each channel records at every pixel, 1 for white, with the light of neighbours
    through their filters.

    Pixels of a channel have different neighbours in the unit cell. Their mean counts.

    is_shaded : whether the frame's shading is taken out, place by place; else white is the value in
        the middle
    """
    means = [
        _aperture_means(
            channel_light.rate_e_per_s_um2, light, physics, channel.aperture_side_um, image_motion
        )
        for channel_light, channel in zip(light.lights, collection.collections, strict=True)
    ]
    flat_fields = [np.full(means[0].shape, rate) for rate in collection.rates]
    side = physics.pixel.bin_side

    def recorded(pictures: Sequence[Array], weights: Array) -> Array:
        """Return what one channel records of the pictures of all channels.

        weights : (C, 5, 5), how often the pixels around have each channel
        """
        total: Array | int = 0
        for picture, channel, weight in zip(pictures, collection.collections, weights, strict=True):
            if weight.any():
                total = total + share_with_neighbours(picture, channel.shares * weight)
        return bin_pixels(np.asarray(total), side)

    planes = []
    for weights in neighbours(collection.layout):
        white = recorded(flat_fields, weights)
        if not is_shaded:
            white = white[white.shape[0] // 2, white.shape[1] // 2]
        planes.append(recorded(means, weights) / white)
    return planes


def neighbours(layout: Layout) -> Array:
    """Return how often the pixels around one of each channel have each channel, (C, C, 5, 5): the
    pixel's, its neighbour's, where.

    As in `share_with_neighbours`, the place [dy + 2, dx + 2] is dy rows above and dx columns to the
    left.
    """
    count = len(layout.channels)
    if layout.is_stacked:
        return np.asarray(np.eye(count)[:, :, None, None] * np.ones((5, 5)))
    cell = layout.numbers(layout.period)
    shares = np.empty((count, count, 5, 5))
    for dy, dx in np.ndindex(5, 5):
        moved = np.roll(cell, (dy - 2, dx - 2), axis=(0, 1))
        for channel, neighbour in np.ndindex(count, count):
            shares[channel, neighbour, dy, dx] = np.mean(moved[cell == channel] == neighbour)
    return shares
