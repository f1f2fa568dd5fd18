"""The colour matrix against another optimiser, in its limits, and against Monte Carlo with
noise.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.light.spectral import colour_matching
from pixsim.light.standard import illuminant
from pixsim.sensor.camera_data import camera_names, camera_sensitivities
from pixsim.viewer.colour_matrix import (
    STANDARD_NM,
    chart_responses,
    chart_xyz,
    check_noise_gains,
    colour_errors,
    colour_matrix,
    fit_matrix,
    metamerism_index,
    noise_gains,
)
from pixsim.viewer.scielab import delta_e, xyz_to_lab

DATA = Path(__file__).parents[1] / "data" / "colour"


@cache
def reference(name: str = "matrices") -> dict[str, np.ndarray]:
    with np.load(DATA / f"{name}.npz") as file:
        return dict(file)


CASES = sorted(key.removesuffix("/M_opt") for key in reference() if key.endswith("/M_opt"))
D5100 = "Nikon_D5100/D55"


def patches_of(case: str, count: int = 18) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(responses, XYZ, XYZ of white) of the reference."""
    lamp, data = case.rpartition("/")[2], reference()
    return (
        data[f"{case}/camera_rgb_wb"][:count],
        data[f"{lamp}/XYZ"][:count],
        data[f"{lamp}/XYZ_white"],
    )


@pytest.mark.parametrize("case", CASES)
def test_fit_is_that_of_another_optimiser(case: str) -> None:
    """The reference is good to 1e-9 in mean ΔE and 1e-6 in the elements; least squares have one
    solution, to rounding.
    """
    data, (responses, xyz, white) = reference(), patches_of(case)
    matrix = fit_matrix(responses, xyz, white)
    ours, theirs = (
        colour_errors(each, responses, xyz, white).mean()
        for each in (matrix, data[f"{case}/M_opt"])
    )
    assert -1e-8 < ours - theirs < 1e-8
    assert matrix == pytest.approx(data[f"{case}/M_opt"], abs=1e-6)
    assert matrix.sum(axis=1) == pytest.approx(white, abs=1e-12)
    for count in (18, 24):
        responses, xyz, white = patches_of(case, count)
        assert fit_matrix(responses, xyz, white, "least_squares") == pytest.approx(
            data[f"{case}/M_lsq{count}"], abs=1e-9
        )


@pytest.mark.parametrize("case", CASES)
def test_colour_matrix_from_sensitivities_is_that_of_the_reference(case: str) -> None:
    camera, _, lamp = case.rpartition("/")
    curves = camera_sensitivities(camera)
    assert pixsim.colour_matrix(*curves, lamp) == pytest.approx(
        reference()[f"{case}/M_opt"], abs=1e-6
    )
    assert colour_matrix(*curves, lamp, "least_squares") == pytest.approx(
        reference()[f"{case}/M_lsq18"], abs=1e-9
    )


@pytest.mark.parametrize("case", CASES)
def test_noise_gains_are_those_of_the_reference(case: str) -> None:
    """Within 3e-4: the reference's display white is (.3127, .3290), pixsim's D65 with five digits
    of XYZ.
    """
    matrix, white = (
        reference()[f"{case}/M_opt"],
        reference()[f"{case.rpartition('/')[2]}/XYZ_white"],
    )
    for adaptation in ("bradford", "cat02"):
        assert noise_gains(matrix, white, adaptation) == pytest.approx(
            reference()[f"{case}/gain_srgb_{adaptation}_opt"], rel=3e-4
        )
    assert noise_gains(100 * matrix, 100 * white) == pytest.approx(
        noise_gains(matrix, white), rel=1e-12
    )  # any unit


@pytest.mark.parametrize("case", [case for case in CASES if case.endswith("/D55")])
def test_metamerism_index_of_the_same_sums_is_that_of_the_reference(case: str) -> None:
    """The way from sensitivities to SMI, in steps of 5 nm as the reference takes them: to rounding,
    where the gate is 0.05.
    """
    responses, xyz, white = patches_of(case)
    theirs = metamerism_index(colour_errors(reference()[f"{case}/M_opt"], responses, xyz, white))
    camera, power = camera_sensitivities(case.partition("/")[0]), illuminant("D55", STANDARD_NM)
    ours = colour_errors(
        colour_matrix(*camera), chart_responses(STANDARD_NM, camera[1], power)[:18], xyz, white
    )
    assert metamerism_index(ours) == pytest.approx(theirs, abs=1e-6)


def test_metamerism_index_of_all_cameras() -> None:
    """SMI of 52 cameras: 84.34, 91.46 and 93.19 (min, median, max) by another program."""
    power = illuminant("D55", STANDARD_NM)
    xyz, white = chart_xyz(STANDARD_NM, power)
    found = []
    for name in camera_names():
        curves = camera_sensitivities(name)
        responses = chart_responses(STANDARD_NM, curves[1], power)[:18]
        found.append(
            metamerism_index(colour_errors(colour_matrix(*curves), responses, xyz[:18], white))
        )
    assert [min(found), np.median(found), max(found)] == pytest.approx(
        [84.34, 91.46, 93.19], abs=0.006
    )


@pytest.mark.parametrize(
    ("lamp", "gate"), [("A", 1e-9), ("D50", 1e-9), ("FL11", 1e-9), ("LED-B3", 1e-9), ("D65", 1e-3)]
)
def test_chart_under_lamps_has_the_xyz_of_the_reference(lamp: str, gate: float) -> None:
    """To rounding; the reference's D65 ends at 780 nm, pixsim's at 830."""
    nm = np.arange(360.0, 831.0)
    assert 100 * chart_xyz(nm, illuminant(lamp, nm))[0] == pytest.approx(
        reference("charts")[f"{lamp}/XYZ"], abs=gate
    )


@pytest.mark.parametrize("method", ["least_squares", "least_delta_e"])
@pytest.mark.parametrize("lamp", ["A", "D65", "FL11", "LED-B3"])
def test_luther_camera_has_no_colour_error(lamp: str, method: str) -> None:
    """Sensitivities that are mixtures of the observer's: each patch is right, whatever the
    method.
    """
    mixture = np.array([[0.8, 0.3, 0.0], [0.1, 0.9, 0.1], [0.0, 0.1, 0.7]])
    power, responses = illuminant(lamp, STANDARD_NM), colour_matching(STANDARD_NM) @ mixture
    xyz, white = chart_xyz(STANDARD_NM, power)
    matrix = colour_matrix(STANDARD_NM, responses, lamp, method)
    assert (
        colour_errors(matrix, chart_responses(STANDARD_NM, responses, power), xyz, white).max()
        < 1e-6
    )


def test_finer_and_coarser_tables_of_smooth_sensitivities_agree() -> None:
    """Linear interpolation of 10 nm tables changes SMI by little; a unit or a shape that was
    mistaken, by a lot.
    """
    nm, curves = camera_sensitivities("Canon_EOS_R5")
    fine = np.arange(380.0, 780.5, 0.5)
    interpolated = np.stack([np.interp(fine, nm, curve) for curve in curves.T], axis=1)
    assert colour_matrix(fine, 7 * interpolated) == pytest.approx(
        colour_matrix(nm, curves), abs=1e-9
    )
    assert colour_matrix(nm[::2], curves[::2]) == pytest.approx(colour_matrix(nm, curves), abs=0.03)


def test_four_channels_are_fitted_no_worse_than_three() -> None:
    responses, xyz, white = patches_of(D5100)
    more = np.hstack([responses, responses.mean(axis=1, keepdims=True) ** 2])
    matrix = fit_matrix(more, xyz, white)
    assert matrix.shape == (3, 4)
    assert matrix.sum(axis=1) == pytest.approx(white, abs=1e-12)
    assert (
        colour_errors(matrix, more, xyz, white).mean()
        < colour_errors(fit_matrix(responses, xyz, white), responses, xyz, white).mean()
    )
    twice = np.hstack([responses, responses[:, :1]])  # a channel that adds nothing
    assert colour_errors(fit_matrix(twice, xyz, white), twice, xyz, white).mean() == pytest.approx(
        1.684575708, abs=1e-8
    )


# --- Noise ---


def shot_noise(responses: np.ndarray, white_e: float) -> np.ndarray:
    """Covariance of balanced responses with `white_e` electrons for white in green, and fewer in
    red and blue.
    """
    return np.einsum("pc,cd->pcd", responses, np.diag([2.0, 1.0, 1.5])) / white_e


def test_noise_aware_without_noise_is_least_delta_e() -> None:
    responses, xyz, white = patches_of(D5100)
    least = fit_matrix(responses, xyz, white)
    assert fit_matrix(
        responses, xyz, white, "noise_aware", shot_noise(responses, np.inf)
    ) == pytest.approx(least, abs=1e-7)
    assert fit_matrix(
        responses, xyz, white, "noise_aware", shot_noise(responses, 1e9)
    ) == pytest.approx(least, abs=1e-3)


@pytest.mark.parametrize("white_e", [1e2, 1e3, 1e4])
@pytest.mark.parametrize("case", [D5100, "ARRI_D21/A"])
def test_noise_aware_has_the_least_expected_error(case: str, white_e: float) -> None:
    """By Monte Carlo with common noise: below both other matrices by more than 3 standard errors of
    the difference.

    Differences are 12 to 110 standard errors here: the seed does not matter.
    """
    responses, xyz, white = patches_of(case)
    covariance = shot_noise(responses, white_e)
    fits = [fit_matrix(responses, xyz, white, "noise_aware", covariance)]
    fits += [
        fit_matrix(responses, xyz, white, method) for method in ("least_delta_e", "least_squares")
    ]
    noise = np.random.default_rng(5).standard_normal((4000, 18, 3)) * np.sqrt(
        np.einsum("pcc->pc", covariance)
    )
    truth = np.broadcast_to(xyz_to_lab(xyz, white), noise.shape)
    aware, *others = (
        delta_e(truth, xyz_to_lab((responses + noise) @ fit.T, white)).mean(axis=1) for fit in fits
    )
    for other in others:
        gain = other - aware
        assert gain.mean() > 3 * gain.std() / np.sqrt(len(gain))


@pytest.mark.parametrize("white_e", [1e4, 1e-3, 1e-20])
def test_noise_aware_fit_of_a_channel_that_hardly_sees_the_lamp(white_e: float) -> None:
    """The worse a channel is, the less it counts, down to nothing: the limit is a camera of the two
    others, at any light.
    """
    responses, xyz, white = patches_of(D5100)
    fits = []
    for worse in (1e9, 1e12, 1e15):
        covariance = shot_noise(responses, white_e)
        covariance[:, 2, 2] *= worse
        fits.append(fit_matrix(responses, xyz, white, "noise_aware", covariance))
        assert fits[-1].sum(axis=1) == pytest.approx(white, abs=1e-9)
    assert np.abs(fits[-1][:, 2]).max() < 1e-6
    assert fits[1] == pytest.approx(fits[2], abs=1e-4)


def test_noise_aware_error_is_the_one_it_minimises() -> None:
    """√(|b|² + tr J M Σ Mᵀ Jᵀ) with J by finite differences: every small change of the matrix that
    keeps white is worse.
    """
    responses, xyz, white = patches_of(D5100)
    covariance = shot_noise(responses, 300.0)
    covariance[:, 0, 1] = covariance[:, 1, 0] = 0.3 * np.sqrt(
        covariance[:, 0, 0] * covariance[:, 1, 1]
    )
    steps = 1e-6 * np.eye(3)
    jacobian = np.stack(
        [(xyz_to_lab(xyz + step, white) - xyz_to_lab(xyz - step, white)) / 2e-6 for step in steps],
        axis=-1,
    )

    def error(matrix: np.ndarray) -> float:
        moved = jacobian @ matrix
        variance = np.einsum("pik,pkl,pil->p", moved, covariance, moved)
        return np.sqrt(colour_errors(matrix, responses, xyz, white) ** 2 + variance).mean()

    matrix = fit_matrix(responses, xyz, white, "noise_aware", covariance)
    rng = np.random.default_rng(6)
    changes = rng.standard_normal((40, 3, 3)) * 1e-3
    changes -= changes.mean(axis=2, keepdims=True)
    assert min(error(matrix + change) for change in changes) > error(matrix)
    assert error(fit_matrix(responses, xyz, white)) > 1.005 * error(matrix)


# --- Errors ---


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda nm, s: (nm[4:-20], s[4:-20]), "at least 400 to 700 nm"),
        (
            lambda nm, s: (np.delete(nm, slice(30, 36)), np.delete(s, slice(30, 36), 0)),
            "a gap from 525 to 560 nm",
        ),
        (lambda nm, s: (nm[::-1], s[::-1]), "in increasing order"),
        (lambda nm, s: (nm, s.T), r"allowed: \(81, channels\)"),
        (lambda nm, s: (nm, s[:, 0]), "with 2 axes"),
        (lambda nm, s: (nm, s[:, :2]), "three channels or more"),
        (lambda nm, s: (nm, s - 1e-3), "from 0 to"),
        (lambda nm, s: (nm, s * np.nan), "allowed: .*numbers from 0"),
        (lambda nm, s: (nm, s * [1, 0, 1]), r"no response of channel \[1\]"),
        (lambda nm, s: (nm, s * 0), "0 everywhere"),
        (
            lambda nm, s: (nm, s[:, [0, 1, 1]]),
            "under illuminant D55: responses: got 3 channels of rank 2",
        ),
        (
            lambda nm, s: (nm, s[:, 1:2] + 0.05 * s),
            "under illuminant D55: colour matrix: got noise gains of .* allowed: gains up to 10",
        ),
    ],
)
def test_invalid_sensitivities_raise(change, says: str) -> None:
    with pytest.raises(PixsimError, match=says):
        pixsim.colour_matrix(*change(*camera_sensitivities("Canon_EOS_R5")))


def test_light_of_one_wavelength_has_rank_one() -> None:
    nm, curves = camera_sensitivities("Canon_EOS_R5")
    laser = np.where(nm == 530, 1.0, 0.0)
    xyz, white = chart_xyz(nm, laser)
    with pytest.raises(
        PixsimError, match=r"3 channels of rank 1 over 24 patches.*broader spectrum"
    ):
        fit_matrix(chart_responses(nm, curves, laser), xyz, white)
    with pytest.raises(PixsimError, match="lamp without luminance"):
        chart_xyz(nm, 0 * laser)


def test_matrix_that_amplifies_noise_raises() -> None:
    _, _, white = patches_of(D5100)
    with pytest.raises(PixsimError, match=r"gains of 16, 16, 16|gains up to 10"):
        check_noise_gains(20 * reference()[f"{D5100}/M_opt"], white)
