"""Settings without effect: one rule for every command, and a table of those settings that the rule
does not cover.

A setting does nothing if the mean frame, its closed-form variance, the ideal picture and the
metrics that were asked for are the same at its default, on one small light in which no pixel is
full. The small light stands on a sensor of a few hundred pixels; the camera is scaled with its die,
so that every part of the field is in the picture.

The small light is so faint that an automatic exposure comes close to its longest time, where dark
charge, motion and flicker are largest. It stands behind a thin lens: what the file of a real one
leaves open is judged where the file is read.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple, TypeVar, get_args, get_origin

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.errors import PixsimError
from pixsim.base.lazy import cached_property
from pixsim.base.notes import Note, suppressed_warnings, warn
from pixsim.base.records import Record
from pixsim.light.spectral import HIGH_NM, LOW_NM, SpectralImage
from pixsim.optics.lens_options import ANY_LENS_FIELDS
from pixsim.sensor.correction import residual_variance_e2
from pixsim.sensor.integration import (
    ChannelLight,
    array_size_um,
    collecting_area_um2,
    electrons_per_joule,
    lights_of,
)
from pixsim.sensor.motion_options import Motion
from pixsim.sensor.photodiode import stored_signal_e
from pixsim.sensor.pixel import PixelPhysics
from pixsim.sensor.pixel_options import NO_TECHNOLOGY
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import Frame, integration_time_s
from pixsim.sensor.technology import load_technology
from pixsim.viewer import display as displays
from pixsim.viewer.chain import ImagingChain, make_chain
from pixsim.viewer.dark_clip import dark_clip
from pixsim.viewer.frame_under_test import FrameUnderTest
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.metric_options import has_target
from pixsim.viewer.metrics import Metric, NoNumberError
from pixsim.viewer.raw_metrics import DETECTABILITY
from pixsim.viewer.scene_light import PreparedScene, SceneLight, prepare_scene
from pixsim.viewer.screen import HEADER_OF_WHITE, amount_of_white, white_field
from pixsim.viewer.setting import Setting

# Of the smallest difference that a result resolves: the scatter of a frame, a code of the display.
RESOLVED = 1e-3
# Relative: 1e-3 of the last of the four digits that are shown.
_METRIC_DIGITS = 1e-6

# Across the small light; they do not divide each other, so that places of pixels count.
PIXELS = 20
SAMPLES = 24
MIN_ASPECT, MAX_ASPECT = 0.5, 2.0  # of the small light
DOTS = 16  # of the display across it
BAND_NM = 40.0
_WHITE_OVER_LIGHT = 1.1  # so that no dot of the ideal picture is brighter than display white
_NO_WHITE: dict[str, float | None] = dict.fromkeys(("white", *HEADER_OF_WHITE))
# Of the longest time of an automatic exposure: no whole number of periods of lamps, and below it.
_PART_OF_LONGEST = (math.sqrt(5) - 1) / 2
# Of what dark charge leaves, of the brightest pixel.
_PART_OF_WELL = 0.5
_MIN_PART_OF_WELL = 0.1
STREAM = ("small light",)

_MAX_CACHED_NOTES = 256  # of calls with records
_SAME_LENGTH = 1e-6  # relative, of lengths that are equal but for rounding
_QUICK_MATRIX = "least_squares"  # in place of the default one, which takes a quarter of a second
SOLVE_FOR = "metric.detectability.solve_for"  # for commands of one frame
TABLES = "camera", "lens", "pixel", "exposure", "motion", "correction", "develop", "display"


# --- names of settings


def changed_settings(record: Record, prefix: str = "", but: Sequence[str] = ()) -> Iterator[str]:
    """Yield the dotted names of fields that were set to another value than their default, also in
    records inside.

    A value of 0 is the absence of what it states, and no such setting.

    prefix : of the names, with its dot
    but : names of fields that are left out
    """
    for name, info in type(record).model_fields.items():
        value = getattr(record, name)
        is_absent = value == 0 and value is not False
        if name not in record.model_fields_set or name in but or is_absent:
            continue
        # Pydantic 2.10 asks for the data, which no factory of a record takes.
        if value != info.get_default(call_default_factory=True, validated_data={}):
            yield prefix + name
            if isinstance(value, Record):
                yield from changed_settings(value, f"{prefix}{name}.")


def field_names(table: str, record: type[Record], *but: str) -> tuple[str, ...]:
    """Return the dotted names of a record's fields, but some."""
    return tuple(f"{table}.{name}" for name in record.model_fields if name not in but)


_RecordKind = TypeVar("_RecordKind", bound=Record)


class Default:
    """Stands for the value of a setting that is left out."""


def record_with(record: _RecordKind, path: Sequence[str], value: object) -> _RecordKind:
    """Return a record with another value of one of its fields, or of a record inside.

    value : `Default` leaves the field out, and a record inside with its last field

    Raises PixsimError if the others are refused with it.
    """
    name, *inner = path
    fields = {other: getattr(record, other) for other in record.model_fields_set}
    if value is Default and name not in fields:
        return record

    if inner and not (value is Default and fields[name].model_fields_set == {*inner}):
        value = record_with(fields[name], inner, value)
    fields[name] = value
    return type(record)(
        **{other: stated for other, stated in fields.items() if stated is not Default}
    )


def _imaging_with(imaging: Imaging, name: str, value: object) -> Imaging:
    """Return an imaging with another value of a setting by its dotted name, as `record_with`."""
    table, *path = name.split(".")
    if table == "metric":
        options = record_with(imaging.metrics.options, path, value)
        return imaging.changed(metrics=replace(imaging.metrics, options=options))
    if table == "lens":
        table = "camera"
        path = [ANY_LENS_FIELDS[path[0]]]
    imaging = imaging.changed(**{table: record_with(getattr(imaging, table), path, value)})
    if name == "pixel.technology":
        imaging = imaging.changed(technology=load_technology(imaging.pixel.technology))
    return imaging


def _allowed_words(annotation: object) -> Iterator[object]:
    """Yield the words that a type allows."""
    if get_origin(annotation) is Literal:
        yield from get_args(annotation)
    else:
        for part in get_args(annotation):
            yield from _allowed_words(part)


# --- the small light


@dataclass(frozen=True)
class _SmallLight:
    """A picture with an edge, a ramp and a coloured patch on a few hundred pixels of a sensor.

    light : with the target, and the white
    background : the same without the target
    imaging : the settings for which it was made
    scale : (height, width) of the small light over the picture's
    white : fields of a display that state its white
    """

    light: SpectralImage
    background: SpectralImage
    imaging: Imaging
    scale: tuple[float, float]
    white: dict[str, float | None]
    _lights: dict[object, tuple[ChannelLight, ...]] = field(
        default_factory=dict, init=False, repr=False
    )
    _prepared: dict[object, PreparedScene] = field(default_factory=dict, init=False, repr=False)

    @classmethod
    def of(cls, imaging: Imaging, picture: SpectralImage | None = None) -> _SmallLight:
        """Return the small light for settings.

        picture : light of the user, whose bands it has, or None for light that is rendered
        """
        camera = imaging.camera
        size_um = camera.die_um if picture is None else displays.picture_size_um(picture)
        aspect = min(max(size_um[0] / size_um[1], MIN_ASPECT), MAX_ASPECT)
        width_um = PIXELS * imaging.physics.read_pitch_um
        sample_um = width_um / SAMPLES
        rows = round(aspect * SAMPLES)
        scale = rows * sample_um / size_um[0], width_um / size_um[1]

        header: dict[str, Any] = {}
        if picture is None or "camera" in picture.header:
            header["camera"] = camera.model_dump()
        if picture is not None and "diffraction" in picture.header:
            header["diffraction"] = picture.header["diffraction"]
        if picture is None:
            count = int((HIGH_NM - LOW_NM) / BAND_NM)
            centre_nm = HIGH_NM - BAND_NM * (np.arange(count, 0, -1) - 0.5)
            width_nm = np.full(count, BAND_NM)
        else:
            centre_nm = picture.wavelength_nm
            width_nm = picture.band_width_nm

        # Two spectra, each with a picture of its own.
        spectra = np.stack([600 / centre_nm, centre_nm / 600])
        target_planes, background_planes = _pictures(rows)

        def light(planes: tuple[Array, Array], brightness: float) -> SpectralImage:
            factors = brightness * spectra, np.stack(planes).astype(np.float32)
            return SpectralImage(centre_nm, width_nm, sample_um, factors=factors, header=header)

        # The brightness is known once the camera has seen light of unit brightness.
        unit = light(target_planes, 1.0)
        small = cls(unit, unit, imaging, scale, dict(_NO_WHITE))
        brightness = small._brightness(small.seen(imaging))
        small = replace(
            small,
            light=light(target_planes, brightness),
            background=light(background_planes, brightness),
        )
        return replace(small, white=small._white(small.seen(imaging)))

    def _brightness(self, imaging: Imaging) -> float:
        """Return by what the light is multiplied so that no pixel is full, and automatic exposures
        are long.
        """
        readout = imaging.readout
        exposure = imaging.exposure
        assert self.light.factors is not None
        spectrum = self.light.factors[0].mean(axis=0)
        electrons = []
        for channel in imaging.physics.channels:
            rate = float((electrons_per_joule(channel, self.light) * spectrum).sum())
            electrons.append(rate * collecting_area_um2(self.light, imaging.camera, channel))
        unit_light_e_per_s = 1e-12 * max(electrons) * readout.bin_side**2
        if not unit_light_e_per_s > 0:  # pixels that see nothing of it are refused elsewhere
            return 1.0

        dark_e_per_s = readout.dark_current_e_per_s
        if exposure.integration_s is None:
            well_e = exposure.well_target * readout.saturation_e
            time_s = _PART_OF_LONGEST * exposure.times * exposure.max_integration_s
            if exposure.flicker_hz is not None:  # in many periods lamps are steady
                time_s = min(time_s, _PART_OF_LONGEST / exposure.flicker_hz)
            if dark_e_per_s * time_s > _PART_OF_WELL * well_e:
                time_s = _PART_OF_WELL * well_e / dark_e_per_s
        else:
            well_e = _PART_OF_WELL * readout.saturation_e
            time_s = exposure.times * exposure.integration_s
        light_e = max(well_e - dark_e_per_s * time_s, _MIN_PART_OF_WELL * well_e)
        return light_e / time_s / unit_light_e_per_s

    def _white(self, imaging: Imaging) -> dict[str, float | None]:
        """Return the fields of a display that state a white above all of the light."""
        largest = float(amount_of_white(imaging, self.light).max())
        return _NO_WHITE | {white_field(self.light): _WHITE_OVER_LIGHT * largest}

    def seen(self, imaging: Imaging) -> Imaging:
        """Return settings for the small light: the camera scaled with its die, few dots, and the
        white in its unit.
        """
        down, across = self.scale
        camera = imaging.camera
        changes: dict[str, Any] = {"lens": None}
        for name in ("focal_length_mm", "object_distance_m", "die_mm"):
            changes[name] = across * getattr(camera, name)
        if camera.die_height_mm is not None:
            changes["die_height_mm"] = down * camera.die_height_mm
        for name in ("chief_ray_angle", "fall_off"):
            rows = getattr(camera, name)
            changes[name] = rows and tuple((across * row[0], *row[1:]) for row in rows)

        develop = imaging.develop
        if "matrix" not in self.imaging.develop.model_fields_set:
            develop = develop.model_copy(update={"matrix": _QUICK_MATRIX})
        display = imaging.display.model_copy(update={"dots": DOTS, **self.white})
        motion = Motion(image_um_per_s=imaging.um_per_s) if imaging.motion.is_on else imaging.motion
        return imaging.changed(
            camera=camera.model_copy(update=changes),
            develop=develop,
            display=display,
            motion=motion,
            border_um=imaging.physics.border_um,
            in_float32=False,
            is_run=False,
        )

    def _lens_key(self, imaging: Imaging) -> tuple[object, ...]:
        """Return a key for all that the light behind the lens depends on."""
        physics = imaging.physics
        electrons = [
            electrons_per_joule(channel, self.light).tobytes() for channel in physics.channels
        ]
        charge = physics.charge.content_hash if physics.charge else ""
        return imaging.camera.model_dump_json(), repr(imaging.pixel.stack), charge, tuple(electrons)

    def behind_lens(self, imaging: Imaging) -> tuple[ChannelLight, ...]:
        """Return the light behind the lens, as each channel sees it."""
        key = self._lens_key(imaging)
        if key not in self._lights:
            self._lights[key] = lights_of(self.light, imaging.camera, imaging.physics)
        return self._lights[key]

    def prepared(self, imaging: Imaging) -> PreparedScene:
        """Return the light behind the lens, and the ideal picture."""
        physics = imaging.physics
        develop = imaging.develop
        metrics = imaging.metrics
        pixels = str(physics.layout), physics.read_pitch_um, physics.border_um, physics.registration
        tone = develop.tone_curve, develop.tone_gamma, develop.tone_white
        key = (
            *self._lens_key(imaging),
            pixels,
            imaging.display.model_dump_json(),
            tone,
            metrics.chosen,
            metrics.needs_light,
        )
        if key not in self._prepared:
            background = self.background if has_target(metrics.names) else None
            self._prepared[key] = prepare_scene(
                imaging, SceneLight(self.light, background), lights=self.behind_lens(imaging)
            )
        return self._prepared[key]


def _pictures(rows: int) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Return the planes of both spectra, (rows, SAMPLES) each, with and without the target.

    From left to right: black, a ramp, and behind a slanted edge white. The target is a square on
    the ramp, of one spectrum alone.
    """
    y = ((np.arange(rows) + 0.5) / rows)[:, None]
    x = ((np.arange(SAMPLES) + 0.5) / SAMPLES)[None]
    ramp = np.clip((x - 0.15) / 0.6, 0.0, 1.0) * np.ones((rows, 1)) * 0.6
    ramp[x > 0.7 + 0.1 * (y - 0.5)] = 1.0

    # The share of the first spectrum is another in the upper and in the lower half.
    share = np.where(y < 0.5, 0.4, 0.6) * np.ones((1, SAMPLES))
    background = share * ramp, (1 - share) * ramp
    is_target = (np.abs(x - 0.5) < 0.12) & (np.abs(y - 0.5) < 0.2)
    with_target = np.where(is_target, ramp, background[0]), np.where(is_target, 0.0, background[1])
    return with_target, background


# --- the rule


class _Trial:
    """Results of settings in the small light, each computed on first use."""

    def __init__(self, small: _SmallLight, imaging: Imaging, base: _Trial | None = None) -> None:
        self.small = small
        self.base = base or self
        self.imaging = small.seen(imaging)

    @property
    def physics(self) -> PixelPhysics:
        return self.imaging.physics

    @cached_property
    def prepared(self) -> PreparedScene:
        """The small light behind the lens, and the ideal picture."""
        return self.small.prepared(self.imaging)

    @cached_property
    def chain(self) -> ImagingChain:
        return make_chain(self.imaging, self.prepared, room_is_checked=True)

    @cached_property
    def frame(self) -> Frame:
        return self.chain.capture(*STREAM)

    @property
    def readout(self) -> Readout:
        """How the pixel is read."""
        return self.imaging.readout

    @cached_property
    def mean_e(self) -> Array:
        """Mean charge of light and dark as the well and its conversion hold it, (rows, columns)."""
        if self.base is self:
            frame = self.frame
        else:  # no frame depends on the screen
            array_um = array_size_um(self.small.light, self.imaging.camera)
            prepared = replace(
                self.base.prepared, lights=self.small.behind_lens(self.imaging), array_um=array_um
            )
            frame = make_chain(self.imaging, prepared, room_is_checked=True).capture(*STREAM)
        count = frame.exposures
        charge_e = (frame.mean_e + frame.mean_dark_e) / count
        if self.readout.readings:
            return np.minimum(count * charge_e, self.readout.saturation_e)
        return count * stored_signal_e(charge_e, frame.integration_s / count, self.readout)

    @cached_property
    def time_s(self) -> float:
        """Integration time of a frame of the base's light."""
        return integration_time_s(
            self.imaging.exposure, self.readout, float(self.base.chain.signal_e_per_s.max())
        )

    def variance_e2(self, light_e: Array) -> Array:
        """Return the variance of a corrected pixel over frames and sensors, in the shape (...) of
        the mean charge of light.
        """
        return np.asarray(
            residual_variance_e2(light_e, self.time_s, self.readout, self.imaging.correction).total
        )

    @property
    def end_e(self) -> Array:
        """Charge at which a frame ends."""
        return np.array(self.readout.saturation_e)

    @cached_property
    def clipped_e(self) -> Array:
        """What clipping at code 0 adds to the mean of a dark frame."""
        return np.array(dark_clip(self.readout, self.time_s, white_e=1.0)["too_bright_e"])

    def metric_values(self, metric: Metric, frame: Frame) -> Array:
        """Return the numbers of a metric of a frame, (n,); NaN where it has none."""
        under_test = FrameUnderTest.of(self.chain, frame, stream=STREAM)
        try:
            values = metric.values(under_test if metric.needs_frame else under_test.score)
        except NoNumberError:
            return np.full(len(metric.columns), np.nan)
        return np.array(list(values.values()))


def _has_effect(base: _Trial, other: _Trial) -> bool:
    """Return whether two settings give the small light another frame, noise, ideal picture or
    metric.

    Each part is compared by itself: the noise at the same mean charge, and the picture of the same
    frame.
    """
    if str(other.physics.layout) != str(base.physics.layout):
        return True
    return (
        _changes_frame(base, other)
        or _changes_picture(base, other)
        or _changes_metrics(base, other)
    )


def _changes_frame(base: _Trial, other: _Trial) -> bool:
    """Return whether the mean frame, its noise, or the ends of its codes differ."""
    light_e = base.frame.mean_e
    variance_e2 = base.variance_e2(light_e)
    scatter_e = np.sqrt(variance_e2)
    least_e = RESOLVED * float(scatter_e.min())
    return (
        _differ(other.variance_e2(light_e), variance_e2, (RESOLVED * scatter_e) ** 2)
        or _differ(other.end_e, base.end_e, least_e)
        or _differ(other.mean_e, base.mean_e, RESOLVED * scatter_e)
        or _differ(other.clipped_e, base.clipped_e, least_e)
    )


def _changes_picture(base: _Trial, other: _Trial) -> bool:
    """Return whether the ideal picture differs, or, for ΔE, the picture of a frame."""
    code = 2.0**-base.imaging.display.bits
    tolerance = RESOLVED * code
    if _differ(other.prepared.screen.ideal, base.prepared.screen.ideal, tolerance):
        return True
    if not any(metric.is_delta_e for metric in base.imaging.metrics.chosen):
        return False

    # The light before a display rounds it, then the picture and its ΔE.
    development = base.chain.development
    other_development = other.chain.development
    frame = base.frame
    if _differ(other_development.light(frame), development.light(frame), tolerance):
        return True
    score = development.score(frame)
    other_score = other_development.score(frame)
    return _differ(other_score.image, score.image, tolerance) or _differ(
        other_score.delta_e, score.delta_e, 100 * RESOLVED * code
    )


def _changes_metrics(base: _Trial, other: _Trial) -> bool:
    """Return whether a metric beside ΔE differs, for the same frame."""
    for metric in base.imaging.metrics.chosen:
        if metric.is_delta_e:
            continue
        values = base.metric_values(metric, base.frame)
        other_values = other.metric_values(metric, base.frame)
        # NaN differs from everything: of a metric without a number nothing is known.
        if _differ(other_values, values, _METRIC_DIGITS * np.abs(values)):
            return True
    return False


def _differ(values: Array, others: Array, tolerance: Array | float) -> bool:
    """Whether arrays have other shapes, or values that differ by more than a tolerance."""
    return values.shape != others.shape or not bool((np.abs(values - others) <= tolerance).all())


# --- settings that the rule does not cover


@dataclass(frozen=True)
class UserSettings:
    """Settings that hold together, and the names of those that the user gave another value than
    their default.

    names : dotted, as `pixel.stack.height_um`
    settings : of the command, or None for a call with records
    picture : light that is given, or None for light that is rendered
    not_taken : names of settings and tables that the command does not take, or that do nothing in
        this one
    makes_frames : whether the command makes the frames of a run, in other light
    """

    imaging: Imaging
    names: tuple[str, ...]
    settings: Setting | None = None
    picture: SpectralImage | None = field(default=None, repr=False)
    not_taken: tuple[str, ...] = ()
    makes_frames: bool = True

    def takes(self, name: str) -> bool | None:
        """Whether the command takes a setting, or None if the frames of a run tell."""
        if any(name == other or name.startswith(f"{other}.") for other in self.not_taken):
            return False
        return None if self.makes_frames else True

    @property
    def is_rendered(self) -> bool:
        """Whether the camera has decided on the light."""
        return self.picture is None or "camera" in self.picture.header

    @classmethod
    def of(cls, imaging: Imaging, tables: Mapping[str, Record], **facts: Any) -> UserSettings:
        """Return the settings of tables, by their names, and the settings of the command above all
        tables.

        facts : further fields
        """
        settings = facts.get("settings")
        picture = facts.get("picture")
        names = [] if settings is None else list(changed_settings(settings, but=tuple(tables)))
        for table, record in tables.items():
            # A complete camera has its lens inside, whose settings have a table of their own, and
            # the die of its pixels.
            inside = ("lens", "pixels", *ANY_LENS_FIELDS.values()) if table == "camera" else ()
            names += changed_settings(record, f"{table}.", but=inside)
        names = [name for name in names if not any(other.startswith(f"{name}.") for other in names)]

        implied = _implied_settings(imaging, picture)
        return cls(imaging, tuple(name for name in names if name not in implied), **facts)

    @classmethod
    def from_records(cls, imaging: Imaging, light: SpectralImage) -> UserSettings:
        """Return the settings of a call with records.

        light : of the user
        """
        tables: dict[str, Record] = {
            table: getattr(imaging, table) for table in TABLES if table != "lens"
        }
        tables |= {"lens": imaging.camera.lens_options, "metric": imaging.metrics.options}
        return cls.of(imaging, tables, picture=light)

    @classmethod
    def from_setting(cls, imaging: Imaging, setting: Setting, **facts: Any) -> UserSettings:
        """Return the settings of a command; `facts` are further fields."""
        tables: dict[str, Record] = {table: getattr(setting, table) for table in TABLES}
        return cls.of(imaging, tables, settings=setting, **facts)

    @cached_property
    def base(self) -> _Trial | None:
        """The trial of the settings, or None where the small light is too small for them."""
        try:
            trial = _Trial(_SmallLight.of(self.imaging, self.picture), self.imaging)
            trial.variance_e2(trial.frame.mean_e)
        except PixsimError:
            return None
        return trial

    def trial_with(self, name: str, value: object) -> _Trial:
        """Return the trial with another value of a setting, by `_imaging_with`. Raises PixsimError
        if it is refused.
        """
        assert self.base is not None
        return _Trial(self.base.small, _imaging_with(self.imaging, name, value), self.base)

    def without_effect(self) -> list[str]:
        """Return the names of the settings that do nothing."""
        with suppressed_warnings(), np.errstate(all="ignore"):
            return [name for name in self.names if not self._acts(name)]

    def _acts(self, name: str) -> bool:
        for row in ROWS:
            if not row.settings or any(
                name == setting or name.startswith(f"{setting}.") for setting in row.settings
            ):
                acts = row.acts(self, name)
                if acts is not None:
                    return acts
        if self.base is None or name.partition(".")[0] not in (*TABLES, "metric"):
            return True
        if self._differs_with(name, Default, when_refused=True):
            return True
        # A default may stand for one of the words of a setting, which acts by the others.
        return any(self._differs_with(name, word, when_refused=False) for word in self._words(name))

    def _differs_with(self, name: str, value: object, *, when_refused: bool) -> bool:
        assert self.base is not None
        try:
            return _has_effect(self.base, self.trial_with(name, value))
        except PixsimError:
            return when_refused

    def _words(self, name: str) -> list[object]:
        """Return the words that a setting may be."""
        table, *path = name.split(".")
        record: Any = getattr(self.imaging, table, self.imaging.camera)
        if table == "metric":
            record = self.imaging.metrics.options
        for part in path[:-1]:
            record = getattr(record, part)
        fields = type(record).model_fields
        return list(_allowed_words(fields[path[-1]].annotation)) if path[-1] in fields else []


def _implied_settings(imaging: Imaging, picture: SpectralImage | None) -> set[str]:
    """Return the names of settings whose values other settings or the light imply anyway."""
    technology = imaging.physics.technology
    names = {
        f"pixel.{name}" for name, value in imaging.pixel if value == getattr(technology, name, None)
    }
    if technology.name == NO_TECHNOLOGY:  # which follows from the numbers of a data sheet
        names.add("pixel.technology")
    if picture is None:
        return names

    height_um, width_um = displays.picture_size_um(picture)
    camera = imaging.camera
    for name, size_um, die_mm in (
        ("camera.die_height_mm", height_um, camera.die_height_mm),
        ("camera.die_mm", width_um, camera.die_mm),
    ):
        if die_mm is not None and math.isclose(die_mm, 1e-3 * size_um, rel_tol=_SAME_LENGTH):
            names.add(name)
    return names


class Row(NamedTuple):
    """A rule for settings that the trial does not cover.

    settings : their names, or names of tables; empty for all settings
    acts : returns whether a setting has an effect in a command, or None to leave it to the trial
    """

    settings: tuple[str, ...]
    acts: Callable[[UserSettings, str], bool | None]


def _motion_acts(case: UserSettings, name: str) -> bool:
    """Motion also decides which part of a frame is scored, however far the picture moves."""
    motion = case.imaging.motion
    return any(motion.velocity_mm_per_s or ()) if name == "motion.distance_m" else motion.is_on


def _lens_decides(case: UserSettings, name: str) -> bool | None:
    """Settings of a real lens and its camera are reviewed where its file is read."""
    table, field_name, *_ = name.split(".")
    if table == "camera":
        is_of_file = case.imaging.camera.lens is not None
    else:
        is_of_file = field_name not in ANY_LENS_FIELDS
    return is_of_file or None


def _effort_acts(case: UserSettings, name: str) -> bool:
    """Settings of the effort act where light is rendered."""
    return case.picture is None


def _render_depends(case: UserSettings, name: str) -> bool | None:
    """A render depends on field, focus, brightness and fall-off."""
    has_fall_off = (
        name != "camera.chief_ray_angle" or case.imaging.camera.relative_illumination is not None
    )
    return (case.is_rendered and has_fall_off) or None


_CAMERA_OF_RENDER = (
    "focal_length_mm",
    "f_number",
    "die_mm",
    "die_height_mm",
    "object_distance_m",
    "transmittance",
    "chief_ray_angle",
)
ROWS = (
    # The small light is that of a run: other commands have no such frame, or do not take all
    # settings.
    Row((), lambda case, name: case.takes(name)),
    # The small light is seen through a thin lens, that of the user's settings.
    Row(("camera", "lens"), _lens_decides),
    # The small light is not rendered.
    Row(("tolerance_e", "render_noise", "max_seconds"), _effort_acts),
    Row(
        (*(f"camera.{name}" for name in _CAMERA_OF_RENDER), "lens.relative_illumination"),
        _render_depends,
    ),
    # The small light has one target, which no parameter states.
    Row(
        ("metric.detectability.without",),
        lambda case, _: has_target(case.imaging.metrics.names) and case.settings is not None,
    ),
    Row((SOLVE_FOR,), lambda case, _: DETECTABILITY.name in case.imaging.metrics.names),
    # The small light is bright enough for a time below the longest one, and has no room for motion.
    Row(
        ("exposure.gain_db", "exposure.max_gain_db"),
        lambda case, _: case.imaging.exposure.gain_db == "auto" or None,
    ),
    Row(
        ("exposure.max_integration_s",),
        lambda case, _: case.imaging.exposure.integration_s is None or None,
    ),
    Row(("motion",), _motion_acts),
    # The small light has a fixed, small number of dots and few pixels, perhaps none of them hot.
    Row(
        ("display.diffuser_reflectance",), lambda case, _: case.imaging.display.white == "diffuser"
    ),
    # The small light states its own white.
    Row(tuple(f"display.{name}" for name in _NO_WHITE), lambda case, _: True),
    Row(("display.dots",), lambda case, _: case.imaging.display.raster == "fixed_size"),
    Row(("correction.defects",), lambda case, _: True),
)


# --- notes


def effect_notes(sensors: Mapping[str, Iterable[UserSettings]]) -> list[Note]:
    """Return notes that name the settings without effect, and the sensors, unless it is all
    sensors.

    sensors : name -> the settings of each of its cases; what has an effect in one of them has one
    """
    sensors_by_name: dict[str, list[str]] = {}
    for label, cases in sensors.items():
        for name in _without_effect_in_all(cases):
            sensors_by_name.setdefault(name, []).append(label)

    # Settings of the same sensors share a note.
    names_by_sensors: dict[tuple[str, ...], list[str]] = {}
    for name, labels in sensors_by_name.items():
        names_by_sensors.setdefault(tuple(labels), []).append(name)
    notes = []
    for labels_together, names in names_by_sensors.items():
        verb = "changes" if len(names) == 1 else "change"
        note = Note("no_effect", words=f"{', '.join(names)} {verb} nothing here")
        is_of_all = len(labels_together) == len(sensors)
        notes.append(note if is_of_all else note.of(labels_together))
    return notes


def _without_effect_in_all(cases: Iterable[UserSettings]) -> list[str]:
    """Return the names of settings that do nothing in any of the cases; none of no case."""
    names: list[str] | None = None
    for case in cases:
        if names is not None:
            case = replace(case, names=tuple(name for name in names if name in case.names))
        names = case.without_effect()
        if not names:
            break
    return names or []


def warn_of_settings(imaging: Imaging, light: SpectralImage) -> None:
    """Warn of the settings without effect of a call with records; equal settings are tried once."""
    tables = [getattr(imaging, table) for table in TABLES if table != "lens"]
    records = [record.model_dump_json() for record in (*tables, imaging.metrics.options)]
    metrics = [(metric.name, metric.code) for metric in imaging.metrics.chosen]
    bands = light.wavelength_nm.tobytes(), light.band_width_nm.tobytes()
    header = [repr(light.header.get(name)) for name in ("camera", "diffraction")]
    key = (*records, *metrics, *bands, light.shape, light.pitch_um, *header)
    if key not in _notes:
        while len(_notes) >= _MAX_CACHED_NOTES:
            del _notes[next(iter(_notes))]
        _notes[key] = effect_notes({"": [UserSettings.from_records(imaging, light)]})
    for note in _notes[key]:
        warn(note)


_notes: dict[tuple[object, ...], list[Note]] = {}


def warn_of_settings_without_effect(sensors: Mapping[str, Iterable[UserSettings]]) -> None:
    """Warn of each of the `effect_notes`, on behalf of the public function that calls this one."""
    for note in effect_notes(sensors):
        warn(note)
