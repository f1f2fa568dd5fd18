"""Settings that do not go together, and words and units of data sheets. Single fields are in
tests/test_refusals.py.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import pixsim
from pixsim.base import cache
from pixsim.base.errors import PixsimError
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.studies.files import load_study
from pixsim.studies.prepare import prepare
from pixsim.studies.settings import Study
from pixsim.viewer.settings_file import run_settings

TECHNOLOGY = Path(pixsim.__file__).parent / "data/technologies/0.35um.toml"
CALLS: dict[str, tuple[Callable[[], Any], str]] = {
    "a data sheet below the pitch of its process": (
        lambda: derive(Pixel(pitch_um=8.0, data_sheet_pitch_um=3.0)),
        r"data_sheet_pitch_um: got 3; allowed: above 5\.13",
    ),
    "a sheet that is not complete": (
        lambda: derive(
            Pixel(pitch_um=2.4, full_well_e=6e3, read_noise_e=1.5, quantum_efficiency=0.6)
        ),
        r"pitch_um: got 2\.4; .*Give dark_current_e_per_s",
    ),
    "a pitch that transistors fill": (
        lambda: derive(Pixel(technology="0.35um", pitch_um=2.4)),
        "transistors of 0.35um fill the pixel",
    ),
    "pixels without a pitch": (
        lambda: CameraOptions(pixels=(640, 480)).over(Camera()),
        r"camera\.pixels: got \[640, 480\]",
    ),
    "quick, of a study": (
        lambda: pixsim.study(Study(name="x"), "out", quick=True),
        "quick: got with a Study",
    ),
    "a focus within the focal length": (
        lambda: CameraOptions(object_distance_m=0.05).over(Camera(focal_length_mm=50)),
        "focal_length_mm = 50 .*no real image",
    ),
    "a curve of an integer beyond any float": (
        lambda: Pixel(quantum_efficiency=[[400, 10**400], [700, 0.5]]),
        "quantum_efficiency: got",
    ),
    "a record of a file": (
        lambda: Pixel("sensor.toml"),
        r"Pixel: got 'sensor\.toml'; allowed: fields by name",
    ),
}
# What a settings file says -> words of the message.
TEXTS = {
    "[pixel]\ngain = 2": "Write gain_e_per_dn or dn_per_e.",
    "read_noise = 3": "It belongs in [pixel], as read_noise_e.",
    "[sensor]\nbits = 8": "Write [pixel].",
    "[pixel]\nf_number = 4": "It belongs in [camera].",
    "[camera]\nbits = 8": "It belongs in [pixel] or in [display].",
    "[camera]\nseed = 8": "It belongs above all tables.",
    "[pixel.stack]\nresolution = 3": "pixel.stack.resolution: unknown name; allowed: enabled,",
    "[camera]\nresolution = 640": "columns and rows are pixels in [camera]",
    "[camera]\npixels = 1936": "allowed: columns and rows, as [1936, 1216]",
    "[camera]\npixels = [640, 480]": "needs the pitch of the sensor",
    "[pixel]\nquantum_efficiency = '65 %'": "a fraction: 65 % is 0.65.",
    "[pixel]\nprnu = 2": "In per cent? Write prnu = 0.02.",
    "[pixel]\ndark_current = 3": "Write dark_current_e_per_s = 3, or",
    "[pixel]\npitch_um = 3,45": "Write numbers with a decimal point and without a unit",
    "metrics = []": "metrics: got []; allowed: a list of at least 1.",
    "[camera]\ndie_mm = true": "camera.die_mm: got True; allowed: a number or a name.",
    "[scene]\nparameters = { lux = 500 }": "State parameters as scene.lux = 500",
}


@pytest.mark.parametrize("case", CALLS)
def test_settings_that_do_not_go_together_are_refused(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    call, words = CALLS[case]
    with pytest.raises(PixsimError, match=words):
        call()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("text", TEXTS)
def test_words_and_units_of_data_sheets_are_answered_in_ours(text: str, tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(text, encoding="utf-8")
    with pytest.raises(PixsimError) as error:
        run_settings(tmp_path / "s.toml", {})
    assert TEXTS[text] in str(error.value)


def test_technologies_that_are_the_same_process_are_refused(tmp_path: Path) -> None:
    """Rows are identified by content: two names of one process would share them."""
    for name in ("a", "b"):
        (tmp_path / f"{name}.toml").write_bytes(TECHNOLOGY.read_bytes())
    text = 'name = "x"\ntechnologies = ["a.toml", "b.toml"]\n'
    (tmp_path / "study.toml").write_text(text, encoding="utf-8")
    with pytest.raises(PixsimError, match=r"b\.toml.*the same process"):
        prepare(load_study(tmp_path / "study.toml"))


@pytest.mark.parametrize("size", ["", "many", "-1", "nan", "inf"])
def test_sizes_that_no_cache_can_have_are_refused(
    size: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(cache.LIMIT_VARIABLE, size)
    with pytest.raises(PixsimError, match=r"PIXSIM_CACHE_GIB.*allowed: a size in GiB"):
        cache.limit_bytes()
