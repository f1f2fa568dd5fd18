"""The colour matrix: XYZ from the white-balanced channels of a camera, fitted over the patches of a
ColorChecker.

Channels are balanced: the perfect white of the lamp has 1 in each. The matrix is fitted under the
lamp of the scene, with that lamp as white, over the 18 chromatic patches (ISO 17321-1).

* least_squares: the least squared error of XYZ. White is not kept.
* least_delta_e: white is kept, and the mean ΔE*ab (CIE 1976) of the patches is the least.
* noise_aware: white is kept, and the mean over the patches of √(|b|² + tr J M Σ Mᵀ Jᵀ) is the
  least: b is the colour error, Σ the
  covariance of the balanced channels, and J the Jacobian of CIELAB at the patch. Without noise it
  is least_delta_e; with noise it
  trades saturation for amplification.

That a matrix which is right in colour amplifies noise is well known, and so are fits that weigh
both: P. L. Vora and C. Herley, ICIP (1998); Y.-P. Tan and T. Acharya, US patent application
2003/0194128; S. H. Lim and A. Silverstein, CIC 12 (2004) 76. Here both parts are in ΔE, and no
weight is free. To observers, noise had 40 % or less of the effect of a colour difference of the
same ΔE (H. Kuniba and R. S. Berns, CIC 16 (2008) 232): so Σ should be the covariance of the means
over a dot, which observers see.

A mean of distances is not smooth where a patch is right. It is minimised as √(d² + ε²), for ε from
1 ΔE down to 10⁻⁷ ΔE.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from pixsim.base.arrays import Array, NotNegativePicture, PositiveArray
from pixsim.base.bounds import POSITIVE, Axes
from pixsim.base.errors import PixsimError, invalid
from pixsim.light.spectral import colour_matching
from pixsim.light.standard import CHROMATIC_PATCHES, illuminant as power_of, patch_reflectance
from pixsim.viewer.adaptation import Adaptation, adaptation_matrix
from pixsim.viewer.display import RGB_FROM_XYZ, WHITE_XYZ
from pixsim.viewer.scielab import delta_e, xyz_to_lab


class AlikeChannelsError(PixsimError):
    """Channels so nearly alike that the matrix which takes them apart amplifies noise too much;
    larger pixels may be possible.
    """


Fit = Literal["least_squares", "least_delta_e", "noise_aware"]
STANDARD_NM = np.arange(380.0, 781.0, 5.0)  # of the tables of illuminants, patches and cameras
_MAX_STEP_NM = 20.0  # between sensitivities: above, the maxima of narrow filters would be missed
_NEEDED_NM = (400.0, 700.0)  # range of sensitivities; the observer has 99.8 % of X, Y and Z in it
RANK_TOLERANCE = 1e-6  # smallest over largest singular value; noise gains are a million there
_NOISE_TOLERANCE = (
    1e-12  # in place of it with noise, which may be much larger in one channel than in the others
)
_MAX_NOISE_GAIN = (
    10.0  # of the display's linear RGB; 52 measured cameras have 1.3 to 3, stacked sensors 6 to 9
)
_SMI_PER_DELTA_E = 5.5  # of the sensitivity metamerism index, ISO 17321-1
_SMOOTHING_DELTA_E = (1.0, 1e-1, 1e-2, 1e-3, 1e-5, 1e-7)
_CIE_LINEAR_BELOW = 216 / 24389
_CIE_SLOPE = 841 / 108
# L*, a* and b* from f(X/Xn), f(Y/Yn) and f(Z/Zn), without the constant -16 of L*.
_LAB_FROM_F = np.array([[0.0, 116.0, 0.0], [500.0, -500.0, 0.0], [0.0, 200.0, -200.0]])


def colour_matrix(
    wavelength_nm: Annotated[Array, POSITIVE, Axes(1)],
    sensitivities: NotNegativePicture,
    illuminant: str = "D55",
    method: Literal["least_squares", "least_delta_e"] = "least_delta_e",
) -> Array:
    """Return the matrix, (3, C), from white-balanced channels to XYZ with Y of 1 for white, fitted
    over the patches of ISO 17321-1.

    Sums are over 380-780 nm in steps of 5 nm, to which the sensitivities are interpolated linearly.

    wavelength_nm : (B,) in increasing order, 400-700 nm or more in steps of at most 20 nm
    sensitivities : (B, C), three channels or more, relative responses to energy; quantum
        efficiencies times the wavelength
    illuminant : A, D50, D55, D65, D75, FL2, FL11 or LED-B3; D55 is the default of the standard
    method : least_delta_e (keeps white; least mean ΔE*ab, CIE 1976) or least_squares, over patches
        1-18

    Raises PixsimError for wavelengths with gaps, for sensitivities of another shape, below 0 or not
    finite, for a channel that does not respond, for channels that the lamp cannot tell apart, and
    for a matrix that amplifies noise more than 10 times.

    >>> from pixsim.sensor.camera_data import camera_sensitivities
    >>> colour_matrix(*camera_sensitivities("Nikon_D5100")).round(3)[1].tolist()
    [0.272, 0.96, -0.232]
    """
    responses = _on_standard_grid(wavelength_nm, sensitivities)
    power = power_of(illuminant, STANDARD_NM)
    patches, white = chart_xyz(STANDARD_NM, power)
    try:
        balanced = chart_responses(STANDARD_NM, responses, power)
        matrix = fit_matrix(balanced[CHROMATIC_PATCHES], patches[CHROMATIC_PATCHES], white, method)
        check_noise_gains(matrix, white)
    except PixsimError as error:
        raise type(error)(f"under illuminant {illuminant}: {error}") from None
    return matrix


def chart_xyz(wavelength_nm: PositiveArray, power: Array) -> tuple[Array, Array]:
    """Return XYZ of the 24 patches, (24, 3), and of the perfect white, (3,), under a lamp; white
    has Y = 1. CIE 15.

    wavelength_nm : (B,)
    power : (B,) of the lamp times the width of the bands, any unit

    Raises PixsimError for a lamp without light that the eye sees.
    """
    weight = power[:, None] * colour_matching(wavelength_nm)
    luminance = float(weight[:, 1].sum())
    if not luminance > 0:
        raise invalid("power", "a lamp without luminance", "light between 360 and 830 nm")
    return patch_reflectance(wavelength_nm) @ weight / luminance, weight.sum(axis=0) / luminance


def chart_responses(wavelength_nm: PositiveArray, sensitivities: Array, power: Array) -> Array:
    """Return the white-balanced responses of a camera to the 24 patches, (24, C), relative to the
    perfect white (ISO 17321-1).

    wavelength_nm : (B,)
    sensitivities : (B, C) to energy, relative
    power : (B,) of the lamp times the width of the bands, any unit

    Raises PixsimError for a channel that does not respond to the lamp.
    """
    weight = power[:, None] * sensitivities
    white = weight.sum(axis=0)
    if not (white > 0).all():
        got = f"no response of channel {np.flatnonzero(~(white > 0)).tolist()} to the lamp"
        raise invalid(
            "sensitivities",
            got,
            "channels that respond to it",
            "Leave the channel out, or choose another lamp.",
        )
    return np.asarray(patch_reflectance(wavelength_nm) @ weight / white)


def fit_matrix(
    responses: Array,
    xyz: Array,
    white_xyz: ArrayLike,
    method: Fit = "least_delta_e",
    covariance: Array | None = None,
) -> Array:
    """Return the matrix, (3, C), from white-balanced responses (P, C) to XYZ (P, 3) in its unit;
    the sources stand at the module.

    responses : (P, C), 1 in each channel for the white
    xyz : (P, 3) of the patches
    white_xyz : (3,) of the lamp, in the unit of `xyz`
    method : least_squares, least_delta_e or noise_aware
    covariance : (P, C, C) of the responses to each patch, for noise_aware only

    Raises PixsimError for fewer than three independent channels.

    >>> rgb = np.vstack([np.eye(3), 1 - np.eye(3)])
    >>> matrix = fit_matrix(rgb, rgb @ np.diag([0.9, 1.0, 1.1]), [0.9, 1.0, 1.1])
    >>> matrix.diagonal().round(6).tolist()
    [0.9, 1.0, 1.1]
    """
    white = np.asarray(white_xyz, float)
    sizes = np.linalg.svd(responses, compute_uv=False)
    rank = int((sizes > RANK_TOLERANCE * sizes[0]).sum())
    if rank < 3:
        got = f"{responses.shape[1]} channels of rank {rank} over {len(responses)} patches"
        hint = (
            "The responses of the channels are not independent in this light. Choose a lamp with a"
            " broader spectrum, or other filters."
        )
        raise invalid("responses", got, "three or more independent channels", hint)
    if method == "least_squares":
        return np.asarray(np.linalg.lstsq(responses, xyz, rcond=RANK_TOLERANCE)[0].T)
    from scipy.optimize import minimize  # takes 0.1 s, and only colour needs it

    # Rows of the matrix to X/Xn, Y/Yn, Z/Zn sum to 1, so that white is kept: 1/C plus what is
    # orthogonal to (1, …, 1). Of that, the fit takes combinations that are orthonormal over the
    # patches and their noise: both may be large in one channel only.
    channels = responses.shape[1]
    target = xyz / white
    data = responses
    data_target = target
    tolerance = RANK_TOLERANCE
    if covariance is not None:
        noise = _root(covariance.sum(axis=0))
        data = np.vstack([responses, noise])
        data_target = np.vstack([target, np.zeros((channels, 3))])
        tolerance = _NOISE_TOLERANCE
    from_equal = data.mean(axis=1, keepdims=True)
    orthogonal = np.linalg.svd(np.ones((1, channels)))[2][1:]
    basis, sizes, directions = np.linalg.svd(data @ orthogonal.T, full_matrices=False)
    is_independent = sizes > tolerance * sizes[0]
    basis = basis[:, is_independent]
    directions = directions[is_independent] / sizes[is_independent, None] @ orthogonal

    # From the least squares of X/Xn, Y/Yn and Z/Zn to the least mean error, less and less smooth.
    coefficients = (basis.T @ (data_target - from_equal)).ravel()
    patches = slice(0, len(target))
    error = _MeanError(basis[patches], directions, from_equal[patches], target, covariance)
    options: dict[str, Any] = {"gtol": 1e-5, "maxiter": 300}
    for smoothing in _SMOOTHING_DELTA_E:
        optimum = minimize(
            error, coefficients, args=(smoothing,), method="BFGS", jac=True, options=options
        )
        coefficients = optimum.x
        inverse_hessian = (optimum.hess_inv + optimum.hess_inv.T) / 2
        # After a search that rounding stopped, it may be of no use.
        is_useful = (
            np.isfinite(inverse_hessian).all() and np.linalg.eigvalsh(inverse_hessian)[0] > 0
        )
        options["hess_inv0"] = inverse_hessian if is_useful else None
    rows = 1 / channels + coefficients.reshape(-1, 3).T @ directions
    return np.asarray(white[:, None] * rows)


def _root(covariance: Array) -> Array:
    """Return a matrix (C, C) whose product of its transpose with itself is a covariance (C, C)."""
    deviation = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    correlation = covariance / np.multiply.outer(deviation, deviation)
    variances, directions = np.linalg.eigh(correlation)
    return np.asarray(np.sqrt(np.maximum(variances, 0.0))[:, None] * directions.T * deviation)


class _MeanError:
    """The mean error of the patches and its gradient, as functions of the coefficients of a matrix
    that keeps white.

    basis : (P, k), what each coefficient adds to the patches
    directions : (k, C), what it adds to the matrix
    from_equal : (P, 1), each of X/Xn, Y/Yn, Z/Zn by the mean of the channels
    target : (P, 3)
    noise : (P, C, C), or None
    """

    def __init__(
        self, basis: Array, directions: Array, from_equal: Array, target: Array, noise: Array | None
    ) -> None:
        self.basis = basis
        self.directions = directions
        self.from_equal = from_equal
        self.f_target, slope = _f_and_slope(target)
        self.noise = self.metric = None
        if noise is not None:
            jacobian = _LAB_FROM_F * slope[:, None, :]
            self.noise = noise
            self.metric = np.swapaxes(jacobian, 1, 2) @ jacobian

    def __call__(self, coefficients: Array, smoothing: float) -> tuple[float, Array]:
        rows = coefficients.reshape(-1, 3)
        f, slope = _f_and_slope(self.from_equal + self.basis @ rows)
        difference = (f - self.f_target) @ _LAB_FROM_F.T
        squares = np.square(difference).sum(axis=1) + smoothing**2
        if self.noise is not None:
            matrix = 1 / self.directions.shape[1] + rows.T @ self.directions
            # Half the gradient of the variance, (P, 3, C).
            variance_gradient = self.metric @ matrix @ self.noise
            squares += (variance_gradient * matrix).sum(axis=(1, 2))

        errors = np.sqrt(squares)
        gradient = self.basis.T @ ((difference / errors[:, None]) @ _LAB_FROM_F * slope)
        if self.noise is not None:
            noise_gradient = (variance_gradient / errors[:, None, None]).sum(axis=0)
            gradient += self.directions @ noise_gradient.T
        return float(errors.mean()), gradient.ravel() / len(errors)


def _f_and_slope(relative: Array) -> tuple[Array, Array]:
    """Return CIELAB's f of X/Xn, Y/Yn and Z/Zn, and its derivative, in the same shape; CIE 15,
    linear also below 0.
    """
    is_linear = relative <= _CIE_LINEAR_BELOW
    root = np.cbrt(np.where(is_linear, 1.0, relative))
    f = np.where(is_linear, _CIE_SLOPE * relative + 16 / 116, root)
    return f, np.where(is_linear, _CIE_SLOPE, 1 / (3 * np.square(root)))


def colour_errors(matrix: Array, responses: Array, xyz: Array, white_xyz: ArrayLike) -> Array:
    """Return the ΔE*ab (CIE 1976) of each patch, (P,), behind a matrix (3, C).

    responses, xyz, white_xyz : (P, C), (P, 3) and (3,), of `fit_matrix`
    """
    white = np.asarray(white_xyz, float)
    return np.asarray(delta_e(xyz_to_lab(xyz, white), xyz_to_lab(responses @ matrix.T, white)))


def metamerism_index(errors_delta_e: Array) -> float:
    """Return the sensitivity metamerism index, 100 - 5.5 · mean ΔE*ab of patches 1-18, (18,); ISO
    17321-1. A number, at most 100.

    The text of the standard was not read; secondary sources agree. Under D55 it is the index of the
    standard's annex.
    """
    return 100.0 - _SMI_PER_DELTA_E * float(np.mean(errors_delta_e))


def noise_gains(matrix: Array, white_xyz: ArrayLike, adaptation: Adaptation = "bradford") -> Array:
    """Return the ratio by which a matrix (3, C) amplifies noise in R, G and B of the display's
    linear light, (3,).

    The noise is independent and of one size in the white-balanced channels: the norms of the
    rows of the matrix from them to linear RGB, with 1 for white on both sides.

    white_xyz : (3,) of the lamp, in the unit of the matrix
    adaptation : of the lamp's white to the display's

    Raises PixsimError as `adaptation_matrix` does.
    """
    to_rgb = RGB_FROM_XYZ @ adaptation_matrix(white_xyz, WHITE_XYZ, adaptation) @ matrix
    return np.sqrt(np.square(to_rgb).sum(axis=1))


def check_noise_gains(
    matrix: Array, white_xyz: ArrayLike, adaptation: Adaptation = "bradford"
) -> None:
    """Raise AlikeChannelsError if a matrix amplifies noise more than 10 times. `noise_gains`
    describes the arguments.
    """
    gains = noise_gains(matrix, white_xyz, adaptation)
    if not gains.max() <= _MAX_NOISE_GAIN:
        got = f"noise gains of {', '.join(f'{gain:.3g}' for gain in gains)} in R, G, B"
        hint = (
            "The channels are nearly alike under this lamp. Choose filters that overlap less, or a"
            " lamp with a broader spectrum."
        )
        raise AlikeChannelsError(
            str(invalid("colour matrix", got, f"gains up to {_MAX_NOISE_GAIN:g}", hint))
        )


def _on_standard_grid(wavelength_nm: Array, sensitivities: Array) -> Array:
    """Sensitivities (81, C) on the grid of the tables, checked; 0 outside the range that is
    given.
    """
    nm = wavelength_nm
    if nm.size < 2 or not (np.diff(nm) > 0).all():
        raise invalid(
            "wavelength_nm",
            f"an array of shape {nm.shape}",
            "wavelengths in increasing order, one axis",
        )
    low, high = _NEEDED_NM
    if nm[0] > low or nm[-1] < high:
        raise invalid(
            "wavelength_nm", f"{nm[0]:g} to {nm[-1]:g} nm", f"at least {low:g} to {high:g} nm"
        )
    widest = int(np.diff(nm).argmax())
    if nm[widest + 1] - nm[widest] > _MAX_STEP_NM:
        got = f"a gap from {nm[widest]:g} to {nm[widest + 1]:g} nm"
        raise invalid(
            "wavelength_nm",
            got,
            f"steps of at most {_MAX_STEP_NM:g} nm",
            "Fill the gap; write 0 where there is no light.",
        )
    if len(sensitivities) != nm.size or sensitivities.shape[1] < 3:
        allowed = f"({nm.size}, channels), three channels or more"
        raise invalid(
            "sensitivities, shape",
            sensitivities.shape,
            allowed,
            "Put the channels in the last axis.",
        )
    largest = sensitivities.max()
    if not largest > 0:
        raise invalid("sensitivities", "0 everywhere", "a response of each channel")
    return np.stack(
        [
            np.interp(STANDARD_NM, nm, curve, left=0.0, right=0.0)
            for curve in sensitivities.T / largest
        ],
        axis=1,
    )
