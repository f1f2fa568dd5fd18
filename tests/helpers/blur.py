"""The blur of a lens at one point of the image, computed there."""

import numpy as np

from pixsim.optics.field_blur import ChannelWavefronts, Psf, periodic_psf, psf_window


def point_spread(
    light: ChannelWavefronts, x_um: float, y_um: float, pitch_um: float, cells: int
) -> Psf:
    """Return the PSF of an image point, cut off to an odd number of film cells along a side.

    x_um, y_um : of the image point, from the optical axis, along columns and rows
    """
    whole = periodic_psf(
        light, x_um, y_um, pitch_um, psf_window(light, x_um, y_um, pitch_um, cells)
    )
    reach = cells // 2
    return Psf(np.roll(whole, (reach, reach), axis=(0, 1))[:cells, :cells].astype(np.float32))
