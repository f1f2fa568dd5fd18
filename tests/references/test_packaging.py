"""Wheel and sdist: their contents, the installed package outside the checkout, and the lowest
allowed versions.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest
from helpers.processes import HANG_S

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
BUILD = "import sys; from hatchling import build; getattr(build, sys.argv[1])(sys.argv[2])"
UNREACHABLE = (
    "Could not find a version",
    "No matching distribution",
    "connection",
    "Failed to establish",
    "Read timed out",
)
AN_AGE_AGO_S = 1.0e9
MAX_S = 6 * HANG_S  # packages are downloaded, and a third of the tests run
TEXT_FILES = (".py", ".toml", ".csv", ".j2", ".xml", ".md", ".spd", ".txt", "METADATA", "py.typed")
# About a third of the quick tests of every room, which need no other tools than pytest.
QUICK_TESTS = {
    "base": "arrays cache config",
    "light": "exr tables",
    "optics": "closed_forms lens",
    "sensor": "closed_forms integration pixel",
    "scene": "closed_forms plan scene",
    "viewer": "causes closed_forms",
    "studies": "closed_forms paper study",
    "measure": "lens sfr",
    "verification": "accuracy",
    "show": "figures render",
    "report": "run views",
    "cli": "cli doctor",
}
QUICK_FILES = [
    ROOT / f"tests/{room}/test_{name}.py"
    for room, names in QUICK_TESTS.items()
    for name in names.split()
]
STUDY = """
name = "tiny"
repeats = 2
scene = { file = "csf", parameters = { resolution = 32, spp = 4 } }
pitch = { values_um = [5.6, 6.5, 7.5, 9.0, 12.0] }
display = { dots = 32, samples_per_deg = 10.0 }
"""


def run(*command: str | Path, folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a command without the environment of the checkout."""
    inherited = {
        key: value
        for key, value in os.environ.items()
        if key not in ("PYTHONPATH", "VIRTUAL_ENV", "DRJIT_LIBLLVM_PATH")
    }
    command = tuple(map(str, command))
    return subprocess.run(
        command,
        cwd=folder,
        env=inherited | environment,
        capture_output=True,
        text=True,
        timeout=MAX_S,
    )


def pip_install(python: Path | str, *what: str | Path, folder: Path) -> None:
    """Install packages; the test is skipped if no package index is reachable."""
    done = run(
        python, "-m", "pip", "install", "-q", "--disable-pip-version-check", *what, folder=folder
    )
    if done.returncode and any(word in done.stderr for word in UNREACHABLE):
        pytest.skip("no package index: " + done.stderr.strip().splitlines()[-1])
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def hatchling(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A folder with the build tool; empty if it is installed in this environment."""
    if run(sys.executable, "-c", "import hatchling", folder=ROOT).returncode == 0:
        return ""
    folder = tmp_path_factory.mktemp("tool")
    pip_install(sys.executable, "--target", folder, "hatchling>=1.21", folder=folder)
    return str(folder)


def build(hook: str, source: Path, out: Path, hatchling: str) -> Path:
    out.mkdir(exist_ok=True)
    done = run(
        sys.executable,
        "-c",
        BUILD,
        hook,
        out,
        folder=source,
        **({"PYTHONPATH": hatchling} if hatchling else {}),
    )
    assert done.returncode == 0, done.stderr
    (archive,) = out.iterdir()
    return archive


@pytest.fixture(scope="module")
def shipped(hatchling: str, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The wheel, the sdist, and both built from the sdist, whose files have another age and other
    rights.
    """
    folder = tmp_path_factory.mktemp("shipped")
    wheel, sdist = (
        build(f"build_{kind}", ROOT, folder / kind, hatchling) for kind in ("wheel", "sdist")
    )
    with tarfile.open(sdist) as archive:
        archive.extraction_filter = getattr(
            tarfile, "data_filter", None
        )  # Python 3.11.2 has no filters
        archive.extractall(folder / "unpacked")
    (source,) = (folder / "unpacked").iterdir()
    for path in source.rglob("*"):
        os.utime(path, (AN_AGE_AGO_S, AN_AGE_AGO_S))
        path.chmod(0o700 if path.is_dir() else path.stat().st_mode & 0o100 | 0o600)
    again = {
        kind: build(f"build_{kind}", source, folder / f"second {kind}", hatchling)
        for kind in ("wheel", "sdist")
    }
    return {
        "wheel": wheel,
        "sdist": sdist,
        "second": again["wheel"],
        "second sdist": again["sdist"],
    }


def contents(wheel: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(wheel) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def test_wheel_contains_package_and_scenes_only(shipped: dict[str, Path]):
    names = set(contents(shipped["wheel"]))
    info = f"pixsim-{PROJECT['version']}.dist-info"
    files = (
        path
        for path in (ROOT / "pixsim").rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    )
    expected = {path.relative_to(ROOT).as_posix() for path in files}
    scenes = {
        f"pixsim/data/{path.relative_to(ROOT).as_posix()}"
        for path in (ROOT / "scenes").rglob("*")
        if path.is_file()
    }
    data = ("style.css.j2", "technologies/0.35um.toml", "studies/chen2000.toml")
    assert {"pixsim/py.typed", *(f"pixsim/data/{name}" for name in data)} <= expected
    assert {
        f"pixsim/data/scenes/{name}"
        for name in ("csf.xml", "charts/csf.exr", "spectra/macbeth/01_dark_skin.spd")
    } <= scenes
    licences = PROJECT["license-files"]
    metadata = {f"{info}/{name}" for name in ("METADATA", "WHEEL", "RECORD", "entry_points.txt")}
    metadata |= {f"{info}/licenses/{name}" for name in licences}
    assert names == expected | scenes | metadata  # neither tests nor caches


def test_wheel_contains_no_local_paths(shipped: dict[str, Path]):
    for name, content in contents(shipped["wheel"]).items():
        if name.endswith(TEXT_FILES):
            text = content.decode("utf-8")
            local = [str(ROOT), str(Path.home()) + "/", "file://", "/work/"]
            assert not [path for path in local if path in text], name


def test_sdist_builds_same_wheel_without_caches(shipped: dict[str, Path]):
    assert contents(shipped["second"]) == contents(shipped["wheel"])
    with tarfile.open(shipped["sdist"]) as archive:
        names = archive.getnames()
    assert any(name.endswith("/tests/references/test_packaging.py") for name in names)
    assert not [
        name
        for name in names
        if re.search(r"__pycache__|\.pyc$|_cache/|pixsim-out|\.part$|/\.git/", name)
    ]


def test_archives_are_the_same_bytes_twice(shipped: dict[str, Path]):
    assert shipped["second sdist"].read_bytes() == shipped["sdist"].read_bytes()
    assert shipped["second"].read_bytes() == shipped["wheel"].read_bytes()


def test_citation_is_shipped_and_states_the_licences(shipped: dict[str, Path]):
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.findall(r"^license:\n((?:  - .*\n)+)", text, re.MULTILINE) == [
        "  - BSD-3-Clause\n  - Apache-2.0\n  - MIT\n"
    ]
    assert PROJECT["license"] == "BSD-3-Clause AND Apache-2.0 AND MIT"
    with tarfile.open(shipped["sdist"]) as archive:
        assert any(name.endswith("/CITATION.cff") for name in archive.getnames())


def test_metadata_state_tested_systems(shipped: dict[str, Path]):
    (text,) = (
        content.decode()
        for name, content in contents(shipped["wheel"]).items()
        if name.endswith("/METADATA")
    )
    systems = re.findall(r"^Classifier: Operating System :: (.*)$", text, re.MULTILINE)
    assert systems == ["POSIX :: Linux"]
    assert "Requires-Python: >=3.11" in text
    assert "License-Expression: BSD-3-Clause AND Apache-2.0 AND MIT\n" in text
    assert not re.search(r"^(Project-URL|Home-page|Download-URL)", text, re.MULTILINE)


# --- Installed elsewhere
# ----------------------------------------------------------------------------------------------


def venv(folder: Path, python: str = sys.executable) -> Path:
    done = run(python, "-m", "venv", folder, folder=folder.parent)
    assert done.returncode == 0, done.stderr
    return folder / "bin" / "python"


def assert_it_works(python: Path, folder: Path) -> None:
    """Run help, doctor, a scene and a study in an empty folder with spaces in its path."""
    folder.mkdir()
    (folder / "tiny study.toml").write_text(STUDY, encoding="utf-8")
    command, environment = (
        python.with_name("pixsim"),
        {"PIXSIM_CACHE_DIR": str(folder / "the cache"), "HOME": str(folder)},
    )
    for arguments in (
        ["--help"],
        ["doctor", "--json", "--limit-s", str(HANG_S)],
        ["run", "csf", "-D", "resolution=32", "--display.dots", "32", "--out", "a picture"],
        ["study", "tiny study.toml", "--out", "a study", "--jobs", "2"],
    ):
        done = run(command, *arguments, folder=folder, **environment)
        assert done.returncode == 0, (arguments, done.stdout, done.stderr)
        if arguments[0] == "doctor":
            findings = {
                finding["subject"]: finding["found"]
                for finding in json.loads(done.stdout)["findings"]
            }
            assert str(python.parent.parent) in findings["pixsim"]  # not the checkout
    assert (folder / "a picture" / "score.json").is_file()
    assert (folder / "a study" / "report.html").is_file()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["wheel", "sdist"])
def test_installed_package_works_in_empty_environment(
    kind: str, shipped: dict[str, Path], tmp_path: Path
):
    python = venv(tmp_path / "empty environment")
    pip_install(python, f"{shipped[kind]}[llvm]", folder=tmp_path)
    assert_it_works(python, tmp_path / "some where")
    if kind == "wheel":
        assert_types_are_seen(python, tmp_path)


def interpreter(version: str) -> str | None:
    """A Python of a version such as "3.12": on the path, or one of pyenv, whose commands answer
    only for the chosen ones.
    """
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    found = [
        shutil.which(f"python{version}"),
        *sorted(map(str, pyenv.glob(f"{version}.*/bin/python{version}"))),
    ]
    return next(
        (path for path in found if path and run(path, "--version", folder=ROOT).returncode == 0),
        None,
    )


def run_quick_tests(python: Path, folder: Path) -> None:
    """A third of the quick tests of every room, against the installed package."""
    options = (
        "-q",
        "-n",
        "1",
        "-p",
        "no:cacheprovider",
        "--rootdir",
        ROOT,
        "-c",
        ROOT / "pyproject.toml",
    )
    done = run(python, "-m", "pytest", *options, *QUICK_FILES, folder=folder)
    assert done.returncode == 0, done.stdout[-4000:]


def test_quick_tests_are_there():
    assert [path for path in QUICK_FILES if not path.is_file()] == []


VERSIONS = ("3.11", "3.12", "3.13", "3.14")
# The lowest packages have no wheels for the newest Python.
INSTALLATIONS = [
    *((version, "newest") for version in VERSIONS),
    *((version, "lowest") for version in VERSIONS[:-1]),
]


@pytest.mark.slow
@pytest.mark.parametrize(("version", "packages"), INSTALLATIONS)
def test_installed_package_works_on_every_python(
    version: str, packages: str, shipped: dict[str, Path], tmp_path: Path
):
    """Newest packages are other ones on newer Pythons: from NumPy 2.5 on, which needs 3.12, types
    of arrays are told otherwise.
    """
    chosen = interpreter(version)
    if chosen is None:
        pytest.skip(f"no Python {version}")
    python = venv(tmp_path / packages, chosen)
    pins = (
        [lowest(requirement) for requirement in PROJECT["dependencies"]]
        if packages == "lowest"
        else []
    )
    pip_install(
        python,
        f"{shipped['wheel']}[llvm]",
        *pins,
        "pytest>=8",
        "pytest-xdist>=3.5",
        folder=tmp_path,
    )
    assert_it_works(python, tmp_path / "some where")
    run_quick_tests(python, tmp_path)


# What each extra brings; that of `llvm` is tested above, and the others are for those who work on
# pixsim.
EXTRAS = {
    "cluster": "distributed",
    "envi": "spectral",
    "explore": "starlette",
    "flip": "flip_evaluator",
    "denoise": "skimage",
}


def test_extras_are_all_tested():
    assert {*PROJECT["optional-dependencies"]} == {*EXTRAS, "llvm", "docs", "test"}


@pytest.mark.slow
@pytest.mark.parametrize("extra", EXTRAS)
def test_wheel_installs_with_each_extra_alone(extra: str, shipped: dict[str, Path], tmp_path: Path):
    python = venv(tmp_path / "with one extra")
    pip_install(python, f"{shipped['wheel']}[{extra}]", folder=tmp_path)
    others = [name for name in EXTRAS.values() if name != EXTRAS[extra]]
    script = (
        f"import {EXTRAS[extra]}, importlib.util as u; print([name for name in {others} if"
        " u.find_spec(name)])"
    )
    for command in (
        [python, "-m", "pip", "check"],
        [python.with_name("pixsim"), "--version"],
        [python, "-c", script],
    ):
        done = run(*command, folder=tmp_path)
        assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.strip() == "[]", "the other extras are not there"


def assert_types_are_seen(python: Path, folder: Path) -> None:
    """mypy reads the annotations of the installed package and reports wrong types."""
    script = folder / "script.py"
    script.write_text(
        "import pixsim\ncamera = pixsim.Camera(f_number=2.8)\nimage: pixsim.SpectralImage ="
        " pixsim.render(pixsim.load_scene('csf', resolution=32), camera, seed=1)\nwrong: int ="
        " image.illuminance_lx()\npixsim.render('csf')\n",
        encoding="utf-8",
    )
    # Without the plugin mypy treats all fields of a record as required: their defaults are
    # positional in Field(…).
    (folder / "mypy.ini").write_text("[mypy]\nplugins = pydantic.mypy\n", encoding="utf-8")
    arguments = (
        "--python-executable",
        python,
        "--strict",
        "--config-file",
        "mypy.ini",
        "--no-incremental",
        script,
    )
    done = run(sys.executable, "-m", "mypy", *arguments, folder=folder)
    assert re.findall(r"script\.py:(\d+): error", done.stdout) == ["4", "5"], (
        done.stdout + done.stderr
    )


def lowest(requirement: str) -> str:
    """`numpy>=2.0` as `numpy==2.0`; `mitsuba==3.9.*` as `mitsuba==3.9.0`."""
    return requirement.replace(">=", "==").replace(".*", ".0")


def test_lowest_pins_every_dependency():
    pins = [lowest(requirement) for requirement in PROJECT["dependencies"]]
    assert "mitsuba==3.9.0" in pins
    assert not [pin for pin in pins if re.search(r"[<>*~!]", pin)], (
        "a kind of bound that `lowest` does not convert"
    )
