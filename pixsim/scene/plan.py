"""Plan a render: decide what can be left out of it, why, and what error that can cause."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, astuple, dataclass, field, replace
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import Array
from pixsim.base.bounds import Count, Positive
from pixsim.base.caller import parameter, setting
from pixsim.base.digits import amount, percent, rounded
from pixsim.base.door import checked_methods
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.notes import Note
from pixsim.light.quantities import FilmSamples
from pixsim.light.spectral import (
    HIGH_NM,
    LAMP,
    LEAST_LM_PER_W,
    LOW_NM,
    VISIBLE,
    WHITE_LAMPS,
    WHITE_OF_PLATE,
    WIDEST,
    Span,
    Spectrum,
    colour_matching,
    photons_per_joule,
    photopic_efficiency,
    white_words,
)
from pixsim.optics.camera import Camera
from pixsim.optics.camera_lens import Tiling, rendered_camera, without_lens
from pixsim.optics.camera_light import camera_factor, camera_pupil
from pixsim.optics.diffraction import cutoff_cy_per_mm, diffraction_otf
from pixsim.optics.lens_defocus import Defocus, depth_of_field_m, finite_or_none
from pixsim.optics.quantities import AnyDistance
from pixsim.scene import bands as spectral_bands, film, rules, white_plate
from pixsim.scene.bands import Bands, Fit, Witness
from pixsim.scene.contents import (
    Lamp,
    Surfaces,
    checked_lamps,
    find_bodies,
    find_lamps,
    find_surfaces,
    light_range_nm,
    planck,
    warnings_of_skies,
    white_of,
)
from pixsim.scene.film import GREEN_NM
from pixsim.scene.real_lens import decide_defocus, decide_real_lens, real_lens_warnings
from pixsim.scene.rules import TOLERANCE_E, Chart, Decision
from pixsim.scene.scene import Scene, film_size, sample_count, sensor_node
from pixsim.scene.tree import Node, Tree, nodes_of
from pixsim.scene.white_plate import distance_of_plate_m, place_of_plate
from pixsim.sensor.collection import check_efficiency, half_sizes_um, scale_error, stack_shares
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.integration import pixels_on
from pixsim.sensor.noise import SOURCES
from pixsim.sensor.outside import (
    CENTRES_NM,
    SHOWN_SHARE,
    inside,
    outside_header,
    outside_hint,
    outside_share,
    outside_words,
    span_of,
)
from pixsim.sensor.photodiode import LINEAR_WITHIN, linear_limit_e
from pixsim.sensor.pixel import PixelPhysics, derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.quantities import Pitch
from pixsim.sensor.reading import Readout
from pixsim.sensor.technology import load_technology
from pixsim.viewer.display_options import Display, Luminance

STACK, FILM = "pixel stack", "oversampling"  # subjects of decisions
# Shares of the tolerance: bands alone, and bands with pulses. The rest is for blur and diffraction (rules.py).
BANDS_SHARE, SPECTRUM_SHARE = 0.25, 0.8
LUMINANCE_SLACK = 5.0  # times the tolerance: error of the luminance of strongly coloured surfaces
COLOUR_SLACK = 2.0  # the same for a channel of a colour sensor
LEAST_OF_WHITE = 0.1  # of the signal of a neutral surface: less of it than that counts as much
FEWEST_RENDERS = 2  # whose difference shows their noise
RESPONSES = ("0.35um", "4t-bsi")  # technologies with the two packaged response curves, for a plan without a pixel


@dataclass(frozen=True)
class FittedLamp:
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
        return {"type": "perspective", "fov": fov_deg, "near_clip": white_plate.NEAR_CLIP * self.distance_m}


@checked_methods
@dataclass(frozen=True)
class Plan:
    """What will be rendered, and why.

    lights : one for each lamp spectrum
    bands : of the result
    white_cd_per_m2 : luminance of texel value 1 of an emissive chart, or None
    white : spectra that add up to the light of the scene's white; none if it is unknown
    white_lamps : ids of the emitters that are it, if the scene names them
    lens : "thinlens", or "perspective" if the aperture need not be sampled
    integrator : plugin and its parameters, or None for that of the scene
    spp : samples per film cell in each pass
    exact : whether film cells are computed from the texels of the chart, without samples
    diffraction : whether diffraction is computed
    regular_tables : whether tables with equal steps are converted to regular spectra
    decisions : each with its reason; `bound_e` is the sum of their error bounds
    full_passes, full_spp : passes and samples with nothing left out
    chart : an emissive chart that is alone and fills the film, or None
    tolerance_e : relative error of the mean electrons that the plan may cause
    warnings : possible problems of the scene
    resolution : samples across the film that this plan is for, if they differ from those of the scene
    sampler : plugin of Mitsuba
    given_spp : whether an option sets `spp`
    full : whether nothing may be left out
    tiling : of the blur of a real lens; None for a thin lens, and where a thin lens takes its place
    ends : whether the scene ends with the film, above and below, and at the left and the right: there a margin mirrors the film
    outside : entry of an irradiance's header on the lamps' light outside 360-830 nm; empty if there is none
    defocus : what the thin lens's defocus is off at depths of the scene behind a real lens, largest errors first
    white_w_per_m2_sr : radiance of texel value 1 of an emissive chart whose light has no luminance, or None
    plate : how a white plate is rendered beside the scene, if the scene asks for it and is no emissive chart
    of_chart : whether the scene asks for a white plate and is an emissive chart, whose texel value 1 takes its place
    in_focus_m : the nearest and the farthest depth at which a point's disc is a pixel wide at most; None without a pixel
    held : (node, property, spectrum) of tables of surfaces that go on beyond their ends, as `beyond_tables = "hold"` has it
    """

    lights: tuple[FittedLamp, ...]
    bands: Bands
    white_cd_per_m2: Luminance | None
    lens: Literal["thinlens", "perspective"]
    integrator: dict[str, Any] | None
    spp: int
    diffraction: bool
    regular_tables: bool
    decisions: tuple[Decision, ...]
    full_passes: int
    full_spp: int
    chart: Chart | None = field(default=None, repr=False)
    tolerance_e: Positive = TOLERANCE_E
    warnings: tuple[Note, ...] = ()
    resolution: FilmSamples | None = None
    sampler: str = "multijitter"
    given_spp: bool = False
    exact: bool = False
    full: bool = False
    tiling: Tiling | None = None
    white: tuple[Spectrum, ...] = ()
    white_lamps: tuple[str, ...] = ()
    defocus: tuple[Defocus, ...] = ()
    ends: tuple[bool, bool] = (False, False)
    outside: dict[str, Any] = field(default_factory=dict, repr=False)
    held: tuple[tuple[int, str, Spectrum], ...] = field(default=(), repr=False)
    white_w_per_m2_sr: float | None = None
    plate: WhitePlate | None = field(default=None, repr=False)
    of_chart: bool = False
    in_focus_m: tuple[AnyDistance, AnyDistance] | None = None

    def camera_of(self, camera: Camera) -> Camera:
        """Return the camera of the render: without its real lens where the plan leaves that out."""
        return without_lens(camera) if self.tiling is None else camera

    def margin(self, shape: tuple[Count, Count], pitch_um: Pitch) -> int:
        """Return the cells at each side of a film that are rendered beyond it, as far as the blur of a real lens reaches.

        shape : (H, W) of the film in cells
        pitch_um : of its cells
        """
        if self.tiling is None or not self.tiling.psf_um:
            return 0
        whole = film.BLOCK * math.ceil(self.tiling.cells(pitch_um)[1] // 2 / film.BLOCK)
        return min(whole, min(shape) // 2 // film.BLOCK * film.BLOCK)

    @property
    def passes(self) -> int:
        """Number of passes over all lights."""
        return sum(len(light.fit.passes) for light in self.lights)

    @property
    def planes(self) -> int:
        """Number of pictures that a render holds in memory, one for each pulse of each lamp."""
        return sum(len(light.fit.pulses) for light in self.lights)

    @property
    def most_samples(self) -> int:
        """Limit of the samples of all renders together, in place of a time limit: it does not depend on the machine."""
        return film.PATH_SAMPLES if self.chart is None else film.CHART_SAMPLES

    @property
    def many_bounces(self) -> bool:
        """Whether paths of any length are traced, whose noise is rarely below that of the sensor."""
        return self.integrator is None and self.chart is None

    @property
    def cells_in_time(self) -> float:
        """Number of film cells for which the fewest renders, two with the fewest samples, stay within `most_samples`."""
        if self.exact:
            return math.inf
        fewest = self.spp if self.given_spp else rules.FEWEST_OF_A_PATH if self.chart is None else rules.FEWEST_OF_A_CHART
        return self.most_samples / (fewest * self.passes * FEWEST_RENDERS)

    @property
    def bound_e(self) -> float:
        """Bound for the relative error of the mean electrons, summed over all decisions."""
        return sum(decision.bound_e for decision in self.decisions)

    @property
    def spare_e(self) -> float:
        """What the other decisions leave of the tolerance for the pixels' stack; 0 if nothing may be left out.

        The film of a scene without detail takes its part where the plan does not choose it.
        """
        others = [decision for decision in self.decisions if decision.subject != STACK]
        chosen = self.chart is None or not self.chart.uniform or any(decision.subject == FILM for decision in others)
        if self.full or not chosen or not all(decision.bounded for decision in others):
            return 0.0
        return max(0.0, self.tolerance_e - sum(decision.bound_e for decision in others))

    @property
    def bounded(self) -> bool:
        """Whether `bound_e` covers all decisions."""
        return all(decision.bounded for decision in self.decisions)

    @property
    def factored(self) -> bool:
        """Whether the image is stored as factors: fewer pictures than bands, or spectra with negative values."""
        fewer = sum(len(light.fit.pulses) for light in self.lights) < self.bands.width_nm.size
        return fewer or any(bool(light.fit.spectra.min() < 0) for light in self.lights)

    @property
    def light_of_white(self) -> str:
        """Name of the light of the scene's white."""
        return WHITE_OF_PLATE if self.plate else white_words(bool(self.white), self.white_lamps)

    def white_header(self, edges_nm: Array) -> dict[str, Any]:
        """Return the entries of an irradiance's header on the light of the scene's white, in bands between edges (B + 1,).

        And on the lamps' light outside the bands' range.

        Raises PixsimError for fewer than two edges.
        """
        if np.ndim(edges_nm) != 1 or len(edges_nm) < 2:
            raise invalid("edges_nm", f"an array of shape {np.shape(edges_nm)}", "two or more edges")
        lamps = {WHITE_LAMPS: list(self.white_lamps)} if self.white_lamps else {}
        lamps |= self.outside
        if not self.white:
            return lamps
        return {LAMP: np.sum([spectrum.cell_means(edges_nm) for spectrum in self.white], axis=0).tolist()} | lamps

    def as_dict(self) -> dict[str, Any]:
        """Return the plan for `pixsim plan --json`."""
        table: dict[str, Any] = {"decisions": [asdict(decision) for decision in self.decisions], "tolerance_e": self.tolerance_e}
        table |= {"bound_e": self.bound_e, "bounded": self.bounded, "lamp_spectra": len(self.lights)}
        table |= {"passes": self.passes, "passes_full": self.full_passes, "spp": self.spp, "spp_full": self.full_spp}
        table |= {"resolution": self.resolution, "diffraction": self.diffraction, "warnings": list(self.warnings)}
        table |= {"lens": self.lens, "integrator": self.integrator}
        table["white_spectrum"] = self.light_of_white
        if self.in_focus_m is not None:
            table["in_focus_m"] = finite_or_none(self.in_focus_m)
        if self.defocus:  # infinity is no number of JSON
            table["defocus"] = [
                {name: value if math.isfinite(value) else None for name, value in asdict(one).items()} for one in self.defocus
            ]
        return table | {"wavelength_nm": self.bands.wavelength_nm.tolist(), "band_width_nm": self.bands.width_nm.tolist()}

    def __repr__(self) -> str:
        return (
            f"<Plan {self.passes} of {self.full_passes} passes, {self.spp} of {self.full_spp} samples, {self.lens}, "
            f"error of mean electrons up to {self.bound_e:.1e}>"
        )


def shutter_note(sensor: Node) -> str:
    """Return what to say of a sensor that states a shutter time; empty for others. No scene that pixsim reads has motion."""
    opens, closes = (float(sensor.get(name, 0.0)) for name in ("shutter_open", "shutter_close"))
    if opens == closes:
        return ""
    exposures = f"{setting('exposure.integration_s')} sets the exposure, and {setting('exposure.max_integration_s')} its longest"
    stated = f"the sensor's shutter_open {opens:g} and shutter_close {closes:g} change nothing"
    return f"{stated}, since nothing in the scene moves: {exposures}"


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
    pixel : the tolerance is for its electrons, or those of several; None takes the packaged response curves
    tolerance_e : relative error of the mean electrons that all decisions together may cause
    full : leave nothing out: every band of every lamp, the scene's integrator, a sampled lens
    exact : whether to compute the film cells of a chart that is alone and in focus, without samples
    aperture_um : side of the smallest photodiode, for which the blur of a real lens is computed; None takes that of the pixel

    Raises PixsimError if an emitter is negative or not finite, or if the tolerance is not between 0 and 1.
    """
    if not 0 < tolerance_e < 1:
        raise invalid("tolerance_e", f"{tolerance_e:g}", "above 0 and below 1, a relative error of mean electrons")
    pixels = [pixel] if isinstance(pixel, Pixel) else pixel or []
    camera = camera or scene.camera()
    tiling, real_lens = decide_real_lens(scene, camera, pixels[0] if pixels else None, tolerance_e, full, aperture_um)
    whole, camera = camera, camera if tiling else without_lens(camera)
    seen = rendered_camera(camera)
    state = scene.for_camera(seen)
    sensor = sensor_node(state, scene.sensor_id)[1]
    height, width = (max(1, side) for side in scene.film_shape(seen, state))  # the renderer checks the size
    bodies = find_bodies(state, sensor)
    every_lamp = find_lamps(state, scene.choice.reading)
    emitted = [lamp.spectrum for lamp in every_lamp if lamp.spectrum is not None]
    seeing = [derive(one, load_technology(one.technology)) for one in pixels or _packaged_pixels()]
    span = span_of(emitted, seeing)
    lamps = checked_lamps(every_lamp, span)
    white = white_of(state, every_lamp if scene.white_lamps else lamps, scene.white_lamps)
    surfaces = find_surfaces(state, scene.choice.reading, span, scene.beyond_tables)
    if not lamps:
        raise _no_light(every_lamp)
    if surfaces.ending and not scene.beyond_tables:
        raise _unknown_beyond(surfaces)
    integrator, met, bounces = rules.decide_bounces(state, bodies, full)
    lights, bands, full_passes, spectral = _lights(
        lamps, surfaces, met, _witnesses(seeing), tolerance_e, full, any(one.colour for one in pixels)
    )
    by_index, tables = rules.decide_tables(state, full)
    lens, focus = rules.decide_lens(state, seen, bodies, width / height, pixels[0] if pixels else None, tolerance_e, full)
    # An unfocused chart differs from its picture, and the lens needs samples too.
    chart = rules.lone_chart(state, seen, bodies, (height, width)) if lens == "perspective" else None
    # What is left out does not change where the scene ends.
    sharp = lens if not full else rules.decide_lens(state, seen, bodies, width / height, None, tolerance_e, False)[0]
    ends = rules.ends_with_film(state, seen, bodies, (height, width)) if tiling and sharp == "perspective" else (False, False)
    scene_spp = sample_count(state, sensor)
    passes = sum(len(light.fit.passes) for light in lights)
    explicit = "spp" in scene.parameters
    finer = (width / max(1, film_size(state, sensor)[1])) ** 2
    spp, sampler, samples = rules.decide_samples(chart, scene_spp, passes, tolerance_e, full, explicit, finer)
    diffraction = rules.decide_diffraction(
        chart, camera, 1e3 * camera.die_mm / width, tolerance_e, full or tiling is not None, span.high_nm
    )
    bound_e = sum(decision.bound_e for decision in (*spectral, focus, diffraction))
    defocus: list[Defocus] = []
    if tiling is not None and focus.kept:
        defocus, of_depth = decide_defocus(state, bodies, camera, seen, width / height, pixels[0] if pixels else None)
        real_lens += of_depth
    warnings = real_lens_warnings(whole, tiling, defocus, tolerance_e)
    if surfaces.short:
        ranges = ", ".join(surfaces.short)
        words = f"reflectance tables cover only {ranges}, and Mitsuba takes 0 outside; extend them to 360-830 nm"
        warnings.append(Note("scene", words=words))
    if text := shutter_note(sensor):
        warnings.append(Note("scene", words=text))
    if surfaces.ending:
        words = f"outside {VISIBLE.words} these are what Mitsuba makes of them: {_named(surfaces.ending)}"
        warnings.append(Note("scene", words=words))
    if surfaces.mirrors:
        beyond = "Mitsuba takes 0 for the index of a metal beyond its tables, a perfect mirror where both end"
        warnings.append(Note("scene", words=f"{beyond}; extend {_named(surfaces.mirrors)}"))
    outside = outside_header(emitted, span)
    scene_texts = [*warnings_of_skies(state, scene.choice.reading), *_light_that_ends(state, every_lamp, span, seeing)]
    warnings += [Note("scene", words=text) for text in scene_texts]
    left_out = max((outside_share(outside, physics) for physics in seeing), default=0.0) if pixels else 0.0
    if left_out > SHOWN_SHARE:
        warnings.append(Note("light_left_out", words=outside_words(left_out, span), hint=outside_hint()))
    if bound_e > tolerance_e:
        limits = f"bands reach their limit of {spectral_bands.NARROWEST_BAND_NM:g} nm or {spectral_bands.MAX_BANDS} bands"
        warnings.append(Note("electrons_error", error=bound_e, tolerance=tolerance_e, limits=limits))
    emitters = nodes_of(state, "Emitter")
    alone = len(emitters) == 1 and len(bodies) == 1 and emitters[0][1].plugin == "area" and bool(lamps)
    luminance, radiance = _white_of_chart(lamps[0], span) if alone else (None, None)
    of_chart = scene.diffuser and bool(luminance or radiance)
    plate = None
    if scene.diffuser and not of_chart:
        plate = _plate_of(scene, seen, state, sensor, pixels, tolerance_e)
    plan = Plan(
        lights=tuple(lights),
        bands=bands,
        white_cd_per_m2=luminance,
        white_w_per_m2_sr=radiance,
        lens=lens,
        integrator=integrator,
        spp=spp,
        sampler=sampler,
        given_spp=explicit,
        diffraction=diffraction.kept,
        regular_tables=by_index,
        decisions=(*spectral, tables, bounces, focus, samples, diffraction, *real_lens),
        full_passes=full_passes,
        full_spp=scene_spp,
        chart=chart,
        tolerance_e=tolerance_e,
        warnings=tuple(warnings),
        full=full,
        tiling=tiling,
        white=white,
        white_lamps=scene.white_lamps,
        defocus=tuple(defocus),
        ends=ends,
        outside=outside,
        plate=plate,
        of_chart=of_chart,
        in_focus_m=depth_of_field_m(whole, seeing[0].read_pitch_um) if pixels else None,
        held=tuple((index, name, table) for (index, name), table in surfaces.held.items()),
    )
    return _without_samples(plan) if exact and not full else plan


def _plate_of(scene: Scene, camera: Camera, state: Tree, sensor: Node, pixels: Sequence[Pixel], tolerance_e: float) -> WhitePlate:
    """Return how a white plate in a scene is rendered.

    camera : thin lens that sees the scene
    state, sensor : of the scene for this camera
    """
    focus_m = camera.object_distance_m
    distance_m = distance_of_plate_m(state, sensor, focus_m)
    place = place_of_plate(sensor, distance_m, focus_m)
    plated = replace(scene, diffuser=False, plate=place, resolution=white_plate.RESOLUTION, _texts={})
    plan = make_render_plan(plated, camera, pixels, tolerance_e=tolerance_e)
    plan = replace(plan, lens="perspective", chart=None, spp=white_plate.FIRST_SPP, sampler="multijitter")
    return WhitePlate(plated, plan, camera, distance_m)


ENDS_LIT = 1e-3  # of its largest value: a lamp's table that ends with less ends dark
LINE_NM = 100.0  # a lamp's table that is shorter is a line, which ends where it says
SKY_NM = 320.0, 720.0  # data of Mitsuba 3.9's sunsky, which is 0 outside
SUN_K = 5772.0  # effective temperature (IAU 2015 resolution B3)


def _light_that_ends(state: Tree, lamps: Sequence[Lamp], span: Span, seeing: Sequence[PixelPhysics]) -> list[str]:
    """Return what to say of lamps whose data end where a sensor sees light, with the share of its electrons that may lack."""
    channels = [channel for physics in seeing for channel in physics.channels]

    def share(light: Array, beyond: NDArray[np.bool_]) -> float:
        """Largest share of the electrons in any channel, of a spectrum (cells,), that comes from the cells beyond."""
        shares = [0.0]
        for channel in channels:
            electrons = light * channel.quantum_efficiency(CENTRES_NM) * photons_per_joule(CENTRES_NM)
            if electrons.sum() > 0:
                shares.append(float(electrons[beyond].sum() / electrons.sum()))
        return max(shares)

    warnings = []
    for lamp in (lamp.spectrum for lamp in lamps if lamp.spectrum is not None):
        nodes, values = lamp.nodes_nm, lamp.values
        if nodes[-1] - nodes[0] < LINE_NM:
            continue

        lit = ENDS_LIT * values.max()
        held = np.where(inside(span), np.interp(CENTRES_NM, nodes, values), 0.0)
        for word, end_nm, value, beyond in (
            ("begins", nodes[0], values[0], nodes[0] > CENTRES_NM),
            ("ends", nodes[-1], values[-1], nodes[-1] < CENTRES_NM),
        ):
            if value > lit and (part := share(held, beyond)) > SHOWN_SHARE:
                warnings.append(
                    f"the light of a lamp {word} at {end_nm:g} nm, where it is not 0: it is taken as 0 beyond; "
                    f"if it stayed so, {percent(part)} of the electrons would come from there"
                )

    pictures = [state.nodes[index] for lamp in lamps if lamp.spectrum is None for index in lamp.pictures]
    if pictures and span != VISIBLE:
        names = ", ".join(dict.fromkeys(f"'{node.plugin}'" for node in pictures))
        warnings.append(f"the light of a picture or an RGB colour is 0 outside {VISIBLE.words}, which counts here: {names}")

    if any(node.plugin == "sunsky" for node in pictures):
        # Air lets little of the sun through below 320 nm.
        part = share(planck(CENTRES_NM, SUN_K), SKY_NM[1] < CENTRES_NM)
        if part > SHOWN_SHARE:
            warnings.append(
                f"a sunsky has data from {SKY_NM[0]:g} to {SKY_NM[1]:g} nm, and is 0 beyond: of sunlight (a black body of "
                f"{SUN_K:g} K), {percent(part, 1)} of the electrons come from there; a filter keeps it out "
                f"({setting('pixel.infrared_cut_nm', SKY_NM[1])})"
            )
    return list(dict.fromkeys(warnings))


def _packaged_pixels() -> list[Pixel]:
    """Return pixels of the packaged response curves, which stand for those that nobody states."""
    return [Pixel(technology=name, pitch_um=10.0) for name in RESPONSES]


def _unknown_beyond(surfaces: Surfaces) -> PixsimError:
    """Return the error for surfaces of which nobody says what they are in all of the range that is computed."""
    got = f"{_named(surfaces.ending)}, under a lamp with light that the sensor sees in {surfaces.span.words}"
    allowed = f"tables of reflectance that cover {surfaces.span.words}"
    hint = (
        f"Extend them; or state {parameter('beyond_tables', 'hold')} or 'zero'; or keep that light out "
        f"({setting('pixel.infrared_cut_nm', HIGH_NM)})."
    )
    return invalid("scene", got, allowed, hint)


NAMED = 4  # surfaces, in a message


def _named(surfaces: Sequence[str]) -> str:
    """Return the first of some surfaces, as text."""
    return "; ".join(surfaces[:NAMED]) + f"; and {len(surfaces) - NAMED} more" * (len(surfaces) > NAMED)


def _white_of_chart(lamp: Lamp, span: Span) -> tuple[float | None, float | None]:
    """Return the luminance of texel value 1 of a chart's lamp, or the radiance of light without one; the other is None."""
    if lamp.spectrum is None:
        return None, None
    luminance, radiance = lamp.luminance_cd_per_m2, lamp.spectrum.integral(*astuple(span))
    return (luminance, None) if luminance > LEAST_LM_PER_W * radiance else (None, radiance)


def _no_light(lamps: Sequence[Lamp]) -> PixsimError:
    """Return the error for a scene without light in the range that is computed."""
    if ends := light_range_nm(lamps):
        got = f"light from {ends[0]:g} to {ends[1]:g} nm only"
        allowed = f"light within {LOW_NM:g}-{HIGH_NM:g} nm, or within {WIDEST.words} where the sensor sees it"
        hint = "Choose a lamp with light in that range, or a sensor without an infrared cut (pixel.infrared_cut_nm)."
        return invalid("scene", got, allowed, hint)
    return invalid("scene", "no emitter with light", "a lamp, a chart or a sky with light", "Check that its scale is above 0.")


def _without_samples(plan: Plan) -> Plan:
    """Return the plan with film cells that are computed, if it is of a chart in focus that is seen straight; else the plan."""
    straight = plan.integrator is not None and plan.integrator.get("max_depth") == 1
    if plan.chart is None or plan.chart.beyond is None or not straight or plan.given_spp:
        return plan
    between = "even over each of its texels" if plan.chart.nearest else "linear between its texels"
    reason = f"none: each film cell is the exact mean of the chart, which is {between}"
    exact = Decision("texture samples", False, reason, f"all {plan.full_spp} samples, and their noise")
    return replace(plan, spp=0, exact=True, decisions=tuple(exact if d.subject == exact.subject else d for d in plan.decisions))


def _witnesses(derived: Sequence[PixelPhysics]) -> list[Witness]:
    """Return the responses that the bands must reproduce: electrons per joule of the pixels, and the luminance.

    Of colour sensors, those of each channel, and XYZ.
    """

    def response(physics: PixelPhysics) -> spectral_bands.Response:
        return lambda nm: physics.quantum_efficiency(nm) * photons_per_joule(nm)

    def observer(number: int) -> spectral_bands.Response:
        return lambda nm: np.asarray(colour_matching(nm)[..., number])

    seen = [Witness(response(channel)) for physics in derived for channel in physics.channels]
    if any(physics.layout for physics in derived):
        # No slack for X, Y and Z: a ColorChecker is then right within 0.04 ΔE under smooth lamps and lines.
        observed = [Witness(observer(number), least=LEAST_OF_WHITE) for number in range(3)]
        return [*(replace(one, slack=COLOUR_SLACK, least=LEAST_OF_WHITE) for one in seen), *observed]
    return [*seen, Witness(photopic_efficiency, LUMINANCE_SLACK)]


def _lights(
    lamps: list[Lamp], surfaces: Surfaces, bounces: int, witnesses: list[Witness], tolerance_e: float, full: bool, in_colour: bool
) -> tuple[list[FittedLamp], Bands, int, list[Decision]]:
    """Return the pulses of each lamp, the bands, the number of passes without leaving out any band, and the reasons."""
    spectra = [lamp.spectrum for lamp in lamps if lamp.spectrum]
    met = surfaces.products(bounces) if bounces else surfaces.products(1)[:0]
    bands = spectral_bands.place_bands(spectra, met, witnesses, tolerance_e * BANDS_SHARE, surfaces.span)
    known = surfaces.spectra is not None or bounces == 0
    lights, reasons, most, alone = [], [], 0, 0.0
    stiffness = spectral_bands.COLOUR_STIFFNESS if in_colour else spectral_bands.STIFFNESS
    for lamp in lamps:
        every = spectral_bands.every_band(lamp.spectrum, bands)
        most += len(every.passes)
        fitted: Fit | None = None
        if lamp.spectrum:
            errors = spectral_bands.band_errors(bands, spectral_bands.resolved(lamp.spectrum, met, surfaces.span), witnesses)
            alone = max(alone, float(np.abs(errors.sum(axis=2)).max()))
            if known and not full:
                fitted = spectral_bands.fit(lamp.spectrum, bands, met, witnesses, tolerance_e * SPECTRUM_SHARE, stiffness)
        lights.append(FittedLamp(lamp, fitted or every))
        count = len(lights[-1].fit.pulses)
        reasons.append(f"{count} pulse{'s' * (count > 1)}" if fitted else f"{count} bands")
    widths = bands.width_nm
    uniform = bool(np.all(np.isin(widths, (5.0, 10.0)))) and widths.size == spectral_bands.band_edges_nm(surfaces.span).size - 1
    sizes = "uniform, 10 nm" if uniform else f"{widths.min():g} to {widths.max():g} nm, finer where lamps or surfaces change"
    reason_of_bands = f"{widths.size} bands, {sizes}, pulses shaped like the lamp, so that no line is missed"
    placing = Decision("wavelength bands", True, reason_of_bands, bound_e=alone)
    fewest = sum(len(light.fit.passes) for light in lights)
    error = max(light.fit.error for light in lights)
    reason, saved = _rank_reason(lamps, surfaces, met, reasons, full), f"{fewest} of {most} passes" if fewest < most else ""
    bounded = all(lamp.spectrum is not None for lamp in lamps) and known
    # The fit's error includes that of its bands.
    rank = Decision("spectral rank", fewest >= most, reason, saved, max(0.0, error - alone), bounded)
    return lights, bands, most, [placing, rank]


def _rank_reason(lamps: list[Lamp], surfaces: Surfaces, met: Array, counts: list[str], full: bool) -> str:
    pulses = " and ".join(counts) or "no light"
    lit = f"{len(lamps)} lamp spectr{'um' if len(lamps) == 1 else 'a'}"
    if full:
        return f"nothing left out: {lit}, {pulses}"
    if any(lamp.spectrum is None for lamp in lamps):
        return f"{lit}, one with a colour that varies over the emitter: {pulses}"
    if surfaces.spectra is None:
        return f"{lit}; all bands, because of {surfaces.unknown}: {pulses}"
    if not len(met):
        return f"{lit} on neutral surfaces or none: {pulses} for all bands"
    return f"{lit} × {len(surfaces.spectra)} surface spectra ({len(met)} with interreflections): {pulses} determine all bands"


UNIFORM_RESOLUTION = 64  # the lens's fall-off is then right to 3e-5 of the mean electrons at 20° off axis


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
    """Plan a simulation: what is rendered, what is left out and why, and a bound for the error.

    Parameters
    ----------
    scene : from `load_scene`
    camera : None takes the camera of the file
    pixel : None takes the default pixel
    exposure : None takes the default; its longest time sets the charge at which a photodiode saturates
    display : chooses a film fine enough for its dots, as `resolution` of the plan; None keeps the scene's film
    tolerance_e : relative error of the mean electrons that all decisions together may cause
    full : leave nothing out

    Raises PixsimError if the scene cannot be rendered, or if the pixel is impossible.

    >>> from pixsim import load_scene
    >>> plan = make_plan(load_scene("csf", resolution=64))
    >>> plan.passes, plan.bound_e < plan.tolerance_e  # a chart under one lamp: one picture determines all bands
    (1, True)
    """
    camera, pixel = camera or scene.camera(), pixel or Pixel()
    exposure = exposure or Exposure()
    physics = derive(pixel, load_technology(pixel.technology))
    readout = Readout.of(physics, exposure)
    options: dict[str, Any] = {"tolerance_e": tolerance_e, "full": full, "exact": display is not None}
    plan = make_render_plan(scene, rendered_camera(camera), pixel, **options)  # the film does not depend on a real lens's blur
    resolution, sampling = decide_oversampling(scene, plan, camera, physics, display, full)
    if resolution or camera.lens is not None:
        plan = make_render_plan(scene.with_resolution(resolution) if resolution else scene, camera, pixel, **options)
    longest_s = exposure.times * (exposure.integration_s or exposure.max_integration_s) / exposure.frames  # of each exposure
    after = (
        decide_saturation(readout, longest_s),
        decide_noise(readout, full),
        decide_transforms(full or physics.layout is not None),
    )
    plan = replace(plan, resolution=resolution, decisions=(*plan.decisions, sampling, *after))
    stack = decide_stack(physics, camera, plan.spare_e, full)
    return replace(plan, decisions=(*plan.decisions[: -len(after)], stack, *after))


def decide_oversampling(
    scene: Scene, plan: Plan, camera: Camera, physics: PixelPhysics, display: Display | None, full: bool
) -> tuple[int | None, Decision]:
    """Choose the film's samples across the die, and describe them; None keeps the scene's film.

    A scene without detail takes a coarser film than the XML's. Every other film has at least two samples for each detail that
    matters on the display, within its limits, if the display is given; the XML's film is the least.
    """
    height, width = (max(1, side) for side in scene.film_shape(camera, scene.for_camera(rendered_camera(camera))))
    uniform, free = plan.chart is not None and plan.chart.uniform, scene.resolution is None
    given = not free or "resolution" in scene.parameters
    # Error of taking the fall-off at the middle of a sample for its mean: it grows as the width squared, so halve the samples.
    n = UNIFORM_RESOLUTION
    middle, parts = (camera_factor(camera, (side, side), 1e3 * camera.die_mm / side) for side in (n, 2 * n))
    error = float(4 / 3 * np.abs(middle / parts.reshape(n, 2, n, 2).mean(axis=(1, 3)) - 1).max())
    if uniform and not full and not given and width > UNIFORM_RESOLUTION and plan.bound_e + error <= plan.tolerance_e:
        reason = f"a scene without detail: {UNIFORM_RESOLUTION} samples across resolve the fall-off of the lens"
        return UNIFORM_RESOLUTION, Decision(FILM, False, reason, f"{UNIFORM_RESOLUTION}² of {width}² samples", error)
    if display is None or full or uniform:
        return None, Decision(FILM, True, _sampling(camera, physics, width))
    details, name = film.details_across(
        camera, physics.aperture_side_um, display, physics.pitch_um, plan.chart.details if plan.chart else None
    )
    words = f"{details:.4g} {name} across the die"
    if not free:
        return None, Decision(FILM, True, f"{_sampling(camera, physics, width)}; {words}; as set by --resolution")
    most = film.largest_film(height / width, plan.planes, plan.cells_in_time)
    needed = film.SAMPLES_PER_DETAIL * details
    if width >= min(needed, most):
        return None, Decision(FILM, True, f"{_sampling(camera, physics, width)}; {words}")
    chosen = film.fitting_width(camera.height_mm / camera.die_mm, needed, most)
    pictures = f"{plan.planes} picture{'s' * (plan.planes > 1)}"
    limits = f", the limit for {pictures} ({film.MAX_ACROSS} across, 2 GiB, {amount(plan.most_samples, 2)} rays)"
    limit = limits if needed > most else ""
    sampling = _sampling(camera, physics, chosen)
    return chosen, Decision(FILM, True, f"{sampling}, not {width} as in the scene: {words}{limit}")


def _sampling(camera: Camera, physics: PixelPhysics, width: int) -> str:
    """Compare the samples of a film with the lens and the photodiode."""
    pitch_um = 1e3 * camera.die_mm / width
    nyquist = 1e3 / (2 * pitch_um)
    cutoff = float(cutoff_cy_per_mm(GREEN_NM, camera.effective_f_number))
    left = float(diffraction_otf(nyquist, GREEN_NM, camera.effective_f_number))
    return (
        f"{width} samples of {pitch_um:.3g} µm across, {physics.aperture_side_um / pitch_um:.2g} per {_aperture(physics)}; "
        f"the lens passes {percent(left)} at their Nyquist frequency, {nyquist:.3g} of {cutoff:.3g} cy/mm"
    )


def decide_stack(physics: PixelPhysics, camera: Camera, spare_e: float, full: bool) -> Decision:
    """Describe what the pixel's stack collects on axis and in the corner of the die, from green light.

    It is left out, but for one scale of all pixels, where the bound of that (`scale_error`) is at most `spare_e`.

    Raises PixsimError if the quantum efficiency exceeds what the stack passes.
    """
    stack = physics.stack
    if stack is None:
        given = "none given" if physics.pixel.stack is None or physics.pixel.stack.enabled else "switched off"
        reason = f"{given}: light on the photodiode is collected from every direction"
        return Decision(STACK, full, reason, "" if full else "its shares")
    check_efficiency(physics)
    axis, corner = stack_shares(physics, camera, GREEN_NM)
    kind = f"{'microlens' if stack.microlens else 'opening'} {stack.height_um:.4g} µm"
    reason = f"{kind} above the photodiode: a pixel collects {percent(axis)} of its light on axis, {percent(corner)} in the corner"
    rays = ", chief rays of camera.chief_ray_angle" if camera.chief_ray_angle is not None else ""
    rays = f", rays of '{camera.lens.file}'" if camera.lens is not None else rays
    reason += f" ({GREEN_NM:g} nm{rays})"
    if stack.microlens:
        slower = f"from f/{stack.lossless_f_number:.3g} on" if stack.lossless_f_number else "at every f-number"
        reason += f"; {slower}, light on axis is lost by diffraction only"
    error = scale_error(physics, camera_pupil(camera), half_sizes_um(physics, pixels_on(camera.die_um, physics.pitch_um)), spare_e)
    if error is None:
        return Decision(STACK, True, reason)
    return Decision(STACK, False, f"{reason}; it is one scale for all pixels", "its neighbours' light and its shading", error)


def _aperture(physics: PixelPhysics) -> str:
    """Return what `PixelPhysics.aperture_side_um` is the side of."""
    return "microlens" if physics.aperture_side_um > physics.photodiode_side_um else "photodiode side"


def decide_saturation(readout: Readout, integration_s: float) -> Decision:
    """Describe how charge is stored, and from which limit on not linearly; the bound, 1e-6 of the well, holds below that limit."""
    pixel, diode, full_well_e = readout.physics.pixel, readout.physics.diode, readout.full_well_e
    bent = pixel.conversion == "junction" and diode is not None and not diode.constant
    conversion = "; V(Q) of the junction at every level" if bent else ""
    if pixel.well_limit == "swing" or diode is None:
        clips = "at the well" if full_well_e <= readout.adc_range_e else "by the ADC"
        reason = f"linear charge up to a hard clip {clips}, {rounded(readout.burst(1).saturation_e, 3)} e-{conversion}"
        return Decision("saturation", True, reason)
    limit_e = linear_limit_e(diode, full_well_e, integration_s)
    limit = f"{rounded(limit_e, 3)} e- in {rounded(integration_s, 3)} s ({percent(limit_e / full_well_e)} of the well)"
    if bent:
        return Decision("saturation", True, f"the diode turns forward above {limit}{conversion}")
    reason = f"linear if the brightest pixel stays below {limit}; else a table of the diode"
    return Decision("saturation", False, reason, "the table", LINEAR_WITHIN * full_well_e / limit_e)


def decide_noise(readout: Readout, full: bool) -> Decision:
    """List the noise sources that are zero."""
    dark = readout.dark_current_e_per_s
    sizes = {each: each.deviation(readout) * (dark if each.grows_with == "dark" else 1.0) for each in SOURCES}
    listed = {each.name: size for each, size in sizes.items() if size or not each.is_rare}
    sources = {each.name: sizes[each] for each in SOURCES if each.grows_with == "light"} | {"dark current": dark}
    sources |= {each.name: sizes[each] for each in SOURCES if each.grows_with == "dark"} | listed
    hot = readout.physics.hot_pixel_fraction
    sources |= {"hot pixels": hot} if hot else {}  # few sensors have numbers for them
    silent = [name for name, value in sources.items() if not value]
    if not silent or full:
        return Decision("noise stages", True, "shot noise, " + ", ".join(name for name, value in sources.items() if value))
    return Decision("noise stages", False, f"zero: {', '.join(silent)}", f"{len(silent)} of {len(sources) + 1} stages")


def decide_transforms(full: bool) -> Decision:
    """Count the transforms of the viewer: the opponent channels of a grey image are multiples of one picture.

    full : leave nothing out; and for coloured images
    """
    if full:
        return Decision("repeated transforms", True, "three forward and three inverse transforms per image")
    reason = "a grey image: one forward transform for three opponent channels; the reference image only once"
    return Decision("repeated transforms", False, reason, "2 of 6 transforms per image")
