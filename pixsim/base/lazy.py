"""Modules of NumPy that are loaded when they are used: SciPy copies NumPy's whole namespace, which loads all of them."""

from __future__ import annotations

import sys
from importlib.util import LazyLoader, find_spec, module_from_spec

import numpy as np


def load_when_used(*names: str) -> None:
    """Put modules of NumPy in place that are loaded when one of their attributes is used, unless they are loaded already."""
    for name in names:
        full = f"numpy.{name}"
        if full in sys.modules or not (spec := find_spec(full)) or not spec.loader:
            continue
        spec.loader = LazyLoader(spec.loader)
        module = module_from_spec(spec)
        sys.modules[full] = module
        spec.loader.exec_module(module)
        setattr(np, name, module)
