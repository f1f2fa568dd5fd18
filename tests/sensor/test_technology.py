"""Technologies: files, sources, ranges, and labels in results."""

from __future__ import annotations

from pathlib import Path

import pytest

from pixsim.base.errors import MAX_LABEL, PixsimError
from pixsim.base.toml import packaged, read_toml
from pixsim.sensor.labels import file_label, label_of, labels_of
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import NUMBERS, Pixel
from pixsim.sensor.reading import Readout
from pixsim.sensor.technology import Junction, Technology, load_technology

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
    is_pinned = name.startswith("4t")
    well = {"full_well_e_per_um2"} if is_pinned else set(Junction.model_fields)
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
    bare = T035.model_copy(update={"ranges": {}, "sources": {}, "distributions": {}})
    assert bare.content == T035.content
    assert T035.with_numbers({"dsnu": 0.2}, "here").content == T035.content | {"dsnu": 0.2}


FILES = [
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
]


@pytest.mark.parametrize(("written", "instead", "words"), FILES)
def test_damaged_files_are_refused(written: str, instead: str, words: str, tmp_path: Path) -> None:
    assert written in TEXT
    with pytest.raises(PixsimError, match=words):
        load(tmp_path, TEXT.replace(written, instead))


def test_file_of_a_user_may_state_distributions_and_another_name(tmp_path: Path) -> None:
    lognormal = TEXT.replace("[0.1, 0.6]", '[0.1, 0.6]\ndistribution = "lognormal"')
    technology = load(tmp_path, lognormal.replace('"0.35um"', '"mine"'))
    assert technology.name == "mine"
    assert technology.distributions == {"dsnu": "lognormal"}
    assert technology.ranges == T035.ranges
    changed = technology.with_numbers({"dsnu": 0.2}, "here")
    assert changed.distributions == technology.distributions


# Mismatch of a layout in place of PRNU and offsets, and numbers that a pixel may state too.
LAYOUT = {
    "prnu_um": 0.03,
    "a_vt_mv_um": 8.0,
    "follower_area_um2": 0.5,
    "dark_current_perimeter_pa_per_cm": 2.0,
    "read_noise_after_gain_e": 20.0,
    "hot_pixel_fraction": 0.001,
    "hot_pixel_median": 30.0,
    "hot_pixel_spread": 1.0,
}


def test_file_may_state_mismatch_of_the_layout(tmp_path: Path) -> None:
    entry = 'confidence = "D"\nsource = "assumed here"\ndistribution = "normal"\n'
    parts = [part for part in TEXT.split("\n\n") if part[:6] not in ("[prnu]", "[offse")]
    for name, value in LAYOUT.items():
        parts.append(f"[{name}]\nvalue = {value}\nrange = [{value / 2}, {value}]\n{entry}")
    technology = load(tmp_path, "\n\n".join(parts))
    for name, value in LAYOUT.items():
        assert (technology.numbers[name], technology.ranges[name]) == (value, (value / 2, value))
    assert {"prnu", "offset_fpn"}.isdisjoint(technology.numbers)
    physics = derive(Pixel(), technology)
    assert (physics.hot_pixel_fraction, physics.hot_pixel_median) == (0.001, 30.0)
    assert Readout.of(physics).read_noise_after_gain_e == 20.0


LONG = "n" * 100
STUDIES = [
    (["0.35um", "0.25um"], ["0.35um", "0.25um"]),
    (["/home/me/mine.toml", "b/mine.toml", "c.d/mine.toml"], ["mine", "mine-2", "mine-3"]),
    # mine-2 is the plain label of another technology; some file systems ignore case
    (["a/mine.toml", "b/mine.toml", "mine-2.toml"], ["mine", "mine-3", "mine-2"]),
    (["a/Mine.toml", "b/mine.toml"], ["Mine", "mine-2"]),
    (["none", "data sheet.toml"], ["data sheet", "data sheet-2"]),
    (["0.35um", "mine/0.35um.toml"], ["0.35um", "0.35um-2"]),
    ([f"a/{LONG}1.toml"], [f"{'n' * (MAX_LABEL - 1)}…"]),
    (["x/two\nlines\t \x1b[31m.toml"], [r"two lines \x1b[31m"]),
]


@pytest.mark.parametrize(("technologies", "labels"), STUDIES)
def test_labels_are_unique_and_a_printable_line(technologies: list[str], labels: list[str]) -> None:
    assert list(labels_of(technologies)) == labels
    assert len({file_label(label).casefold() for label in labels}) == len(labels)
    assert file_label(label_of("none")) == "data_sheet"
