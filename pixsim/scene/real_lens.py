"""Decide what of a real lens a render needs: a thin lens in its place, or its distortion and its blur by tiles."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from pixsim.base.digits import f_stop, percent
from pixsim.base.notes import Note
from pixsim.light.spectral import photons_per_joule
from pixsim.optics.camera import Camera
from pixsim.optics.camera_lens import Tiling, choose_tiling, dark_share, thin_lens_error
from pixsim.optics.lens_defocus import Defocus, defocus_at, largest_disc_um, signed_disc_um, smallest_disc_um
from pixsim.scene.contents import LAMBERTIAN, Body
from pixsim.scene.film import FILM_ROUNDING, SAMPLES_PER_DETAIL
from pixsim.scene.rules import ALIKE, Decision
from pixsim.scene.scene import Scene
from pixsim.scene.tree import Tree, nodes_of
from pixsim.sensor.pixel import PixelPhysics

SEEN_NM = np.arange(400.0, 701.0, 10.0)  # light for which tiles are chosen: even in energy, as the sensor sees it
THIN_LENS_SHARE = 0.5  # of the tolerance, for a thin lens in place of the real one
DEFOCUS = "defocus of the lens"  # subject of a decision
NEAREST = 4.0  # times nearer than the plane in focus: the least depth of shapes that reach further, or of unknown size
MOST_STATED = 10.0  # of the contrast
BLUR_TOLERANCES = 10.0  # of mean electrons, for the rms error of the blur over the rms of a picture: 1 % by default


def decide_real_lens(
    scene: Scene, camera: Camera, pixel: PixelPhysics | None, tolerance_e: float, full: bool, aperture_um: float | None = None
) -> tuple[Tiling | None, list[Decision]]:
    """Return how the blur of a real lens is computed, and the decision; None and no decision for a thin lens.

    None too if a thin lens of its image distance and f-number gives the same electrons within the tolerance. All films with a
    sample or more across a photodiode have one tiling, that of two: photodiodes average what finer films add.

    aperture_um : side of a photodiode; None means that of the pixel, and two samples of the film without one
    """
    if camera.lens is None or camera.chief_ray_angle is None:
        return None, []
    weight = photons_per_joule(SEEN_NM) * (pixel.quantum_efficiency(SEEN_NM) if pixel else 1.0)
    film_um = 1e3 * camera.die_mm / scene.film_shape(camera, scene.parse())[1]
    aperture_um = aperture_um or (pixel.aperture_side_um if pixel else SAMPLES_PER_DETAIL * film_um)
    pitch_um = film_um if film_um > aperture_um else aperture_um / SAMPLES_PER_DETAIL
    height, width = (math.ceil(side_um / pitch_um - FILM_ROUNDING) for side_um in camera.die_um)
    name = f"'{camera.lens.file}' at {camera.lens.focal_length_mm:.4g} mm {f_stop(camera.lens.f_number)}"
    if not full:
        error = thin_lens_error(camera, pitch_um, SEEN_NM, weight, aperture_um)
        if error <= tolerance_e * THIN_LENS_SHARE:
            reason = f"{name}: a thin lens gives the same electrons"
            return None, [Decision("real lens", False, reason, "distortion and tiles", error)]
    target = BLUR_TOLERANCES * tolerance_e / (4 if full else 1)
    tiling = choose_tiling(camera, (height, width), pitch_um, tuple(SEEN_NM.tolist()), tuple(weight.tolist()), aperture_um, target)
    tiles = math.ceil(1e3 * max(camera.die_mm, camera.height_mm) / tiling.spacing_um)
    blur = f"no blur, on film cells of {pitch_um:.3g} µm"
    if tiling.psf_um:
        blur = (
            f"{tiles} tiles across with PSFs of {tiling.psf_um:.3g} µm, which lack up to {percent(tiling.lacking, 1)} of the light"
        )
    reason = f"{name}: {blur}; rms error up to {tiling.error:.1e} of the contrast of detail, {tiling.worst:.1e} where it is largest"
    return tiling, [Decision("real lens", True, reason, bounded=False)]


def decide_defocus(
    state: Tree, bodies: Sequence[Body], camera: Camera, seen: Camera, aspect: float, pixel: PixelPhysics | None
) -> tuple[list[Defocus], list[Decision]]:
    """Return what the thin lens's defocus is off at depths of the scene, largest errors first, and the decision.

    Neither if all of it is in focus.

    camera, seen : with the real lens, and the thin lens through which the scene is rendered
    """
    weight = photons_per_joule(SEEN_NM) * (pixel.quantum_efficiency(SEEN_NM) if pixel else 1.0)
    least_um = smallest_disc_um(camera, float((weight * SEEN_NM).sum() / weight.sum()))
    ranges, unknown = depth_ranges_m([body for body in bodies if body.in_view(seen, aspect)], camera, state)
    discs = tried_discs_um([(signed_disc_um(camera, near), signed_disc_um(camera, far)) for near, far in ranges], least_um, camera)
    if not discs:
        return [], []
    aperture_um = pixel.aperture_side_um if pixel else max(least_um, 1.0)
    light = tuple(SEEN_NM.tolist()), tuple(weight.tolist()), aperture_um
    errors = sorted((defocus_at(camera, disc, *light) for disc in discs), key=lambda item: -item.error)
    words = f"out of focus, a thin lens's discs with the blur that the lens has in focus: rms error up to {_amount(errors[0])}"
    if unknown:
        words += f"; {unknown}"
    if any(node.plugin not in LAMBERTIAN for _, node in nodes_of(state, "BSDF")):
        words += "; what surfaces mirror or refract lies at other depths, which are not looked at"
    return errors, [Decision(DEFOCUS, False, words, "a trace for each depth", bounded=False)]


def depth_ranges_m(bodies: Sequence[Body], camera: Camera, state: Tree) -> tuple[list[tuple[float, float]], str]:
    """Return the nearest and farthest depths of bodies, and what of the scene has no known place.

    Bodies reach to a part of the distance in focus at least; from there to infinity goes what has no known place.
    """
    nearest = camera.object_distance_m / NEAREST
    ranges, unknown = [], 0
    for body in bodies:
        if body.corners is None:
            unknown += 1
            continue
        near, far = body.depths_m
        if far > 0:
            ranges.append((near if near > 0 and far < nearest else min(max(near, nearest), far), far))
    if unknown:
        ranges.append((nearest, math.inf))
    if any(node.plugin not in ALIKE for _, node in nodes_of(state, "Emitter")):
        ranges.append((math.inf, math.inf))
    words = f"{unknown} shape{'s' * (unknown > 1)} of unknown size taken as from {nearest:.3g} m to infinity" if unknown else ""
    return ranges, words


def tried_discs_um(ranges: Sequence[tuple[float, float]], least_um: float, camera: Camera) -> list[float]:
    """Return discs, with sign, at which defocus is computed: at most one an octave and sign, of those that ranges of depth have.

    Discs below `least_um` count less than diffraction; in place of those beyond `largest_disc_um` its disc is computed.
    """
    limit_um = largest_disc_um(camera, float(SEEN_NM[0]))
    octaves = [least_um * 2.0**k for k in range(math.ceil(math.log2(max(limit_um / least_um, 1.0))) + 1)]
    ladder = [sign * min(disc, limit_um) for disc in octaves for sign in (-1, 1)]
    discs_um: dict[tuple[bool, int], float] = {}
    for low, high in ranges:
        for disc in [low, high, *(step for step in ladder if low < step < high)]:
            size = min(abs(disc), limit_um)
            if size >= least_um / 2:
                place = disc > 0, round(math.log2(size / least_um))
                discs_um[place] = max(discs_um.get(place, 0.0), size)
    return [size if behind else -size for (behind, _), size in sorted(discs_um.items())]


def _amount(defocus: Defocus) -> str:
    """Return an error with where it is."""
    where = "infinity" if math.isinf(defocus.depth_m) else f"{defocus.depth_m:.3g} m"
    size = f"{percent(defocus.error, 1)} of the contrast" if defocus.error < MOST_STATED else "more than the contrast"
    return f"{size} at {where}, with discs of {defocus.disc_um:.3g} µm"


def real_lens_warnings(camera: Camera, tiling: Tiling | None, defocus: Sequence[Defocus], tolerance_e: float) -> list[Note]:
    """Return what a real lens does to the picture that the simulation cannot show rightly, or that a user may not expect."""
    if camera.lens is None:
        return []
    notes = []
    if dark := dark_share(camera):
        notes.append(Note("image_circle", share=percent(dark, 1), lens=camera.lens.file))
    tolerance = BLUR_TOLERANCES * tolerance_e  # of the contrast
    if defocus and defocus[0].error > tolerance:
        words = (
            "what is out of focus gets a thin lens's disc and the blur that the real lens has in focus, which is wrong by more "
            f"than {percent(tolerance, 1)}: {_amount(defocus[0])}"
        )
        notes.append(Note("lens_blur", words=words))
    if tiling is not None and tiling.error > tolerance:
        reason = "the film is too coarse for it, and it is left out. Take a finer film"
        if tiling.psf_um:
            reason = f"its PSFs of {tiling.psf_um:.3g} µm lack up to {percent(tiling.lacking, 1)} of the light"
        size = f"up to {percent(tiling.error, 1)} of the picture's contrast, above {percent(tolerance, 1)}"
        notes.append(Note("lens_blur", words=f"the blur of the real lens has an rms error of {size}: {reason}"))
    return notes
