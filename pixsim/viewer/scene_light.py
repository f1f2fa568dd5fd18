"""The light behind the lens, which pixels of one spectral response share, with the screens for its
frames, and caches of both.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.errors import invalid
from pixsim.base.hashes import content_hash
from pixsim.base.lazy import cached_property
from pixsim.light.spectral import SpectralImage, without_outliers
from pixsim.optics.camera import Camera
from pixsim.sensor.collection import Collection, ColourCollection, collected_area_um2
from pixsim.sensor.colour import Layout
from pixsim.sensor.integration import ChannelLight, array_size_um, electrons_per_joule, lights_of
from pixsim.sensor.pixel import PixelPhysics
from pixsim.viewer import display as displays
from pixsim.viewer.causes import lightness_range
from pixsim.viewer.develop import ColourChart
from pixsim.viewer.display_options import Display
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.metric_kernels.information_density import radial_spectrum
from pixsim.viewer.screen import (
    HEADER_OF_WHITE,
    ROUNDING,
    IdealFacts,
    Screen,
    colour_chart_of,
    ideal_facts,
    make_screen,
)

T = TypeVar("T")
SCENE_CACHE_BYTES = 1 << 28  # memory for prepared scenes
_CACHED_TABLES = 32  # of some pixel sizes
_RECENT = (
    4  # prepared scenes, and lights behind the lens; each has some 20 MB at 1024 samples across
)


@dataclass(frozen=True)
class SceneLight:
    """The light on a sensor, with and without a target.

    irradiance : on the sensor plane, before diffraction
    background : irradiance of the scene without its target, on the same samples, or None where no
        metric asks for it
    """

    irradiance: SpectralImage
    background: SpectralImage | None = None

    def check(self) -> None:
        """Raise PixsimError for light that is negative or not finite, and for a background with
        other samples.
        """
        self.irradiance.validate()
        if self.background is not None:
            check_background(self.background, self.irradiance)


def check_background(background: SpectralImage, irradiance: SpectralImage) -> None:
    """Raise PixsimError if light without a target cannot be compared with light with it, sample by
    sample.
    """
    background.validate()
    rows, columns = irradiance.shape
    is_same_pitch = math.isclose(background.pitch_um, irradiance.pitch_um, rel_tol=ROUNDING)
    if background.shape != (rows, columns) or not is_same_pitch:
        got, allowed = (
            f"{image.shape[0]} × {image.shape[1]} samples of {image.pitch_um:g} µm"
            for image in (background, irradiance)
        )
        raise invalid("without", got, f"the samples of the light with the target, {allowed}")


@dataclass(frozen=True)
class LightFacts:
    """Light of a scene for metrics that need more than the picture.

    mean : of all samples, a picture of 1 × 1 with the header of the whole one
    picture : behind the lens, as the first channel sees it, (H, W)
    background : light behind the lens of the scene without its target, for each channel. None:
        there is none
    """

    mean: SpectralImage
    picture: Array = field(repr=False)
    background: tuple[ChannelLight, ...] | None = None
    _cached: dict[Hashable, Any] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    def cached(self, key: Hashable, compute: Callable[[], T]) -> T:
        """Return a value that the frames of a pixel share, computed once; the oldest is dropped
        where there are too many.
        """
        if key in self._cached:
            cached: T = self._cached[key]
            return cached
        value = compute()
        # Several threads may do so.
        for oldest in list(self._cached)[: max(0, len(self._cached) + 1 - _CACHED_TABLES)]:
            self._cached.pop(oldest, None)
        self._cached[key] = value
        return value

    @classmethod
    def of(cls, imaging: Imaging, light: SceneLight, picture: Array) -> LightFacts:
        """Return the record of a light.

        picture : as in the field
        """
        irradiance = light.irradiance
        mean = SpectralImage(
            irradiance.wavelength_nm,
            irradiance.band_width_nm,
            irradiance.pitch_um,
            data=irradiance.mean_spectrum().astype(np.float32)[None, None],
            header=irradiance.header,
        )
        background = None
        if light.background is not None:
            background = lights_of(light.background, imaging.camera, imaging.physics)
        return cls(mean, picture, background)

    @cached_property
    def spectrum(self) -> tuple[Array, Array]:
        """Radially averaged power spectrum of the picture over its squared mean: cycles/mm, and
        mm².
        """
        # A black picture has no power: any mean will do.
        mean = float(self.picture.mean(dtype=float)) or 1.0
        frequency, power = radial_spectrum(self.picture / mean, self.mean.pitch_um)
        return frequency, power


@dataclass(frozen=True)
class PreparedScene:
    """The light behind the lens, and the screens, for pixels of one spectral response and any
    pitch.

    lights : behind the diffracting lens, as each channel sees it
    whites_e_per_s_um2 : of the scene's white, on axis, in each channel
    screens : one for each display that shows the frames
    array_um : (height, width) that the pixels fill
    beyond_white : fraction of the ideal image's dots that are brighter than display white
    colour_chart : what the channels respond to its patches, or None for a monochrome sensor
    metering_light : light of each channel without samples that stand alone far above all others,
        which sets the automatic exposure. None: all light does
    facts : of the light, for metrics, or None if none asks
    """

    lights: tuple[ChannelLight, ...]
    sample_pitch_um: float
    whites_e_per_s_um2: tuple[float, ...]
    screens: tuple[Screen, ...]
    array_um: tuple[float, float]
    beyond_white: float = 0.0
    colour_chart: ColourChart | None = None
    metering_light: tuple[ChannelLight, ...] | None = None
    facts: LightFacts | None = None
    _collections: list[ColourCollection] = field(
        default_factory=list, init=False, repr=False, compare=False
    )

    @property
    def screen(self) -> Screen:
        """The first of the screens."""
        return self.screens[0]

    @property
    def rate_e_per_s_um2(self) -> Array:
        """Light of the first channel, the only one of a monochrome sensor, (H, W)."""
        return self.lights[0].rate_e_per_s_um2

    def whites_e_per_s(self, physics: PixelPhysics) -> tuple[float, ...]:
        """Return the electrons per second of the scene's white in a value of each channel on axis,
        without crosstalk of colours.
        """
        count = physics.pixel.bin_side**2
        whites = []
        for white, light, channel in zip(
            self.whites_e_per_s_um2, self.lights, physics.channels, strict=True
        ):
            whites.append(white * collected_area_um2(channel, light.illumination) * count)
        return tuple(whites)

    def collection(
        self, physics: PixelPhysics, collections: Sequence[Collection]
    ) -> ColourCollection:
        """Return the collection of the pixels of a colour sensor with a stack."""
        layout = Layout.unbinned(physics.pixel)
        assert layout is not None
        # The registrations of a pitch, which follow one another, share what is expensive of it.
        for cached in tuple(self._collections):
            if all(map(operator.is_, cached.collections, collections)):
                return cached
        collection = ColourCollection(
            layout,
            tuple(collections),
            self.whites_e_per_s_um2,
            physics.pitch_um,
            physics.pixel.bin_side,
        )
        self._collections[:] = [collection]
        return collection

    def store_integrals(self) -> None:
        """Compute the running integrals that all pitches share, before workers need them."""
        lights = list(self.lights)
        if self.facts is not None and self.facts.background is not None:
            lights += self.facts.background
        for light in lights:
            light.running_integral  # noqa: B018 – it stays in the light


# Light that the pitches of a technology share; where dots are pixels, it is not prepared.
SharedLight = PreparedScene | SceneLight


def registered_in(imaging: Imaging, light: SharedLight, repeat: int) -> Imaging:
    """Return settings with the registration of one repeat (`Imaging.registered`) in the light that
    all repeats share.
    """
    return imaging.registered(repeat, light.array_um if isinstance(light, PreparedScene) else None)


def prepare_scene(
    imaging: Imaging,
    light: SceneLight,
    *,
    lights: tuple[ChannelLight, ...] | None = None,
    others: Sequence[Display] = (),
) -> PreparedScene:
    """Return the light behind the lens and the screens. They depend on the pitch only if the raster
    is one_to_one.

    lights : behind the lens, where they are known, for example for a part of a picture whose blur
        depends on its place
    others : further displays, with other dots or seen from elsewhere

    Raises PixsimError if the irradiance is negative or not finite, or the background has other
    samples.
    """
    light.check()
    irradiance = light.irradiance
    camera = imaging.camera
    physics = imaging.physics
    colour_chart = colour_chart_of(imaging, irradiance)

    # Displays that differ in their viewer alone share the ideal picture.
    screen, beyond_white = make_screen(imaging, irradiance, colour_chart)
    screen_by_dots = {imaging.display.dots: screen}
    screens = [screen]
    for display in others:
        if display.dots not in screen_by_dots:
            other = imaging.changed(display=display)
            screen_by_dots[display.dots], _ = make_screen(other, irradiance, colour_chart)
        screens.append(screen_by_dots[display.dots].seen_at(display.samples_per_deg))

    if lights is None:
        lights = lights_of(irradiance, camera, physics)
    if imaging.without_shortcuts:  # nothing of the pixels' stack is left out
        lights = tuple(
            replace(channel, illumination=replace(channel.illumination, tolerance=0.0))
            for channel in lights
        )
    whites = tuple(
        displays.white_rate(imaging, irradiance, channel) for channel in physics.channels
    )
    metering = without_outliers(irradiance)
    facts = None
    if imaging.metrics.needs_light:
        facts = LightFacts.of(imaging, light, lights[0].rate_e_per_s_um2)
    return PreparedScene(
        lights,
        irradiance.pitch_um,
        whites,
        tuple(screens),
        array_size_um(irradiance, camera),
        beyond_white,
        colour_chart,
        metering_light=None if metering is None else lights_of(metering, camera, physics),
        facts=facts,
    )


class SceneCache:
    """Prepared scenes of one light, camera and display, made on first use and stored while memory
    allows.

    imaging : settings of the first pixels; others that share the cache differ in their pixels and
        border
    channels : of the pixels, the most of those that share the cache
    others : displays on which frames are shown, too
    """

    def __init__(
        self, imaging: Imaging, light: SceneLight, channels: int = 1, others: Sequence[Display] = ()
    ) -> None:
        self.imaging = imaging
        self.light = light
        self.channels = channels
        self.others = tuple(others)
        self._scenes: dict[object, PreparedScene] = {}
        self._facts: dict[object, IdealFacts] = {}

    @property
    def irradiance(self) -> SpectralImage:
        """Light on the sensor, before diffraction."""
        return self.light.irradiance

    @property
    def camera(self) -> Camera:
        """Camera of all pixels."""
        return self.imaging.camera

    @property
    def display(self) -> Display:
        """First display of all frames."""
        return self.imaging.display

    def get(self, key: object, imaging: Imaging) -> SharedLight:
        """Return the prepared scene of pixels, whose key stands for their spectral response and
        border.
        """
        if self.display.raster == "one_to_one":
            return self.light
        scene = self._scenes.get(key)
        if scene is None:
            if len(self._scenes) >= self.capacity:
                self._scenes.clear()
            scene = prepare_scene(imaging, self.light, others=self.others)
            self._scenes[key] = scene
            self._facts[key] = IdealFacts(scene.beyond_white, lightness_range(scene.screen.ideal))
        return scene

    def ideal_facts(self, key: object, imaging: Imaging) -> IdealFacts:
        """Return the `IdealFacts` for the key of `get`; where dots are pixels, of these pixels."""
        if key in self._facts and self.display.raster != "one_to_one":
            return self._facts[key]
        return ideal_facts(imaging, self.irradiance)

    @cached_property
    def content(self) -> str:
        """Hash of the light, whose header states everything that it depends on, and of the
        camera.
        """
        background = [] if self.light.background is None else [self.light.background.header]
        return content_hash([self.irradiance.header, self.camera.model_dump(), *background])

    def clear(self) -> None:
        """Drop all prepared scenes; they are made again when needed."""
        self._scenes.clear()

    @property
    def capacity(self) -> int:
        """Number of prepared scenes that are stored at once."""
        # For each channel light and spline; ideal image, its CIELAB.
        samples = 2 * self.channels * math.prod(self.irradiance.shape)
        dots = sum(display.dots**2 for display in (self.display, *self.others))
        planes_a_dot = 4 if self.channels == 1 else 6
        return max(1, SCENE_CACHE_BYTES // (8 * (samples + planes_a_dot * dots)))


class RecentScenes:
    """`prepare_scene` with a cache of the last few scenes and lights behind the lens."""

    def __init__(self) -> None:
        self._lights: dict[Hashable, tuple[SpectralImage, tuple[ChannelLight, ...]]] = {}
        self._scenes: dict[Hashable, tuple[SpectralImage, PreparedScene]] = {}

    def __call__(self, imaging: Imaging, light: SceneLight) -> PreparedScene:
        """Return the prepared scene, from the cache if nothing differs that it depends on."""
        irradiance = light.irradiance
        pixel = imaging.pixel
        physics = imaging.physics

        # What the light behind the lens depends on.
        electrons = tuple(
            electrons_per_joule(channel, irradiance).tobytes() for channel in physics.channels
        )
        records = [
            imaging.camera.model_dump(mode="json"),
            pixel.stack and pixel.stack.model_dump(mode="json"),
            str(Layout.unbinned(pixel)),
            physics.charge.content_hash if physics.charge else "",
        ]
        light_key = id(irradiance), content_hash(records), electrons

        # What the screen depends on besides.
        geometry = physics.read_pitch_um, imaging.scored_border_um, physics.registration
        screen = (
            imaging.display.content_hash,
            imaging.develop.content_hash,
            imaging.without_shortcuts,
            imaging.in_float32,
            tuple(irradiance.header.get(name) for name in HEADER_OF_WHITE.values()),
        )
        key = light_key, geometry, screen, imaging.metrics.needs_light, id(light.background)
        if key not in self._scenes:
            if light_key not in self._lights:
                lights = lights_of(irradiance, imaging.camera, physics)
                _add_recent(self._lights, light_key, (irradiance, lights))
            _, lights = self._lights[light_key]
            scene = prepare_scene(imaging, light, lights=lights)
            _add_recent(self._scenes, key, (irradiance, scene))
        return self._scenes[key][1]

    def drop_all_but(self, images: list[SpectralImage]) -> None:
        """Drop scenes and lights that were made from other images than these."""
        for recent in (self._lights, self._scenes):
            for key, (image, _) in list(recent.items()):
                if not any(image is other for other in images):
                    del recent[key]


def _add_recent(recent: dict[Hashable, T], key: Hashable, value: T) -> None:
    """Add an entry, and drop the oldest if there are too many."""
    while len(recent) >= _RECENT:
        del recent[next(iter(recent))]
    recent[key] = value
