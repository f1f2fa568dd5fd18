"""What Windows lacks is hidden from pixsim's modules, and from no other: `python windows.py CODE` runs code in such a process.

Which names of Python's own modules a system has is read from the stubs of typeshed, as mypy brings them. What a system call does
there is not told: files and processes are those of this machine.
"""

from __future__ import annotations

import ast
import builtins
import importlib
import sys
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

WINDOWS = "win32"
ON_WINDOWS: dict[str, dict[str, Any]] = {  # other values of names that it has
    "os": {"name": "nt", "supports_dir_fd": set(), "supports_fd": set()}, "sys": {"platform": WINDOWS},
}  # fmt: skip


def names_of(statements: Sequence[ast.stmt], system: str) -> Iterator[str]:
    """Names that the statements of a stub define on a system, without those that it imports for itself."""
    for each in statements:
        match each:
            case ast.If():
                code = compile(ast.Expression(each.test), "stub", "eval")
                seen = {"sys": type("sys", (), {"platform": system, "version_info": sys.version_info}), "TYPE_CHECKING": True}
                yield from names_of(each.body if eval(code, seen) else each.orelse, system)
            case ast.FunctionDef() | ast.ClassDef():
                yield each.name
            case ast.Assign():
                yield from (target.id for target in each.targets if isinstance(target, ast.Name))
            case ast.AnnAssign(target=ast.Name(id=name)):
                yield name
            case ast.ImportFrom():
                yield from (alias.asname for alias in each.names if alias.asname == alias.name)


@cache
def missing(module: str) -> frozenset[str] | None:
    """Names of a module of Python that Windows lacks and this system has; None if it lacks the module."""
    import mypy  # its package alone, not the checker

    folder = Path(mypy.__file__).parent / "typeshed/stdlib"
    stubs = [folder.joinpath(*module.split(".")).with_suffix(".pyi"), folder.joinpath(*module.split("."), "__init__.pyi")]
    found = next((stub for stub in stubs if stub.is_file()), None)
    if found is None:
        return frozenset()
    tree = ast.parse(found.read_text(encoding="utf-8")).body
    here, there = ({name for name in names_of(tree, system) if name[0] != "_"} for system in (sys.platform, WINDOWS))
    return None if here and not there else frozenset(here - there)


class WindowsModule(ModuleType):
    """A module of Python as Windows has it: without the names that are hidden."""

    def __init__(self, real: ModuleType, hidden: frozenset[str]) -> None:
        super().__init__(real.__name__)
        vars(self).update(_real=real, _hidden=hidden, **ON_WINDOWS.get(real.__name__, {}))

    def __getattr__(self, name: str) -> Any:
        if name in self._hidden:
            raise AttributeError(f"module '{self._real.__name__}' has no attribute '{name}' on Windows", name=name)
        return getattr(self._real, name)

    def __setattr__(self, name: str, value: object) -> None:
        setattr(self._real, name, value)


def hide() -> None:
    """Hide from modules of pixsim that are imported from now on what Windows lacks."""
    import_here = builtins.__import__

    def import_there(name: str, globals: Any = None, locals: Any = None, fromlist: Any = (), level: int = 0) -> ModuleType:
        module = import_here(name, globals, locals, fromlist, level)
        importer = (globals or {}).get("__name__", "")
        if level or not f"{importer}.".startswith("pixsim.") or name.partition(".")[0] not in sys.stdlib_module_names:
            return module
        hidden = missing(name)
        if hidden is None:
            raise ModuleNotFoundError(f"No module named '{name}' on Windows", name=name)
        return WindowsModule(module, hidden) if hidden else module

    importlib.import_module("mypy")
    builtins.__import__ = import_there


if __name__ == "__main__":
    hide()
    exec(sys.argv[1], {"__name__": "code"})
