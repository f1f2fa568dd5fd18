"""Metrics of a user's own: functions of a Score in studies, their code in the keys of rows, and
entry points of packages.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from helpers.tiny import tiny_toml

from pixsim import Display, Frame, PixsimError, compare, run, score_pictures, study
from pixsim.base.user_code import content_of
from pixsim.viewer import metric_registry
from pixsim.viewer.metric_registry import METRICS, metrics_named


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plan") / "small.toml"
    path.write_text(tiny_toml())
    return path


def rms_error(score) -> float:
    return float(np.sqrt(np.mean((score.image - score.ideal) ** 2)))


vars(rms_error).update(unit="of white", title="RMS error", unseen="what the eye does not see")


@pytest.mark.slow
def test_a_function_is_a_metric_of_a_study_in_any_process(plan: Path, tmp_path: Path) -> None:
    """Workers get it by value, and know no function by its name: neither for frames, nor for the
    lights that they compute. So they get one that denoises, which is local here.
    """

    def halved(plane: np.ndarray, strength: float) -> np.ndarray:
        return (plane + plane.mean()) / 2

    axis = [{"name": "aperture", "set": "camera.f_number", "values": [2.8, 8.0]}]
    functions: dict = {"metrics": ["delta_e", rms_error], "develop": {"denoise": halved}}
    result = study(plan, tmp_path / "1", jobs=1, axis=axis, **functions)
    study(plan, tmp_path / "2", jobs=2, axis=axis, **functions)
    assert (tmp_path / "1/results.csv").read_bytes() == (tmp_path / "2/results.csv").read_bytes()
    values = np.array([curve.statistics["rms_error"] for curve in result.curves])
    assert values.shape == (2, 6, 2)
    assert 0 < values.min() < values.max() < 1
    assert "halved#" in result.settings_toml
    assert result.curves[0].metrics[1].label == "RMS error (of white)"


def test_rows_of_another_code_are_computed_anew_and_those_of_the_same_are_not(
    plan: Path, tmp_path: Path, evaluations: list[Frame]
) -> None:
    def made(factor: float):
        def scaled(score) -> float:
            return factor * rms_error(score)

        return scaled

    counts = []
    values = []
    for factor in (1.0, 1.0, 2.0):
        result = study(plan, tmp_path, metrics=["delta_e", made(factor)], jobs=1)
        counts.append(len(evaluations))
        values.append(result.curves[0].statistics["scaled"])
    assert counts == [12, 12, 24]
    np.testing.assert_array_equal(values, [values[0], values[0], 2 * values[0]])


def from_text(text: str, **names):
    scope = {"np": np, **names}
    exec(text, scope)
    return scope["mine"]


BASE = "def mine(score):\n    return float(score.image.mean())"


def of_helper(gain, bias: float, image: int = 0):
    helper = from_text("def mine(x):\n    return float(x.mean()) * gain", gain=gain)
    text = "def mine(score):\n    return helper(score.image) + bias"
    return from_text(text, helper=helper, bias=bias, image=image)


@pytest.mark.parametrize(
    ("first", "second", "alike"),
    [
        (from_text(BASE), from_text(BASE.replace("\n", "\n    # another remark\n")), True),
        (from_text(BASE), from_text(BASE.replace("image", "ideal")), False),
        (from_text(BASE), from_text(f"{BASE} + 1"), False),
        (from_text(BASE), from_text(BASE.replace("score)", "score, power=2)", 1)), False),
        # what it refers to, and what that refers to; not a name that only looks like a value's
        (of_helper(1.0, 0.0), of_helper(1.0, 0.0, image=5), True),
        (of_helper(1.0, 0.0), of_helper(2.0, 0.0), False),
        (of_helper(1.0, 0.0), of_helper(1.0, 0.5), False),
        (of_helper(1.0, 0.0), of_helper(np.ones(3), 0.0), False),
        (
            from_text("def mine(score):\n    return mine(score)"),
            from_text("def mine(score):\n    return mine(score)"),
            True,
        ),
    ],
)
def test_content_of_a_function_is_its_code_and_what_it_refers_to(
    first, second, alike: bool
) -> None:
    assert (content_of(first, []) == content_of(second, [])) is alike


def test_runs_and_comparisons_take_functions_too() -> None:
    """The quieter sensor has the smaller error."""
    small: dict = {
        "display": {"dots": 32},
        "resolution": 48,
        "pixel": {"pitch_um": 60.0},
        "metrics": ["delta_e", rms_error],
    }
    score = run("csf", **small).score
    assert score.metrics["rms_error"] == rms_error(score)
    pair = compare(["0.35um", "4t-bsi"], repeats=2, jobs=1, camera={"die_mm": 2.7}, **small)
    errors = pair.judged["rms_error"]
    assert errors["4t-bsi"].mean() < errors["0.35um"].mean()


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """An installed package with three entry points, of which two fail."""
    files = {
        "METADATA": "Metadata-Version: 2.1\nName: mymetrics\nVersion: 1.0\n",
        "entry_points.txt": """[pixsim.metrics]
contrast = mymetrics:michelson
broken = mymetrics:missing
noname = mymetrics:number
""",
        "../mymetrics.py": """
def michelson(score):
    high, low = score.image.max(), score.image.min()
    return (high - low) / (high + low)
michelson.better = 'more'
number = 3
""",
    }
    info = tmp_path / "mymetrics-1.0.dist-info"
    info.mkdir()
    for name, text in files.items():
        (info / name).write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield
    metric_registry.installed_metric.cache_clear()
    sys.modules.pop("mymetrics", None)


def test_entry_points_of_installed_packages_are_metrics(package: None) -> None:
    """Light of 1/4 and 3/4, of a display without gamma: (3/4 - 1/4)/1."""
    picture = np.repeat([[0.25, 0.75]], 4, axis=0)
    score = score_pictures(picture, picture, Display(gamma=1.0, bits=16), metrics=["contrast"])
    assert score.metrics == {"contrast": pytest.approx(0.5, abs=1e-4)}
    assert metrics_named(["contrast"])[0].better == "more"


@pytest.mark.parametrize("name", ["broken", "noname", "other"])
def test_an_entry_point_that_fails_is_named(package: None, name: str) -> None:
    with pytest.raises(PixsimError, match=f"'{name}'"):
        score_pictures(np.ones((8, 8)), np.ones((8, 8)), metrics=[name])
    assert metrics_named(["delta_e"]) == (METRICS["delta_e"],), "nothing is left"
