"""Keys: each setting of a study makes the stages anew that depend on it, and no others."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.study_settings import CHANGES
from helpers.tiny import TINY, lit_sensors, tiny

from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.studies.design import light_hash
from pixsim.studies.settings import Study

PITCH_UM = 6.0
LIGHT = SpectralImage([550.0], 10.0, 84.8, data=np.ones((4, 4, 1)))
# The settings before, a change, and the stages that it makes anew.
ROWS = {name: ({}, {name: value}, stages) for name, (value, stages) in CHANGES.items()} | {
    "a metric that is asked for": (
        {"metrics": ["delta_e", "information"]},
        {"metric": {"information": {"contrast": 0.3}}},
        "score",
    ),
    "registrations of a target": (
        {"metrics": ["delta_e", "detectability"]},
        {"metric": {"detectability": {"registrations": 32}}},
        "score",
    ),
    "the scene without the target": (
        {"metrics": ["delta_e", "detectability"]},
        {"metric": {"detectability": {"without": "flat"}}},
        "light score",
    ),
    # A frame is registered with a display of dots, not with one of a dot for each pixel.
    "raster": ({}, {"display": TINY["display"] | {"raster": "one_to_one"}}, "light frame score"),
}


def stages(study: Study) -> dict[str, str]:
    """The key of each stage of a study in one light."""
    sensor = lit_sensors(study, LIGHT, Camera())[0]
    return {
        "light": light_hash(study),
        "frame": sensor.pixel_hash(PITCH_UM),
        "score": sensor.keys(PITCH_UM, 2)[1],
    }


@pytest.mark.parametrize("name", [*Study.model_fields, *list(ROWS)[len(CHANGES) :]])
def test_setting_makes_its_stages_anew_and_no_others(name: str) -> None:
    over, change, expected = ROWS[name]
    before = tiny(**over)
    after = Study.model_validate(before.model_dump(exclude_unset=True) | change)
    assert after != before
    keys_before = stages(before)
    keys_after = stages(after)
    changed = {stage for stage in keys_before if keys_before[stage] != keys_after[stage]}
    assert changed == set(expected.split())
