"""From light to frames: the mean electrons of each pixel, and the sensors and frames that are drawn
from them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from pixsim.base.arrays import Array, stream
from pixsim.base.caller import setting
from pixsim.base.digits import exposure_time
from pixsim.base.errors import invalid
from pixsim.base.lazy import cached_property
from pixsim.sensor.collection import Collection, ColourCollection, collections_of
from pixsim.sensor.colour import channel_map
from pixsim.sensor.correction import correct
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.integration import array_signal, centred_pixels, moved_signals
from pixsim.sensor.motion import NO_IMAGE_MOTION, ImageMotion
from pixsim.sensor.motion_options import VELOCITIES
from pixsim.sensor.pixel import PixelPhysics
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import (
    Frame,
    Sensor,
    capture_from_rates,
    integration_time_s,
    metered_motion,
    sample_sensor,
    with_metered_gain,
    with_shared_time,
)
from pixsim.viewer.develop import ColourChart
from pixsim.viewer.development import Development
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.scene_light import LightFacts, PreparedScene, SharedLight, prepare_scene
from pixsim.viewer.score import FrameScore
from pixsim.viewer.screen import ROUNDING, Screen


@dataclass(frozen=True)
class ExpectedFrame:
    """The expected electrons of a frame, before noise is drawn, with the light and the settings.

    light : facts of the light
    development : how such frames become pictures
    signal_e : mean electrons of light, (rows, columns)
    background_e : mean electrons of the scene without its target, or None where no metric asks
    integration_s : time of the frame
    moving : how the light moves meanwhile
    """

    light: LightFacts
    development: Development
    signal_e: Array = field(repr=False)
    background_e: Array | None = field(repr=False)
    integration_s: float
    image_motion: ImageMotion = NO_IMAGE_MOTION

    @property
    def imaging(self) -> Imaging:
        """The settings."""
        return self.development.imaging

    @property
    def readout(self) -> Readout:
        """How the pixels are read."""
        return self.development.readout

    @property
    def white_e(self) -> float:
        """Electrons of the scene's white on axis, in the mean over the channels' pixels."""
        return self.development.white_e_per_s * self.integration_s


@dataclass(frozen=True)
class ImagingChain:
    """From light to the frames of one pixel type, and to their scores on a screen.

    imaging : settings, of the pixels at their place on the die
    readout : how the pixels are read, at the gain of the exposure
    exposure : of the settings, with its time where other light meters it
    signal_e_per_s : of every value of a frame, (rows, columns)
    whites_e_per_s : electrons per second of the scene's white, on axis, in each channel
    collection : light that reaches the photodiodes through the pixels' stack, or None without a
        stack
    colour_chart : what the channels respond to its patches, or None for a monochrome sensor
    scene : the light, or None for a chain that stays in memory
    background_e_per_s : the signal of the scene without its target, or None if no metric asks
    moving : how the light moves in a frame, whose time the exposure states then
    subexposures_e_per_s : the signal in each exposure of a burst, if they differ; else none
    """

    imaging: Imaging
    readout: Readout
    exposure: Exposure
    signal_e_per_s: Array
    whites_e_per_s: tuple[float, ...]
    screen: Screen
    collection: Collection | ColourCollection | None = None
    colour_chart: ColourChart | None = None
    scene: PreparedScene | None = None
    background_e_per_s: Array | None = None
    image_motion: ImageMotion = NO_IMAGE_MOTION
    subexposures_e_per_s: tuple[Array, ...] = ()

    @cached_property
    def development(self) -> Development:
        """How the frames become pictures."""
        imaging = self.imaging
        if self.screen.display is not imaging.display:
            imaging = imaging.changed(display=self.screen.display)
        return Development(
            imaging,
            self.readout,
            self.exposure,
            self.signal_e_per_s,
            self.whites_e_per_s,
            self.screen,
            self.colour_chart,
            self.collection,
        )

    @property
    def white_e_per_s(self) -> float:
        """Electrons per second of the scene's white on axis, in the mean over the channels'
        pixels.
        """
        return self.development.white_e_per_s

    @property
    def integration_s(self) -> float:
        """Integration time of a frame, which depends on its brightest pixel."""
        return integration_time_s(self.exposure, self.readout, float(self.signal_e_per_s.max()))

    def expected(self, integration_s: float) -> ExpectedFrame:
        """Return the expectation of a frame of this time. Only for light that metrics ask for
        (`Metric.needs_light`).
        """
        assert self.scene is not None
        assert self.scene.facts is not None, "no metric asks for the light: needs_light"
        background = self.background_e_per_s
        return ExpectedFrame(
            self.scene.facts,
            self.development,
            self.signal_e_per_s * integration_s,
            None if background is None else background * integration_s,
            integration_s,
            self.image_motion,
        )

    def registered(self, number: int) -> ImagingChain:
        """Return the chain of the same pixels at another registration (`Imaging.spread`)."""
        assert self.scene is not None
        # Frames at other registrations are not displayed, so they need no room for motion.
        imaging = self.imaging.spread(number).changed(exposure=self.exposure)
        return make_chain(imaging, self.scene, room_is_checked=True)

    def on(self, screen: Screen) -> ImagingChain:
        """Return the chain of the same frames on another screen."""
        return self if screen is self.screen else replace(self, screen=screen)

    def simulate(self, *key: object) -> FrameScore:
        """Return the score of a new sensor and a new frame for each key."""
        return self.development.score(self.capture(*key))

    def sensor(self, *key: object) -> Sensor:
        """Return the sensor of `capture`; it does not depend on the light."""
        return sample_sensor(self.readout, self.signal_e_per_s.shape, stream(*key, "sensor"))

    def capture(self, *key: object, sensor_of: Callable[..., Sensor] | None = None) -> Frame:
        """Return the frame that `simulate` scores.

        sensor_of : returns the sensor of a key, such as a cached one. None draws it
        """
        # Before the sensor is drawn: later it would take three times as long.
        frame_rng = stream(*key, "frame")
        return self.capture_by(
            (sensor_of or self.sensor)(*key), frame_rng, partial(stream, *key, "correction")
        )

    def capture_with(
        self,
        sensor_rng: np.random.Generator,
        frame_rng: np.random.Generator,
        correction_rng: np.random.Generator,
    ) -> Frame:
        """Return a frame whose fixed pattern, temporal noise and frames for its correction come
        from three generators.
        """
        sensor = sample_sensor(self.readout, self.signal_e_per_s.shape, sensor_rng)
        return self.capture_by(sensor, frame_rng, lambda: correction_rng)

    def capture_by(
        self,
        sensor: Sensor,
        frame_rng: np.random.Generator,
        make_correction_rng: Callable[[], np.random.Generator],
    ) -> Frame:
        """Return a frame of a sensor, whose temporal noise and frames for its correction come from
        two generators.

        make_correction_rng : makes the second one; it is called only if the camera corrects its
            frames
        """
        frame = self._capture_frame(sensor, frame_rng)
        correction = self.imaging.correction
        if not correction.is_on:
            return frame
        layout = self.readout.physics.layout
        levels = None
        if layout is not None:
            whites = np.array(self.whites_e_per_s)
            levels = channel_map(whites / whites.max(), layout, self.signal_e_per_s.shape)
        return correct(
            frame, sensor, correction, make_correction_rng(), self.development.flat_field, levels
        )

    def further_frames(self, count: int, *key: object) -> Iterator[Frame]:
        """Yield frames 2, 3, … of the sensor of `capture`, whose frame is the first of `count`;
        they are not corrected.

        All have the fixed pattern and the exposure of the first. Each has temporal noise of its
        own, which depends on the key and the number of the frame only.
        """
        if count < 2:
            return
        sensor = self.sensor(*key)
        for number in range(2, count + 1):
            yield self._capture_frame(sensor, stream(*key, "frame", number))

    def _capture_frame(self, sensor: Sensor, rng: np.random.Generator) -> Frame:
        return capture_from_rates(
            self.signal_e_per_s, sensor, self.exposure, rng, self.subexposures_e_per_s
        )


def make_chain(
    imaging: Imaging, light: SharedLight, *, room_is_checked: bool = False
) -> ImagingChain:
    """Return the imaging chain of pixels of any pitch and registration.

    light : prepared for their spectral response, or not yet. Automatic exposure is metered on the
        picture that stands still, without samples that stand alone far above all others
    room_is_checked : nothing of this chain is shown, or another one with the same dots had room for
        the motion

    Raises PixsimError if the picture moves farther than the part that is scored leaves room for.
    """
    scene = light if isinstance(light, PreparedScene) else prepare_scene(imaging, light)
    physics = imaging.physics
    exposure = imaging.exposure
    signal, collections = array_signal(scene.lights, scene.sample_pitch_um, physics, scene.array_um)
    metered = signal
    if scene.metering_light is not None and not exposure.is_manual:
        metered, _ = array_signal(
            scene.metering_light, scene.sample_pitch_um, physics, scene.array_um
        )
    brightest_e_per_s = float(metered.max())
    if exposure.gain_db == "auto":
        exposure = with_metered_gain(exposure, imaging.readout, brightest_e_per_s)
        imaging = imaging.changed(exposure=exposure)
    if scene.metering_light is not None and exposure.integration_s is None:
        exposure = with_shared_time(
            exposure, integration_time_s(exposure, imaging.readout, brightest_e_per_s)
        )
    still = _standing(imaging, scene, exposure, signal, collections)
    return _moved(still, room_is_checked) if any(imaging.um_per_s) else still


def chain_of_frames(
    imaging: Imaging, scene: PreparedScene, exposure: Exposure, shape: tuple[int, int]
) -> ImagingChain:
    """Return the imaging chain for frames (rows, columns) that are known, without the light behind
    them.

    exposure : of the settings, with the time of the frames
    """
    pixels = centred_pixels(scene.array_um, imaging.physics)
    collections = collections_of(
        imaging.physics, [channel.illumination for channel in scene.lights], pixels
    )
    return _standing(imaging, scene, exposure, np.broadcast_to(0.0, shape), collections)


def _standing(
    imaging: Imaging,
    scene: PreparedScene,
    exposure: Exposure,
    signal: Array,
    collections: Sequence[Collection],
) -> ImagingChain:
    """Return the chain of light that stands still."""
    physics = imaging.physics
    colour_chart = scene.colour_chart
    _check_whole_cell(physics, signal.shape)

    collection: Collection | ColourCollection | None = collections[0] if collections else None
    if collections and colour_chart is not None:
        collection = scene.collection(physics, collections)
        whites = tuple(collection.white_e_per_s.tolist())
        colour_chart = colour_chart.mixed_by(collection.mixing_um2, np.array(collection.rates))
    else:
        whites = scene.whites_e_per_s(physics)

    background = None
    if scene.facts is not None and scene.facts.background is not None:
        background, _ = array_signal(
            scene.facts.background, scene.sample_pitch_um, physics, scene.array_um
        )
    return ImagingChain(
        imaging,
        imaging.readout,
        exposure,
        signal,
        whites,
        scene.screen,
        collection,
        colour_chart,
        scene,
        background,
    )


def _moved(still: ImagingChain, room_is_checked: bool) -> ImagingChain:
    """Return the chain of light that moves, from the chain of the same light that stands still."""
    imaging = still.imaging
    scene = still.scene
    assert scene is not None
    image_motion, exposure = metered_motion(
        still.signal_e_per_s, still.readout, still.exposure, imaging.um_per_s
    )
    still = replace(still, exposure=exposure)
    if not room_is_checked:
        _check_room(still, image_motion)

    pixels = scene.sample_pitch_um, imaging.physics, scene.array_um, image_motion
    signal, subexposures = moved_signals(scene.lights, *pixels, exposure.frames)
    background = None
    if (
        still.background_e_per_s is not None
        and scene.facts is not None
        and scene.facts.background is not None
    ):
        background, _ = array_signal(scene.facts.background, *pixels)
    return replace(
        still,
        signal_e_per_s=signal,
        background_e_per_s=background,
        image_motion=image_motion,
        subexposures_e_per_s=subexposures,
    )


def _check_room(chain: ImagingChain, image_motion: ImageMotion) -> None:
    """Raise PixsimError if light from beyond the picture moves into the part of it that is
    scored.
    """
    screen = chain.screen
    physics = chain.readout.physics
    assert chain.scene is not None
    is_one_to_one = screen.display.raster == "one_to_one"
    border_um = 0.0 if is_one_to_one else physics.border_um
    row_count = chain.scene.array_um[0] / physics.read_pitch_um
    for axis, (edges, size_um) in enumerate(zip(screen.dot_edges_um, screen.size_um, strict=True)):
        # The path of a row, and how far the last row is read after the first.
        needed_um = (
            abs(image_motion.path_um[axis]) + abs(image_motion.row_um[axis]) * row_count
        ) / 2
        margin_um = max(0.0, min(float(edges[0]), size_um - float(edges[-1])) - border_um)
        if needed_um <= margin_um * (1 + ROUNDING):
            continue

        time = exposure_time(chain.exposure.integration_s or 0)
        got = f"a path of {2 * needed_um:.4g} µm on the sensor in {time}"
        allowed = (
            f"at most {2 * margin_um:.4g} µm, twice the margin on each side of the scored area"
        )
        slower = f"slow it down ({', '.join(VELOCITIES)})"
        hint = (
            f"Raise {setting('motion.margin_um')}, shorten"
            f" {setting('exposure.max_integration_s')}, or {slower}."
        )
        if is_one_to_one:
            hint = (
                "With display.raster = 'one_to_one' all pixels are scored; use 'fixed_size', or"
                " {slower}."
            )
        raise invalid("motion", got, allowed, hint)


def _check_whole_cell(physics: PixelPhysics, shape: tuple[int, ...]) -> None:
    """Raise PixsimError if a frame (rows, columns) is smaller than the unit cell of its mosaic."""
    layout = physics.layout
    if layout is None:
        return
    cell_rows, cell_columns = layout.period
    rows, columns = shape
    if rows < cell_rows or columns < cell_columns:
        side = physics.pixel.bin_side
        binned = f" after binning of {side} × {side}" if side > 1 else ""
        got = f"{physics.pitch_um:g}, which leaves {rows} × {columns} pixels on the die{binned}"
        cell_size = f"{cell_rows} × {cell_columns}"
        allowed = f"at least the unit cell {', '.join(layout.cell)} of {cell_size} pixels"
        raise invalid("pixel.pitch_um", got, allowed, "Choose smaller pixels or a larger die.")
