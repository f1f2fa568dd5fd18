"""The notebooks of docs/ run from first to last cell and show what they hold."""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path

import pytest
from helpers.documents import difference
from helpers.looks import Elements
from helpers.notebooks import NOTEBOOKS, executed, outputs

MAX_BYTES = 500_000


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_small_and_has_been_run_in_order(path: Path) -> None:
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in code] == list(range(1, len(code) + 1))
    assert path.stat().st_size < MAX_BYTES
    assert cells[0]["source"][0].startswith("# ")
    for words in ("/work/", "/tmp/", "/home/"):
        assert words not in path.read_text(encoding="utf-8"), "a path of the machine it was made on"


@pytest.mark.slow
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
