"""The same job by pixsim and by what one would take in its place, side by side in one run.

    OMP_NUM_THREADS=1 python tests/benchmarks/versus.py [JOB ...] [--install FOLDER | --peers-python FILE] [--turns 7]

Others are plain Mitsuba, NumPy and SciPy (`plain.py`), and packages of the index (`peers.py`), which live in an environment of
their own: `--install` makes one in a folder (1.3 GB), `--peers-python` takes one that is there. Before anything is timed, each
result is compared with pixsim's within the bound of its row; what does not agree is not timed. Then all take turns, in an order
that rotates. A ratio is that of the processor times of one turn, so that other programs on the machine disturb it little; the
table has the median and the quartiles of the turns, and of a render also the ratio of the noise. ISETCam needs MATLAB or Octave,
and pyisetcam is not in the index: their seconds are of an earlier day, on a machine with 2 cores of 2.5 GHz.

Every picture is computed anew: pixsim's cache is an empty folder, in which turns find the spectra of plugins only. JOB is a part
of a job's name. All of it takes a quarter of an hour.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from benchmarks.kernels import CAMERA, DIE_MM, DISPLAY, EXPOSURE, bands, chart
from benchmarks.plain import (
    plain_bilinear,
    plain_delta_e,
    plain_frame,
    plain_ideal,
    plain_mitsuba,
    plain_optics,
    plain_pixels,
    plain_score,
)

import pixsim
from pixsim import optics
from pixsim.base.arrays import stream
from pixsim.base.files import FOLDER_VARIABLE
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.optics.camera_light import camera_factor
from pixsim.scene.convergence import render_until
from pixsim.scene.plan import make_plan
from pixsim.scene.renderer import Renderer
from pixsim.sensor.integration import M2_PER_UM2, diffracted_rate, electrons_per_joule, ideal_rate
from pixsim.sensor.pixel import PixelPhysics, derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.readout import capture_from_rates, integration_time_s, sample_sensor
from pixsim.viewer import scielab
from pixsim.viewer.demosaic import demosaic
from pixsim.viewer.display import WHITE_XYZ, white_rate
from pixsim.viewer.display_options import Display
from pixsim.viewer.score import chain_at_pitch, prepare_scene

PACKAGES = ("colour-science==0.4.7", "colour-demosaicing==0.2.7", "prysm==0.21.1", "poppy==1.1.2", "optiland==0.6.3")
NUMPY, MITSUBA = "NumPy and SciPy", "Mitsuba, NumPy and SciPy"
BANDS_NM = np.arange(365.0, 826.0, 10.0)  # of the plain render: all wavelengths of Mitsuba, with no band beyond their end
SPP, SEEDS = 16, 4
PITCHES_UM = (5.3, 6.5, 8.0, 10.0, 12.0, 15.0)
EDGE = 8  # pixels, which packages continue otherwise beyond the border
LEAST_TURNS, SECONDS_A_JOB = 3, 60.0
NOT_MEASURED, CANNOT = ("not measured",) * 2, ("cannot",) * 2
EARLIER_SIDE = 512  # of the jobs of an earlier day
Work = Callable[[], Any]
Compare = Callable[[Any, Any], float]


@dataclass(frozen=True)
class Other:
    """Who else does a job.

    work : what it does; a text is the job of `peers.py` of that name
    bound : of `compare`, of its result and pixsim's
    """

    who: str
    work: Work | str
    compare: Compare
    bound: float


@dataclass(frozen=True)
class Job:
    """What is done, and by whom.

    agreement : what `bound` of the others is of
    inputs : arrays for packages
    earlier : seconds of ISETCam and pyisetcam of an earlier day, as texts
    """

    name: str
    ours: Work
    others: tuple[Other, ...]
    agreement: str
    inputs: dict[str, Any] = field(default_factory=dict)
    earlier: tuple[str, str] = NOT_MEASURED


def relative(ours: Any, theirs: Any) -> float:
    """Largest difference, of the largest value."""
    return float(np.abs(np.asarray(theirs) - ours).max() / np.abs(ours).max())


def absolute(ours: Any, theirs: Any) -> float:
    return float(np.abs(np.asarray(theirs) - ours).max())


def inside(ours: Any, theirs: Any) -> float:
    """Largest difference away from the border."""
    return absolute(ours[EDGE:-EDGE, EDGE:-EDGE], theirs[EDGE:-EDGE, EDGE:-EDGE])


def of_means(ours: Any, theirs: Any) -> float:
    """Difference of the means, relative."""
    return abs(float(np.mean(theirs) / np.mean(ours)) - 1)


def of_moments(ours: Any, theirs: Any) -> float:
    """Larger relative difference of the mean and of the standard deviation."""
    return max(of_means(ours, theirs), abs(float(np.std(theirs) / np.std(ours)) - 1))


def of_scores(ours: Any, theirs: Any) -> float:
    return max(abs(b / a - 1) for a, b in zip(np.atleast_1d(ours), np.atleast_1d(theirs), strict=True))


# --- after the render -------------------------------------------------------------------------------------------------


def numpy_jobs(side: int) -> Iterator[Job]:
    """Jobs after the render, on films, sensors and displays of `side` samples across."""
    display = DISPLAY.model_copy(update={"dots": side})
    physics = derive(Pixel(pitch_um=1e3 * DIE_MM / side * (1 - 1e-12)))
    general, film = bands(side), chart(2 * side)

    def other(work: Work, compare: Compare, bound: float) -> tuple[Other]:
        return (Other(NUMPY, work, compare, bound),)

    def earlier(isetcam: str, pyisetcam: str) -> tuple[str, str]:
        return (isetcam, pyisetcam) if side == EARLIER_SIDE else NOT_MEASURED

    yield Job(
        f"diffraction of {side}² × 31 bands",
        partial(diffracted_rate, general, CAMERA, physics),
        other(partial(plain_rate, general, CAMERA, physics), relative, 1e-6),
        "light of a sample, of the largest",
        earlier=earlier("6.5 s", "2.4 s"),
    )
    yield Job(
        f"the same of a chart under one lamp, {2 * side}²",
        partial(diffracted_rate, film, CAMERA, physics),
        other(partial(plain_rate, film, CAMERA, physics), relative, 1e-6),
        "light of a sample, of the largest",
    )
    mean_e = np.full((side, side), 0.3 * physics.full_well_e)
    seconds, shape = 0.03, (side, side)

    def frame() -> np.ndarray:
        exposure = EXPOSURE.model_copy(update={"integration_s": seconds})
        return capture_from_rates(mean_e / seconds, sample_sensor(physics, shape, stream(1)), exposure, stream(2)).dn

    yield Job(
        f"fixed pattern, noise and ADC of a frame of {side}²",
        frame,
        other(
            partial(plain_frame, mean_e, physics, seconds, np.random.default_rng(1)), of_moments, 5 / side
        ),  # five standard errors
        "mean and standard deviation of a frame",
        earlier=earlier("0.30 s", "0.09 s"),
    )
    for n, of_n in ((side, earlier("0.47 s", "0.56 s")), (2 * side, earlier("1.6 to 2.4 s", "2.1 s"))):
        pair = np.random.default_rng(n).uniform(1, 100, (2, n, n, 3))
        view = {"white_xyz": WHITE_XYZ, "samples_per_deg": display.samples_per_deg}
        yield Job(
            f"S-CIELAB of a pair of {n}²",
            partial(scielab.delta_e_map, *pair, **view),
            other(partial(plain_delta_e, *pair, display.samples_per_deg), absolute, 1e-9),
            "ΔE of a sample",
            earlier=of_n,
        )
    light = prepare_scene(film, CAMERA, physics, display, single=True)
    light.store_integrals()

    def evaluation() -> float:
        return chain_at_pitch(light, physics, EXPOSURE).simulate(1).mean_delta_e

    plain = PlainScores(film, CAMERA, physics, display)
    yield Job(
        f"pixels, frame, display and S-CIELAB, {side}²",
        evaluation,
        other(partial(plain, physics, plain.behind_the_lens(), plain.ideal()), of_scores, 0.02),
        "mean ΔE",
    )
    sweep = [derive(Pixel(pitch_um=pitch_um * 512 / side)) for pitch_um in PITCHES_UM]

    def study() -> list[float]:
        border_um = max(each.pitch_um for each in sweep)
        shared = prepare_scene(film, CAMERA, physics, display, single=True, border_um=border_um)
        shared.store_integrals()
        return [chain_at_pitch(shared, each, EXPOSURE).simulate(1).mean_delta_e for each in sweep]

    def plain_study() -> list[float]:
        one = PlainScores(film, CAMERA, physics, display, max(each.pitch_um for each in sweep))
        behind, ideal = one.behind_the_lens(), one.ideal()
        return [one(each, behind, ideal) for each in sweep]

    yield Job(f"six pixel sizes of a chart of {2 * side}²", study, other(plain_study, of_scores, 0.03), "mean ΔE of each")


def plain_weight(image: SpectralImage, physics: PixelPhysics) -> np.ndarray:
    """Electrons s⁻¹ µm⁻² of photodiode for each W m⁻² nm⁻¹ in a band."""
    return electrons_per_joule(physics, image) * M2_PER_UM2


def plain_rate(image: SpectralImage, camera: Camera, physics: PixelPhysics) -> np.ndarray:
    return plain_optics(image, camera, plain_weight(image, physics))


@dataclass(frozen=True)
class PlainScores:
    """Mean ΔE of one frame of a sensor, by NumPy and SciPy, from light on the sensor plane."""

    light: SpectralImage
    camera: Camera
    physics: PixelPhysics
    display: Display
    border_um: float = 0.0

    @property
    def white(self) -> float:
        return white_rate(self.light, self.camera, self.physics, self.display)

    def behind_the_lens(self) -> np.ndarray:
        return plain_rate(self.light, self.camera, self.physics)

    def ideal(self) -> np.ndarray:
        rate = self.light.weighted(plain_weight(self.light, self.physics))
        return plain_ideal(rate, self.light.pitch_um, self.white, self.display.dots)

    def __call__(self, physics: PixelPhysics, behind_the_lens: np.ndarray, ideal: np.ndarray) -> float:
        cell_um, generator = self.light.pitch_um, np.random.default_rng(1)
        signal = plain_pixels(behind_the_lens, cell_um, physics.pitch_um, physics.photodiode_side_um)
        seconds = integration_time_s(EXPOSURE, physics, float(signal.max()))
        white_e = self.white * physics.photodiode_side_um**2 * seconds
        border_um = self.border_um or physics.pitch_um
        return plain_score(
            signal * seconds, ideal, white_e, seconds, physics, len(behind_the_lens) * cell_um, self.display, border_um, generator
        )


# --- with the render --------------------------------------------------------------------------------------------------


def render_jobs(side: int, spp: int = SPP) -> Iterator[Job]:
    """The same XML, film and samples, and a picture of the chart from its XML to its mean ΔE."""
    for name, bound in (("csf", 2e-3), ("macbeth", 5e-3), ("still_life", 0.03)):
        across = side // 2 if name == "still_life" else side
        physics = derive(Pixel())
        others = tuple(
            Other(f"Mitsuba, `{sampler}`", Render(name, across, spp, physics, sampler).plain, of_means, bound)
            for sampler in ("multijitter", "independent")
        )
        ours = Render(name, across, spp, physics)
        yield Job(f"render of `{name}`, {across}², {spp} samples", ours, others, f"mean of {SEEDS} renders", earlier=CANNOT)
    chart_to_score = Picture(2 * side, spp, DISPLAY.model_copy(update={"dots": side}))
    yield Job(
        f"`csf` from its XML to the mean ΔE of a frame, film of {2 * side}², 47 bands",
        chart_to_score,
        (Other(MITSUBA, chart_to_score.plain, of_scores, 0.03),),
        "mean ΔE",
        earlier=CANNOT,
    )


class Render:
    """Renders of a scene with other seeds each time: electrons s⁻¹ µm⁻², (H, W)."""

    def __init__(self, name: str, side: int, spp: int, physics: PixelPhysics, sampler: str | None = None) -> None:
        self.scene = pixsim.load_scene(name, resolution=side)
        self.side, self.spp, self.physics, self.seed = side, spp, physics, 0
        self.camera = self.scene.camera()
        if sampler is None:
            self.job = Renderer(self.scene, self.camera, replace(make_plan(self.scene, self.camera), spp=spp), 0)
        else:
            self.bands = plain_mitsuba(self.scene, side, sampler, BANDS_NM)

    def __call__(self) -> np.ndarray:
        self.seed += 1
        return ideal_rate(self.job.image(*self.job.run(self.seed)), self.physics)

    def plain(self) -> np.ndarray:
        self.seed += 1
        return plain_irradiance(self.bands(self.spp, self.seed), self.camera).weighted(self.weight)

    @property
    def weight(self) -> np.ndarray:
        empty = SpectralImage(BANDS_NM, 10.0, 1.0, data=np.ones((1, 1, BANDS_NM.size), np.float32))
        return plain_weight(empty, self.physics)


def plain_irradiance(radiance: np.ndarray, camera: Camera) -> SpectralImage:
    """Light on the sensor plane from the radiance in bands of 10 nm, with the lens's solid angle."""
    pitch_um = 1e3 * camera.die_mm / radiance.shape[1]
    factor = camera_factor(camera, radiance.shape[:2], pitch_um) * camera.transmittance
    data = (radiance * factor[:, :, None] / 10.0).astype(np.float32)
    return SpectralImage(BANDS_NM, 10.0, pitch_um, data=data, header={"luminance_cd_per_m2": 1000.0})


class Picture:
    """The chart `csf` from its XML to the mean ΔE of one frame."""

    def __init__(self, side: int, spp: int, display: Display) -> None:
        self.side, self.spp, self.display = side, spp, display
        self.pixel = Pixel(pitch_um=6.5 * 512 / display.dots)

    def __call__(self) -> float:
        scene = pixsim.load_scene("csf", resolution=self.side)
        camera = scene.camera()
        plan = make_plan(scene, camera, self.pixel)
        image, _ = render_until(scene, camera, plan, [self.pixel], EXPOSURE)
        return pixsim.evaluate(image, camera, self.pixel, EXPOSURE, self.display).mean_delta_e

    def plain(self) -> float:
        scene = pixsim.load_scene("csf", resolution=self.side)
        camera = scene.camera()
        light = plain_irradiance(plain_mitsuba(scene, self.side, "multijitter", BANDS_NM)(self.spp, 1), camera)
        physics = derive(self.pixel)
        scores = PlainScores(light, camera, physics, self.display)
        return scores(physics, scores.behind_the_lens(), scores.ideal())


# --- parts that packages have -----------------------------------------------------------------------------------------


def package_jobs(side: int) -> Iterator[Job]:
    mosaic = np.random.default_rng(2).uniform(0, 1, (side, side))
    for method in ("bilinear", "malvar2004", "menon2007"):
        others = (Other("colour-demosaicing", method, inside, 1e-12),)
        if method == "bilinear":
            others += (Other(NUMPY, partial(plain_bilinear, mosaic), absolute, 1e-12),)
        ours = partial(demosaic, mosaic, "rggb", method)
        yield Job(f"demosaicing, {method}, {side}²", ours, others, f"a value, {EDGE} pixels off the border", {"mosaic": mosaic})
    one, two = np.random.default_rng(3).uniform(1, 100, (2, side, side, 3))

    def cielab() -> np.ndarray:
        return scielab.delta_e(scielab.xyz_to_lab(one, WHITE_XYZ), scielab.xyz_to_lab(two, WHITE_XYZ))

    yield Job(
        f"CIELAB and ΔE 1976 of a pair of {side}², unfiltered",
        cielab,
        (Other("colour-science", "CIELAB", absolute, 1e-9),),
        "ΔE of a sample",
        {"one": one, "other": two, "white_xyz": WHITE_XYZ},
    )
    nm, frequency = np.arange(400.0, 701.0, 10.0), np.linspace(0, 700, 512)

    def mtf() -> np.ndarray:
        return np.stack([optics.diffraction_otf(frequency, each, 4.0) for each in nm])

    yield Job(
        "MTF of a perfect lens at f/4, 31 wavelengths × 512 frequencies",
        mtf,
        (Other("prysm", "MTF, closed form", absolute, 1e-9), Other("poppy", "MTF, from the PSF", absolute, 0.02)),
        "contrast",
        {"frequency_cy_per_mm": frequency, "wavelength_nm": nm, "f_number": 4.0},
    )
    lens = pixsim.load_lens("cooke_triplet")
    y, x = (np.indices((64, 64)) - 31.5) / 32
    x, y = x[np.hypot(x, y) < 1], y[np.hypot(x, y) < 1]
    fields, waves = np.array([0.0, 14.0, 20.0]), np.array([480.0, 550.0, 650.0])
    radius_mm = lens.entrance_pupil_diameter_mm / 2

    def opd() -> np.ndarray:
        every = (part.ravel() for part in np.meshgrid(fields, waves, indexing="ij"))
        found = lens.unaimed_wavefront(*every, radius_mm * x, radius_mm * y).opd_waves
        return found.reshape(fields.size, waves.size, x.size)

    yield Job(
        f"OPD of a Cooke triplet, 3 fields × 3 wavelengths × {x.size} rays",
        opd,
        (Other("optiland", "OPD", absolute, 1e-6),),
        "waves",
        {"field_deg": fields, "wavelength_nm": waves, "x": x, "y": y},
        CANNOT,
    )


# --- measurement ------------------------------------------------------------------------------------------------------


class Peers:
    """The process of the other packages."""

    def __init__(self, python: str, folder: Path) -> None:
        self.folder = folder
        command = [python, str(Path(__file__).with_name("peers.py"))]
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL, text=True)

    def ask(self, **request: object) -> dict[str, Any]:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        try:
            self.process.stdin.write(json.dumps(request) + "\n")
            self.process.stdin.flush()
            return json.loads(self.process.stdout.readline() or '{"error": "its process ended"}')
        except BrokenPipeError:
            return {"error": "its process ended"}

    def ready(self, job: str, inputs: dict[str, Any]) -> str:
        """Return why it cannot, or nothing."""
        file = self.folder / "inputs.npz"
        np.savez(file, **inputs)
        return self.ask(job=job, inputs=str(file)).get("error", "")

    def result(self, job: str) -> np.ndarray | str:
        file = self.folder / "result.npy"
        reply = self.ask(job=job, run=str(file))
        return reply["error"] if "error" in reply else np.load(file)


@contextmanager
def peers(python: str | None) -> Iterator[Peers | None]:
    if python is None:
        yield None
        return
    with tempfile.TemporaryDirectory() as folder:
        one = Peers(python, Path(folder))
        try:
            yield one
        finally:
            one.process.kill()
            one.process.wait()


Times = tuple[float, float]  # of the clock and of all processor cores, s


def timed(work: Work) -> Times:
    clock, cores = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - clock, time.process_time() - cores


def timed_there(process: Peers, job: str) -> Times:
    """Times of a job that `difference` has made ready."""
    reply = process.ask(job=job, run="")
    return reply["s"], reply["cores_s"]


def difference(job: Job, other: Other, process: Peers | None) -> tuple[float | None, str]:
    """What `compare` finds of pixsim's and the other's result; and in words, or why there is none."""
    if isinstance(other.work, str):
        if process is None:
            return None, "not asked for"
        theirs = process.ready(other.work, job.inputs) or process.result(other.work)
        if isinstance(theirs, str):
            return None, theirs
        pair = job.ours(), theirs
    elif other.compare is of_means:
        pair = [job.ours() for _ in range(SEEDS)], [other.work() for _ in range(SEEDS)]
    else:
        pair = job.ours(), other.work()
    measured = other.compare(*pair)
    noise = f"; noise times {noise_of(pair[1]) / noise_of(pair[0]):.2g}" if other.compare is of_means else ""
    return measured, f"{measured:.1g} ({job.agreement}; at most {other.bound:g}){noise}"


def noise_of(renders: list[np.ndarray]) -> float:
    """RMS over the pixels of the standard deviation between renders."""
    return float(np.sqrt(np.var(renders, axis=0, ddof=1).mean()))


def turns(job: Job, others: list[Other], process: Peers | None, most: int) -> dict[str, list[Times]]:
    """Times of pixsim ("") and of each other, turn by turn, in an order that rotates."""
    works: dict[str, Callable[[], Times]] = {"": partial(timed, job.ours)}
    for other in others:
        if isinstance(other.work, str):
            assert process is not None
            works[other.who] = partial(timed_there, process, other.work)
        else:
            works[other.who] = partial(timed, other.work)
    times: dict[str, list[Times]] = {who: [] for who in works}
    start, names = time.perf_counter(), list(works)
    for turn in range(most):
        if turn >= LEAST_TURNS and time.perf_counter() - start > SECONDS_A_JOB:
            break
        for who in names[turn % len(names) :] + names[: turn % len(names)]:
            times[who].append(works[who]())
    return times


def ratio_of(theirs: list[Times], ours: list[Times]) -> str:
    """Median and quartiles of the ratios of processor times."""
    low, middle, high = np.percentile([a[1] / b[1] for a, b in zip(theirs, ours, strict=True)], [25, 50, 75])
    return f"{middle:.3g} ({low:.3g} to {high:.3g})"


def milliseconds_of(times: list[Times]) -> str:
    return f"{1e3 * float(np.median([cores for _, cores in times])):.3g}"


def compared(jobs: Iterator[Job], wanted: list[str], process: Peers | None, most: int) -> None:
    print("| job | pixsim, ms | by | times as long | differs by | ISETCam | pyisetcam |\n|---|---|---|---|---|---|---|", flush=True)
    for job in jobs:
        if wanted and not any(word in job.name for word in wanted):
            continue
        found = {other.who: difference(job, other, process) for other in job.others}
        agreeing = [other for other in job.others if (at := found[other.who][0]) is not None and at <= other.bound]
        times = turns(job, agreeing, process, most)
        own = (job.name, milliseconds_of(times[""]))
        for number, other in enumerate(job.others):
            ratio = ratio_of(times[other.who], times[""]) if other in agreeing else "not timed"
            cells = [*(("", "") if number else own), other.who, ratio, found[other.who][1], *(("", "") if number else job.earlier)]
            print("| " + " | ".join(cells) + " |", flush=True)


def install(folder: Path) -> str:
    """Make an environment for the other packages; returns its Python."""
    subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
    python = str(folder / "bin" / "python")
    subprocess.run([python, "-m", "pip", "install", "-q", *PACKAGES], check=True, stdout=sys.stderr)
    return python


def all_jobs(side: int) -> Iterator[Job]:
    yield from render_jobs(side // 2)
    yield from numpy_jobs(side)
    yield from package_jobs(2 * side)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("jobs", nargs="*", metavar="JOB")
    parser.add_argument("--turns", type=int, default=7)
    parser.add_argument("--side", type=int, default=512, help="samples across of films, sensors and displays")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--install", type=Path, metavar="FOLDER")
    where.add_argument("--peers-python", metavar="FILE")
    options = parser.parse_args()
    python = install(options.install) if options.install else options.peers_python
    with tempfile.TemporaryDirectory() as folder, peers(python) as process:
        os.environ[FOLDER_VARIABLE] = folder
        compared(all_jobs(options.side), options.jobs, process, options.turns)


if __name__ == "__main__":
    main()
