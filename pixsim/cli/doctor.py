"""`pixsim doctor`: versions, LLVM, graphics card, a test render, threads, memory and folders of
this machine, in one table.
"""

from __future__ import annotations

import platform
import re
import sys
from dataclasses import asdict, dataclass, field
from importlib import metadata, resources
from pathlib import Path
from typing import Any

from pixsim.base import cache, machine
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.files import FOLDER_VARIABLE
from pixsim.base.version import VERSION
from pixsim.scene.trial import trial_render
from pixsim.scene.variants import graphics, variant
from pixsim.show.document import Document, DocumentTable

OK = "ok"
NOTE = "note"
PROBLEM = "problem"
LIMIT_S = 20.0  # of the test render, which takes 1 to 3 s


@dataclass(frozen=True)
class _Diagnosis:
    """One line of the report; the names are keys of `pixsim doctor --json`.

    mark : OK, NOTE (renders work nevertheless) or PROBLEM
    found : what was found
    mend : the command that mends it, or None if there is none
    facts : the numbers of `found`
    """

    subject: str
    mark: str
    found: str
    mend: str | None = None
    facts: dict[str, Any] = field(default_factory=dict)


def examine(out: Path, limit_s: float | None = None) -> list[_Diagnosis]:
    """Examine this machine, in about 5 s; a graphics card has time limits of its own.

    out : output folder to examine; it need not exist
    limit_s : time limit of the test render, s, or None for 20

    Raises PixsimError for a limit that is not above 0.
    """
    if limit_s is not None and not 0 < limit_s < float("inf"):
        raise invalid("--limit-s", f"{limit_s:g}", "a number above 0")

    card = graphics.graphics_trial(again=True)
    packages = {name: metadata.version(name) for name in _required()}
    python = (
        f"{platform.python_version()} ({sys.executable}), {platform.platform()},"
        f" {platform.machine()}"
    )
    return [
        _Diagnosis(
            "pixsim", OK, f"{VERSION} in {resources.files('pixsim')}", facts={"version": VERSION}
        ),
        _Diagnosis("Python", OK, python, facts={"version": platform.python_version()}),
        _Diagnosis(
            "packages",
            OK,
            ", ".join(f"{name} {version}" for name, version in packages.items()),
            facts=packages,
        ),
        _llvm(),
        _graphics(card),
        _test_render(LIMIT_S if limit_s is None else limit_s),
        _processors(),
        _memory(),
        _cache(),
        _results(out),
    ]


def doctor_document(findings: list[_Diagnosis]) -> Document:
    """Return the answer of `pixsim doctor`: a line for each finding, and below it the command that
    mends it.
    """
    rows: list[tuple[str, ...]] = []
    for finding in findings:
        rows.append((finding.mark, finding.subject, finding.found))
        if finding.mend:
            # A short row is not wrapped: it can be copied
            rows.append(("", f"to fix it: {finding.mend}"))

    works = all(finding.mark != PROBLEM for finding in findings)
    verdict = "renders work on this machine" if works else "pixsim does not work on this machine"
    data = {"ok": works, "findings": [asdict(finding) for finding in findings]}
    return Document(
        "doctor",
        "check",
        verdict,
        data,
        (DocumentTable("findings", (), rows, words=None), "", verdict),
    )


def _required() -> list[str]:
    """Return the names of the installed packages that pixsim requires, without extras; empty if
    pixsim itself is not installed.
    """
    try:
        lines = metadata.requires("pixsim") or []
    except metadata.PackageNotFoundError:
        return []
    names = [re.split(r"[^\w.-]", line, maxsplit=1)[0] for line in lines if "extra ==" not in line]
    return [name for name in names if any(metadata.distributions(name=name))]


def _llvm() -> _Diagnosis:
    try:
        path, reason = variant.find_llvm()
    except PixsimError as error:  # which says how to mend it
        return _Diagnosis("LLVM", PROBLEM, str(error))
    if path is None:
        has_wheel = (sys.platform, platform.machine()) == ("linux", "x86_64")
        if has_wheel:
            mend = f"pip install {variant.LLVM_WHEEL}"
        else:
            mend = f"export {variant.LLVM_VARIABLE}=FILE"
        return _Diagnosis(
            "LLVM", NOTE, f"{reason}; renders take several times as long", mend, {"path": None}
        )
    return _Diagnosis("LLVM", OK, f"{path} ({reason})", facts={"path": path})


def _graphics(card: graphics.GraphicsTrial) -> _Diagnosis:
    facts = {"fault": card.fault}
    if card.fault is None:
        return _Diagnosis("graphics card", OK, "works, and traces by default", facts=facts)
    mark = NOTE if card.tried else OK  # none is required
    return _Diagnosis("graphics card", mark, f"not used: {card.fault}", facts=facts)


def _test_render(limit_s: float) -> _Diagnosis:
    trial = trial_render(limit_s=limit_s)
    facts = {**trial.facts, "seconds": trial.seconds}
    name = trial.facts.get("variant")
    if fault := trial.fault:
        if trial.seconds >= limit_s:
            fault = f"{fault}; a machine under load may need longer: --limit-s {3 * limit_s:g}"
        # A refusal says how to mend it
        mend = None if "refused" in facts else "pip install --force-reinstall mitsuba drjit"
        if name != variant.SCALAR and trial_render(variant.SCALAR, limit_s=limit_s).fault is None:
            mend = f"pixsim run csf --variant {variant.SCALAR}"
        return _Diagnosis("test render", PROBLEM, fault, mend, facts)
    text = (
        f"csf with {name}, {facts['threads']} threads: {facts['mean_lx']:.3f} lx, closed form"
        f" {facts['expected_lx']:.3f} lx, in {trial.seconds:.1f} s"
    )
    return _Diagnosis("test render", OK, text, facts=facts)


def _processors() -> _Diagnosis:
    processors = machine.processors()
    text = f"{processors.usable} usable of {processors.cores}"
    return _Diagnosis("processors", OK, text, facts=vars(processors))


def _memory() -> _Diagnosis:
    memory = machine.memory()
    text = f"{_gib(memory.usable)} usable of {_gib(memory.total)}"
    return _Diagnosis("memory", OK, text, facts=vars(memory))


def _gib(size: int | None) -> str:
    return "unknown" if size is None else f"{size / cache.GIB:.1f} GiB"


def _cache() -> _Diagnosis:
    try:
        folder = cache.folder()
        limit_bytes = cache.limit_bytes()
        size_bytes = sum(entry.size_bytes for entry in cache.entries())
    except PixsimError as error:  # which says how to mend it
        return _Diagnosis("cache", PROBLEM, str(error))
    fault, _ = machine.check_folder(folder)
    text = f"{folder}: {_gib(size_bytes)} of {_gib(limit_bytes)}"
    if fault:
        return _Diagnosis(
            "cache",
            NOTE,
            f"{text}; it cannot be written ({fault})",
            f"export {FOLDER_VARIABLE}=FOLDER",
        )
    return _Diagnosis(
        "cache",
        OK,
        text,
        facts={"folder": str(folder), "size_bytes": size_bytes, "limit_bytes": limit_bytes},
    )


def _results(out: Path) -> _Diagnosis:
    reason, free_bytes = machine.check_folder(out)
    if reason:
        return _Diagnosis(
            "results",
            PROBLEM,
            f"{out} cannot be written ({reason})",
            "choose another folder with --out",
        )
    return _Diagnosis(
        "results", OK, f"{out}: {_gib(free_bytes)} free", facts={"free_bytes": free_bytes}
    )
