"""PSNR of the denoisers on known pictures with the noise of a sensor, beside BM3D where its authors' package is installed.

    python tests/benchmarks/denoisers.py

BM3D (Dabov et al., IEEE Trans. Image Process. 16 (2007) 2080; `pip install bm3d`, whose licence allows no commercial use) is an
outside standard here and no part of pixsim. All get the same frames, of 1.5 e- read noise, and all but the bound the same
transform, which is for bm3d called as a user's function.
"""

from __future__ import annotations

import math
import sys
import time
from importlib.util import find_spec

import numpy as np

from pixsim.scene.charts import csf_value
from pixsim.viewer.denoising.filters import denoised_plane
from pixsim.viewer.denoising.wiener import wiener_plane

SIDE, READ_NOISE_E, FRAMES = 256, 1.5, 3
WHITES_E = (5, 50, 500)


def pictures() -> dict[str, np.ndarray]:
    """The CSF chart, smooth nearly everywhere, and scikit-image's photographs of a cameraman and of a brick wall, 0 to 1."""
    from skimage import data

    at = (np.arange(SIDE) + 0.5) / SIDE
    photographs = {name: getattr(data, name)().astype(float) for name in ("camera", "brick")}
    halved = {name: (one[::2, ::2] + one[1::2, ::2] + one[::2, 1::2] + one[1::2, 1::2]) / 1020 for name, one in photographs.items()}
    return {"CSF chart": np.asarray(csf_value(at, at[:, None]))} | halved


def bm3d(plane: np.ndarray, sigma: float) -> np.ndarray:
    """BM3D of its authors; a margin keeps its borders from the picture."""
    from bm3d import bm3d as by_authors

    return np.asarray(by_authors(plane, sigma_psd=sigma), float)


def main() -> None:
    methods = {"wavelet": "wavelet", "nlm": "nlm"} | ({"bm3d": bm3d} if find_spec("bm3d") else {})
    print(f"PSNR in dB {'white':>15} {'frame':>7} {'bound':>7} " + " ".join(f"{name:>7}" for name in methods))
    spent = dict.fromkeys(methods, 0.0)
    for name, picture in pictures().items():
        for white_e in WHITES_E:
            true = white_e * picture
            rng, found = np.random.default_rng(45), {}
            for _ in range(FRAMES):
                raw = rng.poisson(true) + READ_NOISE_E * rng.standard_normal(true.shape)
                shown = {"frame": raw, "bound": wiener_plane(raw, true, true + READ_NOISE_E**2)}
                for method, function in methods.items():
                    start = time.process_time()
                    shown[method] = denoised_plane(raw, READ_NOISE_E**2, function)
                    spent[method] += time.process_time() - start
                for method, one in shown.items():
                    found.setdefault(method, []).append(((one - true) ** 2).mean())
            decibels = {method: 10 * math.log10(white_e**2 / np.mean(errors)) for method, errors in found.items()}
            print(f"{name:>10} {white_e:12} e- " + " ".join(f"{value:7.1f}" for value in decibels.values()), flush=True)
    count = FRAMES * len(WHITES_E) * len(pictures())
    print("s of processors a plane of 256²: " + ", ".join(f"{method} {1 / count * time_s:.2f}" for method, time_s in spent.items()))


if __name__ == "__main__":
    sys.exit(main())
