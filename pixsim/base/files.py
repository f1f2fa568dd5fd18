"""Files: output that is whole or not there, and input that is judged before anything reads it.

A named pipe would let a reader wait for ever, a device never ends, and a decoder allocates what a header declares.
"""

from __future__ import annotations

import io
import json
import os
import platform
import stat
import warnings
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout, suppress
from pathlib import Path
from typing import IO, Any

from pixsim.base.errors import PixsimError, invalid

FOLDER_VARIABLE = "PIXSIM_CACHE_DIR"


def cache_folder() -> Path:
    """$PIXSIM_CACHE_DIR, else pixsim in the user's cache folder (XDG base directories)."""
    if named := os.environ.get(FOLDER_VARIABLE):
        return Path(named)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "pixsim"


DEPENDENCIES = ("mitsuba", "drjit", "numpy", "scipy", "OpenEXR", "matplotlib", "pydantic", "joblib")


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A name to write to; it takes the place of `path` at the end, or vanishes if that is not reached."""
    partial = path.with_name(f".{path.name}.part")
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


@contextmanager
def output_folder(out: str | os.PathLike[str]) -> Iterator[Path]:
    """A folder that can be written to, made if need be; those made here and left empty by a failure are removed.

    PixsimError where it cannot be written to.
    """
    folder = Path(out)
    if not is_utf8(folder):
        raise PixsimError(f"output folder: '{folder}' is not in UTF-8. Choose another with --out.")
    made = [each for each in (folder, *folder.parents) if not os.path.lexists(each)]
    probe = folder / ".pixsim-probe"
    try:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            probe.touch()
            probe.unlink()
        except OSError as error:
            raise PixsimError(
                f"output folder: '{folder}' cannot be written ({error.strerror}). Choose another with --out."
            ) from None
        yield folder
    except BaseException:
        for each in made:
            with suppress(OSError):  # it holds something, or was never made
                each.rmdir()
        raise


def write_new(path: Path, text: str) -> None:
    """Write a file that is not there yet, whole. PixsimError where it is, or cannot be written."""
    if path.exists():
        raise PixsimError(f"output file: '{path}' exists already; allowed: a new name. Move it away, or take another.")
    try:
        with replacing(path) as partial:
            partial.write_text(text, encoding="utf-8")
    except OSError as error:
        raise PixsimError(f"output file: '{path}' cannot be written ({error.strerror}). Take another name.") from None


def versions() -> dict[str, str]:
    from importlib import metadata  # 20 ms

    return {"python": platform.python_version(), **{name: metadata.version(name) for name in ("pixsim", *DEPENDENCIES)}}


def write_json(path: Path, content: dict[str, Any]) -> None:
    with replacing(path) as partial:
        text = json.dumps(content, indent=2, sort_keys=True, ensure_ascii=False) + "\n"
        partial.write_text(text, encoding="utf-8", errors="backslashreplace")  # JSON's own form of a name that is no UTF-8


MIB = 1 << 20
# A file may always declare so much; more only where its length makes that likely. Deflate packs up to 1032 : 1.
ALWAYS_BYTES = 256 * MIB
MAX_RATIO = 1100
MAX_PICTURE = 1 << 28  # samples of a PNG and its like
MAX_SPECTRUM = 16 * MIB
MAX_ASSET = 4096 * MIB  # a texture or a mesh
KINDS = {
    stat.S_ISDIR: "a folder",
    stat.S_ISFIFO: "a named pipe",
    stat.S_ISCHR: "a device",
    stat.S_ISBLK: "a device",
    stat.S_ISSOCK: "a socket",
}


@contextmanager
def opened(path: Path, what: str, allowed: str, most_bytes: int | None = None) -> Iterator[IO[bytes]]:
    """A regular file, opened to be read, without waiting for one that is a pipe.

    PixsimError where it is missing, cannot be read, is of another kind, or has more than `most_bytes`.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except FileNotFoundError:
        raise invalid(what, f"'{path}', which does not exist", allowed) from None
    except (OSError, ValueError) as error:  # ValueError: NUL in a name
        raise invalid(what, f"'{path}' ({getattr(error, 'strerror', None) or error})", allowed) from None
    about = os.fstat(descriptor)
    if not stat.S_ISREG(about.st_mode):
        os.close(descriptor)
        kind = next((name for is_kind, name in KINDS.items() if is_kind(about.st_mode)), "no regular file")
        raise invalid(what, f"'{path}', {kind}", allowed)
    with os.fdopen(descriptor, "rb") as file:
        if most_bytes is not None and about.st_size > most_bytes:
            raise invalid(what, f"'{path}' of {about.st_size} bytes", f"{allowed}, of up to {most_bytes} bytes")
        yield file


def size_of(path: Path, what: str, allowed: str, most_bytes: int | None = None) -> int:
    """Bytes of a regular file that can be read; PixsimError for others."""
    with opened(path, what, allowed, most_bytes) as file:
        return os.fstat(file.fileno()).st_size


def is_utf8(path: Path) -> bool:
    """Whether a path is text: libraries in C++ take no other."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        return False
    return True


def read_bytes(path: Path, what: str, allowed: str, most_bytes: int) -> bytes:
    """A whole regular file of at most `most_bytes`; PixsimError for others."""
    with opened(path, what, allowed, most_bytes) as file:
        try:
            content = file.read(most_bytes + 1)
        except OSError as error:
            raise invalid(what, f"'{path}' ({error.strerror})", allowed) from None
    if len(content) > most_bytes:  # it grew, or is one of /proc, which tell no size
        raise invalid(what, f"'{path}' of more than {most_bytes} bytes", f"{allowed}, of up to {most_bytes} bytes")
    return content


def read_text(path: Path, what: str, allowed: str, most_bytes: int) -> str:
    """`read_bytes` in UTF-8, with the line ends of any system; PixsimError where it is something else."""
    try:
        text = read_bytes(path, what, allowed, most_bytes).decode("utf-8-sig")  # a spreadsheet's byte order mark is no text
    except UnicodeDecodeError as error:
        raise invalid(what, f"'{path}' ({error})", f"{allowed} in UTF-8") from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def check_compression(what: str, declared_bytes: int, stored_bytes: int) -> None:
    """PixsimError where a file of so many bytes declares more content than it can hold: nothing is to be allocated for that."""
    if declared_bytes > max(ALWAYS_BYTES, MAX_RATIO * stored_bytes):
        got = f"{declared_bytes} bytes of content declared in a file of {stored_bytes}"
        raise invalid(what, got, f"at most {MAX_RATIO} times its size", "Write the file anew: it is damaged.")


def check_zip(path: Path, file: zipfile.ZipFile, most_members: int) -> None:
    """PixsimError for an archive of more members or bytes than it may have, by its own table; zipfile reads no more than that."""
    members: Sequence[zipfile.ZipInfo] = file.infolist()
    if len(members) > most_members:
        raise invalid(f"archive '{path}'", f"{len(members)} members", f"at most {most_members}")
    check_compression(f"archive '{path}'", sum(member.file_size for member in members), os.path.getsize(path))


def judge_picture(path: Path) -> None:
    """PixsimError for a PNG or its like that is damaged, or of more samples than can be: its header is small, what it unpacks
    into is not."""
    from PIL import Image

    try:
        with warnings.catch_warnings(action="ignore"), Image.open(path) as image:  # its own limit warns first
            width, height = image.size
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise invalid(f"picture '{path}'", error, "a readable picture") from None
    if width * height > MAX_PICTURE:
        raise invalid(f"picture '{path}'", f"{width} × {height} samples", f"up to {MAX_PICTURE} in all")
    check_compression(f"picture '{path}'", 8 * width * height, os.path.getsize(path))


@contextmanager
def quiet_stdout() -> Iterator[None]:
    """Results go to stdout; OpenEXR's module prints its warnings there."""
    with redirect_stdout(io.StringIO()):
        yield
