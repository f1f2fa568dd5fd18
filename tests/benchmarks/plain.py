"""The stages as one writes them with Mitsuba, NumPy and SciPy: what pixsim's kernels and whole runs are compared with.

The render takes a scene's XML as it is: `path`, a specfilm of bands of equal width, a box filter. After it come
one padded Fourier transform per channel, picture or band; running sums for the light on a photodiode; one noise stage
after another; an interpolator for the display. Every picture is (H, W), every stage makes new arrays, and nothing is shared
between two evaluations.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.interpolate import CubicSpline, RegularGridInterpolator
from scipy.ndimage import convolve

from pixsim import optics
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.scene.mitsuba import speaking_mitsuba
from pixsim.scene.scene import Scene, sensor_node
from pixsim.sensor.pixel import PixelPhysics
from pixsim.viewer.display import WHITE_XYZ
from pixsim.viewer.display_options import Display
from pixsim.viewer.scielab import OPPONENT_FROM_XYZ, PUBLISHED_GAUSSIANS, XYZ_FROM_OPPONENT

GAMMA, TOP_CODE = 2.2, 255  # of the display


def plain_mitsuba(scene: Scene, resolution: int, sampler: str, bands_nm: np.ndarray) -> Callable[[int, int], np.ndarray]:
    """Render of (samples, seed): radiance in bands of equal width, (H, W, B), of a square film."""
    film = {"type": "specfilm", "component_format": "float32", "rfilter": {"type": "box"}}
    film |= {"width": resolution, "height": resolution}
    half_nm = float(bands_nm[1] - bands_nm[0]) / 2
    for k, nm in enumerate(bands_nm.tolist()):
        film[f"band{k}"] = {"type": "regular", "wavelength_min": nm - half_nm, "wavelength_max": nm + half_nm, "values": "1, 1"}
    with speaking_mitsuba(scene.choice.variant) as mi:
        loaded = mi.load_file(str(scene.path), **scene.parameters)
        sensor = sensor_node(scene.parse(), None)[1]
        names = ("type", "fov", "aperture_radius", "focus_distance", "to_world")
        lens = {key: sensor[key] for key in names if key in sensor}
        lens["to_world"] = mi.ScalarTransform4f(lens["to_world"])

    def picture(spp: int, seed: int) -> np.ndarray:
        with speaking_mitsuba(scene.choice.variant) as mi:
            camera = mi.load_dict({"type": "thinlens", **lens, "film": film, "sampler": {"type": sampler, "sample_count": spp}})
            path = mi.load_dict({"type": "path"})
            return np.asarray(mi.render(loaded, sensor=camera, integrator=path, spp=spp, seed=seed), float)

    return picture


def plain_optics(image: SpectralImage, camera: Camera, weight: np.ndarray) -> np.ndarray:
    """Weighted sum of the bands behind a lens at its diffraction limit: one padded transform per band."""
    total = np.zeros(image.shape)
    for k, nm in enumerate(image.wavelength_nm):
        margin = image.shape[0] // 2
        padded = np.pad(weight[k] * image.band(k).astype(float), margin, mode="symmetric")
        fy, fx = np.fft.fftfreq(padded.shape[0], image.pitch_um * 1e-3), np.fft.rfftfreq(padded.shape[1], image.pitch_um * 1e-3)
        otf = optics.diffraction_otf(np.hypot(fx, fy[:, None]), nm, camera.effective_f_number)
        total += np.fft.irfft2(np.fft.rfft2(padded) * otf, padded.shape)[margin:-margin, margin:-margin]
    return total


def plain_integrals(picture: np.ndarray, cell_um: float, low_um: np.ndarray, high_um: np.ndarray) -> np.ndarray:
    """Integrals along both axes, in (unit of the picture) · µm², between positions that are the same along both.

    Running sums at the borders of the cells, with a cubic spline in between. Straight lines in between take half of the time,
    but need a film four times as fine for the same mean ΔE: 4 % more for photodiodes of 1.8 cells.
    """
    for _ in range(2):
        running = np.concatenate([np.zeros((1, picture.shape[1])), np.cumsum(picture, axis=0)]) * cell_um
        up_to = CubicSpline(np.arange(len(running)) * cell_um, running)
        last_um = len(picture) * cell_um
        picture = (up_to(np.clip(high_um, 0, last_um)) - up_to(np.clip(low_um, 0, last_um))).T
    return picture


def plain_pixels(rate: np.ndarray, cell_um: float, pitch_um: float, side_um: float) -> np.ndarray:
    """Light on the square photodiodes of an array that is centred on a square picture."""
    size_um = len(rate) * cell_um
    count = int(size_um / pitch_um + 1e-9)
    centre_um = size_um / 2 + (np.arange(count) - (count - 1) / 2) * pitch_um
    return plain_integrals(rate, cell_um, centre_um - side_um / 2, centre_um + side_um / 2)


def plain_frame(mean_e: np.ndarray, p: PixelPhysics, seconds: float, rng: np.random.Generator) -> np.ndarray:
    """Digital numbers: one noise stage after another, each with a new array."""
    gain = np.clip(rng.normal(1, p.prnu, mean_e.shape), 0, None)
    dark = p.dark_current_e_per_s * seconds * rng.gamma(p.dsnu**-2, p.dsnu**2, mean_e.shape)
    level = np.clip(rng.poisson(mean_e * gain + dark), 0, p.full_well_e)
    level = level + rng.normal(0, p.reset_noise_e, mean_e.shape)
    level = level + rng.normal(0, p.read_noise_e, mean_e.shape)
    level = level + rng.normal(0, p.offset_fpn_e, mean_e.shape) + rng.normal(0, p.column_fpn_e, mean_e.shape[1])
    return np.clip(np.rint(level * p.dn_per_e), 0, 2**p.pixel.bits - 1)


def plain_display(picture: np.ndarray, pitch_um: float, size_um: float, dots: int) -> np.ndarray:
    """Light of dots that span `size_um`, from pixels centred there: 2 × 2 interpolated points per dot, in codes of 8 bits."""
    n = len(picture)
    centre_um = size_um / 2 + (np.arange(n) - (n - 1) / 2) * pitch_um
    lines = RegularGridInterpolator((centre_um,) * 2, picture)
    at = np.clip((np.arange(2 * dots) + 0.5) * size_um / (2 * dots), centre_um[0], centre_um[-1])
    points = np.stack(np.meshgrid(at, at, indexing="ij"), axis=-1)
    return plain_codes(lines(points).reshape(dots, 2, dots, 2).mean(axis=(1, 3)))


def plain_codes(light: np.ndarray) -> np.ndarray:
    """What a display shows of luminances, 1 for white."""
    return (np.rint(TOP_CODE * np.clip(light, 0, 1) ** (1 / GAMMA)) / TOP_CODE) ** GAMMA


def plain_ideal(rate: np.ndarray, cell_um: float, white: float, dots: int) -> np.ndarray:
    """What the display shows of the light itself: its mean over each dot."""
    edges_um = np.linspace(0, len(rate) * cell_um, dots + 1)
    dot_um2 = (edges_um[1] - edges_um[0]) ** 2
    return plain_codes(plain_integrals(rate, cell_um, edges_um[:-1], edges_um[1:]) / dot_um2 / white)


def plain_blur(plane: np.ndarray, gaussians: tuple[tuple[float, float], ...], samples_per_deg: float) -> np.ndarray:
    """Sum of weights times Gaussians exp(-r²/spread²), of unit sum, of a plane that is reflected at its borders."""
    rows, columns = plane.shape
    padded = np.pad(plane, ((0, rows), (0, columns)), mode="symmetric")
    fy, fx = np.fft.fftfreq(2 * rows, 1 / samples_per_deg), np.fft.rfftfreq(2 * columns, 1 / samples_per_deg)
    squared = fx**2 + fy[:, None] ** 2
    transfer = sum(weight * np.exp(-((np.pi * spread_deg) ** 2) * squared) for weight, spread_deg in gaussians)
    transfer = transfer / sum(weight for weight, _ in gaussians)
    return np.fft.irfft2(np.fft.rfft2(padded) * transfer, padded.shape)[:rows, :columns]


def plain_lab(xyz: np.ndarray, white: np.ndarray, samples_per_deg: float) -> np.ndarray:
    """CIELAB of XYZ (H, W, 3) after the eye's blur."""
    opponent = np.einsum("ij,yxj->yxi", OPPONENT_FROM_XYZ, xyz)
    seen = np.stack([plain_blur(opponent[..., k], PUBLISHED_GAUSSIANS[k], samples_per_deg) for k in range(3)], axis=-1)
    relative = np.einsum("ij,yxj->yxi", XYZ_FROM_OPPONENT, seen) / white
    f = np.where(relative > 216 / 24389, np.cbrt(relative), 841 / 108 * relative + 16 / 116)
    return np.stack([116 * f[..., 1] - 16, 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])], axis=-1)


def plain_delta_e(reference: np.ndarray, test: np.ndarray, samples_per_deg: float) -> np.ndarray:
    """S-CIELAB map of a pair of pictures in XYZ, (H, W, 3)."""
    labs = [plain_lab(image, WHITE_XYZ, samples_per_deg) for image in (reference, test)]
    return np.sqrt(((labs[0] - labs[1]) ** 2).sum(axis=-1))


def plain_score(
    mean_e: np.ndarray,
    ideal: np.ndarray,
    white_e: float,
    seconds: float,
    p: PixelPhysics,
    size_um: float,
    display: Display,
    border_um: float,
    rng: np.random.Generator,
) -> float:
    """Mean ΔE of one frame against the ideal picture on the dots; those of a border, which pixels may not fill, are left out.

    white_e : mean electrons of the scene's white
    """
    dark_e = p.dark_current_e_per_s * seconds
    electrons = plain_frame(mean_e, p, seconds, rng) / p.dn_per_e - dark_e
    shown = plain_display(electrons / white_e, p.pitch_um, size_um, display.dots)
    cut = int(np.ceil(border_um / size_um * display.dots * (1 - 1e-9)))
    inside = slice(cut, display.dots - cut)
    pair = (picture[inside, inside, None] * WHITE_XYZ for picture in (ideal, shown))
    return float(plain_delta_e(*pair, display.samples_per_deg).mean())


def plain_bilinear(mosaic: np.ndarray) -> np.ndarray:
    """Bilinear demosaicing of RGGB by one convolution a channel."""
    y, x = np.indices(mosaic.shape) % 2
    cross, square = np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]]) / 4, np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]]) / 4
    masks = ((y == 0) & (x == 0), square), (y != x, cross), ((y == 1) & (x == 1), square)
    return np.stack([convolve(mosaic * mask, kernel, mode="mirror") for mask, kernel in masks], axis=-1)
