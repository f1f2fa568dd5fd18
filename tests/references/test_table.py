"""The table of judges: its gates, and that it fails if a judge fails."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from references import table
from references.gates import not_met, row


def test_row_gate_has_two_sides():
    assert [row("j", "s", -1, 2, value)["met"] for value in (-1.1, -1, 0, 2, 2.1, np.nan, [0, 3], [0, np.nan])] == [
        False, True, True, True, False, False, False, False
    ]  # fmt: skip


def test_row_states_gate_and_range():
    line = row("map", "code", -1e-9, 1e-9, [-2e-13, 1e-13])
    assert (line["gate"], line["measured"]) == ("±1e-09", "-2.0e-13 … 1.0e-13")
    assert row("map", "code", 0.9975, 1, 1.0, "{:.4f}")["measured"] == "1.0000"


def test_not_met_without_rows_raises():
    with pytest.raises(AssertionError):
        not_met([])


def test_main_prints_all_judges_and_fails_with_one(tmp_path, monkeypatch, capsys):
    for name, body in {
        "fine": "def rows(): return [row('a|b', 's', 0, 1, 0.5)]",
        "deep": "def rows(full=False): return [row('deep' if full else 'quick', 's', 0, 1, 0.5)]",
        "silent": "",
    }.items():
        (tmp_path / f"test_made_up_{name}.py").write_text(f"from gates import row\n{body}\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv(table.FOLDER_VARIABLE, str(tmp_path))
    monkeypatch.setattr(
        table, "judges", lambda: ["test_made_up_fine", "test_made_up_deep", "test_made_up_silent"]
    )
    assert table.main([]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "| judge | standard | gate | measured | met |"
    assert lines[2] == "| a\\|b | s | 0 … 1 | 5.0e-01 | yes |"
    assert len(lines) == 4
    assert "| quick |" in lines[3]
    assert table.main(["--full"]) == 0
    assert "| deep |" in capsys.readouterr().out
    monkeypatch.setattr(
        sys.modules["test_made_up_fine"], "rows", lambda: [row("a", "s", 0, 1, 1.5)]
    )
    assert table.main([]) == 1
    assert "**no**" in capsys.readouterr().out
    assert table.main(["--quick"]) == 2


def test_judges_lists_modules():
    names = table.judges()
    assert {"test_scielab_judge", "test_optics_judge", "test_monte_carlo_judge"} <= set(names)
    assert names == sorted(names)


def test_condensed_keeps_extremes_and_failures():
    """The range includes its extremes, and one failed row makes the merged row fail."""

    def entry(judge, measured, met=True):
        return {
            "judge": judge,
            "standard": "ISO 15739",
            "gate": "within 0.5 %",
            "measured": measured,
            "met": met,
        }

    rows = [
        entry("noise at 2 % of the well: a", "+0.10 %"),
        entry("noise at 60 % of the well: b", "-0.30 %"),
        entry("other: a", "7 %"),
    ]
    short = table.condensed(rows)
    assert [(line["judge"], line["measured"]) for line in short] == [
        ("noise, 2 cases", "-0.3 … +0.1 %"),
        ("other: a", "7 %"),
    ]
    assert not table.condensed([*rows, entry("noise at 13 % of the well: c", "+0.9 %", met=False)])[
        0
    ]["met"]
