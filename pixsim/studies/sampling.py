"""The pixel sizes of a study, and how many sensors of each it starts with."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.errors import invalid
from pixsim.optics.camera import Camera
from pixsim.optics.diffraction import cutoff_cy_per_mm
from pixsim.scene.film import GREEN_NM
from pixsim.sensor.motion import border_with_room_um
from pixsim.sensor.pixel import largest_pitch_um, pitch_for_fill_factor_um
from pixsim.sensor.pixel_options import NO_TECHNOLOGY
from pixsim.sensor.technology import with_fill_factor_law
from pixsim.studies.pixels import pixel_of, technology_of
from pixsim.studies.study_settings import Study
from pixsim.viewer.imaging import Imaging

CUTOFF_NM = GREEN_NM  # at which a lens limits pixels, as it limits the film of a render
BYTES_PER_PIXEL = 72.0  # of a frame, its fixed pattern and its noise, while it is simulated
Sizes = dict[float, int]  # pitch in µm -> sensors, in order
Sampling = dict[str, Sizes]  # technology -> its pixel sizes, in order


_equal_ratios = lru_cache(np.geomspace)  # which the cases of a study share


def study_pitches_um(study: Study, technology: str) -> Array:
    """Return the pitches of a technology in µm, (P,). A range ends where the stack allows no microlens (`largest_lens_um`).

    Raises PixsimError if there are too few, the range is empty, or the stack allows no microlens on the largest of given pitches.
    """
    largest_um = largest_lens_um(study, technology)
    if study.pitch.values_um is not None:
        pitches = np.unique(study.pitch.values_um)
        if pitches.size < 5:
            raise invalid("pitch.values_um", pitches.tolist(), "at least 5 different pitches")
        if pitches.max() > largest_um:
            expected = f"at most {largest_um:g} µm, √π times the height of the stack of {technology}"
            hint = "Leave out larger ones, raise pixel.stack.height_um, or take pixel.stack.microlens = 'none'."
            raise invalid("pitch.values_um", f"pixels up to {pitches.max():g} µm under microlenses", expected, hint)
        return pitches
    (low, high), source = study.open_range_um, "pitch.min_um"
    if low is None:
        process = with_fill_factor_law(technology_of(study, technology), study.options_of(technology).fill_factor_law)
        if process.name == NO_TECHNOLOGY:
            got, expected = f"no value, with {technology} beside other technologies", "a smallest pixel size, or pitch.values_um"
            raise invalid("pitch.min_um", got, expected, "A data sheet has no fill factors, from which it would follow.")
        low = pitch_for_fill_factor_um(study.pitch.min_fill_factor, process)
        source = f"where {technology} has a fill factor of {study.pitch.min_fill_factor:g}"
    if low >= largest_um:
        hint = "Raise pixel.stack.height_um, or take pixel.stack.microlens = 'none'."
        raise invalid(
            "pitch",
            f"sizes from {low:.4g} µm, {source}",
            f"below {largest_um:g} µm, √π times the height of the stack of {technology}",
            hint,
        )
    high = min(high, largest_um)
    if low >= high:
        raise invalid("pitch.max_um", high, f"above {low:.4g} µm, {source}")
    return _equal_ratios(low, high, study.pitch.count).round(4)  # a new array


def largest_lens_um(study: Study, technology: str) -> float:
    """Return the widest pixel on which a technology's stack allows a microlens, rounded down; infinity without microlenses."""
    largest_um = largest_pitch_um(study.options_of(technology), technology_of(study, technology))
    return largest_um if math.isinf(largest_um) else math.floor(1e4 * largest_um) / 1e4


def cutoff_pitch_um(camera: Camera) -> float:
    """Return the pitch whose Nyquist frequency is the cut-off of a lens at `CUTOFF_NM`, λ/(4 sin α)."""
    return 1e3 / (2 * float(cutoff_cy_per_mm(CUTOFF_NM, camera.effective_f_number)))


def largest_pixel_um(study: Study, technology: str) -> float:
    """Return the largest pixel of a study's range in a technology: `pitch.max_um`, or the widest with a microlens."""
    return min(study.pitch.max_um, largest_lens_um(study, technology))


def imaging_of(study: Study, camera: Camera, technology: str, pitch_um: float) -> Imaging:
    """Return what lies between the light and the score of a pixel of a study, without axes.

    camera : of the window
    """
    return Imaging(
        camera,
        pixel_of(study, technology, pitch_um),
        technology_of(study, technology),
        study.exposure,
        study.display,
        correction=study.correction,
        develop=study.develop,
        motion=study.motion,
        border_um=border_on_um(study, camera),
    )


def border_on_um(study: Study, camera: Camera) -> float:
    """Return the width on each side of a camera's die that a study does not score: that of its pixels, and room for what moves.

    Raises PixsimError if nothing would be left.
    """
    if not study.motion.is_on:
        return study.border_um
    pixels = [
        (float(um), study.options_of(name).bin_side)
        for name in study.technologies
        for um in (*study_pitches_um(study, name)[[0, -1]], study.pitch.largest_um)
    ]
    return border_with_room_um(study.border_um, study.motion, study.exposure, camera, pixels)


def first_sampling(study: Study) -> Sampling:
    """Return the sampling that a study starts with: `repeats` sensors of each of its pitches."""
    return {name: dict.fromkeys(study_pitches_um(study, name).tolist(), study.repeats) for name in study.technologies}
