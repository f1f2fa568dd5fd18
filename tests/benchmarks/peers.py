"""What other Python packages do of a job, in their own environment: `versus.py` starts this and asks for one run after another.

    PYTHON tests/benchmarks/peers.py

It imports nothing of pixsim. Requests and replies are lines of JSON: {"job": …, "inputs": file of arrays} makes a job ready and
answers with its package; {"job": …, "run": file} does it and answers with its times, and stores the result if the file has a name.
"""

from __future__ import annotations

import json
import os
import sys
import time
import warnings
from collections.abc import Callable
from importlib import import_module
from importlib.metadata import version
from typing import Any

import numpy as np

Arrays = dict[str, Any]
Work = Callable[[], np.ndarray]
POPPY_PIXELS, POPPY_CELL_M = 512, 0.25e-6  # of the picture whose transform is the MTF


def demosaic(method: str) -> Callable[[Arrays], Work]:
    def ready(inputs: Arrays) -> Work:
        function = getattr(import_module("colour_demosaicing"), f"demosaicing_CFA_Bayer_{method}")
        return lambda: function(inputs["mosaic"], "RGGB")

    return ready


def difference(inputs: Arrays) -> Work:
    """XYZ of two pictures, Y = 100 for white, to CIELAB and to their difference."""
    colour = import_module("colour")
    white = colour.XYZ_to_xy(inputs["white_xyz"])

    def work() -> np.ndarray:
        one, other = (colour.XYZ_to_Lab(inputs[picture] / 100, white) for picture in ("one", "other"))
        return colour.delta_E(one, other, method="CIE 1976")

    return work


def mtf_by_prysm(inputs: Arrays) -> Work:
    mtf = import_module("prysm.otf").diffraction_limited_mtf
    frequency, f_number = inputs["frequency_cy_per_mm"], float(inputs["f_number"])
    return lambda: np.stack([mtf(f_number, 1e-3 * nm, frequency) for nm in inputs["wavelength_nm"]])


def mtf_by_poppy(inputs: Arrays) -> Work:
    """Its matrix Fourier transform of a sampled pupil to a picture, whose transform is the MTF."""
    poppy = import_module("poppy")
    frequency, f_number = inputs["frequency_cy_per_mm"], float(inputs["f_number"])

    def work() -> np.ndarray:
        system = poppy.OpticalSystem(npix=256)
        system.add_pupil(poppy.CircularAperture(radius=0.5))
        scale = np.degrees(POPPY_CELL_M / f_number) * 3600
        system.add_detector(pixelscale=scale, fov_pixels=POPPY_PIXELS, oversample=1)
        known = np.fft.rfftfreq(POPPY_PIXELS, 1e3 * POPPY_CELL_M)
        found = []
        for nm in inputs["wavelength_nm"]:
            along = np.abs(np.fft.rfft(system.calc_psf(wavelength=1e-9 * nm)[0].data.sum(axis=0)))
            found.append(np.interp(frequency, known, along / along[0]))
        return np.stack(found)

    return work


def opd_by_optiland(inputs: Arrays) -> Work:
    """Optical path differences in waves, (fields, wavelengths, points), of its sample lens CookeTriplet."""
    lens = import_module("optiland.samples.objectives").CookeTriplet()
    wavefront = import_module("optiland.wavefront").Wavefront
    largest = lens.fields.max_field
    points = import_module("optiland.distribution").create_distribution("hexapolar")
    points.x, points.y = inputs["x"], inputs["y"]
    fields = [(0.0, float(field_deg) / largest) for field_deg in inputs["field_deg"]]
    wavelengths_um = [1e-3 * float(nm) for nm in inputs["wavelength_nm"]]

    def work() -> np.ndarray:
        made = wavefront(lens, fields, wavelengths_um, distribution=points)
        return np.array([[np.asarray(made.get_data(field, um).opd) for um in wavelengths_um] for field in fields])

    return work


JOBS: dict[str, tuple[str, Callable[[Arrays], Work]]] = {
    "bilinear": ("colour-demosaicing", demosaic("bilinear")),
    "malvar2004": ("colour-demosaicing", demosaic("Malvar2004")),
    "menon2007": ("colour-demosaicing", demosaic("Menon2007")),
    "CIELAB": ("colour-science", difference),
    "MTF, closed form": ("prysm", mtf_by_prysm),
    "MTF, from the PSF": ("poppy", mtf_by_poppy),
    "OPD": ("optiland", opd_by_optiland),
}


def main() -> None:
    replies = os.fdopen(os.dup(1), "w", encoding="utf-8", buffering=1)
    os.dup2(2, 1)  # packages may print
    warnings.simplefilter("ignore")
    works: dict[str, Work] = {}
    for line in sys.stdin:
        request = json.loads(line)
        try:
            job = request["job"]
            if "inputs" in request:
                package, ready = JOBS[job]
                with np.load(request["inputs"]) as file:
                    works[job] = ready(dict(file))
                reply: dict[str, object] = {"package": f"{package} {version(package)}"}
            else:
                clock, cores = time.perf_counter(), time.process_time()
                result = works[job]()
                reply = {"s": time.perf_counter() - clock, "cores_s": time.process_time() - cores}
                if request["run"]:
                    np.save(request["run"], np.asarray(result))
        except Exception as error:  # of a package that is missing, or has another interface
            reply = {"error": f"{type(error).__name__}: {error}"}
        replies.write(json.dumps(reply) + "\n")


if __name__ == "__main__":
    main()
