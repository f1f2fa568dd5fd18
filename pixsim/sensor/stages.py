"""Signal stages: what lies between the light on a sensor and its frame and may be left out. A stage that is off does nothing.

To add one: write its `Stage` beside its physics, and name it in `STAGES`, in the order of the flow. `act` returns the
like of what it takes: the very same object where the stage is off, so that off costs nothing and leaves all numbers equal to the
bit. Its settings are fields of the records of their rooms (`[lens]`, `[exposure]`), from which template, help, schema and
keys follow; `words` are what headlines and notes say of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from pixsim.base.arrays import Array
from pixsim.optics.lens_options import LensOptions
from pixsim.optics.veil import veil_of
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.flicker import flickering
from pixsim.sensor.motion import STANDING, Moving
from pixsim.sensor.motion_options import VELOCITIES, motion_words

# What a stage acts on, and what `act` takes beside it: the irradiance before the lens's blur, with the camera, of which it returns
# what strays (`Veil`); how the light moves over the pixels (`Moving`), with its velocity, the time of the frame and the exposure;
# the light of each row over its mean (`flickering`), with the time of the frame, the number of rows, the exposure and a generator;
# how a pixel is read, with the exposure.
Acts = Literal["irradiance", "light", "rows", "frame"]


@dataclass(frozen=True)
class Stage:
    """One stage.

    name : as messages have it
    acts_on : as of `Acts`
    settings : dotted names of those that shape it
    act : takes what it acts on, and returns the like
    words : what a headline says of the record of its settings; empty where the stage is off
    """

    name: str
    acts_on: Acts
    settings: tuple[str, ...]
    act: Callable[..., Any]
    words: Callable[..., str]

    @property
    def table(self) -> str:
        """The table of its settings, of a `Setting` or a record like it."""
        return self.settings[0].split(".")[0]


def veil_words(lens: LensOptions) -> str:
    """Return how much light strays, in words; empty if none is stated."""
    share = lens.veiling_glare
    if not share:
        return ""
    return f"veiling glare {100 * share:.3g} %" if isinstance(share, float) else "veiling glare by wavelength"


def flicker_words(exposure: Exposure) -> str:
    """Return how the light flickers, in words; empty if it is steady."""
    depth = exposure.flicker_depth or 0.0
    return f"light flickers at {exposure.flicker_hz:g} Hz by {100 * depth:.3g} %" if exposure.flickers else ""


def burst_words(exposure: Exposure) -> str:
    """Return what a frame is the sum of, in words; empty for one exposure."""
    return f"each frame the sum of {exposure.frames} exposures" if exposure.frames > 1 else ""


MERGING = Stage(
    name="merging of exposures",
    acts_on="frame",
    settings=("exposure.frames", "exposure.frame_time"),
    act=lambda readout, exposure: readout.burst(exposure.frames),
    words=burst_words,
)

MOTION = Stage(
    name="motion",
    acts_on="light",
    settings=tuple(f"motion.{name}" for name in (*VELOCITIES, "distance_m", "margin_um")),
    act=lambda moving, um_per_s, time_s, exposure: replace(moving, path_um=(um_per_s[1] * time_s, um_per_s[0] * time_s)),
    words=motion_words,
)


def _read_by_rows(moving: Moving, um_per_s: tuple[float, float], time_s: float, exposure: Exposure) -> Moving:
    line_s = exposure.line_time_s
    return replace(moving, row_um=(um_per_s[1] * line_s, um_per_s[0] * line_s)) if line_s else moving


SHUTTER = Stage(
    name="rolling shutter",
    acts_on="light",
    settings=("exposure.shutter", "exposure.line_time_us"),
    act=_read_by_rows,
    words=lambda exposure: f"rolling shutter, {exposure.line_time_us:g} µs a row" if exposure.line_time_s else "",
)

FLICKER = Stage(
    name="flicker",
    acts_on="rows",
    settings=("exposure.flicker_hz", "exposure.flicker_depth", "exposure.flicker_phase_deg"),
    act=flickering,
    words=flicker_words,
)

VEIL = Stage(
    name="veiling glare",
    acts_on="irradiance",
    settings=("lens.veiling_glare", "lens.veiling_glare_outside"),
    act=veil_of,
    words=veil_words,
)

STAGES = {"veil": VEIL, "motion": MOTION, "shutter": SHUTTER, "flicker": FLICKER, "merging": MERGING}


def moving_in(um_per_s: tuple[float, float], time_s: float, exposure: Exposure) -> Moving:
    """Return how light of a velocity [x, y] on the sensor moves in the time of a frame."""
    moving = STANDING
    for stage in acting_on("light"):
        moving = stage.act(moving, um_per_s, time_s, exposure)
    return moving


def gains_of_rows(time_s: float, rows: int, exposure: Exposure, rng: np.random.Generator) -> tuple[Array, ...]:
    """Return the light of each row, (rows,), in each exposure of a frame over its mean; none where all have the mean."""
    gains: tuple[Array, ...] = ()
    for stage in acting_on("rows"):
        gains = stage.act(gains, time_s, rows, exposure, rng)
    return gains


def acting_on(what: Acts) -> list[Stage]:
    """Return the stages that act on something, in the order of the flow."""
    return [stage for stage in STAGES.values() if stage.acts_on == what]


def stage_words(settings: object) -> list[str]:
    """Return what headlines say of the stages of a setting of a frame that are on."""
    return [words for stage in STAGES.values() if (words := stage.words(getattr(settings, stage.table)))]
