"""Sensors behind a real lens compared in one field of view: rendered, blurred and scored with lenses scaled to their dies."""

from pathlib import Path

import pytest
from helpers.sheets import sheet

import pixsim
from pixsim.optics.camera import Camera
from pixsim.optics.camera_lens import LENS_HEADER, Tiling, traced_lens


@pytest.mark.filterwarnings("ignore:.*glasses of")
def test_sensors_of_one_field_are_compared_through_one_lens_scaled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pixsim.scene.real_lens.choose_tiling", lambda *_: Tiling(640.0, 100.0, 0.005))
    lens = '\n[lens]\nfile = "singlet"\n'
    files = [sheet(tmp_path / "a.toml", more="", pitch_um=20.0), sheet(tmp_path / "b.toml", pitch_um=10.0, pixels="[64, 64]")]
    for file in files:
        file.write_text(file.read_text(encoding="utf-8") + lens, encoding="utf-8")
    result = pixsim.compare(files, match="view", repeats=2, jobs=1, display={"dots": 32}, resolution=48)
    first, second = result.sensors
    one, other = (Camera(**sensor.irradiance.header["camera"]) for sensor in result.sensors)
    assert one.lens is not None
    assert other.lens is not None
    assert one.fov_deg == pytest.approx(other.fov_deg, rel=1e-6)
    assert one.lens.focal_length_mm / other.lens.focal_length_mm == pytest.approx(2.0, rel=0.01)
    fields = [
        traced_lens(camera.lens, camera.object_distance_m).field_of_height(camera.die_mm / 2, 550.0) for camera in (one, other)
    ]
    assert fields[0] == pytest.approx(fields[1], rel=1e-3)
    assert [LENS_HEADER in sensor.irradiance.header for sensor in result.sensors] == [True, True]
    # Both ideal pictures show the same scene, through the same distortion and fall-off.
    assert first.score.ideal == pytest.approx(second.score.ideal, abs=0.02)
    assert first.score.mean_delta_e == pytest.approx(second.score.mean_delta_e, rel=0.5)  # as large in pixels, of other diffraction
