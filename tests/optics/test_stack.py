"""The stack of a pixel against outside numbers (tests/data/microlens/README.md), closed forms,
étendue and conservation.
"""

from __future__ import annotations

import csv
import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers.claims import Claim, check
from scipy.integrate import quad

from pixsim import optics
from pixsim.optics import stack as stacks
from pixsim.optics.pupil import Directions, Pupil, disc_pupil, numerical_aperture
from pixsim.optics.stack import (
    Stack,
    aperture_mtf,
    aperture_side_um,
    collected_shares,
    model_limits,
)
from pixsim.optics.thin_lens import thin_lens_pupil

DATA = Path(__file__).parents[1] / "data" / "microlens"
BANDS_NM = [450.0, 550.0, 650.0]
AXIS = np.zeros(2)
WAVE = Directions(AXIS[None], np.ones(1), AXIS)
BOTH = pytest.mark.parametrize("refraction", ["exact", "paraxial"])


# Outside numbers


@cache
def table(name: str) -> list[dict[str, str]]:
    with (DATA / name).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


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
TILTED = disc_pupil(numerical_aperture(4.0), [10.0, 20.0])
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
        ("oblique light", True, (TILTED,), oblique, 0.0051),
        ("a wave", True, (WAVE, [550.0]), [wave], 0.0006),
    )
]


def test_paraxial_diffraction_is_near_rayleigh_and_sommerfeld() -> None:
    """It is too low by .004 at a Fresnel number of 3.6, by .030 at .94."""
    errors = []
    for row in table("rayleigh_sommerfeld.csv"):
        sizes = (float(row[key]) for key in ("pitch_um", "photodiode_um", "height_um", "index"))
        stack = Stack(*sizes)
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
ENDS = [((2.0 * k - 0.6) / SPOT, (2.0 * k + 0.6) / SPOT) for k in range(-2, 3)]
LINE = np.array([quad(lambda v: np.sinc(v) ** 2, *ends, epsabs=1e-13)[0] for ends in ENDS])
CORNER = np.pad(np.full((2, 2), 0.25), ((2, 1), (1, 2)))
FLAT = Stack(6.5, 6.5 * math.sqrt(0.3), 1e-6, 1.5, False)
WIDE = disc_pupil(numerical_aperture(1.4), [0.0, 15.0])
NYQUIST = 1e3 / (2 * 6.5)
PUPILS = thin_lens_pupil(1.4, [0.0, 0.3])
OPENING = Stack(6.5, 3.5, 8.0, 1.5, False)
RAY = Directions(np.array([[0.2, 0.0]]), np.ones(1), AXIS)
TWO = Directions(np.array([[0.2, 0.0], [-0.2, 0.0]]), np.ones(2), AXIS)
X_UM = float(OPENING.landing_um(RAY)[0, 0])
FREQUENCY = np.array([50.0, 200.0])
BOX = np.sinc(1e-3 * FREQUENCY * (3.5 - X_UM))
SLANTED = 3.5 * math.tan(math.asin(math.sin(math.radians(25)) / 1.5))
TURNED = np.array([math.cos(math.radians(60)), math.sin(math.radians(60))])
CLAIMS = [
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
    Claim("a ray on a corner", lambda: collected_shares(Stack(3.0, 3.0, 4.0, 1.5, shift_um=(1.5, -1.5)), WAVE), CORNER),
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
            length * TURNED,
            rtol=1e-14,
        )
        for refraction, length in (("exact", SLANTED), ("paraxial", 3.5 * math.sin(math.radians(25)) / 1.5))
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
        lambda: aperture_mtf(Stack(6.5, 3.56, 8.0, 1.5), PUPILS, [0.0, NYQUIST, 2 * NYQUIST]),
        [[1, 2 / math.pi, 0]] * 2,
        atol=1e-15,
    ),
    Claim(
        "of a flat bare pixel the photodiode, sinc(√.3/2)²",
        lambda: aperture_mtf(FLAT, PUPILS, [0.0, NYQUIST], [0.0, NYQUIST]),
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
    Claim("no points", lambda: collected_shares(OPENING, disc_pupil(np.empty(0))), np.empty((0, 5, 5))),
    Claim("fill factor", lambda: Stack(2.0, 0.5, 3.0, 1.5).fill_factor, 1 / 16),
    Claim(
        "no light of a giant pixel is lost, 1 - 2/(π² u)",
        lambda: collected_shares(Stack(1e5, 0.7e5, 0.6e5, 1.5), disc_pupil(numerical_aperture(1.0)), [550.0])[0, 2, 2],
        1.0,
        atol=1e-5,
        why="u = 3e5",
    ),
]  # fmt: skip


@pytest.mark.parametrize("claim", [*EFFICIENCIES, *CLAIMS], ids=str)
def test_closed_forms(claim: Claim) -> None:
    claim.check()


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


# Conservation and symmetry


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


@pytest.mark.parametrize("microlens", [True, False])
def test_shares_turn_with_the_light(microlens: bool) -> None:
    """From x to y, with y down."""
    stack = Stack(2.2, 1.3, 3.5, 1.5, microlens, "optimal")
    kernels = collected_shares(stack, disc_pupil(0.3, 20.0, [30.0, 120.0, 210.0, 150.0]))
    turned = [kernels[0], np.rot90(kernels[0], -1), kernels[0][::-1, ::-1], kernels[0][:, ::-1]]
    check("kernels", kernels, np.array(turned), atol=1e-14, why="rounding")


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


@pytest.mark.parametrize("place", [(0, 0), (1, 2)])
@pytest.mark.parametrize("nm", [None, [450.0, 650.0]], ids=["rays", "waves"])
def test_points_of_the_sensor_are_independent(place: tuple[int, int], nm) -> None:
    stack = Stack(2.2, 1.3, 3.5, 1.5, shift_um="optimal")
    deg, azimuth_deg = np.linspace([0, 0], [35, 300], 6).T.reshape(2, 2, 3)
    together = collected_shares(stack, disc_pupil(0.3, deg, azimuth_deg), nm)
    alone = collected_shares(stack, disc_pupil(0.3, deg[place], azimuth_deg[place]), nm)
    check("shares", together[place], alone, atol=2e-8, why="another table of the spot")


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
    assert "1 at a pitch of 2.16 µm" in fresnel
    assert "0.824 µm, more than half of the pitch" in shift
