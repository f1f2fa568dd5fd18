"""The record of a score: a picture as shown to a viewer, and its difference from the ideal one."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from pixsim.base.arguments import Bounds, NotNegative, checks_arguments, checks_fields
from pixsim.base.arrays import Array
from pixsim.base.errors import invalid
from pixsim.sensor.pixel import PixelPhysics
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import Frame
from pixsim.show.document import pairs
from pixsim.show.figures import new_figure, own_style
from pixsim.show.pages import rows_csv
from pixsim.show.pictures import VIEWING_GAMMA, scale_end
from pixsim.show.render import cell_of
from pixsim.show.sentences import sentence, settings_line
from pixsim.viewer.delta_e_statistics import COLUMNS, delta_e_statistics, percentiles
from pixsim.viewer.display_options import Display
from pixsim.viewer.light_error import NOTHING_KNOWN, LightError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FloatOrNaN = Annotated[float, Bounds(unknown=True)]
PANEL_IN = 3.1  # width of each picture of a figure


@checks_fields
@dataclass(frozen=True)
class Score:
    """A picture as shown to a viewer, and its difference from the ideal one, by S-CIELAB and by further metrics.

    delta_e : (H, W) S-CIELAB difference on the display's dots, in the precision in which it was computed
    ideal, image : (H, W) shown luminance, 1 for white; in colour (H, W, 3), the light of the display's primaries
    display : that shows them
    metrics : numbers of the metrics that were asked for, each by its first column: {"delta_e": mean ΔE, …}; NaN of one that has
        none for this frame
    further : their other numbers, by columns
    """

    delta_e: Array = field(repr=False)
    ideal: Array = field(repr=False)
    image: Array = field(repr=False)
    display: Display = field(repr=False)
    metrics: dict[str, FloatOrNaN] = field(default_factory=dict, kw_only=True)
    further: dict[str, FloatOrNaN] = field(default_factory=dict, kw_only=True, repr=False)
    _scored: dict[str, Any] | None = field(default=None, kw_only=True, repr=False, compare=False)

    def __post_init__(self) -> None:
        pictures: dict[str, Any] = {"delta_e": self.delta_e, "ideal": self.ideal, "image": self.image, "display": self.display}
        for name, scored in (self._scored or {}).items():
            if pictures[name] is not scored and not np.array_equal(pictures[name], scored):  # equal after a journey to a worker
                got = f"another {name} in a Score, whose numbers would be those of the old one"
                hint = "Score other pictures: pixsim.score_pictures(score.ideal, image, score.display)."
                raise invalid(name, got, f"the {name} that was scored", hint)
        object.__setattr__(self, "_scored", pictures)

    @property
    def mean_delta_e(self) -> float:
        """Mean ΔE over all dots, which a study minimises."""
        return float(self.delta_e.mean(dtype=float))

    def statistics(self) -> dict[str, float]:
        """Return the numbers of a row, with the unit in each name."""
        return dict(zip(COLUMNS, delta_e_statistics(self.delta_e), strict=True)) | self.further

    @own_style()
    def plot(self) -> Figure:
        """Return a Matplotlib figure of the ideal image, the sensor's image and the ΔE map with its scale."""
        figure = new_figure(3 * PANEL_IN + 0.6, PANEL_IN + 0.3)
        axes = figure.subplots(1, 3, sharex=True, sharey=True)
        for panel, picture, title in zip(axes, (self.ideal, self.image), ("ideal", "sensor"), strict=False):
            panel.imshow(np.clip(picture, 0, 1) ** (1 / VIEWING_GAMMA), cmap="gray", vmin=0, vmax=1, interpolation="nearest")
            panel.set_title(title)
        end = scale_end(*percentiles(self.delta_e, (99,)))
        delta_e_map = axes[2].imshow(self.delta_e, cmap="viridis", vmin=0, vmax=end, interpolation="nearest")
        axes[2].set_title(f"S-CIELAB ΔE, mean {self.mean_delta_e:.3f}")
        figure.colorbar(delta_e_map, ax=axes[2], label="ΔE", extend="max", shrink=0.85)
        for panel in axes:
            panel.set_xlabel("display dots")
        return figure

    @checks_arguments
    def to_csv(self, path: str | os.PathLike[str] | None = None) -> str:
        """Return `statistics` as CSV, and write it to `path` if given."""
        return rows_csv([self.statistics()], path)

    def _repr_html_(self) -> str:
        return cell_of(f"mean ΔE {self.mean_delta_e:.3f}", self.plot(), pairs("statistics", self.statistics(), ".6g"))

    def __repr__(self) -> str:
        return f"<Score mean ΔE {self.mean_delta_e:.4f}, {' × '.join(map(str, self.delta_e.shape))} dots>"


@checks_fields
@dataclass(frozen=True)
class FrameScore(Score):
    """The score of a sensor's frame.

    frame : the sensor frame that the image shows
    readout : how the pixels are read
    border_um : (above and below, left and right) width of the border that is neither shown nor scored
    out_of_gamut : share of the dots of the ideal image and of the image whose colour the display cannot show; None for grey ones
    light : what is known of the errors of its light
    """

    frame: Frame = field(repr=False, kw_only=True)
    readout: Readout = field(repr=False, kw_only=True)
    border_um: tuple[NotNegative, NotNegative] = field(default=(0.0, 0.0), kw_only=True)
    out_of_gamut: tuple[float, float] | None = field(default=None, kw_only=True)
    light: LightError = field(default=NOTHING_KNOWN, repr=False, kw_only=True)

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

    def _repr_html_(self) -> str:
        title = f"{self.physics.pitch_um:g} µm pixels, mean ΔE {self.light.shown(self.mean_delta_e)}"
        given = self.physics.pixel.model_dump(exclude_unset=True, exclude_none=True)
        notes = [
            "One frame of one sensor: how much others differ is told by pixsim.study, whose means have 95 % intervals.",
            f"Pixel: {settings_line(given)}; all else is the default.",
            *(sentence(str(cause)) for cause in self.light.causes),
            *(f"Not converged: {reason}." for _, reason in self.light.errors),
            *([f"Light: {missing}; pixsim run and pixsim.study measure both."] if (missing := self.light.unmeasured) else []),
        ]
        return cell_of(title, self.plot(), pairs("statistics", self.statistics(), ".6g"), *notes)

    def __repr__(self) -> str:
        words = [f"{self.physics.pitch_um:g} µm pixels, {1e3 * self.frame.integration_s:.3g} ms", self.light.unmeasured]
        return f"<Score mean ΔE {self.light.shown(self.mean_delta_e)}, {'; '.join(filter(None, words))}>"


def frame_statistics(readout: Readout, frame: Frame) -> dict[str, float]:
    """Return the numbers of a row that no metric gives: of the pixel and of the frame."""
    return {
        "pitch_um": readout.physics.pitch_um,
        "fill_factor": readout.physics.fill_factor,
        "full_well_e": readout.full_well_e,
        "integration_s": frame.integration_s,
        "saturated_fraction": frame.saturated_fraction,
        "mean_electrons_e": float(frame.mean_e.mean()),
    }
