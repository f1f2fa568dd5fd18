"""PixsimError, the exception for invalid input, and the text of its messages."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable

CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
MAX_LENGTH = 20_000  # characters of a message


class PixsimError(ValueError):
    """Invalid input. The message states what was given, what is allowed and how to fix it. A ValueError."""

    def __init__(self, message: str) -> None:
        super().__init__(shown(message))


class UnwritableError(PixsimError):
    """A file that cannot be written, as on a full disk; the message names it and says what is kept."""


def shown(text: str) -> str:
    """Text that is safe to print on a terminal: control characters are escaped, and the length is bounded."""
    text = CONTROL.sub(lambda match: repr(match[0])[1:-1], text)
    return text if len(text) <= MAX_LENGTH else f"{text[:MAX_LENGTH]} … ({len(text)} characters)"


def invalid(name: str, got: object, expected: str, hint: str = "") -> PixsimError:
    """The PixsimError for an invalid value, in the form that all messages share; the caller raises it."""
    return PixsimError(f"{name}: got {got}; allowed: {expected}." + (f" {hint}" if hint else ""))


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """A hint with the known name that is most similar; empty if none is similar."""
    similar = difflib.get_close_matches(name, known, 1)
    return f"Did you mean '{similar[0]}'?" if similar else ""


MAX_LABEL = 60  # characters of a label


def one_line(text: str, longest: int = MAX_LABEL) -> str:
    """Text from a file as one printable line of at most `longest` characters."""
    line = " ".join(shown(text).split())
    return line if len(line) <= longest else line[: longest - 1] + "…"
