"""A context for as long as any of several blocks, which may overlap, is in it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack


class SharedBlock:
    """The first of several blocks of any threads enters a context, and the last one leaves it.

    enter : returns the context; called by the first block
    """

    def __init__(self, enter: Callable[[], AbstractContextManager[object]]) -> None:
        self._enter = enter
        self._blocks = 0
        self._context = ExitStack()
        self._changing = threading.RLock()

    @property
    def is_running(self) -> bool:
        """Whether there is such a block now."""
        return self._blocks > 0

    def __enter__(self) -> None:
        with self._changing:
            if not self._blocks:
                self._context.enter_context(self._enter())
            self._blocks += 1

    def __exit__(self, *_: object) -> None:
        with self._changing:
            self._blocks -= 1
            if not self._blocks:
                self._context.close()
