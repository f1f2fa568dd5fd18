"""Traced lenses against closed forms, conservation laws and the values that three other programs
agree on.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from helpers.claims import Claim, check

from pixsim import PixsimError, load_lens, optics
from pixsim.base.toml import packaged
from pixsim.optics.glass import AIR, constant_glass
from pixsim.optics.lens import (
    Lens,
    _last_traced_field,
    _monomial_slopes,
    _monomials,
    _root,
    lens_from_prescription,
)
from pixsim.optics.prescription import Prescription, Surface, Vignetting, _paraxial_focus

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
X, Y = (grid.ravel() for grid in np.meshgrid(*[np.linspace(-1, 1, 15)] * 2))
DISC = X[np.hypot(X, Y) <= 1], Y[np.hypot(X, Y) <= 1]


@cache
def lens_named(name: str) -> Lens:
    return load_lens(name if name in packaged("data/lenses") else str(DATA / f"{name}.toml"))


REFERENCES = np.load(DATA / "reference.npz")


def reference(name: str) -> dict:
    start = f"{name}."
    return {key.removeprefix(start): REFERENCES[key] for key in REFERENCES if key.startswith(start)}


def made_of(*surfaces: Surface, diameter: float = 20.0, field: float = 0.0, stop: int = 0) -> Lens:
    kinds = "entrance_pupil_diameter", diameter, "angle_deg", field
    return lens_from_prescription(
        Prescription("test", "", "", surfaces, stop, *kinds, (550.0,), 550.0)
    )


# Closed forms

OVAL = made_of(Surface(1 / 20, 60.0, GLASS, conic=-1 / 1.5**2))
BALL = made_of(Surface(1 / 50, 150.0, GLASS), diameter=30.0)
NEAR = replace(
    made_of(
        Surface(1 / 20.0, 10.0, GLASS, conic=-(1.5**2)),
        Surface(-1 / 20.0, 40.0, AIR, conic=-(1.5**2)),
    ),
    object_distance_mm=40.0,
)
SINGLET = lens_named("singlet")
INFRARED = SINGLET.refocused("axis", wavelength_nm=850.0)
CONVEX = SINGLET.prescription.surfaces[0]
GAUSS = lens_named("double_gauss")
FIRST = GAUSS.first_order(GAUSS.primary_nm)
NEAR_GAUSS = GAUSS.refocused("paraxial", 2000.0)
PHONE = lens_named("phone")
TRIPLET = lens_named("cooke_triplet")
SMALL = TRIPLET.stopped_down(10.0)
RATIO = SMALL.stop_semi_diameter_mm / TRIPLET.stop_semi_diameter_mm
TWICE = PHONE.scaled(2.0)
DOT = made_of(Surface(1.0, 1e-5, GLASS), Surface(-1.0, 1.0), diameter=0.01, field=20.0)
BEHIND = made_of(
    Surface(1 / 50, 4.0, GLASS), Surface(-1 / 50, 6.0), Surface(0.0, 40.0), diameter=6.0, field=5.0, stop=2
)  # fmt: skip


def aplanatic() -> Lens:
    """Return a hyperboloid that focuses exactly in the aplanatic point of a sphere."""
    focus = 36.0 / 0.5
    return made_of(
        Surface(0.0, 7.2, GLASS),
        Surface(-1 / 36.0, focus - 9.0 * 2.5, AIR, conic=-(1.5**2)),
        Surface(1 / 9.0, 9.0 * (1 + 1 / 1.5), GLASS),
        diameter=18.0,
    )


def crossing_mm(lens: Lens) -> float:
    """Return where a ray from the rim crosses the image, by the law of sines in the sphere."""
    normal = np.arcsin(lens.stop_semi_diameter_mm / 50.0)
    bent = np.arcsin(np.sin(normal) / 1.5)
    crossing = 50.0 * (1 + np.sin(bent) / np.sin(normal - bent))
    return (crossing - 150.0) * np.tan(normal - bent)


def coddington_mm(field_deg: float) -> list[float]:
    """Return both foci behind the plane of `BALL`: n cos²r/t = n/s = (n cos r - cos i)/R along a
    refracted ray through its vertex.
    """
    sine, cosine = np.sin(np.radians(field_deg)), np.cos(np.radians(field_deg))
    bent = np.sqrt(1 - (sine / 1.5) ** 2)
    along_mm = 1.5 * 50.0 / (1.5 * bent - cosine)
    return [along_mm * bent**3 - 150.0, along_mm * bent - 150.0]


def thickness_mm(lens: Lens) -> float:
    return lens.prescription.surfaces[-1].thickness_mm


def lensmaker_mm(nm: float) -> float:
    """Return the focus behind a plano-convex lens, R/(n - 1) - d/n."""
    n = float(CONVEX.glass.index(nm))
    return 1 / CONVEX.curvature_per_mm / (n - 1) - CONVEX.thickness_mm / n


FIELDS = np.array([0.0, 3.0, 29.0, -12.0])
CLAIMS = [
    Claim("an oval focuses at n R/(n - 1)", lambda: OVAL.first_order(550.0).focal_length_mm, 40.0, rtol=1e-14),
    Claim("an oval has no error", lambda: OVAL.opd_waves(0.0, 550.0, *DISC), 0 * DISC[0], atol=WAVES),
    Claim("an aplanatic sphere has none", lambda: aplanatic().opd_waves(0.0, 550.0, *DISC), 0 * DISC[0], atol=WAVES),
    Claim("nor two hyperboloids of a near point", lambda: NEAR.opd_waves(0.0, 550.0, *DISC), 0 * DISC[0], atol=WAVES),
    Claim("which magnify -1 times", lambda: NEAR.paraxial_height_mm, 40.0, rtol=1e-12),
    Claim("and focus there", lambda: thickness_mm(NEAR.refocused("paraxial", 40.0)), 40.0, rtol=1e-12),
    Claim("a ray through a sphere", lambda: BALL.wavefront(0.0, 550.0, [0.0], [1.0]).y_mm[0, 0], crossing_mm(BALL), rtol=1e-12),
    Claim(
        "Broyden's method for a linear map ends after four steps (Gay, 1979)",
        patch("pixsim.optics.lens._MAX_AIM_STEPS", 4)(
            lambda: BALL._aimed_points(
                np.zeros(1),
                np.array([550.0]),
                np.array([0.3]),
                np.array([-0.2]),
                pupil_x_mm=np.zeros((1, 1)),
                pupil_y_mm=np.zeros((1, 1)),
                inverse_jacobian=np.array([[[[9.0, 8.0], [-5.0, 12.0]]]]),
            )
        ),
        [[[4.5]], [[-3.0]]],
        atol=1e-13,
    ),
    Claim(
        "and the secant method after one",
        patch("pixsim.optics.lens._MAX_AIM_STEPS", 1)(
            lambda: BALL._aimed_heights_mm(np.zeros(1), np.array([550.0]), np.array([5.0]))
        ),
        [0.0],
        atol=1e-12,
    ),
    *(
        Claim(
            f"the rule of Illinois needs twelve steps to a root between bends that lie {where}",
            patch("pixsim.optics.lens._ROOT_STEPS", 12)(
                lambda function=function: _root(
                    function, *(part for x in np.array([[0.0], [2.0]]) for part in (x, function(x)))
                )
            ),
            [root],
            atol=1e-14,
        )
        for where, function, root in (
            ("above", lambda x: x**3 - 0.5, 0.5 ** (1 / 3)),
            ("below", lambda x: 0.5 - (2 - x) ** 3, 2 - 0.5 ** (1 / 3)),
        )
    ),
    Claim(
        "slopes of monomials, by a complex step",
        lambda: [part for slopes in _monomial_slopes(*np.array([[0.3], [-0.4]])) for part in np.hstack(slopes)],
        [
            np.hstack(_monomials(*(np.array([[0.3], [-0.4]]) + 1e-30j * np.array(step)))).imag[0] * 1e30
            for step in ([[1], [0]], [[0], [1]])
        ],
        rtol=1e-13,
    ),
    Claim(
        "a focus 0.2 mm within a lens: an image may lie 1 % of the focal length in front of its end",
        lambda: made_of(Surface(1 / 20, 60.3, GLASS), Surface(0.0, 5.0), diameter=2.0).first_order(550.0).back_focal_length_mm,
        -0.2,
        rtol=1e-12,
    ),
    Claim(
        "second moment of a thin lens's light, NA²/4",
        lambda: [
            rays.shares @ rays.cosines**2 for rays in [DOT.directions(0.0, 550.0, 30.0)]
        ],
        [[0.005**2 / 4] * 2],
        rtol=1e-4,
        why="f/100, 10 nm thick",
    ),
    Claim(
        "focus of a sphere in its glass, n R/(n - 1)",
        lambda: _paraxial_focus([Surface(1 / 20, 0.0, GLASS)], np.inf, 550.0),
        60.0,
        rtol=1e-14,
    ),
    Claim(
        "a step beyond the last field with chief rays one is lost, wherever the search ends",
        lambda: [
            step_deg <= 0.1
            and bool(
                np.isnan(
                    TRIPLET._trace_chief_rays(np.full(nm.size, last_deg + step_deg), nm)[0].path_mm
                ).any()
            )
            for nm in [np.array(TRIPLET.prescription.wavelengths_nm)]
            for last_deg, step_deg in [
                _last_traced_field(TRIPLET, limit_deg) for limit_deg in (33, 40, 55, 89)
            ]
        ].count(True),
        4,
    ),
    Claim(
        "of a sphere, the least wavefront is half way between the paraxial and the marginal focus",
        lambda: thickness_mm(replace(BALL, entrance_pupil_diameter_mm=3.0).refocused("axis")),
        100.0 + 25.0 * 0.02 / np.sin(np.arcsin(0.03) - np.arcsin(0.02)),
        atol=3e-7,
        why="fifth-order aberrations, 5e-5 of 15 µm",
    ),
    Claim(
        "the largest of twenty smaller fields that has a chief ray",
        lambda: TRIPLET._nearest_chief_height_mm(60.0, 550.0),
        TRIPLET._chief_pupil_heights_mm(np.array([30.0]), np.array([550.0]))[0],
        rtol=1e-9,
        why="aiming",
    ),
    Claim(
        "exit pupil of a stop 10 mm in front of a sphere of 20 mm and its image in glass",
        lambda: made_of(
            Surface(0.0, 10.0), Surface(1 / 20, 60.0, GLASS), diameter=2.0
        ).first_order(550.0).exit_pupil_from_image_mm,
        1.5 / (0.5 / 20 - 1 / 10) - 60.0,
        rtol=1e-14,
    ),
    Claim("a stop behind the lens: its middle", lambda: BEHIND.ray_points(5.0, 550.0, 0.0, 0.0)[0, 2], [0, 0, 10.0], atol=1e-9),
    Claim(
        "its chief ray in the image",
        lambda: BEHIND.ray_points(5.0, 550.0, 0.0, 0.0)[0, 3],
        [0.0, float(BEHIND.chief_ray(5.0, 550.0).height_mm), 50.0],
        atol=1e-9,
    ),
    *(
        Claim(f"focus at {nm:g} nm", lambda nm=nm: thickness_mm(SINGLET.refocused("paraxial", wavelength_nm=nm)), lensmaker_mm(nm), rtol=1e-9)
        for nm in (486.1327, 850.0, 940.0)
    ),
    Claim(
        "the least wavefront of infrared light is in its focus",
        lambda: np.argmin(
            [
                np.std(INFRARED._with_image_plane_moved(step).opd_waves(0.0, 850.0, *DISC))
                for step in (-0.02, 0.0, 0.02)
            ]
        ),
        1,
    ),
    *(
        Claim(
            f"rays near the chief ray at {distance} mm meet in the paraxial focus",
            lambda distance=distance: TRIPLET.refocused("paraxial", distance).foci_mm(0.0, 550.0),
            [0, 0],
            atol=1e-5,
            why="third-order aberrations at 1e-3 of the stop",
        )
        for distance in (np.inf, 1000.0)
    ),
    Claim(
        "Coddington's equations of a sphere",
        lambda: np.ravel(BALL.foci_mm([10.0, -25.0], 550.0), order="F"),
        coddington_mm(10.0) + coddington_mm(25.0),
        atol=1e-5,
        why="third-order aberrations at 1e-3 of the stop",
    ),
    Claim(
        "Newton: x x' = f²",
        lambda: NEAR_GAUSS.paraxial_height_mm / 2000.0,
        (thickness_mm(NEAR_GAUSS) - FIRST.back_focal_length_mm) / FIRST.focal_length_mm,
        rtol=1e-9,
    ),
    Claim(
        "a small image",
        lambda: NEAR_GAUSS.chief_ray(0.01, GAUSS.primary_nm).height_mm,
        NEAR_GAUSS.paraxial_height_mm * np.tan(np.radians(0.01)),
        rtol=1e-6,
        why="distortion",
    ),
    Claim(
        "working f-number of a near object, height per tangent over the pupil",
        lambda: NEAR_GAUSS.working_f_number,
        NEAR_GAUSS.paraxial_height_mm / GAUSS.entrance_pupil_diameter_mm,
        rtol=1e-12,
    ),
    Claim(
        "a far object is at infinity",
        lambda: replace(PHONE, object_distance_mm=1e9).opd_waves(25.0, 550.0, 0.5, 0.7),
        PHONE.opd_waves(25.0, 550.0, 0.5, 0.7),
        atol=1e-5,
        why="f²/u = 3e-8 mm of focus",
    ),
    Claim(
        "fields of heights",
        lambda: [lens_named("retrofocus").field_of_height(h, 550.0) for h in lens_named("retrofocus").chief_ray(FIELDS, 550.0).height_mm],
        FIELDS,
        atol=1e-9,
    ),
    Claim("distortion on the axis", lambda: GAUSS.distortion(0.0), 0.0),
    Claim(
        "distortion, h/(s tan θ) - 1",
        lambda: GAUSS.distortion(14.0),
        GAUSS.chief_ray(14.0, GAUSS.primary_nm).height_mm / (GAUSS.image_scale_mm * np.tan(np.radians(14.0))) - 1,
        rtol=1e-9,
    ),
    Claim(
        "uncoated surfaces of n = 1.5",
        lambda: BEHIND.fresnel_transmittance(550.0),
        (4 * 1.5 / 2.5**2) ** 2,
        rtol=1e-12,
    ),
    *(
        Claim(
            f"a ghost of a singlet of an object at {distance:g} mm",
            lambda distance=distance, coat=coat: replace(BEHIND, object_distance_mm=distance).ghosts(550.0, coat)[0].share,
            share,
            rtol=1e-12,
        )
        for distance in (np.inf, 1000.0)
        for coat, share in ((None, 0.2**4), (0.01, 1e-4))
    ),
    Claim(
        "conditions with a point each are those one by one",
        lambda: PHONE.opd_waves([0.0, 20.0, 10.0], [600.0, 550.0, 550.0], [0.1, 0.2, 0.3], [0.0, 0.4, 0.5]),
        [
            PHONE.opd_waves(0.0, 600.0, 0.1, 0.0),
            PHONE.opd_waves(20.0, 550.0, 0.2, 0.4),
            PHONE.opd_waves(10.0, 550.0, 0.3, 0.5),
        ],
        rtol=1e-9,
    ),
    Claim(
        "blur of the ghost of a far object",
        lambda: replace(BEHIND, object_distance_mm=1e9).ghosts(550.0)[0].blur_mm,
        replace(BEHIND, object_distance_mm=np.inf).ghosts(550.0)[0].blur_mm,
        rtol=1e-6,
        why="the limit",
    ),
    Claim(
        "and of a near one, of the ray from the axis through the edge of the pupil",
        lambda: replace(BEHIND, object_distance_mm=100.0).ghosts(550.0)[0].blur_mm,
        optics.ghosts.find_ghosts(
            BEHIND.prescription.surfaces,
            [1.0, 1.5, 1.0, 1.0],
            np.array([0.04, 0.04, 0.0]),
            3.0 * (1 - BEHIND.first_order(550.0).entrance_pupil_from_first_vertex_mm / 100.0),
            0.03,
        )[0].blur_mm,
        rtol=1e-12,
    ),
    Claim(
        "lengths of a prescription twice as large",
        lambda: [
            number
            for lens in [
                Prescription(
                    *("lengths", "", "", (Surface(0.1, 3.0, GLASS, 0.0, ((3, 1e-3), (4, 1e-5)), 2.0),)),
                    *(0, "stop_diameter", 5.0, "object_height", 4.0, (550.0,), 550.0, 7.0),
                    (Vignetting(4.0),),
                ).scaled(2.0)
            ]
            for surface in lens.surfaces
            for number in (
                *(surface.curvature_per_mm, surface.thickness_mm, surface.semi_diameter_mm),
                *(surface.asphere[0][1], surface.asphere[1][1], lens.aperture_value),
                *(lens.field_value, lens.object_distance_mm, lens.vignetting[0].field_value),
            )
        ],
        [0.05, 6.0, 4.0, 1e-3 / 4, 1e-5 / 8, 10.0, 8.0, 14.0, 8.0],
        rtol=1e-15,
    ),
    Claim("heights of a lens twice as large", lambda: TWICE.chief_ray(25.0, 550.0).height_mm, 2 * PHONE.chief_ray(25.0, 550.0).height_mm, rtol=1e-12),
    Claim("beyond the stop", lambda: np.isnan(PHONE.opd_waves(25.0, 550.0, 0.9, 0.9)), 1.0),
    Claim("its angles", lambda: TWICE.chief_ray(25.0, 550.0).angle_deg, PHONE.chief_ray(25.0, 550.0).angle_deg, rtol=1e-12),
    Claim("its wavefront", lambda: TWICE.opd_waves(25.0, 550.0, 0.3, 0.7), 2 * PHONE.opd_waves(25.0, 550.0, 0.3, 0.7), rtol=1e-8, why="aiming"),
    Claim("its f-number", lambda: TWICE.first_order(550.0).f_number, PHONE.first_order(550.0).f_number, rtol=1e-12),
    Claim("f-number of a lens stopped down", lambda: SMALL.first_order(550.0).f_number, 10.0, rtol=1e-12),
    Claim(
        "it uses the middle of the stop",
        lambda: SMALL.opd_waves(14.0, 550.0, 0.6, -0.5),
        TRIPLET.opd_waves(14.0, 550.0, 0.6 * RATIO, -0.5 * RATIO),
        atol=1e-7,
        why="aiming",
    ),
    Claim(
        "a paraboloid of A2 = 1/40 mm is a sphere of 20 mm near the axis",
        lambda: made_of(Surface(0.0, 60.0, GLASS, 0.0, ((2, 1 / 40),))).first_order(550.0).focal_length_mm,
        40.0,
        rtol=1e-14,
    ),
    Claim(
        "a concentric image surface of 100 mm is in focus at half of its sag, with the plane through the middle",
        lambda: np.subtract(
            *(
                thickness_mm(lens.refocused(focus, np.inf, 2.0))
                for lens in [
                    made_of(Surface(1 / 50, 50.0, GLASS), Surface(0.0, 100.0, GLASS), diameter=0.2, stop=1)
                ]
                for focus in ("field", "axis")
            )
        ),
        -25 * np.tan(np.radians(2.0)) ** 2,
        rtol=1.2e-3,
        why="tan²",
    ),
    Claim(
        "light comes from both sides of the field's plane alike",
        lambda: PHONE.outline(20.0, 550.0, 64).radius[:, ::-1],
        PHONE.outline(20.0, 550.0, 64).radius,
    ),
    *(
        Claim(
            f"the light of a disc of {radius:g} of the pupil's radius, {place:g} beside its middle",
            lambda place=place, radius=radius, stop_mm=stop_mm: replace(
                DOT, vignetting=((0.0, place * stop_mm, radius * stop_mm, radius * stop_mm),)
            ).projected_solid_angle_sr(0.0, 550.0),
            radius**2 * optics.irradiance_factor(100.0, 0.0),
            rtol=1e-4,
            why="f/100, 10 nm thick",
        )
        for stop_mm in [DOT.stop_semi_diameter_mm]
        for place in (0.33, -0.71)
        for radius in (0.03, 1e-4)
    ),
    Claim(
        "a thin lens has the fall-off of Foote",
        lambda: DOT.projected_solid_angle_sr(np.linspace(0, 20, 5), 550.0),
        optics.irradiance_factor(100.0, np.tan(np.radians(np.linspace(0, 20, 5)))),
        rtol=1e-4,
        why="f/100, 10 nm thick",
    ),
]  # fmt: skip


@pytest.mark.parametrize("claim", CLAIMS, ids=str)
def test_closed_forms(claim: Claim) -> None:
    claim.check()


def test_aplanatic_sphere_meets_the_sine_condition() -> None:
    """Far outside the paraxial region: sin u' = n sin u. Rounding is 1.7e-14 with AVX-512."""
    lens = aplanatic()
    share = np.linspace(0.1, 1, 10)
    waves = lens.wavefront(0.0, 550.0, share, np.zeros(10))
    height = share * lens.stop_semi_diameter_mm  # the stop is the plane in front
    sag = height**2 / 36.0 / (1 + np.sqrt(1 + (1.5**2 - 1) * (height / 36.0) ** 2))
    converging = height / np.hypot(height, 72.0 + sag)
    check("cosines", -waves.cosines[0, :, 0], 1.5 * converging, atol=1e-13, why="rounding")


def test_telecentric_lens_has_its_stop_in_the_focal_plane() -> None:
    """Chief rays are parallel to the axis there, and the exit pupil is far away: in front of the
    image or behind it. A stop 1e-6 mm away moves the wavefront by 2e-8 of its slope.
    """
    gap_mm = 100.0 - 4.0 / 1.5  # the principal plane lies d/n inside the plane side
    glass = Surface(0.0, 4.0, GLASS), Surface(-1 / 50.0, 100.0)
    lenses = [
        made_of(Surface(0.0, gap_mm + near), *glass, diameter=5.0, field=3.0)
        for near in (-1e-6, 0.0, 1e-6)
    ]
    pupils_mm = [lens.first_order(550.0).exit_pupil_from_image_mm for lens in lenses]
    assert min(map(abs, pupils_mm)) > 1e8
    assert pupils_mm[0] * pupils_mm[2] < 0
    assert abs(float(lenses[1].chief_ray(1e-3, 550.0).angle_deg)) < 1e-8
    before, at, behind = (lens.opd_waves(3.0, 550.0, *DISC) for lens in lenses)
    assert np.abs(at).max() > 0.5
    for front in (before, behind):
        check("wavefront", front, at, atol=1e-5, why="1e-6 mm of the stop")


# Other programs


@pytest.mark.parametrize("name", LENSES)
def test_first_order_data_agree_with_other_programs(name: str) -> None:
    lens = lens_named(name)
    want = reference(name)
    first = [lens.first_order(1e3 * wavelength_um) for wavelength_um in want["wavelength_um"]]
    for field, key in {
        "focal_length_mm": "efl_w_mm",
        "back_focal_length_mm": "bfl_w_mm",
        "entrance_pupil_from_first_vertex_mm": "epl_w_mm",
        "exit_pupil_from_image_mm": "xpl_w_mm",
        "exit_pupil_diameter_mm": "xpd_w_mm",
    }.items():
        values = [getattr(numbers, field) for numbers in first]
        check(field, values, want[key], rtol=1e-10, atol=1e-10, why="their digits")
    check("pupil", lens.entrance_pupil_diameter_mm, float(want["epd_mm"]), rtol=1e-10, why="digits")


@pytest.mark.parametrize("name", LENSES)
def test_aimed_rays_agree_with_other_programs(name: str) -> None:
    """Chief rays at all wavelengths, and wavefronts over the real stop at the primary one."""
    lens = lens_named(name)
    want = reference(name)
    fields_deg = want["field_deg"]
    primary = 1e3 * float(want["primary_um"])
    chief = lens.chief_ray(fields_deg[:, None], 1e3 * want["wavelength_um"])
    waves = lens.wavefront(fields_deg, primary, *want["pupil"])
    opd = lens.opd_waves(fields_deg[:, None], primary, *want["pupil"])
    stop_mm = lens.stop_semi_diameter_mm
    for part, value, key, atol in (
        ("stop", stop_mm, "real_stop_semi_mm", 1e-11),
        ("heights", chief.height_mm, "aimed_chief_image_height_mm", 1e-9),
        ("angles", chief.angle_deg, "aimed_chief_angle_image_deg", 1e-8),
        ("wavefront", opd, "aimed_opd_waves", 1e-6),
        ("passed", waves.passed * 1.0, "aimed_pass_mask", 0.0),
    ):
        check(part, value, want[key], atol=atol, why="their digits")
    for index, (x, y) in enumerate(want["aimed_hex_stop_xy_mm"].transpose(0, 2, 1) / stop_mm):
        rays = lens.wavefront(fields_deg[index], primary, x, y)
        points = np.stack(
            [rays.x_mm[0], rays.y_mm[0] + rays.chief_y_mm, *rays.cosines[0].T], axis=1
        )
        wanted = want["aimed_hex_xyzLMN"][index][:, [0, 1, 3, 4]]
        check("points and cosines", points, wanted, atol=1e-9, why="their digits")


@pytest.mark.parametrize("name", LENSES)
def test_unaimed_rays_agree_with_other_programs(name: str) -> None:
    """Through the paraxial entrance pupil, at all fields and wavelengths."""
    lens = lens_named(name)
    want = reference(name)
    grid = np.meshgrid(want["field_deg"], 1e3 * want["wavelength_um"], indexing="ij")
    conditions = [part.ravel() for part in grid]
    radius = lens.entrance_pupil_diameter_mm / 2
    rays = lens.unaimed_wavefront(*conditions, *(radius * part for part in want["hex"]))
    waves = lens.unaimed_wavefront(*conditions, *(radius * part for part in want["pupil"]))
    points = want["hex_xyzLMN"].reshape(conditions[0].size, -1, 6)
    tangent = np.tan(np.radians(conditions[0]))
    focal_mm = want["efl_w_mm"][want["wavelength_um"] == want["primary_um"]]
    percent = want["distortion_percent_ftan"].ravel()
    shape = waves.opd_waves.shape
    for part, value, wanted, atol in (
        ("x", rays.x_mm, points[..., 0], 1e-9),
        ("y", rays.y_mm + rays.chief_y_mm[:, None], points[..., 1], 1e-9),
        ("cosines", rays.cosines, points[..., 3:5], 1e-10),
        ("wavefront", waves.opd_waves, want["opd_waves"].reshape(shape), 1e-6),
        ("passed", waves.passed * 1.0, want["pass_mask"].reshape(shape) * 1.0, 0.0),
        (
            "chief ray",
            waves.chief_y_mm,
            focal_mm * tangent * (1 + np.nan_to_num(percent) / 100),
            1e-8,
        ),
    ):
        check(part, value, wanted, atol=atol, why="their digits")


# Aiming


def test_shapes_broadcast_and_mirror_images_are_equal() -> None:
    fields = np.array([0.0, 14.0])
    points = [-0.5, 0.5, 0.0, 0.9], [0.3, 0.3, -1.0, 0.9]
    whole = TRIPLET.opd_waves(fields[:, None, None], [[480.0], [550.0], [650.0]], *points)
    assert whole.shape == (2, 3, 4)
    assert np.isnan(whole[..., 3]).all(), "outside the stop"
    assert np.array_equal(whole[..., 0], whole[..., 1])
    assert TRIPLET.opd_waves(14.0, 650.0, -0.5, 0.3) == whole[1, 2, 0]
    together = TRIPLET.opd_waves(fields, 550.0, [0.5, 0.5], [0.3, 0.3])
    assert together.tolist() == whole[:, 1, 1].tolist(), "an axis of both conditions and points"
    mirrored = TRIPLET.opd_waves(-14.0, 550.0, 0.5, -0.3)
    check("a field below the axis", mirrored, whole[1, 1, 1], atol=1e-7, why="aiming")


@pytest.mark.parametrize("name", ["phone", "double_gauss_us583336"])
def test_bits_do_not_depend_on_what_is_traced_together(name: str, monkeypatch) -> None:
    """Else a study would depend on the number of its processes."""
    monkeypatch.setattr("pixsim.optics.lens._BLOCK", 2 * DISC[0].size)  # of four conditions
    lens = replace(lens_named(name))
    fields = np.array([0.3, 1.0]) * lens.max_field_deg
    wavelengths = np.array([480.0, 600.0])
    whole = lens.opd_waves(fields[:, None, None], wavelengths[:, None], *DISC)
    area = lens.projected_solid_angle_sr(fields[:, None], wavelengths)
    for at in np.ndindex(2, 2):
        condition = fields[at[0]], wavelengths[at[1]]
        lone = replace(lens)
        assert np.array_equal(lone.opd_waves(*condition, *DISC), whole[at]), condition
        assert lone.projected_solid_angle_sr(*condition) == area[at], condition


@pytest.mark.parametrize(
    "name",
    ["cooke_triplet", "double_gauss_us583336", "retrofocus", "telephoto", "asphere_us8427765"],
)
def test_rays_meet_the_points_of_the_stop_that_they_are_aimed_at(name: str) -> None:
    """To 1e-9 of its radius, also in lenses whose entrance pupil is distorted."""
    lens = lens_named(name)
    waves = lens.wavefront(np.linspace(0, lens.max_field_deg, 4), 600.0, *DISC)
    assert np.isfinite(waves.opd_waves).all()
    for got, wanted in zip((waves.stop_x, waves.stop_y), DISC, strict=True):
        check("stop", got, np.broadcast_to(wanted, got.shape), atol=1e-9, why="the tolerance")


# Light


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
    lens = lens_named(name)
    fields = np.array([0.0, 0.5, 0.9]) * lens.max_field_deg + [0.01, 0, 0]
    half = 0.75 * lens.entrance_pupil_diameter_mm
    grid = (np.arange(100) + 0.5) / 100 * half
    x, y = np.meshgrid(grid, np.concatenate([-grid[::-1], grid]))
    waves = lens.unaimed_wavefront(fields, lens.primary_nm, x, y)
    through = waves.passed & np.isfinite(waves.x_mm) & (np.hypot(waves.stop_x, waves.stop_y) <= 1)
    area = 2 * through.sum(axis=1) * (half / 100) ** 2
    around = fields[:, None] + np.array([-1e-3, 0, 1e-3])
    below, heights, above = lens.chief_ray(around, lens.primary_nm).height_mm.T
    theta = np.radians(fields)
    want = area * np.cos(theta) * np.sin(theta) / (heights * ((above - below) / np.radians(2e-3)))
    got = lens.projected_solid_angle_sr(fields, lens.primary_nm)
    check("E/L", got, want, rtol=0.015, why="aberrations blur the ring")


def test_clear_apertures_take_light_and_the_image_circle_ends() -> None:
    """By other programs .644 at 24°, of a pupil that is not aimed at the stop."""
    lens = lens_named("double_gauss_us583336")
    surfaces = tuple(replace(surface, clips=False) for surface in lens.prescription.surfaces)
    bare = replace(lens, prescription=replace(lens.prescription, surfaces=surfaces))
    share = lens.projected_solid_angle_sr([0.0, 24.0], 587.56)
    share = share / bare.projected_solid_angle_sr([0.0, 24.0], 587.56)
    check("share", share, [1.0, 0.6], atol=[1e-9, 0.1], why="on the axis nothing is cut")
    edge_mm = lens.image_circle_mm(587.56)
    assert lens.chief_ray(24.0, 587.56).height_mm < edge_mm
    assert 0 < lens.relative_illumination(lens.field_of_height(edge_mm, 587.56)) < 0.1


def test_directions_fill_the_outline_and_follow_the_azimuth() -> None:
    azimuth = np.radians([0.0, 90.0, 217.0])
    rays = PHONE.directions(20.0, 550.0, np.degrees(azimuth))
    sine = np.sin(np.radians(PHONE.chief_ray(20.0, 550.0).angle_deg))
    outward = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    turned = np.stack([outward, np.stack([-np.sin(azimuth), np.cos(azimuth)], axis=-1)], axis=-1)
    check("chief rays", rays.chief_cosines, sine * outward, atol=1e-9, why="aiming")
    first = rays.cosines[0]
    check("turned", rays.cosines @ turned, np.array([first] * 3), atol=1e-9, why="aiming")
    check("mean", rays.shares[0] @ first, [sine, 0.0], atol=0.02 * sine, why="no symmetric pupil")


def test_light_behind_strong_aspheres_ends_at_the_first_edge() -> None:
    """Beyond it the phone lens's aspheres fold the directions back, and let some through."""
    fields = np.linspace(0, PHONE.max_field_deg, 9)
    outline = PHONE.outline(fields, PHONE.primary_nm, 512)
    steps = np.abs(np.diff(outline.radius, axis=1))
    assert steps.max() < 0.01 * outline.radius.min(), "an outline without spikes"
    area = PHONE.projected_solid_angle_sr(fields, PHONE.primary_nm)
    check("area", area, outline.area, rtol=1e-6, why="64 spokes for 512")


# Focus


@pytest.mark.parametrize("distance", [np.inf, 1000.0])
@pytest.mark.parametrize(("focus", "fields"), [("axis", [0.0]), ("field", [6.0, 11.0, 14.0])])
def test_refocused_lens_has_its_least_wavefront_in_its_plane(distance, focus, fields) -> None:
    """Any other plane nearby is worse, on the axis or over the field."""
    best = TRIPLET.refocused(focus, distance, 14.0)
    shift_mm = 0.02 if focus == "axis" else 0.1
    nm = np.array(TRIPLET.prescription.wavelengths_nm)[:, None]

    def mean_square(lens: Lens) -> float:
        waves = lens.opd_waves(np.array(fields)[:, None, None], nm, *DISC)
        slope = lens.wavefront(fields, 550.0, *DISC).cosines[..., 1]
        basis = np.stack([np.ones_like(slope), slope], axis=-1)
        if focus == "axis":
            basis = basis[..., :1]
        left = [
            fronts.T - columns @ np.linalg.lstsq(columns, fronts.T, rcond=None)[0]
            for columns, fronts in zip(basis, waves, strict=True)
        ]
        return float(np.mean(np.square(left)))

    planes = [best._with_image_plane_moved(step) for step in (-shift_mm, 0.0, shift_mm)]
    squares = [mean_square(plane) for plane in planes]
    assert np.argmin(squares) == 1, squares
    if focus == "axis":
        assert squares[1] < mean_square(TRIPLET.refocused("paraxial", distance))


# What is refused


def wide(lens: Lens, diameter_mm: float, stop_y: float) -> object:
    return replace(lens, entrance_pupil_diameter_mm=diameter_mm).opd_waves(0.0, 550.0, 0.0, stop_y)


RIM = Surface(1 / 5, 8.0, GLASS), Surface(0.0, 5.0)
REFUSED: list[tuple[str, Callable[[], object], str]] = [
    ("an unknown lens", lambda: load_lens("phon"), "cooke_triplet, .*'phone'"),
    ("no chief ray", lambda: PHONE.chief_ray(85.0, 550.0), r"misses surface \d+ \(550 nm\)"),
    ("height", lambda: PHONE.field_of_height(1e3, 550.0), "height_mm: .*image circle"),
    ("no angle", lambda: replace(PHONE, prescription=replace(PHONE.prescription, field_of_view="paraxial_image_height")).chief_ray(85.0, 550.0), r"reaches the image\.?$"),
    ("sideways", lambda: PHONE.chief_ray(90.0, 550.0), "field_deg: got 90"),
    ("nothing", lambda: PHONE.chief_ray([], 550.0), "field_deg: got an empty array"),
    ("no number", lambda: PHONE.chief_ray(np.nan, 550.0), "field_deg: got nan"),
    ("infrared", lambda: PHONE.opd_waves(0.0, 900.0, 0.0, 0.0), "wavelength_nm: got 900"),
    ("spokes", lambda: PHONE.outline(0.0, 550.0, 6), "spokes: got 6"),
    ("rings", lambda: PHONE.directions(0.0, 550.0, 0.0, rings=0), "rings: got 0"),
    ("a wider stop", lambda: PHONE.stopped_down(1.0), "f_number: got 1; .*'phone'"),
    ("no image", lambda: PHONE.refocused("axis", 1.0), "object_distance_mm: got 1"),
    ("a rim", lambda: wide(made_of(Surface(0.0, 1.0), *RIM, diameter=6.0), 10.6, 0.99), "misses surface 2"),
    ("reflection", lambda: wide(made_of(Surface(0.0, 2.0, GLASS), Surface(-1 / 10, 20.0), diameter=4.0), 15.0, 0.95), "totally reflected"),
    ("marginal ray", lambda: made_of(*RIM, diameter=10.6, stop=1), "marginal ray .* surface 1"),
    ("virtual", lambda: made_of(Surface(-0.02, 3.0, GLASS), Surface(0.0, 5.0)), "positive focal"),
    ("virtual by 1.5 %", lambda: made_of(Surface(1 / 20, 60.9, GLASS), Surface(0.0, 5.0), diameter=2.0), "back focal length of -0.6"),
    ("configuration", lambda: load_lens(DATA / "telephoto.toml", configuration=2), "like every .toml file"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "call", "words"), REFUSED)
def test_rays_that_do_not_exist_are_refused(name: str, call: Callable[[], object], words) -> None:
    with pytest.raises(PixsimError, match=words):
        call()
