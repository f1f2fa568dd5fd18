"""Speed of the pruned render relative to plain Mitsuba at equal error, in one run on one machine.

    python tests/benchmarks/render_speed.py [SCENE ...] [--resolution 512]
    python tests/benchmarks/render_speed.py [SCENE ...] --variant cuda_ad_spectral llvm_ad_spectral scalar_spectral

The error is the RMS of the QE-weighted irradiance (0.35 µm pixel) over its mean, from pairs of
independent renders; the plan's bound on the systematic error of pruning is printed too. Plain
Mitsuba renders the scene's XML with `path`, a specfilm of 31 bands of 10 nm, a box filter, and
`independent` or `multijitter`. Times are medians of the render alone, after a warm-up. If the
largest number of samples misses the target, the time is extrapolated, as the table states. Memory
is the peak of a new process.

A ratio is that of the time of a path times its variance, so both stand below it, from the last rung
of each ladder. A path has four wavelengths in Mitsuba, so that pixsim's passes trace as many paths
for each sample.

With `--variant`, the variants render the scenes in turns, with equal samples: medians of the clock,
and the ratio to the first. Then they take turns with a study of the ColorChecker, from an empty
cache: the seconds of its render and of its evaluations.
"""

from __future__ import annotations

import argparse
import math
import os
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest import mock

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from benchmarks.timing import fresh

import pixsim
from pixsim.base.files import FOLDER_VARIABLE
from pixsim.base.progress import stages
from pixsim.light.spectral import photons_per_joule
from pixsim.scene.mitsuba import mitsuba_session
from pixsim.scene.plan import Plan
from pixsim.scene.renderer import Renderer
from pixsim.scene.scene import Scene, sensor_node
from pixsim.sensor.integration import ideal_rate
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel

TARGETS = {
    "csf": (1e-3, 100.0, 3.0),
    "macbeth": (1e-3, 50.0, 2.0),
    "still_life": (5e-2, 1.5, 1.0),
}  # error, target ratios
BANDS_NM = np.arange(400.0, 701.0, 10.0)
PHYSICS = derive(Pixel())
LADDER = tuple(4**k for k in range(1, 7))
SECONDS_A_RUNG = 20.0
RANDOM, STEEPEST = -0.5, -1.0  # exponents of error against time that an extrapolation may take
Picture = Callable[
    [int, int], tuple[np.ndarray, float]
]  # (samples, seed) -> QE-weighted irradiance, seconds


def plain_mitsuba(
    scene: Scene, resolution: int, sampler: str, bands_nm: np.ndarray
) -> Callable[[int, int], np.ndarray]:
    """Render of (samples, seed): radiance in bands of equal width, (H, W, B), of a square film."""
    film = {"type": "specfilm", "component_format": "float32", "rfilter": {"type": "box"}}
    film |= {"width": resolution, "height": resolution}
    half_nm = float(bands_nm[1] - bands_nm[0]) / 2
    for k, nm in enumerate(bands_nm.tolist()):
        film[f"band{k}"] = {
            "type": "regular",
            "wavelength_min": nm - half_nm,
            "wavelength_max": nm + half_nm,
            "values": "1, 1",
        }
    with mitsuba_session(scene.choice.variant) as mi:
        loaded = mi.load_file(str(scene.path), **scene.parameters)
        sensor = sensor_node(scene.parse(), None)[1]
        names = ("type", "fov", "aperture_radius", "focus_distance", "to_world")
        lens = {key: sensor[key] for key in names if key in sensor}
        lens["to_world"] = mi.ScalarTransform4f(lens["to_world"])

    def picture(spp: int, seed: int) -> np.ndarray:
        with mitsuba_session(scene.choice.variant) as mi:
            camera = mi.load_dict(
                {
                    "type": "thinlens",
                    **lens,
                    "film": film,
                    "sampler": {"type": sampler, "sample_count": spp},
                }
            )
            path = mi.load_dict({"type": "path"})
            return np.asarray(
                mi.render(loaded, sensor=camera, integrator=path, spp=spp, seed=seed), float
            )

    return picture


def plain(name: str, resolution: int, sampler: str) -> Picture:
    """Plain Mitsuba render of the XML in 31 bands."""
    weight = PHYSICS.quantum_efficiency(BANDS_NM) * photons_per_joule(BANDS_NM)
    bands_of = plain_mitsuba(
        pixsim.load_scene(name, resolution=resolution), resolution, sampler, BANDS_NM
    )

    def picture(spp: int, seed: int) -> tuple[np.ndarray, float]:
        start = time.perf_counter()
        rate = (bands_of(spp, seed) * weight).sum(axis=2)
        return rate, time.perf_counter() - start

    return picture


def pruned(name: str, resolution: int, variant: str | None = None) -> tuple[Picture, Plan]:
    """pixsim's planned render, with other numbers of samples."""
    scene = pixsim.load_scene(name, variant=variant, resolution=resolution)
    camera = scene.camera()
    plan = pixsim.make_plan(scene, camera)
    jobs: dict[int, Renderer] = {}

    def picture(spp: int, seed: int) -> tuple[np.ndarray, float]:
        job = jobs.setdefault(
            spp, Renderer(scene, camera, replace(plan, samples=replace(plan.samples, spp=spp)), 0)
        )
        start = time.perf_counter()
        rate = ideal_rate(job.image(*job.run(seed)), PHYSICS)
        return rate, time.perf_counter() - start

    return picture, plan


def rungs(picture: Picture) -> Iterator[tuple[int, float, float]]:
    """(samples, seconds, RMS error) for increasing samples, until a rung takes too long."""
    for spp in LADDER:
        picture(spp, 9)  # compile
        pairs = [[picture(spp, 2 * k), picture(spp, 2 * k + 1)] for k in range(2)]
        seconds = statistics.median(render_[1] for pair in pairs for render_ in pair)
        error = statistics.fmean(
            float(np.sqrt(np.mean((a - b) ** 2) / 2) / a.mean()) for (a, _), (b, _) in pairs
        )
        yield spp, seconds, error
        if seconds * (4 + 1) > SECONDS_A_RUNG:
            return


def of_a_path(
    ladder: list[tuple[int, float, float]], resolution: int, passes: int
) -> tuple[float, float]:
    """Microseconds of a path, and the variance of a film cell over its square for one path."""
    spp, seconds, error = ladder[-1]
    return 1e6 * seconds / (spp * passes * resolution**2), error**2 * spp * passes


def seconds_to(target: float, ladder: list[tuple[int, float, float]]) -> tuple[float, str]:
    """Seconds to reach the error, by log-log inter- or extrapolation, and a description of the
    method.
    """
    t, e = (np.log([rung[k] for rung in ladder]) for k in (1, 2))
    goal = math.log(target)
    if e[0] <= goal:
        return float(np.exp(t[0])), f"at the first rung, {ladder[0][0]} samples"
    for k in range(1, len(ladder)):
        if e[k] <= goal:
            return (
                float(np.exp(t[k - 1] + (t[k] - t[k - 1]) * (goal - e[k - 1]) / (e[k] - e[k - 1]))),
                "measured",
            )
    slope = float(np.clip((e[-1] - e[-2]) / (t[-1] - t[-2]), STEEPEST, RANDOM))
    return (
        float(np.exp(t[-1] + (goal - e[-1]) / slope)),
        f"extrapolated from {np.exp(e[-1]):.2%} with error ∝ time^{slope:.2f}",
    )


def render(name: str, resolution: int, spp: int) -> None:
    pixsim.render(pixsim.load_scene(name, resolution=resolution, spp=spp))


VARIANT_SPP, VARIANT_TURNS = 64, 5
STUDY: dict[str, object] = {  # charts take no rays in a study
    "name": "variants", "scene": {"file": "macbeth"}, "resolution": 512, "repeats": 8, "render_noise": 1.0,
    "pitch": {"values_um": [5.3, 6.0, 7.0, 8.5, 11.0, 15.0]}, "display": {"dots": 256},
}  # fmt: skip
STUDY_TURNS = 3


def compare_variants(name: str, resolution: int, variants: list[str]) -> None:
    """Print the time of a render by each variant, and how its mean differs from that of the
    first.
    """
    pictures, first_s = {}, {}
    for variant in variants:
        pictures[variant] = pruned(name, resolution, variant)[0]
        first_s[variant] = pictures[variant](VARIANT_SPP, 0)[1]
    runs = {variant: [] for variant in variants}
    for turn in range(1, VARIANT_TURNS + 1):
        for variant, picture in pictures.items():
            runs[variant].append(picture(VARIANT_SPP, turn))
    print(f"{name}, {resolution}², {VARIANT_SPP} samples")
    means = {
        variant: statistics.fmean(float(rate.mean()) for rate, _ in pairs)
        for variant, pairs in runs.items()
    }
    medians = {
        variant: statistics.median(seconds for _, seconds in pairs)
        for variant, pairs in runs.items()
    }
    for variant in variants:
        ratio, difference = (
            medians[variant] / medians[variants[0]],
            means[variant] / means[variants[0]] - 1,
        )
        print(
            f"  {variant:18} {medians[variant]:8.3f} s (first {first_s[variant]:.2f} s), times"
            f" {ratio:.2f}; mean {difference:+.2%}"
        )


def compare_studies(variants: list[str]) -> None:
    """Print the time of a study with each variant, of its render and of its evaluations."""
    study, runs = pixsim.Study.model_validate(STUDY), {variant: [] for variant in variants}
    for _ in range(STUDY_TURNS):
        for variant, own in runs.items():
            seconds: dict[str, float] = {}
            with TemporaryDirectory() as folder, ExitStack() as stack:
                stack.enter_context(
                    mock.patch.dict(os.environ, {FOLDER_VARIABLE: f"{folder}/cache"})
                )
                stage = stack.enter_context(stages(seconds, quiet=True))
                result = pixsim.study(
                    study, f"{folder}/out", variant=variant, jobs=1, progress=stage
                )
                stage("end")  # of the last stage's time
            own.append(
                (seconds["render"], seconds["evaluate"], float(result.curves[0].delta_e.mean()))
            )
    print(
        f"study of macbeth, {STUDY['resolution']}², {STUDY['repeats']} sensors at each of 6 sizes"
    )
    first = statistics.median(
        render_s + evaluate_s for render_s, evaluate_s, _ in runs[variants[0]]
    )
    for variant, own in runs.items():
        render_s, evaluate_s, delta_e = (
            statistics.median(values) for values in zip(*own, strict=True)
        )
        ratio = statistics.median(one + other for one, other, _ in own) / first
        print(
            f"  {variant:18} render {render_s:.2f} s, evaluations {evaluate_s:.2f} s, times"
            f" {ratio:.2f}; mean ΔE {delta_e:.4f}"
        )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("scenes", nargs="*", default=list(TARGETS))
    parser.add_argument("--resolution", type=int, default=512)
    parser.add_argument("--variant", nargs="+", metavar="NAME", dest="variants")
    options = parser.parse_args()
    for name in options.scenes or TARGETS:
        if options.variants:
            compare_variants(name, options.resolution, options.variants)
            continue
        target, asked_independent, asked_multijitter = TARGETS.get(name, TARGETS["still_life"])
        picture, plan = pruned(name, options.resolution)
        ladders = {"pruned": list(rungs(picture))}
        ladders |= {
            sampler: list(rungs(plain(name, options.resolution, sampler)))
            for sampler in ("independent", "multijitter")
        }
        print(f"{name}, {options.resolution}², target {target:.1%} RMS; {plan}")
        reached = {}
        for side, ladder in ladders.items():
            seconds, how = seconds_to(target, ladder)
            reached[side] = seconds
            steps = "  ".join(f"{spp}: {s:.2f} s {error:.2%}" for spp, s, error in ladder)
            print(f"  {side:12} {seconds:10.2f} s  {how:60} {steps}")
        for side, ladder in ladders.items():
            path_us, variance = of_a_path(
                ladder, options.resolution, plan.light.passes if side == "pruned" else 1
            )
            print(f"  {side:12} {path_us:.3f} µs a path, whose relative variance is {variance:.3g}")
        for sampler, asked in (
            ("independent", asked_independent),
            ("multijitter", asked_multijitter),
        ):
            ratio = reached[sampler] / reached["pruned"]
            print(
                f"  {ratio:8.1f} times faster than plain {sampler} (target {asked:g}):"
                f" {'yes' if ratio >= asked else 'NO'}"
            )
        few, many = (fresh(render, name, options.resolution, spp)[1] for spp in (4, 256))
        print(f"  memory of a process: {few:.2f} GiB with 4 samples, {many:.2f} GiB with 256")
    if options.variants:
        compare_studies(options.variants)


if __name__ == "__main__":
    main()
