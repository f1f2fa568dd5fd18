"""Pixels and their colours: what they state, what the file of a technology or a camera does, and what
notes say of both.
"""

from pathlib import Path

import numpy as np
import pytest
from helpers.claims import check
from helpers.statistics import seeded

import pixsim
from pixsim.base.errors import MAX_LABEL, PixsimError
from pixsim.base.toml import packaged, read_toml
from pixsim.light.spectral import VISIBLE, WIDEST, SpectralImage, Spectrum
from pixsim.optics.lens_defocus import DEPTHS
from pixsim.sensor.colour import Layout
from pixsim.sensor.colour_options import PATTERNS, channels_of
from pixsim.sensor.integration import lights_of, mean_signal_rate
from pixsim.sensor.labels import file_label, label_of, labels_of
from pixsim.sensor.pixel import PixelPhysics, derive, spread_registration
from pixsim.sensor.pixel_notes import pixel_notes, share_beyond, tables_of
from pixsim.sensor.pixel_options import NUMBERS, Pixel
from pixsim.sensor.raw import read_frame, write_frame
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import make_sensor
from pixsim.sensor.spectral_range import CENTRES_NM, OUTSIDE, outside_header, outside_share, span_of
from pixsim.sensor.technology import Junction, Technology, load_technology
from pixsim.sensor.unit_slips import SLIPS, unit_slips
from pixsim.viewer.merging import merge

SHEET = {
    "pitch_um": 4.0,
    "full_well_e": 10_000.0,
    "read_noise_e": 2.0,
    "dark_current_e_per_s": 5.0,
    "quantum_efficiency": 0.6,
    "bits": 12,
}
PEAK = {"peak_quantum_efficiency": 0.5}
FLAT = [[nm, 0.4] for nm in range(400, 901, 10)]
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


def bsi(**fields) -> PixelPhysics:
    """A pixel of 4 µm without a stack."""
    return derive(
        Pixel(**{"technology": "4t-bsi", "pitch_um": 4.0, "stack": {"enabled": False}} | fields)
    )


def physics(**over) -> PixelPhysics:
    """A data sheet with numbers in place of those that state the same."""
    return derive(Pixel.model_validate(merge({"pixel": SHEET}, {"pixel": over})["pixel"]))


# Name, pixel, attribute of the pixel or of its readout, and value.


@pytest.mark.parametrize(
    ("name", "pixel", "attribute", "expected"),
    [
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
        (
            "mismatch of a process",
            derive(Pixel(), LAYOUT_PROCESS),
            "prnu",
            0.03 / derive(Pixel()).photodiode_side_um,
        ),
        ("PRNU of the pixel goes first", derive(Pixel(prnu=0.01), LAYOUT_PROCESS), "prnu", 0.01),
        ("in per cent", derive(Pixel(prnu_percent=2), LAYOUT_PROCESS), "prnu", 0.02),
        ("DSNU_1288 too", derive(Pixel(dsnu_e=3.0), LAYOUT_PROCESS), "offset_fpn_e", 3.0),
        (
            "a pixel's area with the process's A_Vt",
            derive(Pixel(follower_area_um2=2.0), LAYOUT_PROCESS),
            "offset_fpn_e",
            derive(Pixel(**LAYOUT)).offset_fpn_e / 2,
        ),
        (
            "a stated dark current",
            derive(Pixel(dark_current_e_per_s=7)),
            "dark_current_e_per_s",
            7.0,
        ),
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
            physics(saturation_capacity_e=9000, gain_e_per_dn=2.5, black_level_dn=0).full_well_e,
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
    ],
)
def test_values_of_a_pixel(name: str, pixel: PixelPhysics, attribute: str, expected) -> None:
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
    """Noise in electrons stays."""
    words = gain | {"saturation_capacity_e": 9000, "dsnu_e": 2.0, "bits": 14}
    well_e = physics(**words).full_well_e
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
    before: dict, later: dict, left: dict
) -> None:
    assert merge({"pixel": before}, {"pixel": later}) == {"pixel": left}


def test_a_sheet_of_efficient_channels_needs_no_technology() -> None:
    channels = dict.fromkeys("RGB", FLAT)
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


NAMES = sorted(packaged("data/technologies"))
T035 = load_technology("0.35um")
TEXT = packaged("data/technologies")["0.35um"].read_text(encoding="utf-8")
# Fields with a default that a file may leave out, or of which one stands in place of another.
OPTIONAL = {
    *("response_curve", "fill_factor_inset_features", "dark_current_perimeter_pa_per_cm"),
    *("prnu", "prnu_um", "a_vt_mv_um", "follower_area_um2"),
    *(name for name, number in NUMBERS.items() if number.technology_default is not None),
    *(name for name in Technology.model_fields if name.startswith(("stack_", "quantum_"))),
}
OF_RECORD = {"name", "sources", "ranges", "distributions", "junction", "full_well_e_per_um2"}


def load(tmp_path: Path, text: str) -> Technology:
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return load_technology(str(path))


@pytest.mark.parametrize("name", NAMES)
def test_every_number_of_a_file_has_source_and_confidence(name: str) -> None:
    """And what is derived or assumed says how far it may be wrong."""
    numbers = read_toml(packaged("data/technologies")[name])
    del numbers["name"]
    well = {"full_well_e_per_um2"} if name.startswith("4t") else set(Junction.model_fields)
    assert set(numbers) - OPTIONAL == set(Technology.model_fields) - OF_RECORD - OPTIONAL | well
    for key, entry in numbers.items():
        assert set(entry) - {"range", "distribution"} == {"value", "confidence", "source"}, key
        is_uncertain = entry["confidence"] in "CD" and not isinstance(entry["value"], str)
        assert ("range" in entry) >= is_uncertain, key
        assert ("range" in entry) <= (entry["confidence"] in "BCD"), key
        assert len(entry["source"]) > 8, key


@pytest.mark.parametrize("name", NAMES)
def test_every_number_with_a_range_can_be_set_to_both_ends(name: str) -> None:
    """Nothing else changes, and the source states the old value."""
    technology = load_technology(name)
    for number, ends in technology.ranges.items():
        for end in ends:
            changed = technology.with_numbers({number: end}, "process.x")
            assert changed.numbers == technology.numbers | {number: end}
            old = f"set by the study; the file has {technology.numbers[number]:g} ("
            assert changed.sources[number].startswith(old)
            assert changed.sources | {number: technology.sources[number]} == technology.sources


def test_ranges_and_sources_do_not_change_the_key_of_a_row() -> None:
    assert (
        T035.model_copy(update={"ranges": {}, "sources": {}, "distributions": {}}).content
        == T035.content
    )
    assert T035.with_numbers({"dsnu": 0.2}, "here").content == T035.content | {"dsnu": 0.2}


@pytest.mark.parametrize(
    ("written", "instead", "words"),
    [
        ("range = [0.1, 0.6]", "range = [0.4, 0.6]", "range of dsnu: .*low <= 0.3"),
        ("range = [0.1, 0.6]", "range = [0.1, 0.2]", "range of dsnu: .*low <= 0.3"),
        ("range = [0.1, 0.6]", "range = [-0.1, 0.6]", "range of dsnu: dsnu: got -0.1"),
        ("range = [0.1, 0.6]", "range = [0.1]", "ranges.dsnu"),
        ("range = [0.1, 0.6]", 'range = "wide"', "ranges.dsnu"),
        ("range = [0.1, 0.6]", 'range = [0.1, 0.6]\ndistribution = "flat"', "distributions.dsnu"),
        (
            "range = [0.1, 0.6]",
            'range = [0.0, 0.6]\ndistribution = "lognormal"',
            "range of dsnu: .*0 < low < high",
        ),
        ("range = [0.1, 0.6]", 'distribution = "normal"', "without a range"),
        ("range = [0.1, 0.6]", 'distribtion = "normal"', "Did you mean 'distribution'"),
        ("range = [0.9, 1.5]", "range = [0.9, 2.3]", "voltage_swing_v: .*2.3 exceeds"),
        ('source = "name of the process"', "", "source"),
        ('name = "0.35um"', 'name = "=mine"', "another name"),
    ],
)
def test_damaged_files_are_refused(written: str, instead: str, words: str, tmp_path: Path) -> None:
    assert written in TEXT
    with pytest.raises(PixsimError, match=words):
        load(tmp_path, TEXT.replace(written, instead))


def test_file_of_a_user_may_state_distributions_and_another_name(tmp_path: Path) -> None:
    lognormal = TEXT.replace("[0.1, 0.6]", '[0.1, 0.6]\ndistribution = "lognormal"')
    technology = load(tmp_path, lognormal.replace('"0.35um"', '"mine"'))
    assert (technology.name, technology.distributions) == ("mine", {"dsnu": "lognormal"})
    assert technology.ranges == T035.ranges
    assert technology.with_numbers({"dsnu": 0.2}, "here").distributions == technology.distributions


# Mismatch of a layout in place of PRNU and offsets, and numbers that a pixel may state too.
FILE_LAYOUT = LAYOUT | {
    "dark_current_perimeter_pa_per_cm": 2.0,
    "read_noise_after_gain_e": 20.0,
    "hot_pixel_fraction": 0.001,
    "hot_pixel_median": 30.0,
    "hot_pixel_spread": 1.0,
}


def test_file_may_state_mismatch_of_the_layout(tmp_path: Path) -> None:
    entry = 'confidence = "D"\nsource = "assumed here"\ndistribution = "normal"\n'
    parts = [part for part in TEXT.split("\n\n") if part[:6] not in ("[prnu]", "[offse")]
    for name, value in FILE_LAYOUT.items():
        parts.append(f"[{name}]\nvalue = {value}\nrange = [{value / 2}, {value}]\n{entry}")
    technology = load(tmp_path, "\n\n".join(parts))
    for name, value in FILE_LAYOUT.items():
        assert (technology.numbers[name], technology.ranges[name]) == (value, (value / 2, value))
    assert {"prnu", "offset_fpn"}.isdisjoint(technology.numbers)
    physics = derive(Pixel(), technology)
    assert (physics.hot_pixel_fraction, physics.hot_pixel_median) == (0.001, 30.0)
    assert Readout.of(physics).read_noise_after_gain_e == 20.0


@pytest.mark.parametrize(
    ("technologies", "labels"),
    [
        (["0.35um", "0.25um"], ["0.35um", "0.25um"]),
        (["/home/me/mine.toml", "b/mine.toml", "c.d/mine.toml"], ["mine", "mine-2", "mine-3"]),
        # mine-2 is the plain label of another technology; some file systems ignore case
        (["a/mine.toml", "b/mine.toml", "mine-2.toml"], ["mine", "mine-3", "mine-2"]),
        (["a/Mine.toml", "b/mine.toml"], ["Mine", "mine-2"]),
        (["none", "data sheet.toml"], ["data sheet", "data sheet-2"]),
        (["0.35um", "mine/0.35um.toml"], ["0.35um", "0.35um-2"]),
        ([f"a/{'n' * 100}1.toml"], [f"{'n' * (MAX_LABEL - 1)}…"]),
        (["x/two\nlines\t \x1b[31m.toml"], [r"two lines \x1b[31m"]),
    ],
)
def test_labels_are_unique_and_a_printable_line(technologies: list[str], labels: list[str]) -> None:
    assert list(labels_of(technologies)) == labels
    assert len({file_label(label).casefold() for label in labels}) == len(labels)
    assert file_label(label_of("none")) == "data_sheet"


NM = np.arange(365.0, 1100.0, 10.0)


def light(spectrum: np.ndarray, **header) -> SpectralImage:
    data = np.broadcast_to(spectrum, (8, 8, NM.size)).copy()
    return SpectralImage(NM, 10.0, 5.0, data=data, header={"diffraction": False, **header})


PHOTONS = light(1e-3 / NM)  # as many photons in each band
# 310 nm of photons of 800 to 1110 nm are not computed, of one lamp of two.
LAMPS = [(1e-3 / CENTRES_NM).tolist(), (CENTRES_NM < 800).astype(float).tolist()]
COMPUTED = light(np.where(NM < 830, 1e-3 / NM, 0.0), **{OUTSIDE: LAMPS})


@pytest.mark.parametrize(
    ("physics", "image", "share"),
    [
        (bsi(quantum_efficiency=[[400, 0.4], [900, 0.4]]), PHOTONS, 2 / 7),
        # From 902 to 906 nm there is 0.4 of one band, beside 50 bands below 900 nm.
        (
            bsi(quantum_efficiency=[[400, 0.4], [902, 0.4]], infrared_cut_nm=906.0),
            PHOTONS,
            0.4 / 50.4,
        ),
        (bsi(quantum_efficiency=[[400, 0.4], [800, 0.4]]), COMPUTED, 310 / 710),
        (bsi(quantum_efficiency=[[400, 0.4], [900, 0.0]]), PHOTONS, 0.0),
        (bsi(quantum_efficiency=[[400, 0.4], [1100, 0.4]]), PHOTONS, 0.0),
        (bsi(quantum_efficiency=[[400, 0.4], [900, 0.4]], infrared_cut_nm=900.0), PHOTONS, 0.0),
    ],
)
def test_share_beyond_a_table_is_that_of_its_last_value(
    physics: PixelPhysics, image: SpectralImage, share: float
) -> None:
    """There is a note where it is more than 1 %."""
    (curve,) = tables_of(physics).values()
    check("share", share_beyond(curve, image, physics), share, atol=1e-7, why="float32 of light")
    notes = [
        note
        for note in pixel_notes(physics, pixsim.Camera(die_mm=0.04), image)
        if "ends at" in note
    ]
    assert len(notes) == (share > 0.01)


@pytest.mark.parametrize(
    ("physics", "image", "words"),
    [
        (
            bsi(colour={"quantum_efficiencies": dict.fromkeys("RGB", FLAT)}),
            PHOTONS,
            "efficiencies of G ends at 900",
        ),
        (
            bsi(colour={"sensitivities": "Nikon_D5100", **PEAK}),
            PHOTONS,
            "each channel of Nikon_D5100",
        ),
        (bsi(colour={"sensitivities": "Nikon_D810", **PEAK}), PHOTONS, ""),
        (bsi(quantum_efficiency=0.5), light(1e-3 / NM, **{DEPTHS: [0.1, 0.1, 0.1]}), "0.1 m"),
        (bsi(quantum_efficiency=0.5), light(1e-3 / NM, **{DEPTHS: [0.5, None, 2.0]}), ""),
        (bsi(quantum_efficiency=0.5), light(1e-3 / NM, **{DEPTHS: "near"}), ""),
    ],
)
def test_notes_appear_when_they_should(
    physics: PixelPhysics, image: SpectralImage, words: str
) -> None:
    notes = pixel_notes(
        physics, pixsim.Camera(die_mm=0.04, object_distance_m=1e3, f_number=1.0), image
    )
    assert [note for note in notes if words in note] if words else not notes


def test_light_outside_the_computed_range_widens_it_or_is_noted() -> None:
    """A lamp of equal power at 300 to 1110 nm; an infrared filter needs no more than 830 nm."""
    lamp = Spectrum(np.array([300.0, 1110.0]), np.ones(2))
    wide = span_of([lamp], [bsi(quantum_efficiency=0.5)])
    assert (wide.low_nm, wide.high_nm) == (WIDEST.low_nm, WIDEST.high_nm)
    assert (
        span_of([lamp], [bsi(quantum_efficiency=0.5, infrared_cut_nm=650.0)]).high_nm
        == VISIBLE.high_nm
    )
    widest = outside_share(outside_header([lamp], WIDEST), bsi(quantum_efficiency=0.5))
    assert widest == pytest.approx((1110**2 - 1100**2) / (1110**2 - 300**2), rel=1e-3)


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
def test_number_in_another_unit_is_noted(slip: dict, usual: dict, mended: str) -> None:
    values = {name: value for name, value in (SHEET | usual).items() if value is not None}
    assert not unit_slips(Pixel(**values))
    if slip:
        values = {name: value for name, value in (SHEET | slip).items() if value is not None}
        (note,) = unit_slips(Pixel(**values))
        assert mended in note


def test_both_fields_of_a_slip_exist() -> None:
    names = {*SLIPS, *(slip.meant for slip in SLIPS.values() if slip.meant)}
    assert names <= Pixel.model_fields.keys() | pixsim.Camera.model_fields.keys()


BANDS_NM = np.arange(405.0, 700.0, 10.0)
SMALL = pixsim.Camera(die_mm=0.1)
GRID = np.arange(400.0, 701.0, 10.0)


def bell(centre_nm: float, peak: float = 0.5) -> list[list[float]]:
    """A curve of a channel."""
    return np.stack([GRID, peak * np.exp(-(((GRID - centre_nm) / 40) ** 2))], axis=1).tolist()


CURVES = {"R": bell(600), "G": bell(540), "B": bell(460), "W": bell(550, 0.9), "C": bell(520, 0.8)}
RGB = {"quantum_efficiencies": {letter: CURVES[letter] for letter in "RGB"}}


def picture() -> SpectralImage:
    """A smooth picture whose colour changes over it, of two independent spectra."""
    y, x = np.mgrid[:96, :96] / 96
    pictures = 1 + 0.5 * np.sin(9 * x + 4 * y + 3), 1 + 0.4 * np.cos(7 * y - 3 * x)
    spectra = 1e-3 * np.exp(-(((BANDS_NM - np.array([[480], [610]])) / 60) ** 2))
    factors = spectra, np.array(pictures, np.float32)
    return SpectralImage(
        BANDS_NM, np.full(BANDS_NM.size, 10.0), SMALL.die_um[1] / 96, factors=factors
    )


def signal(colour: dict | None, **fields) -> np.ndarray:
    return mean_signal_rate(picture(), SMALL, bsi(colour=colour, **fields))


@pytest.mark.parametrize(
    "cell",
    [
        *({"pattern": name} for name in PATTERNS),
        {"matrix": ["RGBW", "WRGB"]},
        {"matrix": ["RB", "GG", "WW"]},
    ],
    ids=lambda cell: str(next(iter(cell.values()))),
)
@pytest.mark.parametrize("pitch_um", [4.0, 3.45], ids=["odd", "even"])
def test_each_pixel_has_the_signal_of_its_channel(cell: dict, pitch_um: float) -> None:
    """That of a monochrome sensor of the channel's quantum efficiency."""
    letters = channels_of(cell.get("matrix") or PATTERNS[cell["pattern"]])
    colour = cell | {"quantum_efficiencies": {letter: CURVES[letter] for letter in letters}}
    layout = Layout.of(bsi(colour=colour).pixel)
    alone = [
        signal(None, quantum_efficiency=CURVES[letter], pitch_um=pitch_um) for letter in letters
    ]
    expected = np.concatenate(alone)
    if not layout.is_stacked:
        rows, columns = alone[0].shape
        cells = np.tile([list(row) for row in layout.cell], alone[0].shape)
        at_pixel = cells[:rows, :columns]
        expected = np.select([at_pixel == letter for letter in letters], alone)
    np.testing.assert_allclose(signal(colour, pitch_um=pitch_um), expected, rtol=1e-12)


def test_transmittances_multiply_the_response_of_the_pixel() -> None:
    """The pixel as a whole has the mean over its unit cell: two green pixels in four."""
    unfiltered = bsi(infrared_cut_nm=650.0).quantum_efficiency(BANDS_NM)
    filters = {"transmittances": RGB["quantum_efficiencies"]}
    pixel = bsi(colour=filters, infrared_cut_nm=650.0)
    efficiencies = np.array([channel.quantum_efficiency(BANDS_NM) for channel in pixel.channels])
    filters = [np.interp(BANDS_NM, *np.transpose(CURVES[letter])) for letter in "RGB"]
    np.testing.assert_allclose(efficiencies, filters * unfiltered, rtol=1e-12)
    np.testing.assert_allclose(
        pixel.quantum_efficiency(BANDS_NM), [0.25, 0.5, 0.25] @ efficiencies, rtol=1e-12
    )


def test_crosstalk_mixes_colours_before_noise() -> None:
    """Uniform light: a red pixel keeps 1 - c of red and gets c of green; a green one c/2 of red and
    of blue. Also at the border.
    """
    data = np.full((100, 100, BANDS_NM.size), 1e-3)
    uniform = SpectralImage(BANDS_NM, 10.0, 1.0, data=data, header={"diffraction": False})
    slow = pixsim.Camera(die_mm=0.1, f_number=1e3)
    stack = {"height_um": 4.0, "index": 1.5, "microlens": "none"}
    cells = [
        mean_signal_rate(uniform, slow, bsi(colour=RGB, stack=stack | {"crosstalk": crosstalk}))
        for crosstalk in (0.0, 0.2)
    ]
    (red, green), (_, blue) = cells[0][:2, :2]
    mixed_green = 0.8 * green + 0.1 * (red + blue)
    cell = [[0.8 * red + 0.2 * green, mixed_green], [mixed_green, 0.8 * blue + 0.2 * green]]
    # Openings show less of the lens off the axis.
    np.testing.assert_allclose(cells[1], np.tile(cell, (13, 13))[:25, :25], rtol=3e-3)


def test_each_channel_is_lit_by_its_own_spectrum() -> None:
    illuminations = [
        channel.illumination for channel in lights_of(picture(), SMALL, bsi(colour=RGB))
    ]
    assert len({illumination.weight for illumination in illuminations}) == 3


# --- Files


@pytest.mark.parametrize("suffix", [".tiff", ".png", ".exr", ".npz"])
@pytest.mark.parametrize("pattern", ["gbrg", "stacked", "quad_rggb"])
def test_raw_files_carry_the_layout(suffix: str, pattern: str, tmp_path: Path) -> None:
    sensor = make_sensor(bsi(colour=RGB | {"pattern": pattern}).pixel, SMALL)
    frame = pixsim.capture(picture(), SMALL, sensor, rng=seeded(1))
    assert frame.pixels == (25, 25)
    path = tmp_path / f"raw{suffix}"
    write_frame(path, frame)
    stored = read_frame(path)
    assert stored.layout == frame.layout == Layout(PATTERNS[pattern], pattern == "stacked")
    np.testing.assert_array_equal(stored.dn, frame.dn)


@pytest.mark.parametrize("text", ["RG/G", "rg/gb", "R+G/B", "", "R+", "1/2"])
def test_unknown_layout_of_a_file_is_left_out(text: str, tmp_path: Path) -> None:
    np.savez(tmp_path / "raw.npz", dn=np.ones((2, 2), np.uint8), layout=text)
    assert read_frame(tmp_path / "raw.npz").layout is None
    with pytest.raises(ValueError, match="allowed: rows of capital letters"):
        Layout.parse(text)


FILE = "# made up\nnm;red;green;blue\n" + "\n".join(f"{nm:g};0,5;0,4;0,3" for nm in GRID)


@pytest.mark.parametrize("text", [FILE, FILE.replace("nm;red;green;blue\n", "")])
def test_curves_of_a_file_with_and_without_a_title(text: str, tmp_path: Path) -> None:
    path = tmp_path / "qe.csv"
    path.write_text(text, encoding="utf-8")
    colour = bsi(colour={"quantum_efficiencies": str(path)}).pixel.colour
    values = {letter: curve[3] for letter, curve in colour.curves.items()}
    assert values == {"R": (430, 0.5), "G": (430, 0.4), "B": (430, 0.3)}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (FILE.replace("green", "red"), "two channels R"),
        (FILE.replace(";blue", ""), "2 channels in the title and 3 values"),
        (FILE.replace("0,5;0,4;0,3", "0,5;0,4;x", 3), "no 3 numbers in line"),
        ("nm,r\n400,0.5\n700,0.4\n", "3 values|no 3 numbers"),
        ("", "at least|values"),
    ],
)
def test_damaged_curves_are_refused(text: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "qe.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=words):
        bsi(colour={"quantum_efficiencies": str(path)})
