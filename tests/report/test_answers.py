"""First lines of answers, which are read at a glance, and the answers of `pixsim compare`."""

import json
import math
import re
from dataclasses import replace
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.commands import command, output_of
from helpers.runs import run_result
from helpers.sheets import sheet, two_sheets
from helpers.tiny import rows

import pixsim
from pixsim.base.headline import MAX_HEADLINE_WORDS
from pixsim.report.compare import numbers
from pixsim.report.curve import optimum_answer
from pixsim.report.run import run_answer, run_document, shown_mean_of
from pixsim.report.verdicts import better_cases_words, dependences, pair_sentence
from pixsim.sensor.spectral_range import outside_share_text
from pixsim.show.document import plain_text
from pixsim.show.render import text
from pixsim.studies.comparison import Comparison, DisplayDifference
from pixsim.studies.curve import CaseLabels, CurveErrors
from pixsim.studies.design import Case
from pixsim.studies.film_error import FilmError, light_error_and_limit
from pixsim.studies.paired import Pairs
from pixsim.viewer.metrics import DELTA_E
from pixsim.viewer.score import Cause, converged
from pixsim.viewer.setting import Run, stage_words

FILM = FilmError(
    (256, 256), 10.0, (7.5,), (0.6,), (0.02,), "the limit of 4096 samples across for 20 pictures"
)
FILMS = [None, FILM, replace(FILM, delta_e=(math.nan,)), replace(FILM, delta_e=(0.01,), limit="")]
NOISE = {"ended_by": "samples", "delta_e": 0.36, "tolerance_delta_e": 0.02}
NOISES = [{}, {"render_noise": NOISE}]
CAUSES = [  # the longest words of each kind
    Cause("only 3.1 codes of the ADC between black and display white", 64.0, "more bits"),
    Cause("the ideal image has no contrast, L* 0.0 to 0.9", 50.0, "a scene with detail"),
    Cause(outside_share_text(0.3), 20.0, "a filter"),
    Cause("the lightest dot is 0.99 of a step of the ADC above black", 1.0, "more bits"),
]
NAMED = [[], CAUSES[:1], CAUSES[2:3], CAUSES[3:], CAUSES[2:]]
FRAME = {"pixels": (4170, 4170), "integration_s": 0.1, "saturated_fraction": 0.25}


@pytest.mark.parametrize("longest_s", [0.1, 1.0])
@pytest.mark.parametrize("delta_e", [[76.54], [76.1234, 76.5432, 76.9]])
def test_headlines_of_runs_are_short_and_name_the_largest_cause(
    delta_e: list[float], longest_s: float
) -> None:
    """Of runs whose errors are known in all the ways there are."""
    settings = {"exposure": {"max_integration_s": longest_s}, "display": {"dots": 512}}
    sizes = {"settings": settings, "frame": FRAME, "pitch_um": 5.857, "border_um": 10.6}
    for film, header, causes in product(FILMS, NOISES, NAMED):
        result = run_result(delta_e, header, film, causes, **sizes)
        head = plain_text(run_answer(result).head)
        assert len(head.split()) <= MAX_HEADLINE_WORDS, head
        assert head == f"mean ΔE {shown_mean_of(result)}"
        warnings = [cause.words in head for cause in causes] + ["not converged" in head]
        is_unsure = bool(causes) or not converged(result.light, result.light_limit)
        assert sum(warnings) == is_unsure, "one warning at most"


@pytest.mark.parametrize(
    ("metrics", "first", "other"),
    [
        (["detectability", "delta_e"], "seen: detectability d′", "mean ΔE"),
        (["delta_e", "detectability"], "mean ΔE", "seen: detectability d′"),
        ([], "seen: detectability d′", "mean ΔE"),
    ],
)
def test_headline_of_a_run_is_that_of_its_first_metric(
    metrics: list[str], first: str, other: str
) -> None:
    """Of a target without stated metrics, whether it is seen."""
    options = {"camera": {"die_mm": 0.2}, "pixel": {"bits": 12}, "display": {"dots": 48}}
    result = pixsim.run("target", resolution=48, metrics=metrics, **options)
    head, *lines = text(run_document(result)).splitlines()
    assert head.startswith(first)
    assert any(line.strip().startswith(other) for line in lines)


INTERVALS_UM = [(7.35, 7.88), (None, None), (None, 7.88), (16.0, None)]
NO_DIFFERENCES_UM = [None, (1.25, 12.74)]


@pytest.mark.parametrize("is_inside", [True, False])
@pytest.mark.parametrize("fit_swings", [True, False])
def test_headlines_of_studies_are_short(is_inside: bool, fit_swings: bool) -> None:
    """The answer and its interval, unless a range of sizes shows no difference, with one warning at
    most.
    """
    value = {"value": 76.5, "value_interval": (75.2, 77.8)}
    value |= {"mean_delta_e": 76.5, "mean_delta_e_interval": (75.2, 77.8)}
    within = {"within_1_percent_um": (None, None)}
    for interval_um, no_difference_um, film, header, causes in product(
        INTERVALS_UM, NO_DIFFERENCES_UM, FILMS, NOISES, NAMED
    ):
        best = SimpleNamespace(
            pitch_um=7.5, inside=is_inside, interval_um=interval_um, **value, **within
        )
        curve = SimpleNamespace(
            label="data sheet",
            optimum=best,
            pitch_um=np.geomspace(0.47, 15.0, 8),
            errors=CurveErrors(*light_error_and_limit(header, film), causes),
            fit_swings=fit_swings,
            no_difference_um=no_difference_um,
            on_displays=[SimpleNamespace(dots=1024, optimum=best)],
            judged_by_delta_e=True,
            metrics=(DELTA_E,),
            case=CaseLabels(),
        )
        head = plain_text(optimum_answer(curve).head)
        assert len(head.split()) <= MAX_HEADLINE_WORDS, head
        if no_difference_um is None:
            size = "optimal pixel size 7.50 µm" if is_inside else "no optimum between 0.47 µm and"
            assert head.startswith(f"data sheet: {size}")
        assert sum([cause.words in head for cause in causes] + ["not converged" in head]) <= 1


SMALL = (
    "--scene slanted_edge --display.dots 120 --resolution 48 --repeats 3 --jobs 1 --variant"
    " scalar_spectral"
)


def test_stages_are_named_in_the_order_of_the_light() -> None:
    shutter = {"shutter": "rolling", "line_time_us": 10.0, "frames": 4}
    exposure = shutter | {"flicker_hz": 100.0, "flicker_depth": 0.5}
    settings = {"lens": {"veiling_glare": 0.03}, "motion": {"image_um_per_s": [100.0, 0.0]}}
    words = " ".join(stage_words(Run.model_validate(settings | {"exposure": exposure})))
    assert re.match("veiling glare 3 % .*rolling shutter, .*flickers at 100 Hz .*4 exp", words)


def test_compare_dry_run_writes_nothing(tmp_path: Path) -> None:
    files = two_sheets(tmp_path)
    line = f"compare {SMALL} --dry-run --json --match lens --out {tmp_path / 'out'}"
    code, out, err = command(line, *files)
    assert (code, err, sorted(tmp_path.iterdir())) == (0, "", sorted(files))
    content = json.loads(out)
    cameras = [sensor["camera"] for sensor in content["sensors"].values()]
    assert [camera["focal_length_mm"] for camera in cameras] == [3.86, 3.86]
    assert content["film"]["samples"] == [36, 48]


def test_compare_of_three_has_a_difference_for_each_pair(tmp_path: Path) -> None:
    """That of the means of its sensors."""
    files = [*two_sheets(tmp_path), sheet(tmp_path / "worst.toml", 400.0, prnu=0.0)]
    options = SMALL.replace("--repeats 3", "--repeats 2 --match view --json")
    content = json.loads(output_of(f"compare {options} --out {tmp_path / 'out'}", *files))
    assert list(content["pairs"]) == list(content["verdicts"]) == ["noisy_one", "worst"]
    for name, difference in content["difference"].items():
        scores = content["pairs"][name]["scores"]
        assert difference == pytest.approx(scores[name][1] - scores["quiet"][1], rel=1e-12)


# --- the words of an answer
# ---------------------------------------------------------------------------------------------

CERTAIN = " (probability > .75)"  # two pairs


@pytest.mark.parametrize(
    ("first", "other", "film", "words"),
    [
        ([1.0, 1.01], [1.2, 1.211], 0.0, "a is better than b by 0.2005 ± 0.0064 ΔE (probability > .75)"),
        ([1.2, 1.21], [1.0, 1.011], 0.0, "b is better than a by 0.1995 ± 0.0064 ΔE (probability > .75)"),
        ([1.0, 1.0], [1.2, 1.2], 0.0, "a is better than b by 0.2000 ± 0.0000 ΔE (probability > .75)"),
        ([1.0, 1.0], [1.2, 1.2], 0.05, "a is better than b by 0.20 ± 0.05 ΔE (probability > .75)"),
        ([1.0, 1.0], [1.2, 1.2], 0.3, "a and b cannot be told apart: a is better by 0.2 ± 0.3 ΔE (probability > .75)"),
        ([1, 1], [1.2, 1.2], None, "a is better than b by 0.2000 ± 0.0000 ΔE and the unknown error of the film" + CERTAIN),
        ([1.0, 1.2], [1.1, 1.2], 0.0, "a and b cannot be told apart: a is better by 0.1 ± 0.6 ΔE (probability .75)"),
        ([1, 1], [1.02, 1.02], 0.0, "a is better than b by 0.0200 ± 0.0000 ΔE" + CERTAIN + ", no visible difference (< 0.05 ΔE)"),
        ([1.0, 1.1], [1.0, 1.1], 0.01, "a and b have the same mean ΔE in every pair of frames"),
    ],
)  # fmt: skip
def test_verdict_is_as_sure_as_its_numbers(
    first: list[float], other: list[float], film: float | None, words: str
) -> None:
    pairs = Pairs(("a", "b"), np.array(first, float), np.array(other, float))
    assert pair_sentence(pairs, film) == words


@pytest.mark.parametrize(
    ("differences", "words"),
    [
        ((0.2, 0.6, 0.2), []),
        ((0.2, 0.005, 0.2), []),
        (
            (0.2, -0.2, 0.2),
            ["depends on the display: a is better on 600 dots, b on 300 dots, a on 1200 dots"],
        ),
        ((0.005, -0.2, 0.2), ["depends on the display: b is better on 300 dots, a on 1200 dots"]),
    ],
)
def test_verdict_depends_on_the_display_where_the_sign_differs(
    differences: tuple[float, ...], words: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    on_displays = [
        DisplayDifference(dots, difference, (difference - 0.01, difference + 0.01), 0.0)
        for dots, difference in zip((600, 300, 1200), differences, strict=True)
    ]
    monkeypatch.setattr(
        Comparison, "display_differences", lambda self, other, match=None: on_displays
    )
    monkeypatch.setattr(
        Comparison,
        "groups",
        lambda self, match=None: [SimpleNamespace(first=SimpleNamespace(condition=""))],
    )
    monkeypatch.setattr(Comparison, "sign", lambda self, other, match=None: 1)
    job = SimpleNamespace(names=("a", "b"), matches=("view",))
    assert dependences(Comparison(job, None, ()), "b") == words  # type: ignore[arg-type]


@pytest.mark.parametrize("metrics", [["detectability"], ["detectability", "delta_e"]])
def test_first_metric_decides_and_delta_e_stands_where_it_was_asked_for(
    metrics: list[str], tmp_path: Path
) -> None:
    """In the terminal, the page, the figure's table and the JSON."""
    options = " ".join(f"--metric {name}" for name in metrics)
    small = "--scene target --display.dots 32 --resolution 64 --repeats 3 --jobs 1 --match view"
    line = f"compare {options} {small} --out {tmp_path / 'out'}"
    assert "in detectability d′" in output_of(line, *two_sheets(tmp_path)).splitlines()[0]
    page = (tmp_path / "out/report.html").read_text(encoding="utf-8")
    assert ("mean ΔE" in re.sub(r'"data:[^"]*"', "", page)) == ("delta_e" in metrics)

    content = json.loads((tmp_path / "out/compare.json").read_text(encoding="utf-8"))
    table = rows(tmp_path / "out/figures/scores.csv")
    for name in content["names"]:
        values = [float(row["detectability"]) for row in table if row["sensor"] == name]
        assert np.mean(values) == pytest.approx(
            content["metrics"]["detectability"]["scores"][name][1]
        )


@pytest.mark.parametrize(
    ("signs", "words"),
    [
        (
            [1, -1, 0],
            (
                "a is better than b at light 100, b is better than a at light 0.05, neither is"
                " clearly better at light 1"
            ),
        ),
        ([1, 1, 1], "a is better than b in all 3 cases"),
        ([0, 0, 0], "neither is clearly better in all 3 cases"),
    ],
)
def test_headline_over_axes_says_where_which_is_better(
    signs: list[int], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    cases = [Case(settings=Run(), at={"light": light}) for light in (100, 0.05, 1)]
    job = SimpleNamespace(names=("a", "b"), match="lens", combinations=cases, base=(Run(),))
    monkeypatch.setattr("pixsim.report.verdicts.dependences", lambda result, other: [])
    monkeypatch.setattr(
        Comparison, "sign", lambda self, other, metric=None: signs[self.combination]
    )
    assert better_cases_words(Comparison(job, None, ()), "b") == f"{words} with match lens"  # type: ignore[arg-type]


def test_each_value_of_an_axis_is_a_comparison_of_its_own(here: Path) -> None:
    """Bit for bit."""
    files = two_sheets(here)
    axis = (
        '{ name = "light", set = "scene.parameters.luminance_cd_per_m2", values = [0.05, 100.0] }'
    )
    Path("lights.toml").write_text(f'name = "lights"\naxis = [{axis}]\n', encoding="utf-8")
    small = "--scene flat --display.dots 32 --resolution 48 --repeats 3 --jobs 1 --match view"
    out = output_of(f"compare --study lights.toml --out out {small}", *files)
    content = json.loads(Path("out/compare.json").read_text(encoding="utf-8"))
    assert out.splitlines()[0] == content["verdicts"][content["names"][1]]
    options = {"display": {"dots": 32}, "resolution": 48, "repeats": 3, "jobs": 1, "match": "view"}
    for light, case in zip((0.05, 100.0), content["cases"], strict=True):
        alone = pixsim.compare(files, "flat", parameters={"luminance_cd_per_m2": light}, **options)
        assert case == {"at": {"light": light}} | json.loads(json.dumps(numbers(alone)))
