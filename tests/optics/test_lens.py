"""Traced lenses against closed forms, conservation laws and the values that three other programs
agree on.
"""

from __future__ import annotations

import time
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pixsim
from pixsim.base.toml import packaged
from pixsim.optics.glass import AIR, constant_glass
from pixsim.optics.lens import Lens, lens_from_prescription
from pixsim.optics.prescription import Prescription, Surface
from pixsim.optics.ray_trace import rays_from, trace
from pixsim.optics.thin_lens import irradiance_factor

DATA = Path(__file__).parents[1] / "data" / "lenses"
LENSES = (
    "achromat_pair_55278",
    "cooke_triplet",
    "double_gauss",
    "double_gauss_us583336",
    "phone",
    "retrofocus",
    "singlet",
)
GLASS = constant_glass("n = 1.5", 1.5)
WAVES = 1e-9  # the floor of float64 for paths near 100 mm


@cache
def lens_named(name: str) -> Lens:
    return pixsim.load_lens(name if name in packaged("data/lenses") else str(DATA / f"{name}.toml"))


@cache
def all_references() -> dict[str, np.ndarray]:
    return dict(np.load(DATA / "reference.npz"))


def reference(name: str) -> dict[str, Any]:
    return {
        key.partition(".")[2]: value
        for key, value in all_references().items()
        if key.startswith(f"{name}.")
    }


def made_of(*surfaces: Surface, diameter: float = 20.0, field: float = 0.0, stop: int = 0) -> Lens:
    kind, aperture = "angle_deg", "entrance_pupil_diameter"
    return lens_from_prescription(
        Prescription(
            "test", "", "", surfaces, stop, aperture, diameter, kind, field, (550.0,), 550.0
        )
    )


def disc(count: int = 21) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.meshgrid(*[np.linspace(-1, 1, count)] * 2)
    return x[np.hypot(x, y) <= 1], y[np.hypot(x, y) <= 1]


# Closed forms


def test_cartesian_oval_has_no_wavefront_error() -> None:
    """An ellipsoid of conic -1/n² focuses parallel light at n R/(n-1) in its glass."""
    lens = made_of(Surface(1 / 20, 60.0, GLASS, conic=-1 / 1.5**2))
    assert lens.first_order(550.0).focal_length_mm == pytest.approx(40.0, rel=1e-14)
    assert np.abs(lens.opd_waves(0.0, 550.0, *disc())).max() < WAVES


def aplanatic(scale: float = 1.0) -> Lens:
    """A hyperboloid that focuses exactly, then a sphere whose aplanatic point lies in that focus,
    with the image in its glass.
    """
    radius, n = 10.0 * scale, 1.5
    focus = 40.0 * scale / (n - 1)
    gap = focus - radius * (1 + n)
    return made_of(
        Surface(0.0, 8.0 * scale, GLASS),
        Surface(-1 / (40.0 * scale), gap, AIR, conic=-(n**2)),
        Surface(1 / radius, radius * (1 + 1 / n), GLASS),
        diameter=20.0 * scale,
    )


def test_aplanatic_sphere_has_no_wavefront_error_and_meets_the_sine_condition() -> None:
    """Far outside the paraxial region: an aplanatic point at n R from the centre, imaged at R/n."""
    lens, n = aplanatic(0.9), 1.5
    x, y = disc()
    assert np.abs(lens.opd_waves(0.0, 550.0, x, y)).max() < WAVES
    waves = lens.wavefront(0.0, 550.0, np.linspace(0.1, 1, 10), np.zeros(10))
    height = np.linspace(0.1, 1, 10) * lens.stop_semi_diameter_mm  # the stop is the plane in front
    curvature, focus = 1 / 36.0, 72.0
    sag = curvature * height**2 / (1 + np.sqrt(1 + (n**2 - 1) * (curvature * height) ** 2))
    converging = height / np.hypot(height, focus + sag)
    # Rounding: 1.7e-14 on a processor with AVX-512, less on others.
    assert np.abs(-waves.cosines[0, :, 0] - n * converging).max() < 1e-13, "sin u' = n sin u"
    assert converging[-1] * n > 0.15


def test_two_hyperboloids_image_a_near_point_without_error() -> None:
    """Light from a focus of the first, of conic -n², is parallel in the glass, and meets again in
    the focus of the second.
    """
    n, radius = 1.5, 20.0
    focus = radius / (n - 1)
    surfaces = (
        Surface(1 / radius, 10.0, GLASS, conic=-(n**2)),
        Surface(-1 / radius, focus, AIR, conic=-(n**2)),
    )
    lens = replace(made_of(*surfaces), object_distance_mm=focus)
    assert np.abs(lens.opd_waves(0.0, 550.0, *disc())).max() < WAVES
    assert lens.paraxial_height_mm == pytest.approx(focus, rel=1e-12), "magnification -1"
    assert lens.refocused("paraxial", focus).prescription.surfaces[
        -1
    ].thickness_mm == pytest.approx(focus, rel=1e-12)


def test_telecentric_lens_has_its_stop_in_the_focal_plane() -> None:
    """Chief rays are parallel to the axis there, and the exit pupil is far away: in front of the
    image or behind it.
    """
    radius, n = 50.0, 1.5
    focal = radius / (
        n - 1
    )  # a plano-convex lens; its front focal plane lies a focal length before the curved vertex
    gap = focal - 4.0 / n  # of the plane side, whose principal plane lies d/n inside
    glass = Surface(0.0, 4.0, GLASS), Surface(-1 / radius, focal)
    either = [
        made_of(Surface(0.0, gap + near), *glass, diameter=5.0, field=3.0)
        for near in (-1e-6, 0.0, 1e-6)
    ]
    far = [lens.first_order(550.0).exit_pupil_from_image_mm for lens in either]
    assert min(map(abs, far)) > 1e8
    assert far[0] * far[2] < 0
    lens = either[1]
    assert abs(float(lens.chief_ray(1e-3, 550.0).angle_deg)) < 1e-8
    x, y = disc(7)
    fronts = [lens.opd_waves(3.0, 550.0, x, y) for lens in either]
    assert np.abs(fronts[1]).max() > 0.5
    # A stop 1e-6 mm away moves the rays by 5e-8 mm, 2e-8 of its radius, and the wavefront by as
    # much of its slope.
    assert max(np.abs(fronts[1] - fronts[0]).max(), np.abs(fronts[1] - fronts[2]).max()) < 1e-5


def test_stop_may_lie_behind_the_lens() -> None:
    """The entrance pupil is then the stop's virtual image; the chief ray goes through the middle of
    the stop.
    """
    surfaces = Surface(1 / 50, 4.0, GLASS), Surface(-1 / 50, 6.0), Surface(0.0, 40.0)
    lens = made_of(*surfaces, diameter=6.0, field=5.0, stop=2)
    assert lens.first_order(550.0).entrance_pupil_from_first_vertex_mm > 8
    points = lens.ray_points(5.0, 550.0, 0.0, 0.0)[0]
    assert np.abs(points[2, :2]).max() < 1e-9
    assert points[2, 2] == pytest.approx(10.0)
    assert points[3, 1] == pytest.approx(float(lens.chief_ray(5.0, 550.0).height_mm), abs=1e-9)


@pytest.mark.parametrize("angle", [0.0, 20.0, 55.0])
def test_plane_plate_shifts_rays_by_its_closed_form(angle: float) -> None:
    """Path through a plate of thickness d behind which the ray is parallel: n d/cos θ' and d tan
    θ'.
    """
    d, n, sine = 50.0, 1.5, np.sin(np.radians(angle))
    inside = np.arcsin(sine / n)
    one = np.ones((1, 1))
    start = rays_from(
        0 * one, 0 * one, 0 * one, 0 * one, sine * one, np.cos(np.radians(angle)) * one
    )
    *_, rays = trace(start, [Surface(0.0, d, GLASS), Surface(0.0, 1.0)], [1.0, n, 1.0])
    assert rays.y[0, 0] == pytest.approx(d * np.tan(inside), rel=1e-14)
    assert rays.m[0, 0] == pytest.approx(sine, abs=1e-15)
    assert abs(rays.path_mm[0, 0] - n * d / np.cos(inside)) / 550e-6 < WAVES


def test_ray_through_a_sphere_crosses_the_axis_in_its_closed_form() -> None:
    """By the law of sines in the triangle of the sphere's centre, the point on it and the
    crossing.
    """
    radius, image = 50.0, 150.0
    lens = made_of(Surface(1 / radius, image, GLASS), diameter=30.0)
    waves = lens.wavefront(0.0, 550.0, np.zeros(1), np.ones(1))
    normal = np.arcsin(lens.stop_semi_diameter_mm / radius)
    bent = np.arcsin(np.sin(normal) / 1.5)
    crossing = radius * (1 + np.sin(bent) / np.sin(normal - bent))
    assert waves.y_mm[0, 0] == pytest.approx((crossing - image) * np.tan(normal - bent), rel=1e-12)


@pytest.mark.parametrize("field", [0.0, 10.0])
def test_transverse_error_is_the_slope_of_the_wavefront(field: float) -> None:
    """-s λ ∂W/∂(exit pupil), with the way s from the reference sphere to the image: the sign that
    the blur of a picture needs.
    """
    lens, step = lens_named("singlet"), 1e-4
    waves = lens.wavefront(field, 550.0, np.zeros(3), np.array([0.6 - step, 0.6, 0.6 + step]))
    error, along = waves.y_mm[0], waves.cosines[0, :, 1]
    radius = np.hypot(
        waves.chief_y_mm[0], lens.first_order(lens.primary_nm).exit_pupil_from_image_mm
    )
    way = error * along + np.sqrt((error * along) ** 2 - error**2 + radius**2)
    pupil = error - way * along
    slope = (waves.opd_waves[0, 2] - waves.opd_waves[0, 0]) / (pupil[2] - pupil[0])
    assert -way[1] * 550e-6 * slope == pytest.approx(error[1], rel=1e-5)
    assert abs(error[1]) > 0.01


# Other programs


@pytest.mark.parametrize("name", LENSES)
def test_first_order_data_agree_with_other_programs(name: str) -> None:
    lens, want = lens_named(name), reference(name)
    for index, wavelength_um in enumerate(want["wavelength_um"]):
        first = lens.first_order(1e3 * wavelength_um)
        assert first.focal_length_mm == pytest.approx(want["efl_w_mm"][index], rel=1e-10)
        assert first.back_focal_length_mm == pytest.approx(want["bfl_w_mm"][index], rel=1e-10)
        assert first.entrance_pupil_from_first_vertex_mm == pytest.approx(
            want["epl_w_mm"][index], rel=1e-10, abs=1e-10
        )
        assert first.exit_pupil_from_image_mm == pytest.approx(want["xpl_w_mm"][index], rel=1e-10)
        assert first.exit_pupil_diameter_mm == pytest.approx(want["xpd_w_mm"][index], rel=1e-10)
        assert first.entrance_pupil_diameter_mm == pytest.approx(float(want["epd_mm"]), rel=1e-10)


@pytest.mark.parametrize("name", LENSES)
def test_aimed_rays_agree_with_other_programs(name: str) -> None:
    """Chief rays at all wavelengths, and wavefronts over the real stop at the primary one."""
    lens, want = lens_named(name), reference(name)
    assert lens.stop_semi_diameter_mm == pytest.approx(float(want["real_stop_semi_mm"]), rel=1e-12)
    chief = lens.chief_ray(want["field_deg"][:, None], 1e3 * want["wavelength_um"])
    assert np.abs(chief.height_mm - want["aimed_chief_image_height_mm"]).max() < 1e-9
    assert np.abs(chief.angle_deg - want["aimed_chief_angle_image_deg"]).max() < 1e-8
    primary = 1e3 * float(want["primary_um"])
    opd = lens.opd_waves(want["field_deg"][:, None], primary, *want["pupil"])
    assert np.abs(opd - want["aimed_opd_waves"]).max() < 1e-6
    waves = lens.wavefront(want["field_deg"], primary, *want["pupil"])
    assert np.array_equal(waves.passed, want["aimed_pass_mask"] > 0)
    x, y = want["aimed_hex_stop_xy_mm"].transpose(2, 0, 1) / lens.stop_semi_diameter_mm
    for index, field in enumerate(want["field_deg"]):
        hexagon = lens.wavefront(field, primary, x[index], y[index])
        found = np.stack(
            [hexagon.x_mm[0], hexagon.y_mm[0] + hexagon.chief_y_mm, *hexagon.cosines[0].T], axis=1
        )
        assert np.abs(found - want["aimed_hex_xyzLMN"][index][:, [0, 1, 3, 4]])[:, :2].max() < 1e-9
        assert np.abs(found - want["aimed_hex_xyzLMN"][index][:, [0, 1, 3, 4]])[:, 2:].max() < 1e-10


@pytest.mark.parametrize("name", LENSES)
def test_unaimed_rays_agree_with_other_programs(name: str) -> None:
    """Rays through the paraxial entrance pupil, at all fields and wavelengths: points, directions,
    wavefronts, what passes.
    """
    lens, want = lens_named(name), reference(name)
    fields, wavelengths = (
        part.ravel()
        for part in np.meshgrid(want["field_deg"], 1e3 * want["wavelength_um"], indexing="ij")
    )
    radius = lens.entrance_pupil_diameter_mm / 2
    hexagon = lens.unaimed_wavefront(fields, wavelengths, *(radius * part for part in want["hex"]))
    points = want["hex_xyzLMN"].reshape(fields.size, -1, 6)
    assert np.abs(hexagon.x_mm - points[..., 0]).max() < 1e-9
    assert np.abs(hexagon.y_mm + hexagon.chief_y_mm[:, None] - points[..., 1]).max() < 1e-9
    assert np.abs(hexagon.cosines - points[..., 3:5]).max() < 1e-10
    waves = lens.unaimed_wavefront(fields, wavelengths, *(radius * part for part in want["pupil"]))
    assert np.abs(waves.opd_waves - want["opd_waves"].reshape(waves.opd_waves.shape)).max() < 1e-6
    assert np.array_equal(waves.passed, want["pass_mask"].reshape(waves.passed.shape) > 0)
    paraxial_height = want["efl_w_mm"][want["wavelength_um"] == want["primary_um"]] * np.tan(
        np.radians(fields)
    )
    where = fields > 0
    percent = 100 * (waves.chief_y_mm / np.where(where, paraxial_height, 1.0) - 1)
    assert np.abs(percent - want["distortion_percent_ftan"].ravel())[where].max() < 1e-8


@pytest.mark.parametrize("name", ["cooke_triplet", "phone"])
def test_rms_wavefront_agrees_with_other_programs(name: str) -> None:
    """Over the same grid of 64² points, piston removed."""
    lens, want = lens_named(name), reference(name)
    grid = (np.arange(64) - 31.5) / 32
    opd = lens.opd_waves(
        want["field_deg"][:, None, None], 1e3 * float(want["primary_um"]), grid, grid[:, None]
    )
    assert np.nanstd(opd, axis=(1, 2)) == pytest.approx(
        want["aimed_rms_piston_removed_waves"], rel=1e-6
    )


# Aiming


def test_shapes_broadcast_and_mirror_images_are_equal() -> None:
    lens = lens_named("cooke_triplet")
    fields, wavelengths = np.array([0.0, 14.0]), np.array([480.0, 550.0, 650.0])
    x, y = np.array([-0.5, 0.5, 0.0, 0.9]), np.array([0.3, 0.3, -1.0, 0.9])
    whole = lens.opd_waves(fields[:, None, None], wavelengths[:, None], x, y)
    assert whole.shape == (2, 3, 4)
    assert np.isnan(whole[..., 3]).all(), "outside the stop"
    assert np.array_equal(whole[..., 0], whole[..., 1])
    for index in np.ndindex(2, 3, 3):
        one = lens.opd_waves(fields[index[0]], wavelengths[index[1]], x[index[2]], y[index[2]])
        assert one == whole[index]
    together = lens.opd_waves(fields, 550.0, np.array([0.1, 0.2]), np.array([0.5, 0.6]))
    singly = [
        float(lens.opd_waves(*values))
        for values in ((0.0, 550.0, 0.1, 0.5), (14.0, 550.0, 0.2, 0.6))
    ]
    assert together.tolist() == singly
    assert lens.opd_waves(-14.0, 550.0, 0.2, -0.6) == pytest.approx(together[1], abs=1e-7), (
        "a field below the axis"
    )


@pytest.mark.parametrize("name", ["phone", "double_gauss_us583336"])
def test_bits_do_not_depend_on_what_is_traced_together(name: str) -> None:
    """Else a study would depend on the number of its processes: what each has traced before
    differs.
    """
    lens = lens_named(name)
    again = replace(lens)
    fields, wavelengths = np.linspace(0, lens.max_field_deg, 5), np.array([480.0, 600.0])
    x, y = disc(13)
    whole = again.opd_waves(fields[:, None, None], wavelengths[:, None], x, y)
    area = again.projected_solid_angle_sr(fields[:, None], wavelengths)
    for index in np.ndindex(5, 2):
        lone = replace(lens)
        assert np.array_equal(
            lone.opd_waves(fields[index[0]], wavelengths[index[1]], x, y), whole[index]
        )
        assert lone.projected_solid_angle_sr(fields[index[0]], wavelengths[index[1]]) == area[index]


@pytest.mark.parametrize(
    "name",
    ["cooke_triplet", "double_gauss_us583336", "retrofocus", "telephoto", "asphere_us8427765"],
)
def test_rays_meet_the_points_of_the_stop_that_they_are_aimed_at(name: str) -> None:
    """To 1e-9 of its radius, also in lenses whose entrance pupil is distorted."""
    lens = lens_named(name)
    fields, (x, y) = np.linspace(0, lens.max_field_deg, 4), disc(9)
    waves = lens.wavefront(fields, 600.0, x, y)
    assert np.isfinite(waves.opd_waves).all()
    assert max(np.abs(waves.stop_x - x).max(), np.abs(waves.stop_y - y).max()) <= 1e-9


def test_seventeen_fields_and_eight_wavelengths_take_half_a_second() -> None:
    """On 64² points: .3 s measured for the phone lens on an idle core; more is allowed on a busy
    one, in CPU time.
    """
    grid = (np.arange(64) - 31.5) / 32
    for name in ("phone", "cooke_triplet"):
        lens = pixsim.load_lens(name)
        fields, wavelengths = (
            np.linspace(0, lens.max_field_deg, 17)[:, None, None, None],
            np.linspace(430, 680, 8)[:, None, None],
        )
        start = time.process_time()
        lens.opd_waves(fields, wavelengths, grid, grid[:, None])
        assert time.process_time() - start < 1.0


# Light


def test_thin_lens_has_the_fall_off_of_foote() -> None:
    """Equiconvex, f = 1 mm, f/100, 10 nm thick, stop at the lens: the pupil of a thin lens up to
    20°.
    """
    thin = lens_from_prescription(
        Prescription(
            "thin",
            "",
            "",
            (Surface(1.0, 1e-5, GLASS), Surface(-1.0, 1.0)),
            0,
            "f_number",
            100.0,
            "angle_deg",
            20.0,
            (550.0,),
            550.0,
        )
    )
    fields = np.linspace(0, 20, 5)
    want = irradiance_factor(100.0, np.tan(np.radians(fields)))
    np.testing.assert_allclose(thin.projected_solid_angle_sr(fields, 550.0), want, rtol=1e-4)


@pytest.mark.parametrize(
    "name", ["cooke_triplet", "retrofocus", "telephoto", "double_gauss_us583336"]
)
def test_illumination_conserves_light(name: str) -> None:
    """All light of a ring of the scene that enters the lens arrives in its ring of the image:
    étendue, also behind apertures.

    E/L = A cos θ sin θ dθ/(h dh), with the area A of the entrance pupil that leads through stop and
    apertures. The gate is the blur of the ring by aberrations, of 1 % for the double Gauss in its
    file's image plane; the others agree to .3 %.
    """
    lens, step = lens_named(name), 1e-3
    fields = np.array([0.0, 0.5, 0.9]) * lens.max_field_deg + [0.01, 0, 0]
    half = 0.75 * lens.entrance_pupil_diameter_mm
    grid = (np.arange(200) + 0.5) / 200 * half
    x, y = np.meshgrid(grid, np.concatenate([-grid[::-1], grid]))
    waves = lens.unaimed_wavefront(fields, lens.primary_nm, x, y)
    through = waves.passed & np.isfinite(waves.x_mm) & (np.hypot(waves.stop_x, waves.stop_y) <= 1)
    area = 2 * through.sum(axis=1) * (half / 200) ** 2
    heights = lens.chief_ray(
        fields[:, None] + np.array([-step, 0, step]), lens.primary_nm
    ).height_mm
    slope = (heights[:, 2] - heights[:, 0]) / np.radians(2 * step)
    theta = np.radians(fields)
    want = area * np.cos(theta) * np.sin(theta) / (heights[:, 1] * slope)
    np.testing.assert_allclose(
        lens.projected_solid_angle_sr(fields, lens.primary_nm), want, rtol=0.015
    )


def test_clear_apertures_take_light_and_the_image_circle_ends() -> None:
    lens = lens_named("double_gauss_us583336")
    surfaces = tuple(replace(surface, clips=False) for surface in lens.prescription.surfaces)
    bare = replace(lens, prescription=replace(lens.prescription, surfaces=surfaces))
    fields = np.array([0.0, 24.0])
    share = lens.projected_solid_angle_sr(fields, 587.56) / bare.projected_solid_angle_sr(
        fields, 587.56
    )
    assert share[0] == pytest.approx(1.0, rel=1e-9)
    assert 0.5 < share[1] < 0.7, "by other programs .644 of a pupil that is not aimed at the stop"
    edge = lens.image_circle_mm(587.56)
    assert lens.chief_ray(24.0, 587.56).height_mm < edge
    assert 0 < lens.relative_illumination(lens.field_of_height(edge, 587.56)) < 0.1


def test_directions_fill_the_outline_and_follow_the_azimuth() -> None:
    lens = lens_named("phone")
    azimuth = np.array([0.0, 90.0, 217.0])
    rays = lens.directions(20.0, 550.0, azimuth)
    chief = lens.chief_ray(20.0, 550.0)
    sine = np.sin(np.radians(chief.angle_deg))
    turned = np.stack([np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))], axis=-1)
    np.testing.assert_allclose(rays.chief_cosines, sine * turned, atol=1e-9)
    mean = (rays.cosines * rays.shares[..., None]).sum(axis=1)
    np.testing.assert_allclose(mean, np.linalg.norm(mean[0]) * turned, atol=1e-9)
    assert np.linalg.norm(mean[0]) == pytest.approx(sine, rel=0.02)


# Changed lenses


def test_scaled_lens_keeps_angles_and_multiplies_lengths() -> None:
    lens = lens_named("phone")
    twice = lens.scaled(2.0)
    one, two = lens.chief_ray(25.0, 550.0), twice.chief_ray(25.0, 550.0)
    assert two.height_mm == pytest.approx(2 * one.height_mm, rel=1e-12)
    assert two.angle_deg == pytest.approx(one.angle_deg, rel=1e-12)
    assert twice.opd_waves(25.0, 550.0, 0.3, 0.7) == pytest.approx(
        2 * lens.opd_waves(25.0, 550.0, 0.3, 0.7), rel=1e-8
    )
    assert twice.first_order(550.0).f_number == pytest.approx(
        lens.first_order(550.0).f_number, rel=1e-12
    )


def test_stopped_down_lens_uses_the_middle_of_the_stop() -> None:
    lens = lens_named("cooke_triplet")
    down = lens.stopped_down(10.0)
    assert down.first_order(550.0).f_number == pytest.approx(10.0, rel=1e-12)
    ratio = down.stop_semi_diameter_mm / lens.stop_semi_diameter_mm
    assert down.opd_waves(14.0, 550.0, 0.6, -0.5) == pytest.approx(
        lens.opd_waves(14.0, 550.0, 0.6 * ratio, -0.5 * ratio), abs=1e-7
    )
    with pytest.raises(
        pixsim.PixsimError, match=r"at least 4\.99998, the widest of 'cooke_triplet'"
    ):
        lens.stopped_down(4.0)


@pytest.mark.parametrize("distance", [np.inf, 1000.0])
def test_refocused_lens_has_its_least_wavefront_where_it_says(distance: float) -> None:
    """Paraxial: no defocus of rays near the axis. Axis and field: any other plane nearby is
    worse.
    """
    lens = lens_named("cooke_triplet")
    tangential, sagittal = lens.refocused("paraxial", distance).foci_mm(0.0, 550.0)
    assert max(abs(tangential), abs(sagittal)) < 1e-5
    x, y = disc(15)
    best = lens.refocused("axis", distance)

    def rms(lens: Lens) -> float:
        waves = np.array(lens.prescription.wavelengths_nm)[:, None]
        return float(np.mean(np.std(lens.opd_waves(0.0, waves, x, y), axis=1) ** 2))

    assert rms(best) < min(
        rms(best._with_image_plane_moved(0.02)), rms(best._with_image_plane_moved(-0.02))
    )
    assert rms(best) < rms(lens.refocused("paraxial", distance))


@pytest.mark.parametrize("nm", [486.1327, 850.0, 940.0])
def test_focus_at_a_wavelength_is_that_of_the_lensmaker(nm: float) -> None:
    """Of a plano-convex lens: R/(n - 1) - d/n behind its plane side, with n of N-BK7 there; and the
    least wavefront is in it.
    """
    lens = lens_named("singlet")
    convex = lens.prescription.surfaces[0]
    n = float(convex.glass.index(nm))
    wanted = 1 / convex.curvature_per_mm / (n - 1) - convex.thickness_mm / n
    assert lens.refocused("paraxial", wavelength_nm=nm).prescription.surfaces[
        -1
    ].thickness_mm == pytest.approx(wanted, rel=1e-9)
    x, y = disc(15)
    best = lens.refocused("axis", wavelength_nm=nm)
    planes = [
        best._with_image_plane_moved(shift_mm).opd_waves(0.0, nm, x, y)
        for shift_mm in (-0.02, 0.0, 0.02)
    ]
    assert np.argmin([np.std(waves) for waves in planes]) == 1


def test_far_object_is_imaged_as_one_at_infinity() -> None:
    lens = lens_named("phone")
    far = replace(lens, object_distance_mm=1e9)
    assert far.chief_ray(25.0, 550.0).height_mm == pytest.approx(
        lens.chief_ray(25.0, 550.0).height_mm, rel=1e-8
    )
    # The focus moves by f²/u = 3e-8 mm, by 1e-6 waves at the edge.
    assert far.opd_waves(25.0, 550.0, 0.5, 0.7) == pytest.approx(
        lens.opd_waves(25.0, 550.0, 0.5, 0.7), abs=1e-5
    )


def test_near_object_has_the_magnification_of_the_lens_equation() -> None:
    """x x' = f² from the focal points (Newton)."""
    lens = lens_named("double_gauss")
    focal, primary = lens.first_order(lens.primary_nm), lens.primary_nm
    near = lens.refocused("paraxial", 2000.0)
    shift = near.prescription.surfaces[-1].thickness_mm - focal.back_focal_length_mm
    magnification = near.paraxial_height_mm / 2000.0
    assert magnification == pytest.approx(shift / focal.focal_length_mm, rel=1e-9)
    assert near.chief_ray(0.01, primary).height_mm == pytest.approx(
        near.paraxial_height_mm * np.tan(np.radians(0.01)), rel=1e-6
    )


def test_field_of_height_inverts_the_chief_ray() -> None:
    lens = lens_named("retrofocus")
    for field in (0.0, 3.0, 29.0, -12.0):
        height = float(lens.chief_ray(field, 550.0).height_mm)
        assert lens.field_of_height(height, 550.0) == pytest.approx(field, abs=1e-9)


# Bad input


def test_fields_beyond_the_image_circle_name_the_surface() -> None:
    lens = lens_named("phone")
    with pytest.raises(
        pixsim.PixsimError, match=r"got 85, where the chief ray misses surface \d+ \(550 nm\)"
    ):
        lens.chief_ray(85.0, 550.0)
    with pytest.raises(pixsim.PixsimError, match="beyond the image circle; allowed: at most"):
        lens.field_of_height(1e3, 550.0)
    with pytest.raises(pixsim.PixsimError, match="above -90 and below 90"):
        lens.chief_ray(90.0, 550.0)
    with pytest.raises(
        pixsim.PixsimError,
        match=r"wavelength_nm: got 900; allowed: 400 to 750, where the glass 'n1.471v76.6'",
    ):
        lens.opd_waves(0.0, 900.0, 0.0, 0.0)


def test_rays_that_miss_or_are_reflected_are_named() -> None:
    """A ball's rim: rays at its height miss it; steep rays inside a half ball are reflected at its
    plane.
    """
    miss = made_of(Surface(0.0, 1.0), Surface(1 / 5, 8.0, GLASS), Surface(0.0, 5.0), diameter=6.0)
    wide = replace(miss, entrance_pupil_diameter_mm=10.6)
    with pytest.raises(pixsim.PixsimError, match=r"through .* of the stop that misses surface 2"):
        wide.opd_waves(0.0, 550.0, 0.0, 0.99)
    half = made_of(Surface(0.0, 2.0, GLASS), Surface(-1 / 10, 20.0), diameter=4.0)
    reflected = replace(half, entrance_pupil_diameter_mm=15.0)
    with pytest.raises(
        pixsim.PixsimError, match=r"through .* of the stop that is totally reflected at surface 2"
    ):
        reflected.opd_waves(0.0, 550.0, 0.0, 0.95)
    with pytest.raises(pixsim.PixsimError, match="a marginal ray that misses surface 1"):
        made_of(Surface(1 / 5, 8.0, GLASS), Surface(0.0, 5.0), diameter=10.6, stop=1)
    with pytest.raises(pixsim.PixsimError, match="a positive focal length"):
        made_of(Surface(-1 / 50, 3.0, GLASS), Surface(0.0, 5.0))


def test_light_behind_strong_aspheres_ends_at_the_first_edge() -> None:
    """Beyond the stop's edge the phone lens's aspheres fold the directions back, and let some
    through once more.
    """
    lens = lens_named("phone")
    fields = np.linspace(0, lens.max_field_deg, 9)
    radius = lens.outline(fields, lens.primary_nm, 512).radius
    assert np.abs(np.diff(radius, axis=1)).max() < 0.01 * radius.min(), "an outline without spikes"
    area = lens.outline(fields, lens.primary_nm, 512).area
    np.testing.assert_allclose(
        lens.projected_solid_angle_sr(fields, lens.primary_nm), area, rtol=1e-6
    )
