"""Technologies by the names that readers and files see: the path of a user's TOML is neither."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pixsim.errors import shown
from pixsim.pixel_record import NO_TECHNOLOGY

LONGEST = 60  # characters of a label


def one_line(text: str, longest: int = LONGEST) -> str:
    """What files and names say, as one line of bounded length."""
    line = " ".join(shown(text).split())
    return line if len(line) <= longest else line[: longest - 1] + "…"


def label_of(technology: str) -> str:
    """A technology's name for readers: 0.35um, or the stem of a user's TOML."""
    if technology == NO_TECHNOLOGY:
        return "data sheet"
    return one_line(Path(technology).stem if technology.endswith(".toml") else technology)


def file_label(label: str) -> str:
    """A label as a part of file names."""
    return label.replace(" ", "_")


def labels_of(technologies: Sequence[str]) -> tuple[str, ...]:
    """A label for each technology of a study, no two alike: mine, mine-2.

    A number is told from a label that another one has anyway; letters of either case are the same to some file systems.
    """
    plain = [label_of(each) for each in technologies]
    taken: set[str] = {each.casefold() for each in plain}
    labels, met = [], set[str]()
    for each in plain:
        label, number = each, 1
        while label.casefold() in (met if number == 1 else met | taken):
            number += 1
            label = f"{each}-{number}"
        met.add(label.casefold())
        labels.append(label)
    return tuple(labels)
