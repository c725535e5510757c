"""Documentation that runs, and commands that are documented."""

import ast
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


def test_commands_in_the_docs_have_the_options_they_are_given():
    import click
    from typer.main import get_command

    from kreisel.cli.main import app

    root = get_command(app)
    lines = [
        line
        for page in [*PAGES, DOCS.parent / "README.md"]
        for block in re.findall(r"```sh\n(.*?)```", page.read_text(encoding="utf-8"), re.S)
        for line in block.replace("\\\n", " ").splitlines()
    ]
    commands = [match for line in lines for match in re.findall(r"(?:^|\| )kreisel ([^|#>]*)", line)]
    assert len(commands) > 50
    for text in commands:
        words = text.split()
        command = root.get_command(click.Context(root), words[0])
        assert command is not None, text
        if hasattr(command, "get_command"):
            command = command.get_command(click.Context(command), words[1])
        known = {name for parameter in command.params for name in (*parameter.opts, *parameter.secondary_opts)}
        for word in words[1:]:
            if word.startswith("-") and len(word) > 1:
                assert word.partition("=")[0] in {*known, "--help", "--version"}, f"{word} in: kreisel {text}"


def test_the_messages_of_troubleshooting_are_those_of_the_program():
    """Texts of the program, with its values left out, contain every message that the page lists."""
    texts = []
    for path in (DOCS.parent / "src" / "kreisel").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.JoinedStr):
                texts.append("".join(part.value if isinstance(part, ast.Constant) else "\0" for part in node.values))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                texts.append(node.value)
    program = "\n".join(texts)
    page = (DOCS / "reference" / "troubleshooting.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([^`]+)`(?: … `([^`]+)`)?", page, re.M)
    assert len(rows) > 30
    for message in (part for row in rows for part in row if part):
        assert message in program, message


def test_the_table_of_grades_is_true():
    from kreisel.calibration.limits import limits_of_grade
    from kreisel.inertial.noise_figures import GRADES
    from kreisel.units import DEG_PER_ROOT_HOUR, MG

    page = (DOCS / "reference" / "grades.md").read_text(encoding="utf-8")
    rows = {row[0]: row[1:] for row in re.findall(r"^\| `([\w-]+)` \|" + r" ([\d.]+) \|" * 7, page, re.M)}
    assert rows.keys() == GRADES.keys()
    for name, grade in GRADES.items():
        limits = {key: values[0] for key, values in limits_of_grade(name).values.items()}
        want = [
            grade.gyro_noise_density / DEG_PER_ROOT_HOUR, grade.accel_noise_density / MG, limits["gyro_bias_deg_h"],
            limits["accel_bias_mg"], limits["gyro_scale_error_ppm"], limits["accel_scale_error_ppm"],
            limits["gyro_non_orthogonality_mrad"],
        ]  # fmt: skip
        assert [float(x) for x in rows[name]] == pytest.approx(want, rel=5e-3)


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
    assert numbers == [int(n) for n in re.findall(r"\\tag\{(\d+)\}", text)] == list(range(1, len(numbers) + 1))
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
    """`make site` runs this for all packages; names on the first page have signatures, though imported late."""
    script = DOCS.parent / "design" / "api_pages.py"
    subprocess.run([sys.executable, script, tmp_path, "model.problem"], check=True, capture_output=True)
    page = (tmp_path / "kreisel" / "model" / "problem.html").read_text(encoding="utf-8")
    assert "Everything a filter run needs" in page
    front = (tmp_path / "kreisel.html").read_text(encoding="utf-8")
    for text in (
        "scalar first; may be left out if there are positions",
        "Return the calibration of a recording",
        "size_effect",
    ):
        assert text in front


def test_the_citation_names_the_version_and_the_paper():
    from ruamel.yaml import YAML

    from kreisel import __version__

    found = YAML(typ="safe").load((DOCS.parent / "CITATION.cff").read_text(encoding="utf-8"))
    assert found["version"] == __version__
    assert found["date-released"].isoformat() >= "2026-11-22"
    assert found["references"][0]["year"] == 2005
