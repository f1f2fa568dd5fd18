"""Invalid colour filters by a file, by options and from Python: one message, which names what to mend."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.commands import assert_refused, command
from helpers.tiny import toml_of

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.viewer.develop_options import Develop
from pixsim.viewer.display_options import Display

NM = range(400, 701, 10)
CAMERA = Camera(die_mm=0.1)


def curve(number: int, wavelength_nm: float, width_nm: float = 40) -> float:
    """Of a channel: R, G, B, X."""
    return 0.5 * float(np.exp(-(((wavelength_nm - (600, 540, 460, 520)[number]) / width_nm) ** 2)))


def table(letters: str = "RGB", nm: Any = NM, of: Any = curve) -> str:
    lines = (",".join(f"{value:.6g}" for value in (x, *(of(number, x) for number in range(len(letters))))) for x in nm)
    return "\n".join([",".join(["nm", *letters]), *lines])


FILES = {
    "good.csv": table(),
    "more.csv": table("RGBX"),
    "fewer.csv": table("RG"),
    "negative.csv": table(of=lambda number, x: curve(number, x) - 0.1 * (number == 2)),
    "large.csv": table(of=lambda number, x: curve(number, x) * (3 if number == 1 else 1)),
    "nan.csv": table(of=lambda number, x: curve(number, x) if x != 500 else np.nan),
    "dark.csv": table(of=lambda number, x: curve(number, x) * (number != 2)),
    "gap.csv": table(nm=[x for x in NM if not 480 < x < 540]),
    "short.csv": table(nm=range(450, 701, 10)),
    "alike.csv": table(nm=range(380, 831, 10), of=lambda number, x: 0.5 * float(np.exp(-(((x - 570 + 25 * number) / 150) ** 2)))),
    "same.csv": table(of=lambda number, x: curve(1, x)),
}
GOOD = {"quantum_efficiencies": "good.csv"}
REFUSED: list[tuple[dict[str, Any], dict[str, Any], list[str]]] = [
    ({"quantum_efficiencies": "none.csv"}, {}, ["quantum_efficiencies", "'none.csv', which does not exist", "a CSV file"]),
    ({"quantum_efficiencies": "negative.csv"}, {}, ["channel B with -0.", "0 to 1", "Set negative values"]),
    ({"quantum_efficiencies": "large.csv"}, {}, ["channel G with 1.1682 at 520 nm", "0 to 1", "Divide percentages by 100"]),
    ({"transmittances": "large.csv"}, {}, ["transmittances", "channel G with 1.1682 at 520 nm", "0 to 1"]),
    ({"quantum_efficiencies": "nan.csv"}, {}, ["channel R with nan at 500 nm"]),
    ({"quantum_efficiencies": "dark.csv"}, {}, ["channel B that is 0 at every wavelength"]),
    ({"quantum_efficiencies": "gap.csv"}, {}, ["channel R with a gap from 480 to 540 nm", "steps of at most 20 nm"]),
    ({"quantum_efficiencies": "short.csv"}, {}, ["for 450 to 700 nm", "at least 400 to 700 nm"]),
    ({"quantum_efficiencies": "fewer.csv"}, {}, ["the unit cell has B, of which no response is given", "R, G"]),
    (GOOD | {"matrix": ["RG", "XB"]}, {}, ["the unit cell has X, of which no response is given"]),
    (GOOD | {"matrix": ["RG", "gB"]}, {}, ["matrix with 'g'", "capital letters"]),
    (GOOD | {"matrix": ["RG", "B"]}, {}, ["rows of equal length"]),
    (GOOD | {"matrix": ["RG", "GR"]}, {}, ["channel B has no pixels in RG, GR", "leave it out"]),
    (GOOD | {"pattern": "rgbg"}, {}, ["'rgbg'", "'rggb'"]),
    (
        {"quantum_efficiencies": "more.csv", "matrix": ["RX", "GB"]},
        {"demosaic": "malvar2004"},
        ["develop.demosaic", "'malvar2004' for the unit cell RX, GB", "'interpolate' for any other"],
    ),
    ({"sensitivities": "Nikon_D810"}, {}, ["sensitivities are relative", "peak_quantum_efficiency"]),
    ({"pattern": "rggb"}, {}, ["no response of the channels", "quantum_efficiencies"]),
    (GOOD | {"transmittances": "good.csv"}, {}, ["quantum_efficiencies and transmittances state the same quantity"]),
]


def light() -> SpectralImage:
    """An even field under a lamp of equal energy."""
    nm = np.array(NM, float)
    header = {"diffraction": False, "lamp_w_per_m2_sr_nm": np.ones(nm.size).tolist()}
    return SpectralImage(nm, np.full(nm.size, 10.0), 5.0, data=np.full((20, 20, nm.size), 1e-4), header=header)


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the files, as the working directory."""
    monkeypatch.chdir(tmp_path)
    for name, text in FILES.items():
        Path(name).write_text(text, encoding="utf-8")
    return tmp_path


def options(settings: dict[str, Any], prefix: str = "") -> list[str]:
    """Settings as the words of a command."""
    words: list[str] = []
    for name, value in settings.items():
        if isinstance(value, dict):
            words += options(value, f"{prefix}{name}.")
        else:
            word = f"--{prefix}{name}".replace("_", "-")
            words += [word, ",".join(value) if isinstance(value, list) else str(value)]
    return words


def assert_refused_both_ways(scene: str, settings: dict[str, Any], texts: list[str]) -> None:
    """By a file and by options, with one message and no folder of results."""
    Path("sensor.toml").write_text("".join(f"{name} = {toml_of(value)}\n" for name, value in settings.items()), encoding="utf-8")
    for words in (["--config", "sensor.toml"], options(settings)):
        assert_refused(*command(f"run {scene} --out out", *words), texts)
        assert not Path("out").exists()


@pytest.mark.usefixtures("desk")
@pytest.mark.parametrize(("colour", "develop", "texts"), REFUSED, ids=lambda value: str(value)[:60])
def test_invalid_filters_are_refused_before_any_light(colour: dict[str, Any], develop: dict[str, Any], texts: list[str]) -> None:
    settings = {"pixel": {"technology": "4t-bsi", "pitch_um": 20.0, "colour": colour}, "develop": develop}
    assert_refused_both_ways("macbeth", settings, texts)
    with pytest.raises(PixsimError) as error:
        pixsim.evaluate(light(), CAMERA, pixsim.Pixel(**settings["pixel"]), develop=Develop(**develop))
    assert not [text for text in texts if text not in str(error.value)]


@pytest.mark.usefixtures("desk")
@pytest.mark.parametrize(
    ("colour", "pitch_um", "texts"),
    [
        ({"quantum_efficiencies": "alike.csv"}, 5.0, ["noise gains of 1", "in R, G, B", "gains up to 10", "overlap less"]),
        ({"quantum_efficiencies": "same.csv"}, 5.0, ["colour under the scene's lamp", "rank 1", "other filters"]),
        (GOOD, 60.0, ["pixel.pitch_um: got 60, which leaves 1 × 1 pixels", "2 × 2", "smaller pixels"]),
    ],
    ids=str,
)
def test_filters_that_do_not_suit_the_light_are_refused(colour: dict[str, Any], pitch_um: float, texts: list[str]) -> None:
    pixsim.write_exr("light.exr", light())
    pixel = {"technology": "4t-bsi", "pitch_um": pitch_um, "colour": colour, "stack": {"enabled": False}}
    display = {"white_cd_per_m2": 1e4, "raster": "one_to_one"}
    assert_refused_both_ways("light.exr", {"pixel": pixel, "camera": {"die_mm": CAMERA.die_mm}, "display": display}, texts)
    with pytest.raises(PixsimError) as error:
        pixsim.evaluate(light(), CAMERA, pixsim.Pixel(**pixel), display=Display(**display))
    assert not [text for text in texts if text not in str(error.value)]
