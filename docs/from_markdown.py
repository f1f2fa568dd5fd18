"""Markdown that reads well on GitHub and in the site: links between files, pages from elsewhere,
the reference.

A link to a page of the site stays one. A link to another file of the repository becomes its path,
as code; one to nothing fails the build.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from reference_text import with_directives
from sphinx.application import Sphinx
from sphinx.util import logging

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
# Pages that stand elsewhere in the repository: what docs/ has under these names is a line for
# readers on GitHub.
ELSEWHERE = {
    "repository/readme": ROOT / "README.md",
    "repository/scenes": ROOT / "scenes/README.md",
    "repository/changelog": ROOT / "CHANGELOG.md",
    "repository/contributing": ROOT / "CONTRIBUTING.md",
}
FENCE = re.compile(r"^ *(```|~~~)")
CODE_OR_LINK = re.compile(r"(`+[^`]*`+)|(!?)\[((?:[^\[\]]|\[[^\]]*\]\([^)]*\))*)\]\(([^()\s]+)\)")
logger = logging.getLogger(__name__)


def page_of(path: Path) -> str | None:
    """The document that shows a file."""
    for name, other in ELSEWHERE.items():
        if path == other:
            return name
    return (
        path.relative_to(DOCS).with_suffix("").as_posix()
        if path.is_relative_to(DOCS) and path.suffix == ".md"
        else None
    )


def rewritten(text: str, source: Path, docname: str) -> str:
    """The text of a file with links as the page `docname` needs them; nothing in code is
    touched.
    """
    here = (DOCS / docname).parent

    def link(match: re.Match[str]) -> str:
        code, picture, words, target = match.groups()
        if code:
            return code
        words = CODE_OR_LINK.sub(link, words)  # a picture within a link
        if re.match(r"[a-z+]+:|#", target):
            return f"{picture}[{words}]({target})"
        path, _, anchor = target.partition("#")
        found = Path(os.path.normpath(source.parent / path))
        if not found.exists() or not found.is_relative_to(ROOT):
            logger.warning("a link to nothing: %s", target, location=str(source))
            return words
        if picture:
            return f"![{words}]({os.path.relpath(found, here)})"
        page = page_of(found)
        if page:
            anchor = f"#{anchor}" if anchor else ""
            return f"[{words}]({os.path.relpath(DOCS / page, here)}.md{anchor})"
        name = found.relative_to(ROOT).as_posix()
        return words if name in words else f"{words} (`{name}`)"

    return "".join(part if fenced else CODE_OR_LINK.sub(link, part) for part, fenced in parts(text))


def parts(text: str) -> Iterator[tuple[str, bool]]:
    """Paragraphs, within which a link may go over to the next line, and (…, True) the lines of
    fenced blocks.
    """
    paragraph, fence = "", ""
    for line in text.splitlines():
        mark = FENCE.match(line)
        borders = bool(mark and fence in ("", mark[1]))
        if fence or borders or not line.strip():
            yield paragraph, False
            yield f"{line}\n", bool(fence or borders)
            paragraph = ""
        else:
            paragraph += f"{line}\n"
        if mark and borders:
            fence = "" if fence else mark[1]
    yield paragraph, False


def on_read(app: Sphinx, docname: str, content: list[str]) -> None:
    source = ELSEWHERE.get(docname, DOCS / f"{docname}.md")
    if docname in ELSEWHERE:
        app.env.note_dependency(str(source))
        content[0] = source.read_text(encoding="utf-8")
    content[0] = with_directives(content[0])
    content[0] = rewritten(content[0], source, docname)


def setup(app: Sphinx) -> dict[str, Any]:
    app.connect("source-read", on_read)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
