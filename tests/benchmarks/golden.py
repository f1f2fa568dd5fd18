"""Golden numbers: what commands that touch every feature compute, to compare a changed tree with
the tree before.

    python tests/benchmarks/golden.py write FOLDER [--all | NAME ...]
    python tests/benchmarks/golden.py compare FOLDER [--all | NAME ...]

Each command runs with an empty cache, in a folder of its own. Numbers count, and words, pages,
pictures and lists of files do not: of tables the columns of numbers without times, of JSON the
numbers, and of frames and light all samples. Each command states its film, its dots and, of a lit
scene, its samples and its render noise, but for those of `FREE`, which leave them to pixsim.

On one type of processor and one set of packages every bit counts, elsewhere a relative difference
of `ELSEWHERE`. A number that only one of the trees writes is listed, and no difference. `compare`
exits with 1 if a number differs, or a command fails. Without `--all` it takes the commands of
`QUICK`, about three minutes on two idle cores.
"""

from __future__ import annotations

import csv
import json
import math
import os
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from hashlib import blake2b
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

from helpers.documents import this_machine

ROOT = Path(__file__).parents[2]
ELSEWHERE = 1e-9
LINES_PRINTED = 20
SHEET = """[pixel]
pitch_um = {pitch_um}
full_well_e = {well_e}
read_noise_e = {read_e}
dark_current_e_per_s = 3
quantum_efficiency = {efficiency}
bits = 12
black_level_dn = 64
prnu = 0.005
dsnu = 0.2
{more}
[camera]
die_mm = {die_mm}
focal_length_mm = 4.0
f_number = 2.8
[exposure]
max_integration_s = 0.033
"""
SMALL = {
    "pitch_um": 3.75,
    "well_e": 10500,
    "read_e": 2.3,
    "efficiency": 0.62,
    "die_mm": 2.4,
    "more": "",
}
LARGE = SMALL | {"pitch_um": 4.8, "well_e": 22000, "read_e": 3.1}
UNSURE = SMALL | {
    "more": (
        "[pixel.uncertainty]\nread_noise_e = { range = [1.8, 2.9] }\nprnu = { range = [0.003,"
        " 0.01] }"
    )
}
COLOUR = (
    "[pixel]\ntechnology = '4t-bsi'\npitch_um = 3.0\n[pixel.colour]\nsensitivities ="
    " 'Nikon_D5100'\npeak_quantum_efficiency = 0.5\n"
)
FEW = """name = "few"
title = "Few"
streams = "pixel-size"
seed = 1
technologies = ["{technology}"]
repeats = {repeats}
pitch = {{ min_um = {low}, max_um = 10.0, count = 5 }}
scene = {{ file = "{scene}"{parameters} }}
camera = {{ focal_length_mm = 3.86, f_number = 2.8, die_mm = 2.7136, object_distance_m = 1.0 }}
pixel = {{ bits = 10 }}
exposure = {{ max_integration_s = 0.033 }}
display = {{ dots = 128 }}
resolution = 256
{more}
"""
FEW_DEFAULTS = {
    "technology": "4t-bsi",
    "repeats": 2,
    "low": 2.0,
    "scene": "csf",
    "parameters": "",
    "more": "",
}
AXES = """[[axis]]
name = "light"
set = "scene.parameters.luminance_cd_per_m2"
values = [20.0, 200.0]
[[axis]]
name = "bits"
set = "pixel.bits"
values = [8, 12]
alone = true
[[axis]]
name = "dark"
range_of = "dark_current_na_per_cm2"
alone = true
[correction]
dark_frames = 4
column_clamp = 4
"""
LIGHT = """[[axis]]
name = "light"
set = "scene.parameters.luminance_cd_per_m2"
values = [2.0, 200.0]
"""
CONDITIONS = """[[condition]]
name = "day"
weight = 0.7
set.scene.parameters.luminance_cd_per_m2 = 200.0
[[condition]]
name = "night"
weight = 0.3
set.scene.parameters.luminance_cd_per_m2 = 2.0
"""
FILTERS = """[[axis]]
name = "filters"
values = [
    { label = "none", set.pixel.quantum_efficiency = 0.5 },
    { label = "RGGB", set.pixel.colour = { pattern = "rggb", sensitivities = "Nikon_D5100", peak_quantum_efficiency = 0.5 } },
    { label = "quad", set.pixel.colour = { pattern = "quad_rggb", binning = true, sensitivities = "Nikon_D5100", \
peak_quantum_efficiency = 0.5 } },
]
"""


def few(**changes: Any) -> str:
    """A study of few sizes and sensors."""
    return FEW.format(**(FEW_DEFAULTS | changes))


FILES = {
    "small.toml": SHEET.format(**SMALL),
    "large.toml": SHEET.format(**LARGE),
    "third.toml": SHEET.format(**(LARGE | {"pitch_um": 6.0, "die_mm": 3.0})),
    "unsure.toml": SHEET.format(**UNSURE),
    "colour.toml": COLOUR,
    "stack.toml": (
        "[pixel]\ntechnology = '0.25um'\npitch_um = 6.0\n[pixel.stack]\nheight_um = 3.0\nindex ="
        " 1.46\n"
    ),
    "few.toml": few(),
    "more.toml": few(repeats=4),
    "axes.toml": few(technology="0.35um", low=6.0, more=AXES),
    "conditions.toml": few(more=CONDITIONS),
    "light.toml": few(more=LIGHT),
    "filters.toml": few(more=FILTERS),
    "sensors.toml": few(technology='small.toml", "4t-bsi'),
    "scene.toml": few(
        scene="macbeth", parameters=", parameters = { spp = 4 }", more="render_noise = 1.0", low=4.0
    ),
    "target.toml": few(technology="0.35um", low=6.0, more="target_ci_um = 0.4\nmax_repeats = 8"),
    "process.toml": few(technology="0.35um", low=6.0),
}
DESK = ROOT / "tests/data/desk/desk.xml"
LIT = "--render-noise 1"
COMMANDS: dict[str, tuple[str, ...]] = {
    "run chart": ("run csf --resolution 512 --display.dots 512 --raw npz --frames 2",),
    "run repeats": ("run csf --resolution 512 --display.dots 256 --repeats 4",),
    "run scene": (f"run {DESK} --resolution 32 --display.dots 32 -D spp=4 {LIT}",),
    "run packaged scene": (
        f"run macbeth --resolution 64 --display.dots 64 -D spp=4 {LIT} --config colour.toml",
    ),
    "run colour": ("run csf --config colour.toml --resolution 256 --display.dots 256",),
    "run stack": ("run csf --config stack.toml --resolution 256 --display.dots 256",),
    "run lens": ("run csf --lens phone --resolution 256 --display.dots 256",),
    "run lens window": (
        (
            "run csf --config small.toml --camera.die-mm 8.4 --camera.f-number 5 --lens"
            " cooke_triplet --window 0.5 --resolution 256 --display.dots 256"
        ),
    ),
    "run sheet": (
        (
            "run csf --config small.toml --resolution 512 --display.dots 512"
            " --correction.dark-frames 4 --correction.defects true"
        ),
    ),
    "run metrics": (
        (
            "run target --config small.toml --resolution 256 --display.dots 256 --metric delta_e"
            " --metric detectability --metric npwe --metric information --metric acutance"
        ),
    ),
    "run picture": (
        "run csf --resolution 128 --display.dots 128 --irradiance full --out picture",
        "run picture/irradiance.exr --display.dots 128 --seed 3",
    ),
    "study paper": ("study chen2000 --quick --resolution 1024",),
    "study target": ("study target.toml",),
    "study resumed": (
        "study few.toml --config small.toml --out again",
        "study more.toml --config small.toml --out again",
    ),
    "study axes": ("study axes.toml",),
    "study axes together": (
        (
            "study few.toml --config small.toml --axis camera.f_number=2.8,5.6 --axis"
            " exposure.gain_db=0,6"
        ),
    ),
    "study sensitivity": (
        "study chen2000-sensitivity --quick --resolution 256 --display.dots 128",
    ),
    "study modern": ("study modern --quick --resolution 256 --display.dots 128",),
    "study conditions": ("study conditions.toml",),
    "study filters": ("study filters.toml",),
    "study sensors": ("study sensors.toml",),
    "study lens": ("study few.toml --lens phone",),
    "study scene": ("study scene.toml",),
    "study metrics": ("study few.toml --metric delta_e --metric information --metric acutance",),
    "study one to one": ("study few.toml --config small.toml --display.raster one_to_one",),
    "types of a technology": ("study process.toml --uncertainty 8",),
    "types of a sheet": ("study few.toml --config unsure.toml --uncertainty 8",),
    "indices": ("study few.toml --config unsure.toml --sobol 8 --smaller-than 5",),
    "compare view": (
        (
            "compare large.toml small.toml --match view --repeats 4 --resolution 512"
            " --display.dots 512"
        ),
    ),
    "compare lens": (
        (
            "compare large.toml third.toml --match lens --repeats 4 --resolution 512"
            " --display.dots 512"
        ),
    ),
    "compare own": (
        "compare large.toml third.toml --match own --repeats 4 --resolution 512 --display.dots 512",
    ),
    "compare three": (
        (
            "compare large.toml small.toml third.toml --match view --repeats 4 --resolution 512"
            " --display.dots 512"
        ),
    ),
    "compare conditions": (
        (
            "compare large.toml small.toml --match view --study conditions.toml --repeats 4"
            " --resolution 256"
        ),
    ),
    "compare axes": (
        (
            "compare large.toml small.toml --match view --study light.toml --repeats 3"
            " --resolution 256"
        ),
    ),
    "compare uncertainty": (
        (
            "compare unsure.toml large.toml --match view --uncertainty 8 --repeats 3 --resolution"
            " 256 --display.dots 256"
        ),
    ),
    "datasheet": ("datasheet small.toml",),
    "datasheet of a technology": ("datasheet 0.35um --pixel.pitch-um 6.5 --pixel.bits 12",),
    "sfr": ("run slanted_edge --resolution 512 --display.dots 512 --out edge", "sfr edge/raw.exr"),
    "lens": ("lens cooke_triplet --pitch-um 2",),
    "accuracy": ("accuracy csf --quick -D resolution=128 --display.dots 64 --pixel.pitch-um 21.2",),
    "free run": ("run csf",),
    "free run tolerance": ("run csf --tolerance-delta-e 0.2 --pixel.pitch-um 21.2",),
    "free run scene": (f"run {DESK} --window 0.5",),
    "free study": ("study chen2000 --quick",),
    "free study tolerance": ("study free.toml --tolerance-delta-e 0.3",),
    "free compare": ("compare large.toml small.toml --match view --repeats 4",),
}
FREE = [name for name in COMMANDS if name.startswith("free")]
QUICK = (
    *(
        "run chart",
        "run repeats",
        "run scene",
        "run colour",
        "run lens",
        "run sheet",
        "run metrics",
        "study axes",
    ),
    *(
        "study conditions",
        "types of a sheet",
        "compare view",
        "compare conditions",
        "datasheet",
        "lens",
    ),
)
# What depends on the clock, the machine or the version, and what is computed but not a result.
NOT_NUMBERS = {
    *(
        "seconds",
        "stage_seconds",
        "wall_s",
        "time_s",
        "cpu_s",
        "memory_bytes",
        "estimate",
        "created",
        "versions",
        "machine",
    ),
    *("stages", "pixsim", "schema", "key", "files", "check", "written"),
}


def json_numbers(value: Any, place: str) -> Iterator[tuple[str, float]]:
    """Each number of JSON, with the names that lead to it."""
    if isinstance(value, dict):
        for name, inner in value.items():
            if name not in NOT_NUMBERS:
                yield from json_numbers(inner, f"{place}/{name}")
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from json_numbers(inner, f"{place}[{index}]")
    elif isinstance(value, int | float):
        yield place, float(value)


def table_numbers(path: Path, place: str) -> Iterator[tuple[str, float]]:
    """Each number of a CSV file, with its row and its column, and the number of rows."""
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    yield f"{place}/rows", float(len(rows))
    for index, row in enumerate(rows):
        for column, text in row.items():
            if column in NOT_NUMBERS:
                continue
            try:
                number = float(text)
            except (TypeError, ValueError):
                continue  # a word
            yield f"{place}[{index}]/{column}", number


def array_numbers(samples: Any, place: str) -> Iterator[tuple[str, float]]:
    """What stands for an array: a digest of its bits as a number, and moments, which elsewhere are
    compared in its place.
    """
    import numpy as np

    array = np.ascontiguousarray(samples)
    digest = blake2b(str(array.shape).encode() + array.tobytes(), digest_size=6).digest()
    yield f"{place}/{BITS}", float(int.from_bytes(digest, "big"))
    if array.dtype.kind in "fiub":
        flat = array.astype(float).ravel()
        weights = np.random.default_rng(0).random(flat.size)
        yield f"{place}/mean", float(flat.mean())
        yield f"{place}/mean square", float(np.square(flat).mean())
        yield f"{place}/weighted mean", float((flat * weights).mean())


BITS = "bits"


def file_numbers(path: Path, place: str) -> Iterator[tuple[str, float]]:
    """What is compared of a file, which is nothing of a page or of a picture."""
    match path.suffix:
        case ".json" if path.name not in ("pixsim.json", "provenance.json"):
            yield from json_numbers(json.loads(path.read_text(encoding="utf-8")), place)
        case ".csv":
            yield from table_numbers(path, place)
        case ".exr":
            import OpenEXR

            with OpenEXR.File(str(path), separate_channels=True) as file:
                for name in sorted(file.channels()):
                    yield from array_numbers(file.channels()[name].pixels, f"{place}/{name}")
        case ".npz":
            import numpy as np

            with np.load(path) as arrays:
                for name in sorted(arrays.files):
                    if arrays[name].dtype.kind in "fiub":
                        yield from array_numbers(arrays[name], f"{place}/{name}")


def command_numbers(lines: tuple[str, ...]) -> dict[str, float]:
    """All that is compared of commands in a folder of their own."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary).resolve()
        for name, text in FILES.items():
            (folder / name).write_text(text, encoding="utf-8")
        environment = os.environ | {
            "PIXSIM_CACHE_DIR": f"{folder}/cache",
            "PYTHONPATH": str(ROOT),
            # as in the tests: other numbers of threads turn the last digits of fits
            "OPENBLAS_NUM_THREADS": "1",
            "OMP_NUM_THREADS": "1",
        }

        numbers: dict[str, float] = {}
        for index, line in enumerate(lines):
            output = [] if "--out" in line else ["--out", f"out{index}"]
            command = [
                sys.executable,
                "-P",
                "-W",
                "ignore",
                "-m",
                "pixsim",
                *shlex.split(line),
                *output,
                "--json",
                "--quiet",
            ]
            process = subprocess.run(
                command, cwd=folder, env=environment, capture_output=True, text=True, check=False
            )
            if process.returncode:
                raise SystemExit(f"pixsim {line}: {process.stderr}")
            numbers.update(json_numbers(json.loads(process.stdout), f"stdout {index}"))

        for path in sorted(folder.rglob("*")):
            place = str(path.relative_to(folder))
            if path.is_file() and "/" in place and not place.startswith("cache/"):
                numbers.update(file_numbers(path, place))
    return numbers


def differences(before: dict[str, float], after: dict[str, float], *, every_bit: bool) -> list[str]:
    """Lines for the numbers that both trees write and that differ."""
    lines = []
    for place in before.keys() & after.keys():
        old, new = before[place], after[place]
        if every_bit:
            is_equal = old == new or (math.isnan(old) and math.isnan(new))
        elif place.endswith(f"/{BITS}"):
            is_equal = True
        else:
            is_equal = math.isclose(old, new, rel_tol=ELSEWHERE, abs_tol=0.0) or (
                math.isnan(old) and math.isnan(new)
            )
        if not is_equal:
            lines.append(f"{place}: {old!r} -> {new!r}")
    return sorted(lines)


def main(words: list[str]) -> int:
    action, folder_name, *names = words
    chosen = list(COMMANDS) if names == ["--all"] else names or list(QUICK)
    folder = Path(folder_name)
    folder.mkdir(parents=True, exist_ok=True)
    machine_file = folder / "machine.json"
    machine = json.loads(json.dumps(this_machine()))
    if action == "write":
        machine_file.write_text(json.dumps(machine), encoding="utf-8")
    every_bit = json.loads(machine_file.read_text(encoding="utf-8")) == machine
    print(
        (
            "every bit counts"
            if every_bit
            else f"another machine: relative differences above {ELSEWHERE:g} count"
        ),
        flush=True,
    )

    any_difference = False
    for name in chosen:
        start = time.perf_counter()
        numbers = command_numbers(COMMANDS[name])
        seconds = time.perf_counter() - start
        file = folder / f"{name.replace(' ', '_')}.json"
        if action == "write":
            file.write_text(json.dumps(numbers), encoding="utf-8")
            print(f"{name}: {len(numbers)} numbers, {seconds:.0f} s", flush=True)
            continue
        before = json.loads(file.read_text(encoding="utf-8"))
        lines = differences(before, numbers, every_bit=every_bit)
        any_difference |= bool(lines)
        result = f"{len(lines)} differences" if lines else "equal"
        gone, new = sorted(before.keys() - numbers.keys()), sorted(numbers.keys() - before.keys())
        print(
            f"{name}: {result} of {len(before)}, {len(gone)} gone, {len(new)} new, {seconds:.0f} s",
            flush=True,
        )
        for line in [*lines[:LINES_PRINTED], *(f"gone: {place}" for place in gone[:LINES_PRINTED])]:
            print(f"  {line}")
    return int(any_difference)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
