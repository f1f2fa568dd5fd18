"""Many sensors in one light: the frames are those of `pixsim.evaluate`, computed as the evaluations of a study are."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from pixsim.base.arguments import Count, Jobs, Whole, checks_arguments
from pixsim.base.errors import invalid, name_fault
from pixsim.base.notes import collected_notes, warn
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.sensor.correction_options import NO_CORRECTION, Correction
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.infrared import light_notes
from pixsim.sensor.integration import array_size_um
from pixsim.sensor.motion_options import STILL, Motion
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.technology import load_technology
from pixsim.sensor.unit_slips import unit_slips
from pixsim.show.document import Document, Table
from pixsim.show.pages import dataframe_of, rows_csv
from pixsim.show.render import notebook
from pixsim.studies.cases import named
from pixsim.studies.engine import workers_here
from pixsim.studies.evaluations import check_ideals, rows_of
from pixsim.studies.result import causes_of_rows
from pixsim.studies.series import Series
from pixsim.viewer.develop_options import DEVELOP, Develop, check_develop
from pixsim.viewer.display import dot_edges_um, picture_size_um
from pixsim.viewer.display_options import Display
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.metric_options import METRIC_OPTIONS, MetricOptions
from pixsim.viewer.metric_registry import metrics_named
from pixsim.viewer.metrics import PIXEL_STATISTICS, Metric, MetricContext, MetricRequest, columns_of_metrics, columns_with_numbers
from pixsim.viewer.review import background_notes, camera_notes
from pixsim.viewer.scene_light import SceneCache, SceneLight
from pixsim.viewer.score import Score
from pixsim.viewer.screen import warn_of_clipping, white_header, with_white
from pixsim.viewer.without_effect import GivenSettings, warn_of_settings_without_effect

if TYPE_CHECKING:
    from pandas import DataFrame

PIXEL = "pixel"


@dataclass(frozen=True, repr=False)
class SensorTable(Sequence[dict[str, Any]]):
    """The rows of `pixsim.sweep`, one for each pixel and repeat.

    rows : {"pixel": its place or name, "technology": …, "pitch_um": …, "repeat": …, and the numbers of the pixel, of its frame
        and of each metric}
    metrics : in the order of their columns
    """

    rows: tuple[dict[str, Any], ...]
    metrics: tuple[Metric, ...]

    @overload
    def __getitem__(self, index: int) -> dict[str, Any]: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[dict[str, Any]]: ...
    def __getitem__(self, index: int | slice) -> dict[str, Any] | Sequence[dict[str, Any]]:
        return self.rows[index]

    def __len__(self) -> int:
        return len(self.rows)

    @checks_arguments
    def to_csv(self, path: str | os.PathLike[str] | None = None) -> str:
        """Return the rows as CSV, and write it to `path` if given."""
        return rows_csv(self.rows, path)

    def to_dataframe(self) -> DataFrame:
        """Return the rows as a pandas.DataFrame. Raises PixsimError without pandas."""
        return dataframe_of(self.rows)

    def _repr_html_(self) -> str:
        repeats = self.rows[-1]["repeat"] + 1
        names = [metric.columns[0] for metric in self.metrics]
        lines = []
        for first in range(0, len(self), repeats):
            row, own = self.rows[first], self.rows[first : first + repeats]
            means = [f"{np.mean([each[name] for each in own]):.6g}".replace("nan", "–") for name in names]
            lines.append((str(row[PIXEL]), row["technology"], f"{row['pitch_um']:g}", *means))
        head = PIXEL, "technology", "size (µm)", *(metric.label for metric in self.metrics)
        caption = f"{len(lines)} pixels, " + (f"means over {repeats} sensors of each" if repeats > 1 else "a sensor of each")
        return notebook(Document("", "", "", {}, cell=(Table(caption, head, tuple(lines), caption, words=(1,)),)))

    def __repr__(self) -> str:
        return f"<SensorTable of {len(self)} rows: {', '.join(metric.name for metric in self.metrics)}>"


@checks_arguments
def sweep(
    light: SpectralImage,
    pixels: Mapping[str, Pixel] | Sequence[Pixel],
    *,
    camera: Camera,
    exposure: Exposure | None = None,
    display: Display | None = None,
    correction: Correction | None = None,
    motion: Motion | None = None,
    develop: Develop | None = None,
    metrics: Sequence[str | Callable[[Score], float]] = ("delta_e",),
    metric: MetricOptions | None = None,
    without: SpectralImage | None = None,
    repeats: Count = 1,
    seed: Whole = 0,
    jobs: Jobs | None = None,
) -> SensorTable:
    """Evaluate many sensors in one light, rendered or of another program.

    The frames are those of `pixsim.evaluate`, and of `pixsim run --repeats`, with the same seed, bit for bit; equal sensors have
    equal frames. All are shown with one white, and scored on the same dots: the border of the largest pixels is left out. So
    pixels of one size have the numbers of `evaluate`, and smaller ones among larger ones those of fewer dots.

    pixels : of each sensor; a list, or names -> pixels
    camera, exposure, display, correction, develop, motion, metric, without : as of `pixsim.evaluate`
    metrics : names of metrics, or functions of a Score that return a number; each has its columns. One that has no number for a
        frame, as NIIRS for one that is overexposed, is NaN, with a warning that says why
    repeats : sensors of each kind
    seed : of the fixed patterns and the temporal noise
    jobs : processes; None means one per core, where they are worth it. The results do not depend on it

    Raises PixsimError as `evaluate` does, with the pixel's name or its place in the list, from 0.

    >>> light = SpectralImage([550.0], 10.0, 84.8, data=np.full((32, 32, 1), 1e-3), header={"diffraction": False})
    >>> pixels = [Pixel(pitch_um=pitch_um, prnu=0) for pitch_um in (60.0, 84.8)]
    >>> table = sweep(light, pixels, camera=Camera(), display=Display(white_cd_per_m2=1000, dots=32), jobs=1)
    >>> [(row["pixel"], row["pitch_um"]) for row in table], table[0]["mean_delta_e"] < 1
    ([(0, 60.0), (1, 84.8)], True)
    """
    by_name: Mapping[Any, Pixel] = pixels if isinstance(pixels, Mapping) else dict(enumerate(pixels))
    if not by_name:
        raise invalid("pixels", "none", "at least one Pixel")
    for name in by_name:
        if not isinstance(name, int) and (fault := "is empty" if not name else name_fault(name)):
            raise invalid("pixels", f"a name that {fault}: {name!r:.80}", "names for a column of a table")
    request = MetricRequest(metrics_named(metrics), metric or METRIC_OPTIONS)
    asked: dict[Any, Imaging] = {}
    for name, pixel in by_name.items():
        with named(f"pixel {name}"):
            asked[name] = Imaging(
                camera,
                pixel,
                load_technology(pixel.technology),
                exposure or Exposure(),
                display or Display(),
                correction=correction or NO_CORRECTION,
                develop=develop or DEVELOP,
                motion=motion or STILL,
                metrics=request,
                is_run=True,
            )
    with collected_notes():
        for note in (*background_notes(request.names, without), *camera_notes(camera, light)):
            warn(note)
        for name, imaging in asked.items():
            with named(f"pixel {name}"):
                check_pixel(imaging, light, has_background=without is not None)
            for note in unit_slips(imaging.pixel):
                warn(f"pixel {name}: {note}")
            for note in light_notes(imaging.physics, camera, light):
                warn(note)
        warn_of_settings_without_effect({"": (GivenSettings.of_records(imaging, light) for imaging in asked.values())})

        # All are scored on the dots that the largest pixels leave, with one white.
        border_um = max(imaging.scored_border_um for imaging in asked.values())
        scored = {name: imaging.changed(border_um=border_um) for name, imaging in asked.items()}
        white = white_header([(imaging, light) for imaging in scored.values()])
        scored = {name: imaging.changed(display=with_white(imaging.display, white)) for name, imaging in scored.items()}
        first, *_ = scored.values()
        channels = max(len(imaging.physics.channels) for imaging in scored.values())
        scenes = SceneCache(first, SceneLight(light.identified, without), channels)
        series = [
            Series(
                imaging.physics.technology.name,
                imaging,
                scenes,
                ("evaluate", seed),
                False,
                {PIXEL: str(name)},
                f"pixel {name}",
                stored=False,
            )
            for name, imaging in scored.items()
        ]
        check_ideals(series)
        found = rows_of(series, repeats, None, None if jobs is None else workers_here(jobs), tell=warn)
        facts = {one.light_id: scenes.ideal_facts(one.light_key, one.imaging) for one in series}
        for one, of_pixel in zip(series, found, strict=True):
            for cause in causes_of_rows(light, one.imaging, facts[one.light_id].lightness, of_pixel):
                if cause.leaves_nothing:
                    warn(f"{one.words}: {cause}")
        warn_of_clipping(max(each.beyond_white for each in facts.values()), light.header, first.display)
    every = {name: np.array([float(row[name]) for rows in found for row in rows]) for name in columns_of_metrics(request.chosen)}
    numbers = *PIXEL_STATISTICS, *columns_with_numbers(request.chosen, every)
    rows = [
        {PIXEL: name, "technology": row["technology"], "pitch_um": float(row["pitch_um"]), "repeat": int(row["repeat"])}
        | {column: float(row[column]) for column in numbers}
        for name, of_pixel in zip(asked, found, strict=True)
        for row in of_pixel
    ]
    return SensorTable(tuple(rows), request.chosen)


def check_pixel(imaging: Imaging, light: SpectralImage, *, has_background: bool) -> None:
    """Raise PixsimError for a pixel that a metric, its development or the dots of the display do not allow.

    has_background : whether there is light of the scene without its target
    """
    imaging.metrics.check(MetricContext(imaging.pixel.colour is not None, has_background))
    check_develop(imaging.develop, imaging.pixel)
    read = imaging.physics.as_read
    dot_edges_um(
        picture_size_um(light),
        read.read_pitch_um,
        imaging.display,
        imaging.scored_border_um,
        array_size_um(light, imaging.camera),
        read.registration,
    )
