"""Pictures blurred by a circular pupil."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.claims import Claim, check
from scipy.fft import dct

from pixsim import optics

NM = np.array([550.0])
ONE = np.array([1.0])


FLAT = [np.full(shape, 3.0) for shape in ((32, 20), (1, 7), (7, 1), (1, 1))]
DARK = np.zeros((8, 8))
POINT = np.eye(1, 8192)  # in a corner it holds all cosines
OTF = optics.diffraction_otf(np.arange(8192) / (2 * 8192 * 0.5e-3), 550.0, 4.0)
CLAIMS = [
    *(
        Claim(
            f"a flat field of {flat.shape} is unchanged",
            lambda flat=flat: optics.diffract(flat, 2.0, NM, ONE, 4.0),
            flat,
            atol=1e-12,
        )
        for flat in FLAT
    ),
    *(
        Claim(
            f"a sum of {len(pictures)} pictures without light is dark",
            lambda pictures=pictures: optics.diffract_sum(pictures, (8, 8), 1.0, NM, 8.0),
            DARK,
        )
        for pictures in ([], [(DARK + 1, np.zeros(1))])
    ),
    Claim(
        "all frequencies are scaled by the OTF",
        lambda: dct(optics.diffract(POINT, 0.5, NM, ONE, 4.0)[0]) / dct(POINT[0]),
        OTF,
        atol=1e-7,
        why="a table of 32768 frequencies: 3e-8",
    ),
    Claim("up to the cut-off, below order 3724", lambda: np.count_nonzero(OTF), 3724),
]


@pytest.mark.parametrize("claim", CLAIMS, ids=str)
def test_closed_forms(claim: Claim) -> None:
    claim.check()


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
        blurred = optics.diffract_sum([(picture, ONE)], (1, 64), 1.0, NM, f_number, gaussian)
        check(f"f/{f_number}", blurred, wanted * picture, atol=1e-7, why="a table of frequencies")
