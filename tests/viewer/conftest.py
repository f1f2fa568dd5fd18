"""`evaluate` also looks for settings that do nothing, a good part of its time for a small frame."""

from collections.abc import Iterator

import pytest

from pixsim.viewer.without_effect import UserSettings


@pytest.fixture(scope="module", autouse=True)
def without_review(request: pytest.FixtureRequest) -> Iterator[None]:
    """Find none; test_without_effect, which has the claim, looks for them."""
    with pytest.MonkeyPatch.context() as patch:
        if not request.path.name.startswith("test_without_effect"):
            patch.setattr(UserSettings, "without_effect", lambda _: [])
        yield
