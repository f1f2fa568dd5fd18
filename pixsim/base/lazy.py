"""What Python, SciPy and Matplotlib do, and pixsim does not need."""

from __future__ import annotations

import functools
import os
import sys
from contextlib import chdir, suppress
from importlib.util import LazyLoader, find_spec, module_from_spec
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING or sys.version_info >= (3, 12):
    cached_property = functools.cached_property
else:

    class cached_property(functools.cached_property):
        """Python's cached property as it is from 3.12 on: without a lock, which before would let
        one thread at a time compute the property of all records of a class.
        """

        def __get__(self, record: Any, owner: type | None = None) -> Any:
            """Return the value, computed once; by two threads at the same time, perhaps twice."""
            if record is None:
                return self
            if self.attrname not in record.__dict__:
                record.__dict__[self.attrname] = self.func(record)
            return record.__dict__[self.attrname]


def load_when_used(*names: str) -> None:
    """Put modules of NumPy in place that are loaded when one of their attributes is used, unless
    they are loaded already.

    SciPy copies NumPy's whole namespace, which would load all of them. Only for modules that no
    thread uses: before Python 3.12, a second thread finds a module that is being loaded empty.
    """
    import numpy as np  # here: the help of a command needs none

    for name in names:
        full = f"numpy.{name}"
        if full in sys.modules or not (spec := find_spec(full)) or not spec.loader:
            continue
        spec.loader = LazyLoader(spec.loader)
        module = module_from_spec(spec)
        sys.modules[full] = module
        spec.loader.exec_module(module)
        setattr(np, name, module)


RC_FILE = "matplotlibrc"


def ignore_matplotlibrc() -> None:
    """Let Matplotlib read no file of settings, in the process of a command before it has threads or
    children.

    When it is imported it looks for one in the current folder first, before any variable, and would
    wait for a pipe there: where there is one it is imported at once, from another folder.
    """
    os.environ["MATPLOTLIBRC"] = os.devnull
    if "matplotlib" not in sys.modules and os.path.lexists(RC_FILE):
        with chdir("/"), suppress(ImportError):  # which is reported where a figure is drawn
            import matplotlib  # noqa: F401
