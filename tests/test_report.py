"""The report of a study: one file that opens offline, tells the optimum, and fits a telephone."""

import html
import json
import re
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest

import pixsim
from pixsim.report import write_report
from pixsim.sweep import StudyResult

TITLE = "<script>alert(1)</script> \"quoted\" & 'Ångström' µm"
STUDY = {
    "name": "tiny",
    "title": TITLE,
    "technologies": ["0.35um", "<b>&process.toml"],
    "repeats": 2,
    "iso_delta_e": 1.0,
    "scene": {"file": "csf", "parameters": {"resolution": 96, "spp": 4, "luminance_cd_per_m2": 100.0}},
    "pitch": {"values_um": [5.3, 6.0, 7.0, 8.5, 11.0, 15.0]},
    "display": {"dots": 96, "samples_per_deg": 10.0},
}
BROWSER = shutil.which("chromium") or shutil.which("google-chrome")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[StudyResult, Path]]:
    folder = tmp_path_factory.mktemp("report")
    process = Path(pixsim.__file__).parent / "data/technologies/0.35um.toml"
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        other = process.read_text(encoding="utf-8").replace('name = "0.35um"', 'name = "other"')
        Path(STUDY["technologies"][1]).write_text(other, encoding="utf-8")
        result = pixsim.study(pixsim.Study.model_validate(STUDY), folder / "out", jobs=1)
        write_report(result, folder / "out", {"render": 1.25})
        yield result, folder / "out"


class Elements(HTMLParser):
    """Tags, and the values of attributes that make a browser fetch something."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.links: list[str] = []
        self.words: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [value or "" for name, value in attrs if name in {"src", "href", "srcset", "data", "poster"}]

    def handle_data(self, data: str) -> None:
        self.words.append(data)


def text_of(folder: Path) -> str:
    return (folder / "report.html").read_text(encoding="utf-8")


def test_the_report_is_one_file_that_opens_offline(made: tuple[StudyResult, Path]) -> None:
    page = text_of(made[1])
    elements = Elements(page)
    assert elements.links
    assert all(link.startswith("data:") for link in elements.links)
    assert not {"script", "link", "iframe", "object", "embed", "base"} & set(elements.tags)
    assert not re.search(r"url\(|@import", page)
    assert str(made[1].parent) not in page, "a path of the machine it was made on"


def test_words_from_files_stay_words(made: tuple[StudyResult, Path]) -> None:
    """The title and a technology's name hold markup; a reader sees them letter by letter."""
    words = "".join(Elements(text_of(made[1])).words)
    assert words.count(TITLE) == 2  # <title> and <h1>
    assert "<b>&process" in words


def test_the_report_tells_what_summary_json_holds(made: tuple[StudyResult, Path]) -> None:
    words = " ".join("".join(Elements(text_of(made[1])).words).split())
    for curve in json.loads((made[1] / "summary.json").read_text(encoding="utf-8"))["curves"]:
        best = curve["optimum"]
        assert best["inside"]
        assert f"{best['pitch_um']:.2f} ± {best['ci95_um']:.2f} µm" in words
        low, high = best["within_1_percent_um"]
        assert f"{low:.2f} to {high:.2f} µm" in words
        for pitch_um, delta_e in zip(curve["pitch_um"], curve["mean_delta_e"], strict=True):
            assert f"{pitch_um:.3f}" in words
            assert f"{delta_e:.4f}" in words


def test_a_minimum_at_the_end_is_not_sold_as_the_best(made: tuple[StudyResult, Path], tmp_path: Path) -> None:
    result = made[0]
    curve = result.curves[0]
    at_the_end = replace(curve, optimum=replace(curve.optimum, inside=False, pitch_um=15.0))
    write_report(replace(result, curves=(at_the_end,)), tmp_path, {})
    words = " ".join("".join(Elements(text_of(tmp_path)).words).split())
    assert "No best pixel size in 0.35um between 5.30 and 15.00 µm" in words
    assert "Best pixel size" not in words


def figures(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (folder / "figures").glob("*.svg")}


def test_figures_are_the_same_bytes_each_time_and_undated(made: tuple[StudyResult, Path], tmp_path: Path) -> None:
    result, folder = made
    write_report(result, tmp_path, {"render": 99.0})
    assert figures(folder) == figures(tmp_path)
    for svg in figures(folder).values():
        assert b"dc:date" not in svg
        assert not re.search(rb"\d{4}-\d\d-\d\dT\d\d", svg)


def test_each_technology_has_its_own_pictures(made: tuple[StudyResult, Path]) -> None:
    assert {"delta_e_against_pitch.svg", "pictures_0.35um.svg", "pictures_<b>&process.svg"} <= figures(made[1]).keys()
    assert len(set(figures(made[1]).values())) == len(figures(made[1]))
    assert text_of(made[1]).count("<img ") == len(figures(made[1]))


needs_browser = pytest.mark.skipif(BROWSER is None, reason="neither chromium nor google-chrome is on PATH")


def browse(page: Path, profile: Path) -> str:
    """The page as headless Chromium has it after loading; it is told to stay off the network."""
    quiet = ["background-networking", "component-update", "sync", "extensions", "default-apps"]
    command = [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--window-size=1600,1200"]
    command += [f"--disable-{name}" for name in quiet] + [f"--user-data-dir={profile}", "--dump-dom", page.as_uri()]
    return subprocess.run(command, capture_output=True, encoding="utf-8", check=True, timeout=60).stdout


@needs_browser
def test_a_browser_shows_the_optimum(made: tuple[StudyResult, Path], tmp_path: Path) -> None:
    dom = browse(made[1] / "report.html", tmp_path)
    best = made[0].curves[0].optimum
    assert f"<b>{best.pitch_um:.2f} ± {best.ci95_um:.2f} µm</b>" in dom
    assert dom.count(html.escape(TITLE, quote=False)) == 2


FRAME = """<!DOCTYPE html><title></title>
<iframe width="{width}" height="900" style="border: 0" srcdoc="{page}"></iframe>
<script>
onload = () => {{
  const page = document.querySelector("iframe").contentDocument;
  const root = page.documentElement;
  const pictures = [...page.images].map(each => each.naturalWidth > 0 && each.getBoundingClientRect().right <= {width});
  document.title = JSON.stringify([root.clientWidth, root.scrollWidth, page.body.scrollWidth, pictures]);
}};
</script>"""


@needs_browser
@pytest.mark.parametrize("width", [400, 1280])
def test_nothing_sticks_out_of_the_page(width: int, made: tuple[StudyResult, Path], tmp_path: Path) -> None:
    """A telephone and a desk; wide tables scroll within themselves."""
    frame = tmp_path / "frame.html"
    frame.write_text(FRAME.format(width=width, page=html.escape(text_of(made[1]))), encoding="utf-8")
    title = re.search(r"<title>(.*?)</title>", browse(frame, tmp_path / "profile"))
    room, *wide, pictures = json.loads(title[1])
    assert width - 20 <= room <= width, "the frame is as wide as it should be, but for a scroll bar"
    assert max(wide) <= room
    assert pictures == [True] * len(figures(made[1]))
