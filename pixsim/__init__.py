"""pixsim: from a Mitsuba 3 spectral scene to the pixel size with the least visible error.

Names are imported when first used, so that `import pixsim` stays quick.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from pixsim import optics as optics
    from pixsim.charts import make_chart as make_chart
    from pixsim.charts import write_chart as write_chart
    from pixsim.errors import PixsimError as PixsimError
    from pixsim.exchange import read_irradiance as read_irradiance
    from pixsim.exchange import write_npz as write_npz
    from pixsim.parameters import Camera as Camera
    from pixsim.parameters import Display as Display
    from pixsim.parameters import Exposure as Exposure
    from pixsim.parameters import Pixel as Pixel
    from pixsim.parameters import Study as Study
    from pixsim.pixel import derive as derive
    from pixsim.plan import Plan as Plan
    from pixsim.raw import read_frame as read_frame
    from pixsim.raw import write_frame as write_frame
    from pixsim.renderer import render as render
    from pixsim.report import write_report as write_report
    from pixsim.scene import load_scene as load_scene
    from pixsim.scielab import delta_e_map as delta_e_map
    from pixsim.score import evaluate as evaluate
    from pixsim.sensor import Frame as Frame
    from pixsim.sensor import capture as capture
    from pixsim.sensor import make_sensor as make_sensor
    from pixsim.sensor_plan import make_plan as make_plan
    from pixsim.sfr import edge_response as edge_response
    from pixsim.spectral import SpectralImage as SpectralImage
    from pixsim.spectral import read_exr as read_exr
    from pixsim.spectral import write_exr as write_exr
    from pixsim.sweep import study as study
    from pixsim.technology import Technology as Technology
    from pixsim.technology import load_technology as load_technology

_HOME = {
    "PixsimError": "errors",
    "Camera": "parameters",
    "Display": "parameters",
    "Exposure": "parameters",
    "Pixel": "parameters",
    "Study": "parameters",
    "Technology": "technology",
    "load_technology": "technology",
    "SpectralImage": "spectral",
    "read_exr": "spectral",
    "write_exr": "spectral",
    "read_irradiance": "exchange",
    "write_npz": "exchange",
    "make_chart": "charts",
    "write_chart": "charts",
    "load_scene": "scene",
    "render": "renderer",
    "Plan": "plan",
    "make_plan": "sensor_plan",
    "derive": "pixel",
    "Frame": "sensor",
    "capture": "sensor",
    "make_sensor": "sensor",
    "write_frame": "raw",
    "read_frame": "raw",
    "edge_response": "sfr",
    "delta_e_map": "scielab",
    "evaluate": "score",
    "study": "sweep",
    "write_report": "report",
}
_MODULES = ("optics", "photodiode", "pixel", "sensor", "display", "scielab", "charts", "parameters", "spectral")

__all__ = [*_HOME, "optics"]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(f"pixsim.{_HOME[name]}"), name)
    if name in _MODULES:
        return import_module(f"pixsim.{name}")
    raise AttributeError(f"module 'pixsim' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted({"__version__", *__all__, *_MODULES})
