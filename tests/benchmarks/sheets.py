"""Published sensors through the commands that a user runs first: seconds, memory and headline of
each.

    taskset -c 0,1 python tests/benchmarks/sheets.py [--sheet imx174]…

Every sheet of tests/data/sheets is rendered on a chart and on a 3-D scene, studied with --quick and
measured. Each command starts with an empty cache.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

SHEETS = Path(__file__).parents[1] / "data/sheets"
COMMANDS = {
    "chart": ["run", "csf", "-D", "luminance_cd_per_m2=100"],
    "3-D scene": ["run", "still_life"],
    "study": ["study", "pixel-size", "--quick"],
    "data sheet": ["datasheet"],
}


def measured(command: list[str], folder: str) -> tuple[float, float, str]:
    """Seconds, GiB of the largest process so far, and the last lines that a command prints."""
    environment = os.environ | {"PIXSIM_CACHE_DIR": f"{folder}/cache"}
    start = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "pixsim", *command],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    seconds = time.perf_counter() - start
    lines = (done.stdout or done.stderr).strip().splitlines() or [f"exit code {done.returncode}"]
    return (
        seconds,
        resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 2**20,
        " | ".join(lines[:2]),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sheet", action="append", help="only this sheet")
    parser.add_argument(
        "--command", action="append", choices=list(COMMANDS), help="only this command"
    )
    parser.add_argument("--json", action="store_true")
    chosen = parser.parse_args()
    rows = []
    for sheet in sorted(SHEETS.glob("*.toml")):
        if chosen.sheet and sheet.stem not in chosen.sheet:
            continue
        for name, command in COMMANDS.items():
            if chosen.command and name not in chosen.command:
                continue
            with tempfile.TemporaryDirectory() as folder:
                given = [str(sheet)] if name == "data sheet" else ["--config", str(sheet)]
                seconds, gib, words = measured([*command, *given], folder)
            rows.append(
                {
                    "sheet": sheet.stem,
                    "command": name,
                    "seconds": round(seconds, 1),
                    "gib": round(gib, 2),
                    "words": words,
                }
            )
            if not chosen.json:
                print(
                    f"{sheet.stem:20} {name:10} {seconds:6.1f} s {gib:5.2f} GiB  {words}",
                    flush=True,
                )
    if chosen.json:
        print(json.dumps(rows, indent=2, ensure_ascii=False))


if __name__ == "__main__":
    main()
