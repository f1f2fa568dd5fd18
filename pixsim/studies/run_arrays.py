"""The arrays of a run as files for other programs: its light, its raw frames and its ΔE map."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import chain
from pathlib import Path
from typing import Literal

from pixsim.base.errors import invalid
from pixsim.light.exr import reduced_to_fit, write_channels, write_exr
from pixsim.light.spectral import SpectralImage
from pixsim.sensor.raw import BITS_OF_PICTURES, write_frame
from pixsim.studies.run import RunResult
from pixsim.viewer.setting import Run

Irradiance = Literal["reduced", "full", "factors", "none"]  # what irradiance.exr holds


def check_raw(settings: Run, suffixes: Sequence[str]) -> None:
    """Raise PixsimError for raw frames of too many bits for their format."""
    bits = (settings.exposure.frames * (2**settings.pixel.bits - 1)).bit_length()
    if bits > BITS_OF_PICTURES and {".tiff", ".png"} & set(suffixes):
        got = f"tiff or png for frames of {bits} bits"
        raise invalid("--raw", got, f"at most {BITS_OF_PICTURES} bits; use npz for more")


def write_irradiance(path: Path, image: SpectralImage, irradiance: Irradiance) -> None:
    """Write the light of a run as EXR: whole, its factors only, or bands of at most 1024 samples across and 60 MB."""
    write_exr(path, reduced_to_fit(image) if irradiance == "reduced" else image, factors_only=irradiance == "factors")


def write_numbers(
    result: RunResult, folder: Path, name_of: Callable[[int], str], suffixes: Sequence[str], frame_done: Callable[[int], object]
) -> None:
    """Write delta_e.exr and the raw frames of a run.

    name_of : returns the name of a frame's file, without its suffix
    suffixes : of the formats
    frame_done : called with the number of frames written so far
    """
    write_channels(folder / "delta_e.exr", {"delta_e": result.score.delta_e}, {})
    for number, frame in enumerate(chain([result.score.frame], result.further_frames()), 1):
        for suffix in suffixes:
            write_frame(folder / f"{name_of(number)}{suffix}", frame)
        frame_done(number)
