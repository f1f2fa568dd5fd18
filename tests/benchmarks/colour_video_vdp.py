"""ColorVideoVDP of the pictures of a study, beside pixsim's own judges of shown pictures.

    python tests/benchmarks/colour_video_vdp.py [--python FILE] [--pitches 1 1.4 2 2.8 4 5.6 8]

ColorVideoVDP (Mantiuk et al., ACM Trans. Graph. 43 (2024) 129) needs PyTorch, which pixsim does not
depend on: `--python` names the interpreter of an environment of its own, made by
`python -m venv E; E/bin/pip install cvvdp`. (Beside a torch without CUDA, the file
torchvision/_meta_registrations.py of torchvision has to be empty: it registers operators that are
not there.) The pictures are those that pixsim's display shows, of the first sensor, with the pixels
per degree of that display; both programs see the same relative luminance. JOD is 10 for pictures
that nobody tells apart, and falls by 1 where 75 % of viewers prefer the other one.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import pixsim

# Run by the other interpreter: pictures in, JOD out.
JUDGE = """
import json, sys, numpy as np, torch, pycvvdp
from importlib import metadata
job = json.load(open(sys.argv[1]))
wide_deg = job["width"] / job["dots_per_deg"]
geometry = pycvvdp.vvdp_display_geometry((job["width"], job["height"]), distance_m=1.0, fov_horizontal=wide_deg)
photometry = pycvvdp.vvdp_display_photo_eotf(Y_peak=job["peak_cd_per_m2"], contrast=1e6, source_colorspace="sRGB", EOTF="linear")
metric = pycvvdp.cvvdp(display_geometry=geometry, display_photometry=photometry, device=torch.device("cpu"), quiet=True)
pictures = np.load(job["pictures"])
def light(relative):
    grey = np.clip(relative, 0, None) * job["peak_cd_per_m2"]
    return np.repeat(grey[..., None], 3, axis=2).astype(np.float32)
found = []
for image in pictures["images"]:
    jod, _ = metric.predict(light(image), light(pictures["ideal"]), dim_order="HWC")
    found.append(float(jod))
print(json.dumps({"jod": found, "version": metadata.version("cvvdp")}))
"""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--python", default=sys.executable, help="interpreter that has cvvdp")
    parser.add_argument(
        "--pitches", type=float, nargs="+", default=[1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0]
    )
    parser.add_argument("--peak-cd-per-m2", type=float, default=100.0)
    asked = parser.parse_args()
    scene = pixsim.load_scene("csf", luminance_cd_per_m2=10.0, resolution=1024)
    camera = scene.camera()
    light = pixsim.render(scene, camera)
    display = pixsim.Display()
    exposure = pixsim.Exposure(max_integration_s=0.033)
    scores = [
        pixsim.evaluate(
            light, camera, pixsim.Pixel(technology="4t-bsi", pitch_um=pitch_um), exposure, display
        )
        for pitch_um in asked.pitches
    ]
    shape = np.min([score.image.shape for score in scores], axis=0)

    def central(picture: np.ndarray) -> np.ndarray:
        rows, columns = (
            (full - part) // 2 for full, part in zip(picture.shape, shape, strict=True)
        )
        return picture[rows : rows + shape[0], columns : columns + shape[1]]

    with tempfile.TemporaryDirectory() as folder:
        pictures, job = Path(folder) / "pictures.npz", Path(folder) / "job.json"
        np.savez(
            pictures,
            ideal=central(scores[0].ideal),
            images=np.stack([central(score.image) for score in scores]),
        )
        settings = {
            "width": int(shape[1]),
            "height": int(shape[0]),
            "dots_per_deg": display.samples_per_deg,
        }
        job.write_text(
            json.dumps(
                settings | {"peak_cd_per_m2": asked.peak_cd_per_m2, "pictures": str(pictures)}
            )
        )
        done = subprocess.run(
            [asked.python, "-c", JUDGE, str(job)], capture_output=True, text=True, check=False
        )
        if done.returncode:
            sys.exit(f"ColorVideoVDP did not run: {done.stderr[-2000:]}")
    found = json.loads(done.stdout.splitlines()[-1])
    print(
        f"ColorVideoVDP {found['version']}, csf at 10 cd/m², 4t-bsi, {display.samples_per_deg:g}"
        " dots per degree"
    )
    print("pitch µm    mean ΔE       JOD")
    for pitch_um, score, jod in zip(asked.pitches, scores, found["jod"], strict=True):
        print(f"{pitch_um:8.2f} {score.mean_delta_e:10.4f} {jod:9.4f}")


if __name__ == "__main__":
    main()
