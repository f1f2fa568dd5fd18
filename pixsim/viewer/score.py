"""The record of a score: a picture as shown to a viewer, and its difference from the ideal one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Annotated, Any

from pixsim.base.arrays import Array
from pixsim.base.bounds import Bounds, NotNegative
from pixsim.base.digits import estimate, exposure_time
from pixsim.base.notes import Note
from pixsim.base.result import Result
from pixsim.sensor.pixel import PixelPhysics
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import Frame
from pixsim.viewer.delta_e_statistics import COLUMNS, delta_e_statistics
from pixsim.viewer.display_options import Display

_FloatOrNaN = Annotated[float, Bounds(unknown=True)]
NOTHING = "the frame contains no information"


@dataclass(frozen=True)
class Cause:
    """A cause of a mean ΔE.

    words : for the headline
    delta_e : how much of ΔE it can make, which decides on the order of causes
    hint : what removes it
    """

    words: str
    delta_e: float
    hint: str

    def __str__(self) -> str:
        return str(self.note)

    @property
    def note(self) -> Note:
        """The note of the cause."""
        return Note("cause", words=self.words, hint=self.hint)

    @property
    def is_uninformative(self) -> bool:
        """Whether the frame contains no information about the light."""
        return self.words.startswith(NOTHING)

    def as_dict(self) -> dict[str, Any]:
        """Return the cause as in score.json."""
        return asdict(self)


@dataclass(frozen=True)
class LightError:
    """Errors of a mean ΔE by the light behind it; or their limits.

    film_delta_e : by the film; NaN if it is unknown, None if it was not measured, or has no limit
    noise_delta_e : by the noise of the render; likewise
    """

    film_delta_e: float | None = None
    noise_delta_e: float | None = None


NOT_MEASURED = LightError()


@dataclass(frozen=True)
class Score(Result):
    """A picture as shown to a viewer, and its difference from the ideal one, by S-CIELAB and by
    further metrics.

    delta_e : (H, W) S-CIELAB difference on the display's dots, in the precision in which it was
        computed
    ideal, image : (H, W) shown luminance, 1 for white; in colour (H, W, 3), the light of the
        display's primaries
    display : that shows them
    metrics : numbers of the metrics that were asked for, each by its first column: {"delta_e": mean
        ΔE, …}; NaN of one that has none for this frame
    further : their other numbers, by columns
    """

    delta_e: Array = field(repr=False)
    ideal: Array = field(repr=False)
    image: Array = field(repr=False)
    display: Display = field(repr=False)
    metrics: dict[str, _FloatOrNaN] = field(default_factory=dict, kw_only=True)
    further: dict[str, _FloatOrNaN] = field(default_factory=dict, kw_only=True, repr=False)

    @property
    def mean_delta_e(self) -> float:
        """Mean ΔE over all dots, which a study minimises."""
        return float(self.delta_e.mean(dtype=float))

    def statistics(self) -> dict[str, float]:
        """Return the numbers of a row, with the unit in each name."""
        return dict(zip(COLUMNS, delta_e_statistics(self.delta_e), strict=True)) | self.further

    def __repr__(self) -> str:
        return (
            f"<Score mean ΔE {estimate(self.mean_delta_e)},"
            f" {' × '.join(map(str, self.delta_e.shape))} dots>"
        )


@dataclass(frozen=True)
class FrameScore(Score):
    """The score of a sensor's frame.

    frame : the sensor frame that the image shows
    readout : how the pixels are read
    border_um : (above and below, left and right) width of the border that is neither shown nor
        scored
    out_of_gamut : share of the dots of the ideal image and of the image whose colour the display
        cannot show, or None for grey ones
    light, light_limit : errors of its light, and their tolerances
    causes : of its mean ΔE beside the sensor's noise and blur, the largest first
    """

    frame: Frame = field(repr=False, kw_only=True)
    readout: Readout = field(repr=False, kw_only=True)
    border_um: tuple[NotNegative, NotNegative] = field(default=(0.0, 0.0), kw_only=True)
    out_of_gamut: tuple[float, float] | None = field(default=None, kw_only=True)
    light: LightError = field(default=NOT_MEASURED, repr=False, kw_only=True)
    light_limit: LightError = field(default=NOT_MEASURED, repr=False, kw_only=True)
    causes: tuple[Cause, ...] = field(default=(), repr=False, kw_only=True)

    @property
    def physics(self) -> PixelPhysics:
        """Physical properties of the pixel."""
        return self.readout.physics

    @property
    def gamut(self) -> dict[str, float]:
        """Shares of dots out of the display's gamut, as in score.json; empty for grey pictures."""
        names = "ideal_out_of_gamut_fraction", "out_of_gamut_fraction"
        return {} if self.out_of_gamut is None else dict(zip(names, self.out_of_gamut, strict=True))

    def statistics(self) -> dict[str, float]:
        """Return the numbers of score.json, with the unit in each name."""
        return frame_statistics(self.readout, self.frame) | super().statistics() | self.gamut

    def __repr__(self) -> str:
        cause = f" ({self.causes[0].words})" if self.causes else ""
        doubt = "" if converged(self.light, self.light_limit) else ", not converged"
        mean = f"mean ΔE {estimate(self.mean_delta_e)}{cause}{doubt}"
        return (
            f"<Score {mean}, {self.physics.pitch_um:g} µm pixels,"
            f" {exposure_time(self.frame.integration_s)}>"
        )


def frame_statistics(readout: Readout, frame: Frame) -> dict[str, float]:
    """Return the numbers of a row that no metric gives: of the pixel and of the frame.

    `share_of_full_well` is the mean charge of the brightest pixel, light and dark, over the full
    well, or over what fills the last of several readings; above 1 it is more than the pixel holds.
    """
    brightest_e = float(frame.mean_e.max()) + frame.mean_dark_e
    full_e = frame.exposures * readout.full_well_e
    if readout.readings:
        full_e = readout.burst(frame.exposures).saturation_e
    return {
        "pitch_um": readout.physics.pitch_um,
        "fill_factor": readout.physics.fill_factor,
        "full_well_e": readout.full_well_e,
        "integration_s": frame.integration_s,
        "saturated_fraction": frame.saturated_fraction,
        "share_of_full_well": brightest_e / full_e,
        "mean_electrons_e": float(frame.mean_e.mean()),
    }


# --- the errors of its light


def noise_error_and_limit(
    header: Mapping[str, Any], *, is_corrected: bool = False
) -> tuple[LightError, LightError]:
    """Return the error of a mean ΔE by the noise of a render, and the largest tolerated error.

    header : of an irradiance; a file of another program may hold anything in it, and then nothing
        is known
    is_corrected : whether the bias by the noise is taken off the mean ΔE
    """
    stated = header.get("render_noise")
    noise = stated if isinstance(stated, Mapping) else {}
    delta_e, tolerance = (
        value if isinstance(value, float | int) else None
        for value in (noise.get(name) for name in ("delta_e", "tolerance_delta_e"))
    )
    if delta_e is None:
        return NOT_MEASURED, NOT_MEASURED
    biases = noise.get("bias")
    if isinstance(biases, Mapping) and not is_corrected:
        bias = biases.get("mean_delta_e", 0.0)
        delta_e += abs(bias) if isinstance(bias, float | int) else 0.0
    return LightError(noise_delta_e=delta_e), LightError(noise_delta_e=tolerance)


def converged(error: LightError, limit: LightError) -> bool:
    """Return whether no error is above its limit. An unknown error is above any; one not measured,
    or without a limit, is not.

    >>> limit = LightError(film_delta_e=0.02)
    >>> errors = [LightError(film_delta_e=delta_e) for delta_e in (0.01, 0.6, math.nan, None)]
    >>> [converged(error, limit) for error in errors]
    [True, False, False, True]
    """
    return not exceeded(error, limit)


def exceeded(error: LightError, limit: LightError) -> dict[str, float]:
    """Return the errors above their limits by the names of their fields, the largest first; an
    unknown one is infinite.
    """
    above: dict[str, float] = {}
    for name, delta_e in asdict(error).items():
        limit_delta_e = getattr(limit, name)
        if delta_e is not None and limit_delta_e is not None and not delta_e <= limit_delta_e:
            above[name] = math.inf if math.isnan(delta_e) else delta_e
    return dict(sorted(above.items(), key=lambda pair: -pair[1]))
