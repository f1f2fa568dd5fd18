"""The plan in full: what is rendered, and what the sensor and the viewer need of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pixsim import optics
from pixsim.parameters import Camera, Exposure, Pixel
from pixsim.pixel import PixelPhysics, derive
from pixsim.plan import Plan, make_render_plan
from pixsim.rules import TOLERANCE_E, Decision
from pixsim.saturation import LINEAR_WITHIN, linear_limit_e
from pixsim.scene import Scene, film_size, sensor_node

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
    return replace(
        plan,
        resolution=resolution,
        decisions=(
            *plan.decisions,
            sampling,
            decide_saturation(physics, longest_s),
            decide_noise(physics, full),
            decide_transforms(full),
        ),
    )


def decide_oversampling(
    plan: Plan, camera: Camera, physics: PixelPhysics, width: int, full: bool, free: bool
) -> tuple[int | None, Decision]:
    """A coarser film for a scene without detail; else the scene's own, and how it compares with the lens and the photodiode."""
    pitch_um = 1e3 * camera.die_mm / width
    nyquist = 1e3 / (2 * pitch_um)
    cutoff = float(optics.cutoff_cy_per_mm(GREEN_NM, camera.effective_f_number))
    left = float(optics.diffraction_otf(nyquist, GREEN_NM, camera.effective_f_number))
    told = (
        f"{width} samples of {pitch_um:.3g} µm across: {physics.photodiode_side_um / pitch_um:.2g} a photodiode side; "
        f"the lens passes {left:.0%} at their Nyquist frequency, {nyquist:.3g} of {cutoff:.3g} cy/mm"
    )
    uniform = plan.chart is not None and plan.chart.uniform
    error = _fall_off_error(camera, UNIFORM_RESOLUTION)
    if uniform and not full and free and width > UNIFORM_RESOLUTION and plan.bound_e + error <= plan.tolerance_e:
        reason = f"a scene without detail: {UNIFORM_RESOLUTION} samples across tell the fall-off"
        return UNIFORM_RESOLUTION, Decision("oversampling", False, reason, f"{UNIFORM_RESOLUTION}² of {width}² samples", error)
    return None, Decision("oversampling", True, told)


def _fall_off_error(camera: Camera, width: int) -> float:
    """Greatest relative error of the lens's fall-off at the middle of a sample as its mean over it, by halving the sample."""
    lens = camera.image_distance_mm, camera.f_number, camera.magnification
    middle, parts = (optics.field_factor((n, n), 1e3 * camera.die_mm / n, *lens) for n in (width, 2 * width))
    means = parts.reshape(width, 2, width, 2).mean(axis=(1, 3))
    return float(4 / 3 * np.abs(middle / means - 1).max())  # the error goes with the square of the width


def decide_saturation(physics: PixelPhysics, integration_s: float) -> Decision:
    """Which law turns generated into kept charge, from which charge on it counts, and whether V(Q) is bent.

    The bound is on pictures that stay below the limit: 1e-6 of the well, relative to the limit itself.
    """
    pixel, diode = physics.pixel, physics.diode
    bent = pixel.conversion == "junction" and diode is not None and not diode.constant
    conversion = "; V(Q) by the junction, at every level" if bent else ""
    if pixel.well_limit == "swing" or diode is None:
        return Decision(
            "saturation", True, f"linear charge up to a hard clip at the well, {physics.full_well_e:.3g} e-{conversion}"
        )
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
    return Decision(
        "repeated transforms",
        False,
        "a grey image: one forward transform; its three opponent channels are blurred each in its own way; the ideal once",
        "2 of 6 transforms an image",
    )
