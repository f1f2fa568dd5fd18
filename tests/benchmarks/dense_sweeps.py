"""Dense sweeps of mean ΔE against pitch, the data of `interval_coverage.py`: tests/data/dense_sweeps/*.csv.

python tests/benchmarks/dense_sweeps.py [NAME …]

The sensors differ between pitches. A file holds mean and standard deviation of the sensors' mean ΔE at every pitch.
"""

from __future__ import annotations

import csv
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import pixsim
from pixsim.studies.sampling import study_pitches_um
from pixsim.studies.study_file import load_study

DATA = Path(__file__).parents[1] / "data" / "dense_sweeps"
SENSORS = 8
# docs/how_small.md
GATE_SENSOR = {
    "full_well_e": 10500, "read_noise_e": 2.3, "dark_current_e_per_s": 3, "quantum_efficiency": 0.62, "bits": 12,
    "black_level_dn": 64, "prnu": 0.005, "dsnu": 0.2, "data_sheet_pitch_um": 3.75
}  # fmt: skip
GATE = {"name": "gate", "seed": 1, "technologies": ["none"], "pixel": GATE_SENSOR, "exposure": {"max_integration_s": 0.033}}


def chen2000(technology: str, count: int, **more: Any) -> pixsim.Study:
    """The packaged study for one technology, with `count` pitches in its range."""
    study = load_study("chen2000").model_copy(update={"technologies": (technology,), "paper": False, "target_ci_um": None})
    table = study.model_dump(mode="json")
    table["pitch"]["count"] = count
    return pixsim.Study.model_validate(table | more)


def gate(luminance_cd_per_m2: float, f_number: float, count: int) -> pixsim.Study:
    """The camera of docs/how_small.md with a given luminance and f-number."""
    scene = {"file": "csf", "parameters": {"luminance_cd_per_m2": luminance_cd_per_m2}}
    pitch = {"min_um": 1.326, "max_um": 10.607, "count": count}
    camera = {"die_mm": 2.4, "focal_length_mm": 4.0, "f_number": f_number}
    return pixsim.Study.model_validate(GATE | {"scene": scene, "pitch": pitch, "camera": camera})


def beside_an_end(count: int, **more: Any) -> pixsim.Study:
    """The paper's pixel with its response scaled: its best size is beside the least that is possible."""
    pitch = {"min_fill_factor": 0.05, "max_um": 15.0, "count": count}
    return pixsim.Study.model_validate({"name": "open", "scene": {"file": "csf"}, "pitch": pitch} | more)


def studies() -> dict[str, pixsim.Study]:
    """Studies by the name of their data file."""
    one_to_one = {"display": {"raster": "one_to_one", "white_cd_per_m2": 1000.0}}
    return {
        "chen2000_0.35um": chen2000("0.35um", 140),
        "evening": gate(3.0, 2.8, 50),
        "flat": gate(20.0, 8.0, 60),  # diffraction exceeds most of the pixel sizes
        "near_an_end": chen2000("0.5um", 60),
        "at_the_end": chen2000("0.35um", 60, **one_to_one),
        "beside_an_end": beside_an_end(60),
        "skewed": chen2000("0.18um", 80),
    }


def sweep(study: pixsim.Study) -> np.ndarray:
    """(pitches, sensors) mean ΔE."""
    with tempfile.TemporaryDirectory() as folder:
        return pixsim.study(study.model_copy(update={"repeats": SENSORS, "refine": False}), folder).curves[0].delta_e


def main(names: list[str]) -> None:
    DATA.mkdir(parents=True, exist_ok=True)
    for name, study in studies().items():
        if names and name not in names:
            continue
        delta_e = sweep(study)
        rows = zip(study_pitches_um(study, study.technologies[0]), delta_e.mean(axis=1), delta_e.std(axis=1, ddof=1), strict=True)
        with (DATA / f"{name}.csv").open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(["pitch_um", "mean_delta_e", "sensor_std_delta_e"])
            writer.writerows([f"{pitch:.4f}", f"{mean:.6f}", f"{std:.6f}"] for pitch, mean, std in rows)


if __name__ == "__main__":
    main(sys.argv[1:])
