"""Notes on tables of efficiency that end before the light does: their shares in closed form."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.sensor.pixel import PixelPhysics, derive
from pixsim.sensor.pixel_notes import pixel_notes, share_beyond, tables_of
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.spectral_range import CENTRES_NM, OUTSIDE

NM = np.arange(365.0, 1100.0, 10.0)
CAMERA = Camera(die_mm=0.04)


def light(spectrum: np.ndarray, **header: Any) -> SpectralImage:
    return SpectralImage(
        NM,
        10.0,
        5.0,
        data=np.broadcast_to(spectrum, (8, 8, NM.size)).copy(),
        header={"diffraction": False, **header},
    )


EVEN_PHOTONS = light(1e-3 / NM)  # as many photons in each band


def grey(table: list[list[float]], **more: Any) -> PixelPhysics:
    stack = {"enabled": False}
    return derive(
        Pixel.model_validate(
            {"technology": "4t-bsi", "pitch_um": 5.0, "quantum_efficiency": table, "stack": stack}
            | more
        )
    )


def said(physics: PixelPhysics, image: SpectralImage = EVEN_PHOTONS) -> list[str]:
    return pixel_notes(physics, CAMERA, image)


def test_share_beyond_a_table_is_that_of_its_last_value() -> None:
    """0.4 from 400 to 900 nm, and then 0.4 for 200 nm of 700: 2 of 7 of photons that are even."""
    physics = grey([[400, 0.4], [900, 0.4]])
    (curve,) = tables_of(physics).values()
    assert share_beyond(curve, EVEN_PHOTONS, physics) == pytest.approx(2 / 7, rel=1e-7)
    (text,) = said(physics)
    assert re.search(
        r"pixel\.quantum_efficiency ends at 900 nm with 0\.4, and is 0 beyond: if it stayed so, 29"
        r" % of",
        text,
    )


def test_table_and_filter_may_end_within_one_band() -> None:
    """From 902 to 906 nm there is 0.4 of one band, beside 50 bands below 900 nm and none above."""
    physics = grey([[400, 0.4], [902, 0.4]], infrared_cut_nm=906.0)
    (curve,) = tables_of(physics).values()
    assert share_beyond(curve, EVEN_PHOTONS, physics) == pytest.approx(0.4 / 50.4, rel=1e-7)


@pytest.mark.parametrize(
    "physics",
    [
        grey([[400, 0.4], [900, 0.0]]),
        grey([[400, 0.4], [1100, 0.4]]),
        grey([[400, 0.4], [900, 0.4]], infrared_cut_nm=900.0),
        grey([[400, 0.4], [1090, 0.4], [1095, 0.4]]),
    ],
)
def test_a_table_that_ends_dark_or_with_the_light_or_the_filter_says_nothing(
    physics: PixelPhysics,
) -> None:
    assert said(physics) == []


def test_light_that_is_not_computed_counts_by_its_lamp() -> None:
    """A table that ends at 800 nm keeps the range at 830 nm: what the lamp has beyond stands in the
    header.
    """
    physics = grey([[400, 0.4], [800, 0.4]])
    lamps = [(1e-3 / CENTRES_NM).tolist(), (CENTRES_NM < 800).astype(float).tolist()]
    image = light(np.where(NM < 830, 1e-3 / NM, 0.0), **{OUTSIDE: lamps})
    (curve,) = tables_of(physics).values()
    assert share_beyond(curve, image, physics) == pytest.approx(
        310 / 710, rel=1e-7
    )  # from 800 to 1110 nm, of 400 to 1110 nm
