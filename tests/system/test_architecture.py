"""The house keeps its shape: the longest chain of imports, cycles, and sizes of files and functions."""

import ast
from functools import cache
from pathlib import Path

SRC = Path(__file__).resolve().parents[2] / "src"
MODULES = {
    ".".join(file.relative_to(SRC).with_suffix("").parts): ast.parse(file.read_text(encoding="utf-8"))
    for file in sorted((SRC / "kreisel").rglob("*.py"))
}

MAX_CHAIN = 12
MAX_LINES = 600
MAX_BODY = 65


def imported(module, *, deferred=False):
    """Return the modules one imports when it is imported itself; with `deferred`, also those that functions import."""
    names = set()
    for node in ast.walk(MODULES[module]) if deferred else MODULES[module].body:
        if isinstance(node, ast.ImportFrom) and node.module:
            names |= {f"{node.module}.{alias.name}" for alias in node.names} | {node.module}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    names |= {f"{name}.__init__" for name in names}
    return {name for name in names if name in MODULES and name != module}


@cache
def chain_of(module):
    """Return the longest chain of imports from a module downwards; a cycle would never end."""
    return (module, *max((chain_of(name) for name in imported(module)), key=len, default=()))


def test_no_chain_of_imports_is_longer_than_twelve():
    longest = max((chain_of(module) for module in MODULES), key=len)
    assert len(longest) <= MAX_CHAIN, " > ".join(longest)


def test_no_circle_of_imports_even_through_functions():
    """An import that a function makes later hides a circle. What types alone need does not count: it is never run."""
    seen, path = set(), []

    def visit(module):
        assert module not in path, " > ".join([*path[path.index(module) :], module])
        if module in seen:
            return
        path.append(module)
        for name in sorted(imported(module, deferred=True) - for_types_alone(module)):
            visit(name)
        seen.add(path.pop())

    for module in MODULES:
        visit(module)


def for_types_alone(module):
    """Return the modules that are imported under `if TYPE_CHECKING` only."""
    names = set()
    for node in MODULES[module].body:
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            names |= {one.module for one in node.body if isinstance(one, ast.ImportFrom)}
    return names


def test_packages_export_nothing():
    """An import names the module it is from; only `kreisel` itself has public names, found when asked for."""
    for name, tree in MODULES.items():
        if name.endswith(".__init__") and name not in ("kreisel.__init__", "kreisel.devices.krl.__init__"):
            assert [type(node) for node in tree.body] == [ast.Expr], name


def test_files_and_functions_can_be_read_at_once():
    for file in (SRC / "kreisel").rglob("*.py"):
        assert len(file.read_text(encoding="utf-8").splitlines()) <= MAX_LINES, file.name
    for name, tree in MODULES.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                body = node.body[1:] if ast.get_docstring(node) and len(node.body) > 1 else node.body
                lines = body[-1].end_lineno - body[0].lineno + 1
                assert lines <= MAX_BODY, f"{name}.{node.name}: {lines} lines"


def test_nothing_outside_its_room_names_the_filters_passes():
    """Whatever needs a fit asks an estimator: `kalman` is imported where one is chosen, and for figures of its own."""
    allowed = {"kreisel.calibration.calibrate", "kreisel.calibration.convergence", "kreisel.study.bound"}
    for name in MODULES:
        if name.startswith("kreisel.kalman."):
            continue
        used = {
            module for module in imported(name) if module.startswith("kreisel.kalman.") and "__init__" not in module
        }
        if name in allowed:
            used -= {"kreisel.kalman.sigma_point_filter"}
        assert not used, f"{name} imports {', '.join(used)}"
