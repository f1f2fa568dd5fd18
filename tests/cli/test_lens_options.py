"""Real lenses on the command line, in TOML and in Python: one setting however it is spelt, and one error for what is wrong."""

import re
from pathlib import Path
from typing import Any

import pytest
from helpers.commands import command

from pixsim import load_scene
from pixsim.base.errors import PixsimError
from pixsim.base.parameters import CameraOptions, LensOptions
from pixsim.cli.commands import with_lens_file

# Settings of [lens] and [camera], and what the error names.
WRONG: list[tuple[dict[str, Any], dict[str, Any], str]] = [
    ({"file": "nolens"}, {}, "unknown lens 'nolens'; allowed: cooke_triplet, double_gauss, phone, singlet"),
    ({"file": "missing.zmx"}, {}, "missing.zmx"),
    ({"file": "binary.zmx"}, {}, "a binary file; allowed: a Zemax prescription"),
    ({"file": "mirror.zmx"}, {}, "MIRROR"),
    ({"file": "phone"}, {"focal_length_mm": 4.0}, "camera.focal_length_mm: got a value beside lens.file = 'phone'"),
    ({"file": "phone"}, {"f_number": 1.0}, "camera.f_number: got 1; allowed: at least 3.5, the widest of 'phone'"),
    ({"file": "phone", "refocus": "best"}, {}, "refocus"),
    ({"file": "phone", "ideal": "straight"}, {}, "ideal"),
    ({"file": "phone", "focal_length_mm": -3.0}, {}, "focal_length_mm"),
    ({"refocus": "field"}, {}, "refocus without file"),
    ({"file": "singlet", "focal_length_mm": 2000.0}, {}, "whose image is"),
]
MIRROR = """VERS 1
MODE SEQ
UNIT MM
ENPD 1
WAVM 1 0.55 1
SURF 0
  DISZ INFINITY
SURF 1
  STOP
  CURV 0.01
  DISZ -10
  GLAS MIRROR 0 0
SURF 2
  DISZ 0
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "binary.zmx").write_bytes(bytes(range(256)) * 8)
    (tmp_path / "mirror.zmx").write_text(MIRROR, encoding="utf-8")
    return tmp_path


@pytest.mark.parametrize(("lens", "camera", "named"), WRONG, ids=[named[:30] for *_, named in WRONG])
def test_wrong_lenses_are_one_error_in_toml_on_the_command_line_and_in_python(
    folder: Path, lens: dict[str, Any], camera: dict[str, Any], named: str
) -> None:
    tables = [("lens", lens), ("camera", camera)]
    text = "\n".join(f"[{table}]\n" + "".join(f"{key} = {value!r}\n" for key, value in values.items()) for table, values in tables)
    (folder / "run.toml").write_text(text, encoding="utf-8")
    options = [
        word for table, values in tables for key, value in values.items() for word in (f"--{table}.{key.replace('_', '-')}", value)
    ]
    for words in (["--config", "run.toml"], options):
        code, out, err = command("plan csf -D resolution=16", *words)
        assert (code, out) == (2, ""), err
        assert named in re.sub(r"\s+", " ", err)
    with pytest.raises(PixsimError, match=re.escape(named)):
        load_scene("csf", resolution=16).camera(CameraOptions(**camera), LensOptions(**lens))


def test_a_lens_may_be_named_shortly_beside_its_other_options() -> None:
    wanted = ["plan", "csf", "--lens.file", "phone", "--lens.focal-length-mm", "3"]
    assert with_lens_file(["plan", "csf", "--lens", "phone", "--lens.focal-length-mm", "3"]) == wanted
    assert with_lens_file(["--lens=phone", "lens", "phone"]) == ["--lens.file=phone", "lens", "phone"]
    code, _, err = command("plan csf --lens phone --lens.refocus field --camera.f-number 1")
    assert code == 2
    assert "the widest of 'phone'" in err
