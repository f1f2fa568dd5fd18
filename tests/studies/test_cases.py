"""What axes and conditions make of a study, and that its cases are the studies that one would run
apart.
"""

from __future__ import annotations

import json
import weakref
from pathlib import Path
from typing import Any

import pytest
from helpers.tiny import TINY, keys, rows, tiny, toml_of

import pixsim
from pixsim.base import cache
from pixsim.studies.design import BASE, cases_of, pixel_of
from pixsim.studies.files import load_study
from pixsim.studies.result import StudyResult
from pixsim.studies.settings import Study, axes_of
from pixsim.viewer import scene_light
from pixsim.viewer.chain import ImagingChain
from pixsim.viewer.merging import merge
from pixsim.viewer.without_effect import STREAM

LIGHT = "scene.parameters.luminance_cd_per_m2"
# A chart whose cells are computed, on few pixel sizes: a case takes a fifth of a second.
SMALL = TINY | {
    "pitch": {"values_um": [5.3, 6.0, 7.0, 8.5, 11.0]},
    "camera": {"die_mm": 0.7},
    "display": {"dots": 32},
}
LENS = {
    "name": "lens",
    "values": [
        {"label": "f/2.8", "set": {"camera": {"f_number": 2.8}}},
        {"label": "f/8", "set": {"camera": {"f_number": 8.0}}},
    ],
}
PRNU = {"name": "PRNU", "set": "pixel.prnu", "values": [0.01, 0.03], "alone": True}
DAY = {"name": "day", "weight": 3.0, "set": {"scene": {"parameters": {"luminance_cd_per_m2": 300}}}}
NIGHT = {"name": "night", "set": {"scene": {"parameters": {"luminance_cd_per_m2": 30}}}}
LIGHTS = {"name": "light", "set": [LIGHT, "display.white_cd_per_m2"], "from": 50.0, "to": 100.0}


def small(**over: Any) -> Study:
    return Study.model_validate(merge(SMALL, over))


# --- cases ----------------------------------------------------------------------------------------


def test_axes_survive_a_round_trip_through_settings() -> None:
    times = {"name": "t", "set": "exposure.max_integration_s", "from": 0, "to": 9, "count": 3}
    study = tiny(axis=[LENS, PRNU, times | {"from": 1}], condition=[DAY])
    table = json.loads(json.dumps(study.model_dump(mode="json", exclude_unset=True)))
    labels = [case.labels for case in cases_of(Study.model_validate(table))]
    assert labels == [case.labels for case in cases_of(study)]


def test_study_without_axes_is_its_only_case() -> None:
    study = tiny()
    (case,) = cases_of(study)
    assert case.settings is study
    assert (case.words, case.labels) == ("", {})


def test_cases_are_a_product_then_single_moves_each_under_every_condition() -> None:
    times = {"name": "integration", "set": "exposure.max_integration_s", "values": [0.1, 0.2]}
    cases = cases_of(tiny(axis=[LENS, times, PRNU], condition=[DAY, NIGHT]))
    words = ["f/2.8, integration 0.1, day", "f/2.8, integration 0.1, night"]
    assert len(cases) == (2 * 2 + 1 + 2) * 2
    assert [case.words for case in cases[:2]] == words
    assert [case.words for case in cases[8:11]] == ["day", "night", "PRNU: 0.01, day"]
    assert cases[8].at == {"lens": BASE, "integration": BASE, "PRNU": BASE}
    assert (cases[8].one_at_a_time, cases[10].one_at_a_time) == ("", "PRNU")
    assert (cases[0].settings.camera.f_number, cases[10].settings.camera.f_number) == (2.8, None)
    assert cases[10].settings.pixel.prnu == 0.01
    assert cases[0].settings.scene.parameters["luminance_cd_per_m2"] == 300.0


@pytest.mark.parametrize(
    "axis",
    [
        {"set": "pixel.technology", "values": ["0.5um", "0.25um"]},
        {
            "values": [
                {"label": "old", "set": {"pixel": {"technology": "0.5um", "prnu": 0.02}}},
                {"label": "new", "set": {"pixel": {"technology": "0.25um"}}},
            ]
        },
    ],
    ids=["setting", "tables"],
)
def test_an_axis_may_set_the_technology(axis: dict[str, Any]) -> None:
    cases = cases_of(tiny(axis=[{"name": "process"} | axis]))
    assert [case.settings.technologies for case in cases] == [("0.5um",), ("0.25um",)]


def test_settings_of_the_pixel_hold_for_data_sheets(tmp_path: Path) -> None:
    """Under the word that the sheet has, or another one; what is not varied stays that of the
    sheet.
    """
    sheet = tmp_path / "sheet.toml"
    numbers = {"full_well_e": 1e4, "dark_current_e_per_s": 1.0, "quantum_efficiency": 0.6}
    pixel = numbers | {"pitch_um": 6.0, "read_noise_e": 20.0}
    sheet.write_text(f"pixel = {toml_of(pixel)}\n", encoding="utf-8")
    (tmp_path / "s.toml").write_text('name = "s"\ntechnologies = ["sheet.toml", "4t-bsi"]\n')
    axis = {"name": "noise", "set": "pixel.temporal_dark_noise_e", "values": [1.0, 2.0]}
    warm = {"name": "warm", "set": {"pixel": {"dark_current_e_per_s": 50.0}}}
    study = load_study(tmp_path / "s.toml", axis=[axis], condition=[warm])
    for case, noise_e in zip(cases_of(study), (1.0, 2.0), strict=True):
        pixels = [pixel_of(case.settings, name, 6.0) for name in study.technologies]
        for pixel in pixels:
            assert (pixel.temporal_dark_noise_e, pixel.read_noise_e) == (noise_e, None)
            assert pixel.dark_current_e_per_s == 50.0
        assert pixels[0].full_well_e == 1e4


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"axis": [LENS]}, "camera.f_number is not used: the axis 'lens' sets it"),
        ({"axis": [LENS, PRNU]}, ""),  # PRNU is moved alone about it
        (
            {"condition": [{"name": "n", "set": {"camera": {"f_number": 2.0}}}]},
            "camera.f_number is not used: every condition sets it",
        ),
        ({"condition": [DAY, {"name": "n", "set": {"camera": {"f_number": 2.0}}}]}, ""),
    ],
)
def test_option_that_axes_or_conditions_set_is_named(
    tables: dict[str, Any], words: str, tmp_path: Path, recwarn: pytest.WarningsRecorder
) -> None:
    (tmp_path / "s.toml").write_text('name = "s"\n')
    load_study(tmp_path / "s.toml", camera={"f_number": 3.0}, **tables)
    assert [str(warning.message) for warning in recwarn.list] == ([words] if words else [])


def test_files_of_axes_and_conditions_lie_next_to_the_study(tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("scene.xml", "qe.csv", "star.exr", "mine.toml")]
    for file in files:
        file.write_text("", encoding="utf-8")
    axes = [
        {"name": "scene", "set": "scene.file", "values": ["scene.xml", "csf"]},
        {"name": "process", "set": "pixel.technology", "values": ["mine.toml", "0.5um"]},
        {
            "name": "QE",
            "values": [{"label": "a", "set": {"pixel": {"quantum_efficiency": "qe.csv"}}}],
        },
    ]
    night = {"name": "n", "set": {"scene": {"parameters": {"chart": "star.exr"}}}}
    text = f'name = "s"\naxis = {toml_of(axes)}\ncondition = {toml_of([night])}\n'
    (tmp_path / "s.toml").write_text(text, encoding="utf-8")
    study = load_study(tmp_path / "s.toml")
    scene, qe, star, mine = map(str, files)
    assert [axis.values for axis in study.axis[:2]] == [(scene, "csf"), (mine, "0.5um")]
    assert study.axis[2].points[0].table == {"pixel": {"quantum_efficiency": qe}}
    assert study.condition[0].set == {"scene": {"parameters": {"chart": star}}}


def test_axes_of_the_command_line() -> None:
    """The table of a file's axis is unchanged, but for its values; labels pick values."""
    light = {"name": "light", "set": LIGHT, "from": 1.0, "to": 10.0, "count": 4}
    texts = ["light=1,2.5", "camera.f_number=2:8:3:log", "a.b+c.d=x,1e3"]
    ratios = {"from": 2.0, "to": 8.0, "count": 3, "spacing": "log"}
    assert axes_of(texts, [light]) == [
        {"name": "light", "set": LIGHT, "values": [1, 2.5]},
        {"name": "camera.f_number", "set": ["camera.f_number"]} | ratios,
        {"name": "a.b and c.d", "set": ["a.b", "c.d"], "values": ["x", 1000.0]},
    ]
    assert light["to"] == 10.0
    entries = [1, {"name": ["x"]}, {"name": "a", "values": [3]}]
    assert axes_of(["a=1"], entries) == [*entries[:2], {"name": "a", "values": [1]}]
    assert axes_of(["lens=f/8"], [LENS]) == [LENS | {"values": LENS["values"][1:]}]


# --- a study with axes and conditions -------------------------------------------------------------


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[StudyResult, Path]:
    folder = tmp_path_factory.mktemp("axes")
    return pixsim.study(small(axis=[LENS, PRNU], condition=[DAY, NIGHT]), folder, jobs=1), folder


def test_a_case_has_the_rows_of_its_study_alone(
    done: tuple[StudyResult, Path], tmp_path: Path
) -> None:
    """The same numbers and keys: a case does not depend on the others."""
    result, folder = done
    alone = pixsim.study(
        small(camera={"f_number": 8.0}, scene=NIGHT["set"]["scene"]), tmp_path, jobs=1
    )
    expected = rows(tmp_path)
    names = expected[0].keys() - {"check"}  # of a whole row, with its labels
    case_rows = [
        {name: row[name] for name in names}
        for row in rows(folder)
        if (row["lens"], row["condition"]) == ("f/8", "night")
    ]
    assert case_rows == [{name: row[name] for name in names} for row in expected]
    assert result.case(lens="f/8", condition="night").curves[0].optimum == alone.curves[0].optimum


def test_curves_are_by_axis_and_condition(done: tuple[StudyResult, Path]) -> None:
    result, _ = done
    values = [("f/2.8", BASE), ("f/8", BASE), (BASE, BASE), (BASE, 0.01), (BASE, 0.03)]
    expected = [(*value, condition) for value in values for condition in ("day", "night")]
    assert [(*curve.at.values(), curve.condition) for curve in result.curves] == expected
    assert all(result.part_of(curve).curves[0].label == curve.label for curve in result.curves)
    for labels in ({"lens": "f/8"}, {"condition": "noon"}):
        with pytest.raises(pixsim.PixsimError, match=r"which names [02] cases"):
            result.case(**labels)


def test_study_computes_only_what_is_new(done: tuple[StudyResult, Path], tmp_path: Path) -> None:
    """Another display leaves the light on the sensor and the frames as they are; f/4 is the chart's
    own lens, so that its rows are those of the base.
    """
    result, folder = done
    before = set(keys(folder))
    samples = {"name": "shown", "set": "display.samples_per_deg", "values": [10.0, 20.0]}
    lenses = {"name": "lens", "set": "camera.f_number", "values": [8.0, 4.0, 5.6]}
    displays = pixsim.study(small(axis=[samples], seed=7, exposure={"frames": 2}), tmp_path, jobs=1)
    with_lenses = pixsim.study(small(axis=[lenses], condition=[NIGHT]), folder, jobs=1)
    counts = [
        (item.cases, item.evaluations_made, item.evaluations_reused, item.frames_reused)
        for item in (result.counts, displays.counts, with_lenses.counts)
    ]
    assert counts == [(10, 100, 0, 0), (2, 20, 0, 10), (3, 10, 20, 0)]
    assert len(set(keys(folder)) - before) == 10


def test_lights_behind_the_lens_are_held_one_at_a_time_where_one_has_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No more of them for more lights, while the study runs and in its result."""
    monkeypatch.setattr(scene_light, "SCENE_CACHE_BYTES", 1)
    prepare_scene = scene_light.prepare_scene
    held: list[weakref.ref[Any]] = []
    counts: dict[int, list[int]] = {2: [], 4: []}
    for lights, peaks in counts.items():

        def recorded(*arguments: Any, peaks: list[int] = peaks, **options: Any) -> Any:
            light = prepare_scene(*arguments, **options)
            held.append(weakref.ref(light.rate_e_per_s_um2))
            peaks.append(sum(item() is not None for item in held))
            return light

        monkeypatch.setattr(scene_light, "prepare_scene", recorded)
        axis = LIGHTS | {"count": lights}
        result = pixsim.study(small(axis=[axis]), tmp_path / str(lights), jobs=1)
        peaks.append(sum(item() is not None for item in held))
        assert len(result.parts) == lights
        held.clear()
    assert max(counts[2]) == max(counts[4])
    assert counts[2][-1] == counts[4][-1]


def test_sensors_are_drawn_once_for_all_lights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[object] = []
    sensor = ImagingChain.sensor

    def recorded(chain: ImagingChain, *key: object) -> Any:
        drawn.append(key)
        return sensor(chain, *key)

    monkeypatch.setenv(cache.LIMIT_VARIABLE, "0")
    monkeypatch.setattr(ImagingChain, "sensor", recorded)
    pixsim.study(small(axis=[LIGHTS | {"count": 3}]), tmp_path, jobs=1)
    keys_drawn = [key for key in drawn if key != STREAM]
    assert len(rows(tmp_path)) == 3 * 5 * 2
    assert len(keys_drawn) == len(set(keys_drawn)) == 5 * 2
