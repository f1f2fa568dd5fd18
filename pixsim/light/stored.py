"""Spectral images whose pictures lie in a file, so that the memory holds only those in use."""

from __future__ import annotations

import hashlib
import os
import tempfile
import weakref
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from pixsim.base.files import disk_faults_named
from pixsim.light.spectral import SpectralImage


class PictureFile:
    """A file of pictures without a name, whose space is free again when nothing uses it, however
    the process ends.

    folder : on the disk that is to hold it
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._file: IO[bytes] | None = None
        self._offsets: dict[bytes, int] = {}

    def stored(self, image: SpectralImage) -> StoredImage:
        """Return the image with its pictures in the file, equal pictures once. Raises PixsimError
        if the disk is full.
        """
        whole = image.whole
        values = np.ascontiguousarray(whole.factors[1] if whole.factors else whole.data)
        digest = hashlib.blake2b(values.data, digest_size=16).digest()
        with disk_faults_named(
            self._folder, self._folder, "It holds the pictures of all lights of the study."
        ):
            if self._file is None:
                # Open as long as its images are.
                self._file = tempfile.TemporaryFile(buffering=0, dir=self._folder)  # noqa: SIM115
                weakref.finalize(self, self._file.close)
            if digest not in self._offsets:
                offset = self._file.seek(0, os.SEEK_END)
                remaining = values.data.cast("B")
                while remaining:  # one write is at most 2 GiB
                    remaining = remaining[self._file.write(remaining) :]
                self._offsets[digest] = offset

        return StoredImage(image, self, self._offsets[digest])

    def mapped(self, offset: int, shape: tuple[int, ...]) -> NDArray[np.float32]:
        """Return pictures at an offset in the file; memory holds the parts that are read, as long
        as the array is used.
        """
        assert self._file is not None
        return np.asarray(np.memmap(self._file, np.float32, "r", offset, shape))


class StoredImage(SpectralImage):
    """A spectral image whose pictures lie in a file; they are mapped into memory each time that
    they are used.

    A copy, and the image in another process, has them in memory.
    """

    def __init__(self, image: SpectralImage, file: PictureFile, offset: int) -> None:
        self.wavelength_nm = image.wavelength_nm
        self.band_width_nm = image.band_width_nm
        self.within = image.within
        self.pitch_um = image.pitch_um
        self.header = dict(image.header)
        self.margin = image.margin
        self._spectra = image.factors[0] if image.factors else None
        self._file = file
        self._offset = offset
        whole = image.whole
        self._size = (whole.factors[1] if whole.factors else whole.data).shape

    @property
    def _pictures_with_margin(self) -> NDArray[np.float32]:  # type: ignore[override]
        """The pictures of the factors (r, H, W), or the bands (H, W, B), with their margin."""
        return self._file.mapped(self._offset, self._size)

    @property
    def _values(self) -> NDArray[np.float32]:
        """The pictures of the factors (r, H, W), or the bands (H, W, B), without their margin."""
        pictures = self._pictures_with_margin
        height, width = pictures.shape[:2] if self._spectra is None else pictures.shape[1:]
        inside = slice(self.margin, height - self.margin), slice(self.margin, width - self.margin)
        return pictures[inside] if self._spectra is None else pictures[:, *inside]

    @property
    def factors(self) -> tuple[NDArray[Any], NDArray[Any]] | None:  # type: ignore[override]
        """(spectra (r, B), pictures (r, H, W)), or None."""
        return None if self._spectra is None else (self._spectra, self._values)

    @property
    def data(self) -> NDArray[np.float32]:
        """Values (H, W, B) float32, W m⁻² nm⁻¹."""
        return self._values if self._spectra is None else self.in_memory().data

    def in_memory(self) -> SpectralImage:
        """Return the image with its pictures in memory."""
        values = np.array(self._pictures_with_margin)
        content: dict[str, Any] = (
            {"data": values} if self._spectra is None else {"factors": (self._spectra, values)}
        )
        content |= {"within": self.within, "header": self.header, "margin": self.margin}
        return SpectralImage(self.wavelength_nm, self.band_width_nm, self.pitch_um, **content)

    def __reduce__(self) -> tuple[Any, ...]:
        return _itself, (self.in_memory(),)


def _itself(image: SpectralImage) -> SpectralImage:
    return image
