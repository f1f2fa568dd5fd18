"""Write the output of pages and notebooks of docs/ again.

    python tests/benchmarks/pages.py PAGE_OR_NOTEBOOK...

A page gets its output, its pictures, and docs/made_on.toml, which records the processor and the
packages; a notebook gets the outputs of its cells.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from helpers.documents import (
    ANY_LINES,
    MADE_ON,
    OF_MACHINE,
    ROOT,
    difference,
    this_machine,
    words_of,
)
from references.notebooks import executed
from references.pages import Block, Page, blocks_of, first_study

MADE_ON_HEAD = """\
# The processor and the packages that made the numbers and pictures of README.md and docs/. There, every digit comes out again.
# Other processors round some functions differently, which changes noise. (Written by tests/benchmarks/pages.py.)
"""


def write_made_on() -> None:
    made = this_machine()
    lines = [f'{name} = "{made[name]}"' for name in OF_MACHINE]
    lines += [
        "",
        "[packages]",
        *(f'{name} = "{version}"' for name, version in made["packages"].items()),
    ]
    MADE_ON.write_text(MADE_ON_HEAD + "\n".join(lines) + "\n", encoding="utf-8")


def updated(path: Path, outputs: list[tuple[Block, str]]) -> str:
    """The text of a page with its output blocks replaced.

    In a block with a line of …, the lines with the same words are replaced; it is named if that is
    not enough.
    """
    lines = path.read_text(encoding="utf-8").splitlines()
    for block, printed in reversed(outputs):
        end, new = (
            block.line + len(block.text.strip("\n").splitlines()),
            printed.rstrip().splitlines(),
        )
        if ANY_LINES in block.text.splitlines():
            same_words = {
                words_of(line): line.rstrip() for line in reversed(new)
            }  # "ISO 15739" and "ISO 12232" have the same
            new = [
                line if line in new else same_words.get(words_of(line), line)
                for line in block.text.splitlines()
            ]
            if message := difference("\n".join(new), printed):
                print(f"{path}, line {block.line}: CHANGE BY HAND: {message}\n{printed}")
        lines[block.line : end] = new
    return "\n".join(lines) + "\n"


def update_first_study(readme: Path) -> None:
    """Replace README's first output and its picture."""
    with tempfile.TemporaryDirectory() as folder:
        page = Page(first_study(readme, Path(folder)), Path(folder))
        old = page.path.read_text(encoding="utf-8")
        page.run()
        (block, _), text = page.outputs[0], readme.read_text(encoding="utf-8")
        new = next(
            other.text
            for other in blocks_of(updated(page.path, page.outputs))
            if "output" in other.comments
        )
        assert old.count(block.text) == 1
        assert text.count(block.text) == 1
        readme.write_text(text.replace(block.text, new), encoding="utf-8")
        ((_, created),) = page.pictures
        shown = next(other for other in blocks_of(old) if other.language == "picture")
        shutil.copyfile(created, readme.parent / shown.text)


def update_page(path: Path) -> None:
    if path.resolve() == ROOT / "README.md":
        update_first_study(path)
    with tempfile.TemporaryDirectory() as folder:
        page = Page(path, Path(folder))
        page.run()
        path.write_text(updated(path, page.outputs), encoding="utf-8")
        for picture, created in page.pictures:
            picture.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(created, picture)
            print(picture)
    write_made_on()


def update_notebook(path: Path) -> None:
    """Without what depends on the machine's speed and on the place of the package."""
    import nbformat

    with tempfile.TemporaryDirectory() as folder:
        notebook = executed(path, Path(folder))
    for cell in notebook.cells:
        if cell.cell_type == "code":
            cell.outputs = [output for output in cell.outputs if output.get("name") != "stderr"]
            streams = [output for output in cell.outputs if output.output_type == "stream"]
            for other in streams[1:]:
                streams[0].text += other.text
                cell.outputs.remove(other)
    nbformat.write(notebook, path)


def main(paths: list[str]) -> None:
    for path in map(Path, paths):
        if path.suffix == ".ipynb":
            update_notebook(path)
        else:
            update_page(path)


if __name__ == "__main__":
    main(sys.argv[1:])
