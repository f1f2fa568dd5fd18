"""A study that takes a second, and its rows in a folder."""

import csv
import json
from pathlib import Path

import pixsim
from pixsim.studies.design import Case
from pixsim.studies.evaluate import RenderedCase, rendered_cases
from pixsim.studies.lights import Light
from pixsim.studies.prepare import cases_of_sensors
from pixsim.viewer.merging import merge

PITCHES_UM = [5.3, 6.0, 7.0, 8.5, 11.0, 15.0]
# Samples across a film that is too small for its error to be measured, which takes most of the time
# of a small study; and across one that tells its sizes apart.
COARSE, FINE = 48, 384
# Dim, so that few, coarse dots have a minimum between noise and blur.
TINY = {
    "name": "tiny",
    "repeats": 2,
    "iso_delta_e": 1.0,
    "resolution": COARSE,
    "tolerance_delta_e": 100.0,  # four renders are enough, if a test has the chart sampled
    "scene": {
        "file": "csf",
        "parameters": {"luminance_cd_per_m2": 100.0},
    },  # its cells are computed
    "camera": {"die_mm": 1.3568},
    "pitch": {"values_um": PITCHES_UM},
    "display": {"dots": 48, "samples_per_deg": 10.0},
}
WHOLE_CHART = {
    "camera": {"die_mm": 2.7136},
    "display": {"dots": 96},
}  # as in the paper, up to 33.3 lp/mm


def tiny(**over) -> pixsim.Study:
    return pixsim.Study.model_validate(merge(TINY, over))


def tiny_toml(**over) -> str:
    """The same study as the text of a file."""
    return "".join(f"{name} = {toml_of(value)}\n" for name, value in merge(TINY, over).items())


def toml_of(value) -> str:
    if isinstance(value, dict):
        return (
            "{ "
            + ", ".join(f"{json.dumps(name)} = {toml_of(each)}" for name, each in value.items())
            + " }"
        )
    return f"[{', '.join(map(toml_of, value))}]" if isinstance(value, list) else json.dumps(value)


def rows(path: Path) -> list[dict[str, str]]:
    """Rows of results.csv in a folder, or of a CSV file."""
    with (path / "results.csv" if path.is_dir() else path).open(
        newline="", encoding="utf-8"
    ) as file:
        return list(csv.DictReader(file))


def keys(folder: Path) -> list[str]:
    return [row["key"] for row in rows(folder)]


def lit_sensors(
    study: pixsim.Study, image: pixsim.SpectralImage, camera: pixsim.Camera
) -> list[RenderedCase]:
    """The sensors of a study without axes in a light."""
    cases = list(cases_of_sensors(Case(study, resolved=(image, camera))))
    return rendered_cases(cases, [Light(image, camera)] * len(cases))
