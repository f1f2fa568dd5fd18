"""The tests themselves: they leave the machine that they run on as it was, which
`machine_as_it_was` sees after each module.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from helpers.machine import changes, files_below


def test_home_and_temporary_files_are_of_the_run(own_places: tuple[Path, Path]) -> None:
    assert (Path.home(), Path(tempfile.gettempdir())) == own_places
    assert not changes(files_below(own_places[0]), files_below(own_places[0]))


def test_changes_name_each_file(tmp_path: Path) -> None:
    """New, gone, written, replaced by another of the same content, and of other permissions; in
    folders, too.
    """
    names = "gone", "written", "replaced", "open", "same", "below/written"
    (tmp_path / "below").mkdir()
    for name in names:
        (tmp_path / name).write_text("a")
        os.utime(tmp_path / name, ns=(1, 1))
    before = files_below(tmp_path)
    (tmp_path / "gone").unlink()
    (tmp_path / "new").mkdir()
    (tmp_path / "replaced").unlink()
    (tmp_path / "replaced").symlink_to("same")
    (tmp_path / "open").chmod(0o777)
    for name in ("written", "below/written"):
        (tmp_path / name).write_text("b")
    expected = [
        "below/written has changed",
        "gone is gone",
        "new is new",
        "open has changed",
        "replaced has changed",
        "written has changed",
    ]
    assert changes(before, files_below(tmp_path)) == expected
