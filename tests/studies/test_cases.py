"""What axes and conditions make of a study: its cases are the studies that one would run apart, and
each setting makes the stages anew that depend on it, and no others. Studies of colour filters.
"""

import json
import weakref
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from helpers.study_settings import CHANGES
from helpers.tiny import COARSE, TINY, lit_sensors, rows, tiny, toml_of

import pixsim
from pixsim.base import cache
from pixsim.studies.design import BASE, cases_of, light_hash, pixel_of
from pixsim.studies.files import load_study
from pixsim.studies.merit import noise_budgets
from pixsim.studies.result import StudyResult
from pixsim.studies.settings import axes_of
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


def small(**over) -> pixsim.Study:
    return pixsim.Study.model_validate(merge(SMALL, over))


def rows_without(folder: Path, *labels: str, **values: str) -> list[dict[str, str]]:
    """Return the rows of these values, without some of their labels."""
    return [
        {name: value for name, value in row.items() if name not in {*labels, *values, "check"}}
        for row in rows(folder)
        if values.items() <= row.items()
    ]


# --- cases ----------------------------------------------------------------------------------------


def test_cases_are_a_product_then_single_moves_each_under_every_condition() -> None:
    """Also of settings that are written and read again."""
    times_s = {"from": 0.1, "to": 0.2, "count": 2}
    times = {"name": "integration", "set": "exposure.max_integration_s"} | times_s
    study = tiny(axis=[LENS, times, PRNU], condition=[DAY, NIGHT])
    settings = json.loads(json.dumps(study.model_dump(mode="json", exclude_unset=True)))
    cases = cases_of(pixsim.Study.model_validate(settings))
    assert [case.labels for case in cases] == [case.labels for case in cases_of(study)]
    assert len(cases) == (2 * 2 + 1 + 2) * 2
    assert [case.words for case in cases[:2]] == [
        "f/2.8, integration 0.1, day",
        "f/2.8, integration 0.1, night",
    ]
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
def test_an_axis_may_set_the_technology(axis: dict) -> None:
    cases = cases_of(tiny(axis=[{"name": "process"} | axis]))
    assert [case.settings.technologies for case in cases] == [("0.5um",), ("0.25um",)]


def test_settings_of_the_pixel_hold_for_data_sheets(tmp_path: Path) -> None:
    """Under the word that the sheet has, or another one; what is not varied stays that of the
    sheet.
    """
    (tmp_path / "sheet.toml").write_text(
        "[pixel]\npitch_um = 6.0\nread_noise_e = 20.0\nfull_well_e = 10000.0\n"
        "dark_current_e_per_s = 1.0\nquantum_efficiency = 0.6\n"
    )
    (tmp_path / "s.toml").write_text('name = "s"\ntechnologies = ["sheet.toml", "4t-bsi"]\n')
    axis = {"name": "noise", "set": "pixel.temporal_dark_noise_e", "values": [1.0, 2.0]}
    warm = {"name": "warm", "set": {"pixel": {"dark_current_e_per_s": 50.0}}}
    study = load_study(tmp_path / "s.toml", axis=[axis], condition=[warm])
    pixels = [
        pixel_of(case.settings, name, 6.0)
        for case in cases_of(study)
        for name in study.technologies
    ]
    assert [pixel.temporal_dark_noise_e for pixel in pixels] == [1.0, 1.0, 2.0, 2.0]
    assert {(pixel.read_noise_e, pixel.dark_current_e_per_s) for pixel in pixels} == {(None, 50.0)}
    assert [pixel.full_well_e for pixel in pixels[::2]] == [1e4, 1e4]


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
    tables: dict, words: str, tmp_path: Path, recwarn: pytest.WarningsRecorder
) -> None:
    (tmp_path / "s.toml").write_text('name = "s"\n')
    load_study(tmp_path / "s.toml", camera={"f_number": 3.0}, **tables)
    assert [str(warning.message) for warning in recwarn.list] == ([words] if words else [])


FILES = ("scene.xml", "qe.csv", "star.exr", "mine.toml", "empty.xml")


def test_files_of_axes_conditions_and_metrics_lie_next_to_the_study(tmp_path: Path) -> None:
    files = [tmp_path / name for name in FILES]
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
    processes = {"mine.toml": {"dsnu": 0.2}}
    scene = {"parameters": {"chart": "star.exr"}}
    night = {"name": "n", "set": {"scene": scene, "process": processes}}
    metrics = 'metrics = ["detectability"]\nmetric.detectability.without = "empty.xml"\n'
    text = f'name = "s"\naxis = {toml_of(axes)}\ncondition = {toml_of([night])}\n{metrics}'
    (tmp_path / "s.toml").write_text(text, encoding="utf-8")
    study = load_study(tmp_path / "s.toml")
    scene, qe, star, mine, empty = map(str, files)
    assert [axis.values for axis in study.axis[:2]] == [(scene, "csf"), (mine, "0.5um")]
    assert study.axis[2].points[0].table == {"pixel": {"quantum_efficiency": qe}}
    resolved = {"scene": {"parameters": {"chart": star}}, "process": {mine: {"dsnu": 0.2}}}
    assert study.condition[0].set == resolved
    assert study.metric.detectability.without == empty


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
    assert rows_without(folder, "PRNU", lens="f/8", condition="night") == rows_without(tmp_path)
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
    samples = {"name": "shown", "set": "display.samples_per_deg", "values": [10.0, 20.0]}
    lenses = {"name": "lens", "set": "camera.f_number", "values": [8.0, 4.0, 5.6]}
    displays = pixsim.study(small(axis=[samples], seed=7, exposure={"frames": 2}), tmp_path, jobs=1)
    with_lenses = pixsim.study(small(axis=[lenses], condition=[NIGHT]), folder, jobs=1)
    counts = [
        (item.cases, item.evaluations_made, item.evaluations_reused, item.frames_reused)
        for item in (result.counts, displays.counts, with_lenses.counts)
    ]
    assert counts == [(10, 100, 0, 0), (2, 20, 0, 10), (3, 10, 20, 0)]


def test_lights_behind_the_lens_are_held_one_at_a_time_where_one_has_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And that which replaces it; none of them in the result."""
    monkeypatch.setattr(scene_light, "SCENE_CACHE_BYTES", 1)
    prepare_scene = scene_light.prepare_scene
    references: list[weakref.ref] = []
    counts: list[int] = []

    def counted(*arguments, **options):
        light = prepare_scene(*arguments, **options)
        references.append(weakref.ref(light.rate_e_per_s_um2))
        counts.append(sum(reference() is not None for reference in references))
        return light

    monkeypatch.setattr(scene_light, "prepare_scene", counted)
    assert len(pixsim.study(small(axis=[LIGHTS | {"count": 4}]), tmp_path, jobs=1).parts) == 4
    assert max(counts) == 2
    assert all(reference() is None for reference in references)


def test_sensors_are_drawn_once_for_all_lights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(cache.LIMIT_VARIABLE, "0")
    sensor = ImagingChain.sensor
    with patch.object(ImagingChain, "sensor", autospec=True, side_effect=sensor) as draws:
        pixsim.study(small(axis=[LIGHTS | {"count": 3}]), tmp_path, jobs=1)
    drawn = [call.args[1:] for call in draws.call_args_list if call.args[1:] != STREAM]
    assert len(rows(tmp_path)) == 3 * 5 * 2
    assert len(drawn) == len(set(drawn)) == 5 * 2


# --- keys -----------------------------------------------------------------------------------------

# The settings before, a change, and the stages that it makes anew.
STAGES = {name: ({}, {name: value}, stages) for name, (value, stages) in CHANGES.items()} | {
    "a metric that is asked for": (
        {"metrics": ["delta_e", "information"]},
        {"metric": {"information": {"contrast": 0.3}}},
        "score",
    ),
    "registrations of a target": (
        {"metrics": ["delta_e", "detectability"]},
        {"metric": {"detectability": {"registrations": 32}}},
        "score",
    ),
    "the scene without the target": (
        {"metrics": ["delta_e", "detectability"]},
        {"metric": {"detectability": {"without": "flat"}}},
        "light score",
    ),
    # A frame is registered with a display of dots, not with one of a dot for each pixel.
    "raster": ({}, {"display": TINY["display"] | {"raster": "one_to_one"}}, "light frame score"),
}


def stages(study: pixsim.Study) -> dict[str, str]:
    """The key of each stage of a study in one light."""
    light = pixsim.SpectralImage([550.0], 10.0, 84.8, data=np.ones((4, 4, 1)))
    (sensor, *_) = lit_sensors(study, light, pixsim.Camera())
    _, score_key = sensor.keys(6.0, 2)
    return {"light": light_hash(study), "frame": sensor.pixel_hash(6.0), "score": score_key}


@pytest.mark.parametrize("name", [*pixsim.Study.model_fields, *list(STAGES)[len(CHANGES) :]])
def test_setting_makes_its_stages_anew_and_no_others(name: str) -> None:
    over, change, expected = STAGES[name]
    before = tiny(**over)
    after = pixsim.Study.model_validate(before.model_dump(exclude_unset=True) | change)
    assert after != before
    keys_after = stages(after)
    changed = {stage for stage, key in stages(before).items() if key != keys_after[stage]}
    assert changed == set(expected.split())


# --- colour filters -------------------------------------------------------------------------------

IN_COLOUR = pytest.mark.filterwarnings(
    "ignore:.*black level", "ignore:.*Fresnel", "ignore:.*, lens .*left out"
)
CAMERA = {"sensitivities": "Sony_ILCE-7M4", "peak_quantum_efficiency": 0.65}
FILTERS = {
    "name": "filters",
    "values": [
        {"label": "none", "set": {"pixel": {"bits": 10}}},
        {"label": "RGGB", "set": {"pixel": {"colour": CAMERA}}},
        {
            "label": "quad",
            "set": {"pixel": {"colour": CAMERA | {"pattern": "quad_rggb", "binning": True}}},
        },
    ],
}
STACKS = [
    {"label": "open", "set": {"pixel": {"stack": {"enabled": False}}}},
    {"label": "deep", "set": {"pixel": {"stack": {"enabled": True}}}},
]


def filters(**over) -> pixsim.Study:
    table: dict = {
        "name": "filters",
        "technologies": ["4t-bsi"],
        "repeats": 2,
        "resolution": COARSE,
        "camera": {"die_mm": 0.2},
        "pixel": {"stack": {"enabled": False}},
        "display": {"dots": 24},
        "pitch": {"values_um": [2.0, 2.5, 3.0, 4.0, 6.0]},
    }
    return pixsim.Study.model_validate(merge(table, over))


@IN_COLOUR
def test_study_of_filters(tmp_path: Path) -> None:
    """The monochrome case is the study without filters, and the parts of each error add up. The
    chart is grey in colour, too: to a code of the display.
    """
    pixsim.study(filters(), out=tmp_path / "plain", jobs=1)
    result = pixsim.study(
        filters(axis=[FILTERS], noise_budget=True), out=tmp_path / "filters", jobs=1
    )
    case_rows = rows_without(tmp_path / "filters", "key", filters="none")
    assert case_rows == rows_without(tmp_path / "plain", "key")
    budgets = list(noise_budgets(result).values())
    assert ["mosaic" in budget.delta_e for budget in budgets] == [False, True, True]
    np.testing.assert_allclose(
        [sum(budget.parts.values()) for budget in budgets],
        [budget.mean_delta_e for budget in budgets],
        atol=1e-9,
    )

    score = result.case(filters="RGGB").scores("4t-bsi", 2.5, 1)[0]
    assert score.image.shape == (*score.delta_e.shape, 3)
    assert np.ptp(score.ideal, axis=2).max() < 0.02


@IN_COLOUR
def test_sizes_whose_colours_mix_are_left_out(tmp_path: Path) -> None:
    """With the reason; the other sizes have the rows of a study that never had them, also when it
    is resumed.
    """
    sizes_um = [1.2, 2.0, 2.5, 3.0, 4.0]
    few = {"pixel": {"colour": CAMERA, "stack": {"enabled": True}}, "camera": {"die_mm": 0.1}}
    pixsim.study(filters(pitch={"values_um": sizes_um}, **few), out=tmp_path / "possible", jobs=1)
    for _ in range(2):
        with pytest.warns(UserWarning, match=r"0.45, 0.6 µm left out: .*noise gains of"):
            result = pixsim.study(
                filters(pitch={"values_um": [0.45, 0.6, *sizes_um]}, **few),
                out=tmp_path / "all",
                jobs=1,
            )
        assert result.curves[0].pitch_um.tolist() == sizes_um
        assert list(result.as_dict()["curves"][0]["left_out"]) == ["0.45", "0.6"]
        assert rows_without(tmp_path / "all") == rows_without(tmp_path / "possible")


@IN_COLOUR
def test_case_without_possible_sizes_is_left_out_with_the_reason(tmp_path: Path) -> None:
    study = filters(
        axis=[{"name": "stack", "values": STACKS}],
        pixel={"colour": CAMERA},
        pitch={"values_um": [0.45, 0.5, 0.55, 0.6, 0.65]},
        camera={"die_mm": 0.1},
    )
    with pytest.warns(UserWarning, match="a case is left out: 4t-bsi, deep: 0 of 5 pixel sizes"):
        result = pixsim.study(study, out=tmp_path, jobs=1)
    assert [curve.at for curve in result.curves] == [{"stack": "open"}]
    (words,) = result.as_dict()["left_out"]
    assert words.startswith("4t-bsi, deep: ")
