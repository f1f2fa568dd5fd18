"""What a command decides before its first render: display and chart for a data sheet's sensor,
pixel sizes, cases.

A sensor given by its data sheet has no display or chart that belongs to it, as the process of Chen
et al. (2000) has. Where nobody sets them, its display has a dot for each column of pixels, up to
2048, and the CSF chart ends at the highest frequency that the sensor, the lens and the display can
show. Both are chosen once a command, so that all its scores are comparable.

Settings that do nothing are found here, and sensor types are drawn: values for the numbers of a
study's sensors, or of those of a comparison, that are not known. What is made of the draws is in
`pixsim.studies.uncertainty`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Generic, TypeVar

from pixsim.base.caller import setting
from pixsim.base.digits import amount
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.notes import Note, warn
from pixsim.base.records import Record, content_hash
from pixsim.base.schema import KEY
from pixsim.base.toml import whole_path
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.optics.diffraction import cutoff_cy_per_mm
from pixsim.optics.exchange import camera_of_light, read_with_camera
from pixsim.scene.charts import DIE_MM, MAX_LP_PER_MM, MIN_FREQUENCY_LP_PER_MM
from pixsim.scene.film import GREEN_NM
from pixsim.scene.scene import Scene, load_scene
from pixsim.scene.study_scene import StudyScene
from pixsim.sensor.integration import MAX_PIXELS, check_pixel_count, pixels_along, pixels_on
from pixsim.sensor.labels import file_label, label_of, labels_of
from pixsim.sensor.pixel_options import NO_TECHNOLOGY, Pixel, PixelOptions
from pixsim.sensor.reading import Readout
from pixsim.sensor.spread import Spread, Uncertainty, sheet_uncertainty
from pixsim.sensor.technology import check_name, load_technology
from pixsim.studies.design import (
    BASE,
    BYTES_PER_PIXEL,
    Case,
    Settings,
    border_on_um,
    cases_of,
    check_number,
    first_sampling,
    frames_fit_in_cache,
    further_displays,
    imaging_of,
    largest_lens_um,
    metrics_of,
    named,
    physics_of,
    point_count,
    study_pitches_um,
    technology_of,
    warn_of_reviews,
    with_range_ends,
)
from pixsim.studies.files import spreads_of_study
from pixsim.studies.lights import LightRequest, light_request
from pixsim.studies.settings import PitchRange, Study, paths_of
from pixsim.studies.uncertainty import (
    MAX_DRAWS,
    MAX_TYPE_EVALUATIONS,
    MIN_DRAWS,
    Sample,
    Unknown,
    drawn_metrics,
    sample_types,
    sobol_points,
    unknowns_of_process,
    unknowns_of_sheet,
)
from pixsim.viewer.display import dot_edges_um
from pixsim.viewer.display_options import Display
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.metric_options import has_target
from pixsim.viewer.metrics import (
    DELTA_E,
    ROW_COLUMNS,
    Metric,
    MetricContext,
    MetricRequest,
    columns_of_metrics,
)
from pixsim.viewer.scene_light import check_background
from pixsim.viewer.screen import allows_single
from pixsim.viewer.setting import Run, Setting
from pixsim.viewer.without_effect import (
    SOLVE_FOR,
    TABLES,
    Default,
    UserSettings,
    record_with,
    warn_of_settings_without_effect,
)

# --- settings that do nothing
# --------------------------------------------------------------------------------------------------


def cases_to_try(cases: Sequence[Case[Study]]) -> list[int]:
    """Return the numbers of cases in which settings are tried: those that differ from the first in
    one axis, and the last.

    A product of axes may have thousands; each of its values is in one of these.
    """
    first = cases[0]
    chosen = [
        number
        for number, case in enumerate(cases)
        if sum(case.at[name] != value for name, value in first.at.items())
        + (case.condition != first.condition)
        <= 1
    ]
    return list(dict.fromkeys([*chosen, len(cases) - 1]))


@dataclass(frozen=True)
class _GivenSizes(UserSettings):
    """Settings of one technology of a study, at one of its pixel sizes; what changes the list of
    sizes has an effect, too.

    study : as the user set it
    """

    study: Study | None = None
    technology: str = ""

    def _acts(self, name: str) -> bool:
        return (not name.startswith("pitch.") and super()._acts(name)) or self._moves_sizes(name)

    def _moves_sizes(self, name: str) -> bool:
        assert self.study is not None
        try:
            sizes_um = study_pitches_um(self.study, self.technology)
            other = record_with(self.study, name.split("."), Default)
            return study_pitches_um(other, self.technology).tolist() != sizes_um.tolist()
        except PixsimError:  # without it the settings are refused
            return True


# A study of a data sheet takes it from the sheet's pitch; the range and the display that follow
# from it are stated in `complete`.
_OF_THE_SHEET = "pitch.own_um"


def settings_of_technology(
    stated: Case[Study], complete: Case[Study], technology: str
) -> list[_GivenSizes]:
    """Return the settings of one technology in one case, at its largest and its smallest pixel
    size.

    stated : as the user set it
    complete : the same, with what the user left open
    """
    study = stated.settings
    tables: dict[str, Record] = {table: getattr(study, table) for table in TABLES}
    tables |= {"pixel": study.options_of(technology), "pitch": study.pitch}
    states_sizes = study.pitch.values_um is not None
    not_taken = [SOLVE_FOR]
    if not study.target_ci_um and (states_sizes or not study.refine):
        not_taken += ["max_repeats", "max_evaluations"]
    if study.target_ci_um or states_sizes:
        not_taken.append("refine")
    facts: dict[str, Any] = {
        "settings": study,
        "picture": complete.picture,
        "not_taken": tuple(not_taken),
    }
    settings = []
    for pitch_um in study_pitches_um(complete.settings, technology)[[-1, 0]].tolist():
        imaging = imaging_of(complete.settings, complete.camera, technology, pitch_um)
        at_size = UserSettings.of(imaging.changed(metrics=metrics_of(study)), tables, **facts)
        names = tuple(
            name for name in at_size.names if technology != NO_TECHNOLOGY or name != _OF_THE_SHEET
        )
        settings.append(
            _GivenSizes(at_size.imaging, names, **facts, study=study, technology=technology)
        )
    return settings


# --- sensor types
# --------------------------------------------------------------------------------------------------

_MOST_VALUES = 5  # of the axis of a study whose sensor types are drawn


@dataclass(frozen=True)
class UncertaintyRequest:
    """What is asked about the unknown numbers.

    draws : sensor types; rounded up to a power of two
    total : whether the draws are those of total indices, draws × (inputs + 2)
    smaller_than_um : pixel sizes; the probability that the optimum is smaller is reported
    uncertainty : of the study's own [pixel] and data sheets, as its files state it
    """

    draws: int
    total: bool = False
    smaller_than_um: tuple[float, ...] = ()
    uncertainty: Uncertainty = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not MIN_DRAWS <= self.draws <= MAX_DRAWS:
            raise invalid(
                setting("sobol" if self.total else "uncertainty"),
                self.draws,
                f"{MIN_DRAWS} to {MAX_DRAWS} sensor types",
            )

    def sample(self, study: Study) -> Sample:
        """Return the sensor types. Raises PixsimError if nothing is unknown."""
        make = sobol_points if self.total else sample_types
        return make(unknowns_of_study(study, self.uncertainty), self.draws, study.seed)


def uncertainty_request(
    uncertainty: int | None,
    sobol: int | None,
    smaller_than_um: Sequence[float],
    spreads: Uncertainty,
) -> UncertaintyRequest | None:
    """Return what is asked about the unknown numbers; None if nothing is.

    uncertainty, sobol : sensor types to draw, or those of total indices
    smaller_than_um : as in `UncertaintyRequest`
    spreads : `UncertaintyRequest.uncertainty`

    Raises PixsimError for both numbers of types, for sizes without any, and for those that are not
    above 0.
    """
    if uncertainty is not None and sobol is not None:
        raise invalid(setting("uncertainty"), f"with {setting('sobol')}", "one of the two")
    draws = uncertainty if sobol is None else sobol
    if draws is not None:
        for size_um in smaller_than_um:
            if not 0 < size_um < math.inf:
                raise invalid(setting("smaller_than_um"), f"{size_um:g}", "a size above 0 µm")
        return UncertaintyRequest(draws, sobol is not None, tuple(smaller_than_um), spreads)
    if smaller_than_um:
        got = f"without {setting('uncertainty')}"
        raise invalid(setting("smaller_than_um"), got, f"{setting('uncertainty', 'N')} beside it")
    return None


def unknowns_of_study(
    study: Study, uncertainty: Mapping[str, Mapping[str, Spread]] | None = None
) -> list[Unknown]:
    """Return all numbers of a study's sensors that are not known: of [pixel], its data sheets, and
    its technologies.

    uncertainty : of the study's own [pixel] by the name '', and of data sheets; that of others
        stands in their files

    Numbers that the study or a data sheet gives in place of a technology's are known, unless their
    own uncertainty is given.

    Raises PixsimError for a file that is damaged, and as `unknowns_of_sheet`.
    """
    spreads = spreads_of_study(study, uncertainty or {})
    unknowns = unknowns_of_sheet(study.pixel, spreads[""])
    for name in study.technologies:
        if name in study.sensors:
            unknowns += unknowns_of_sheet(study.sensors[name], spreads[name], name)
        unknowns += unknowns_of_process(
            study.options_of(name), technology_of(study, name), name, study.process.get(name, {})
        )
    return unknowns


def check_axes(study: Study) -> None:
    """Raise PixsimError for axes with which sensor types cannot be drawn."""
    if (
        any(axis.alone for axis in study.axis)
        or len(study.axis) > 1
        or any(len(axis.points) > _MOST_VALUES for axis in study.axis)
    ):
        got = ", ".join(f"{axis.name} with {len(axis.points)} values" for axis in study.axis)
        raise invalid(
            setting("uncertainty"),
            f"a study with the axes {got}",
            f"at most one axis of at most {_MOST_VALUES} values",
        )


def check_types(
    study: Study, cases: Sequence[Study], request: UncertaintyRequest, agreed: bool
) -> tuple[int, int]:
    """Return the number of sensor types of a study and of their evaluations at most, for all
    metrics.

    cases : of the study
    agreed : whether they may be very many

    Raises PixsimError for axes with which types cannot be drawn, if nothing is unknown, and for too
    many evaluations.
    """
    check_axes(study)
    types = len(request.sample(cases[0]).quantiles)
    evaluations = (
        types
        * MAX_TYPE_EVALUATIONS
        * sum(len(case.technologies) * len(drawn_metrics(case)) for case in cases)
    )
    check_number(types, evaluations, agreed)
    return types, evaluations


@dataclass(frozen=True)
class Types:
    """The sensor types of a comparison.

    requested_draws : number of sensor types that the user asks for; the sample has a power of two
    spreads : [pixel.uncertainty] of each sensor's file
    sample : drawn for all sensors, whose names are the technologies of its unknowns
    total : whether they are the points of total indices
    """

    requested_draws: int
    spreads: tuple[Mapping[str, Spread], ...]
    sample: Sample
    total: bool = False

    @classmethod
    def of(cls, request: UncertaintyRequest, sensors: Sequence[Case[Run]]) -> Types:
        """Draw sensor types. Raises PixsimError if nothing is unknown."""
        spreads = tuple(
            sheet_uncertainty(Path(case.file)) if Path(case.file).is_file() else {}
            for case in sensors
        )
        files = list(dict.fromkeys(whole_path(case.settings.pixel.technology) for case in sensors))
        processes = dict(zip(files, labels_of([file_label(file) for file in files]), strict=True))
        unknowns: list[Unknown] = []
        for case, sheet_spreads in zip(sensors, spreads, strict=True):
            name, pixel = case.sensor, case.settings.pixel
            unknowns += unknowns_of_sheet(pixel, sheet_spreads, name)
            if pixel.technology != NO_TECHNOLOGY:
                process = processes[whole_path(pixel.technology)]
                process_unknowns = unknowns_of_process(
                    pixel, load_technology(pixel.technology), name
                )
                unknowns += [replace(unknown, process=process) for unknown in process_unknowns]
        make = sobol_points if request.total else sample_types
        return cls(
            request.draws,
            spreads,
            make(unknowns, request.draws, sensors[0].settings.seed),
            request.total,
        )

    def imagings(self, name: str, imaging: Imaging) -> Iterator[Imaging]:
        """Yield what lies between light and score of each type of a sensor.

        name, imaging : of the sensor as it is; numbers that a condition sets are known in it
        """
        pixel = imaging.pixel
        unknowns = [
            unknown
            for members in self.sample.inputs.values()
            for unknown in members
            if unknown.technology == name
        ]
        sheet_unknowns = [
            unknown
            for unknown in unknowns
            if unknown.is_data_sheet and getattr(pixel, unknown.quantity) == unknown.value
        ]
        process_unknowns = [
            unknown
            for unknown in unknowns
            if not unknown.is_data_sheet and getattr(pixel, unknown.quantity, None) is None
        ]
        technology = load_technology(pixel.technology)
        for draw in self.sample.draws:
            numbers = {unknown.quantity: draw[unknown.name] for unknown in sheet_unknowns}
            process = {unknown.quantity: draw[unknown.name] for unknown in process_unknowns}
            drawn = Pixel(**pixel.model_dump() | numbers) if numbers else pixel
            yield replace(
                imaging,
                pixel=drawn,
                technology=(
                    technology.with_numbers(process, name) if process else imaging.technology
                ),
            )


# --- the job
# --------------------------------------------------------------------------------------------------

_ALLOWED_DOTS = (8, 2048)  # of a display that is chosen; a user may set up to 4096
_MIN_OCTAVES = 1.0  # of a chart that is chosen, for dies of a few pixels
_Chosen = TypeVar("_Chosen", bound=Setting)


def choose_view(
    pitch_um: float, camera: Camera, display: Display, scene: Scene | None
) -> dict[str, Any]:
    """Return the display's dots and the chart's end for a data sheet's sensor of a pitch, where
    nobody set them.

    `dots` are the columns of pixels on the die, 8 to 2048. The CSF chart ends at `max_lp_per_mm` on
    the sensor, the least of the Nyquist frequencies of sensor and display and the cut-off of the
    lens in green light; `limited_by` names it. What was set, or does not apply, is left out.
    `with_view` completes settings with them.

    camera : of the window that is simulated
    scene : None for a picture of another program

    Raises PixsimError if not one pixel fits on the die.
    """
    fixed = display.raster == "fixed_size"
    columns = pixels_along(camera.die_um[1], pitch_um)
    dots = min(max(columns, _ALLOWED_DOTS[0]), _ALLOWED_DOTS[1])
    free = fixed and "dots" not in display.model_fields_set
    chosen: dict[str, Any] = {"dots": dots} if free else {}
    if scene is None or not scene.shows_csf or MAX_LP_PER_MM in scene.parameters:
        return chosen
    limits = {
        "the sensor's Nyquist frequency": 1e3 / (2 * pitch_um),
        "the lens's cut-off": float(cutoff_cy_per_mm(GREEN_NM, camera.effective_f_number)),
    }
    if fixed:
        limits["the display's Nyquist frequency"] = (dots if free else display.dots) / (
            2 * camera.die_mm
        )
    limited_by = min(limits, key=lambda name: limits[name])
    lowest = MIN_FREQUENCY_LP_PER_MM * DIE_MM / camera.die_mm
    return chosen | {
        MAX_LP_PER_MM: max(limits[limited_by], 2**_MIN_OCTAVES * lowest),
        "limited_by": limited_by,
    }


def with_view(settings: _Chosen, view: Mapping[str, Any]) -> _Chosen:
    """Return settings with the display and the chart of `choose_view`, except for what they state
    of them.
    """
    display, scene = settings.display, settings.scene
    if "dots" in view and "dots" not in display.model_fields_set:
        display = display.model_copy(update={"dots": view["dots"]})
    if MAX_LP_PER_MM in view:
        chart = {MAX_LP_PER_MM: view[MAX_LP_PER_MM]}
        if isinstance(scene, dict):
            scene = chart | scene
        elif isinstance(scene, StudyScene):
            scene = scene.model_copy(update={"parameters": chart | scene.parameters})
    return settings.model_copy(update={"display": display, "scene": scene})


def scene_with_view(scene: Scene, view: Mapping[str, Any]) -> Scene:
    """Return a scene with the chart of `choose_view`."""
    return (
        scene.with_parameters(**{MAX_LP_PER_MM: repr(view[MAX_LP_PER_MM])})
        if MAX_LP_PER_MM in view
        else scene
    )


def _source_with_view(
    source: Scene | SpectralImage, view: Mapping[str, Any]
) -> Scene | SpectralImage:
    """Return `scene_with_view` of a scene; light that is given as it is."""
    return source if isinstance(source, SpectralImage) else scene_with_view(source, view)


def shows_csf(source: Scene | SpectralImage) -> bool:
    """Return whether a scene shows the CSF chart, whose end may be chosen."""
    return not isinstance(source, SpectralImage) and source.shows_csf


def _without_chart(view: Mapping[str, Any]) -> dict[str, Any]:
    """Return a view without its chart, for a scene that has another one."""
    return {name: value for name, value in view.items() if name == "dots"}


_MIN_ACROSS = 16  # pixels across the die, of the largest pitch by default
MAX_FRAME_BYTES = 1.0 * (1 << 30)
PITCH_DIGITS = 4


def _most_pixels(camera: Camera, own_um: float | None) -> float:
    """Return the number of pixels that a study chooses by itself at most.

    That of a data sheet takes 1 GiB while a frame is simulated, or as many pixels as its sensor
    has; of a technology, any number that pixsim simulates.
    """
    if own_um is None:
        return MAX_PIXELS
    sensor_pixels = math.prod(pixels_on(camera.die_um, own_um))
    return min(max(MAX_FRAME_BYTES / BYTES_PER_PIXEL, sensor_pixels), MAX_PIXELS)


def fitted_range(study: Study, camera: Camera) -> Study:
    """Return the study with the range of its pixel sizes: that of the data sheet, and within what a
    frame may hold.

    A range that is left open begins at a quarter of the data sheet's pitch, or where the fill
    factor is `min_fill_factor`, and ends at four times the pitch. It is shortened, with a warning,
    where there would be too many pixels or too few, and where a stack allows no microlens.

    Raises PixsimError if a pixel size that was set makes too many pixels.
    """
    pitch, own_um = study.pitch, study.own_um
    height_um, width_um = camera.die_um
    if pitch.values_um is not None:
        _check_smallest(min(pitch.values_um), camera, "pitch.values_um")
        return study
    low, high = study.open_range_um
    if own_um is not None and "max_um" not in pitch.model_fields_set:
        wished, high = high, min(high, max(min(height_um, width_um) / _MIN_ACROSS, own_um))
        if high < wished:
            reason = f"a larger one leaves fewer than {_MIN_ACROSS} on the die"
            warn(_range_note("largest pixel size", high, wished, reason))
    for name in study.technologies:
        if (lens_um := largest_lens_um(study, name)) < high:
            reason = (
                "its stack is too low for a wider ideal microlens (h < p/√π); larger ones:"
                " pixel.stack.height_um, or "
            )
            reason += "pixel.stack.microlens = 'none'"
            warn(_range_note(f"largest pixel size of {label_of(name)}", lens_um, high, reason))
    if pitch.min_um is not None:
        _check_smallest(pitch.min_um, camera, "pitch.min_um")
    else:
        lows = (
            [low]
            if low is not None
            else [float(study_pitches_um(study, name).min()) for name in study.technologies]
        )
        low = low if low is None else _up_to_pitch_digits(low)
        max_pixels = _most_pixels(camera, own_um)
        smallest_um = _up_to_pitch_digits(math.sqrt(height_um * width_um / max_pixels))
        if min(lows) < smallest_um - 10**-PITCH_DIGITS:
            if len(lows) > 1:
                which = study.technologies[lows.index(min(lows))]
                got = (
                    f"{min(lows):.4g} µm of {which}:"
                    f" {amount(height_um * width_um / min(lows) ** 2)} pixels"
                )
                raise invalid(
                    "pitch.min_fill_factor",
                    got,
                    f"at most {amount(max_pixels)} pixels",
                    f"Set --pitch.min-um {smallest_um:g}, or --window.",
                )
            low = smallest_um
            reason = (
                f"it has {amount(max_pixels)} pixels on the die; smaller ones: --pitch.min-um, or a part"
                " of the die by --window"
            )
            warn(_range_note("smallest pixel size", low, min(lows), reason))
    if own_um is None and low == pitch.min_um:
        return study
    chosen = {
        name: value for name, value in (("min_um", low), ("max_um", high)) if value is not None
    }
    return study.model_copy(
        update={"pitch": PitchRange.model_validate(pitch.model_dump(exclude_unset=True) | chosen)}
    )


def _range_note(size: str, pitch_um: float, asked_um: float, reason: str) -> Note:
    return Note(
        "left_out", words=f"the {size} is {pitch_um:.4g} µm in place of {asked_um:.4g} µm: {reason}"
    )


def _check_smallest(pitch_um: float, camera: Camera, name: str) -> None:
    """Raise PixsimError if pixels of a size that was set are too many for the die."""
    height_um, width_um = camera.die_um
    count = math.floor(height_um / pitch_um) * math.floor(width_um / pitch_um)
    if count > MAX_PIXELS:
        smallest_um = _up_to_pitch_digits(math.sqrt(height_um * width_um / MAX_PIXELS))
        hint = "Or take a part of the die: --window."
        raise invalid(
            name,
            f"{pitch_um:g}, which makes {amount(count)} pixels",
            f"at least {smallest_um:g} on this die",
            hint,
        )


def _up_to_pitch_digits(pitch_um: float) -> float:
    """Return a pitch rounded up to the digits of a study's pitches."""
    return math.ceil(pitch_um * 10**PITCH_DIGITS) / 10**PITCH_DIGITS


def check_technologies(study: Study) -> None:
    """Raise PixsimError for an unknown technology, one that a study has twice, or numbers of one
    that it does not have.
    """
    processes: dict[str, str] = {}
    for name in study.process:
        if name not in study.technologies:
            raise invalid(
                "process",
                f"'{name}'",
                f"technologies of the study: {', '.join(study.technologies)}",
            )
    for name in study.technologies:
        check_name(name)
        sheet = study.sensors[name].model_dump() if name in study.sensors else None
        content = content_hash([technology_of(study, name).content, sheet])
        if content in processes:
            kind = "process" if sheet is None else "data sheet"
            raise invalid(
                "technologies",
                f"{name} and {processes[content]}, which are the same {kind}",
                f"each {kind} once",
            )
        processes[content] = name


def check_pitches(study: Study) -> None:
    """Raise PixsimError for an impossible pitch or limit, before anything is computed.

    Of a study without axes.
    """
    for technology in study.technologies:
        pitches_um, process = (
            study_pitches_um(study, technology).tolist(),
            technology_of(study, technology),
        )
        # what a pixel is derived from grows or falls with its pitch: sizes between two possible
        # ones are possible
        try:
            smallest, _ = (
                physics_of(study, technology, pitches_um[end], process) for end in (0, -1)
            )
        except PixsimError:
            for pitch_um in pitches_um:  # the message is that of the first impossible one
                physics_of(study, technology, pitch_um, process)
            raise
        Readout.of(smallest, study.exposure)  # raises for a burst whose sum has too many bits
    first = sum(sum(sensors.values()) for sensors in first_sampling(study).values())
    if study.max_evaluations is not None and study.max_evaluations < first:
        expected = f"at least {first}, with which the study starts"
        raise invalid(
            "max_evaluations",
            study.max_evaluations,
            expected,
            "Raise it, or lower repeats or pitch.count.",
        )


def is_picture(file: str) -> bool:
    """Return whether a file holds light that was rendered before, by its name."""
    return Path(file).suffix.lower() in (".exr", ".npz", ".hdr")


def loaded_scene(
    file: str,
    parameters: Mapping[str, float | int | str],
    resolution: int | None,
    display: Display,
    *,
    variant: str | None = None,
    sensor: str | None = None,
) -> Scene:
    """Return a scene with its parameters, on a film of `resolution` samples across if that is set.

    display : says whether light of the scene has to say what a white plate in it shows

    Raises PixsimError as `pixsim.load_scene`.
    """
    scene = replace(
        load_scene(file, variant=variant, sensor=sensor, **parameters),
        diffuser=display.white == "diffuser",
    )
    return scene.with_resolution(resolution) if resolution else scene


_GIVEN_LIGHT = "(given light)"  # in place of a scene's file
# What light of a scene is rendered by, and given light is not.
_OF_SCENE = (
    "scene",
    "camera",
    "lens",
    "window_mm",
    "resolution",
    "max_seconds",
    "tolerance_e",
    "tolerance_delta_e",
    "render_noise",
)


def check_given_light(**settings: object) -> None:
    """Raise PixsimError for what says which scene is rendered, beside light that is given."""
    if names := [name for name, value in settings.items() if value]:
        raise invalid(names[0], "a value beside light", "one of the two")


def check_axis_names(study: Study, metrics: Sequence[Metric], *labels: str) -> None:
    """Raise PixsimError for an axis with the name of a column that all rows have.

    labels : further columns
    """
    columns = *ROW_COLUMNS, *columns_of_metrics(metrics), KEY, *labels
    if taken := [axis.name for axis in study.axis if axis.name in columns]:
        raise invalid("axis", f"name = '{taken[0]}', a column of every study", "another name")


def with_given_light(study: Study, variant: str | None) -> Study:
    """Return a study whose light is given, without the scene of its file.

    Raises PixsimError for what only light of a scene has: axes over scene and camera, a window, a
    tolerance of ΔE.
    """
    where = "a study whose light is given"
    varied = [path for axis in study.axis for path in axis.paths]
    varied += [path for condition in study.condition for path in paths_of(condition.set)]
    if moved := [".".join(path) for path in varied if path[0] in _OF_SCENE]:
        raise invalid(
            "axis",
            f"{moved[0]} in {where}",
            "settings of pixel, exposure, display, correction and development",
        )
    stated = {
        "window_mm": study.window_mm,
        "tolerance_delta_e": study.tolerance_delta_e,
        "variant": variant,
    }
    if (
        names := [name for name, value in stated.items() if value is not None]
        + ["paper"] * study.paper
    ):
        raise invalid(names[0], f"a value in {where}", "a study of a scene, or no value")
    return study.model_copy(update={"scene": StudyScene(file=_GIVEN_LIGHT), "resolution": None})


def _scene_for(
    study: Study, variant: str | None = None, scenes: dict[str, Scene] | None = None
) -> tuple[Scene, Camera]:
    """Return the study's scene and the camera of its window. Raises PixsimError for invalid input.

    scenes : scenes by their settings, to which this one is added
    """
    if study.scene.file == _GIVEN_LIGHT:
        raise invalid(
            "scene.file", "light that was given in Python", "a scene, or pixsim.study(…, light=…)"
        )
    if is_picture(study.scene.file):
        hint = f"In Python: pixsim.study(…, light=pixsim.read_irradiance('{study.scene.file}'))."
        raise invalid("scene.file", f"'{study.scene.file}', a picture", "a Mitsuba scene", hint)
    scenes = {} if scenes is None else scenes
    key = content_hash([study.scene.model_dump(mode="json"), study.resolution, study.display.white])
    if key not in scenes:
        scenes[key] = loaded_scene(
            study.scene.file,
            study.scene.parameters,
            study.resolution,
            study.display,
            variant=variant,
        )
    scene = scenes[key]
    return scene, scene.camera(study.camera, study.lens).window(study.window_mm)


@dataclass(frozen=True, eq=False, kw_only=True)
class Job(Generic[Settings]):
    """What a command is asked for, with cases that are resolved and checked.

    stated : settings as the user states them
    complete : the same, with display and chart; of a study with its axes and conditions
    file : the scene or the picture, as it was given
    source : the scene of `complete`, or the picture
    view : display and chart that pixsim chose for the sensor of a data sheet, of `choose_view`
    sensor, variant, units : id of the scene's sensor, variant of Mitsuba, and units of a picture,
        as they were given
    """

    cases: tuple[Case[Settings], ...]
    stated: Settings
    complete: Settings
    file: str
    source: Scene | SpectralImage
    view: Mapping[str, Any] = field(default_factory=dict)
    sensor: str | None = None
    variant: str | None = None
    units: str | None = None

    @property
    def settings(self) -> Settings:
        """The complete settings of the first case."""
        return self.cases[0].settings

    @property
    def camera(self) -> Camera:
        """The camera of the first case."""
        return self.cases[0].camera

    @property
    def repeats(self) -> int:
        """Number of sensors of each kind with which the first case starts."""
        return next(iter(self.cases[0].sizes.values()))

    @property
    def frames(self) -> int:
        """Number of frames of the first sensor."""
        return self.cases[0].frames

    @cached_property
    def request(self) -> LightRequest:
        """What the pixels of the first case ask of its light."""
        return light_request(self.cases[0])

    @property
    def combinations(self) -> tuple[Case[Settings], ...]:
        """The first case of each group."""
        firsts: dict[object, Case[Settings]] = {}
        for case in self.cases:
            firsts.setdefault(case.group, case)
        return tuple(firsts.values())

    @property
    def evaluations(self) -> int:
        """Number of evaluations that the cases start with."""
        return sum(
            point_count(count, 1 + len(case.further_displays))
            for case in self.cases
            for count in case.sizes.values()
        )


def prepare(
    study: Study,
    variant: str | None = None,
    light: SpectralImage | None = None,
    background: SpectralImage | None = None,
) -> Job[Study]:
    """Choose what a study leaves open, and check everything that can be checked before a render.

    light : on the sensor, in place of a scene's
    background : such light without the target

    Raises PixsimError for invalid input, and warns of a range of sizes that had to be shortened.
    """
    stated = study
    study = with_range_ends(stated)
    scenes: dict[str, Scene] = {}
    light = None if light is None else light.identified
    study = study if light is None else with_given_light(study, variant)

    def source_for(study: Study) -> tuple[Scene | SpectralImage, Camera]:
        return (
            _scene_for(study, variant, scenes)
            if light is None
            else (light, camera_of_light(light, study.camera, study.lens))
        )

    check_axis_names(study, (DELTA_E, *metrics_of(study).chosen))
    # Display and chart are those of the study itself, so that all of its cases are comparable.
    base_study = _without_axes(study) if study.has_cases else study
    scene, camera = source_for(base_study)
    view = _chosen_view(base_study, scene, camera)
    complete_cases: list[Case[Study]] = []
    cases = cases_of(study)
    for case in cases:
        with named((case.words or BASE) if study.has_cases else ""):
            shares_chart = _same_chart(case.settings, base_study) or shows_csf(
                source_for(case.settings)[0]
            )
            complete = with_view(case.settings, view if shares_chart else _without_chart(view))
            check_technologies(complete)
            scene_of_case, its_camera = source_for(complete)
            sized_case = replace(case, settings=fitted_range(complete, its_camera))
            complete_cases.append(_checked(sized_case, scene_of_case, its_camera, background))
    _warn_of_settings_without_effect(cases, complete_cases)
    _warn_of_other_parts(complete_cases)
    # A chart that not all cases have stays chosen: settings.toml cannot state its end for all of
    # them.
    common_view = (
        view
        if all(_same_chart(case.settings, base_study) for case in complete_cases)
        else _without_chart(view)
    )
    asked_displays = [case.settings.display for case in cases]
    sensors = tuple(
        replace(case, further_displays=_further_displays(case, display))
        for combination, display in zip(complete_cases, asked_displays, strict=True)
        for case in cases_of_sensors(combination)
    )
    warn_of_reviews((label_of(case.sensor), case, None) for case in sensors)
    return Job(
        cases=sensors,
        stated=stated,
        complete=with_view(study, common_view) if study.has_cases else complete_cases[0].settings,
        file=study.scene.file,
        source=_source_with_view(scene, view),
        view=view,
        variant=variant,
    )


def _further_displays(case: Case[Study], stated: Display) -> tuple[Display, ...]:
    """Return further displays on which frames of a data sheet's sensor are shown: nobody knows its
    display.

    stated : the display, as the user stated it
    """
    study, imaging = case.settings, case.imaging
    if study.own_um is None or imaging is None or imaging.border_um is None:
        return ()
    return further_displays(
        stated, imaging.display, case.camera.die_um, imaging.pixel.pitch_um, imaging.border_um
    )


def cases_of_sensors(combination: Case[Study]) -> Iterator[Case[Study]]:
    """Yield a case for each technology and data sheet of a study without axes."""
    study, camera = combination.settings, combination.camera
    caches_frames = frames_fit_in_cache(study, camera)
    for name in study.technologies:
        pitches_um = study_pitches_um(study, name).tolist()
        imaging = imaging_of(study, camera, name, pitches_um[-1])
        yield replace(
            combination,
            sensor=name,
            imaging=imaging.changed(
                single=allows_single(study.tolerance_delta_e),
                metrics=metrics_of(study, study.repeats),
            ),
            # The name of the technology, not its path, which is no part of a result.
            stream=(study.stream_name, study.seed, imaging.physics.technology.name),
            sizes=dict.fromkeys(pitches_um, study.repeats),
            caches_frames=caches_frames,
        )


def _warn_of_other_parts(cases: Sequence[Case[Study]]) -> None:
    """Warn if what moves leaves other parts of the frame to score in one case than in another."""
    rooms_um = {
        border_on_um(case.settings, case.camera) - case.settings.border_um for case in cases
    }
    if len(rooms_um) > 1:
        warn(Note("unequal_margins", margin_um=math.ceil(max(rooms_um))))


def _warn_of_settings_without_effect(
    stated: Sequence[Case[Study]], complete: Sequence[Case[Study]]
) -> None:
    """Warn of the settings that have no effect in any case of a study, and of those that have none
    in one of its technologies.

    stated : the cases as the user set them
    complete : the same, with what the user left open
    """
    tried = [(stated[number], complete[number]) for number in cases_to_try(stated)]
    technologies = list(
        dict.fromkeys(name for case in stated for name in case.settings.technologies)
    )
    sensors = {
        label: (
            settings
            for pair in tried
            if name in pair[0].settings.technologies
            for settings in settings_of_technology(*pair, name)
        )
        for name, label in zip(technologies, labels_of(technologies), strict=True)
    }
    warn_of_settings_without_effect(sensors)


def _same_chart(first: Study, second: Study) -> bool:
    """Return whether two studies show the same scene with the same chart."""
    files = [(study.scene.file, study.scene.parameters.get("chart")) for study in (first, second)]
    return files[0] == files[1]


def _without_axes(study: Study) -> Study:
    """Return the study with its own settings alone; an axis over technologies leaves the first of
    them.
    """
    table = study.stated
    for axis in study.axis:
        if "technologies" in axis.points[0].table:
            table |= axis.points[0].table
    return Study.model_validate(table)


def _chosen_view(study: Study, source: Scene | SpectralImage, camera: Camera) -> dict[str, Any]:
    scene = None if isinstance(source, SpectralImage) else source
    return {} if study.own_um is None else choose_view(study.own_um, camera, study.display, scene)


def check_metrics(
    settings: Setting,
    pixels: Sequence[PixelOptions],
    source: Scene | SpectralImage,
    background: SpectralImage | None = None,
    units: str | None = None,
    names: Sequence[str] = (),
) -> SpectralImage | None:
    """Return the light without the target beside light that is given: `background`, or that of a file
    that the settings name.

    source : scene, or light that is given
    units : of light in files that do not state them
    names : of the pixels, for messages

    Raises PixsimError for a metric that is unknown, or that means nothing for one of the pixels, or
    for the source.
    """
    request, stated, name = (
        metrics_of(settings),
        settings.metric.detectability.without,
        setting("metric.detectability.without"),
    )
    if isinstance(source, SpectralImage):
        if (
            background is None
            and has_target(settings.metrics)
            and isinstance(stated, str)
            and is_picture(stated)
        ):
            with named(name):
                background, _ = read_with_camera(stated, settings.camera, units, settings.lens)
        elif background is not None and "without" in settings.metric.detectability.model_fields_set:
            warn(
                Note(
                    "not_used",
                    setting=name,
                    reason="the light without the target is given beside the light",
                )
            )
        if background is not None:
            check_background(background, source)
        has_without = background is not None
        distances = (
            settings.camera.object_distance_m,
            settings.metric.niirs.ground_distance_m,
            source.header.get("camera"),
        )
        has_distance = any(distance is not None for distance in distances)
    else:
        if isinstance(stated, str) and has_target(settings.metrics):
            from pixsim.scene.scene import scene_path

            with named(name):
                scene_path(stated)
        has_without, has_distance = isinstance(stated, str) or stated.keys() <= source.names, True
    for number, pixel in enumerate(pixels):
        with named(names[number] if names else ""):
            request.check(
                MetricContext(pixel.colour is not None, has_without, has_distance=has_distance)
            )
    return None if background is None else background.identified


def sensor_case(
    case: Case[Run],
    *,
    repeats: int = 1,
    border_um: float | None = None,
    units: str | None = None,
    request: MetricRequest | None = None,
    **imaging_fields: bool,
) -> Case[Run]:
    """Return the case of one sensor with its imaging and sizes, after the checks that hold for
    every command.

    case : with its complete settings, its source and its camera
    repeats : number of sensors of the kind
    border_um : width that is not scored; None takes that of its own pixels, with room for what
        moves
    units : of light in files that do not state them
    request : metrics; None takes ΔE and those of the settings
    imaging_fields : further fields of `Imaging`, such as `is_run`

    Raises PixsimError for metrics that mean nothing for the pixel, and if the die has too many
    pixels, or too few dots.
    """
    run, die_um, pitch_um = case.settings, case.camera.die_um, case.settings.pixel.pitch_um
    background = check_metrics(run, [run.pixel], case.source, case.background, units)
    check_pixel_count(pixels_on(die_um, pitch_um), pitch_um)
    imaging = Imaging.of(run, case.camera)
    border_um = imaging.scored_border_um if border_um is None else border_um
    dot_edges_um(die_um, pitch_um, run.display, border_um)

    request = request or metrics_of(with_delta_e(run))
    imaging = imaging.changed(border_um=border_um, metrics=request, **imaging_fields)
    return replace(
        case,
        background=background,
        imaging=imaging,
        stream_has_pitch=False,
        sizes={pitch_um: repeats},
    )


def with_delta_e(run: Run) -> Run:
    """Return a run that is judged by ΔE first, and then by its metrics."""
    return run.model_copy(update={"metrics": tuple(dict.fromkeys((DELTA_E.name, *run.metrics)))})


def _checked(
    case: Case[Study],
    source: Scene | SpectralImage,
    camera: Camera,
    background: SpectralImage | None = None,
) -> Case[Study]:
    """Return a case whose settings are complete. Raises PixsimError for pixel sizes that are not
    possible.

    background : light without the target, beside light that is given
    """
    study = case.settings
    background = check_metrics(
        study, [study.options_of(name) for name in study.technologies], source, background
    )
    check_pitches(study)
    for technology in study.technologies:
        largest_um = float(study_pitches_um(study, technology).max())
        dot_edges_um(camera.die_um, largest_um, study.display, border_on_um(study, camera))
    return replace(case, resolved=(source, camera), background=background)
