"""Light of pictures, as exact or nearly exact means over fine cells, for the error that a film
causes.
"""

import itertools
from collections.abc import Callable, Sequence

import numpy as np

from pixsim.base.arrays import Array, strips
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.optics.thin_lens import irradiance_factor
from pixsim.sensor.pixel_options import Pixel
from pixsim.studies.film_error import delta_e_on_films
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.screen import white_header

ROWS = 32  # at a time, whose numbers stay in the processor's caches
WIDTH = 4096  # of a film that is taken for the truth
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
    return SpectralImage(
        nm,
        20.0,
        pitch_um,
        factors=(spectrum[None], picture[None].astype(np.float32)),
        header={"luminance_cd_per_m2": white_cd_per_m2, "lamp_w_per_m2_sr_nm": spectrum.tolist()},
    )


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


def delta_e_of(films: Sequence[SpectralImage], imaging: Imaging) -> list[float]:
    """The mean ΔE of whole pictures on several films, with the same noise."""
    white = white_header([(imaging, films[0])])
    shown = [
        film.with_planes(film.whole.planes, header=film.header | white, margin=film.margin)
        for film in films
    ]
    return (
        delta_e_on_films(
            [[(film, imaging.display)] for film in shown], [[None]] * len(films), imaging
        )
        .mean(axis=1)
        .tolist()
    )
