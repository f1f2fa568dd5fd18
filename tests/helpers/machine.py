"""What a run of the tests may not change: devices, the home folder, and the folder of temporary
files.
"""

import os
import stat
from collections.abc import Container
from pathlib import Path

DEVICES = Path("/dev")


def devices(known: Container[str] | None = None) -> dict[str, tuple[int, ...]]:
    """Kind, permissions, owner and number of each file in /dev, without the folders that all
    processes share.

    known : names without which a device is left out: the system makes one when something is plugged
        in
    """
    listed = {each.name: each.lstat() for each in (DEVICES.iterdir() if DEVICES.is_dir() else ())}
    return {
        name: (found.st_mode, found.st_uid, found.st_gid, found.st_rdev)
        for name, found in listed.items()
        if not stat.S_ISDIR(found.st_mode) and (known is None or name in known or not found.st_rdev)
    }


def files_below(folder: Path) -> dict[str, tuple[int, ...]]:
    """Kind, permissions, owner, length and time of change of all files and folders below a folder;
    of folders, no time.
    """
    listed = {}
    for place, folders, files in os.walk(folder):
        for name in (*folders, *files):
            found = Path(place, name).lstat()
            content = () if stat.S_ISDIR(found.st_mode) else (found.st_size, found.st_mtime_ns)
            listed[str(Path(place, name).relative_to(folder))] = (
                found.st_mode,
                found.st_uid,
                found.st_gid,
                *content,
            )
    return listed


def changes(before: dict[str, tuple[int, ...]], after: dict[str, tuple[int, ...]]) -> list[str]:
    """What is new, gone or changed, in words."""
    words = [f"{name} is new" for name in after.keys() - before.keys()] + [
        f"{name} is gone" for name in before.keys() - after.keys()
    ]
    return sorted(
        [
            *words,
            *(
                f"{name} has changed"
                for name in before.keys() & after.keys()
                if before[name] != after[name]
            ),
        ]
    )
