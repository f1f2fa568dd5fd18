"""Renders that were made before: the pictures of a job's runs, in the cache."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pixsim import cache
from pixsim.parameters import Camera, content_hash
from pixsim.plan import Plan
from pixsim.scene import Scene
from pixsim.tree_hash import hash_of_tree

Pictures = list[NDArray[np.float32]]

KIND = "render"


def hash_of_job(scene: Scene, state: Any, camera: Camera, plan: Plan, seed: int) -> str:
    """Of all that makes the light of a job's runs, and of nothing else: neither the pixel nor the display, unless the plan
    differs for them.

    state : the scene as parsed for the camera
    """
    lights = [
        [
            light.lamp.spectrum is None,
            sorted(light.lamp.pictures.items()),
            [[pulse.low_nm, pulse.high_nm, pulse.values.tolist()] for pulse in light.pulses],
            light.passes,
        ]
        for light in plan.lights
    ]
    how = [plan.lens, plan.integrator, plan.spp, plan.sampler, plan.regular_tables]
    tree = hash_of_tree(state, scene.path.parent)
    made_by = cache.made_by("mitsuba", "drjit")
    return content_hash([tree, scene.sensor_id, scene.choice.variant, camera.model_dump(), lights, how, seed, made_by])


class KeptRenders:
    """The runs of one job: as many are kept as fit into one entry's share of the cache, those made first."""

    def __init__(self, job: str) -> None:
        self.job, self.size_bytes = job, 0

    def find(self, index: int, level: int) -> tuple[Pictures, int] | None:
        """The pictures of a run and its samples a film cell, or None."""
        content = cache.arrays(KIND, self._key(index, level))
        if content is None:
            return None
        pictures = [content[f"light{number}"] for number in range(len(content) - 1)]
        self.size_bytes += sum(each.nbytes for each in pictures)
        return pictures, int(content["spp"])

    def keep(self, index: int, level: int, pictures: Pictures, spp: int) -> None:
        self.size_bytes += sum(each.nbytes for each in pictures)
        if cache.has_room(self.size_bytes):
            named = {f"light{number}": each for number, each in enumerate(pictures)}
            cache.keep_arrays(KIND, self._key(index, level), {"spp": np.array(spp), **named})

    def runs_in_time(self, limits: str) -> int | None:
        """After how many runs the clock ended the job under the same limits, or None: the clock would not say so twice."""
        content = cache.arrays(KIND, f"{self.job}-{limits}")
        return None if content is None else int(content["runs"])

    def keep_runs_in_time(self, limits: str, runs: int) -> None:
        cache.keep_arrays(KIND, f"{self.job}-{limits}", {"runs": np.array(runs)})

    def _key(self, index: int, level: int) -> str:
        return f"{self.job}-{level}-{index}"
