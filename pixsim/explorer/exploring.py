"""`explore`: the page for light in memory."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from pixsim.base.errors import invalid
from pixsim.base.records import Record
from pixsim.explorer.session import Session
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.sensor.correction_options import Correction
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.pixel_options import Pixel
from pixsim.viewer.develop_options import Develop
from pixsim.viewer.display_options import Display


def check_installed() -> None:
    """Raise PixsimError if a package of the server is missing."""
    if missing := [
        name for name in ("starlette", "uvicorn", "websockets") if find_spec(name) is None
    ]:
        raise invalid(
            "explore", f"no package {', '.join(missing)}", "pip install 'pixsim[explore]'"
        )


def explore(
    light: SpectralImage,
    pixel: Pixel,
    camera: Camera | None = None,
    exposure: Exposure | None = None,
    display: Display | None = None,
    *,
    correction: Correction | None = None,
    develop: Develop | None = None,
    opened: Callable[[Path], object] | None = None,
) -> None:
    """Open a page in the browser on which settings of a sensor in this light are turned, until it
    is closed.

    light : on the sensor, rendered or of another program; it stays as it is
    camera : the camera of the light by default
    exposure, display, correction, develop : to start from, as in `pixsim.evaluate`
    opened : takes the path of the private file that leads to the page, such as print. None opens
        the browser

    What is shown is what `pixsim run` computes of the light. An interruption (Ctrl-C, or in a
    notebook) ends it, too.

    Raises PixsimError for invalid input, and without the packages of pixsim[explore].
    """
    check_installed()
    from pixsim.explorer.server import explore_until_closed

    names = "pixel", "camera", "exposure", "display", "correction", "develop"
    records = zip(names, (pixel, camera, exposure, display, correction, develop), strict=True)
    stated: dict[str, Any] = {"exclude_unset": True, "exclude_none": True, "exclude": {"lens"}}
    tables = {
        name: record.model_dump(**stated) for name, record in records if isinstance(record, Record)
    }
    explore_until_closed(Session(light, (), tables), opened)
