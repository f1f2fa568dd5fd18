"""Time of the kernels after the render, against targets and the unavoidable operations.

    python tests/benchmarks/kernels.py

Medians of wall times in one process. The unavoidable operations of an evaluation (one sensor at one
pitch) are its random numbers, transforms and cube roots, of the same sizes, in padded planes and in
place, in float32 as in a study.
"""

from __future__ import annotations

import itertools
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from itertools import cycle, product
from pathlib import Path
from statistics import median
from unittest import mock

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from benchmarks.timing import median_s, seconds_of
from helpers.chains import imaging

import pixsim
from pixsim import optics
from pixsim.base.arrays import STRIP_DOTS, dct, empty_planes, inverse_dct, stream, strips_of
from pixsim.base.files import FOLDER_VARIABLE
from pixsim.light.spectral import SpectralImage, d65
from pixsim.optics.camera import Camera
from pixsim.optics.lens_options import LensOptions
from pixsim.scene.charts import csf_value
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.integration import diffracted_rate
from pixsim.sensor.motion_options import Motion
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.readout import capture_from_rates, sample_sensor
from pixsim.viewer import scielab
from pixsim.viewer.chain import ImagingChain, make_chain
from pixsim.viewer.demosaic import demosaic
from pixsim.viewer.denoising.filters import denoised_plane
from pixsim.viewer.denoising.wiener import wiener_plane
from pixsim.viewer.display import WHITE_XYZ, frame_luminance
from pixsim.viewer.display_options import Display
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.scene_light import PreparedScene, SceneLight, prepare_scene
from pixsim.viewer.screen import display_image

Work = Callable[[], object]
NM = np.arange(400.0, 701.0, 10.0)
DIE_MM = 2.7136
CAMERA, DISPLAY, EXPOSURE = Camera(die_mm=DIE_MM), Display(), Exposure()
PITCHES_UM = (5.3, 6.5, 15.0)
MAX_TIMES_PARTS = 1.3


def chart(n: int) -> SpectralImage:
    """The CSF chart under D65 with a white of 1000 cd/m²."""
    at = (np.arange(n) + 0.5) / n
    picture = csf_value(at, at[:, None]).astype(np.float32)
    one = SpectralImage(NM, 10.0, 1.0, factors=(d65(NM), np.ones((1, 1, 1))))
    white_lx = 1000.0 * float(optics.irradiance_factor(CAMERA.f_number, 0.0, CAMERA.magnification))
    spectrum = d65(NM) * white_lx / one.illuminance_lx()[0, 0]
    header = {"luminance_cd_per_m2": 1000.0}
    return SpectralImage(
        NM, 10.0, 1e3 * DIE_MM / n, factors=(spectrum, picture[None]), header=header
    )


def bands(n: int) -> SpectralImage:
    data = np.random.default_rng(1).uniform(0, 1, (n, n, NM.size)).astype(np.float32)
    return SpectralImage(NM, 10.0, 1e3 * DIE_MM / n, data=data)


def row(name: str, target_s: float | None, work: Work, repeats: int = 11) -> None:
    seconds = median_s(work, repeats)
    met = "" if target_s is None else f"{target_s:7.3f} {'yes' if seconds <= target_s else 'NO':>4}"
    print(f"{name:48} {seconds:8.4f} {met}", flush=True)


def targets() -> None:
    print(f"{'kernel':48} {'s':>8} {'target':>7} {'met':>4}")
    view = {"white_xyz": WHITE_XYZ, "samples_per_deg": DISPLAY.samples_per_deg}
    for n, target_s in ((512, 0.06), (1024, 0.25)):
        pair = np.random.default_rng(n).uniform(1, 100, (2, n, n, 3))
        row(f"S-CIELAB of a pair, {n}²", target_s, partial(scielab.delta_e_map, *pair, **view))
    mosaic = np.random.default_rng(2).uniform(0, 1, (1024, 1024))
    for method, target in (("bilinear", 0.12), ("malvar2004", 0.25), ("menon2007", None)):
        row(f"demosaicing, {method}, 1024²", target, partial(demosaic, mosaic, "rggb", method))
    expected_e = 20 + 1000 * mosaic
    raw_e = expected_e + 3 * np.random.default_rng(3).standard_normal(mosaic.shape)
    row("denoising, wiener_bound, 1024²", 0.1, partial(wiener_plane, raw_e, expected_e, expected_e))
    for method, target in (("wavelet", 0.5), ("nlm", 4.0)):
        row(f"denoising, {method}, 1024²", target, partial(denoised_plane, raw_e, 9.0, method), 3)
    film, general = chart(1024), bands(1024)
    asked = imaging(CAMERA, Pixel(pitch_um=5.3), EXPOSURE, DISPLAY, in_float32=True)
    physics = asked.physics
    row(
        "diffraction, 31 bands of one spectrum, 1024²",
        0.15,
        partial(diffracted_rate, film, CAMERA, physics),
    )
    row(
        "diffraction, 31 bands, general, 1024²",
        3.0,
        partial(diffracted_rate, general, CAMERA, physics),
        3,
    )
    row(
        "diffraction, 31 bands, general, 512²",
        None,
        partial(diffracted_rate, bands(512), CAMERA, physics),
        3,
    )
    light = prepare_scene(asked, SceneLight(film))
    chain = make_chain(asked, light)
    shape, signal = chain.signal_e_per_s.shape, chain.signal_e_per_s
    frame = chain.simulate(0).frame
    white_e = chain.white_e_per_s * frame.integration_s

    def noise() -> None:
        capture_from_rates(
            signal, sample_sensor(asked.readout, shape, stream(1)), EXPOSURE, stream(2)
        )

    row("noise of a sensor and a frame, 512²", 0.03, noise)
    whole = np.kron(signal, np.ones((2, 2)))
    sensor = sample_sensor(asked.readout, whole.shape, stream(1))
    for frames in (1, 8):
        burst = EXPOSURE.model_copy(update={"frames": frames})
        row(
            f"frame of {frames} exposures, 1024²",
            None,
            partial(capture_from_rates, whole, sensor, burst, stream(2)),
        )
    show = partial(
        frame_luminance, frame, chain.screen.size_um, white_e, DISPLAY, chain.screen.dot_edges_um
    )
    row("display of a frame, 512² on 512 dots", None, show)

    def evaluation() -> None:
        make_chain(asked, light).simulate(1).statistics()

    row("sense, display, score of a 512² frame", 0.08, evaluation)


def unavoidable(chain: ImagingChain) -> dict[str, Work]:
    """Random numbers, transforms and cube roots of one evaluation."""
    p, rng = chain.readout, np.random.default_rng(0)
    mean_e, screen = chain.simulate(0).frame.mean_e, chain.screen
    dots, number = screen.ideal.shape[:2], np.float32 if screen.in_float32 else np.float64
    first, planes = (
        empty_planes(count, *dots, dtype=number)
        for count in (1 if screen.ideal.ndim == 2 else 3, 3)
    )
    first[...] = planes[...] = 0.5
    relative = np.full((3, *dots), 0.5, number)

    def roots() -> None:
        for rows, work in strips_of(relative.shape, number, STRIP_DOTS):
            for plane, out in zip(relative[:, rows], work, strict=True):
                (
                    scielab._single_f(plane, *scielab.CIE_LAB[:2], out)
                    if screen.in_float32
                    else np.cbrt(plane, out=out)
                )

    drawn = np.empty(mean_e.shape)
    normals = [spread for spread in (p.prnu, p.physics.offset_fpn_e, p.noise_floor_e) if spread]
    return {
        "normals": lambda: [rng.standard_normal(out=drawn) for _ in normals],
        "gamma": lambda: (
            rng.gamma(p.dark_spread.dsnu**-2, p.dark_spread.dsnu**2, mean_e.shape)
            if p.dark_spread.dsnu
            else None
        ),
        "Poisson": lambda: rng.poisson(mean_e),
        "DCTs": lambda: (dct(first), inverse_dct(planes)),
        "cube roots": roots,
    }


def stages(chain: ImagingChain) -> dict[str, Work]:
    """What an evaluation does, in its order: with the unavoidable operations, and with all else."""
    frame, display = chain.capture(1), chain.screen.display
    score, scratch = chain.development.score(frame), chain.development.light(frame)
    sensor = chain.sensor(1)
    return {
        "fixed pattern (normals, gamma)": lambda: chain.sensor(1),
        "frame (Poisson, normals)": lambda: chain.capture_by(
            sensor, stream(1, "frame"), partial(stream, 1, "correction")
        ),
        "light of the dots": lambda: chain.development.light(frame),
        "codes of the dots": lambda: display_image(
            scratch, display, in_place=True
        ),  # of any light: their time does not depend on it
        "S-CIELAB (DCTs, cube roots)": lambda: chain.screen.delta_e_map(score.image),
        "statistics": score.statistics,
    }


COLOUR = {"pattern": "rggb", "sensitivities": "Sony_ILCE-7M4", "peak_quantum_efficiency": 0.65}
LENSED = {
    "height_um": 3.0,
    "index": 1.5,
    "microlens": "square",
}  # not shifted: what is collected varies over the field
ROUNDS = 15


def parts() -> None:
    """Least times of processors in turns that alternate between the whole and its parts, and the
    median of the turns' ratios.

    Other programs disturb both alike in a turn, but a long piece of work less often not at all.
    """
    print(
        f"\nan evaluation, ms of processors: {'whole':>12} {'parts':>8} {'ratio':>6}  at most"
        f" {MAX_TIMES_PARTS:g}"
    )
    film = chart(1024)
    cases = {f"{pitch_um:g} µm": Pixel(pitch_um=pitch_um) for pitch_um in PITCHES_UM}
    cases |= {
        "5.3 µm, colour": Pixel(
            technology="4t-bsi", pitch_um=5.3, stack={"enabled": False}, colour=COLOUR
        ),
        "5.3 µm, stack": Pixel(technology="4t-fsi", pitch_um=5.3, stack=LENSED),
    }
    for name, pixel in cases.items():
        asked = imaging(
            CAMERA, pixel, EXPOSURE, DISPLAY, border_um=max(PITCHES_UM), in_float32=True
        )
        light = prepare_scene(asked, SceneLight(film))
        light.store_integrals()
        chain = make_chain(asked, light)
        works = {"whole": lambda chain=chain: chain.simulate(1).statistics()} | unavoidable(chain)
        times = turns(works)
        seconds = {name: min(each) for name, each in times.items()}
        whole, wholes = seconds.pop("whole"), times.pop("whole")
        ratio = median(each / sum(own) for each, *own in zip(wholes, *times.values(), strict=True))
        text = ", ".join(f"{name} {1e3 * time_s:.1f}" for name, time_s in seconds.items())
        sum_ = sum(seconds.values())
        print(f"{name:>17}: {1e3 * whole:12.1f} {1e3 * sum_:8.1f} {ratio:6.2f}  {text}", flush=True)
        print(
            f"{'':19}{', '.join(f'{stage} {1e3 * min(times):.1f}' for stage, times in turns(stages(chain)).items())}",
            flush=True,
        )


def turns(works: dict[str, Work]) -> dict[str, list[float]]:
    """Times of processors of `ROUNDS` turns of each, after a first one."""
    times: dict[str, list[float]] = {name: [] for name in works}
    for each in range(ROUNDS + 1):
        for name, work in works.items():
            start = time.process_time()
            work()
            if each:
                times[name].append(time.process_time() - start)
    return times


def lenses() -> None:
    """The light behind a lens whose blur varies over the field: once for all pitches and sensors,
    after its rays are traced.

    Of two pictures in turns, since a lens remembers the last one.
    """
    print(f"\nlight behind a lens, s: {'thin':>8} {'phone':>8} {'ratio':>6} {'traced':>8}")
    scene, physics = pixsim.load_scene("csf"), derive(Pixel())
    thin, phone = scene.camera(), scene.camera(lens=LensOptions(file="phone"))

    def behind(films: Iterator[SpectralImage], camera: Camera) -> None:
        diffracted_rate(next(films), camera, physics)

    for n in (1024, 2048):
        film = chart(n)
        spectra, pictures = film.factors
        mirrored = SpectralImage(
            NM, 10.0, film.pitch_um, factors=(spectra, pictures[:, ::-1].copy()), header=film.header
        )
        films = cycle([film, mirrored])
        first_s = seconds_of(partial(behind, films, phone))
        thin_s, phone_s = (median_s(partial(behind, films, camera), 4) for camera in (thin, phone))
        print(
            f"{n:20}²: {thin_s:10.3f} {phone_s:8.3f} {phone_s / thin_s:6.1f}"
            f" {first_s - phone_s:8.2f}",
            flush=True,
        )


ROLLING = Exposure(shutter="rolling", line_time_us=5.0)
VELOCITIES = {
    "still": ((0.0, 0.0), EXPOSURE),
    "across": ((800.0, 0.0), EXPOSURE),
    "down": ((0.0, 800.0), EXPOSURE),
    "slanted": ((800.0, 500.0), EXPOSURE),
    "across, rolling": ((800.0, 0.0), ROLLING),
}  # µm/s of the image: 1 to 6 pixels in an exposure


def motion() -> None:
    """Evaluations of light that moves against those of light that stands still: one frame, or some,
    of each integration time.
    """
    print(
        "\nframes of light that moves, times those of light that stands still: median of turns, and"
        " ms of processors"
    )
    film, numbers = chart(1024), itertools.count()
    for pitch_um, frames in product(PITCHES_UM, (1, 8)):
        still = imaging(
            CAMERA, Pixel(pitch_um=pitch_um), EXPOSURE, DISPLAY, in_float32=True, border_um=100.0
        )
        room = prepare_scene(still, SceneLight(film))
        room.store_integrals()

        def evaluation(
            velocity: tuple[float, float],
            exposure: Exposure,
            frames: int = frames,
            room: PreparedScene = room,
            still: Imaging = still,
        ) -> None:
            longer = 1 + 1e-6 * next(numbers)  # as of another time
            x, y = longer * velocity[0], longer * velocity[1]
            chain = make_chain(
                still.changed(exposure=exposure, motion=Motion(image_um_per_s=(x, y))), room
            )
            for frame in range(frames):
                chain.simulate(frame).statistics()

        times = turns({name: partial(evaluation, *own) for name, own in VELOCITIES.items()})
        ratios = {
            name: median(a / b for a, b in zip(each, times["still"], strict=True))
            for name, each in times.items()
        }
        text = ", ".join(
            f"{name} {ratio:.2f} ({1e3 * min(times[name]):.1f})" for name, ratio in ratios.items()
        )
        print(f"{frames:8} frames of {pitch_um:g} µm: {text}", flush=True)


MAX_COLOUR_RATIO = 2.5  # of the time of an evaluation with colour filters to that of one without


def colour() -> None:
    """An evaluation of 1024² pixels with a Bayer mosaic, bilinear demosaicing, and without."""
    print(
        f"\n1024² pixels, s: {'grey':>8} {'colour':>8} {'ratio':>6}  at most {MAX_COLOUR_RATIO:g}"
    )
    film, sheet = (
        chart(1024),
        {"technology": "4t-bsi", "pitch_um": CAMERA.die_um[1] / 1024, "stack": {"enabled": False}},
    )
    for dots in (512, 1024):
        display = DISPLAY.model_copy(update={"dots": dots})
        seconds = []
        for pixel in (Pixel(**sheet), Pixel(**sheet, colour=COLOUR)):
            asked = imaging(CAMERA, pixel, EXPOSURE, display, in_float32=True)
            light = prepare_scene(asked, SceneLight(film))
            light.store_integrals()
            make_chain(asked, light).simulate(0)  # the matrix is fitted once a light

            def evaluation(light: PreparedScene = light, asked: Imaging = asked) -> None:
                make_chain(asked, light).simulate(1).statistics()

            seconds.append(median_s(evaluation, 7))
        print(
            f"{dots:10} dots: {seconds[0]:8.3f} {seconds[1]:8.3f} {seconds[1] / seconds[0]:6.2f}",
            flush=True,
        )


if __name__ == "__main__":
    targets()
    parts()
    colour()
    motion()
    with (
        tempfile.TemporaryDirectory() as folder,
        mock.patch.dict(os.environ, {FOLDER_VARIABLE: folder}),
    ):  # no PSFs of a run before
        lenses()
