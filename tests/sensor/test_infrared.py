"""Notes on tables of efficiency that end before the light does, and on infrared light in colours: their shares in closed form."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.scene.packaged import packaged_scenes
from pixsim.sensor.infrared import flat_efficiency_change, infrared_shares, pixel_notes, share_beyond, tables_of
from pixsim.sensor.outside import CENTRES_NM, OUTSIDE
from pixsim.sensor.pixel import PixelPhysics, derive
from pixsim.sensor.pixel_options import Pixel

NM = np.arange(365.0, 1100.0, 10.0)
CAMERA = Camera(die_mm=0.04)


def light(spectrum: np.ndarray, **header: Any) -> SpectralImage:
    return SpectralImage(
        NM, 10.0, 5.0, data=np.broadcast_to(spectrum, (8, 8, NM.size)).copy(), header={"diffraction": False, **header}
    )


EVEN_PHOTONS = light(1e-3 / NM)  # as many photons in each band


def grey(table: list[list[float]], **more: Any) -> PixelPhysics:
    stack = {"enabled": False}
    return derive(
        Pixel.model_validate({"technology": "4t-bsi", "pitch_um": 5.0, "quantum_efficiency": table, "stack": stack} | more)
    )


def coloured(**more: Any) -> PixelPhysics:
    """Each channel sees 100 nm of the visible with 0.5, and all see 700 to 1000 nm: G half as much as the others."""
    low_nm, high = {"R": 600.0, "G": 500.0, "B": 400.0}, {"R": 0.2, "G": 0.1, "B": 0.2}
    nm = np.arange(400.5, 1001.0)
    curves = {}
    for letter, low in low_nm.items():
        values = np.where((nm > low) & (nm < low + 100), 0.5, np.where((nm > 700) & (nm < 1000), high[letter], 0.0))
        curves[letter] = [[400, 0.0], *np.column_stack([nm, values]).tolist()]
    colour = {"pattern": "rggb", "quantum_efficiencies": curves}
    return derive(
        Pixel.model_validate({"technology": "4t-bsi", "pitch_um": 5.0, "colour": colour, "stack": {"enabled": False}} | more)
    )


def said(physics: PixelPhysics, image: SpectralImage = EVEN_PHOTONS) -> list[str]:
    return pixel_notes(physics, CAMERA, image)


def test_share_beyond_a_table_is_that_of_its_last_value() -> None:
    """0.4 from 400 to 900 nm, and then 0.4 for 200 nm of 700: 2 of 7 of photons that are even."""
    physics = grey([[400, 0.4], [900, 0.4]])
    (curve,) = tables_of(physics).values()
    assert share_beyond(curve, EVEN_PHOTONS, physics) == pytest.approx(2 / 7, rel=1e-7)
    (text,) = said(physics)
    assert re.search(r"pixel\.quantum_efficiency ends at 900 nm with 0\.4, and is 0 beyond: if it stayed so, 29 % of", text)


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
def test_a_table_that_ends_dark_or_with_the_light_or_the_filter_says_nothing(physics: PixelPhysics) -> None:
    assert said(physics) == []


def test_light_that_is_not_computed_counts_by_its_lamp() -> None:
    """A table that ends at 800 nm keeps the range at 830 nm: what the lamp has beyond stands in the header."""
    physics = grey([[400, 0.4], [800, 0.4]])
    lamps = [(1e-3 / CENTRES_NM).tolist(), (CENTRES_NM < 800).astype(float).tolist()]
    image = light(np.where(NM < 830, 1e-3 / NM, 0.0), **{OUTSIDE: lamps})
    (curve,) = tables_of(physics).values()
    assert share_beyond(curve, image, physics) == pytest.approx(310 / 710, rel=1e-7)  # from 800 to 1110 nm, of 400 to 1110 nm


def flat(**more: Any) -> PixelPhysics:
    sheet = {"full_well_e": 1e4, "read_noise_e": 2.0, "dark_current_e_per_s": 1.0, "quantum_efficiency": 0.65}
    return derive(Pixel.model_validate({"pitch_um": 5.0, **sheet} | more))


def test_change_of_a_flat_efficiency_is_that_of_the_stated_curve() -> None:
    """The mean of the curve of 525 nm over even photons, over the number."""
    curve = flat(quantum_efficiency_nm=525).quantum_efficiency(NM)
    change = flat_efficiency_change(EVEN_PHOTONS, flat())
    assert change == pytest.approx(curve.mean() / 0.65 - 1, rel=5e-3)  # means within bands, not their middles
    assert flat_efficiency_change(EVEN_PHOTONS, flat(quantum_efficiency_depth_um=0.2)) == change, "a depth that nothing uses"
    assert flat_efficiency_change(EVEN_PHOTONS, flat(quantum_efficiency_nm=525)) == 0.0
    assert flat_efficiency_change(EVEN_PHOTONS, grey([[400, 0.4], [1100, 0.4]])) == 0.0
    assert flat_efficiency_change(EVEN_PHOTONS, coloured(quantum_efficiency=0.65)) == 0.0, "channels state what they see"


@pytest.mark.parametrize(
    ("lamp", "fewer"),
    [("led_b3", ""), ("d65", ""), ("fl11", ""), ("halogen", "69 %"), ("led_850nm", "76 %"), ("led_940nm", "91 %")],
)
def test_flat_efficiency_is_told_in_halogen_and_infrared_light(lamp: str, fewer: str) -> None:
    nm, watts = np.loadtxt(packaged_scenes()["flat"].parent / f"spectra/{lamp}.spd").T
    image = light(np.interp(NM, nm, watts, left=0.0, right=0.0))
    notes = said(flat(), image)
    pattern = rf"pixel\.quantum_efficiency = 0\.65 holds at every wavelength; .* {fewer} fewer electrons of this light"
    assert [bool(re.match(pattern, text)) for text in notes] == [True] * bool(fewer)
    assert said(flat(quantum_efficiency_nm=525), image) == []


def test_infrared_in_colours_is_told_by_channel() -> None:
    """R: 300 · 0.2 of 100 · 0.5 + 300 · 0.2, G: 300 · 0.1 of 100 · 0.5 + 300 · 0.1, B as R; a filter takes it away."""
    shares = infrared_shares(EVEN_PHOTONS, coloured())
    assert shares == {
        "R": pytest.approx(60 / 110, rel=1e-3),
        "G": pytest.approx(30 / 80, rel=0.01),
        "B": pytest.approx(60 / 110, rel=1e-3),
    }
    (text,) = said(coloured())
    assert text.startswith(
        "infrared beyond 700 nm is 55 % of R, 38 % of G, 55 % of B, which no eye sees: it is part of the colour error."
    )
    assert said(coloured(infrared_cut_nm=690.0)) == said(coloured(), light(np.where(NM < 700, 1e-3, 0.0))) == []
    assert infrared_shares(EVEN_PHOTONS, grey([[400, 0.4], [1100, 0.4]])) == {}
