"""Keys: each setting of a study makes the stages anew that depend on it, and no others."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.tiny import lit_sensors, tiny

from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.studies.keys import light_hash
from pixsim.studies.settings import Study

NAMES = "name", "streams"  # their content is that of the random streams
PITCH_UM = 6.0
LIGHT = SpectralImage([550.0], 10.0, 84.8, data=np.ones((4, 4, 1)))
# Another value of each setting, and the stages that it makes anew where the light is the same: a light states in its header what
# it depends on, so that its hash alone tells of a render.
CHANGES: dict[str, tuple[Any, str]] = {
    "scene": ({"file": "flat"}, "light"),
    "camera": ({"f_number": 5.6}, "light"),
    "lens": ({"file": "phone"}, "light"),
    "tolerance_e": (2e-3, "light"),
    "render_noise": (0.4, "light"),
    "resolution": (77, "light"),
    "max_seconds": (9.0, "light"),
    "window_mm": (0.5, "light"),
    "tolerance_delta_e": (1e-6, "light score"),  # which asks for double precision
    "pitch": ({"values_um": (6.0, 7.0, 8.0, 9.0, 16.0)}, "light score"),
    "exposure": ({"well_target": 0.5}, "light frame score"),
    "motion": ({"image_um_per_s": (3.0, 0.0)}, "light frame score"),
    "correction": ({"dark_frames": 4}, "light frame score"),
    "develop": ({"matrix": "noise_aware"}, "light score"),
    "display": ({"gamma": 1.8}, "light score"),
    "metrics": (("delta_e", "acutance"), "score"),
    "metric": ({"information": {"contrast": 0.3}}, ""),  # of a metric that nobody asks for
    "pixel": ({"prnu": 0.02}, "light frame score"),
    "process": ({"0.35um": {"dsnu": 0.6}}, "light frame score"),
    "technologies": (("0.35um", "0.25um"), "light"),
    "sensors": ({"one.toml": {"pitch_um": 6.0, "full_well_e": 1e4, "read_noise_e": 2.0, "quantum_efficiency": 0.5}}, "light"),
    "seed": (9, "light frame score"),
    "name": ("another", "frame score"),
    "streams": ("another", "frame score"),
    "repeats": (5, ""),
    "max_repeats": (50, ""),
    "target_ci_um": (0.5, ""),
    "max_evaluations": (1000, ""),
    "refine": (False, ""),
    "axis": (({"name": "f", "set": "camera.f_number", "values": (4.0, 8.0)},), ""),
    "condition": (({"name": "day", "set": {"camera": {"f_number": 4.0}}},), ""),
    "title": ("another", ""),
    "iso_delta_e": (2.0, ""),
    "detail": ((0.25, 0.75), ""),
    "paper": (True, ""),
    "sources": ({"seed": "here"}, ""),
    "noise_budget": (True, ""),
}


def stages(study: Study) -> dict[str, str]:
    hashes = lit_sensors(study, LIGHT, Camera())[0].fingerprints
    return {"light": light_hash(study), "frame": hashes.pixel(PITCH_UM), "score": hashes.keys(PITCH_UM, 2)[1]}


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
def test_settings_of_a_metric_count_where_it_is_asked_for(name: str, table: dict[str, object], anew: str) -> None:
    assert made_anew(tiny(metrics=["delta_e", name]), metric={name: table}) == set(anew.split())


def test_raster_decides_on_the_frame_too() -> None:
    """A frame is registered with a display of dots, not with one of a dot for each pixel."""
    assert made_anew(tiny(), display=tiny(display={"raster": "one_to_one"}).display) == {"light", "frame", "score"}
