"""Records: what they refuse, what their hash depends on, and the geometry of the camera."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from pixsim.base.parameters import Camera, CameraOptions, Display, Exposure, Pixel, Run, Study, content_hash, merge

RECORDS = [Camera, CameraOptions, Display, Exposure, Pixel, Run]


# --- Records ---


@pytest.mark.parametrize("record", RECORDS)
def test_an_unknown_name_is_refused(record):
    with pytest.raises(ValidationError, match="pitch_mm"):
        record(pitch_mm=1.0)


@pytest.mark.parametrize("record", RECORDS)
def test_records_are_frozen(record):
    made = record()
    name = next(iter(record.model_fields))
    with pytest.raises(ValidationError, match="frozen"):
        setattr(made, name, 1.0)


@pytest.mark.parametrize(
    ("record", "values"),
    [
        (Camera, {"f_number": 0}),
        (Camera, {"f_number": float("nan")}),
        (Camera, {"die_mm": float("inf")}),
        (Camera, {"transmittance": 1.01}),
        (Pixel, {"pitch_um": -1}),
        (Pixel, {"quantum_efficiency": 1.5}),
        (Pixel, {"bits": 0}),
        (Pixel, {"bits": 10.5}),
        (Pixel, {"bits": 8, "black_level_dn": 255}),
        (Pixel, {"temperature_k": 27}),
        (Exposure, {"max_integration_s": 0}),
        (Exposure, {"well_target": 1.2}),
        (Display, {"raster": "fit"}),
        (Display, {"dots": 0}),
        (Study, {"name": "a b"}),
        (Study, {"name": "x", "repeats": 1}),
        (Study, {"name": "x", "technologies": ()}),
    ],
)
def test_impossible_values_are_refused(record, values):
    with pytest.raises(ValidationError, match=next(reversed(values))):
        record(**values)


def test_the_hash_depends_on_content_not_on_order():
    one = Pixel.model_validate({"pitch_um": 5.3, "bits": 12})
    other = Pixel.model_validate({"bits": 12, "pitch_um": 5.3, "technology": "0.35um"})
    assert one.content_hash == other.content_hash
    assert len(one.content_hash) == 16
    assert content_hash({"a": {"b": 1, "c": 2}, "d": 3}) == content_hash({"d": 3, "a": {"c": 2, "b": 1}})


def test_the_hash_depends_on_every_field():
    hashes = {Camera().content_hash}
    for name in Camera.model_fields:
        hashes.add(Camera(**{name: getattr(Camera(), name) * 0.99}).content_hash)
    assert len(hashes) == 1 + len(Camera.model_fields)
    # Digits below single precision, the order of a list and the kind of a value count as well.
    assert content_hash([1.0, 2.0]) != content_hash([2.0, 1.0])
    assert content_hash(1.0) != content_hash(1.0 + 1e-15)
    assert content_hash("1") != content_hash(1)


def test_the_hash_is_the_same_in_every_process():
    # BLAKE2b of the text {"a":1}, 8 bytes: `printf '{"a":1}' | b2sum -l 64`.
    assert content_hash({"a": 1}) == "1f8c00645b7df6ce"


def test_a_study_is_quickened_by_its_own_table():
    study = Study(name="x", repeats=8, pitch={"count": 24, "max_um": 12.0}, quick={"repeats": 2, "pitch": {"count": 6}})
    assert (study.quickened.repeats, study.quickened.pitch.count, study.quickened.pitch.max_um) == (2, 6, 12.0)
    assert study.quickened.quickened == study.quickened
    with pytest.raises(ValidationError, match="counts"):
        _ = Study(name="x", quick={"pitch": {"counts": 6}}).quickened


# --- Layers ---


def test_later_tables_win_and_keep_what_they_do_not_name():
    base = {"camera": {"f_number": 4.0, "die_mm": 2.7}, "seed": 1}
    over = {"camera": {"f_number": 2.0}, "pixel": {"bits": 12}}
    assert merge(base, over) == {"camera": {"f_number": 2.0, "die_mm": 2.7}, "seed": 1, "pixel": {"bits": 12}}
    # Neither side is changed; a value replaces a table and a table a value.
    assert base == {"camera": {"f_number": 4.0, "die_mm": 2.7}, "seed": 1}
    assert merge({"a": {"b": 1}}, {"a": 2}) == {"a": 2}
    assert merge({"a": 2}, {"a": {"b": 1}}) == {"a": {"b": 1}}


def test_camera_options_replace_what_is_given_only():
    camera = CameraOptions(f_number=2.0).over(Camera(focal_length_mm=5.0))
    assert (camera.focal_length_mm, camera.f_number, camera.die_mm) == (5.0, 2.0, Camera().die_mm)
    with pytest.raises(ValidationError, match="no real image"):
        CameraOptions(object_distance_m=0.001).over(Camera())


# --- The camera ---

CAMERAS = [
    Camera(),
    Camera(focal_length_mm=50, f_number=1.4, die_mm=36, object_distance_m=0.45),
    Camera(focal_length_mm=4.5, object_distance_m=1e4),
    Camera(focal_length_mm=10, object_distance_m=0.0101),
]


@pytest.mark.parametrize("camera", CAMERAS)
def test_the_thin_lens_equation_holds(camera):
    u_mm, v_mm, f_mm = 1e3 * camera.object_distance_m, camera.image_distance_mm, camera.focal_length_mm
    assert 1 / u_mm + 1 / v_mm == pytest.approx(1 / f_mm, rel=1e-12)
    assert camera.magnification == pytest.approx(v_mm / u_mm, rel=1e-12)
    assert camera.working_f_number == pytest.approx(v_mm / (2e3 * camera.aperture_radius_m), rel=1e-12)
    assert np.tan(np.radians(camera.fov_deg / 2)) == pytest.approx(camera.die_mm / 2 / v_mm, rel=1e-12)
    # The chart that fills the die is the die over the magnification.
    assert 2e3 * camera.chart_half_width_m * camera.magnification == pytest.approx(camera.die_mm, rel=1e-12)


def test_one_to_one_imaging():
    camera = Camera(focal_length_mm=50, f_number=2, object_distance_m=0.1)
    assert (camera.magnification, camera.image_distance_mm, camera.working_f_number) == pytest.approx((1.0, 100.0, 4.0))


@pytest.mark.parametrize("camera", CAMERAS)
def test_a_camera_comes_back_from_its_lens_geometry(camera):
    geometry = (camera.fov_deg, camera.aperture_radius_m, camera.object_distance_m, camera.die_mm)
    back = Camera.from_lens_geometry(*geometry)
    for name in Camera.model_fields:
        assert getattr(back, name) == pytest.approx(getattr(camera, name), rel=1e-9), name


@pytest.mark.parametrize("object_distance_m", [0.05, 0.049])
def test_an_object_within_the_focal_length_is_refused(object_distance_m):
    with pytest.raises(ValidationError, match=r"focal_length_mm = 50 .*no real image"):
        Camera(focal_length_mm=50, object_distance_m=object_distance_m)
