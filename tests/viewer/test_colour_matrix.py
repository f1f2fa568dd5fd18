"""The colour matrix against another optimiser, in its limits, and with noise."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from pixsim.light.standard import illuminant
from pixsim.sensor.camera_data import camera_names, camera_sensitivities
from pixsim.viewer.colour_matrix import (
    STANDARD_NM,
    chart_responses,
    chart_xyz,
    colour_errors,
    colour_matrix,
    fit_matrix,
    metamerism_index,
    noise_gains,
)
from pixsim.viewer.scielab import xyz_to_lab

DATA = Path(__file__).parents[1] / "data" / "colour"
D5100 = "Nikon_D5100/D55"


@cache
def reference(name: str = "matrices") -> dict[str, np.ndarray]:
    with np.load(DATA / f"{name}.npz") as file:
        return dict(file)


CASES = sorted(key.removesuffix("/M_opt") for key in reference() if key.endswith("/M_opt"))


def patches_of(case: str, count: int = 18) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return responses, XYZ and XYZ of white of the reference."""
    lamp = case.rpartition("/")[2]
    data = reference()
    responses = data[f"{case}/camera_rgb_wb"][:count]
    return responses, data[f"{lamp}/XYZ"][:count], data[f"{lamp}/XYZ_white"]


# --- another program


@pytest.mark.parametrize("case", CASES)
def test_matrix_is_that_of_another_optimiser(case: str) -> None:
    """To 1e-6, from responses and from sensitivities; least squares have one solution, to rounding.
    White is kept.
    """
    expected = reference()[f"{case}/M_opt"]
    responses, xyz, white = patches_of(case)
    matrix = fit_matrix(responses, xyz, white)
    np.testing.assert_allclose(matrix, expected, rtol=0, atol=1e-6)
    np.testing.assert_allclose(matrix.sum(axis=1), white, atol=1e-12)
    camera, _, lamp = case.rpartition("/")
    curves = camera_sensitivities(camera)
    np.testing.assert_allclose(colour_matrix(*curves, lamp), expected, rtol=0, atol=1e-6)
    squares = colour_matrix(*curves, lamp, "least_squares")
    np.testing.assert_allclose(squares, reference()[f"{case}/M_lsq18"], rtol=0, atol=1e-9)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("adaptation", ["bradford", "cat02"])
def test_noise_gains_are_those_of_another_program(case: str, adaptation: str) -> None:
    """Within 3e-4: its display white is (.3127, .3290), pixsim's D65 with five digits of XYZ. They
    do not depend on the unit.
    """
    matrix = reference()[f"{case}/M_opt"]
    white = reference()[f"{case.rpartition('/')[2]}/XYZ_white"]
    expected = reference()[f"{case}/gain_srgb_{adaptation}_opt"]
    gains = noise_gains(100 * matrix, 100 * white, adaptation)
    np.testing.assert_allclose(gains, expected, rtol=3e-4)


def test_metamerism_index_of_all_cameras() -> None:
    """SMI of 52 cameras: 84.34, 91.46 and 93.19 (min, median, max) by another program."""
    power = illuminant("D55", STANDARD_NM)
    xyz, white = chart_xyz(STANDARD_NM, power)
    indices = []
    for name in camera_names():
        curves = camera_sensitivities(name)
        responses = chart_responses(STANDARD_NM, curves[1], power)[:18]
        errors = colour_errors(colour_matrix(*curves), responses, xyz[:18], white)
        indices.append(metamerism_index(errors))
    extremes = [min(indices), np.median(indices), max(indices)]
    np.testing.assert_allclose(extremes, [84.34, 91.46, 93.19], atol=0.006)


@pytest.mark.parametrize(
    ("lamp", "atol"), [("A", 1e-9), ("D50", 1e-9), ("FL11", 1e-9), ("LED-B3", 1e-9), ("D65", 1e-3)]
)
def test_chart_has_the_xyz_of_another_program(lamp: str, atol: float) -> None:
    """To rounding; its D65 ends at 780 nm, pixsim's at 830."""
    nm = np.arange(360.0, 831.0)
    xyz, _ = chart_xyz(nm, illuminant(lamp, nm))
    np.testing.assert_allclose(100 * xyz, reference("charts")[f"{lamp}/XYZ"], atol=atol)


# --- limits


def test_tables_of_other_steps_agree() -> None:
    """Finer ones to rounding in any unit; of 10 nm to 0.03."""
    nm, curves = camera_sensitivities("Canon_EOS_R5")
    fine = np.arange(380.0, 780.5, 0.5)
    interpolated = np.stack([np.interp(fine, nm, curve) for curve in curves.T], axis=1)
    expected = colour_matrix(nm, curves)
    np.testing.assert_allclose(colour_matrix(fine, 7 * interpolated), expected, atol=1e-9)
    np.testing.assert_allclose(colour_matrix(nm[::2], curves[::2]), expected, atol=0.03)


def test_further_channels_fit_no_worse() -> None:
    """A repeated channel as well as three, another one better; white is kept."""
    responses, xyz, white = patches_of(D5100)
    mean = []
    for channel in (
        np.empty((18, 0)),
        responses[:, :1],
        responses.mean(axis=1, keepdims=True) ** 2,
    ):
        channels = np.hstack([responses, channel])
        matrix = fit_matrix(channels, xyz, white)
        mean.append(colour_errors(matrix, channels, xyz, white).mean())
        np.testing.assert_allclose(matrix.sum(axis=1), white, atol=1e-12)
    assert mean[1] == pytest.approx(mean[0], abs=1e-8)
    assert mean[2] < mean[0]


# --- noise


def shot_noise(responses: np.ndarray, white_e: float) -> np.ndarray:
    """Covariance of balanced responses with `white_e` electrons of white in green, fewer in red and
    blue.
    """
    return np.einsum("pc,cd->pcd", responses, np.diag([2.0, 1.0, 1.5])) / white_e


@pytest.mark.parametrize(("white_e", "atol"), [(np.inf, 1e-7), (1e9, 1e-3)])
def test_noise_aware_without_noise_is_least_delta_e(white_e: float, atol: float) -> None:
    responses, xyz, white = patches_of(D5100)
    matrix = fit_matrix(responses, xyz, white, "noise_aware", shot_noise(responses, white_e))
    np.testing.assert_allclose(matrix, fit_matrix(responses, xyz, white), atol=atol)


@pytest.mark.parametrize("white_e", [1e4, 1e-20])
def test_channel_that_hardly_sees_the_lamp_counts_nothing(white_e: float) -> None:
    """The limit is a camera of the two others, at any light."""
    responses, xyz, white = patches_of(D5100)
    fits = []
    for factor in (1e12, 1e15):
        covariance = shot_noise(responses, white_e)
        covariance[:, 2, 2] *= factor
        fits.append(fit_matrix(responses, xyz, white, "noise_aware", covariance))
    np.testing.assert_allclose(fits[1][:, 2], 0, atol=1e-6)
    np.testing.assert_allclose(fits[0], fits[1], atol=1e-4)
    np.testing.assert_allclose(fits[1].sum(axis=1), white, atol=1e-9)


def test_noise_aware_error_is_the_one_that_it_minimises() -> None:
    """√(|b|² + tr J M Σ Mᵀ Jᵀ) with J by finite differences, of correlated noise: every small
    change of the matrix that keeps white is worse.
    """
    responses, xyz, white = patches_of(D5100)
    covariance = shot_noise(responses, 300.0)
    correlated = 0.3 * np.sqrt(covariance[:, 0, 0] * covariance[:, 1, 1])
    covariance[:, 0, 1] = correlated
    covariance[:, 1, 0] = correlated
    steps = 1e-6 * np.eye(3)
    slopes = [xyz_to_lab(xyz + step, white) - xyz_to_lab(xyz - step, white) for step in steps]
    jacobian = np.stack(slopes, axis=-1) / 2e-6

    def error(matrix: np.ndarray) -> float:
        change = jacobian @ matrix
        variance = np.einsum("pik,pkl,pil->p", change, covariance, change)
        return np.sqrt(colour_errors(matrix, responses, xyz, white) ** 2 + variance).mean()

    matrix = fit_matrix(responses, xyz, white, "noise_aware", covariance)
    changes = np.random.default_rng(6).standard_normal((40, 3, 3)) * 1e-3
    changes -= changes.mean(axis=2, keepdims=True)
    assert min(error(matrix + change) for change in changes) > error(matrix)
    assert error(fit_matrix(responses, xyz, white)) > 1.005 * error(matrix)
