"""Spectral irradiance on the sensor plane, spectra, and functions of wavelength.

Pictures are stored upright: row 0 is the top of the scene and column 0 its left, as the
photographer sees it (the light on a real die is this picture turned by 180°).
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, field
from functools import lru_cache
from hashlib import blake2b
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pixsim.base.arrays import Array, Positives, Row, strips, values_of
from pixsim.base.bounds import Count, Positive, Whole, check_broadcast
from pixsim.base.door import checked_methods
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.lazy import cached_property
from pixsim.base.mapped import is_mapped, release, update_with_array

# The public names; everything else is internal.
__all__ = [
    "SpectralImage",
    "colour_matching",
    "d65",
    "luminous_weight",
    "photons_per_joule",
    "photopic_efficiency",
]

PLANCK_J_S = 6.62607015e-34  # SI 2019, exact
LIGHT_SPEED_M_PER_S = 299792458.0
WHOLE = slice(None)
STRIP_VALUES = 1 << 18  # of all bands of a strip: 1 MiB in float32
MAX_VALUE = float(np.finfo(np.float32).max)
# Entry of a header: hash of light from outside, whose other entries need not identify it.
DIGEST = "digest"
# Entries of a header: the light of the scene's white, in each band; and the lamps that make it
# together, if the scene names them.
LAMP = "lamp_w_per_m2_sr_nm"
WHITE_LAMPS = "white_lamps"
# Entry of a header: radiance of white, of light without luminance.
WHITE_RADIANCE = "white_w_per_m2_sr"
# Entry of a header: radiance of a white plate at the object's distance, for
# `display.white = "diffuser"`.
DIFFUSER = "diffuser"
DIFFUSER_W = "w_per_m2_sr_nm"  # of that entry: radiance of a perfect diffuser, in each band
WHITE_OF_PLATE = "a white plate in the scene's light"  # as `white_description`
# Entry of a header: the light that falls on the part of a target, and its reflectance.
PART = "part"
# Of light whose amount a luminance can state; an incandescent lamp has 15, a line at 750 nm 0.08.
MIN_LM_PER_W = 0.1
LUMINOUS_EFFICACY_LM_PER_W = 683.002  # K_m for standard air, CIE 018:2019


def photons_per_joule(wavelength_nm: Positives) -> Array:
    """Return λ/(hc), photons per joule, in the shape (...) of the wavelengths; SI constants of
    2019.
    """
    return np.asarray(wavelength_nm, float) * 1e-9 / (PLANCK_J_S * LIGHT_SPEED_M_PER_S)


@lru_cache
def _photometric_table() -> Array:
    return np.loadtxt(
        str(resources.files("pixsim") / "data/observer_and_d65.csv"), delimiter=",", skiprows=3
    )


def photopic_efficiency(wavelength_nm: Positives) -> Array:
    """Return ȳ(λ) of the CIE 1931 observer (CIE 018:2019) (...) as the wavelengths: 1 at its peak,
    0 outside 360-830 nm.
    """
    table = _photometric_table()
    return np.interp(
        np.asarray(wavelength_nm, float), table[:, 0], table[:, 2], left=0.0, right=0.0
    )


def colour_matching(wavelength_nm: Positives) -> Array:
    """Return x̄(λ), ȳ(λ) and z̄(λ) of the CIE 1931 observer (CIE 018:2019), (..., 3) as the
    wavelengths; 0 outside 360-830 nm.

    Relative to the peak of ȳ, which is 1.

    >>> colour_matching(555.0).tolist()
    [0.5120501, 1.0, 0.005749999]
    """
    nm = np.asarray(wavelength_nm, float)
    table = _photometric_table()
    return np.stack(
        [np.interp(nm, table[:, 0], table[:, column], left=0.0, right=0.0) for column in (1, 2, 3)],
        axis=-1,
    )


def d65(wavelength_nm: Positives) -> Array:
    """Return the relative power of CIE D65 (CIE 15:2018) (...) as the wavelengths: 100 at 560 nm, 0
    outside 360-830 nm.
    """
    table = _photometric_table()
    return np.interp(
        np.asarray(wavelength_nm, float), table[:, 0], table[:, 4], left=0.0, right=0.0
    )


def luminous_weight(wavelength_nm: Positives, band_width_nm: Positives) -> Array:
    """Return the weights (B,) that turn band values per nm into lx (from W m⁻² nm⁻¹) or cd/m² (from
    W m⁻² sr⁻¹ nm⁻¹).

    683.002 lm/W times `photopic_efficiency` times the width (CIE 018:2019).
    """
    check_broadcast(wavelength_nm=np.shape(wavelength_nm), band_width_nm=np.shape(band_width_nm))
    return (
        LUMINOUS_EFFICACY_LM_PER_W
        * photopic_efficiency(wavelength_nm)
        * np.asarray(band_width_nm, float)
    )


def bands_last_hint(shape: tuple[int, ...], bands: int) -> str:
    """Return the line of Python that turns a cube whose bands are not its last axis; empty if no
    axis has their number.

    >>> bands_last_hint((31, 480, 640), 31)
    'Its bands are axis 0: data = np.moveaxis(data, 0, 2)'
    """
    axes = [axis for axis in (0, 1) if len(shape) == 3 and shape[axis] == bands != shape[2]]
    return f"Its bands are axis {axes[0]}: data = np.moveaxis(data, {axes[0]}, 2)" if axes else ""


@checked_methods
class SpectralImage:
    """Spectral irradiance on the sensor plane before diffraction.

    Parameters
    ----------
    wavelength_nm, band_width_nm : (B,) wavelengths and widths of adjoining bands; each value is the
        mean over its band. The wavelength is the band's centre. In a render it is the mean
        wavelength of the lamps' light in the band instead, where this is 1 nm or more from the
        centre. The bands of a render adjoin and start at 360 nm, or where header["computed_nm"]
        says: their upper edges are 360 + np.cumsum(band_width_nm)
    pitch_um : sampling pitch on the sensor
    data : (H, W, B) float32, W m⁻² nm⁻¹; or
    factors : (spectra (r, B) float64 W m⁻² nm⁻¹, pictures (r, H, W) float32): data = Σ_r spectrum ×
        picture. With r = 1 a picture value of 1 is the on-axis irradiance of texel value 1.
    within : distribution of the light within each band, (nodes in nm (B, n), shares of the light
        (B, n)); by default it is all at `wavelength_nm`
    header : provenance (camera, scene hash, seed, samples, versions), stored in files as JSON
    margin : samples of the given pictures at each side that lie beyond the picture; a real lens's
        blur takes light from there

    Raises PixsimError if the shapes do not match, if the pitch or the bands are not positive, or if
    the margin leaves no picture.

    >>> light = SpectralImage([550.0], 10.0, 5.0, data=np.full((2, 3, 1), 1e-3))

    683.002 lm/W · ȳ(550 nm) · 10 nm · 1 mW m⁻² nm⁻¹:

    >>> light.illuminance_lx()[0].round(2).tolist()
    [6.8, 6.8, 6.8]
    """

    def __init__(
        self,
        wavelength_nm: Positives,
        band_width_nm: Positives,
        pitch_um: Positive,
        *,
        data: ArrayLike | None = None,
        factors: tuple[ArrayLike, ArrayLike] | None = None,
        within: tuple[ArrayLike, ArrayLike] | None = None,
        header: dict[str, Any] | None = None,
        margin: int = 0,
    ) -> None:
        self.wavelength_nm = np.asarray(wavelength_nm, float)
        if not self.wavelength_nm.size or self.wavelength_nm.ndim != 1:
            raise invalid(
                "wavelength_nm",
                f"an array of shape {self.wavelength_nm.shape}",
                "(B,), at least one",
            )

        if np.shape(band_width_nm) not in ((), (1,), self.wavelength_nm.shape):
            got = f"an array of shape {np.shape(band_width_nm)}"
            bands = self.wavelength_nm.size
            raise invalid(
                "band_width_nm",
                got,
                f"a number, or an array of shape ({bands},), one per wavelength",
            )

        self.band_width_nm = np.broadcast_to(
            np.asarray(band_width_nm, float), self.wavelength_nm.shape
        ).copy()
        self.pitch_um = float(pitch_um)
        self.header = dict(header or {})
        if (data is None) == (factors is None):
            raise PixsimError("SpectralImage: give either data or factors, not both or neither")

        self.factors: tuple[Array, NDArray[np.float32]] | None = None
        if factors is not None:
            spectra = np.atleast_2d(np.asarray(factors[0], float))
            pictures = np.asarray(factors[1], np.float32)
            self.factors = spectra, pictures
            if pictures.ndim != 3 or spectra.shape != (len(pictures), self.wavelength_nm.size):
                raise invalid(
                    "factors",
                    f"{spectra.shape} and {pictures.shape}",
                    "spectra (r, B), pictures (r, H, W)",
                )
        else:
            values = np.asarray(data, np.float32)
            self.data = values
            if self.data.ndim != 3 or self.data.shape[2] != self.wavelength_nm.size:
                hint = bands_last_hint(self.data.shape, self.wavelength_nm.size)
                raise invalid(
                    "data",
                    self.data.shape,
                    f"(rows, columns, bands), here (H, W, {self.wavelength_nm.size})",
                    hint,
                )

        self.margin = margin
        if margin:
            self._set_margin(self.factors[1] if self.factors else self.data)

        if within is None:
            within = self.wavelength_nm[:, None], np.ones((self.wavelength_nm.size, 1))
        nodes_nm = np.asarray(within[0], float)
        shares = np.asarray(within[1], float)
        self.within = nodes_nm, shares
        if not nodes_nm.shape == shares.shape == (self.wavelength_nm.size, nodes_nm.shape[-1]):
            raise invalid(
                "within",
                f"{nodes_nm.shape} and {shares.shape}",
                "nodes and shares, each of shape (B, n)",
            )

    def digest(self) -> str:
        """Return a hash of everything that the light is made of, 32 hexadecimal digits; arrays can
        change in place.
        """
        hasher = blake2b(repr((self.pitch_um, self.margin)).encode(), digest_size=16)
        hasher.update(json.dumps(self.header, sort_keys=True, default=repr).encode())
        spectra = () if self.factors is None else (self.factors[0],)
        if self.margin:
            pictures = self._pictures_with_margin
        else:
            pictures = self.data if self.factors is None else self.factors[1]

        for array in (self.wavelength_nm, self.band_width_nm, *self.within, *spectra, pictures):
            update_with_array(hasher, array)
        return hasher.hexdigest()

    @property
    def identified(self) -> SpectralImage:
        """This light with its `digest` in the header, which distinguishes it from other light of
        the same settings.
        """
        light = copy(self)
        light.header = self.header | {DIGEST: self.digest()}
        return light

    def _set_margin(self, pictures: NDArray[np.float32]) -> None:
        """Store the pictures with their margin and, as factors or data, without it."""
        height, width = pictures.shape[1:] if self.factors else pictures.shape[:2]
        if not 0 < 2 * self.margin < min(height, width):
            raise invalid(
                "margin",
                self.margin,
                f"0 or more, and less than half of the {width} × {height} samples given",
            )

        self._pictures_with_margin = pictures
        inside = slice(self.margin, height - self.margin), slice(self.margin, width - self.margin)
        if self.factors:
            self.factors = self.factors[0], pictures[:, *inside]
        else:
            self.data = pictures[inside]

    @property
    def whole(self) -> SpectralImage:
        """The picture with its margin as part of it."""
        if not self.margin:
            return self
        pictures = self._pictures_with_margin
        content: dict[str, Any] = {"data": pictures}
        if self.factors:
            content = {"factors": (self.factors[0], pictures)}
        content |= {"within": self.within, "header": self.header}
        return SpectralImage(self.wavelength_nm, self.band_width_nm, self.pitch_um, **content)

    @cached_property
    def data(self) -> NDArray[np.float32]:
        """Values (H, W, B) float32, W m⁻² nm⁻¹, computed from the factors on first use."""
        return np.stack([self.band(index) for index in range(self.wavelength_nm.size)], axis=2)

    def band(self, index: Whole, rows: slice = WHOLE) -> NDArray[np.float32]:
        """Return band `index`, (H, W) float32 in W m⁻² nm⁻¹, or some of its `rows`.

        Raises PixsimError if there is no such band.
        """
        if not 0 <= index < self.wavelength_nm.size:
            raise invalid("index", index, f"0 to {self.wavelength_nm.size - 1}")
        if not self.factors:
            return self.data[rows, :, index]
        spectra = self.factors[0].astype(np.float32)
        pictures = self.factors[1][:, rows]
        total = np.zeros(pictures.shape[1:], np.float32)
        for spectrum, picture in zip(spectra, pictures, strict=True):
            for part in strips(*pictures.shape[1:]):
                total[part] += spectrum[index] * picture[part]
                release(picture[part])

        return total

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        return self.factors[1].shape[1:] if self.factors else self.data.shape[:2]

    def weighted(self, weight: Row) -> Array:
        """Return Σ_b weight_b · E_b at each sample, (H, W) float64, independent of the number of
        threads.

        weight : (B,), any unit per W m⁻² nm⁻¹
        """
        height, width = self.shape
        total = np.empty(self.shape)
        for rows in strips(
            height, width * len(self.factors[0] if self.factors else weight), STRIP_VALUES
        ):
            total[rows] = self.weighted_part(weight, (rows, WHOLE))
        return total

    def weighted_part(self, weight: Row, part: tuple[slice, slice]) -> Array:
        """Return some rows and columns of `weighted`, bit for bit the same.

        weight : (B,), any unit per W m⁻² nm⁻¹
        part : slices of rows and columns

        Raises PixsimError if there is not one weight for each band.
        """
        if weight.shape != self.wavelength_nm.shape:
            raise invalid(
                "weight",
                f"an array of shape {weight.shape}",
                f"({self.wavelength_nm.size},), one for each band",
            )

        if self.factors:
            totals = [(weight * spectrum).sum() for spectrum in self.factors[0]]
            terms = (
                (total, picture[part])
                for total, picture in zip(totals, self.factors[1], strict=True)
            )
        else:
            terms = ((weight[band], self.data[(*part, band)]) for band in np.flatnonzero(weight))

        total = np.zeros(
            [len(range(*span.indices(n))) for span, n in zip(part, self.shape, strict=True)]
        )
        for factor, picture in terms:
            total += factor * picture.astype(float)
            release(picture)
        return total

    def box_reduced(self, columns: Count) -> SpectralImage:
        """Return the image on `columns` samples across, each the mean over its area, of the larger
        pitch.

        The width stays. Where the height is no whole number of the larger samples, less than one of
        them is cut off, half above and half below. `header["reduced"]` states the samples of the
        picture before, and their number along a side of a new one.

        Raises PixsimError unless columns is 1 to the present number.

        >>> light = SpectralImage([550.0], 10.0, 5.0, data=np.arange(8.0).reshape(2, 4, 1))
        >>> light.box_reduced(2).data[:, :, 0].tolist(), light.box_reduced(2).pitch_um
        ([[2.5, 4.5]], 10.0)
        """
        height, width = self.shape
        is_coarser = 1 <= columns <= width
        samples_per_cell = width / columns if is_coarser else math.nan
        rows = int(height / samples_per_cell + RATIO_ROUNDING) if is_coarser else 0
        if not rows:
            raise invalid(
                "columns", columns, f"1 to {width}, and at least one row of square samples"
            )

        earlier = self.header.get("reduced", {"samples": [height, width], "factor": 1.0})
        factor = float(f"{earlier['factor'] * samples_per_cell:.12g}")
        header = self.header | {"reduced": {"samples": earlier["samples"], "factor": factor}}

        planes = np.empty((len(self.planes), rows, columns), np.float32)
        for plane, means in zip(self.planes, planes, strict=True):
            means[:] = _box_means(plane, rows, columns)
        return self.with_planes(planes, pitch_um=self.pitch_um * samples_per_cell, header=header)

    @property
    def planes(self) -> NDArray[np.float32]:
        """The pictures, (n, H, W) float32: of the factors, relative to their spectra, or of the
        bands, W m⁻² nm⁻¹.
        """
        return self.factors[1] if self.factors else np.moveaxis(self.data, 2, 0)

    def with_planes(
        self,
        planes: NDArray[np.float32],
        *,
        pitch_um: Positive | None = None,
        header: dict[str, Any] | None = None,
        margin: int = 0,
    ) -> SpectralImage:
        """Return an image of the same bands with other `planes`, (n, H, W), of any height and
        width.

        pitch_um, header : by default as in this image
        margin : of the planes, as for a new image

        Raises PixsimError if there are not as many planes as this image has.
        """
        if planes.ndim != 3 or len(planes) != len(self.planes):
            raise invalid(
                "planes",
                f"an array of shape {planes.shape}",
                f"({len(self.planes)}, rows, columns)",
            )

        content: dict[str, Any] = (
            {"factors": (self.factors[0], planes)}
            if self.factors
            else {"data": np.moveaxis(planes, 0, 2)}
        )
        content |= {
            "within": self.within,
            "header": self.header if header is None else header,
            "margin": margin,
        }
        return SpectralImage(
            self.wavelength_nm,
            self.band_width_nm,
            self.pitch_um if pitch_um is None else pitch_um,
            **content,
        )

    def mean_spectrum(self) -> Array:
        """Return the mean over all samples, (B,) W m⁻² nm⁻¹."""
        if not self.factors:
            return self.data.mean(axis=(0, 1), dtype=float)
        spectra, pictures = self.factors
        means = np.empty(len(pictures))
        for number, picture in enumerate(pictures):
            means[number] = picture.mean(dtype=float)
            release(picture)
        return (spectra * means[:, None]).sum(axis=0)

    def band_mean(self, response: Callable[[Array], Array]) -> Array:
        """Return the mean of `response`, a function of nm, over each band (B,), weighted by the
        light within the band.

        response : maps wavelengths in nm, (B, n), to numbers of the same shape, or to one number

        Raises PixsimError if it does not.
        """
        nodes_nm, shares = self.within
        return np.asarray(
            (shares * values_of("response", response, nodes_nm.shape, nodes_nm)).sum(axis=1)
        )

    def luminous_weight(self) -> Array:
        """Return the weights (B,) that turn band values into lx, or radiances into cd/m²."""
        return LUMINOUS_EFFICACY_LM_PER_W * self.band_mean(photopic_efficiency) * self.band_width_nm

    def illuminance_lx(self) -> Array:
        """Return the illuminance 683.002 ∫ ȳ E dλ, (H, W) lx."""
        return self.weighted(self.luminous_weight())

    @property
    def white_spectrum(self) -> Array | None:
        """Light of the scene's white in each band, (B,) in any unit, or None if it is unknown.

        White is a white plate where the header has one (`DIFFUSER`), else the lamps that the scene
        names as its white, else the spectrum that all lamps share.
        """
        if plate_radiance := self.header.get(DIFFUSER, {}).get(DIFFUSER_W):
            return np.asarray(plate_radiance, float)
        if lamp_radiance := self.header.get(LAMP):
            return np.asarray(lamp_radiance, float)
        return self.factors[0][0] if self.factors and len(self.factors[0]) == 1 else None

    def validate(self) -> None:
        """Check the values. Raises PixsimError if one is not finite, or is negative and not one of
        several factors.

        Where the header says that the picture rings (`RINGS`), values down to `MAX_RING` of the
        largest may be negative.
        """
        spectra, _ = self.factors or (np.ones((1, 1)), None)
        low, high = extremes(self.planes)
        arrays = self.pitch_um, self.wavelength_nm, self.band_width_nm, *self.within, spectra
        if not all(np.abs(values).max() <= MAX_VALUE for values in (low, high, *arrays)):
            got = (
                f"values from {low:g} to {high:g}, and a value here or among the bands or spectra"
                " that is not finite"
            )
            raise invalid(
                "irradiance", got, f"finite values, spectra and bands, at most {MAX_VALUE:.4g}"
            )

        if len(spectra) == 1 and (
            low < lowest_allowed(self.header, high) or float(spectra.min()) < 0
        ):
            hint = "Clip the negative values to zero."
            raise invalid("irradiance", f"values from {low:g} to {high:g}", "0 or more", hint)

    def __repr__(self) -> str:
        height, width = self.shape
        count = len(self.factors[0]) if self.factors else 0
        if count:
            kind = f"{count} {'spectrum × picture' if count == 1 else 'spectra × pictures'}"
        else:
            kind = "general"
        return (
            f"<SpectralImage {width}×{height} samples of {self.pitch_um:g} µm,"
            f" {self.wavelength_nm.size} bands {self.wavelength_nm[0]:g}–{self.wavelength_nm[-1]:g}"
            f" nm, {kind}, W m^-2 nm^-1>"
        )


# Entry of an image's header: its light is still to be blurred by a real lens, and rings below zero
# at edges.
RINGS = "rings"
# Of the largest value, below zero: 1.15 of the worst picture in a quintic spline, and its means
# over other cells.
MAX_RING = 1.5


OUTLIER = 100.0
_SAMPLES_AN_OUTLIER = 10_000


def lowest_allowed(header: dict[str, Any], highest: float) -> float:
    """Return the lowest value that the planes of an image may have, by its header and its highest
    value.
    """
    return -MAX_RING * max(highest, 0.0) if header.get(RINGS) is True else 0.0


# Entry of a header: row, column of samples far above all others, which set neither exposure nor
# white.
OUTLIERS = "outlier_samples"


def find_outliers(picture: Array) -> list[tuple[int, int]]:
    """Return the samples (row, column) of a picture (H, W) that stand alone, far above all others:
    at most 1 in 10 000.

    Such are fireflies of a path tracer, and hot pixels. Each is more than `OUTLIER` times the
    brightest other sample and its neighbours; none is in a picture that is dark beside them, like a
    star.

    >>> picture = np.ones((50, 50))
    >>> picture[3, 4] = 1e6
    >>> find_outliers(picture)
    [(3, 4)]
    """
    max_count = max(1, picture.size // _SAMPLES_AN_OUTLIER)
    if picture.size <= max_count + 1:
        return []
    order = np.argpartition(picture, -max_count - 1, axis=None)[-max_count - 1 :]
    order = order[np.argsort(picture.ravel()[order])[::-1]]
    values = picture.ravel()[order]
    gaps = np.flatnonzero((values[:-1] > OUTLIER * values[1:]) & (values[1:] > 0))
    if not gaps.size:
        return []
    outliers = [divmod(int(index), picture.shape[1]) for index in order[: gaps[-1] + 1]]
    brightest_other = values[gaps[-1] + 1]
    # Of two neighbours one is in the other's row, or in the row below.
    neighbourhoods = [
        picture[row : row + 2, max(column - 1, 0) : column + 2] for row, column in outliers
    ]

    # Brighter than the rest of the picture, alone among its neighbours.
    stand_alone = all(
        np.count_nonzero(neighbourhood > brightest_other) == 1 for neighbourhood in neighbourhoods
    )
    return outliers if stand_alone else []


def without_outliers(image: SpectralImage) -> SpectralImage | None:
    """Return an image whose outliers, as its header states them, are the median of their
    neighbours, or None if it states none.
    """
    outliers = image.header.get(OUTLIERS)
    if not isinstance(outliers, list) or not outliers:
        return None
    planes = np.array(image.planes)
    for outlier in outliers:
        if not (
            isinstance(outlier, list)
            and len(outlier) == 2
            and all(isinstance(index, int) for index in outlier)
        ):
            return None  # the header of another program

        row, column = outlier
        if not (0 <= row < planes.shape[1] and 0 <= column < planes.shape[2]):
            return None
        neighbourhood = planes[:, max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
        planes[:, row, column] = np.median(neighbourhood, axis=(1, 2))

    return image.with_planes(
        planes, header={name: value for name, value in image.header.items() if name != OUTLIERS}
    )


def white_description(has_spectrum: bool, lamps: Sequence[str] = ()) -> str:
    """Return a description of the light of a scene's white, for messages and reports.

    has_spectrum : whether its spectrum is known; else D65 takes its place
    lamps : names of the lamps that make the scene's white
    """
    if lamps:
        return f"the scene's own white, of its lamps {', '.join(lamps)}"
    if has_spectrum:
        return "the scene's lamp"
    return f"D65 (the lamps share no spectrum, and the scene names no {WHITE_LAMPS})"


RATIO_ROUNDING = 1e-9  # of a sample: rounding errors of a ratio


def _box_means(picture: NDArray[np.float32], rows: int, columns: int) -> NDArray[np.float32]:
    """Return the means (rows, columns) of a picture over square areas that fill its width, centred
    in its height.
    """
    height, width = picture.shape
    ratio = width / columns
    edges_x = np.linspace(0, width, columns + 1)
    edges_y = (height - rows * ratio) / 2 + ratio * np.arange(rows + 1)
    total = _running_integral(_running_integral(picture, edges_y).T, edges_x).T
    # A mean lies in the range of its values, but for rounding errors.
    return np.clip(total / ratio**2, *extremes(picture[None])).astype(np.float32)


def _running_integral(values: NDArray[Any], edges: Array) -> Array:
    """Return the integrals of the rows of `values`, taken as constant in each, between edges in
    units of a row.
    """
    position = np.clip(edges, 0, len(values))
    below = np.minimum(position.astype(int), len(values) - 1)
    result = np.empty((edges.size, values.shape[1]))
    total = np.zeros((1, values.shape[1]))
    for rows in strips(*values.shape):  # a picture in float64 need not be in memory
        strip = values[rows].astype(float)
        # The integral up to each row, and with the last one.
        total = np.cumsum(np.concatenate([total[-1:], strip]), axis=0)
        edges_in_strip = np.flatnonzero((below >= rows.start) & (below < rows.stop))
        row = below[edges_in_strip] - rows.start
        part = position[edges_in_strip] - below[edges_in_strip]
        result[edges_in_strip] = total[row] + part[:, None] * strip[row]
        release(values[rows])

    return np.diff(result, axis=0)


def extremes(planes: NDArray[np.float32]) -> tuple[float, float]:
    """Return the lowest and the highest value of planes (n, H, W); NaN if one is NaN, or there is
    none.
    """
    if not planes.size:
        return math.nan, math.nan
    if not is_mapped(planes):
        return float(planes.min()), float(planes.max())
    low = math.inf
    high = -math.inf
    for plane in planes:
        for rows in strips(*plane.shape):
            part = plane[rows]
            # np.minimum keeps NaN; min does not.
            low = float(np.minimum(low, part.min()))
            high = float(np.maximum(high, part.max()))
            release(part)

    return low, high


LOW_NM, HIGH_NM = 360.0, 830.0  # the range of the eye, and of Mitsuba's colours
# Steps of the wavelength grids; a lamp uses the coarsest that resolves it. Powers of two, so that
# nodes, widths and ratios are exact in Mitsuba's float32, and the nodes of its combined response
# are those of the grid.
STEPS_NM = (1.0, 1 / 8, 1 / 32)
MAX_COUNT = 1e30  # largest value of a spectrum, in any unit
_FINEST_REGULAR_NM = 0.1
_MAX_REGULAR_VALUES = 8192
# 0.2 nm less a rounding error; tables with closer nodes need the finest step.
_COARSE_SPACING_NM = 0.199


@dataclass(frozen=True)
class Span:
    """A range of wavelengths that is computed; both ends are whole nanometres."""

    low_nm: float = LOW_NM
    high_nm: float = HIGH_NM

    @property
    def words(self) -> str:
        """The range, as text."""
        return f"{self.low_nm:g}-{self.high_nm:g} nm"


VISIBLE, WIDEST = Span(), Span(300.0, 1100.0)  # from where lenses transmit to where silicon ends


def grid_nm(step_nm: float = 1.0, span: Span = VISIBLE) -> Array:
    """Return the wavelengths of a range in equal steps."""
    return np.arange(span.low_nm, span.high_nm + step_nm / 2, step_nm)


@dataclass(frozen=True)
class Spectrum:
    """A piecewise linear function of wavelength, zero outside its nodes."""

    nodes_nm: Array = field(repr=False)
    values: Array = field(repr=False)

    def __post_init__(self) -> None:
        x = self.nodes_nm
        if x.size < 2 or x.shape != self.values.shape or not np.all(np.diff(x) >= 0):
            raise invalid(
                "spectrum",
                f"{x.size} wavelengths, {self.values.size} values",
                "two nodes or more, in increasing order",
            )

        if not (np.isfinite(x).all() and np.isfinite(self.values).all()):
            raise invalid(
                "spectrum", "NaN or infinity among the wavelengths or values", "finite numbers"
            )

        if self.values.max() > MAX_COUNT or self.values.min() < -MAX_COUNT:
            raise invalid(
                "spectrum",
                f"values up to {np.abs(self.values).max():.3g}",
                f"up to {MAX_COUNT:g}, the limit for float32",
            )

    def at(self, wavelength_nm: Array) -> Array:
        return np.interp(wavelength_nm, self.nodes_nm, self.values, left=0.0, right=0.0)

    @cached_property
    def step_nm(self) -> float:
        """Step of the coarsest grid that resolves the spectrum: 1 nm for tables at whole
        nanometres, else finer.
        """
        if np.all(self.nodes_nm == np.rint(self.nodes_nm)):
            return STEPS_NM[0]
        spacing_nm = np.diff(self.nodes_nm).min(initial=1.0)
        return STEPS_NM[1] if spacing_nm >= _COARSE_SPACING_NM else STEPS_NM[2]

    def cell_means(self, edges_nm: Array) -> Array:
        """Return the exact means over the cells between increasing edges, so that no spectral line
        is missed.
        """
        x = self.nodes_nm
        y = self.values
        cumulative = np.concatenate([[0.0], np.cumsum(np.diff(x) * (y[1:] + y[:-1]) / 2)])
        position_nm = np.clip(edges_nm, x[0], x[-1])
        index = np.clip(np.searchsorted(x, position_nm, side="right") - 1, 0, x.size - 2)
        distance_nm = position_nm - x[index]
        width = np.maximum(x[index + 1] - x[index], np.finfo(float).tiny)

        # The mean between the node below and the edge, by the line between the nodes.
        mean = y[index] + distance_nm / width * (y[index + 1] - y[index]) / 2
        integral = cumulative[index] + distance_nm * mean
        return np.diff(integral) / np.diff(edges_nm)

    def integral(self, low_nm: float = LOW_NM, high_nm: float = HIGH_NM) -> float:
        """Return the exact integral over a range."""
        return float(self.cell_means(np.array([low_nm, high_nm]))[0] * (high_nm - low_nm))

    def on_grid(self, step_nm: float, span: Span = VISIBLE) -> Array:
        """Return the means over cells around the nodes of `grid_nm`; their trapezoidal sum is the
        integral.
        """
        if (step_nm, span) not in self._on_grids:  # each band of a lamp asks for it
            nodes_nm = grid_nm(step_nm, span)
            edges_nm = np.concatenate([nodes_nm[:1], nodes_nm[:-1] + step_nm / 2, nodes_nm[-1:]])
            means = self.cell_means(edges_nm)
            means.flags.writeable = False
            self._on_grids[step_nm, span] = means
        return self._on_grids[step_nm, span]

    @cached_property
    def _on_grids(self) -> dict[tuple[float, Span], Array]:
        return {}

    def __mul__(self, factor: float) -> Spectrum:
        return Spectrum(self.nodes_nm, self.values * factor)


def tabulated(values: Array) -> Spectrum:
    """Make a spectrum from its values at 360 … 830 nm, every nanometre."""
    return Spectrum(grid_nm(), np.asarray(values, float))


def regular_values(table: Spectrum) -> Array | None:
    """Resample a table at equal steps without changing it, or return None if no step of at least
    0.1 nm does so.
    """
    distances = np.diff(table.nodes_nm) / _FINEST_REGULAR_NM
    counts = np.rint(distances).astype(int)
    if not np.allclose(distances, counts, rtol=0, atol=1e-6) or not np.all(counts > 0):
        return None
    count = int(counts.sum()) // int(np.gcd.reduce(counts)) + 1
    if count > _MAX_REGULAR_VALUES:
        return None
    return table.at(np.linspace(table.nodes_nm[0], table.nodes_nm[-1], count))
