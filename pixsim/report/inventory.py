"""The documents of what there is beside results: entries of the cache, and packaged cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from pixsim.base.files import MIB
from pixsim.show.document import Answer, Block, Document, DocumentTable, Listed

if TYPE_CHECKING:
    from pixsim.sensor.camera_data import CameraEntry


def cache_document(summary: Mapping[str, Any], freed_bytes: int | None = None) -> Document:
    """Return the answer of `pixsim cache`.

    summary : folder, limit and sizes of the entries
    freed_bytes : by entries that were removed; None if none were to be
    """

    def mib(size_bytes: int) -> str:
        return f"{size_bytes / MIB:.1f} MiB"

    freed, foreign = ([] if freed_bytes is None else [f"removed {mib(freed_bytes)}"]), summary["foreign_bytes"]
    size = Answer(f"{summary['folder']}: {mib(summary['size_bytes'])} of {summary['limit_bytes'] / MIB:.0f}")
    rows = [
        (name, f"{kind['entries']} entr{'y' if kind['entries'] == 1 else 'ies'}", mib(kind["size_bytes"]))
        for name, kind in summary["kinds"].items()
    ]
    others = f"{mib(foreign)} of other files, or of another release, which pixsim leaves alone"
    blocks: list[Block] = [
        *freed,
        size,
        *([DocumentTable("entries", (), rows)] if rows else []),
        *([Listed(others)] if foreign else []),
    ]
    data = {**summary} | ({} if freed_bytes is None else {"freed_bytes": freed_bytes})
    return Document("cache", "cache", summary["folder"], data, blocks)


def cameras_document(cameras: Sequence[CameraEntry], sources: Mapping[str, str]) -> Document:
    """Return the answer of `pixsim cameras`.

    sources : of each kind
    """
    rows = [
        (each.name, each.kind, each.channels, f"{each.range_nm[0]:g}-{each.range_nm[1]:g} nm, peaks {peaks} nm", each.words)
        for each in cameras
        for peaks in [", ".join(f"{nm:g}" for nm in each.peak_nm)]
    ]
    use = 'use: pixel.colour.sensitivities = "NAME" with pixel.colour.peak_quantum_efficiency; pixsim cameras --json has the notes'
    kinds = (f"{kind}: {words}" for kind, words in sources.items())
    blocks: list[Block] = [DocumentTable("cameras", (), rows, words=None), *kinds, use]
    return Document("cameras", "cameras", "Cameras", {"cameras": [asdict(each) for each in cameras]}, blocks)
