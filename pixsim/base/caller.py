"""Who called pixsim: messages name a setting to a command line by its option, and to Python by its
argument.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from contextlib import contextmanager

# Settings whose option has another name
OPTIONS = {"window_mm": "window", "smaller_than_um": "smaller-than"}
_command_lines = 0  # those that run: of all threads, of which some belong to the command


@contextmanager
def command_line() -> Iterator[None]:
    """Within the block, the caller is a command line."""
    global _command_lines
    _command_lines += 1
    try:
        yield
    finally:
        _command_lines -= 1


def setting(path: str, value: float | str | None = None) -> str:
    """Return a setting as the caller writes it, with a value if one is given.

    path : its dotted name in a file of settings, as display.white_cd_per_m2

    >>> setting("display.white_cd_per_m2", 300.0), setting("resolution", 512)
    ('Display(white_cd_per_m2=300)', 'resolution=512')
    >>> with command_line():
    ...     print(setting("display.white_cd_per_m2", 300.0), setting("max_seconds"))
    --display.white-cd-per-m2 300 --max-seconds
    """
    text = f"{value:g}" if isinstance(value, int | float) else value
    if _command_lines:
        option = f"--{OPTIONS.get(path, path).replace('_', '-')}"
        return option if text is None else f"{option} {text}"
    *tables, name = path.split(".")
    if tables:
        return f"{tables[-1].capitalize()}({name}={'…' if text is None else text})"
    return name if text is None else f"{name}={text}"


def parameter(name: str, value: str) -> str:
    """Return a parameter of a scene as the caller writes it.

    >>> parameter("chart", "star.png")
    "chart='star.png'"
    """
    return f"-D {name}={shlex.quote(value)}" if _command_lines else f"{name}={value!r}"
