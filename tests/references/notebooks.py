"""Run the notebooks of docs/, into which `python tests/benchmarks/pages.py` writes their outputs."""

import os
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parents[2]
NOTEBOOKS = sorted((HERE / "docs/notebooks").glob("*.ipynb"))
LONGEST_S = 300  # of a cell


def executed(path: Path, folder: Path) -> Any:
    """A notebook run from its first cell to its last in a folder, with this checkout's package.
    Raises CellExecutionError.
    """
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.read(path, as_version=4)
    for cell in notebook.cells:
        if cell.cell_type == "code":
            cell.outputs, cell.execution_count = [], None
    environment = {**os.environ, "PYTHONPATH": str(HERE), "MPLBACKEND": "agg"}
    client = NotebookClient(
        notebook,
        timeout=LONGEST_S,
        resources={"metadata": {"path": str(folder)}},
        record_timing=False,
    )
    client.execute(env=environment)
    return notebook


def outputs(notebook: Any) -> list[tuple[int, str, str]]:
    """(cell, kind, text) of what each code cell printed to standard output or shows, in order."""
    found = []
    for number, cell in enumerate(notebook.cells):
        own = cell.get("outputs", []) if cell.cell_type == "code" else []
        if printed := "".join(
            output.text for output in own if output.get("name") == "stdout"
        ):  # it comes in pieces
            found.append((number, "text", printed))
        found += [
            (number, kind, text)
            for output in own
            for kind, text in sorted(output.get("data", {}).items())
        ]
    return found
