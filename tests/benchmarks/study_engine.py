"""Overhead of a study: 10 000 evaluations of a small study on 1 and 2 processes, from an empty folder.

    python tests/benchmarks/study_engine.py [--repeats 2000] [--scheduler tcp://host:8786]

The work is `ImagingChain.simulate(...).statistics()` in a loop in this process. The overhead is the study's additional time per
evaluation: keys, tasks, workers, frames and rows, and the start of the processes.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
from helpers.timing import seconds_of

import pixsim
from pixsim.studies.lights import render_for
from pixsim.studies.preparation import prepare
from pixsim.studies.series import series_of
from pixsim.viewer.score import SceneCache

PITCHES_UM = (5.3, 6.0, 7.0, 8.5, 11.0)
TIMED = 100  # evaluations of each pitch, to time the work
TARGET_MS = 2.0


def small_study(repeats: int, dots: int = 96) -> pixsim.Study:
    """Study of as many film cells as dots, and of a die that grows with them."""
    table = {"scene": {"file": "csf", "parameters": {"resolution": dots, "spp": 4}}, "camera": {"die_mm": 0.5 * dots / 96}}
    table |= {"name": "small", "repeats": repeats, "pitch": {"values_um": PITCHES_UM}, "display": {"dots": dots}}
    return pixsim.Study.model_validate(table)


def work_s(study: pixsim.Study) -> float:
    """Seconds of one evaluation, mean over the pitches."""
    lit = render_for(prepare(study).cases[0])
    (series,) = series_of(study, SceneCache(lit.image, lit.camera, study.display))
    light = series.light()

    def evaluations() -> None:
        for pitch_um in PITCHES_UM:
            chain = series.imaging.at(pitch_um).chain(light)
            for repeat in range(TIMED):
                chain.simulate(*series.stream_at(pitch_um), repeat).statistics()

    return seconds_of(evaluations) / (TIMED * len(PITCHES_UM))


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--repeats", type=int, default=2000)
    parser.add_argument("--scheduler")
    options = parser.parse_args()
    study = small_study(options.repeats)
    count = options.repeats * len(PITCHES_UM)
    work_ms = 1e3 * work_s(study)
    print(f"{count} evaluations of {work_ms:.2f} ms; target overhead: {TARGET_MS:g} ms each")
    ways: list[tuple[str, dict[str, object], int]] = [("1 process", {"jobs": 1}, 1), ("2 processes", {"jobs": 2}, 2)]
    if options.scheduler:
        ways.append(("cluster", {"scheduler": options.scheduler}, 2))
    for cache in ("frames stored", "frames cached", "cache off"):
        for name, how, processes in ways:
            with tempfile.TemporaryDirectory() as folder:
                os.environ["PIXSIM_CACHE_GIB"] = "0" if cache == "cache off" else "4"
                os.environ["PIXSIM_CACHE_DIR"] = str(Path(folder) / "cache")
                if cache == "frames cached":
                    pixsim.study(study, Path(folder) / "before", **how)
                taken_ms = 1e3 * seconds_of(partial(pixsim.study, study, Path(folder) / "out", **how))
            each_ms = taken_ms / count
            beyond_ms = each_ms - work_ms / processes
            print(f"{name:12} {cache:13} {taken_ms / 1e3:6.1f} s, {each_ms:5.2f} ms each, overhead {beyond_ms:5.2f} ms")


if __name__ == "__main__":
    main()
