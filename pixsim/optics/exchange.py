"""Exchange spectral images with other programs: read a file as irradiance on the sensor, and write
an `.npz` cube.

Missing metadata is an error, never a guess. Row 0 is the top of the scene and column 0 its left.
"""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import Array, first_where
from pixsim.base.bounds import Positive
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.files import replacing
from pixsim.base.layers import Layer
from pixsim.base.notes import Note, warn
from pixsim.base.records import checked
from pixsim.base.version import VERSION
from pixsim.light import foreign
from pixsim.light.exr import read_exr, read_header
from pixsim.light.spectral import (
    MAX_VALUE,
    OUTLIER,
    OUTLIERS,
    RINGS,
    SpectralImage,
    find_outliers,
    lowest_allowed,
)
from pixsim.light.tables import unit_hint
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.camera_lens import camera_with_lens
from pixsim.optics.camera_light import camera_factor
from pixsim.optics.lens_options import LensOptions

ALLOWED_NM = (300.0, 1200.0)  # where glass transmits and silicon responds
_NO_FILE = Path("the light that is given")
_PITCH_TOLERANCE = 1e-6  # an EXR attribute is a float32
PARTS_OF_A_BAND = 10
_WIDE_BAND_NM = 40.0  # of a band; filters of a camera are about 80 nm wide
# Of the brightest band's mean: sums of fitted factors may fall a little below zero where a lamp is
# dark.
_MAX_NEGATIVE_SHARE = 0.01


def read_irradiance(
    path: str | os.PathLike[str],
    camera: Camera | None = None,
    *,
    units: str | None = None,
    pitch_um: Positive | None = None,
) -> SpectralImage:
    """Read spectral irradiance on the sensor, W m⁻² nm⁻¹, from a file of pixsim or of another
    program.

    Parameters
    ----------
    path : `.exr` from `write_exr` (read back bit for bit) or in the layout of Fichet et al. (JCGT
        10(3), 2021), as pbrt-v4's SpectralFilm writes it; `.npz` from `write_npz`; `.hdr`, an ENVI
        header with its raw file in the same folder
    camera : converts radiance L to irradiance E = L · `optics.irradiance_factor` · transmittance,
        with the optical axis at the centre of the picture; its die width gives the pitch if nothing
        else does
    units : of the values if the file does not state them, for example "W.m^-2.nm^-1" or
        "uW/cm^2/sr/nm"
    pitch_um : of the samples on the sensor, if neither the file nor the camera's die gives it

    Units are read from `units` of an `.npz`, emissiveUnits of an EXR, and `data units` of an ENVI
    header. A band's value is the mean over its width: `band_width_nm` of the file, or `fwhm` of an
    ENVI header where bands do not overlap. Otherwise a band extends halfway to its neighbours
    (Fichet et al.). The emissiveUnits "W.m^-2.sr^-1" of an EXR are read as per nm. (pbrt-v4
    normalises the spectra of lights, so its values are absolute only if the scales of the lights
    are.)

    Raises PixsimError if units, pitch or band widths are missing or contradict each other, for
    radiance without a camera, reflectances, RGB, polarised light, wavelengths outside 300-1200 nm,
    values that are negative or not finite, a black picture, and damaged files.
    """
    path = Path(path)
    if path.suffix.lower() == ".exr" and "pixsim" in read_header(path):
        return _read_pixsim_exr(path, camera, units, pitch_um)
    return _from_cube(path, foreign.read_cube(path), camera, units, pitch_um)


def read_with_camera(
    path: str | os.PathLike[str],
    options: CameraOptions,
    units: str | None = None,
    lens: LensOptions | None = None,
) -> tuple[SpectralImage, Camera]:
    """Read irradiance as `read_irradiance` does, and its camera: the file's metadata, overridden by
    the options.

    A file from pixsim states its camera and its real lens. Another file may state its pitch, and so
    the width of the die; light on the sensor has the distortion and the fall-off that it has, and
    gets the blur of a real lens.
    """
    lens = lens or LensOptions()
    path = Path(path)
    if path.suffix.lower() == ".exr" and "pixsim" in read_header(path):
        image = _read_pixsim_exr(path, None, units, None)
        return image, camera_of_light(image, options, lens, path)
    cube = foreign.read_cube(path)
    pitch_known = cube.pitch_um is not None and options.die_mm is None
    if pitch_known:
        die_mm = _positive(path, "pitch_um", cube.pitch_um) * cube.data.shape[1] / 1e3
    else:
        die_mm = Camera().die_mm
    camera = camera_with_lens(
        options.over(checked(Camera, [Layer({"die_mm": die_mm}, f"'{path}'")])), options, lens
    )
    return _from_cube(path, cube, camera, units, None), camera


def camera_of_light(
    image: SpectralImage, options: CameraOptions, lens: LensOptions, path: Path = _NO_FILE
) -> Camera:
    """Return the camera in the header of light, overridden by the options.

    path : of its file, for messages

    Raises PixsimError if the camera's pitch and die contradict each other, and for rendered light
    with a lens other than the lens of the render.
    """
    if "camera" in image.header and lens.file is not None:
        got = f"'{lens.file}' for light of '{path}', which was rendered with another lens"
        raise invalid(
            "lens.file",
            got,
            "the lens with which this light was rendered",
            "Render the scene with this lens.",
        )

    die = {"die_mm": image.pitch_um * image.shape[1] / 1e3} if options.die_mm is None else {}
    camera = options.over(
        checked(
            Camera, [Layer({**(image.header.get("camera") or {}), **die}, f"camera in '{path}'")]
        )
    )
    _agreed_pitch(path, image.pitch_um, None, camera, image.shape[1])
    return camera_with_lens(camera, options, lens)


def _from_cube(
    path: Path, cube: foreign.Cube, camera: Camera | None, units: str | None, pitch_um: float | None
) -> SpectralImage:
    nm, width_nm = _bands(path, cube)
    unit, text = _agreed_unit(path, cube.units, units, cube.per_nm)
    sampling_um = _agreed_pitch(path, cube.pitch_um, pitch_um, camera, cube.data.shape[1])
    header: dict[str, Any] = {"source": path.name, "units": text, "pixsim": VERSION}

    irradiance_per_value: float | Array = unit.factor
    if unit.radiance:
        if camera is None:
            hint = (
                "Give read_irradiance(path, camera), or --camera.f-number and the other camera"
                " options on the command line."
            )
            raise invalid(
                f"light in '{path}'",
                f"radiance ({text}) without a camera",
                "irradiance, or radiance and a camera",
                hint,
            )

        irradiance_per_value = (
            unit.factor
            * camera.transmittance
            * camera_factor(camera, cube.data.shape[:2], sampling_um)
        )
        header["camera"] = camera.model_dump()

    if cube.white_cd_per_m2 is not None:
        header["luminance_cd_per_m2"] = _positive(path, "white_cd_per_m2", cube.white_cd_per_m2)

    data = np.empty(cube.data.shape, np.float32)
    for band, centre_nm in enumerate(nm):
        file_values = cube.data[:, :, band]
        with np.errstate(over="ignore", invalid="ignore"):
            data[:, :, band] = file_values.astype(float) * irradiance_per_value
        _check_band(path, data[:, :, band], file_values, centre_nm)

    _check_not_black(path, data.any())
    if outliers := find_outliers(data @ width_nm):
        header[OUTLIERS] = [list(sample) for sample in outliers]
        row, column = outliers[0]
        samples_text = f"row {row}, column {column}"
        if len(outliers) > 1:
            samples_text += f" and {len(outliers) - 1} more"
        warning_text = (
            f"has isolated samples, more than {OUTLIER:g} times all others"
            f" ({samples_text}), like the fireflies of a path tracer: the automatic exposure"
            f" treats them as if they were like their neighbours. Remove them at their source"
        )
        warn(Note("light_file", file=path.name, words=warning_text))

    _note_bands(path, nm, width_nm)

    # The light is taken as uniform within each band.
    offsets = (np.arange(PARTS_OF_A_BAND) + 0.5) / PARTS_OF_A_BAND - 0.5
    nodes = nm[:, None] + width_nm[:, None] * offsets
    within = nodes, np.full(nodes.shape, 1 / PARTS_OF_A_BAND)
    return SpectralImage(nm, width_nm, sampling_um, data=data, within=within, header=header)


def _note_bands(path: Path, nm: Array, width_nm: Array) -> None:
    """Warn of bands so wide that lines and filters within them are not resolved."""
    if nm.size > 1 and width_nm.max() > _WIDE_BAND_NM:
        low = nm[0] - width_nm[0] / 2
        high = nm[-1] + width_nm[-1] / 2
        text = (
            f"has {nm.size} bands of up to {width_nm.max():g} nm: they represent {low:g}-{high:g}"
            " nm, with the light uniform within each and none outside. Colour and quantum"
            f" efficiency need bands of {_WIDE_BAND_NM:g} nm or less"
        )
        warn(Note("light_file", file=path.name, words=text))


def write_npz(path: str | os.PathLike[str], image: SpectralImage) -> None:
    """Write an `.npz` file that `read_irradiance` reads back bit for bit; it is moved into place
    when complete.

    Its arrays are `data` (rows, columns, bands) float32, `wavelength_nm` and `band_width_nm` (B,),
    `units`, `pitch_um`, and `white_cd_per_m2` if the image has a white luminance. Factors and
    header are not written; `write_exr` keeps them. Light that is still to be blurred by a real lens
    rings below zero at edges, and is written as 0 there.

    path : must end in .npz for `read_irradiance`

    Raises PixsimError if `path` cannot be written.
    """
    data = np.maximum(image.data, 0) if image.header.get(RINGS) is True else image.data
    arrays: dict[str, Any] = {
        "data": data,
        "wavelength_nm": image.wavelength_nm,
        "units": foreign.IRRADIANCE_UNIT,
    }
    arrays |= {"band_width_nm": image.band_width_nm, "pitch_um": image.pitch_um}
    if "luminance_cd_per_m2" in image.header:
        arrays["white_cd_per_m2"] = image.header["luminance_cd_per_m2"]
    try:
        # Given a name instead of a file, NumPy would append .npz.
        with replacing(Path(path)) as partial, partial.open("wb") as file:
            np.savez(file, **arrays)
    except OSError as error:
        raise invalid(
            "output file", f"'{path}' ({error.strerror or error})", "a path that can be written"
        ) from None


def _read_pixsim_exr(
    path: Path, camera: Camera | None, units: str | None, pitch_um: float | None
) -> SpectralImage:
    image = read_exr(path)
    _agreed_unit(path, foreign.IRRADIANCE_UNIT, units)
    _agreed_pitch(path, image.pitch_um, pitch_um, camera, image.shape[1])
    if reduced := image.header.get("reduced"):
        factor = f"{reduced['factor']:.4g}"
        text = (
            f"holds means over {factor} × {factor} samples of the render, {image.pitch_um:.4g} µm"
            f" wide: finer detail is lost, and results differ; pixsim run --irradiance full"
            " keeps it"
        )
        warn(Note("light_file", file=path.name, words=text))

    # Check the pictures of the factors: a band that is made of them may be slightly below zero, as
    # may be what rings.
    if image.factors:
        planes = list(image.factors[1])
    else:
        planes = [image.band(band) for band in range(image.wavelength_nm.size)]

    for plane, centre_nm in zip(planes, np.resize(image.wavelength_nm, len(planes)), strict=True):
        highest = float(np.nanmax(plane, initial=0.0))
        lowest = lowest_allowed(image.header, highest)
        _check_band(path, plane, plane, float(centre_nm), lowest)

    _check_not_black(path, any(plane.any() for plane in planes))
    if image.factors and (image.factors[0] < 0).any() and image.header.get(RINGS) is not True:
        # Single samples are below zero by the noise of a render, whose factors are independent.
        mean = image.factors[0].T @ image.factors[1].mean(axis=(1, 2), dtype=float)
        darkest = int(mean.argmin())
        if mean[darkest] < -_MAX_NEGATIVE_SHARE * np.abs(mean).max():
            got = (
                f"a mean of {mean[darkest]:.3g} W/m²/nm in the band at"
                f" {image.wavelength_nm[darkest]:g} nm"
            )
            raise invalid(
                f"light in '{path}'", got, "0 or more", "Correct the spectra of its factors."
            )

    return image


def _bands(path: Path, cube: foreign.Cube) -> tuple[Array, Array]:
    """Return band centres and widths, (B,) nm."""
    nm = cube.wavelength_nm
    low, high = ALLOWED_NM
    if (
        nm.shape != cube.data.shape[2:]
        or not np.all(np.diff(nm) > 0)
        or not np.all((nm >= low) & (nm <= high))
    ):
        got = f"{foreign.shortened(nm.tolist())} nm for {cube.data.shape[2]} bands"
        allowed = f"one per band, increasing, from {low:g} to {high:g} nm"
        unit = unit_hint(nm.tolist(), ALLOWED_NM, cube.wavelength_unit, "the header")
        raise invalid(
            f"wavelengths in '{path}'",
            got,
            allowed,
            f"{unit}." if unit else "Remove the bands outside this range.",
        )

    if cube.band_width_nm is not None:
        width_nm = np.asarray(cube.band_width_nm)
        numbers = width_nm.shape in ((), nm.shape) and width_nm.dtype.kind in "iuf"
        if not (numbers and np.all((width_nm > 0) & (width_nm < np.inf))):
            raise invalid(
                f"band widths in '{path}'", width_nm, f"one or {nm.size} positive numbers, in nm"
            )
        return nm, np.broadcast_to(width_nm.astype(float), nm.shape)

    if nm.size == 1:
        hint = (
            "Add band_width_nm to the .npz, as an attribute to the EXR, or fwhm to the ENVI header."
        )
        raise invalid(f"band width in '{path}'", "none, for a single band", "a width in nm", hint)

    edges_nm = (nm[1:] + nm[:-1]) / 2
    return nm, np.diff(
        np.concatenate([[2 * nm[0] - edges_nm[0]], edges_nm, [2 * nm[-1] - edges_nm[-1]]])
    )


def _agreed_unit(
    path: Path, file_units: str, stated: str | None, per_nm: bool = False
) -> tuple[foreign.LightUnit, str]:
    """Return the unit of the values and its text; a unit that the caller states must not contradict
    the file's.
    """
    name = f"units of '{path}'"
    text = stated or file_units
    if not text:
        raise invalid(name, "none in the file", foreign.ALLOWED_UNITS, foreign.HOW_TO_STATE)
    unit = file_unit = foreign.parse_light_unit(text, name, typed=bool(stated))
    if stated and file_units:
        with suppress(PixsimError):  # the file's text may be no unit
            file_unit = foreign.parse_light_unit(file_units, name, typed=False)
    if per_nm and unit.radiance:
        unit = replace(unit, spectral=True)
    if per_nm and file_unit.radiance:
        file_unit = replace(file_unit, spectral=True)

    # Of a unit that is not per wavelength, only its kind says something.
    is_other_kind = file_unit.radiance != unit.radiance
    if is_other_kind or (file_unit.spectral and file_unit != unit):
        raise invalid(
            name,
            f"{file_units} in the file, but {stated} stated",
            "the same unit",
            "Leave units (--units) out.",
        )

    if not unit.spectral:
        raise invalid(
            name,
            f"{text}, which is not per wavelength",
            foreign.ALLOWED_UNITS,
            foreign.HOW_TO_STATE,
        )

    return unit, text


def _agreed_pitch(
    path: Path, file_pitch_um: object, stated: float | None, camera: Camera | None, columns: int
) -> float:
    """Return the pitch in µm: the camera's if it agrees with the others, so that the picture fills
    the die exactly.
    """
    stated_pitches: dict[str, Any] = {}
    if camera:
        stated_pitches[f"camera.die_mm / {columns} columns"] = 1e3 * camera.die_mm / columns
    stated_pitches["the file"] = file_pitch_um
    stated_pitches["pitch_um"] = stated
    pitches = {
        source: _positive(path, "pitch_um", value)
        for source, value in stated_pitches.items()
        if value is not None
    }
    if not pitches:
        hint = "Give pitch_um, or a camera with the width of the die (--camera.die-mm)."
        raise invalid(
            f"pitch of '{path}'",
            "none in the file",
            "the pitch of the samples on the sensor in µm",
            hint,
        )

    values = list(pitches.values())
    if not np.allclose(values, values[0], rtol=_PITCH_TOLERANCE, atol=0.0):
        got = ", ".join(f"{pitch:.9g} µm by {source}" for source, pitch in pitches.items())
        die_mm = values[-1] * columns / 1e3
        hint = (
            f"Leave pitch_um out, or set camera.die_mm = {die_mm:.9g} (--camera.die-mm"
            f" {die_mm:.9g})."
        )
        raise invalid(f"pitch of '{path}'", got, "equal pitches", hint)

    return values[0]


def _positive(path: Path, name: str, value: object) -> float:
    try:
        number = float(np.asarray(value).item())
    except (TypeError, ValueError):
        number = np.nan

    low, high = _PICTURE_BOUNDS[name]
    if not low <= number <= high:
        got = "no number" if np.isnan(number) else f"{number:g}"
        raise invalid(f"{name} of '{path}'", got, f"a positive number, {low:g} to {high:g}")
    return number


# Samples from a thousandth of a pixel's smallest pitch to a die of their own, and the luminances
# that a display's white may have.
_PICTURE_BOUNDS = {"pitch_um": (1e-6, 1e6), "white_cd_per_m2": (1e-12, 1e15)}


def _check_band(
    path: Path,
    values: NDArray[np.float32],
    file_values: NDArray[Any],
    centre_nm: float,
    lowest: float = 0.0,
) -> None:
    """Raise PixsimError if a band has invalid values; the message shows the value in the file."""
    if at := first_where(~((values >= lowest) & (values <= MAX_VALUE))):
        row, column = at
        got = (
            f"{file_values[row, column]} at row {row}, column {column} of the band at"
            f" {centre_nm:g} nm"
        )
        raise invalid(
            f"light in '{path}'",
            got,
            f"{lowest:.3g} to {MAX_VALUE:.3g} W/m²/nm",
            "Correct the picture at its source.",
        )


def _check_not_black(path: Path, has_light: object) -> None:
    if not has_light:
        raise invalid(
            f"light in '{path}'",
            "a black picture",
            "some light",
            "Check the file and the lamps of its scene.",
        )
