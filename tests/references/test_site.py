"""The documentation site builds without warnings, has no dead links, and works from disk and on
narrow screens.
"""

import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import pytest
from helpers.processes import HANG_S
from references.layout import in_frames, needs_browser

for needed in ("sphinx", "myst_parser", "furo"):
    if find_spec(needed) is None:  # not imported, which takes a second of each worker's collection
        pytest.skip(f"{needed} is not installed: pip install '.[docs]'", allow_module_level=True)

# Before a release. The site takes long to build; part of `.ci/run`, which builds it on one worker.
pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("site")]
ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
if not (DOCS / "conf.py").is_file():
    pytest.skip("the tests are installed without the pages' sources", allow_module_level=True)
PAGES_ELSEWHERE = ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "scenes/README.md")
MARKDOWN = [*(ROOT / name for name in PAGES_ELSEWHERE), *sorted(DOCS.rglob("*.md"))]


def sphinx(builder: str, out: Path) -> subprocess.CompletedProcess[str]:
    """Build the site with a builder of Sphinx."""
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-W",
        "-n",
        "--keep-going",
        "-q",
        "-b",
        builder,
        "-d",
        str(out / "../trees"),
    ]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(
        [*command, str(DOCS), str(out)],
        capture_output=True,
        encoding="utf-8",
        env=environment,
        timeout=HANG_S,
    )


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site in HTML, which takes half a minute."""
    out = tmp_path_factory.mktemp("site") / "html"
    done = sphinx("html", out)
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    return out


class Page(HTMLParser):
    """Anchors, links and fetched resources of a page."""

    FETCHED = ("img", "script", "link", "iframe", "source", "video", "audio", "embed", "object")

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.ids: set[str] = set()
        self.links: list[str] = []
        self.fetched: list[str] = []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {name: value or "" for name, value in attrs}
        self.ids |= {values[name] for name in ("id", "name") if name in values}
        if tag == "a" and "href" in values:
            self.links.append(values["href"])
        if tag in self.FETCHED and values.get("rel", "stylesheet") in (
            "stylesheet",
            "icon",
            "preload",
            "prefetch",
            "manifest",
        ):
            self.fetched += [
                values[name] for name in ("src", "href", "srcset", "data") if name in values
            ]


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[Path, Page]:
    return {path: Page(path) for path in sorted(site.rglob("*.html"))}


def test_site_has_no_dead_links(pages: dict[Path, Page]) -> None:
    """To a file, or to a place of a page."""
    links = [
        (path, link, urlsplit(link))
        for path, page in pages.items()
        for link in page.links
        if not (urlsplit(link).scheme or urlsplit(link).netloc)
    ]
    assert len(links) > 1000
    for path, link, parts in links:
        target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
        assert target in pages or target.is_file(), f"{path.name}: {link}"
        place = unquote(parts.fragment)
        assert not place or place in pages[target].ids, f"{path.name}: {link}, no such anchor"


def test_site_loads_nothing_from_network(site: Path, pages: dict[Path, Page]) -> None:
    fetched = [(path, link) for path, page in pages.items() for link in page.fetched]
    assert fetched
    for path, link in fetched:
        parts = urlsplit(link)
        assert parts.scheme in ("", "data"), link
        assert not parts.netloc, link
        assert parts.scheme or (path.parent / unquote(parts.path)).is_file(), link
    for style in site.rglob("*.css"):
        assert not re.search(
            r"(url\(\s*['\"]?|@import\s+['\"]?)(https?:)?//", style.read_text(encoding="utf-8")
        ), style
    for script in site.rglob("*.js"):
        code = re.sub(
            r"/\*.*?\*/|(?<![:'\"])//[^\n]*",
            "",
            script.read_text(encoding="utf-8"),
            flags=re.DOTALL,
        )
        assert not re.search(r"(fetch|importScripts|import|open)\(\s*['\"`](https?:)?//", code), (
            script
        )


def anchors(path: Path) -> set[str]:
    """Anchors of the headings of a Markdown file, as on GitHub."""
    text = re.sub(
        r"^(```|~~~).*?^\1", "", path.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL
    )
    slugs: set[str] = set()
    for heading in re.findall(r"^#{1,6} +(.+?)\s*#*$", text, re.MULTILINE):
        words = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading)
        slug = re.sub(r"[^\w\- ]", "", words.lower()).strip().replace(" ", "-")
        slugs.add(
            slug
            if slug not in slugs
            else f"{slug}-{sum(other.startswith(slug) for other in slugs)}"
        )
    return slugs


@pytest.mark.parametrize("path", MARKDOWN, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_markdown_has_no_dead_links(path: Path) -> None:
    text = re.sub(
        r"^(```|~~~).*?^\1|`[^`\n]*`",
        "",
        path.read_text(encoding="utf-8"),
        flags=re.MULTILINE | re.DOTALL,
    )
    for link in re.findall(r"\]\(([^()\s]+)\)", text):
        parts = urlsplit(link)
        if parts.scheme:
            assert parts.scheme == "https", link
            continue
        target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
        assert target.exists(), link
        assert not parts.fragment or parts.fragment in anchors(target), link


FRAMES = """<!DOCTYPE html><title></title>{frames}
<script>
onload = () => {{
  document.title = JSON.stringify([...document.querySelectorAll("iframe")].map(frame => {{
    const page = frame.contentDocument, root = page.documentElement;
    const pictures = [...page.images].filter(each => each.naturalWidth == 0).map(each => each.src);
    const out = [...page.querySelectorAll("article *")].filter(each => each.getBoundingClientRect().right > root.clientWidth + 1)
      .filter(each => !each.closest("pre, table, dt, .highlight, .toctree-wrapper") && each.getBoundingClientRect().width > 0);
    return [root.clientWidth, root.scrollWidth, page.title, pictures, out.map(each => each.outerHTML.slice(0, 80))];
  }}));
}};
</script>"""


def measured(paths: list[Path], width: int, folder: Path) -> list[Any]:
    """[available width, needed width, title, missing pictures, overflowing elements] of each
    page.
    """
    sources = [f'width="{width}" src="{path.as_uri()}"' for path in paths]
    return in_frames(
        FRAMES, sources, 900, folder, "--allow-file-access-from-files"
    )  # frames may read pages on disk


@needs_browser
@pytest.mark.parametrize("width", [400, 1280])
def test_site_pages_fit_width(width: int, pages: dict[Path, Page], tmp_path: Path) -> None:
    """On a telephone and a desktop; wide tables and code scroll."""
    indices = {"genindex", "py-modindex", "search"}
    paths = [path for path in pages if "_modules" not in path.parts and path.stem not in indices]
    assert len(paths) > 15
    for path, (available, needed, name, missing, out) in zip(
        paths, measured(paths, width, tmp_path), strict=True
    ):
        assert name, path
        assert width - 20 <= available <= width, "the frame has its width, except for a scroll bar"
        assert needed <= available, path
        assert missing == [], path
        assert out == [], path
