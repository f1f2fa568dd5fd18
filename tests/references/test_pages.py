"""Blocks of README, docs/ and notebooks are run; output and pictures must be those that they show.

The changes of docs/first_change.md do what the page says.

On the processor and with the packages of docs/made_on.toml, every digit must agree.
"""

import csv
import json
import os
import shutil
import subprocess
import sys
import warnings
from importlib.util import find_spec
from pathlib import Path

import pytest
from helpers.documents import ROOT, difference, differs_from_made_on
from helpers.looks import Elements
from helpers.processes import HANG_S
from references.notebooks import NOTEBOOKS, executed, outputs
from references.pages import Page, alike_pictures, differences, first_study

import pixsim

# Of minutes; `.ci/run` runs them apart from the judges, whose packages change how NumPy prints.
pytestmark = pytest.mark.slow
README = ROOT / "README.md"
PAGES = [
    README,
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "docs/gallery").glob("*.md")),
]
# First, so that in the end no worker waits for one of them.
LONGEST = (
    *(
        "inspection_line.md",
        "pixel_stack.md",
        "own_scene.md",
        "first_sensor.md",
        "compare.md",
        "colour.md",
        "rendering.md",
    ),
    *("questions.md", "not_known.md", "how_small.md"),
)


@pytest.fixture(scope="module")
def exact() -> bool:
    """Whether this is the machine of docs/made_on.toml; if not, a notice says what is compared."""
    if found := differs_from_made_on():
        warnings.warn(
            f"pages are compared within their intervals, not in every digit: {found}", stacklevel=1
        )
    return not found


@pytest.mark.parametrize(
    "path", sorted(PAGES, key=lambda path: path.name not in LONGEST), ids=lambda path: path.name
)
def test_page_blocks_give_shown_output(
    path: Path, exact: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MPLBACKEND", "agg")
    page = Page(path, tmp_path, exact)
    page.check()
    if path.name == "studies.md":
        report = tmp_path / "pixsim-out/chen2000/report.html"
        assert 1e6 < report.stat().st_size < 5e6, "what an e-mail takes"
    for shown, created in page.pictures:
        assert shown.is_file(), f"{path.name} shows {shown.name}, which does not exist"
        assert alike_pictures(shown, created, exact), (
            f"{shown} is outdated: run python tests/benchmarks/pages.py {path}"
        )


def test_readme_first_study_gives_shown_output(
    exact: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first study of README gives the output and the first picture that it shows, and what the
    paper says.

    Chen et al. (2000), figure 7: 6.5 µm in 0.35 µm CMOS. They do not state lens, response, ADC and
    display: ± 0.6 µm.
    """
    page = Page(first_study(README, tmp_path), tmp_path, exact)
    page.check()
    ((picture, drawn),) = page.pictures
    assert alike_pictures(ROOT / picture.relative_to(tmp_path), drawn, exact)
    (curve,) = pixsim.study("chen2000", drawn.parents[1], quick=True).curves  # its rows are stored
    best, mean = curve.optimum, curve.mean()
    assert (curve.technology, best.inside) == ("0.35um", True)
    assert best.pitch_um == pytest.approx(6.5, abs=0.6)
    assert best.half_width_um <= 0.1, "what the study asks for"
    assert mean[0] > 1.3 * best.mean_delta_e, "noise: 5 % fill factor"
    assert mean[-1] > 1.3 * best.mean_delta_e, "blur: 15 µm"


@pytest.mark.skipif(
    not (find_spec("nbclient") and find_spec("ipykernel")),
    reason="nbclient or ipykernel is not installed",
)
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_gives_shown_output(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Numbers within 2 %, or within the interval printed with them; results show themselves with a
    picture and no scripts.
    """
    import nbformat

    monkeypatch.setenv(
        "IPYTHONDIR", str(tmp_path / ".ipython")
    )  # both processes make one, else at home
    stored = outputs(nbformat.read(path, as_version=4))
    made = outputs(executed(path, tmp_path))
    assert [output[:2] for output in stored] == [output[:2] for output in made]
    assert any(kind == "text/html" for _, kind, _ in made)
    for (cell, kind, expected), (_, _, printed) in zip(stored, made, strict=True):
        if kind == "text/html":
            words = Elements(printed)
            assert "img" in words.tags
            assert "script" not in words.tags
        else:
            assert difference(expected.strip(), printed.strip(), exact=False) == "", f"cell {cell}"


# The changes of docs/first_change.md

FIRST_CHANGE = ROOT / "docs/first_change.md"
TESTS = "flicker or every_setting_of_a_frame or rms_luminance or mean_and_variance"
OF_METRICS = "viewer/test_score.py", "viewer/test_metrics.py", "studies/test_own_metrics.py"
FILES = ("sensor/test_readout.py", "viewer/test_without_effect.py", *OF_METRICS)


def test_changes_give_a_noise_an_axis_and_a_metric(tmp_path: Path) -> None:
    for name in ("pixsim", "tests", "scenes"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    for name, before, after in differences(FIRST_CHANGE.read_text(encoding="utf-8")):
        path = tmp_path / name
        path.write_text(path.read_text(encoding="utf-8").replace(before, after), encoding="utf-8")
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}

    def run(*words: str) -> str:
        done = subprocess.run(
            [sys.executable, "-m", *words],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            timeout=HANG_S,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    assert " passed" in run(
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "--basetemp",
        "runs",
        "-k",
        TESTS,
        *(f"tests/{name}" for name in FILES),
    )
    small = ["--resolution", "64", "--display.dots", "32", "--pixel.pitch-um", "21.2"]
    judged = ["--metric", "delta_e", "--metric", "rms_luminance"]
    quiet, noisy = (
        json.loads(run("pixsim", "run", "csf", *small, *judged, "--json", "--out", name, *more))
        for name, more in (("a", ()), ("b", ("--pixel.flicker-noise-e", "60000")))
    )
    assert 0 < quiet["rms_of_white"] < noisy["rms_of_white"]
    assert quiet["mean_delta_e"] < noisy["mean_delta_e"]
    sizes = ["--pitch.values-um", "15,20,25,30,40", "--jobs", "1", "--out", "c"]
    axes = ["--axis", "pixel.flicker_noise_e=0,300", "--axis", "display.gain=1,1.1"]
    run("pixsim", "study", "pixel-size", "--quick", *small[:4], *judged, *sizes, *axes)
    with (tmp_path / "c/results.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert "rms_of_white" in rows[0]
    rows_of_gain = {
        gain: [row for row in rows if float(row["display.gain"]) == gain] for gain in (1.0, 1.1)
    }
    for right, bright in zip(
        *rows_of_gain.values(), strict=True
    ):  # the same frames, of which no dot is at the end of the codes
        assert float(bright["rms_of_white"]) == pytest.approx(
            1.1 * float(right["rms_of_white"]), rel=1e-4
        )


# The runner itself


@pytest.mark.parametrize(
    "text",
    [
        "```sh\nexit 3\n```\n",
        "```sh\necho 'the time limit of 120 s ended rendering' >&2\n```\n",
        (
            "```python\nimport warnings\nwarnings.warn('the time limit of 120 s ended"
            " rendering')\n```\n"
        ),
        "```python\nassert 1 == 2\n```\n",
        "```sh\necho 1\n```\n\n<!-- output -->\n```text\n2\n```\n",
        "```python\nprint(1)\n```\n",
        "```python\nprint(1)\n```\n\n```python\nx = 2\n```\n",
        "<!-- output -->\n```sh\necho 1\n```\n",
        "<!-- picture: a.svg -->\nwords\n",
        "~~~sh\nexit 3\n~~~\n",
        "> ```sh\n> exit 3\n> ```\n",
        "```sh\ntrue\n",
    ],
)
def test_page_with_wrong_output_fails(text: str, tmp_path: Path) -> None:
    (tmp_path / "page.md").write_text(text, encoding="utf-8")
    with pytest.raises((AssertionError, UserWarning)):
        Page(tmp_path / "page.md", tmp_path).check()
