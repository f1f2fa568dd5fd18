"""Time is bounded by size: a file of one endless line, or of many tiny ones, is read or refused in
seconds, and not quoted.

Each case took minutes to hours before, since an expression or a search looked at the rest of the
line from every place in it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import pixsim
from pixsim.light.curves import AS_CURVES, as_quantum_efficiency
from pixsim.optics.chief_rays import as_chief_ray_angles
from pixsim.optics.exchange import read_irradiance
from pixsim.optics.glass import read_catalogue
from pixsim.scene.scene import load_scene
from pixsim.studies.files import load_study

# each takes up to 2 s on the machine of development; those that are quadratic take minutes
MOST_CPU_S = 10.0
LONGEST_MESSAGE = 1500
SCENE = '<scene version="3.0.0">{}</scene>'
ENVI = """ENVI
samples = 2
lines = 2
bands = 2
file type = ENVI Standard
data type = 4
interleave = bsq
wavelength = {{400, 500}}
wavelength units = {units}
data units = {data}
{more}
"""
ZMX = """MNUM 999999
{head}
SURF 0
SURF 1
  STOP
SURF 2
"""
STUDY = 'name = "x"\n{}\n'
SETTINGS = '"camera.f_number",' * 40_000


READERS: dict[str, tuple[Callable[[str], Any], str]] = {
    "curve": (as_quantum_efficiency, ".csv"),
    "curves": (AS_CURVES["quantum_efficiencies"], ".csv"),
    "chief rays": (as_chief_ray_angles, ".csv"),
    "scene": (load_scene, ".xml"),
    "ENVI": (read_irradiance, ".hdr"),
    "EXR": (read_irradiance, ".exr"),
    "zmx": (lambda path: pixsim.load_lens(path, configuration=2), ".zmx"),
    "catalogue": (lambda path: read_catalogue(Path(path)), ".agf"),
    "study": (load_study, ".toml"),
}
MIB = 1 << 20


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("curve", "(" * (MIB - 1)),
        ("curve", "( " * (MIB // 2 - 10) + "\n400 1\n500 2\n"),
        ("curves", "[" * (MIB - 1)),
        ("chief rays", "1\n" * (MIB // 2 - 1)),
        ("scene", SCENE.format(f'<shape type="${"a" * (MIB - 100)}"/>')),
        ("scene", SCENE.format(f'<shape type="sphere"><float name="radius" value="{"1" * (MIB - 100)}x"/></shape>')),
        ("scene", SCENE.format("<shape " + " ".join(f'a{i}="1"' for i in range(100_000)) + "/>")),
        ("scene", "<a>" * MIB),
        ("scene", f"<{'a' * MIB}/>"),
        ("scene", '<a "' + '<" "' * MIB),
        ("ENVI", ENVI.format(units="([" * (MIB // 2 - 1000), data="W/m^2/nm", more="byte order = 0")),
        ("ENVI", ENVI.format(units="nm", data="W/" * (MIB // 2 - 1000), more="byte order = 0")),
        ("ENVI", ENVI.format(units="nm", data="W/m^2/nm", more=(" " * 50 + "\n") * 19_000)),
        ("zmx", ZMX.format(head="\n".join(f"YFIE {i} 2 0.5" for i in range(1, 200)) + "\nXXXX 1" * 500_000)),
        ("catalogue", f"NM {'a' * (15 * MIB)} 2 0 0 60\n"),
        ("study", STUDY.format(f"[[axis]]\nname = 'a'\nset = [{SETTINGS}]\nvalues = [1, 2]")),
        ("study", STUDY.format("\n".join(f"[[condition]]\nname = 'c{i}'\nset.camera.f_number = 2" for i in range(17_000)))),
        ("study", STUDY.format(f"pitch.values_um = [{'5.0,' * 200_000}]")),
        ("study", STUDY.format(f"camera.pixels = '{'1x' * 400_000}'")),
        ("study", STUDY.format(f"a = {'[' * 100_000}")),
    ],
    ids=lambda value: value if len(value) < 20 else "",
)  # fmt: skip
def test_time_is_bounded_by_size(kind: str, text: str, tmp_path: Path) -> None:
    assert_refused_soon(kind, text, tmp_path)


@pytest.mark.parametrize(
    ("kind", "head"),
    [
        ("curve", ""), ("scene", ""), ("EXR", "v/1\x01\x02\0\0\0"), ("zmx", ""), ("catalogue", ""), ("study", ""),
    ],
)  # fmt: skip
def test_a_line_of_50_mb_is_refused_in_seconds(kind: str, head: str, tmp_path: Path) -> None:
    assert_refused_soon(kind, head + "a" * (50 * MIB), tmp_path)


def assert_refused_soon(kind: str, text: str, folder: Path) -> None:
    read, suffix = READERS[kind]
    path = folder / f"x{suffix}"
    path.write_text(text, encoding="latin-1")
    (folder / "x.img").write_bytes(bytes(32))  # of an ENVI header
    start = time.process_time()
    with pytest.raises(ValueError, match=r"allowed:|line \d+") as refused:
        read(str(path))
    assert time.process_time() - start < MOST_CPU_S
    assert len(str(refused.value)) < LONGEST_MESSAGE
