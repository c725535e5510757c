"""The line and the examples of each command: all have them, they fit a terminal, and their options exist."""

import runpy
import shlex
from pathlib import Path

import pytest
from typer.main import get_command

from kreisel.cli.command_help import COMMANDS, START
from kreisel.cli.main import app

ROOT = Path(__file__).resolve().parents[3]


def commands():
    """Return all commands by their names."""
    found = {}
    for name, command in get_command(app).commands.items():
        found[name] = command
        found |= {f"{name} {own}": one for own, one in getattr(command, "commands", {}).items()}
    return found


def lines_of(examples):
    """Return whole command lines as words, without what a shell takes for itself."""
    for line in "\n".join(examples).replace("\\\n", " ").splitlines():
        words = shlex.split(line, comments=True)
        yield words[: words.index(">")] if ">" in words else words


def test_every_command_has_a_line_and_an_example():
    """What is said of no command is a mistake, too."""
    known = commands()
    assert COMMANDS.keys() == known.keys()
    for name, said in COMMANDS.items():
        assert known[name].get_short_help_str(200) == said.summary or name == "study", name
        assert said.examples or name == "study", name


@pytest.mark.parametrize("name", [name for name in COMMANDS if name != "study"])
def test_examples_are_in_the_help_and_can_be_parsed(name):
    """Each is a line of this command with options that exist, with values that they take, and nothing missing."""
    command, said = commands()[name], COMMANDS[name]
    shown = command.get_help(command.context_class(command, info_name=name))
    assert all(f"    {line}\n" in shown + "\n" for line in said.examples)
    for words in lines_of(said.examples):
        own = len(name.split())
        assert words[: 1 + own] == ["kreisel", *name.split()]
        command.make_context(name, words[1 + own :])


def test_the_examples_of_the_program_are_those_of_its_commands():
    for words in lines_of(START):
        commands()[words[1]].make_context(words[1], words[2:])


def test_lists_and_examples_fit_a_terminal():
    for name, said in COMMANDS.items():
        assert len(said.summary) <= 62, name
        assert all(len(line) <= 76 for line in said.examples), name


def test_the_manual_is_made_anew():
    """`python design/man_page.py` writes it."""
    text = (ROOT / "share" / "kreisel.1").read_text(encoding="utf-8")
    assert runpy.run_path(str(ROOT / "design" / "man_page.py"))["page"](text) == text
