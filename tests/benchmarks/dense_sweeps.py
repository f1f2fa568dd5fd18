"""Dense sweeps of mean ΔE, or of another metric, against pitch, the data of `interval_coverage.py`:
tests/data/dense_sweeps/*.csv.

python tests/benchmarks/dense_sweeps.py [NAME …]

The sensors differ between pitches. A file holds mean and standard deviation of the sensors' mean ΔE
at every pitch.
"""

from __future__ import annotations

import csv
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import pixsim
from pixsim.studies.design import study_pitches_um
from pixsim.studies.files import load_study

DATA = Path(__file__).parents[1] / "data" / "dense_sweeps"
SENSORS = 8
# docs/how_small.md
GATE_SENSOR = {
    "full_well_e": 10500, "read_noise_e": 2.3, "dark_current_e_per_s": 3, "quantum_efficiency": 0.62, "bits": 12,
    "black_level_dn": 64, "prnu": 0.005, "dsnu": 0.2, "data_sheet_pitch_um": 3.75
}  # fmt: skip
GATE = {
    "name": "gate",
    "seed": 1,
    "technologies": ["none"],
    "pixel": GATE_SENSOR,
    "exposure": {"max_integration_s": 0.033},
}


def chen2000(technology: str, count: int, **more: Any) -> pixsim.Study:
    """The packaged study for one technology, with `count` pitches in its range."""
    study = load_study("chen2000").model_copy(
        update={"technologies": (technology,), "paper": False, "target_ci_um": None}
    )
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
    """The paper's pixel with its response scaled: its best size is beside the least that is
    possible.
    """
    pitch = {"min_fill_factor": 0.05, "max_um": 15.0, "count": count}
    return pixsim.Study.model_validate(
        {"name": "open", "scene": {"file": "csf"}, "pitch": pitch} | more
    )


def line(
    f_number: float, file: str, count: int, seed: int, repeats: int, *metrics: str
) -> pixsim.Study:
    """4t-bsi pixels behind a lens of 16 mm, as in docs/inspection_line.md, without motion."""
    target = {"shape": "bar", "size_mm": 0.1, "contrast": -0.2} if file == "target" else {}
    camera = {
        "die_mm": 0.6 if file == "target" else 1.2,
        "focal_length_mm": 16.0,
        "f_number": f_number,
        "object_distance_m": 0.3,
    }
    return pixsim.Study.model_validate({
        "name": "line", "seed": seed, "repeats": repeats, "technologies": ["4t-bsi"], "metrics": metrics, "camera": camera,
        "scene": {"file": file, "parameters": target | {"luminance_cd_per_m2": 79.6}},
        "pitch": {"min_um": 0.95, "max_um": 8.2, "count": count}, "exposure": {"integration_s": 5e-4}, "display": {"dots": 128},
        "pixel": {"bits": 12, "black_level_dn": 64},
    })  # fmt: skip


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
        "day": line(2.8, "csf", 48, 7, 48, "delta_e"),
        "day_f8": line(8.0, "csf", 72, 1, 16, "delta_e", "information"),
        **without_noise("", 2.8, SENSORS),
        **without_noise("_f8", 8.0, SENSORS),
        **without_noise("_f4", 4.0, 2),
        **without_noise("_f5_6", 5.6, 2),
        **without_noise("_f11", 11.0, 2),
    }


def without_noise(suffix: str, f_number: float, repeats: int) -> dict[str, pixsim.Study]:
    """Studies of a scratch by metrics with little or no noise."""
    orders = (
        ("information", "delta_e", "detectability"),
        ("detectability", "delta_e", "information"),
    )
    return {
        f"{first}{suffix}": line(f_number, "target", 72, 1, repeats, first, *others)
        for first, *others in orders
    }


def sweep(study: pixsim.Study) -> np.ndarray:
    """(pitches, sensors) mean ΔE, or the study's first metric."""
    repeats = SENSORS if study.name != "line" else study.repeats
    with tempfile.TemporaryDirectory() as folder:
        curve = pixsim.study(
            study.model_copy(update={"repeats": repeats, "refine": False}), folder
        ).curves[0]
    return curve.statistics[curve.metric.columns[0]]


def main(names: list[str]) -> None:
    DATA.mkdir(parents=True, exist_ok=True)
    for name, study in studies().items():
        if names and name not in names:
            continue
        values, metric = sweep(study), study.metrics[0]
        rows = zip(
            study_pitches_um(study, study.technologies[0]),
            values.mean(axis=1),
            values.std(axis=1, ddof=1),
            strict=True,
        )
        digits = 3 if metric == "information" else 6  # of 1e5 bits/mm²
        with (DATA / f"{name}.csv").open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(["pitch_um", f"mean_{metric}", f"sensor_std_{metric}"])
            writer.writerows(
                [f"{pitch:.4f}", f"{mean:.{digits}f}", f"{std:.{digits}f}"]
                for pitch, mean, std in rows
            )


if __name__ == "__main__":
    main(sys.argv[1:])
