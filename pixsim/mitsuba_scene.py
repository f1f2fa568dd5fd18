"""What Mitsuba is given: the scene with the lamps of one spectrum, and films whose channels are pulses."""

from __future__ import annotations

from typing import Any

from pixsim.bands import Pulse
from pixsim.mitsuba_xml import children, nodes_of
from pixsim.plan import Light
from pixsim.rules import irregular_tables
from pixsim.scene import Scene
from pixsim.spectral import Array

SCALAR_BLOCK = 32  # fixed: left to itself Mitsuba makes blocks, and with them seeds, by the number of threads


def film(responses: list[dict[str, Any]], size: tuple[int, int], top: int, bottom: int) -> dict[str, Any]:
    """A specfilm for some rows: float32 and a box, so that a cell holds its mean and runs repeat."""
    height, width = size
    return {
        "type": "specfilm",
        "width": width,
        "height": height,
        "component_format": "float32",
        "rfilter": {"type": "box"},
        "crop_offset_x": 0,
        "crop_offset_y": int(top),
        "crop_width": width,
        "crop_height": int(bottom - top),
        **{f"band{channel}": response for channel, response in enumerate(responses)},
    }


def film_response(pulse: Pulse) -> dict[str, Any]:
    return _regular(pulse.low_nm, pulse.high_nm, pulse.values)


def _regular(low_nm: float, high_nm: float, values: Array) -> dict[str, Any]:
    text = ", ".join(repr(float(value)) for value in values)
    return {"type": "regular", "wavelength_min": low_nm, "wavelength_max": high_nm, "values": text}


def load_light(mi: Any, scene: Scene, state: Any, light: Light, scalar: bool, regular_tables: bool) -> Any:
    """The scene with the emitters of one light only, each as its neutral picture or relative power: the spectrum is in the
    pulses. Emitters whose colours vary stay as they are, and the pulses are flat."""
    emitters = nodes_of(state, "Emitter")
    dark = {index for index, _ in emitters} - light.lamp.pictures.keys()
    for parent in state.nodes if dark else ():
        for name, child in children(parent, state).items():
            if child in dark:
                del parent.props[name]
    for index, node in emitters:
        if index in light.lamp.pictures and light.lamp.spectrum is not None:
            name, picture = light.lamp.pictures[index]
            if isinstance(picture, int):
                node.props[name] = mi.Properties.ResolvedReference(picture)
            else:
                node.props[name] = mi.load_dict({"type": "uniform", "value": picture})  # a plain number would be a d65
    for _, node in nodes_of(state, "Integrator"):
        if scalar and "block_size" not in node.props:
            node.props["block_size"] = SCALAR_BLOCK
    for (index, name), (table, values) in irregular_tables(state).items() if regular_tables else ():
        state.nodes[index].props[name] = mi.load_dict(_regular(float(table.nodes_nm[0]), float(table.nodes_nm[-1]), values))
    config = mi.parser.ParserConfig(scene.choice.variant)
    mi.parser.transform_all(config, state)
    built = mi.parser.instantiate(config, state)
    return next(each for each in built if isinstance(each, mi.Scene)) if isinstance(built, list) else built
