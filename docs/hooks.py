"""What the site has beyond its pages: generated pages, tables from data files, typeset equations."""

from __future__ import annotations

import csv
import os
import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from markdown import Markdown
from markdown.extensions import Extension
from markdown.inlinepatterns import InlineProcessor
from markdown.preprocessors import Preprocessor
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


# Tables from data files

TABLE = re.compile(r"^<!-- table: (data/[\w-]+\.csv) -->\n.*\n", re.M)
"""A marker, and the line after it: a link for readers of the source, which the table replaces."""


def on_page_markdown(markdown: str, config: Any, **_: Any) -> str:
    """Put tables in the place of their markers."""
    return TABLE.sub(lambda marker: table(Path(config.docs_dir) / marker[1]) + "\n", markdown)


def table(path: Path) -> str:
    """Return a CSV file as a table in Markdown."""
    with path.open(encoding="utf-8", newline="") as stream:
        header, *rows = csv.reader(stream)
    lines = [header, ["---"] * len(header), *rows]
    return "".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |\n" for line in lines)


# Equations, as MathML


def on_config(config: Any, **_: Any) -> Any:
    """Add the extension for equations."""
    config.markdown_extensions.append(Equations())
    return config


class Equations(Extension):
    """LaTeX between dollar signs as MathML: inline, and in blocks that begin with two dollar signs."""

    def extendMarkdown(self, md: Markdown) -> None:
        """Register after fenced blocks and code spans, whose dollar signs stay."""
        md.preprocessors.register(_Blocks(md), "equations", 15)
        md.inlinePatterns.register(_Inline(r"\$(?=[^\s$])([^$\n]*[^\s$])\$(?!\w)([,.;:)]?)", md), "formulas", 185)


class _Blocks(Preprocessor):
    def run(self, lines: list[str]) -> list[str]:
        text = re.sub(r"^\$\$(.+?)\$\$$", lambda match: self._typeset(match[1]), "\n".join(lines), flags=re.M | re.S)
        return text.split("\n")

    def _typeset(self, latex: str) -> str:
        tag = re.search(r"\\tag\{(\d+)\}", latex)
        formula = convert(latex.replace(tag[0], "") if tag else latex, display="block")
        name, number = (f' id="equation-{tag[1]}"', f'<span class="number">({tag[1]})</span>') if tag else ("", "")
        block = f'<div class="equation"{name}><div class="formula">{formula}</div>{number}</div>'
        return f"\n{self.md.htmlStash.store(block)}\n"


class _Inline(InlineProcessor):
    def handleMatch(self, m: re.Match[str], data: str) -> tuple[str, int, int]:  # noqa: ARG002
        return self.md.htmlStash.store(f'<span class="formula">{convert(m[1])}{m[2]}</span>'), m.start(0), m.end(0)
