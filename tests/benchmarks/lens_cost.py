"""Time and error of a real lens's blur: python tests/benchmarks/lens_cost.py [LENS ...]

For each lens on the default die, a film of 1024² and a pixel of 2 µm: seconds of all processor
cores together (which other programs on the machine raise) and by the clock, for the command
`pixsim lens`, for the trace, for the plan's choice, for a first picture and for one whose PSFs come
from the cache; the memory of the process; and the blurred picture against superposition at 64
points. Superposition takes the PSF of each lit point of random dots from its own pupil, within 97
cells and without tiles; light from further away counts as even. For the packaged chart csf, lit
everywhere, the picture of 129 × 129 tiles stands for it. Errors are relative to the rms of the
blurred picture about its mean. The part of the tiles alone is the difference from 129 × 129 tiles
with PSFs of the same size.
"""

from __future__ import annotations

import math
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any
from unittest import mock

import numpy as np

from pixsim.base.arrays import Array
from pixsim.light.spectral import photons_per_joule
from pixsim.optics import camera_lens
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.camera_lens import Tiling, camera_blur, channel_wavefronts, choose_tiling
from pixsim.optics.field_blur import ChannelWavefronts, FieldBlur, periodic_psf
from pixsim.optics.lens import load_lens
from pixsim.optics.lens_options import LensOptions
from pixsim.scene.charts import csf_value
from pixsim.scene.real_lens import SEEN_NM
from pixsim.scene.scene import load_scene
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel

SIDE, POINTS, LIT, TOLERANCE = 1024, 64, 1 / 250, 0.01
COMPARED, FINEST = (16, 32, 64), 128  # tiles across
NEAR, WINDOW = (
    48,
    240,
)  # cells: how far from a point its light comes from, and in which a PSF repeats
PIXEL = derive(Pixel(pitch_um=6.5, technology="0.35um"))
APERTURE_UM = 2.0
WEIGHT = photons_per_joule(SEEN_NM) * PIXEL.quantum_efficiency(SEEN_NM)


def timed(name: str, work: Callable[[], Any]) -> Any:
    clock, cores = time.perf_counter(), used_s()
    result = work()
    print(
        f"  {name:46} {used_s() - cores:6.2f} s of cores, {time.perf_counter() - clock:6.2f} s by"
        " the clock",
        flush=True,
    )
    return result


def used_s() -> float:
    """Seconds of all processor cores that this process and those that it started have taken."""
    return sum(os.times()[:4])


def page(name: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(
            [sys.executable, "-m", "pixsim", "lens", name, "--out", f"{folder}/lens"],
            check=True,
            capture_output=True,
        )


def forget() -> None:
    camera_lens._BLURS.clear()
    camera_lens._PSFS.clear()


def seen_by_pixels(picture: Array, pitch_um: float) -> Array:
    """The picture as square pixels average it, for which the plan's bound is."""
    along, across = (
        np.fft.fftfreq(picture.shape[0], pitch_um),
        np.fft.rfftfreq(picture.shape[1], pitch_um),
    )
    averaged = np.sinc(along * APERTURE_UM)[:, None] * np.sinc(across * APERTURE_UM)
    return np.fft.irfft2(np.fft.rfft2(picture) * averaged, picture.shape)


def superposed_at(
    picture: Array, points: Array, light: ChannelWavefronts, pitch_um: float
) -> Array:
    """The blurred picture at cells (n, 2) as pixels see it, each lit cell with its own PSF."""

    def psf_of(source: Array) -> Array:
        y_um, x_um = (source - (SIDE - 1) / 2) * pitch_um
        return seen_by_pixels(periodic_psf(light, x_um, y_um, pitch_um, WINDOW), pitch_um)

    values = []
    for point in points:
        near = (
            slice(point[0] - NEAR, point[0] + NEAR + 1),
            slice(point[1] - NEAR, point[1] + NEAR + 1),
        )
        lit = np.argwhere(picture[near]) + point - NEAR
        here = np.roll(psf_of(point), (NEAR, NEAR), axis=(0, 1))[
            : 2 * NEAR + 1, : 2 * NEAR + 1
        ].sum()
        from_lit = sum(
            picture[tuple(source)] * float(psf_of(source)[tuple(point - source)]) for source in lit
        )
        values.append(from_lit + picture.mean() * (1 - here))
    return np.array(values)


def blurred(blur: FieldBlur, picture: Array) -> Array:
    """The picture with the light of each point spread by its PSF, and what it lacks as a veil."""
    blur._last.clear()
    return np.asarray(blur.blurred(picture) * blur.flat_field)


def setting(name: str) -> tuple[Camera, float]:
    camera = load_scene("csf", resolution=SIDE).camera(CameraOptions(), LensOptions(file=name))
    return camera, 1e3 * camera.die_mm / SIDE


def pictures() -> tuple[Array, Array, Array]:
    """Random dots, the chart csf, and points of both (n, 2) at which errors are found."""
    generator = np.random.default_rng(3)
    dots = (generator.random((SIDE, SIDE)) < LIT).astype(float)
    chart = csf_value((np.arange(SIDE) + 0.5) / SIDE, (np.arange(SIDE)[:, None] + 0.5) / SIDE)
    return dots, chart, generator.integers(NEAR, SIDE - NEAR, (POINTS, 2))


def relative(difference: Array, picture: Array) -> float:
    return float(np.sqrt(np.mean(np.square(difference))) / picture[NEAR:-NEAR, NEAR:-NEAR].std())


def measure_errors(camera: Camera, pitch_um: float, tiling: Tiling, points: int = POINTS) -> None:
    """Print the errors, after one another: in all against superposition, and of the tiles alone."""
    dots, chart, places = pictures()
    places = places[:points]
    cells = tiling.cells(pitch_um)[1]

    def at(tiles: float) -> FieldBlur:
        wanted = replace(tiling, spacing_um=SIDE / tiles * pitch_um, psf_um=cells * pitch_um)
        return camera_blur(camera, (SIDE, SIDE), pitch_um, wanted, SEEN_NM, WEIGHT)

    exact = superposed_at(
        dots, places, channel_wavefronts(camera, SEEN_NM, WEIGHT, tiling), pitch_um
    )

    def seen(tiles: float) -> list[Array]:
        return [seen_by_pixels(blurred(at(tiles), picture), pitch_um) for picture in (dots, chart)]

    finest = seen(FINEST)
    parts = {}
    for tiles in (SIDE / tiling.cells(pitch_um)[0], *COMPARED):
        found = seen(tiles)
        parts[tiles] = [
            relative((one - fine)[NEAR:-NEAR, NEAR:-NEAR], fine)
            for one, fine in zip(found, finest, strict=True)
        ]
        total = relative(found[0][tuple(places.T)] - exact, found[0])
        print(
            f"  {tiles:4.0f} tiles: error of random dots {total:.3%} in all; of the tiles alone "
            f"{parts[tiles][0]:.4%} of random dots, {parts[tiles][1]:.4%} of csf",
            flush=True,
        )
    orders = [math.log2(coarse / fine) for coarse, fine in zip(parts[32], parts[64], strict=True)]
    print(f"  order from 33² to 65² tiles: {orders[0]:.2f} of random dots, {orders[1]:.2f} of csf")


def measure(name: str) -> None:
    (camera, pitch_um), shape = setting(name), (SIDE, SIDE)
    print(
        f"{name} at f/{camera.f_number:.3g} on {camera.die_mm:g} mm, film of {SIDE}² cells of"
        f" {pitch_um:.3g} µm"
    )
    timed(f"pixsim lens {name}, a new process", lambda: page(name))
    lens = load_lens(name)
    x, y = np.meshgrid(np.linspace(-1, 1, 64), np.linspace(-1, 1, 64))
    fields, nm = (
        np.linspace(0, lens.max_field_deg, 17)[:, None, None, None],
        np.linspace(430, 680, 8)[:, None, None],
    )
    timed(
        "OPD of 17 fields × 8 wavelengths on 64² pupils", lambda: lens.opd_waves(fields, nm, x, y)
    )
    seen = tuple(SEEN_NM.tolist()), tuple(WEIGHT.tolist())
    tiling: Tiling = timed(
        "choice of tiles",
        lambda: choose_tiling(camera, shape, pitch_um, *seen, APERTURE_UM, TOLERANCE),
    )
    spacing, cells = tiling.cells(pitch_um)
    print(
        f"  {SIDE / spacing:.0f} tiles across, PSFs of {cells} cells, {tiling.wavelengths}"
        f" wavelengths, {tiling.nodes} wavefronts"
    )
    print(
        f"  bound {tiling.error:.2%}, {tiling.worst:.2%} at the worst place; lacking in a PSF",
        end=" ",
    )
    forget()
    dots, chart, _ = pictures()

    def first(of: Tiling) -> FieldBlur:
        return camera_blur(camera, shape, pitch_um, of, SEEN_NM, WEIGHT)

    def at(tiles: int) -> Tiling:
        return replace(tiling, spacing_um=SIDE / tiles * pitch_um, psf_um=cells * pitch_um)

    blur = first(tiling)
    print(f"at most {blur.tail_share:.2%}")
    forget()
    timed("first picture, with its PSFs", lambda: first(tiling).blurred(dots))
    camera_lens._BLURS.clear()
    timed("picture with PSFs from the cache", lambda: first(tiling).blurred(chart))
    for tiles in (32, 64):
        blur = first(at(tiles))
        blur._last.clear()
        timed(
            f"picture of {tiles + 1}² tiles, PSFs from the cache",
            lambda blur=blur: blur.blurred(chart),
        )
    measure_errors(camera, pitch_um, tiling)
    print(
        "  memory of the process"
        f" {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1 << 20):.2f} GiB"
    )


def main() -> None:
    with (
        tempfile.TemporaryDirectory() as folder,
        mock.patch.dict("os.environ", PIXSIM_CACHE_DIR=folder),
    ):
        for name in sys.argv[1:] or ["phone", "cooke_triplet"]:
            measure(name)


if __name__ == "__main__":
    main()
