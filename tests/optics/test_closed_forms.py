"""Kernels of lenses against closed forms and the numbers of other programs.

Extremes are in pixsim.verification.extreme_cases; ISETCam's numbers and a path tracer's in
tests/references.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from helpers.claims import Claim, check
from scipy.fft import dct

from pixsim import optics
from pixsim.base.errors import PixsimError
from pixsim.optics.camera import Camera
from pixsim.optics.ghosts import Ghost, find_ghosts, reflectances, unfolded_path
from pixsim.optics.glass import (
    LINES_UM,
    Glass,
    abbe_glass,
    catalogue,
    code_glass,
    constant_glass,
    read_catalogue,
    shifted,
)
from pixsim.optics.lens_defocus import depth_of_disc_m, depth_of_field_m, signed_disc_um
from pixsim.optics.prescription import Surface
from pixsim.optics.pupil import Pupil, disc_pupil, numerical_aperture
from pixsim.optics.ray_trace import rays_from, trace
from pixsim.optics.stack import Stack, aperture_mtf
from pixsim.optics.thin_lens import dense_fall_off, thin_lens_pupil

LINES_NM = 1e3 * np.array([LINES_UM[line] for line in "FdC"])


# Glasses

NM = np.array([486.1327, 546.074, 587.5618, 656.2725])
# n_F, n_e, n_d, n_C as optiland 0.6.3 computes them from refractiveindex.info, one of each formula
# and one of a plastic.
INDICES = {
    "SCHOTT:N-BK7": (1.522376289731, 1.518721971471, 1.516800034501, 1.514322347261),
    "HIKARI:SK16": (1.627567401336, 1.622864330112, 1.620408887039, 1.617275432286),
    "MAIN:fused_silica_Malitson": (1.463126484747, 1.460078129245, 1.458463687137, 1.456366620295),
    "ORGANIC:PMMA_Beadie": (1.498363159348, 1.494489947679, 1.492527436275, 1.490066808367),
}
MELT = catalogue()["HOYA:M-PCD51"]


def abbe(glass: Glass | None) -> np.ndarray:
    """Return n_d and the Abbe number of a glass."""
    n_f, n_d, n_c = glass.index(LINES_NM)
    return np.array([n_d, (n_d - 1) / (n_f - n_c)])


GLASSES = [
    *(
        Claim(
            f"indices of {name}",
            lambda name=name: catalogue()[name].index(NM),
            indices,
            atol=1e-12,
            why="twelve digits",
        )
        for name, indices in INDICES.items()
    ),
    Claim(
        "a glass of two numbers",
        lambda: abbe(abbe_glass("model", 1.5168, 64.17)),
        [1.5168, 64.17],
        rtol=1e-12,
    ),
    Claim(
        "the model beside the glass",
        lambda: abbe_glass("model", 1.5168, 64.17).index(435.8),
        catalogue()["SCHOTT:N-BK7"].index(435.8),
        atol=2e-3,
        why="stated error",
    ),
    *(
        Claim(f"six digits {code}", lambda code=code: abbe(code_glass(code)), [n_d, v_d], rtol=1e-9)
        for code, n_d, v_d in (
            ("517642", 1.517, 64.2),
            ("003283", 2.003, 28.3),
            ("516800.641673", 1.5168, 64.1673),
            ("847.238", 1.847, 23.8),
        )
    ),
    Claim(
        "a melt", lambda: abbe(shifted(MELT, 7e-4, -0.05)) - abbe(MELT), [7e-4, -0.05], rtol=1e-9
    ),
    Claim("no shift", lambda: abbe(shifted(MELT, 0.0, 0.0)), abbe(MELT)),
]

Square = Callable[[Any, list[float]], Any]  # n² at a wavelength in µm


def powers(*exponents: int) -> Square:
    return lambda um, c: sum(value * um**power for value, power in zip(c, exponents, strict=True))


def sellmeier(um: Any, c: list[float]) -> Any:
    return 1 + sum(b * um**2 / (um**2 - pole) for b, pole in zip(c[::2], c[1::2], strict=True))


def herzberger(um: Any, c: list[float]) -> Any:
    pole = 1 / (um**2 - 0.028)
    return (c[0] + c[1] * pole + c[2] * pole**2 + c[3] * um**2 + c[4] * um**4 + c[5] * um**6) ** 2


SELLMEIER = [1.04, 0.006, 0.23, 0.02, 1.0, 103.0, 0.1, 150.0, 0.05, 200.0]
SERIES = [2.27, -0.01, 0.011, 1e-4, 1e-6, 1e-8]
# Number of the formula in Zemax's manual -> coefficients, and n² of them.
AGF: dict[int, tuple[list[float], Square]] = {
    1: (SERIES, powers(0, 2, -2, -4, -6, -8)),
    2: (SELLMEIER[:6], sellmeier),
    3: ([1.5, 0.004, 2e-5, -0.003, 1e-5, 1e-6], herzberger),
    4: (
        [0.1, 1.1, 0.1, 0.005, 0.15],
        lambda um, c: 1 + c[0] + c[1] * um**2 / (um**2 - c[2] ** 2) + c[3] / (um**2 - c[4] ** 2),
    ),
    5: ([1.5, 0.01, 5e-4], lambda um, c: (c[0] + c[1] / um + c[2] / um**3.5) ** 2),
    6: (SELLMEIER[:8], sellmeier),
    7: ([2.25, 0.012, 0.01, 0.009], lambda um, c: c[0] + c[1] / (um**2 - c[2]) - c[3] * um**2),
    8: (
        [1.1, 1.15, 0.01, 0.009],
        lambda um, c: c[0] + c[1] * um**2 / (um**2 - c[2]) - c[3] * um**2,
    ),
    9: ([1.2, 1.05, 0.01, 0.9, 100.0], lambda um, c: c[0] - 1 + sellmeier(um, c[1:])),
    10: ([*SERIES, 1e-9, 1e-10], powers(0, 2, -2, -4, -6, -8, -10, -12)),
    11: (SELLMEIER, sellmeier),
    12: ([*SERIES, 1e-4, 1e-5], powers(0, 2, -2, -4, -6, -8, 4, 6)),
    13: ([2.27, -0.01, 1e-4, *SERIES[2:], 1e-9, 1e-10], powers(0, 2, 4, -2, -4, -6, -8, -10, -12)),
}


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_catalogue_of_zemax_has_each_formula_of_its_manual(tmp_path, encoding: str) -> None:
    lines = []
    for formula, (coefficients, square) in AGF.items():
        n_d = math.sqrt(square(LINES_UM["d"], coefficients))
        numbers = [*coefficients, *([0.0] * (10 - len(coefficients)))]
        lines += ["CC a glass", f"NM GLASS{formula} {formula} 517642 {n_d} 64.2 0 1", "GC nothing"]
        lines += [f"CD {' '.join(map(repr, numbers))}", "TD 0 0 0 0 0 0 20", "LD 0.35 2.0"]
    (tmp_path / "mine.agf").write_bytes("\n".join(lines).encode(encoding))
    glasses = read_catalogue(tmp_path / "mine.agf")
    um = np.array([0.4, 0.55, 1.1])
    for formula, (coefficients, square) in AGF.items():
        glass = glasses[f"MINE:GLASS{formula}"]
        wanted = np.sqrt(square(um, coefficients))
        check(f"formula {formula}", glass.index(1e3 * um), wanted, rtol=1e-12, why="rounding")
        assert glass.range_um == (0.35, 2.0)


def test_every_glass_of_the_table_is_physical() -> None:
    """Normal dispersion in every medium, and the Abbe number of optical media."""
    glasses = catalogue()
    assert len(glasses) == 1638
    assert {glass.formula for glass in glasses.values()} == {1, 2, 3}
    numbers = np.array([abbe(glass) for glass in glasses.values()])
    assert (numbers > [1.4, 15]).all(), numbers.min(axis=0)
    assert (numbers < [2.2, 100]).all(), numbers.max(axis=0)


# Thin lens and pupil

COS40 = math.cos(math.radians(40.0))
TANGENTS = np.tan(np.radians([0.0, 10.0, 25.0, 45.0, 60.0]))
FIELD = optics.field_factor((3, 4), 10.0, 2.0, 4.0, 0.1)
OUTWARD = np.array([math.cos(math.radians(40)), math.sin(math.radians(40))])
SIN25 = math.sin(math.radians(25))


def ellipse() -> Pupil:
    """Return ellipses on the axis and at 25°, in the direction of 40°."""
    disc = disc_pupil(0.3, [0.0, 25.0], 40.0)
    return Pupil(disc.centre, 0.75 * disc.radial, 0.9 * disc.tangential)


def moments() -> tuple[np.ndarray, np.ndarray]:
    """Return the mean direction of both ellipses, and the second moment along the first."""
    rays = ellipse().directions(3, 8)
    mean = (rays.cosines * rays.shares[..., None]).sum(axis=1)
    return mean, (rays.cosines[0] @ OUTWARD) ** 2 @ rays.shares[0]


def thin_lens_axes() -> list[float]:
    """Return the width of the pupil of f/100 at 40°, along the field and across it."""
    pupil = thin_lens_pupil(100.0, math.tan(math.radians(40.0)))
    edge, _ = pupil.boundary(np.array([0.0, np.pi / 2, np.pi, 1.5 * np.pi]))
    return [edge[0, 0] - edge[2, 0], edge[1, 1] - edge[3, 1]]


SLOW = 1 / (4 * 500.0**2 * 1.3**2)
THIN_LENS = [
    *(
        Claim(
            f"π sin²α at f/{n:g}, m = {m:g}",
            lambda n=n, m=m: optics.irradiance_factor(n, 0.0, m),
            np.pi * np.sin(np.arctan(0.5 / (n * (1 + abs(m))))) ** 2,
            rtol=1e-14,
        )
        for n, m in ((0.5, 0.0), (1.0, 0.0), (1.4, -0.5), (0.25, 1.0), (1e100, 0.0))
    ),
    *(
        Claim(
            f"cos⁴ at {deg:g}°",
            lambda deg=deg: optics.irradiance_factor(500.0, np.tan(np.radians(deg)), 0.3),
            np.pi * math.cos(math.radians(deg)) ** 4 * SLOW,
            rtol=1.1 * SLOW,
            why="next term of the series: -1 to 0.19 A",
        )
        for deg in (0.0, 15.0, 40.0, 70.0)
    ),
    *(
        Claim(
            f"πA/T² at T = {t:g}²",
            lambda t=t: optics.irradiance_factor(4.0, t),
            np.pi / 64 / t / t / t / t,
            rtol=1e-12,
            atol=1e-300,
        )
        for t in (1e8, 1e76, 1e100, np.inf)
    ),
    Claim(
        "a sample of the field",
        lambda: FIELD[2, 3],
        optics.irradiance_factor(4.0, np.hypot(10, 15) / 2000, 0.1),
        rtol=1e-14,
    ),
    Claim("the field is mirrored", lambda: FIELD[::-1, ::-1], FIELD),
    Claim(
        "part of the field",
        lambda: optics.field_factor((3, 4), 10.0, 2.0, 4.0, 0.1, np.s_[1:, 2:3]),
        FIELD[1:, 2:3],
    ),
    Claim("numerical aperture", lambda: numerical_aperture(1.4), math.sin(math.atan(1 / 2.8)), rtol=1e-15),
    Claim("of a pinhole", lambda: numerical_aperture(math.inf), 0.0),
    Claim("area of ellipses", lambda: ellipse().area, np.full(2, math.pi * 0.09 * 0.675), rtol=1e-14),
    Claim("chief rays", lambda: ellipse().chief_cosines, [[0, 0], SIN25 * OUTWARD], rtol=1e-14, atol=1e-16),
    Claim("mean direction", lambda: moments()[0], [[0, 0], SIN25 * OUTWARD], atol=1e-15),
    Claim("second moment a²/4", lambda: moments()[1], (0.3 * 0.75) ** 2 / 4, rtol=1e-13),
    *(
        Claim(
            f"area of a pupil is Foote's at f/{n:g}",
            lambda n=n, m=m: thin_lens_pupil(n, TANGENTS, 33.0, m).area,
            optics.irradiance_factor(n, TANGENTS, m),
            rtol=1e-10,
            why="rounding of 1e-5 between cosines of 1",
        )
        for n, m in ((0.5, 0.0), (1.4, 0.2), (100.0, 0.0))
    ),
    *(
        Claim(
            f"rays of a pupil have Foote's light at f/{n:g}",
            lambda n=n: (
                np.pi * (0.5 / n) ** 2
                * thin_lens_pupil(n, TANGENTS).directions(16, 40).weight.sum(axis=-1)
            ),
            optics.irradiance_factor(n, TANGENTS),
            rtol=1e-7,
            why="quadrature",
        )
        for n in (0.5, 4.0)
    ),
    Claim(
        "chief rays of a thin lens",
        lambda: thin_lens_pupil(4.0, TANGENTS, 33.0).chief_cosines[:, 1],
        np.sin(np.arctan(TANGENTS)) * math.sin(math.radians(33)),
        rtol=1e-14,
        atol=1e-16,
    ),
    Claim("semi-axes cos³ and cos", thin_lens_axes, [0.01 * COS40**3, 0.01 * COS40], rtol=1e-4, why="NA²"),
    *(
        Claim(
            f"light and blur share one aperture at f/{n:g}",
            lambda n=n: optics.cutoff_cy_per_mm(
                500.0, Camera(focal_length_mm=50.0, f_number=n, object_distance_m=0.3).effective_f_number
            ),
            2 * np.sqrt(optics.irradiance_factor(n, 0.0, 0.2) / np.pi) / 500e-6,
            rtol=1e-13,
        )
        for n in (1.0, 1.8, 1000.0)
    ),
    Claim(
        "fall-off of a table in r² is that of the law",
        lambda: np.interp(1.5, *dense_fall_off(((0.0, 1.0), (1.0, 0.9), (2.0, 0.6)))),
        1 - 0.1 * 1.5**2,
        rtol=2e-5,
        why="512 straight lines",
    ),
]  # fmt: skip

# Discs out of focus: depths u and distances v of a thin lens of 25 mm at f/2, focused on 1 m.

THIN = Camera(focal_length_mm=25.0, f_number=2.0)


def marginal_disc_um(depth_m: float) -> float:
    """Return the diameter in which the marginal rays of a point meet the sensor."""
    image_mm = 1e3 * depth_m * 25.0 / (1e3 * depth_m - 25.0)
    return 1e3 * 25.0 / 2.0 * (THIN.image_distance_mm - image_mm) / image_mm


DEFOCUS = [
    *(
        Claim(
            f"marginal rays from {u:g} m",
            lambda u=u: signed_disc_um(THIN, u),
            marginal_disc_um(u),
            rtol=1e-9,
            atol=1e-9,
        )
        for u in (0.5, 1.0, 3.0)
    ),
    Claim("depth of a disc", lambda: signed_disc_um(THIN, depth_of_disc_m(THIN, -20.0)), -20.0, rtol=1e-9),
    Claim(
        "depth of field, u f²/(f² ± N c (u - f))",
        lambda: depth_of_field_m(THIN, 30.0),
        [625 / (625 + 2 * 0.03 * 975), 625 / (625 - 2 * 0.03 * 975)],
        rtol=1e-12,
    ),
    Claim("beyond infinity", lambda: depth_of_field_m(THIN, 1e6)[1], math.inf),
]  # fmt: skip

# Diffraction

GREEN_NM = np.array([550.0])
ONE = np.array([1.0])
FLAT = [np.full(shape, 3.0) for shape in ((32, 20), (1, 7), (7, 1), (1, 1))]
DARK = np.zeros((8, 8))
POINT = np.eye(1, 8192)  # in a corner it holds all cosines
OTF = optics.diffraction_otf(np.arange(8192) / (2 * 8192 * 0.5e-3), 550.0, 4.0)
DIFFRACTION = [
    Claim("cut-off 1/(λN)", lambda: optics.cutoff_cy_per_mm(500.0, 4.0), 500.0, rtol=1e-15),
    Claim(
        "OTF: 1, half way, beyond",
        lambda: optics.diffraction_otf([0.0, 250.0, -250.0, 500.0, 1e9], 500.0, 4.0),
        [1, 2 / 3 - np.sqrt(3) / (2 * np.pi), 2 / 3 - np.sqrt(3) / (2 * np.pi), 0, 0],
        atol=1e-15,
    ),
    Claim(
        "only λN matters",
        lambda: optics.diffraction_otf(100.0, 500.0, 4.0),
        optics.diffraction_otf(100.0, 400.0, 5.0),
        rtol=1e-14,
    ),
    Claim(
        "OTF of two wavelengths",
        lambda: optics.white_otf(np.array([100.0]), np.array([450.0, 650.0]), np.array([0.25, 0.75]), 4.0),
        [
            0.25 * float(optics.diffraction_otf(100.0, 450.0, 4.0))
            + 0.75 * float(optics.diffraction_otf(100.0, 650.0, 4.0))
        ],
        rtol=1e-14,
    ),
    Claim(
        "square aperture: 2/π at its Nyquist frequency, 0 at 1/w",
        lambda: optics.square_aperture_mtf([0.0, 100.0, 200.0], 5.0),
        [1, 2 / np.pi, 0],
        atol=1e-15,
    ),
    *(
        Claim(
            f"a flat field of {flat.shape} is unchanged",
            lambda flat=flat: optics.diffract(flat, 2.0, GREEN_NM, ONE, 4.0),
            flat,
            atol=1e-12,
        )
        for flat in FLAT
    ),
    *(
        Claim(
            f"a sum of {len(pictures)} pictures without light is dark",
            lambda pictures=pictures: optics.diffract_sum(pictures, (8, 8), 1.0, GREEN_NM, 8.0),
            DARK,
        )
        for pictures in ([], [(DARK + 1, np.zeros(1))])
    ),
    Claim(
        "all frequencies are scaled by the OTF",
        lambda: dct(optics.diffract(POINT, 0.5, GREEN_NM, ONE, 4.0)[0]) / dct(POINT[0]),
        OTF,
        atol=1e-7,
        why="a table of 32768 frequencies: 3e-8",
    ),
    Claim("up to the cut-off, below order 3724", lambda: np.count_nonzero(OTF), 3724),
]  # fmt: skip

# Rays and ghosts

INDEX = 1.7
GLASS = constant_glass("glass", INDEX)


def plate(angle_deg: float) -> list[float]:
    """Return height, cosine and path of a ray behind a plate of 50 mm, n = 1.5."""
    one = np.ones((1, 1))
    sine = math.sin(math.radians(angle_deg))
    start = rays_from(0 * one, 0 * one, 0 * one, 0 * one, sine * one, math.sqrt(1 - sine**2) * one)
    surfaces = [Surface(0.0, 50.0, constant_glass("n", 1.5)), Surface(0.0, 1.0)]
    *_, rays = trace(start, surfaces, [1.0, 1.5, 1.0])
    return [float(part[0, 0]) for part in (rays.y, rays.m, rays.path_mm)]


def inside(angle_deg: float) -> float:
    return math.asin(math.sin(math.radians(angle_deg)) / 1.5)


def only_ghost(lens: list[Surface], height_mm: float, slope: float) -> Ghost:
    indices = [1.0, INDEX, 1.0]
    (ghost,) = find_ghosts(lens, indices, reflectances(indices), height_mm, slope)
    return ghost


def thin_lens(bending: float) -> list[Surface]:
    curvature = 1 / (50.0 * (INDEX - 1))
    front = curvature * (1 + bending) / 2
    return [Surface(front, 1e-9, GLASS), Surface(front - curvature, 50.0)]


def transmitted(reflectance: np.ndarray) -> float:
    """Return the share that a stack of surfaces lets through with all of its reflections."""
    share = 1 - reflectance[0]
    behind = reflectance[0]
    for r in reflectance[1:]:
        rounds = 1 / (1 - behind * r)
        share, behind = share * (1 - r) * rounds, r + (1 - r) ** 2 * behind * rounds
    return share


STACKED = [1.0, INDEX, 1.5, 1.0, INDEX, 1.0]


def ghost_shares(coated: float | None) -> float:
    surfaces = [Surface(0.1, 1.0, constant_glass("a", n)) for n in STACKED[1:]]
    reflectance = reflectances(STACKED, coated)
    return sum(ghost.share for ghost in find_ghosts(surfaces, STACKED, reflectance, 1.0, 0.0))


GHOST_MM = (INDEX - 1) * 50.0 / (3 * INDEX - 1)
FOLDED = unfolded_path(thin_lens(0.0), [1.0, INDEX, 1.0], 0, 1)
RAYS = [
    *(
        Claim(
            f"a plate at {deg:g}°: d tan θ', sin θ, n d/cos θ'",
            lambda deg=deg: plate(deg),
            [50 * math.tan(inside(deg)), math.sin(math.radians(deg)), 75 / math.cos(inside(deg))],
            rtol=1e-13,
            atol=1e-15,
        )
        for deg in (0.0, 20.0, 55.0)
    ),
    Claim(
        "bare and cemented surfaces",
        lambda: reflectances(STACKED)[:2],
        [(0.7 / 2.7) ** 2, (0.2 / 3.2) ** 2],
        rtol=1e-12,
    ),
    Claim(
        "coated surfaces, and a cemented one",
        lambda: reflectances(STACKED, 0.002)[:3],
        [0.002, (0.2 / 3.2) ** 2, 0.002],
        rtol=1e-12,
    ),
    *(
        Claim(
            f"ghosts are the light of all reflections, coating {coated}",
            lambda coated=coated: ghost_shares(coated),
            transmitted(r) / np.prod(1 - r) - 1,
            rtol=30 * float(r.max()) ** 2,
            why="light that is reflected four times",
        )
        for coated in (None, 0.002)
        for r in [reflectances(STACKED, coated)]
    ),
    *(
        Claim(
            f"ghost of a thin lens of bending {bending:g}: (n - 1) f/(3n - 1) behind it",
            lambda bending=bending: only_ghost(thin_lens(bending), 2.0, 0.0).focus_from_image_mm,
            GHOST_MM - 50.0,
            rtol=1e-6,
            why="1e-9 mm thick",
        )
        for bending in (-1.0, 0.0, 0.5)
    ),
    Claim(
        "blur of that ghost",
        lambda: only_ghost(thin_lens(0.0), 2.0, 0.0).blur_mm,
        2 * 2.0 * (50.0 / GHOST_MM - 1),
        rtol=1e-6,
        why="1e-9 mm thick",
    ),
    Claim(
        "light crosses a plate three times",
        lambda: only_ghost([Surface(0.0, 3.0, GLASS), Surface(0.0, 10.0)], 0.5, 0.05).blur_mm,
        2 * (0.5 + 0.05 * (3 * 3.0 / INDEX + 10.0)),
        rtol=1e-12,
    ),
    Claim("indices of an unfolded path", lambda: FOLDED[1], [1.0, INDEX, -INDEX, INDEX, 1.0]),
    Claim(
        "thicknesses of an unfolded path",
        lambda: [surface.thickness_mm for surface in FOLDED[0]],
        [1e-9, -1e-9, 1e-9, 50.0],
    ),
]


@pytest.mark.parametrize("claim", [*GLASSES, *THIN_LENS, *DEFOCUS, *DIFFRACTION, *RAYS], ids=str)
@pytest.mark.filterwarnings("error")
def test_closed_forms(claim: Claim) -> None:
    claim.check()


# Pictures blurred by a circular pupil


@pytest.mark.parametrize("pitch_um", [2.65, 0.25])
@pytest.mark.parametrize(
    ("row_order", "column_order"), [(0, 0), (0, 3), (5, 0), (40, 90), (127, 191)]
)
def test_cosine_is_scaled_by_the_otf(pitch_um: float, row_order: int, column_order: int) -> None:
    y = np.cos(np.pi * row_order * (np.arange(128) + 0.5) / 128)
    x = np.cos(np.pi * column_order * (np.arange(192) + 0.5) / 192)
    picture = y[:, None] * x
    frequency = np.hypot(row_order / (256e-3 * pitch_um), column_order / (384e-3 * pitch_um))
    nm = np.array([450.0, 550.0, 700.0])
    weight = np.array([1.0, 2.0, 0.5])
    otf = (weight * optics.diffraction_otf(frequency, nm, 4.0)).sum() / 3.5
    blurred = optics.diffract(picture, pitch_um, nm, weight, 4.0)
    check("picture", blurred, otf * picture, atol=1e-7, why="a table of 32768 frequencies: 3e-8")


@pytest.mark.parametrize("shape", [(24, 40), (1, 33)])
def test_sum_of_pictures_is_that_of_their_blurs(shape, monkeypatch: pytest.MonkeyPatch) -> None:
    """Weights of both signs, as the spectra of a fit; strips of any size; float32 pictures."""
    rng = np.random.default_rng(3)
    nm = np.array([450.0, 550.0, 620.0, 700.0])
    pictures = rng.uniform(0, 1, (4, *shape)).astype(np.float32)
    weights = rng.normal(0, 1, (4, 4))
    weights[3] = 0.0
    together = optics.diffract_sum(zip(pictures, weights, strict=True), shape, 1.0, nm, 8.0)
    wanted = sum(
        weight * optics.diffract(pictures[i].astype(float), 1.0, nm[k : k + 1], ONE, 8.0)
        for (i, k), weight in np.ndenumerate(weights)
    )
    check("sum", together, wanted, atol=1e-6, why="tables of other wavelengths: 3e-8 each")
    mean = np.tensordot(weights.sum(axis=1), pictures.mean(axis=(1, 2), dtype=float), 1)
    check("light", together.mean(), mean, rtol=1e-12, why="conserved")
    monkeypatch.setattr("pixsim.base.arrays.STRIP_SAMPLES", 5)
    strips = optics.diffract_sum(zip(pictures, weights, strict=True), shape, 1.0, nm, 8.0)
    check("strips", strips, together, why="the same bits")


def test_transfer_behind_the_lens_multiplies_its_otf() -> None:
    """A Gaussian of σ in place of the lens, and behind it."""
    picture = np.cos(np.pi * 5 * (np.arange(64) + 0.5) / 64)[None]
    frequency = 5 / (2 * 64 * 1e-3)

    def gaussian(cy_per_mm: np.ndarray, nm: float) -> np.ndarray:
        return np.exp(-((cy_per_mm * nm * 1e-5) ** 2))

    mtf = float(gaussian(np.array(frequency), 550.0))
    otf = float(optics.diffraction_otf(frequency, 550.0, 8.0))
    for f_number, wanted in ((None, mtf), (8.0, mtf * otf)):
        blurred = optics.diffract_sum([(picture, ONE)], (1, 64), 1.0, GREEN_NM, f_number, gaussian)
        check(f"f/{f_number}", blurred, wanted * picture, atol=1e-7, why="a table of frequencies")


# Values that do not fit each other


def collection(**numbers: object) -> object:
    sizes = {"pitch_um": 2.2, "photodiode_side_um": 1.3, "height_um": 3.5, "index": 1.5}
    return optics.stack_collection(**sizes | {"f_number": 2.0} | numbers)


REFUSED: list[tuple[str, Callable[[], object], str]] = [
    *(
        (f"{nm} nm", lambda nm=nm: catalogue()["SCHOTT:N-BK7"].index([550.0, nm]), "wavelength_nm: got .*'SCHOTT:N-BK7'")
        for nm in (299.0, 2501.0, 0.0, np.nan, np.inf)
    ),
    ("no index", lambda: Glass("x", 3, (-1.0,)).index(550.0), "index of glass 'x': got nan"),
    ("formula", lambda: Glass("x", 6, (1.0,)), "formula of glass 'x': got 6"),
    ("an even number", lambda: Glass("x", 2, (1.0, 2.0)), "got 2 numbers"),
    ("few numbers", lambda: Glass("x", 4, (1.0,)), "got 1 numbers"),
    ("not six", lambda: Glass("x", 7, (1.0,)), "got 1 numbers"),
    ("infinite", lambda: Glass("x", 3, (np.inf,)), "infinity or NaN"),
    ("faster than f/0.5", lambda: optics.irradiance_factor(0.4, 0.0), "f_number: got"),
    ("no tangent", lambda: optics.irradiance_factor(4.0, [0, np.nan]), "tan_field: got nan"),
    ("horizon", lambda: thin_lens_pupil(4.0, np.inf), "tan_field and azimuth_deg: got"),
    ("steep pupil", lambda: disc_pupil(0.5, [0.0, 30.001]), "pupil: .*horizon"),
    ("90°", lambda: disc_pupil(0.1, 90.0), "chief_ray_deg: got 90"),
    ("dark weights", lambda: optics.diffract(np.ones((2, 2)), 1.0, np.ones(1), np.zeros(1), 4.0), "weight: got a sum of 0"),
    ("weights", lambda: optics.diffract(np.ones((2, 2)), 1.0, np.ones(1), np.ones(2), 4.0), "1 and 2 values"),
    ("photodiode", lambda: collection(photodiode_side_um=2.3), "photodiode_side_um: got 2.3"),
    ("étendue", lambda: collection(height_um=1.2), "height_um: got 1.2; .* 1.24122"),
    ("shift", lambda: collection(shift_um=(1.2, 0.0)), r"shift_um: got \(1\.2, 0\.0\)"),
    ("cone", lambda: collection(f_number=0.9, chief_ray_deg=32.0), "pupil: .*1.016"),
    ("light beside", lambda: aperture_mtf(Stack(6.5, 3.5, 8.0, 1.5, False), disc_pupil(1e-9, 53.0), 1.0), "does not reach"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "call", "words"), REFUSED)
def test_values_are_refused_by_their_cause(name: str, call: Callable[[], object], words) -> None:
    with pytest.raises(PixsimError, match=words):
        call()


def test_pupils_up_to_the_horizon_are_allowed() -> None:
    for chief_deg in (0.0, 5.0, -30.0):
        disc_pupil((1 - math.sin(math.radians(abs(chief_deg)))) * (1 - 1e-6), chief_deg, 10.0)
