"""Blocks of README, docs/ and notebooks, and the examples of docstrings, are run; output and pictures must be those that they show.

On the processor and with the packages of docs/made_on.toml, every digit must agree.
"""

import doctest
import importlib
import inspect
import warnings
from importlib.util import find_spec
from pathlib import Path

import pytest
from helpers.documents import ROOT, difference, differs_from_made_on
from helpers.looks import Elements
from helpers.public_names import PUBLIC
from references.notebooks import NOTEBOOKS, executed, outputs
from references.pages import Page, alike_pictures, first_study

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


# Docstrings

# Functions for beginners, and kernels with a published number.
SHOWN = (
    *(
        "load_scene",
        "render",
        "evaluate",
        "study",
        "Camera",
        "derive",
        "make_sensor",
        "capture",
        "delta_e_map",
        "read_exr",
    ),
    *("read_frame", "edge_response", "make_plan", "load_technology", "SpectralImage", "make_chart"),
    *("compare", "datasheet", "accuracy", "sfr", "lens"),
    *(
        "optics.irradiance_factor",
        "optics.diffraction_otf",
        "photodiode.collected_charge_e",
        "pixel.fill_factor_law",
    ),
)


def test_docstring_examples_pass() -> None:
    """Their numbers are published values or closed forms."""
    finder = doctest.DocTestFinder(exclude_empty=True, recurse=False)
    runner = doctest.DocTestRunner()
    report: list[str] = []
    names = set()
    for name, thing in PUBLIC.items():
        getter = getattr(thing, "fget", None) or getattr(thing, "func", thing)
        plain = inspect.unwrap(getattr(getter, "__func__", getter))
        scope = vars(importlib.import_module(plain.__module__))
        for example in finder.find(plain, name, globs=dict(scope)):
            names |= {name} if example.examples else set()
            runner.run(example, out=report.append)
    assert runner.failures == 0, "".join(report)
    assert {f"pixsim.{name}" for name in SHOWN} <= names


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
