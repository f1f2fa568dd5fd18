"""Keys: each setting of a study makes the stages anew that depend on it, and no others."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.study_settings import CHANGES
from helpers.tiny import lit_sensors, tiny

from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.studies.design import light_hash
from pixsim.studies.settings import Study

NAMES = "name", "streams"  # their content is that of the random streams
PITCH_UM = 6.0
LIGHT = SpectralImage([550.0], 10.0, 84.8, data=np.ones((4, 4, 1)))


def stages(study: Study) -> dict[str, str]:
    lit = lit_sensors(study, LIGHT, Camera())[0]
    return {
        "light": light_hash(study),
        "frame": lit.pixel_hash(PITCH_UM),
        "score": lit.keys(PITCH_UM, 2)[1],
    }


def made_anew(before: Study, **change: Any) -> set[str]:
    """The stages of a study that other values of settings make anew."""
    after = Study.model_validate(before.model_dump(exclude_unset=True) | change)
    assert all(getattr(after, name) != getattr(before, name) for name in change)
    own, other = stages(before), stages(after)
    return {stage for stage in own if own[stage] != other[stage]}


@pytest.mark.parametrize("name", Study.model_fields)
def test_setting_makes_its_stages_anew_and_no_others(name: str) -> None:
    value, anew = CHANGES[name]
    assert made_anew(tiny(), **{name: value}) == set(anew.split())


@pytest.mark.parametrize(
    ("name", "table", "anew"),
    [
        ("information", {"contrast": 0.3}, "score"),
        ("detectability", {"registrations": 32}, "score"),
        ("detectability", {"without": "flat"}, "light score"),
    ],
)
def test_settings_of_a_metric_count_where_it_is_asked_for(
    name: str, table: dict[str, object], anew: str
) -> None:
    assert made_anew(tiny(metrics=["delta_e", name]), metric={name: table}) == set(anew.split())


def test_raster_decides_on_the_frame_too() -> None:
    """A frame is registered with a display of dots, not with one of a dot for each pixel."""
    assert made_anew(tiny(), display=tiny(display={"raster": "one_to_one"}).display) == {
        "light",
        "frame",
        "score",
    }
