"""What is refused: settings that do not go together, words and units of data sheets, numbers at the
ends of their range in functions and free tables; and that no message quotes a file.

Single fields are in tests/test_refusals.py.
"""

import re
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated
from unittest.mock import Mock, patch

import numpy as np
import pytest
from numpy.typing import ArrayLike
from pydantic import Field, create_model

import pixsim
from pixsim.base import cache, door
from pixsim.base.bounds import POSITIVE
from pixsim.base.files import output_folder, write_new
from pixsim.base.problems import explain
from pixsim.base.records import Record, checked
from pixsim.base.tables import dataframe_of
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.glass import read_catalogue
from pixsim.optics.prescription import read_prescription
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel, PixelOptions
from pixsim.sensor.technology import load_technology
from pixsim.studies.files import load_study
from pixsim.studies.prepare import prepare
from pixsim.viewer.setting import Run
from pixsim.viewer.settings_file import run_settings, settings_layer

DATA = Path(pixsim.__file__).parent / "data"
TECHNOLOGY = DATA / "technologies/0.35um.toml"
INCOMPLETE = {"full_well_e": 1e4, "read_noise_e": 2, "dark_current_e_per_s": 1}
ADDED = {"quantum_efficiency": 0.5, "data_sheet_pitch_um": 3.0}
LIGHT = pixsim.SpectralImage(
    [450.0, 550.0, 650.0],
    100.0,
    42.4,
    data=np.full((64, 64, 3), 1e-3),
    header={"luminance_cd_per_m2": 100.0},
)
NO_PAGE = Mock(side_effect=pixsim.PixsimError("no page"))
CALLS: dict[str, tuple[Callable, str]] = {
    "a data sheet below the pitch of its process": (
        lambda: derive(Pixel(pitch_um=8.0, data_sheet_pitch_um=3.0)),
        r"data_sheet_pitch_um: got 3; allowed: above 5\.13",
    ),
    "a sheet that is not complete": (
        lambda: derive(
            Pixel(pitch_um=2.4, full_well_e=6e3, read_noise_e=1.5, quantum_efficiency=0.6)
        ),
        r"pitch_um: got 2\.4; .*If you give dark_current_e_per_s",
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
        lambda: pixsim.study(pixsim.Study(name="x"), "out", quick=True),
        "quick: got with a Study",
    ),
    "files of settings, of a study": (
        lambda: pixsim.study(pixsim.Study(name="x"), "out", config=["sensor.toml"]),
        "config: got with a Study",
    ),
    "a study of an incomplete data sheet": (
        lambda: pixsim.Study(name="a", technologies=["none"], pixel=INCOMPLETE),
        "missing: data_sheet_pitch_um, quantum_efficiency",
    ),
    "a study of a data sheet and a technology": (
        lambda: pixsim.Study(name="a", technologies=["none", "0.35um"], pixel=INCOMPLETE | ADDED),
        r"'none' is the data sheet of \[pixel\]; give it alone",
    ),
    "pixels of a study without a pitch": (
        lambda: pixsim.Study(name="a", camera={"pixels": [500, 400]}),
        "needs the pitch of the sensor",
    ),
    "a focus within the focal length": (
        lambda: CameraOptions(object_distance_m=0.05).over(Camera(focal_length_mm=50)),
        "focal_length_mm = 50 .*no real image",
    ),
    "a curve of an integer beyond any float": (
        lambda: Pixel(quantum_efficiency=[[400, 10**400], [700, 0.5]]),
        "quantum_efficiency: got",
    ),
    "no pandas": (
        lambda: patch.dict("sys.modules", pandas=None)(dataframe_of)([]),
        "pip install pandas",
    ),
    "a gain that is no level": (lambda: pixsim.Exposure(gain=4), "gain_db is 20 log10 of a gain"),
    "a folder that is not there": (
        lambda: pixsim.write_npz("/proc/light.npz", LIGHT),
        "output file: .*a path that can be written",
    ),
    "a folder of the system": (lambda: write_new(Path("/proc/x.toml"), "x"), "cannot be written"),
    "a folder that is no text": (
        lambda: output_folder(Path("\udcff")).__enter__(),
        "not valid UTF-8. Choose another",
    ),
    "a name that is no text": (lambda: Pixel(technology="\udcff"), "allowed: text in UTF-8"),
    "a page that cannot be opened": (
        lambda: pixsim.explore(LIGHT, Pixel(pitch_um=21.2), opened=NO_PAGE),
        "no page",
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
    "[camera]\npixels = [2448, 2048]\n[pixel]\npitch_um = 500": "Check pixel.pitch_um, which is in",
    "[exposure]\nISO = 800": "18.06 for 800 over 100.",
    "iso = 800": "It belongs in [exposure], as gain_db. gain_db is 20 log10 of ISO",
    "[camera]\npixels = [640, 480]": "needs the pitch of the sensor",
    "[pixel]\nquantum_efficiency = '65 %'": "a fraction: 65 % is 0.65.",
    "[pixel]\nprnu = 2": "In per cent? Write prnu = 0.02.",
    "[pixel]\ndark_current = 3": "Write dark_current_e_per_s = 3, or",
    "[pixel]\npitch_um = 3,45": "Write numbers with a decimal point and without a unit",
    "require = ['mtf50>=3']": "limits on the run's metrics, delta_e. Add mtf50 to metrics",
    "[pixel]\nuncertainty = 3": "pixel.uncertainty: got 3; allowed: a table",
    "[pixel]\nuncertainty = [3]": "pixel.uncertainty: got a list; allowed: a table",
    "[pixel]\ndsnu = 0.1\nuncertainty.dsnu = 'x'": "pixel.uncertainty.dsnu: got a text",
    "[pixel]\ndsnu = 0\nuncertainty.dsnu = { sd = 1, distribution = 'lognormal' }": (
        "a lognormal distribution for 0; allowed: a number above 0"
    ),
    "metrics = []": "metrics: got []; allowed: a list of at least 1.",
    "[camera]\ndie_mm = true": "camera.die_mm: got True; allowed: a number or a name.",
}


@pytest.mark.parametrize("case", CALLS)
def test_settings_that_do_not_go_together_are_refused(case: str, here: Path) -> None:
    call, words = CALLS[case]
    with pytest.raises(pixsim.PixsimError, match=words):
        call()
    assert list(here.iterdir()) == []


@pytest.mark.parametrize("text", TEXTS)
def test_words_and_units_of_data_sheets_are_answered_in_ours(text: str, tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(text, encoding="utf-8")
    with pytest.raises(pixsim.PixsimError) as error:
        run_settings(tmp_path / "s.toml", {})
    assert TEXTS[text] in str(error.value)


def test_technologies_that_are_the_same_process_are_refused(tmp_path: Path) -> None:
    """Rows are identified by content: two names of one process would share them."""
    for name in ("a", "b"):
        (tmp_path / f"{name}.toml").write_bytes(TECHNOLOGY.read_bytes())
    text = 'name = "x"\ntechnologies = ["a.toml", "b.toml"]\n'
    (tmp_path / "study.toml").write_text(text, encoding="utf-8")
    with pytest.raises(pixsim.PixsimError, match=r"b\.toml.*the same process"):
        prepare(load_study(tmp_path / "study.toml"))


@pytest.mark.parametrize("size", ["", "many", "-1", "nan", "inf"])
def test_sizes_that_no_cache_can_have_are_refused(
    size: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(cache.LIMIT_VARIABLE, size)
    with pytest.raises(pixsim.PixsimError, match=r"PIXSIM_CACHE_GIB.*allowed: a size in GiB"):
        cache.limit_bytes()


# --- Numbers at the ends of their range
# ---------------------------------------------------------------------------------------------------

MAX_CPU_S = 5.0  # subnormal numbers make operations slow


def checked_as(hint) -> Callable:
    """A public function that returns its argument."""

    def value_of(pitch_um):
        return pitch_um

    value_of.__annotations__["pitch_um"] = hint
    return door.checked(value_of, "pixsim.value_of")


@pytest.mark.parametrize("bounds", [POSITIVE, Field(gt=0)], ids=["function", "record"])
@pytest.mark.parametrize("value", [5e-324, 9e-31, -1e-320, 0.0])
def test_arguments_above_0_are_not_tiny(bounds, value: float) -> None:
    """Also in arrays; 1e-30 is the smallest."""
    words = r"pitch_um.*: got .*allowed: .*number.* above 0 \(1e-30 or more\)"
    for kind, argument in (
        (float, value),
        (ArrayLike, [1.0, value]),
        (tuple[float, float], (1.0, value)),
    ):
        with pytest.raises(pixsim.PixsimError, match=words):
            checked_as(Annotated[kind, bounds])(argument)
        checked_as(Annotated[kind, bounds])(1e-30 if kind is float else (1.0, 1e-30))


@pytest.mark.parametrize(
    ("field", "allowed"),
    [
        (Field(ge=2, le=3), [2.0, 2.5, 3.0]),
        (Field(gt=0, lt=3.5), [1.5, 2.0, 2.5, 3.0]),
        (Field(ge=2, lt=3.5), [2.0, 2.5, 3.0]),
    ],
)
def test_functions_share_the_bounds_of_records(field, allowed: list[float]) -> None:
    function = checked_as(Annotated[float, field])
    record = create_model("Shared", __base__=Record, number=(Annotated[float, field], 2.0))
    for value in allowed:
        assert function(value) == record(number=value).number == value
    for value in {0.0, 1.5, 2.0, 2.5, 3.0, 3.5, float("nan")} - {*allowed}:
        for call in (partial(function, value), partial(record, number=value)):
            with pytest.raises(pixsim.PixsimError):
                call()


FREE_TABLES = {
    "axis": "[[axis]]\nname = 'a'\nset = 'pixel.read_noise_e'\nvalues = [1.0, {}]",
    "scene": "[scene.parameters]\nluminance_cd_per_m2 = {}",
    "curve": "pixel.quantum_efficiency = 'qe.csv'",
    "process": "process.'0.35um'.prnu = {}",
}


@pytest.mark.parametrize("value", ["1e-320", "1e308", "inf", "nan"])
@pytest.mark.parametrize("table", FREE_TABLES)
def test_extremes_in_free_tables_of_a_study_are_refused(
    table: str, value: str, tmp_path: Path
) -> None:
    (tmp_path / "qe.csv").write_text(f"400,{value}\n700,{value}\n", encoding="utf-8")
    text = f"name = 'x'\n{FREE_TABLES[table].format(value)}\n"
    (tmp_path / "s.toml").write_text(text, encoding="utf-8")
    start = time.process_time()
    with pytest.raises(pixsim.PixsimError):
        prepare(load_study(tmp_path / "s.toml"))
    assert time.process_time() - start < MAX_CPU_S


def test_a_zero_has_no_sign() -> None:
    assert repr(PixelOptions(offset_fpn=-0.0).offset_fpn) == "0.0"


# --- Messages quote no file: it may be another than the user believes, such as a key, where a study
# or a scene names it
# ---------------------------------------------------------------------------------------------------

KEY = "wJalrXUtnFEMI/K7MDENG bPxRfi/CYEXAMPLEKEY"  # as of a service, with a space
WORD = "wJalrXUtnFEMIK7MDENG"
PARTS = re.compile("wJal|UtnF|K7MD|bPxR|EXAMPLE", re.IGNORECASE)
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
AGF = "NM A 2 0 1.5168 64.17\nCD 1.04 0.006 0.23 0.02 1 103\nLD 0.35 2\n"
SCENE = '<scene version="3.0.0"><bsdf type="diffuse" id="a"/>{}</scene>'
# Kind of file -> its ending, and its reader.
READERS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "toml lens": (".toml", lambda path: read_prescription(str(path))),
    "zmx": (".zmx", lambda path: read_prescription(str(path))),
    "agf": (".agf", read_catalogue),
    "technology": (".toml", lambda path: load_technology(str(path))),
    "csv": (".csv", lambda path: PixelOptions.model_validate({"quantum_efficiency": str(path)})),
    "channels": (
        ".csv",
        lambda path: PixelOptions.model_validate({"colour": {"sensitivities": str(path)}}),
    ),
    "settings": (".toml", lambda path: checked(Run, [settings_layer(path)])),
    "xml": (".xml", lambda path: pixsim.load_scene(path, variant="scalar_spectral")),
}


def edits(text: str) -> list[str]:
    """A text with the key in place of each of its words, once each, and as whole lines of it."""
    words = list(re.finditer(r"[^\s=\[\]{}\",]+", text))
    lines = text.splitlines(keepends=True)
    in_words = [
        text[: word.start()] + key + text[word.end() :]
        for word in words[:: max(1, len(words) // 60)]
        for key in (KEY, f'"{KEY}"')
    ]
    in_lines = [
        "".join([*lines[:at], line, *lines[at:]])
        for at in (0, len(lines) // 2, len(lines))
        for line in KEY_LINES
    ]
    return [*in_words, *in_lines]


KEY_LINES = (
    f"{KEY}\n", f'"{KEY}" = 1\n', f'"{KEY}" = 1\n"{KEY}" = 2\n', f'[x]\n"{KEY}" = {{ a = 1, a = 2 }}\n', f'["{KEY}"]\n["{KEY}"]\n',
    *(f"{word} {KEY}\n" for word in ("SURF", "  TYPE", "  CURV", "  GLAS", "  DIAM", "  PARM 1", "  MAZH", "GCAT", "MODE", "UNIT", "MNUM", "FTYP")),
)  # fmt: skip
CONTENTS = {
    "toml lens": edits((DATA / "lenses/singlet.toml").read_text(encoding="utf-8")), "zmx": edits(ZMX), "agf": edits(AGF), "technology": edits(TECHNOLOGY.read_text(encoding="utf-8")),
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


@pytest.mark.parametrize("kind", CONTENTS)
def test_no_message_quotes_a_file(kind: str, tmp_path: Path) -> None:
    """Nor does a warning."""
    suffix, read = READERS[kind]
    path, refused = tmp_path / f"x{suffix}", 0
    for text in CONTENTS[kind]:
        path.write_text(text, encoding="utf-8")
        message = ""
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                read(path)
            except ValueError as error:  # of pydantic too
                message = str(error) if isinstance(error, pixsim.PixsimError) else explain(error)
        assert not PARTS.search(f"{message} {[str(note.message) for note in caught]}"), text
        refused += message != ""
    assert refused > len(CONTENTS[kind]) / 3


def test_what_the_user_types_is_quoted(tmp_path: Path) -> None:
    scene = tmp_path / "scene.xml"
    text = (
        '<default name="r" value="1"/><shape type="sphere"><float name="radius"'
        ' value="$r"/></shape>'
    )
    scene.write_text(SCENE.format(text), encoding="utf-8")
    with pytest.raises(pixsim.PixsimError, match=f"^r: got '{KEY[:8]}"):
        pixsim.load_scene(scene, r=KEY, variant="scalar_spectral")
    light = {"data": np.ones((2, 2, 1)), "wavelength_nm": [550.0], "band_width_nm": [10.0]}
    np.savez(tmp_path / "a.npz", **light)
    with pytest.raises(pixsim.PixsimError, match=re.escape(f"got '{KEY}'")):
        pixsim.read_irradiance(tmp_path / "a.npz", units=KEY, pitch_um=1.0)
