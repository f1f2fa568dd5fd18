"""What a pixel states, what its technology does, and which of them goes first."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.claims import check

from pixsim.base.toml import packaged
from pixsim.sensor.pixel import PixelPhysics, derive, spread_registration
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.reading import Readout
from pixsim.sensor.technology import Technology, load_technology
from pixsim.viewer.merging import merge

SHEET: dict[str, Any] = {
    "pitch_um": 4.0,
    "full_well_e": 10_000.0,
    "read_noise_e": 2.0,
    "dark_current_e_per_s": 5.0,
    "quantum_efficiency": 0.6,
    "bits": 12,
}
BSI = {"technology": "4t-bsi", "pitch_um": 1.4}
# Mismatch of a layout, and read noise on both sides of the amplifier.
LAYOUT = {"prnu_um": 0.03, "a_vt_mv_um": 8.0, "follower_area_um2": 0.5}
LAYOUT_PROCESS = Technology.model_validate(
    load_technology("0.35um").model_dump()
    | {"ranges": {}, "distributions": {}, "prnu": None, "offset_fpn": None}
    | LAYOUT
)
NOISY_PROCESS = load_technology("4t-bsi").model_copy(
    update={"read_noise_e": 3.0, "read_noise_after_gain_e": 4.0}
)
SIDE_UM = math.sqrt(derive(Pixel()).fill_factor) * 6.5


def physics(**over: Any) -> PixelPhysics:
    """A data sheet with numbers in place of those that state the same."""
    return derive(Pixel.model_validate(merge({"pixel": SHEET}, {"pixel": over})["pixel"]))


# Name, pixel, attribute of the pixel or of its readout, and value.
VALUES: list[tuple[str, PixelPhysics, str, Any]] = [
    ("stated fill factor", physics(fill_factor=0.9), "photodiode_area_um2", 0.9 * 16),
    ("fixed patterns are shares of the well", physics(offset_fpn=1e-3), "offset_fpn_e", 10.0),
    ("columns too", physics(column_fpn=2e-3), "column_fpn_e", 20.0),
    ("codes above black span the well", physics(black_level_dn=95), "dn_per_e", 0.4),
    ("pinned photodiodes have no kTC", derive(Pixel(**BSI)), "reset_noise_e", 0.0),
    ("nor a known capacitance", derive(Pixel(**BSI)), "capacitance_ff", None),
    ("a sheet states its doubling", physics(), "dark_doubling_k", 8.0),
    (
        "of its dark current",
        physics(dark_current={"e_per_s": 1.0, "at_c": 20.0, "doubling_k": 6.0}),
        "dark_doubling_k",
        6.0,
    ),
    ("mismatch of a process", derive(Pixel(), LAYOUT_PROCESS), "prnu", 0.03 / SIDE_UM),
    ("PRNU of the pixel goes first", derive(Pixel(prnu=0.01), LAYOUT_PROCESS), "prnu", 0.01),
    ("in per cent", derive(Pixel(prnu_percent=2), LAYOUT_PROCESS), "prnu", 0.02),
    ("DSNU_1288 too", derive(Pixel(dsnu_e=3.0), LAYOUT_PROCESS), "offset_fpn_e", 3.0),
    (
        "a pixel's area with the process's A_Vt",
        derive(Pixel(follower_area_um2=2.0), LAYOUT_PROCESS),
        "offset_fpn_e",
        derive(Pixel(**LAYOUT)).offset_fpn_e / 2,
    ),
    ("a stated dark current", derive(Pixel(dark_current_e_per_s=7)), "dark_current_e_per_s", 7.0),
    # A technology's noise after the amplifier belongs to its own read noise.
    ("noise of a process", derive(Pixel(**BSI), NOISY_PROCESS), "noise_floor_e", 5.0),
    *(
        (
            f"noise of a pixel {options}",
            derive(Pixel(**BSI | options), NOISY_PROCESS),
            "noise_floor_e",
            value,
        )
        for options, value in (
            ({"read_noise_e": 2.0}, 2.0),
            ({"read_noise_e": 12.0, "read_noise_after_gain_e": 5.0}, 13.0),
            ({"read_noise_after_gain_e": 0.0}, 3.0),
            ({"temporal_dark_noise_e": 2.5}, 2.5),
        )
    ),
    # An ADC that is stated stays at every pitch, and else grows with the well.
    ("stated ADC", derive(Pixel(pitch_um=15, adc_full_scale_e=4e4)), "dn_per_e", 1023 / 4e4),
    (
        "ADC of the well",
        derive(Pixel(pitch_um=15)),
        "dn_per_e",
        1023 / derive(Pixel(pitch_um=15)).full_well_e,
    ),
    ("the aperture under a microlens", derive(Pixel(**BSI)), "aperture_side_um", 1.4),
    *(
        (
            f"PRNU of 0.03 µm at {pitch_um:g} µm of {technology}",
            derive(Pixel(technology=technology, pitch_um=pitch_um, prnu_um=0.03)),
            "prnu",
            0.03 / derive(Pixel(technology=technology, pitch_um=pitch_um)).photodiode_side_um,
        )
        for technology in ("0.18um", "4t-bsi")
        for pitch_um in (6.0, 9.0)
    ),
    (
        "an ADC stated by its range solves the same well as one by its gain",
        physics(saturation_capacity_e=9000, adc_full_scale_e=4095 * 2.5),
        "full_well_e",
        physics(saturation_capacity_e=9000, gain_e_per_dn=2.5).full_well_e,
    ),
    # [x, y] = 0.5 + 0.25, 0.5 + 0.75 - 1.
    (
        "registration of a repeat",
        derive(Pixel()).registered(1, (0.25, 0.75)),
        "registration",
        (0.25, 0.75),
    ),
    (
        "a stated registration stays",
        derive(Pixel(registration=(0.1, 0.2))).registered(1),
        "registration",
        (0.2, 0.1),
    ),
    ("a border of 1.5 pixels", physics(), "border_um", 6.0),
]


@pytest.mark.parametrize(("name", "pixel", "attribute", "expected"), VALUES)
def test_values_of_a_pixel(name: str, pixel: PixelPhysics, attribute: str, expected: Any) -> None:
    value = getattr(pixel, attribute, None)
    if not hasattr(pixel, attribute):
        value = getattr(Readout.of(pixel), attribute)
    if expected is None:
        assert value is None, name
        return
    check(f"{name}: {attribute}", value, expected, rtol=1e-12, why="rounding")


@pytest.mark.parametrize("gain", [{"gain_e_per_dn": 2.5}, {"dn_per_e": 0.4}])
@pytest.mark.parametrize("pitch_um", [2.0, 8.0])
def test_a_saturation_capacity_is_solved_once_and_scales_with_the_area(
    gain: dict[str, float], pitch_um: float
) -> None:
    """9000 e- is the peak of the variance of a well 3.5 % larger; noise in electrons stays."""
    words = gain | {"saturation_capacity_e": 9000, "dsnu_e": 2.0, "bits": 14}
    well_e = physics(**words).full_well_e
    assert well_e == pytest.approx(9000 * 1.035, rel=0.01)
    scaled = physics(**words, data_sheet_pitch_um=4.0, pitch_um=pitch_um)
    area = (pitch_um / 4) ** 2
    values = scaled.full_well_e, 1 / Readout.of(scaled).dn_per_e, scaled.dark_current_e_per_s
    assert values == pytest.approx((well_e * area, 2.5 * area, 5 * area), rel=1e-12)
    assert (scaled.offset_fpn_e, Readout.of(scaled).read_noise_e) == (2.0, 2.0)


@pytest.mark.parametrize(
    ("before", "later", "left"),
    [
        ({"a_vt_mv_um": 8, "follower_area_um2": 1}, {"offset_fpn": 0.001}, {"offset_fpn": 0.001}),
        ({"offset_fpn": 0.001}, {"a_vt_mv_um": 8}, {"a_vt_mv_um": 8}),
        ({"a_vt_mv_um": 8}, {"follower_area_um2": 1}, {"a_vt_mv_um": 8, "follower_area_um2": 1}),
        ({"prnu_um": 0.02}, {"prnu_percent": 1}, {"prnu_percent": 1}),
        ({"adc_full_scale_e": 9000}, {"dn_per_e": 0.4}, {"dn_per_e": 0.4}),
        (
            {"read_noise_e": 2, "read_noise_after_gain_e": 9},
            {"temporal_dark_noise_e": 3},
            {"temporal_dark_noise_e": 3},
        ),
        (
            {"stack": {"height_um": 4.0, "shift": "optimal", "depletion_um": 1.0}},
            {"stack": {"shift_um": [0.1, 0.0], "crosstalk": 0.1}},
            {"stack": {"height_um": 4.0, "shift_um": [0.1, 0.0], "crosstalk": 0.1}},
        ),
        (
            {"colour": {"sensitivities": "Nikon_D5100", "peak_quantum_efficiency": 0.5}},
            {"colour": {"matrix": ["RG", "GB"], "quantum_efficiencies": "qe.csv"}},
            {"colour": {"matrix": ["RG", "GB"], "quantum_efficiencies": "qe.csv"}},
        ),
    ],
)
def test_a_later_layer_replaces_a_quantity_in_any_word(
    before: dict[str, Any], later: dict[str, Any], left: dict[str, Any]
) -> None:
    assert merge({"pixel": before}, {"pixel": later}) == {"pixel": left}


def test_a_sheet_of_efficient_channels_needs_no_technology() -> None:
    channels = {letter: [[nm, 0.4] for nm in range(400, 701, 10)] for letter in "RGB"}
    sheet = {name: value for name, value in SHEET.items() if name != "quantum_efficiency"}
    assert Pixel(**sheet, colour={"quantum_efficiencies": channels}).technology == "none"
    assert Pixel(**sheet, colour={"transmittances": channels}).technology == "0.35um"


def test_a_technology_is_read_once(tmp_path: Path, recwarn: pytest.WarningsRecorder) -> None:
    """Its file may be gone when the pixel is derived; a PRNU as in per cent warns elsewhere."""
    path = tmp_path / "mine.toml"
    path.write_bytes(packaged("data/technologies")["4t-bsi"].read_bytes())
    technology = load_technology(str(path))
    path.unlink()
    assert derive(Pixel(technology=str(path), pitch_um=2.0, prnu=0.2), technology).full_well_e > 0
    assert not recwarn.list


@pytest.mark.parametrize("digits", [1, 4, 8])
def test_spread_registration_is_a_net_for_every_power_of_two(digits: int) -> None:
    """Of 2^m points, each of 2^m equal rectangles of any shape has one: a (0, m, 2)-net in base 2,
    as Sobol' proved.
    """
    points = np.array([spread_registration(repeat) for repeat in range(2**digits)])
    for across in range(digits + 1):
        cells = (points * [2**across, 2 ** (digits - across)]).astype(int)
        assert len(np.unique(cells, axis=0)) == 2**digits
