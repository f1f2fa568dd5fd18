"""The command line: one message for invalid input, complete files for valid input; stdout and stderr,
exit codes and verbosity.
"""

import errno
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from helpers.commands import assert_refused, command, output_of, process
from helpers.processes import HANG_S
from matplotlib.image import imread

import pixsim
from pixsim.base import cache
from pixsim.base.files import FOLDER_VARIABLE
from pixsim.light.exr import read_channels
from pixsim.scene.packaged import packaged_scenes

RUN_FILES = {
    "results.csv", "irradiance.exr", "raw.exr", "ideal.png", "image.png", "delta_e.exr", "delta_e.png", "score.json",
    "settings.toml", "pixsim.json",
    "report.html",
}  # fmt: skip
SMALL = "--resolution 48 --display.dots 48"
SHEET = (
    "[pixel]\npitch_um = 4\nfull_well_e = 12000\nread_noise_e = 2.5\ndark_current_e_per_s ="
    " 8\nquantum_efficiency = 0.6\n"
)


COLOUR = '[pixel]\ntechnology = "4t-bsi"\npitch_um = 20\n[pixel.colour]\n'


def contents(folder: Path) -> dict[str, bytes | None]:
    """All files below a folder, including hidden ones."""
    return {
        str(p.relative_to(folder)): p.read_bytes() if p.is_file() else None
        for p in sorted(folder.rglob("*"))
    }


@pytest.fixture
def desk(here: Path) -> Path:
    """A working folder with invalid input."""
    flat = packaged_scenes()["flat"].read_text(encoding="utf-8")
    Path("charts").mkdir()
    pixsim.write_chart("charts/flat.exr", pixsim.make_chart("flat"))
    texels = np.ones((4, 4), np.float32)
    texels[1, 2] = np.nan
    pixsim.write_chart("nan.exr", texels)
    files = {
        "perspective.xml": flat.replace('"thinlens"', '"perspective"'),
        "turned_away.xml": flat.replace('<rotate y="1" angle="180"/>', ""),
        "key.toml": "[pixel]\npitch_mu = 6\n",
        "scalar.toml": "pixel = 3\n",
        "not.toml": "pitch_um == 6\n",
        "study_few.toml": 'name = "s"\npitch = { values_um = [6, 7, 8] }\n',
        "study_large.toml": (
            'name = "s"\nscene.parameters.resolution = 64\npitch = { values_um = [6, 7, 8, 9,'
            " 3000] }\n"
        ),
        "sheet.toml": SHEET,
        "sheet_wide.toml": SHEET.replace("pitch_um = 4", 'pitch_um = "wide"'),
        "sheet_key.toml": SHEET + "[exposure]\nmax_integration = 3\n",
        "sheet_curve.toml": SHEET.replace("0.6", '"qe.csv"'),
        "qe.csv": "400,30\n500,40\n",
        "filters.csv": "nm,R,G,B\n"
        + "".join(f"{nm},0.1,1.1682,0.5\n" for nm in range(400, 701, 10)),
        "colour_file.toml": COLOUR + 'quantum_efficiencies = "none.csv"\n',
        "colour_curve.toml": COLOUR + 'quantum_efficiencies = "filters.csv"\n',
        "study_errors.toml": 'name = "s"\nrepeats = 1\n[pitch]\ncuont = 9\n',
        "fewer.toml": 'name = "s"\n',
        "fewer.quick.toml": "repeats = 1\n",
        "taken": "a file, not a folder",
    }
    for name, text in files.items():
        Path(name).write_text(text, encoding="utf-8")
    return here


INVALID = {
    # command line: texts of the message (the given value, what is allowed or how to fix it). What
    # else a scene, a chart, a pixel, a technology or a lens refuses is tested in its folder.
    "run perspective.xml": ["'perspective'", "thinlens", "aperture_radius"],
    f"run turned_away.xml {SMALL} --camera.die-mm 2.7 --pixel.pitch-um 6.5": [
        "black",
        "that lamps face them",
    ],
    "run flat -D chart=nan.exr": ["nan.exr", "nan at row 1, column 2", "0 or more"],
    "run flat --pixel.pitch-um 5": ["pitch_um", "5", "5.135 µm"],
    "run flat --pixel.pitch-um 3000": ["pitch_um", "3000", "2713.6 µm"],
    f"run flat {SMALL} --pixel.quantum-efficiency 0": ["quantum_efficiency", "0"],
    f"run flat {SMALL} --camera.f-number 0.3": ["f-number", "0.3", "0.5"],
    "run flat --config key.toml": ["pixel.pitch_mu", "Did you mean 'pitch_um'?"],
    "run flat --config scalar.toml": ["pixel", "3"],
    "run flat --config not.toml": ["not.toml", "line 1", "TOML"],
    "run flat --camera.fnumber 4": ["--camera.fnumber", "--camera.f-number"],
    "run flat -D resolution": ["-D", "resolution", "name=value"],
    "run flat -D resolution=wide": ["resolution: got 'wide'"],
    f"run flat {SMALL} -D emitter_scale=-1": ["-1"],
    f"run flat {SMALL} --out taken": ["taken", "cannot be written", "--out"],
    f"run flat {SMALL} --out /proc/pixsim": ["/proc/pixsim", "cannot be written", "--out"],
    "run flat --config sheet_curve.toml": [
        "sheet_curve.toml: pixel.quantum_efficiency: got 'qe.csv'",
        "Divide percentages by 100",
    ],
    "run macbeth --config colour_file.toml": [
        "quantum_efficiencies",
        "'none.csv', which does not exist",
    ],
    "run macbeth --config colour_curve.toml": [
        "channel G with 1.1682 at 400 nm",
        "Divide percentages by 100",
    ],
    "study chen2000 --quick --pixel.prnu-um 2": ["pixel.prnu_um: got 2", "at least 44.4 µm²"],
    "datasheet --exposure.gain-db 60": ["exposure.gain_db: got 60", "Lower exposure.gain_db"],
    "run sheet.toml": ["a TOML file", "pixsim run csf --config"],
    "run": ["SCENE"],
    "run cfs": ["Did you mean 'csf'?"],
    "run csf --variant cuda_spectral": ["Did you mean 'cuda_ad_spectral'?"],
    "look": ["look", "run, explore, plan, study, compare, accuracy, datasheet, lens"],
    "study nowhere": ["nowhere", "chen2000"],
    "study sheet.toml": ["the file of a sensor", "pixsim study pixel-size --config"],
    "study pixel-size --config sheet_wide.toml": [
        "sheet_wide.toml: pixel.pitch_um: got 'wide'; allowed: a valid number."
    ],
    "study pixel-size --config sheet_key.toml": [
        "sheet_key.toml: exposure.max_integration",
        "max_integration_s",
    ],
    "study study_errors.toml": [
        *(
            "study_errors.toml: repeats: got 1; allowed: greater than or equal to 2.",
            "Did you mean 'count'?",
        ),
        "study_errors.toml: pitch.cuont: unknown name;",
    ],
    "study fewer.toml --quick": ["fewer.quick.toml: repeats: got 1"],
    "study study_few.toml": ["[6.0, 7.0, 8.0]", "at least 5"],
    "study study_large.toml": ["3000", "2713.6 µm"],
    "study chen2000 --jobs 0": ["--jobs", "0", "1 or more"],
    "study chen2000 --quick --out taken": ["taken", "cannot be written", "--out"],
    "datasheet 0.35um --pixel.technology 4t-bsi": ["give only one of them"],
    "datasheet nothing": ["technology: got 'nothing'"],
    "datasheet --pixel.bits 2": ["pixel.bits: got 2"],
    "datasheet --wavelength-nm 2000": ["--wavelength-nm: got 2000"],
    "lens": ["FILE"],
    "lens phone --f-number 2.8": ["f_number: got 2.8", "at least 3.5, the widest of 'phone'"],
    "lens phone --field-deg 80": [
        "field_deg: got",
        "where the chief ray",
        "the largest of its file is 31.76 degrees",
    ],
    f"lens phone{' --wavelength-nm 500' * 25}": [
        "--wavelength-nm: got 25 wavelengths; allowed: at most 24"
    ],
    "study chen2000 --quick --uncertainty 8 --smaller-than nan": [
        "--smaller-than: got nan; allowed: a size above 0 µm"
    ],
    "lens phone --glass-catalogues none.agf": ["none.agf"],
    "lens phone --out taken": ["taken", "cannot be written", "--out"],
    "datasheet 0.35um --out taken": ["taken", "cannot be written", "--out"],
    "accuracy csf --quick --out taken": ["taken", "cannot be written", "--out"],
    "template study --of pixel-siz": ["--of: got 'pixel-siz'", "Did you mean 'pixel-size'"],
    "template sensor --of pixel-size": ["--of: got 'pixel-size' with sensor"],
    "chart gone.png --aspect 5000 -o y.exr": ["--aspect: got 5000"],
    "doctor --limit-s 0": ["--limit-s: got 0", "above 0"],
    "lens phone --reflectance 1": ["reflectance: got 1", "below 1"],
    "template lens": ["kind: got 'lens'; allowed: sensor or study"],
    "template sensor -o key.toml": ["key.toml", "exists already"],
    "template sensor -o a.txt": ["a.txt", ".toml"],
    "chart flat --colour-axis red-green -o x.xml": [
        "--colour-axis: got with flat; allowed: the chart csf"
    ],
    "chart flat --contrast 0.2 --size-um 3 -o y.exr": [
        "--size-um, --contrast: got with flat; allowed: the chart target"
    ],
    "chart csf --colour-axis red-green -o x.exr": ["x.exr", "ends in .xml"],
    "chart csf --colour-axis red-green -o gone/x.xml": ["gone/x.xml", "can be written"],
    "chart csf --colour-axis red-green -o $x.xml": ["$x.xml", "without $"],
    "chart csf --colour-axis red-green --linear -o x.xml": [
        "--linear: got with csf; allowed: a picture"
    ],
}


@pytest.mark.parametrize("line", INVALID)
def test_command_invalid_input_gives_one_message_and_no_files(line: str, desk: Path) -> None:
    before = contents(desk)
    assert_refused(*command(line), INVALID[line])
    assert contents(desk) == before


def test_run_failure_preserves_earlier_results(desk: Path) -> None:
    assert command(f"run flat {SMALL} --out earlier")[0] == 0
    before = contents(desk)
    assert command(f"run turned_away.xml {SMALL} --out earlier")[0] == 2
    assert contents(desk) == before


QUADRANTS = np.array(
    [[1.0, 0.25], [0.5, 0.75]]
)  # all different, so that a flip or transposition shows


@pytest.fixture(scope="module")
def picture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of four grey quadrants with a sensor without dark current and non-uniformities."""
    folder = tmp_path_factory.mktemp("picture")
    pixsim.write_chart(
        folder / "quadrants.exr", np.kron(QUADRANTS, np.ones((32, 32))).astype(np.float32)
    )
    ideal = " ".join(
        f"--pixel.{name} 0"
        for name in ("prnu", "dsnu", "offset-fpn", "column-fpn", "dark-current-e-per-s")
    )
    code, out, err = command(
        f"run csf -D chart={folder / 'quadrants.exr'} --resolution 128 --display.dots 128 --seed 7"
        " --json --pixel.pitch-um 8 --pixel.bits 12 --pixel.black-level-dn 64 --pixel.full-well-e"
        f" 40000 {ideal} --out {folder / 'out'}"
    )
    assert (code, err) == (0, "")
    (folder / "stdout").write_text(out, encoding="utf-8")
    return folder


def test_run_json_equals_score_json(picture: Path) -> None:
    score = json.loads((picture / "stdout").read_text(encoding="utf-8"))
    assert score == json.loads((picture / "out/score.json").read_text(encoding="utf-8"))
    delta_e = read_channels(picture / "out/delta_e.exr")[0]["delta_e"]
    # Without a border of 1.5 pixels, 12 µm, in whole dots.
    assert delta_e.shape == tuple(score["scored_dots"]) == (126, 126)
    assert score["border_um"] == pytest.approx([21.2, 21.2])
    # The file is float32.
    assert score["mean_delta_e"] == pytest.approx(delta_e.mean(dtype=float), rel=1e-6)


def test_run_image_png_has_orientation_and_greys(picture: Path) -> None:
    """The chart under the thin lens's fall-off, 1 on the axis at texel value 1. Means over the
    middle of a quadrant, 2304 dots: noise and the curvature of gamma are below 0.5 %.
    """
    camera = pixsim.Camera()
    place = (np.arange(128) + 0.5) / 128
    x_mm = (place - 0.5) * camera.die_mm
    tan_field = np.hypot(*np.meshgrid(x_mm, x_mm)) / camera.image_distance_mm
    fall_off, on_axis = (
        pixsim.optics.irradiance_factor(camera.f_number, field, camera.magnification)
        for field in (tan_field, 0.0)
    )
    luminance = np.kron(QUADRANTS, np.ones((64, 64))) * fall_off / on_axis
    # At least 1/16 away from all edges, which diffraction and texture interpolation blur.
    is_middle = np.abs(place * 2 % 1 - 0.5) < 3 / 8
    middles = np.where(np.logical_and.outer(is_middle, is_middle), 1.0, np.nan)
    # The border of one dot is not shown.
    png = np.pad(imread(picture / "out/image.png")[:, :, 0].astype(float), 1)
    means, expected = (
        np.nanmean((middles * image).reshape(2, 64, 2, 64), axis=(1, 3))
        for image in (png**2.2, luminance)
    )
    np.testing.assert_allclose(means, expected, rtol=0.005)
    assert imread(picture / "out/delta_e.png").shape[0] > 128, "a map with axes and colour bar"


def test_run_raw_exr_holds_digital_numbers(picture: Path) -> None:
    channels, header = read_channels(picture / "out/raw.exr")
    dn = channels["Y"]
    score = json.loads((picture / "out/score.json").read_text(encoding="utf-8"))
    assert dn.shape == (int(2713.6 / 8),) * 2
    assert np.array_equal(dn, np.rint(dn).clip(0, 4095))
    assert (header["bits"], header["black_level_dn"], header["pitch_um"]) == (12, 64, 8)
    assert header["dn_per_e"] == pytest.approx(
        (4095 - 64) / 40_000, rel=1e-6
    )  # the full well is the top code
    assert header["integration_s"] == pytest.approx(score["integration_s"], rel=1e-6)
    electrons = (dn.mean(dtype=float) - header["black_level_dn"]) / header["dn_per_e"]
    # 339² pixels of shot and reset noise below 200 e: 0.6 e on a mean of about 20 000.
    assert electrons == pytest.approx(score["mean_electrons_e"], rel=2e-4)


def test_options_and_later_files_take_precedence(desk: Path) -> None:
    texts = {
        "first.toml": """seed = 5
scene.resolution = 32
camera.f_number = 2.8
pixel = { pitch_um = 8, bits = 12 }
""",
        "second.toml": """scene.spp = 4
pixel = { pitch_um = 9, prnu = 0.0 }
display.dots = 32
""",
    }
    for name, text in texts.items():
        Path(name).write_text(text, encoding="utf-8")
    files = "--config first.toml --config second.toml"
    score = json.loads(output_of(f"run flat {files} --pixel.pitch-um 10 -D resolution=64 --json"))
    pixel = score["pixel"]
    assert (pixel["pitch_um"], pixel["prnu"], pixel["bits"], score["seed"]) == (10, 0, 12, 5)
    assert score["irradiance"]["parameters"] == {"resolution": "64", "spp": "4"}
    assert score["irradiance"]["camera"]["f_number"] == 2.8
    assert {path.name for path in (desk / "pixsim-out/flat").iterdir()} == RUN_FILES


@pytest.mark.parametrize("kind", ["csf", "flat", "siemens_star", "slanted_edge", "target"])
def test_chart_writes_make_chart(kind: str, desk: Path) -> None:
    assert command(f"chart {kind} -o x.exr --width 96 --height 64")[0] == 0
    ((name, texels),) = read_channels("x.exr")[0].items()
    assert name == "Y"
    np.testing.assert_array_equal(texels, pixsim.make_chart(kind, 96, 64))


def test_chart_draws_target_of_its_options(desk: Path) -> None:
    line = "chart target --shape bar --size-um 40 --contrast 0.2 --direction horizontal --die-mm 2"
    assert command(f"{line} -o x.exr")[0] == 0
    target = pixsim.make_chart(
        "target", die_mm=2.0, shape="bar", size_um=40, contrast=0.2, direction="horizontal"
    )
    np.testing.assert_array_equal(read_channels("x.exr")[0]["Y"], target)
    assert command("chart target --shape edge -o edge.exr")[0] == 0, "it needs no size"


@pytest.mark.parametrize(("axis", "first"), [("red-green", "red"), ("blue-yellow", "blue")])
def test_chart_colour_axis_states_its_modulation(axis: str, first: str, desk: Path) -> None:
    line = f"chart csf --colour-axis {axis} -o x.xml --width 96 --height 64 --json"
    result = json.loads(output_of(line))
    assert result["slides"] == ["x_red.exr", "x_green.exr", "x_blue.exr"]
    assert {path.name for path in desk.glob("x*")} == {"x.xml", *result["slides"]}
    assert result["contrasts"][first] == pytest.approx(0.951, abs=1e-3)  # of the grey chart
    assert max(result["contrasts"].values()) == result["contrasts"][first]
    assert 0.05 < result["opponent_amplitude"] < 0.5


@pytest.mark.parametrize(
    "statement", ["import pixsim; pixsim.Camera()", "import pixsim.cli; pixsim.cli.main()"]
)
def test_import_is_lazy(statement: str) -> None:
    """Import times: Mitsuba 0.3 s, matplotlib 0.5 s, colour 2.6 s."""
    script = f"""
import atexit, sys
slow = {{"mitsuba", "drjit", "colour", "matplotlib", "OpenEXR", "scipy"}}
atexit.register(lambda: print("slow:", sorted(slow & set(sys.modules))))
sys.argv = ["pixsim", "--help"]
{statement}
"""
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=HANG_S
    )
    assert done.stdout.endswith("slow: []\n")


# --- In a shell
# ---------------------------------------------------------------------------------------------------


def test_run_invalid_files_reports_all_errors(tmp_path: Path) -> None:
    first, second = tmp_path / "a.toml", tmp_path / "b c.toml"
    first.write_text('[pixel]\nbitz = 3\nprnu = 2\n[camera]\nf_number = "wide"\n', encoding="utf-8")
    second.write_text("[display]\ndots = 1\n[exposur]\n", encoding="utf-8")
    code, out, err = command(
        "run csf --pixel.dsnu much --display.gamma 0 --config", first, "--config", second
    )
    assert (code, out) == (2, "")
    expected = [
        rf"{first}: camera.f_number: got 'wide'; .*",
        (
            rf"{first}: pixel.prnu: got 2; allowed: less than or equal to 0\.3\. In per cent\?"
            r" Write prnu = 0\.02\."
        ),
        r"pixel.dsnu: got 'much'; .*",
        rf"{first}: pixel.bitz: unknown name; .* Did you mean 'bits'\?",
        rf"{second}: display.dots: got 1; allowed: greater than or equal to 8\.",
        r"display.gamma: got '0'; allowed: greater than or equal to 0\.01\.",
        rf"{second}: exposur: unknown name; .* Did you mean 'exposure'\?",
    ]
    assert re.fullmatch("pixsim: " + "\n".join(expected) + "\n", err), err


@pytest.mark.parametrize(
    ("failure", "code", "message"),
    [
        (
            RuntimeError("the moon is out"),
            1,
            "unexpected RuntimeError: the moon is out\nThis is a bug in pixsim. --verbose",
        ),
        (MemoryError(), 1, "the system is out of memory; use a coarser film (--resolution 512)"),
        (ImportError("no lens"), 1, "a package is missing or broken (no lens). Install pixsim"),
        (OSError(errno.EMFILE, "x"), 2, "the limit of open files is too low"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_main_exception_sets_exit_code(
    failure: BaseException, code: int, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Codes 0 and 2 are checked in other tests."""
    monkeypatch.setattr("pixsim.report.commands.run.prepare", Mock(side_effect=failure))
    found, out, err = command("run csf")
    assert (found, out) == (code, "")
    assert err.startswith(f"pixsim: {message}")
    assert "Traceback" in command("run csf --verbose")[2]


def test_cameras_are_listed_with_what_they_are() -> None:
    entries = json.loads(output_of("cameras --json"))["cameras"]
    channels = {entry["name"]: entry["channels"] for entry in entries if entry["notes"]}
    assert (len(channels), channels["Canon_EOS_R5"]) == (55, "RGB")


def test_cache_reports_and_clears_entries(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    cache.store_arrays("render", "a", {"x": np.zeros(1 << 20, np.uint8)})
    size = sum(entry.size_bytes for entry in cache.entries())
    assert command("cache")[1].splitlines() == [
        f"{tmp_path}: 1.0 MiB of 4096.0 MiB",
        "  render  1 entry  1.0 MiB",
    ]
    assert_refused(*command("cache --kind frame"), ["--kind: got 'frame'; allowed: render"])
    code, out, _ = command("cache --clear --json")
    assert (code, json.loads(out)["freed_bytes"], json.loads(out)["kinds"]) == (0, size, {})


# Brighter than display white, which gives a warning.
BRIGHT = f"run csf {SMALL} --variant scalar_spectral --display.white-cd-per-m2 10"


@pytest.fixture(scope="module")
def installed(
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[subprocess.CompletedProcess[str], Path]:
    """A run by the installed command in a folder `here`, with a home folder and a cache of its own,
    and the folder above them.
    """
    above = tmp_path_factory.mktemp("installed")
    home, here, kept = (above / name for name in ("home", "here", "cache"))
    home.mkdir(), here.mkdir()
    prefixes = ("XDG_", "DRJIT_CACHE", "MPLCONFIG")
    environment = {name: None for name in os.environ if name.startswith(prefixes)} | {
        "HOME": str(home),
        "TMPDIR": str(here),
        FOLDER_VARIABLE: str(kept),
    }
    # New ones take seconds.
    for variable, name in (("MPLCONFIGDIR", "matplotlib"), ("DRJIT_CACHE_DIR", "kernels")):
        shutil.copytree(os.environ[variable], kept / name)
    colours = {"FORCE_COLOR": "", "TERM": "xterm-256color"}
    line = f"{BRIGHT} --json --out {above / 'out'}"
    return process(line, folder=here, **environment, **colours), above


def test_run_separates_stdout_and_stderr(
    installed: tuple[subprocess.CompletedProcess[str], Path],
) -> None:
    done, above = installed
    assert json.loads(done.stdout)["pitch_um"] == 6.5, done.stderr
    assert "warning: " in done.stderr
    line = f"{BRIGHT} --out {above / 'out'}"
    code, out, err = command(f"{line} --json --quiet")
    # Only what makes a number doubtful.
    assert all("warning: " in words for words in err.splitlines())
    assert (code, out) == (0, done.stdout)
    code, out, err = command(f"-v {line}")
    assert (code, out[:7]) == (0, "mean ΔE")
    assert re.search(r"^render: \d+\.\d\d s$", err, re.MULTILINE)


def test_output_without_terminal_has_no_colours(
    installed: tuple[subprocess.CompletedProcess[str], Path],
) -> None:
    assert command("--version") == (0, f"{pixsim.__version__}\n", "")
    assert "\x1b" not in installed[0].stdout + installed[0].stderr


def test_commands_write_only_to_output_and_cache(
    installed: tuple[subprocess.CompletedProcess[str], Path],
) -> None:
    _, above = installed
    assert [*(above / "home").rglob("*"), *(above / "here").rglob("*")] == [], (
        "temporary files remain"
    )
    assert {path.name for path in (above / "cache").iterdir()} > {"kernels", "matplotlib"}


def test_completion_prints_valid_script() -> None:
    """The shells differ in Cyclopts alone; `__complete` asks for names of scenes and files."""
    out = output_of("completion bash")
    assert {"run", "study", "pixsim", "__complete"} <= {*re.findall(r"\w+", out)}
    if program := shutil.which("bash"):
        subprocess.run(
            [program, "-n"], input=out, text=True, check=True, capture_output=True, timeout=HANG_S
        )
