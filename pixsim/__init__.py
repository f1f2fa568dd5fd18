"""pixsim: from a Mitsuba 3 spectral scene to the pixel size with the least visible error.

Names are imported on first use, so that `import pixsim` is fast.
"""

from __future__ import annotations

from pixsim.base.version import VERSION

TYPE_CHECKING = False  # as of `typing`, whose import takes as long as the rest of this file
if TYPE_CHECKING:
    from pixsim import optics as optics, sensor as sensor
    from pixsim.base.errors import PixsimError as PixsimError
    from pixsim.explorer.exploring import explore as explore
    from pixsim.light import spectral as spectral
    from pixsim.light.exr import read_exr as read_exr, write_exr as write_exr
    from pixsim.light.spectral import SpectralImage as SpectralImage
    from pixsim.measure.datasheet import datasheet as datasheet
    from pixsim.measure.lens import lens as lens
    from pixsim.measure.sfr import edge_response as edge_response, sfr as sfr
    from pixsim.optics.camera import Camera as Camera
    from pixsim.optics.exchange import read_irradiance as read_irradiance, write_npz as write_npz
    from pixsim.optics.lens import load_lens as load_lens
    from pixsim.report.write import write_report as write_report
    from pixsim.scene import charts as charts
    from pixsim.scene.charts import make_chart as make_chart, write_chart as write_chart
    from pixsim.scene.plan import Plan as Plan, make_plan as make_plan
    from pixsim.scene.renderer import render as render
    from pixsim.scene.scene import load_scene as load_scene
    from pixsim.sensor import photodiode as photodiode, pixel as pixel
    from pixsim.sensor.correction_options import Correction as Correction
    from pixsim.sensor.dynamic_range import dynamic_range as dynamic_range, snr_db as snr_db
    from pixsim.sensor.exposure import Exposure as Exposure
    from pixsim.sensor.motion_options import Motion as Motion
    from pixsim.sensor.pixel import derive as derive
    from pixsim.sensor.pixel_options import Pixel as Pixel
    from pixsim.sensor.raw import read_frame as read_frame, write_frame as write_frame
    from pixsim.sensor.readout import Frame as Frame, capture as capture, make_sensor as make_sensor
    from pixsim.sensor.technology import (
        Technology as Technology,
        load_technology as load_technology,
    )
    from pixsim.studies.compare import compare as compare
    from pixsim.studies.run import run as run
    from pixsim.studies.settings import Study as Study
    from pixsim.studies.study import study as study
    from pixsim.studies.sweep import sweep as sweep
    from pixsim.studies.two_results import compare_results as compare_results
    from pixsim.verification.ladder import accuracy as accuracy
    from pixsim.viewer import (
        display as display,
        metric_kernels as metric_kernels,
        scielab as scielab,
    )
    from pixsim.viewer.colour_matrix import colour_matrix as colour_matrix
    from pixsim.viewer.demosaic import demosaic as demosaic
    from pixsim.viewer.develop_options import Develop as Develop
    from pixsim.viewer.display_options import Display as Display
    from pixsim.viewer.evaluate import evaluate as evaluate
    from pixsim.viewer.other_pictures import score_pictures as score_pictures
    from pixsim.viewer.scielab import delta_e_map as delta_e_map
    from pixsim.viewer.score import Score as Score
    from pixsim.viewer.settings_file import load_pixel as load_pixel

__version__ = VERSION

_NAMES_OF = {
    "base.errors": "PixsimError",
    "optics.camera": "Camera",
    "sensor.correction_options": "Correction",
    "sensor.dynamic_range": "dynamic_range snr_db",
    "sensor.exposure": "Exposure",
    "sensor.motion_options": "Motion",
    "sensor.pixel_options": "Pixel",
    "studies.settings": "Study",
    "viewer.develop_options": "Develop",
    "viewer.display_options": "Display",
    "viewer.settings_file": "load_pixel",
    "sensor.technology": "Technology load_technology",
    "light.spectral": "SpectralImage",
    "light.exr": "read_exr write_exr",
    "optics.exchange": "read_irradiance write_npz",
    "optics.lens": "load_lens",
    "scene.charts": "make_chart write_chart",
    "scene.scene": "load_scene",
    "scene.renderer": "render",
    "scene.plan": "Plan make_plan",
    "sensor.pixel": "derive",
    "sensor.readout": "Frame capture make_sensor",
    "sensor.raw": "write_frame read_frame",
    "measure.datasheet": "datasheet",
    "measure.lens": "lens",
    "measure.sfr": "edge_response sfr",
    "viewer.colour_matrix": "colour_matrix",
    "viewer.demosaic": "demosaic",
    "viewer.scielab": "delta_e_map",
    "viewer.score": "Score",
    "viewer.evaluate": "evaluate",
    "viewer.other_pictures": "score_pictures",
    "studies.study": "study",
    "studies.compare": "compare",
    "studies.two_results": "compare_results",
    "report.write": "write_report",
    "studies.run": "run",
    "studies.sweep": "sweep",
    "explorer.exploring": "explore",
    "verification.ladder": "accuracy",
}
_HOME = {name: module for module, names in _NAMES_OF.items() for name in names.split()}
_MODULES = {
    "optics": "optics",
    "photodiode": "sensor.photodiode",
    "pixel": "sensor.pixel",
    "sensor": "sensor",
    "display": "viewer.display",
    "scielab": "viewer.scielab",
    "metrics": "viewer.metric_kernels",
    "charts": "scene.charts",
    "spectral": "light.spectral",
}

# Type of results -> the module that plots, writes and shows them.
PRESENTERS = {
    "Accuracy": "report.accuracy",
    "Comparison": "report.compare",
    "Curve": "report.curve",
    "DataSheet": "report.datasheet",
    "EdgeResponse": "report.sfr",
    "LensData": "report.lens",
    "RunResult": "report.run",
    "ResultsComparison": "report.two_results",
    "Score": "report.score",
    "StudyResult": "report.axes",
    "Table": "report.table",
}

__all__ = [*_HOME, "optics"]


def __getattr__(name: str) -> object:
    from importlib import import_module

    if name in _HOME:
        from pixsim.base.door import public

        return public(getattr(import_module(f"pixsim.{_HOME[name]}"), name), f"pixsim.{name}")
    if name in _MODULES:
        module = import_module(f"pixsim.{_MODULES[name]}")
        if name == _MODULES[name]:  # a package, which hands out checked functions itself
            return module
        from pixsim.base.door import public_module

        return globals().setdefault(name, public_module(f"pixsim.{name}", module))
    raise AttributeError(f"module 'pixsim' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted({"__version__", *__all__, *_MODULES})
