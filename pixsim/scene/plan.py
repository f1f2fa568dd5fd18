"""Plan a render: decide what can be left out of it, why, and what error that can cause."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal, NamedTuple

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.bounds import Count, Positive
from pixsim.base.digits import amount, percent, rounded
from pixsim.base.door import checked_methods
from pixsim.base.errors import invalid
from pixsim.base.notes import Note
from pixsim.light.quantities import FilmSamples
from pixsim.light.spectral import (
    LAMP,
    WHITE_LAMPS,
    WHITE_OF_PLATE,
    Span,
    Spectrum,
    colour_matching,
    photons_per_joule,
    photopic_efficiency,
    white_description,
)
from pixsim.optics.camera import Camera
from pixsim.optics.camera_lens import Tiling, rendered_camera, without_lens
from pixsim.optics.camera_light import camera_factor, camera_pupil
from pixsim.optics.lens_defocus import depth_of_field_m, finite_or_none
from pixsim.optics.quantities import AnyDistance
from pixsim.scene import bands as spectral_bands, film, rules, white_plate
from pixsim.scene.bands import Bands, Detector, Fit
from pixsim.scene.contents import Lamp, Surfaces
from pixsim.scene.film import GREEN_NM
from pixsim.scene.inspection import Inspection, inspect_scene
from pixsim.scene.real_lens import decide_real_lens, out_of_focus, real_lens_warnings
from pixsim.scene.rules import TEXTURE_SAMPLES, TOLERANCE_E, Chart, Decision
from pixsim.scene.scene import RESOLUTION, SAMPLES_PER_CELL, Scene
from pixsim.scene.white_plate import plate_distance_m, plate_transform
from pixsim.sensor.collection import check_efficiency, half_sizes_um, scale_error, stack_shares
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.integration import pixels_on
from pixsim.sensor.photodiode import LINEAR_WITHIN, linear_limit_e
from pixsim.sensor.pixel import PixelPhysics, derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.quantities import Pitch
from pixsim.sensor.reading import Readout
from pixsim.sensor.spectral_range import (
    NOTED_SHARE,
    outside_header,
    outside_hint,
    outside_share,
    outside_share_text,
)
from pixsim.sensor.technology import load_technology
from pixsim.viewer.display_options import Display

# Subjects of decisions
STACK = "pixel stack"
FILM = "oversampling"
# Shares of the tolerance: bands alone, and bands with pulses. The rest is for blur and diffraction
# (rules.py).
BANDS_SHARE = 0.25
_SPECTRUM_SHARE = 0.8
_LUMINANCE_TOLERANCE = 5.0  # times the tolerance, for luminance of strongly coloured surfaces
_COLOUR_TOLERANCE = 2.0  # times the tolerance, for a channel of a colour sensor
_MIN_SHARE_OF_WHITE = 0.1  # of the signal of a neutral surface: less of it than that counts as much
_MIN_RENDERS = 4  # a quarter each, which show their noise
# The lens's fall-off is then right to 3e-5 of the mean electrons at 20° off axis.
UNIFORM_RESOLUTION = 64
# Technologies with the two packaged response curves, for a plan without a pixel.
RESPONSES = ("0.35um", "4t-bsi")


@dataclass(frozen=True)
class _FittedLamp:
    """Lamps of one spectrum, and the pulses that measure their light at the lens."""

    lamp: Lamp
    fit: Fit


class WhitePlate(NamedTuple):
    """How a white plate is rendered.

    scene : with the plate
    plan : of the render
    camera : that sees the scene
    distance_m : from the lens to the plate
    """

    scene: Scene
    plan: Plan
    camera: Camera
    distance_m: float

    @property
    def lens(self) -> dict[str, object]:
        """The sensor in Mitsuba that sees nothing but the plate."""
        fov_deg = math.degrees(2 * math.atan(white_plate.HALF_VIEW / (1 - white_plate.BEFORE)))
        return {
            "type": "perspective",
            "fov": fov_deg,
            "near_clip": white_plate.NEAR_CLIP * self.distance_m,
        }


@checked_methods
@dataclass(frozen=True)
class LightPlan:
    """Which light is rendered: its lamps, its bands and its white.

    lamps : one for each lamp spectrum
    bands : of the result
    full_passes : passes over all lamps with nothing left out
    regular_tables : whether tables with equal steps are converted to regular spectra
    held : (node, property, spectrum) of tables of surfaces that go on beyond their ends, as
        `beyond_tables = "hold"` has it
    outside : entry of an irradiance's header on the lamps' light outside 360-830 nm; empty if there
        is none
    white : spectra that add up to the light of the scene's white; none if it is unknown
    white_lamps : ids of the emitters that are it, if the scene names them
    chart_white : entry of an irradiance's header on texel value 1 of an emissive chart; empty for
        other scenes
    plate : how a white plate is rendered beside the scene, if the scene asks for it and is no
        emissive chart
    """

    lamps: tuple[_FittedLamp, ...]
    bands: Bands
    full_passes: int
    regular_tables: bool
    held: tuple[tuple[int, str, Spectrum], ...] = field(default=(), repr=False)
    outside: dict[str, Any] = field(default_factory=dict, repr=False)
    white: tuple[Spectrum, ...] = ()
    white_lamps: tuple[str, ...] = ()
    chart_white: dict[str, float] = field(default_factory=dict)
    plate: WhitePlate | None = field(default=None, repr=False)

    @property
    def passes(self) -> int:
        """Number of passes over all lamps."""
        return sum(len(light.fit.passes) for light in self.lamps)

    @property
    def planes(self) -> int:
        """Number of pictures that a render holds in memory, one for each pulse of each lamp."""
        return sum(len(light.fit.pulses) for light in self.lamps)

    @property
    def factored(self) -> bool:
        """Whether the image is stored as factors: fewer pictures than bands, or spectra with
        negative values.
        """
        return self.planes < self.bands.width_nm.size or any(
            bool(light.fit.spectra.min() < 0) for light in self.lamps
        )

    @property
    def white_name(self) -> str:
        """Name of the light of the scene's white."""
        if self.plate:
            return WHITE_OF_PLATE
        return white_description(bool(self.white), self.white_lamps)

    def white_header(self, edges_nm: Array) -> dict[str, Any]:
        """Return the entries of an irradiance's header on the light of the scene's white, and on
        the lamps' light outside the bands' range.

        edges_nm : (B + 1,) of the bands
        """
        header: dict[str, Any] = {}
        if self.white:
            lamps = [spectrum.cell_means(edges_nm) for spectrum in self.white]
            header[LAMP] = np.sum(lamps, axis=0).tolist()
        if self.white_lamps:
            header[WHITE_LAMPS] = list(self.white_lamps)
        return header | self.outside


@checked_methods
@dataclass(frozen=True)
class FilmPlan:
    """What is computed on the film.

    resolution : samples across that the plan is for, if they differ from the scene's
    chart : an emissive chart that is alone and fills the film, or None
    diffraction : whether diffraction is computed
    tiling : of the blur of a real lens, or None for a thin lens, and where a thin lens takes its
        place
    ends : whether the scene ends with the film, above and below, and at the left and the right:
        there a margin mirrors the film
    in_focus_m : the nearest and the farthest depth at which a point's disc is a pixel wide at most,
        or None without a pixel
    """

    resolution: FilmSamples | None = None
    chart: Chart | None = field(default=None, repr=False)
    diffraction: bool = True
    tiling: Tiling | None = None
    ends: tuple[bool, bool] = (False, False)
    in_focus_m: tuple[AnyDistance, AnyDistance] | None = None

    def camera_of(self, camera: Camera) -> Camera:
        """Return the camera of the render: without its real lens where the plan leaves that out."""
        return without_lens(camera) if self.tiling is None else camera

    def margin(self, shape: tuple[Count, Count], pitch_um: Pitch) -> int:
        """Return the cells at each side of a film that are rendered beyond it, as far as the blur
        of a real lens reaches.

        shape : (H, W) of the film in cells
        pitch_um : of its cells
        """
        if self.tiling is None or not self.tiling.psf_um:
            return 0
        whole = film.BLOCK * math.ceil(self.tiling.cells(pitch_um)[1] // 2 / film.BLOCK)
        return min(whole, min(shape) // 2 // film.BLOCK * film.BLOCK)


@dataclass(frozen=True)
class SamplePlan:
    """How the light of each film cell is sampled.

    lens : "thinlens", or "perspective" if the aperture need not be sampled
    integrator : plugin and its parameters, or None for the scene's
    sampler : plugin of Mitsuba
    spp : samples per film cell in each pass; 0 where `exact`
    full_spp : samples in the scene
    given_spp : whether an option sets `spp`
    exact : whether film cells are computed from the texels of the chart, without samples
    """

    lens: Literal["thinlens", "perspective"]
    integrator: dict[str, Any] | None
    sampler: str
    spp: int
    full_spp: int
    given_spp: bool = False
    exact: bool = False


@dataclass(frozen=True)
class Plan:
    """What will be rendered, and why.

    light, film, samples : which light, on which film, and how it is sampled
    decisions : each with its reason; `bound_e` is the sum of their error bounds
    tolerance_e : relative error of the mean electrons that the plan may cause
    warnings : possible problems of the scene
    full : whether nothing may be left out
    """

    light: LightPlan
    film: FilmPlan
    samples: SamplePlan
    decisions: tuple[Decision, ...]
    tolerance_e: Positive = TOLERANCE_E
    warnings: tuple[Note, ...] = ()
    full: bool = False

    @property
    def most_samples(self) -> int:
        """Limit of the samples of all renders together, in place of a time limit: it does not
        depend on the machine.
        """
        return film.PATH_SAMPLES if self.film.chart is None else film.CHART_SAMPLES

    @property
    def many_bounces(self) -> bool:
        """Whether paths of any length are traced, whose noise is rarely below the
        sensor's.
        """
        return self.samples.integrator is None and self.film.chart is None

    @property
    def cells_in_time(self) -> float:
        """Number of film cells for which the fewest renders, four with the fewest samples, stay
        within `most_samples`.
        """
        if self.samples.exact:
            return math.inf

        min_spp = rules.MIN_PATH_SPP if self.film.chart is None else rules.MIN_CHART_SPP
        if self.samples.given_spp:
            min_spp = self.samples.spp
        return self.most_samples / (min_spp * self.light.passes * _MIN_RENDERS)

    @property
    def bound_e(self) -> float:
        """Bound for the relative error of the mean electrons, summed over all decisions."""
        return sum(decision.bound_e for decision in self.decisions)

    @property
    def spare_e(self) -> float:
        """What the other decisions leave of the tolerance for the pixels' stack; 0 if nothing may
        be left out.

        The film of a scene without detail takes its part where the plan does not choose it.
        """
        others = [decision for decision in self.decisions if decision.subject != STACK]
        has_detail = self.film.chart is None or not self.film.chart.uniform
        chooses_film = any(decision.subject == FILM for decision in others)
        if self.full or not (has_detail or chooses_film):
            return 0.0
        if not all(decision.bounded for decision in others):
            return 0.0
        return max(0.0, self.tolerance_e - sum(decision.bound_e for decision in others))

    @property
    def bounded(self) -> bool:
        """Whether `bound_e` covers all decisions."""
        return all(decision.bounded for decision in self.decisions)

    def as_dict(self) -> dict[str, Any]:
        """Return the plan for `pixsim plan --json`."""
        bands = self.light.bands
        table: dict[str, Any] = {
            "decisions": [asdict(decision) for decision in self.decisions],
            "tolerance_e": self.tolerance_e,
            "bound_e": self.bound_e,
            "bounded": self.bounded,
            "lamp_spectra": len(self.light.lamps),
            "passes": self.light.passes,
            "passes_full": self.light.full_passes,
            "spp": self.samples.spp,
            "spp_full": self.samples.full_spp,
            "resolution": self.film.resolution,
            "diffraction": self.film.diffraction,
            "warnings": list(self.warnings),
            "lens": self.samples.lens,
            "integrator": self.samples.integrator,
            "white_spectrum": self.light.white_name,
        }
        if self.film.in_focus_m is not None:
            table["in_focus_m"] = finite_or_none(self.film.in_focus_m)

        table["wavelength_nm"] = bands.wavelength_nm.tolist()
        table["band_width_nm"] = bands.width_nm.tolist()
        return table

    def __repr__(self) -> str:
        return (
            f"<Plan {self.light.passes} of {self.light.full_passes} passes, {self.samples.spp} of"
            f" {self.samples.full_spp} samples, {self.samples.lens}, error of mean electrons up to"
            f" {self.bound_e:.1e}>"
        )


def make_render_plan(
    scene: Scene,
    camera: Camera | None = None,
    pixel: Pixel | Sequence[Pixel] | None = None,
    *,
    tolerance_e: float = TOLERANCE_E,
    full: bool = False,
    exact: bool = False,
    aperture_um: float | None = None,
) -> Plan:
    """Return the plan of a render, from the parsed tree of a scene.

    Parameters
    ----------
    pixel : the tolerance is for its electrons, or for those in several. None takes the packaged
        response curves
    tolerance_e : relative error of the mean electrons that all decisions together may cause
    full : leave nothing out: every band of every lamp, the scene's integrator, a sampled lens
    exact : whether to compute the film cells of a chart that is alone and in focus, without samples
    aperture_um : side of the smallest photodiode, for which the blur of a real lens is computed,
        or None for the pixel's

    Raises PixsimError if an emitter is negative or not finite, or if the tolerance is not between 0
    and 1.
    """
    if not 0 < tolerance_e < 1:
        allowed = "above 0 and below 1, a relative error of the mean electrons"
        raise invalid("tolerance_e", f"{tolerance_e:g}", allowed)

    options = [pixel] if isinstance(pixel, Pixel) else pixel or []
    pixels = [derive(option, load_technology(option.technology)) for option in options]
    camera = camera or scene.camera()
    tiling, lens_decisions = decide_real_lens(
        scene, camera, pixels[0] if pixels else None, tolerance_e, full, aperture_um
    )

    thin_camera = rendered_camera(camera if tiling else without_lens(camera))
    inspection = inspect_scene(scene, thin_camera, pixels or _packaged_pixels())
    plan = _plan_inspected_scene(
        inspection,
        camera,
        pixels,
        tolerance_e,
        full=full,
        tiling=tiling,
        lens_decisions=lens_decisions,
    )
    if scene.diffuser and not inspection.chart_white:
        plate = _plan_white_plate(inspection, pixels, tolerance_e)
        plan = replace(plan, light=replace(plan.light, plate=plate))
    return _without_samples(plan) if exact and not full else plan


def _packaged_pixels() -> list[PixelPhysics]:
    """Return pixels with the packaged response curves, for a plan without a pixel."""
    return [
        derive(Pixel(technology=name, pitch_um=10.0), load_technology(name)) for name in RESPONSES
    ]


def _plan_white_plate(
    inspection: Inspection, pixels: Sequence[PixelPhysics], tolerance_e: float
) -> WhitePlate:
    """Return how a white plate in a scene is rendered."""
    camera = inspection.camera
    sensor = inspection.sensor
    focus_m = camera.object_distance_m
    distance_m = plate_distance_m(inspection.state, sensor, focus_m)
    scene = replace(
        inspection.scene,
        diffuser=False,
        plate=plate_transform(sensor, distance_m, focus_m),
        resolution=white_plate.RESOLUTION,
        _texts={},
    )

    plate_inspection = inspect_scene(scene, camera, inspection.pixels)
    plan = _plan_inspected_scene(plate_inspection, camera, pixels, tolerance_e)
    samples = replace(
        plan.samples, lens="perspective", spp=white_plate.FIRST_SPP, sampler="multijitter"
    )
    plan = replace(plan, samples=samples, film=replace(plan.film, chart=None))
    return WhitePlate(scene=scene, plan=plan, camera=camera, distance_m=distance_m)


def _plan_inspected_scene(
    inspection: Inspection,
    camera: Camera,
    pixels: Sequence[PixelPhysics],
    tolerance_e: float,
    *,
    full: bool = False,
    tiling: Tiling | None = None,
    lens_decisions: Sequence[Decision] = (),
) -> Plan:
    """Return the plan of an inspected scene, without a white plate.

    camera : with its real lens
    pixels : whose electrons have the tolerance; none where the user states none
    tiling, lens_decisions : from `decide_real_lens`
    """
    scene = inspection.scene
    state = inspection.state
    bodies = inspection.bodies
    thin_camera = inspection.camera
    physics = pixels[0] if pixels else None
    film_camera = camera if tiling else without_lens(camera)

    # Light
    integrator, max_surfaces, bounces = rules.decide_bounces(state, bodies, full)
    lamps, bands, full_passes, spectral = _decide_light(inspection, max_surfaces, tolerance_e, full)
    by_index, tables = rules.decide_tables(state, full)
    passes = sum(len(light.fit.passes) for light in lamps)

    # Lens. What is left out does not change what is in focus.
    lens, focus = rules.decide_lens(
        state, thin_camera, bodies, inspection.aspect, physics, tolerance_e, full
    )
    lens_in_focus = lens
    if full:
        lens_in_focus, _ = rules.decide_lens(
            state, thin_camera, bodies, inspection.aspect, None, tolerance_e, False
        )
    is_in_focus = lens_in_focus == "perspective"

    # Samples. An unfocused chart differs from its picture, and the lens needs samples too.
    chart: Chart | None = None
    if lens == "perspective":
        chart = rules.lone_chart(state, thin_camera, bodies, inspection.shape)
    scene_spp = scene.sample_count(state)
    given_spp = SAMPLES_PER_CELL in scene.parameters
    finer = (inspection.shape[1] / scene.film_size(state)[1]) ** 2
    spp, sampler, samples = rules.decide_samples(chart, scene_spp, passes, full, given_spp, finer)

    # Film
    ends = (False, False)
    if tiling and is_in_focus:
        ends = rules.ends_with_film(state, thin_camera, bodies, inspection.shape)
    film_pitch_um = 1e3 * film_camera.die_mm / inspection.shape[1]
    diffraction = rules.decide_diffraction(
        chart,
        film_camera,
        film_pitch_um,
        tolerance_e,
        full or tiling is not None,
        inspection.span.high_nm,
    )

    # Decisions and warnings
    outside = outside_header(inspection.lamp_spectra, inspection.span)
    decisions = [*spectral, tables, bounces, focus, samples, diffraction, *lens_decisions]
    warnings = [*real_lens_warnings(camera, tiling, tolerance_e), *inspection.warnings]
    if tiling is not None and not is_in_focus:
        decision, note = out_of_focus()
        decisions.append(decision)
        warnings.append(note)
    warnings += _outside_notes(outside, inspection.span, pixels)
    bound_e = sum(decision.bound_e for decision in (*spectral, focus, diffraction))
    warnings += _tolerance_notes(bound_e, tolerance_e)

    held_tables = inspection.surfaces.held.items()
    return Plan(
        light=LightPlan(
            lamps=tuple(lamps),
            bands=bands,
            full_passes=full_passes,
            regular_tables=by_index,
            held=tuple((index, name, table) for (index, name), table in held_tables),
            outside=outside,
            white=inspection.white,
            white_lamps=scene.white_lamps,
            chart_white=inspection.chart_white,
        ),
        film=FilmPlan(
            chart=chart,
            diffraction=diffraction.kept,
            tiling=tiling,
            ends=ends,
            in_focus_m=depth_of_field_m(camera, physics.read_pitch_um) if physics else None,
        ),
        samples=SamplePlan(
            lens=lens,
            integrator=integrator,
            sampler=sampler,
            spp=spp,
            full_spp=scene_spp,
            given_spp=given_spp,
        ),
        decisions=tuple(decisions),
        tolerance_e=tolerance_e,
        warnings=tuple(warnings),
        full=full,
    )


def _outside_notes(
    outside: dict[str, Any], span: Span, pixels: Sequence[PixelPhysics]
) -> list[Note]:
    """Return a note on light outside the range that is computed, if a pixel sees enough of it."""
    share = max((outside_share(outside, pixel) for pixel in pixels), default=0.0)
    if share <= NOTED_SHARE:
        return []
    return [Note("light_left_out", words=outside_share_text(share, span), hint=outside_hint())]


def _tolerance_notes(bound_e: float, tolerance_e: float) -> list[Note]:
    """Return a note where the bound of the error exceeds the tolerance."""
    if bound_e <= tolerance_e:
        return []
    limits = (
        f"bands reach their limit of {spectral_bands.NARROWEST_BAND_NM:g} nm or"
        f" {spectral_bands.MAX_BANDS} bands"
    )
    return [Note("electrons_error", error=bound_e, tolerance=tolerance_e, limits=limits)]


def _without_samples(plan: Plan) -> Plan:
    """Return the plan with film cells that are computed, if it is of a chart in focus that is seen
    straight; else the plan.
    """
    chart = plan.film.chart
    integrator = plan.samples.integrator
    is_seen_straight = integrator is not None and integrator.get("max_depth") == 1
    if chart is None or chart.beyond is None or not is_seen_straight or plan.samples.given_spp:
        return plan

    between = "even over each of its texels" if chart.nearest else "linear between its texels"
    exact = Decision(
        TEXTURE_SAMPLES,
        False,
        f"none: each film cell is the exact mean of the chart, which is {between}",
        f"all {plan.samples.full_spp} samples, and their noise",
    )
    decisions = tuple(
        exact if decision.subject == TEXTURE_SAMPLES else decision for decision in plan.decisions
    )
    return replace(plan, samples=replace(plan.samples, spp=0, exact=True), decisions=decisions)


def _detectors(pixels: Sequence[PixelPhysics]) -> list[Detector]:
    """Return the responses that the bands must reproduce.

    These are electrons per joule of the pixels, and the luminance. For colour sensors they are the
    electrons of each channel, and XYZ.
    """

    def electrons_per_joule(physics: PixelPhysics) -> spectral_bands.Response:
        return lambda nm: physics.quantum_efficiency(nm) * photons_per_joule(nm)

    def observer(number: int) -> spectral_bands.Response:
        return lambda nm: np.asarray(colour_matching(nm)[..., number])

    responses = [electrons_per_joule(channel) for pixel in pixels for channel in pixel.channels]
    if not any(pixel.layout for pixel in pixels):
        return [*map(Detector, responses), Detector(photopic_efficiency, _LUMINANCE_TOLERANCE)]

    channels = [
        Detector(
            response, tolerance_factor=_COLOUR_TOLERANCE, min_share_of_neutral=_MIN_SHARE_OF_WHITE
        )
        for response in responses
    ]
    # X, Y and Z have the tolerance itself: a ColorChecker is then right within 0.04 ΔE under smooth
    # lamps and lines.
    observers = [
        Detector(observer(number), min_share_of_neutral=_MIN_SHARE_OF_WHITE) for number in range(3)
    ]
    return [*channels, *observers]


def _decide_light(
    inspection: Inspection, max_surfaces: int, tolerance_e: float, full: bool
) -> tuple[list[_FittedLamp], Bands, int, list[Decision]]:
    """Return the pulses of each lamp, the bands, the number of passes without leaving out any band,
    and the decisions.

    max_surfaces : that light can meet; -1 for any number
    """
    lamps = inspection.lamps
    surfaces = inspection.surfaces
    detectors = _detectors(inspection.pixels)
    products = surfaces.products(1)[:0]
    if max_surfaces:
        products = surfaces.products(max_surfaces)

    # Bands
    spectra = [lamp.spectrum for lamp in lamps if lamp.spectrum]
    bands = spectral_bands.place_bands(
        spectra, products, detectors, tolerance_e * BANDS_SHARE, surfaces.span
    )

    # Pulses. Where the spectra of all surfaces are known, a few pulses determine all bands.
    has_spectra = surfaces.spectra is not None or max_surfaces == 0
    has_colour = any(physics.pixel.colour for physics in inspection.pixels)
    stiffness = spectral_bands.COLOUR_STIFFNESS if has_colour else spectral_bands.STIFFNESS
    lights = []
    full_passes = 0
    bands_error = 0.0
    for lamp in lamps:
        fit: Fit | None = None
        every_band = spectral_bands.every_band(lamp.spectrum, bands)
        full_passes += len(every_band.passes)
        if lamp.spectrum:
            fine_lamp = spectral_bands.resolved(lamp.spectrum, products, surfaces.span)
            errors = spectral_bands.band_errors(bands, fine_lamp, detectors)
            bands_error = max(bands_error, float(np.abs(errors.sum(axis=2)).max()))
        if lamp.spectrum and has_spectra and not full:
            fit = spectral_bands.fit(
                lamp.spectrum,
                bands,
                products,
                detectors,
                tolerance=tolerance_e * _SPECTRUM_SHARE,
                stiffness=stiffness,
            )
        lights.append(_FittedLamp(lamp, fit or every_band))

    # Decisions
    widths = bands.width_nm
    placing = Decision(
        "wavelength bands",
        True,
        f"{widths.size} bands of {widths.min():g} to {widths.max():g} nm, finer where lamps or"
        " surfaces change",
        bound_e=bands_error,
    )
    passes = sum(len(light.fit.passes) for light in lights)
    # The fit's error includes that of its bands.
    fit_error = max(0.0, max(light.fit.error for light in lights) - bands_error)
    rank = Decision(
        "spectral rank",
        passes >= full_passes,
        _rank_reason(lights, surfaces, full),
        f"{passes} of {full_passes} passes" if passes < full_passes else "",
        bound_e=fit_error,
        bounded=has_spectra and all(lamp.spectrum is not None for lamp in lamps),
    )
    return lights, bands, full_passes, [placing, rank]


def _rank_reason(lights: Sequence[_FittedLamp], surfaces: Surfaces, full: bool) -> str:
    """Return why so many pulses are rendered."""
    pulses = " and ".join(str(len(light.fit.pulses)) for light in lights)
    spectra = "1 lamp spectrum" if len(lights) == 1 else f"{len(lights)} lamp spectra"
    reason = f"{pulses} pulses for {spectra}"
    if full:
        return f"{reason}, since nothing is left out"
    if any(light.lamp.spectrum is None for light in lights):
        return f"{reason}, since the colour of a lamp varies over it"
    if surfaces.spectra is None:
        return f"{reason}, one for each band, because of {surfaces.unknown}"
    count = len(surfaces.spectra)
    return f"{reason} determine all bands of {count} surface spectr{'um' if count == 1 else 'a'}"


def make_plan(
    scene: Scene,
    camera: Camera | None = None,
    pixel: Pixel | None = None,
    *,
    exposure: Exposure | None = None,
    display: Display | None = None,
    tolerance_e: Positive = TOLERANCE_E,
    full: bool = False,
) -> Plan:
    """Plan a simulation: which light is rendered, what can be left out and why, and a bound for the
    error.

    Parameters
    ----------
    scene : from `load_scene`
    camera : None takes the camera of the file
    pixel : None takes the default pixel
    exposure : None takes the default; its longest time sets the charge at which a photodiode
        saturates
    display : chooses a film fine enough for its dots, as `resolution` of the plan. None keeps the
        scene's film
    tolerance_e : relative error of the mean electrons that all decisions together may cause
    full : leave nothing out

    Raises PixsimError if the scene cannot be rendered, or if the pixel is impossible.

    >>> from pixsim import load_scene
    >>> plan = make_plan(load_scene("csf", resolution=64))
    >>> plan.light.passes  # a chart under one lamp: one picture determines all bands
    1
    >>> plan.bound_e < plan.tolerance_e
    True
    """
    camera = camera or scene.camera()
    pixel = pixel or Pixel()
    exposure = exposure or Exposure()
    physics = derive(pixel, load_technology(pixel.technology))
    options: dict[str, Any] = {
        "tolerance_e": tolerance_e,
        "full": full,
        "exact": display is not None,
    }

    # The film does not depend on a real lens's blur.
    plan = make_render_plan(scene, rendered_camera(camera), pixel, **options)
    resolution, sampling = decide_oversampling(scene, plan, camera, physics, display, full)
    if resolution or camera.lens is not None:
        film_scene = scene.with_resolution(resolution) if resolution else scene
        plan = make_render_plan(film_scene, camera, pixel, **options)

    # Of each exposure
    integration_s = exposure.integration_s or exposure.max_integration_s
    longest_s = exposure.times * integration_s / exposure.frames
    saturation = decide_saturation(Readout.of(physics, exposure), longest_s)

    others = (*plan.decisions, sampling)
    plan = replace(
        plan, film=replace(plan.film, resolution=resolution), decisions=(*others, saturation)
    )
    stack = _decide_stack(physics, camera, plan.spare_e, full)
    return replace(plan, decisions=(*others, stack, saturation))


def decide_oversampling(
    scene: Scene,
    plan: Plan,
    camera: Camera,
    physics: PixelPhysics,
    display: Display | None,
    full: bool,
) -> tuple[int | None, Decision]:
    """Choose the film's samples across the die, and describe them. None keeps the scene's film.

    A scene without detail takes a coarser film than the XML's. Every other film has at least two
    samples for each detail that matters on the display, within its limits, if the display is given;
    it is never coarser than the XML's.
    """
    shape = scene.film_shape(camera, scene.for_camera(rendered_camera(camera)))
    height, width = (max(1, side) for side in shape)
    chart = plan.film.chart
    is_uniform = chart is not None and chart.uniform
    is_free = scene.resolution is None

    # A scene without detail
    may_be_coarse = is_free and RESOLUTION not in scene.parameters and not full
    if is_uniform and may_be_coarse and width > UNIFORM_RESOLUTION:
        error = _fall_off_error(camera, UNIFORM_RESOLUTION)
        if plan.bound_e + error <= plan.tolerance_e:
            reason = (
                f"a scene without detail: {UNIFORM_RESOLUTION} samples across resolve the fall-off"
                " of the lens"
            )
            saved = f"{UNIFORM_RESOLUTION}² of {width}² samples"
            return UNIFORM_RESOLUTION, Decision(FILM, False, reason, saved, error)
    if display is None or full or is_uniform:
        return None, Decision(FILM, True, _sampling(camera, physics, width))

    # The finest detail that matters
    details, name = film.details_across(
        camera,
        physics.aperture_side_um,
        display,
        physics.pitch_um,
        chart.details if chart else None,
    )
    needed = film.SAMPLES_PER_DETAIL * details
    widest = film.largest_film(height / width, plan.light.planes, plan.cells_in_time)
    words = f"{details:.4g} {name} across the die"
    if not is_free or width >= min(needed, widest):
        set_by = "" if is_free else "; as set by --resolution"
        return None, Decision(FILM, True, f"{_sampling(camera, physics, width)}; {words}{set_by}")

    chosen = film.fitting_width(camera.height_mm / camera.die_mm, needed, widest)
    limit = ""
    if needed > widest:
        limit = (
            f", the limit ({film.MAX_ACROSS} across, 2 GiB for {plan.light.planes} pictures,"
            f" {amount(plan.most_samples, 2)} rays)"
        )
    reason = f"{_sampling(camera, physics, chosen)}, not {width} as in the scene: {words}{limit}"
    return chosen, Decision(FILM, True, reason)


def _fall_off_error(camera: Camera, width: int) -> float:
    """Return the largest relative error of taking the lens's fall-off at the middle of a film cell
    for its mean, on a square film of `width` cells.

    The error grows as the square of the width of a cell, so it follows from cells of half the
    width.
    """
    pitch_um = 1e3 * camera.die_mm / width
    middle = camera_factor(camera, (width, width), pitch_um)
    quarters = camera_factor(camera, (2 * width, 2 * width), 1e3 * camera.die_mm / (2 * width))
    mean = quarters.reshape(width, 2, width, 2).mean(axis=(1, 3))
    return float(4 / 3 * np.abs(middle / mean - 1).max())


def _sampling(camera: Camera, physics: PixelPhysics, width: int) -> str:
    """Compare the samples of a film with the photodiode."""
    pitch_um = 1e3 * camera.die_mm / width
    return (
        f"{width} samples of {pitch_um:.3g} µm across, {physics.aperture_side_um / pitch_um:.2g}"
        " per photodiode or microlens"
    )


def _decide_stack(physics: PixelPhysics, camera: Camera, spare_e: float, full: bool) -> Decision:
    """Describe what the pixel's stack collects on axis and in the corner of the die, from green
    light.

    It is left out, but for one scale of all pixels, where the bound of that (`scale_error`) is at
    most `spare_e`.

    Raises PixsimError if the quantum efficiency exceeds what the stack passes.
    """
    stack = physics.stack
    if stack is None:
        reason = "none, or switched off: light on the photodiode is collected from every direction"
        return Decision(STACK, full, reason, "" if full else "its shares")

    check_efficiency(physics)
    axis, corner = stack_shares(physics, camera, GREEN_NM)
    opening = "microlens" if stack.microlens else "opening"
    reason = (
        f"{opening} {stack.height_um:.4g} µm above the photodiode: a pixel collects"
        f" {percent(axis)} of its light on axis, {percent(corner)} in the corner ({GREEN_NM:g} nm)"
    )
    half_um = half_sizes_um(physics, pixels_on(camera.die_um, physics.pitch_um))
    error = scale_error(physics, camera_pupil(camera), half_um, spare_e)
    if error is None:
        return Decision(STACK, True, reason)
    return Decision(
        STACK,
        False,
        f"{reason}; it is one scale for all pixels",
        "its neighbours' light and its shading",
        error,
    )


def decide_saturation(readout: Readout, integration_s: float) -> Decision:
    """Describe how charge is stored, and from which limit on not linearly; the bound, 1e-6 of the
    well, holds below that limit.
    """
    pixel = readout.physics.pixel
    diode = readout.physics.diode
    full_well_e = readout.full_well_e
    if pixel.well_limit == "swing" or diode is None:
        clips = "at the well" if full_well_e <= readout.adc_range_e else "by the ADC"
        saturation_e = rounded(readout.burst(1).saturation_e, 3)
        return Decision("saturation", True, f"a hard clip {clips}, {saturation_e} e-")

    limit_e = linear_limit_e(diode, full_well_e, integration_s)
    limit = (
        f"{rounded(limit_e, 3)} e- in {rounded(integration_s, 3)} s"
        f" ({percent(limit_e / full_well_e)} of the well)"
    )
    if pixel.conversion == "junction" and not diode.constant:
        return Decision("saturation", True, f"the diode turns forward above {limit}")
    reason = f"linear if the brightest pixel stays below {limit}; else a table of the diode"
    return Decision("saturation", False, reason, "the table", LINEAR_WITHIN * full_well_e / limit_e)
