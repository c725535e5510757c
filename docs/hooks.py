"""Pages of the site that a command can write: all options of all commands, and the gallery's files."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

GALLERY = Path("build/gallery")
"""Reports that `make site` made; see the Makefile."""

API = Path("build/api")


def on_files(files: Files, config: Any, **_: Any) -> Files:
    """Add what is generated."""
    files.append(File.generated(config, "reference/options.md", content=options()))
    for folder, target in ((GALLERY, "gallery"), (API, "api")):
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                name = f"{target}/{path.relative_to(folder).as_posix()}"
                files.append(File.generated(config, name, abs_src_path=str(path.resolve())))
    return files


def options() -> str:
    """Return the page of all commands with their options, as their `--help` prints them."""
    os.environ["COLUMNS"] = "100"
    import click
    from typer.main import get_command

    from kreisel.cli.main import app

    out = ["# All options\n", "As `kreisel COMMAND --help` prints them.\n"]

    def write(command: click.Command, name: str) -> None:
        context = click.Context(command, info_name=name, max_content_width=100)
        if isinstance(command, click.Group) or hasattr(command, "list_commands"):
            for own in command.list_commands(context):  # type: ignore[attr-defined]
                write(command.get_command(context, own), f"{name} {own}")  # type: ignore[attr-defined]
            return
        out.append(f"## {name}\n\n```text\n{command.get_help(context).strip()}\n```\n")

    write(get_command(app), "kreisel")
    return "\n".join(out)
