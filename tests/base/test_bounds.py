"""Bounds of the records: told as a reader writes them, and wide enough."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from pixsim.base.config import explain
from pixsim.base.parameters import Camera, Display, Exposure, Pixel, Run, Study
from pixsim.sensor.pixel import derive


@pytest.mark.parametrize(
    ("record", "values", "told"),
    [
        (Camera, {"focal_length_mm": 1e300}, "focal_length_mm: got 1e+300; allowed: less than or equal to 1e+06."),
        (Camera, {"transmittance": 1e-30}, "transmittance: got 1e-30; allowed: at least 1e-12"),
        (Exposure, {"integration_s": 1e300}, "integration_s: got 1e+300; allowed: less than or equal to 1e+09."),
        (Exposure, {"integration_s": 1e-16}, "integration_s: got 1e-16; allowed: greater than or equal to 1e-15."),
        (Pixel, {"full_well_e": 1e-300}, "full_well_e: got 1e-300; allowed: greater than or equal to 1."),
        (Pixel, {"bits": True}, "bits: got True; allowed: a number or a name."),
        (Run, {"pixel": {"prnu": 1e9}}, "pixel.prnu: got 1000000000.0; allowed: less than or equal to 0.3."),
        (Display, {"gamma": 1e-9}, "gamma: got 1e-09; allowed: greater than or equal to 0.01."),
    ],
)
def test_bounds_are_told_as_a_reader_writes_them(record, values, told):
    with pytest.raises(ValidationError) as refusal:
        record.model_validate(values)
    assert told in explain(refusal.value)


def test_what_the_issue_names_is_within_the_bounds():
    for pitch_um in (0.3, 100.0):
        for kelvin in (77, 400):
            for bits in (1, 24):
                pixel = Pixel(pitch_um=pitch_um, fill_factor=1e-12, temperature_k=kelvin, bits=bits, read_noise_e=0)
                assert derive(pixel).full_well_e > 0
    assert Pixel(fill_factor=1.0, full_well_e=1e15, dark_current_e_per_s=1e15).fill_factor == 1
    assert Exposure(integration_s=1e-9).integration_s < Exposure(integration_s=36_000).integration_s
    assert Display(white_cd_per_m2=1e-9).white_cd_per_m2 < Display(white_cd_per_m2=1e12).white_cd_per_m2
    assert Study(name="x", paper=False).paper is False
