"""What a parsed scene is, in one hash: every node in full, and the bytes of the files that it names."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np

from pixsim.mitsuba_xml import children, plain
from pixsim.parameters import content_hash
from pixsim.textures import texture_files


def hash_of_tree(state: Any, folder: Path) -> str:
    """16 hexadecimal digits. PixsimError for a file that is missing."""
    tree = [
        [
            node.type.name,
            node.props.plugin_name(),
            sorted((name, in_full(value)) for name, value in plain(node, numbers_only=False)),
            sorted(children(node, state).items()),
        ]
        for node in state.nodes
    ]
    return content_hash([tree, [_hash_of(path) for path in texture_files(state, folder)]])


def _hash_of(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "blake2b").hexdigest()


def in_full(value: Any) -> str:
    """A property to its last digit: Mitsuba's own text of a spectrum tells its length, that of vectors six digits."""
    kind = type(value).__name__  # a Dr.Jit vector has every attribute: it takes the name for a swizzle
    if kind == "Spectrum":
        return f"{value.wavelengths} {value.values}"
    if "Transform" in kind:
        return str(np.array(value.matrix).tolist())
    return str(np.array(value).tolist()) if "Array" in kind or "Color" in kind else str(value)
