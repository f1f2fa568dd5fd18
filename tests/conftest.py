"""What every test shares: a cache of its own, so that none reads or writes the user's."""

from collections.abc import Iterator

import pytest

from pixsim import cache


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(cache.FOLDER_VARIABLE, str(tmp_path_factory.mktemp("cache")))
        # More than a hundred processes are started: each would compile all of pixsim for itself.
        patch.delenv("PYTHONDONTWRITEBYTECODE", raising=False)
        yield
