"""One picture taken, shown and compared: irradiance + camera + pixel → frame, images and the ΔE map."""

from __future__ import annotations

import math
import os
import warnings
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import gammaincinv, gammaln, ndtr

from pixsim.base.arrays import Array, stream
from pixsim.base.parameters import Camera, Display, Exposure, Pixel
from pixsim.light.spectral import SpectralImage
from pixsim.sensor.integration import diffracted_rate, integrate_pixels, running_integral
from pixsim.sensor.pixel import PixelPhysics, derive
from pixsim.sensor.readout import Frame, capture_from_rates, dark_spread_e, least_black_level_dn, sample_sensor
from pixsim.show.figures import new_figure
from pixsim.show.pages import _cell, rows_csv
from pixsim.show.pictures import DELTA_E_SHOWN, VIEWING_GAMMA
from pixsim.viewer import display as displays
from pixsim.viewer.scielab import delta_e, filtered_grey_lab, filtered_lab, grey_delta_e_map, xyz_to_lab

if TYPE_CHECKING:
    from matplotlib.figure import Figure


CLIPPED_WARNING = 0.01
HISTOGRAM_BINS = 1 << 14
PANEL_IN = 3.1  # width of each picture of a figure
LIGHTS_BYTES = 1 << 28  # of lights that are made at once
MAX_KEPT_SAMPLES = 1 << 22  # of a running integral, 32 MiB: a film of 2048²


@dataclass(frozen=True)
class Score:
    """What a viewer sees of a sensor's picture, next to what an ideal camera would have shown.

    delta_e : (H, W) S-CIELAB difference on the display's dots
    ideal, image : (H, W) shown luminance, 1 for white
    frame : behind the image
    physics : of the pixel
    border_um : (above and below, left and right) width of the edge of the picture that is neither shown nor scored
    """

    delta_e: Array = field(repr=False)
    ideal: Array = field(repr=False)
    image: Array = field(repr=False)
    frame: Frame = field(repr=False)
    physics: PixelPhysics = field(repr=False)
    border_um: tuple[float, float] = (0.0, 0.0)

    @property
    def mean_delta_e(self) -> float:
        """Over all dots: what a study makes least."""
        return float(self.delta_e.mean())

    def statistics(self) -> dict[str, float]:
        """The numbers that stand in score.json and in a study's rows, each with its unit in its name."""
        p, frame = self.physics, self.frame
        median, p90, p99 = percentiles(self.delta_e, (50, 90, 99))
        return {
            "pitch_um": p.pitch_um,
            "fill_factor": p.fill_factor,
            "full_well_e": p.full_well_e,
            "integration_s": frame.integration_s,
            "saturated_fraction": frame.saturated_fraction,
            "mean_electrons_e": float(frame.mean_e.mean()),
            "mean_delta_e": self.mean_delta_e,
            "median_delta_e": median,
            "p90_delta_e": p90,
            "p99_delta_e": p99,
            "max_delta_e": float(self.delta_e.max()),
        }

    def plot(self) -> Figure:
        """Ideal picture, sensor's picture and ΔE map on the fixed scale, a dot of the display a sample; a Matplotlib figure."""
        figure = new_figure(3 * PANEL_IN + 0.6, PANEL_IN + 0.3)
        axes = figure.subplots(1, 3, sharex=True, sharey=True)
        for each, picture, title in zip(axes, (self.ideal, self.image), ("ideal", "sensor"), strict=False):
            each.imshow(np.clip(picture, 0, 1) ** (1 / VIEWING_GAMMA), cmap="gray", vmin=0, vmax=1, interpolation="nearest")
            each.set_title(title)
        shown = axes[2].imshow(self.delta_e, cmap="viridis", vmin=0, vmax=DELTA_E_SHOWN, interpolation="nearest")
        axes[2].set_title(f"S-CIELAB ΔE, mean {self.mean_delta_e:.3f}")
        figure.colorbar(shown, ax=axes[2], label="ΔE", extend="max", shrink=0.85)
        for each in axes:
            each.set_xlabel("display dots")
        return figure

    def to_csv(self, path: str | os.PathLike[str] | None = None) -> str:
        """`statistics` as CSV, also into a file where a `path` is given."""
        return rows_csv([self.statistics()], path)

    def _repr_html_(self) -> str:
        rows = [(name, f"{value:.6g}") for name, value in self.statistics().items()]
        title = f"{self.physics.pitch_um:g} µm pixels, mean ΔE {self.mean_delta_e:.3f}"
        return _cell(title, ("", ""), rows, self.plot())

    def __repr__(self) -> str:
        return (
            f"<Score mean ΔE {self.mean_delta_e:.3f}, {self.physics.pitch_um:g} µm pixels, {1e3 * self.frame.integration_s:.3g} ms>"
        )


def percentiles(values: Array, percent: tuple[float, ...]) -> list[float]:
    """`np.percentile` of finite values of 0 and more, in a third of the time: a histogram tells where they are."""
    scale = (HISTOGRAM_BINS - 1) / max(float(values.max()), np.finfo(float).tiny * HISTOGRAM_BINS)
    bins = (values * scale).astype(np.uint16).ravel()
    up_to = np.bincount(bins, minlength=HISTOGRAM_BINS).cumsum()
    inside: dict[int, Array] = {}

    def smallest(rank: int) -> float:
        """The value that `rank` others come before."""
        at = int(np.searchsorted(up_to, rank, "right"))
        if at not in inside:
            inside[at] = np.sort(values.ravel()[bins == at])
        return float(inside[at][rank - (up_to[at - 1] if at else 0)])

    found = []
    for each in percent:
        below, part = divmod(each / 100 * (values.size - 1), 1)
        low, high = smallest(int(below)), smallest(min(int(below) + 1, values.size - 1))
        found.append(low + part * (high - low))
    return found


def perceived_lab(shown: Array, display: Display, full: bool = False) -> Array:
    """CIELAB of a shown grey image as the viewer's eye blurs it, (H, W, 3). `full` takes it for a coloured one."""
    view = viewing_conditions(display)
    return filtered_lab(displays.to_xyz(shown), **view) if full else filtered_grey_lab(shown, **view)


def viewing_conditions(display: Display) -> dict[str, Any]:
    """What S-CIELAB has to know of a display."""
    return {"white_xyz": displays.WHITE_XYZ, "samples_per_deg": display.samples_per_deg, "filters": display.filters}


@dataclass(frozen=True)
class Screen:
    """What a viewer looks at: a display, the part of the die that is shown on it, and the ideal image of that part.

    size_um : (height, width) of the whole picture on the sensor
    dot_edges_um : of the rows and columns of dots that are shown and scored
    ideal, ideal_lab : shown luminance on those dots, and its CIELAB as the eye blurs it
    full : leave out no transform
    """

    display: Display
    size_um: tuple[float, float]
    dot_edges_um: tuple[Array, Array] = field(repr=False)
    ideal: Array = field(repr=False)
    ideal_lab: Array = field(repr=False)
    full: bool = False

    def luminance(self, frame: Frame, white_e: float) -> Array:
        """`displays.frame_luminance` on these dots."""
        return displays.frame_luminance(frame, self.size_um, white_e, self.display, self.dot_edges_um)

    def delta_e_of(self, image: Array) -> Array:
        """S-CIELAB difference of a shown picture from the ideal one, (H, W)."""
        if self.display.delta_e == "1976" and not self.full:
            return grey_delta_e_map(self.ideal_lab, image, **viewing_conditions(self.display))
        return delta_e(self.ideal_lab, perceived_lab(image, self.display, self.full), self.display.delta_e)


@dataclass(frozen=True)
class ImagingChain:
    """What all pictures of one pixel type share: its mean signal, and what the viewer looks at."""

    signal_e_per_s: Array
    physics: PixelPhysics
    exposure: Exposure
    white_e_per_s: float
    screen: Screen

    def score(self, *key: object) -> Score:
        """Another sensor and another frame for each key."""
        return self.view(self.capture(*key))

    def capture(self, *key: object) -> Frame:
        """The frame behind `score`."""
        return self.capture_with(stream(*key, "sensor"), stream(*key, "frame"))

    def capture_with(self, sensor_rng: np.random.Generator, frame_rng: np.random.Generator) -> Frame:
        """The frame of the sensor that one generator draws, with the temporal noise of the other."""
        sensor = sample_sensor(self.physics, self.signal_e_per_s.shape, sensor_rng)
        return capture_from_rates(self.signal_e_per_s, sensor, self.exposure, frame_rng)

    def view(self, frame: Frame) -> Score:
        """What a viewer sees of a frame."""
        screen = self.screen
        image = displays.shown_luminance(screen.luminance(frame, self.white_e_per_s * frame.integration_s), screen.display)
        border_um = float(screen.dot_edges_um[0][0]), float(screen.dot_edges_um[1][0])
        return Score(screen.delta_e_of(image), screen.ideal, image, frame, self.physics, border_um)


@dataclass(frozen=True)
class PreparedScene:
    """What pixels of one response share, whatever their pitch: the light behind the lens, and what the viewer looks at.

    rate_e_per_s_um2 : (H, W) photo-electrons s⁻¹ µm⁻² of photodiode behind the diffracting lens, means over samples
    white_e_per_s_um2 : of the scene's white, on axis
    """

    rate_e_per_s_um2: Array = field(repr=False)
    sample_pitch_um: float
    white_e_per_s_um2: float
    screen: Screen

    @cached_property
    def running_integral(self) -> Array | None:
        """Down the picture: it takes longer than all that a pitch adds. None where it is too large to be kept."""
        return running_integral(self.rate_e_per_s_um2) if self.rate_e_per_s_um2.size <= MAX_KEPT_SAMPLES else None


def prepare_scene(
    irradiance: SpectralImage,
    camera: Camera,
    physics: PixelPhysics,
    display: Display,
    full: bool = False,
    *,
    border_um: float | None = None,
) -> PreparedScene:
    """Everything up to the pixels. Only the one_to_one raster, whose dots are pixels, makes it depend on the pitch.

    border_um : the largest pitch that shares the frame, as `displays.dot_edges_um` takes it; None takes the pixel's own

    PixsimError for light that is negative or not finite.
    """
    irradiance.validate()
    size_um = displays.picture_size_um(irradiance)
    own_um = physics.pitch_um
    edges_um = displays.dot_edges_um(size_um, own_um, display, own_um if border_um is None else border_um)
    luminance = displays.ideal_luminance(irradiance, camera, physics, display, edges_um)
    if (beyond := float(np.mean(luminance > 1 + 1e-6))) > CLIPPED_WARNING:
        warnings.warn(
            f"{beyond:.0%} of the ideal image is brighter than display white; raise display.white_cd_per_m2", stacklevel=4
        )
    ideal = displays.shown_luminance(luminance, display)
    rate = diffracted_rate(irradiance, camera, physics)
    white = displays.white_rate(irradiance, camera, physics, display)
    screen = Screen(display, size_um, edges_um, ideal, perceived_lab(ideal, display, full), full)
    return PreparedScene(rate, irradiance.pitch_um, white, screen)


# What the pitches of a technology share. Dots that are pixels (one_to_one) leave the irradiance alone to share.
Light = PreparedScene | SpectralImage


class Lights:
    """What the pixels that look at one picture share, made when first asked for, and kept while there is room."""

    def __init__(self, irradiance: SpectralImage, camera: Camera, display: Display) -> None:
        self.irradiance, self.camera, self.display = irradiance, camera, display
        self._kept: dict[object, PreparedScene] = {}

    def of(self, key: object, physics: PixelPhysics, border_um: float) -> Light:
        """For pixels of one response that share a frame, known by any key; `border_um` as `prepare_scene` takes it."""
        if self.display.raster == "one_to_one":
            return self.irradiance
        if key not in self._kept:
            if len(self._kept) >= self.room:
                self._kept.clear()
            self._kept[key] = prepare_scene(self.irradiance, self.camera, physics, self.display, border_um=border_um)
        return self._kept[key]

    @property
    def room(self) -> int:
        """How many may be there at once."""
        planes = 2 * math.prod(self.irradiance.shape) + 4 * self.display.dots**2  # light, spline; ideal image, its CIELAB
        return max(1, LIGHTS_BYTES // (8 * planes))


def chain_at_pitch(light: PreparedScene, physics: PixelPhysics, exposure: Exposure) -> ImagingChain:
    """A pixel of any pitch under a projection for its response."""
    grid_um = light.sample_pitch_um, physics.pitch_um, physics.photodiode_side_um
    signal_e_per_s = integrate_pixels(light.rate_e_per_s_um2, *grid_um, light.running_integral)
    np.maximum(signal_e_per_s, 0.0, out=signal_e_per_s)
    return ImagingChain(signal_e_per_s, physics, exposure, light.white_e_per_s_um2 * physics.photodiode_area_um2, light.screen)


def make_imaging_chain(
    irradiance: SpectralImage, camera: Camera, pixel: Pixel, exposure: Exposure, display: Display, full: bool = False
) -> ImagingChain:
    """Everything up to the noise. Warns where the camera is not the render's, or the display cannot show the scene."""
    rendered = irradiance.header.get("camera")
    if rendered is not None and Camera.model_validate(rendered) != camera:
        warnings.warn("the irradiance was rendered with another camera than the one it is sensed with", stacklevel=3)
    physics = derive(pixel)
    return chain_at_pitch(prepare_scene(irradiance, camera, physics, display, full), physics, exposure)


def evaluate(
    irradiance: SpectralImage,
    camera: Camera,
    pixel: Pixel,
    exposure: Exposure | None = None,
    display: Display | None = None,
    *,
    seed: int = 0,
    full: bool = False,
) -> Score:
    """Sense an irradiance with one individual sensor, show it, and compare it with the ideal image by S-CIELAB.

    camera : the one that the irradiance was rendered with
    exposure, display : None takes the default ones
    seed : of the individual sensor and of its temporal noise
    full : leave out no transform (the result differs by rounding only)

    Raises PixsimError for a pitch that is too small or larger than the die, or an unknown scene white.

    >>> light = SpectralImage([550.0], 10.0, 84.8, data=np.full((32, 32, 1), 1e-3), header={"diffraction": False})
    >>> pixel, display = Pixel(pitch_um=84.8, prnu=0, infrared_cut_nm=700), Display(white_cd_per_m2=1000, dots=32)
    >>> score = evaluate(light, Camera(), pixel, display=display)
    >>> score.delta_e.shape, round(float(score.image.mean() / score.ideal.mean()), 2)
    ((30, 30), 1.0)
    """
    bench = make_imaging_chain(irradiance, camera, pixel, exposure or Exposure(), display or Display(), full)
    return bench.score("evaluate", seed)


DSNU_NODES = 64  # of equal weight
FEW_E = 100.0  # dark charge up to which its Poisson law is summed; above it, 10 σ from 0, a normal one clips nothing by itself
POISSON_TERMS = 200  # 10 σ above `FEW_E`
NO_NOISE_DN = 1e-9  # a σ that stands for 0
COARSE_DN = 8.0  # σ above which a sum over codes is the integral within 1/(24 σ²), 7e-4


def dark_clip(physics: PixelPhysics, integration_s: float, white_e: float) -> dict[str, float]:
    """What the clip at 0 DN does to the dark, and the black level that avoids it; as score.json holds it.

    A dark level is the black level, dark charge (gamma-distributed by DSNU, Poisson), which is never negative, and a normal
    law of reset noise, read noise and offsets. Of a normal level of mean µ and deviation σ (DN), Φ((½ - µ)/σ) stands at 0 DN,
    and rounded, clipped levels have a mean larger than unclipped ones by Σ Φ((-½ - j - µ)/σ) over j = 0, 1, …, which is
    σφ(µ/σ) - µΦ(-µ/σ) for a σ of many DN.

    white_e : mean electrons of the scene's white in this time

    spread_e, spread_dn : `dark_spread_e`
    at_zero_fraction : of the dark pixels, those at 0 DN
    too_bright_e : what the clip adds to the mean of a dark frame
    of_display_white, lightness : the same as luminance over display white (at most 1) and as CIE L*, before the display clips
        and rounds; black has 0, so L* is the ΔE of an even black area
    least_black_level_dn : `pixsim.sensor.least_black_level_dn`

    >>> from pixsim.pixel import derive
    >>> from pixsim.parameters import Pixel
    >>> clip = dark_clip(derive(Pixel()), 0.03, white_e=5e4)  # no black level: half of the dark, σ of 209 e-
    >>> round(clip["at_zero_fraction"], 2), round(clip["too_bright_e"]), clip["least_black_level_dn"]
    (0.54, 71, 15)
    """
    p, gain = physics, physics.dn_per_e
    noise_dn = gain * math.sqrt(p.reset_noise_e**2 + p.read_noise_e**2 + p.offset_fpn_e**2 + p.column_fpn_e**2)
    dark_e = np.array([p.dark_current_e_per_s * integration_s])
    if p.dsnu > np.finfo(float).eps:  # as `sample_sensor` takes it
        shape = p.dsnu**-2
        dark_e = dark_e * gammaincinv(shape, (np.arange(DSNU_NODES) + 0.5) / DSNU_NODES) / shape
    many, few = dark_e[dark_e > FEW_E], np.maximum(dark_e[dark_e <= FEW_E, None], np.finfo(float).tiny)
    counts = np.arange(POISSON_TERMS)
    poisson = np.exp(counts * np.log(few) - few - gammaln(counts + 1)).sum(axis=0)
    charge_e = np.concatenate([counts, many])
    weight = np.concatenate([poisson, np.ones(many.size)]) / dark_e.size
    sigma_dn = np.sqrt(noise_dn**2 + gain**2 * np.concatenate([np.zeros(counts.size), many]))
    at_zero, excess_dn = clipped_at_zero(p.pixel.black_level_dn + gain * charge_e, sigma_dn)
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
    }


def clipped_at_zero(mean_dn: Array, sigma_dn: Array) -> tuple[Array, Array]:
    """P(0) of normal levels (n,) that are rounded and clipped at 0, and by how much the clip raises their mean (DN)."""
    sigma = np.maximum(sigma_dn, NO_NOISE_DN)
    reach = mean_dn / sigma
    excess = sigma * np.exp(-(reach**2) / 2) / math.sqrt(2 * math.pi) - mean_dn * ndtr(-reach)
    fine = sigma <= COARSE_DN
    codes = np.arange(math.ceil(8 * COARSE_DN))[:, None]  # the terms beyond 8 σ are below 1e-15
    excess[fine] = ndtr((-0.5 - codes - mean_dn[fine]) / sigma[fine]).sum(axis=0)
    return ndtr((0.5 - mean_dn) / sigma), excess
