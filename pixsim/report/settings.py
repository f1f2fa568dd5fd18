"""What a result was found with, as the tables of its page: scene, camera, pixel, exposure, display."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pixsim.base.parameters import NO_TECHNOLOGY, Display, PixelOptions, Record
from pixsim.light.spectral import SpectralImage
from pixsim.show.pages import shown_value

FILLED = 0.9995  # fill factors above it read as 100 %: those of sensors whose data sheets tell the whole pixel's numbers


# Of a pixel, choices between models of a process: a sensor that is known by its data sheet uses none of them.
OF_A_PROCESS = frozenset({"capacitance", "well_limit", "conversion", "response", "fill_factor_law"})


Row = tuple[str, Any, str, str]  # a setting, its value, its meaning, and where it comes from


class Light(NamedTuple):
    """What is shown as display white, and for how long pixels see it."""

    white_cd_per_m2: float
    white_from: str
    shortest_s: float
    longest_s: float

    @classmethod
    def of(cls, irradiance: SpectralImage, display: Display, integration_s: Iterable[float]) -> Light:
        """Of a scored picture, whose white is known: the display's own number goes before the scene's."""
        header, times_s = irradiance.header, np.array(list(integration_s), float)
        if display.white_cd_per_m2:
            white, told = display.white_cd_per_m2, "display.white_cd_per_m2"
        else:
            white = header["luminance_cd_per_m2"]
            told = f"{header['white_from']} of the scene's luminance" if "white_from" in header else "the scene"
        return cls(float(white), told, float(times_s.min()), float(times_s.max()))

    @property
    def exposure(self) -> str:
        """The time, or the shortest and the longest, in ms."""
        ends = [f"{1e3 * each:.3g}" for each in (self.shortest_s, self.longest_s)]
        return " to ".join(dict.fromkeys(ends)) + " ms"

    def __str__(self) -> str:
        return f"display white is {self.white_cd_per_m2:.4g} cd/m² in the scene; exposed for {self.exposure}"


def scene_rows(
    irradiance: SpectralImage, parameters: Mapping[str, object], light: Light, sources: Mapping[str, str] | None = None
) -> list[Row]:
    """What was looked at, how bright it was, and how long it was exposed.

    parameters : of the scene, that were set
    sources : dotted name -> where its value comes from
    """
    header = irradiance.header
    named = sources or {}
    together = named.get("scene.parameters", "set")
    file = header.get("scene", header.get("source"))
    rows = [("file", file, "what is looked at", named.get("scene.file", ""))] if file else []
    for name, value in parameters.items():
        shown = Path(value).name if isinstance(value, str) else value
        rows.append((name, shown, "parameter of the scene", named.get(f"scene.parameters.{name}", together)))
    own = header.get("luminance_cd_per_m2")
    if isinstance(own, int | float) and own != light.white_cd_per_m2:
        rows.append(("luminance_cd_per_m2", f"{own:.4g}", "white of the scene, which the display does not show as its own", ""))
    rows.append(("white_cd_per_m2", f"{light.white_cd_per_m2:.4g}", "scene luminance shown as display white", light.white_from))
    rows.append(("integration_s", light.exposure, "exposure time, from the shortest to the longest frame", ""))
    return rows


def record_rows(name: str, record: Record, from_a_sheet: bool, sources: Mapping[str, str] | None = None) -> list[Row]:
    """The fields of a record that were used, with where each comes from: told by the user, set, or the default."""
    left_out = OF_A_PROCESS if from_a_sheet and isinstance(record, PixelOptions) else frozenset()
    fields, rows = type(record).model_fields, []
    for key, value in record.model_dump(exclude_none=True, exclude=set(left_out)).items():
        meaning = re.sub(r"\bNone: ", "left out: ", fields[key].description or "")
        source = (sources or {}).get(f"{name}.{key}", "default" if value == fields[key].default else "set")
        rows.append((key, shown_value(value), meaning, source))
    return rows


def only_data_sheets(technologies: Iterable[str]) -> bool:
    """Whether all sensors are known by their data sheets."""
    return all(each == NO_TECHNOLOGY for each in technologies)
