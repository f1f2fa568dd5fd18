"""Metrics of a user's own: functions of a Score in studies, their code in the keys of rows, and
entry points of packages.
"""

import sys
import types

import numpy as np
import pytest
from helpers.tiny import rows, tiny_toml

import pixsim
from pixsim import (
    Camera,
    Display,
    Pixel,
    PixsimError,
    SpectralImage,
    compare,
    evaluate,
    run,
    score_pictures,
    study,
)
from pixsim.base.user_code import content_of
from pixsim.viewer import metric_registry
from pixsim.viewer.metric_registry import METRICS, metrics_named

EVEN = np.full((8, 8), 0.5)


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    path = tmp_path_factory.mktemp("plan") / "small.toml"
    path.write_text(tiny_toml())
    return path


def rms_error(score):
    return float(np.sqrt(np.mean((score.image - score.ideal) ** 2)))


rms_error.unit, rms_error.title, rms_error.unseen = (
    "of white",
    "RMS error",
    "what the eye does not see",
)


def test_a_function_is_a_metric_of_a_study_in_any_process(plan, tmp_path):
    """Workers get it by value, and know no function by its name: neither for frames, nor for the
    lights that they compute.
    """
    axis = [{"name": "aperture", "set": "camera.f_number", "values": [2.8, 8.0]}]
    for jobs in (1, 2):
        result = study(
            plan, tmp_path / str(jobs), metrics=["delta_e", rms_error], axis=axis, jobs=jobs
        )
    assert (tmp_path / "1/results.csv").read_bytes() == (tmp_path / "2/results.csv").read_bytes()
    values = np.array([curve.statistics["rms_error"] for curve in result.curves])
    assert values.shape == (2, 6, 2)
    assert [float(row["rms_error"]) for row in rows(tmp_path / "2")] == values.ravel().tolist()
    assert 0 < values.min() < values.max() < 1
    metric = result.curves[0].metrics[1]
    assert (metric.label, metric.better, metric.unseen) == (
        "RMS error (of white)",
        "less",
        "what the eye does not see",
    )


def test_rows_of_another_code_are_computed_anew_and_those_of_the_same_are_not(plan, tmp_path):
    calls = types.SimpleNamespace(count=0)
    pixsim.calls_of_test = calls  # of a module, which is no part of a function's content

    def made(factor):
        def scaled(score):
            pixsim.calls_of_test.count += 1
            return factor * rms_error(score)

        return scaled

    counts, values = [], []
    try:
        for factor in (1.0, 1.0, 2.0):
            before = calls.count
            result = study(plan, tmp_path, metrics=["delta_e", made(factor)], jobs=1)
            counts.append(calls.count - before)
            values.append(result.curves[0].statistics["scaled"])
    finally:
        del pixsim.calls_of_test
    assert counts == [12, 0, 12]
    assert np.array_equal(values[1], values[0])
    assert np.array_equal(values[2], 2 * values[0])


def from_text(text, **names):
    scope = {"np": np, **names}
    exec(text, scope)
    return scope["mine"]


BASE = "def mine(score):\n    return float(score.image.mean())"


@pytest.mark.parametrize(
    ("other", "alike"),
    [
        ("def mine(score):\n    # another remark\n    return float(score.image.mean())", True),
        ("def mine(score):\n    return float(score.ideal.mean())", False),
        ("def mine(score):\n    return float(score.image.mean()) + 1", False),
        ("def mine(score, power=2):\n    return float(score.image.mean())", False),
        ("def mine(score):\n    return (lambda x: float(x.mean()))(score.image)", False),
    ],
)
def test_content_of_a_function_is_its_code(other, alike):
    assert (content_of(from_text(BASE), []) == content_of(from_text(other), [])) is alike


def test_content_of_a_function_has_what_it_refers_to():
    """A value, an array, a function, and what that refers to; not a name that only looks like a
    value's.
    """
    text = "def mine(score):\n    return helper(score.image) + bias"
    helper = "def mine(x):\n    return float(x.mean()) * gain"
    first = from_text(text, helper=from_text(helper, gain=1.0), bias=0.0)
    for gain, bias, image, alike in (
        (1.0, 0.0, 5, True),
        (2.0, 0.0, 5, False),
        (1.0, 0.5, 5, False),
        (np.ones(3), 0.0, 5, False),
    ):
        other = from_text(text, helper=from_text(helper, gain=gain), bias=bias, image=image)
        assert (content_of(first, []) == content_of(other, [])) is alike
    recursive = from_text("def mine(score):\n    return mine(score)")
    assert content_of(recursive, []) == content_of(
        from_text("def mine(score):\n    return mine(score)"), []
    )


def returns(value, name="mine", **marks):
    def mine(score):
        return value

    mine.__name__ = name
    vars(mine).update(marks)
    return mine


@pytest.mark.parametrize(
    ("metrics", "message"),
    [
        ([lambda score: 1.0], "a named function, not a lambda: its name becomes that of a column"),
        ([returns(1.0), returns(2.0)], "'mine' twice; allowed: metrics of different names"),
        (["delta_e", "delta_e"], "'delta_e' twice"),
        (
            ["sharpness"],
            "'sharpness'; allowed: any of delta_e, .*A function of your own is given in Python",
        ),
        ([returns(1.0, "delta_e")], "a function 'delta_e', which is a name of pixsim's"),
        ([returns(1.0, "pitch_um")], "a function 'pitch_um', which is a name of pixsim's"),
        ([returns(1.0, "visual_noise")], "a function 'visual_noise', which is a name of pixsim's"),
        ([returns(1.0, better="up")], "mine.better = 'up'; allowed: 'less' or 'more'"),
        (
            [returns(np.nan)],
            "nan of mine; allowed: a function that returns one finite number of a Score",
        ),
        ([returns(None)], "None of mine; allowed: a function that returns one finite number"),
        ([returns(True)], "True of mine"),
        ([returns(np.ones(2))], r"array\(.*\) of mine"),  # other packages change how NumPy prints
        ([3], r"metrics.*got 3"),
        ([], "metrics: got none"),
    ],
)
def test_what_is_no_metric_says_why(metrics, message):
    with pytest.raises(PixsimError, match=message):
        score_pictures(EVEN, EVEN, metrics=metrics)
    assert metrics_named(["delta_e"]) == (METRICS["delta_e"],), (
        "the refused function has left nothing"
    )


def test_a_function_that_returns_nan_ends_a_study_with_its_name(plan, tmp_path):
    with pytest.raises(
        PixsimError,
        match="nan of mine; allowed: a function that returns one finite number of a Score",
    ):
        study(plan, tmp_path, metrics=["delta_e", returns(np.nan)], jobs=1)


def test_an_axis_may_not_have_the_name_of_a_metric_of_ones_own(plan, tmp_path):
    axis = [{"name": "rms_error", "set": "camera.f_number", "values": [2.0, 4.0]}]
    with pytest.raises(PixsimError, match="name = 'rms_error', a column of every study"):
        study(plan, tmp_path, metrics=["delta_e", rms_error], axis=axis)


def test_runs_and_comparisons_take_functions_too():
    """The quieter sensor has the smaller error."""
    small = {
        "display": {"dots": 32},
        "resolution": 48,
        "pixel": {"pitch_um": 60.0},
        "metrics": ["delta_e", rms_error],
    }
    result = run("csf", **small)
    assert result.score.metrics["rms_error"] == rms_error(result.score)
    of_sensors = compare(
        ["0.35um", "4t-bsi"], repeats=2, jobs=1, camera={"die_mm": 2.7}, **small
    ).judged["rms_error"]
    assert of_sensors["4t-bsi"].mean() < of_sensors["0.35um"].mean()


def test_a_number_of_numpy_is_a_number():
    assert score_pictures(EVEN, EVEN, metrics=[returns(np.float32(0.5))]).metrics == {"mine": 0.5}


@pytest.fixture
def package(tmp_path, monkeypatch):
    """An installed package with three entry points, of which two fail."""
    info = tmp_path / "mymetrics-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: mymetrics\nVersion: 1.0\n")
    points = (
        "[pixsim.metrics]\ncontrast = mymetrics:michelson\nbroken = mymetrics:missing\nnoname ="
        " mymetrics:number\n"
    )
    (info / "entry_points.txt").write_text(points)
    code = (
        "def michelson(score):\n    high, low = score.image.max(), score.image.min()\n    return"
        " (high - low) / (high + low)\n"
    )
    (tmp_path / "mymetrics.py").write_text(f"{code}\n\nmichelson.better = 'more'\nnumber = 3\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    yield
    metric_registry.installed_metric.cache_clear()
    sys.modules.pop("mymetrics", None)


def test_entry_points_of_installed_packages_are_metrics(package):
    """Light of 1/4 and 3/4, of a display without gamma: (3/4 - 1/4)/1."""
    picture = np.repeat([[0.25, 0.75]], 4, axis=0)
    display = Display(gamma=1.0, bits=16)
    score = score_pictures(picture, picture, display, metrics=["contrast"])
    assert score.metrics == {"contrast": pytest.approx(0.5, abs=1e-4)}
    assert metrics_named(["contrast"])[0].better == "more"
    light = SpectralImage(
        [550.0], 10.0, 10.0, data=np.full((48, 48, 1), 1e-3), header={"diffraction": False}
    )
    own = {"display": Display(dots=48, white_cd_per_m2=1000.0), "metrics": ["delta_e", "contrast"]}
    frame = evaluate(light, Camera(die_mm=0.48), Pixel(), **own)
    assert frame.statistics()["contrast"] == frame.metrics["contrast"] > 0


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("broken", "'broken' of the package mymetrics, which fails .AttributeError: .*missing"),
        ("noname", "'noname' of the package mymetrics, which fails"),
        ("other", "'other'; allowed: any of delta_e, .*contrast"),
    ],
)
def test_an_entry_point_that_fails_is_named(package, name, message):
    with pytest.raises(PixsimError, match=message):
        score_pictures(EVEN, EVEN, metrics=[name])


def test_every_metric_stands_in_the_help_of_the_commands():
    from pixsim.cli.options import Metrics

    text = Metrics.__metadata__[-1].help
    assert [name for name in METRICS if name not in text] == []
