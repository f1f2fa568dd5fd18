"""What a scene's tree says can be left out without rendering it: bounces, the lens, samples, diffraction."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from pixsim.geometry import FLAT, Body, face_one_way, greatest_blur_um
from pixsim.lamps import parsed_table
from pixsim.mitsuba_xml import children, nodes_of
from pixsim.needs import SAMPLE_COUNTS, Chart, diffraction_effect, samples_needed
from pixsim.parameters import Camera, Pixel
from pixsim.pixel import derive
from pixsim.spectral import Array
from pixsim.spectrum import HIGH_NM, Spectrum, regular_values
from pixsim.surfaces import LAMBERTIAN
from pixsim.textures import emitted_picture

TOLERANCE_E = 1e-3  # relative error of the mean electrons
BLUR_SHARE, DIFFRACTION_SHARE = 0.1, 0.1  # of the tolerance
# A disc of diameter c carries 2c/(3π) of the light across an edge, which is on average in the middle of a pixel.
BLURRED_EDGE = 2 / (3 * math.pi)
AIRY_DIAMETER = 2.44  # first dark ring over λN (Goodman)
UNLIMITED = -1
LEAST_OF_A_PATH = 16  # samples: of 4, multijitter correlates the dimensions of a path (still_life: 0.8 % too dark)
ALIGNED = 1e-6  # of a chart's half width: so little may be off the axis, turned or short
# Emitters that a pinhole sees as the lens does: they shine alike to all sides, or cannot be seen.
ALIKE = ("area", "constant", "point", "spot", "directional", "projector")


@dataclass(frozen=True)
class Decision:
    """One line of the plan. `bound_e` is the greatest relative error of mean electrons that it can cost, where `bounded`."""

    subject: str
    kept: bool
    reason: str
    saved: str = ""
    bound_e: float = 0.0
    bounded: bool = True


def decide_bounces(state: Any, bodies: list[Body], full: bool) -> tuple[dict[str, Any] | None, int, Decision]:
    """(integrator in place of the scene's own, surfaces that light can meet, why).

    A flat emitter alone: depth 1. One surface at most, since flat, matt, one-sided surfaces that face one way are lit from
    outside, or since the scene says so: `direct` samples as `path` does, in less time. Else the scene's own.
    """
    own = next((int(node.props.get("max_depth", UNLIMITED)) for _, node in nodes_of(state, "Integrator")), UNLIMITED)
    told = "any number" if own < 0 else f"{max(own - 1, 0)}"
    met = UNLIMITED if own < 0 else max(own - 1, 0)
    if full:
        return None, met, Decision("bounces", True, f"the scene's own: {told}")
    paths = [node for _, node in nodes_of(state, "Integrator")]
    names = [node.props.plugin_name() for node in paths] or ["path"]
    if names != ["path"] or own in (0, 1) or nodes_of(state, "Medium"):
        return None, 1 if names == ["direct"] else met, Decision("bounces", True, f"the scene's own integrator, '{names[0]}'")
    hidden = {"hide_emitters": True} if paths and paths[0].props.get("hide_emitters", False) else {}
    shining = {index for index, node in nodes_of(state, "Shape") if _emitter_of(state, node) is not None}
    alone = len(bodies) == 1 and len(nodes_of(state, "Emitter")) == 1 and bodies[0].node in shining
    if alone and bodies[0].normal is not None:
        reason = "a flat emitter alone: its light meets nothing before the lens"
        return {"type": "path", "max_depth": 1, **hidden}, 0, Decision("bounces", False, reason, f"all of {told}")
    direct = {"type": "direct", **hidden}
    if own == 2:
        return direct, 1, Decision("bounces", False, "one, as the scene says: paths need no loop", "a third of the time")
    matt = all(node.props.plugin_name() == "diffuse" for _, node in nodes_of(state, "BSDF")) and not shining
    if matt and bodies and face_one_way(bodies):
        reason = "flat, one-sided, matt surfaces that face one way send each other no light"
        return direct, 1, Decision("bounces", False, reason, f"all but 1 of {told}")
    return None, met, Decision("bounces", True, f"surfaces may light each other; the scene's own: {told}")


def _emitter_of(state: Any, shape: Any) -> int | None:
    return next((index for index in children(shape, state).values() if state.nodes[index].type.name == "Emitter"), None)


def irregular_tables(state: Any) -> dict[tuple[int, str], tuple[Spectrum, Array]]:
    """(node, property) -> (table, its values at equal steps) of every surface's table that has equal steps in it."""
    found = {}
    for index, node in enumerate(state.nodes):
        if node.type.name not in ("BSDF", "Texture"):
            continue
        for name in node.props.keys():  # noqa: SIM118  (Properties is no dict)
            if node.props.type(name).name == "Spectrum" and not node.props[name].is_uniform():
                table = parsed_table(node.props[name])
                regular = regular_values(table)
                if regular is not None:
                    found[index, name] = table, regular
    return found


def decide_tables(state: Any, full: bool) -> tuple[bool, Decision]:
    """Tables at equal steps can be looked up by index; Mitsuba searches those that are written as pairs."""
    count = len(irregular_tables(state))
    if full or not count:
        told = "as they are" if full else "none that would be searched"
        return False, Decision("spectrum tables", True, told)
    return True, Decision("spectrum tables", False, f"{count} with equal steps: read by index, not searched", "the searches", 0.0)


def decide_lens(
    state: Any, camera: Camera, bodies: list[Body], aspect: float, pixel: Pixel | None, tolerance_e: float, full: bool
) -> tuple[Literal["thinlens", "perspective"], Decision]:
    """A pinhole sees the same as the lens where all that is seen is matt (or shines alike to all sides) and in focus."""
    seen = [body for body in bodies if body.in_view(camera, aspect)]
    blur = max((greatest_blur_um(camera, body) for body in seen), default=0.0)
    side_um = derive(pixel).photodiode_side_um if pixel else 1.0
    told = f"blur up to {blur:.3g} µm" if math.isfinite(blur) else "shapes of unknown size, or at the lens"
    if full:
        return "thinlens", Decision("lens samples", True, f"nothing left out ({told})")
    if nodes_of(state, "Medium"):
        return "thinlens", Decision("lens samples", True, "a medium")
    coloured = [node.props.plugin_name() for _, node in nodes_of(state, "BSDF") if node.props.plugin_name() not in LAMBERTIAN]
    distant = [node.props.plugin_name() for _, node in nodes_of(state, "Emitter")]
    if coloured:
        return "thinlens", Decision("lens samples", True, f"'{coloured[0]}' looks different from each point of the lens; {told}")
    if not set(distant) <= set(ALIKE):
        return "thinlens", Decision("lens samples", True, "a picture at infinity, or an emitter that is not matt")
    error = BLURRED_EDGE * blur / side_um
    if error > tolerance_e * BLUR_SHARE:
        return "thinlens", Decision("lens samples", True, f"not all in focus: {told}; samples are added until its noise is small")
    return "perspective", Decision(
        "lens samples", False, f"all that is seen is matt and in focus ({told})", "2 of 5 dimensions", error
    )


def lone_chart(state: Any, folder: Path, camera: Camera, bodies: list[Body], shape: tuple[int, int]) -> Chart | None:
    """The one flat emitter, where it faces the lens upright, on its axis, and fills the film; else None."""
    emitters = nodes_of(state, "Emitter")
    if len(bodies) != 1 or len(emitters) != 1 or emitters[0][1].props.plugin_name() != "area":
        return None
    body = bodies[0]
    node = state.nodes[body.node]
    if node.props.plugin_name() != FLAT[0] or body.corners is None or body.normal is None:
        return None
    half = [float(np.ptp(body.corners[:, axis])) / 2 for axis in (1, 0)]
    middle = body.corners.mean(axis=0)
    up, across = body.corners[1] - body.corners[0], body.corners[2] - body.corners[0]
    upright = max(abs(up[0]), abs(across[1])) <= ALIGNED * min(half)
    depth = float(middle[2])
    tangent = camera.die_mm / (2 * camera.image_distance_mm)
    view = (tangent * depth * shape[0] / shape[1], tangent * depth)
    centred = max(abs(middle[0]), abs(middle[1])) <= ALIGNED * min(half)
    covers = all(v <= h * (1 + ALIGNED) for v, h in zip(view, half, strict=True))
    if not (upright and centred and covers and abs(body.normal[2]) > 1 - 1e-9):
        return None
    texels = emitted_picture(state, emitters[0][1], folder)
    if texels is None:
        return None
    per_sample = tuple(v / h * n / film for v, h, n, film in zip(view, half, texels.shape, shape, strict=True))
    return Chart(texels, (per_sample[0], per_sample[1]), shape)


def decide_samples(
    chart: Chart | None, most: int, passes: int, tolerance_e: float, full: bool, explicit: bool
) -> tuple[int, Decision]:
    subject = "texture samples"
    if full or explicit:
        return most, Decision(subject, True, f"{most} a film cell, as {'the scene says' if full else 'asked for'}")
    if chart is None and most < LEAST_OF_A_PATH:
        told = f"{LEAST_OF_A_PATH} a film cell, the scene says {most}: with so few, multijitter makes paths too dark"
        return LEAST_OF_A_PATH, Decision(subject, True, told)
    if chart is None:
        told = f"{most} a film cell, as the scene says: edges and depth are known to the renderer only"
        if passes == 1:
            return most, Decision(subject, True, told)
        # Passes have seeds of their own, and the sum over bands averages their noise.
        each = next((count for count in SAMPLE_COUNTS if count >= max(most / passes, LEAST_OF_A_PATH)), most)
        each = min(each, most)
        saved = f"{each} of {most} samples a pass" if each < most else ""
        return each, Decision(subject, each == most, f"{told}; shared by {passes} passes, {each} each", saved)
    spp, error = samples_needed(chart, tolerance_e, most)
    if spp < most:
        return spp, Decision(
            subject, False, f"{spp} a film cell: the chart's detail gives {error:.1e} RMS", f"{spp} of {most} samples", 0.0
        )
    return most, Decision(subject, True, f"{most} a film cell, as the scene says: {error:.1e} RMS by the chart's detail")


def decide_diffraction(chart: Chart | None, camera: Camera, pitch_um: float, tolerance_e: float, full: bool) -> Decision:
    """Left out where it changes no sample of a lone chart by more than its share, at the longest wavelength."""
    disc_um = AIRY_DIAMETER * HIGH_NM / 1e3 * camera.effective_f_number
    told = f"Airy disc up to {disc_um:.3g} µm"
    if chart is None or full:
        return Decision("diffraction", True, f"{told}; what it does is known only from the picture" if not full else told)
    allowed = tolerance_e * DIFFRACTION_SHARE
    effect = diffraction_effect(chart, pitch_um, np.array([HIGH_NM]), np.ones(1), camera.effective_f_number, allowed)
    if effect > allowed:
        return Decision("diffraction", True, f"{told}; changes samples of this chart by up to {effect:.1%}")
    return Decision(
        "diffraction", False, f"{told}; changes no sample of this chart by more than {effect:.1e}", "2 transforms", effect
    )
