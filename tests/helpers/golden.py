"""Golden outputs: what commands that touch every feature write, to compare a changed tree with the tree before.

    python tests/helpers/golden.py write FOLDER [--all | NAME ...]
    python tests/helpers/golden.py compare FOLDER [--all | NAME ...]

Each command runs with an empty cache, in a folder of its own. Of what it writes, tables are kept without `key`, JSON without
times, and pictures and frames by a hash of their samples. `compare` runs the commands again and prints what differs; it exits
with 1 if anything does. Without `--all` it takes the commands of `QUICK`, two minutes on two cores.
"""

from __future__ import annotations

import csv
import json
import os
import shlex
import subprocess
import sys
import tempfile
import time
from hashlib import blake2b
from pathlib import Path
from typing import Any

HERE = Path(__file__).parents[2]
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
SMALL = {"pitch_um": 3.75, "well_e": 10500, "read_e": 2.3, "efficiency": 0.62, "die_mm": 2.4, "more": ""}
LARGE = SMALL | {"pitch_um": 4.8, "well_e": 22000, "read_e": 3.1}
UNSURE = SMALL | {"more": "[pixel.uncertainty]\nread_noise_e = { range = [1.8, 2.9] }\nprnu = { range = [0.003, 0.01] }"}
COLOUR = (
    "[pixel]\ntechnology = '4t-bsi'\npitch_um = 3.0\n[pixel.colour]\nsensitivities = 'Nikon_D5100'\npeak_quantum_efficiency = 0.5\n"
)
FEW = """name = "few"
streams = "pixel-size"
seed = 1
title = "Few"
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
OF_FEW = {"technology": "4t-bsi", "repeats": 2, "low": 2.0, "scene": "csf", "parameters": "", "more": ""}
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
    return FEW.format(**(OF_FEW | changes))


FILES = {
    "small.toml": SHEET.format(**SMALL),
    "large.toml": SHEET.format(**LARGE),
    "third.toml": SHEET.format(**(LARGE | {"pitch_um": 6.0, "die_mm": 3.0})),
    "unsure.toml": SHEET.format(**UNSURE),
    "colour.toml": COLOUR,
    "stack.toml": "[pixel]\ntechnology = '0.25um'\npitch_um = 6.0\n[pixel.stack]\nheight_um = 3.0\nindex = 1.46\n",
    "few.toml": few(),
    "more.toml": few(repeats=4),
    "axes.toml": few(technology="0.35um", low=6.0, more=AXES),
    "conditions.toml": few(more=CONDITIONS),
    "light.toml": few(more=LIGHT),
    "filters.toml": few(more=FILTERS),
    "sensors.toml": few(technology='small.toml", "4t-bsi'),
    "scene.toml": few(scene="macbeth", parameters=", parameters = { spp = 4 }", low=4.0),
    "target.toml": few(technology="0.35um", low=6.0, more="target_ci_um = 0.4\nmax_repeats = 8"),
    "process.toml": few(technology="0.35um", low=6.0),
}
DESK = HERE / "tests/data/desk/desk.xml"
COMMANDS: dict[str, tuple[str, ...]] = {
    "run chart": ("run csf --resolution 512 --raw tiff npz --frames 2",),
    "run scene": (f"run {DESK} --resolution 32 -D spp=4",),
    "run packaged scene": ("run macbeth --resolution 64 -D spp=4 --config colour.toml",),
    "run colour": ("run csf --config colour.toml --resolution 256",),
    "run stack": ("run csf --config stack.toml --resolution 256",),
    "run lens": ("run csf --lens phone --resolution 256",),
    "run lens window": (
        "run csf --config small.toml --camera.die-mm 8.4 --camera.f-number 5 --lens cooke_triplet --window 0.5 --resolution 256",
    ),
    "run sheet": ("run csf --config small.toml --resolution 512 --correction.dark-frames 4 --correction.defects true",),
    "run tolerance": ("run csf --resolution 128 --tolerance-delta-e 0.2 --pixel.pitch-um 21.2 --display.dots 64",),
    "run picture": ("run csf --resolution 128 --irradiance full --out picture", "run picture/irradiance.exr --seed 3"),
    "study paper": ("study chen2000 --quick",),
    "study target": ("study target.toml",),
    "study resumed": ("study few.toml --config small.toml --out again", "study more.toml --config small.toml --out again"),
    "study single precision": ("study few.toml --tolerance-delta-e 0.3",),
    "study axes": ("study axes.toml",),
    "study axes together": ("study few.toml --config small.toml --axis camera.f_number=2.8,5.6 --axis exposure.gain_db=0,6",),
    "study sensitivity": ("study chen2000-sensitivity --quick --resolution 256 --display.dots 128",),
    "study modern": ("study modern --quick --resolution 256",),
    "study conditions": ("study conditions.toml",),
    "study filters": ("study filters.toml",),
    "study sensors": ("study sensors.toml",),
    "study lens": ("study few.toml --lens phone",),
    "study scene": ("study scene.toml",),
    "study one to one": ("study few.toml --config small.toml --display.raster one_to_one",),
    "types of a technology": ("study process.toml --uncertainty 8",),
    "types of a sheet": ("study few.toml --config unsure.toml --uncertainty 8",),
    "indices": ("study few.toml --config unsure.toml --sobol 8 --smaller-than 5",),
    "compare view": ("compare large.toml small.toml --repeats 4 --resolution 512",),
    "compare lens": ("compare large.toml third.toml --match lens --repeats 4 --resolution 512",),
    "compare own": ("compare large.toml third.toml --match own --repeats 4 --resolution 512",),
    "compare three": ("compare large.toml small.toml third.toml --repeats 4 --resolution 512",),
    "compare conditions": ("compare large.toml small.toml --study conditions.toml --repeats 4 --resolution 256",),
    "compare axes": ("compare large.toml small.toml --study light.toml --repeats 3 --resolution 256",),
    "compare uncertainty": ("compare unsure.toml large.toml --uncertainty 8 --repeats 3 --resolution 256",),
    "datasheet": ("datasheet small.toml",),
    "datasheet of a technology": ("datasheet 0.35um --pixel.pitch-um 6.5 --pixel.bits 12",),
    "sfr": ("run slanted_edge --resolution 512 --out edge", "sfr edge/raw.exr"),
    "lens": ("lens cooke_triplet --pitch-um 2",),
    "accuracy": ("accuracy csf --quick -D resolution=128 --display.dots 64 --pixel.pitch-um 21.2",),
}
QUICK = (
    *("run chart", "run scene", "run colour", "run lens", "run sheet", "study paper", "study axes", "study conditions"),
    *("types of a sheet", "compare view", "compare conditions"),
)
TIMES = {
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
    "stages",
    "pixsim",
}


def plain(value: Any, folder: str) -> Any:
    """JSON without times, and without the folder it was made in."""
    if isinstance(value, dict):
        return {name: plain(each, folder) for name, each in value.items() if name not in TIMES}
    if isinstance(value, list):
        return [plain(each, folder) for each in value]
    return value.replace(folder, "") if isinstance(value, str) else value


def kept(path: Path, folder: str) -> Any:
    """What is compared of a file; None if nothing is."""
    import numpy as np

    if path.name == "provenance.json":
        return None
    match path.suffix:
        case ".json":
            return plain(json.loads(path.read_text(encoding="utf-8")), folder)
        case ".csv":
            with path.open(newline="", encoding="utf-8") as file:
                return [
                    {name: text for name, text in row.items() if name != "key" and name not in TIMES}
                    for row in csv.DictReader(file)
                ]
        case ".png":
            from PIL import Image

            with Image.open(path) as picture:
                return blake2b(np.asarray(picture).tobytes(), digest_size=8).hexdigest()
        case ".exr":
            import OpenEXR

            with OpenEXR.File(str(path), separate_channels=True) as file:
                digest = blake2b(digest_size=8)
                for name in sorted(file.channels()):
                    digest.update(name.encode() + np.ascontiguousarray(file.channels()[name].pixels).tobytes())
                return digest.hexdigest()
        case ".npz" | ".tiff":
            return path.stat().st_size
    return None


def outputs(lines: tuple[str, ...]) -> dict[str, Any]:
    """All that is compared of commands in a folder of their own."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary).resolve()
        for name, text in FILES.items():
            (folder / name).write_text(text, encoding="utf-8")
        places = {"PIXSIM_CACHE_DIR": f"{folder}/cache", "PYTHONPATH": str(HERE)}
        found: dict[str, Any] = {}
        for number, line in enumerate(lines):
            given = [] if "--out" in line else ["--out", f"out{number}"]
            command = [sys.executable, "-P", "-W", "ignore", "-m", "pixsim", *shlex.split(line), *given, "--json", "--quiet"]
            done = subprocess.run(command, cwd=folder, env=os.environ | places, capture_output=True, text=True, check=False)
            if done.returncode:
                raise SystemExit(f"pixsim {line}: {done.stderr}")
            found[f"stdout {number}"] = plain(json.loads(done.stdout), str(folder))
        for path in sorted(folder.rglob("*")):
            name = str(path.relative_to(folder))
            if (
                path.is_file()
                and not name.startswith("cache/")
                and "/" in name
                and (content := kept(path, str(folder))) is not None
            ):
                found[name] = content
        return found


def differences(before: Any, after: Any, where: str = "") -> list[str]:
    """Where two outputs differ, as lines."""
    if isinstance(before, dict) and isinstance(after, dict):
        names = [*before, *(name for name in after if name not in before)]
        missing = object()
        return [
            line
            for name in names
            for line in (
                [f"{where}/{name}: {'only before' if name in before else 'only after'}"]
                if (name in before) != (name in after)
                else differences(before.get(name, missing), after.get(name, missing), f"{where}/{name}")
            )
        ]
    if isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        pairs = enumerate(zip(before, after, strict=True))
        return [line for number, (one, other) in pairs for line in differences(one, other, f"{where}[{number}]")]
    return [] if before == after else [f"{where}: {str(before)[:80]} -> {str(after)[:80]}"]


def main(words: list[str]) -> int:
    action, folder, *names = words
    chosen = list(COMMANDS) if names == ["--all"] else names or list(QUICK)
    place, differs = Path(folder), False
    place.mkdir(parents=True, exist_ok=True)
    for name in chosen:
        start = time.perf_counter()
        found = json.loads(json.dumps(outputs(COMMANDS[name])))
        seconds, file = time.perf_counter() - start, place / f"{name.replace(' ', '_')}.json"
        if action == "write":
            file.write_text(json.dumps(found), encoding="utf-8")
            print(f"{name}: {len(found)} files, {seconds:.0f} s", flush=True)
            continue
        lines = differences(json.loads(file.read_text(encoding="utf-8")), found)
        differs |= bool(lines)
        print(f"{name}: {'equal' if not lines else f'{len(lines)} differences'}, {seconds:.0f} s", flush=True)
        for line in lines[:20]:
            print(f"  {line}")
    return int(differs)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
