"""What a picture's ΔE is made of: noise, mosaic, colour error and blur, each left out in turn.

In this order, on which they depend: the whole; without noise, fixed pattern and codes of the ADC; without the mosaic, every pixel
knowing each channel of its own light; without colour error, with channels that are the observer's. What is left then is the blur of
lens, pixels and display, and the display's codes. Crosstalk through filters of other colours belongs to the mosaic.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from itertools import pairwise

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.parameters import Camera
from pixsim.light.spectral import SpectralImage
from pixsim.sensor.collection import Collection, collection_of, read_as_one
from pixsim.sensor.crosstalk import share_with_neighbours
from pixsim.sensor.integration import M2_PER_UM2, diffracted, diffusion_of, illumination_of, integrate_pixels, pixels_on
from pixsim.sensor.pixel import PixelPhysics
from pixsim.sensor.readout import Frame, integration_time_s, make_frame
from pixsim.viewer.develop import frame_rgb, white_y, xyz_weights
from pixsim.viewer.score import ImagingChain, PreparedScene, shown


@dataclass(frozen=True)
class Parts:
    """Parts of a mean ΔE; they add up to it.

    noise, mosaic, colour_error, blur : what leaving them out, in this order, takes off; blur is what is left
    dots_per_pixel : along a side; dots larger than pixels average their noise
    """

    mean_delta_e: float
    noise: float
    mosaic: float
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
    screen = chain.screen
    whole = chain.simulate(*key).mean_delta_e
    time_s = integration_time_s(chain.exposure, chain.physics, float(chain.signal_e_per_s.max()))
    still = noiseless_frame(chain, time_s)
    steps = [whole, chain.score_frame(still).mean_delta_e]
    if light.rendition is not None:
        own = replace(chain, collection=None, rendition=light.rendition, whites_e_per_s=light.whites_e_per_s(physics))
        planes = [
            _at_every_pixel(one.rate_e_per_s_um2, light, physics, collection_of(channel, one.illumination, _pixels(light, physics)))
            / white
            for one, channel, white in zip(light.lights, physics.channels, light.whites_e_per_s_um2, strict=True)
        ]
        blur = diffusion_of(physics)
        mean = collection_of(physics, illumination_of(irradiance, camera, physics), _pixels(light, physics))
        seen = diffracted(irradiance, camera, list(xyz_weights(irradiance)), blur)
        white = white_y(irradiance, camera, screen.display) * M2_PER_UM2
        observed = [_at_every_pixel(rate, light, physics, mean) / white for rate in seen]
        for channels, matrix in ((planes, own.matrix), (observed, light.rendition.to_display)):
            picture = frame_rgb(channels, still, matrix, screen.size_um, screen.display, screen.dot_edges_um)
            steps.append(float(screen.delta_e_of(shown(picture, screen.display)).mean()))
    else:
        steps += [steps[-1]] * 2
    noise, mosaic, colour_error = (before - after for before, after in pairwise(steps))
    dots = 1.0 if screen.dot_um is None else chain.physics.read_pitch_um / screen.dot_um
    return Parts(whole, noise, mosaic, colour_error, steps[-1], dots)


def noiseless_frame(chain: ImagingChain, integration_s: float) -> Frame:
    """Return the frame of the mean electrons, without noise, fixed pattern and rounding; as of a well without end."""
    exposure = chain.exposure.model_copy(update={"integration_s": integration_s})
    empty = np.zeros(chain.signal_e_per_s.shape, np.int32)
    frame = make_frame(empty, 0.0, chain.signal_e_per_s, chain.physics, exposure)
    return replace(frame, corrected_e=(chain.signal_e_per_s * integration_s).astype(np.float32))


def _pixels(light: PreparedScene, physics: PixelPhysics) -> tuple[int, int]:
    """Return rows and columns of the pixels."""
    rows, columns = pixels_on(light.array_um, physics.as_read.read_pitch_um)
    return rows * physics.as_read.bin_side, columns * physics.as_read.bin_side


def _at_every_pixel(rate: Array, light: PreparedScene, physics: PixelPhysics, collection: Collection | None) -> Array:
    """Return the mean light on every pixel, (rows, columns), as one channel would see it everywhere, without shading."""
    side_um = physics.photodiode_side_um if collection is None else collection.aperture_side_um
    rows, columns = _pixels(light, physics)
    size_um = rows * physics.pitch_um, columns * physics.pitch_um
    mean = integrate_pixels(rate, light.sample_pitch_um, physics.pitch_um, side_um, size_um=size_um) / side_um**2
    if collection is not None:
        mean = share_with_neighbours(mean, collection.shares) / collection.on_axis / collection.relative((rows, columns))
    side = physics.as_read.bin_side
    return read_as_one(mean, side) / side**2
