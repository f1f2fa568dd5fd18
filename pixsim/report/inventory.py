"""The documents of what there is beside results: entries of the cache, and packaged cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from pixsim.base import cache
from pixsim.base.errors import invalid
from pixsim.base.files import MIB
from pixsim.show.document import Answer, Block, Document, DocumentTable

if TYPE_CHECKING:
    from pixsim.sensor.camera_data import CameraEntry


def cache_document(kind: str | None = None, clear: bool = False) -> Document:
    """Return the answer of `pixsim cache`: what the cache holds, after its entries were removed if
    asked for.

    kind : of entries. None means all

    Raises PixsimError for a kind of which there are no entries.
    """
    kinds = cache_summary()["kinds"]
    if kind is not None and kind not in kinds:
        raise invalid("--kind", f"'{kind}'", ", ".join(kinds) or "none, since the cache is empty")
    freed_bytes = cache.clear(kind) if clear else 0
    summary = cache_summary(kind)

    size = f"{summary['folder']}: {_mib(summary['size_bytes'])} of {_mib(summary['limit_bytes'])}"
    blocks: list[Block] = [f"removed {_mib(freed_bytes)}"] if clear else []
    blocks.append(Answer(size))
    rows = []
    for name, total in summary["kinds"].items():
        entries = "1 entry" if total["entries"] == 1 else f"{total['entries']} entries"
        rows.append((name, entries, _mib(total["size_bytes"])))
    if rows:
        blocks.append(DocumentTable("entries", (), rows))
    data = summary | ({"freed_bytes": freed_bytes} if clear else {})
    return Document("cache", "cache", summary["folder"], data, blocks)


def cache_summary(kind: str | None = None) -> dict[str, Any]:
    """Return folder and size limit of the cache, and the entries and bytes of each kind, or of
    one.
    """
    kinds: dict[str, dict[str, int]] = {}
    for name in [kind] if kind else [None, *cache.HELPERS]:
        for entry in cache.entries(name):
            total = kinds.setdefault(entry.kind, {"entries": 0, "size_bytes": 0})
            total["entries"] += 1
            total["size_bytes"] += entry.size_bytes
    return {
        "folder": str(cache.folder()),
        "limit_bytes": cache.limit_bytes(),
        "size_bytes": sum(total["size_bytes"] for total in kinds.values()),
        "kinds": dict(sorted(kinds.items())),
    }


def _mib(size_bytes: int) -> str:
    return f"{size_bytes / MIB:.1f} MiB"


def cameras_document(cameras: Sequence[CameraEntry], sources: Mapping[str, str]) -> Document:
    """Return the answer of `pixsim cameras`.

    sources : of each kind
    """
    rows = []
    for camera in cameras:
        low_nm, high_nm = camera.range_nm
        peaks = ", ".join(f"{peak_nm:g}" for peak_nm in camera.peak_nm)
        rows.append(
            (
                camera.name,
                camera.kind,
                camera.channels,
                f"{low_nm:g}-{high_nm:g} nm, peaks {peaks} nm",
                camera.description,
            )
        )
    use = (
        'use: pixel.colour.sensitivities = "NAME" with pixel.colour.peak_quantum_efficiency; pixsim'
        " cameras --json has the notes"
    )
    kinds = (f"{kind}: {words}" for kind, words in sources.items())
    blocks: list[Block] = [DocumentTable("cameras", (), rows, words=None), *kinds, use]
    return Document(
        "cameras", "cameras", "Cameras", {"cameras": [asdict(camera) for camera in cameras]}, blocks
    )
