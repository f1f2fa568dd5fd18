"""Kernels of light against closed forms, CIE tables, and colour-science."""

from __future__ import annotations

from decimal import Decimal

import colour
import numpy as np
import pytest
import scipy.constants as si
from helpers.claims import Claim

from pixsim.light import spectral
from pixsim.light.exr import _merged, shortest
from pixsim.light.spectral import SpectralImage, Spectrum, colour_matching, d65, photopic_efficiency
from pixsim.light.standard import OPPONENT_FROM_XYZ, XYZ_FROM_OPPONENT, illuminant, illuminant_names
from pixsim.light.tables import Column, column_quantum_efficiency

NM = np.arange(360.0, 831.0)
OBSERVER = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
TENTHS = np.linspace(400.0, 401.0, 11)
TRIANGLE = Spectrum(np.array([400.0, 410.0, 430.0]), np.array([0.0, 2.0, 0.0]))
STEP = Spectrum(np.array([500.0, 500.0, 510.0]), np.array([0.0, 3.0, 3.0]))
BANDS_NM = np.arange(370.0, 821.0, 10.0)
UNEQUAL = Spectrum(np.array([400.0, 400.05, 401.0]), np.ones(3))


def one_band(nm: float, width_nm: float, value: float, within_nm: float | None = None):
    """Return an image of one sample and one band, with its light at a single wavelength."""
    within = None if within_nm is None else ([[within_nm]], [[1.0]])
    return SpectralImage([nm], width_nm, 1.0, data=np.full((1, 1, 1), value), within=within)


def two_bands() -> SpectralImage:
    """Return bands with lines at 546 and 553 nm (1:3), and 596, 600 and 604 nm (1:2:1)."""
    nodes_nm = [[546.0, 553.0, 550.0], [596.0, 600.0, 604.0]]
    shares = [[0.25, 0.75, 0.0], [0.25, 0.5, 0.25]]
    data = np.ones((1, 1, 2))
    return SpectralImage([550.0, 600.0], 10.0, 1.0, data=data, within=(nodes_nm, shares))


def lamp_lx(name: str) -> tuple[float, float]:
    """Return the illuminance of a CIE lamp by ten-nanometre bands, and by colour-science."""
    shape = colour.SpectralShape(365, 825, 1)
    lamp = colour.SDS_ILLUMINANTS[name].copy().align(shape, interpolator=colour.LinearInterpolator)
    means = (lamp.values[:-1] + lamp.values[1:]) / 2
    bands = means.reshape(46, 10).mean(axis=1)[None, None]
    image = SpectralImage(BANDS_NM, 10.0, 1.0, data=bands)
    return image.illuminance_lx()[0, 0], colour.colorimetry.luminous_flux(lamp)


def merged_bands() -> SpectralImage:
    width_nm = np.array([5, 5, 2.5, 2.5, 1.25, 1.25, 2.5, 10, 15, 5, 5])
    nm = np.cumsum(width_nm) - width_nm / 2
    factors = np.arange(11.0), np.ones((1, 1, 1))
    return _merged(SpectralImage(nm, width_nm, 1.0, factors=factors))


MIDDLE = (2 * 2.5 + 3 * 2.5 + 4 * 1.25 + 5 * 1.25 + 6 * 2.5) / 10
AMPERE = Column("R", "A/W", (Decimal("0.1"), Decimal("0.2")))
CLAIMS = [
    Claim(
        "photons a joule by the SI",
        lambda: spectral.photons_per_joule([400.0, 800.0]),
        np.array([400e-9, 800e-9]) / (si.h * si.c),
        rtol=1e-14,
    ),
    Claim(
        "photons a lumen at 555 nm",
        lambda: spectral.photons_per_joule(555.0) / 683,
        4.09e15,
        rtol=1e-3,
        why="the handbook's three digits",
    ),
    Claim(
        "683 lm/W at 555 nm by the SI",
        lambda: one_band(555.0, 1.0, 2.0).illuminance_lx(),
        [[2 * 683.0]],
        rtol=1e-5,
        why="the SI defines it for 555.016 nm in air",
    ),
    Claim(
        "light off the centre of its band",
        lambda: one_band(530.0, 10.0, 0.2, 532.0).illuminance_lx(),
        [[2 * 683.002 * 0.8849624]],
        rtol=1e-6,
        why="digits of CIE's table",
    ),
    Claim(
        "light at the centre of its band",
        lambda: one_band(530.0, 10.0, 0.2).illuminance_lx(),
        [[2 * 683.002 * 0.862]],
        rtol=1e-6,
        why="digits of CIE's table",
    ),
    Claim(
        "weights of bands",
        lambda: spectral.luminous_weight([550.0, 600.0], [10.0, 5.0]),
        683.002 * photopic_efficiency([550.0, 600.0]) * [10.0, 5.0],
        rtol=1e-14,
    ),
    Claim(
        "mean of a line over the light in a band",
        lambda: two_bands().band_mean(lambda nm: nm),
        [551.25, 600.0],
        rtol=1e-15,
    ),
    Claim(
        "mean of a square over the light in a band",
        lambda: two_bands().band_mean(lambda nm: nm**2) - [551.25**2, 600**2],
        [49 * 3 / 16, 8],
        rtol=1e-9,
    ),
    *(
        Claim(f"illuminance of {name}", lambda got=got: got, wanted, rtol=1e-4, why="10 nm bands")
        for name in ("E", "D65", "A")
        for got, wanted in [lamp_lx(name)]
    ),
    Claim(
        "observer of colour-science",
        lambda: colour_matching(OBSERVER.wavelengths),
        OBSERVER.values,
        rtol=1e-9,
        atol=1e-20,
        why="ten digits",
    ),
    Claim(
        "efficiency is the observer's y", lambda: photopic_efficiency(NM), colour_matching(NM)[:, 1]
    ),
    Claim("no light beyond the tables", lambda: colour_matching([359.0, 831.0]), np.zeros((2, 3))),
    Claim(
        "opponents of X = Y = Z by the published matrix",
        lambda: OPPONENT_FROM_XYZ @ np.ones(3),
        [0.8939847, -0.0818111, -0.0029257],
        atol=1e-9,
    ),
    Claim("D65 is 100 at 560 nm", lambda: d65([359.0, 560.0, 831.0]), [0, 100, 0]),
    Claim("illuminant D65 is d65", lambda: illuminant("D65", NM), d65(NM)),
    *(
        Claim(
            f"{name} of colour-science",
            lambda name=name, table=table: illuminant(name, table.wavelengths[table.domain >= 360]),
            table.values[table.domain >= 360],
            rtol=1e-5,
            why="six digits",
        )
        for name in illuminant_names()
        for table in [colour.SDS_ILLUMINANTS[name]]
    ),
    Claim("no A beyond 360-780 nm", lambda: illuminant("A", [355.0, 835.0]), [0, 0]),
    Claim("opponents back", lambda: XYZ_FROM_OPPONENT @ OPPONENT_FROM_XYZ, np.eye(3), atol=1e-14),
    Claim("area of a triangle", TRIANGLE.integral, 30.0, rtol=1e-14),
    Claim("area of half a triangle", lambda: TRIANGLE.integral(410, 430), 20.0, rtol=1e-14),
    Claim("area beside a jump", lambda: STEP.integral(490.0, 505.0), 15.0, rtol=1e-14),
    Claim(
        "means over cells of a triangle",
        lambda: TRIANGLE.cell_means(np.array([395.0, 405.0, 410.0, 420.0, 440.0])),
        [0.25, 1.5, 1.5, 0.25],
        rtol=1e-13,
    ),
    Claim("a spectrum between nodes", lambda: TRIANGLE.at(np.array([390, 405, 420])), [0, 1, 1]),
    Claim("a spectrum twice", lambda: (TRIANGLE * 2.0).integral(), 60.0, rtol=1e-14),
    *(
        Claim(
            f"trapezoids on a grid of {step_nm:g} nm",
            lambda step_nm=step_nm: np.trapezoid(TRIANGLE.on_grid(step_nm), dx=step_nm),
            30.0,
            rtol=1e-12,
        )
        for step_nm in spectral.STEPS_NM
    ),
    *(
        Claim(f"step for nodes {spacing_nm:g} nm apart", lambda nodes=nodes: nodes.step_nm, step_nm)
        for spacing_nm, step_nm in ((1.0, 1.0), (0.2, 1 / 8), (0.1, 1 / 32))
        for nodes in [Spectrum(400.0 + spacing_nm * np.arange(3), np.ones(3))]
    ),
    Claim(
        "nodes of unequal steps in equal ones",
        lambda: spectral.regular_values(TRIANGLE),
        [0, 2, 1, 0],
        rtol=1e-14,
    ),
    Claim(
        "equal steps of 0.1 nm",
        lambda: spectral.regular_values(Spectrum(TENTHS, TENTHS - 400)),
        TENTHS - 400,
        atol=1e-12,
    ),
    Claim(
        "no equal steps below 0.1 nm", lambda: float(spectral.regular_values(UNEQUAL) is None), 1.0
    ),
    Claim("a table at whole nanometres", lambda: spectral.tabulated(NM).integral(400, 402), 802.0),
    Claim("widths of merged bands", lambda: merged_bands().band_width_nm, [10, 10, 10, 15, 10]),
    Claim(
        "centres of merged bands",
        lambda: merged_bands().wavelength_nm,
        [5, 15, 25, 37.5, 50],
        rtol=1e-14,
    ),
    Claim(
        "means of merged bands",
        lambda: merged_bands().factors[0][0],
        [0.5, MIDDLE, 7, 8, 9.5],
        rtol=1e-14,
    ),
    Claim(
        "responsivity to quantum efficiency, R h c/(q λ)",
        lambda: column_quantum_efficiency(AMPERE, (Decimal(400), Decimal(500))),
        np.array([0.1, 0.2]) * si.h * si.c / (si.e * np.array([400e-9, 500e-9])),
        rtol=1e-12,
    ),
    Claim("shortest digits of a float32", lambda: shortest(float(np.float32(5.3))), 5.3),
]


@pytest.mark.parametrize("claim", CLAIMS, ids=str)
def test_closed_forms(claim: Claim) -> None:
    claim.check()
