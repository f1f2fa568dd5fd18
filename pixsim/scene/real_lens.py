"""Decide what of a real lens a render needs: a thin lens in its place, or its distortion and its blur by tiles."""

from __future__ import annotations

import math

import numpy as np

from pixsim.base.parameters import Camera, Pixel
from pixsim.light.spectral import photons_per_joule
from pixsim.optics.camera_lens import NODES, TILES, Tiling, choose_tiling, dark_share, distortion_of, thin_lens_error
from pixsim.scene.rules import Decision
from pixsim.scene.scene import Scene
from pixsim.sensor.pixel import derive

SEEN_NM = np.arange(400.0, 701.0, 10.0)  # light for which tiles are chosen: even in energy, as the sensor sees it
THIN_LENS_SHARE = 0.5  # of the tolerance, for a thin lens in place of the real one
BLUR_TOLERANCES = 10.0  # of mean electrons, for the rms error of the blur over the rms of a picture: 1 % by default


def decide_real_lens(
    scene: Scene, camera: Camera, pixel: Pixel | None, tolerance_e: float, full: bool
) -> tuple[Tiling | None, list[Decision]]:
    """Return how the blur of a real lens is computed, and the decision; None and no decision for a thin lens.

    None too if a thin lens of its image distance and f-number gives the same electrons within the tolerance.
    """
    if camera.lens is None or camera.chief_ray_angle is None:
        return None, []
    physics = derive(pixel) if pixel else None
    weight = photons_per_joule(SEEN_NM) * (physics.quantum_efficiency(SEEN_NM) if physics else 1.0)
    shape = scene.film_shape(camera, scene.parse())
    pitch_um = 1e3 * camera.die_mm / shape[1]
    aperture_um = physics.aperture_side_um if physics else 2 * pitch_um
    distortion = distortion_of(camera)
    assert distortion is not None
    words = f"'{camera.lens.file}' at {camera.lens.focal_length_mm:.4g} mm f/{camera.lens.f_number:.3g}; in the corner "
    words += f"{camera.chief_ray_angle[-1][2]:.0%} of the light, from {camera.chief_ray_angle[-1][1]:.3g} degrees; "
    words += f"shifts up to {1e3 * distortion.largest_mm:.3g} µm"
    if not full:
        error = thin_lens_error(camera, pitch_um, SEEN_NM, weight, aperture_um)
        if error <= tolerance_e * THIN_LENS_SHARE:
            reason = f"{words}: a thin lens gives the same electrons"
            return None, [Decision("real lens", False, reason, "distortion and tiles", error)]
    target = BLUR_TOLERANCES * tolerance_e / (4 if full else 1)
    tiling = choose_tiling(camera, shape, pitch_um, tuple(SEEN_NM.tolist()), tuple(weight.tolist()), aperture_um, target)
    tiles = math.ceil(1e3 * max(camera.die_mm, camera.height_mm) / tiling.spacing_um)
    reason = f"{words}; {tiles} tiles across with PSFs of {tiling.psf_um:.3g} µm, from wavefronts of {NODES} fields: rms error "
    return tiling, [Decision("real lens", True, f"{reason}up to {tiling.error:.1e} of the contrast", bounded=False)]


def real_lens_warnings(camera: Camera, tiling: Tiling | None, focus: Decision, tolerance_e: float) -> list[str]:
    """Return what a real lens does to the picture that the simulation cannot show rightly, or that a user may not expect."""
    if camera.lens is None:
        return []
    notes = []
    if dark := dark_share(camera):
        notes.append(f"{dark:.1%} of the die lies beyond the image circle of '{camera.lens.file}', where no light arrives")
    if tiling is not None and focus.kept:
        notes.append(
            f"not all of the scene is known to be in focus ({focus.reason}): the rest gets a thin lens's defocus, and then "
            "the blur that the real lens has in focus, which is wrong where both are of like size"
        )
    if tiling is not None and tiling.error > BLUR_TOLERANCES * tolerance_e:
        notes.append(
            f"the blur of the real lens has an rms error of up to {tiling.error:.1%} of the picture's contrast, above "
            f"{BLUR_TOLERANCES * tolerance_e:.1%}: its tiles reach their limit of {TILES[-1]} across the die, or its PSFs theirs"
        )
    return notes
