"""How right the time of `--dry-run` is, for commands of all kinds: estimates beside what they took.

    python tests/benchmarks/estimates.py [NAME ...]

Each command runs in a folder of its own: with an empty cache (of renders and of Dr.Jit's kernels), and again with what the first
left there. The estimate of each is made right before it. Times are wall time, with nothing else on the machine.
"""

from __future__ import annotations

import json
import math
import os
import shlex
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).parents[2]
WITHIN = 1.5  # the factor that a good estimate keeps
SMALL, LARGE = (
    f"[pixel]\npitch_um = {pitch_um}\nfull_well_e = {well_e}\nread_noise_e = {read_e}\ndark_current_e_per_s = 3\n"
    "quantum_efficiency = 0.62\nbits = 12\nblack_level_dn = 64\nprnu = 0.005\ndsnu = 0.2\n[camera]\ndie_mm = 2.4\n"
    "focal_length_mm = 4.0\nf_number = 2.8\n[exposure]\nmax_integration_s = 0.033\n"
    for pitch_um, well_e, read_e in ((3.75, 10500, 2.3), (4.8, 22000, 3.1))
)
COLOUR = (
    SMALL.replace("quantum_efficiency = 0.62\n", "technology = '4t-bsi'\n")
    + "[pixel.colour]\nsensitivities = 'Nikon_D5100'\npeak_quantum_efficiency = 0.5\n"
)
STACK = "[pixel.stack]\nheight_um = 3.0\nindex = 1.46\n"
FILES = {"small.toml": SMALL, "large.toml": LARGE, "colour.toml": COLOUR, "stack.toml": STACK}
DESK = HERE / "tests/data/desk/desk.xml"
COMMANDS = {
    "chart": "run csf",
    "fine chart": "run csf --resolution 2048",
    "large film": "run siemens_star --resolution 4096",
    "scene": "run macbeth --resolution 256",
    "scene in depth": "run still_life --resolution 128",
    "scene of files": f"run {DESK} --resolution 32",
    "line lamp": "run line_lamp --resolution 256",
    "lens": "run csf --lens phone",
    "lens of a window": "run csf --config small.toml --camera.die-mm 8.4 --camera.f-number 5 --lens cooke_triplet --window 1",
    "sheet": "run csf --config small.toml",
    "colour": "run csf --config colour.toml --resolution 640",
    "stack": "run csf --config stack.toml --pixel.technology 0.25um --resolution 640",
    "quick study": "study chen2000 --quick",
    "study": "study chen2000",
    "study of a sheet": "study pixel-size --config small.toml --quick",
    "study with a stack": "study modern --quick",
    "axis": "study pixel-size --config small.toml --quick --axis camera.f_number=2.8,5.6,11",
    "axes": "study chen2000 --quick --axis exposure.max_integration_s=0.02,0.1 --axis camera.f_number=2.8,5.6",
    "comparison": "compare large.toml small.toml",
    "comparison of many": "compare large.toml small.toml --repeats 32",
}


def called(folder: Path, line: str, *words: str) -> tuple[float, str]:
    """Seconds and output of a command, with the cache of a folder."""
    places = {"PIXSIM_CACHE_DIR": f"{folder}/cache", "DRJIT_CACHE_DIR": f"{folder}/kernels", "PYTHONPATH": str(HERE)}
    (folder / "kernels").mkdir(exist_ok=True)
    start = time.perf_counter()
    command = [sys.executable, "-P", "-m", "pixsim", *shlex.split(line), *words]
    done = subprocess.run(command, cwd=folder, env=os.environ | places, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"pixsim {line}: {done.stderr}")
    return time.perf_counter() - start, done.stdout


def main(names: list[str]) -> None:
    print("| command | estimate, s | took, s | ratio | with the cache: estimate | took | ratio |\n|---|---|---|---|---|---|---|")
    good = []
    for name, line in COMMANDS.items():
        if names and name not in names:
            continue
        cells = [f"`{line.replace(str(DESK), 'desk.xml')}`"]
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            for file, text in FILES.items():
                (folder / file).write_text(text, encoding="utf-8")
            for out in ("first", "again"):
                estimate_s = json.loads(called(folder, line, "--dry-run", "--json")[1])["estimate"]["seconds"]
                took_s, _ = called(folder, line, "--out", out)
                good.append(abs(math.log(estimate_s / took_s)) <= math.log(WITHIN))
                cells += [f"{estimate_s:.1f}", f"{took_s:.1f}", f"{estimate_s / took_s:.2f}"]
        print(f"| {' | '.join(cells)} |", flush=True)
    print(f"within a factor of {WITHIN}: first {sum(good[::2])} of {len(good[::2])}, again {sum(good[1::2])} of {len(good[1::2])}")


if __name__ == "__main__":
    main(sys.argv[1:])
