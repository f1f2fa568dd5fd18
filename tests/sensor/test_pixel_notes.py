"""Notes on pixels: efficiencies that end before the light does, scales of channels, and numbers in
another unit.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.claims import check

from pixsim.light.spectral import VISIBLE, WIDEST, SpectralImage, Spectrum
from pixsim.optics.camera import Camera
from pixsim.optics.lens_defocus import DEPTHS
from pixsim.sensor.pixel import PixelPhysics, derive
from pixsim.sensor.pixel_notes import pixel_notes, share_beyond, tables_of
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.spectral_range import CENTRES_NM, OUTSIDE, outside_header, outside_share, span_of
from pixsim.sensor.unit_slips import SLIPS, unit_slips

NM = np.arange(365.0, 1100.0, 10.0)
CAMERA = Camera(die_mm=0.04)


def light(spectrum: np.ndarray, **header: Any) -> SpectralImage:
    data = np.broadcast_to(spectrum, (8, 8, NM.size)).copy()
    return SpectralImage(NM, 10.0, 5.0, data=data, header={"diffraction": False, **header})


PHOTONS = light(1e-3 / NM)  # as many photons in each band
# 310 nm of photons of 800 to 1110 nm are not computed, of one lamp of two.
LAMPS = [(1e-3 / CENTRES_NM).tolist(), (CENTRES_NM < 800).astype(float).tolist()]
COMPUTED = light(np.where(NM < 830, 1e-3 / NM, 0.0), **{OUTSIDE: LAMPS})


def pixel(table: Any, **more: Any) -> PixelPhysics:
    options = {"technology": "4t-bsi", "pitch_um": 5.0, "stack": {"enabled": False}}
    return derive(Pixel.model_validate(options | {"quantum_efficiency": table} | more))


def colour(table: Any) -> PixelPhysics:
    channels = {"R": table, "G": table, "B": table}
    return pixel(None, colour={"quantum_efficiencies": channels})


@pytest.mark.parametrize(
    ("physics", "image", "share"),
    [
        (pixel([[400, 0.4], [900, 0.4]]), PHOTONS, 2 / 7),
        # From 902 to 906 nm there is 0.4 of one band, beside 50 bands below 900 nm.
        (pixel([[400, 0.4], [902, 0.4]], infrared_cut_nm=906.0), PHOTONS, 0.4 / 50.4),
        (pixel([[400, 0.4], [800, 0.4]]), COMPUTED, 310 / 710),
        (pixel([[400, 0.4], [900, 0.0]]), PHOTONS, 0.0),
        (pixel([[400, 0.4], [1100, 0.4]]), PHOTONS, 0.0),
        (pixel([[400, 0.4], [900, 0.4]], infrared_cut_nm=900.0), PHOTONS, 0.0),
    ],
)
def test_share_beyond_a_table_is_that_of_its_last_value(
    physics: PixelPhysics, image: SpectralImage, share: float
) -> None:
    """There is a note where it is more than 1 %."""
    (curve,) = tables_of(physics).values()
    check("share", share_beyond(curve, image, physics), share, atol=1e-7, why="float32 of light")
    notes = [note for note in pixel_notes(physics, CAMERA, image) if "ends at" in note]
    assert len(notes) == (share > 0.01)


NEAR = light(1e-3 / NM, **{DEPTHS: [0.1, 0.1, 0.1]})
SINGLE_SCALE = {"colour": {"sensitivities": "Nikon_D810", "peak_quantum_efficiency": 0.5}}
SEPARATE_SCALES = {"colour": {"sensitivities": "Nikon_D5100", "peak_quantum_efficiency": 0.5}}


@pytest.mark.parametrize(
    ("physics", "image", "words"),
    [
        (
            colour([[nm, 0.4] for nm in range(400, 901, 10)]),
            PHOTONS,
            "efficiencies of G ends at 900",
        ),
        (pixel(None, **SEPARATE_SCALES), PHOTONS, "each channel of Nikon_D5100"),
        (pixel(None, **SINGLE_SCALE), PHOTONS, ""),
        (pixel(0.5), NEAR, "0.1 m"),
        (pixel(0.5), light(1e-3 / NM, **{DEPTHS: [0.5, None, 2.0]}), ""),
        (pixel(0.5), light(1e-3 / NM, **{DEPTHS: "near"}), ""),
    ],
)
def test_notes_appear_when_they_should(
    physics: PixelPhysics, image: SpectralImage, words: str
) -> None:
    camera = Camera(die_mm=0.04, object_distance_m=1e3, f_number=1.0)
    notes = pixel_notes(physics, camera, image)
    assert [note for note in notes if words in note] if words else not notes


def test_light_outside_the_computed_range_widens_it_or_is_noted() -> None:
    """A lamp of equal power at 300 to 1110 nm; an infrared filter needs no more than 830 nm."""
    lamp = Spectrum(np.array([300.0, 1110.0]), np.ones(2))
    wide = span_of([lamp], [pixel(0.5)])
    assert (wide.low_nm, wide.high_nm) == (WIDEST.low_nm, WIDEST.high_nm)
    assert span_of([lamp], [pixel(0.5, infrared_cut_nm=650.0)]).high_nm == VISIBLE.high_nm
    # ∫ λ dλ outside 360-830 nm, over that from 300 to 1110 nm.
    header = outside_header([lamp])
    expected = 1 - (830**2 - 360**2) / (1110**2 - 300**2)
    assert outside_share(header, pixel(0.5)) == pytest.approx(expected, rel=1e-3)
    widest = outside_share(outside_header([lamp], WIDEST), pixel(0.5))
    assert widest == pytest.approx((1110**2 - 1100**2) / (1110**2 - 300**2), rel=1e-3)
    assert outside_share({OUTSIDE: "lamps"}, pixel(0.5)) == 0


SHEET: dict[str, Any] = {
    "pitch_um": 2.0,
    "full_well_e": 10_000.0,
    "read_noise_e": 2.0,
    "dark_current_e_per_s": 5.0,
    "quantum_efficiency": 0.8,
    "bits": 12,
}


# Each number on both sides of where a note begins; the ADC has 4095 codes.
@pytest.mark.parametrize(
    ("slip", "usual", "mended"),
    [
        ({"pitch_um": 301.0}, {"pitch_um": 300.0}, "In nm? Write pitch_um = 0.301"),
        (
            {"data_sheet_pitch_um": 301.0},
            {"data_sheet_pitch_um": 300.0},
            "In nm? Write data_sheet_pitch_um = 0.301",
        ),
        (
            {"full_well_e": 199.0},
            {"full_well_e": 200.0},
            "In thousands of electrons? Write full_well_e = 199000",
        ),
        (
            {"full_well_e": None, "saturation_capacity_e": 91.0},
            {"full_well_e": None, "saturation_capacity_e": 200.0},
            "Write saturation_capacity_e = 91000",
        ),
        ({"adc_full_scale_e": 8.0}, {"adc_full_scale_e": 8e3}, "adc_full_scale_e = 8000"),
        ({"prnu": 0.051}, {"prnu": 0.05}, "In per cent? Write prnu = 0.00051"),
        ({"prnu": 0.2}, {"prnu_percent": 20.0}, "In per cent? Write prnu = 0.002"),
        # The range is 2499 and 2501 of 10 000 e-; the reciprocal gain makes it 6710 e-.
        (
            {"gain_e_per_dn": 2499 / 4095},
            {"gain_e_per_dn": 2501 / 4095},
            "In DN per electron? Write dn_per_e = 0.610256",
        ),
        (
            {"dn_per_e": 2.5},
            {"gain_e_per_dn": 2.5},
            "In electrons per DN? Write gain_e_per_dn = 2.5",
        ),
        # No other unit mends 400 µm in nm, or a range of 0.4 % of the well and 41 wells.
        ({}, {"pitch_um": 4e5}, ""),
        ({}, {"gain_e_per_dn": 0.01}, ""),
        ({}, {"gain_e_per_dn": 20.0}, ""),
    ],
)
def test_number_in_another_unit_is_noted(
    slip: dict[str, Any], usual: dict[str, Any], mended: str
) -> None:
    values = {name: value for name, value in (SHEET | usual).items() if value is not None}
    assert not unit_slips(Pixel(**values))
    if slip:
        values = {name: value for name, value in (SHEET | slip).items() if value is not None}
        (note,) = unit_slips(Pixel(**values))
        assert mended in note


def test_both_fields_of_a_slip_exist() -> None:
    names = {*SLIPS, *(slip.meant for slip in SLIPS.values() if slip.meant)}
    assert names <= Pixel.model_fields.keys() | Camera.model_fields.keys()
