"""Spectral irradiance on the sensor plane: the value that flows from the renderer to the sensor, and its EXR file.

Pictures are stored upright: row 0 is the top of the scene and column 0 its left, as the photographer sees it
(the light on a real die is this picture turned by 180°).
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterator
from functools import cached_property, lru_cache, partial
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pixsim.errors import PixsimError, refuse
from pixsim.exr import Rows, write_rows, writing
from pixsim.exr import read_channels as read_channels
from pixsim.exr import read_header as read_header
from pixsim.exr import write_channels as write_channels
from pixsim.exr_header import checked_own

Array = NDArray[np.float64]

PLANCK_J_S = 6.62607015e-34  # SI 2019, exact
LIGHT_SPEED_M_PER_S = 299792458.0
WHOLE = slice(None)
BLOCK_SAMPLES = 1 << 18  # in float64 2 MiB: in a processor's cache
MOST_BAND_BYTES = 1 << 30  # of a file's channels: where they would be more, one of illuminance stands for them
CHANNEL_WIDTH_NM = 10.0  # of a file's channels, where finer bands are in its header
LUMINOUS_EFFICACY_LM_PER_W = 683.002  # K_m for standard air, CIE 018:2019


def photons_per_joule(wavelength_nm: ArrayLike) -> Array:
    """λ/(hc), (...) as the wavelengths, with the constants of the SI of 2019."""
    return np.asarray(wavelength_nm, float) * 1e-9 / (PLANCK_J_S * LIGHT_SPEED_M_PER_S)


@lru_cache
def _photometric_table() -> Array:
    return np.loadtxt(str(resources.files("pixsim") / "data/photopic_and_d65.csv"), delimiter=",", skiprows=3)


def photopic_efficiency(wavelength_nm: ArrayLike) -> Array:
    """ȳ(λ) of the CIE 1931 observer (CIE 018:2019), (...) as the wavelengths, 1 at its peak, zero outside 360-830 nm."""
    table = _photometric_table()
    return np.interp(np.asarray(wavelength_nm, float), table[:, 0], table[:, 1], left=0.0, right=0.0)


def d65(wavelength_nm: ArrayLike) -> Array:
    """Relative spectral power of CIE D65 (CIE 15:2018), (...) as the wavelengths, 100 at 560 nm; zero outside 360-830 nm."""
    table = _photometric_table()
    return np.interp(np.asarray(wavelength_nm, float), table[:, 0], table[:, 2], left=0.0, right=0.0)


def luminous_weight(wavelength_nm: ArrayLike, band_width_nm: ArrayLike) -> Array:
    """What turns band values per nm into photometric ones, (B,): lx from W m⁻² nm⁻¹, cd/m² from W m⁻² sr⁻¹ nm⁻¹.

    683.002 lm/W times `photopic_efficiency` times the width (CIE 018:2019).
    """
    return LUMINOUS_EFFICACY_LM_PER_W * photopic_efficiency(wavelength_nm) * np.asarray(band_width_nm, float)


def row_blocks(height: int, width: int) -> Iterator[slice]:
    """Rows of a picture of `height` × `width` in blocks of about `BLOCK_SAMPLES`."""
    step = max(1, BLOCK_SAMPLES // max(1, width))
    return (slice(top, min(top + step, height)) for top in range(0, height, step))


class SpectralImage:
    """Spectral irradiance on the sensor plane before diffraction.

    Parameters
    ----------
    wavelength_nm, band_width_nm : (B,) band centres and widths; a value is the mean over its band
    pitch_um : sampling pitch on the sensor
    data : (H, W, B) float32, W m⁻² nm⁻¹; or
    factors : (spectra (r, B) float64 W m⁻² nm⁻¹, pictures (r, H, W) float32): data = Σ_r spectrum × picture.
        With r = 1 a picture value of 1 is the on-axis irradiance of texel value 1.
    within : where in each band its light is, (nodes in nm (B, n), shares of the light (B, n)); None takes it at the centre
    header : what made it (camera, scene hash, seed, samples, versions); JSON, travels in the file

    Raises PixsimError for arrays whose shapes do not fit, and for a pitch or bands that are not positive.

    >>> light = SpectralImage([550.0], 10.0, 5.0, data=np.full((2, 3, 1), 1e-3))
    >>> light.illuminance_lx()[0].round(2).tolist()  # 683.002 lm/W · ȳ(550 nm) · 10 nm · 1 mW m⁻² nm⁻¹
    [6.8, 6.8, 6.8]
    """

    def __init__(
        self,
        wavelength_nm: ArrayLike,
        band_width_nm: ArrayLike,
        pitch_um: float,
        *,
        data: ArrayLike | None = None,
        factors: tuple[ArrayLike, ArrayLike] | None = None,
        within: tuple[ArrayLike, ArrayLike] | None = None,
        header: dict[str, Any] | None = None,
    ) -> None:
        self.wavelength_nm = np.asarray(wavelength_nm, float)
        self.band_width_nm = np.broadcast_to(np.asarray(band_width_nm, float), self.wavelength_nm.shape).copy()
        self.pitch_um = float(pitch_um)
        self.header = dict(header or {})
        if (data is None) == (factors is None):
            raise PixsimError("a SpectralImage is made of data or of factors, one of them")
        self.factors: tuple[Array, NDArray[np.float32]] | None = None
        if factors is not None:
            self.factors = np.atleast_2d(np.asarray(factors[0], float)), np.asarray(factors[1], np.float32)
            spectra, pictures = self.factors
            if pictures.ndim != 3 or spectra.shape != (len(pictures), self.wavelength_nm.size):
                raise refuse("factors", f"{spectra.shape} and {pictures.shape}", "spectra (r, B), pictures (r, H, W)")
        else:
            self.data = np.ascontiguousarray(data, np.float32)
            if self.data.ndim != 3 or self.data.shape[2] != self.wavelength_nm.size:
                raise refuse("data", self.data.shape, f"(H, W, {self.wavelength_nm.size})")
        positive = (self.wavelength_nm > 0) & (self.band_width_nm > 0)
        if not (self.pitch_um > 0 and positive.size and positive.all()):
            got = f"pitch {pitch_um} µm, bands {self.band_width_nm} nm at {self.wavelength_nm} nm"
            raise refuse("sampling", got, "positive pitch and band widths, at positive wavelengths")
        if within is None:
            within = self.wavelength_nm[:, None], np.ones((self.wavelength_nm.size, 1))
        self.within = np.asarray(within[0], float), np.asarray(within[1], float)
        if not self.within[0].shape == self.within[1].shape == (self.wavelength_nm.size, self.within[0].shape[-1]):
            raise refuse("within", f"{self.within[0].shape} and {self.within[1].shape}", "nodes and shares, (B, n) each")

    @cached_property
    def data(self) -> NDArray[np.float32]:
        """(H, W, B) float32, W m⁻² nm⁻¹; made from the factors when first asked for."""
        return np.stack([self.band(index) for index in range(self.wavelength_nm.size)], axis=2)

    def band(self, index: int, rows: slice = WHOLE) -> NDArray[np.float32]:
        """(H, W) float32, W m⁻² nm⁻¹, of the band of an `index`, or some of its `rows`."""
        if not self.factors:
            return self.data[rows, :, index]
        spectra, pictures = self.factors[0].astype(np.float32), self.factors[1][:, rows]
        total = np.zeros(pictures.shape[1:], np.float32)
        for spectrum, picture in zip(spectra, pictures, strict=True):
            total += spectrum[index] * picture
        return total

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        return self.factors[1].shape[1:] if self.factors else self.data.shape[:2]

    def weighted(self, weight: Array) -> Array:
        """Σ_b weight_b · E_b per pixel, (H, W) float64; elementwise, so that it does not depend on threads.

        weight : (B,), any unit per W m⁻² nm⁻¹
        """
        total = np.empty(self.shape)
        for rows in row_blocks(*self.shape):  # so that no second picture of this size is needed
            total[rows] = self.weighted_part(weight, (rows, WHOLE))
        return total

    def weighted_part(self, weight: Array, part: tuple[slice, slice]) -> Array:
        """`weighted` of some rows and columns, to the same bits: (rows, columns).

        weight : (B,), any unit per W m⁻² nm⁻¹
        part : rows and columns
        """
        if self.factors:
            totals = [(weight * spectrum).sum() for spectrum in self.factors[0]]
            terms = ((total, picture[part]) for total, picture in zip(totals, self.factors[1], strict=True))
        else:
            terms = ((weight[band], self.data[part][:, :, band]) for band in np.flatnonzero(weight))
        height, width = (len(range(*each.indices(n))) for each, n in zip(part, self.shape, strict=True))
        total = np.zeros((height, width))
        for factor, picture in terms:
            total += factor * picture.astype(float)
        return total

    def mean_spectrum(self) -> Array:
        """Mean over the picture, (B,) W m⁻² nm⁻¹."""
        if not self.factors:
            return self.data.mean(axis=(0, 1), dtype=float)
        spectra, pictures = self.factors
        return (spectra * pictures.mean(axis=(1, 2), dtype=float)[:, None]).sum(axis=0)

    def band_mean(self, response: Callable[[Array], Array]) -> Array:
        """Mean of `response`, a function of nm, over each band, weighted by the light in it, (B,) in its unit."""
        nodes_nm, shares = self.within
        return (shares * response(nodes_nm)).sum(axis=1)

    def luminous_weight(self) -> Array:
        """What turns band values into lx, (B,); cd/m² where they are radiances."""
        return LUMINOUS_EFFICACY_LM_PER_W * self.band_mean(photopic_efficiency) * self.band_width_nm

    def illuminance_lx(self) -> Array:
        """(H, W) lx: 683.002 ∫ ȳ E dλ."""
        return self.weighted(self.luminous_weight())

    def __repr__(self) -> str:
        height, width = self.shape
        count = len(self.factors[0]) if self.factors else 0
        kind = f"{count} {'spectrum × picture' if count == 1 else 'spectra × pictures'}" if count else "general"
        return (
            f"<SpectralImage {width}×{height} samples of {self.pitch_um:g} µm, {self.wavelength_nm.size} bands "
            f"{self.wavelength_nm[0]:g}–{self.wavelength_nm[-1]:g} nm, {kind}, W m^-2 nm^-1>"
        )


def _band_channel(wavelength_nm: float) -> str:
    """Fichet's channel name: total (Stokes 0) emissive value, decimal comma."""
    return f"S0.{wavelength_nm:.6f}nm".replace(".", ",").replace("S0,", "S0.")


def write_exr(path: str | os.PathLike[str], image: SpectralImage) -> None:
    """Write a spectral EXR in the layout of Fichet et al. (JCGT 10(3), 2021); `read_exr` gives the same bits back.

    Channels `S0.550,000000nm` in W m⁻² nm⁻¹ for any reader, and `factor.N` pictures where the image has factors; then bands
    finer than 10 nm stand in the header, and the channels hold their means over 10 nm. Where those would take more than 1 GiB
    beside the factors, which tell all of them, one channel `Y` in lx (`illuminanceUnits`) stands in their place.

    Not compressed: OpenEXR's lossless ways take ten times as long for two thirds of the bytes.

    Raises PixsimError where `path` cannot be written.
    """
    shown = _merged(image) if image.factors else image
    header = {"emissiveUnits": "W.m^-2.nm^-1"}
    channels: dict[str, Rows]
    if image.factors and 4 * shown.wavelength_nm.size * math.prod(image.shape) > MOST_BAND_BYTES:
        weight = image.luminous_weight()
        channels = {"Y": lambda rows: image.weighted_part(weight, (rows, WHOLE)).astype(np.float32)}
        header["illuminanceUnits"] = "lx"
    else:
        channels = {_band_channel(nm): partial(shown.band, band) for band, nm in enumerate(shown.wavelength_nm)}
        header["spectralLayoutVersion"] = "1.0"
    if image.factors:
        channels |= {f"factor.{r}": picture.__getitem__ for r, picture in enumerate(image.factors[1])}
    header["pixsim"] = json.dumps(_own_header(image), sort_keys=True)
    with writing(path) as unfinished:
        write_rows(unfinished, channels, image.shape, header)


def _own_header(image: SpectralImage) -> dict[str, Any]:
    own: dict[str, Any] = {
        "wavelength_nm": image.wavelength_nm.tolist(),
        "band_width_nm": image.band_width_nm.tolist(),
        "pitch_um": image.pitch_um,
        "within_nm": image.within[0].tolist(),
        "within_shares": image.within[1].tolist(),
        "header": image.header,
    }
    return own | ({"spectra_w_per_m2_nm": image.factors[0].tolist()} if image.factors else {})


def _merged(image: SpectralImage) -> SpectralImage:
    """A factored image with neighbouring bands taken together up to 10 nm; those wider stay."""
    assert image.factors
    groups: list[list[int]] = []
    width = 0.0
    for band, own in enumerate(image.band_width_nm):
        if groups and width + own <= CHANNEL_WIDTH_NM:
            groups[-1].append(band)
            width += own
        else:
            groups.append([band])
            width = own
    widths = np.array([image.band_width_nm[group].sum() for group in groups])
    mean = np.array([(image.band_width_nm[group] * image.wavelength_nm[group]).sum() for group in groups]) / widths
    spectra = np.array([(image.factors[0][:, group] * image.band_width_nm[group]).sum(axis=1) for group in groups]).T / widths
    return SpectralImage(mean, widths, image.pitch_um, factors=(spectra, image.factors[1]))


def read_exr(path: str | os.PathLike[str]) -> SpectralImage:
    """Read what `write_exr` wrote, from `path`.

    Raises PixsimError for a file that is missing, damaged or was not written by pixsim.

    >>> import tempfile
    >>> light = SpectralImage([550.0], 10.0, 5.0, data=np.full((2, 3, 1), 1e-3))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_exr(f"{folder}/light.exr", light)
    ...     back = read_exr(f"{folder}/light.exr")
    >>> bool((back.data == light.data).all()), back.pitch_um
    (True, 5.0)
    """
    channels, header = read_channels(path)
    if "pixsim" not in header or header.get("emissiveUnits") != "W.m^-2.nm^-1":
        raise refuse("irradiance file", f"'{path}' without pixsim's header", "a file from pixsim.write_exr")
    try:
        own = checked_own(json.loads(header["pixsim"]))
        bands = own["wavelength_nm"], own["band_width_nm"], own["pitch_um"]
        more = {"header": own["header"], "within": (own["within_nm"], own["within_shares"]) if "within_nm" in own else None}
        if "spectra_w_per_m2_nm" in own:
            spectra = np.array(own["spectra_w_per_m2_nm"])
            pictures = np.stack([channels[f"factor.{r}"] for r in range(len(spectra))])
            return SpectralImage(*bands, factors=(spectra, pictures), **more)
        data = np.stack([channels[_band_channel(nm)] for nm in own["wavelength_nm"]], axis=2)
        return SpectralImage(*bands, data=data, **more)
    except (KeyError, TypeError, ValueError, OverflowError, IndexError, RecursionError) as error:
        raise refuse("irradiance file", f"'{path}' with a damaged header ({error})", "a file from pixsim.write_exr") from None
