"""Names of technologies for readers, tables and files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pixsim.base.errors import one_line
from pixsim.sensor.pixel_options import NO_TECHNOLOGY


def label_of(technology: str) -> str:
    """Return the display name of a technology: 0.35um, or the stem of a user's TOML file."""
    if technology == NO_TECHNOLOGY:
        return "data sheet"
    return one_line(Path(technology).stem if technology.endswith(".toml") else technology)


def label_in(technology: str, words: str) -> str:
    """Return the display name of a technology with the words of its case, for messages."""
    return ", ".join(filter(None, (label_of(technology), words)))


def file_label(label: str) -> str:
    """Return a label without spaces, for file names."""
    return label.replace(" ", "_")


def labels_of(technologies: Sequence[str]) -> tuple[str, ...]:
    """Return a unique label for each technology of a study: mine, mine-2.

    Labels differ by more than case, since some file systems ignore it, and a numbered label is
    never another's plain label.
    """
    plain = [label_of(technology) for technology in technologies]
    taken: set[str] = {label.casefold() for label in plain}
    used: set[str] = set()
    labels: list[str] = []
    for label in plain:
        stem = label
        number = 1
        while label.casefold() in (used if number == 1 else used | taken):
            number += 1
            label = f"{stem}-{number}"
        used.add(label.casefold())
        labels.append(label)
    return tuple(labels)
