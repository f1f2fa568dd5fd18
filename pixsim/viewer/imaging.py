"""All settings between the light on a sensor and a score, in one record that every function of
`viewer` takes.

The way of one frame, each step in the module of its name:

    Imaging, SceneLight                  settings (imaging); irradiance with or without a target
                                         (scene_light)
      → prepare_scene → PreparedScene    light behind the lens, ideal picture, white
                                         (scene_light, screen)
      → make_chain → ImagingChain        electrons of each pixel; sensors and frames drawn from
                                         them (chain)
      → Development.score → FrameScore   a frame as a picture on a screen, and its ΔE
                                         (development, score)
      → FrameUnderTest → numbers         one frame as metrics see it (frame_under_test,
                                         raw_metrics, shown_metrics)

`evaluate` goes this way once; studies enter it where the light is shared.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from pixsim.base.hashes import content_hash
from pixsim.base.lazy import cached_property
from pixsim.optics.camera import Camera
from pixsim.sensor.correction_options import NO_CORRECTION, Correction
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.integration import pixels_on
from pixsim.sensor.motion import border_with_motion_um, velocity_um_per_s
from pixsim.sensor.motion_options import NO_MOTION, Motion
from pixsim.sensor.pixel import PixelPhysics, derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.reading import Readout
from pixsim.sensor.technology import Technology, load_technology
from pixsim.viewer.develop_options import DEVELOP, Develop
from pixsim.viewer.display_options import Display
from pixsim.viewer.metrics import DELTA_E_ONLY, MetricRequest
from pixsim.viewer.setting import Run

_PHYSICS_FIELDS = "pixel", "technology"


@dataclass(frozen=True)
class Imaging:
    """The settings of a frame and its score, beside the light and the random numbers.

    technology : of the pixel, with all its numbers
    border_um : width on each side of the die that is not scored, of all that is scored on the same
        dots. None: as wide as this pixel alone needs
    in_float32 : compute dots and S-CIELAB in float32, as a study does for its many evaluations; not
        with `without_shortcuts`
    without_shortcuts : compute grey images as colour images, and leave out nothing of the pixels'
        stack
    is_run : whether repeats are the sensors of a run: the first one is centred, and its random
        streams have no number
    """

    camera: Camera
    pixel: Pixel
    technology: Technology
    exposure: Exposure
    display: Display
    correction: Correction = NO_CORRECTION
    develop: Develop = DEVELOP
    motion: Motion = NO_MOTION
    metrics: MetricRequest = DELTA_E_ONLY
    border_um: float | None = None
    in_float32: bool = False
    without_shortcuts: bool = False
    is_run: bool = False

    @classmethod
    def of(cls, run: Run, camera: Camera) -> Imaging:
        """Return the settings of a run's frames, with the technology that its pixel names."""
        return cls.from_records(
            camera,
            run.pixel,
            exposure=run.exposure,
            display=run.display,
            correction=run.correction,
            develop=run.develop,
            motion=run.motion,
        )

    @classmethod
    def from_records(
        cls,
        camera: Camera,
        pixel: Pixel,
        *,
        exposure: Exposure | None = None,
        display: Display | None = None,
        correction: Correction | None = None,
        develop: Develop | None = None,
        motion: Motion | None = None,
        metrics: MetricRequest = DELTA_E_ONLY,
    ) -> Imaging:
        """Return the settings of records, with the technology that the pixel names. None means the
        defaults.
        """
        return cls(
            camera,
            pixel,
            load_technology(pixel.technology),
            exposure or Exposure(),
            display or Display(),
            correction=correction or NO_CORRECTION,
            develop=develop or DEVELOP,
            motion=motion or NO_MOTION,
            metrics=metrics,
        )

    @cached_property
    def physics(self) -> PixelPhysics:
        """Physical properties of the pixel."""
        return derive(self.pixel, self.technology)

    @cached_property
    def readout(self) -> Readout:
        """How the exposure reads the pixel."""
        return Readout.of(self.physics, self.exposure)

    @property
    def um_per_s(self) -> tuple[float, float]:
        """Velocity [x, y] of the image on the sensor."""
        return velocity_um_per_s(self.motion, self.camera, self.pixel.pitch_um)

    @property
    def scored_border_um(self) -> float:
        """Width on each side of the die that is not scored: `border_um`, or the border of this
        pixel, with room for what moves.
        """
        if self.border_um is not None:
            return self.border_um
        border_um = self.physics.border_um
        if not self.motion.is_on:
            return border_um
        pixels = self.pixel.pitch_um, self.pixel.bin_side
        return border_with_motion_um(border_um, self.motion, self.exposure, self.camera, [pixels])

    @property
    def pixel_key(self) -> tuple[str, ...]:
        """Key of all that the pixels depend on but their registration."""
        pixel = self.pixel.model_copy(update={"registration": None})
        return pixel.content_hash, content_hash(self.physics.technology.content)

    def changed(self, **settings: Any) -> Imaging:
        """Return a copy with other settings; the pixel is derived again only if they change it."""
        other = replace(self, **settings)
        if "physics" in self.__dict__ and not settings.keys() & set(_PHYSICS_FIELDS):
            other.__dict__["physics"] = self.physics
        return other

    def at(self, pitch_um: float) -> Imaging:
        """Return a copy with pixels of another pitch."""
        if pitch_um == self.pixel.pitch_um:
            return self
        return replace(self, pixel=self.pixel.model_copy(update={"pitch_um": pitch_um}))

    def registered(self, repeat: int, array_um: tuple[float, float] | None = None) -> Imaging:
        """Return a copy with the registration of one repeat. Where dots are pixels, all arrays are
        centred.

        The first repeat of a run is centred: its registration is 0 along an axis with an even
        number of pixels, and 0.5 with an odd one. The further repeats are spread from there, as the
        repeats of a study are spread from 0.

        array_um : (height, width) that the pixels of a run fill
        """
        if self.display.raster == "one_to_one" or (self.is_run and repeat == 0):
            return self
        first = 0.0, 0.0
        if self.is_run:
            assert array_um is not None
            rows, columns = pixels_on(array_um, self.physics.read_pitch_um)
            first = columns % 2 / 2, rows % 2 / 2
        return self._with_physics(self.physics.registered(repeat, first=first))

    def spread(self, number: int) -> Imaging:
        """Return a copy at a numbered registration (`PixelPhysics.registered`), as for pixels
        without a stated one.
        """
        centred = replace(self.physics, pixel=self.pixel.model_copy(update={"registration": None}))
        return self._with_physics(centred.registered(number))

    def _with_physics(self, physics: PixelPhysics) -> Imaging:
        """Return a copy with derived pixels that differ in their registration only."""
        if physics is self.physics:
            return self
        other = replace(self, pixel=physics.pixel)
        other.__dict__["physics"] = physics
        return other

    def stream_of(self, stream: tuple[object, ...], repeat: int) -> tuple[object, ...]:
        """Return the key of the random streams of one repeat, which begins with the common key."""
        return stream if self.is_run and repeat == 0 else (*stream, repeat)
