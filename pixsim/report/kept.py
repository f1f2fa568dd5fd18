"""Files that are kept: nothing is computed or drawn again when its folder holds what equal content gave, unchanged."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from importlib import resources
from pathlib import Path

import numpy as np
from pydantic import BaseModel

from pixsim.base import cache
from pixsim.base.files import (
    DEPENDENCIES,
    are_kept,
    digest_of,
    files_are_finished,
    output_folder,
    said_with,
    versions,
    write_made_from,
)
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
            files_are_finished()
            return folder / "report.html"
        report = write()
        write_made_from(folder, command, made_from)
        return report


def kept_run(folder: Path, made_from: str) -> tuple[Document, list[Note]] | None:
    """Return the answer of a run whose files are kept, without its page, and its warnings; None if they are not kept."""
    if not are_kept(folder, "run", made_from):
        return None
    files_are_finished()
    said = said_with(folder)
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
    digest = hashlib.blake2b(digest_size=16)
    for text in _texts([_environment(), *content], digest):
        digest.update(f"{len(text)}:{text}".encode(errors="surrogatepass"))
    return digest.hexdigest()


def _environment() -> list[object]:
    """Return what decides on the files besides the result: the code, its templates, and the versions."""
    templates = sorted(Path(str(resources.files("pixsim") / "data")).glob("*.j2"))
    return [cache.version_fingerprint(*DEPENDENCIES, *DRAWING), versions(), *map(digest_of, templates)]


def _texts(value: object, digest: hashlib.blake2b) -> Iterator[str]:
    """Yield texts that tell a value from others; arrays go to `digest` themselves.

    Raises TypeError for a value of another kind: what it holds would not be compared.
    """
    if value is None or isinstance(value, bool | int | float | str | np.generic | os.PathLike):
        yield repr(value)
    elif isinstance(value, np.ndarray):
        update_with_array(digest, value)
    elif callable(of_light := getattr(value, "digest", None)):  # of a SpectralImage
        yield of_light()
    elif isinstance(value, Mapping):
        yield f"table of {len(value)}"
        for key, content in value.items():
            yield repr(key)
            yield from _texts(content, digest)
    elif isinstance(value, list | tuple | set | frozenset):
        yield f"list of {len(value)}"
        for content in sorted(value, key=repr) if isinstance(value, set | frozenset) else value:
            yield from _texts(content, digest)
    elif isinstance(value, BaseModel):
        yield type(value).__name__
        yield from _texts([dict(value), value.model_fields_set], digest)
    elif is_dataclass(value):
        yield type(value).__name__
        yield from _texts({each.name: getattr(value, each.name) for each in fields(value) if each.name not in LEFT_OUT}, digest)
    else:
        raise TypeError(f"a report made from {type(value).__name__}, whose content is not known")
