"""What axes and conditions make of a study, and that its cases are the studies that one would run
apart.
"""

from __future__ import annotations

import json
import math
import pydoc
import re
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.browser import assert_fits, assert_prints, needs_browser
from helpers.commands import assert_refused, command
from helpers.tiny import COARSE, TINY, keys, rows, tiny, toml_of
from pydantic import ValidationError

import pixsim
from pixsim.base import cache
from pixsim.base.errors import PixsimError
from pixsim.base.layers import nested
from pixsim.report.study_facts import study_notes
from pixsim.studies import prepare as preparation
from pixsim.studies.design import BASE, MAX_CASES, cases_of, check_number, pixel_of
from pixsim.studies.files import load_study
from pixsim.studies.prepare import prepare
from pixsim.studies.result import StudyResult
from pixsim.studies.settings import Axis, Study, axes_of
from pixsim.viewer.chain import ImagingChain
from pixsim.viewer.merging import merge
from pixsim.viewer.without_effect import STREAM

LIGHT = "scene.parameters.luminance_cd_per_m2"
FEW_UM = [5.3, 6.0, 7.0, 8.5, 11.0]
# A chart whose cells are computed, on few pixel sizes: a case takes a fifth of a second.
SMALL = TINY | {
    "paper": False,
    "pitch": {"values_um": FEW_UM},
    "camera": {"die_mm": 0.7},
    "display": {"dots": 32},
}


def axis_of(name: str, setting: str, *values: Any, **more: Any) -> dict[str, Any]:
    """An axis over a setting."""
    return {"name": name, "set": setting, "values": list(values)} | more


def labelled(name: str, **tables: dict[str, Any]) -> dict[str, Any]:
    """An axis of labels, which set these tables."""
    return {
        "name": name,
        "values": [{"label": label, "set": table} for label, table in tables.items()],
    }


def condition_of(name: str, table: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {"name": name, "set": table} | more


def small(**over: Any) -> Study:
    return Study.model_validate(merge(SMALL, over))


def small_toml(**over: Any) -> str:
    return "".join(f"{name} = {toml_of(value)}\n" for name, value in merge(SMALL, over).items())


LENS = labelled(
    "lens", **{"f/2.8": {"camera": {"f_number": 2.8}}, "f/8": {"camera": {"f_number": 8.0}}}
)
PRNU = axis_of("PRNU", "pixel.prnu", 0.01, 0.03, alone=True)
DAY = condition_of("day", {"scene": {"parameters": {"luminance_cd_per_m2": 300.0}}}, weight=3.0)
NIGHT = condition_of("night", {"scene": {"parameters": {"luminance_cd_per_m2": 30.0}}})


# --- values of an axis
# ------------------------------------------------------------------------------------------------


def test_axis_from_zero_is_written_with_its_ends() -> None:
    """The table of an axis, as in settings.toml, makes the same axis again."""
    axis = Axis.model_validate(
        {"name": "PRNU", "set": "pixel.prnu", "from": 0, "to": 0.1, "count": 3}
    )
    assert Axis.model_validate(axis.model_dump(mode="json")) == axis


def test_axis_spacing_has_equal_steps_and_its_ends() -> None:
    points = Axis.model_validate(
        {"name": "a", "set": LIGHT, "from": 1.0, "to": 1000.0, "count": 7, "spacing": "log"}
    ).points
    values = [float(point.value) for point in points]
    assert (values[0], values[-1]) == (1.0, 1000.0)
    np.testing.assert_allclose(np.diff(np.log10(values)), 0.5, atol=2e-6)  # six digits
    both = [LIGHT, "display.white_cd_per_m2"]
    points = Axis.model_validate(
        {"name": "a", "set": both, "from": 4.0, "to": 1.0, "count": 4}
    ).points
    assert [point.value for point in points] == [4.0, 3.0, 2.0, 1.0]
    assert points[1].table == {
        "scene": {"parameters": {"luminance_cd_per_m2": 3.0}},
        "display": {"white_cd_per_m2": 3.0},
    }


ONE_OR_TEXT = r"allowed: a number from -1e\+30 to 1e\+30, or a text"
EACH = "allowed: a number, a name, or a table of label and set"


@pytest.mark.parametrize(
    ("axis", "message"),
    [
        ({}, r"missing: from .*, to, count; allowed: values = \[...\], or from, to and count"),
        ({"values": []}, "values: got an empty list"),
        ({"values": [2, 2]}, "values: 2 occurs twice"),
        ({"values": [2], "to": 3.0}, "values and to both state the values"),
        ({"from": 0.0, "to": 3.0, "count": 3, "spacing": "log"}, "allowed: numbers above 0"),
        ({"set": "pitch.min_um", "values": [2]}, "pixel sizes are an axis of every study"),
        ({"set": "technologies", "values": ["a"]}, "vary pixel.technology by an axis"),
        ({"set": "camera..f", "values": [2]}, "a dotted setting, as camera.f_number"),
        ({"set": None, "values": [2, 3]}, "set: missing"),
        ({"values": [{"label": "a", "set": {"resolution": 9}}]}, "do not go with set"),
        ({"name": "pitch_um", "values": [2]}, "is a column of every study"),
        ({"name": "a=b", "values": [2]}, "a name without = "),
        ({"name": "", "values": [2]}, "a name without = "),
        ({"values": [math.nan]}, "got nan; " + ONE_OR_TEXT),
        ({"values": [-math.inf]}, "got -inf; " + ONE_OR_TEXT),
        ({"values": [10**400]}, r"got 1\d*\.\.\.\d+; " + ONE_OR_TEXT),
        ({"values": [True]}, "got True; allowed: a number or a name"),
        ({"values": [""]}, EACH),
        ({"from": math.nan, "to": 3.0, "count": 3}, "finite number"),
        ({"from": 3.0, "to": 3.0, "count": 3}, "values: 3 occurs twice"),
        ({"from": 2.0, "to": 3.0, "count": 1}, "greater than or equal to 2"),
        (
            {"from": 2.0, "to": 2.1, "count": 900},
            "occurs twice; allowed: values that differ in 4 digits",
        ),
        (
            labelled("a", b={"pixel": {"prnu": None}}) | {"set": None},
            "pixel.prnu = None; allowed: a number, a text or a list",
        ),
        ({"values": [2], "spacing": "log"}, "values and spacing both state the values"),
        (
            {"set": None, "values": [{"label": "b", "set": {"resolution": n}} for n in (20, 30)]},
            "values: b occurs twice",
        ),
        ({"set": "process.0.35um.prnu", "values": [0.1]}, "process.'0.35um'.prnu"),
    ],
)
def test_axis_invalid_values_raise(axis: dict[str, Any], message: str) -> None:
    given = {"name": "a", "set": "camera.f_number"} | axis
    with pytest.raises(ValidationError, match=message):
        Axis.model_validate({name: value for name, value in given.items() if value is not None})


def hot(**pixel: Any) -> dict[str, Any]:
    return condition_of("n", {"pixel": pixel})


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"axis": [LENS, LENS]}, "'lens' occurs twice"),
        (
            {"axis": [LENS, axis_of("N", "camera.f_number", 3)]},
            "camera.f_number is varied by 'lens' and by 'N'",
        ),
        (
            {"axis": [axis_of("light", LIGHT, 3)], "condition": [DAY]},
            "condition 'day': .* varied by the axis 'light'",
        ),
        ({"condition": [DAY | {"weight": 0.0}]}, "all weights are 0"),
        ({"condition": [DAY | {"weight": -1.0}]}, "condition.0.weight"),
        ({"condition": [DAY | {"weight": math.nan}]}, "condition.0.weight"),
        ({"condition": [DAY | {"wieght": 2}]}, "condition.0.wieght"),
        ({"condition": [DAY, DAY]}, "'day' occurs twice"),
        ({"axis": [PRNU], "condition": [hot(prnu=0.0)]}, "pixel.prnu is varied by the axis 'PRNU'"),
        ({"axis": [PRNU], "condition": [hot(prnu_percent=1.0)]}, "pixel.prnu_percent is varied by"),
        (
            {"condition": [hot(technology="0.5um")]},
            "cannot be changed by a condition; .* by an axis",
        ),
        (
            {"technologies": ["0.35um"], "axis": [axis_of("t", "pixel.technology", "0.5um")]},
            "leave technologies out",
        ),
    ],
)
def test_study_contradictory_axes_raise(more: dict[str, object], message: str) -> None:
    with pytest.raises((ValidationError, PixsimError), match=message):
        tiny(**more)


@pytest.mark.parametrize(
    "name",
    [
        *(
            "axis",
            "condition",
            "name",
            "streams",
            "title",
            "sources",
            "sensors",
            "paper",
            "technologies",
            "pitch.min_um",
        ),
        *(
            "seed",
            "repeats",
            "target_ci_um",
            "max_repeats",
            "max_evaluations",
            "iso_delta_e",
            "detail",
            "tolerance_delta_e",
        ),
        "max_seconds",
    ],
)
def test_setting_of_the_whole_study_cannot_be_varied(name: str) -> None:
    """By the settings of an axis, by those of its values, or by a condition."""
    table = nested(name.split("."), 2)
    for more in (
        {"axis": [axis_of("a", name, 2)]},
        {"axis": [labelled("a", b=table)]},
        {"condition": [condition_of("n", table)]},
    ):
        with pytest.raises(
            ValidationError, match=f"{name} cannot be changed by an axis or a condition"
        ):
            tiny(**more)


def test_study_axes_survive_a_round_trip() -> None:
    integration = {"name": "l", "set": "exposure.max_integration_s", "from": 1, "to": 9, "count": 3}
    study = tiny(axis=[LENS, PRNU, integration], condition=[DAY])
    again = Study.model_validate(
        json.loads(json.dumps(study.model_dump(mode="json", exclude_unset=True)))
    )
    assert [case.labels for case in cases_of(again)] == [case.labels for case in cases_of(study)]


# --- cases
# ------------------------------------------------------------------------------------------------------------


def test_cases_of_plain_study_is_itself() -> None:
    (case,) = cases_of(study := tiny())
    assert case.settings is study
    assert (case.words, case.labels) == ("", {})
    assert [case.at for case in cases_of(tiny(condition=[DAY, NIGHT]))] == [{}, {}]


def test_cases_of_moves_alone_begin_with_the_base() -> None:
    cases = cases_of(tiny(axis=[PRNU]))
    assert [(case.at["PRNU"], case.one_at_a_time) for case in cases] == [
        (BASE, ""),
        (0.01, "PRNU"),
        (0.03, "PRNU"),
    ]


def test_cases_of_are_a_product_then_single_moves_each_under_every_condition() -> None:
    integration = axis_of("integration", "exposure.max_integration_s", 0.1, 0.2)
    cases = cases_of(tiny(axis=[LENS, integration, PRNU], condition=[DAY, NIGHT]))
    assert len(cases) == (2 * 2 + 1 + 2) * 2
    words = [f"f/2.8, integration {more}" for more in ("0.1, day", "0.1, night", "0.2, day")]
    assert [case.words for case in cases[:3]] == words
    assert cases[8].at == {"lens": BASE, "integration": BASE, "PRNU": BASE}
    assert [case.words for case in cases[8:12]] == [
        "day",
        "night",
        "PRNU: 0.01, day",
        "PRNU: 0.01, night",
    ]
    assert (
        cases[10].one_at_a_time,
        cases[10].settings.pixel.prnu,
        cases[10].settings.camera.f_number,
    ) == ("PRNU", 0.01, None)
    assert (
        cases[0].settings.camera.f_number,
        cases[0].settings.scene.parameters["luminance_cd_per_m2"],
    ) == (2.8, 300.0)
    assert all(not (case.settings.axis or case.settings.condition) for case in cases)


def test_cases_of_an_axis_may_set_the_technology() -> None:
    names = ("0.5um", "0.25um")
    values = labelled(
        "process", **{name: {"pixel": {"technology": name, "prnu": 0.02}} for name in names}
    )
    for axis in (axis_of("process", "pixel.technology", *names), values):
        assert [case.settings.technologies for case in cases_of(tiny(axis=[axis]))] == [
            (name,) for name in names
        ]
    assert [case.settings.pixel.prnu for case in cases_of(tiny(axis=[values]))] == [0.02, 0.02]
    with pytest.raises(ValidationError, match="leave technologies out"):
        tiny(axis=[values], technologies=["0.35um"])


SHEET = {
    "pitch_um": 6.0,
    "full_well_e": 1e4,
    "read_noise_e": 20.0,
    "dark_current_e_per_s": 1.0,
    "quantum_efficiency": 0.6,
}


def test_cases_of_settings_of_the_pixel_hold_for_data_sheets(tmp_path: Path) -> None:
    """Under the word that the sheet has, or another one; what is not varied stays that of the
    sheet.
    """
    sheet = tmp_path / "sheet.toml"
    sheet.write_text(f"pixel = {toml_of(SHEET)}\n", encoding="utf-8")
    axis, condition = (
        axis_of("noise", "pixel.temporal_dark_noise_e", 1.0, 2.0),
        hot(dark_current_e_per_s=50.0),
    )
    (tmp_path / "s.toml").write_text(
        'name = "s"\ntechnologies = ["sheet.toml", "4t-bsi"]\n', encoding="utf-8"
    )
    study = load_study(tmp_path / "s.toml", axis=[axis], condition=[condition])
    for case, noise_e in zip(cases_of(study), (1.0, 2.0), strict=True):
        for technology in study.technologies:
            pixel = pixel_of(case.settings, technology, 6.0)
            assert (
                pixel.temporal_dark_noise_e,
                pixel.read_noise_e,
                pixel.dark_current_e_per_s,
            ) == (noise_e, None, 50.0)
        assert pixel_of(case.settings, str(sheet), 6.0).full_well_e == 1e4


@pytest.mark.parametrize(
    ("axis", "message"),
    [
        (
            axis_of("a", "camera.f_nmber", 2.0),
            "axis a, value 2: camera.f_nmber: unknown name.*Did you mean 'f_number'",
        ),
        (axis_of("a", "camera.f_number", 2.0, -2.0), "axis a, value -2: camera.f_number: got -2"),
        (axis_of("a", "camera.f_number", "abc"), "axis a, value abc: camera.f_number: got 'abc'"),
        (axis_of("a", "f_number", 2.0), r"f_number: unknown name.*It belongs in \[camera\]"),
        (
            axis_of("a", "camera", 2.0),
            "camera: got 2.0; allowed: a table of focal_length_mm, f_number",
        ),
        (labelled("a", b={"camera": {"f_number": -3}}), "axis a, value b: camera.f_number: got -3"),
    ],
)
def test_cases_of_bad_value_is_named(axis: dict[str, Any], message: str) -> None:
    with pytest.raises(PixsimError, match=message):
        cases_of(tiny(axis=[axis]))


def test_cases_of_very_many_raise_at_once() -> None:
    ends = {"from": 0.0, "to": 0.1, "count": 101}
    many = [{"name": name, "set": f"pixel.{name}"} | ends for name in ("prnu", "dsnu")]
    assert math.prod(len(axis.points) for axis in tiny(axis=many).axis) > MAX_CASES
    with pytest.raises(PixsimError, match=r"10201 cases.*at most 10000"):
        cases_of(tiny(axis=many))


def test_prepare_of_many_cases_derives_few_pixels_each(monkeypatch: pytest.MonkeyPatch) -> None:
    """A dry run of 1000 cases takes 2 s, and took 6 s when every pixel size of every case was
    derived.
    """
    derived: list[float] = []
    whole = preparation.physics_of
    monkeypatch.setattr(
        preparation, "physics_of", lambda *given: derived.append(given[2]) or whole(*given)
    )
    axis = {"name": "noise", "set": "pixel.read_noise_e", "from": 1.0, "to": 20.0, "count": 20}
    assert len(prepare(small(axis=[axis])).cases) == 20
    assert len(derived) == 20 * 2  # the ends of its range


@pytest.mark.parametrize(
    ("over", "message"),
    [
        (
            {"pitch": {"values_um": [4.0, 5.0, 7.0, 8.0, 9.0]}},
            r"pixel.pitch_um: got 4; allowed: above 5\.",
        ),
        (
            {"pixel": {"stack": {"height_um": 5.0, "index": 1.5, "shift_um": [5.5, 0.0]}}},
            r"half of pitch_um = 5\.3 along",
        ),
        *(
            (
                {"axis": [PRNU | {"name": name}]},
                f"axis: got name = '{name}', a column of every study",
            )
            for name in ("mean_delta_e", "fill_factor", "integration_s")
        ),
    ],
)
def test_prepare_names_what_no_case_can_have(over: dict[str, Any], message: str) -> None:
    """Of sizes, the first one that is impossible."""
    with pytest.raises(PixsimError, match=message):
        prepare(small(**over))


def test_check_number_asks_for_more_than_a_hundred_thousand() -> None:
    check_number(2, 100_000, agreed=False)
    check_number(2, 100_001, agreed=True)
    check_number(0, 10**9, agreed=False)  # a study without axes
    with pytest.raises(PixsimError, match=r"100001 evaluations in 2 cases.*--yes"):
        check_number(2, 100_001, agreed=False)


# --- a study with axes and conditions
# ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[StudyResult, Path]:
    folder = tmp_path_factory.mktemp("axes")
    return pixsim.study(small(axis=[LENS, PRNU], condition=[DAY, NIGHT]), folder, jobs=1), folder


def test_study_of_a_case_alone_has_its_rows(done: tuple[StudyResult, Path], tmp_path: Path) -> None:
    """The same numbers and keys: a case does not depend on the others."""
    result, folder = done
    alone = small(camera={"f_number": 8.0}, scene={"parameters": {"luminance_cd_per_m2": 30.0}})
    same = pixsim.study(alone, tmp_path, jobs=1)
    of_case = [row for row in rows(folder) if (row["lens"], row["condition"]) == ("f/8", "night")]
    names = rows(tmp_path)[0].keys() - {"check"}  # of a whole row, with its labels
    of_both = [
        [{name: row[name] for name in names} for row in table]
        for table in (of_case, rows(tmp_path))
    ]
    assert of_both[0] == of_both[1]
    assert result.case(lens="f/8", condition="night").curves[0].optimum == same.curves[0].optimum


def test_result_is_by_technology_axis_and_condition(done: tuple[StudyResult, Path]) -> None:
    """Its curves, the case that is asked for, and the columns of its table."""
    result, _ = done
    assert [(curve.at["lens"], curve.at["PRNU"], curve.condition) for curve in result.curves] == [
        (lens, prnu, condition)
        for lens, prnu in (("f/2.8", BASE), ("f/8", BASE), (BASE, BASE), (BASE, 0.01), (BASE, 0.03))
        for condition in ("day", "night")
    ]
    assert not [note for note in study_notes(result) if "changes nothing" in note]
    assert result.curves[0].label == "0.35um, f/2.8, day"
    assert all(result.part_of(curve).curves[0].label == curve.label for curve in result.curves)
    with pytest.raises(
        PixsimError,
        match=r"lens = f/8, which names 2 cases; allowed: one of: f/2.8, day; f/2.8, night",
    ):
        result.case(lens="f/8")
    with pytest.raises(PixsimError, match="condition noon, which names 0 cases"):
        result.case(condition="noon")
    head, first, *_ = result.to_csv().splitlines()
    assert head.startswith("technology,pitch_um,repeat,lens,PRNU,condition,fill_factor,")
    assert first.startswith("0.35um,5.3,0,f/2.8,base,day,")


def test_study_computes_only_what_is_new(done: tuple[StudyResult, Path], tmp_path: Path) -> None:
    result, folder = done
    before = set(keys(folder))
    shown = axis_of("shown", "display.samples_per_deg", 10.0, 20.0)
    lenses = labelled(
        "lens", **{f"f/{number:g}": {"camera": {"f_number": number}} for number in (8.0, 4.0, 5.6)}
    )
    of_display = pixsim.study(
        small(axis=[shown], seed=7), tmp_path, jobs=1
    )  # frames that no other test has kept
    of_more = pixsim.study(small(axis=[lenses], condition=[NIGHT]), folder, jobs=1)
    counts = [each.counts for each in (result, of_display, of_more) if each.counts is not None]
    assert [
        (own.cases, own.evaluations_made, own.evaluations_reused, own.frames_reused)
        for own in counts
    ] == [
        (10, 100, 0, 0),
        (2, 20, 0, 10),  # another display leaves the light on the sensor and the frames as they are
        (3, 10, 20, 0),  # f/4 is the chart's own lens: its rows are those of the base
    ]
    assert len(set(keys(folder)) - before) == 10


def test_rasters_of_one_study_are_as_if_each_were_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dots that are pixels are centred, and others have registrations, of which the first two are
    the same for many sizes.
    """
    rasters = ["fixed_size", "one_to_one"]
    both = pixsim.study(
        small(repeats=4, axis=[axis_of("shown", "display.raster", *rasters)]),
        tmp_path / "both",
        jobs=1,
    )
    monkeypatch.setenv("PIXSIM_CACHE_GIB", "0")
    for curve, raster in zip(both.curves, rasters, strict=True):
        alone = pixsim.study(
            small(repeats=4, display={"raster": raster}), tmp_path / raster, jobs=1
        )
        np.testing.assert_array_equal(curve.delta_e, alone.curves[0].delta_e)


LIGHTS = {"name": "light", "set": [LIGHT, "display.white_cd_per_m2"], "from": 50.0, "to": 100.0}


def test_study_lights_are_done_one_after_the_other_in_little_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No more of them are held for more lights, while the study runs and in its result: here one
    light behind the lens has room.

    A process fits the curve of a light before the evaluations of the next one.
    """
    held: list[weakref.ref[Any]] = []
    peaks: list[int] = []
    order: list[str] = []

    def recorded(place: str, large: Callable[[Any], Any] | None = None) -> Callable[..., Any]:
        function: Any = pydoc.locate(place)

        def call(*arguments: Any, **more: Any) -> Any:
            made = function(*arguments, **more)
            if large is None:
                order.append(function.__name__)
            else:
                held.append(weakref.ref(large(made)))
                peaks.append(sum(each() is not None for each in held))
            return made

        return call

    watched: dict[str, Callable[[Any], Any] | None] = {
        "pixsim.scene.renderer.Renderer.image": lambda image: image.factors[1],
        "pixsim.viewer.scene_light.prepare_scene": lambda light: light.rate_e_per_s_um2,
        "pixsim.studies.curve.curve_of": None,
        "pixsim.studies.evaluate.evaluate_task": None,
    }
    for place, replacement in {
        place: recorded(place, large) for place, large in watched.items()
    }.items():
        monkeypatch.setattr(place, replacement)
    monkeypatch.setattr("pixsim.viewer.scene_light.SCENE_CACHE_BYTES", 1)
    most = []
    for count in (2, 4):
        result = pixsim.study(
            small(axis=[LIGHTS | {"count": count}]), tmp_path / str(count), jobs=1
        )
        assert len(result.parts) == count
        most.append((max(peaks), sum(each() is not None for each in held)))
        assert result.parts[-1].irradiance.planes.shape[1:] == (COARSE, COARSE)
        held.clear(), peaks.clear()
    assert most[0] == most[1], "light or pictures are held for each case"
    assert order == (2 + 4) * [*(5 * ["evaluate_task"]), "curve_of"]


def test_study_sensors_are_drawn_once_for_all_lights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[object] = []
    sensor = ImagingChain.sensor
    monkeypatch.setenv(cache.LIMIT_VARIABLE, "0")
    monkeypatch.setattr(
        ImagingChain, "sensor", lambda chain, *key: drawn.append(key) or sensor(chain, *key)
    )
    pixsim.study(small(axis=[LIGHTS | {"count": 3}], resolution=COARSE), tmp_path, jobs=1)
    assert len(rows(tmp_path)) == 3 * 5 * 2
    drawn = [key for key in drawn if key != STREAM]
    assert len(drawn) == len(set(drawn)) == 5 * 2


def test_load_study_names_options_that_are_not_used(
    tmp_path: Path, recwarn: pytest.WarningsRecorder
) -> None:
    (tmp_path / "s.toml").write_text(small_toml(), encoding="utf-8")
    fast = condition_of("n", {"camera": {"f_number": 2.0}})
    for more, words in (
        ({"axis": [LENS]}, "camera.f_number is not used: the axis 'lens' sets it"),
        ({"axis": [LENS, PRNU]}, ""),  # PRNU is moved alone about it
        ({"condition": [fast]}, "camera.f_number is not used: every condition sets it"),
        ({"condition": [DAY, fast]}, ""),
    ):
        load_study(tmp_path / "s.toml", camera={"f_number": 3.0}, **more)
        assert [str(warning.message) for warning in recwarn.list] == ([words] if words else [])
        recwarn.clear()


def test_load_study_files_of_axes_and_conditions_lie_next_to_it(tmp_path: Path) -> None:
    for name in ("own.xml", "qe.csv", "star.exr", "mine.toml"):
        (tmp_path / name).write_text("", encoding="utf-8")
    axes = [
        axis_of("scene", "scene.file", "own.xml", "csf"),
        axis_of("process", "pixel.technology", "mine.toml", "0.5um"),
        labelled("QE", a={"pixel": {"quantum_efficiency": "qe.csv"}}),
    ]
    condition = condition_of("n", {"scene": {"parameters": {"chart": "star.exr"}}})
    text = f'name = "s"\naxis = {toml_of(axes)}\ncondition = {toml_of([condition])}\n'
    (tmp_path / "s.toml").write_text(text, encoding="utf-8")
    study = load_study(tmp_path / "s.toml")
    assert study.axis[0].values == (str(tmp_path / "own.xml"), "csf")
    assert study.axis[1].values == (str(tmp_path / "mine.toml"), "0.5um")
    assert study.axis[2].points[0].table == {
        "pixel": {"quantum_efficiency": str(tmp_path / "qe.csv")}
    }
    assert study.condition[0].set == {
        "scene": {"parameters": {"chart": str(tmp_path / "star.exr")}}
    }


# --- command line
# -----------------------------------------------------------------------------------------------------


def test_axes_of_texts() -> None:
    known = [{"name": "light", "set": LIGHT, "from": 1.0, "to": 10.0, "count": 4}]
    actual = axes_of(["light=1,2.5", "camera.f_number=2:8:3:log", "a.b+c.d=x,1e3"], known)
    assert actual == [
        {"name": "light", "set": LIGHT, "values": [1, 2.5]},
        {
            "name": "camera.f_number",
            "set": ["camera.f_number"],
            "from": 2.0,
            "to": 8.0,
            "count": 3,
            "spacing": "log",
        },
        {"name": "a.b and c.d", "set": ["a.b", "c.d"], "values": ["x", 1000.0]},
    ]
    assert known[0]["to"] == 10.0, "the file's own table is unchanged"


def test_axes_of_labels_picks_values() -> None:
    assert axes_of(["lens=f/8"], [LENS]) == [LENS | {"values": LENS["values"][1:]}]


@pytest.mark.parametrize(
    ("texts", "known", "message"),
    [
        (["light"], [], "NAME=v1,v2"), (["=1"], [], "NAME=v1,v2"), (["a="], [], "NAME=v1,v2"), (["a=1", "a=2"], [], "'a' twice"),
        (["a=1,,2"], [], "a value on both sides"), (["a=1,"], [], "a value on both sides"), (["a=1:2:2.5"], [], "numbers in"),
        (["a=1:x:3"], [], "numbers in from:to:count"), (["a=1:2:3:cubic"], [], "log or linear"),
        (["lens=f/9"], [LENS], "got f/9 in 'lens=f/9'; allowed: labels of its values: f/2.8, f/8"),
        (["lens=1:2:3"], [LENS], "labels"), (["a=1"], {"name": "a"}, "a list"),
        (["a=1"], 3, r"axis: got 3; allowed: a list of tables \[\[axis\]\]"),
    ],
)  # fmt: skip
def test_axes_of_bad_text_or_file_raises(texts: list[str], known: Any, message: str) -> None:
    with pytest.raises(PixsimError, match=message):
        axes_of(texts, known)


def test_axes_of_file_with_other_entries_leaves_them_to_the_record() -> None:
    assert axes_of(["a=1"], [1, {"name": ["x"]}])[:2] == [1, {"name": ["x"]}]


def test_study_command_dry_run_states_number_time_and_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also of more evaluations than are run unasked."""
    monkeypatch.chdir(tmp_path)
    Path("s.toml").write_text(
        small_toml(repeats=10_000, axis=[LENS], condition=[DAY, NIGHT]), encoding="utf-8"
    )
    line = "study s.toml --axis pixel.prnu=0,0.01,0.02 --out out"
    code, out, err = command(f"{line} --dry-run")
    assert code == 0, err
    assert "cases    12, 600000 evaluations" in out
    cost = (
        r"^cost +12 renders, 600000 evaluations.*; about [\d.]+ (s|min|h), .*; [\d.]+ GB of memory$"
    )
    assert re.search(cost, out, re.MULTILINE)
    assert_refused(
        *command(line), ["600000 evaluations in 12 cases", "up to 100000", "--yes", "--dry-run"]
    )
    assert not Path("out").exists()


def test_study_command_with_axis_writes_page_maps_and_cases(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("s.toml").write_text(small_toml(condition=[NIGHT]), encoding="utf-8")
    code, out, err = command("study s.toml --axis pixel.prnu=0.01,0.03 --jobs 1 --out out --json")
    assert code == 0, err
    summary = json.loads(out)
    assert summary["counts"]["evaluations_made"] == 2 * 10
    written = json.loads(Path("out/summary.json").read_text(encoding="utf-8"))
    assert [curve["at"] for curve in written["curves"]] == [
        {"pixel.prnu": 0.01},
        {"pixel.prnu": 0.03},
    ]
    names = {str(path.relative_to("out")) for path in Path("out").rglob("*") if path.is_file()}
    assert names >= {
        "report.html",
        "optima.csv",
        "regrets.csv",
        "settings.toml",
        "figures/regrets_1.svg",
    }
    assert "pixel.prnu_0.01_night/report.html" in names
    assert any(name.startswith("figures/optimum_by") for name in names)
    assert "least weighted mean ΔE" in Path("out/report.html").read_text(encoding="utf-8")


@pytest.mark.slow
@needs_browser
def test_study_page_of_axes_and_conditions_fits_screens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("s.toml").write_text(
        small_toml(axis=[LENS, PRNU], condition=[DAY, NIGHT]), encoding="utf-8"
    )
    code, _, err = command(
        "study s.toml --axis exposure.max_integration_s=0.05,0.1 --jobs 1 --out out"
    )
    assert code == 0, err
    assert_fits(tmp_path / "out/report.html", tmp_path)
    assert_prints(
        tmp_path / "out/report.html",
        tmp_path,
        range(2, 40),
        ["least weighted mean ΔE", "PRNU"],
        ["Optima"],
    )
