"""What a study takes, a comparison and a sweep take too: each option changes what is made, or a
message names it.
"""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np
import pytest
from helpers.sheets import sheet
from helpers.study_settings import CHANGES

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.cli.commands import app
from pixsim.light.spectral import SpectralImage
from pixsim.sensor.pixel_options import Pixel
from pixsim.studies import compare as compare_module, sweep as sweep_module
from pixsim.studies.engine import Workers
from pixsim.studies.settings import SUPPORTED_BY, Study

LIGHT = SpectralImage(
    [450.0, 550.0, 620.0],
    30.0,
    10.0,
    data=1e-3 * (1 + np.random.default_rng(1).random((40, 40, 3))).astype(np.float32),
    header={"diffraction": False, "luminance_cd_per_m2": 3000.0},
)
# Arguments of `study`, each with another value than its default; beside the fields of its settings.
ARGUMENTS: dict[str, Any] = {
    "config": "sensor.toml", "parameters": {"luminance_cd_per_m2": 5.0}, "pixel": {"bits": 8}, "scene": "flat", "quick": True,
    "jobs": 1, "scheduler": "tcp://localhost:8786", "variant": "scalar_spectral", "progress": lambda _: lambda _: None,
    "agreed": True, "uncertainty": 8, "sobol": 8, "smaller_than_um": (3.0,), "metrics": ("delta_e", "acutance"), "light": LIGHT,
    "without": LIGHT,
}  # fmt: skip
NO_NUMBERS = {
    "jobs",
    "scheduler",
    "progress",
    "agreed",
    "variant",
}  # they decide how and where, and change no number
VALUES = {name: value for name, (value, _) in CHANGES.items()} | ARGUMENTS
# In light that is given, axes and conditions vary the sensor and what follows it.
SWEEP_VALUES: dict[str, Any] = {
    "axis": ({"name": "time", "set": "exposure.integration_s", "values": (1e-4, 1e-3)},),
    "condition": ({"name": "dusk", "set": {"exposure": {"integration_s": 1e-4}}},),
}
REFUSED = {
    "compare": {"smaller_than_um", "paper", "light", "without"},
    # A sweep has light that is given: it refuses what `study(…, light=…)` refuses.
    "sweep": {
        "smaller_than_um",
        "paper",
        "noise_budget",
        "scene",
        "parameters",
        "variant",
        "window_mm",
        "tolerance_delta_e",
    },
}
SUBJECTS, FOLDER = {"plan", "settings"}, {"out"}  # of `study`: what it varies, and where it writes


def test_values_are_those_of_all_arguments_and_settings() -> None:
    assert (
        VALUES.keys()
        == (inspect.signature(pixsim.study).parameters.keys() - SUBJECTS - FOLDER)
        | Study.model_fields.keys()
    )


def test_options_of_the_command_line_are_those_of_a_study() -> None:
    """All of `pixsim study` are options of `pixsim compare`."""
    study, compare = (
        {
            name
            for argument in app[command].assemble_argument_collection()
            for name in argument.names
        }
        for command in ("study", "compare")
    )
    assert study <= compare


def made_by_compare(options: dict[str, Any]) -> object:
    """What a comparison would make: its cases."""
    job = pixsim.compare(
        ["a.toml", "b.toml"], **{"resolution": 48, "display": {"dots": 48}} | options
    )
    cases = [
        (case.settings, case.camera, case.imaging, case.sizes, case.labels, case.header)
        for case in job.cases
    ]
    return repr((cases, job.types, job.study and (job.study.name, job.study.detail)))


def made_by_sweep(options: dict[str, Any]) -> object:
    """What a sweep makes: its rows."""
    pixels = {"a": Pixel(pitch_um=10.0), "b": Pixel(technology="4t-bsi", pitch_um=10.0)}
    return repr(list(pixsim.sweep(LIGHT, pixels, **{"display": {"dots": 24}} | options)))


MADE = {"compare": made_by_compare, "sweep": made_by_sweep}
# Settings that have an effect only beside others.
BESIDE: dict[str, dict[str, Any]] = {
    "without": {"metrics": ("delta_e", "detectability")},
    "metric": {"metrics": ("delta_e", "information")},
}


@contextmanager
def local_workers(jobs: int | None, scheduler: object) -> Iterator[Workers]:
    yield Workers()


@pytest.fixture(scope="module", autouse=True)
def desk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A folder with two sensors of uncertain read noise; comparisons only prepare."""
    folder = tmp_path_factory.mktemp("desk")
    unsure = "[pixel.uncertainty]\nread_noise_e = { sd = 0.5 }\n"
    sheet(folder / "a.toml", more=unsure)
    sheet(folder / "b.toml", 12.0)
    (folder / "sensor.toml").write_text("[exposure]\nwell_target = 0.5\n", encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(compare_module, "run_prepared", lambda job, **_: job)
        patch.setattr(sweep_module, "workers_for", local_workers)
        yield


@cache
def made_without(command: str, name: str) -> object:
    # Without the light and its metric, there is no detectability.
    return MADE[command](BESIDE.get(name, {}) if name != "without" else {})


@pytest.mark.parametrize("name", VALUES)
@pytest.mark.parametrize("command", MADE)
def test_option_of_a_study_acts_is_named_or_is_refused(command: str, name: str) -> None:
    if (command, name) == ("sweep", "light"):
        return  # its first argument
    value = (VALUES | SWEEP_VALUES if command == "sweep" else VALUES)[name]
    if name in REFUSED[command]:
        with pytest.raises(PixsimError, match=rf"^{name}: got a value .*; allowed: "):
            MADE[command]({name: value})
        return

    before = made_without(command, name if name in BESIDE else "")
    with warnings.catch_warnings(record=True, action="always") as caught:
        after = MADE[command](BESIDE.get(name, {}) | {name: value})
    texts = [str(warning.message) for warning in caught]
    is_named = any("nothing here" in text and name in text for text in texts)
    if name in NO_NUMBERS:
        assert (before == after, is_named) == (True, False)
        return
    assert before != after or is_named, texts
    assert command == "compare" or before == after or not is_named, "a row differs nevertheless"


def test_refusals_stand_in_one_table() -> None:
    """Those of a sweep that are not in it are those of every study whose light is given."""
    with_given_light = {"scene", "parameters", "variant", "window_mm", "tolerance_delta_e"}
    assert REFUSED["compare"] | REFUSED["sweep"] - with_given_light == SUPPORTED_BY.keys()
