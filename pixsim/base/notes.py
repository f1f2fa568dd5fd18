"""Notes: what a user should be told besides a result. They are warnings, and results collect
them.
"""

from __future__ import annotations

import sys
import threading
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial
from pathlib import Path
from typing import Any, Self

from pixsim.base.errors import safe_message
from pixsim.base.note_kinds import NOTES

# Suppresses warnings, such as of clipped white, that the run itself gives once.
suppressed_warnings = partial(warnings.catch_warnings, action="ignore", category=UserWarning)


class Note(str):
    """The text of a note, with the id of its kind.

    >>> note = Note("not_used", setting="lens.file", reason="the scene has its own")
    >>> note.id, str(note)
    ('not_used', 'lens.file is not used: the scene has its own')
    """

    __slots__ = ("id",)
    id: str

    def __new__(cls, id: str, /, **values: Any) -> Self:
        """Return a note of a kind.

        values : those that the kind's template names
        """
        return cls.restored(id, safe_message(NOTES[id].template.format(**values)).removesuffix("."))

    @classmethod
    def restored(cls, id: str, text: str) -> Self:
        """Return the note of a text that was made before."""
        note = super().__new__(cls, text)
        note.id = id
        return note

    def __reduce__(self) -> tuple[Any, ...]:
        return Note.restored, (self.id, str(self))

    def of(self, names: Iterable[str]) -> Note:
        """Return the note of some sensors or cases only, which stand before its text."""
        return Note.restored(self.id, f"{', '.join(names)}: {self}")

    @property
    def doubts(self) -> bool:
        """Whether numbers may not be of what was asked for, stated or measured; --quiet hides the
        other notes.
        """
        return NOTES[self.id].doubts

    def as_dict(self) -> dict[str, str]:
        """Return the note as in the JSON files of results."""
        return {"id": self.id, "text": str(self)}


class MachineWarning(UserWarning):
    """A warning about this machine or this run of a command, not about its result: no note of a
    result.
    """


PACKAGE = str(Path(__file__).parents[1])
_showing = threading.RLock()


def warn(note: Note) -> None:
    """Warn of a note, at the first line outside pixsim: the user's. One of a machine is a
    MachineWarning.
    """
    level = 2
    frame = sys._getframe(1)
    while frame.f_back and frame.f_code.co_filename.startswith(PACKAGE):
        level = level + 1
        frame = frame.f_back
    category = MachineWarning if note.id == "machine" else UserWarning
    with _showing:  # while another thread shows one, the filters are not those of its caller
        warnings.warn(category(note), stacklevel=level)


def note_of(message: Warning | str) -> Note:
    """Return the note of a warning; the id is "other" for a warning of another library."""
    content = message.args[0] if isinstance(message, Warning) and message.args else message
    if isinstance(content, Note):
        return content
    return Note("other", words=str(content).removesuffix("."))


_outer: ContextVar[list[Note] | None] = ContextVar("notes", default=None)


@contextmanager
def collected_notes(alone: bool = False) -> Iterator[list[Note]]:
    """Collect the notes of the warnings of the block, each once; they are shown as before, by the
    filters of the caller.

    A warning counts in whichever earlier call it was shown before; a MachineWarning is shown, and
    does not count. A block inside another shares its list: what a command said before belongs to
    its result.

    alone : share no list, for one of many results of a command
    """
    outer = _outer.get()
    if outer is not None and not alone:
        yield outer
        return

    notes: list[Note] = []
    # Each once too: a cache folder that cannot be written fails for every entry.
    machine_notes: list[Note] = []
    filters = list(warnings.filters)
    show = warnings.showwarning

    def collect(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        *_: object,
        **__: object,
    ) -> None:
        if issubclass(category, UserWarning):
            note = note_of(message)
            collected = machine_notes if issubclass(category, MachineWarning) else notes
            if note in collected:
                return
            collected.append(note)
        with _showing, warnings.catch_warnings():  # the filters are those of all threads
            warnings.resetwarnings()
            # A list, though typed as a sequence.
            warnings.filters[:] = filters  # type: ignore[index]
            warnings.showwarning = show
            warnings.warn_explicit(message, category, filename, lineno)

    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = collect
        token = _outer.set(notes)
        try:
            yield notes
        finally:
            _outer.reset(token)


_MAX_NOTES = 8


def first_notes(notes: Sequence[Sequence[Note]]) -> list[Note]:
    """Return the notes of all cases, once for each text, and of very many the first ones and the
    number of the others.
    """
    texts = list(dict.fromkeys(note for part in notes for note in part))
    if len(texts) <= _MAX_NOTES:
        return texts
    last = texts[_MAX_NOTES - 1]
    return [
        *texts[: _MAX_NOTES - 1],
        Note.restored(
            last.id, f"and {len(texts) - _MAX_NOTES + 1} more notes of this kind, for other cases"
        ),
    ]
