"""Gain, time and subexposures of a frame, and how the light changes meanwhile."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from pixsim.base.problems import Words
from pixsim.base.records import Record
from pixsim.light.quantities import Fraction
from pixsim.sensor.quantities import GainDb, Seconds

MAX_FRAMES = 1024
_GAIN_WORDS = Words(
    also=("gain", "iso"),
    instead={
        "gain": "gain_db is 20 log10 of a gain: 12.04 for 4.",
        "iso": "gain_db is 20 log10 of ISO over the sensor's base ISO: 18.06 for 800 over 100.",
    },
)
_FRAMES_WORDS = Words(
    also=("hdr",),
    instead={
        "hdr": "frames sums equal subexposures; pixel.readout.kind = 'staggered' has several."
    },
)


class Exposure(Record):
    """Gain and time: the time is manual if `integration_s` is given, else such that the brightest
    pixel reaches `well_target` of saturation. A gain of "auto" is 0 dB until light meters it.

    A burst is one frame: the sum of `frames` subexposures, each with its own noise, well and codes.
    They share the time of the frame, or each has all of it.
    """

    integration_s: Seconds | None = Field(
        None, description="exposure time (absent: automatic exposure)"
    )
    max_integration_s: Seconds = Field(
        0.1, description="longest exposure time of the automatic exposure"
    )
    well_target: Fraction = Field(
        0.95,
        description=(
            "automatic exposure: mean signal of the brightest pixel, as a fraction of saturation"
            " (the lower of the full well and the range of the ADC at gain_db)"
        ),
    )
    gain_db: Annotated[GainDb | Literal["auto"], _GAIN_WORDS] = Field(
        0.0,
        description=(
            "amplification before the ADC; at 0 dB the codes above the black level span the full"
            " well, unless [pixel] states gain_e_per_dn, dn_per_e or adc_full_scale_e. auto raises"
            " it, up to max_gain_db, if the exposure time alone cannot bring the brightest pixel"
            " to well_target"
        ),
    )
    max_gain_db: GainDb = Field(24.0, description="largest gain of gain_db = 'auto'")
    frames: Annotated[int, Field(ge=1, le=MAX_FRAMES), _FRAMES_WORDS] = Field(
        1,
        description=(
            "subexposures that are summed in one frame; each saturates, is read out and is rounded"
            " separately"
        ),
    )
    frame_time: Literal["shared", "each"] = Field(
        "shared",
        description=(
            "whether integration_s and max_integration_s are the time of all subexposures of a"
            " frame together, or of each"
        ),
    )
    shutter: Literal["global", "rolling"] = Field(
        "global",
        description=(
            "whether all rows are exposed together, or each begins line_time_us after the one"
            " above it"
        ),
    )
    line_time_us: Annotated[float, Field(ge=1e-6, le=1e9)] | None = Field(
        None, description="time from row to row of a rolling shutter"
    )

    flicker_hz: Annotated[float, Field(ge=1e-6, le=1e9)] | None = Field(
        None,
        description=(
            "frequency at which the light flickers, twice that of the mains (absent: steady light)"
        ),
    )
    flicker_depth: Annotated[float, Field(ge=0, le=1)] | None = Field(
        None, description="modulation of light that flickers, as a sine: (max - min)/(max + min)"
    )
    flicker_phase_deg: Annotated[float, Field(ge=0, le=360)] | None = Field(
        None,
        description=(
            "phase of the flicker at mid exposure of the middle row, 0 where it is brightest "
            "(absent: drawn for each frame)"
        ),
    )

    @model_validator(mode="after")
    def _rolling_shutter_has_a_line_time(self) -> Self:
        if self.shutter == "rolling" and self.line_time_us is None:
            raise ValueError(
                "got shutter = 'rolling' without line_time_us; allowed: with the time from row to"
                " row, as 10.0"
            )
        return self

    @model_validator(mode="after")
    def _flicker_has_a_depth(self) -> Self:
        if self.flicker_hz is not None and self.flicker_depth is None:
            raise ValueError(
                "got flicker_hz without flicker_depth; allowed: with the modulation of the lamp,"
                " from 0 to 1, as 0.4"
            )
        return self

    @property
    def least_gain_db(self) -> float:
        """The gain, before light meters it."""
        return 0.0 if self.gain_db == "auto" else self.gain_db

    @property
    def is_manual(self) -> bool:
        """Whether neither time nor gain depends on the light."""
        return self.integration_s is not None and self.gain_db != "auto"

    @property
    def flickers(self) -> bool:
        """Whether the light changes in the time of a frame."""
        return self.flicker_hz is not None and bool(self.flicker_depth)

    @property
    def steady(self) -> Exposure:
        """The same exposure in the mean light of a lamp that flickers."""
        if not self.flickers:
            return self
        return self.model_copy(update={"flicker_hz": None, "flicker_depth": None})

    @property
    def line_time_s(self) -> float:
        """Time from row to row, 0 of a global shutter."""
        if self.shutter != "rolling" or self.line_time_us is None:
            return 0.0
        return 1e-6 * self.line_time_us

    @property
    def times(self) -> int:
        """Number of stated times that a frame takes: 1, unless each subexposure has the time."""
        return self.frames if self.frame_time == "each" else 1
