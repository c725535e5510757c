"""Documentation that runs, and commands that are documented."""

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
BLOCKS = [
    pytest.param(block, id=f"{page.relative_to(DOCS)}:{i}")
    for page in PAGES
    for i, block in enumerate(re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.S))
]


@pytest.mark.parametrize("block", BLOCKS)
def test_code_blocks_run(block, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(compile(block, "docs", "exec"), {})


def test_every_command_has_help_and_documentation():
    from kreisel.cli.main import app

    text = (DOCS / "reference" / "commands.md").read_text(encoding="utf-8")
    for command in app.registered_commands:
        assert command.callback.__doc__, command.name
        assert f"## kreisel {command.name}" in text
    for group in app.registered_groups:
        for command in group.typer_instance.registered_commands:
            assert command.callback.__doc__, command.name
            assert f"`kreisel {group.name} {command.callback.__name__}" in text


def test_every_group_is_documented():
    from kreisel.model.parameters import GROUPS

    text = (DOCS / "reference" / "commands.md").read_text(encoding="utf-8")
    assert all(group in text for group in GROUPS)


def test_links_lead_somewhere():
    for page in [*PAGES, DOCS.parent / "README.md"]:
        for target in re.findall(r"\]\(([^)#]+)\)", page.read_text(encoding="utf-8")):
            assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_the_table_of_equations_is_true():
    """Every equation has its row; what computes and what checks it is there."""
    text = (DOCS / "explanation" / "model.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| ((?:\(\d+\)(?:, )?)+) \| (.*?) \| (.*?) \|$", text, re.M)
    numbers = [int(n) for row in rows for n in re.findall(r"\d+", row[0])]
    assert sorted(numbers) == sorted(set(map(int, re.findall(r"\((\d+)\)", text.partition("## Where each")[0]))))
    for equations, computed, checked in rows:
        sources = ""
        for path in re.findall(r"`(kreisel[\w.]+)`", computed):
            assert resolved(path) is not None, path
            sources += source_of(path)
        for path, name in re.findall(r"`(src/kernels/\w+\.hpp): (\w+)`", computed):
            source = (DOCS.parent / path).read_text(encoding="utf-8")
            assert re.search(rf"^inline [^\n]*\b{name}\(", source, re.M), f"{path} has no {name}"
            sources += source
        assert sources
        for number in re.findall(r"\(\d+\)", equations):
            assert re.search(rf"equations? [^\n]*{re.escape(number)}", sources), f"{number} does not stand at its line"
        for path in re.findall(r"`(tests/[\w/.]+)`", checked):
            assert (DOCS.parent / path).is_file(), path


def source_of(path):
    """Return the text of the module a dotted path leads into."""
    while path not in sys.modules:
        path = path.rpartition(".")[0]
    return Path(sys.modules[path].__file__).read_text(encoding="utf-8")


def resolved(path):
    """Return what a dotted path names: a module's function, or a class's method."""
    parts = path.split(".")
    for split in range(len(parts) - 1, 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:split]))
        except ModuleNotFoundError:
            continue
        for name in parts[split:]:
            found = getattr(found, name)
        return found
    return None


def test_help_answers_without_the_mathematics():
    """No import of NumPy or numba for --help: that keeps it below 0.3 s."""
    code = "import sys; sys.argv=['kreisel','--help']\nfrom kreisel.cli.main import run\n"
    code += "try:\n run()\nexcept SystemExit: pass\n"
    code += "assert not {'numpy','numba','scipy','jinja2'} & set(sys.modules), 'heavy imports'"
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


def test_the_reference_is_made_from_docstrings(tmp_path):
    """`make docs` does the same for all packages."""
    command = [
        sys.executable,
        "-m",
        "pdoc",
        "--docformat",
        "numpy",
        "--output-directory",
        str(tmp_path),
        "kreisel.model",
    ]
    subprocess.run(command, check=True, capture_output=True)
    page = (tmp_path / "kreisel" / "model" / "problem.html").read_text(encoding="utf-8")
    assert "Everything a filter run needs" in page
