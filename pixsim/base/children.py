"""Child processes look for no code in the current folder, which may be a stranger's.

Python takes an empty part of PYTHONPATH, and the system one of PATH, for the current folder; and
Python starts its own children so that they look there first. This file imports nothing that Python
has not loaded before: a command calls it first of all.
"""

import os
import sys


def _without_empty_parts(folders: str) -> str:
    """A list of folders, as in PATH, without the empty parts, which stand for the current folder.

    >>> _without_empty_parts(":/usr/bin::/bin")
    '/usr/bin:/bin'
    """
    return os.pathsep.join(part for part in folders.split(os.pathsep) if part)


def safe_variables() -> dict[str, str]:
    """The variables of a child that looks for code in no folder but those that are named."""
    search = _without_empty_parts(os.environ.get("PATH", os.defpath)) or os.defpath
    return {
        "PYTHONSAFEPATH": "1",
        "PYTHONPATH": _without_empty_parts(os.environ.get("PYTHONPATH", "")),
        "PATH": search,
    }


def leave_current_folder() -> None:
    """Take the current folder off the paths of this process and its children, where it is there for
    an empty part of a variable.

    A folder that is named stays, also if it is the current one. So does the first folder of
    Python's path: the folder of the script, or, for `python -m` and `python -c`, the current
    folder.
    """
    parts = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    if "" in parts and len(parts) > 1:
        try:
            here = os.getcwd()
        except OSError:  # it is gone
            here = ""
        if here not in [os.path.abspath(part) for part in parts if part]:
            first = 0 if sys.flags.safe_path else 1
            sys.path[first:] = [path for path in sys.path[first:] if path not in ("", here)]
    os.environ.update(safe_variables())
