"""Functions of the user's: what their results depend on, and how they travel to workers."""

from __future__ import annotations

import dis
import hashlib
import inspect
import pickle
import sysconfig
from pathlib import Path
from types import CellType, CodeType, FunctionType

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
    seen : values that were visited before, to which this one is added
    """
    if inspect.ismodule(value) or any(value is seen_value for seen_value in seen):
        return ""
    seen.append(value)
    function = getattr(value, "__func__", value)  # of a method
    if not inspect.isfunction(function) or _is_versioned(function):
        return _content_of_value(value)

    # The code of the function and of all functions inside it.
    codes = [function.__code__]
    for code in codes:
        codes += [constant for constant in code.co_consts if inspect.iscode(constant)]
    steps = [(code.co_code, code.co_names, _constants(code)) for code in codes]

    # The global names that this code uses, variables of functions around it, and defaults.
    instructions = (step for code in codes for step in dis.get_instructions(code))
    global_names = {
        step.argval for step in instructions if step.opname in ("LOAD_GLOBAL", "LOAD_NAME")
    }
    names = sorted(global_names & function.__globals__.keys())
    values: list[object] = [function.__globals__[name] for name in names]
    cells = function.__closure__ or ()
    values += [cell.cell_contents for cell in cells if cell != CellType()]
    values += [function.__defaults__, function.__kwdefaults__]
    return " ".join([repr(steps), *(content_of(inner, seen) for inner in values)])


def _is_versioned(function: FunctionType) -> bool:
    """Return whether a function belongs to a package, whose version stands for its code."""
    return function.__code__.co_filename.startswith(_VERSIONED_FOLDERS)


def _content_of_value(value: object) -> str:
    """Return the source of a class, or a hash of another value; its type where it has neither."""
    try:
        if inspect.isclass(value):
            return inspect.getsource(value)
        return hashlib.blake2b(pickle.dumps(value)).hexdigest()
    except Exception:  # whatever a class of the user's raises
        return f"{type(value)} {getattr(value, '__qualname__', '')}"


def _constants(code: CodeType) -> list[object]:
    """Return what tells the constants of code apart; a set has its members in one order."""
    plain = (constant for constant in code.co_consts if not inspect.iscode(constant))
    return [
        sorted(map(repr, constant)) if isinstance(constant, frozenset) else repr(constant)
        for constant in plain
    ]
