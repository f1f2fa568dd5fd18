"""S-CIELAB, CIELAB and ΔE against independent code and published tables.

Sources (tests/data/scielab/README.md):
* the authors' first public code, SCIELAB-1996 (X. Zhang & B. A. Wandell), run unmodified under
  Octave: maps and kernels;
* unfiltered CIELAB maps, ΔE 1976 and 2000, by the same MATLAB code;
* colour-science: CIELAB with CIE's exact constants (CIE 15), ΔE 1976, 1994, 2000;
* Sharma, Wu & Dalal (2005), table 1: 34 pairs for CIEDE2000, chosen to detect wrong branches.

Gates:
* ±1e-9 for the same formula in float64 on both sides: rounding is 1e-13 in ΔE, the smallest mistake
  (a Lab constant rounded as
  in 1976) 1e-5. A wrong tap, edge, width or density has a larger effect.
* ±1e-14 for filter taps, which are at most 1.
* ±1e-4 for Sharma's pairs, printed with 4 decimals.
* 1 to 7 % (17 % below 60 samples/deg) between the published filters and the code of 1996: two
  parametrisations of one
  experiment, which must not be identical. The gate is wide because no outside map uses the
  published filters;
  tests/viewer/test_scielab.py checks their closed form to 1e-12.

Independence: pixsim computes ΔE 1994 and 2000 with colour-science, which therefore judges only
pixsim's arguments there; the MATLAB maps and Sharma's table judge the formulas.
"""

from __future__ import annotations

from functools import cache, partial
from pathlib import Path

import colour
import numpy as np
import pytest
from references.gates import not_met, row

from pixsim.viewer import scielab

DATA = Path(__file__).parents[1] / "data" / "scielab"
PAIRS = [
    "constant_offset",
    "csf_sweep_vs_blur",
    "dark_noise",
    "edge_vs_blurred_edge",
    "redgreen_grating_vs_mean",
]
COLOURED = ["blueyellow_grating_demosaic", "redgreen_grating_demosaic", "zoneplate_malvar_fringes"]
D65 = np.array([95.047, 100.0, 108.883])
WHITE_XY = D65[:2] / D65.sum()
KERNELS_SAMPLES_PER_DEG = [20, 23, 30, 60, 120, 240]
COLOUR_METHODS = {"1976": "CIE 1976", "1994": "CIE 1994", "2000": "CIE 2000"}
ROUNDED_BELOW = (
    0.009  # of white: below it the MATLAB code uses .008856, 7.787 and 903.3, CIE exact fractions
)
PLAIN_STEP = 4  # every fourth sample of each map


def load_pair(name: str) -> tuple[np.ndarray, np.ndarray, dict]:
    """(reference XYZ, test XYZ, everything in the file)."""
    with np.load(DATA / f"{name}.npz") as file:
        data = dict(file)
    if "reference_xyz" in data:
        return data["reference_xyz"].astype(float), data["test_xyz"].astype(float), data
    return (
        data["reference_over_white"] * data["white_xyz"],
        data["test_over_white"] * data["white_xyz"],
        data,
    )


def map_of(name: str, density: float = 1.0, **options) -> tuple[np.ndarray, dict]:
    """(pixsim's map of a pair, everything in the file); `density` other than 1 is a wrong viewing
    distance.
    """
    reference, test, data = load_pair(name)
    view = {
        "white_xyz": data["white_xyz"],
        "samples_per_deg": density * float(data["samples_per_deg"]),
    }
    return scielab.delta_e_map(reference, test, **view, **options), data


def from_1996(
    formula: str, names: list[str] = PAIRS, filters: str = "zhang1996", density: float = 1.0
) -> np.ndarray:
    """Differences of all samples from the maps of 1996."""
    differences = []
    for name in names:
        map_, data = map_of(name, density, filters=filters, formula=formula)
        step = len(map_) // len(data[f"delta_e_{formula}"])
        differences.append((map_[::step, ::step] - data[f"delta_e_{formula}"]).ravel())
    return np.concatenate(differences)


def from_1996_kernels(samples_per_deg: int, width: float = 1.0) -> np.ndarray:
    """Differences of the taps of all Gaussians and channels from those of 1996."""
    with np.load(DATA / "kernels.npz") as kernels:
        return np.concatenate([
            np.ravel([
                np.sign(weight) * abs(weight) ** 0.5 * scielab.zhang1996_kernel(width * width_deg, samples_per_deg)
                for weight, width_deg in gaussians
            ] - kernels[f"spd{samples_per_deg}_k{channel + 1}"])
            for channel, gaussians in enumerate(scielab.ZHANG1996_GAUSSIANS)
        ])  # fmt: skip


def published_over_1996(coarse: bool, filters: str = "published") -> np.ndarray:
    """Mean ΔE / that of 1996 - 1, for the pairs below 60 samples/deg or for the others."""
    ratios = [
        (map_.mean() / data["delta_e_1976"].mean() - 1, data)
        for map_, data in (map_of(n, filters=filters) for n in PAIRS)
    ]
    return np.array([ratio for ratio, data in ratios if (data["samples_per_deg"] < 60) == coarse])


def from_matlab_plain(formula: str, dark: bool = False, asked: str | None = None) -> np.ndarray:
    """Differences from unfiltered MATLAB maps, for samples above the rounded constants, or for the
    dark ones.
    """
    differences = []
    with np.load(DATA / "plain_cielab.npz") as plain:
        for name in PAIRS:
            reference, test, data = load_pair(name)
            subset = np.s_[::PLAIN_STEP, ::PLAIN_STEP]
            images = [image[subset] for image in np.broadcast_arrays(reference, test)]
            lab = [scielab.xyz_to_lab(image, data["white_xyz"]) for image in images]
            least = np.minimum(*(image / data["white_xyz"] for image in images)).min(axis=-1)
            chosen = (least < ROUNDED_BELOW) == dark
            differences.append(
                (scielab.delta_e(*lab, asked or formula) - plain[f"{name}_{formula}"])[chosen]
            )
    return np.concatenate(differences)


@cache
def many_xyz() -> np.ndarray:
    """Pairs (2, N, 3) of XYZ from black, through CIELAB's linear branch, to beyond white."""
    rng = np.random.default_rng(5)
    first = D65 * np.concatenate(
        [rng.uniform(0, 1.2, (2000, 3)), rng.uniform(0, 0.012, (500, 3)), np.zeros((1, 3))]
    )
    return np.stack([first, np.abs(first + D65 * rng.normal(0, 0.05, first.shape))])


def from_colour_lab(
    white_xyz: np.ndarray = D65, constants: tuple[float, float, float] | None = None
) -> np.ndarray:
    """Differences of L*, a*, b* from colour-science."""
    xyz = many_xyz().reshape(-1, 3)
    expected = colour.XYZ_to_Lab(xyz / 100, WHITE_XY)  # colour's white has Y = 1
    if constants is None:
        return scielab.xyz_to_lab(xyz, white_xyz) - expected
    return scielab._lab((xyz / white_xyz).T, *constants) - expected


def from_colour_delta_e(formula: str, asked: str | None = None) -> np.ndarray:
    """Differences of ΔE from colour-science, including its CIELAB."""
    lab = [colour.XYZ_to_Lab(xyz / 100, WHITE_XY) for xyz in many_xyz()]
    expected = colour.delta_E(*lab, method=COLOUR_METHODS[formula])
    return (
        scielab.delta_e(*(scielab.xyz_to_lab(xyz, D65) for xyz in many_xyz()), asked or formula)
        - expected
    )


def from_sharma(formula: str = "2000", hue_deg: float = 0.0) -> np.ndarray:
    """Differences from the 34 pairs; hue_deg rotates the second colour of each."""
    rows = np.loadtxt(DATA / "sharma.csv", delimiter=",", skiprows=1)
    assert rows.shape == (34, 7)
    cosine, sine = np.cos(np.radians(hue_deg)), np.sin(np.radians(hue_deg))
    turned = rows[:, 3:6] @ np.array([[1, 0, 0], [0, cosine, sine], [0, -sine, cosine]])
    computed = scielab.delta_e(rows[:, :3], turned, formula)
    error = computed - rows[:, 6]
    # Pair 14 has hues 180° apart, where the formula is discontinuous: the last bit of arctan2
    # selects its value or pair 15's.
    error[13] = min(computed[13] - rows[13:15, 6], key=abs)
    return error


def rows() -> list[dict[str, object]]:
    matlab, both, code = (
        "SCIELAB-1996 under Octave",
        "SCIELAB-1996 and ISETCam under Octave",
        "colour-science",
    )
    kernels = np.concatenate([from_1996_kernels(density) for density in KERNELS_SAMPLES_PER_DEG])
    coarse = published_over_1996(True)
    return [
        *(
            row(f"S-CIELAB map, ΔE {formula}, 5 pairs", matlab, -1e-9, 1e-9, from_1996(formula))
            for formula in ("1976", "1994")
        ),
        *(
            row(
                f"S-CIELAB map, ΔE {formula}, 3 coloured pairs",
                matlab,
                -1e-9,
                1e-9,
                from_1996(formula, COLOURED),
            )
            for formula in ("1976", "1994")
        ),
        row("S-CIELAB kernels, 20 to 240 samples/deg", matlab, -1e-14, 1e-14, kernels),
        row(
            "mean ΔE, published filters / 1996 - 1, 60 samples/deg",
            matlab,
            0.01,
            0.07,
            published_over_1996(False),
            "{:.3f}",
        ),
        row(
            "mean ΔE, published filters / 1996 - 1, 20 and 30 samples/deg",
            matlab,
            0.01,
            0.17,
            coarse,
            "{:.3f}",
        ),
        *(
            row(f"ΔE {formula}, no filter", both, -1e-9, 1e-9, from_matlab_plain(formula))
            for formula in ("1976", "2000")
        ),
        row("CIELAB, exact constants", f"{code}, CIE 15", -1e-9, 1e-9, from_colour_lab()),
        *(
            row(f"ΔE {formula}", code, -1e-9, 1e-9, from_colour_delta_e(formula))
            for formula in COLOUR_METHODS
        ),
        row("CIEDE2000, 34 pairs", "Sharma, Wu & Dalal 2005", -1e-4, 1e-4, from_sharma()),
    ]


def test_rows_pass():
    assert not_met(rows()) == []


@pytest.mark.parametrize("name", PAIRS + COLOURED)
@pytest.mark.parametrize(
    "wrong", [{"filters": "published"}, {"density": 1.01}, {"density": 1 / 1.01}]
)
def test_maps_other_filters_or_distance_fail(name, wrong):
    # A uniform map depends on the density only by the deviation of the kernels' sums from 1.
    assert np.abs(from_1996("1976", [name], **wrong)).max() > 1e-4


WRONG = {  # (differences with an error, their minimum)
    "constants rounded in 1976": (partial(from_colour_lab, constants=scielab.ZHANG1996_LAB), 1e-5),
    "a white of 0.01 % more light": (partial(from_colour_lab, white_xyz=D65 * 1.0001), 1e-4),
    "1994 for 1976": (partial(from_colour_delta_e, "1976", asked="1994"), 0.1),
    "2000 for 1994": (partial(from_colour_delta_e, "1994", asked="2000"), 0.1),
    "1994 for 2000": (partial(from_colour_delta_e, "2000", asked="1994"), 0.1),
    "1994 for Sharma's pairs": (partial(from_sharma, "1994"), 0.1),
    "Sharma's colours turned": (partial(from_sharma, hue_deg=0.01), 1e-4),
    "turned back": (partial(from_sharma, hue_deg=-0.01), 1e-4),
    "MATLAB's 1976 by 1994": (partial(from_matlab_plain, "1976", asked="1994"), 0.1),
    "MATLAB's 2000 by 1994": (partial(from_matlab_plain, "2000", asked="1994"), 0.1),
} | {f"kernels {by} times as wide, {spd}/deg": (partial(from_1996_kernels, spd, by), 1e-6)
     for spd in KERNELS_SAMPLES_PER_DEG for by in (1.001, 0.999)}  # fmt: skip


@pytest.mark.parametrize("cause", WRONG)
def test_wrong_formula_or_constant_fails(cause):
    differences, least = WRONG[cause]
    assert np.abs(differences()).max() > least


def test_dark_map_exact_lab_constants_fail(monkeypatch):
    monkeypatch.setattr(scielab, "ZHANG1996_LAB", scielab.CIE_LAB)
    assert np.abs(from_1996("1976", ["dark_noise"])).max() > 1e-6


def test_delta_e_1994_swapped_images_differ():
    reference, test, data = load_pair("redgreen_grating_vs_mean")
    swapped = scielab.delta_e_map(
        test, reference, white_xyz=D65, samples_per_deg=30, filters="zhang1996", formula="1994"
    )
    assert (
        np.abs(swapped - data["delta_e_1994"]).max() > 1
    )  # measured 2.5, so the maps above distinguish the two


@pytest.mark.parametrize("name", PAIRS[1:])  # the first map is uniform and has no correlation
def test_published_and_1996_filters_correlate(name):
    map_, data = map_of(name)
    coarse = data["samples_per_deg"] < 60  # where the 1996 kernels are undersampled
    assert np.corrcoef(map_.ravel(), data["delta_e_1976"].ravel())[0, 1] > (
        0.99 if coarse else 0.998
    )


@pytest.mark.parametrize("name", COLOURED)
def test_coloured_pairs_swapped_channels_or_images_fail(name):
    """Their colours count: as grey pictures, or with X and Z swapped, they have other maps. ΔE 1976
    is symmetric, 1994 is not.
    """
    reference, test, data = load_pair(name)
    view = {
        "white_xyz": data["white_xyz"],
        "samples_per_deg": float(data["samples_per_deg"]),
        "filters": "zhang1996",
    }
    right = scielab.delta_e_map(reference, test, **view)
    grey = [image[..., 1:2] / 100 * data["white_xyz"] for image in (reference, test)]
    swapped = [image[..., ::-1] for image in (reference, test)]
    for images in (grey, swapped):
        assert np.abs(scielab.delta_e_map(*images, **view) - right).max() > 0.1
    assert scielab.delta_e_map(test, reference, **view) == pytest.approx(right, abs=1e-12)
    backwards, forwards = (
        scielab.delta_e_map(*pair, **view, formula="1994")
        for pair in ((test, reference), (reference, test))
    )
    assert np.abs(backwards - forwards).max() > 0.01


@pytest.mark.parametrize("coarse", [False, True])
def test_1996_filters_against_themselves_fail(coarse):
    assert np.abs(published_over_1996(coarse, filters="zhang1996")).max() < 0.01


@pytest.mark.parametrize("formula", ["1976", "2000"])
def test_matlab_plain_dark_samples_differ(formula):
    assert from_matlab_plain(formula).size > 1000
    # In dark samples the rounded constants have an effect, but not more than they can explain.
    assert 1e-6 < np.abs(from_matlab_plain(formula, dark=True)).max() < 1e-4
