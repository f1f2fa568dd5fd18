"""Kernels of lenses, and the stack of a pixel, against closed forms, the numbers of other programs
(tests/data/microlens/README.md), étendue and conservation.

Extremes are in pixsim.verification.extreme_cases; ISETCam's numbers and a path tracer's in
tests/references.
"""

import csv
import math
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers.claims import Claim, check
from scipy.integrate import quad

from pixsim import Camera, PixsimError, optics
from pixsim.optics import stack as stacks
from pixsim.optics.ghosts import Ghost, find_ghosts, reflectances, unfolded_path
from pixsim.optics.glass import (
    LINES_UM,
    Glass,
    abbe_glass,
    catalogue,
    code_glass,
    constant_glass,
    dispersive_coefficients,
    read_catalogue,
    shifted,
)
from pixsim.optics.lens_defocus import depth_of_disc_m, depth_of_field_m, signed_disc_um
from pixsim.optics.prescription import Surface
from pixsim.optics.pupil import Directions, Pupil, disc_pupil, numerical_aperture
from pixsim.optics.ray_trace import intersect, rays_from, trace
from pixsim.optics.stack import (
    Stack,
    aperture_mtf,
    aperture_side_um,
    collected_shares,
    model_limits,
)
from pixsim.optics.thin_lens import dense_fall_off, thin_lens_pupil

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
    n_f, n_d, n_c = (glass.index(1e3 * LINES_UM[line]) for line in "FdC")
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
            ("0500.283", 2.05, 28.3),
            ("516800.641673", 1.5168, 64.1673),
            ("847.238", 1.847, 23.8),
        )
    ),
    Claim(
        "a melt", lambda: abbe(shifted(MELT, 7e-4, -0.05)) - abbe(MELT), [7e-4, -0.05], rtol=1e-9
    ),
    *(
        Claim(
            f"coefficients of formula {formula} without which a glass has one index",
            lambda formula=formula, count=count: dispersive_coefficients(formula, range(count)),
            factors,
        )
        for formula, count, factors in (
            (2, 7, [1, 3, 5]),
            (4, 13, [1, 5, 9, 11]),
            (7, 6, [1, 2, 3, 4, 5]),
        )
    ),
    Claim(
        "a glass is known at the ends of its range",
        lambda: np.isfinite(catalogue()["SCHOTT:N-BK7"].index([300.0, 2500.0])),
        [1, 1],
    ),
    Claim("no shift", lambda: abbe(shifted(MELT, 0.0, 0.0)), abbe(MELT)),
]

Square = Callable[[object, list[float]], object]  # n² at a wavelength in µm


def powers(*exponents: int) -> Square:
    return lambda um, c: sum(value * um**power for value, power in zip(c, exponents, strict=True))


def sellmeier(um, c: list[float]):
    return 1 + sum(b * um**2 / (um**2 - pole) for b, pole in zip(c[::2], c[1::2], strict=True))


def herzberger(um, c: list[float]):
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
        lines += [
            *(
                "CC a glass",
                f"NM GLASS{formula} {formula} 517642 {n_d + 8e-4} 64.2 0 1",
                "GC nothing",
            ),
            *(f"CD {' '.join(map(repr, numbers))}", "TD 0 0 0 0 0 0 20", "LD 0.35 2.0 0"),
        ]
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
    assert (len(glasses), {glass.formula for glass in glasses.values()}) == (1638, {1, 2, 3})
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
    Claim(
        "height of a window of half the width",
        lambda: Camera(die_mm=4.0, die_height_mm=3.0).window(2.0).height_mm,
        1.5,
        why="exact",
    ),
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
    *(
        Claim(
            f"a disc at {deg:g}° that nearly reaches the horizon",
            lambda deg=deg, radius=radius: disc_pupil(radius, deg, 10.0).area,
            np.pi * radius**2,
            rtol=1e-12,
        )
        for deg in (0.0, 5.0, -30.0)
        for radius in [(1 - math.sin(math.radians(abs(deg)))) * (1 - 1e-6)]
    ),
    Claim("chief rays", lambda: ellipse().chief_cosines, [[0, 0], SIN25 * OUTWARD], rtol=1e-14, atol=1e-16),
    Claim("mean direction", lambda: moments()[0], [[0, 0], SIN25 * OUTWARD], atol=1e-15),
    Claim("second moment a²/4", lambda: moments()[1], (0.3 * 0.75) ** 2 / 4, rtol=1e-13),
    Claim(
        "nodes of a disc: Gauss's in radius², from the middle, and equal steps from x to y",
        lambda: disc_pupil(0.3).directions(2, 4).cosines,
        [
            [0.3 * math.sqrt((1 + side / math.sqrt(3)) / 2) * part for part in axis]
            for side in (-1, 1)
            for axis in ((1, 0), (0, 1), (-1, 0), (0, -1))
        ],
        atol=1e-15,
    ),
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


DEFOCUS = [
    *(
        Claim(
            f"marginal rays from {u:g} m",
            lambda u=u: signed_disc_um(THIN, u),
            # The pupil's 12.5 mm over the distance of the image, times what it is out of focus.
            1e3 * 12.5 * (THIN.image_distance_mm - image_mm) / image_mm,
            rtol=1e-9,
            atol=1e-9,
        )
        for u in (0.5, 1.0, 3.0)
        for image_mm in [1e3 * u * 25.0 / (1e3 * u - 25.0)]
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
DARK = np.zeros((8, 8))
DIFFRACTION = [
    Claim("cut-off 1/(λN)", lambda: optics.cutoff_cy_per_mm(500.0, 4.0), 500.0, rtol=1e-15),
    Claim(
        "cut-off and OTF half way to it in the infrared",
        lambda: [optics.cutoff_cy_per_mm(1000.0, 4.0), float(optics.diffraction_otf(125.0, 1000.0, 4.0))],
        [250.0, 2 / 3 - np.sqrt(3) / (2 * np.pi)],
        rtol=1e-14,
    ),
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
        for flat in (np.full(shape, 3.0) for shape in ((32, 20), (1, 7), (7, 1), (1, 1)))
    ),
    *(
        Claim(
            f"a sum of {len(pictures)} pictures without light is dark",
            lambda pictures=pictures: optics.diffract_sum(pictures, (8, 8), 1.0, GREEN_NM, 8.0),
            DARK,
        )
        for pictures in ([], [(DARK + 1, np.zeros(1))])
    ),
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


def depth_in_ball(height_mm: float) -> float:
    """Return how far behind the vertex of a ball of 1 mm a ray along its axis meets it."""
    start = rays_from(*map(np.array, (0.0, height_mm, 0.0, 0.0, 0.0, 1.0)))
    return float(intersect(start, Surface(1.0, 1.0), 1.0).z)


def only_ghost(lens: list[Surface], height_mm: float, slope: float, n: float = 1.0) -> Ghost:
    indices = [n, INDEX, *[n] * (len(lens) - 1)]
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
CURVED = Surface(0.1, 1.0, GLASS)


def ghost_shares(coated: float | None) -> float:
    ghosts = find_ghosts([CURVED] * 5, STACKED, reflectances(STACKED, coated), 1.0, 0.0)
    return sum(ghost.share for ghost in ghosts)


GHOST_MM = (INDEX - 1) * 50.0 / (3 * INDEX - 1)
FOLDED = unfolded_path(thin_lens(0.0), [1.0, INDEX, 1.0], 0, 1)
RAYS = [
    Claim(
        "a ray meets the front of a ball up to its rim",
        lambda: list(map(depth_in_ball, (0.0, 0.6, 0.96))),
        [0.0, 0.2, 0.72],
        atol=1e-14,
        why="rounding",
    ),
    Claim(
        "a ray on the edge of an aperture passes, one beyond does not",
        lambda: [
            intersect(
                rays_from(*map(np.array, (0.0, height_mm, 0.0, 0.0, 0.0, 1.0))),
                Surface(0.0, 1.0, semi_diameter_mm=2.0, clips=True),
                1.0,
            ).passed
            for height_mm in (2.0, 2.0 + 1e-11)
        ],
        [1, 0],
    ),
    *(
        Claim(
            f"a plate at {deg:g}°: d tan θ', sin θ, n d/cos θ'",
            lambda deg=deg: plate(deg),
            [50 * math.tan(inside), math.sin(math.radians(deg)), 75 / math.cos(inside)],
            rtol=1e-13,
            atol=1e-15,
        )
        for deg in (0.0, 20.0, 55.0)
        for inside in [math.asin(math.sin(math.radians(deg)) / 1.5)]
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
    Claim(
        "ghosts, the largest share first",
        lambda: [
            ghost.surfaces
            for ghost in find_ghosts([CURVED] * 5, STACKED, reflectances(STACKED), 1.0, 0.0)[:4]
        ],
        [(4, 5), (1, 4), (1, 5), (3, 4)],
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
    *(
        Claim(
            f"light crosses a plate in a medium of {n:g} three times",
            lambda n=n: (
                only_ghost(
                    [Surface(0.0, 3.0, GLASS), Surface(0.0, 4.0), Surface(0.0, 6.0)], 0.5, 0.05, n
                ).blur_mm
            ),
            2 * (0.5 + 0.05 * (3 * 3.0 * n / INDEX + 10.0)),
            rtol=1e-12,
        )
        for n in (1.0, 1.3)
    ),
    Claim("indices of an unfolded path", lambda: FOLDED[1], [1.0, INDEX, -INDEX, INDEX, 1.0]),
    Claim(
        "thicknesses and indices on the way between the outer ones of three surfaces",
        lambda: [
            number
            for surfaces, indices in [
                unfolded_path(
                    [Surface(0.0, mm) for mm in (1.0, 2.0, 3.0)], [1.0, 1.5, 1.7, 1.0], 0, 2
                )
            ]
            for number in (*(surface.thickness_mm for surface in surfaces), *indices)
        ],
        [1, 2, -2, -1, 1, 2, 3, 1.0, 1.5, 1.7, -1.7, -1.5, 1.5, 1.7, 1.0],
    ),
    Claim(
        "thicknesses of an unfolded path",
        lambda: [surface.thickness_mm for surface in FOLDED[0]],
        [1e-9, -1e-9, 1e-9, 50.0],
    ),
]

# The stack of a pixel

BANDS_NM = [450.0, 550.0, 650.0]
AXIS = np.zeros(2)
WAVE = Directions(AXIS[None], np.ones(1), AXIS)
BOTH = pytest.mark.parametrize("refraction", ["exact", "paraxial"])


# Outside numbers


@cache
def table(name: str) -> list[dict[str, str]]:
    text = (Path(__file__).parents[1] / "data/microlens" / name).read_text(encoding="utf-8")
    return list(csv.DictReader(text.splitlines()))


STACKS = {row["stack"]: row for row in table("stacks.csv")}
BARE = [name for name, row in STACKS.items() if row["microlens"] == "off"]
TARGETS = [
    (name, target)
    for name in STACKS
    for target in ("photodiode", "cell")
    if target == "photodiode" or name not in BARE
]


def landing(name: str, target: str, column: str) -> np.ndarray:
    """Return a column of landing.csv of a stack and target, (3, 3) as `stack_collection`."""
    rows = [row for row in table("landing.csv") if (row["stack"], row["target"]) == (name, target)]
    rows.sort(key=lambda row: (int(row["dy_pixels"]), int(row["dx_pixels"])))
    return np.array([float(row[column]) for row in rows]).reshape(3, 3)


def reference_stack(name: str, target: str, refraction: str) -> tuple[Stack, Pupil]:
    """Return a stack and pupil of stacks.csv; a target of side p is a photodiode of that side."""
    row = {
        key: float(text)
        for key, text in STACKS[name].items()
        if key not in ("stack", "microlens") and text
    }
    side_um = row["photodiode_um"] if target == "photodiode" else row["pitch_um"]
    shift_um = row["shift_x_um"], row["shift_y_um"]
    sizes = row["pitch_um"], side_um, row["height_um"], row["index"]
    stack = Stack(*sizes, name not in BARE, shift_um, refraction)
    aperture = numerical_aperture(row["f_number"])
    return stack, disc_pupil(aperture, row["cra_deg"], row["azimuth_deg"])


@pytest.mark.parametrize(("name", "target"), TARGETS)
def test_shares_agree_with_outside_numbers(name: str, target: str) -> None:
    """Quadrature of the paraxial model, and rays drawn at random of the exact one."""
    stack, pupil = reference_stack(name, target, "paraxial")
    inner = collected_shares(stack, pupil)[1:-1, 1:-1]
    digit = 1e-7 if name in BARE else 1e-9
    check("paraxial", inner, landing(name, target, "quadrature"), atol=digit, why="its digits")
    if target == "photodiode":
        lost = float(STACKS[name]["lost_quadrature"])
        check("lost", 1 - inner.sum(), lost, atol=2e-7 if name in BARE else 1e-8, why="its digits")
    exact = collected_shares(reference_stack(name, target, "exact")[0], pupil)[1:-1, 1:-1]
    sigmas = 4 * landing(name, target, "mc_exact_se") + 1e-6
    miss = (exact - landing(name, target, "mc_exact_refraction")) / sigmas
    check("exact, in 4 standard errors", miss, np.zeros((3, 3)), atol=1.0, why="random rays")


@pytest.mark.parametrize(("name", "target"), [pair for pair in TARGETS if pair[0] not in BARE])
def test_diffracted_shares_agree_with_outside_numbers(name: str, target: str) -> None:
    stack, pupil = reference_stack(name, target, "paraxial")
    wave = Directions(pupil.chief_cosines[None], np.ones(1), pupil.chief_cosines)
    for light, kind in ((pupil, "diff_pupil"), (wave, "diff_single")):
        shares = collected_shares(stack, light, BANDS_NM)[:, 1:-1, 1:-1]
        wanted = [landing(name, target, f"{kind}_0.{nm / 10:.0f}um") for nm in BANDS_NM]
        check(kind, shares, np.array(wanted), atol=1e-8, why="interpolation of the spot: 3e-9")


# pitch, fill factor, height; bare f/4, f/1.4; lens f/4, f/1.4; lens f/4 at 10°, 20°; diffraction.
# Paraxial, n = 1.5, 550 nm.
PUBLISHED = [
    (6.5, 0.30, 8.0, [0.254, 0.184], [1.0, 0.998], [1.0, 0.46], 0.950),
    (3.3, 0.35, 5.0, [0.290, 0.198], [1.0, 0.891], [0.995, 0.25], 0.898),
    (2.2, 0.35, 3.5, [0.287, 0.191], [1.0, 0.835], [0.965, 0.19], 0.817),
    (1.4, 0.30, 2.5, [0.235, 0.139], [1.0, 0.596], [0.779, 0.02], 0.692),
]


def published(pitch: float, fill: float, height: float, microlens: bool = False) -> Stack:
    return Stack(pitch, pitch * math.sqrt(fill), height, 1.5, microlens, refraction="paraxial")


ON_AXIS = disc_pupil([numerical_aperture(4.0), numerical_aperture(1.4)])
EFFICIENCIES = [
    Claim(
        f"{name} of {pitch} µm",
        lambda sizes=(pitch, fill, height), lens=lens, light=light: collected_shares(
            published(*sizes, lens), *light
        )[..., 2, 2],
        wanted,
        atol=atol,
        why="its digits",
    )
    for pitch, fill, height, bare, microlens, oblique, wave in PUBLISHED
    for name, lens, light, wanted, atol in (
        ("bare", False, (ON_AXIS,), bare, 0.0011),
        ("microlens", True, (ON_AXIS,), microlens, 0.0011),
        (
            "oblique light",
            True,
            (disc_pupil(numerical_aperture(4.0), [10.0, 20.0]),),
            oblique,
            0.0051,
        ),
        ("a wave", True, (WAVE, [550.0]), [wave], 0.0006),
    )
]


def test_paraxial_diffraction_is_near_rayleigh_and_sommerfeld() -> None:
    """It is too low by .004 at a Fresnel number of 3.6, by .030 at .94."""
    errors = []
    for row in table("rayleigh_sommerfeld.csv"):
        stack = Stack(
            *(float(row[key]) for key in ("pitch_um", "photodiode_um", "height_um", "index"))
        )
        fresnel = float(row["fresnel_number"])
        check("Fresnel number", stack.fresnel_number(550.0), fresnel, atol=6e-5, why="digits")
        share = collected_shares(stack, WAVE, 550.0)[0, 2, 2]
        check("share", share, float(row["paraxial_photodiode"]), atol=1e-6, why="digits")
        errors.append(float(row["rs_photodiode"]) - share)
    check("errors", errors, [0.004, 0.011, 0.030, 0.020], atol=0.0006, why="three digits")


# Closed forms


def disc_on_square(side: float) -> float:
    """Return the share of a disc of radius 0.4 on a square: it covers it, or lacks segments."""
    cut = min(side / 0.8, 1.0)
    segment = math.acos(cut) - cut * math.sqrt(1 - cut**2)
    return 1 - 4 * segment / math.pi if cut > math.sqrt(0.5) else side**2 / (math.pi * 0.4**2)


def one_ray(**options: object) -> np.ndarray:
    """Return the middle row of shares of an infinitely slow lens at 20°."""
    return optics.stack_collection(3.0, 2.5, 4.0, 1.5, chief_ray_deg=20, **options)[1]


SINE = math.sin(math.radians(20))
LANDING = {"exact": 4 * SINE / math.sqrt(1.5**2 - SINE**2), "paraxial": 4 * SINE / 1.5}
SPOT = 0.6 * 4.0 / (1.5 * 2.0)
LINE = np.array(
    [
        quad(lambda v: np.sinc(v) ** 2, (k - 0.6) / SPOT, (k + 0.6) / SPOT, epsabs=1e-13)[0]
        for k in (-4.0, -2.0, 0.0, 2.0, 4.0)
    ]
)
WIDE = disc_pupil(numerical_aperture(1.4), [0.0, 15.0])
NYQUIST = 1e3 / (2 * 6.5)
PUPILS = thin_lens_pupil(1.4, [0.0, 0.3])
SHIFTED = Stack(2.2, 1.3, 3.5, 1.5, shift_um="optimal")
PLACES = np.linspace([0, 0], [35, 300], 6).T.reshape(2, 2, 3)
OPENING = Stack(6.5, 3.5, 8.0, 1.5, False)
RAY = Directions(np.array([[0.2, 0.0]]), np.ones(1), AXIS)
TWO = Directions(np.array([[0.2, 0.0], [-0.2, 0.0]]), np.ones(2), AXIS)
X_UM = float(OPENING.landing_um(RAY)[0, 0])
FREQUENCY = np.array([50.0, 200.0])
BOX = np.sinc(1e-3 * FREQUENCY * (3.5 - X_UM))


def slopes_at_turns() -> np.ndarray:
    """Return the slopes of x of an oblique disc's boundary at the angles where it turns."""
    pupil, axis = disc_pupil(0.3, [20.0], 33.0), np.zeros(1, int)
    nodes = np.linspace(0, 2 * np.pi, stacks.STEPS + 1)
    _, slope = stacks._coordinate(OPENING, pupil, axis, nodes[None])
    angle = stacks._turns(OPENING, pupil, axis, nodes, slope)
    return stacks._coordinate(OPENING, pupil, axis, angle)[1][slope[:, :-1] * slope[:, 1:] < 0]


STACKS_IN_CLOSED_FORM = [
    *(
        Claim(
            f"a disc on a square of {side:g}",
            lambda side=side: collected_shares(
                Stack(1.0, side, 1.0, 1.5, refraction="paraxial"), disc_pupil(0.6)
            )[2, 2],
            disc_on_square(side),
            rtol=1e-13,
        )
        for side in (0.01, 0.3, 0.56, 0.57, 0.7, 0.79, 0.8, 1.0)
    ),
    *(
        Claim(
            f"one bare ray, {refraction}, f/{n:g}",
            lambda refraction=refraction, n=n: one_ray(
                microlens=False, refraction=refraction, f_number=n
            ),
            np.array([0.0, 2.5 - x, max(0.0, 2.5 - abs(x - 3.0))]) * 2.5 / 9,
            atol=1.5e-6,
            why="at f/1e5 the mean of |y| is 6e-6",
        )
        for refraction, x in LANDING.items()
        for n in (1e5, math.inf)
    ),
    Claim("one ray under a lens", lambda: one_ray(f_number=1e30), [0, 1, 0], atol=1e-15),
    *(
        Claim(
            f"a bare pixel without height collects its fill factor, {refraction}",
            lambda refraction=refraction: optics.stack_collection(
                3.0, 1.7, 1e-6, 1.5, f_number=1.4, chief_ray_deg=30.0, azimuth_deg=20.0,
                microlens=False, refraction=refraction,
            ).sum(),
            (1.7 / 3.0) ** 2,
            rtol=1.2e-6,
            why="the overlap is displaced by h/√(n² - 1)",
        )
        for refraction in LANDING
    ),
    Claim("a ray on a corner", lambda: collected_shares(Stack(3.0, 3.0, 4.0, 1.5, shift_um=(1.5, -1.5)), WAVE), np.pad(np.full((2, 2), 0.25), ((2, 1), (1, 2)))),
    Claim("a ray on an edge", lambda: collected_shares(Stack(3.0, 2.0, 4.0, 1.5, shift_um=(1.0, 0.0)), WAVE)[2, 2], 0.5),
    Claim(
        "the lowest microlens reaches the bound of étendue",
        lambda: collected_shares(Stack(2.0, 0.4, 2.0 / math.sqrt(math.pi), 1.0, refraction="paraxial"), disc_pupil(0.9))[2, 2],
        0.04 / 0.81,
        rtol=1e-13,
    ),
    *(
        Claim(
            f"optimal shift, {refraction}",
            lambda refraction=refraction: Stack(2.2, 1.3, 3.5, 1.5, shift_um="optimal", refraction=refraction).shifts_um(
                disc_pupil(1e-9, 25.0, 60.0).chief_cosines
            ),
            length * np.array([0.5, math.sqrt(0.75)]),
            rtol=1e-14,
        )
        for refraction, length in (("exact", 3.5 * math.tan(math.asin(math.sin(math.radians(25)) / 1.5))), ("paraxial", 3.5 * math.sin(math.radians(25)) / 1.5))
    ),
    Claim(
        "a shifted lens keeps a thin lens's light at 25° and f/1.4",
        lambda: collected_shares(Stack(2.2, 1.3, 3.5, 1.5, shift_um="optimal"), thin_lens_pupil(1.4, math.tan(math.radians(25))))[2, 2],
        0.88,
        atol=0.005,
        why="two digits",
    ),
    Claim(
        "and a disc's",
        lambda: collected_shares(Stack(2.2, 1.3, 3.5, 1.5, shift_um=(0.98611, 0.0)), disc_pupil(numerical_aperture(1.4), 25.0))[2, 2],
        0.708,
        atol=0.0006,
        why="three digits",
    ),
    Claim(
        "a plane wave is the integral of its spot",
        lambda: collected_shares(Stack(2.0, 1.2, 4.0, 1.5), WAVE, 600.0)[0],
        LINE[:, None] * LINE,
        atol=3e-8,
        why="interpolation",
    ),
    Claim("E(u) of a slit", lambda: 2 * stacks.spot_integral(np.array(0.6 / SPOT)) - 1, LINE[2], atol=1e-12),
    Claim(
        "aperture under a microlens is the pitch",
        lambda: aperture_mtf(
            Stack(6.5, 3.56, 8.0, 1.5),
            PUPILS,
            [0.0, NYQUIST, 2 * NYQUIST, NYQUIST],
            [0.0, 0.0, 0.0, NYQUIST],
        ),
        [[1, 2 / math.pi, 0, 4 / math.pi**2]] * 2,
        atol=1e-15,
    ),
    Claim(
        "of a flat bare pixel the photodiode, sinc(√.3/2)²",
        lambda: aperture_mtf(Stack(6.5, 6.5 * math.sqrt(0.3), 1e-6, 1.5, False), PUPILS, [0.0, NYQUIST], [0.0, NYQUIST]),
        [[1, 0.881116**2]] * 2,
        rtol=2e-6,
        why="six digits",
    ),
    Claim("of one ray a box of w - |x|", lambda: aperture_mtf(OPENING, RAY, FREQUENCY), abs(BOX), rtol=1e-12),
    Claim(
        "of two rays two boxes, centred at ∓x/2",
        lambda: aperture_mtf(OPENING, TWO, FREQUENCY),
        abs(BOX * np.cos(math.pi * 1e-3 * FREQUENCY * X_UM)),
        rtol=1e-12,
    ),
    Claim(
        "side of their spread, 12 (w²/12 + x²/4)",
        lambda: aperture_side_um(OPENING, TWO),
        [math.hypot(3.5 - X_UM, math.sqrt(3) * X_UM), 3.5],
        rtol=1e-14,
    ),
    Claim(
        "aperture and side at one point",
        lambda: [
            *aperture_mtf(Stack(6.5, 3.56, 8.0, 1.5), WAVE, [0.0, NYQUIST]),
            *aperture_side_um(Stack(6.5, 3.5, 8.0, 1.5), WAVE),
        ],
        [1, 2 / math.pi, 6.5, 6.5],
        atol=1e-15,
    ),
    Claim("side under a microlens", lambda: aperture_side_um(Stack(6.5, 3.5, 8.0, 1.5), PUPILS), np.full((2, 2), 6.5)),
    Claim("Fresnel number n p²/(4 λ h)", lambda: Stack(1.4, 0.8, 2.5, 1.5).fresnel_number(700.0), 1.5 * 1.4**2 / (4 * 0.7 * 2.5), rtol=1e-12),
    *(
        Claim(
            f"a box of the spread of {pitch} µm has the MTF of the aperture",
            lambda sizes=(pitch, fill, height): (
                aperture_mtf(published(*sizes), WIDE, [500 / sizes[0], 0.0], [0.0, 500 / sizes[0]])
                - np.sinc(0.5 / sizes[0] * aperture_side_um(published(*sizes), WIDE))
            ),
            np.zeros((2, 2)),
            atol=0.002,
            why="stated",
        )
        for pitch, fill, height, *_ in PUBLISHED
    ),
    Claim(
        "light that diffraction takes halves with the wavelength",
        lambda: (1 - collected_shares(Stack(3.3, 1.95, 5.0, 1.5), ON_AXIS, [40.0, 20.0, 10.0])[0, :, 2, 2]) * [1, 2, 4]
        / (1 - collected_shares(Stack(3.3, 1.95, 5.0, 1.5), ON_AXIS, [40.0])[0, 0, 2, 2]),
        np.ones(3),
        rtol=0.05,
        why="the next term",
    ),
    *(
        Claim(
            f"shares turn with the light, from x to y, with y down, microlens {lens}",
            lambda lens=lens: collected_shares(
                Stack(2.2, 1.3, 3.5, 1.5, lens, "optimal"), disc_pupil(0.3, 20.0, [120.0, 210.0, 150.0])
            ),
            [np.rot90(shares, -1), shares[::-1, ::-1], shares[:, ::-1]],
            atol=1e-14,
        )
        for lens in (True, False)
        for shares in [
            collected_shares(Stack(2.2, 1.3, 3.5, 1.5, lens, "optimal"), disc_pupil(0.3, 20.0, 30.0))
        ]
    ),
    *(
        Claim(
            f"a point of the sensor is independent of others, {nm} nm",
            lambda at=at, nm=nm: collected_shares(SHIFTED, disc_pupil(0.3, *PLACES), nm)[at],
            collected_shares(SHIFTED, disc_pupil(0.3, PLACES[0][at], PLACES[1][at]), nm),
            atol=2e-8,
            why="another table of the spot",
        )
        for at in ((0, 0), (1, 2))
        for nm in (None, [450.0, 650.0])
    ),
    Claim(
        "the boundary of a pupil turns where its slope is 0, and nowhere else",
        slopes_at_turns,
        [0.0, 0.0],
        atol=1e-5,
        why="two steps of the false position",
    ),
    *(
        Claim(
            f"shares of a round pupil on the axis, wherever its boundary begins, of {stack}",
            lambda stack=stack: collected_shares(
                stack, disc_pupil(0.45, np.zeros(300), np.arange(0, 360, 1.2))
            ),
            np.tile(collected_shares(stack, disc_pupil(0.45)), (300, 1, 1)),
            atol=1e-14,
        )
        for stack in (
            Stack(2.2, 1.3, 3.5, 1.5),
            Stack(2.2, 1.3, 3.5, 1.5, microlens=False),
            Stack(2.2, 2.1 * (1 - 1e-4), 3.5, 1.5, refraction="paraxial"),  # it touches the edges
        )
    ),
    Claim(
        "a bare pixel has the shares of each wavelength",
        lambda: collected_shares(OPENING, WIDE, BANDS_NM),
        np.stack([collected_shares(OPENING, WIDE)] * 3, axis=1),
    ),
    Claim("no points", lambda: collected_shares(OPENING, disc_pupil(np.empty(0))), np.empty((0, 5, 5))),
    Claim("fill factor", lambda: Stack(2.0, 0.5, 3.0, 1.5).fill_factor, 1 / 16),
    Claim(
        "diffracted light of many points",
        lambda: collected_shares(SHIFTED, disc_pupil(0.3, np.full(60, 20.0), 30.0), 450.0),
        np.stack([collected_shares(SHIFTED, disc_pupil(0.3, 20.0, 30.0), 450.0)] * 60),
        atol=2e-8,
        why="interpolation",
    ),
    *(
        Claim(
            f"light lands on a giant pixel {pixels} away",
            lambda pixels=pixels: collected_shares(
                Stack(1e5, 0.7e5, pixels * 0.6e5, 1.0),
                Directions(np.array([[1 / math.sqrt(1.36), 0.0]]), np.ones(1), AXIS),
                [550.0],
            )[0, 2, 2 + pixels],
            1.0,
            atol=2e-5,
            why="1 - 2/(π² u) along both axes, u = 2e4",
        )
        for pixels in (1, 2)
    ),
    Claim(
        "no light of a giant pixel is lost, 1 - 2/(π² u)",
        lambda: collected_shares(Stack(1e5, 0.7e5, 0.6e5, 1.5), disc_pupil(numerical_aperture(1.0)), [550.0])[0, 2, 2],
        1.0,
        atol=1e-5,
        why="u = 3e5",
    ),
]  # fmt: skip


@pytest.mark.parametrize(
    "claim",
    [*GLASSES, *THIN_LENS, *DEFOCUS, *DIFFRACTION, *RAYS, *EFFICIENCIES, *STACKS_IN_CLOSED_FORM],
    ids=str,
)
@pytest.mark.filterwarnings("error")
def test_closed_forms(claim: Claim) -> None:
    claim.check()


# Pictures blurred by a circular pupil


@pytest.mark.parametrize("pitch_um", [2.65, 0.25])
@pytest.mark.parametrize(
    ("row_order", "column_order"), [(0, 0), (0, 3), (5, 0), (40, 90), (127, 191)]
)
def test_cosine_is_scaled_by_the_otf(pitch_um: float, row_order: int, column_order: int) -> None:
    y = np.cos(np.pi * row_order * (np.arange(128) + 0.5) / 128)[:, None]
    picture = y * np.cos(np.pi * column_order * (np.arange(192) + 0.5) / 192)
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

    wanted = gaussian(np.array(frequency), 550.0) * picture
    for f_number, otf in ((None, 1.0), (8.0, optics.diffraction_otf(frequency, 550.0, 8.0))):
        blurred = optics.diffract_sum([(picture, ONE)], (1, 64), 1.0, GREEN_NM, f_number, gaussian)
        check(f"f/{f_number}", blurred, otf * wanted, atol=1e-7, why="a table of frequencies")


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


# Light in a stack: conservation and symmetry


@BOTH
@pytest.mark.parametrize(
    ("side", "height", "index"),
    [(3.56, 8.0, 1.5), (1.3, 3.5, 1.6), (1.9, 2.0, 1.0), (0.5, 5.0, 1.45)],
)
def test_light_is_lost_below_the_threshold_only(side, height, index, refraction) -> None:
    """Four segments of relative height d = 1e-9 (1 - NA²) are 16√2/3π d^1.5, 1e-14 to 1e-13."""
    stack = Stack(2.0 if side < 2 else 4.0, side, height, index, refraction=refraction)
    extra = 1 / (4 * index**2) if refraction == "exact" else 0.0
    threshold = math.sqrt((height / (index * side)) ** 2 + extra - 0.25)
    check("threshold", stack.lossless_f_number, threshold, rtol=1e-15, why="rounding")
    apertures = [numerical_aperture(threshold * factor) for factor in (1 + 1e-9, 1 - 1e-9)]
    lost = 1 - collected_shares(stack, disc_pupil(apertures))[:, 2, 2]
    assert abs(lost[0]) < 2e-15 < 5e-15 < lost[1] < 1e-12


def random_stack(rng: np.random.Generator, **fields: object) -> Stack:
    pitch_um = rng.uniform(0.5, 15)
    numbers = {
        "pitch_um": pitch_um,
        "photodiode_side_um": rng.uniform(0.1, 1) * pitch_um,
        "height_um": rng.uniform(0.57, 3) * pitch_um,
        "index": rng.uniform(1, 2),
        "shift_um": tuple((pitch_um / 2 * rng.uniform(-1, 1, 2)).tolist()),
        "refraction": str(rng.choice(["exact", "paraxial"])),
        "microlens": bool(rng.random() < 0.8),
    }
    return Stack(**numbers | fields)


def test_no_stack_collects_more_than_etendue_allows() -> None:
    """Discs of f/0.7 to f/8, up to the horizon."""
    rng = np.random.default_rng(22)
    nearest = 0.0
    for _ in range(60):
        stack = random_stack(rng)
        aperture = 1 / np.sqrt(1 + 4 * rng.uniform(0.7, 8.0, 60) ** 2)
        chief_deg = np.degrees(np.arcsin((1 - aperture) * rng.uniform(0, 0.99, 60)))
        pupil = disc_pupil(aperture, chief_deg, rng.uniform(0, 360, 60))
        shares = collected_shares(stack, pupil)
        bound = np.minimum(stack.fill_factor * stack.index**2 * np.pi / pupil.area, 1.0)
        nearest = max(nearest, float((shares[..., 2, 2] / bound).max()))
        assert shares.min() > -1e-15
        assert shares.sum(axis=(-2, -1)).max() < 1 + 1e-12
    assert 0.9 < nearest <= 1 + 1e-12, "the bound is reached, and not passed"


@pytest.mark.parametrize("microlens", [True, False])
def test_full_photodiodes_collect_everything(microlens: bool) -> None:
    """With w = p the cells fill the plane; light lands within 5 × 5 of them."""
    rng = np.random.default_rng(3)
    sizes = {"photodiode_side_um": 2.0, "pitch_um": 2.0, "height_um": 2.0, "shift_um": "optimal"}
    for _ in range(10):
        stack = random_stack(rng, **sizes, index=rng.uniform(1.2, 2), microlens=microlens)
        pupil = thin_lens_pupil(rng.uniform(0.9, 4), rng.uniform(0, 1, 10), rng.uniform(0, 360, 10))
        total = collected_shares(stack, pupil).sum(axis=(-2, -1))
        check("light", total, np.ones(10), atol=1e-12, why="conserved")


@BOTH
@pytest.mark.parametrize("microlens", [True, False])
def test_boundary_integral_is_the_mean_over_rays(microlens: bool, refraction: str) -> None:
    """200 × 600 rays resolve the edges of a photodiode to 1e-3, a bare pixel to 1e-5."""
    stack = Stack(2.2, 1.3, 3.5, 1.5, microlens, "optimal", refraction)
    disc = disc_pupil(0.45, 25.0, 40.0)
    ellipse = Pupil(disc.centre, 0.74 * disc.radial, 0.91 * disc.tangential)
    for pupil in (ellipse, thin_lens_pupil(0.8, 0.9, 10.0)):
        shares = collected_shares(stack, pupil)
        rays = collected_shares(stack, pupil.directions(200, 600))
        check("shares", shares, rays, atol=1e-3 if microlens else 1e-5, why="a finite grid")
        assert 0.1 < shares.sum() < 0.99


def test_rays_of_wide_pixels_are_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pixels with more turns of phase than are resolved; the photodiode's edge cuts the disc."""
    wide = Stack(100.0, 70.0, 150.0, 1.5)
    pupil = disc_pupil(numerical_aperture(1.0), 3.0, 30.0)
    limited = collected_shares(wide, pupil, [550.0])
    monkeypatch.setattr(stacks, "MAX_PHASE_RAD", math.inf)
    check("shares", limited, collected_shares(wide, pupil, [550.0]), atol=1e-6, why="stated")


def test_limits_of_the_model_are_named() -> None:
    assert model_limits(Stack(6.5, 3.5, 8.0, 1.5), disc_pupil(0.3), 700.0) == []
    assert not model_limits(Stack(1.4, 0.8, 2.5, 1.5, microlens=False), disc_pupil(0.1), 700.0)
    small = Stack(1.4, 0.8, 2.5, 1.5, shift_um="optimal")
    fresnel, shift = model_limits(small, disc_pupil(0.1, 28.0), [400.0, 700.0])
    assert "Fresnel number of 0.42 at 700 nm" in fresnel
    assert "1 at a pitch of 2.16 µm, or with a height of 1.05 µm" in fresnel
    assert "0.824 µm, more than half of the pitch" in shift
