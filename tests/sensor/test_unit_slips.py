"""Numbers of data sheets in another unit than that of their field: named where the other unit, and
only that one, is usual.
"""

from __future__ import annotations

from typing import Any

import pytest

from pixsim.base.errors import PixsimError
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.unit_slips import SLIPS, unit_slips

SHEET: dict[str, Any] = {
    "pitch_um": 2.0,
    "full_well_e": 10_000.0,
    "read_noise_e": 2.0,
    "dark_current_e_per_s": 5.0,
    "quantum_efficiency": 0.8,
    "bits": 12,
}


def sheet(**fields: Any) -> Pixel:
    """A complete data sheet, with another word for its full well if one is given."""
    words = {"saturation_capacity_e": {"full_well_e": None}}
    other = {name: value for field in fields for name, value in words.get(field, {}).items()}
    return Pixel(
        **{name: value for name, value in (SHEET | other | fields).items() if value is not None}
    )


# Each number on both sides of where a note begins; the ADC has 4095 codes.
@pytest.mark.parametrize(
    ("slip", "usual", "mended"),
    [
        ({"pitch_um": 3450.0}, {"pitch_um": 300.0}, "In nm? Write pitch_um = 3.45."),
        (
            {"data_sheet_pitch_um": 301.0},
            {"data_sheet_pitch_um": 300.0},
            "In nm? Write data_sheet_pitch_um = 0.301.",
        ),
        (
            {"full_well_e": 199.0},
            {"full_well_e": 200.0},
            "In thousands of electrons? Write full_well_e = 199000.",
        ),
        (
            {"full_well_e": 10.5},
            {"full_well_e": 10_500.0},
            "In thousands of electrons? Write full_well_e = 10500.",
        ),
        (
            {"saturation_capacity_e": 91.0},
            {"saturation_capacity_e": 200.0},
            "Write saturation_capacity_e = 91000.",
        ),
        (
            {"adc_full_scale_e": 8.0},
            {"adc_full_scale_e": 8000.0},
            "In thousands of electrons? Write adc_full_scale_e = 8000.",
        ),
        ({"prnu": 0.051}, {"prnu": 0.05}, "In per cent? Write prnu = 0.00051."),
        ({"prnu": 0.2}, {"prnu_percent": 20.0}, "In per cent? Write prnu = 0.002."),
        # The range is 2499 and 2501 of 10 000 e-; the reciprocal gain makes it 6710 e-.
        (
            {"gain_e_per_dn": 2499 / 4095},
            {"gain_e_per_dn": 2501 / 4095},
            "In DN per electron? Write dn_per_e = 0.610256.",
        ),
        (
            {"dn_per_e": 2.5},
            {"gain_e_per_dn": 2.5},
            "In electrons per DN? Write gain_e_per_dn = 2.5.",
        ),
        # More than four wells, and with the reciprocal gain 82 % of one.
        (
            {"full_well_e": 2000.0, "gain_e_per_dn": 2.5},
            {"full_well_e": 2000.0, "dn_per_e": 2.5},
            "Write dn_per_e = 2.5.",
        ),
    ],
)
def test_number_in_another_unit_is_named(
    slip: dict[str, float], usual: dict[str, float], mended: str
) -> None:
    (text,) = unit_slips(sheet(**slip))
    *_, (name, number) = slip.items()
    assert text.startswith(f"pixel: {name} = {number:g} is unusual. ")
    assert text.endswith(mended.removesuffix("."))
    assert not unit_slips(sheet(**usual))


@pytest.mark.parametrize(
    "fields",
    [
        {"gain_e_per_dn": 0.01},  # 0.4 % of the well, and with the reciprocal gain 41 wells
        {"gain_e_per_dn": 20.0},  # 8 wells, and 2 % of one
        {"pitch_um": 4e5},  # 400 µm in nm
        {
            "technology": "4t-bsi",
            "full_well_e": None,
            "gain_e_per_dn": 40.0,
        },  # no sheet states the well
    ],
)
def test_number_that_no_other_unit_mends_is_left_alone(fields: dict[str, Any]) -> None:
    assert not unit_slips(sheet(**fields))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"prnu": 0.5}, r"prnu: got 0\.5; allowed: .* In per cent\? Write prnu = 0\.005\.$"),
        (
            {"fill_factor": 60.0},
            r"fill_factor: got 60.*; allowed: .* In per cent\? Write fill_factor = 0\.6\.$",
        ),
        (
            {"quantum_efficiency": 62.0},
            r"quantum_efficiency: got 62; allowed: a fraction: 62 % is 0\.62\.$",
        ),
    ],
)
def test_refusal_of_a_fraction_in_per_cent_says_how_to_write_it(
    fields: dict[str, float], message: str
) -> None:
    with pytest.raises(PixsimError, match=message):
        sheet(**fields)


def test_every_row_of_the_table_has_a_field() -> None:
    """Both fields of a row, so that a hint can be followed."""
    names = {*SLIPS, *(slip.meant for slip in SLIPS.values() if slip.meant)}
    assert names <= Pixel.model_fields.keys()
