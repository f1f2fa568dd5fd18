"""Numbers of data sheets that are often given in another unit than their field has."""

from __future__ import annotations

from typing import NamedTuple

from pydantic import BaseModel

from pixsim.base.notes import Note

# The public names; everything else is internal.
__all__ = ["SLIPS", "slip_hint", "unit_slips"]


class _UnitSlip(NamedTuple):
    """A field of a data sheet, and the other unit in which its number is often given.

    usual : smallest and largest usual value, in the field's unit
    unit : the other unit, in words
    factor : what converts a number from the other unit
    meant : field that states the converted number; empty for the same field
    property : of the pixel, which has to be usual in place of the number itself; empty where the
        number has to be
    """

    usual: tuple[float, float]
    unit: str
    factor: float
    meant: str = ""
    property: str = ""


# The published sheets of the tests have pitches of 11 µm at most, wells of 7500 to 91 000 e-, 1 %
# PRNU at most, and ADCs that end at 30 % of the well (the high-gain channel of one with two) to 2.3
# wells. Pitches below 0.3 µm are finer than a wavelength.
PITCH_UM = (0.3, 300.0)
_WELL_E = (200.0, 1e7)
_ADC_RANGE_PER_WELL = (0.25, 4.0)
SLIPS = {
    "pitch_um": _UnitSlip(PITCH_UM, "nm", 1e-3),
    "data_sheet_pitch_um": _UnitSlip(PITCH_UM, "nm", 1e-3),
    "full_well_e": _UnitSlip(_WELL_E, "thousands of electrons", 1e3),
    "saturation_capacity_e": _UnitSlip(_WELL_E, "thousands of electrons", 1e3),
    "adc_full_scale_e": _UnitSlip(_WELL_E, "thousands of electrons", 1e3),
    "prnu": _UnitSlip((0.0, 0.05), "per cent", 0.01),
    "fill_factor": _UnitSlip((0.0, 1.0), "per cent", 0.01),
    "focal_length_mm": _UnitSlip((0.3, 1e5), "m", 1e3),
    "gain_e_per_dn": _UnitSlip(
        _ADC_RANGE_PER_WELL, "DN per electron", 1.0, "dn_per_e", "adc_range_per_well"
    ),
    "dn_per_e": _UnitSlip(
        _ADC_RANGE_PER_WELL, "electrons per DN", 1.0, "gain_e_per_dn", "adc_range_per_well"
    ),
}


def slip_hint(name: str, value: object) -> str:
    """Return how to write a number that is unusual in its field's unit and usual in the other one;
    empty for others.

    name : of a field of `SLIPS` that is judged by its number, without a `property`
    """
    slip = SLIPS[name]
    if isinstance(value, bool) or not isinstance(value, int | float):
        return ""
    number = float(value)
    return _hint(name, number) if _is_slip(slip, number, number * slip.factor) else ""


def unit_slips(settings: BaseModel, table: str = "pixel") -> list[Note]:
    """Return a note for each number of settings that is unusual in its field's unit, and usual in
    the other one of `SLIPS`.

    settings : a `PixelOptions`, or a `Camera`
    table : of a settings file, to which they belong

    A gain is judged by the range of the ADC over the full well, where both are stated.

    >>> from pixsim.sensor.pixel_options import Pixel
    >>> unit_slips(Pixel(technology="4t-bsi", pitch_um=1.4, prnu=0.2))
    ['pixel: prnu = 0.2 is unusual. In per cent? Write prnu = 0.002']
    """
    notes = []
    for name, slip in SLIPS.items():
        number = getattr(settings, name, None)
        if number is None:
            continue

        value = number
        converted = number * slip.factor
        if slip.property:
            other = settings.model_copy(update={name: None, slip.meant: converted})
            value = getattr(settings, slip.property)
            converted = getattr(other, slip.property)
        if value is not None and converted is not None and _is_slip(slip, value, converted):
            place = f"{table}: {name}"
            notes.append(Note("unit_slip", name=place, number=number, hint=_hint(name, number)))
    return notes


def _is_slip(slip: _UnitSlip, value: float, converted: float) -> bool:
    """Return whether a value is unusual, and the converted one usual."""
    low, high = slip.usual
    return not low <= value <= high and low <= converted <= high


def _hint(name: str, number: float) -> str:
    """Return how to write a number that is in the other unit."""
    slip = SLIPS[name]
    return f"In {slip.unit}? Write {slip.meant or name} = {number * slip.factor:g}."
