"""Start from light that another program made: any file's values as irradiance on the sensor, and a cube for others.

What a file does not tell is asked for, never guessed. Row 0 is the top of the scene and column 0 its left.
"""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import Array
from pixsim.base.config import checked
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.files import replacing
from pixsim.base.parameters import Camera, CameraOptions, Layer
from pixsim.base.version import VERSION
from pixsim.light.exr import read_exr, read_header
from pixsim.light.foreign import (
    ALLOWED_UNITS,
    HOW_TO_STATE,
    IRRADIANCE_UNIT,
    Cube,
    LightUnit,
    parse_light_unit,
    read_cube,
    shortened,
)
from pixsim.light.spectral import MAX_VALUE, SpectralImage
from pixsim.optics.thin_lens import field_factor

ALLOWED_NM = (300.0, 1200.0)  # what glass lets through and silicon sees
PITCH_TOLERANCE = 1e-6  # an EXR attribute is a float32
PARTS_OF_A_BAND = 10


def read_irradiance(
    path: str | os.PathLike[str],
    camera: Camera | None = None,
    *,
    units: str | None = None,
    pitch_um: float | None = None,
) -> SpectralImage:
    """Spectral irradiance on the sensor, W m⁻² nm⁻¹, from a file of pixsim's or of another program's.

    Parameters
    ----------
    path : `.exr` of pixsim's (comes back bit for bit) or in the layout of Fichet et al. (JCGT 10(3), 2021), as pbrt-v4's
        SpectralFilm writes it; `.npz` with the arrays that `write_npz` writes; `.hdr`, an ENVI header beside its raw file
    camera : turns radiance L into irradiance E = L · `optics.irradiance_factor` · transmittance, its axis in the middle of
        the picture; its die gives the pitch where nothing else does
    units : of the values where the file does not tell them, as "W.m^-2.nm^-1" or "uW/cm^2/sr/nm"
    pitch_um : of the samples on the sensor, where neither the file nor the camera's die tells it

    The units of an `.npz` stand in `units`, of an EXR in emissiveUnits, of an ENVI cube in `data units`.
    A band's value is the mean over its width: `band_width_nm` in the file, `fwhm` in an ENVI header where bands do not
    overlap, else from the middle to one neighbour to the middle to the other (Fichet et al.).
    The emissiveUnits "W.m^-2.sr^-1" of an EXR are read per nm. (pbrt-v4 writes it whatever the scene's lights mean; it
    normalises their spectra, so that its values are absolute only where the lights' scales make them so.)

    Raises PixsimError for units, pitch or widths that are missing or contradict each other, radiance without a camera,
    reflectances, RGB, polarised light, wavelengths outside 300-1200 nm, values that are negative or not finite, darkness
    everywhere, and damaged files.
    """
    path = Path(path)
    if path.suffix.lower() == ".exr" and "pixsim" in read_header(path):
        return _own(path, camera, units, pitch_um)
    return _from_cube(path, read_cube(path), camera, units, pitch_um)


def read_with_camera(
    path: str | os.PathLike[str], options: CameraOptions, units: str | None = None
) -> tuple[SpectralImage, Camera]:
    """`read_irradiance` and the camera that the picture is taken with: what the file tells, with the options over it.

    A file of pixsim's own tells all of its camera; another may tell its pitch, and so the die that the picture fills.
    """
    path = Path(path)
    if path.suffix.lower() == ".exr" and "pixsim" in read_header(path):
        image = _own(path, None, units, None)
        told = image.header.get("camera") or {}
        die = {"die_mm": image.pitch_um * image.shape[1] / 1e3} if options.die_mm is None else {}
        camera = options.over(checked(Camera, [Layer({**told, **die}, f"camera in '{path}'")]))
        _agreed_pitch(path, image.pitch_um, None, camera, image.shape[1])
        return image, camera
    cube = read_cube(path)
    known = cube.pitch_um is not None and options.die_mm is None
    die_mm = _positive(path, "pitch_um", cube.pitch_um) * cube.data.shape[1] / 1e3 if known else Camera().die_mm
    camera = options.over(checked(Camera, [Layer({"die_mm": die_mm}, f"'{path}'")]))
    return _from_cube(path, cube, camera, units, None), camera


def _from_cube(path: Path, cube: Cube, camera: Camera | None, units: str | None, pitch_um: float | None) -> SpectralImage:
    nm, width_nm = _bands(path, cube)
    unit, text = _agreed_unit(path, cube.units, units, cube.per_nm)
    sampling_um = _agreed_pitch(path, cube.pitch_um, pitch_um, camera, cube.data.shape[1])
    header: dict[str, Any] = {"source": path.name, "units": text, "pixsim": VERSION}
    light: float | Array = unit.factor
    if unit.radiance:
        if camera is None:
            mend = "Give read_irradiance(path, camera); on the command line --camera.f-number and its like."
            raise invalid(f"light in '{path}'", f"radiance ({text}) without a camera", "irradiance, or radiance and a camera", mend)
        lens = camera.image_distance_mm, camera.f_number, camera.magnification
        light = unit.factor * camera.transmittance * field_factor(cube.data.shape[:2], sampling_um, *lens)
        header["camera"] = camera.model_dump()
    if cube.white_cd_per_m2 is not None:
        header["luminance_cd_per_m2"] = _positive(path, "white_cd_per_m2", cube.white_cd_per_m2)
    data = np.empty(cube.data.shape, np.float32)
    for band, centre_nm in enumerate(nm):
        told = cube.data[:, :, band]
        with np.errstate(over="ignore", invalid="ignore"):
            data[:, :, band] = told.astype(float) * light
        _check_band(path, data[:, :, band], told, centre_nm)
    _check_lit(path, data.any())
    # Light that is even over each band, in ten parts.
    nodes = nm[:, None] + width_nm[:, None] * ((np.arange(PARTS_OF_A_BAND) + 0.5) / PARTS_OF_A_BAND - 0.5)
    within = nodes, np.full(nodes.shape, 1 / PARTS_OF_A_BAND)
    return SpectralImage(nm, width_nm, sampling_um, data=data, within=within, header=header)


def write_npz(path: str | os.PathLike[str], image: SpectralImage) -> None:
    """Write the arrays that `read_irradiance` reads, moved into place when whole; they come back bit for bit.

    `data` (H, W, B) float32, `wavelength_nm` and `band_width_nm` (B,), `units`, `pitch_um`, and `white_cd_per_m2` where the
    image knows its white. Factors and the header stay behind; `write_exr` keeps them.

    path : ends in .npz, as `read_irradiance` expects

    Raises PixsimError where `path` cannot be written.
    """
    arrays: dict[str, Any] = {"data": image.data, "wavelength_nm": image.wavelength_nm, "units": IRRADIANCE_UNIT}
    arrays |= {"band_width_nm": image.band_width_nm, "pitch_um": image.pitch_um}
    if "luminance_cd_per_m2" in image.header:
        arrays["white_cd_per_m2"] = image.header["luminance_cd_per_m2"]
    try:
        # A name instead of a file would get the ending .npz.
        with replacing(Path(path)) as partial, partial.open("wb") as file:
            np.savez(file, **arrays)
    except OSError as error:
        raise invalid("output file", f"'{path}' ({error})", "a path that can be written") from None


def _own(path: Path, camera: Camera | None, units: str | None, pitch_um: float | None) -> SpectralImage:
    image = read_exr(path)
    _agreed_unit(path, IRRADIANCE_UNIT, units)
    _agreed_pitch(path, image.pitch_um, pitch_um, camera, image.shape[1])
    # The pictures behind factors are light; a band made of them may be a little below zero.
    planes = list(image.factors[1]) if image.factors else [image.band(band) for band in range(image.wavelength_nm.size)]
    for plane, centre_nm in zip(planes, np.resize(image.wavelength_nm, len(planes)), strict=True):
        _check_band(path, plane, plane, float(centre_nm))
    _check_lit(path, any(plane.any() for plane in planes))
    return image


def _bands(path: Path, cube: Cube) -> tuple[Array, Array]:
    """Centres and widths, (B,) nm."""
    nm = cube.wavelength_nm
    low, high = ALLOWED_NM
    if nm.shape != cube.data.shape[2:] or not np.all(np.diff(nm) > 0) or not np.all((nm >= low) & (nm <= high)):
        got = f"{shortened(nm.tolist())} nm for {cube.data.shape[2]} bands"
        allowed = f"one a band, increasing, {low:g} to {high:g} nm"
        raise invalid(f"wavelengths in '{path}'", got, allowed, "Leave out the other bands.")
    if cube.band_width_nm is not None:
        width_nm = np.asarray(cube.band_width_nm)
        numbers = width_nm.shape in ((), nm.shape) and width_nm.dtype.kind in "iuf"
        if not (numbers and np.all((width_nm > 0) & (width_nm < np.inf))):
            raise invalid(f"band widths in '{path}'", width_nm, f"one, or {nm.size}, positive, in nm")
        return nm, np.broadcast_to(width_nm.astype(float), nm.shape)
    if nm.size == 1:
        mend = "Add band_width_nm to the .npz, as an attribute to the EXR, or fwhm to the ENVI header."
        raise invalid(f"band width in '{path}'", "none, and one band has no neighbour that tells it", "a width in nm", mend)
    middle = (nm[1:] + nm[:-1]) / 2
    return nm, np.diff(np.concatenate([[2 * nm[0] - middle[0]], middle, [2 * nm[-1] - middle[-1]]]))


def _agreed_unit(path: Path, told: str, stated: str | None, per_nm: bool = False) -> tuple[LightUnit, str]:
    """The unit of the values and how it was spelled; what the caller states may add to what the file tells, not differ."""
    what, text = f"units of '{path}'", stated or told
    if not text:
        raise invalid(what, "none in the file", ALLOWED_UNITS, HOW_TO_STATE)
    unit = own = parse_light_unit(text, what)
    if stated and told:
        with suppress(PixsimError):  # what the file says is no unit
            own = parse_light_unit(told, what)
    if per_nm:
        unit, own = (replace(each, spectral=True) if each.radiance else each for each in (unit, own))
    if (own != unit) if own.spectral else (own.radiance != unit.radiance):
        raise invalid(what, f"{told} in the file, {stated} stated", "one unit", "Leave the stated one out.")
    if not unit.spectral:
        raise invalid(what, f"{text}, which names no wavelength", ALLOWED_UNITS, HOW_TO_STATE)
    return unit, text


def _agreed_pitch(path: Path, told: Any, stated: float | None, camera: Camera | None, columns: int) -> float:
    """µm; the camera's where it agrees with the others, so that the picture fills the die to the last bit."""
    known: dict[str, Any] = {}
    if camera:
        known[f"camera.die_mm / {columns} columns"] = 1e3 * camera.die_mm / columns
    known |= {"the file": told, "pitch_um": stated}
    pitches = {what: _positive(path, "pitch_um", value) for what, value in known.items() if value is not None}
    if not pitches:
        mend = "Give pitch_um=, or a camera whose die the picture fills (--camera.die-mm)."
        raise invalid(f"pitch of '{path}'", "none in the file", "the pitch of the samples on the sensor in µm", mend)
    values = list(pitches.values())
    if not np.allclose(values, values[0], rtol=PITCH_TOLERANCE, atol=0.0):
        got = ", ".join(f"{pitch:.9g} µm by {what}" for what, pitch in pitches.items())
        die_mm = values[-1] * columns / 1e3
        mend = f"Leave pitch_um out, or take camera.die_mm = {die_mm:.9g} (--camera.die-mm {die_mm:.9g})."
        raise invalid(f"pitch of '{path}'", got, "one pitch", mend)
    return values[0]


def _positive(path: Path, what: str, value: Any) -> float:
    try:
        number = float(np.asarray(value).item())
    except (TypeError, ValueError):
        number = np.nan
    if not 0 < number < np.inf:
        raise invalid(f"{what} of '{path}'", value, "a positive number")
    return number


def _check_band(path: Path, values: NDArray[np.float32], told: NDArray[Any], centre_nm: float) -> None:
    """Refuse what is not light; `told` are the file's own values of it."""
    bad = np.argwhere(~((values >= 0) & (values <= MAX_VALUE)))
    if bad.size:
        row, column = bad[0]
        got = f"{told[row, column]} at row {row}, column {column} of the band at {centre_nm:g} nm"
        raise invalid(f"light in '{path}'", got, f"0 to {MAX_VALUE:.3g} W/m²/nm", "Mend the picture where it was made.")


def _check_lit(path: Path, lit: object) -> None:
    if not lit:
        raise invalid(f"light in '{path}'", "black everywhere", "some light", "Is this the right file, and are its lamps on?")
