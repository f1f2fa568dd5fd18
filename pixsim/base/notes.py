"""Notes: what a user should be told besides a result. They are warnings, and results collect them."""

from __future__ import annotations

import sys
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial
from pathlib import Path

from pixsim.base.errors import shown

# Suppresses warnings, such as of clipped white, that the run itself gives once.
without_warnings = partial(warnings.catch_warnings, action="ignore", category=UserWarning)


class MachineWarning(UserWarning):
    """A warning about this machine or this run of a command, not about its result: no note of a result."""


PACKAGE = str(Path(__file__).parents[1])


def warn(text: str, category: type[Warning] = UserWarning) -> None:
    """Warn of a text, made printable, at the first line outside pixsim: the user's."""
    level, frame = 2, sys._getframe(1)
    while frame.f_back and frame.f_code.co_filename.startswith(PACKAGE):
        level, frame = level + 1, frame.f_back
    warnings.warn(shown(text), category, stacklevel=level)


_outer: ContextVar[list[str] | None] = ContextVar("notes", default=None)
_showing = threading.RLock()


@contextmanager
def collected_notes(alone: bool = False) -> Iterator[list[str]]:
    """Collect the texts of the warnings of the block, each once; they are shown as before, by the filters of the caller.

    A warning counts in whichever earlier call it was shown before; a MachineWarning is shown, and does not count. A block
    inside another shares its list: what a command said before belongs to its result.

    alone : share no list, for one of many results of a command
    """
    if (outer := _outer.get()) is not None and not alone:
        yield outer
        return
    notes: list[str] = []
    of_machine: list[str] = []  # each once too: a cache folder that cannot be written fails for every entry
    filters, show = list(warnings.filters), warnings.showwarning

    def collect(message: Warning | str, category: type[Warning], filename: str, lineno: int, *_: object, **__: object) -> None:
        text = str(message).removesuffix(".")
        if issubclass(category, UserWarning):
            texts = of_machine if issubclass(category, MachineWarning) else notes
            if text in texts:
                return
            texts.append(text)
        with _showing, warnings.catch_warnings():  # the filters are those of all threads
            warnings.resetwarnings()
            warnings.filters[:] = filters  # type: ignore[index]  # a list, though typed as a sequence
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


SHOWN_NOTES = 8


def few(notes: Sequence[Sequence[str]]) -> list[str]:
    """Return the notes of all cases, each once, and of very many the first ones and the number of the others."""
    each = list(dict.fromkeys(note for part in notes for note in part))
    if len(each) <= SHOWN_NOTES:
        return each
    return [*each[: SHOWN_NOTES - 1], f"and {len(each) - SHOWN_NOTES + 1} more notes of this kind, of other cases"]
