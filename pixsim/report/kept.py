"""Files that are kept: nothing is computed or drawn again when its folder holds what equal content gave, unchanged."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from importlib import resources
from pathlib import Path

import numpy as np
from pydantic import BaseModel

from pixsim.base import cache
from pixsim.base.files import DEPENDENCIES, SAID, are_kept, digest_of, output_folder, read_list, versions, write_made_from
from pixsim.base.mapped import update_with_array
from pixsim.base.notes import Note
from pixsim.show.document import Document
from pixsim.show.pages import Figures
from pixsim.studies.result import StudyResult

DRAWING = ("Jinja2", "MarkupSafe", "Pillow", "contourpy", "kiwisolver")  # packages that decide on the bytes, besides DEPENDENCIES
# Fields that are not compared: how a result was computed, as the wall times tell too; and what follows from the other fields.
LEFT_OUT = ("counts", "lit", "table", "likeliest", "width_um")


def keep_or_write(command: str, made_from: str, folder: Path, write: Callable[[], Path]) -> Path:
    """Return the report of a command, from `write` unless the folder holds that of an equal result.

    The report is written again if anything differs that it shows or is made with: the result, the settings, the sources and
    the versions of pixsim and what it draws with; or if one of its files is missing or was changed. The wall times in a report
    that is kept are those of the command that wrote it.

    made_from : `digest_of_report` of the result, or its like
    """
    with output_folder(folder):
        if are_kept(folder, command, made_from):
            return folder / "report.html"
        report = write()
        write_made_from(folder, command, made_from)
        return report


def kept_run(folder: Path, made_from: str) -> tuple[Document, list[Note]] | None:
    """Return the answer of a run whose files are kept, without its page, and its warnings; None if they are not kept."""
    if not are_kept(folder, "run", made_from):
        return None
    said = read_list(folder)[SAID]
    data = json.loads((folder / "score.json").read_bytes())
    return Document("run", "kept", str(folder), data, terminal=tuple(said["lines"])), [
        Note.restored(**note) for note in said["warned"]
    ]


def digest_of_report(result: StudyResult, figures: Figures = "svg") -> str:
    """Hash of everything that the files of a study's report are made from, but the wall times."""
    return digest_of_content([part.processes for part in (result, *result.cases)], result, figures)


def digest_of_content(*content: object) -> str:
    """Hash of content, and of all else that decides on files that are made from it.

    Raises TypeError for a value of an unknown kind.
    """
    text = json.dumps([_environment(), *content], default=_as_json, sort_keys=True)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def _environment() -> list[object]:
    """Return what decides on the files besides the result: the code, its templates, and the versions."""
    templates = sorted(Path(str(resources.files("pixsim") / "data")).glob("*.j2"))
    return [cache.version_fingerprint(*DEPENDENCIES, *DRAWING), versions(), *map(digest_of, templates)]


def _as_json(value: object) -> object:
    """Return what tells a value from others as JSON content.

    Raises TypeError for a value of another kind: what it holds would not be compared.
    """
    if callable(digest_of_value := getattr(value, "digest", None)):  # of a SpectralImage or a Metric
        return digest_of_value()
    match value:
        case np.ndarray():
            digest = hashlib.blake2b(digest_size=16)
            update_with_array(digest, value)
            return digest.hexdigest()
        case BaseModel():
            return [type(value).__name__, dict(value), sorted(value.model_fields_set)]
        case Mapping():
            return dict(value)
        case os.PathLike() | np.generic():
            return repr(value)
        case set() | frozenset():
            return sorted(map(repr, value))
    if not is_dataclass(value):
        raise TypeError(f"a report made from {type(value).__name__}, whose content is not known")
    compared = {field.name: getattr(value, field.name) for field in fields(value) if field.name not in LEFT_OUT}
    return [type(value).__name__, compared]
