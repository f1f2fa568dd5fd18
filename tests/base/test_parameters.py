"""Records: validation, content hash, quantum efficiency curves, and the geometry of the camera."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from pixsim.base.hashes import content_hash
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.lens_options import TracedLens
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.pixel_options import Pixel
from pixsim.viewer.display_options import Display
from pixsim.viewer.merging import merge
from pixsim.viewer.setting import Run

RECORDS = [Camera, CameraOptions, Display, Exposure, Pixel, Run]


@pytest.mark.parametrize("record", RECORDS)
def test_record_is_frozen(record):
    with pytest.raises(ValidationError, match="frozen"):
        setattr(record(), next(iter(record.model_fields)), 1.0)


def test_content_hash_ignores_the_order_of_keys_alone():
    one = Pixel.model_validate({"pitch_um": 5.3, "bits": 12})
    other = Pixel.model_validate({"bits": 12, "pitch_um": 5.3, "technology": "0.35um"})
    assert one.content_hash == other.content_hash
    # BLAKE2b of the text {"a":1}, 8 bytes: `printf '{"a":1}' | b2sum -l 64`.
    assert content_hash({"a": 1}) == "1f8c00645b7df6ce"
    # Digits below single precision, the order of a list and the kind of a value count.
    contents = [[1.0, 2.0], [2.0, 1.0], 1.0, 1.0 + 1e-15, "1", 1]
    assert len(set(map(content_hash, contents))) == len(contents)


def test_content_hash_depends_on_every_field():
    values = Camera(die_height_mm=2.0, veiling_glare=0.1, veiling_glare_outside=0.1).model_dump()
    numbers = {name: value for name, value in values.items() if isinstance(value, float)}
    changes: list[dict[str, object]] = [{name: 0.99 * value} for name, value in numbers.items()]
    lens = TracedLens(file="phone", focal_length_mm=3.86, f_number=4, field_mm=1.9, content="0")
    changes += [
        {"chief_ray_angle": [[0, 0], [2, 20]]},
        {"fall_off": [[0, 1], [2, 0.5]]},
        {"lens": lens},
    ]
    hashes = {Camera(**change).content_hash for change in ({}, *changes)}
    assert len(hashes) == 1 + len(Camera.model_fields)


def test_merge_later_values_take_precedence():
    base = {"camera": {"f_number": 4.0, "die_mm": 2.7}, "seed": 1}
    over = {"camera": {"f_number": 2.0}, "pixel": {"bits": 12}}
    assert merge(base, over) == {
        "camera": {"f_number": 2.0, "die_mm": 2.7},
        "seed": 1,
        "pixel": {"bits": 12},
    }
    # Neither side is changed; a value replaces a table and a table a value.
    assert base == {"camera": {"f_number": 4.0, "die_mm": 2.7}, "seed": 1}
    assert merge({"a": {"b": 1}}, {"a": 2}) == {"a": 2}
    assert merge({"a": 2}, {"a": {"b": 1}}) == {"a": {"b": 1}}


def test_camera_options_over_replaces_given_fields():
    camera = CameraOptions(f_number=2.0).over(Camera(focal_length_mm=5.0))
    assert (camera.focal_length_mm, camera.f_number, camera.die_mm) == (5.0, 2.0, Camera().die_mm)


CAMERAS = [
    Camera(),
    Camera(focal_length_mm=50, f_number=1.4, die_mm=36, object_distance_m=0.45),
    Camera(focal_length_mm=4.5, object_distance_m=1e4),
    Camera(focal_length_mm=10, object_distance_m=0.0101),
]


@pytest.mark.parametrize("camera", CAMERAS)
def test_camera_obeys_thin_lens_equation(camera):
    u_mm, v_mm, f_mm = (
        1e3 * camera.object_distance_m,
        camera.image_distance_mm,
        camera.focal_length_mm,
    )
    assert 1 / u_mm + 1 / v_mm == pytest.approx(1 / f_mm, rel=1e-12)
    assert camera.magnification == pytest.approx(v_mm / u_mm, rel=1e-12)
    assert camera.working_f_number == pytest.approx(
        v_mm / (2e3 * camera.aperture_radius_m), rel=1e-12
    )
    assert np.tan(np.radians(camera.fov_deg / 2)) == pytest.approx(
        camera.die_mm / 2 / v_mm, rel=1e-12
    )
    back = Camera.from_lens_geometry(
        camera.fov_deg, camera.aperture_radius_m, camera.object_distance_m, camera.die_mm
    )
    assert back.model_dump(exclude_none=True) == pytest.approx(
        camera.model_dump(exclude_none=True), rel=1e-9
    )
    # The chart that fills the die is the die over the magnification.
    assert 2e3 * camera.chart_half_width_m * camera.magnification == pytest.approx(
        camera.die_mm, rel=1e-12
    )
