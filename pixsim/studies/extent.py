"""What a picture shows of the sensor, and of the CSF chart on it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.scene.charts import MAX_LP_PER_MM, csf_contrast, csf_frequency_on_sensor
from pixsim.sensor.integration import pixels_along
from pixsim.studies.study_settings import Study
from pixsim.studies.varied import paths_of
from pixsim.viewer.display import picture_size_um

Border = tuple[float, float]  # µm omitted above and below, and left and right, of the rendered picture
NO_BORDER: Border = (0.0, 0.0)


def extent(irradiance: SpectralImage, border_um: Border = NO_BORDER) -> tuple[float, float, float, float]:
    """Return left, right, bottom, top in mm on the sensor of a picture without its border, row 0 on top."""
    height_um, width_um = picture_size_um(irradiance)
    down_um, across_um = border_um
    return 1e-3 * across_um, 1e-3 * (width_um - across_um), 1e-3 * (height_um - down_um), 1e-3 * down_um


def csf_range_lp_per_mm(irradiance: SpectralImage, border_um: Border = NO_BORDER) -> tuple[float, float] | None:
    """Return the lowest and highest frequency of the CSF chart within a border; None for another scene."""
    left, right, _, _ = extent(irradiance, border_um)
    width_mm = extent(irradiance)[1]
    frequency = csf_frequency_on_sensor(irradiance.header, width_mm)
    return None if frequency is None else (float(frequency(left / width_mm)), float(frequency(right / width_mm)))


def csf_contrasts(irradiance: SpectralImage, border_um: Border = NO_BORDER) -> tuple[float, float]:
    """Return the contrast of the CSF chart at the top and at the bottom of a picture of it, within a border."""
    _, _, bottom, top = extent(irradiance, border_um)
    height_mm = extent(irradiance)[2]
    return float(csf_contrast(top / height_mm)), float(csf_contrast(bottom / height_mm))


def stated_end_lp_per_mm(header: Mapping[str, Any]) -> float | None:
    """Return the highest frequency that a scene's parameters give the CSF chart; None if they state none.

    header : of an irradiance
    """
    parameters = header.get("parameters")
    return float(parameters[MAX_LP_PER_MM]) if isinstance(parameters, dict) and MAX_LP_PER_MM in parameters else None


def moved_view(study: Study) -> list[str]:
    """Return which of the display's dots and the chart's end an axis or a condition of a study sets, as dotted names."""
    moved = {path for axis in study.axis for path in axis.paths} | {path for each in study.condition for path in paths_of(each.set)}
    return [".".join(path) for path in (("display", "dots"), ("scene", "parameters", MAX_LP_PER_MM)) if path in moved]


def columns_on(camera: Camera, pitch_um: float) -> int:
    """Return the columns of pixels on the die. Raises PixsimError if not one pixel fits."""
    return pixels_along(camera.die_um[1], pitch_um)
