"""Decide what of a real lens a render needs: a thin lens in its place, or its distortion and its
blur by tiles.
"""

from __future__ import annotations

import math

import numpy as np

from pixsim.base.digits import f_stop, percent
from pixsim.base.notes import Note
from pixsim.light.spectral import photons_per_joule
from pixsim.optics.camera import Camera
from pixsim.optics.camera_lens import Tiling, choose_tiling, dark_share, thin_lens_error
from pixsim.scene.film import FILM_ROUNDING, SAMPLES_PER_DETAIL
from pixsim.scene.rules import Decision
from pixsim.scene.scene import Scene
from pixsim.sensor.pixel import PixelPhysics

# Light for which tiles are chosen: uniform in energy, weighted as the sensor sees it
SEEN_NM = np.arange(400.0, 701.0, 10.0)
_THIN_LENS_SHARE = 0.5  # of the tolerance, for a thin lens in place of the real one
_DEFOCUS = "defocus of the lens"  # subject of a decision
# of mean electrons, for the rms error of the blur over the rms of a picture: 1 % by default
_BLUR_TOLERANCES = 10.0


def decide_real_lens(
    scene: Scene,
    camera: Camera,
    pixel: PixelPhysics | None,
    tolerance_e: float,
    full: bool,
    aperture_um: float | None = None,
) -> tuple[Tiling | None, list[Decision]]:
    """Return how the blur of a real lens is computed, and the decision.

    There is no blur if a thin lens of its image distance and f-number gives the same electrons
    within the tolerance, and no decision either for a thin lens. All films with a sample or more
    across a photodiode have one tiling, made for two samples: photodiodes average what finer films
    add.

    aperture_um : side of a photodiode. None takes the pixel's, or two samples of the film if there
        is no pixel
    """
    lens = camera.lens
    if lens is None or camera.chief_ray_angle is None:
        return None, []

    # Light as the sensor sees it, on cells that are as wide as half a photodiode, or as the film's
    # if these are wider than a photodiode.
    weight = photons_per_joule(SEEN_NM) * (pixel.quantum_efficiency(SEEN_NM) if pixel else 1.0)
    film_um = 1e3 * camera.die_mm / scene.film_shape(camera, scene.parse())[1]
    aperture_um = aperture_um or (pixel.aperture_side_um if pixel else SAMPLES_PER_DETAIL * film_um)
    pitch_um = film_um if film_um > aperture_um else aperture_um / SAMPLES_PER_DETAIL
    height, width = (math.ceil(side_um / pitch_um - FILM_ROUNDING) for side_um in camera.die_um)

    # A thin lens in its place
    name = f"'{lens.file}' at {lens.focal_length_mm:.4g} mm {f_stop(lens.f_number)}"
    if not full:
        error = thin_lens_error(camera, pitch_um, SEEN_NM, weight, aperture_um)
        if error <= tolerance_e * _THIN_LENS_SHARE:
            reason = f"{name}: a thin lens gives the same electrons"
            return None, [Decision("real lens", False, reason, "distortion and tiles", error)]

    # Its blur by tiles
    target = _BLUR_TOLERANCES * tolerance_e / (4 if full else 1)
    tiling = choose_tiling(
        camera,
        (height, width),
        pitch_um,
        tuple(SEEN_NM.tolist()),
        tuple(weight.tolist()),
        aperture_um,
        target,
    )
    blur = f"no blur, on film cells of {pitch_um:.3g} µm"
    if tiling.psf_um:
        tiles = math.ceil(1e3 * max(camera.die_mm, camera.height_mm) / tiling.spacing_um)
        blur = (
            f"{tiles} tiles across with PSFs of {tiling.psf_um:.3g} µm, which lack up to"
            f" {percent(tiling.lacking, 1)} of the light"
        )
    reason = (
        f"{name}: {blur}; rms error up to {tiling.error:.1e} of the contrast of detail,"
        f" {tiling.worst:.1e} where it is largest"
    )
    return tiling, [Decision("real lens", True, reason, bounded=False)]


def real_lens_warnings(camera: Camera, tiling: Tiling | None, tolerance_e: float) -> list[Note]:
    """Return notes on the image circle of a real lens, and on a blur whose error exceeds the
    tolerance.
    """
    if camera.lens is None:
        return []
    notes = []
    if dark := dark_share(camera):
        notes.append(Note("image_circle", share=percent(dark, 1), lens=camera.lens.file))
    tolerance = _BLUR_TOLERANCES * tolerance_e  # of the contrast
    if tiling is not None and tiling.error > tolerance:
        reason = "the film is too coarse for it, and it is left out. Use a finer film"
        if tiling.psf_um:
            reason = (
                f"its PSFs of {tiling.psf_um:.3g} µm lack up to {percent(tiling.lacking, 1)} of the"
                " light"
            )
        size = (
            f"up to {percent(tiling.error, 1)} of the picture's contrast, above"
            f" {percent(tolerance, 1)}"
        )
        notes.append(
            Note(
                "lens_blur", words=f"the blur of the real lens has an rms error of {size}: {reason}"
            )
        )
    return notes


def out_of_focus() -> tuple[Decision, Note]:
    """Return the decision on the blur of things out of focus behind a real lens, and its note."""
    blur = "the disc of a thin lens and then the blur that the real lens has in focus"
    decision = Decision(
        _DEFOCUS, False, f"objects out of focus get {blur}", "a trace for each depth", bounded=False
    )
    return decision, Note(
        "lens_blur", words=f"objects out of focus get {blur}; its error is not known"
    )
