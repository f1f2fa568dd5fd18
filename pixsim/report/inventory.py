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

    blocks: list[Block] = []
    if freed_bytes is not None:
        blocks.append(f"removed {mib(freed_bytes)}")
    blocks.append(Answer(f"{summary['folder']}: {mib(summary['size_bytes'])} of {mib(summary['limit_bytes'])}"))
    rows = [
        (name, f"{kind['entries']} entr{'y' if kind['entries'] == 1 else 'ies'}", mib(kind["size_bytes"]))
        for name, kind in summary["kinds"].items()
    ]
    if rows:
        blocks.append(DocumentTable("entries", (), rows))
    if summary["foreign_bytes"]:
        blocks.append(Listed([f"{mib(summary['foreign_bytes'])} of other files, or of another release, which pixsim leaves alone"]))
    data = {**summary} | ({} if freed_bytes is None else {"freed_bytes": freed_bytes})
    return Document("cache", "cache", summary["folder"], data, blocks)


def cameras_document(cameras: Sequence[CameraEntry], sources: Mapping[str, str]) -> Document:
    """Return the answer of `pixsim cameras`.

    sources : of each kind
    """
    rows = []
    for camera in cameras:
        low_nm, high_nm = camera.range_nm
        peaks = ", ".join(f"{peak_nm:g}" for peak_nm in camera.peak_nm)
        rows.append((camera.name, camera.kind, camera.channels, f"{low_nm:g}-{high_nm:g} nm, peaks {peaks} nm", camera.words))
    use = 'use: pixel.colour.sensitivities = "NAME" with pixel.colour.peak_quantum_efficiency; pixsim cameras --json has the notes'
    kinds = (f"{kind}: {words}" for kind, words in sources.items())
    blocks: list[Block] = [DocumentTable("cameras", (), rows, words=None), *kinds, use]
    return Document("cameras", "cameras", "Cameras", {"cameras": [asdict(each) for each in cameras]}, blocks)
