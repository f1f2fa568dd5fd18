"""What one review says of settings in their light."""

from __future__ import annotations

import numpy as np
from helpers.chains import imaging

from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.sensor.pixel_options import Pixel
from pixsim.viewer.review import review
from pixsim.viewer.scene_light import SceneLight

CAMERA = Camera(die_mm=0.32)


def light(camera: Camera) -> SpectralImage:
    """Green light that was rendered with a camera."""
    header = {"camera": camera.model_dump(mode="json"), "diffraction": False}
    return SpectralImage([550.0], 10.0, 10.0, data=np.full((32, 32, 1), 1e-3), header=header)


def test_review_names_what_the_settings_and_the_light_do_not_say_themselves() -> None:
    """A PRNU in per cent, and light of another f-number; nothing of a plain one."""
    plain = imaging(CAMERA, Pixel(technology="4t-bsi", pitch_um=5.0, stack={"enabled": False}))
    image = light(CAMERA)
    assert review(plain, SceneLight(image)) == []

    doubtful = imaging(CAMERA, plain.pixel.model_copy(update={"prnu": 0.2}))
    other_camera, slip = review(doubtful, SceneLight(light(Camera(die_mm=0.32, f_number=2.0))))
    assert other_camera.endswith("rendered with a camera of different f_number")
    assert slip == "pixel: prnu = 0.2 is unusual. In per cent? Write prnu = 0.002"
