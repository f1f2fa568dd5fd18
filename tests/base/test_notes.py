"""Notes of results: warnings collected once, shown by the caller's filters, and numbers that can be
told apart.
"""

from __future__ import annotations

import ast
import pickle
import string
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

import pytest
from hypothesis import given, strategies as st

from pixsim.base.digits import distinct_texts
from pixsim.base.note_kinds import NOTES
from pixsim.base.notes import MachineWarning, Note, collected_notes
from pixsim.cli.options import Verbosity

PACKAGE = Path(__file__).parents[2] / "pixsim"


def tell(text: str = "told", category: type[Warning] = UserWarning) -> None:
    warnings.warn(text, category, stacklevel=2)


@contextmanager
def shown_as(
    action: Literal["always", "default", "ignore", "error"],
) -> Iterator[list[warnings.WarningMessage]]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter(action)
        yield caught


def test_collected_notes_are_there_once_whatever_was_shown_before() -> None:
    """Python shows a warning of one place once a process."""
    for _ in range(2):
        with shown_as("always") as shown, collected_notes() as notes:
            for text in ("told", "other.", "told"):
                tell(text)
        assert notes == ["told", "other"]
        assert [str(warning.message) for warning in shown] == ["told", "other."]


def test_collected_notes_filters_of_caller_hold() -> None:
    with shown_as("ignore") as shown, collected_notes() as notes:
        tell()
    assert (notes, shown) == (["told"], [])
    with shown_as("error"), collected_notes(), pytest.raises(UserWarning, match="told"):
        tell()


def test_collected_notes_machine_and_other_categories_are_shown_only() -> None:
    """A warning about the machine once: a cache folder that cannot be written fails for every
    entry.
    """
    with shown_as("always") as shown, collected_notes() as notes:
        for category in (MachineWarning, DeprecationWarning, MachineWarning):
            tell("cache", category)
    assert notes == []
    assert [warning.category for warning in shown] == [MachineWarning, DeprecationWarning]


def test_collected_notes_inner_block_shares_list() -> None:
    """A warning about the settings, before the result collects, belongs to the result."""
    with shown_as("always"), collected_notes() as notes:
        tell("settings")
        with collected_notes() as inner:
            tell("result")
            assert inner == ["settings", "result"]
    assert notes == ["settings", "result"]
    with collected_notes() as after:
        assert after == []


@given(st.floats(1e-300, 1e300), st.floats(1e-300, 1e300))
def test_told_apart_order_is_that_of_the_numbers(value: float, limit: float) -> None:
    value_text, limit_text = map(float, distinct_texts(value, limit))
    assert (value_text > limit_text) == (value > limit)
    assert (value_text == limit_text) == (value == limit)


CALLS = [
    (path.name, call)
    for path in sorted(PACKAGE.rglob("*.py"))
    for call in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "Note"
]


def test_each_note_is_of_a_kind_and_has_the_values_of_its_template() -> None:
    """A note that is rare would otherwise fail when a user needs it."""
    made = set()
    for name, call in CALLS:
        (kind,) = call.args
        assert isinstance(kind, ast.Constant), name
        made.add(kind.value)
        stated = {keyword.arg for keyword in call.keywords}
        wanted = {
            field
            for _, field, _, _ in string.Formatter().parse(NOTES[kind.value].template)
            if field
        }
        assert stated == wanted or (None in stated and stated - {None} < wanted), (
            name,
            call.lineno,
        )
    assert made == set(NOTES), "each kind is used"


def test_note_keeps_its_id_in_a_process_of_a_worker_and_under_a_name() -> None:
    note = Note("left_out", words="4t-bsi: 1, 2 µm left out: they have no photodiode.")
    assert str(note) == "4t-bsi: 1, 2 µm left out: they have no photodiode"
    copy = pickle.loads(pickle.dumps(note))
    assert (copy, copy.id, copy.of(["a", "b"]).id) == (note, note.id, note.id)
    assert copy.of(["a", "b"]).as_dict() == {"id": "left_out", "text": f"a, b: {note}"}


@pytest.mark.parametrize(
    ("note", "quiet", "lines"),
    [
        (Note("no_effect", words="a changes nothing here"), False, 1),
        (Note("no_effect", words="a changes nothing here"), True, 0),
        (Note("reflectance", what="r", highest=1.2, place="b"), True, 1),
    ],
)
def test_quiet_hides_advice_only(
    note: Note, quiet: bool, lines: int, capsys: pytest.CaptureFixture[str]
) -> None:
    verbosity = Verbosity()
    verbosity.quiet = quiet
    verbosity.warning(UserWarning(note))
    assert capsys.readouterr().err.count("warning: ") == lines
