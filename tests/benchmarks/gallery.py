"""Processor time and memory of each page of docs/gallery, with an empty cache; `--write` puts them
into the pages.

python tests/benchmarks/gallery.py [--write] [PAGE…]
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from helpers.documents import ROOT
from references.pages import Block, blocks_of

GALLERY = ROOT / "docs/gallery"
LINE = re.compile(r"^\*\*It takes\*\* .*?\.(?= |$)", re.MULTILINE)
GIB = 1 << 30


def blocks_to_run(page: Path) -> tuple[list[Block], list[Block]]:
    """The files that a page's commands need, and its commands: those of the page that runs them, if
    another does.
    """
    blocks = list(blocks_of(page.read_text(encoding="utf-8")))
    files = [block for block in blocks if "file" in block.comments]
    for block in blocks:
        if other := block.comments.get("elsewhere"):
            files += [
                each
                for each in blocks_of((ROOT / other).read_text(encoding="utf-8"))
                if "file" in each.comments
            ]
    return files, [
        block
        for block in blocks
        if block.language in ("sh", "python") and "file" not in block.comments
    ]


def cost(page: Path) -> tuple[float, float]:
    """Processor seconds, user and system, and the largest memory of a process in GiB."""
    files, commands = blocks_to_run(page)
    seconds, most_bytes = 0.0, 0
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as cache:
        for block in files:
            (Path(folder) / block.comments["file"]).write_text(block.text, encoding="utf-8")
        # Without the installation, which is before the last && of README's command.
        texts = [
            block.text
            if block.language == "python"
            else re.sub(r".* && \.venv/bin/", "", block.text)
            for block in commands
        ]
        for block, text in zip(commands, texts, strict=True):
            bare = re.sub(r"^pixsim ", f"{sys.executable} -m pixsim ", text, flags=re.MULTILINE)
            command = (
                [sys.executable, "-c", text]
                if block.language == "python"
                else ["bash", "-ec", bare]
            )
            environment = os.environ | {
                "PIXSIM_CACHE_DIR": cache,
                "MPLBACKEND": "agg",
                "PYTHONPATH": str(ROOT),
            }
            process = subprocess.Popen(
                command,
                cwd=folder,
                env=environment,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            _, status, used = os.wait4(process.pid, 0)
            if status:
                raise SystemExit(f"{page.name}: {text!r} ended with status {status}")
            seconds += used.ru_utime + used.ru_stime
            most_bytes = max(most_bytes, used.ru_maxrss * 1024)
    return seconds, most_bytes / GIB


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("pages", nargs="*", type=Path)
    arguments = parser.parse_args()
    for page in arguments.pages or sorted(GALLERY.glob("*.md")):
        if page.name == "index.md":
            continue
        seconds, gib = cost(page)
        line = f"**It takes** {float(f'{seconds:.2g}'):g} s of processor time and {gib:.1f} GiB."
        print(f"{page.name:24} {line}", flush=True)
        if arguments.write:
            text = page.read_text(encoding="utf-8")
            assert LINE.search(text), page
            page.write_text(LINE.sub(line, text), encoding="utf-8")


if __name__ == "__main__":
    main()
