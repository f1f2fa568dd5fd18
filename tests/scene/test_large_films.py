"""Films whose pictures are too large for memory, from the render to the score."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

GIB = 1 << 30
# Run words, and print the largest resident memory of that process, in KiB.
LARGEST_KIB = """import resource, subprocess, sys
done = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
sys.exit(done.returncode)
"""
PLANES, SIDE = 12, 3072  # pictures of pulses of `macbeth`


@pytest.mark.longest
@pytest.mark.slow
def test_a_general_scene_takes_a_few_planes_of_memory(tmp_path: Path) -> None:
    """Two halves of the renders in float64, a render and the image in float32 would take 2.5 GiB
    beside the program.

    At most two planes of float64, of 0.07 GiB each, are in memory, with the program, Mitsuba's
    kernels and a strip: 0.77 GiB.
    """
    options = [
        "--resolution",
        str(SIDE),
        "-D",
        "spp=1",
        "--render-noise",
        "10",
        "--irradiance",
        "none",
        "--quiet",
    ]
    log = (tmp_path / "log").open("wb")
    words = [
        sys.executable,
        "-m",
        "pixsim",
        "run",
        "macbeth",
        *options,
        "--out",
        str(tmp_path / "out"),
    ]
    # By a small process between: Linux counts the memory of the process that forks another to that
    # one.
    between = [sys.executable, "-c", LARGEST_KIB, *words]
    done = subprocess.run(between, stdout=subprocess.PIPE, stderr=log, text=True)
    assert done.returncode == 0, (tmp_path / "log").read_text(encoding="utf-8")
    whole = PLANES * SIDE**2 * (8 + 8 + 4 + 4)
    assert whole > 2.5 * GIB
    assert 0.5 * GIB < 1024 * int(done.stdout.split()[-1]) < 1.2 * GIB
