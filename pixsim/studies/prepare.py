"""Prepare a command before its first render: choose the display, the chart and the pixel sizes that
the user left open, and check all cases.

The process of Chen et al. (2000) comes with a display and a chart; a data sheet does not. Unless
the user sets them, the display of a data sheet's sensor has a dot for each column of pixels, up to
2048, and the CSF chart ends at the highest frequency that the sensor, the lens and the display can
show. Both are chosen once a command, so that all its scores are comparable.

This module also warns of settings that have no effect, and draws sensor types: values for the
unknown numbers of the sensors of a study or a comparison. `pixsim.studies.uncertainty` evaluates
them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

from pixsim.base.caller import setting
from pixsim.base.digits import amount
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.hashes import content_hash
from pixsim.base.lazy import cached_property
from pixsim.base.notes import Note, warn
from pixsim.base.records import Record
from pixsim.base.schema import KEY
from pixsim.base.toml import whole_path
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.diffraction import cutoff_cy_per_mm
from pixsim.optics.exchange import camera_of_light, read_with_camera
from pixsim.scene.charts import DIE_MM, MAX_LP_PER_MM, MIN_FREQUENCY_LP_PER_MM
from pixsim.scene.film import GREEN_NM
from pixsim.scene.packaged import packaged_scenes
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
from pixsim.viewer.screen import allows_float32
from pixsim.viewer.setting import Run, Setting
from pixsim.viewer.without_effect import (
    SOLVE_FOR,
    TABLES,
    Default,
    UserSettings,
    record_with,
    warn_of_settings_without_effect,
)

# --- settings without effect
# --------------------------------------------------------------------------------------------------


def cases_to_try(cases: Sequence[Case[Study]]) -> list[int]:
    """Return the numbers of cases in which settings are tried: the cases that differ from the first
    in one axis, and the last case.

    A product of axes may have thousands; each of its values is in one of these.
    """
    first = cases[0]
    numbers = []
    for number, case in enumerate(cases):
        differences = sum(case.at[name] != value for name, value in first.at.items())
        differences += case.condition != first.condition
        if differences <= 1:
            numbers.append(number)
    return list(dict.fromkeys([*numbers, len(cases) - 1]))


@dataclass(frozen=True)
class _SizeSettings(UserSettings):
    """Settings of one technology of a study at one of its pixel sizes.

    A setting that changes the list of sizes has an effect, too.

    study : as the user states it
    """

    study: Study | None = None
    technology: str = ""

    def _acts(self, name: str) -> bool:
        if not name.startswith("pitch.") and super()._acts(name):
            return True
        return self._changes_sizes(name)

    def _changes_sizes(self, name: str) -> bool:
        assert self.study is not None
        try:
            sizes_um = study_pitches_um(self.study, self.technology)
            other = record_with(self.study, name.split("."), Default)
            return study_pitches_um(other, self.technology).tolist() != sizes_um.tolist()
        except PixsimError:  # without this setting the others are refused
            return True


# A study of a data sheet takes this pitch from the sheet; the complete settings state the range
# and the display that follow from it.
_SHEET_PITCH = "pitch.own_um"


def settings_of_technology(
    stated: Case[Study], complete: Case[Study], technology: str
) -> list[_SizeSettings]:
    """Return the settings of one technology in one case, at its largest and its smallest pixel
    size.

    stated : as the user states it
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
        settings_at_size = UserSettings.of(
            imaging.changed(metrics=metrics_of(study)), tables, **facts
        )
        names = settings_at_size.names
        if technology == NO_TECHNOLOGY:
            names = tuple(name for name in names if name != _SHEET_PITCH)
        settings.append(
            _SizeSettings(
                settings_at_size.imaging, names, **facts, study=study, technology=technology
            )
        )
    return settings


# --- sensor types
# --------------------------------------------------------------------------------------------------

_MAX_AXIS_VALUES = 5  # of the axis of a study whose sensor types are drawn


@dataclass(frozen=True)
class UncertaintyRequest:
    """Sensor types that a user asks for, to find the effect of the unknown numbers of sensors.

    draws : sensor types; rounded up to a power of two
    total : whether total indices are estimated, from draws × (inputs + 2) types
    smaller_than_um : pixel sizes; the probability of a smaller optimum is reported for each
    uncertainty : of [pixel] and of the data sheets of a study, as its files state it
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
    """Return the request about the unknown numbers that options make, or None without such options.

    uncertainty, sobol : sensor types to draw: at random, or for total indices
    smaller_than_um : as in `UncertaintyRequest`
    spreads : `UncertaintyRequest.uncertainty`

    Raises PixsimError for both numbers of types, for sizes without any, and for those that are not
    above 0.
    """
    if uncertainty is not None and sobol is not None:
        raise invalid(
            setting("uncertainty"), f"a value together with {setting('sobol')}", "one of the two"
        )
    draws = uncertainty if sobol is None else sobol
    if draws is not None:
        for size_um in smaller_than_um:
            if not 0 < size_um < math.inf:
                raise invalid(setting("smaller_than_um"), f"{size_um:g}", "a size above 0 µm")
        return UncertaintyRequest(draws, sobol is not None, tuple(smaller_than_um), spreads)
    if smaller_than_um:
        got = f"without {setting('uncertainty')}"
        raise invalid(
            setting("smaller_than_um"), got, f"{setting('uncertainty', 'N')} together with it"
        )
    return None


def unknowns_of_study(
    study: Study, uncertainty: Mapping[str, Mapping[str, Spread]] | None = None
) -> list[Unknown]:
    """Return all unknown numbers of a study's sensors: of [pixel], its data sheets, and its
    technologies.

    uncertainty : of the study's [pixel] by the name '', and of data sheets by theirs; other sheets
        state it in their files

    A number that the study or a data sheet states in place of the technology's is known, unless
    its uncertainty is stated, too.

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
    has_few_values = all(len(axis.points) <= _MAX_AXIS_VALUES for axis in study.axis)
    is_alone = any(axis.alone for axis in study.axis)
    if len(study.axis) <= 1 and has_few_values and not is_alone:
        return
    got = ", ".join(f"{axis.name} with {len(axis.points)} values" for axis in study.axis)
    raise invalid(
        setting("uncertainty"),
        f"a study with the axes {got}",
        f"at most one axis of at most {_MAX_AXIS_VALUES} values",
    )


def check_types(
    study: Study, cases: Sequence[Study], request: UncertaintyRequest, agreed: bool
) -> tuple[int, int]:
    """Return the number of sensor types of a study, and the largest number of their evaluations for
    all metrics.

    cases : the settings of each case of the study
    agreed : whether the user agrees to very many evaluations

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
class SensorTypes:
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
    def of(cls, request: UncertaintyRequest, sensors: Sequence[Case[Run]]) -> SensorTypes:
        """Draw sensor types. Raises PixsimError if nothing is unknown."""
        spreads = tuple(
            sheet_uncertainty(Path(case.file)) if Path(case.file).is_file() else {}
            for case in sensors
        )
        files = list(dict.fromkeys(whole_path(case.settings.pixel.technology) for case in sensors))
        processes = dict(zip(files, labels_of([file_label(file) for file in files]), strict=True))

        unknowns: list[Unknown] = []
        for case, sheet_spreads in zip(sensors, spreads, strict=True):
            name = case.sensor
            pixel = case.settings.pixel
            unknowns += unknowns_of_sheet(pixel, sheet_spreads, name)
            if pixel.technology != NO_TECHNOLOGY:
                technology = load_technology(pixel.technology)
                process = processes[whole_path(pixel.technology)]
                for unknown in unknowns_of_process(pixel, technology, name):
                    unknowns.append(replace(unknown, process=process))

        draw = sobol_points if request.total else sample_types
        sample = draw(unknowns, request.draws, sensors[0].settings.seed)
        return cls(request.draws, spreads, sample, request.total)

    def imagings(self, name: str, imaging: Imaging) -> Iterator[Imaging]:
        """Yield what lies between light and score of each type of a sensor.

        name, imaging : of the sensor as it is; a number that a condition sets is known
        """
        pixel = imaging.pixel
        sheet_unknowns: list[Unknown] = []
        process_unknowns: list[Unknown] = []
        for members in self.sample.inputs.values():
            for unknown in members:
                if unknown.technology != name:
                    continue
                stated = getattr(pixel, unknown.quantity, None)
                if unknown.is_data_sheet and stated == unknown.value:
                    sheet_unknowns.append(unknown)
                elif not unknown.is_data_sheet and stated is None:
                    process_unknowns.append(unknown)

        process = load_technology(pixel.technology)
        for draw in self.sample.draws:
            drawn_pixel = pixel
            technology = imaging.technology
            if sheet_unknowns:
                numbers = {unknown.quantity: draw[unknown.name] for unknown in sheet_unknowns}
                drawn_pixel = Pixel(**pixel.model_dump() | numbers)
            if process_unknowns:
                numbers = {unknown.quantity: draw[unknown.name] for unknown in process_unknowns}
                technology = process.with_numbers(numbers, name)
            yield replace(imaging, pixel=drawn_pixel, technology=technology)


# --- the job
# --------------------------------------------------------------------------------------------------

_ALLOWED_DOTS = (8, 2048)  # of a display that is chosen; a user may set up to 4096
_MIN_OCTAVES = 1.0  # of a chart that is chosen, for dies of a few pixels
_ChosenSettings = TypeVar("_ChosenSettings", bound=Setting)


def choose_view(
    pitch_um: float, camera: Camera, display: Display, scene: Scene | None
) -> dict[str, Any]:
    """Return the display's dots and the chart's end for a data sheet's sensor of a pitch, where
    nobody set them.

    `dots` are the columns of pixels on the die, 8 to 2048. The CSF chart ends at `max_lp_per_mm` on
    the sensor, the least of the Nyquist frequencies of sensor and display and the cut-off of the
    lens in green light; `limited_by` names it. Values that the user set, or that do not apply, are
    left out. `with_view` completes settings with the view.

    camera : of the window that is simulated
    scene : None for a picture from another program

    Raises PixsimError if not one pixel fits on the die.
    """
    has_fixed_size = display.raster == "fixed_size"
    columns = pixels_along(camera.die_um[1], pitch_um)
    dots = min(max(columns, _ALLOWED_DOTS[0]), _ALLOWED_DOTS[1])
    view: dict[str, Any] = {}
    if has_fixed_size and "dots" not in display.model_fields_set:
        view["dots"] = dots
    else:
        dots = display.dots
    if scene is None or not scene.shows_csf or MAX_LP_PER_MM in scene.parameters:
        return view

    limits = {
        "the sensor's Nyquist frequency": 1e3 / (2 * pitch_um),
        "the lens's cut-off": float(cutoff_cy_per_mm(GREEN_NM, camera.effective_f_number)),
    }
    if has_fixed_size:
        limits["the display's Nyquist frequency"] = dots / (2 * camera.die_mm)
    limited_by = min(limits, key=lambda name: limits[name])
    lowest = MIN_FREQUENCY_LP_PER_MM * DIE_MM / camera.die_mm
    view[MAX_LP_PER_MM] = max(limits[limited_by], 2**_MIN_OCTAVES * lowest)
    view["limited_by"] = limited_by
    return view


def with_view(settings: _ChosenSettings, view: Mapping[str, Any]) -> _ChosenSettings:
    """Return settings with the display and the chart of `choose_view`, where they do not state
    them.
    """
    display = settings.display
    scene = settings.scene
    if "dots" in view and "dots" not in display.model_fields_set:
        display = display.model_copy(update={"dots": view["dots"]})
    if MAX_LP_PER_MM in view:
        parameters = {MAX_LP_PER_MM: view[MAX_LP_PER_MM]} | scene.parameters
        scene = scene.model_copy(update={"parameters": parameters})
    return settings.model_copy(update={"display": display, "scene": scene})


def scene_with_view(scene: Scene, view: Mapping[str, Any]) -> Scene:
    """Return a scene with the chart of `choose_view`."""
    if MAX_LP_PER_MM not in view:
        return scene
    return scene.with_parameters(**{MAX_LP_PER_MM: repr(view[MAX_LP_PER_MM])})


def _source_with_view(
    source: Scene | SpectralImage, view: Mapping[str, Any]
) -> Scene | SpectralImage:
    """Return a scene with the chart of `choose_view`; light without a scene as it is."""
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


def _max_pixel_count(camera: Camera, sheet_pitch_um: float | None) -> float:
    """Return the largest number of pixels that a study chooses by itself.

    For a data sheet they take 1 GiB while a frame is simulated, or are as many as its sensor has;
    for a technology they are as many as pixsim simulates.

    sheet_pitch_um : pitch of the data sheet, or None for a technology
    """
    if sheet_pitch_um is None:
        return MAX_PIXELS
    sensor_pixels = math.prod(pixels_on(camera.die_um, sheet_pitch_um))
    return min(max(MAX_FRAME_BYTES / BYTES_PER_PIXEL, sensor_pixels), MAX_PIXELS)


def fitted_range(study: Study, camera: Camera) -> Study:
    """Return a study with a range of pixel sizes that a frame can hold.

    A range that is left open begins at a quarter of the data sheet's pitch, or where the fill
    factor is `min_fill_factor`, and ends at four times the pitch. It is shortened, with a warning,
    where there would be too many pixels or too few, and where a stack allows no microlens.

    Raises PixsimError if a pixel size that was set makes too many pixels.
    """
    pitch = study.pitch
    if pitch.values_um is not None:
        smallest_um = min(pitch.values_um)
        counts = [side_um / smallest_um for side_um in camera.die_um]
        check_pixel_count(counts, smallest_um, "pitch.values_um")
        return study

    low_um, high_um = study.open_range_um
    high_um = _largest_size_um(study, camera, high_um)
    if pitch.min_um is None:
        low_um = _smallest_size_um(study, camera, low_um)
    else:
        counts = [side_um / pitch.min_um for side_um in camera.die_um]
        check_pixel_count(counts, pitch.min_um, "pitch.min_um")

    if study.own_um is None and low_um == pitch.min_um:
        return study
    ends = {} if low_um is None else {"min_um": low_um}
    fields = pitch.model_dump(exclude_unset=True) | ends | {"max_um": high_um}
    return study.model_copy(update={"pitch": PitchRange.model_validate(fields)})


def _largest_size_um(study: Study, camera: Camera, high_um: float) -> float:
    """Return the largest pixel size of a range, with a warning if it is smaller than stated, or if
    a stack allows no microlens there.

    high_um : of `Study.open_range_um`
    """
    if study.own_um is not None and "max_um" not in study.pitch.model_fields_set:
        stated_um = high_um
        high_um = min(high_um, max(min(camera.die_um) / _MIN_ACROSS, study.own_um))
        if high_um < stated_um:
            reason = f"a larger one leaves fewer than {_MIN_ACROSS} on the die"
            warn(_range_note("largest pixel size", high_um, stated_um, reason))

    for name in study.technologies:
        lens_um = largest_lens_um(study, name)
        if lens_um < high_um:
            reason = (
                "its stack is too low for a wider ideal microlens (h < p/√π); larger ones:"
                " pixel.stack.height_um, or pixel.stack.microlens = 'none'"
            )
            size = f"largest pixel size of {label_of(name)}"
            warn(_range_note(size, lens_um, high_um, reason))
    return high_um


def _smallest_size_um(study: Study, camera: Camera, low_um: float | None) -> float | None:
    """Return the smallest pixel size of a range that is left open, with a warning if a frame cannot
    hold smaller ones, or None where it follows from the fill factor.

    low_um : of `Study.open_range_um`

    Raises PixsimError if one of several technologies would have too many pixels.
    """
    if low_um is None:
        sizes_um = [float(study_pitches_um(study, name).min()) for name in study.technologies]
    else:
        sizes_um = [low_um]
        low_um = _up_to_pitch_digits(low_um)

    die_um2 = math.prod(camera.die_um)
    max_pixels = _max_pixel_count(camera, study.own_um)
    min_um = _up_to_pitch_digits(math.sqrt(die_um2 / max_pixels))
    smallest_um = min(sizes_um)
    if smallest_um >= min_um - 10**-PITCH_DIGITS:
        return low_um

    if len(sizes_um) > 1:
        name = study.technologies[sizes_um.index(smallest_um)]
        pixels = amount(die_um2 / smallest_um**2)
        raise invalid(
            "pitch.min_fill_factor",
            f"{smallest_um:.4g} µm of {name}: {pixels} pixels",
            f"at most {amount(max_pixels)} pixels",
            f"Set --pitch.min-um {min_um:g}, or --window.",
        )
    reason = (
        f"it has {amount(max_pixels)} pixels on the die; for smaller ones, set --pitch.min-um, or"
        f" --window for a part of the die"
    )
    warn(_range_note("smallest pixel size", min_um, smallest_um, reason))
    return min_um


def _range_note(size: str, pitch_um: float, stated_um: float, reason: str) -> Note:
    """Return a note that a pixel size of a range is not as stated."""
    words = f"the {size} is {pitch_um:.4g} µm in place of {stated_um:.4g} µm: {reason}"
    return Note("left_out", words=words)


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

    study : without axes
    """
    for technology in study.technologies:
        pitches_um = study_pitches_um(study, technology).tolist()
        process = technology_of(study, technology)
        # The quantities of a pixel grow or fall with its pitch: sizes between two possible ones
        # are possible.
        try:
            smallest = physics_of(study, technology, pitches_um[0], process)
            physics_of(study, technology, pitches_um[-1], process)
        except PixsimError:
            # The message is about the first impossible size.
            for pitch_um in pitches_um:
                physics_of(study, technology, pitch_um, process)
            raise
        Readout.of(smallest, study.exposure)  # raises for a burst whose sum has too many bits

    first = sum(sum(sensors.values()) for sensors in first_sampling(study).values())
    if study.max_evaluations is not None and study.max_evaluations < first:
        raise invalid(
            "max_evaluations",
            study.max_evaluations,
            f"at least {first}, with which the study starts",
            "Raise it, or lower repeats or pitch.count.",
        )


def file_of_scene(settings: Run) -> str:
    """Return the file of the scene of a run. Raises PixsimError if none is stated."""
    if settings.scene.file is None:
        names = ", ".join(packaged_scenes())
        allowed = f"an XML file, one of {names}, or a settings file whose [scene] has a file"
        raise invalid("scene", "none", allowed)
    return settings.scene.file


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

    display : if its white is that of a diffuser, the scene renders such a plate, too

    Raises PixsimError as `pixsim.load_scene`.
    """
    scene = replace(
        load_scene(file, variant=variant, sensor=sensor, **parameters),
        diffuser=display.white == "diffuser",
    )
    return scene.with_resolution(resolution) if resolution else scene


def warn_of_default_sensor(
    scene: Scene, cameras: Iterable[CameraOptions], pixel: Pixel | None = None
) -> None:
    """Warn of the die and the pixel that a scene of the user has because nobody states them.

    cameras : options of each camera
    pixel : None where the command states the pixels
    """
    if scene.is_packaged:
        return
    defaults = []
    if all(options.die_mm is None for options in cameras):
        defaults.append(f"a die of {Camera().die_mm:g} mm ({setting('camera.die_mm')})")
    if pixel is not None and not pixel.is_stated:
        size = f"{pixel.pitch_um:g} µm in {pixel.technology}"
        defaults.append(f"a pixel of {size} ({setting('pixel.pitch_um')})")
    if defaults:
        words = f"assumed, as in the paper: {' and '.join(defaults)}"
        warn(Note("assumed", words=words))


_GIVEN_LIGHT = "(given light)"  # in place of a scene's file
# Settings of a render, which light that is given does not have.
_SCENE_SETTINGS = (
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
    """Raise PixsimError for settings of a scene beside light that is given."""
    names = [name for name, value in settings.items() if value]
    if names:
        raise invalid(names[0], "a value together with light", "one of the two")


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
    scene_paths = [".".join(path) for path in varied if path[0] in _SCENE_SETTINGS]
    if scene_paths:
        raise invalid(
            "axis",
            f"{scene_paths[0]} in {where}",
            "settings of pixel, exposure, display, correction and development",
        )

    stated = {
        "window_mm": study.window_mm,
        "tolerance_delta_e": study.tolerance_delta_e,
        "variant": variant,
        "paper": study.paper or None,
    }
    names = [name for name, value in stated.items() if value is not None]
    if names:
        raise invalid(names[0], f"a value in {where}", "a study of a scene, or no value")
    return study.model_copy(update={"scene": StudyScene(file=_GIVEN_LIGHT), "resolution": None})


@dataclass(frozen=True)
class _Sources:
    """Sources of the light of a study's cases: scenes, each loaded once, or light that is given.

    variant : of Mitsuba
    light : in place of a scene's
    scenes : hash of the settings of a scene -> the scene
    """

    variant: str | None
    light: SpectralImage | None
    scenes: dict[str, Scene] = field(default_factory=dict)

    def of(self, study: Study) -> tuple[Scene | SpectralImage, Camera]:
        """Return the scene or the light of a study, and its camera. Raises PixsimError for invalid
        input.
        """
        if self.light is not None:
            return self.light, camera_of_light(self.light, study.camera, study.lens)
        scene = self._scene(study)
        return scene, scene.camera(study.camera, study.lens).window(study.window_mm)

    def _scene(self, study: Study) -> Scene:
        file = study.scene.file
        if file == _GIVEN_LIGHT:
            allowed = "a scene, or pixsim.study(…, light=…)"
            raise invalid("scene.file", "light that was given in Python", allowed)
        if is_picture(file):
            hint = f"In Python: pixsim.study(…, light=pixsim.read_irradiance('{file}'))."
            raise invalid("scene.file", f"'{file}', a picture", "a Mitsuba scene", hint)

        scene = study.scene.model_dump(mode="json")
        key = content_hash([scene, study.resolution, study.display.white])
        if key not in self.scenes:
            self.scenes[key] = loaded_scene(
                file, study.scene.parameters, study.resolution, study.display, variant=self.variant
            )
        return self.scenes[key]


@dataclass(frozen=True, eq=False, kw_only=True)
class Job(Generic[Settings]):
    """A command that is ready to run: its settings, and its cases, resolved and checked.

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
        first_cases: dict[object, Case[Settings]] = {}
        for case in self.cases:
            first_cases.setdefault(case.group, case)
        return tuple(first_cases.values())

    @property
    def evaluations(self) -> int:
        """Number of evaluations that the cases start with."""
        return sum(
            point_count(count, displays=1 + len(case.further_displays))
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
    if light is not None:
        light = light.identified
        study = with_given_light(study, variant)
    metrics = metrics_of(study).chosen
    check_axis_names(study, (DELTA_E, *metrics))
    if not metrics[0].has_optimum:
        got = f"'{metrics[0].name}' first, which has no best pixel size"
        raise invalid("metrics", got, "another metric first, as delta_e")

    # Display and chart are chosen for the study without its axes, so that all of its cases are
    # comparable.
    sources = _Sources(variant, light)
    base_study = _without_axes(study) if study.has_cases else study
    source, camera = sources.of(base_study)
    view = _chosen_view(base_study, source, camera)

    cases = cases_of(study)
    if isinstance(source, Scene):
        warn_of_default_sensor(source, [case.settings.camera for case in cases])
    complete: list[Case[Study]] = []
    for case in cases:
        with named((case.words or BASE) if study.has_cases else ""):
            complete.append(_complete_case(case, base_study, view, sources, background))
    _warn_of_settings_without_effect(cases, complete)
    _warn_of_unequal_margins(complete)

    sensors: list[Case[Study]] = []
    for case, complete_case in zip(cases, complete, strict=True):
        for sensor in cases_of_sensors(complete_case):
            displays = _further_displays(sensor, case.settings.display)
            sensors.append(replace(sensor, further_displays=displays))
    warn_of_reviews((label_of(case.sensor), case, None) for case in sensors)

    settings = complete[0].settings
    if study.has_cases:
        # settings.toml cannot state the end of a chart that not all cases have: it is chosen again.
        has_one_chart = all(_same_chart(case.settings, base_study) for case in complete)
        settings = with_view(study, view if has_one_chart else _without_chart(view))
    return Job(
        cases=tuple(sensors),
        stated=stated,
        complete=settings,
        file=study.scene.file,
        source=_source_with_view(source, view),
        view=view,
        variant=variant,
    )


def _complete_case(
    case: Case[Study],
    base_study: Study,
    view: Mapping[str, Any],
    sources: _Sources,
    background: SpectralImage | None,
) -> Case[Study]:
    """Return a case with complete settings, its source and its camera, after all checks.

    base_study : the study without its axes
    view : display and chart that are chosen for it
    """
    settings = case.settings
    shows_chart = _same_chart(settings, base_study) or shows_csf(sources.of(settings)[0])
    complete = with_view(settings, view if shows_chart else _without_chart(view))
    check_technologies(complete)
    source, camera = sources.of(complete)
    complete = fitted_range(complete, camera)
    return _checked(replace(case, settings=complete), source, camera, background)


def _further_displays(case: Case[Study], stated: Display) -> tuple[Display, ...]:
    """Return further displays for the frames of a data sheet's sensor, whose display is unknown.

    stated : the display, as the user states it
    """
    study = case.settings
    imaging = case.imaging
    if study.own_um is None or imaging is None or imaging.border_um is None:
        return ()
    return further_displays(
        stated, imaging.display, case.camera.die_um, imaging.pixel.pitch_um, imaging.border_um
    )


def cases_of_sensors(combination: Case[Study]) -> Iterator[Case[Study]]:
    """Yield a case for each technology and data sheet of a study without axes."""
    study = combination.settings
    camera = combination.camera
    caches_frames = frames_fit_in_cache(study, camera)
    for name in study.technologies:
        pitches_um = study_pitches_um(study, name).tolist()
        imaging = imaging_of(study, camera, name, pitches_um[-1])
        yield replace(
            combination,
            sensor=name,
            imaging=imaging.changed(
                in_float32=allows_float32(study.tolerance_delta_e),
                metrics=metrics_of(study, study.repeats),
            ),
            # The name of the technology, not its path, which is no part of a result.
            stream=(study.stream_name, study.seed, imaging.physics.technology.name),
            sizes=dict.fromkeys(pitches_um, study.repeats),
            caches_frames=caches_frames,
        )


def _warn_of_unequal_margins(cases: Sequence[Case[Study]]) -> None:
    """Warn if motion leaves a wider margin of the frame unscored in one case than in another."""
    margins_um = {
        border_on_um(case.settings, case.camera) - case.settings.border_um for case in cases
    }
    if len(margins_um) > 1:
        warn(Note("unequal_margins", margin_um=math.ceil(max(margins_um))))


def _warn_of_settings_without_effect(
    stated: Sequence[Case[Study]], complete: Sequence[Case[Study]]
) -> None:
    """Warn of the settings that have no effect in any case of a study, or in any case of one of its
    technologies.

    stated : the cases as the user states them
    complete : the same, with what the user left open
    """
    technologies = list(
        dict.fromkeys(name for case in stated for name in case.settings.technologies)
    )
    tried = [(stated[number], complete[number]) for number in cases_to_try(stated)]
    labels = labels_of(technologies)
    warn_of_settings_without_effect(
        {
            label: _tried_settings(tried, name)
            for name, label in zip(technologies, labels, strict=True)
        }
    )


def _tried_settings(
    cases: Sequence[tuple[Case[Study], Case[Study]]], technology: str
) -> Iterator[_SizeSettings]:
    """Yield the settings of one technology in the cases that have it, each stated and complete."""
    for stated, complete in cases:
        if technology in stated.settings.technologies:
            yield from settings_of_technology(stated, complete, technology)


def _same_chart(first: Study, second: Study) -> bool:
    """Return whether two studies show the same scene with the same chart."""
    if first.scene.file != second.scene.file:
        return False
    return first.scene.parameters.get("chart") == second.scene.parameters.get("chart")


def _without_axes(study: Study) -> Study:
    """Return a study without its axes and conditions.

    Of an axis over technologies, the first one becomes the technology of the study.
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
    """Return the light without the target beside light that is given: `background`, or the light of
    a file that the settings name.

    source : scene, or light that is given
    units : of light in files that do not state them
    names : of the pixels, for messages

    Raises PixsimError for a metric that is unknown, or not defined for one of the pixels or for the
    source.
    """
    request = metrics_of(settings)
    if isinstance(source, SpectralImage):
        background = _background_of_light(settings, source, background, units)
        has_background = background is not None
        has_distance = _states_distance(settings, source)
    else:
        has_background = _scene_has_background(settings, source)
        has_distance = True

    for number, pixel in enumerate(pixels):
        with named(names[number] if names else ""):
            request.check(
                MetricContext(pixel.colour is not None, has_background, has_distance=has_distance)
            )
    return None if background is None else background.identified


def _background_of_light(
    settings: Setting, light: SpectralImage, background: SpectralImage | None, units: str | None
) -> SpectralImage | None:
    """Return the light without the target for light that is given, read from a file if the settings
    name one.
    """
    options = settings.metric.detectability
    name = setting("metric.detectability.without")
    if background is not None and "without" in options.model_fields_set:
        reason = "the light without the target is given together with the light"
        warn(Note("not_used", setting=name, reason=reason))
    file = options.without if isinstance(options.without, str) else ""
    if background is None and is_picture(file) and has_target(settings.metrics):
        with named(name):
            background, _ = read_with_camera(file, settings.camera, units, settings.lens)
    if background is not None:
        check_background(background, light)
    return background


def _states_distance(settings: Setting, light: SpectralImage) -> bool:
    """Return whether the distance of what given light shows is stated."""
    distances = settings.camera.object_distance_m, settings.metric.niirs.ground_distance_m
    return any(distance is not None for distance in (*distances, light.header.get("camera")))


def _scene_has_background(settings: Setting, scene: Scene) -> bool:
    """Return whether the settings state a scene without its target. Raises PixsimError if a metric
    needs its file, and there is none.
    """
    stated = settings.metric.detectability.without
    if not isinstance(stated, str):
        return stated.keys() <= scene.names
    if has_target(settings.metrics):
        from pixsim.scene.scene import scene_path

        with named(setting("metric.detectability.without")):
            scene_path(stated)
    return True


def sensor_case(
    case: Case[Run],
    *,
    repeats: int = 1,
    border_um: float | None = None,
    units: str | None = None,
    request: MetricRequest | None = None,
    **imaging_fields: bool,
) -> Case[Run]:
    """Return the case of one sensor with its imaging and sizes, after the checks that all commands
    share.

    case : with its complete settings, its source and its camera
    repeats : number of sensors of the kind
    border_um : width that is not scored. None takes the border of its pixels, with room for what
        moves
    units : of light in files that do not state them
    request : metrics. None takes ΔE and the metrics of the settings
    imaging_fields : further fields of `Imaging`, such as `is_run`

    Raises PixsimError for metrics that are not defined for the pixel, and if the die has too many
    pixels, or too few dots.
    """
    run = case.settings
    die_um = case.camera.die_um
    pitch_um = run.pixel.pitch_um
    background = check_metrics(run, [run.pixel], case.source, case.background, units)
    imaging = Imaging.of(run, case.camera)
    imaging.physics  # noqa: B018 – raises an error for a pitch that its technology does not allow
    check_pixel_count(pixels_on(die_um, pitch_um), pitch_um)
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
    """Return a case with its source and camera. Raises PixsimError for pixel sizes that are not
    possible.

    case : with complete settings
    background : light without the target, beside light that is given
    """
    study = case.settings
    pixels = [study.options_of(name) for name in study.technologies]
    background = check_metrics(study, pixels, source, background)
    check_pitches(study)
    for technology in study.technologies:
        largest_um = float(study_pitches_um(study, technology).max())
        dot_edges_um(camera.die_um, largest_um, study.display, border_on_um(study, camera))
    return replace(case, resolved=(source, camera), background=background)
