"""No message quotes a file: it may be another than the user believes, such as a key, where a study
or a scene names it.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.base.problems import explain
from pixsim.base.records import checked
from pixsim.optics.prescription import read_prescription
from pixsim.sensor.pixel_options import PixelOptions
from pixsim.sensor.technology import load_technology
from pixsim.viewer.setting import Run
from pixsim.viewer.settings_file import settings_layer

KEY = "wJalrXUtnFEMI/K7MDENG bPxRfi/CYEXAMPLEKEY"  # as of a service, with a space
WORD = "wJalrXUtnFEMIK7MDENG"
PARTS = re.compile("wJal|UtnF|K7MD|bPxR|EXAMPLE", re.IGNORECASE)
ROOT = Path(pixsim.__file__).parent
LENS, TECHNOLOGY = (
    (ROOT / name).read_text(encoding="utf-8")
    for name in ("data/lenses/singlet.toml", "data/technologies/0.35um.toml")
)
ZMX = """UNIT MM
ENPD 10
FTYP 0 0 1 1
YFLN 1
WAVM 1 0.55 1
SURF 0
  DISZ INFINITY
SURF 1
  STOP
  CURV 0.01
  DISZ 2
  GLAS N-BK7 0 0
SURF 2
  DISZ 0
"""
SCENE = '<scene version="3.0.0"><bsdf type="diffuse" id="a"/>{}</scene>'
READERS: dict[str, Callable[[Path], object]] = {
    "toml lens": lambda path: read_prescription(str(path)),
    "zmx": lambda path: read_prescription(str(path)),
    "technology": lambda path: load_technology(str(path)),
    "csv": lambda path: PixelOptions.model_validate({"quantum_efficiency": str(path)}),
    "channels": lambda path: PixelOptions.model_validate({"colour": {"sensitivities": str(path)}}),
    "settings": lambda path: checked(Run, [settings_layer(path)]),
    "xml": lambda path: pixsim.load_scene(path, variant="scalar_spectral"),
}
SUFFIXES = {"zmx": ".zmx", "csv": ".csv", "channels": ".csv", "xml": ".xml"}


def edits(text: str) -> list[str]:
    """A text with the key in place of each of its words, once each, and as whole lines of it."""
    words = list(re.finditer(r"[^\s=\[\]{}\",]+", text))
    lines = text.splitlines(keepends=True)
    in_words = [
        text[: word.start()] + KEY + text[word.end() :]
        for word in words[:: max(1, len(words) // 60)]
    ]
    quoted = [
        text[: word.start()] + f'"{KEY}"' + text[word.end() :]
        for word in words[:: max(1, len(words) // 60)]
    ]
    in_lines = [
        "".join([*lines[:at], line, *lines[at:]])
        for at in (0, len(lines) // 2, len(lines))
        for line in KEY_LINES
    ]
    return [*in_words, *quoted, *in_lines]


KEY_LINES = (
    f"{KEY}\n", f'"{KEY}" = 1\n', f'"{KEY}" = 1\n"{KEY}" = 2\n', f'[x]\n"{KEY}" = {{ a = 1, a = 2 }}\n', f'["{KEY}"]\n["{KEY}"]\n',
    f"SURF {KEY}\n", f"  TYPE {KEY}\n", f"  CURV {KEY}\n", f"  GLAS {KEY}\n", f"GCAT {KEY}\n", f"MODE {KEY}\n",
)  # fmt: skip
TEXTS = {
    "toml lens": edits(LENS), "zmx": edits(ZMX), "technology": edits(TECHNOLOGY),
    "csv": edits("wavelength_nm,qe\n400,0.1\n700,0.5\n"),
    "channels": edits("nm,R,G,B\n400,0.1,0.2,0.3\n700,0.5,0.2,0.1\n"),
    "settings": edits('[camera]\nf_number = 2.8\n[pixel]\nbits = 10\ntemperature_k = 300\n[display]\ndots = 100\n'),
    "xml": [
        f"<{WORD}/>", KEY, f'<scene version="{KEY}"/>',
        f'<?xml version="1.0" encoding="{KEY}"?><scene/>',
        *(SCENE.format(part) for part in (
            f"<{WORD}/>", f'<bsdf type="{KEY}"/>', f'<bsdf type="diffuse" id="{KEY}"/>' * 2,
            f'<ref id="{KEY}"/>', f'<bsdf type="diffuse"><float name="{KEY}" value="1"/></bsdf>',
            f'<default name="{KEY}" value="1"/>',
            f'<shape type="sphere"><float name="radius" value="{KEY}"/></shape>', f'<bsdf type="diffuse" {WORD}="1"/>',
            f'<shape type="cube"><transform name="to_world"><matrix value="{KEY}"/></transform></shape>',
            f'<bsdf type="conductor"><string name="material" value="{KEY}"/></bsdf>', f'<alias id="{KEY}" as="{KEY}"/>',
            f'<bsdf type="plastic"><boolean name="nonlinear" value="{KEY}"/></bsdf>', f'<path value="{KEY}"/>',
            f'<emitter type="constant"><spectrum name="radiance" value="{KEY}"/></emitter>', f"<bsdf>{KEY}</bsdf>",
        )),
    ],
}  # fmt: skip


@pytest.mark.parametrize("kind", TEXTS)
def test_no_message_quotes_a_file(kind: str, tmp_path: Path) -> None:
    path, refused = tmp_path / f"x{SUFFIXES.get(kind, '.toml')}", 0
    for text in TEXTS[kind]:
        path.write_text(text, encoding="utf-8")
        try:
            READERS[kind](path)
        except ValueError as error:  # of pydantic too
            message = str(error) if isinstance(error, PixsimError) else explain(error)
            assert not PARTS.search(message), text
            refused += 1
    assert refused > len(TEXTS[kind]) / 3


def test_what_the_user_types_is_quoted(tmp_path: Path) -> None:
    scene = tmp_path / "scene.xml"
    text = (
        '<default name="r" value="1"/><shape type="sphere"><float name="radius"'
        ' value="$r"/></shape>'
    )
    scene.write_text(SCENE.format(text), encoding="utf-8")
    with pytest.raises(PixsimError, match=f"^r: got '{KEY[:8]}"):
        pixsim.load_scene(scene, r=KEY, variant="scalar_spectral")
    with pytest.raises(PixsimError, match=re.escape(f"got '{KEY}'")):
        pixsim.read_irradiance(npz(tmp_path), units=KEY, pitch_um=1.0)


def npz(folder: Path) -> Path:
    np.savez(folder / "a.npz", data=np.ones((2, 2, 1)), wavelength_nm=[550.0], band_width_nm=[10.0])
    return folder / "a.npz"
