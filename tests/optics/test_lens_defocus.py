"""Defocus of a real lens: against Hopkins' closed form, and against pictures blurred by traces at the defocused distance."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import fftconvolve

from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.camera_lens import camera_with_lens, fitted_wavefronts, traced_lens
from pixsim.optics.field_blur import ChannelWavefronts, even_window, picture_error
from pixsim.optics.lens_defocus import (
    BESIDE_DISC,
    CELLS_PER_DISC,
    SLOPE,
    defocus_at,
    defocus_error,
    depth_of_disc_m,
    disc_mtf,
    largest_disc_um,
    signed_disc_um,
    wavefronts_at_depth,
)
from pixsim.optics.lens_options import LensOptions
from tests.optics.test_field_blur import blur_of, hopkins
from tests.scene.test_real_lens import THIN

NM = (550.0,)


def with_lens(file: str, die_mm: float, distance_m: float = 1.0, **options: object) -> Camera:
    return camera_with_lens(Camera(die_mm=die_mm, object_distance_m=distance_m), CameraOptions(), LensOptions(file=file, **options))


def test_disc_has_the_zero_of_its_bessel_function() -> None:
    assert float(disc_mtf(np.array([0.0]), 10.0)[0]) == pytest.approx(1.0, abs=1e-12)
    assert float(disc_mtf(np.array([1e3 * 1.2196699 / 10.0]), 10.0)[0]) == pytest.approx(0.0, abs=1e-7)
    curvature = (1 - float(disc_mtf(np.array([0.1]), -10.0)[0])) / (math.pi * 0.1 * 1e-2) ** 2
    assert curvature == pytest.approx(1 / 8, rel=1e-5)  # 2 J₁(x)/x = 1 - x²/8


@pytest.mark.parametrize("signed_um", [-20.0, 0.0, 5.0])
def test_depths_and_discs_are_inverse_and_the_disc_is_the_thin_lens_s(signed_um: float) -> None:
    camera = Camera(focal_length_mm=25.0, f_number=2.0)
    depth_m = depth_of_disc_m(camera, signed_um)
    assert signed_disc_um(camera, depth_m) == pytest.approx(signed_um, abs=1e-9)
    image_mm = 1e3 * depth_m * 25.0 / (1e3 * depth_m - 25.0)
    gap = (camera.image_distance_mm - image_mm) / image_mm  # of the marginal rays, over their distance from the axis
    assert 1e3 * 25.0 / 2.0 * gap == pytest.approx(signed_um, rel=1e-9, abs=1e-9)


def test_in_focus_the_wavefront_is_that_of_the_blur_and_nothing_is_off() -> None:
    camera = with_lens("cooke_triplet", 24.0)
    there, known = wavefronts_at_depth(camera, 1.0, NM)[0], fitted_wavefronts(camera, NM, 17)[0]
    for height_um, numbers in zip(there.height_um.tolist(), there.numbers, strict=True):
        np.testing.assert_allclose(numbers[:30], known.at(height_um)[:30], atol=3e-3)
    assert defocus_error(camera, 1.0, NM, (1.0,), 2.0) < 1e-6


def test_defocus_of_a_perfect_lens_is_off_by_diffraction_as_hopkins_has_it(tmp_path: Path) -> None:
    """The wave's OTF against disc times diffraction: a closed form, of a quarter of a wave to two."""
    file = tmp_path / "thin.toml"
    file.write_text(THIN, encoding="utf-8")
    camera = with_lens(str(file), 0.1, focal_length_mm=10.0)
    aperture_um, effective = 40.0, camera.effective_f_number
    light = ChannelWavefronts(wavefronts_at_depth(camera, 1.0, NM), np.ones(1))
    for w20 in (0.25, 2.0):
        disc_um = 8 * w20 * NM[0] * 1e-3 * effective  # marginal rays: 2 λ W₂₀/NA on each side, NA = 1/(2 N)
        pitch_um = max(aperture_um / 2, disc_um / CELLS_PER_DISC)
        window = even_window(light, 0.0, 0.0, pitch_um, 2 * round((disc_um / pitch_um + BESIDE_DISC) / 2) + 1)
        frequency = np.hypot(np.fft.fftfreq(window, pitch_um * 1e-3)[:, None], np.fft.rfftfreq(window, pitch_um * 1e-3))
        reduced = np.maximum(2 * frequency * NM[0] * 1e-6 * effective, 1e-6)
        inside = reduced < 2
        exact = np.zeros(frequency.shape, complex)
        sharp = exact.copy()
        exact[inside] = hopkins(reduced[inside], w20)
        half = reduced[inside] / 2
        sharp[inside] = 2 / math.pi * (np.arccos(half) - half * np.sqrt(1 - half**2))
        wanted = picture_error(sharp * disc_mtf(frequency, disc_um), exact, pitch_um, aperture_um, SLOPE)
        found = defocus_error(camera, depth_of_disc_m(camera, -disc_um), NM, (1.0,), aperture_um)
        assert found == pytest.approx(wanted, rel=0.02)


SIDE, PITCH_UM, CELLS = 192, 4.0, 65


def dots_and_steps() -> np.ndarray:
    """Squares of random brightness, whose power falls as f⁻² and faster."""
    generator = np.random.default_rng(8)
    squares = sum(np.kron(generator.random((SIDE // side, SIDE // side)), np.ones((side, side))) for side in (6, 12, 24, 48))
    return np.asarray(squares)


# The phone's lens is the most aberrated; the others lie between it and a perfect one, which has a closed form above.
@pytest.mark.parametrize(
    ("file", "disc_um"),
    [*(pytest.param(*lens, marks=pytest.mark.slow) for lens in (("singlet", 12.0), ("cooke_triplet", -24.0))), ("phone", -16.0)],
)
def test_stated_error_is_that_against_a_trace_at_the_defocused_distance(file: str, disc_um: float) -> None:
    """A picture blurred by the lens with the object at its own depth, against the thin lens's disc blurred as in focus."""
    distance_m = 0.1
    camera = with_lens(file, SIDE * PITCH_UM * 1e-3, distance_m, focal_length_mm=1.0 if file == "phone" else 4.0)
    depth_m = depth_of_disc_m(camera, disc_um)
    everywhere = tuple(np.linspace(0, 1, 9).tolist())
    there, focused = (
        ChannelWavefronts(wavefronts_at_depth(camera, depth, NM, everywhere), np.ones(1)) for depth in (depth_m, distance_m)
    )
    exact, in_focus = (blur_of(light, (SIDE, SIDE), PITCH_UM, 12, CELLS) for light in (there, focused))
    # The disc as means over cells, from 16 × 16 points in each.
    fine = (np.arange(CELLS * 16) - (CELLS * 16 - 1) / 2) * PITCH_UM / 16
    inside = np.hypot(fine, fine[:, None]) <= abs(disc_um) / 2
    disc = inside.reshape(CELLS, 16, CELLS, 16).mean(axis=(1, 3))
    picture = dots_and_steps()
    wide = np.pad(picture, CELLS // 2, "symmetric")
    simulated = in_focus.blurred(fftconvolve(wide, disc / disc.sum(), "valid"))
    right = exact.blurred(picture)
    error = float(np.sqrt(np.mean((simulated - right) ** 2)) / right.std())
    stated = defocus_error(camera, depth_m, NM, (1.0,), PITCH_UM)
    assert stated / 5 < error < stated
    assert error > 0.01  # not separable, and it is said


def test_of_large_discs_the_largest_that_is_judged_stands_for_all() -> None:
    camera = with_lens("singlet", 6.0)
    limit_um = largest_disc_um(camera, NM[0])
    far = defocus_at(camera, -1e4, NM, (1.0,), 2.0)
    assert far.disc_um == 1e4
    assert far.error == defocus_at(camera, -limit_um, NM, (1.0,), 2.0).error
    assert math.isinf(depth_of_disc_m(camera, 1e4))


def test_depths_from_which_no_light_arrives_are_infinitely_wrong() -> None:
    camera = with_lens("phone", 4.8)
    lens = traced_lens(camera.lens, 1.0)  # type: ignore[arg-type]
    assert replace(lens, object_distance_mm=1e-4).object_distance_mm < lens.entrance_pupil_diameter_mm
    assert defocus_error(camera, 1e-7, NM, (1.0,), 2.0) == math.inf
