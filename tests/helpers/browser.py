"""Pages as headless Chromium shows and prints them; tests that need it are skipped where there is none."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from helpers.processes import HANG_S

BROWSER = shutil.which("chromium") or shutil.which("google-chrome")
needs_browser = pytest.mark.skipif(BROWSER is None, reason="neither chromium nor google-chrome is on PATH")
WIDTHS = (400, 1280)  # a telephone and a desk
MIN_TEXT_PX = 12
QUIET = ("background-networking", "component-update", "sync", "extensions", "default-apps", "quic", "gpu")

# The page at every width in a browser that is started once; what it finds comes back as the title.
FRAMES = """<!DOCTYPE html><title></title>{frames}
<script>
function seen(frame) {{
  const page = frame.contentDocument, root = page.documentElement, at = each => each.getBoundingClientRect();
  const shown = each => each.checkVisibility({{visibilityProperty: true}});
  const texts = page.createNodeIterator(page.body, NodeFilter.SHOW_TEXT);
  let text, smallest = 1e9;
  while (text = texts.nextNode())
    if (text.data.trim() && shown(text.parentElement))
      smallest = Math.min(smallest, parseFloat(frame.contentWindow.getComputedStyle(text.parentElement).fontSize));
  return {{
    room: root.clientWidth, wide: Math.max(root.scrollWidth, page.body.scrollWidth), smallest,
    pictures: [...page.images].map(each => each.naturalWidth),
    outside: [...page.images].filter(each => at(each).right > root.clientWidth && !each.closest(".scroll")).length,
    tiles: [...page.querySelectorAll(".tile img")].map(
      each => [each.naturalWidth, each.clientWidth, each.naturalHeight, each.clientHeight]),
    unnamed: [...page.images].filter(each => !each.alt).length
      + [...page.querySelectorAll("input:not([hidden])")].filter(each => !each.labels.length).length,
    headings: [...page.querySelectorAll("h1, h2, h3, h4")].map(each => [+each.tagName[1], each.textContent]),
    sliders: [...page.querySelectorAll(".compare")].map(each => moved(frame, page, each)),
  }};
}}
function moved(frame, page, each) {{
  const range = each.querySelector("input[type=range]"), box = each.querySelector(".stack").getBoundingClientRect();
  const at = share => page.elementFromPoint(box.left + share * box.width, box.top + box.height / 2);
  const hit = share => at(share).closest("figure, .border").className;
  const results = [], spoken = [];
  [...each.querySelectorAll("input.pick")].forEach(pick => {{
    pick.click();
    for (const value of [50, 20, 80]) {{
      range.value = value;
      range.dispatchEvent(new Event("input"));
      spoken.push(range.getAttribute("aria-valuetext"));
      results.push([value, ...[10, 30, 60, 90].map(share => hit(share / 100))]);
    }}
  }});
  return {{live: each.classList.contains("live"), focusable: range.tabIndex === 0, results, spoken}};
}}
onload = () => document.title = JSON.stringify([...document.querySelectorAll("iframe")].map(seen));
</script>"""


@dataclass(frozen=True)
class Seen:
    """What a page is at one width; see `FRAMES`."""

    width: int
    room: int
    wide: int
    smallest: float
    pictures: list[int]
    outside: int
    tiles: list[list[int]]
    unnamed: int
    headings: list[tuple[int, str]]
    sliders: list[dict[str, Any]]


def browse(arguments: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    """Chromium, told to stay off the network."""
    command = [
        BROWSER,
        "--headless",
        "--no-sandbox",
        "--no-first-run",
        "--window-size=1600,1200",
        f"--user-data-dir={folder}/profile",
    ]
    command += [*(f"--disable-{name}" for name in QUIET), "--enable-logging=stderr", *arguments]
    return subprocess.run(command, capture_output=True, encoding="utf-8", errors="replace", check=True, timeout=HANG_S)


def in_frames(script: str, sources: list[str], height: int, folder: Path, *arguments: str) -> list[Any]:
    """What a script, which puts JSON into its page's title, finds in frames (`width="…" src="…"`); no errors in the console."""
    frame = folder / "frames.html"
    frames = "\n".join(f'<iframe height="{height}" style="border: 0" {source}></iframe>' for source in sources)
    frame.write_text(script.format(frames=frames), encoding="utf-8")
    done = browse([*arguments, "--dump-dom", frame.as_uri()], folder)
    assert "CONSOLE" not in done.stderr, done.stderr
    title = re.search(r"<title>(.*?)</title>", done.stdout, re.DOTALL)
    assert title
    found: list[Any] = json.loads(html.unescape(title[1]))
    assert len(found) == len(sources)
    return found


def see(page: Path, folder: Path) -> list[Seen]:
    """The page at each of `WIDTHS`."""
    text = html.escape(page.read_text(encoding="utf-8"))
    found = in_frames(FRAMES, [f'width="{width}" srcdoc="{text}"' for width in WIDTHS], 20000, folder)
    return [Seen(width, **each) for width, each in zip(WIDTHS, found, strict=True)]


def assert_fits(page: Path, folder: Path) -> list[Seen]:
    """Nothing sticks out, all pictures load, text can be read, 1:1 is 1:1, and everything has a name, at every width."""
    found = see(page, folder)
    for seen in found:
        assert seen.width - 20 <= seen.room <= seen.width, "the frame is as wide as it should be, but for a scroll bar"
        assert seen.wide <= seen.room
        assert seen.pictures
        assert min(seen.pictures) > 0, "a picture that did not load"
        assert seen.outside == 0
        assert seen.smallest >= MIN_TEXT_PX
        assert all(natural == shown for tile in seen.tiles for natural, shown in (tile[:2], tile[2:]))
        assert seen.unnamed == 0
        levels = [level for level, _ in seen.headings]
        assert levels[0] == 1
        assert levels.count(1) == 1
        assert all(below <= above + 1 for above, below in pairwise(levels))
    return found


def assert_sliders_move(found: list[Seen], pictures: int) -> None:
    """Left of the border lies the ideal image, right of it the chosen output, by what a pointer meets there."""
    for seen in found:
        assert seen.sliders
        for slider in seen.sliders:
            assert slider["live"]
            assert slider["focusable"]
            assert len(slider["results"]) == 3 * pictures
            assert slider["spoken"] == [f"{value} % of the width is the ideal image" for value, *_ in slider["results"]]
            for index, (value, *met) in enumerate(slider["results"]):
                expected = ["ideal" if share < value else f"out out-{index // 3}" for share in (10, 30, 60, 90)]
                assert met == expected, (seen.width, value)


def print_page(page: Path, folder: Path) -> Any:
    """The page printed to PDF, as pypdf reads it."""
    PdfReader = pytest.importorskip("pypdf", reason="pypdf is not installed").PdfReader
    target = folder / "page.pdf"
    browse(["--no-pdf-header-footer", f"--print-to-pdf={target}", page.as_uri()], folder)
    return PdfReader(target)


def assert_prints(
    page: Path, folder: Path, pages: range, told: list[str], headings: list[str], pictured: list[str] | None = None
) -> None:
    """As many pages as expected, words in them, no picture over an edge, and no heading alone at the foot of a page.

    pictured : headings that have a bitmap under them on their page; figures of lines are printed as lines
    """
    reader = print_page(page, folder)
    assert len(reader.pages) in pages
    shown, text = set[str](), ""
    for number, sheet in enumerate(reader.pages, 1):
        width, height = (float(each) for each in sheet.mediabox[2:])
        lines: dict[float, str] = {}
        boxes: list[tuple[float, float, float, float]] = []

        def words(part: str, cm: Any, tm: Any, font: Any, size: float, lines: dict[float, str] = lines) -> None:
            if part.strip():
                place = float(round(tm[4] * cm[1] + tm[5] * cm[3] + cm[5]))
                lines[place] = lines.get(place, "") + part

        def operand(name: bytes, args: Any, cm: Any, tm: Any, boxes: list[Any] = boxes, sheet: Any = sheet) -> None:
            if name == b"Do" and sheet["/Resources"]["/XObject"][args[0]]["/Subtype"] == "/Image":
                x, y = (sorted((cm[at], cm[at] + cm[at - 4] + cm[at - 2])) for at in (4, 5))
                boxes.append((x[0], y[0], x[1], y[1]))

        sheet.extract_text(visitor_text=words, visitor_operand_before=operand)
        for left, low, right, high in boxes:
            assert -1 <= left <= right <= width + 1, f"page {number}"
            assert -1 <= low <= high <= height + 1, f"page {number}"
        for each in pictured or []:
            places = [place for place, line in lines.items() if squeezed(line) == squeezed(each)]
            if places and any(low < places[0] for _, low, _, _ in boxes):
                shown.add(each)
        text += squeezed("".join(lines.values()))
        for place, line in lines.items():
            if squeezed(line) in {squeezed(each) for each in headings}:
                assert place > FOOT_PT, f"page {number}: {line!r} stands alone at its foot"
    assert shown == set(pictured or [])
    for each in [*told, *headings]:
        assert squeezed(each) in text, each


FOOT_PT = 70  # a margin of 0.4 inch (29 pt) and a line or two of what follows


def squeezed(text: str) -> str:
    return re.sub(r"\s+", "", text)
