"""Check the meshes, pictures and volumes that Mitsuba has read, before the first ray: in the child,
whose memory is bounded and which may crash.

Mitsuba takes the corners of a mesh for granted: one beyond the vertices is read from foreign
memory.
"""

from __future__ import annotations

import os
import re
from functools import lru_cache
from pathlib import Path
from types import ModuleType

import numpy as np

from pixsim.base.errors import PixsimError, invalid
from pixsim.base.machine import memory, text_of
from pixsim.scene.job import MESHES, AssetFile, TraceJob
from pixsim.scene.mitsuba import mitsuba_session
from pixsim.scene.textures import check_texels, has_floats
from pixsim.scene.variants.graphics import CUDA

MIN_BYTES = 4 << 30
# Memory for each byte of a file: a compressed half becomes floats of a picture and of its copies, a
# face becomes a part of a tree.
BYTES_PER_BYTE = 16
# A corner of an OBJ's face that names no texture coordinates, or no normal.
_CORNER = rb"(?m)^[ \t]*f[ \t](?:.*[ \t])?-?\d+%b(?=\s|\Z)"
_UNSET_OF_OBJ = (
    (
        "texture coordinates",
        re.compile(rb"(?m)^[ \t]*vt[ \t]"),
        re.compile(_CORNER % rb"(?:/(?:/-?\d*)?)?"),
    ),
    ("normals", re.compile(rb"(?m)^[ \t]*vn[ \t]"), re.compile(_CORNER % rb"(?:/-?\d*/?)?")),
)


def limit_memory(job: TraceJob) -> None:
    """Limit the memory that this process may map from now on, in proportion to the files and to
    what the machine has.

    Call it when Mitsuba's variant is set: LLVM and threads reserve addresses that they do not use.
    There is no limit for graphics cards, whose driver maps all memory of the card, and on systems
    that do not say how much is mapped.
    """
    pages = text_of(Path("/proc/self/statm")).split()
    if not pages or job.variant == CUDA:
        return
    import resource  # Windows has none

    files_bytes = sum(os.path.getsize(file.path) for file in job.files)
    machine = memory()
    room_bytes = min(
        size
        for size in (MIN_BYTES + BYTES_PER_BYTE * files_bytes, machine.total, machine.limit)
        if size is not None
    )
    limit_bytes = int(pages[0]) * os.sysconf("SC_PAGE_SIZE") + room_bytes
    _, highest = resource.getrlimit(resource.RLIMIT_AS)
    if highest not in (resource.RLIM_INFINITY, -1):
        limit_bytes = min(limit_bytes, highest)
    resource.setrlimit(resource.RLIMIT_AS, (limit_bytes, highest))


def check_files(job: TraceJob) -> list[float]:
    """Return the highest texel of each file that is a share of light; 0 for the others.

    Raises PixsimError for a file that Mitsuba cannot read, corners that are none of a mesh's
    vertices, vertices and texels that are not finite, and negative light.
    """
    highest = []
    for file in job.files:
        try:
            highest.append(_highest(job.variant, file))
        except (PixsimError, MemoryError) as error:
            # Readers of scenes, which a child that traces does not need, take 10 ms to import.
            from pixsim.scene.guard.files import escaped

            lines = job.text.splitlines()
            line = next(
                number for number, text in enumerate(lines, 1) if escaped(file.path) in text
            )
            name = Path(file.path).name
            raise PixsimError(f"At string (line {line}, col 1), '{name}': {error}") from None
    return highest


@lru_cache(maxsize=512)
def _highest(variant: str, file: AssetFile) -> float:
    """Check a file, once for its content."""
    with mitsuba_session(variant) as mi:
        if file.plugin in MESHES:
            _check_mesh(mi, file)
        elif file.has_light and (file.plugin == "gridvolume" or has_floats(file.path)):
            picture = (
                mi.VolumeGrid(file.path) if file.plugin == "gridvolume" else mi.Bitmap(file.path)
            )
            texels = np.asarray(picture)
            check_texels(Path(file.path), texels)
            if file.share and texels.dtype.kind == "f":
                return float(texels.max())
    return 0.0


def _check_mesh(mi: ModuleType, file: AssetFile) -> None:
    index = {"shape_index": file.shape_index} if file.plugin == "serialized" else {}
    # Mitsuba computes normals from the corners, which are not checked yet.
    mesh = mi.load_dict({"type": file.plugin, "filename": file.path, "face_normals": True} | index)
    what = f"mesh '{file.path}'"
    vertices = mesh.vertex_count()
    arrays = mi.traverse(mesh)
    corners = np.array(arrays["faces"])
    if not (vertices and corners.size):
        raise invalid(
            what, f"{vertices} vertices, {corners.size // 3} faces", "at least one of each"
        )
    if corners.max() >= vertices:
        raise invalid(what, f"corner {corners.max()}", f"vertex numbers from 0 to {vertices - 1}")
    if file.plugin == "obj":
        _check_obj(Path(file.path), what)
    for name in sorted(arrays.keys()):
        if name.startswith(("vertex_", "face_")) and not np.isfinite(np.array(arrays[name])).all():
            raise invalid(what, f"{name} that are NaN or infinite", "finite numbers")


def _check_obj(path: Path, what: str) -> None:
    """Raise PixsimError if some corners of faces name texture coordinates or normals and others do
    not.

    Mitsuba leaves the others as the memory was, so that a render would not repeat.
    """
    content = path.read_bytes()
    for name, declaration, corner in _UNSET_OF_OBJ:
        if declaration.search(content) and (face := corner.search(content)):
            line = content.count(b"\n", 0, face.start()) + 1
            hint = f"Export it again with {name} at every face, or at none."
            raise invalid(
                what,
                f"a face without {name} in line {line}, among others with them",
                f"{name} at every face, or at none",
                hint,
            )
