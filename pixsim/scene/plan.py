"""From what a scene contains to the least work that serves it; each thing left out with its reason and what it can cost."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.errors import invalid
from pixsim.base.parameters import Camera, Exposure, Pixel
from pixsim.light.spectral import photons_per_joule, photopic_efficiency
from pixsim.optics.diffraction import cutoff_cy_per_mm, diffraction_otf
from pixsim.optics.thin_lens import field_factor
from pixsim.scene import bands as spectral_bands
from pixsim.scene.bands import Bands, Fit, Witness
from pixsim.scene.contents import Lamp, Surfaces, checked_lamps, find_bodies, find_lamps, find_surfaces
from pixsim.scene.mitsuba import nodes_of
from pixsim.scene.rules import (
    TOLERANCE_E,
    Chart,
    Decision,
    decide_bounces,
    decide_diffraction,
    decide_lens,
    decide_samples,
    decide_tables,
    lone_chart,
)
from pixsim.scene.scene import Scene, film_size, sample_count, sensor_node
from pixsim.sensor.photodiode import LINEAR_WITHIN, linear_limit_e
from pixsim.sensor.pixel import PixelPhysics, derive

# Of the tolerance: bands alone, and bands and pulses together. The rest is for blur and diffraction (rules.py).
BANDS_SHARE, SPECTRUM_SHARE = 0.25, 0.8
LUMINANCE_SLACK = 5.0  # the luminance of strongly coloured surfaces may be this much worse than their electrons
RESPONSES = ("0.35um", "4t-bsi")  # technologies with the packaged response curves, for a render without a pixel


@dataclass(frozen=True)
class Light:
    """Lamps of one spectrum, and the pulses that measure what they send to the lens."""

    lamp: Lamp
    fit: Fit


@dataclass(frozen=True)
class Plan:
    """What will be rendered, and why.

    lights : one for each lamp spectrum
    bands : of the result
    white_cd_per_m2 : luminance of an emissive chart's texel value 1, or None
    lens : "thinlens", or "perspective" where the aperture needs no sampling
    integrator : plugin and its values, or None for the scene's own
    spp : samples of each film cell in each pass
    diffraction : whether the picture changes by it
    regular_tables : whether tables at equal steps are read by index
    decisions : for people; `bound_e` adds them up
    full_passes, full_spp : what it would take with nothing left out
    chart : a lone one and what it needs, or None
    tolerance_e : relative error of the mean electrons that was asked for
    warnings : what may be wrong with the scene
    resolution : a coarser film that is enough, where the scene leaves it open
    sampler : Mitsuba's
    """

    lights: tuple[Light, ...]
    bands: Bands
    white_cd_per_m2: float | None
    lens: Literal["thinlens", "perspective"]
    integrator: dict[str, Any] | None
    spp: int
    diffraction: bool
    regular_tables: bool
    decisions: tuple[Decision, ...]
    full_passes: int
    full_spp: int
    chart: Chart | None = field(default=None, repr=False)
    tolerance_e: float = TOLERANCE_E
    warnings: tuple[str, ...] = ()
    resolution: int | None = None
    sampler: str = "multijitter"

    @property
    def passes(self) -> int:
        """Over all lights."""
        return sum(len(light.fit.passes) for light in self.lights)

    @property
    def bound_e(self) -> float:
        """Relative error of the mean electrons that all decisions can cost together."""
        return sum(each.bound_e for each in self.decisions)

    @property
    def bounded(self) -> bool:
        """Whether `bound_e` covers everything."""
        return all(each.bounded for each in self.decisions)

    @property
    def factored(self) -> bool:
        """Fewer pictures than bands; or a fitted lamp beside others, whose share of a band may be a little below zero."""
        fewer = sum(len(light.fit.pulses) for light in self.lights) < self.bands.width_nm.size
        return fewer or any(bool(light.fit.spectra.min() < 0) for light in self.lights)

    def as_dict(self) -> dict[str, Any]:
        """For `pixsim plan --json`."""
        return {
            "decisions": [asdict(each) for each in self.decisions],
            "tolerance_e": self.tolerance_e,
            "bound_e": self.bound_e,
            "bounded": self.bounded,
            "lamp_spectra": len(self.lights),
            "passes": self.passes,
            "passes_full": self.full_passes,
            "spp": self.spp,
            "spp_full": self.full_spp,
            "resolution": self.resolution,
            "diffraction": self.diffraction,
            "warnings": list(self.warnings),
            "lens": self.lens,
            "integrator": self.integrator,
            "wavelength_nm": self.bands.wavelength_nm.tolist(),
            "band_width_nm": self.bands.width_nm.tolist(),
        }

    def __repr__(self) -> str:
        return (
            f"<Plan {self.passes} of {self.full_passes} passes, {self.spp} of {self.full_spp} samples, {self.lens}, "
            f"mean electrons to {self.bound_e:.1e}>"
        )


def make_render_plan(
    scene: Scene,
    camera: Camera | None = None,
    pixel: Pixel | None = None,
    *,
    tolerance_e: float = TOLERANCE_E,
    full: bool = False,
    band_count: int | None = None,
) -> Plan:
    """Decide what to render from the parsed tree.

    Parameters
    ----------
    pixel : whose electrons must be right; None takes the packaged response curves
    tolerance_e : relative error of the mean electrons that all decisions may cost together
    full : leave nothing out: every band of every lamp, the scene's own integrator, a sampled lens
    band_count : so many bands of equal width instead of those that the tolerance asks for

    Raises PixsimError for emitters that are negative or not finite, and for a tolerance that is not positive.
    """
    if not 0 < tolerance_e < 1:
        raise invalid("tolerance_e", f"{tolerance_e:g}", "above 0 and below 1: a relative error of mean electrons")
    camera = camera or scene.camera()
    state = scene.for_camera(camera)
    sensor = sensor_node(state, scene.sensor_id)[1]
    height, width = (max(1, each) for each in film_size(state, sensor))  # the renderer refuses the others
    bodies = find_bodies(state, sensor)
    lamps = checked_lamps(find_lamps(state, scene.choice.variant))
    surfaces = find_surfaces(state, scene.choice.variant)
    if not lamps:
        raise invalid("scene", "no emitter that shines", "a lamp, a chart or a sky with light", "Is its scale above 0?")
    integrator, met, bounces = decide_bounces(state, bodies, full)
    lights, bands, full_passes, spectral = _lights(lamps, surfaces, met, _witnesses(pixel), tolerance_e, full, band_count)
    by_index, tables = decide_tables(state, full)
    lens, focus = decide_lens(state, camera, bodies, width / height, pixel, tolerance_e, full)
    # Out of focus a chart is not the picture, and the lens takes samples of its own.
    chart = lone_chart(state, scene.path.parent, camera, bodies, (height, width)) if lens == "perspective" else None
    most = sample_count(state, sensor)
    passes = sum(len(light.fit.passes) for light in lights)
    spp, samples = decide_samples(chart, most, passes, tolerance_e, full, explicit="spp" in scene.parameters)
    diffraction = decide_diffraction(chart, camera, 1e3 * camera.die_mm / width, tolerance_e, full)
    emitters = nodes_of(state, "Emitter")
    bound_e = sum(each.bound_e for each in (*spectral, focus, diffraction))
    told = []
    if surfaces.short:
        ranges = ", ".join(surfaces.short)
        told.append(f"reflectance tables of {ranges}: Mitsuba takes 0 outside; extend them to 360-830 nm")
    if bound_e > tolerance_e:
        finest = f"bands of {spectral_bands.NARROWEST_BAND_NM:g} nm, or {spectral_bands.MAX_BANDS} of them, are the finest"
        told.append(f"mean electrons are right to {bound_e:.1e} only, asked for {tolerance_e:g}: {finest}")
    alone = len(emitters) == 1 and len(bodies) == 1 and emitters[0][1].props.plugin_name() == "area" and bool(lamps)
    return Plan(
        lights=tuple(lights),
        bands=bands,
        white_cd_per_m2=lamps[0].luminance_cd_per_m2 if alone and lamps[0].spectrum else None,
        lens=lens,
        integrator=integrator,
        spp=spp,
        diffraction=diffraction.kept,
        regular_tables=by_index,
        decisions=(*spectral, tables, bounces, focus, samples, diffraction),
        full_passes=full_passes,
        full_spp=most,
        chart=chart,
        tolerance_e=tolerance_e,
        warnings=tuple(told),
    )


def _witnesses(pixel: Pixel | None) -> list[Witness]:
    """Responses in electrons per joule, and the eye's."""
    pixels = [pixel] if pixel else [Pixel(technology=name, pitch_um=10.0) for name in RESPONSES]

    def response(physics: Any) -> spectral_bands.Response:
        return lambda nm: physics.quantum_efficiency(nm) * photons_per_joule(nm)

    return [*(Witness(response(derive(each))) for each in pixels), Witness(photopic_efficiency, LUMINANCE_SLACK)]


def _lights(
    lamps: list[Lamp],
    surfaces: Surfaces,
    bounces: int,
    witnesses: list[Witness],
    tolerance_e: float,
    full: bool,
    band_count: int | None,
) -> tuple[list[Light], Bands, int, list[Decision]]:
    """What to render of each lamp, in which bands, how many passes all bands would take, and why."""
    spectra = [lamp.spectrum for lamp in lamps if lamp.spectrum]
    met = surfaces.products(bounces) if bounces else surfaces.products(1)[:0]
    if band_count:
        bands = spectral_bands.equal_bands(band_count, spectra)
    else:
        bands = spectral_bands.place_bands(spectra, met, witnesses, tolerance_e * BANDS_SHARE)
    known = surfaces.spectra is not None or bounces == 0
    lights, reasons, most, alone = [], [], 0, 0.0
    for lamp in lamps:
        every = spectral_bands.every_band(lamp.spectrum, bands)
        most += len(every.passes)
        found: Fit | None = None
        if lamp.spectrum:
            errors = spectral_bands.band_errors(bands, spectral_bands.resolved(lamp.spectrum, met), witnesses)
            alone = max(alone, float(np.abs(errors.sum(axis=2)).max()))
            if known and not full:
                found = spectral_bands.fit(lamp.spectrum, bands, met, witnesses, tolerance_e * SPECTRUM_SHARE)
        lights.append(Light(lamp, found or every))
        count = len(lights[-1].fit.pulses)
        reasons.append(f"{count} pulse{'s' * (count > 1)}" if found else f"{count} bands")
    widths = bands.width_nm
    uniform = bool(np.all(np.isin(widths, (5.0, 10.0)))) and widths.size == spectral_bands.BAND_EDGES_NM.size - 1
    sizes = "uniform, 10 nm" if uniform else f"{widths.min():g} to {widths.max():g} nm, finer where lamps or surfaces change"
    told = f"{widths.size} bands, {sizes}, lamp-shaped: no line is missed"
    placing = Decision("wavelength bands", True, told, bound_e=alone)
    fewest = sum(len(light.fit.passes) for light in lights)
    error = max(light.fit.error for light in lights)
    reason, saved = _rank_reason(lamps, surfaces, met, reasons, full), f"{fewest} of {most} passes" if fewest < most else ""
    bounded = all(lamp.spectrum is not None for lamp in lamps) and known
    # The fit's error includes that of its bands.
    rank = Decision("spectral rank", fewest >= most, reason, saved, max(0.0, error - alone), bounded)
    return lights, bands, most, [placing, rank]


def _rank_reason(lamps: list[Lamp], surfaces: Surfaces, met: Array, counts: list[str], full: bool) -> str:
    each = " and ".join(counts) or "no light"
    lit = f"{len(lamps)} lamp spectr{'um' if len(lamps) == 1 else 'a'}"
    if full:
        return f"nothing left out: {lit}, {each}"
    if any(lamp.spectrum is None for lamp in lamps):
        return f"{lit}, one with colours that vary over it and stay in place: {each}"
    if surfaces.spectra is None:
        return f"{lit}; all bands, for {surfaces.unknown}: {each}"
    if not len(met):
        return f"{lit} on neutral surfaces or none: {each} for all bands"
    return f"{lit} × {len(surfaces.spectra)} surface spectra ({len(met)} with what meets several): {each} tell all bands"


GREEN_NM = 550.0
UNIFORM_RESOLUTION = 64  # tells the lens's fall-off to 3e-5 of the mean electrons at 20° off axis


def make_plan(
    scene: Scene,
    camera: Camera | None = None,
    pixel: Pixel | None = None,
    *,
    exposure: Exposure | None = None,
    tolerance_e: float = TOLERANCE_E,
    full: bool = False,
) -> Plan:
    """What a scene needs, what is left out, why, and what that can cost at most.

    Parameters
    ----------
    scene : from `load_scene`
    camera : None takes what the file says
    pixel : None takes the default one
    exposure : None takes the default one; its longest time says from which charge on a photodiode saturates
    tolerance_e : relative error of the mean electrons that all decisions may cost together
    full : leave nothing out

    Raises PixsimError for what cannot be rendered or sensed.

    >>> from pixsim import load_scene
    >>> plan = make_plan(load_scene("csf", resolution=64))
    >>> plan.passes, plan.bound_e < plan.tolerance_e  # a chart under one lamp: one picture tells all bands
    (1, True)
    """
    camera, pixel = camera or scene.camera(), pixel or Pixel()
    physics = derive(pixel)
    plan = make_render_plan(scene, camera, pixel, tolerance_e=tolerance_e, full=full)
    state = scene.for_camera(camera)
    _, width = film_size(state, sensor_node(state, scene.sensor_id)[1])
    free = "resolution" in scene.names and "resolution" not in scene.parameters
    exposure = exposure or Exposure()
    longest_s = exposure.integration_s or exposure.max_integration_s
    resolution, sampling = decide_oversampling(plan, camera, physics, max(1, width), full, free)
    more = sampling, decide_saturation(physics, longest_s), decide_noise(physics, full), decide_transforms(full)
    return replace(plan, resolution=resolution, decisions=(*plan.decisions, *more))


def decide_oversampling(
    plan: Plan, camera: Camera, physics: PixelPhysics, width: int, full: bool, free: bool
) -> tuple[int | None, Decision]:
    """A coarser film for a scene without detail; else the scene's own, and how it compares with the lens and the photodiode."""
    pitch_um = 1e3 * camera.die_mm / width
    nyquist = 1e3 / (2 * pitch_um)
    cutoff = float(cutoff_cy_per_mm(GREEN_NM, camera.effective_f_number))
    left = float(diffraction_otf(nyquist, GREEN_NM, camera.effective_f_number))
    told = (
        f"{width} samples of {pitch_um:.3g} µm across: {physics.photodiode_side_um / pitch_um:.2g} a photodiode side; "
        f"the lens passes {left:.0%} at their Nyquist frequency, {nyquist:.3g} of {cutoff:.3g} cy/mm"
    )
    uniform = plan.chart is not None and plan.chart.uniform
    # Of the fall-off at the middle of a sample as its mean over it: by halving the sample, since it goes with the width's square.
    lens = camera.image_distance_mm, camera.f_number, camera.magnification
    n = UNIFORM_RESOLUTION
    middle, parts = (field_factor((each, each), 1e3 * camera.die_mm / each, *lens) for each in (n, 2 * n))
    error = float(4 / 3 * np.abs(middle / parts.reshape(n, 2, n, 2).mean(axis=(1, 3)) - 1).max())
    if uniform and not full and free and width > UNIFORM_RESOLUTION and plan.bound_e + error <= plan.tolerance_e:
        reason = f"a scene without detail: {UNIFORM_RESOLUTION} samples across tell the fall-off"
        return UNIFORM_RESOLUTION, Decision("oversampling", False, reason, f"{UNIFORM_RESOLUTION}² of {width}² samples", error)
    return None, Decision("oversampling", True, told)


def decide_saturation(physics: PixelPhysics, integration_s: float) -> Decision:
    """Which law turns generated into kept charge, from which charge on it counts, and whether V(Q) is bent.

    The bound is on pictures that stay below the limit: 1e-6 of the well, relative to the limit itself.
    """
    pixel, diode = physics.pixel, physics.diode
    bent = pixel.conversion == "junction" and diode is not None and not diode.constant
    conversion = "; V(Q) by the junction, at every level" if bent else ""
    if pixel.well_limit == "swing" or diode is None:
        reason = f"linear charge up to a hard clip at the well, {physics.full_well_e:.3g} e-{conversion}"
        return Decision("saturation", True, reason)
    limit_e = linear_limit_e(diode, physics.full_well_e, integration_s)
    told = f"{limit_e:.3g} e- in {integration_s:.3g} s ({limit_e / physics.full_well_e:.0%} of the well)"
    if bent:
        return Decision("saturation", True, f"the diode turns forward above {told}{conversion}")
    reason = f"linear for pictures whose brightest pixel stays below {told}; others by the diode's table"
    return Decision("saturation", False, reason, "the table", LINEAR_WITHIN * physics.full_well_e / limit_e)


def decide_noise(physics: PixelPhysics, full: bool) -> Decision:
    """A noise source that is zero costs nothing."""
    sources = {
        "PRNU": physics.prnu,
        "dark current": physics.dark_current_e_per_s,
        "DSNU": physics.dsnu and physics.dark_current_e_per_s,
        "reset noise": physics.reset_noise_e,
        "read noise": physics.read_noise_e,
        "offset FPN": physics.offset_fpn_e,
        "column FPN": physics.column_fpn_e,
    }
    silent = [name for name, value in sources.items() if not value]
    if not silent or full:
        return Decision("noise stages", True, "shot noise, " + ", ".join(name for name, value in sources.items() if value))
    return Decision("noise stages", False, f"zero: {', '.join(silent)}", f"{len(silent)} of {len(sources) + 1} stages")


def decide_transforms(full: bool) -> Decision:
    """The viewer's filters: grey on a D65 display has three opponent channels, all multiples of one picture."""
    if full:
        return Decision("repeated transforms", True, "three forward and three inverse transforms an image")
    reason = "a grey image: one forward transform; its three opponent channels are blurred each in its own way; the ideal once"
    return Decision("repeated transforms", False, reason, "2 of 6 transforms an image")
