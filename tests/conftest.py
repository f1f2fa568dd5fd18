"""Shared fixtures: a temporary cache, a small study, and a record of captured frames."""

import gc
import os
import signal
import site
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

# Before NumPy: threads make the small matrices of a fit several times slower, and the workers of a
# run share the cores.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")
# Else each worker of each run would compile pixsim and rewrite the assertions of all tests, which
# takes most of their collection.
if sys.dont_write_bytecode:
    sys.dont_write_bytecode = False
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
# Workers have 80 columns from no terminal; a test that needs a width sets its own.
os.environ.pop("COLUMNS", None)
# A shell starts what runs in the background with Ctrl-C ignored, which commands under test would
# inherit.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

import pytest
from filelock import FileLock
from helpers.machine import changes, devices, files_below
from helpers.tiny import WHOLE_CHART, tiny

import pixsim
from pixsim.base.files import FOLDER_VARIABLE
from pixsim.base.locks import UNFINISHED
from pixsim.studies.result import StudyResult
from pixsim.viewer.chain import ImagingChain
from pixsim.viewer.development import Development
from pixsim.viewer.merging import merge
from pixsim.viewer.score import FrameScore
from pixsim.viewer.without_effect import STREAM, UserSettings

gc.disable()  # until tests are collected, of which all stay


def shared_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run of pytest, which its workers share."""
    base = tmp_path_factory.getbasetemp()
    return base.parent if "PYTEST_XDIST_WORKER" in os.environ else base


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--renew-golden", action="store_true", help="write the documents of tests/data/golden again"
    )


def pytest_collection_finish() -> None:
    """Tests that are collected stay until the end: the garbage collector need not look at a million
    objects again and again.

    Nor at each 700 new ones: figures are made of a hundred thousand.
    """
    gc.freeze()
    gc.set_threshold(50_000)
    gc.enable()


@pytest.fixture(scope="session", autouse=True)
def temporary_cache(
    tmp_path_factory: pytest.TempPathFactory, pytestconfig: pytest.Config
) -> Iterator[None]:
    shared = shared_folder(tmp_path_factory)
    # Compiled kernels, whose names are digests of what they compute, and the list of fonts also
    # serve the next runs: compilation takes a second for a kernel of paths.
    lasting = pytestconfig.cache.mkdir("compiled") if hasattr(pytestconfig, "cache") else shared
    with pytest.MonkeyPatch.context() as patch:
        # Pictures, kernels and fonts are the same for all processes of a run.
        for variable, folder in (
            (FOLDER_VARIABLE, shared / "cache"),
            ("DRJIT_CACHE_DIR", lasting / "kernels"),
            ("MPLCONFIGDIR", lasting / "matplotlib"),
            ("DASK_TEMPORARY_DIRECTORY", shared / "dask"),
        ):
            folder.mkdir(exist_ok=True)
            patch.setenv(variable, str(folder))
        yield


@pytest.fixture(scope="session")
def own_places(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, Path]]:
    """A home folder and a folder of temporary files of the run's own, with a file in each that is
    another's.
    """
    places = tmp_path_factory.mktemp("home"), tmp_path_factory.mktemp("T")
    for place in places:
        (place / "theirs.txt").write_text("theirs", encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(
            "PYTHONUSERBASE", site.getuserbase()
        )  # which Python looks for in the home folder
        for variable, place in zip(("HOME", "TMPDIR"), places, strict=True):
            patch.setenv(variable, str(place))
        patch.setattr(tempfile, "tempdir", None)
        yield places


@pytest.fixture(scope="module", autouse=True)
def machine_as_it_was(own_places: tuple[Path, Path]) -> Iterator[None]:
    """The tests of a module leave devices, the home folder and temporary files as they were, also
    if root runs them.

    The temporary folder of a process that has no cache goes when the process ends, as tests of
    whole processes see.
    """
    before = devices(), *map(files_below, own_places)
    yield
    after = devices(before[0]), *map(files_below, own_places)
    found = {
        name: changes(*each)
        for name, *each in zip(("/dev", "HOME", "TMPDIR"), before, after, strict=True)
    }
    found["TMPDIR"] = [words for words in found["TMPDIR"] if not words.startswith(UNFINISHED)]
    assert not any(found.values()), found


# Modules whose claims are settings without effect, all that a page says, or that nothing else is
# raised, whatever the settings.
REVIEWED = (
    "test_without_effect",
    "test_preparation",
    "test_golden",
    "test_properties",
    "test_arguments",
)


@pytest.fixture(scope="module", autouse=True)
def unreviewed(request: pytest.FixtureRequest) -> Iterator[None]:
    """No setting is said to do nothing, which takes a third of the time of a small frame's score:
    in modules whose claims are others.
    """
    with pytest.MonkeyPatch.context() as patch:
        if request.path.stem not in REVIEWED:
            patch.setattr(UserSettings, "without_effect", lambda _: [])
        yield


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of the test's own, which is the current one."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="session")
def tiny_result(tmp_path_factory: pytest.TempPathFactory) -> StudyResult:
    """A study of one technology with the comparison to the paper, on a display slightly larger than
    a detail.
    """
    import joblib

    study = tiny(**merge(WHOLE_CHART, {"display": {"dots": 120}, "resolution": 256, "paper": True}))
    stored = shared_folder(tmp_path_factory) / "tiny_result"
    with FileLock(f"{stored}.lock"):  # it is made once for all workers of the run
        if not stored.exists():
            joblib.dump(pixsim.study(study, tmp_path_factory.mktemp("tiny"), jobs=1), stored)
    return joblib.load(stored)


@pytest.fixture
def evaluations(monkeypatch: pytest.MonkeyPatch) -> list[pixsim.Frame]:
    """Frames scored in this process so far, without those of the small light; none of them measures
    a film that is coarse.
    """
    frames: list[pixsim.Frame] = []
    of_small_light: list[pixsim.Frame] = []
    capture, view = ImagingChain.capture, Development.score

    def captured(chain: ImagingChain, *key: object, **more) -> pixsim.Frame:
        frame = capture(chain, *key, **more)
        of_small_light.extend([frame] * (key == STREAM))
        return frame

    def scored(development: Development, frame: pixsim.Frame) -> FrameScore:
        frames.extend([frame] * all(frame is not other for other in of_small_light))
        return view(development, frame)

    monkeypatch.setattr(ImagingChain, "capture", captured)
    monkeypatch.setattr(Development, "score", scored)
    return frames
