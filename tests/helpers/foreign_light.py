"""Files of light as other programs write them: EXR by OpenEXR, `.npz` by NumPy, ENVI by SPy."""

from pathlib import Path

import numpy as np
import OpenEXR
from spectral.io import envi

UNIT = "W.m^-2.nm^-1"
NM = [500.0, 510.0, 520.0]
NAMES = ("S0.500nm", "S0.510nm", "S0.520nm")


def light(shape: tuple[int, ...] = (4, 5, 3), seed: int = 0) -> np.ndarray:
    """Return random values of a cube, float32."""
    return np.random.default_rng(seed).uniform(0.1, 1, shape).astype(np.float32)


def stokes(data: np.ndarray, names: tuple[str, ...] = NAMES) -> dict[str, np.ndarray]:
    """Return the channels of a cube by name."""
    return {name: data[:, :, band] for band, name in enumerate(names)}


def write_exr(path: Path, channels: dict[str, np.ndarray], **header: object) -> Path:
    top = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **header}
    planes = {name: np.ascontiguousarray(plane) for name, plane in channels.items()}
    with OpenEXR.File(top, planes) as file:
        file.write(str(path))
    return path


def write_npz(path: Path, **arrays: object) -> Path:
    """Write a cube; an array of None is left out."""
    every = {"data": light(), "wavelength_nm": NM, "units": UNIT, "pitch_um": 2.5} | arrays
    np.savez(path, **{name: value for name, value in every.items() if value is not None})
    return path


def write_envi(
    path: Path,
    data: np.ndarray | None = None,
    interleave: str = "bil",
    byte_order: int = 0,
    **fields: object,
) -> Path:
    """Write a cube; a field of None is left out."""
    values = light() if data is None else data
    header = {"wavelength": NM, "wavelength units": "Nanometers", "data units": UNIT}
    header |= {name.replace("_", " "): value for name, value in fields.items()}
    envi.save_image(
        str(path),
        values,
        dtype=values.dtype,
        interleave=interleave,
        byteorder=byte_order,
        metadata={name: value for name, value in header.items() if value is not None},
        ext="raw",
    )
    return path


def write_light(kind: str, path: Path, data: np.ndarray, units: str | None) -> Path:
    """Write a cube without pitch as exr, npz or hdr."""
    if kind == "exr":
        header = {"emissiveUnits": units} if units else {}
        return write_exr(path.with_suffix(".exr"), stokes(data), **header)
    if kind == "npz":
        return write_npz(path.with_suffix(".npz"), data=data, units=units, pitch_um=None)
    return write_envi(path.with_suffix(".hdr"), data, data_units=units)
