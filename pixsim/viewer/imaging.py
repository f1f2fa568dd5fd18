"""What lies between the light on a sensor and a score, as one noun: camera, pixel, exposure, correction, development, display."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.sensor.correction_options import NO_CORRECTION, Correction
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.integration import ChannelLight, pixels_on
from pixsim.sensor.motion import velocity_um_per_s
from pixsim.sensor.motion_options import STILL, Motion
from pixsim.sensor.pixel import PixelPhysics, derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.technology import Technology
from pixsim.viewer.develop_options import DEVELOP, Develop
from pixsim.viewer.display_options import Display
from pixsim.viewer.judged import DELTA_E_ONLY, Judging
from pixsim.viewer.score import ImagingChain, PreparedScene, SharedLight, Unprepared, chain_at_pitch, prepare_scene
from pixsim.viewer.setting import Run


@dataclass(frozen=True)
class Imaging:
    """The settings of one frame and its score, beside the light and the random numbers.

    process : of the pixel's technology; None means that of its file
    border_um : of all that is scored on the same dots, as for `pixsim.viewer.display.dot_edges_um`; None means this pixel's
    single : compute dots and S-CIELAB in float32
    judging : what is asked of the judges
    is_run : whether its repeats are the sensors of a run: the first one is centred, and its random streams have no number
    """

    camera: Camera
    pixel: Pixel
    exposure: Exposure
    display: Display
    correction: Correction = NO_CORRECTION
    develop: Develop = DEVELOP
    process: Technology | None = None
    border_um: float | None = None
    single: bool = False
    judging: Judging = DELTA_E_ONLY
    is_run: bool = False
    motion: Motion = STILL

    @classmethod
    def of(cls, run: Run, camera: Camera) -> Imaging:
        """Return that of the frame of a run."""
        return cls(camera, run.pixel, run.exposure, run.display, run.correction, run.develop, motion=run.motion)

    @cached_property
    def physics(self) -> PixelPhysics:
        """Physical properties of the pixel, as its exposure reads it."""
        return derive(self.pixel, self.process).at_exposure(self.exposure)

    def at(self, pitch_um: float) -> Imaging:
        """Return the same with pixels of another size."""
        if pitch_um == self.pixel.pitch_um:
            return self
        return replace(self, pixel=self.pixel.model_copy(update={"pitch_um": pitch_um}))

    def registered(self, repeat: int, light: SharedLight | None = None) -> PixelPhysics:
        """Return the pixel of one repeat, with its registration. Where dots are pixels, all arrays are centred.

        The first repeat of a run is centred: its registration is 0 along an axis with an even number of pixels, and 0.5 with an
        odd one. The further ones are spread from there as those of a study are from 0.

        light : whose array the pixels of a run fill
        """
        if self.display.raster == "one_to_one":
            return self.physics
        if not self.is_run:
            return self.physics.registered(repeat)
        if repeat == 0:
            return self.physics

        assert isinstance(light, PreparedScene)
        rows, columns = pixels_on(light.array_um, self.physics.as_read.read_pitch_um)
        return self.physics.registered(repeat, first=(columns % 2 / 2, rows % 2 / 2))

    def stream_of(self, stream: tuple[object, ...], repeat: int) -> tuple[object, ...]:
        """Return the key of the random streams of one repeat, which begins as those of all."""
        return stream if self.is_run and repeat == 0 else (*stream, repeat)

    def light(
        self,
        irradiance: SpectralImage,
        physics: PixelPhysics | None = None,
        lights: tuple[ChannelLight, ...] | None = None,
        without: SpectralImage | None = None,
    ) -> PreparedScene:
        """Return the light behind the lens and the screen, as of `prepare_scene`.

        physics : the pixel with its registration; None means as it is
        lights : behind the lens, where they are known
        without : irradiance of the scene without its target, if a metric asks for it
        """
        own = irradiance, self.camera, physics or self.physics, self.display
        return prepare_scene(
            *own,
            border_um=self.border_um,
            single=self.single,
            lights=lights,
            judging=self.judging,
            without=without,
            develop=self.develop,
        )

    def prepared(self, light: SharedLight, physics: PixelPhysics) -> PreparedScene:
        """Return light that a series shares, prepared for its pixels."""
        return self.light(light.irradiance, physics, without=light.without) if isinstance(light, Unprepared) else light

    def chain(self, light: SharedLight, physics: PixelPhysics | None = None) -> ImagingChain:
        """Return the imaging chain up to the noise.

        light : prepared for the pixel's response, or not yet
        physics : the pixel with its registration; None means as it is
        """
        physics = physics or self.physics
        prepared = self.prepared(light, physics)
        um_per_s = velocity_um_per_s(self.motion, self.camera, physics.pitch_um)
        return chain_at_pitch(prepared, physics, self.exposure, self.correction, self.develop, um_per_s)
