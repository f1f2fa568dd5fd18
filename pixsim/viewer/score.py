"""The imaging chain from irradiance to ΔE: irradiance + camera + pixel → frame, shown images and ΔE map."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import product
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, TypeVar

import numpy as np
from scipy.special import gammaincinv, gammaln, ndtr, ndtri

from pixsim.base.arguments import Bounds, NotNegative, Whole, checks_arguments, checks_fields, made
from pixsim.base.arrays import Array, stream
from pixsim.base.caller import setting
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.notes import warn
from pixsim.base.records import Record, content_hash
from pixsim.light.spectral import DIFFUSER, DIFFUSER_W, LEAST_LM_PER_W, WHITE_RADIANCE, SpectralImage, without_outliers
from pixsim.optics.camera import Camera
from pixsim.optics.camera_lens import ideal_light
from pixsim.sensor.collection import Collection, ColourCollection, collected_area_um2, collections_of, shading_of
from pixsim.sensor.colour import Layout, of_channels
from pixsim.sensor.correction import correct
from pixsim.sensor.correction_options import NO_CORRECTION, Correction
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.infrared import warn_of_light
from pixsim.sensor.integration import (
    ChannelLight,
    array_signal,
    array_size_um,
    centred_pixels,
    electrons_per_joule,
    lights_of,
    moved_signals,
)
from pixsim.sensor.motion import STANDING, Moving, border_with_room_um, velocity_um_per_s
from pixsim.sensor.motion_options import STILL, VELOCITIES, Motion
from pixsim.sensor.noise import variance_e2
from pixsim.sensor.pixel import PixelPhysics, derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.readout import (
    MAX_BLACK,
    Frame,
    Sensor,
    capture_from_rates,
    dark_spread_e,
    integration_time_s,
    lasting,
    least_black_level_dn,
    make_frame,
    metered_motion,
    sample_sensor,
)
from pixsim.sensor.unit_slips import warn_of_unit_slips
from pixsim.show.document import pairs
from pixsim.show.figures import new_figure, own_style
from pixsim.show.pages import rows_csv
from pixsim.show.pictures import VIEWING_GAMMA, scale_end
from pixsim.show.render import cell_of
from pixsim.show.sentences import rounded, sentence, settings_line
from pixsim.viewer import display as displays
from pixsim.viewer.causes import causes_of, lightness_range
from pixsim.viewer.colour_matrix import metamerism_index
from pixsim.viewer.develop import Rendition, ideal_rgb, rendition_of
from pixsim.viewer.develop_options import DEVELOP, Develop, check_develop
from pixsim.viewer.develop_steps import Developing, developed_planes, light_of_dots, noise_covariance
from pixsim.viewer.display_options import Display
from pixsim.viewer.judged import DELTA_E_ONLY, Judged, Judging, frame_statistics, numbers_of
from pixsim.viewer.judges.information_density import radial_spectrum
from pixsim.viewer.light_error import NOTHING_KNOWN, LightError
from pixsim.viewer.metric_options import METRIC_OPTIONS, MetricOptions
from pixsim.viewer.metrics import (
    DELTA_E,
    Metric,
    MetricContext,
    NoNumberError,
    columns_with_numbers,
    delta_e_statistics,
    percentiles,
)
from pixsim.viewer.raw_metrics import OF_TARGETS, has_target, moments_of_codes
from pixsim.viewer.scielab import (
    SINGLE_DELTA_E,
    colour_delta_e_map,
    delta_e,
    filtered_grey_lab,
    filtered_lab,
    grey_delta_e_map,
    xyz_to_lab,
)
from pixsim.viewer.sharpening import noise_gain
from pixsim.viewer.tone import luminance_of, toned
from pixsim.viewer.unused import Configuration, warn_of_unused_settings

if TYPE_CHECKING:
    from matplotlib.figure import Figure


NO_VELOCITY = 0.0, 0.0
T = TypeVar("T")
S = TypeVar("S", bound="Score")
NumberOrNone = Annotated[float, Bounds(unknown=True)]
CLIPPED_WARNING = 0.01
ROUNDING = 1e-6  # of white, in the luminance of a dot
MIN_RADIUS_PX, MAX_RADIUS_PX = 0.1, 100.0  # of the blur of sharpening
PHASES_PX = (-1 / 3, 0.0, 1 / 3)  # of dots on pixels
DOTS_OF_PATCH, LEAST_PATCH, MOST_PATCH = 48, 96, 256  # of even frames that tell of noise: dots across, and pixels
PANEL_IN = 3.1  # width of each picture of a figure
SCENE_CACHE_BYTES = 1 << 28  # memory for prepared scenes
WHITE_PERCENTILE = 99.0  # of the ideal image of a scene whose white is unknown
WHITE_FROM = f"{WHITE_PERCENTILE:g}th percentile of the ideal image"
WHITE_DIGITS = 2  # the noise of a render does not change a white rounded to two digits


@checks_fields
@dataclass(frozen=True)
class Score:
    """A picture as shown to a viewer, and its difference from the ideal one, by S-CIELAB and by further metrics.

    delta_e : (H, W) S-CIELAB difference on the display's dots, in the precision in which it was computed
    ideal, image : (H, W) shown luminance, 1 for white; in colour (H, W, 3), the light of the display's primaries
    display : that shows them
    metrics : numbers of the metrics that were asked for, each by its first column: {"delta_e": mean ΔE, …}; NaN of one that has
        none for this frame
    further : their other numbers, by columns
    """

    delta_e: Array = field(repr=False)
    ideal: Array = field(repr=False)
    image: Array = field(repr=False)
    display: Display = field(repr=False)
    metrics: dict[str, NumberOrNone] = field(default_factory=dict, kw_only=True)
    further: dict[str, NumberOrNone] = field(default_factory=dict, kw_only=True, repr=False)
    _scored: dict[str, Any] | None = field(default=None, kw_only=True, repr=False, compare=False)

    def __post_init__(self) -> None:
        own: dict[str, Any] = {"delta_e": self.delta_e, "ideal": self.ideal, "image": self.image, "display": self.display}
        for name, old in (self._scored or {}).items():
            if own[name] is not old and not np.array_equal(own[name], old):  # equal after a journey to a worker
                got = f"another {name} in a Score, whose numbers would be those of the old one"
                hint = "Score other pictures: pixsim.score_pictures(score.ideal, image, score.display)."
                raise invalid(name, got, f"the {name} that was scored", hint)
        object.__setattr__(self, "_scored", own)

    @property
    def mean_delta_e(self) -> float:
        """Mean ΔE over all dots, which a study minimises."""
        return float(self.delta_e.mean(dtype=float))

    def statistics(self) -> dict[str, float]:
        """Return the numbers of a row, with the unit in each name."""
        return dict(zip(DELTA_E.columns, delta_e_statistics(self.delta_e), strict=True)) | self.further

    @own_style()
    def plot(self) -> Figure:
        """Return a Matplotlib figure of the ideal image, the sensor's image and the ΔE map with its scale."""
        figure = new_figure(3 * PANEL_IN + 0.6, PANEL_IN + 0.3)
        axes = figure.subplots(1, 3, sharex=True, sharey=True)
        for panel, picture, title in zip(axes, (self.ideal, self.image), ("ideal", "sensor"), strict=False):
            panel.imshow(np.clip(picture, 0, 1) ** (1 / VIEWING_GAMMA), cmap="gray", vmin=0, vmax=1, interpolation="nearest")
            panel.set_title(title)
        end = scale_end(*percentiles(self.delta_e, (99,)))
        delta_e_map = axes[2].imshow(self.delta_e, cmap="viridis", vmin=0, vmax=end, interpolation="nearest")
        axes[2].set_title(f"S-CIELAB ΔE, mean {self.mean_delta_e:.3f}")
        figure.colorbar(delta_e_map, ax=axes[2], label="ΔE", extend="max", shrink=0.85)
        for panel in axes:
            panel.set_xlabel("display dots")
        return figure

    @checks_arguments
    def to_csv(self, path: str | os.PathLike[str] | None = None) -> str:
        """Return `statistics` as CSV, and write it to `path` if given."""
        return rows_csv([self.statistics()], path)

    def _repr_html_(self) -> str:
        return cell_of(f"mean ΔE {self.mean_delta_e:.3f}", self.plot(), pairs("statistics", self.statistics(), ".6g"))

    def __repr__(self) -> str:
        return f"<Score mean ΔE {self.mean_delta_e:.4f}, {' × '.join(map(str, self.delta_e.shape))} dots>"


@checks_fields
@dataclass(frozen=True)
class FrameScore(Score):
    """The score of a sensor's frame.

    frame : the sensor frame that the image shows
    physics : of the pixel
    border_um : (above and below, left and right) width of the border that is neither shown nor scored
    out_of_gamut : share of the dots of the ideal image and of the image whose colour the display cannot show; None for grey ones
    light : what is known of the errors of its light
    """

    frame: Frame = field(repr=False, kw_only=True)
    physics: PixelPhysics = field(repr=False, kw_only=True)
    border_um: tuple[NotNegative, NotNegative] = field(default=(0.0, 0.0), kw_only=True)
    out_of_gamut: tuple[float, float] | None = field(default=None, kw_only=True)
    light: LightError = field(default=NOTHING_KNOWN, repr=False, kw_only=True)

    @property
    def gamut(self) -> dict[str, float]:
        """Shares of dots out of the display's gamut, as in score.json; empty for grey pictures."""
        names = "ideal_out_of_gamut_fraction", "out_of_gamut_fraction"
        return {} if self.out_of_gamut is None else dict(zip(names, self.out_of_gamut, strict=True))

    def statistics(self) -> dict[str, float]:
        """Return the numbers of score.json, with the unit in each name."""
        return frame_statistics(self.physics, self.frame) | super().statistics() | self.gamut

    def _repr_html_(self) -> str:
        title = f"{self.physics.pitch_um:g} µm pixels, mean ΔE {self.light.shown(self.mean_delta_e)}"
        given = self.physics.pixel.model_dump(exclude_unset=True, exclude_none=True)
        notes = [
            "One frame of one sensor: how much others differ is told by pixsim.study, whose means have 95 % intervals.",
            f"Pixel: {settings_line(given)}; all else is the default.",
            *(sentence(str(cause)) for cause in self.light.causes),
            *(f"Not converged: {reason}." for _, reason in self.light.errors),
            *([f"Light: {missing}; pixsim run and pixsim.study measure both."] if (missing := self.light.unmeasured) else []),
        ]
        return cell_of(title, self.plot(), pairs("statistics", self.statistics(), ".6g"), *notes)

    def __repr__(self) -> str:
        words = [f"{self.physics.pitch_um:g} µm pixels, {1e3 * self.frame.integration_s:.3g} ms", self.light.unmeasured]
        return f"<Score mean ΔE {self.light.shown(self.mean_delta_e)}, {'; '.join(filter(None, words))}>"


@dataclass(frozen=True)
class LightFacts:
    """What metrics know of the light of a scene beside the picture.

    mean : of all samples, a picture of 1 × 1 with the header of the whole one
    camera : with which it was rendered
    picture : behind the lens, as the first channel sees it, (H, W)
    without : light behind the lens of the scene without its target, for each channel; None: there is none
    """

    mean: SpectralImage
    camera: Camera
    picture: Array = field(repr=False)
    without: tuple[ChannelLight, ...] | None = None
    _kept: dict[Hashable, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    def kept(self, key: Hashable, compute: Callable[[], T]) -> T:
        """Return what the frames of a pixel share, from before or computed; it is dropped where others took its place."""
        if key not in self._kept:
            while len(self._kept) >= KEPT_OF_PIXELS:
                self._kept.pop(next(iter(self._kept)), None)
            self._kept[key] = compute()
        found: T = self._kept[key]
        return found

    @classmethod
    def of(
        cls, irradiance: SpectralImage, camera: Camera, physics: PixelPhysics, without: SpectralImage | None, picture: Array
    ) -> LightFacts:
        """Return those of the irradiance of a picture."""
        mean = SpectralImage(
            irradiance.wavelength_nm,
            irradiance.band_width_nm,
            irradiance.pitch_um,
            data=irradiance.mean_spectrum().astype(np.float32)[None, None],
            header=irradiance.header,
        )
        of_without = None if without is None else lights_of(without, camera, physics)
        return cls(mean, camera, picture, of_without)

    @cached_property
    def spectrum(self) -> tuple[Array, Array]:
        """Power spectrum of the picture over its squared mean, as of `radial_spectrum`: cycles/mm, and mm²."""
        mean = float(self.picture.mean(dtype=float)) or 1.0  # of a black picture, which has no power
        frequency, power = radial_spectrum(self.picture / mean, self.mean.pitch_um)
        return frequency, power


def allows_single(tolerance_delta_e: float | None) -> bool:
    """Return whether a study may compute dots and S-CIELAB in float32, whose error of a mean ΔE is below `SINGLE_DELTA_E`."""
    return tolerance_delta_e is None or tolerance_delta_e >= SINGLE_DELTA_E


def perceived_lab(shown: Array, display: Display, full: bool = False, single: bool = False) -> Array:
    """Return the CIELAB of a shown image after the eye's blur, (H, W, 3); `full` computes a grey one as a colour image.

    shown : (H, W) luminance, or (H, W, 3) light of the display's primaries
    single : as of `filtered_lab`
    """
    view = viewing_conditions(display) | {"single": single}
    if shown.ndim == 3:
        return filtered_lab(displays.rgb_to_xyz(shown.astype(np.float32, copy=False) if single else shown), **view)
    return filtered_lab(displays.to_xyz(shown), **view) if full else filtered_grey_lab(shown, **view)


def viewing_conditions(display: Display) -> dict[str, Any]:
    """Return the S-CIELAB arguments for a display."""
    return {"white_xyz": displays.WHITE_XYZ, "samples_per_deg": display.samples_per_deg, "filters": display.filters}


@dataclass(frozen=True)
class Screen:
    """A display, the part of the die that it shows, and the ideal image of that part.

    size_um : (height, width) of the whole picture on the sensor
    dot_edges_um : of the rows and columns of dots that are shown and scored
    ideal, ideal_lab : shown light on those dots, as of `Score`, and its CIELAB after the eye's blur
    full : use no shortcut for grey images
    single : compute the dots of frames and S-CIELAB in float32
    ideal_out_of_gamut : of `Score.out_of_gamut`
    """

    display: Display
    size_um: tuple[float, float]
    dot_edges_um: tuple[Array, Array] = field(repr=False)
    ideal: Array = field(repr=False)
    ideal_lab: Array = field(repr=False)
    full: bool = False
    single: bool = False
    ideal_out_of_gamut: float = 0.0

    @property
    def dot_um(self) -> float | None:
        """Side of a dot on the sensor; None if dots are pixels."""
        return self.size_um[1] / self.display.dots if self.display.raster == "fixed_size" else None

    def seen_at(self, samples_per_deg: float) -> Screen:
        """Return the same dots, as seen from where so many of them make a degree."""
        if samples_per_deg == self.display.samples_per_deg:
            return self
        display = self.display.model_copy(update={"samples_per_deg": samples_per_deg})
        return replace(self, display=display, ideal_lab=perceived_lab(self.ideal, display, self.full, self.single))

    def delta_e_of(self, image: Array) -> Array:
        """Return the S-CIELAB difference between a shown picture and the ideal one, (H, W)."""
        if self.display.delta_e != "1976" or self.full:
            return delta_e(self.ideal_lab, perceived_lab(image, self.display, self.full, self.single), self.display.delta_e)
        view = viewing_conditions(self.display) | {"single": self.single}
        if image.ndim == 2:
            return grey_delta_e_map(self.ideal_lab, image, **view)
        return colour_delta_e_map(
            self.ideal_lab, displays.rgb_to_xyz(image.astype(np.float32, copy=False) if self.single else image), **view
        )


@dataclass(frozen=True)
class ImagingChain:
    """Everything that the frames of one pixel type share: its mean signal, exposure and screen.

    signal_e_per_s : of every value of a frame
    physics : of what is read, at the gain of the exposure
    whites_e_per_s : electrons per second of the scene's white, on axis, in each channel
    collection : what the pixels' stack does to their light; None without a stack
    rendition : what the channels see of a chart; None for a monochrome sensor
    made_from : the light and the pixel, before it is read; None for a chain that stays in memory
    without_e_per_s : the signal of the scene without its target; None if no metric asks
    um_per_s : velocity [x, y] of the image on the sensor
    moving : how the light moves in a frame, whose time the exposure states then
    each_e_per_s : the signal in each exposure of a burst, if they differ; else none
    """

    signal_e_per_s: Array
    physics: PixelPhysics
    exposure: Exposure
    whites_e_per_s: tuple[float, ...]
    screen: Screen
    correction: Correction = NO_CORRECTION
    collection: Collection | ColourCollection | None = None
    develop: Develop = DEVELOP
    rendition: Rendition | None = None
    made_from: tuple[PreparedScene, PixelPhysics] | None = None
    without_e_per_s: Array | None = None
    um_per_s: tuple[float, float] = NO_VELOCITY
    moving: Moving = STANDING
    each_e_per_s: tuple[Array, ...] = ()

    @property
    def facts(self) -> LightFacts:
        """What metrics know of the light."""
        assert self.made_from is not None
        assert self.made_from[0].facts is not None
        return self.made_from[0].facts

    @property
    def pixel_key(self) -> tuple[str, ...]:
        """What tells the pixels of the chain from others in the same light, wherever the array lies."""
        pixel = self.physics.pixel.model_copy(update={"registration": None})
        return pixel.content_hash, content_hash(self.physics.technology.content)

    def registered(self, number: int) -> ImagingChain:
        """Return the chain of the same pixels at another registration, of `PixelPhysics.registered`."""
        assert self.made_from is not None
        light, physics = self.made_from
        moved = replace(physics, pixel=physics.pixel.model_copy(update={"registration": None})).registered(number)
        # What is read at other places is not shown, so the room that this chain's dots have is all that motion needs.
        return chain_at_pitch(light, moved, self.exposure, self.correction, self.develop, self.um_per_s, room_is_checked=True)

    @property
    def white_e_per_s(self) -> float:
        """Electrons per second of the scene's white on axis, in the mean over the channels' pixels."""
        return mean_white(self.physics, self.whites_e_per_s)

    @cached_property
    def even(self) -> Array | None:
        """What each pixel collects of even light, relative to one on axis, (rows, columns); None without a stack."""
        return None if self.collection is None else self.collection.relative(self.signal_e_per_s.shape)

    @cached_property
    def shading(self) -> Array | None:
        """By what the display divides a frame, as `shading_of`."""
        corrects = self.screen.display.shading_correction
        return shading_of(self.collection, self.signal_e_per_s.shape, self.correction) if corrects else None

    def simulate(self, *key: object) -> FrameScore:
        """Return the score of a new sensor and a new frame for each key."""
        return self.score_frame(self.capture(*key))

    def capture(self, *key: object, sensor_of: Callable[..., Sensor] | None = None) -> Frame:
        """Return the frame that `simulate` scores.

        sensor_of : returns the sensor of a key, which may be known; None draws it
        """
        frame_rng = stream(*key, "frame")  # before the sensor is drawn: later it would take three times as long
        return self.capture_by((sensor_of or self.sensor)(*key), frame_rng, partial(stream, *key, "correction"))

    def on(self, screen: Screen) -> ImagingChain:
        """Return the chain of the same frames on another screen."""
        return self if screen is self.screen else replace(self, screen=screen)

    def capture_with(
        self, sensor_rng: np.random.Generator, frame_rng: np.random.Generator, correction_rng: np.random.Generator
    ) -> Frame:
        """Return a frame whose fixed pattern, temporal noise and frames for its correction come from three generators."""
        sensor = sample_sensor(self.physics, self.signal_e_per_s.shape, sensor_rng)
        return self.capture_by(sensor, frame_rng, lambda: correction_rng)

    def capture_by(
        self, sensor: Sensor, frame_rng: np.random.Generator, make_correction_rng: Callable[[], np.random.Generator]
    ) -> Frame:
        """Return a frame of a sensor, whose temporal noise and frames for its correction come from two generators.

        make_correction_rng : makes the second one; it is called only if the camera corrects its frames
        """
        frame = self._taken(sensor, frame_rng)
        if not self.correction.is_on:
            return frame
        layout, whites = self.physics.layout, np.array(self.whites_e_per_s)
        levels = None if layout is None else of_channels(whites / whites.max(), layout, self.signal_e_per_s.shape)
        return correct(frame, sensor, self.correction, make_correction_rng(), self.even, levels)

    def further_frames(self, count: int, *key: object) -> Iterator[Frame]:
        """Yield frames 2, 3, … of the sensor of `capture`, whose frame is the first of `count`; they are not corrected.

        All have the fixed pattern and the exposure of the first. Each has temporal noise of its own, which depends on the key
        and the number of the frame only.
        """
        if count < 2:
            return
        sensor = self.sensor(*key)
        for number in range(2, count + 1):
            yield self._taken(sensor, stream(*key, "frame", number))

    def _taken(self, sensor: Sensor, rng: np.random.Generator) -> Frame:
        return capture_from_rates(self.signal_e_per_s, sensor, self.exposure, rng, self.each_e_per_s)

    def sensor(self, *key: object) -> Sensor:
        """Return the sensor of `capture`; it does not depend on the light."""
        return sample_sensor(self.physics, self.signal_e_per_s.shape, stream(*key, "sensor"))

    @cached_property
    def matrix(self) -> Array:
        """Matrix from balanced channels to the light of the display's primaries, (3, C); only for colour sensors.

        Raises PixsimError as `Rendition.matrix` does, with the pixel's pitch.
        """
        try:
            return self._fitted_matrix()
        except PixsimError as error:
            hint = "" if self.collection is None else " Light between neighbours counts: larger pixels mix the channels less."
            raise type(error)(f"pixels of {self.physics.read_pitch_um:g} µm: {error}{hint}") from None

    def _fitted_matrix(self) -> Array:
        assert self.rendition is not None
        if self.develop.matrix != "noise_aware":
            return self.rendition.matrix(self.develop)
        time_s = integration_time_s(self.exposure, self.physics, float(self.signal_e_per_s.max()))
        return self.rendition.matrix(self.develop, self.channel_covariance(time_s))

    def channel_covariance(self, integration_s: float) -> Array:
        """Return the covariance of the balanced channels on each patch of the chart, (P, C, C), as means over a dot.

        In closed form, or, of noise reduction that adapts to the picture, of simulated frames.
        """
        assert self.rendition is not None
        if self.develop.adapts:
            return self._covariance_of_frames(integration_s)
        empty = np.zeros(self.signal_e_per_s.shape, np.int32)
        exposure = lasting(self.exposure, integration_s)
        frame = make_frame(empty, 0.0, self.signal_e_per_s, self.physics, exposure)
        return noise_covariance(self.developing(frame, matrix=None), self.rendition.responses, self.screen.dot_um)

    def _covariance_of_frames(self, integration_s: float) -> Array:
        """Estimate `channel_covariance` by a frame of an even patch each, of a sensor of its own, without correction."""
        layout, screen, physics = self.physics.layout, self.screen, self.physics
        assert self.rendition is not None
        assert layout is not None
        pitch_um, cell = physics.read_pitch_um, max(layout.period)
        dot_um = screen.dot_um or pitch_um
        side = cell * math.ceil(min(max(DOTS_OF_PATCH * dot_um / pitch_um, LEAST_PATCH), MOST_PATCH) / cell)
        count = max(2, math.floor(side * pitch_um / dot_um) - 2)  # but those at the edges
        edges_um = side * pitch_um / 2 + (np.arange(count + 1.0) - count / 2) * min(dot_um, side * pitch_um / count)
        rates = np.maximum(self.rendition.responses, 0.0) * np.array(self.whites_e_per_s)
        exposure = lasting(self.exposure.steady, integration_s)
        whole = replace(self.screen, size_um=(side * pitch_um, side * pitch_um), dot_edges_um=(edges_um, edges_um))
        display = screen.display.model_copy(update={"dots": max(8, count)})  # decides on the order of the axes alone
        physics = replace(physics, pixel=physics.pixel.model_copy(update={"registration": None}))
        found = []
        for number, own in enumerate(rates):
            signal = of_channels(own, layout, (side * layout.planes, side))
            patch = replace(self, signal_e_per_s=signal, physics=physics, exposure=exposure, screen=whole, correction=NO_CORRECTION)
            key = "covariance of patches", number
            frame = patch.capture_with(stream(*key, "sensor"), stream(*key, "frame"), stream(*key, "correction"))
            planes = developed_planes(replace(patch.developing(frame, matrix=None), shading=None))
            each = []
            for at in product(PHASES_PX, repeat=2):  # in the mean over where the dots lie on the pixels
                places = [edges_um + phase * pitch_um for phase in at]
                own = whole.size_um, display, (places[0], places[1]), frame.registration
                dots = np.stack([displays.on_dots(plane, pitch_um, *own).ravel() for plane in planes])
                away = dots - dots.mean(axis=1, keepdims=True)
                each.append((away[:, None] * away).mean(axis=2))
            found.append(np.mean(each, axis=0))
        return np.array(found)

    def colour_facts(self, integration_s: float) -> dict[str, Any]:
        """Return what score.json has of a colour sensor: its channels, matrix and noise in an exposure."""
        assert self.rendition is not None
        assert self.physics.layout is not None
        errors = self.rendition.errors(self.matrix)
        dot_um, pitch_um = self.screen.dot_um, self.physics.read_pitch_um
        return {
            "layout": str(self.physics.layout),
            "white_spectrum": self.rendition.lamp,
            "white_e": dict(
                zip(self.physics.layout.channels, (np.array(self.whites_e_per_s) * integration_s).tolist(), strict=True)
            ),
            "matrix_to_display": self.matrix.tolist(),
            "noise_gains": np.sqrt((self.matrix**2).sum(axis=1)).tolist(),
            "patches_mean_delta_e": float(errors.mean()),
            "sensitivity_metamerism_index": metamerism_index(errors),
            "ideal_is_coloured": is_coloured(self.screen.ideal),
            "dots_per_pixel": 1.0 if dot_um is None else pitch_um / dot_um,
        }

    @property
    def sharpen_px(self) -> float:
        """Standard deviation, in pixels, of the blur of sharpening. Raises PixsimError for one that is too wide."""
        develop, pitch_um = self.develop, self.physics.read_pitch_um
        if develop.sharpen_radius_cy_per_deg is None:
            return develop.sharpen_radius_px or 1.0
        dots = self.screen.display.samples_per_deg / (2 * math.pi * develop.sharpen_radius_cy_per_deg)
        pixels = dots * (self.screen.dot_um or pitch_um) / pitch_um
        if not pixels <= MAX_RADIUS_PX:
            got = f"{develop.sharpen_radius_cy_per_deg:g}, a blur of {pixels:.3g} pixels of {pitch_um:g} µm"
            raise invalid("develop.sharpen_radius_cy_per_deg", got, f"up to {MAX_RADIUS_PX:g} pixels", "Raise it.")
        return max(pixels, MIN_RADIUS_PX)

    @property
    def sharpening_noise_gain(self) -> float:
        """By how much sharpening amplifies the standard deviation of noise that is independent from pixel to pixel."""
        return noise_gain(self.develop.sharpen_amount, self.sharpen_px)

    def developing(self, frame: Frame, matrix: Array | None) -> Developing:
        """Return a frame with all that the steps of its development know.

        matrix : from the channels to the display's primaries; None leaves it out
        """
        develop, time_s = self.develop, frame.integration_s
        return Developing(
            frame,
            develop,
            self.screen.display,
            np.array(self.whites_e_per_s) * time_s,
            self.physics,
            self.correction,
            self.shading,
            self.screen.single,
            self.signal_e_per_s * time_s if develop.denoise == "wiener_bound" else None,
            self.sharpen_px if develop.sharpens else 1.0,
            matrix,
        )

    def light(self, frame: Frame, window: Callable[[Array], Array] | None = None) -> Array:
        """Return what a frame asks of the display's dots: luminance (H, W), or light of the primaries (3, H, W), 1 for white.

        window : selects a part of the dots; None takes all
        """
        return self.toned(self.light_before_tone(frame, window))

    def toned(self, light: Array) -> Array:
        """Return light behind the tone curve."""
        return toned(light, self.develop, self.screen.display)

    def light_before_tone(self, frame: Frame, window: Callable[[Array], Array] | None = None) -> Array:
        """Return `light` without the tone curve."""
        c = self.developing(frame, None if self.rendition is None else self.matrix)
        return self.mixed_on_dots(developed_planes(c), c, window)

    def mixed_on_dots(self, planes: Sequence[Array], c: Developing, window: Callable[[Array], Array] | None = None) -> Array:
        """Return the light of developed planes on the dots, before the tone curve.

        c : with the matrix
        """
        screen, frame = self.screen, c.frame
        own = screen.size_um, screen.display, screen.dot_edges_um, frame.registration
        light = light_of_dots([displays.on_dots(plane, frame.pitch_um, *own) for plane in planes], c)
        if window is None:
            return light
        return window(light) if light.ndim == 2 else np.stack([window(plane) for plane in light])

    def score_frame(self, frame: Frame) -> FrameScore:
        """Return the score of a frame as shown on the screen, with ΔE alone."""
        screen = self.screen
        light, gamut = self.light_before_tone(frame), None
        if light.ndim == 3:
            gamut = screen.ideal_out_of_gamut, displays.out_of_gamut_share(np.moveaxis(light, 0, -1))
        image = shown(self.toned(light), screen.display, in_place=True)
        # Pixels that fill the picture exactly may begin at -1e-18 µm.
        border_um = max(0.0, float(screen.dot_edges_um[0][0])), max(0.0, float(screen.dot_edges_um[1][0]))
        delta_e = screen.delta_e_of(image)
        own = {"frame": frame, "physics": self.physics, "border_um": border_um, "out_of_gamut": gamut}
        return made(FrameScore, delta_e, screen.ideal, image, screen.display, **own)


def shown(light: Array, display: Display, *, in_place: bool = False) -> Array:
    """Return light as a display shows it: (H, W) of a luminance (H, W); (H, W, 3) of the light of primaries (3, H, W).

    in_place : as of `displays.shown_luminance`
    """
    codes = displays.shown_luminance(light, display, in_place=in_place)  # each primary has the codes of a luminance
    return codes if codes.ndim == 2 else np.moveaxis(codes, 0, -1)


def mean_white(physics: PixelPhysics, whites: Sequence[float]) -> float:
    """Return the mean over the values of a frame of what white gives in each channel."""
    layout = physics.layout
    return whites[0] if layout is None else float((layout.shares * np.array(whites)).sum())


@dataclass(frozen=True)
class PreparedScene:
    """The light behind the lens, and the screens, for pixels of one spectral response and any pitch.

    lights : behind the diffracting lens, as each channel sees it
    whites_e_per_s_um2 : of the scene's white, on axis, in each channel
    screens : one for each display that shows the frames
    array_um : (height, width) that the pixels fill
    beyond_white : fraction of the ideal image's dots that are brighter than display white
    rendition : what the channels see of a chart; None for a monochrome sensor
    exposed_for : light of each channel without samples that stand alone far above all others, which sets the automatic exposure;
        None: all light does
    facts : what metrics know of the light; None if none asks
    """

    lights: tuple[ChannelLight, ...]
    sample_pitch_um: float
    whites_e_per_s_um2: tuple[float, ...]
    screens: tuple[Screen, ...]
    array_um: tuple[float, float]
    beyond_white: float = 0.0
    rendition: Rendition | None = None
    exposed_for: tuple[ChannelLight, ...] | None = None
    facts: LightFacts | None = None
    _collections: list[ColourCollection] = field(default_factory=list, init=False, repr=False, compare=False)

    @property
    def screen(self) -> Screen:
        """The first of the screens."""
        return self.screens[0]

    @property
    def rate_e_per_s_um2(self) -> Array:
        """Light of the first channel, the only one of a monochrome sensor, (H, W)."""
        return self.lights[0].rate_e_per_s_um2

    def whites_e_per_s(self, physics: PixelPhysics) -> tuple[float, ...]:
        """Return the electrons per second of the scene's white in a value of each channel on axis, without crosstalk of colours."""
        whites = zip(self.whites_e_per_s_um2, self.lights, physics.channels, strict=True)
        count = physics.as_read.bin_side**2
        return tuple(white * collected_area_um2(channel, light.illumination) * count for white, light, channel in whites)

    def collection(self, physics: PixelPhysics, collections: Sequence[Collection]) -> ColourCollection:
        """Return the collection of the pixels of a colour sensor with a stack."""
        layout = Layout.of_pixels(physics.pixel)
        assert layout is not None
        own = tuple(collections)
        last = self._collections[-1] if self._collections else None
        if last is None or any(one is not other for one, other in zip(last.each, own, strict=True)):
            side = physics.as_read.bin_side
            # The registrations of a pitch, which follow one another, share what is expensive of it.
            self._collections[:] = [ColourCollection(layout, own, self.whites_e_per_s_um2, physics.pitch_um, side)]
        return self._collections[-1]

    def store_integrals(self) -> None:
        """Compute what all pitches share, for workers that would each compute it."""
        without = self.facts.without if self.facts is not None and self.facts.without is not None else ()
        for light in (*self.lights, *without):
            light.running_integral  # noqa: B018 – it stays in the light


def ideal_on_dots(
    irradiance: SpectralImage,
    camera: Camera,
    physics: PixelPhysics,
    display: Display,
    border_um: float,
    rendition: Rendition | None = None,
) -> tuple[tuple[Array, Array], Array]:
    """Return the edges of the dots, as `displays.dot_edges_um`, and what the ideal image asks of them.

    That is `displays.ideal_luminance`, (H, W), or `ideal_rgb`, (3, H, W).

    border_um : of all that is scored on the same dots, as for `displays.dot_edges_um`
    rendition : of a colour sensor
    """
    irradiance = ideal_light(irradiance, camera)
    size_um, array_um = displays.picture_size_um(irradiance), array_size_um(irradiance, camera)
    own = physics.as_read.read_pitch_um, display, border_um, array_um, physics.registration
    edges_um = displays.dot_edges_um(size_um, *own)
    if rendition is None:
        return edges_um, displays.ideal_luminance(irradiance, camera, physics, display, edges_um)
    return edges_um, ideal_rgb(irradiance, camera, display, rendition.to_display, edges_um)


COLOURED = 0.02  # of white, between the primaries of a dot of the ideal image: two codes of 8 bits and more in all but dark greys


def is_coloured(ideal: Array) -> bool:
    """Return whether an ideal image, (H, W) or (H, W, 3), shows colours."""
    return ideal.ndim == 3 and float(np.ptp(ideal, axis=2).max()) > COLOURED


def check_one_ideal(grey: Sequence[str], coloured: Mapping[str, Array]) -> None:
    """Raise PixsimError if monochrome and colour sensors look at a coloured scene: their ideal images differ.

    grey : names of the monochrome sensors
    coloured : name of each colour sensor -> its ideal image
    """
    if grey and any(is_coloured(ideal) for ideal in coloured.values()):
        got = f"{', '.join(grey)} without colour filters and {', '.join(coloured)} with them, in a coloured scene"
        hint = "Take a grey scene, such as csf, or leave the monochrome sensors out, whose ideal image is grey."
        raise invalid("sensors", got, "a scene that has one ideal image for all", hint)


def fraction_beyond_white(light: Array) -> float:
    """Return the fraction of dots of an ideal image, (H, W) or (3, H, W), that are brighter than display white."""
    return float(np.mean(luminance_of(light) > 1 + ROUNDING))


class SeenPicture(NamedTuple):
    """A picture as pixels see it, for `white_header`.

    border_um : of all that is scored on the same dots, as for `displays.dot_edges_um`; None means this pixel's
    """

    irradiance: SpectralImage
    camera: Camera
    physics: PixelPhysics
    border_um: float | None = None

    @property
    def white_field(self) -> str:
        """The field of a display that says what is white: a luminance, or the radiance of light without one."""
        return "white_cd_per_m2" if displays.has_luminance(self.irradiance) else "white_w_per_m2_sr"

    def amount(self, display: Display) -> Array:
        """Return the light of the scene's white that gives each scored dot its ideal image, (H, W), in the unit of `white_field`.

        It is the ideal image in the response of these pixels, in units of a white of 1.
        """
        irradiance, camera, physics, border_um = self
        unit = display.model_copy(update={self.white_field: 1.0})
        border_um = physics.as_read.border_um if border_um is None else border_um
        rendition = None if physics.layout is None else rendition_of(irradiance, physics.channels, unit)
        return luminance_of(ideal_on_dots(irradiance, camera, physics, unit, border_um, rendition)[1])


def white_header(seen: Sequence[SeenPicture], display: Display) -> dict[str, Any]:
    """Return header entries with a white for a scene of unknown white; none if the display or the scene defines the white.

    It is one luminance for all that see the scene: the 99th percentile of the ideal image in the response of the pixels, on the
    dots that are scored, rounded up to two digits, with a warning. Of several pixels, which see different parts of the spectrum,
    the largest counts: so that white clips at most 1 % of the ideal image of each.

    Of light without luminance it is a radiance. `display.white = "diffuser"` takes that of a white plate, or of texel value 1 of
    an emissive chart, as the light says it, in place of any other.

    Raises PixsimError if an ideal image is black up to that percentile, or if the light does not say what a white plate shows.
    """
    if display.white is not None:
        return _white_of_diffuser(seen[0].irradiance, display)
    name = seen[0].white_field
    if display.white_cd_per_m2 or display.white_w_per_m2_sr or HEADER_OF_WHITE[name] in seen[0].irradiance.header:
        return {}
    found = max(float(np.percentile(one.amount(display), WHITE_PERCENTILE, overwrite_input=True)) for one in seen)
    unit = UNITS_OF_WHITE[name]
    if not found > 0:
        got = "no value, and the picture is too dark to estimate it"
        what = "luminance" if name == "white_cd_per_m2" else "radiance"
        raise invalid(f"display.{name}", got, f"the scene {what} in {unit} shown as white", f"Set {setting(f'display.{name}')}.")
    white = rounded_up(found, WHITE_DIGITS)
    of_all = "" if len(seen) == 1 else ", the largest of these sensors'"
    source = f"the {WHITE_FROM} in the sensor's response{of_all}, rounded up"
    fixed = f"set {setting(f'display.{name}', white)} to fix this value"
    warn(f"the scene does not define its white: using {white:g} {unit}, {source}; {fixed}")
    return {HEADER_OF_WHITE[name]: white, "white_from": WHITE_FROM}


def _white_of_diffuser(image: SpectralImage, display: Display) -> dict[str, Any]:
    """Return header entries with the white of a plate. Raises PixsimError if the light does not say what it shows."""
    stated = image.header.get(DIFFUSER)
    if stated is None:
        got = "'diffuser', in light that does not say what a white plate in it shows"
        hint = f"State the white: {setting('display.white_cd_per_m2')} or {setting('display.white_w_per_m2_sr')}. "
        hint += "In Python, pixsim.render(…, diffuser=True) makes light that says it."
        raise invalid("display.white", got, "light of a scene that was rendered for it", hint)
    if DIFFUSER_W not in stated:
        if display.diffuser_reflectance != 1:
            warn("display.diffuser_reflectance is not used: white is texel value 1 of the scene's emissive chart, and no plate")
        return {**stated, "white_from": "texel value 1 of the chart"}
    per_nm = display.diffuser_reflectance * np.array(stated[DIFFUSER_W])
    cd_per_m2, w_per_m2_sr = (float(weights @ per_nm) for weights in (image.luminous_weight(), image.band_width_nm))
    name, white = ("white_cd_per_m2", cd_per_m2) if cd_per_m2 > LEAST_LM_PER_W * w_per_m2_sr else ("white_w_per_m2_sr", w_per_m2_sr)
    source = f"a white plate of reflectance {display.diffuser_reflectance:g}, {stated['distance_m']:.4g} m before the lens"
    return {HEADER_OF_WHITE[name]: float(f"{white:.9g}"), "white_from": source}


# Of fields of a display: their units, and their entries in a header. A radiance is there where a luminance says nothing.
UNITS_OF_WHITE = {"white_w_per_m2_sr": "W m⁻² sr⁻¹", "white_cd_per_m2": "cd/m²"}
HEADER_OF_WHITE = {"white_w_per_m2_sr": WHITE_RADIANCE, "white_cd_per_m2": "luminance_cd_per_m2"}


def with_white(display: Display, white: Mapping[str, Any]) -> Display:
    """Return a display with the white of a `white_header`; as it is for an empty one."""
    found = {name: white[entry] for name, entry in HEADER_OF_WHITE.items() if entry in white}
    return display.model_copy(update={**found, "white": None}) if found else display


def rounded_up(value: float, digits: int) -> float:
    """Return a positive number rounded up to so many decimal digits, but for errors of rounding.

    >>> rounded_up(730.1, 2), rounded_up(730.0000001, 2), rounded_up(9.96e-5, 2)
    (740.0, 730.0, 0.0001)
    """
    value *= 1 - ROUNDING
    nearest = float(f"{value:.{digits - 1}e}")
    step = 10.0 ** (math.floor(math.log10(value)) - digits + 1)
    return nearest if nearest >= value else float(f"{nearest + step:.{digits - 1}e}")


def warn_of_clipping(beyond_white: float, header: Mapping[str, Any], display: Display) -> None:
    """Warn if the display clips more of the ideal image than `CLIPPED_WARNING`, on behalf of the caller of the caller."""
    if beyond_white > CLIPPED_WARNING:
        higher = displays.setting_of_white(header, display)
        warn(f"{beyond_white:.0%} of the ideal image is brighter than display white; raise {higher}")


def check_without(without: SpectralImage, irradiance: SpectralImage) -> None:
    """Raise PixsimError if light without a target cannot be compared with that with it, sample by sample."""
    without.validate()
    got, wanted = ([*each.shape[:2], each.pitch_um] for each in (without, irradiance))
    if got[:2] != wanted[:2] or not math.isclose(got[2], wanted[2], rel_tol=ROUNDING):
        found, allowed = ("{} × {} samples of {:g} µm".format(*each) for each in (got, wanted))
        raise invalid("without", found, f"the samples of the light with the target, {allowed}")


def prepare_scene(
    irradiance: SpectralImage,
    camera: Camera,
    physics: PixelPhysics,
    display: Display,
    full: bool = False,
    *,
    border_um: float | None = None,
    single: bool = False,
    lights: tuple[ChannelLight, ...] | None = None,
    others: Sequence[Display] = (),
    judging: Judging = DELTA_E_ONLY,
    without: SpectralImage | None = None,
    develop: Develop = DEVELOP,
) -> PreparedScene:
    """Return the light behind the lens and the screens. They depend on the pitch only if the raster is one_to_one.

    others : further displays, with other dots or seen from elsewhere
    single : compute dots and S-CIELAB in float32, as a study does for its many evaluations; not with `full`
    border_um : of all that is scored on the same dots, as for `displays.dot_edges_um`; None means this pixel's
    lights : behind the lens, of a part of a picture whose blur depends on its place; None computes them
    judging : what is asked of the judges
    without : the irradiance of the scene without its target, if a metric asks for it
    develop : whose tone curve the ideal image has, too

    Raises PixsimError if the irradiance is negative or not finite, or without the target has other samples.
    """
    irradiance.validate()
    if without is not None:
        check_without(without, irradiance)
    channels = physics.channels
    rendition = None if physics.layout is None else rendition_of(irradiance, channels, display)
    make_screen = partial(
        screen_of, irradiance, camera, physics, border_um=border_um, rendition=rendition, full=full, single=single, develop=develop
    )
    screen, beyond_white = make_screen(display)
    of_dots, screens = {display.dots: screen}, [screen]
    for other in others:
        if other.dots not in of_dots:
            of_dots[other.dots], _ = make_screen(other)
        screens.append(of_dots[other.dots].seen_at(other.samples_per_deg))
    lights = lights_of(irradiance, camera, physics) if lights is None else lights
    if full:  # nothing of the pixels' stack is left out
        lights = tuple(replace(one, illumination=replace(one.illumination, spare_e=0.0)) for one in lights)
    whites = tuple(displays.white_rate(irradiance, camera, channel, display) for channel in channels)
    array_um = array_size_um(irradiance, camera)
    calm = without_outliers(irradiance)
    exposed_for = None if calm is None else lights_of(calm, camera, physics)
    own = tuple(screens), array_um, beyond_white, rendition, exposed_for
    facts = None
    if judging.needs_light:
        facts = LightFacts.of(irradiance, camera, physics, without, lights[0].rate_e_per_s_um2)
    return PreparedScene(lights, irradiance.pitch_um, whites, *own, facts)


def screen_of(
    irradiance: SpectralImage,
    camera: Camera,
    physics: PixelPhysics,
    display: Display,
    *,
    border_um: float | None = None,
    rendition: Rendition | None = None,
    full: bool = False,
    single: bool = False,
    develop: Develop = DEVELOP,
) -> tuple[Screen, float]:
    """Return the screen for a display, and the fraction of the ideal image's dots that are brighter than display white.

    border_um, full, single, develop : as of `prepare_scene`
    rendition : of a colour sensor
    """
    border_um = physics.as_read.border_um if border_um is None else border_um
    edges_um, light = ideal_on_dots(irradiance, camera, physics, display, border_um, rendition)
    gamut = 0.0 if rendition is None else displays.out_of_gamut_share(np.moveaxis(light, 0, -1))
    light = toned(light, develop, display)
    ideal, single = shown(light, display), single and not full
    lab = perceived_lab(ideal, display, full, single)
    screen = Screen(display, displays.picture_size_um(irradiance), edges_um, ideal, lab, full, single, gamut)
    return screen, fraction_beyond_white(light)


class IdealFacts(NamedTuple):
    """What must be known of an ideal image: how much of it is brighter than display white, and its `lightness_range` as shown."""

    beyond_white: float
    lightness: tuple[float, float]


# What the pitches of a technology share. With one_to_one, where dots are pixels, that is the irradiance only.
@dataclass(frozen=True)
class Unprepared:
    """Irradiance of the scene, and of the scene without its target, if a metric asks for it."""

    irradiance: SpectralImage
    without: SpectralImage | None = None


SharedLight = PreparedScene | Unprepared


class SceneCache:
    """Prepared scenes of one irradiance, camera and display, made on first use and stored while memory allows.

    channels : of the pixels, the most of those that share the cache
    single, others, judging, without, develop : of `prepare_scene`
    """

    def __init__(
        self,
        irradiance: SpectralImage,
        camera: Camera,
        display: Display,
        channels: int = 1,
        *,
        single: bool = False,
        others: Sequence[Display] = (),
        judging: Judging = DELTA_E_ONLY,
        without: SpectralImage | None = None,
        develop: Develop = DEVELOP,
    ) -> None:
        self.irradiance, self.camera, self.display, self.channels = irradiance, camera, display, channels
        self.single, self.others, self.judging, self.without = single, tuple(others), judging, without
        self.develop = develop
        self._scenes: dict[object, PreparedScene] = {}
        self._facts: dict[object, IdealFacts] = {}

    def get(self, key: object, physics: PixelPhysics, border_um: float) -> SharedLight:
        """Return the prepared scene of a key, which stands for a spectral response and a border."""
        if self.display.raster == "one_to_one":
            return Unprepared(self.irradiance, self.without)
        if key not in self._scenes:
            if len(self._scenes) >= self.capacity:
                self._scenes.clear()
            own = self.irradiance, self.camera, physics, self.display
            scene = prepare_scene(
                *own,
                border_um=border_um,
                single=self.single,
                others=self.others,
                judging=self.judging,
                without=self.without,
                develop=self.develop,
            )
            self._scenes[key], self._facts[key] = scene, IdealFacts(scene.beyond_white, lightness_range(scene.screen.ideal))
        return self._scenes[key]

    def ideal_facts(self, key: object, physics: PixelPhysics, border_um: float) -> IdealFacts:
        """Return facts of the ideal image, for the key of `get`; with one_to_one, where dots are pixels, of the pixels given."""
        if key in self._facts and self.display.raster != "one_to_one":
            return self._facts[key]
        light = self.ideal(physics, border_um)
        return IdealFacts(fraction_beyond_white(light), lightness_range(shown(light, self.display)))

    def ideal(self, physics: PixelPhysics, border_um: float) -> Array:
        """Return what the ideal image of a pixel asks of the dots, as `ideal_on_dots`, behind the tone curve."""
        rendition = None if physics.layout is None else rendition_of(self.irradiance, physics.channels, self.display)
        light = ideal_on_dots(self.irradiance, self.camera, physics, self.display, border_um, rendition)[1]
        return toned(light, self.develop, self.display)

    @cached_property
    def content(self) -> str:
        """Hash of the light, whose header states everything that it depends on, and of the camera."""
        without = [] if self.without is None else [self.without.header]
        return content_hash([self.irradiance.header, self.camera.model_dump(), *without])

    def clear(self) -> None:
        """Drop all prepared scenes; they are made again when needed."""
        self._scenes.clear()

    @property
    def capacity(self) -> int:
        """Number of prepared scenes that are stored at once."""
        # For each channel light and spline; ideal image, its CIELAB.
        dots = sum(display.dots**2 for display in (self.display, *self.others))
        planes = 2 * self.channels * math.prod(self.irradiance.shape) + (4 if self.channels == 1 else 6) * dots
        return max(1, SCENE_CACHE_BYTES // (8 * planes))


def chain_at_pitch(
    light: PreparedScene,
    physics: PixelPhysics,
    exposure: Exposure,
    correction: Correction = NO_CORRECTION,
    develop: Develop = DEVELOP,
    um_per_s: tuple[float, float] = NO_VELOCITY,
    *,
    room_is_checked: bool = False,
) -> ImagingChain:
    """Return the imaging chain of a pixel of any pitch and registration, from light prepared for its spectral response.

    um_per_s : velocity [x, y] of the image on the sensor; automatic exposure is metered on the picture that stands still
    room_is_checked : nothing of this chain is shown, or another one with the same dots had room for the motion

    Raises PixsimError if the picture moves farther than what is scored leaves room for.
    """
    signal, collections = array_signal(light.lights, light.sample_pitch_um, physics, light.array_um)
    if light.exposed_for is not None and exposure.integration_s is None:
        calm, _ = array_signal(light.exposed_for, light.sample_pitch_um, physics, light.array_um)
        time_s = integration_time_s(exposure, physics.as_read, float(calm.max()))
        exposure = lasting(exposure, time_s)
    still = _chain(light, physics, exposure, correction, develop, signal, collections)
    return still if um_per_s == NO_VELOCITY else _moved(still, light, physics, um_per_s, room_is_checked)


def _moved(
    still: ImagingChain, light: PreparedScene, physics: PixelPhysics, um_per_s: tuple[float, float], room_is_checked: bool
) -> ImagingChain:
    """Return the chain of light that moves, from that of the same light that stands still.

    physics : of the pixels, before they are read
    """
    moving, exposure = metered_motion(still.signal_e_per_s, still.physics, still.exposure, um_per_s)
    still = replace(still, exposure=exposure)
    if not room_is_checked:
        check_room(still, moving, light.array_um)

    pixels = light.sample_pitch_um, physics, light.array_um, moving
    signal, each = moved_signals(light.lights, *pixels, exposure.frames)
    without = None if still.without_e_per_s is None or light.facts is None else light.facts.without
    return replace(
        still,
        signal_e_per_s=signal,
        without_e_per_s=None if without is None else array_signal(without, *pixels)[0],
        um_per_s=um_per_s,
        moving=moving,
        each_e_per_s=each,
    )


def check_room(chain: ImagingChain, moving: Moving, array_um: tuple[float, float]) -> None:
    """Raise PixsimError if light from beyond the picture moves into the part of it that is scored."""
    screen, read = chain.screen, chain.physics
    own_um = 0.0 if screen.display.raster == "one_to_one" else read.border_um
    for axis, (edges, size_um) in enumerate(zip(screen.dot_edges_um, screen.size_um, strict=True)):
        lines = array_um[0] / read.read_pitch_um
        needed_um = (abs(moving.path_um[axis]) + abs(moving.row_um[axis]) * lines) / 2
        room_um = max(0.0, min(float(edges[0]), size_um - float(edges[-1])) - own_um)
        if needed_um > room_um * (1 + ROUNDING):
            got = f"a path of {2 * needed_um:.4g} µm on the sensor in {1e3 * (chain.exposure.integration_s or 0):.4g} ms"
            slower = f"slow it down ({', '.join(VELOCITIES)})"
            hint = f"Raise {setting('motion.margin_um')}, shorten {setting('exposure.max_integration_s')}, or {slower}."
            if screen.display.raster == "one_to_one":
                hint = f"With display.raster = 'one_to_one' all pixels are scored; take 'fixed_size', or {slower}."
            raise invalid("motion", got, f"at most {2 * room_um:.4g} µm, twice what is left on each side of what is scored", hint)


def chain_of_frames(
    light: PreparedScene,
    physics: PixelPhysics,
    exposure: Exposure,
    correction: Correction,
    develop: Develop,
    shape: tuple[int, int],
) -> ImagingChain:
    """Return the imaging chain for frames (rows, columns) that are known, without the light behind them.

    exposure : with the time of the frames
    """
    pixels = centred_pixels(light.array_um, physics)
    collections = collections_of(physics, [one.illumination for one in light.lights], pixels)
    return _chain(light, physics, exposure, correction, develop, np.broadcast_to(0.0, shape), collections)


def check_whole_cell(physics: PixelPhysics, shape: tuple[int, ...]) -> None:
    """Raise PixsimError if a frame (rows, columns) of a mosaic lacks a part of the unit cell, and with it colours.

    physics : of what is read
    """
    layout = physics.layout
    if layout is None:
        return
    (high, wide), (rows, columns) = layout.period, shape
    if rows < high or columns < wide:
        binned = f" after binning of {physics.bin_side} × {physics.bin_side}" if physics.bin_side > 1 else ""
        got = f"{physics.pitch_um:g}, which leaves {rows} × {columns} pixels on the die{binned}"
        allowed = f"at least the unit cell {', '.join(layout.cell)} of {high} × {wide} pixels"
        raise invalid("pixel.pitch_um", got, allowed, "Choose smaller pixels or a larger die.")


def _chain(
    light: PreparedScene,
    physics: PixelPhysics,
    exposure: Exposure,
    correction: Correction,
    develop: Develop,
    signal: Array,
    collections: Sequence[Collection],
) -> ImagingChain:
    read, rendition = physics.as_read.at_exposure(exposure), light.rendition
    check_whole_cell(read, signal.shape)
    collection: Collection | ColourCollection | None = collections[0] if collections else None
    if collections and rendition is not None:
        collection = light.collection(physics, collections)
        whites = tuple(collection.white_e_per_s.tolist())
        rendition = rendition.mixed_by(collection.mixing_um2, np.array(collection.rates))
    else:
        whites = light.whites_e_per_s(physics)
    without = None
    if light.facts is not None and light.facts.without is not None:
        without, _ = array_signal(light.facts.without, light.sample_pitch_um, physics, light.array_um)
    own = light.screen, correction, collection, develop, rendition, (light, physics), without
    return ImagingChain(signal, read, exposure, whites, *own)


def make_imaging_chain(
    irradiance: SpectralImage,
    camera: Camera,
    pixel: Pixel,
    exposure: Exposure,
    display: Display,
    full: bool = False,
    correction: Correction = NO_CORRECTION,
    develop: Develop = DEVELOP,
    *,
    keep: bool = False,
    judging: Judging = DELTA_E_ONLY,
    without: SpectralImage | None = None,
    motion: Motion = STILL,
    prepare: Callable[..., PreparedScene] | None = None,
) -> ImagingChain:
    """Return the imaging chain up to the noise.

    keep : whether the chain stays in memory, with the last few others, for the same light and settings
    judging, without : as of `prepare_scene`
    prepare : knows what `prepare_scene` did (`KeptScenes`); None means that itself

    Warns if the render used another camera, the scene's white is estimated (`white_header`), the display clips the scene, a number
    of the pixel is rather in another unit, or the model of the pixel's stack is doubtful.
    """
    warn_of_other_camera(irradiance, camera)
    check_develop(develop, pixel)
    warn_of_unit_slips(pixel)
    physics = derive(pixel)
    warn_of_light(physics, camera, irradiance)
    border_um = scored_border_um(physics, motion, exposure, camera)
    display = with_white(display, white_header([SeenPicture(irradiance, camera, physics, border_um)], display))
    judging.check(MetricContext(physics.layout is not None, without is not None))
    keep = keep and not judging.needs_light
    key = _key_of_chain(irradiance, camera, physics, (exposure, display, correction, develop, motion), full) if keep else None
    if key is None or key not in _kept_chains:
        own = irradiance, camera, physics, display, full
        light = (prepare or prepare_scene)(*own, border_um=border_um, judging=judging, without=without, develop=develop)
        um_per_s = velocity_um_per_s(motion, camera, physics.pitch_um)
        chain = chain_at_pitch(light, physics, exposure, correction, develop, um_per_s)
        found = (chain if key is None else replace(chain, made_from=None)), light.beyond_white
    else:
        found = _kept_chains.pop(key)
    if key is not None:
        _keep_chain(key, *found)
    warn_of_clipping(found[1], irradiance.header, display)
    return found[0]


def scored_border_um(physics: PixelPhysics, motion: Motion, exposure: Exposure, camera: Camera) -> float | None:
    """Return the border of a frame that is scored alone, with room for what moves; None: that of the pixel."""
    read = physics.as_read
    room_of = motion, exposure, camera, [(read.pitch_um, read.bin_side)]
    return border_with_room_um(read.border_um, *room_of) if motion.is_on else None


def warn_of_other_camera(irradiance: SpectralImage, camera: Camera) -> None:
    """Warn if light was rendered with another camera than the one that is given."""
    rendered = irradiance.header.get("camera")
    if rendered is not None and not (of_light := Camera.model_validate(rendered)).lights_like(camera):
        other = [name for name, value in camera if value != getattr(of_light, name)]
        warn(f"the irradiance was rendered with another camera than the one given, of another {', '.join(other)}")


KEPT_OF_PIXELS = 32  # tables, of some pixel sizes
KEPT_CHAINS, MOST_KEPT_BYTES = 8, 1 << 27
MOST_DIGESTED_BYTES = 1 << 27  # of light; a tenth of a second
_kept_chains: dict[str, tuple[ImagingChain, float]] = {}  # the last one last; with `PreparedScene.beyond_white`


def _key_of_chain(
    irradiance: SpectralImage, camera: Camera, physics: PixelPhysics, settings: Sequence[Record], full: bool
) -> str | None:
    """Return a key for all that a chain depends on; None for light that takes long to read, and angles that a file has."""
    light = irradiance.data if irradiance.factors is None else irradiance.factors[1]
    if light.nbytes > MOST_DIGESTED_BYTES or camera.chief_ray_angle is not None:
        return None
    responses = [electrons_per_joule(channel, irradiance).tolist() for channel in physics.channels]
    charge = physics.charge.content_hash if physics.charge else ""
    records = [record.model_dump(mode="json") for record in (camera, physics.pixel, *settings)]
    return content_hash([irradiance.digest(), records, physics.technology.content, repr(physics), responses, charge, full])


def _keep_chain(key: str, chain: ImagingChain, beyond_white: float) -> None:
    """Keep a chain as the last one, and drop the first ones if they are too many or too large."""
    _kept_chains[key] = chain, beyond_white
    sizes = [each.signal_e_per_s.nbytes + 3 * each.screen.ideal.nbytes for each, _ in _kept_chains.values()]
    while len(sizes) > KEPT_CHAINS or sum(sizes) > MOST_KEPT_BYTES:
        _kept_chains.pop(next(iter(_kept_chains)), None)
        sizes.pop(0)


@checks_arguments
def evaluate(
    irradiance: SpectralImage,
    camera: Camera,
    pixel: Pixel,
    exposure: Exposure | None = None,
    display: Display | None = None,
    *,
    correction: Correction | None = None,
    develop: Develop | None = None,
    motion: Motion | None = None,
    seed: Whole = 0,
    full: bool = False,
    metrics: Sequence[str | Callable[[Score], float]] = ("delta_e",),
    metric: MetricOptions | None = None,
    without: SpectralImage | None = None,
) -> FrameScore:
    """Simulate one frame of one sensor, show it on a display, and compare it with the ideal image by S-CIELAB.

    camera : the one that the irradiance was rendered with
    exposure, display : None means the defaults
    correction : of the frame by the camera; None means none
    develop : of a frame into a picture; None means the default
    motion : of the scene; None means that it stands still
    seed : of the sensor's fixed pattern and its temporal noise
    full : use no shortcut for grey images (the result differs by rounding only)
    metrics : names of metrics, or functions of a Score, each a number in its own unit; they are the score's `metrics`. One that has
        no number for this frame, as NIIRS for one that is overexposed, is NaN, with a warning that says why
    metric : settings of the metrics; None means the defaults
    without : irradiance of the scene without its target, for the metric detectability

    Where neither the display nor the scene states its white, it is estimated, with a warning, as in `pixsim run`. What the frames
    of one sensor and one light share is kept for the next calls.

    Raises PixsimError if the pitch is too small or larger than the die, if white has no luminance, or the sensor no response to it.

    >>> light = SpectralImage([550.0], 10.0, 84.8, data=np.full((32, 32, 1), 1e-3), header={"diffraction": False})
    >>> pixel, display = Pixel(pitch_um=84.8, prnu=0), Display(white_cd_per_m2=1000, dots=32)
    >>> score = evaluate(light, Camera(), pixel, display=display)
    >>> score.delta_e.shape, round(float(score.image.mean() / score.ideal.mean()), 2)
    ((28, 28), 1.0)
    """
    exposure, display = exposure or Exposure(), display or Display()
    correction, develop, motion = correction or NO_CORRECTION, develop or DEVELOP, motion or STILL
    from pixsim.viewer.metric_registry import metrics_named

    judging = Judging(metrics_named(metrics), metric or METRIC_OPTIONS)
    names = tuple(each.name for each in judging.metrics)
    own = pixel, exposure, correction, develop, display, camera, camera.lens_options
    given = Configuration(derive(pixel), *own, light=irradiance, metrics=names, metric=judging.options, motion=motion)
    warn_of_unused_settings({"": [given]})
    warn_of_unused_light(judging, without)
    settings = irradiance, camera, pixel, exposure, display, full, correction, develop
    chain = make_imaging_chain(*settings, keep=True, judging=judging, without=without, motion=motion)
    lacking: dict[str, str] = {}
    score = judged_score(chain, judging, ("evaluate", seed), lacking)
    for reason in lacking.values():
        warn(reason)
    time_s, saturated = score.frame.integration_s, score.frame.saturated_fraction
    of_frame = chain.white_e_per_s * time_s, time_s, lightness_range(score.ideal), saturated
    causes = causes_of(irradiance.header, score.display, score.physics, *of_frame, exposure)
    for cause in causes:
        if cause.leaves_nothing:
            warn(str(cause))
    # The ideal picture is that of the chain, which stays.
    return replace(score, ideal=score.ideal.copy(), light=LightError.of(irradiance.header, causes=causes), _scored=None)


def warn_of_unused_light(judging: Judging, without: SpectralImage | None) -> None:
    """Warn if light without a target is given, and no metric asks for it."""
    if without is not None and not has_target([metric.name for metric in judging.metrics]):
        warn(f"without is not used: neither {' nor '.join(OF_TARGETS)} is among the metrics")


def judged_score(
    chain: ImagingChain, judging: Judging, key: tuple[object, ...], lacking: dict[str, str] | None = None
) -> FrameScore:
    """Return the score of a new sensor and a new frame for a key, with the numbers of its metrics.

    lacking : as of `numbers_of`

    Raises NoNumberError if no metric has a number.
    """
    judged = Judged(chain, chain.capture(*key), judging, stream=key)
    score = with_numbers(judged.score, judging.metrics, judged, lacking)
    if lacking and len(lacking) == len(judging.metrics):
        raise NoNumberError(next(iter(lacking.values())))
    return score


def with_numbers(score: S, metrics: Sequence[Metric], judged: Judged | Score, lacking: dict[str, str] | None = None) -> S:
    """Return a score with the numbers of metrics of what `numbers_of` takes; `lacking` is also its."""
    others = [metric for metric in metrics if metric.name != DELTA_E.name]  # a score has ΔE
    numbers = numbers_of(others, judged, lacking)
    numbers = {name: numbers[name] for name in columns_with_numbers(others, numbers)}
    first = {metric.name: numbers.get(metric.columns[0], score.mean_delta_e) for metric in metrics}
    return replace(score, metrics=first, further=numbers)


DARK_NODES = 64  # of equal weight, for the ordinary pixels and for the hot ones
FEW_E = 100.0  # the Poisson law is summed up to this dark charge; above, 10 σ from 0, a normal law clips nothing by itself
POISSON_TERMS = 200  # 10 σ above `FEW_E`
NO_NOISE_DN = 1e-9  # σ used in place of 0


def dark_clip(physics: PixelPhysics, integration_s: float, white_e: float) -> dict[str, float]:
    """Return the effect of clipping dark pixels at 0 DN, and the black level that avoids it, as in score.json.

    A dark level is the sum of the black level, dark charge (gamma-distributed by DSNU, with hot pixels, Poisson, never negative),
    and normal reset noise, read noise and offsets. Of normal levels of mean µ and deviation σ (DN), the fraction Φ((½ - µ)/σ) is
    at 0 DN. Rounding and clipping raise their mean by Σ Φ((-½ - j - µ)/σ) over j = 0, 1, …, which is σφ(µ/σ) - µΦ(-µ/σ) if σ is
    many DN.

    Of a burst the spread and `too_bright_e` are those of the frame, all else that of each exposure.

    white_e : mean electrons of the scene's white in this time

    spread_e, spread_dn : `dark_spread_e`
    at_zero_fraction : fraction of dark pixels at 0 DN
    too_bright_e : increase of the mean of a dark frame
    of_display_white, lightness : that increase as luminance over display white (at most 1) and as CIE L*, before the display
        clips and rounds; L* is the ΔE of an even black area
    least_black_level_dn : `pixsim.sensor.least_black_level_dn`
    gain_db : of the exposure, without which the black level would have room

    >>> from pixsim.sensor.pixel import derive
    >>> from pixsim import Pixel
    >>> clip = dark_clip(derive(Pixel()), 0.03, white_e=5e4)  # no black level: half of the dark levels, σ of 209 e-
    >>> round(clip["at_zero_fraction"], 2), round(clip["too_bright_e"]), clip["least_black_level_dn"]
    (0.54, 71, 15)
    """
    count = physics.exposures
    if count > 1:
        clip = dark_clip(physics.burst(1), integration_s / count, white_e / count)
        spread_e = dark_spread_e(physics, integration_s)
        of_frame = {"spread_e": spread_e, "spread_dn": physics.dn_per_e * spread_e, "too_bright_e": count * clip["too_bright_e"]}
        return clip | of_frame
    p, gain = physics, physics.dn_per_e
    noise_dn = gain * math.sqrt(variance_e2(p))
    ordinary_e = p.dark_current_e_per_s * integration_s * p.dark_spread.ordinary_mean
    dark_e = np.array([ordinary_e])
    if p.dsnu > np.finfo(float).eps:  # as `sample_sensor` takes it
        shape = p.dsnu**-2
        dark_e = dark_e * gammaincinv(shape, (np.arange(DARK_NODES) + 0.5) / DARK_NODES) / shape
    share = np.full(dark_e.size, 1.0 / dark_e.size)
    if p.hot_pixel_fraction:
        logarithm = p.hot_pixel_spread * ndtri((np.arange(DARK_NODES) + 0.5) / DARK_NODES)
        of_hot = np.full(DARK_NODES, p.hot_pixel_fraction / DARK_NODES)
        dark_e = np.concatenate([dark_e, ordinary_e * p.hot_pixel_median * np.exp(logarithm)])
        share = np.concatenate([(1 - p.hot_pixel_fraction) * share, of_hot])
    is_few = dark_e <= FEW_E
    many, few = dark_e[~is_few], np.maximum(dark_e[is_few, None], np.finfo(float).tiny)
    counts = np.arange(POISSON_TERMS)
    poisson = (share[is_few, None] * np.exp(counts * np.log(few) - few - gammaln(counts + 1))).sum(axis=0)
    charge_e = np.concatenate([counts, many])
    weight = np.concatenate([poisson, share[~is_few]])
    sigma_dn = np.sqrt(noise_dn**2 + gain**2 * np.concatenate([np.zeros(counts.size), many]))
    level_dn, sigma_dn = p.pixel.black_level_dn + gain * charge_e, np.maximum(sigma_dn, NO_NOISE_DN)
    at_zero, excess_dn = ndtr((0.5 - level_dn) / sigma_dn), moments_of_codes(-level_dn, sigma_dn)[0]  # codes below 0, mirrored
    too_bright_e = float(weight @ excess_dn) / gain
    of_white = min(too_bright_e / white_e, 1.0)
    return {
        "spread_e": dark_spread_e(p, integration_s),
        "spread_dn": gain * dark_spread_e(p, integration_s),
        "at_zero_fraction": float(weight @ at_zero),
        "too_bright_e": too_bright_e,
        "of_display_white": of_white,
        "lightness": float(xyz_to_lab([of_white] * 3, np.ones(3))[0]),
        "least_black_level_dn": least_black_level_dn(p, integration_s),
        "gain_db": p.gain_db,
    }


HIDDEN_DN = 0.05  # shift of the dark mean that rounding hides: a sixth of its error, 1/√12 DN
TAIL_SIGMAS = 0.01  # shift in units of the dark spread that a black level of 1.9 σ causes


def clips_dark(dark: dict[str, float]) -> bool:
    """Return whether a `dark_clip` is visible: larger than rounding errors and than the tail of the noise."""
    clipped_e, spread_e = dark["too_bright_e"], dark["spread_e"]
    return clipped_e * dark["spread_dn"] > HIDDEN_DN * spread_e and clipped_e > TAIL_SIGMAS * spread_e


def clip_words(dark: dict[str, float], pixel: dict[str, Any], where: str = "") -> str:
    """Return a `dark_clip` in words, with the black level that avoids it.

    pixel : its settings
    where : further words after the black level
    """
    black, needed = pixel["black_level_dn"], dark["least_black_level_dn"]
    fits = needed <= MAX_BLACK * (2 ** pixel["bits"] - 1)
    lacking = "less gain (exposure.gain_db)" if dark["gain_db"] else "more bits (pixel.bits)"
    hint = f"set pixel.black_level_dn = {needed} to avoid this" if fits else f"avoiding this takes {lacking}"
    return (
        f"the black level of {black:g} DN clips dark noise{where}: {100 * dark['at_zero_fraction']:.0f} % of dark pixels "
        f"are at 0 DN, which raises the dark mean by {rounded(dark['too_bright_e'])} e- "
        f"(ΔE {rounded(dark['lightness'])} on uniform black, less on grey); {hint}"
    )
