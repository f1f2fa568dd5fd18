"""Which settings of a frame cause which note, and which do not: a row for each."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

import pixsim
from pixsim import Camera, Display, Exposure, Pixel, SpectralImage
from pixsim.base.note_kinds import NOTES
from pixsim.base.notes import collected_notes

NM = np.arange(405.0, 1000.0, 10.0)
CAMERA = Camera(die_mm=0.32)
CHECKS = 0.5 + np.indices((32, 32)).sum(axis=0) // 4 % 2
SILICON: dict[str, Any] = {"technology": "4t-bsi", "pitch_um": 5.0, "stack": {"enabled": False}}
WHITE = {"white_w_per_m2_sr": 200.0}


def light(low_nm: float = 400.0, high_nm: float = 700.0, **header: Any) -> SpectralImage:
    """A chart in light of a range, as it was rendered with a camera."""
    header = {"camera": CAMERA.model_dump(mode="json"), "diffraction": False} | header
    inside = (low_nm < NM) & (high_nm > NM)
    return SpectralImage(NM, 10.0, 10.0, data=1e-3 * CHECKS[..., None] * inside, header=header)


def notes_of(change: dict[str, Any]) -> set[str]:
    """Return the ids of the notes of one evaluation."""
    pixel = Pixel.model_validate(SILICON | change.get("pixel", {}))
    display = Display.model_validate({"dots": 32} | change.get("display", WHITE))
    with warnings.catch_warnings(action="ignore"), collected_notes(alone=True) as notes:
        camera = change.get("camera", CAMERA)
        image = light(**change.get("light", {}))
        pixsim.evaluate(image, camera, pixel, display=display, **change.get("evaluate", {}))
    return {note.id for note in notes}


TABLE = [[400.0, 0.5], [650.0, 0.5]]
ROWS: list[tuple[str, dict[str, Any], dict[str, Any]]] = [
    ("unit_slip", {"pixel": {"prnu": 0.2}}, {"pixel": {"prnu": 0.002}}),
    ("other_camera", {"camera": Camera(die_mm=0.32, f_number=2.0)}, {"camera": CAMERA}),
    ("assumed", {"display": {}}, {"display": WHITE}),
    (
        "white_clipped",
        {"display": {"white_w_per_m2_sr": 1e-4}},
        {"display": {"white_w_per_m2_sr": 200.0}},
    ),
    (
        "spectral_range",
        {"pixel": {"quantum_efficiency": TABLE}},
        {"pixel": {"quantum_efficiency": [*TABLE, [660.0, 0.0]]}},
    ),
    ("no_effect", {"display": WHITE | {"adaptation": "cat02"}}, {}),
    ("cause", {"evaluate": {"exposure": Exposure(integration_s=1e4)}}, {}),
    (
        "focus",
        {"light": {"depths_m": [0.02, 0.02, 0.02]}},
        {"light": {"depths_m": [0.02, CAMERA.object_distance_m, None]}},
    ),
]


@pytest.mark.parametrize(("kind", "causing", "other"), ROWS, ids=[row[0] for row in ROWS])
def test_settings_cause_their_note(
    kind: str, causing: dict[str, Any], other: dict[str, Any]
) -> None:
    assert kind in NOTES
    assert kind in notes_of(causing)
    assert kind not in notes_of(other)
