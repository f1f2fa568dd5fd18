"""Pictures with edges and textures, for the error that a film causes, as exact or nearly exact
means over fine cells.

The numbers of `pixsim/studies/film_error.py` were fitted to `SCENES` and `SET_CELLS`. `JUDGES` were
not looked at for that: other kinds of pictures, other random numbers, other cameras, pixels,
displays and films.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from pixsim.base.arrays import Array, strips
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.optics.thin_lens import irradiance_factor
from pixsim.sensor.pixel_options import Pixel
from pixsim.viewer.display_options import Display

ROWS = 32  # at a time, whose numbers stay in the processor's caches
WIDTH = 4096  # of the films that are taken for the truth of `SCENES`
CAMERA = Camera(die_mm=2.4, focal_length_mm=4.0, f_number=2.8)
PIXEL = Pixel(
    technology="none", pitch_um=3.75, full_well_e=10500, read_noise_e=2.3, dark_current_e_per_s=3, quantum_efficiency=0.62, bits=12,
    black_level_dn=64,
)  # fmt: skip


def light(
    picture: Array, camera: Camera = CAMERA, white_cd_per_m2: float = 1000.0
) -> SpectralImage:
    """Irradiance of a picture of relative luminance, under light of equal energy."""
    nm = np.arange(410.0, 700.0, 20.0)
    pitch_um = 1e3 * camera.die_mm / picture.shape[1]
    unit = SpectralImage(nm, 20.0, pitch_um, factors=(np.ones((1, nm.size)), np.zeros((1, 1, 1))))
    lux = white_cd_per_m2 * float(irradiance_factor(camera.f_number, 0.0, camera.magnification))
    spectrum = np.full(nm.size, lux / unit.luminous_weight().sum())
    header = {"luminance_cd_per_m2": white_cd_per_m2, "lamp_w_per_m2_sr_nm": spectrum.tolist()}
    return SpectralImage(
        nm,
        20.0,
        pitch_um,
        factors=(spectrum[None], picture[None].astype(np.float32)),
        header=header,
    )


# --- Ten scenes ---


def covered(inside: Callable[[Array, Array], Array], points: int = 3, width: int = WIDTH) -> Array:
    """Means over cells from `points` × `points` points in each."""
    offsets = (np.arange(points) + 0.5) / points
    axis = np.arange(width)
    total = np.zeros((width, width), np.float32)
    for rows in strips(width, 1, ROWS):
        for down, across in itertools.product(offsets, offsets):
            total[rows] += inside(
                (axis[None, :] + across) / width, (axis[rows, None] + down) / width
            )
    return total / points**2


def edge() -> Array:
    return covered(lambda x, y: 0.1 + 0.9 * (x - 0.5 > (0.5 - y) * math.tan(math.radians(5))))


def star() -> Array:
    return covered(lambda x, y: 0.025 + 0.975 * (np.sin(72 * np.arctan2(0.5 - y, x - 0.5)) > 0))


def tiled_floor() -> Array:
    return covered(
        lambda x, y: (
            0.2 + 0.6 * ((np.floor(3 * (x - 0.5) / (y + 0.08)) + np.floor(3 / (y + 0.08))) % 2)
        )
    )


def turned_checkerboard() -> Array:
    return covered(
        lambda x, y: (
            0.1 + 0.8 * ((np.floor((x + 0.13 * y) * 97.3) + np.floor((y - 0.13 * x) * 97.3)) % 2)
        )
    )


def zone_plate() -> Array:
    return covered(
        lambda x, y: 0.5 + 0.45 * np.cos(900 * math.pi * ((x - 0.5) ** 2 + (y - 0.5) ** 2)), 2
    )


def woven() -> Array:
    def cloth(x: Array, y: Array) -> Array:
        return (
            0.4
            + 0.16 * np.sign(np.sin(620 * math.pi * (x + 0.02 * np.sin(9 * y))))
            + 0.15 * np.sin(574 * math.pi * (y + 0.3 * x))
        )

    return covered(cloth, 2)


def print_like() -> Array:
    rng, page = np.random.default_rng(1), np.full((WIDTH, WIDTH), 0.9, np.float32)
    for _ in range(60_000):
        sides = rng.permutation([int(rng.integers(2, 40)), int(rng.integers(2, 12))])
        row, column = (int(rng.integers(0, WIDTH - side)) for side in sides)
        page[row : row + sides[0], column : column + sides[1]] = rng.choice([0.03, 0.05, 0.1])
    return page


def fallen_leaves() -> Array:
    """Opaque discs whose areas fall with the inverse square of their radii, as in natural
    scenes.
    """
    rng, ground = np.random.default_rng(2), np.full((WIDTH, WIDTH), 0.4, np.float32)
    for _ in range(12_000):
        radius, (x, y) = min(6 / math.sqrt(1 - rng.random()), 500.0), rng.random(2) * WIDTH
        rows, columns = (
            slice(max(int(c - radius), 0), min(int(c + radius + 2), WIDTH)) for c in (y, x)
        )
        down, across = (
            np.arange(rows.start, rows.stop) + 0.5 - y,
            np.arange(columns.start, columns.stop) + 0.5 - x,
        )
        cover = np.clip(radius - np.hypot(down[:, None], across[None, :]) + 0.5, 0, 1)
        ground[rows, columns] += cover * (rng.random() * 0.9 + 0.03 - ground[rows, columns])
    return ground


def fractal() -> Array:
    """A texture whose power falls with the square of the frequency, as in natural scenes."""
    rng = np.random.default_rng(3)
    frequency = WIDTH * np.hypot(np.fft.fftfreq(WIDTH)[:, None], np.fft.rfftfreq(WIDTH)[None, :])
    frequency[0, 0] = np.inf
    values = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((WIDTH, WIDTH))) / frequency)
    return np.clip(0.4 + 0.15 * values / values.std(), 0.01, 1)


def barcodes() -> Array:
    rng = np.random.default_rng(5)

    def lines() -> Array:
        return rng.uniform(0.05, 0.95, WIDTH)[
            np.searchsorted(np.cumsum(rng.integers(1, 60, WIDTH)), np.arange(WIDTH), "right")
        ]

    return np.sqrt(lines()[None, :] * lines()[:, None])


SCENES = (
    edge,
    star,
    tiled_floor,
    turned_checkerboard,
    zone_plate,
    woven,
    print_like,
    fallen_leaves,
    fractal,
    barcodes,
)


def cells(across: int, width: int, levels: Sequence[float] | None, seed: int) -> Array:
    """A texture of even cells, each of one of the levels, or of any from 0.05 to 0.95; it fills a
    film of `width`.
    """
    assert width % across == 0
    rng = np.random.default_rng(seed)
    values = (
        rng.uniform(0.05, 0.95, (across, across))
        if levels is None
        else rng.choice(levels, (across, across))
    )
    return values.astype(np.float32).repeat(width // across, axis=0).repeat(width // across, axis=1)


# The film, cells across it, and times that the film of the truth is as wide. Cells are 1, 2, 3 and
# 1/2 samples wide.
SET_CELLS = (
    (1024, 1024, 4),
    (512, 512, 8),
    (768, 768, 4),
    (768, 384, 4),
    (510, 170, 8),
    (1020, 340, 4),
    (510, 1020, 8),
)


# --- Pictures that judge ---


def bricks(width: int, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    tone, rows = rng.uniform(0.15, 0.5, (80, 80)), rng.uniform(31, 53)

    def wall(x: Array, y: Array) -> Array:
        row = np.floor(y * rows)
        along = 0.42 * rows * x + 0.5 * (row % 2)
        mortar = (y * rows % 1 < 0.13) | (along % 1 < 0.06)
        return np.where(mortar, 0.8, tone[row.astype(int) % 80, np.floor(along).astype(int) % 80])

    return covered(wall, 3, width)


def gravel(width: int, seed: int) -> Array:
    """Cells around random points (Voronoi), by the nearest point of the 3 × 3 squares around each
    place.
    """
    rng, n = np.random.default_rng(seed), 70
    at, tone = rng.random((2, n + 2, n + 2)), rng.uniform(0.05, 0.9, (n + 2, n + 2))

    def stones(x: Array, y: Array) -> Array:
        x, y = np.broadcast_arrays(x * n, y * n)
        nearest, shown = np.full(x.shape, np.inf), np.zeros(x.shape)
        for down in (0, 1, 2):
            for across in (0, 1, 2):
                i, j = np.floor(y).astype(int) + down, np.floor(x).astype(int) + across
                far = (i - 1 + at[0, i, j] - y) ** 2 + (j - 1 + at[1, i, j] - x) ** 2
                shown = np.where(far < nearest, tone[i, j], shown)
                nearest = np.minimum(far, nearest)
        return shown

    return covered(stones, 2, width)


def blots(width: int, seed: int) -> Array:
    """Black and white, by the sign of noise of a band of frequencies, as camouflage or frost."""
    rng = np.random.default_rng(seed)
    n = width // 2
    frequency = n * np.hypot(np.fft.fftfreq(n)[:, None], np.fft.rfftfreq(n)[None, :])
    centre = rng.uniform(30, 70)
    values = np.fft.irfft2(
        np.fft.rfft2(rng.standard_normal((n, n))) * np.exp(-((frequency - centre) ** 2) / 200),
        s=(n, n),
    )
    return np.where(values > 0, 0.75, 0.12).astype(np.float32).repeat(2, axis=0).repeat(2, axis=1)


def chirp(width: int, seed: int) -> Array:
    turn = np.random.default_rng(seed).uniform(0, math.pi)

    def waves(x: Array, y: Array) -> Array:
        along = 0.5 + (x - 0.5) * math.cos(turn) * 0.7 + (y - 0.5) * math.sin(turn) * 0.7
        return 0.45 + 0.4 * np.sin(6 * np.exp(4 * along))

    return covered(waves, 2, width)


def wire_mesh(width: int, seed: int) -> Array:
    turn, count = np.random.default_rng(seed).uniform(0, 1), 37.7

    def mesh(x: Array, y: Array) -> Array:
        wires = [
            np.abs(((x * math.cos(a) + y * math.sin(a)) * count) % 1 - 0.5) < 0.07
            for a in turn + np.arange(3) * math.pi / 3
        ]
        return np.where(wires[0] | wires[1] | wires[2], 0.06, 0.7)

    return covered(mesh, 3, width)


def halftone(width: int, seed: int) -> Array:
    turn = np.random.default_rng(seed).uniform(0.2, 0.6)

    def dots(x: Array, y: Array) -> Array:
        u, v = (
            (x * math.cos(a) + y * math.sin(a)) * 63.1 % 1 - 0.5 for a in (turn, turn + math.pi / 2)
        )
        return np.where(np.hypot(u, v) < 0.15 + 0.35 * x * y, 0.05, 0.85)

    return covered(dots, 3, width)


def pickets(width: int, seed: int) -> Array:
    shift = np.random.default_rng(seed).uniform(0, 1)
    return covered(
        lambda x, y: 0.1 + 0.7 * (((11 * x + shift) / (0.15 + 0.9 * x) * 4 + 0.05 * y) % 1 < 0.55),
        3,
        width,
    )


def cloud(width: int, seed: int) -> Array:
    """A texture whose power falls with the third power of the frequency, and whose brightness is
    log-normal.
    """
    rng = np.random.default_rng(seed)
    frequency = width * np.hypot(np.fft.fftfreq(width)[:, None], np.fft.rfftfreq(width)[None, :])
    frequency[0, 0] = np.inf
    values = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((width, width))) / frequency**1.5)
    return np.clip(0.25 * np.exp(0.8 * values / values.std()), 0.005, 1)


def grass(width: int, seed: int) -> Array:
    rng, ground = np.random.default_rng(seed), np.full((width, width), 0.15, np.float32)
    steps = np.linspace(0, 1, width // 12)
    for _ in range(5000):
        (x, y), lean, tone = rng.random(2) * width, rng.uniform(-0.6, 0.6), rng.uniform(0.1, 0.8)
        blade = steps * width / 24
        rows, columns = (
            (y + blade).astype(int) % width,
            (x + lean * blade + 0.01 * lean * blade**2).astype(int) % width,
        )
        ground[rows, columns] = ground[rows, (columns + 1) % width] = tone
    return ground


def night_windows(width: int, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    lit = rng.choice([0.004, 0.03, 0.6, 1.0], (90, 60), p=[0.4, 0.3, 0.2, 0.1])

    def town(x: Array, y: Array) -> Array:
        u, v = 58.3 * x, 87.7 * (y + 0.04 * x)
        return np.where(
            (u % 1 < 0.6) & (v % 1 < 0.5),
            lit[np.floor(v).astype(int) % 90, np.floor(u).astype(int) % 60],
            0.01,
        )

    return covered(town, 3, width)


@dataclass(frozen=True)
class Judge:
    """A picture on a film, and what looks at it; the truth is a film of `times` as many samples
    across.
    """

    name: str
    picture: Callable[[int], Array]
    film: int
    times: int
    camera: Camera
    pixel: Pixel
    display: Display


def _judges() -> list[Judge]:
    rng, found = np.random.default_rng(37), []
    cameras = [
        Camera(die_mm=die, focal_length_mm=5.0, f_number=f)
        for die, f in ((1.6, 2.0), (2.1, 4.0), (1.1, 2.8))
    ]

    def add(name: str, picture: Callable[[int], Array], film: int, times: int) -> None:
        camera, dots = cameras[len(found) % 3], int(rng.choice([128, 200, 256]))
        across = float(
            rng.choice([96, 160, 223, 256])
        )  # pixels on the die: some in step with samples or dots
        pixel = PIXEL.model_copy(update={"pitch_um": 1e3 * camera.die_mm / across})
        found.append(
            Judge(f"{name}, {film}", picture, film, times, camera, pixel, Display(dots=dots))
        )

    films = ((256, 8), (384, 6), (480, 4), (300, 6))
    for number, kind in enumerate(
        (bricks, gravel, blots, chirp, wire_mesh, halftone, pickets, cloud, grass, night_windows)
        * 2
    ):
        seed = 100 + number
        add(kind.__name__, partial(kind, seed=seed), *films[(number + number // 10) % 4])
    for film, across, times in (
        (512, 512, 4), (256, 256, 8), (384, 192, 6), (480, 240, 4), (384, 128, 6), (480, 160, 4), (255, 85, 8),
        (384, 768, 6), (256, 768, 12), (300, 300, 6),
    ):  # fmt: skip
        levels = ((0.2, 0.7), (0.05, 0.3, 0.9), None)[
            across % 3 if across != film else len(found) % 3
        ]
        seed = 200 + len(found)
        add(f"{across} cells", partial(cells, across, levels=levels, seed=seed), film, times)
    return found


JUDGES = _judges()
