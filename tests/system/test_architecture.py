"""The house keeps its shape: the longest chain of imports, cycles, and sizes of files and functions."""

import ast
import re
import sys
import tomllib
from functools import cache
from importlib.metadata import packages_distributions
from pathlib import Path

SRC = Path(__file__).resolve().parents[2] / "src"
FILES = {
    ".".join(file.relative_to(SRC).with_suffix("").parts): file for file in sorted((SRC / "kreisel").rglob("*.py"))
}

MAX_CHAIN = 12
MAX_LINES = 600
MAX_BODY = 65
MANY_ARGUMENTS = 0.012
"""Share of functions with more than six arguments."""


@cache
def parsed(module):
    return ast.parse(FILES[module].read_text(encoding="utf-8"))


def imported(module, *, deferred=False):
    """Return the modules one imports when it is imported itself; with `deferred`, also those that functions import."""
    names = set()
    for node in ast.walk(parsed(module)) if deferred else parsed(module).body:
        if isinstance(node, ast.ImportFrom) and node.module:
            names |= {f"{node.module}.{alias.name}" for alias in node.names} | {node.module}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    names |= {f"{name}.__init__" for name in names}
    return {name for name in names if name in FILES and name != module}


@cache
def chain_of(module):
    """Return the longest chain of imports from a module downwards; a cycle would never end."""
    return (module, *max((chain_of(name) for name in imported(module)), key=len, default=()))


def test_no_chain_of_imports_is_longer_than_twelve():
    longest = max((chain_of(module) for module in FILES), key=len)
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

    for module in FILES:
        visit(module)


def for_types_alone(module):
    """Return the modules that are imported under `if TYPE_CHECKING` only."""
    names = set()
    for node in parsed(module).body:
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            names |= {one.module for one in node.body if isinstance(one, ast.ImportFrom)}
    return names


def test_a_modules_name_says_what_it_holds_wherever_it_lies():
    """No two modules have one name, but for the commands, which are named as the user types them."""
    places = {}
    for name in FILES:
        package, _, last = name.rpartition(".")
        if last != "__init__" and package != "kreisel.cli":
            places.setdefault(last, []).append(name)
    assert {last: names for last, names in places.items() if len(names) > 1} == {}


def test_packages_export_nothing():
    """An import names the module it is from; only `kreisel` itself has public names, found when asked for."""
    for name, tree in ((name, parsed(name)) for name in FILES):
        if name.endswith(".__init__") and name not in ("kreisel.__init__", "kreisel.devices.krl.__init__"):
            assert [type(node) for node in tree.body] == [ast.Expr], name


def test_files_and_functions_can_be_read_at_once():
    for file in (SRC / "kreisel").rglob("*.py"):
        assert len(file.read_text(encoding="utf-8").splitlines()) <= MAX_LINES, file.name
    for name, tree in ((name, parsed(name)) for name in FILES):
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                body = node.body[1:] if ast.get_docstring(node) and len(node.body) > 1 else node.body
                lines = body[-1].end_lineno - body[0].lineno + 1
                assert lines <= MAX_BODY, f"{name}.{node.name}: {lines} lines"


def test_nothing_outside_its_room_names_the_filters_passes():
    """Whatever needs a fit asks an estimator: `kalman` is imported where one is chosen, and for figures of its own.

    `inverse` is an estimator that starts from a filter's pass.
    """
    allowed = {"kreisel.calibration.calibrate", "kreisel.calibration.convergence", "kreisel.study.bound"}
    for name in FILES:
        if name.startswith(("kreisel.kalman.", "kreisel.inverse.")):
            continue
        used = {
            module for module in imported(name) if module.startswith("kreisel.kalman.") and "__init__" not in module
        }
        if name in allowed:
            used -= {"kreisel.kalman.kalman_filter", "kreisel.kalman.batch"}
        assert not used, f"{name} imports {', '.join(used)}"


def test_few_functions_take_more_than_six_arguments():
    """Commands take their options; what a program of its own calls is the exception elsewhere."""
    counts = []
    for tree in map(parsed, FILES):
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                names = [one.arg for one in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
                counts.append(len([name for name in names if name not in ("self", "cls")]))
    assert sum(count > 6 for count in counts) <= MANY_ARGUMENTS * len(counts)


THROUGH = {
    "kreisel._version": "tests/system/test_cli.py",
    "kreisel.cli": "tests/system/test_cli.py",  # commands are run as users run them
    "kreisel.exchange": "tests/unit/exchange/test_proofs.py",  # every format, from the registry
    "kreisel.report": "tests/unit/report/test_report.py",  # the page, with all its parts
    "kreisel.validation": "tests/unit/validation/test_checks.py",  # `check_streams` runs all checks
    "kreisel.formats": "tests/unit/formats/test_proposal.py",  # what proposals consist of
    "kreisel.formats.imu_lines": "tests/system/test_handing_on.py",
    "kreisel.formats.kuka_trace_text": "tests/unit/formats/test_kuka_trace.py",
    "kreisel.formats.playback": "tests/system/test_replay.py",
    "kreisel.array": "tests/system/test_tray.py",  # in a process of its own
    "kreisel.dashboard.serving": "tests/system/test_watch.py",  # in a process of its own
    "kreisel.dashboard.message": "tests/system/test_watch.py",  # the type of what is sent
    "kreisel.dashboard.patience": "tests/system/test_watch.py",  # a class of the server's, in a process of its own
    "kreisel.devices": "tests/system/test_record_robots.py",  # over loopback, against the simulators
    "kreisel.acquisition": "tests/system/test_run.py",
    "kreisel.application": "tests/system/test_handing_on.py",
    "kreisel.batch": "tests/system/test_handing_on.py",
    "kreisel.preparation": "tests/unit/preparation/test_build_problem.py",  # steps of `prepare_recording`
    "kreisel.inertial.effect_formulas": "tests/unit/exchange/test_source_code.py",
    "kreisel.fitting.result_change": "tests/unit/refinement/test_attenuation.py",
    "kreisel.fitting.reported_poses": "tests/scenarios/test_filter_agreement.py",
    "kreisel.refinement": "tests/unit/refinement/test_iteration.py",  # steps of `estimate`
    "kreisel.calibration": "tests/unit/calibration/test_verdict.py",
    "kreisel.calibration.sharing": "tests/scenarios/test_joint.py",
    "kreisel.calibration.joint_outcome": "tests/scenarios/test_joint.py",
    "kreisel.calibration.stream_correction": "tests/unit/calibration/test_correct.py",
    "kreisel.calibration.array_checks": "tests/unit/calibration/test_correct.py",
    "kreisel.static.table_errors": "tests/scenarios/test_standstills.py",  # through `calibrate_static`
    "kreisel.station": "tests/system/test_station.py",
    "kreisel.study": "tests/unit/study/test_robustness.py",
    "kreisel.simulation": "tests/system/test_simulate.py",
    "kreisel.synchronization.lost_samples": "tests/unit/synchronization/test_lost_samples.py",
    "kreisel.static.static_parts": "tests/unit/static/test_by_robot.py",
    "kreisel.static.truncation": "tests/unit/static/test_truncation.py",  # of whole calibrations
    "kreisel.markup": "tests/unit/robot/test_description.py",  # what a hostile description is refused by
    "kreisel.kalman.noise_shares": "tests/unit/calibration/test_filter_budget.py",
    "kreisel.refinement.named_terms": "tests/unit/refinement/test_effect_selection.py",
    "kreisel.model.considered_terms": "tests/unit/refinement/test_effect_selection.py",
    "kreisel.progress": "tests/system/test_cli.py",
    "kreisel.protocols.framing": "tests/protocols/test_peers.py",
    "kreisel.recording": "tests/unit/validation/test_checks.py",
    "kreisel.robot.pose_accuracy": "tests/unit/calibration/test_assembly.py",
    "kreisel._kernels.filter": "tests/scenarios/test_filter_agreement.py",
    "kreisel._kernels.recursions": "tests/unit/simulation/test_low_pass.py",
    "kreisel._kernels.rotation_fit": "tests/unit/synchronization/test_rate_fit.py",
}
"""Tests of modules that no test imports by name, by package or module: they are run through what these tests call."""


def test_every_module_is_imported_by_a_test_or_run_through_one():
    tests = SRC.parent / "tests"
    named = set()
    for file in tests.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module:
                named |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    for name in FILES:
        if name in named or name.endswith(".__init__"):
            continue
        entry = max((key for key in THROUGH if name == key or name.startswith(f"{key}.")), key=len, default=None)
        assert entry is not None, f"{name}: no test imports it; write one, or say which runs it"
        assert (SRC.parent / THROUGH[entry]).is_file(), THROUGH[entry]


NEEDS_AN_EXTRA = {
    "kreisel.dashboard.app": "starlette",
    "kreisel.dashboard.patience": "uvicorn",
    "kreisel.dashboard.serving": "uvicorn starlette",
    "kreisel.devices.ros2_types": "cyclonedds",
    "kreisel.report.shown_figure": "matplotlib",
    "kreisel.station.server": "starlette",
}
"""Modules that need a package of an extra when they are imported: whoever needs them imports them where it runs."""


def test_a_plain_installation_has_all_that_modules_import():
    """The tests run with every extra: nothing else would show that a command needs one."""
    project = tomllib.loads((SRC.parent / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    plain = {re.split(r"[^\w.-]", name)[0].lower() for name in project["dependencies"]} | {"jinja2", "markupsafe"}
    known = packages_distributions()
    for name in FILES:
        further = set()
        for node in parsed(name).body:
            modules = [node.module] if isinstance(node, ast.ImportFrom) else []
            modules += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            for top in {module.split(".")[0] for module in modules} - {"kreisel"} - sys.stdlib_module_names:
                if not {one.lower() for one in known.get(top, [top])} & plain:
                    further.add(top)
        assert further == set(NEEDS_AN_EXTRA.get(name, "").split()), f"{name} needs {further}"
