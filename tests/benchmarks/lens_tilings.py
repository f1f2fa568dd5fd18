"""Tilings of the packaged lenses on the default sensor, which pixsim ships:

    python tests/benchmarks/lens_tilings.py > pixsim/data/lens_tilings.toml

They serve all packaged scenes with two samples or more across a photodiode. To be run again after
a change of a lens, of the search for a tiling, of the default sensor or of the default camera, as a
test in tests/scene/test_lenses.py notices.
"""

from __future__ import annotations

import os
from dataclasses import asdict
from unittest.mock import patch

import pixsim
from pixsim.base.toml import packaged
from pixsim.optics.camera_lens import choose_tiling, tiling_key
from pixsim.optics.lens_options import LensOptions


def main() -> None:
    os.environ["PIXSIM_CACHE_GIB"] = "0"
    print("# Written by tests/benchmarks/lens_tilings.py: the Tiling of each tiling_key")
    scene = pixsim.load_scene("csf")
    for lens in packaged("data/lenses"):
        with (
            patch("pixsim.optics.camera_lens.packaged_tables", lambda _: {}),
            patch("pixsim.scene.real_lens.choose_tiling", side_effect=choose_tiling) as chosen,
        ):
            pixsim.make_plan(scene, scene.camera(None, LensOptions(file=lens)))
            asked = chosen.call_args.args
            print(f"\n[{tiling_key(*asked)}]  # {lens}")
            for entry, value in asdict(choose_tiling(*asked)).items():
                print(f"{entry} = {value!r}")


if __name__ == "__main__":
    main()
