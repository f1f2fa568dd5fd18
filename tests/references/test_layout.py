"""How the pages of commands look in a browser and on paper; tests/report/test_golden.py has what they
say.
"""

from collections.abc import Callable
from pathlib import Path

import pytest
from helpers.answers import COMMANDS, Answer, answers_in
from references.layout import assert_fit, assert_prints, assert_sliders_move, needs_browser

# A browser, in `.ci/run`; the golden documents have the pages' content.
pytestmark = [pytest.mark.slow, needs_browser]


@pytest.fixture(scope="module")
def answer(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Answer]:
    return answers_in(tmp_path_factory.mktemp("desk"))


def test_pages_fit_screens(answer: Callable[[str], Answer], tmp_path: Path) -> None:
    """The sliders' pictures lie on the sides that the pages say; details are shown dot by dot."""
    sliders = {  # pictures of a slider, and what is on its left; details, and their dots
        "run": (1, "the ideal image", 3, 112),
        "compare": (2, "the picture of quiet", 6, 84),
        "two_runs": (3, "the picture of day", 0, 0),
    }
    pages = [answer(name).folder / "report.html" for name in COMMANDS]
    for name, views in zip(COMMANDS, assert_fit(pages, tmp_path), strict=True):
        if name in sliders:
            pictures, left, count, dots = sliders[name]
            assert_sliders_move(views, pictures, left)
            assert [view.tiles for view in views] == [[[dots] * 4] * count] * len(views), name


def test_page_prints(answer: Callable[[str], Answer], tmp_path: Path) -> None:
    """On a few sheets, with the map below the first heading."""
    headings = ["Where the errors are", "Numbers", "Settings"]
    texts = ["not converged", "10.6 µm pixels"]
    page = answer("run").folder / "report.html"
    assert_prints(page, tmp_path, range(2, 5), texts, headings, headings[:1])
