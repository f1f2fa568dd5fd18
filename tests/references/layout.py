"""The looks of pages in headless Chromium: at every width, light and dark, and on paper."""

import html
import json
import os
import re
import subprocess
import unicodedata
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import pytest
from helpers.browser import AXE, AXE_TAGS, BROWSER, DISABLED, FLAGS, MIN_TEXT_PX
from helpers.processes import HANG_S

needs_browser = pytest.mark.skipif(
    BROWSER is None, reason="neither chromium nor google-chrome is on PATH"
)
LOOKS = (
    (400, "light"),
    (1280, "light"),
    (1280, "dark"),
)  # a telephone and a desk; in the dark, only colours are looked at
# ms, which pass at once where nothing is computed: axe works in steps
VIRTUAL_TIME = "--virtual-time-budget=20000"
# Measure the page at every width in one start of the browser; the result is returned as the title.
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
    available: root.clientWidth, needed: Math.max(root.scrollWidth, page.body.scrollWidth), smallest,
    pictures: [...page.images].map(each => each.naturalWidth),
    outside: [...page.images].filter(each => at(each).right > root.clientWidth && !each.closest(".scroll")).length,
    tiles: [...page.querySelectorAll(".tile img")].map(
      each => [each.naturalWidth, each.clientWidth, each.naturalHeight, each.clientHeight]),
    unnamed: [...page.images].filter(each => !each.alt).length
      + [...page.querySelectorAll("input:not([hidden])")].filter(each => !each.labels.length).length,
    scrolls: [...page.querySelectorAll(".scroll")].filter(shown).map(each => [each.scrollWidth > each.clientWidth,
      frame.contentWindow.getComputedStyle(each, "::before").content.includes("move it sideways"), each.tabIndex === 0]),
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
async function findings(frame) {{
  const page = frame.contentDocument, script = page.createElement("script");
  script.src = "{axe}";
  await new Promise((resolve, reject) => {{ script.onload = resolve; script.onerror = reject; page.head.append(script); }});
  const tags = getComputedStyle(frame).colorScheme == "dark" ? ["cat.color"] : {tags};
  const found = await frame.contentWindow.axe.run(page, {{resultTypes: ["violations"], runOnly: tags}});
  return found.violations.flatMap(
    each => each.nodes.map(node => [each.impact, each.id, node.target.join(" "), node.failureSummary]));
}}
onload = async () => {{
  const frames = [...document.querySelectorAll("iframe")], results = frames.map(seen);
  for (const [index, frame] of frames.entries()) results[index].findings = await findings(frame);
  document.title = JSON.stringify(results);
}};
</script>"""


def browse(arguments: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    """Run Chromium without network services, and with a home folder of its own, where it writes
    settings and reports.
    """
    flags = [*FLAGS, f"user-data-dir={folder}/profile", *(f"disable-{name}" for name in DISABLED)]
    command = [BROWSER, *(f"--{flag}" for flag in flags), *arguments]
    own = {name: value for name, value in os.environ.items() if not name.startswith("XDG_")} | {
        "HOME": f"{folder}/profile"
    }
    options: dict = {
        "capture_output": True,
        "encoding": "utf-8",
        "errors": "replace",
        "check": True,
        "timeout": HANG_S,
    }
    return subprocess.run(command, env=own, **options)


def in_frames(
    script: str, sources: list[str], height: int, folder: Path, *arguments: str, **names: str
) -> list:
    """Results of a script in frames (`width="…" src="…"`), which it writes to the title as JSON;
    the console has no errors.
    """
    frame = folder / "frames.html"
    frames = "\n".join(f'<iframe height="{height}" {source}></iframe>' for source in sources)
    frame.write_text(script.format(frames=frames, **names), encoding="utf-8")
    done = browse([*arguments, "--dump-dom", frame.as_uri()], folder)
    assert "CONSOLE" not in done.stderr, done.stderr
    title = re.search(r"<title>(.*?)</title>", done.stdout, re.DOTALL)
    results: list = json.loads(html.unescape(title[1]))
    assert len(results) == len(sources)
    return results


def views_of(pages: Sequence[Path], folder: Path) -> list[list[SimpleNamespace]]:
    """The measurements of `FRAMES` of each page in each of `LOOKS`, in one start of the browser."""
    texts = [html.escape(page.read_text(encoding="utf-8")) for page in pages]
    frame = 'width="{}" style="border: 0; color-scheme: {}" srcdoc="{}"'
    sources = [frame.format(*look, text) for text in texts for look in LOOKS]
    results = in_frames(
        FRAMES, sources, 20000, folder, VIRTUAL_TIME, axe=AXE.as_uri(), tags=json.dumps(AXE_TAGS)
    )
    looks = [{"width": width, "scheme": scheme} for _ in pages for width, scheme in LOOKS]
    views = [SimpleNamespace(**look, **result) for look, result in zip(looks, results, strict=True)]
    return [views[first : first + len(LOOKS)] for first in range(0, len(views), len(LOOKS))]


def assert_fit(pages: Sequence[Path], folder: Path) -> list[list[SimpleNamespace]]:
    """At every width, light and dark: nothing overflows, text is legible, tiles are 1:1, and axe
    finds nothing to object to.
    """
    views = views_of(pages, folder)
    for view, page in (
        (view, page) for page, own in zip(pages, views, strict=True) for view in own
    ):
        assert view.width - 20 <= view.available <= view.width, (
            "the frame has its width, except for a scroll bar"
        )
        assert view.needed <= view.available, page
        assert min(view.pictures, default=0) > 0, f"{page}: a picture is missing or did not load"
        assert view.outside == 0, page
        assert view.smallest >= MIN_TEXT_PX, page
        assert all(
            natural == shown for tile in view.tiles for natural, shown in (tile[:2], tile[2:])
        ), page
        assert view.unnamed == 0, page
        assert all(wide == hint == stop for wide, hint, stop in view.scrolls), (
            "what is wide says so and is a stop of the keyboard"
        )
        assert view.findings == [], f"axe on {page} at {view.width} px, {view.scheme}"
        levels = [level for level, _ in view.headings]
        assert (levels[0], levels.count(1)) == (1, 1), page
        assert all(below <= above + 1 for above, below in pairwise(levels)), page
    return views


def assert_sliders_move(
    views: list[SimpleNamespace], pictures: int, left: str = "the ideal image"
) -> None:
    """The ideal image (or another picture, `left`) is left of the border, the chosen output right
    of it.
    """
    for view in views:
        assert view.sliders
        for slider in view.sliders:
            assert (slider["live"], slider["focusable"]) == (True, True)
            assert len(slider["results"]) == 3 * pictures
            assert slider["spoken"] == [
                f"{value} % of the width is {left}" for value, *_ in slider["results"]
            ]
            for index, (value, *met) in enumerate(slider["results"]):
                expected = [
                    "ideal" if share < value else f"out out-{index // 3}"
                    for share in (10, 30, 60, 90)
                ]
                assert met == expected, (view.width, value)


def print_page(page: Path, folder: Path):
    """The page printed to PDF, as pypdf reads it."""
    PdfReader = pytest.importorskip("pypdf", reason="pypdf is not installed").PdfReader
    target = folder / "page.pdf"
    browse(["--no-pdf-header-footer", f"--print-to-pdf={target}", page.as_uri()], folder)
    return PdfReader(target)


def assert_prints(
    page: Path,
    folder: Path,
    pages: range,
    texts: list[str],
    headings: list[str],
    pictured: Sequence[str] = (),
) -> None:
    """The print has the pages and texts expected, no clipped picture, and no heading alone at the
    foot of a page.

    pictured : headings with a bitmap below them on their page; vector figures stay vectors
    """
    reader = print_page(page, folder)
    assert len(reader.pages) in pages, f"{len(reader.pages)} pages"
    shown, text = set[str](), ""
    wanted = set(map(squeezed, headings))
    for number, sheet in enumerate(reader.pages, 1):
        width, height = (float(length) for length in sheet.mediabox[2:])
        lines: dict[float, str] = {}
        boxes: list[tuple[float, float, float, float]] = []

        def words(part: str, cm, tm, font, size: float, lines: dict[float, str] = lines) -> None:
            if part.strip():
                place = float(round(tm[4] * cm[1] + tm[5] * cm[3] + cm[5]))
                lines[place] = lines.get(place, "") + part

        def operand(name: bytes, args, cm, tm, boxes: list = boxes, sheet=sheet) -> None:
            if name == b"Do" and sheet["/Resources"]["/XObject"][args[0]]["/Subtype"] == "/Image":
                x, y = (sorted((cm[at], cm[at] + cm[at - 4] + cm[at - 2])) for at in (4, 5))
                boxes.append((x[0], y[0], x[1], y[1]))

        sheet.extract_text(visitor_text=words, visitor_operand_before=operand)
        for left, low, right, high in boxes:
            assert -1 <= left <= right <= width + 1, f"page {number}"
            assert -1 <= low <= high <= height + 1, f"page {number}"
        for place, line in lines.items():
            if squeezed(line) in wanted:
                assert place > FOOT_PT, f"page {number}: {line!r} stands alone at its foot"
                is_pictured = any(low < place for _, low, _, _ in boxes)
                shown |= {squeezed(line)} if is_pictured else set()
        text += squeezed("".join(lines.values()))
    assert {*map(squeezed, pictured)} <= shown, f"pictured: {sorted(shown)}"
    assert not [words for words in [*texts, *headings] if squeezed(words) not in text]


FOOT_PT = 70  # a margin of 0.4 inch (29 pt) and one or two lines


def squeezed(text: str) -> str:
    """Text without spaces and ligatures."""
    return re.sub(r"\s+", "", unicodedata.normalize("NFKC", text))
