"""What another system lacks is hidden from pixsim's modules, and from no other:
`python systems.py SYSTEM CODE` runs code so.

Which names of Python's own modules a system has is read from the stubs of typeshed, as mypy brings
them. What a system call does there is not told: files and processes are those of this machine.
"""

import ast
import builtins
import importlib
import sys
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from types import ModuleType

WINDOWS, MACOS = "win32", "darwin"  # as `sys.platform`
OTHER_VALUES: dict[str, dict] = {
    WINDOWS: {"name": "nt", "supports_dir_fd": set(), "supports_fd": set()},
    MACOS: {},
}  # of os


def names_of(statements: Sequence[ast.stmt], system: str) -> Iterator[str]:
    """Names that the statements of a stub define on a system, without those that it imports for
    itself.
    """
    for each in statements:
        match each:
            case ast.If():
                code = compile(ast.Expression(each.test), "stub", "eval")
                seen = {
                    "sys": type("sys", (), {"platform": system, "version_info": sys.version_info}),
                    "TYPE_CHECKING": True,
                }
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
def missing(module: str, system: str) -> frozenset[str] | None:
    """Names of a module of Python that a system lacks and this one has; None if it lacks the
    module.
    """
    import mypy  # its package alone, not the checker

    folder = Path(mypy.__file__).parent / "typeshed/stdlib"
    stubs = [
        folder.joinpath(*module.split(".")).with_suffix(".pyi"),
        folder.joinpath(*module.split("."), "__init__.pyi"),
    ]
    found = next((stub for stub in stubs if stub.is_file()), None)
    if found is None:
        return frozenset()
    tree = ast.parse(found.read_text(encoding="utf-8")).body
    here, there = (
        {name for name in names_of(tree, each) if name[0] != "_"} for each in (sys.platform, system)
    )
    return None if here and not there else frozenset(here - there)


class ModuleThere(ModuleType):
    """A module of Python as another system has it: without the names that are hidden."""

    def __init__(self, real: ModuleType, hidden: frozenset[str], system: str) -> None:
        super().__init__(real.__name__)
        others = {"os": OTHER_VALUES[system], "sys": {"platform": system}}
        vars(self).update(_real=real, _hidden=hidden, **others.get(real.__name__, {}))

    def __getattr__(self, name: str):
        if name in self._hidden:
            raise AttributeError(
                f"module '{self._real.__name__}' has no attribute '{name}' there", name=name
            )
        return getattr(self._real, name)

    def __setattr__(self, name: str, value: object) -> None:
        setattr(self._real, name, value)


def hide(system: str) -> None:
    """Hide from modules of pixsim that are imported from now on what a system lacks."""
    import_here = builtins.__import__

    def import_there(
        name: str, globals=None, locals=None, fromlist=(), level: int = 0
    ) -> ModuleType:
        module = import_here(name, globals, locals, fromlist, level)
        importer = (globals or {}).get("__name__", "")
        if (
            level
            or not f"{importer}.".startswith("pixsim.")
            or name.partition(".")[0] not in sys.stdlib_module_names
        ):
            return module
        hidden = missing(name, system)
        if hidden is None:
            raise ModuleNotFoundError(f"No module named '{name}' there", name=name)
        return ModuleThere(module, hidden, system) if hidden or name in ("os", "sys") else module

    importlib.import_module("mypy")
    builtins.__import__ = import_there


if __name__ == "__main__":
    hide(sys.argv[1])
    exec(sys.argv[2], {"__name__": "code"})
