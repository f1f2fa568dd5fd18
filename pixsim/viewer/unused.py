"""Settings that nothing uses in this configuration: one table of rules for every command, and the notes that follow from it.

A setting that decides nothing says so, since its user may rely on it. The rules stand here, not beside the code that takes other
values in their place. Only values that could tell count: a default holds anyway, and 0 of what is not there is right. A limit that
is not reached, such as a longest exposure time, is met and not unused. What contradicts another setting is an error of the records.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from pixsim.base.notes import warn
from pixsim.base.records import Record
from pixsim.light.spectral import HIGH_NM, SpectralImage
from pixsim.optics.camera import OF_DIE, Camera, CameraOptions
from pixsim.optics.lens_options import LensOptions
from pixsim.sensor.colour_options import binned_cell, efficiencies_of
from pixsim.sensor.correction_options import Correction
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.motion_options import STILL, Motion
from pixsim.sensor.pixel import PixelPhysics, derive
from pixsim.sensor.pixel_options import ABSOLUTE_ZERO_C, NO_TECHNOLOGY, SCALED_WITH_AREA, PixelOptions
from pixsim.sensor.stack_options import StackOptions
from pixsim.sensor.technology import load_technology
from pixsim.viewer.develop_options import Develop
from pixsim.viewer.display_options import Display
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.metric_options import METRIC_OPTIONS, OF_TARGETS, MetricOptions, has_target
from pixsim.viewer.setting import Effort, Run, Setting

WITHIN = 1e-6  # relative, of lengths and temperatures that are equal but for rounding
NO_LENS = LensOptions()
CUT_STEPS = 1001  # wavelengths at which a response beyond the infrared cut is looked for


@dataclass(frozen=True)
class Configuration:
    """Settings that hold together, as the user gave them, and the pixel that follows from them.

    command : the run or the study, whose fields above all tables these are; None for a call with records
    light : of a picture, with bands and a size of its own; None for light that is rendered
    lens_of : the sensor whose lens this one has in a comparison; empty for its own
    is_compared : whether it is one of a comparison's
    metrics, metric : names of the metrics that judge, and their settings, of a call with records
    own_rules : of a command that takes other settings than a run; None for those of runs
    """

    physics: PixelPhysics
    pixel: PixelOptions
    exposure: Exposure
    correction: Correction
    develop: Develop
    display: Display
    camera: Camera | CameraOptions
    lens: LensOptions = NO_LENS
    command: Effort | None = None
    light: SpectralImage | None = field(default=None, repr=False)
    lens_of: str = ""
    is_compared: bool = False
    metrics: tuple[str, ...] = ()
    metric: MetricOptions = METRIC_OPTIONS
    motion: Motion = STILL
    own_rules: tuple[Rule, ...] | None = None

    @classmethod
    def of(cls, run: Run) -> Configuration:
        """Return that of a run."""
        physics = derive(run.pixel, load_technology(run.pixel.technology))
        own = run.exposure, run.correction, run.develop, run.display, run.camera, run.lens
        return cls(physics, run.pixel, *own, run, motion=run.motion)

    @classmethod
    def of_imaging(cls, imaging: Imaging, light: SpectralImage) -> Configuration:
        """Return that of a call with records, in light that is given."""
        return cls(
            imaging.physics,
            imaging.pixel,
            imaging.exposure,
            imaging.correction,
            imaging.develop,
            imaging.display,
            imaging.camera,
            imaging.camera.lens_options,
            light=light,
            metrics=imaging.metrics.names,
            metric=imaging.metrics.options,
            motion=imaging.motion,
        )

    @property
    def rules(self) -> tuple[Rule, ...]:
        """The rules on its settings."""
        return RULES if self.own_rules is None else self.own_rules

    @property
    def tables(self) -> dict[str, Record]:
        """Its tables by their names."""
        return {name: getattr(self, name) for name in TABLES}

    @property
    def judges(self) -> tuple[tuple[str, ...], MetricOptions]:
        """Names of the metrics that judge, and their settings."""
        command = self.command
        return (command.metrics, command.metric) if isinstance(command, Setting) else (self.metrics, self.metric)

    @property
    def process(self) -> str:
        """Name of the technology, for messages."""
        return "a data sheet" if self.from_sheet else self.physics.technology.name

    @property
    def from_sheet(self) -> bool:
        """Whether a data sheet states the pixel, without a technology."""
        return self.physics.technology.name == NO_TECHNOLOGY

    @property
    def changed(self) -> list[str]:
        """Dotted names of the settings that were set to another value than 0, their default, and that of the technology."""
        above = changed_of(self.command, "", but=[*self.tables]) if self.command else changed_of(self.metric, "metric.")
        same = [f"pixel.{name}" for name, value in self.pixel if value == getattr(self.physics.technology, name, None)]
        found = [*above, *(name for table, record in self.tables.items() for name in changed_of(record, f"{table}."))]
        return [name for name in found if name not in same]


TABLES = "camera", "lens", "pixel", "exposure", "motion", "correction", "develop", "display"


def changed_of(record: Record, prefix: str, but: Sequence[str] = ()) -> Iterator[str]:
    """Yield the names, after a prefix, of fields set to another value than 0 and their default, also in records inside."""
    for name, info in type(record).model_fields.items():
        value = getattr(record, name)
        if name not in record.model_fields_set or name in but or (value == 0 and value is not False):
            continue
        # Pydantic 2.10 asks for the data, which no factory of a record takes.
        if value != info.get_default(call_default_factory=True, validated_data={}):
            yield prefix + name
            if isinstance(value, Record):
                yield from changed_of(value, f"{prefix}{name}.")


class Rule(NamedTuple):
    """Settings by their dotted names, and why nothing uses them in a configuration: an empty text where something does."""

    settings: tuple[str, ...]
    why: Callable[[Configuration], str]


def of_channels(c: Configuration) -> str:
    """What states the quantum efficiency in place of the pixel's own and of the technology's curve."""
    stated = next((name for name in ("sensitivities", "quantum_efficiencies") if getattr(c.pixel.colour, name, None)), "")
    return f"pixel.colour.{stated} states what every channel sees" if stated else ""


def of_response(c: Configuration) -> str:
    if c.pixel.quantum_efficiency is not None:
        return of_channels(c) or "pixel.quantum_efficiency stands in place of the technology's curve"
    has_none = c.physics.technology.response_curve != "hp_mosis"
    return of_channels(c) or (f"it is about the response file of 3T technologies, not of {c.process}" if has_none else "")


def of_absorption(c: Configuration) -> str:
    if isinstance(c.pixel.quantum_efficiency, tuple):
        return "pixel.quantum_efficiency is a table, which states every wavelength"
    if c.pixel.quantum_efficiency is None:
        return of_channels(c) or "pixel.quantum_efficiency is not given"
    return of_channels(c)


def of_absorption_depth(c: Configuration) -> str:
    flat = "pixel.quantum_efficiency holds at every wavelength without the one of its measurement (pixel.quantum_efficiency_nm)"
    return of_absorption(c) or ("" if c.pixel.quantum_efficiency_nm else flat)


def of_measurement(c: Configuration) -> str:
    if c.physics.stack is None:
        return "it matters to pixels with a stack (pixel.stack) only"
    return "" if c.physics.efficiency_f_number else "the efficiency is that of the photodiode (pixel.quantum_efficiency_includes)"


def of_infrared_cut(c: Configuration) -> str:
    longest_nm = HIGH_NM if c.light is None else float((c.light.wavelength_nm + c.light.band_width_nm / 2).max())
    cut_nm = c.physics.infrared_cut_nm
    if cut_nm >= longest_nm:
        return f"the light ends at {longest_nm:g} nm"
    uncut = replace(c.physics, pixel=c.physics.pixel.model_copy(update={"infrared_cut_nm": None}))
    sees = uncut.quantum_efficiency(np.linspace(cut_nm, longest_nm, CUT_STEPS)).any()
    return "" if sees else "the pixel responds to no longer light anyway"


def of_fill_factor_law(c: Configuration) -> str:
    if c.from_sheet:
        return "it is about CMOS processes, and a data sheet has none"
    return "" if c.pixel.fill_factor is None else "pixel.fill_factor states the fill factor"


def of_data_sheet_pitch(c: Configuration) -> str:
    scaled = any(getattr(c.pixel, name) is not None for name in SCALED_WITH_AREA)
    sees = c.pixel.quantum_efficiency is not None or efficiencies_of(c.pixel.colour)
    return "" if scaled or (sees and c.physics.stack) else f"nothing is given that scales from it: {', '.join(SCALED_WITH_AREA)}"


def of_dark_current(c: Configuration) -> str:
    return "" if c.physics.dark_current_e_per_s else "the dark current is 0"


def of_doubling(c: Configuration) -> str:
    given = c.pixel.dark_current
    above_k = 0.0 if given is None else c.pixel.temperature_k + ABSOLUTE_ZERO_C - given.at_c
    same = abs(above_k) < WITHIN * c.pixel.temperature_k
    return of_dark_current(c) or ("the dark current was measured at pixel.temperature_k" if same else "")


def of_temperature(c: Configuration) -> str:
    turns_forward = c.physics.diode is not None and c.pixel.well_limit == "diode"
    diffuses = c.physics.charge is not None and c.physics.charge.diffusion_um is not None
    if c.physics.reset_noise_e or turns_forward or diffuses:
        return ""
    if c.physics.dark_current_e_per_s and c.pixel.dark_current_e_per_s is not None:
        return "pixel.dark_current_e_per_s holds at every temperature; pixel.dark_current = { e_per_s, at_c } follows it"
    return of_dark_current(c)


def of_capacitance(c: Configuration) -> str:
    by_voltage = c.pixel.well_limit == "diode" or c.pixel.conversion == "junction"
    of_follower = c.physics.technology.a_vt_mv_um if c.pixel.offset_fpn is None and c.pixel.dsnu_e is None else None
    given_well = c.pixel.full_well_e is not None or c.pixel.saturation_capacity_e is not None
    used = by_voltage or not given_well or c.physics.reset_noise_e or c.pixel.a_vt_mv_um is not None or of_follower is not None
    return "" if used else "the full well is given, and there is no reset noise"


def of_stack(c: Configuration) -> str:
    return "" if c.physics.stack else "the pixel has no stack (pixel.stack)"


def of_no_stack(c: Configuration) -> str:
    own = c.pixel.stack.model_dump(exclude_none=True, exclude={"enabled"}) if c.pixel.stack else {}
    return of_stack(c) if not own and c.physics.technology.stack == StackOptions() else ""


def of_chief_rays(c: Configuration) -> str:
    rows = c.camera.chief_ray_angle
    if c.physics.stack or rows is None or getattr(c.camera, "lens", None):  # those of a real lens are not the user's
        return ""
    if len(rows[0]) < 3:
        return "pixels without a stack (pixel.stack) see light from every direction alike"
    return of_fall_off(c)


def of_fall_off(c: Configuration) -> str:
    return "the picture has its fall-off already" if c.light is not None and "camera" not in c.light.header else ""


def of_outside(c: Configuration) -> str:
    return "" if c.lens.veiling_glare else "lens.veiling_glare is 0"


def of_die(c: Configuration, axis: int) -> str:
    """Of the height (axis 0) or the width of the die: a picture has its own, of which a die may show a part."""
    given_mm = (c.camera.die_height_mm, c.camera.die_mm)[axis]
    if c.light is None or "camera" in c.light.header or given_mm is None or getattr(c.camera, "lens", None):
        return ""  # a real lens is scaled and focused for the die
    picture_mm = 1e-3 * c.light.shape[axis] * c.light.pitch_um
    is_part = given_mm < picture_mm and c.camera.die_height_mm is not None
    return "" if is_part or abs(given_mm / picture_mm - 1) < WITHIN else f"the picture is {picture_mm:.6g} mm {DIRECTIONS[axis]}"


DIRECTIONS = "high", "wide"


def of_colour(c: Configuration) -> str:
    return "" if c.pixel.colour else "the pixels have no colour filters (pixel.colour)"


def of_mosaic(c: Configuration) -> str:
    return of_colour(c) or ("stacked pixels have every channel" if c.pixel.colour and c.pixel.colour.is_stacked else "")


def of_quad(c: Configuration) -> str:
    colour = c.pixel.colour
    if colour is None or colour.is_stacked:
        return of_mosaic(c)
    return "" if binned_cell(colour.cell) else "what is read has no unit cell of 2 x 2 equal pixels, as quad_rggb without binning"


def of_denoise(c: Configuration) -> str:
    if c.develop.denoise == "none":
        return "develop.denoise is 'none'"
    return "'wiener_bound' knows the noise, and has no strength" if c.develop.denoise == "wiener_bound" else ""


def of_shading(c: Configuration) -> str:
    return of_stack(c) or ("flat frames (correction.flat_frames) remove the shading" if c.correction.flat_frames else "")


def of_tolerance(c: Configuration) -> str:
    chosen = c.command is not None and c.command.tolerance_delta_e is not None
    return "tolerance_delta_e limits the noise of the render in its place" if chosen else ""


def of_metric(c: Configuration, name: str) -> str:
    """Of the settings of a metric, by its name."""
    return "" if name in c.judges[0] else f"{name} is not among the metrics"


def of_target(c: Configuration) -> str:
    return "" if has_target(c.judges[0]) else f"neither {' nor '.join(OF_TARGETS)} is among the metrics"


def of_without(c: Configuration) -> str:
    return of_target(c) or ("" if c.command else "the light of the scene without its target is given (without=…)")


def of_line_time(c: Configuration) -> str:
    if c.exposure.shutter == "global":
        return "it is about exposure.shutter = 'rolling'"
    return of_shutter(c)


def of_shutter(c: Configuration) -> str:
    return "" if c.motion.is_on or c.exposure.flickers else "nothing moves, and the light is steady"


def of_flicker(c: Configuration) -> str:
    return "" if c.exposure.flickers else f"exposure.flicker_{'hz is not given' if c.exposure.flicker_hz is None else 'depth is 0'}"


def of_plane(c: Configuration) -> str:
    return "" if any(c.motion.velocity_mm_per_s or ()) else "it is about motion.velocity_mm_per_s"


def of_registrations(c: Configuration) -> str:
    centred = "with display.raster = 'one_to_one' the array is centred" if c.display.raster == "one_to_one" else ""
    return of_target(c) or centred


def of_one_run(c: Configuration) -> str:
    axis = "only a run looks for it; a study has an axis over scene.parameters, and the contrast factor of every pixel size"
    return of_metric(c, "detectability") or ("" if isinstance(c.command, Run) and not c.is_compared else axis)


def of_natural_spectrum(c: Configuration) -> str:
    natural = c.judges[1].information.spectrum == "natural"
    return of_metric(c, "information") or ("" if natural else "the spectrum is that of the scene (metric.information.spectrum)")


def fields_of(table: str, record: type[Record], *but: str) -> tuple[str, ...]:
    """Return the dotted names of a record's fields, but some."""
    return tuple(f"{table}.{name}" for name in record.model_fields if name not in but)


TAIL = "pixel.hot_pixel_median", "pixel.hot_pixel_spread"
RULES = (
    Rule(("pixel.quantum_efficiency",), of_channels),
    Rule(("pixel.quantum_efficiency_nm",), of_absorption),
    Rule(("pixel.quantum_efficiency_depth_um",), of_absorption_depth),
    Rule(("pixel.response",), of_response),
    Rule(("pixel.quantum_efficiency_includes",), lambda c: "" if c.physics.stack else of_measurement(c)),
    Rule(("pixel.quantum_efficiency_f_number", "pixel.quantum_efficiency_pitch_um"), of_measurement),
    Rule(("pixel.infrared_cut_nm",), of_infrared_cut),
    Rule(("pixel.fill_factor_law",), of_fill_factor_law),
    Rule(("pixel.data_sheet_pitch_um",), of_data_sheet_pitch),
    Rule(("pixel.dsnu", "pixel.hot_pixel_fraction", *TAIL, "pixel.dark_current.at_c"), of_dark_current),
    Rule(TAIL, lambda c: "" if c.physics.hot_pixel_fraction else "pixel.hot_pixel_fraction is 0"),
    Rule(("pixel.dark_current.doubling_k",), of_doubling),
    Rule(("pixel.temperature_k",), of_temperature),
    Rule(("pixel.reset_noise_factor",), lambda c: "" if c.physics.diode else f"{c.process} has no reset noise"),
    Rule(("pixel.capacitance",), of_capacitance),
    Rule(
        ("pixel.conversion",),
        lambda c: "the capacitance is the same at every voltage" if c.physics.diode and c.physics.diode.constant else "",
    ),
    Rule(("pixel.stack.enabled",), of_no_stack),
    Rule(fields_of("pixel.stack", StackOptions, "enabled"), lambda c: "" if c.physics.stack else "pixel.stack.enabled is false"),
    Rule(("camera.chief_ray_angle",), of_chief_rays),
    Rule(("lens.relative_illumination",), of_fall_off),
    Rule(("lens.veiling_glare_outside",), of_outside),
    Rule(("camera.die_height_mm",), lambda c: of_die(c, 0)),
    Rule(("camera.die_mm",), lambda c: of_die(c, 1)),
    Rule(
        (*fields_of("camera", CameraOptions, *OF_DIE), *fields_of("lens", LensOptions)),
        lambda c: f"all sensors have the lens of {c.lens_of} (--match)" if c.lens_of else "",
    ),
    Rule(
        ("exposure.max_integration_s", "exposure.well_target"),
        lambda c: "exposure.integration_s states the time" if c.exposure.integration_s else "",
    ),
    Rule(("exposure.shutter",), of_shutter),
    Rule(("exposure.line_time_us",), of_line_time),
    Rule(("exposure.flicker_hz", "exposure.flicker_phase_deg"), of_flicker),
    Rule(("exposure.flicker_depth",), lambda c: of_flicker(c) if c.exposure.flicker_hz is None else ""),
    Rule(("motion.distance_m",), of_plane),
    Rule(("motion.margin_um",), lambda c: "" if c.motion.is_on else "nothing moves"),
    Rule(("exposure.frame_time",), lambda c: "" if c.exposure.frames > 1 else "exposure.frames is 1"),
    Rule(("correction.flat_level",), lambda c: "" if c.correction.flat_frames else "correction.flat_frames is 0"),
    Rule(("develop.white_balance", "develop.matrix"), of_colour),
    Rule(("develop.demosaic",), of_mosaic),
    Rule(("develop.remosaic",), of_quad),
    Rule(("develop.denoise",), lambda c: "" if c.develop.denoises else "develop.denoise_strength is 0"),
    Rule(("develop.denoise_strength",), of_denoise),
    Rule(
        ("develop.sharpen_radius_px", "develop.sharpen_radius_cy_per_deg"),
        lambda c: "" if c.develop.sharpens else "develop.sharpen_amount is 0",
    ),
    Rule(("develop.tone_gamma",), lambda c: "" if c.develop.tone_curve == "gamma" else "develop.tone_curve is not 'gamma'"),
    Rule(("develop.tone_white",), lambda c: "" if c.develop.tone_curve == "reinhard" else "develop.tone_curve is not 'reinhard'"),
    Rule(("display.adaptation",), of_colour),
    Rule(
        ("display.white_cd_per_m2",), lambda c: "display.white_w_per_m2_sr states the white" if c.display.white_w_per_m2_sr else ""
    ),
    Rule(("display.diffuser_reflectance",), lambda c: "" if c.display.white else "display.white is not 'diffuser'"),
    Rule(
        ("display.dots", "display.interpolation"),
        lambda c: "with display.raster = 'one_to_one' dots are pixels" if c.display.raster == "one_to_one" else "",
    ),
    Rule(("display.shading_correction",), of_shading),
    Rule(
        ("tolerance_e", "render_noise", "max_seconds"),
        lambda c: "" if c.light is None else "the light of a picture is not rendered",
    ),
    Rule(("render_noise",), of_tolerance),
    Rule(("noise_budget",), lambda c: "a comparison has none; pixsim run tells that of each sensor" if c.is_compared else ""),
    Rule(("metric.information.contrast", "metric.information.corner_cy_per_mm"), of_natural_spectrum),
    Rule(("metric.detectability.without",), of_without),
    Rule(("metric.detectability.registrations",), of_registrations),
    Rule(("metric.detectability.solve_for",), of_one_run),
    *(
        Rule(fields_of(f"metric.{name}", type(options), "without", "registrations", "solve_for"), partial(of_metric, name=name))
        for name, options in METRIC_OPTIONS
    ),
)


def unused_settings(configuration: Configuration) -> dict[str, str]:
    """Return the settings that were changed and that nothing uses, by dotted name, and why.

    >>> run = Run(exposure=Exposure(integration_s=0.01, well_target=0.5))
    >>> unused_settings(Configuration.of(run))
    {'exposure.well_target': 'exposure.integration_s states the time'}
    """
    changed = configuration.changed
    found: dict[str, str] = {}
    for rule in configuration.rules:
        if (names := [name for name in rule.settings if name in changed]) and (why := rule.why(configuration)):
            found |= {name: why for name in names if name not in found}
    return found


def unused_notes(sensors: Mapping[str, Sequence[Configuration]]) -> list[str]:
    """Return a sentence for each reason why settings are not used; it names the sensors, unless all of them have it.

    sensors : name -> its configurations, such as the cases of a study; what one of them uses is used
    """
    notes: dict[str, list[str]] = {}
    for label, configurations in sensors.items():
        unused = unused_settings(configurations[0])
        for other in configurations[1:]:
            if not unused:  # of thousands of cases the first ones tell
                break
            of_other = unused_settings(other)
            unused = {name: why for name, why in unused.items() if name in of_other}
        by_reason: dict[str, list[str]] = {}
        for name, why in unused.items():
            by_reason.setdefault(why, []).append(name)
        for why, names in by_reason.items():
            notes.setdefault(f"{', '.join(names)} {'is' if len(names) == 1 else 'are'} not used: {why}", []).append(label)
    return [text if len(labels) == len(sensors) else f"{', '.join(labels)}: {text}" for text, labels in notes.items()]


def warn_of_unused_settings(sensors: Mapping[str, Sequence[Configuration]]) -> None:
    """Warn of each of the `unused_notes`, on behalf of the public function that calls this one."""
    for text in unused_notes(sensors):
        warn(text)
