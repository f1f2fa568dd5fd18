"""Settings between light and score, and what is made of them, for tests that go a part of the
way.
"""

from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.technology import load_technology
from pixsim.viewer.chain import ImagingChain
from pixsim.viewer.display_options import Display
from pixsim.viewer.evaluate import reviewed_chain
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.scene_light import PreparedScene, SceneLight, prepare_scene

AUTOMATIC, USUAL = Exposure(), Display()


def imaging(
    camera: Camera,
    pixel: Pixel,
    exposure: Exposure = AUTOMATIC,
    display: Display = USUAL,
    **settings,
) -> Imaging:
    """Settings, with the technology that the pixel names."""
    return Imaging(camera, pixel, load_technology(pixel.technology), exposure, display, **settings)


def scene_of(
    image: SpectralImage, camera: Camera, pixel: Pixel, display: Display = USUAL, **settings
) -> PreparedScene:
    """The light behind the lens for a pixel, with its screen."""
    return prepare_scene(imaging(camera, pixel, display=display, **settings), SceneLight(image))


def imaging_chain(
    image: SpectralImage,
    camera: Camera,
    pixel: Pixel,
    exposure: Exposure = AUTOMATIC,
    display: Display = USUAL,
    *,
    background: SpectralImage | None = None,
    **settings,
) -> ImagingChain:
    """The imaging chain that `pixsim.evaluate` takes its frame from."""
    return reviewed_chain(
        imaging(camera, pixel, exposure, display, **settings), SceneLight(image, background)
    )
