"""`pixsim doctor`: checks of software, machine and a test render, with the command that fixes each problem.

Checks that may abort or hang run in separate processes (`pixsim.scene.variants.trial`).
"""

from __future__ import annotations

import platform
import shlex
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from importlib import metadata, resources
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Any

from pixsim.base import cache, machine
from pixsim.base.digits import percent
from pixsim.base.errors import PixsimError
from pixsim.base.files import FOLDER_VARIABLE
from pixsim.base.version import VERSION
from pixsim.scene.variants import graphics, variant
from pixsim.scene.variants.trial import Trial, attempt, picture_fault
from pixsim.scene.variants.variant import CUDA, LLVM, SCALAR
from pixsim.show.document import Document, DocumentTable

MODULES = {"colour-science": "colour", "openexr": "OpenEXR", "pillow": "PIL"}  # import names that differ from package names


def requirements(lines: Iterable[str]) -> dict[str, str]:
    """Package -> allowed versions, such as `>=2.0`, from the metadata of a package; requirements of extras are skipped."""
    from packaging.requirements import Requirement

    parsed = (Requirement(line) for line in lines)
    needed = (package for package in parsed if not package.marker or package.marker.evaluate({"extra": ""}))
    return {package.name: str(package.specifier) for package in needed}


def satisfies(version: str, allowed: str) -> bool:
    """Whether a version is in a range; a pre-release or local build counts as its release."""
    from packaging.specifiers import SpecifierSet
    from packaging.version import InvalidVersion, Version

    try:
        return Version(Version(version).base_version) in SpecifierSet(allowed)
    except InvalidVersion:
        return False


def installed(package: str) -> str | None:
    """Installed version of a package, or None."""
    with suppress(metadata.PackageNotFoundError):
        return metadata.version(package)
    return None


def module_of(package: str) -> str:
    """Import name of a package."""
    return MODULES.get(package.lower(), package.lower().replace("-", "_"))


def pip(*arguments: str) -> str:
    """Command that installs packages for this Python."""
    return shlex.join([sys.executable, "-m", "pip", "install", *arguments])


OK, NOTE, PROBLEM = "ok", "note", "problem"
LIMIT_S = 20.0  # per trial, which takes 1 to 3 s
MEMORY_GIB = 1.0  # `pixsim run csf` takes 0.6
DISK_GIB = 0.5  # it writes 0.13
MIN_VERSIONS = ("mitsuba", "drjit", "numpy", "scipy")  # checked if the metadata of pixsim are missing
OPTIONAL = {  # package -> extra of pixsim that installs it, and its purpose
    variant.LLVM_WHEEL: ("llvm", "fast renders where the system has no LLVM"),
    "distributed": ("cluster", "studies on a cluster"),
    "starlette": ("explore", "the page of pixsim explore"),
    "spectral": ("envi", "ENVI cubes"),
    "flip-evaluator": ("flip", "the metric flip"),
    "scikit-image": ("denoise", "the denoisers nlm and wavelet"),
}


@dataclass(frozen=True)
class Diagnosis:
    """One line of the report; the names are keys of `pixsim doctor --json`.

    room, subject, mark : group of the line, what was checked, and OK, NOTE or PROBLEM
    found, mend : result, and the command that fixes a problem
    """

    room: str
    subject: str
    mark: str
    found: str
    mend: str | None = None
    facts: dict[str, Any] = field(default_factory=dict, repr=False)


def examine(out: Path = Path("pixsim-out"), limit_s: float = LIMIT_S) -> list[Diagnosis]:
    """Run all checks, in about 5 s, or at most about three times `limit_s` if something hangs; a graphics card has its own limits.

    out : output folder to check; it need not exist
    limit_s : time limit of each trial, s
    """
    required = requirements(metadata.requires("pixsim") or []) if installed("pixsim") else {}
    card = graphics.verdict(again=True)
    with ThreadPoolExecutor() as pool:
        libraries = attempt("libraries", limit_s=limit_s)
        chosen = attempt("render", limit_s=limit_s)  # not in parallel, since it is timed
        usable = usable_llvm(libraries)
        default = chosen.facts.get("variant", LLVM if usable else SCALAR)
        taken = default if chosen.facts.get("refused") is None else None
        others = {
            name: pool.submit(attempt, "render", name, limit_s=limit_s)
            for name in (SCALAR, LLVM)[: 1 + bool(usable)]
            if name != taken
        }
        imports = pool.submit(attempt, "imports", *map(module_of, required or MIN_VERSIONS), limit_s=limit_s)
        renders = {name: trial.result() for name, trial in others.items()}
    if taken:
        renders[taken] = chosen
    return [
        *_software(required, imports.result()),
        *_llvm(libraries, usable),
        *_variants(renders, taken, card),
        _graphics(card),
        *_hardware(chosen.facts.get("threads")),
        _cache(),
        _space("results", out, "choose another folder with --out"),
        _space("temporary files", Path(tempfile.gettempdir()), "export TMPDIR=FOLDER"),
        *_optional(),
        _test_render(chosen, renders.get(SCALAR)),
    ]


def doctor_document(findings: Sequence[Diagnosis]) -> Document:
    """Return the answer of `pixsim doctor`: the findings below their groups, each with the command that fixes it."""
    rows: list[tuple[str, ...]] = []
    for room, of_room in groupby(findings, attrgetter("room")):
        rows += [*([("",)] if rows else []), (room,)]
        for each in of_room:
            rows.append((each.mark, each.subject, each.found))
            rows += [("", f"to fix it: {each.mend}")] if each.mend else []  # a short row is not wrapped: it can be copied
    problems, notes = (sum(each.mark == mark for each in findings) for mark in (PROBLEM, NOTE))
    verdict = "pixsim does not work on this machine" if problems else "renders work on this machine"
    counts = ", ".join(f"{number} {what}{'' if number == 1 else 's'}" for number, what in ((problems, "problem"), (notes, "note")))
    data = {"ok": not problems, "findings": [asdict(each) for each in findings]}
    return Document("doctor", "check", verdict, data, (DocumentTable("findings", (), rows, words=None), "", f"{verdict}: {counts}"))


def _software(required: dict[str, str], imports: Trial) -> Iterator[Diagnosis]:
    group, package = "software", Path(str(resources.files("pixsim")))
    mark, text, fix = OK, f"{VERSION} in {package}", None
    if not required:
        mark, fix = PROBLEM, pip("-e", str(package.parent))
        text += " is on the path but not installed"
    yield Diagnosis(group, "pixsim", mark, text, fix, {"version": VERSION})
    python = platform.python_version()
    yield Diagnosis(group, "Python", OK, f"{python} ({sys.executable})", facts={"version": python})
    system = f"{platform.platform()}, {platform.machine()}"
    untested = "" if sys.platform == "linux" else "; pixsim is tested on Linux only"
    yield Diagnosis(group, "system", NOTE if untested else OK, system + untested, facts={"platform": platform.platform()})
    required = required or dict.fromkeys(MIN_VERSIONS, "")
    versions = {name: installed(name) for name in required}
    text = ", ".join(f"{name} {version}" for name, version in versions.items() if version)
    yield Diagnosis(group, "packages", OK, text, facts={"versions": versions})
    yield from _broken_packages(required, versions, imports)


def _broken_packages(required: dict[str, str], versions: dict[str, str | None], imports: Trial) -> Iterator[Diagnosis]:
    errors = {line["module"]: line["error"] for line in imports.lines if "module" in line}
    if imports.fault and imports.lines:
        errors[imports.lines[-1]["importing"]] = imports.fault
    for name, allowed in required.items():
        version, error = versions[name], errors.get(module_of(name))
        if version is None:
            yield Diagnosis("software", name, PROBLEM, "is not installed", pip(f"{name}{allowed}"))
        elif not satisfies(version, allowed):
            yield Diagnosis("software", name, PROBLEM, f"{version}; pixsim needs {allowed}", pip(f"{name}{allowed}"))
        elif error:
            verb = "" if error.startswith(("hangs", "dies", "fails")) else "fails: "
            fix = pip("--force-reinstall", f"{name}{allowed}")
            yield Diagnosis("software", name, PROBLEM, f"{version} is installed, but its import {verb}{error}", fix)


def usable_llvm(libraries: Trial) -> str | None:
    """Path of the library that `variant.find_llvm` uses; None if there is none, or if $DRJIT_LIBLLVM_PATH is unusable."""
    candidates = [line for line in libraries.lines if "path" in line and line["origin"] != variant.BY_HAND]
    if candidates and candidates[0]["origin"] == variant.LLVM_VARIABLE:
        candidates = candidates[:1]
    return next((line["path"] for line in candidates if line["fault"] is None), None)


def _llvm(libraries: Trial, taken: str | None) -> Iterator[Diagnosis]:
    candidates = [line for line in libraries.lines if "path" in line]
    for line in candidates:
        mark, reason, fix = _status_of_library(line, taken)
        version = f"LLVM {line['version']}, " if line["version"] else ""
        yield Diagnosis("LLVM", line["origin"], mark, f"{line['path']}: {version}{reason}", fix, line)
    if libraries.fault:
        path = libraries.lines[-1].get("judging") if libraries.lines else None
        text = f"the check of {path or 'the libraries'} {libraries.fault}"
        yield Diagnosis("LLVM", "libraries", PROBLEM, text, f"export {variant.LLVM_VARIABLE}=FILE  # another libLLVM")
    elif taken is None and not any(line["origin"] == variant.LLVM_VARIABLE for line in candidates):
        text = f"no usable LLVM {variant.OLDEST_LLVM} or newer; renders take several times as long"
        fix = f"export {variant.LLVM_VARIABLE}=FILE  # a libLLVM {variant.OLDEST_LLVM} or newer"
        if (sys.platform, platform.machine()) == ("linux", "x86_64"):
            fix = pip(variant.LLVM_WHEEL)
        yield Diagnosis("LLVM", "libraries", NOTE, text, fix)
    if mapped := machine.mapped_files("libLLVM"):
        yield Diagnosis("LLVM", "this process", OK, f"has loaded {', '.join(mapped)}", facts={"mapped": mapped})


def _status_of_library(line: dict[str, Any], taken: str | None) -> tuple[str, str, str | None]:
    """Mark, reason and fixing command for a library."""
    if line["path"] == taken:
        return OK, "used", None
    if line["fault"] is not None:
        reason = f"not used, since it {line['fault']}; Mitsuba needs {variant.OLDEST_LLVM} or newer"
        requested = line["origin"] == variant.LLVM_VARIABLE
        return (PROBLEM, reason, f"unset {variant.LLVM_VARIABLE}") if requested else (OK if taken else NOTE, reason, None)
    if taken is None and line["origin"] == variant.BY_HAND:
        return NOTE, "usable", f"export {variant.LLVM_VARIABLE}={shlex.quote(line['path'])}"
    return OK, "usable, but another is preferred", None


def _variants(renders: dict[str, Trial], taken: str | None, card: graphics.GraphicsTrial) -> Iterator[Diagnosis]:
    compiled = next((names for trial in renders.values() if (names := trial.facts.get("compiled_in"))), None)
    if compiled:
        yield Diagnosis("Mitsuba", "compiled in", OK, ", ".join(compiled), facts={"variants": compiled})
    faults = {name: picture_fault(renders[name]) if name in renders else "needs a usable LLVM" for name in (LLVM, SCALAR)}
    for name, fault in (faults | {CUDA: card.fault}).items():
        mark = NOTE if fault and (name != CUDA or card.tried_s) else OK  # a graphics card is not required
        works = "works" + (" and is the default" if name == taken else f", with --variant {name}")
        yield Diagnosis("Mitsuba", name, mark, f"does not work: {fault}" if fault else works)


def _test_render(chosen: Trial, scalar: Trial | None) -> Diagnosis:
    fault, taken = picture_fault(chosen), chosen.facts.get("variant")
    facts = {**chosen.facts, "seconds": chosen.seconds}
    facts.pop("compiled_in", None)
    if fault is None:
        text = (
            f"csf with {taken}: {facts['mean_lx']:.3f} lx, closed form {facts['expected_lx']:.3f} lx "
            f"({facts['mean_error']:+.1e}; RMS {percent(facts['rms_error'], 2)}); {chosen.seconds:.1f} s, "
            f"of which {facts['render_s']:.1f} s render"
        )
        return Diagnosis("test render", facts["variant"], OK, text, facts=facts)
    scalar_works = scalar is not None and picture_fault(scalar) is None and taken != SCALAR
    unset = f"unset {variant.LLVM_VARIABLE}" if variant.LLVM_VARIABLE in fault else None
    fix = f"pixsim run csf --variant {SCALAR}" if scalar_works else pip("--force-reinstall", "mitsuba==3.9.*", "drjit")
    return Diagnosis("test render", taken or "Mitsuba", PROBLEM, fault, unset or fix, facts)


def _graphics(card: graphics.GraphicsTrial) -> Diagnosis:
    cards = machine.graphics_cards()
    facts = {"cards": cards, "card": card.card, "fault": card.fault}
    shown = "; ".join(cards) or card.card
    if card.fault:
        text = f"{shown}; not used: {card.fault}" if shown else f"none usable: {card.fault}"
        return Diagnosis("machine", "GPU", NOTE if shown else OK, text, facts=facts)
    return Diagnosis("machine", "GPU", OK, shown, facts=facts)


def _hardware(threads: int | None) -> Iterator[Diagnosis]:
    processors = machine.processors()
    text = f"{processors.cores} cores, {processors.allowed} for this process"
    text += "" if processors.granted is None else f", {processors.granted:g} granted by the container"
    text += f"; Mitsuba uses {threads} threads" if threads else ""
    few = processors.usable < (processors.cores or 1)
    fix = f"pixsim study STUDY --jobs {processors.usable}" if few else None
    yield Diagnosis("machine", "processors", NOTE if few else OK, text, fix, {**vars(processors), "threads": threads})
    memory = machine.memory()
    text = f"{_gib(memory.total)} in total, {_gib(memory.available)} free"
    text += "" if memory.limit is None else f", {_gib(memory.limit)} allowed by the container"
    little = memory.usable is not None and memory.usable < MEMORY_GIB * cache.GIB
    fix = "pixsim run SCENE --resolution 512" if little else None
    yield Diagnosis("machine", "memory", NOTE if little else OK, text, fix, dict(vars(memory)))


def _gib(size: int | None) -> str:
    return "unknown" if size is None else f"{size / cache.GIB:.1f} GiB"


def _cache() -> Diagnosis:
    fix = f"export {FOLDER_VARIABLE}=FOLDER"
    try:
        folder = cache.folder()
    except PixsimError as error:
        return Diagnosis("folders", "cache", PROBLEM, str(error), fix)
    try:
        limit = cache.limit_bytes()
        size = sum(entry.size_bytes for entry in cache.entries())
    except PixsimError as error:
        return Diagnosis("folders", "cache", PROBLEM, str(error), f"unset {cache.LIMIT_VARIABLE}")
    except OSError as error:
        return Diagnosis("folders", "cache", PROBLEM, f"cannot be read: {error}", fix)
    fault, _ = machine.check_folder(folder)
    text = f"{folder}: {_gib(size)} of {_gib(limit)}" + (", disabled" if not limit else "")
    text += f", cannot be written ({fault}): no new entries" if fault else ""
    facts = {"folder": str(folder), "size_bytes": size, "limit_bytes": limit, "writable": fault is None}
    return Diagnosis("folders", "cache", NOTE if fault else OK, text, fix if fault else None, facts)


def _space(subject: str, path: Path, fix: str) -> Diagnosis:
    fault, free = machine.check_folder(path)
    facts = {"folder": str(path), "free_bytes": free, "writable": fault is None}
    if fault:
        return Diagnosis("folders", subject, PROBLEM, f"{path} cannot be written ({fault})", fix, facts)
    little = free is not None and free < DISK_GIB * cache.GIB
    return Diagnosis("folders", subject, NOTE if little else OK, f"{path}: {_gib(free)} free", fix if little else None, facts)


def _optional() -> Iterator[Diagnosis]:
    for name, (extra, purpose) in OPTIONAL.items():
        version = installed(name)
        text = f"{version} ({purpose})" if version else f"not installed; only for {purpose}: pip install 'pixsim[{extra}]'"
        yield Diagnosis("optional", name, OK, text, facts={"version": version})
