"""What tests share: a cache of their own, so that none reads or writes the user's, and a count of the pictures taken."""

from collections.abc import Iterator

import pytest
from helpers.tiny import tiny

import pixsim
from pixsim.base.files import FOLDER_VARIABLE
from pixsim.sensor.readout import Frame
from pixsim.studies.result import StudyResult
from pixsim.viewer.score import ImagingChain


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(FOLDER_VARIABLE, str(tmp_path_factory.mktemp("cache")))
        # More than a hundred processes are started: each would compile all of pixsim for itself.
        patch.delenv("PYTHONDONTWRITEBYTECODE", raising=False)
        yield


@pytest.fixture(scope="session")
def tiny_result(tmp_path_factory: pytest.TempPathFactory) -> StudyResult:
    """A study of one technology that is compared with the paper, on a display just larger than a detail."""
    return pixsim.study(tiny(paper=True, display={"dots": 120}), tmp_path_factory.mktemp("tiny"), jobs=1)


@pytest.fixture
def evaluations(monkeypatch: pytest.MonkeyPatch) -> list[Frame]:
    """Grows by one with every picture that is taken in this process."""
    taken: list[Frame] = []
    view = ImagingChain.score_frame
    monkeypatch.setattr(ImagingChain, "score_frame", lambda self, frame: taken.append(frame) or view(self, frame))
    return taken
