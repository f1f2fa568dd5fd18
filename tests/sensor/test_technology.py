"""Technologies: files, sources, ranges, invalid values, and names in results."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from pixsim.base.errors import PixsimError
from pixsim.base.toml import packaged, read_toml
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import NUMBERS, Pixel
from pixsim.sensor.reading import Readout
from pixsim.sensor.technology import Junction, Technology, load_technology

TECHNOLOGIES = ["0.5um", "0.35um", "0.25um", "0.18um"]
PINNED = ["4t-bsi", "4t-fsi"]
# Fields with a default that a file may leave out.
OPTIONAL = {
    *("response_curve", "fill_factor_inset_features", "dark_current_perimeter_pa_per_cm"),
    *(name for name, number in NUMBERS.items() if number.technology_default is not None),
    *("prnu", "prnu_um", "a_vt_mv_um", "follower_area_um2"),  # one in place of another
}
OPTIONAL |= {
    name for name in Technology.model_fields if name.startswith(("stack_", "quantum_efficiency_"))
}
T035 = load_technology("0.35um")


# --- Files ---


def test_load_technology_packaged_names():
    assert set(packaged("data/technologies")) == {*TECHNOLOGIES, *PINNED}


def text_of_035um() -> str:
    return packaged("data/technologies")["0.35um"].read_text(encoding="utf-8")


@pytest.mark.parametrize("name", [*TECHNOLOGIES, *PINNED])
def test_load_technology_numbers_have_source_and_confidence(name):
    table = read_toml(packaged("data/technologies")[name])
    numbers = {key: value for key, value in table.items() if key != "name"}
    common = set(Technology.model_fields) - {
        "name",
        "sources",
        "ranges",
        "distributions",
        "junction",
        "full_well_e_per_um2",
        *OPTIONAL,
    }
    assert set(numbers) - OPTIONAL == common | (
        set(Junction.model_fields) if name in TECHNOLOGIES else {"full_well_e_per_um2"}
    )
    for key, entry in numbers.items():
        assert set(entry) - {"range", "distribution"} == {"value", "confidence", "source"}, key
        assert entry["confidence"] in ("A", "B", "C", "D"), key
        if entry["confidence"] in "CD" and isinstance(entry["value"], float | int):
            assert "range" in entry, (
                f"{key} is derived or assumed, and does not say how far it may be wrong"
            )
        assert not ("range" in entry and entry["confidence"] == "A"), key
        assert len(entry["source"]) > 8, key
    loaded = load_technology(name)
    if name in TECHNOLOGIES:
        assert loaded.feature_size_um == pytest.approx(float(name.removesuffix("um")))
    assert set(loaded.sources) == set(numbers)
    assert loaded.ranges == {
        key: tuple(entry["range"]) for key, entry in numbers.items() if "range" in entry
    }


def test_technology_ranges_hold_known_values():
    """The 0.37 measured at 0.35 µm is plausible for every 3T process; dark current is known to a
    factor of 3, a node to 40 %.
    """
    for name in TECHNOLOGIES:
        ranges = load_technology(name).ranges
        values = load_technology(name).numbers
        low, high = ranges.get("peak_quantum_efficiency", (0.37, 0.37))
        assert low <= 0.37 <= high
        dark = np.array(ranges["dark_current_na_per_cm2"]) / values["dark_current_na_per_cm2"]
        np.testing.assert_allclose(dark, [1 / 3, 3], rtol=0.01)  # written with three digits
        node = np.array(ranges["node_capacitance_ff"]) / values["node_capacitance_ff"]
        np.testing.assert_allclose(node, [0.6, 1.4], rtol=1e-9)


def test_technology_ranges_do_not_change_content():
    """Another range or distribution changes no result, and so no key of a row; another value
    does.
    """
    bare = T035.model_copy(update={"ranges": {}, "sources": {}})
    assert bare.content == T035.content
    normal = Technology.model_validate(T035.model_dump() | {"distributions": {"dsnu": "normal"}})
    assert normal.content == T035.content
    assert normal.with_numbers({"dsnu": 0.2}, "here").distributions == {"dsnu": "normal"}
    assert T035.with_numbers({"dsnu": 0.2}, "here").content == T035.content | {"dsnu": 0.2}
    assert set(T035.content) == set(Technology.model_fields) - {
        "ranges",
        "distributions",
        "sources",
    }


RANGES = [
    ("[0.4, 0.6]", r"range of dsnu: got \[0\.4, 0\.6\]; allowed: low <= 0\.3"),
    ("[0.1, 0.2]", r"range of dsnu: got \[0\.1, 0\.2\]; allowed: low <= 0\.3"),
    ("[0.6, 0.1]", r"range of dsnu: got \[0\.6, 0\.1\]"),
    ("[-0.1, 0.6]", r"range of dsnu: dsnu: got -0\.1; allowed: greater than or equal to 0"),
    ("[0.1, 101]", r"range of dsnu: dsnu: got 101.*less than or equal to 100"),
    ("[0.1, inf]", r"dsnu\.1: got inf; allowed: a finite number"),
    ("[0.1]", r"ranges\.dsnu"),
    ('"wide"', r"ranges\.dsnu: got a text of 4 characters"),
    (
        '[0.1, 0.6]\ndistribution = "flat"',
        (
            r"distributions\.dsnu: got a text of 4 characters; allowed: 'uniform', 'normal' or"
            r" 'lognormal'"
        ),
    ),
    (
        '[0.0, 0.6]\ndistribution = "lognormal"',
        r"range of dsnu: got \[0, 0\.6\]; allowed: 0 < low < high for a lognormal",
    ),
    (
        '[0.3, 0.3]\ndistribution = "lognormal"',
        r"range of dsnu: got \[0\.3, 0\.3\]; allowed: 0 < low < high",
    ),
]


@pytest.mark.parametrize(
    ("written", "instead", "message"),
    [
        *(("range = [0.1, 0.6]", f"range = {each}", message) for each, message in RANGES),
        # A swing above the reset voltage would turn the diode forward.
        (
            "range = [0.9, 1.5]",
            "range = [0.9, 2.3]",
            r"range of voltage_swing_v: .*2\.3 exceeds reset_voltage_v = 2\.2",
        ),
        (
            "range = [0.1, 0.6]",
            'distribution = "normal"',
            r"distribution of dsnu: got 'normal' without a range",
        ),
        ('source = "name of the process"', "", "source"),
        (
            "range = [0.1, 0.6]",
            'distribtion = "normal"',
            r"dsnu: got a text of 11 characters.*Did you mean 'distribution'",
        ),
    ],
)
def test_load_technology_damaged_file_raises(written, instead, message, tmp_path):
    assert written in text_of_035um()
    (tmp_path / "mine.toml").write_text(text_of_035um().replace(written, instead), encoding="utf-8")
    with pytest.raises(PixsimError, match=message) as caught:
        load_technology(str(tmp_path / "mine.toml"))
    assert "mine.toml" in str(caught.value) or "s.dsnu" in str(caught.value)


def test_load_technology_distributions(tmp_path):
    mine = tmp_path / "mine.toml"
    mine.write_text(
        text_of_035um().replace(
            "range = [0.1, 0.6]", 'range = [0.1, 0.6]\ndistribution = "lognormal"'
        ),
        encoding="utf-8",
    )
    loaded = load_technology(str(mine))
    assert loaded.distributions == {"dsnu": "lognormal"}
    assert loaded.ranges == T035.ranges
    assert T035.distributions == {}


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"fill_factor_inset_features": 20}, "fill_factor_inset_features = 20 exceeds"),
        ({"dark_doubling_k": 1e-3}, "dark_doubling_k"),
        ({"full_well_e_per_um2": 1000.0}, "either full_well_e_per_um2 or all of reset_voltage_v"),
        (
            dict.fromkeys(("cj_ff_per_um2", "cjsw_ff_per_um", "node_capacitance_ff"), 0),
            "must be at least 1e-06",
        ),
        ({"voltage_swing_v": 9.0}, r"voltage_swing_v = 9.*reset_voltage_v = 2\.2"),
    ],
)
def test_technology_invalid_values_raise(values, message):
    whole = T035.model_dump()
    if values.keys() <= Junction.model_fields.keys():
        values = {"junction": whole["junction"] | values}
    with pytest.raises(ValidationError, match=message):
        Technology.model_validate(whole | values)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"prnu": None}, "got neither prnu nor prnu_um; give one of them"),
        ({"prnu_um": 0.02}, "got both prnu and prnu_um; give one of them"),
        ({"a_vt_mv_um": 8.0}, "a_vt_mv_um and offset_fpn state the same quantity"),
        ({"a_vt_mv_um": 8.0, "offset_fpn": None}, "got a_vt_mv_um alone; give offset_fpn, or both a_vt_mv_um and follower_area"),
        ({"offset_fpn": None}, "got no offsets; give offset_fpn, or both"),
        ({"a_vt_mv_um": 8.0, "follower_area_um2": 1.0, "offset_fpn": None, "junction": None, "full_well_e_per_um2": 3e3},
         "a_vt_mv_um with full_well_e_per_um2: the node capacitance of a pinned photodiode is unknown; give offset_fpn"),
    ],
)  # fmt: skip
def test_technology_mismatch_is_stated_once(values, message):
    record = T035.model_dump() | {"ranges": {}, "distributions": {}}
    with pytest.raises(PixsimError, match=message):
        Technology(**record | values)


def test_load_technology_mismatch_of_layout_has_ranges(tmp_path):
    """The numbers of the layout are numbers of the file: with source, range and distribution, and a
    study may change them.
    """
    entry = (
        'value = {}\nrange = {}\ndistribution = "normal"\nconfidence = "D"\nsource = "assumed'
        ' here"\n'
    )
    added = {
        "prnu_um": (0.03, [0.02, 0.04]), "a_vt_mv_um": (8.0, [6.0, 10.0]), "follower_area_um2": (0.5, [0.4, 0.6]),
        "dark_current_perimeter_pa_per_cm": (2.0, [1.0, 5.0]), "read_noise_after_gain_e": (20.0, [10.0, 30.0]),
        "hot_pixel_fraction": (0.001, [0.0, 0.01]), "hot_pixel_median": (30.0, [10.0, 90.0]), "hot_pixel_spread": (1.0, [0.5, 1.5]),
    }  # fmt: skip
    kept = [
        part
        for part in text_of_035um().split("\n\n")
        if not part.startswith(("[prnu]", "[offset_fpn]"))
    ]
    text = "\n\n".join(
        [*kept, *(f"[{name}]\n" + entry.format(*values) for name, values in added.items())]
    )
    (tmp_path / "layout.toml").write_text(text, encoding="utf-8")
    technology = load_technology(str(tmp_path / "layout.toml"))
    for name, (value, ends) in added.items():
        assert (technology.numbers[name], technology.ranges[name]) == (value, tuple(ends)), name
        moved = technology.with_numbers({name: ends[1]}, "process.x")
        assert moved.numbers == technology.numbers | {name: ends[1]}
    assert {"prnu", "offset_fpn"}.isdisjoint(technology.numbers)
    with pytest.raises(PixsimError, match=r"process\.x: got 'prnu'; allowed: .*prnu_um"):
        technology.with_numbers({"prnu": 0.02}, "process.x")
    physics = derive(Pixel(), technology)
    assert (physics.hot_pixel_fraction, Readout.of(physics).read_noise_after_gain_e) == (
        0.001,
        20.0,
    )


def test_load_technology_unknown_name_lists_names():
    with pytest.raises(PixsimError, match=r"'0\.13um'") as caught:
        derive(Pixel(technology="0.13um"))
    assert all(name in str(caught.value) for name in TECHNOLOGIES)
    with pytest.raises(PixsimError, match="does not exist"):
        load_technology("nowhere/nowhere.toml")


def test_load_technology_name_of_a_sensor_tells_where_it_belongs():
    """A packaged sensor is a file of settings, whose name may be mistyped, too."""
    with pytest.raises(
        PixsimError, match=r"got 'imx363'.*a packaged sensor, a file of settings: config=imx363\.$"
    ):
        load_technology("imx363")
    with pytest.raises(PixsimError, match=r"got 'imx36'.*Did you mean 'imx363'"):
        load_technology("imx36")


def test_load_technology_user_file(tmp_path):
    mine = tmp_path / "mine.toml"
    mine.write_text(text_of_035um().replace('"0.35um"', '"mine"'))
    physics, packaged_one = (derive(Pixel(technology=name)) for name in (str(mine), "0.35um"))
    assert physics.capacitance_ff == packaged_one.capacitance_ff
    assert load_technology(str(mine)).name == "mine"


# --- Other numbers ---


@pytest.mark.parametrize("name", [*TECHNOLOGIES, *PINNED])
def test_technology_with_numbers_changes_values(name):
    """Every number with a range can be set to both ends; nothing else changes, and the source
    states the old value.
    """
    technology = load_technology(name)
    for number, ends in technology.ranges.items():
        for end in ends:
            moved = technology.with_numbers({number: end}, "process.x")
            assert moved.numbers == technology.numbers | {number: end}
            assert (moved.name, moved.ranges) == (technology.name, technology.ranges)
            assert moved.sources[number].startswith(
                f"set by the study; the file has {technology.numbers[number]:g} ("
            )
            assert moved.sources | {number: technology.sources[number]} == technology.sources


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (
            {"dark_currnt": 1.0},
            r"process\.x: got 'dark_currnt'; allowed: .*node_capacitance_ff.* Did you mean",
        ),
        ({"name": 1.0}, r"process\.x: got 'name'"),
        ({"full_well_e_per_um2": 1.0}, r"process\.x: got 'full_well_e_per_um2'"),  # of a 4T process
        ({"dsnu": -1.0}, r"process\.x: dsnu: got -1\.0; allowed: greater than or equal to 0"),
        ({"peak_quantum_efficiency": 1.1}, r"process\.x: peak_quantum_efficiency: got 1\.1"),
        (
            {"voltage_swing_v": 2.3},
            r"process\.x: junction: voltage_swing_v = 2\.3 exceeds reset_voltage_v = 2\.2",
        ),
    ],
)
def test_technology_with_invalid_numbers_raises(values, message):
    with pytest.raises(PixsimError, match=message):
        T035.with_numbers(values, "process.x")
