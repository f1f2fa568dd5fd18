"""The picture files that a scene names: found, checked, and read as texels."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from pixsim.errors import refuse
from pixsim.geometry import matrix_of
from pixsim.lamps import EMISSION, is_neutral
from pixsim.mitsuba_xml import children, nodes_of
from pixsim.safe_files import judge_picture
from pixsim.scene_files import judge_asset
from pixsim.spectral import Array, read_channels

PLAIN_SPECTRA = ("uniform", "d65", "blackbody", "regular", "irregular", "srgb")
# Maps that are no light and no reflectance: any numbers, in any number of channels.
MAPS = ("normalmap", "bumpmap", "mask", "blendbsdf")
MAP_NAMES = ("alpha", "alpha_u", "alpha_v", "roughness", "metallic", "anisotropic", "weight", "opacity")
EIGHT_BIT = (".png", ".jpg", ".jpeg", ".bmp", ".tga")


def texture_files(state: Any, folder: Path) -> list[Path]:
    """Files that nodes name; PixsimError for one that is missing."""
    return [_file_of(node, folder) for node in state.nodes if "filename" in node.props]


def _file_of(node: Any, folder: Path) -> Path:
    name = str(node.props["filename"])
    found = next((path for path in (folder / name, Path(name)) if os.path.lexists(path)), None)
    if found is None:
        raise refuse("texture", f"'{name}', which does not exist", f"a file, relative to '{folder}' or to here")
    judge_asset(found, "texture")
    return found


def check_textures(state: Any, folder: Path) -> None:
    """Refuse NaN, infinite and negative texels: Mitsuba lets them pass, and spreads them over their neighbours."""
    maps = _maps(state)
    files = {index: _file_of(node, folder) for index, node in nodes_of(state, "Texture") if "filename" in node.props}
    raw = {path for index, path in files.items() if is_neutral(state.nodes[index]) and index not in maps}
    numbers = {path for index, path in files.items() if index in maps}
    for path in texture_files(state, folder):
        if path.suffix.lower() in EIGHT_BIT:
            judge_picture(path)
        if path in numbers and path not in raw:
            continue
        if path in raw and path.suffix.lower() in EIGHT_BIT:
            raise refuse(
                f"texture '{path}'", f"{path.suffix} with raw = true", "a linear float32 EXR of one channel, as pixsim chart writes"
            )
        if path.suffix.lower() == ".exr":
            channels = read_channels(path)[0]
            if path in raw and len(channels) > 1:
                raise refuse(
                    f"texture '{path}'", f"channels {', '.join(channels)} with raw = true", "one channel, Y: a neutral picture"
                )
            for name, texels in channels.items():
                bad = ~(np.isfinite(texels) & (texels >= 0))
                if bad.any():
                    row, column = np.argwhere(bad)[0]
                    raise refuse(
                        f"texture '{path}'",
                        f"{texels[row, column]} at row {row}, column {column} of channel {name}",
                        "finite texels of 0 or more",
                    )


def _maps(state: Any) -> set[int]:
    """Textures that only steer: normals, bumps, opacity, weights, roughness."""
    maps: set[int] = set()
    others: set[int] = set()
    for node in state.nodes:
        for name, index in children(node, state).items():
            steers = node.props.plugin_name() in MAPS or name in MAP_NAMES
            (maps if steers else others).add(index)
    return {index for index in maps - others if state.nodes[index].type.name == "Texture"}


def emitted_picture(state: Any, emitter: Any, folder: Path) -> Array | None:
    """Texels of an emitter's neutral EXR, one of value 1 where there is no picture.

    None where the picture is of another kind, turned, repeated, or not seen from its middle.
    """
    name = EMISSION.get(emitter.props.plugin_name(), "")
    texture = children(emitter, state).get(name)
    while texture is not None and not is_neutral(state.nodes[texture]):
        nested = list(children(state.nodes[texture], state).values())
        if not nested and state.nodes[texture].props.plugin_name() not in PLAIN_SPECTRA:
            return None
        texture = nested[0] if nested else None
    if texture is None:
        return np.ones((1, 1))
    node = state.nodes[texture]
    to_uv = matrix_of(node, "to_uv")
    path = folder / str(node.props.get("filename", ""))
    whole = np.allclose(np.abs(to_uv[:2, :2]), np.eye(2)) and np.allclose(to_uv[:2, :2].sum(axis=1) / 2 + to_uv[:2, 3], 0.5)
    if path.suffix.lower() != ".exr" or not path.is_file() or not whole:
        return None
    return next(iter(read_channels(path)[0].values())).astype(float)
