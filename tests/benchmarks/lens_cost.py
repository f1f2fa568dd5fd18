"""Time and error of a real lens's blur: python tests/benchmarks/lens_cost.py [LENS ...]

For each lens on the default die, a film of 1024² and a pixel of 2 µm: seconds of all processor cores together (which other
programs on the machine raise) and by the clock, for the trace, for the plan's choice, for a first picture and for one whose
PSFs come from the cache; the memory of the process; and the blurred picture against superposition at 64 points. Superposition
takes the PSF of each lit point of random dots from its own pupil, whole and without tiles. For the packaged chart csf, lit
everywhere, the picture of 129 × 129 tiles stands for it. Errors are relative to the rms of the blurred picture about its mean.
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any
from unittest import mock

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.parameters import CameraOptions, LensOptions, Pixel
from pixsim.light.spectral import photons_per_joule
from pixsim.optics import camera_lens
from pixsim.optics.camera_lens import Tiling, blur_of, choose_tiling, light_of
from pixsim.optics.field_blur import FieldBlur, Light, periodic_psf
from pixsim.optics.lens import load_lens
from pixsim.scene.charts import csf_value
from pixsim.scene.real_lens import SEEN_NM
from pixsim.scene.scene import load_scene
from pixsim.sensor.pixel import derive

SIDE, POINTS, LIT, TOLERANCE = 1024, 64, 1 / 250, 0.01
COMPARED, FINEST = (16, 32, 64), 128  # tiles across
PIXEL = derive(Pixel(pitch_um=6.5, technology="0.35um"))
APERTURE_UM = 2.0
WEIGHT = photons_per_joule(SEEN_NM) * PIXEL.quantum_efficiency(SEEN_NM)


def timed(name: str, work: Callable[[], Any]) -> Any:
    clock, cores = time.perf_counter(), time.process_time()
    result = work()
    print(
        f"  {name:46} {time.process_time() - cores:6.2f} s of cores, {time.perf_counter() - clock:6.2f} s by the clock", flush=True
    )
    return result


def forget() -> None:
    camera_lens._BLURS.clear()
    camera_lens._PSFS.clear()


def superposed_at(picture: Array, points: Array, light: Light, pitch_um: float, cells: int) -> Array:
    """The blurred picture at cells (n, 2), each lit cell with its own PSF."""
    values, reach = [], cells // 2
    for point in points:
        first = np.maximum(point - reach, 0)
        lit = np.argwhere(picture[first[0] : point[0] + reach + 1, first[1] : point[1] + reach + 1]) + first
        total = 0.0
        for source in lit:
            y_um, x_um = (source - (SIDE - 1) / 2) * pitch_um
            psf = periodic_psf(light, x_um, y_um, pitch_um, 2 * cells + 2)  # twice as wide: little light folds back
            total += picture[tuple(source)] * float(psf[tuple(point - source)])
        values.append(total)
    return np.array(values)


def blurred(blur: FieldBlur, picture: Array) -> Array:
    reach = blur.cells // 2
    return blur.superposed(np.pad(picture, reach))[0][2 * reach : -2 * reach, 2 * reach : -2 * reach]


def measure(name: str) -> None:
    camera = load_scene("csf", resolution=SIDE).camera(CameraOptions(), LensOptions(file=name))
    pitch_um, shape = 1e3 * camera.die_mm / SIDE, (SIDE, SIDE)
    print(f"{name} at f/{camera.f_number:.3g} on {camera.die_mm:g} mm, film of {SIDE}² cells of {pitch_um:.3g} µm")
    lens = load_lens(name)
    x, y = np.meshgrid(np.linspace(-1, 1, 64), np.linspace(-1, 1, 64))
    fields, nm = np.linspace(0, lens.max_field_deg, 17)[:, None, None, None], np.linspace(430, 680, 8)[:, None, None]
    timed("OPD of 17 fields × 8 wavelengths on 64² pupils", lambda: lens.opd_waves(fields, nm, x, y))
    seen = tuple(SEEN_NM.tolist()), tuple(WEIGHT.tolist())
    tiling: Tiling = timed("choice of tiles", lambda: choose_tiling(camera, shape, pitch_um, *seen, APERTURE_UM, TOLERANCE))
    spacing, cells = tiling.cells(pitch_um)
    print(
        f"  {SIDE / spacing:.0f} tiles across, PSFs of {cells} cells, {tiling.wavelengths} wavelengths, {tiling.nodes} wavefronts"
    )
    print(f"  bound {tiling.error:.2%}, {tiling.worst:.2%} at the worst place; lacking in a PSF", end=" ")
    forget()
    chart = csf_value((np.arange(SIDE) + 0.5) / SIDE, (np.arange(SIDE)[:, None] + 0.5) / SIDE)
    generator = np.random.default_rng(3)
    dots = (generator.random(shape) < LIT).astype(float)
    points = generator.integers(cells // 2, SIDE - cells // 2, (POINTS, 2))

    def first(of: Tiling) -> FieldBlur:
        return blur_of(camera, shape, pitch_um, of, SEEN_NM, WEIGHT)

    def at(tiles: int) -> Tiling:
        return replace(tiling, spacing_um=SIDE / tiles * pitch_um, psf_um=cells * pitch_um)

    blur = first(tiling)
    print(f"at most {blur.lacking:.2%}")
    forget()
    timed("first picture, with its PSFs", lambda: first(tiling).blurred(dots))
    camera_lens._BLURS.clear()
    timed("picture with PSFs from the cache", lambda: first(tiling).blurred(chart))
    for tiles in (32, 64):
        blur = first(at(tiles))
        blur._last.clear()
        timed(f"picture of {tiles + 1}² tiles, PSFs from the cache", lambda blur=blur: blur.blurred(chart))
    exact_dots = superposed_at(dots, points, light_of(camera, SEEN_NM, WEIGHT, tiling), pitch_um, cells)
    exact_chart = blurred(first(at(FINEST)), chart)[tuple(points.T)]
    found = {}
    for tiles in (SIDE / spacing, *COMPARED):
        blur = first(tiling if tiles == SIDE / spacing else at(int(tiles)))
        errors = []
        for picture, exact in ((dots, exact_dots), (chart, exact_chart)):
            picture_blurred = blurred(blur, picture)
            inside = picture_blurred[cells:-cells, cells:-cells]
            errors.append(float(np.sqrt(np.mean((picture_blurred[tuple(points.T)] - exact) ** 2)) / inside.std()))
        found[tiles] = errors
        print(f"  {tiles:4.0f} tiles: error {errors[0]:.3%} of random dots, {errors[1]:.3%} of csf", flush=True)
    for which, picture_name in enumerate(("random dots", "csf")):
        order = np.log2(found[32][which] / found[64][which])
        print(f"  order from 33² to 65² tiles, {picture_name}: {order:.2f}")
    print(f"  memory of the process {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1 << 20):.2f} GiB")


def main() -> None:
    with tempfile.TemporaryDirectory() as folder, mock.patch.dict("os.environ", PIXSIM_CACHE_DIR=folder):
        for name in sys.argv[1:] or ["phone", "cooke_triplet"]:
            measure(name)


if __name__ == "__main__":
    main()
