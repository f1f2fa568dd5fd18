"""Functions of the user's: what their results depend on, and how they travel to workers."""

from __future__ import annotations

import dis
import hashlib
import inspect
import pickle
import sysconfig
from pathlib import Path
from types import CellType, CodeType

# Code that versions tell, not results: of pixsim, of Python and of installed packages.
_VERSIONED_FOLDERS = (
    str(Path(__file__).parents[1]),
    *(sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib")),
)


def code_hash(function: object) -> str:
    """Return a hash of what the results of a user's function depend on, 16 hexadecimal digits."""
    return hashlib.blake2b(content_of(function, []).encode(), digest_size=8).hexdigest()


def by_value(function: object) -> object:
    """Return a function that is pickled by value: the workers of a study do not have the script or
    the notebook of it.
    """
    from joblib import wrap_non_picklable_objects

    return wrap_non_picklable_objects(function, keep_wrapper=False)


def content_of(value: object, seen: list[object]) -> str:
    """Return what the results of a user's function depend on: its code, and the functions and
    values to which that refers.

    value : the function, or what it refers to
    seen : such values that were met before, to which this one is added
    """
    if inspect.ismodule(value) or any(value is seen_value for seen_value in seen):
        return ""
    seen.append(value)
    function = getattr(value, "__func__", value)  # of a method
    if not inspect.isfunction(function) or function.__code__.co_filename.startswith(
        _VERSIONED_FOLDERS
    ):
        try:
            return (
                inspect.getsource(value)
                if inspect.isclass(value)
                else hashlib.blake2b(pickle.dumps(value)).hexdigest()
            )
        except Exception:  # whatever a class of the user's raises
            return f"{type(value)} {getattr(value, '__qualname__', '')}"
    codes = [function.__code__]
    for code in codes:  # with those of functions inside
        codes += [constant for constant in code.co_consts if inspect.iscode(constant)]
    steps = [(code.co_code, code.co_names, _constants(code)) for code in codes]

    instructions = (step for code in codes for step in dis.get_instructions(code))
    global_names = {
        step.argval for step in instructions if step.opname in ("LOAD_GLOBAL", "LOAD_NAME")
    }
    names = sorted(global_names & function.__globals__.keys())
    cells = [cell.cell_contents for cell in function.__closure__ or () if cell != CellType()]
    values = [
        *(function.__globals__[name] for name in names),
        *cells,
        function.__defaults__,
        function.__kwdefaults__,
    ]
    return " ".join([repr(steps), *(content_of(value, seen) for value in values)])


def _constants(code: CodeType) -> list[object]:
    """Return what tells the constants of code apart; a set has its members in one order."""
    plain = (constant for constant in code.co_consts if not inspect.iscode(constant))
    return [
        sorted(map(repr, constant)) if isinstance(constant, frozenset) else repr(constant)
        for constant in plain
    ]
