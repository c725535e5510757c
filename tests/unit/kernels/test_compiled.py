"""The compiled library itself: of these sources, both sets of instructions, in threads, with NaN."""

import importlib.util
import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from kreisel._kernels import compiled, filter_arguments, manifold, quadrature, views
from kreisel.errors import LibraryError
from kreisel.kalman.filter_pass import run_filter

from ...small_problem import small_problem

ROOT = Path(__file__).resolve().parents[3]
NUMBERS = """
import numpy as np
from tests.small_problem import plain_run, small_problem
from kreisel._kernels import compiled
run = plain_run()
print(compiled.variant, *run.belief.mean, *run.belief.standard_deviation)
"""


def build_script():
    spec = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    build = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(build)
    return build


def test_a_library_that_is_older_than_its_sources_is_refused(tmp_path):
    build = build_script()
    built = build.source_hash(ROOT)
    compiled.check_sources(built, ROOT / "src" / "kernels")
    compiled.check_sources(built, tmp_path)  # an installed package has no sources
    shutil.copytree(ROOT / "src" / "kernels", tmp_path / "kernels")
    with (tmp_path / "kernels" / "filter_arguments.hpp").open("a") as file:
        file.write("\n")
    with pytest.raises(LibraryError, match=f"older than its sources: it was compiled from {built}"):
        compiled.check_sources(built, tmp_path / "kernels")


def test_an_installation_compiles_only_what_has_changed(tmp_path, monkeypatch):
    build, count = build_script(), 0
    sources, library = tmp_path / "src" / "kernels", tmp_path / build.PACKAGE / build.this_machine().file
    shutil.copytree(ROOT / "src" / "kernels", sources)
    shutil.copy(ROOT / "hatch_build.py", tmp_path)

    def compiles(root, out, target):
        nonlocal count
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text("a library")
        count += 1

    monkeypatch.setattr(build, "compile_library", compiles)
    hook = build.LibraryHook(str(tmp_path), {}, None, None, str(tmp_path), "wheel")

    def compiled_by(change):
        change()
        before, data = count, {"force_include": {}}
        hook.initialize("standard", data)
        assert data["force_include"] == {str(library): f"kreisel/_kernels/{library.name}"}
        return count > before

    assert compiled_by(lambda: None)
    assert not compiled_by(lambda: None)
    assert compiled_by(lambda: (sources / "choose.cpp").write_text("// another"))
    assert compiled_by(lambda: library.write_text("a library that is another"))
    assert compiled_by(library.unlink)
    assert compiled_by(lambda: (tmp_path / "hatch_build.py").write_text("# other flags"))
    assert compiled_by(lambda: monkeypatch.setattr(build, "native_compiler", lambda: ["another"]))
    assert not compiled_by(lambda: None)


def swapped(kind, a, b):
    """A named tuple with two fields exchanged, as an edit of Python alone would do."""
    hints, names = kind.__annotations__, list(kind._fields)
    i, j = names.index(a), names.index(b)
    names[i], names[j] = b, a
    made = renamed(kind.__name__, **{name: hints[name] for name in names})
    made.__module__ = kind.__module__
    return made


def renamed(name, **fields):
    return NamedTuple(name, list(fields.items()))


@pytest.mark.parametrize(
    ("kind", "a", "b"),
    [
        (filter_arguments.Model, "standstill", "coloured"),
        (filter_arguments.Record, "nis", "log_likelihood"),
        (filter_arguments.Steps, "first", "last"),
    ],
)
def test_fields_that_changed_places_on_one_side_are_refused(kind, a, b):
    with pytest.raises(LibraryError, match=rf"{kind.__name__} has {a} \d+ \w+, expected {b} \d+ \w+"):
        compiled.function("run", views.Pointer(swapped(kind, a, b)))


def test_a_field_more_or_of_another_type_is_refused():
    more = renamed("Gaussian", mean=views.Numbers, upper=views.Table, size=int)
    with pytest.raises(LibraryError, match="Gaussian has nothing, expected size 40 Index"):
        compiled.function("run", views.Pointer(more))
    other = renamed("Gate", bounds=views.Numbers, most=float, rejected=views.Indices)
    with pytest.raises(LibraryError, match="Gate has most 16 Index, expected most 16 double"):
        compiled.function("run", views.Pointer(other))


def test_another_number_than_the_library_is_made_for_is_refused():
    with pytest.raises(LibraryError, match="it is made for 9 measured, expected 8"):
        compiled.check_count("measured", 8)


def test_an_order_that_does_not_fit_is_refused():
    places = dict(filter_arguments.AROUND)
    compiled.check_order("Around", places)
    with pytest.raises(LibraryError, match="Around has time_offset at 7, expected place 6"):
        compiled.check_order("Around", places | {"time_offset": 6, "gravity": 6})
    del places["gravity"]
    with pytest.raises(LibraryError, match="Around has gravity at 6, expected nothing of this name"):
        compiled.check_order("Around", places)


def numbers_of(variant):
    environment = os.environ | {"KREISEL_INSTRUCTIONS": variant}
    command = [sys.executable, "-c", NUMBERS]
    ended = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True)
    used, *numbers = ended.stdout.split()
    assert used == variant
    return np.array(numbers, dtype=float)


@pytest.mark.skipif(compiled.variant != "avx2", reason="this processor has one set of instructions")
def test_both_sets_of_instructions_give_the_same_result():
    plain, fast = (numbers_of(variant) for variant in ("baseline", "avx2"))
    layout = small_problem().layout
    x, deviation = plain[: layout.size], plain[layout.size :]
    np.testing.assert_allclose(fast[layout.size :], deviation, rtol=1e-7)
    assert np.all(np.abs(layout.minus(fast[: layout.size, None], x)[:, 0]) < 1e-6 * deviation)


def test_an_unknown_set_of_instructions_is_refused():
    command = [sys.executable, "-m", "kreisel.cli.main", "info", "nothing"]
    environment = os.environ | {"KREISEL_INSTRUCTIONS": "avx9"}
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert ended.returncode == 1
    assert "KREISEL_INSTRUCTIONS is 'avx9'; this processor has" in ended.stderr


def test_runs_in_two_threads_are_those_of_one():
    problem = small_problem()
    alone = run_filter(problem, problem.prior.start)
    with ThreadPoolExecutor(2) as pool:
        runs = list(pool.map(lambda _: run_filter(problem, problem.prior.start), range(4)))
    for run in runs:
        np.testing.assert_array_equal(run.belief.factor, alone.belief.factor)
        np.testing.assert_array_equal(run.history.whitened, alone.history.whitened)


@pytest.mark.parametrize(
    "array",
    [np.zeros(3, dtype=np.float32), np.zeros((3, 3)), np.zeros(6)[::2], np.zeros(3, dtype=np.int64)],
)
def test_an_array_of_another_form_is_refused(array):
    with pytest.raises(TypeError, match="expected float64"):
        views.NumbersView.from_param(array)


def test_indices_and_lengths_that_do_not_fit_are_refused():
    t, values, out = np.arange(4.0), np.zeros((4, 3)), np.zeros((1, 3))
    with pytest.raises(ValueError, match="before from 3 to 3; expected 0 to 2"):
        quadrature.double_integral(t, values, np.array([3]), np.zeros(1), out)
    with pytest.raises(ValueError, match="out has the shape"):
        quadrature.double_integral(t, values, np.array([0]), np.zeros(1), out[:, :2].copy())


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e308])
def test_numbers_that_are_none_come_out_as_such(bad):
    table = np.array([[0, 3, 0, 0], [3, 3, 3, 1]])
    x = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    moved = manifold.plus(table, x, np.full((6, 5), bad))
    assert moved.shape == (7, 5)
    back = manifold.minus(table, moved, x, 6)
    assert not np.isfinite(back).all() or bad == 1e308
