"""Veiling glare: the share of the light of the whole field that strays in lens and camera, and
falls uniformly on the sensor.

With g its share (ISO 9358, ISO 18844), E′ = (1 - g) E + g (1 + s) mean(E). The mean is over the
film that is rendered and the margin around it; s is the light from outside of them that strays in,
relative to the light from within. So a black hole of share a in a uniform field, without fall-off,
has g (1 - a)/(1 - g a) of its surround. The ideal picture has no veil.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pixsim.base.arrays import Array
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera

# Header entry: mean of the picture of which this one is a part, (B,).
VEIL = "veil_of_w_per_m2_nm"


@dataclass(frozen=True)
class _StrayLight:
    """Stray light in a camera, and the share of the light that does not stray.

    direct_share : (B,) share of each band that does not stray
    uniform_w_per_m2_nm : (B,) irradiance by stray light, the same everywhere
    """

    direct_share: Array
    uniform_w_per_m2_nm: Array


def stray_light(irradiance: SpectralImage, camera: Camera) -> _StrayLight | None:
    """Return the stray light of a picture, or None without veiling glare.

    It is that of the whole picture, of which this one may be a part (`with_veil_of_whole`).

    Beyond its ends, a table of shares is constant.

    >>> flat_field = SpectralImage([550.0], 10.0, 5.0, data=np.full((2, 3, 1), 1e-3))
    >>> veil = stray_light(flat_field, Camera(veiling_glare=0.04))
    >>> veil.direct_share.round(3).tolist(), veil.uniform_w_per_m2_nm.round(8).tolist()
    ([0.96], [4e-05])
    """
    glare = camera.veiling_glare
    if not glare:
        return None
    if isinstance(glare, float):
        share = np.full(irradiance.wavelength_nm.size, glare)
    else:
        share = _band_shares(irradiance, glare)

    stated_mean = irradiance.header.get(VEIL)  # a file may state anything
    is_valid = (
        isinstance(stated_mean, list)
        and len(stated_mean) == share.size
        and all(isinstance(value, float) for value in stated_mean)
    )
    mean = np.asarray(stated_mean) if is_valid else irradiance.whole.mean_spectrum()
    return _StrayLight(1 - share, share * (1 + camera.veiling_glare_outside) * mean)


def _band_shares(irradiance: SpectralImage, glare: tuple[tuple[float, float], ...]) -> Array:
    table_nm, share = np.array(glare).T
    return irradiance.band_mean(lambda wavelength_nm: np.interp(wavelength_nm, table_nm, share))


def with_veil_of_whole(irradiance: SpectralImage, camera: Camera) -> SpectralImage:
    """Return a picture whose parts keep the stray light of the whole picture.

    Without veiling glare it is the picture itself.
    """
    if not camera.veiling_glare:
        return irradiance
    mean = irradiance.whole.mean_spectrum().tolist()
    return irradiance.with_planes(
        irradiance.whole.planes, header=irradiance.header | {VEIL: mean}, margin=irradiance.margin
    )
