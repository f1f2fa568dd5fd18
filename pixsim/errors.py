"""The one error that pixsim raises on purpose."""

from __future__ import annotations


class PixsimError(ValueError):
    """Input that pixsim cannot use; the message tells what was asked, found and allowed, and how to mend it."""


def refuse(what: str, got: object, allowed: str, mend: str = "") -> PixsimError:
    """Build the error in the house's form; the caller raises it."""
    return PixsimError(f"{what}: got {got}; allowed: {allowed}." + (f" {mend}" if mend else ""))
