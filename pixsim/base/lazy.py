"""What NumPy, SciPy and Matplotlib do when they are imported, and pixsim does not need: up to a third of the time of an import."""

from __future__ import annotations

import os
import sys
from contextlib import chdir, suppress
from importlib.util import LazyLoader, find_spec, module_from_spec
from typing import Any


def load_when_used(*names: str) -> None:
    """Put modules of NumPy in place that are loaded when one of their attributes is used, unless they are loaded already.

    SciPy copies NumPy's whole namespace, which would load all of them. Only for modules that no thread uses: before Python 3.12, a
    second thread finds a module that is being loaded empty.
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


class PlainDocstring:
    """A docstring as it is, in place of SciPy's `FunctionDoc`, which parses it."""

    def __init__(self, function: object) -> None:
        self.text = function.__doc__ or ""

    def __getitem__(self, section: str) -> list[Any]:
        return []

    def __setitem__(self, section: str, content: object) -> None:
        pass

    def __str__(self) -> str:
        return f"\n{self.text}"  # SciPy takes the first line for the signature


def import_less() -> None:
    """Let SciPy import and do less, in the process of a command.

    It leaves the docstrings of its functions as they are, since nobody reads them: when it is imported it adds notes on other array
    libraries to hundreds of them. Its functions are the same. Matplotlib obeys no file of settings.

    SciPy's name that is replaced is private. Without that, `pixsim run csf --resolution 64 --display.dots 32 --pixel.pitch-um 42.4`
    takes 4 % more processor time with a filled cache (1.23 s against 1.27 s, medians of nine runs in turns).
    """
    ignore_matplotlibrc()
    with suppress(ImportError):  # SciPy's own name for it may change: then nothing is gained
        from scipy._lib import _docscrape

        if hasattr(_docscrape, "FunctionDoc"):
            _docscrape.FunctionDoc = PlainDocstring
    global _nobody_reads
    _nobody_reads = True


RC_FILE = "matplotlibrc"


def ignore_matplotlibrc() -> None:
    """Let Matplotlib read no file of settings, in the process of a command before it has threads or children.

    When it is imported it looks for one in the current folder first, before any variable, and would wait for a pipe there: where
    there is one it is imported at once, from another folder.
    """
    os.environ["MATPLOTLIBRC"] = os.devnull
    if "matplotlib" not in sys.modules and os.path.lexists(RC_FILE):
        with chdir("/"), suppress(ImportError):  # which is reported where a figure is drawn
            import matplotlib  # noqa: F401


_nobody_reads = False  # docstrings, in the process of a command


def leave_out_docstrings_of_matplotlib() -> None:
    """Let Matplotlib list no properties in the docstrings of its classes, where nobody reads them; call before it draws.

    It asks each class for its properties when it is imported. Its figures are the same. Without that, `pixsim lens singlet` takes
    4 % more processor time (0.09 s of 2.2 s). The function that is replaced is public.
    """
    if _nobody_reads:
        with suppress(ImportError):
            from matplotlib import artist

            if hasattr(artist, "kwdoc"):
                artist.kwdoc = lambda artist: ""
