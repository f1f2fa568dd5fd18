"""Folders of a study's cases."""

from __future__ import annotations

import re
from collections.abc import Sequence

# Names that the files and folders of a study have, or may have.
FILES_OF_STUDY = re.compile(r"\..*|.*\.(toml|csv|json|html|svg|pdf|png|part|old\d*)|figures|pictures|sensors", re.IGNORECASE)


def case_folder(words: str) -> str:
    """The name of a case's folder in that of the study, from its values and condition."""
    return re.sub(r"[^\w.\-]+", "_", words)


def check_case_folders(words: Sequence[str]) -> None:
    """Raise ValueError if the folders of two cases would be one, also where capitals do not count, or have a file's name."""
    taken: dict[str, str] = {}
    for each in words:
        folder = case_folder(each)
        if FILES_OF_STUDY.fullmatch(folder):
            raise ValueError(f"the folder of '{each}' would be '{folder}', as a file of pixsim; allowed: another name")
        if other := taken.get(folder.casefold()):
            raise ValueError(f"the folders of '{other}' and '{each}' would both be '{folder}'; allowed: names that differ more")
        taken[folder.casefold()] = each
