"""PixsimError, the exception for invalid input, and the text of its messages."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable

# Control characters but tab and line feed, and the marks that turn the direction of the text that
# follows.
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]")
# of a spreadsheet: it runs a cell that begins so, also in full width
_FORMULA = "=+-@\uff1d\uff0b\uff0d\uff20"
_MAX_LENGTH = 20_000  # characters of a message


class PixsimError(ValueError):
    """Invalid input. The message states the input, the allowed values and how to fix it. A
    ValueError.
    """

    def __init__(self, message: str) -> None:
        super().__init__(safe_message(message))


class UnwritableError(PixsimError):
    """A file that cannot be written, as on a full disk. The message names it, and lists the files
    that remain.
    """


def safe_message(text: str) -> str:
    """A message as it is safe to print: `printable`, and of bounded length."""
    text = printable(text)
    return text if len(text) <= _MAX_LENGTH else f"{text[:_MAX_LENGTH]} … ({len(text)} characters)"


def printable(text: str, json: bool = False) -> str:
    """Text without control characters, which a terminal would obey: they are escaped as in Python.

    All that pixsim prints passes here, since names of files and texts of headers may hold them.

    json : escape as in JSON

    >>> print(printable("\\x1b[2J"), printable("\\x7f", json=True))
    \\x1b[2J \\u007f
    """
    return _CONTROL.sub(
        lambda match: f"\\u{ord(match[0]):04x}" if json else repr(match[0])[1:-1], text
    )


def invalid(name: str, got: object, expected: str, hint: str = "") -> PixsimError:
    """The PixsimError for an invalid value, in the form that all messages share; the caller raises
    it.
    """
    return PixsimError(f"{name}: got {got}; allowed: {expected}." + (f" {hint}" if hint else ""))


def did_you_mean(name: str, names: Iterable[str]) -> str:
    """A hint with the one of some names that is most similar, whatever its capitals; empty if none
    is similar.

    >>> did_you_mean("canon_eos_5d_mark_ii", ["Canon_EOS_5D_Mark_IV", "Canon_EOS_5D_Mark_II"])
    "Did you mean 'Canon_EOS_5D_Mark_II'?"
    """
    names_by_folded = {name.casefold(): name for name in names}
    similar = difflib.get_close_matches(name.casefold(), names_by_folded, 1)
    return f"Did you mean '{names_by_folded[similar[0]]}'?" if similar else ""


PLAIN_WORD = re.compile(r"[A-Za-z0-9_.+,-]{1,24}")


def excerpt(text: str, typed: bool = False) -> str:
    """What a message says of a text in a file: the file can be another than the user believes, such
    as a key.

    typed : whether the user has typed it on the command line; only then it is quoted

    >>> excerpt("N-BK7"), excerpt("N-BK7", typed=True)
    ('a text of 5 characters', "'N-BK7'")
    """
    if typed:
        return f"'{one_line(text)}'"
    return f"a text of {len(text)} character{'s' * (len(text) > 1)}" if text else "nothing"


def quoted(name: str, typed: bool = False) -> str:
    """Return `excerpt` of the name of a glass, a type or a channel in a file of a recognised
    format. Plain names are quoted.

    >>> quoted("N-BK7"), quoted("two words")
    ("'N-BK7'", 'a text of 9 characters')
    """
    return excerpt(name, typed or PLAIN_WORD.fullmatch(name) is not None)


def names_in(texts: Iterable[str]) -> list[str]:
    """Names of channels or arrays of a file that was recognised as its format, without quotes, as
    `excerpt` has them.
    """
    return [text if PLAIN_WORD.fullmatch(text) else f"({excerpt(text)})" for text in texts]


def name_fault(name: str) -> str:
    """Why a text cannot name something in tables and files; empty if it can.

    >>> name_fault("=1+1"), name_fault("-0.5"), name_fault("night")
    ('begins with =, which a spreadsheet reads as a formula', '', '')
    """
    if _CONTROL.search(name) or "\t" in name or "\n" in name:
        return "contains control characters, or marks that change the direction of text"
    if name[:1] in _FORMULA and name:
        try:
            float(name)
        except ValueError:
            return f"begins with {name[0]}, which a spreadsheet reads as a formula"
    return ""


MAX_LABEL = 60  # characters of a label


def one_line(text: str, longest: int = MAX_LABEL) -> str:
    """Text from a file as one printable line of at most `longest` characters."""
    line = " ".join(safe_message(text).split())
    return line if len(line) <= longest else line[: longest - 1] + "…"
