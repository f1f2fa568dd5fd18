"""Radiance to irradiance: Foote's factor on and off the axis.

Its extremes are in pixsim.verification.extreme_cases; ISETCam's numbers and a path tracer's in
tests/references/test_optics_judge.py.
"""

from __future__ import annotations

import numpy as np
import pytest

from pixsim import optics
from pixsim.base.errors import PixsimError
from pixsim.optics.camera import Camera
from pixsim.optics.thin_lens import thin_lens_pupil


@pytest.mark.parametrize(
    ("f_number", "magnification"),
    [(0.5, 0.0), (1.0, 0.0), (2.0, 0.0), (1.4, -0.5), (0.25, 1.0), (0.4, 0.25), (1e100, 0.0)],
)
def test_irradiance_factor_on_axis_is_pi_sine_squared(f_number, magnification):
    sine = np.sin(np.arctan(0.5 / (f_number * (1 + abs(magnification)))))
    assert optics.irradiance_factor(f_number, 0.0, magnification) == pytest.approx(
        np.pi * sine**2, rel=1e-14
    )


@pytest.mark.parametrize("angle_deg", [0.0, 15.0, 40.0, 70.0])
def test_irradiance_factor_slow_lens_is_cos4(angle_deg):
    f_number, magnification = 500.0, 0.3
    a = 1 / (4 * f_number**2 * (1 + magnification) ** 2)
    cos4 = np.cos(np.radians(angle_deg)) ** 4
    result = optics.irradiance_factor(f_number, np.tan(np.radians(angle_deg)), magnification)
    # The next term of the series, in A = 5.9e-7: -1 on the axis, -0.75 to 0.19 at these angles.
    assert result == pytest.approx(np.pi * cos4 * a, rel=1.1 * a)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("tan_field", [1e8, 1e76, 1e100, 1e200, np.inf])
def test_irradiance_factor_grazing_light_is_zero(tan_field):
    # πA/T² for T >> 1: below the smallest number beyond tan θ = 1e77.
    faint = np.pi / 64 / tan_field / tan_field / tan_field / tan_field
    assert optics.irradiance_factor(4.0, tan_field) == pytest.approx(faint, rel=1e-12, abs=1e-300)


@pytest.mark.parametrize("f_number", [0.4, 0.0, -4.0, np.nan])
def test_irradiance_factor_invalid_arguments_raise(f_number):
    with pytest.raises(PixsimError, match=r"f_number: got .*(0\.5|above 0)"):
        optics.irradiance_factor(f_number, 0.0)
    with pytest.raises(PixsimError, match="tan_field: got nan"):
        optics.irradiance_factor(4.0, [0.0, np.nan])


def test_field_factor_axis_is_at_centre():
    field = optics.field_factor((3, 4), 10.0, 2.0, 4.0, 0.1)
    assert field[1, 0] == pytest.approx(optics.irradiance_factor(4.0, 15 / 2000, 0.1), rel=1e-15)
    assert field[2, 3] == pytest.approx(
        optics.irradiance_factor(4.0, np.hypot(10, 15) / 2000, 0.1), rel=1e-15
    )
    np.testing.assert_array_equal(field, field[::-1, ::-1])
    part = optics.field_factor((3, 4), 10.0, 2.0, 4.0, 0.1, np.s_[1:, 2:3])
    np.testing.assert_array_equal(part, field[1:, 2:3])


@pytest.mark.parametrize("f_number", [1.0, 1.8, 4.0, 1000.0])
def test_irradiance_factor_and_cutoff_share_numerical_aperture(f_number):
    """E = π L sin²α on axis and the cut-off 2 sin α/λ have the same α, also at a magnification of
    1/5.
    """
    camera = Camera(focal_length_mm=50.0, f_number=f_number, object_distance_m=0.3)
    sin_alpha = np.sqrt(optics.irradiance_factor(f_number, 0.0, camera.magnification) / np.pi)
    assert optics.cutoff_cy_per_mm(500.0, camera.effective_f_number) == pytest.approx(
        2 * sin_alpha / 500e-6, rel=1e-13
    )
    assert np.tan(np.arcsin(sin_alpha)) == pytest.approx(1 / (2 * f_number * 1.2), rel=1e-12)


@pytest.mark.parametrize(
    ("f_number", "magnification"), [(0.5, 0.0), (1.4, 0.2), (4.0, 0.0), (100.0, 0.0)]
)
def test_thin_lens_pupil_has_the_area_of_the_irradiance_factor(f_number, magnification):
    """The area in direction cosines is E/L (Foote), as an integral along the boundary, and as a sum
    of rays.
    """
    tan_field = np.tan(np.radians([0.0, 10.0, 25.0, 45.0, 60.0]))
    pupil = thin_lens_pupil(f_number, tan_field, 33.0, magnification)
    wanted = optics.irradiance_factor(f_number, tan_field, magnification)
    np.testing.assert_allclose(
        pupil.area, wanted, rtol=1e-10
    )  # rounding, of an area of 1e-5 between cosines of 1, at f/100
    np.testing.assert_allclose(
        pupil.chief_cosines[:, 0], np.sin(np.arctan(tan_field)) * np.cos(np.radians(33)), rtol=1e-14
    )
    disc = np.pi * (0.5 / (f_number * (1 + magnification))) ** 2  # of tangents, weighted by cos⁴
    np.testing.assert_allclose(
        disc * pupil.directions(16, 40).weight.sum(axis=-1), wanted, rtol=1e-7
    )


def test_thin_lens_pupil_of_a_slow_lens_is_an_ellipse_of_cos_and_cos3():
    cos = np.cos(np.radians(40.0))
    edge = thin_lens_pupil(100.0, np.tan(np.radians(40.0))).boundary(
        np.array([0.0, np.pi / 2, np.pi, 1.5 * np.pi])
    )[0]
    assert (edge[0] - edge[2])[0] == pytest.approx(0.01 * cos**3, rel=1e-4)  # next term NA²
    assert (edge[1] - edge[3])[1] == pytest.approx(0.01 * cos, rel=1e-4)


@pytest.mark.parametrize(
    ("tan_field", "azimuth_deg"), [(np.inf, 0.0), (np.nan, 0.0), (0.1, np.inf)]
)
def test_thin_lens_pupil_at_the_horizon_raises(tan_field, azimuth_deg):
    with pytest.raises(PixsimError, match=r"(tan_field|azimuth_deg).*: got"):
        thin_lens_pupil(4.0, tan_field, azimuth_deg)
