"""S-CIELAB, CIELAB and ΔE against code and tables that are not ours.

Sources (tests/data/scielab/README.md):
* the authors' first public code, SCIELAB-1996 (X. Zhang & B. A. Wandell), run unmodified under Octave: maps and kernels;
* plain CIELAB maps, ΔE 1976 and 2000, made with them, in the same MATLAB code;
* colour-science: CIELAB with CIE's exact constants (CIE 15), ΔE 1976, 1994, 2000;
* Sharma, Wu & Dalal (2005), table 1: 34 pairs for CIEDE2000, made to find wrong branches.

Gates:
* ±1e-9 where both sides are float64 of the same formula: roundings are 1e-13 of ΔE, and the smallest mistake (a Lab constant
  rounded as in 1976) shows as 1e-5. A wrong tap, edge, width or density shows as more.
* ±1e-14 for taps, which are at most 1.
* ±1e-4 for Sharma's pairs, printed with 4 decimals.
* 1 to 7 % (17 % below 60 samples/deg) between the published filters and the code of 1996: two parametrisations of one
  experiment. Were they nearer than 1 %, one of them would not be what it says. A wide gate: no outside map has the published
  filters, whose closed form tests/viewer/test_scielab.py holds to 1e-12.

How independent they are: ΔE 1994 and 2000 are colour-science's own in pixsim, so that colour-science judges there only what
pixsim hands over; the MATLAB maps and Sharma's table judge the formulas.
"""

from __future__ import annotations

from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from judges.gates import not_met, row

from pixsim.viewer import scielab

DATA = Path(__file__).parents[1] / "data" / "scielab"
PAIRS = ["constant_offset", "csf_sweep_vs_blur", "dark_noise", "edge_vs_blurred_edge", "redgreen_grating_vs_mean"]
D65 = np.array([95.047, 100.0, 108.883])
KERNELS_SAMPLES_PER_DEG = [20, 23, 30, 60, 120, 240]
COLOUR_METHODS = {"1976": "CIE 1976", "1994": "CIE 1994", "2000": "CIE 2000"}
ROUNDED_BELOW = 0.009  # of white: the MATLAB code has .008856, 7.787 and 903.3 there, CIE the exact fractions
PLAIN_STEP = 4  # of each map every fourth sample is kept


def load_pair(name: str) -> tuple[np.ndarray, np.ndarray, dict]:
    """(reference XYZ, test XYZ, everything in the file)."""
    with np.load(DATA / f"{name}.npz") as file:
        data = dict(file)
    return data["reference_over_white"] * data["white_xyz"], data["test_over_white"] * data["white_xyz"], data


def map_of(name: str, density: float = 1.0, **options) -> tuple[np.ndarray, dict]:
    """(pixsim's map of a pair, everything in the file); a density other than 1 is a wrong viewing distance."""
    reference, test, data = load_pair(name)
    view = {"white_xyz": data["white_xyz"], "samples_per_deg": density * float(data["samples_per_deg"])}
    return scielab.delta_e_map(reference, test, **view, **options), data


def from_1996(formula: str, names: list[str] = PAIRS, filters: str = "zhang1996", density: float = 1.0) -> np.ndarray:
    """Differences from the maps of 1996, of all samples."""
    differences = []
    for name in names:
        found, data = map_of(name, density, filters=filters, formula=formula)
        differences.append((found - data[f"delta_e_{formula}"]).ravel())
    return np.concatenate(differences)


def from_1996_kernels(samples_per_deg: int, width: float = 1.0) -> np.ndarray:
    """Differences from the taps of 1996, of all Gaussians of all channels."""
    with np.load(DATA / "kernels.npz") as kernels:
        return np.concatenate([
            np.ravel([
                np.sign(weight) * abs(weight) ** 0.5 * scielab.zhang1996_kernel(width * width_deg, samples_per_deg)
                for weight, width_deg in gaussians
            ] - kernels[f"spd{samples_per_deg}_k{channel + 1}"])
            for channel, gaussians in enumerate(scielab.ZHANG1996_GAUSSIANS)
        ])  # fmt: skip


def published_over_1996(coarse: bool, filters: str = "published") -> np.ndarray:
    """Mean ΔE over that of 1996, less 1, of the pairs below 60 samples/deg, or of the others."""
    found = [(each.mean() / data["delta_e_1976"].mean() - 1, data) for each, data in (map_of(n, filters=filters) for n in PAIRS)]
    return np.array([ratio for ratio, data in found if (data["samples_per_deg"] < 60) == coarse])


def from_matlab_plain(formula: str, dark: bool = False, asked: str | None = None) -> np.ndarray:
    """Differences from unfiltered maps of the MATLAB code, where all light is above the rounded constants, or elsewhere."""
    differences = []
    with np.load(DATA / "plain_cielab.npz") as plain:
        for name in PAIRS:
            reference, test, data = load_pair(name)
            kept = np.s_[::PLAIN_STEP, ::PLAIN_STEP]
            images = [each[kept] for each in np.broadcast_arrays(reference, test)]
            lab = [scielab.xyz_to_lab(each, data["white_xyz"]) for each in images]
            least = np.minimum(*(each / data["white_xyz"] for each in images)).min(axis=-1)
            chosen = (least < ROUNDED_BELOW) == dark
            differences.append((scielab.delta_e(*lab, asked or formula) - plain[f"{name}_{formula}"])[chosen])
    return np.concatenate(differences)


@cache
def many_xyz() -> np.ndarray:
    """Pairs (2, N, 3): from black, through CIELAB's linear branch, to beyond white, with colours near and far."""
    rng = np.random.default_rng(5)
    first = D65 * np.concatenate([rng.uniform(0, 1.2, (2000, 3)), rng.uniform(0, 0.012, (500, 3)), np.zeros((1, 3))])
    return np.stack([first, np.abs(first + D65 * rng.normal(0, 0.05, first.shape))])


def white_xy(white_xyz: np.ndarray) -> np.ndarray:
    return white_xyz[:2] / white_xyz.sum()


def from_colour_lab(white_xyz: np.ndarray = D65, constants: tuple[float, float, float] | None = None) -> np.ndarray:
    """Differences of L*, a*, b* from colour-science."""
    import colour

    xyz = many_xyz().reshape(-1, 3)
    expected = colour.XYZ_to_Lab(xyz / 100, white_xy(D65))  # colour's white has Y = 1
    if constants is None:
        return scielab.xyz_to_lab(xyz, white_xyz) - expected
    return scielab._lab((xyz / white_xyz).T, *constants) - expected


def from_colour_delta_e(formula: str, asked: str | None = None) -> np.ndarray:
    """Differences of ΔE from colour-science, from XYZ on: its CIELAB too."""
    import colour

    lab = [colour.XYZ_to_Lab(each / 100, white_xy(D65)) for each in many_xyz()]
    expected = colour.delta_E(*lab, method=COLOUR_METHODS[formula])
    return scielab.delta_e(*(scielab.xyz_to_lab(each, D65) for each in many_xyz()), asked or formula) - expected


def from_sharma(formula: str = "2000", hue_deg: float = 0.0) -> np.ndarray:
    """Differences from the 34 pairs; hue_deg turns the second colour of each."""
    rows = np.loadtxt(DATA / "sharma.csv", delimiter=",", skiprows=1)
    assert rows.shape == (34, 7)
    cosine, sine = np.cos(np.radians(hue_deg)), np.sin(np.radians(hue_deg))
    turned = rows[:, 3:6] @ np.array([[1, 0, 0], [0, cosine, sine], [0, -sine, cosine]])
    found = scielab.delta_e(rows[:, :3], turned, formula)
    error = found - rows[:, 6]
    # Pair 14 has hues 180° apart, where the formula itself jumps: arctan2's last bit chooses its value or pair 15's.
    error[13] = min(found[13] - rows[13:15, 6], key=abs)
    return error


def rows() -> list[dict[str, object]]:
    matlab, both, code = "SCIELAB-1996 under Octave", "SCIELAB-1996 and ISETCam under Octave", "colour-science"
    kernels = np.concatenate([from_1996_kernels(each) for each in KERNELS_SAMPLES_PER_DEG])
    return [
        *(row(f"S-CIELAB map, ΔE {each}, 5 pairs", matlab, -1e-9, 1e-9, from_1996(each)) for each in ("1976", "1994")),
        row("S-CIELAB kernels, 20 to 240 samples/deg", matlab, -1e-14, 1e-14, kernels),
        row("published filters over 1996's, mean ΔE, 60 samples/deg", matlab, 0.01, 0.07, published_over_1996(False), "{:.3f}"),
        row("the same, 20 and 30 samples/deg", matlab, 0.01, 0.17, published_over_1996(True), "{:.3f}"),
        *(row(f"ΔE {each}, no filter", both, -1e-9, 1e-9, from_matlab_plain(each)) for each in ("1976", "2000")),
        row("CIELAB, exact constants", f"{code}, CIE 15", -1e-9, 1e-9, from_colour_lab()),
        *(row(f"ΔE {each}", code, -1e-9, 1e-9, from_colour_delta_e(each)) for each in COLOUR_METHODS),
        row("CIEDE2000, 34 pairs", "Sharma, Wu & Dalal 2005", -1e-4, 1e-4, from_sharma()),
    ]


def test_rows():
    assert not_met(rows()) == []


# --- The first public code, 1996 ---


@pytest.mark.parametrize("name", PAIRS)
@pytest.mark.parametrize("wrong", [{"filters": "published"}, {"density": 1.01}, {"density": 1 / 1.01}])
def test_other_filters_or_distances_miss_the_1996_maps(name, wrong):
    # A uniform map feels the density only by what the kernels' sums lack.
    assert np.abs(from_1996("1976", [name], **wrong)).max() > 1e-4


WRONG = {  # a cause, and the least that it does
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
def test_what_is_wrong_is_found_out(cause):
    differences, least = WRONG[cause]
    assert np.abs(differences()).max() > least


def test_exact_lab_constants_miss_the_1996_map_of_the_dark(monkeypatch):
    monkeypatch.setattr(scielab, "ZHANG1996_LAB", scielab.CIE_LAB)
    assert np.abs(from_1996("1976", ["dark_noise"])).max() > 1e-6


def test_1994_is_weighted_by_the_reference():
    reference, test, data = load_pair("redgreen_grating_vs_mean")
    swapped = scielab.delta_e_map(test, reference, white_xyz=D65, samples_per_deg=30, filters="zhang1996", formula="1994")
    assert np.abs(swapped - data["delta_e_1994"]).max() > 1  # measured 2.5: so the maps above do tell which is which


@pytest.mark.parametrize("name", PAIRS)
def test_published_and_1996_filters_tell_nearly_the_same(name):
    found, data = map_of(name)
    expected, coarse = data["delta_e_1976"], float(data["samples_per_deg"]) < 60
    # Two parametrisations of one experiment: measured 2 to 6 % apart in the mean, published above. They are not the
    # same filter, hence the lower bound. At 20 and 30 samples/deg the 1996 kernels are undersampled.
    assert 0.01 < found.mean() / expected.mean() - 1 < (0.17 if coarse else 0.07)
    if np.ptp(expected) > 1e-6:  # a uniform map has no correlation
        assert np.corrcoef(found.ravel(), expected.ravel())[0, 1] > (0.99 if coarse else 0.998)


@pytest.mark.parametrize("coarse", [False, True])
def test_the_1996_filters_are_too_near_themselves(coarse):
    assert np.abs(published_over_1996(coarse, filters="zhang1996")).max() < 0.01


# --- MATLAB's plain CIELAB ---


@pytest.mark.parametrize("formula", ["1976", "2000"])
def test_matlabs_rounded_constants_show_where_it_is_dark(formula):
    assert from_matlab_plain(formula).size > 1000
    # Where it is dark its rounded constants are seen, and no more than they can do.
    assert 1e-6 < np.abs(from_matlab_plain(formula, dark=True)).max() < 1e-4
