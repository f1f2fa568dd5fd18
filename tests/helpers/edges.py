"""Pictures of slanted edges whose MTF is known in closed form."""

import numpy as np
from scipy.special import erf

from pixsim.sensor.colour import Layout

SIDE = 320
DARK, LIGHT = 100.0, 1000.0
SIGMA_PX = 0.6  # of the Gaussian blur, if no other is stated
PIXEL_NOISE = np.random.default_rng(9).standard_normal((SIDE, SIDE))
GAINS = {"R": 0.6, "G": 1.0, "B": 0.4, "W": 1.6}  # of the channels of a mosaic


def distances(
    angle_deg: float, height: int = SIDE, width: int = SIDE, shift: float = 0.2
) -> np.ndarray:
    """Return signed distances of the pixel centres from an edge, clockwise from the vertical."""
    y, x = np.mgrid[:height, :width]
    angle = np.radians(angle_deg)
    return (x - (width - 1) / 2 - shift) * np.cos(angle) + (y - (height - 1) / 2) * np.sin(angle)


def blurred(distance_px: np.ndarray, sigma_px: float = SIGMA_PX) -> np.ndarray:
    """Return the light at distances from an edge with the MTF exp(-2 π² σ² f²)."""
    return DARK + (LIGHT - DARK) * (1 + erf(distance_px / (sigma_px * 2**0.5))) / 2


def gaussian_edge(angle_deg: float = 5.0, sigma_px: float = SIGMA_PX, **size: int) -> np.ndarray:
    return blurred(distances(angle_deg, **size), sigma_px)


def gaussian_mtf(frequency: np.ndarray, sigma_px: float = SIGMA_PX) -> np.ndarray:
    return np.exp(-2 * (np.pi * sigma_px * frequency) ** 2)


def mosaic(layout: str, edge: np.ndarray) -> np.ndarray:
    """Return the frame of an edge in grey light behind a mosaic."""
    cell = Layout.parse(layout)
    return edge * np.array([GAINS[letter] for letter in cell.channels])[cell.numbers(edge.shape)]
