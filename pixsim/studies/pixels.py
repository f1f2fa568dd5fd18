"""The pixels of a study: of each technology or data sheet, at any size."""

from __future__ import annotations

import numpy as np

from pixsim.base.arguments import checks_arguments
from pixsim.base.arrays import Array, PositiveArray
from pixsim.base.errors import invalid
from pixsim.light.quantities import MIN_FRACTION
from pixsim.sensor.pixel import PixelPhysics, derive, fill_factor_law
from pixsim.sensor.pixel_options import NO_TECHNOLOGY, Pixel
from pixsim.sensor.quantities import Pitch
from pixsim.sensor.technology import Technology, load_technology, with_fill_factor_law
from pixsim.studies.study_settings import Study


@checks_arguments
def pixel_of(study: Study, technology: str, pitch_um: Pitch) -> Pixel:
    """Pixel of a study in a technology, by name or path, at a pitch."""
    sensor = study.sensors.get(technology)
    if sensor is None:
        return Pixel(**study.pixel.model_dump() | {"technology": technology, "pitch_um": pitch_um})
    measured_um = sensor.data_sheet_pitch_um or sensor.pitch_um
    return Pixel(**sensor.model_dump() | {"pitch_um": pitch_um, "data_sheet_pitch_um": measured_um})


def technology_of(study: Study, name: str) -> Technology:
    """Return a technology of a study with the numbers of `Study.process` in place of the file's.

    That of a data sheet (`Study.sensors`) is the one that it names, or none.

    Raises PixsimError as `load_technology` and `Technology.with_numbers` do, and for process numbers of a data sheet.
    """
    sensor, values = study.sensors.get(name), study.process.get(name)
    technology = load_technology(sensor.technology if sensor else name)
    if not values:
        return technology
    if technology.name == NO_TECHNOLOGY:
        hint = "Put them into [pixel]."
        raise invalid(f"process.{name}", ", ".join(values), "no process numbers for a data sheet", hint)
    return technology.with_numbers(values, f"process.{name}")


@checks_arguments
def physics_of(study: Study, technology: str, pitch_um: Pitch, process: Technology | None = None) -> PixelPhysics:
    """Return the physical properties of a study's pixel, with the process numbers of `Study.process`, as it is exposed.

    Parameters
    ----------
    technology : a name or path as in `Study.technologies`
    pitch_um : centre-to-centre distance
    process : the result of `technology_of`, if available

    Raises PixsimError as `derive` and `technology_of` do.
    """
    physics = derive(pixel_of(study, technology, pitch_um), process or technology_of(study, technology))
    return physics.at_exposure(study.exposure)


@checks_arguments
def photodiode_widths_um(study: Study, technology: str, pitch_um: PositiveArray) -> Array:
    """Return the widths √fill factor · pitch in µm of the square photodiodes of a study's pixels, (n,) as the pitches.

    technology : a name or path as in `Study.technologies`

    Raises PixsimError as `technology_of` does.
    """
    options = study.options_of(technology)
    process = with_fill_factor_law(technology_of(study, technology), options.fill_factor_law)
    fill_factor = options.fill_factor or np.maximum(fill_factor_law(pitch_um, process), MIN_FRACTION)
    return np.asarray(np.sqrt(fill_factor) * pitch_um)
