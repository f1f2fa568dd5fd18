"""What this machine has for pixsim, whether renders work on it and are right, and what mends what does not.

Whatever may abort or hang runs in processes of its own (`pixsim.cli.trial`): a broken Mitsuba, LLVM or driver becomes a finding.
"""

from __future__ import annotations

import platform
import shlex
import sys
import tempfile
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from importlib import metadata, resources
from pathlib import Path
from typing import Any

from pixsim.base import cache, machine
from pixsim.base.errors import PixsimError
from pixsim.base.files import FOLDER_VARIABLE
from pixsim.base.version import VERSION
from pixsim.cli.trial import Trial, attempt
from pixsim.scene import variant

MODULES = {"colour-science": "colour", "openexr": "OpenEXR", "pillow": "PIL"}  # of packages that are imported by another name


def requirements(lines: Iterable[str]) -> dict[str, str]:
    """Package -> allowed versions, as `>=2.0`, of what is always needed, from a package's metadata; extras are left out."""
    from packaging.requirements import Requirement

    parted = [Requirement(line) for line in lines]
    return {each.name: str(each.specifier) for each in parted if not each.marker or each.marker.evaluate({"extra": ""})}


def satisfies(version: str, wanted: str) -> bool:
    """Whether a version is in a range; a pre-release, or a local build, counts as its release."""
    from packaging.specifiers import SpecifierSet
    from packaging.version import InvalidVersion, Version

    try:
        return Version(Version(version).base_version) in SpecifierSet(wanted)
    except InvalidVersion:
        return False


def installed(package: str) -> str | None:
    """The version that is there."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def module_of(package: str) -> str:
    """The name that a package is imported by."""
    return MODULES.get(package.lower(), package.lower().replace("-", "_"))


def pip(*arguments: str) -> str:
    """The command that installs packages for this very Python."""
    return shlex.join([sys.executable, "-m", "pip", "install", *arguments])


OK, NOTE, PROBLEM = "ok", "note", "problem"
LIMIT_S = 20.0  # for each trial; one takes 1 to 3 s
MEAN_GATE, RMS_GATE = 1e-3, 1e-2  # of the tried picture's illuminance: 1e-5 and 0.4 % where all is right
MEMORY_GIB = 1.0  # `pixsim run csf` takes 0.6
DISK_GIB = 0.5  # it writes 0.13
MIN_VERSIONS = ("mitsuba", "drjit", "numpy", "scipy")  # looked at where pixsim's own metadata are missing
OPTIONAL = {  # package -> pixsim's extra that brings it, and its purpose
    variant.LLVM_WHEEL: ("llvm", "fast renders where the system has no LLVM"),
    "distributed": ("cluster", "studies on a cluster"),
    "spectral": ("envi", "ENVI cubes"),
}
SCALAR, LLVM, CUDA = "scalar_spectral", "llvm_ad_spectral", "cuda_ad_spectral"


@dataclass(frozen=True)
class Finding:
    """One line of the report: its room, its subject, ok, note or problem, what was found, the command that mends it."""

    room: str
    subject: str
    mark: str
    found: str
    mend: str | None = None
    facts: dict[str, Any] = field(default_factory=dict, repr=False)


def examine(out: Path = Path("pixsim-out"), limit_s: float = LIMIT_S) -> list[Finding]:
    """Look at everything; 5 s where all is well, and no more than about three times `limit_s` where something hangs.

    Parameters
    ----------
    out : folder that results would go to; it need not exist
    limit_s : for each process that tries something, s
    """
    try:
        required = requirements(metadata.requires("pixsim") or [])
    except metadata.PackageNotFoundError:
        required = {}  # pixsim is on the path but not installed
    with ThreadPoolExecutor() as pool:
        first = [pool.submit(attempt, kind, limit_s=limit_s) for kind in ("libraries", "driver")]
        libraries, driver = (each.result() for each in first)
        chosen = attempt("render", limit_s=limit_s)  # alone, since it is timed
        usable = usable_llvm(libraries)
        taken = (LLVM if usable else SCALAR) if chosen.facts.get("refused") is None else None
        other = {name: pool.submit(attempt, "render", name, limit_s=limit_s) for name in (SCALAR, CUDA) if name != taken}
        imports = pool.submit(attempt, "imports", *map(module_of, required or MIN_VERSIONS), limit_s=limit_s)
        tried = {name: each.result() for name, each in other.items()}
    if taken:
        tried[taken] = chosen
    return [
        *_software(required, imports.result()),
        *_llvm(libraries, usable),
        *_variants(tried, taken, driver),
        _graphics(driver),
        *_hardware(chosen.facts.get("threads")),
        _cache(),
        _space("results", out, "choose another folder with --out"),
        _space("temporary files", Path(tempfile.gettempdir()), "export TMPDIR=FOLDER"),
        *_optional(),
        _picture(chosen, tried.get(SCALAR)),
    ]


# --- Software ---------------------------------------------------------------------------------------------------------


def _software(required: dict[str, str], imports: Trial) -> Iterator[Finding]:
    room, where = "software", Path(str(resources.files("pixsim")))
    mark, text, mend = OK, f"{VERSION} in {where}", None
    if not required:
        mark, mend = PROBLEM, pip("-e", str(where.parent))
        text += " is on the path but not installed: `pixsim run` cannot tell its version"
    yield Finding(room, "pixsim", mark, text, mend, {"version": VERSION})
    python = platform.python_version()
    yield Finding(room, "Python", OK, f"{python} ({sys.executable})", facts={"version": python})
    system = f"{platform.platform()}, {platform.machine()}"
    only = "" if sys.platform == "linux" else "; pixsim is tried on Linux only"
    yield Finding(room, "system", NOTE if only else OK, system + only, facts={"platform": platform.platform()})
    required = required or dict.fromkeys(MIN_VERSIONS, "")
    versions = {name: installed(name) for name in required}
    told = ", ".join(f"{name} {version}" for name, version in versions.items() if version)
    yield Finding(room, "packages", OK, told, facts={"versions": versions})
    yield from _broken_packages(required, versions, imports)


def _broken_packages(required: dict[str, str], versions: dict[str, str | None], imports: Trial) -> Iterator[Finding]:
    errors = {line["module"]: line["error"] for line in imports.lines if "module" in line}
    if imports.fault and imports.lines:
        errors[imports.lines[-1]["importing"]] = imports.fault
    for name, wanted in required.items():
        version, error = versions[name], errors.get(module_of(name))
        if version is None:
            yield Finding("software", name, PROBLEM, "is not installed", pip(f"{name}{wanted}"))
        elif not satisfies(version, wanted):
            yield Finding("software", name, PROBLEM, f"{version}; pixsim needs {wanted}", pip(f"{name}{wanted}"))
        elif error:
            verb = "" if error.startswith(("hangs", "dies", "fails")) else "fails: "
            mend = pip("--force-reinstall", f"{name}{wanted}")
            yield Finding("software", name, PROBLEM, f"{version} is installed, but its import {verb}{error}", mend)


# --- Mitsuba ----------------------------------------------------------------------------------------------------------


def usable_llvm(libraries: Trial) -> str | None:
    """Path of the library that `variant.find_llvm` takes; None where there is none, or it refuses the user's own."""
    judged = [line for line in libraries.lines if "path" in line and line["origin"] != variant.BY_HAND]
    if judged and judged[0]["origin"] == variant.LLVM_VARIABLE:
        judged = judged[:1]
    return next((line["path"] for line in judged if line["fault"] is None), None)


def _llvm(libraries: Trial, taken: str | None) -> Iterator[Finding]:
    judged = [line for line in libraries.lines if "path" in line]
    for line in judged:
        mark, why, mend = _judgement(line, taken)
        version = f"LLVM {line['version']}, " if line["version"] else ""
        yield Finding("LLVM", line["origin"], mark, f"{line['path']}: {version}{why}", mend, line)
    if libraries.fault:
        at = libraries.lines[-1].get("judging") if libraries.lines else None
        found = f"looking at {at or 'libraries'} {libraries.fault}"
        yield Finding("LLVM", "libraries", PROBLEM, found, f"export {variant.LLVM_VARIABLE}=FILE  # another libLLVM")
    elif taken is None and not any(line["origin"] == variant.LLVM_VARIABLE for line in judged):
        found = f"no LLVM {variant.OLDEST_LLVM} or newer that is taken by itself; renders are slower by several times without"
        mend = f"export {variant.LLVM_VARIABLE}=FILE  # a libLLVM {variant.OLDEST_LLVM} or newer"
        if (sys.platform, platform.machine()) == ("linux", "x86_64"):
            mend = pip(variant.LLVM_WHEEL)
        yield Finding("LLVM", "libraries", NOTE, found, mend)
    if here := variant.mapped():
        yield Finding("LLVM", "this process", OK, f"has loaded {', '.join(here)}", facts={"mapped": here})


def _judgement(line: dict[str, Any], taken: str | None) -> tuple[str, str, str | None]:
    """Mark, reason and mending command for a library."""
    if line["path"] == taken:
        return OK, "taken", None
    if line["fault"] is not None:
        why = f"not taken, since it {line['fault']}; Mitsuba needs {variant.OLDEST_LLVM} or newer"
        asked = line["origin"] == variant.LLVM_VARIABLE
        return (PROBLEM, why, f"unset {variant.LLVM_VARIABLE}") if asked else (OK if taken else NOTE, why, None)
    if taken is None and line["origin"] == variant.BY_HAND:
        return NOTE, "would serve", f"export {variant.LLVM_VARIABLE}={shlex.quote(line['path'])}"
    return OK, "would serve, but is not the first choice", None


def _variants(tried: dict[str, Trial], taken: str | None, driver: Trial) -> Iterator[Finding]:
    compiled = next((found for each in tried.values() if (found := each.facts.get("compiled_in"))), None)
    if compiled:
        yield Finding("Mitsuba", "compiled in", OK, ", ".join(compiled), facts={"variants": compiled})
    for name in (LLVM, SCALAR, CUDA):
        fault = _fault(tried[name]) if name in tried else "needs a usable LLVM"
        mark = NOTE if fault else OK
        if name == CUDA and (reason := driver.facts.get("fault")) and fault:
            fault, mark = reason, OK  # nothing is wrong with a machine without a graphics card
        run = "runs here" + (" and is taken" if name == taken else f" on request: --variant {name}")
        yield Finding("Mitsuba", name, mark, f"does not run here: {fault}" if fault else run)


def _fault(trial: Trial) -> str | None:
    """Why a trial has no picture, or a wrong one."""
    if reason := trial.fault or trial.facts.get("refused"):
        return str(reason)
    if (mean := trial.facts.get("mean_error")) is None:
        return "says nothing"
    rms = trial.facts["rms_error"]
    if abs(mean) <= MEAN_GATE and rms <= RMS_GATE:  # NaN is wrong too
        return None
    return f"its picture is wrong: illuminance {mean:+.2%} in the mean, {rms:.2%} RMS, off the closed form"


def _picture(chosen: Trial, scalar: Trial | None) -> Finding:
    fault, taken = _fault(chosen), chosen.facts.get("variant")
    facts = {**chosen.facts, "seconds": chosen.seconds}
    facts.pop("compiled_in", None)
    if fault is None:
        found = (
            f"csf with {taken}: {facts['mean_lx']:.3f} lx, closed form {facts['expected_lx']:.3f} lx "
            f"({facts['mean_error']:+.1e}; RMS {facts['rms_error']:.2%}); {chosen.seconds:.1f} s, "
            f"of which {facts['render_s']:.1f} s render"
        )
        return Finding("test render", facts["variant"], OK, found, facts=facts)
    scalar_works = scalar is not None and _fault(scalar) is None and taken != SCALAR
    unset = f"unset {variant.LLVM_VARIABLE}" if variant.LLVM_VARIABLE in fault else None
    mend = f"pixsim run csf --variant {SCALAR}" if scalar_works else pip("--force-reinstall", "mitsuba==3.9.*", "drjit")
    return Finding("test render", taken or "Mitsuba", PROBLEM, fault, unset or mend, facts)


# --- Machine ----------------------------------------------------------------------------------------------------------


def _graphics(driver: Trial) -> Finding:
    cards, fault = machine.graphics_cards(), driver.fault or driver.facts.get("fault")
    facts = {"cards": cards, "cuda": driver.facts.get("cuda"), "devices": driver.facts.get("devices")}
    if fault:
        return Finding("machine", "GPU", NOTE if cards else OK, "; ".join([*cards, f"none to use: {fault}"]), facts=facts)
    return Finding("machine", "GPU", OK, "; ".join(cards) or f"{facts['devices']} devices, CUDA {facts['cuda']}", facts=facts)


def _hardware(threads: int | None) -> Iterator[Finding]:
    found = machine.processors()
    granted = "" if found.granted is None else f", of which a container grants {found.granted:g}"
    text = f"{found.cores} cores, {found.allowed} for this process{granted}" + (
        f"; Mitsuba takes {threads} threads" if threads else ""
    )
    few = found.usable < (found.cores or 1)
    mend = f"pixsim study STUDY --jobs {found.usable}" if few else None
    yield Finding("machine", "processors", NOTE if few else OK, text, mend, {**vars(found), "threads": threads})
    memory = machine.memory()
    text = f"{_gib(memory.total)} in all, {_gib(memory.available)} free"
    text += "" if memory.limit is None else f", {_gib(memory.limit)} allowed by the container"
    little = memory.usable is not None and memory.usable < MEMORY_GIB * cache.GIB
    mend = "pixsim run SCENE -D resolution=512" if little else None
    yield Finding("machine", "memory", NOTE if little else OK, text, mend, dict(vars(memory)))


def _gib(size: int | None) -> str:
    return "unknown" if size is None else f"{size / cache.GIB:.1f} GiB"


def _cache() -> Finding:
    room, mend = "folders", f"export {FOLDER_VARIABLE}=FOLDER"
    try:
        folder, limit = cache.folder(), cache.limit_bytes()
        size = sum(entry.size_bytes for entry in cache.entries())
    except PixsimError as error:
        return Finding(room, "cache", PROBLEM, str(error), f"unset {cache.LIMIT_VARIABLE}")
    except (OSError, RuntimeError) as error:  # RuntimeError: this user has no home
        return Finding(room, "cache", PROBLEM, f"cannot be read: {error}", mend)
    at = machine.folder_at(folder)
    text = f"{folder}: {_gib(size)} of {_gib(limit)}" + (", keeps nothing" if not limit else "")
    text += f", cannot be written ({at.fault}): nothing new is kept" if at.fault else ""
    facts = {"folder": str(folder), "size_bytes": size, "limit_bytes": limit, "writable": at.fault is None}
    return Finding(room, "cache", NOTE if at.fault else OK, text, mend if at.fault else None, facts)


def _space(subject: str, path: Path, mend: str) -> Finding:
    at = machine.folder_at(path)
    facts = {"folder": str(path), "free_bytes": at.free, "writable": at.fault is None}
    if at.fault:
        return Finding("folders", subject, PROBLEM, f"{path} cannot be written ({at.fault})", mend, facts)
    little = at.free is not None and at.free < DISK_GIB * cache.GIB
    return Finding("folders", subject, NOTE if little else OK, f"{path}: {_gib(at.free)} free", mend if little else None, facts)


def _optional() -> Iterator[Finding]:
    for name, (extra, purpose) in OPTIONAL.items():
        version = installed(name)
        text = f"{version} ({purpose})" if version else f"not installed; for {purpose} only: pip install 'pixsim[{extra}]'"
        yield Finding("optional", name, OK, text, facts={"version": version})
