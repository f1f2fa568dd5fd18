"""The one error that pixsim raises on purpose."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable

CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
MAX_LENGTH = 20_000  # characters of a message


class PixsimError(ValueError):
    """Input that pixsim cannot use; the message tells what was asked, found and allowed, and how to mend it. A ValueError."""

    def __init__(self, message: str) -> None:
        super().__init__(shown(message))


def shown(text: str) -> str:
    """What files and names say, for a terminal: characters that would steer it are spelled out, and nothing has no end."""
    text = CONTROL.sub(lambda match: repr(match[0])[1:-1], text)
    return text if len(text) <= MAX_LENGTH else f"{text[:MAX_LENGTH]} … ({len(text)} characters)"


def invalid(what: str, got: object, allowed: str, mend: str = "") -> PixsimError:
    """Build the error in the house's form; the caller raises it."""
    return PixsimError(f"{what}: got {got}; allowed: {allowed}." + (f" {mend}" if mend else ""))


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """How to mend a misspelt name; nothing where none is near."""
    near = difflib.get_close_matches(name, known, 1)
    return f"Did you mean '{near[0]}'?" if near else ""


MAX_LABEL = 60  # characters of a label


def one_line(text: str, longest: int = MAX_LABEL) -> str:
    """What files and names say, as one line of bounded length."""
    line = " ".join(shown(text).split())
    return line if len(line) <= longest else line[: longest - 1] + "…"
