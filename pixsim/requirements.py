"""Other packages: the versions that pixsim asks for, in the two forms that it uses, `>=2.0` and `==3.9.*`, and what is there."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Iterable
from importlib import metadata

MODULES = {"colour-science": "colour", "openexr": "OpenEXR", "pillow": "PIL"}  # of packages that are imported by another name


def requirements(lines: Iterable[str]) -> dict[str, str]:
    """Package -> allowed versions, as `>=2.0`, of what is always needed, from a package's metadata; extras are left out."""
    parted = (re.match(r"([\w.-]+)(?:\[[^]]*\])?\s*([^;]*)", line) for line in lines if "extra ==" not in line)
    return {each[1]: each[2].strip() for each in parted if each}


def satisfies(version: str, wanted: str) -> bool:
    """Whether a version is in a range; a pre-release counts as its release."""
    have = _numbers(version)
    for each in filter(None, wanted.split(",")):
        bound = _numbers(each)
        if not (have >= bound if each.strip().startswith(">=") else have[: len(bound)] == bound):
            return False
    return True


def _numbers(version: str) -> list[int]:
    return [int(number) for number in re.findall(r"\d+", version.partition("+")[0])]


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
