"""Forty pictures that did not set the numbers of the film's error: grey and coloured, of detail
around the width of a sample.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from helpers.chains import imaging
from helpers.film_pictures import PIXEL, covered, light
from scipy.ndimage import zoom

from pixsim.base.arrays import Array
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.camera_lens import LENS_HEADER, Tiling, camera_with_lens
from pixsim.optics.lens_options import LensOptions
from pixsim.sensor.pixel_options import Pixel
from pixsim.viewer.display_options import Display
from pixsim.viewer.imaging import Imaging

BAYER = {"pattern": "rggb", "sensitivities": "Nikon_D5100", "peak_quantum_efficiency": 0.5}


@dataclass(frozen=True)
class Picture:
    """A picture on a film of `film` samples across, and what looks at it; the truth is a film of
    `times` as many samples across.
    """

    name: str
    draw: Callable[
        [int], Array
    ]  # width -> relative luminance, (width, width), or (3, width, width) in three bands
    film: int
    times: int
    imaging: Imaging

    def fine(self) -> SpectralImage:
        """The light on the film of the truth."""
        width, camera = self.film * self.times, self.imaging.camera
        drawn = self.draw(width)
        if drawn.ndim == 2:
            image = light(drawn, camera)
        else:
            grey = light(drawn[1], camera)
            spectrum, nm = grey.factors[0][0], grey.wavelength_nm
            thirds = np.array([nm < 500, (nm >= 500) & (nm < 600), nm >= 600]) * spectrum
            header = grey.header
            image = SpectralImage(
                nm, 20.0, grey.pitch_um, factors=(thirds, drawn.astype(np.float32)), header=header
            )
        if camera.lens is not None:
            image.header[LENS_HEADER] = asdict(Tiling(300.0, 160.0, 0.0))
        return image


def zone_plate(width: int, seed: int) -> Array:
    rate = np.random.default_rng(seed).uniform(200, 700)
    return covered(
        lambda x, y: 0.5 + 0.45 * np.cos(rate * math.pi * ((x - 0.4) ** 2 + (y - 0.55) ** 2)),
        3,
        width,
    )


def cells_of(width: int, samples: float, film: int, seed: int) -> Array:
    """Even cells of some samples of a film across, in step with nothing."""
    tone = np.random.default_rng(seed).choice([0.1, 0.35, 0.8], (film * 2, film * 2))
    return covered(
        lambda x, y: tone[
            np.floor(y * film / samples).astype(int), np.floor(x * film / samples).astype(int)
        ],
        4,
        width,
    )


def wires(width: int, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    turn, count, thick = rng.uniform(0, math.pi), rng.uniform(20, 45), rng.uniform(0.03, 0.09)

    def wire(x: Array, y: Array) -> Array:
        along = (x * math.cos(turn) + y * math.sin(turn)) * count + 0.4 * np.sin(5 * (x - y))
        return np.where(np.abs(along % 1 - 0.5) < thick, 0.05, 0.75)

    return covered(wire, 4, width)


def leaves(width: int, seed: int) -> Array:
    """Fallen leaves whose radii are shares of the width."""
    return fallen_leaves(width, seed, count=3000, radii=(0.002, 0.12), unit=width)


def fallen_leaves(
    width: int, seed: int, *, count: int, radii: tuple[float, float], unit: float = 1.0
) -> Array:
    """Opaque discs whose areas fall with the inverse square of their radii, as in natural scenes.

    radii : the least and the largest, in units
    """
    rng, ground = np.random.default_rng(seed), np.full((width, width), 0.4, np.float32)
    for _ in range(count):
        radius = min(radii[0] / math.sqrt(1 - rng.random()), radii[1]) * unit
        x, y = rng.random(2) * width
        rows, columns = (
            slice(max(int(c - radius), 0), min(int(c + radius + 2), width)) for c in (y, x)
        )
        down, across = (
            np.arange(rows.start, rows.stop) + 0.5 - y,
            np.arange(columns.start, columns.stop) + 0.5 - x,
        )
        cover = np.clip(radius - np.hypot(down[:, None], across[None, :]) + 0.5, 0, 1)
        ground[rows, columns] += cover * (rng.random() * 0.9 + 0.03 - ground[rows, columns])
    return ground


def clouds(width: int, seed: int) -> Array:
    """A texture whose power falls with the square of the frequency, drawn on 1024 cells."""
    rng, n = np.random.default_rng(seed), 1024
    frequency = n * np.hypot(np.fft.fftfreq(n)[:, None], np.fft.rfftfreq(n)[None, :])
    frequency[0, 0] = np.inf
    values = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((n, n))) / frequency, s=(n, n))
    return np.clip(
        0.4
        + 0.15 * zoom(values / values.std(), width / n, order=1, grid_mode=True, mode="grid-wrap"),
        0.01,
        1,
    )


def edges(width: int, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    turn, dark = rng.uniform(0, math.pi), rng.uniform(0.03, 0.3)
    return covered(
        lambda x, y: np.where(
            ((x - 0.5) * math.cos(turn) + (y - 0.5) * math.sin(turn)) * 7 % 1 < 0.5, dark, 0.9
        ),
        4,
        width,
    )


def coloured(
    draw: Callable[[int], Array], tints: tuple[float, float, float]
) -> Callable[[int], Array]:
    """A picture in three bands: in each, another share of its contrast."""

    def three(width: int) -> Array:
        grey = draw(width)
        return np.stack([0.4 + tint * (grey - 0.4) for tint in tints])

    return three


def pictures() -> Iterator[Picture]:
    rng = np.random.default_rng(53)
    cameras = [
        Camera(die_mm=die, focal_length_mm=5.0, f_number=f)
        for die, f in ((1.6, 2.0), (2.1, 4.0), (1.1, 2.8))
    ]
    drawn: list[tuple[str, Callable[[int, int], Array] | None, float]] = [
        *[("zone plate", zone_plate, 0.0)] * 5,
        *[("wires", wires, 0.0)] * 5,
        *[("leaves", leaves, 0.0)] * 4,
        *[("clouds", clouds, 0.0)] * 4,
        *[("edges", edges, 0.0)] * 4,
        *[("edges behind a lens", edges, 0.0)] * 3,
        *[("cells", None, samples) for samples in (0.7, 1.0, 1.3, 2.6, 3.0) for _ in range(3)],
    ]
    for number, (name, kind, samples) in enumerate(drawn):
        behind = name.endswith("lens")
        film = 192 if behind else int(rng.choice([192, 256, 320]))
        draw = (
            partial(cells_of, samples=samples, film=film, seed=number)
            if kind is None
            else partial(kind, seed=number)
        )
        camera, in_colour = cameras[number % 3], number % 3 == 1
        if behind:
            options = LensOptions(file="singlet", focal_length_mm=12.0)
            camera = camera_with_lens(
                Camera(die_mm=2.4, object_distance_m=5.0), CameraOptions(), options
            )
        across = float(
            rng.choice([64, 96, 121, 160])
        )  # pixels on the die: some in step with samples or dots
        pixel = PIXEL.model_copy(update={"pitch_um": 1e3 * camera.die_mm / across})
        if in_colour:
            numbers = pixel.model_dump(exclude_unset=True) | {"colour": BAYER}
            numbers.pop("quantum_efficiency")
            pixel = Pixel.model_validate(numbers)
            draw = coloured(draw, (1.0, 0.7, 0.4))
        display = Display(dots=int(rng.choice([96, 128, 200])))
        label = (
            f"{number}:"
            f" {name}{f' of {samples}' if samples else ''}{', colour' if in_colour else ''}, {film}"
        )
        yield Picture(
            label, draw, film, 5 if behind else 6, imaging(camera, pixel, display=display)
        )


def other_sensor(imaging: Imaging) -> Imaging:
    """A sensor with pixels half as large again, and three times the read noise."""
    pixel = imaging.pixel
    update = {"pitch_um": 1.5 * pixel.pitch_um, "read_noise_e": 7.0}
    return replace(imaging, pixel=pixel.model_copy(update=update))
