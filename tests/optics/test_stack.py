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

from pixsim import optics
from pixsim.base.errors import PixsimError
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
BANDS = {"0.45um": 450.0, "0.55um": 550.0, "0.65um": 650.0}
AXIS = np.zeros(2)


def table(name: str) -> list[dict[str, str]]:
    with (DATA / name).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


TEXTS = ("stack", "microlens")
REFERENCE = {
    row["stack"]: {key: float(text) for key, text in row.items() if text and key not in TEXTS}
    for row in table("stacks.csv")
}
BARE = [row["stack"] for row in table("stacks.csv") if row["microlens"] == "off"]


@cache
def landing(name: str, target: str) -> dict[str, np.ndarray]:
    """The columns of landing.csv of a stack and target, (3, 3) as `stack_collection`."""
    rows = [row for row in table("landing.csv") if (row["stack"], row["target"]) == (name, target)]
    rows.sort(key=lambda row: (int(row["dy_pixels"]), int(row["dx_pixels"])))
    columns = [
        column for column, text in rows[0].items() if text and column not in ("stack", "target")
    ]
    return {
        column: np.array([float(row[column]) for row in rows]).reshape(3, 3) for column in columns
    }


def reference_stack(name: str, target: str, refraction: str) -> tuple[Stack, Pupil]:
    """The stack and pupil of stacks.csv; a target of side p is a photodiode of that side under a
    microlens.
    """
    row = REFERENCE[name]
    side = row["photodiode_um"] if target == "photodiode" else row["pitch_um"]
    shift = row["shift_x_um"], row["shift_y_um"]
    stack = Stack(
        row["pitch_um"], side, row["height_um"], row["index"], name not in BARE, shift, refraction
    )
    return stack, disc_pupil(
        numerical_aperture(row["f_number"]), row["cra_deg"], row["azimuth_deg"]
    )


TARGETS = [
    (name, target)
    for name in REFERENCE
    for target in ("photodiode", "cell")
    if target == "photodiode" or name not in BARE
]


@pytest.mark.parametrize(("name", "target"), TARGETS)
def test_shares_agree_with_outside_numbers(name, target):
    wanted = landing(name, target)
    stack, pupil = reference_stack(name, target, "paraxial")
    inner = collected_shares(stack, pupil)[1:-1, 1:-1]
    # 1e-9 is the table's last digit; the quadrature of a bare pixel has an error of 2e-8.
    assert np.abs(inner - wanted["quadrature"]).max() < (1e-7 if name in BARE else 1e-9)
    if target == "photodiode":
        assert 1 - inner.sum() == pytest.approx(
            REFERENCE[name]["lost_quadrature"], abs=2e-7 if name in BARE else 1e-8
        )
    exact = collected_shares(reference_stack(name, target, "exact")[0], pupil)[1:-1, 1:-1]
    assert np.all(np.abs(exact - wanted["mc_exact_refraction"]) <= 4 * wanted["mc_exact_se"] + 1e-6)
    assert (
        np.abs(inner - exact).max() > 1e-3 or target == "cell" or name == "A1_large_f1p4"
    )  # so the test tells them apart


@pytest.mark.parametrize(("name", "target"), [pair for pair in TARGETS if pair[0] not in BARE])
def test_diffracted_shares_agree_with_outside_numbers(name, target):
    stack, pupil = reference_stack(name, target, "paraxial")
    wave = Directions(pupil.chief_cosines[None], np.ones(1), pupil.chief_cosines)
    for light, kind in ((pupil, "diff_pupil"), (wave, "diff_single")):
        shares = collected_shares(stack, light, list(BANDS.values()))[:, 1:-1, 1:-1]
        wanted = [landing(name, target)[f"{kind}_{band}"] for band in BANDS]
        assert np.abs(shares - wanted).max() < 1e-8  # interpolation of the spot errs by 3e-9


def test_public_function_is_the_inner_part_of_the_kernel():
    for refraction in ("exact", "paraxial"):
        stack, pupil = reference_stack("A7_small_f2_cra20_az30_shift", "photodiode", refraction)
        shares = optics.stack_collection(
            2.2,
            1.3,
            3.5,
            1.5,
            f_number=2.0,
            chief_ray_deg=20,
            azimuth_deg=30,
            shift_um=(0.4, 0.15),
            refraction=refraction,
        )
        np.testing.assert_array_equal(shares, collected_shares(stack, pupil)[1:-1, 1:-1])
    default = optics.stack_collection(2.2, 1.3, 3.5, 1.5, f_number=2.0)
    np.testing.assert_array_equal(
        default, optics.stack_collection(2.2, 1.3, 3.5, 1.5, f_number=2.0, refraction="exact")
    )


@pytest.mark.parametrize("side", [0.01, 0.3, 0.56, 0.57, 0.7, 0.79, 0.8, 1.0])
def test_microlens_on_axis_is_disc_and_square(side):
    """On the square photodiode lies a disc of radius h NA/n = 0.4: it covers the square, or the
    sides cut off four segments.
    """
    radius, cut = 0.4, min(side / 0.8, 1.0)
    segment = math.acos(cut) - cut * math.sqrt(1 - cut**2)
    wanted = 1 - 4 * segment / math.pi if cut > math.sqrt(0.5) else side**2 / (math.pi * radius**2)
    shares = collected_shares(Stack(1.0, side, 1.0, 1.5, refraction="paraxial"), disc_pupil(0.6))
    assert shares[2, 2] == pytest.approx(wanted, rel=1e-13)
    assert np.count_nonzero(shares) == 1


@pytest.mark.parametrize("refraction", ["exact", "paraxial"])
@pytest.mark.parametrize(
    ("side", "height", "index"),
    [(3.56, 8.0, 1.5), (1.3, 3.5, 1.6), (1.9, 2.0, 1.0), (0.5, 5.0, 1.45)],
)
def test_light_is_lost_below_the_threshold_only(side, height, index, refraction):
    stack = Stack(2.0 if side < 2 else 4.0, side, height, index, refraction=refraction)
    extra = 1 / (4 * index**2) if refraction == "exact" else 0.0
    threshold = math.sqrt((height / (index * side)) ** 2 + extra - 0.25)
    assert stack.lossless_f_number == pytest.approx(threshold, rel=1e-15)
    lost = [
        1 - collected_shares(stack, disc_pupil(numerical_aperture(threshold * factor)))[2, 2]
        for factor in (1 + 1e-9, 1 - 1e-9)
    ]
    # The four segments of relative height d = 1e-9 (1 - NA²) are 16√2/3π d^1.5, 1e-14 to 1e-13; 1
    # is exact to rounding.
    assert abs(lost[0]) < 2e-15 < 5e-15 < lost[1] < 1e-12


@pytest.mark.parametrize("chief_ray_deg", [0.0, 30.0])
@pytest.mark.parametrize("refraction", ["exact", "paraxial"])
def test_bare_pixel_without_height_collects_fill_factor(refraction, chief_ray_deg):
    numbers = {
        "f_number": 1.4,
        "chief_ray_deg": chief_ray_deg,
        "azimuth_deg": 20.0,
        "microlens": False,
        "refraction": refraction,
    }
    for height_um in (1e-6, 1e-12):
        shares = optics.stack_collection(3.0, 1.7, height_um, 1.5, **numbers)
        # The overlap is displaced by at most h/√(n² - 1): a share of 2 h/w, 1e-6, is lost.
        assert shares[1, 1] == pytest.approx((1.7 / 3.0) ** 2, rel=1.2 * height_um)
        assert shares.sum() == pytest.approx(shares[1, 1], rel=1e-15)


@pytest.mark.parametrize("refraction", ["exact", "paraxial"])
@pytest.mark.parametrize("f_number", [1e5, 1e30, math.inf])
def test_narrow_pupil_is_one_ray(f_number, refraction):
    cosine = math.sin(math.radians(20))
    x = 4.0 * (cosine / math.sqrt(1.5**2 - cosine**2) if refraction == "exact" else cosine / 1.5)
    bare = optics.stack_collection(
        3.0,
        2.5,
        4.0,
        1.5,
        f_number=f_number,
        chief_ray_deg=20,
        microlens=False,
        refraction=refraction,
    )
    wanted = np.array([0.0, 2.5 - x, max(0.0, 2.5 - abs(x - 3.0))]) * 2.5 / 9
    np.testing.assert_allclose(bare[1], wanted, atol=1.5e-6)  # at f/1e5 the mean of |y| is 6e-6
    lens = optics.stack_collection(
        3.0, 2.5, 4.0, 1.5, f_number=f_number, chief_ray_deg=20, refraction=refraction
    )
    np.testing.assert_allclose(lens, np.eye(3)[1] * np.eye(3)[1][:, None], atol=1e-15)


def test_ray_on_an_edge_is_shared():
    """Photodiodes that touch get half each of a ray on their common edge, a quarter each at a
    corner.
    """
    ray = Directions(AXIS[None], np.ones(1), AXIS)
    corner = collected_shares(Stack(3.0, 3.0, 4.0, 1.5, shift_um=(1.5, -1.5)), ray)
    wanted = np.zeros((5, 5))
    wanted[2:4, 1:3] = 0.25
    np.testing.assert_array_equal(corner, wanted)
    assert collected_shares(Stack(3.0, 2.0, 4.0, 1.5, shift_um=(1.0, 0.0)), ray)[2, 2] == 0.5


def random_pupils(rng: np.random.Generator, count: int) -> Pupil:
    """Discs of f/0.7 to f/8, up to the horizon."""
    aperture = 1 / np.sqrt(1 + 4 * rng.uniform(0.7, 8.0, count) ** 2)
    chief_deg = np.degrees(np.arcsin((1 - aperture) * rng.uniform(0, 0.99, count)))
    return disc_pupil(aperture, chief_deg, rng.uniform(0, 360, count))


def random_stack(rng: np.random.Generator, **more: object) -> Stack:
    pitch, part, height, index = (
        rng.uniform(0.5, 15),
        rng.uniform(0.1, 1),
        rng.uniform(0.57, 3),
        rng.uniform(1, 2),
    )
    shift = tuple((pitch / 2 * rng.uniform(-1, 1, 2)).tolist())
    return Stack(
        **{
            "pitch_um": pitch,
            "photodiode_side_um": part * pitch,
            "height_um": height * pitch,
            "index": index,
        }
        | {"shift_um": shift}
        | more
    )


def test_no_stack_collects_more_than_etendue_allows():
    rng = np.random.default_rng(22)
    nearest = 0.0
    for _ in range(100):
        stack = random_stack(
            rng,
            refraction=str(rng.choice(["exact", "paraxial"])),
            microlens=bool(rng.random() < 0.8),
        )
        pupil = random_pupils(rng, 100)
        shares = collected_shares(stack, pupil)
        bound = np.minimum(stack.fill_factor * stack.index**2 * np.pi / pupil.area, 1.0)
        assert np.all(shares[..., 2, 2] <= bound * (1 + 1e-12))
        assert shares.min() > -1e-15
        assert shares.sum(axis=(-2, -1)).max() < 1 + 1e-12
        nearest = max(nearest, float((shares[..., 2, 2] / bound).max()))
    assert nearest > 0.9  # the bound is not far from what stacks do


def test_lowest_microlens_reaches_the_bound_of_etendue():
    """At h = p/√π a paraxial spot wider than the photodiode has its area, and the share is the
    bound itself.
    """
    pupil = disc_pupil(0.9)
    lowest = Stack(2.0, 0.4, 2.0 / math.sqrt(math.pi), 1.0, refraction="paraxial")
    assert collected_shares(lowest, pupil)[2, 2] == pytest.approx(0.04 / 0.81, rel=1e-13)
    with pytest.raises(
        PixsimError,
        match=r"height_um: got 1\.12; allowed: at least p/√π = 1\.12838 .* pitch_um = 2.*étendue",
    ):
        Stack(2.0, 0.4, 1.12, 1.0)
    assert Stack(2.0, 0.4, 1.12, 1.0, microlens=False).fill_factor == pytest.approx(
        0.04
    )  # bare: no limit


@pytest.mark.parametrize("refraction", ["exact", "paraxial"])
@pytest.mark.parametrize("microlens", [True, False])
def test_full_photodiodes_collect_everything(microlens, refraction):
    """With w = p the cells fill the plane; light lands within 5 × 5 of them, since t < 2 in the
    medium.
    """
    rng = np.random.default_rng(3)
    for _ in range(10):
        own = {
            "photodiode_side_um": 2.0,
            "pitch_um": 2.0,
            "height_um": 2.0,
            "index": rng.uniform(1.2, 2),
        }
        stack = random_stack(
            rng, **own, shift_um="optimal", microlens=microlens, refraction=refraction
        )
        shares = collected_shares(
            stack,
            thin_lens_pupil(rng.uniform(0.9, 4), rng.uniform(0, 1, 10), rng.uniform(0, 360, 10)),
        )
        assert np.abs(shares.sum(axis=(-2, -1)) - 1).max() < 1e-12


@pytest.mark.parametrize("microlens", [True, False])
def test_shares_turn_with_the_light(microlens):
    stack = Stack(2.2, 1.3, 3.5, 1.5, microlens, "optimal")
    kernels = collected_shares(stack, disc_pupil(0.3, 20.0, [30.0, 120.0, 210.0, 150.0]))
    np.testing.assert_allclose(
        kernels[1], np.rot90(kernels[0], -1), atol=1e-14
    )  # x to y, with y down
    np.testing.assert_allclose(kernels[2], kernels[0][::-1, ::-1], atol=1e-14)
    np.testing.assert_allclose(kernels[3], kernels[0][:, ::-1], atol=1e-14)


@pytest.mark.parametrize("refraction", ["exact", "paraxial"])
@pytest.mark.parametrize("microlens", [True, False])
def test_boundary_integral_is_the_mean_over_rays(microlens, refraction):
    """Ellipses and discs seen in perspective; 200 × 600 rays resolve the edges of a photodiode to
    1e-3, a bare pixel to 1e-5.
    """
    stack = Stack(2.2, 1.3, 3.5, 1.5, microlens, "optimal", refraction)
    disc = disc_pupil(0.45, 25.0, 40.0)
    for pupil in (
        Pupil(disc.centre, 0.74 * disc.radial, 0.91 * disc.tangential),
        thin_lens_pupil(0.8, 0.9, 10.0),
    ):
        shares = collected_shares(stack, pupil)
        assert np.abs(shares - collected_shares(stack, pupil.directions(200, 600))).max() < (
            1e-3 if microlens else 1e-5
        )
        assert 0.1 < shares.sum() < 0.99


def test_points_of_the_sensor_are_independent():
    stack = Stack(2.2, 1.3, 3.5, 1.5, shift_um="optimal")
    deg, turn = np.linspace(0, 35, 6).reshape(2, 3), np.linspace(0, 300, 6).reshape(2, 3)
    bands = np.array([450.0, 650.0])
    pupils = disc_pupil(0.3, deg, turn)
    together, diffracted = collected_shares(stack, pupils), collected_shares(stack, pupils, bands)
    assert together.shape == (2, 3, 5, 5)
    assert diffracted.shape == (2, 3, 2, 5, 5)
    for at in np.ndindex(2, 3):
        alone = disc_pupil(0.3, deg[at], turn[at])
        np.testing.assert_allclose(together[at], collected_shares(stack, alone), atol=1e-14)
        np.testing.assert_allclose(
            diffracted[at], collected_shares(stack, alone, bands), atol=2e-8
        )  # another table of the spot
    bare = Stack(2.2, 1.3, 3.5, 1.5, microlens=False)
    np.testing.assert_array_equal(
        collected_shares(bare, pupils, bands)[..., 1, :, :], collected_shares(bare, pupils)
    )
    assert collected_shares(stack, disc_pupil(np.empty(0))).shape == (0, 5, 5)


def test_optimal_shift_centres_the_chief_ray():
    """An optimum follows the refraction: it is h s/√(n² - s²), or h s/n. At 25° and f/1.4 a thin
    lens keeps .88, not .71.
    """
    pupil = disc_pupil(1e-9, 25.0, 60.0)
    for refraction, tangent in (
        ("exact", math.tan(math.asin(math.sin(math.radians(25)) / 1.5))),
        ("paraxial", math.sin(math.radians(25)) / 1.5),
    ):
        stack = Stack(2.2, 1.3, 3.5, 1.5, shift_um="optimal", refraction=refraction)
        wanted = 3.5 * tangent * np.array([math.cos(math.radians(60)), math.sin(math.radians(60))])
        np.testing.assert_allclose(stack.shifts_um(pupil.chief_cosines), wanted, rtol=1e-14)
        assert collected_shares(stack, pupil)[2, 2] == 1
    real = thin_lens_pupil(1.4, math.tan(math.radians(25)))
    assert collected_shares(Stack(2.2, 1.3, 3.5, 1.5, shift_um="optimal"), real)[
        2, 2
    ] == pytest.approx(0.88, abs=0.005)
    disc = disc_pupil(numerical_aperture(1.4), 25.0)
    assert collected_shares(Stack(2.2, 1.3, 3.5, 1.5, shift_um=(0.98611, 0.0)), disc)[
        2, 2
    ] == pytest.approx(0.708, abs=0.0006)


# pitch, fill factor, height; bare f/4, f/1.4; lens f/4, f/1.4; lens f/4 at 10°, 20°; diffraction.
# Paraxial, n = 1.5, 550 nm.
PUBLISHED = [
    (6.5, 0.30, 8.0, 0.254, 0.184, 1.0, 0.998, 1.0, 0.46, 0.950),
    (3.3, 0.35, 5.0, 0.290, 0.198, 1.0, 0.891, 0.995, 0.25, 0.898),
    (2.2, 0.35, 3.5, 0.287, 0.191, 1.0, 0.835, 0.965, 0.19, 0.817),
    (1.4, 0.30, 2.5, 0.235, 0.139, 1.0, 0.596, 0.779, 0.02, 0.692),
]


@pytest.mark.parametrize(
    ("pitch", "fill_factor", "height", "bare4", "bare1", "lens4", "lens1", "at10", "at20", "wave"),
    PUBLISHED,
)
def test_usual_pixels_have_the_known_efficiencies(
    pitch, fill_factor, height, bare4, bare1, lens4, lens1, at10, at20, wave
):
    side = pitch * math.sqrt(fill_factor)
    on_axis = disc_pupil([numerical_aperture(4.0), numerical_aperture(1.4)])
    bare = collected_shares(Stack(pitch, side, height, 1.5, False, refraction="paraxial"), on_axis)[
        :, 2, 2
    ]
    np.testing.assert_allclose(
        bare, [bare4, bare1], atol=0.0011
    )  # three digits, sides rounded as the table's
    lens = Stack(pitch, side, height, 1.5, refraction="paraxial")
    np.testing.assert_allclose(
        collected_shares(lens, on_axis)[:, 2, 2], [lens4, lens1], atol=0.0011
    )
    oblique = collected_shares(lens, disc_pupil(numerical_aperture(4.0), [10.0, 20.0]))[:, 2, 2]
    np.testing.assert_allclose(oblique, [at10, at20], atol=0.0051)
    centred = collected_shares(lens, Directions(AXIS[None], np.ones(1), AXIS), [550.0])[0, 2, 2]
    assert centred == pytest.approx(wave, abs=0.0006)


def test_diffracted_plane_wave_is_the_integral_of_its_spot():
    """E(u)² at the centre and the spot's tails elsewhere, against the integral of sinc² by
    quadrature; the rest is lost.
    """
    from scipy.integrate import quad

    stack = Stack(2.0, 1.2, 4.0, 1.5)
    spot = 0.6 * 4.0 / (1.5 * 2.0)
    shares = collected_shares(stack, Directions(AXIS[None], np.ones(1), AXIS), 600.0)[0]
    ends = [((2.0 * k - 0.6) / spot, (2.0 * k + 0.6) / spot) for k in range(-2, 3)]
    line = np.array([quad(lambda v: np.sinc(v) ** 2, *end, epsabs=1e-13)[0] for end in ends])
    np.testing.assert_allclose(shares, line[:, None] * line, atol=3e-8)
    assert 1 - shares.sum() == pytest.approx(1 - line.sum() ** 2, abs=1e-7)
    u = 0.6 / spot
    assert shares[2, 2] == pytest.approx((2 * stacks.spot_integral(np.array(u)) - 1) ** 2, abs=3e-8)


def test_diffraction_vanishes_with_the_wavelength():
    """From 50 nm down the share under a lens nears that without diffraction in proportion: tails of
    1/(π² u) on each side.
    """
    stack, pupil = Stack(3.3, 1.95, 5.0, 1.5), disc_pupil(numerical_aperture(4.0))
    missing = 1 - collected_shares(stack, pupil, [40.0, 20.0, 10.0])[:, 2, 2]
    assert collected_shares(stack, pupil)[2, 2] == 1
    np.testing.assert_allclose(missing[:-1] / missing[1:], 2.0, rtol=0.05)


def test_paraxial_diffraction_is_near_rayleigh_and_sommerfeld():
    """It is too low by .004 at a Fresnel number of 3.6, by .030 at .94."""
    numbers, errors = [], []
    for row in table("rayleigh_sommerfeld.csv"):
        pitch, side, height, index = (
            float(row[key]) for key in ("pitch_um", "photodiode_um", "height_um", "index")
        )
        stack = Stack(pitch, side, height, index)
        numbers.append(float(stack.fresnel_number(550.0)))
        assert numbers[-1] == pytest.approx(float(row["fresnel_number"]), abs=6e-5)
        share = collected_shares(stack, Directions(AXIS[None], np.ones(1), AXIS), 550.0)[0, 2, 2]
        assert share == pytest.approx(float(row["paraxial_photodiode"]), abs=1e-6)
        errors.append(float(row["rs_photodiode"]) - share)
    np.testing.assert_allclose(errors, [0.004, 0.011, 0.030, 0.020], atol=0.0006)


def test_microlens_makes_the_aperture_the_pitch():
    nyquist = 1e3 / (2 * 6.5)
    pupil = thin_lens_pupil(1.4, [0.0, 0.3])
    lens = aperture_mtf(Stack(6.5, 3.56, 8.0, 1.5), pupil, [0.0, nyquist, 2 * nyquist])
    np.testing.assert_allclose(lens, [[1, 2 / math.pi, 0]] * 2, atol=1e-15)
    flat = aperture_mtf(
        Stack(6.5, 6.5 * math.sqrt(0.3), 1e-6, 1.5, False), pupil, [0.0, nyquist], [0.0, nyquist]
    )
    np.testing.assert_allclose(
        flat, [[1, 0.881116**2]] * 2, rtol=2e-6
    )  # sinc(√.3/2) along x and along y


def test_bare_aperture_is_the_overlap_of_opening_and_photodiode():
    """One ray that lands at x: a box of width w - |x|. A pupil around it: the weighted sum, here by
    its second moment.
    """
    stack, frequency = Stack(6.5, 3.5, 8.0, 1.5, False), np.array([50.0, 200.0])
    x = float(stack.landing_um(Directions(np.array([[0.2, 0.0]]), np.ones(1), AXIS))[0, 0])
    one = aperture_mtf(stack, Directions(np.array([[0.2, 0.0]]), np.ones(1), AXIS), frequency)
    np.testing.assert_allclose(one, np.abs(np.sinc(1e-3 * frequency * (3.5 - x))), rtol=1e-12)
    two = Directions(
        np.array([[0.2, 0.0], [-0.2, 0.0]]), np.ones(2), AXIS
    )  # two boxes, centred at ∓x/2
    mixed = np.sinc(1e-3 * frequency * (3.5 - x)) * np.cos(math.pi * 1e-3 * frequency * x)
    np.testing.assert_allclose(aperture_mtf(stack, two, frequency), np.abs(mixed), rtol=1e-12)
    sides = aperture_side_um(stack, two)
    np.testing.assert_allclose(
        sides, [math.hypot(3.5 - x, math.sqrt(3) * x), 3.5], rtol=1e-14
    )  # 12 (w²/12 + x²/4)
    with pytest.raises(PixsimError, match="does not reach the photodiode"):
        aperture_mtf(stack, Directions(np.array([[0.8, 0.0]]), np.ones(1), AXIS), frequency)


@pytest.mark.parametrize(("pitch", "fill_factor", "height"), [row[:3] for row in PUBLISHED])
def test_box_of_the_same_spread_has_the_mtf_of_the_aperture(pitch, fill_factor, height):
    stack = Stack(pitch, pitch * math.sqrt(fill_factor), height, 1.5, False)
    pupils, nyquist = disc_pupil(numerical_aperture(1.4), [0.0, 15.0]), 500 / pitch
    mtf, sides = (
        aperture_mtf(stack, pupils, [nyquist, 0.0], [0.0, nyquist]),
        aperture_side_um(stack, pupils),
    )
    assert np.abs(np.sinc(1e-3 * nyquist * sides) - mtf).max() < 0.002
    assert np.all(sides < 0.95 * stack.photodiode_side_um)  # oblique light narrows the aperture
    np.testing.assert_array_equal(
        aperture_side_um(Stack(6.5, 3.5, 8.0, 1.5), pupils), np.full((2, 2), 6.5)
    )


def test_model_limits_name_number_and_remedy():
    usual = Stack(6.5, 3.5, 8.0, 1.5)
    assert model_limits(usual, disc_pupil(0.3), 700.0) == []
    small = Stack(1.4, 0.8, 2.5, 1.5, shift_um="optimal")
    fresnel, shift = model_limits(small, disc_pupil(0.1, 28.0), [400.0, 700.0])
    assert "Fresnel number of 0.42 at 700 nm" in fresnel  # 1.5 · 1.4²/(4 · 0.7 · 2.5)
    assert "1 at a pitch of 2.16 µm" in fresnel
    assert "shift reaches 0.824 µm, more than half of the pitch of 1.4 µm" in shift
    assert not model_limits(Stack(1.4, 0.8, 2.5, 1.5, microlens=False), disc_pupil(0.1), 700.0)


WRONG = [
    (
        {"photodiode_side_um": 2.3},
        r"photodiode_side_um: got 2\.3; allowed: at most the pitch, pitch_um = 2\.2",
    ),
    ({"height_um": 0.0}, "height_um: got 0.*above 0"),
    ({"height_um": -1.0, "microlens": False}, "height_um: got -1.*above 0"),
    ({"height_um": 1.2}, "height_um: got 1.2; allowed: at least p/√π = 1.24122"),
    ({"index": 0.99}, r"index: got 0\.99; .*from 1"),
    ({"index": math.nan}, "index: got nan"),
    (
        {"shift_um": (1.2, 0.0)},
        r"shift_um: got \(1\.2, 0\.0\); allowed: at most half of pitch_um = 2\.2",
    ),
    (
        {"f_number": 0.9, "chief_ray_deg": 32.0},
        r"pupil: got direction cosines up to 1\.016 .*f_number.*chief_ray_deg",
    ),
    ({"f_number": 0.0}, "f_number: got 0.*above 0"),
    ({"chief_ray_deg": 90.0}, "chief_ray_deg: got 90.*below 90"),
    ({"refraction": "snell"}, "refraction: got 'snell'"),
]


@pytest.mark.parametrize(("wrong", "message"), WRONG)
def test_invalid_stacks_raise_errors_that_name_number_and_limit(wrong, message):
    good = {
        "pitch_um": 2.2,
        "photodiode_side_um": 1.3,
        "height_um": 3.5,
        "index": 1.5,
        "f_number": 2.0,
    }
    optics.stack_collection(**good)
    with pytest.raises(PixsimError, match=message):
        optics.stack_collection(**good | wrong)


def test_rays_of_wide_pixels_are_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shares of pixels with more turns of phase than are resolved: right to 1e-6, and nothing is
    lost by pixels of 10 cm.
    """
    wide = Stack(100.0, 70.0, 150.0, 1.5)
    pupil = disc_pupil(
        numerical_aperture(1.0), 3.0, 30.0
    )  # its disc is cut by the photodiode's edge
    limited = collected_shares(wide, pupil, [550.0])
    monkeypatch.setattr(stacks, "MAX_PHASE_RAD", math.inf)
    np.testing.assert_allclose(limited, collected_shares(wide, pupil, [550.0]), atol=1e-6)
    monkeypatch.undo()
    giant = collected_shares(
        Stack(1e5, 0.7e5, 0.6e5, 1.5), disc_pupil(numerical_aperture(1.0), 0.0), [550.0]
    )
    assert giant[0, 2, 2] == pytest.approx(1, abs=1e-5)  # 1 less 2/(π²u), u = 3e5
    assert giant.sum() <= 1 + 1e-9
