"""`pixsim cache`: what is kept, and how to be rid of it."""

from __future__ import annotations

from typing import Annotated, Any

from cyclopts import Parameter

from pixsim.cli.base import Json, app, show
from pixsim.errors import refuse

MIB = 1 << 20


@app.command
def cache(
    *,
    clear: Annotated[bool, Parameter(help="Remove what is kept.")] = False,
    kind: Annotated[str | None, Parameter(help="Only entries of this kind, as the list names them.")] = None,
    json: Json = False,
) -> None:
    """Show or clear what is kept between runs: renders, frames of studies, calibrations.

    Example: pixsim cache --clear

    An entry is named by the hash of all that made it, so that nothing in it is ever out of date: clearing only frees
    space. PIXSIM_CACHE_DIR moves the folder, PIXSIM_CACHE_GIB bounds it (4 by default, 0 keeps nothing); what was not used
    for the longest time goes first. Mitsuba's kernels and Matplotlib's fonts lie beside the entries; --kind names them too.
    """
    from pixsim import cache as kept  # with NumPy, which help does without

    kinds = sorted(summary()["kinds"])
    if kind is not None and kind not in kinds:
        raise refuse("--kind", f"'{kind}'", ", ".join(kinds) or "none, since nothing is kept")
    freed = kept.clear(kind) if clear else None
    found = summary(kind)
    lines = [f"{kept.folder()}: {found['size_bytes'] / MIB:.1f} MiB of {found['limit_bytes'] / MIB:.0f}"]
    lines += [
        f"  {name:<12} {own['entries']:>6} entries {own['size_bytes'] / MIB:>10.1f} MiB" for name, own in found["kinds"].items()
    ]
    if freed is not None:
        found["freed_bytes"] = freed
        lines.insert(0, f"removed {freed / MIB:.1f} MiB")
    show(found, json, "\n".join(lines))


def summary(kind: str | None = None) -> dict[str, Any]:
    """The folder, its limit, and entries and bytes of each kind, or of one."""
    from pixsim import cache as kept

    kinds: dict[str, dict[str, int]] = {}
    for each in [kind] if kind else [None, *kept.HELPERS]:
        for entry in kept.entries(each):
            own = kinds.setdefault(entry.kind, {"entries": 0, "size_bytes": 0})
            own["entries"] += 1
            own["size_bytes"] += entry.size_bytes
    return {
        "folder": str(kept.folder()),
        "limit_bytes": kept.limit_bytes(),
        "size_bytes": sum(own["size_bytes"] for own in kinds.values()),
        "kinds": dict(sorted(kinds.items())),
    }
