"""What the site has beyond its pages: generated pages, notebooks, tables and figures from data files, equations."""

from __future__ import annotations

import base64
import csv
import json
import math
import os
import re
from html import escape
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

PICTURES = Path("build/pictures")
"""Pictures that `make site` drew: those of the tour, of explanations, and of the gallery's pages."""

NOTEBOOKS = Path("build/notebooks")
"""Notebooks that `make site` executed; pages of others have no results."""


def on_files(files: Files, config: Any, **_: Any) -> Files:
    """Add what is generated."""
    files.append(File.generated(config, "reference/options.md", content=options()))
    for folder, target in ((GALLERY, "gallery"), (API, "api"), (PICTURES, "pictures")):
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                name = f"{target}/{path.relative_to(folder).as_posix()}"
                files.append(File.generated(config, name, abs_src_path=str(path.resolve())))
    for path in sorted((Path(config.docs_dir) / "notebooks").glob("*.ipynb")):
        executed = NOTEBOOKS / path.name
        notebook = json.loads((executed if executed.is_file() else path).read_text(encoding="utf-8"))
        page, pictures = notebook_page(notebook, path.stem)
        for name, content in {f"{path.stem}.md": page, **pictures}.items():
            files.append(File.generated(config, f"notebooks/{name}", content=content))
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


# Notebooks


def notebook_page(notebook: dict[str, Any], name: str) -> tuple[str, dict[str, bytes]]:
    """Return a notebook as a page in Markdown, and its pictures by the names of their files.

    A picture is described by `alt` in the metadata of its cell.
    """
    out, pictures = [], {}
    for cell in notebook["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            out.append(source)
            continue
        out.append(f"```python\n{source}\n```")
        for output in _joined(cell["outputs"]):
            if png := output.get("data", {}).get("image/png"):
                file = f"{name}-{len(pictures) + 1}.png"
                pictures[file] = base64.b64decode(png)
                width = output["metadata"]["image/png"]["width"]
                alt = escape(cell["metadata"]["alt"])
                out.append(f'<img src="{file}" alt="{alt}" width="{width}" loading="lazy">')
            else:
                out.append(_result(output))
    title, _, rest = out[0].partition("\n")
    link = f'<a href="{name}.ipynb" download>Download this page as a notebook</a>'
    return "\n\n".join([title, link, rest.strip(), *out[1:]]) + "\n", pictures


def _joined(outputs: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return outputs with texts that follow each other made one."""
    out: list[dict[str, Any]] = []
    for output in outputs:
        if out and "text" in output and "text" in out[-1]:
            out[-1] = {**output, "text": [*out[-1]["text"], *output["text"]]}
        else:
            out.append(output)
    return out


def _result(output: dict[str, Any]) -> str:
    """Return what a cell printed, or its last value."""
    data = output.get("data", {})
    if html := data.get("text/html"):
        return f'<div class="result">{"".join(html)}</div>'
    return f"```text\n{''.join(output.get('text') or data['text/plain']).rstrip()}\n```"


# Tables from data files

TABLE = re.compile(r"^<!-- table: (data/[\w-]+\.csv) -->\n.*\n", re.M)
"""A marker, and the line after it: a link for readers of the source, which the table replaces."""


FIGURE = re.compile(r"^<!-- figure: (data/[\w-]+\.csv) \| (.+?) \| (.+?)(?: \| without (.+))? -->$", re.M)
"""A marker: the file, the unit of the axis, columns NAME or NAME +- NAME of deviations, separated by semicolons, and a
word whose rows are left out."""


PICTURE = re.compile(r"^<!-- picture: ([\w-]+\.(?:svg|png)) \| (.+?)(?: \| (.+?))? -->$", re.M)
"""A marker: the file below pictures/, what it shows in words, and a page that it leads to."""


def picture(name: str, alt: str, link: str | None, page: str) -> str:
    """Return a picture with its words as caption; a page without it keeps the words."""
    up = "../" * page.count("/")
    image = f'<img src="{up}pictures/{name}" alt="{escape(alt)}" loading="lazy">' if (PICTURES / name).is_file() else ""
    caption = escape(alt)
    if link is not None:
        image, caption = f'<a href="{link}" aria-label="{caption}">{image}</a>', f'<a href="{link}">{caption}</a>'
    return f'<figure class="picture">{image}<figcaption>{caption}</figcaption></figure>\n'


def on_page_markdown(markdown: str, config: Any, page: Any, **_: Any) -> str:
    """Put tables, figures and pictures in the place of their markers; let links to notebooks lead to their pages."""
    folder = Path(config.docs_dir)
    markdown = PICTURE.sub(lambda m: picture(m[1], m[2], m[3], page.file.src_uri), markdown)
    markdown = re.sub(r"(\]\([\w./-]+)\.ipynb\)", r"\1.md)", markdown)
    markdown = FIGURE.sub(lambda m: figure(folder / m[1], m[2], m[3].split("; "), m[4]), markdown)
    return TABLE.sub(lambda marker: table(folder / marker[1]) + "\n", markdown)


def table(path: Path) -> str:
    """Return a CSV file as a table in Markdown."""
    with path.open(encoding="utf-8", newline="") as stream:
        header, *rows = csv.reader(stream)
    lines = [header, ["---"] * len(header), *rows]
    return "".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |\n" for line in lines)


# Figures from data files

COLOURS = ("#0b62a4", "#d1510a", "#2a8a3e")
"""As in the report: blue, orange, green."""

LEFT, RIGHT, TOP, BOTTOM, STEP = 130, 170, 16, 130, 52
"""px; margins of a figure, and what a row of the data has."""


def figure(path: Path, unit: str, columns: list[str], without: str | None = None) -> str:
    """Return points with bars of one deviation, a row of a CSV file beside another, as SVG."""
    with path.open(encoding="utf-8", newline="") as stream:
        rows = [row for row in csv.DictReader(stream) if without is None or without not in next(iter(row.values()))]
    name = next(iter(rows[0]))
    pairs = [column.split(" +- ") for column in columns]
    rows = [row for row in rows if any(row[pair[0]] for pair in pairs)]
    ends = [
        float(row[pair[0]]) + sign * (float(row[pair[1]]) if len(pair) > 1 else 0.0)
        for row in rows for pair in pairs if row[pair[0]] for sign in (-1.0, 1.0)
    ]  # fmt: skip
    step = 10.0 ** math.floor(math.log10(max(ends) - min(min(ends), 0.0)))
    step *= 0.5 if (max(ends) - min(ends)) / step < 4.0 else 1.0
    low, high = step * math.floor(min(*ends, 0.0) / step), step * math.ceil(max(ends) / step)
    width, height = LEFT + STEP * len(rows) + RIGHT, TOP + 220 + BOTTOM

    def at(value: float) -> float:
        return TOP + 220.0 * (high - value) / (high - low)

    out = [f'<svg class="figure" viewBox="0 0 {width} {height}" role="img" style="max-width: {width}px">']
    for k in range(round((high - low) / step) + 1):
        value, right = low + k * step, LEFT + STEP * len(rows)
        out.append(f'<path d="M{LEFT} {at(value):.1f}H{right}" stroke="currentColor" stroke-opacity="0.2"/>')
        out.append(f'<text x="{LEFT - 6}" y="{at(value) + 4:.1f}" text-anchor="end">{value:g}</text>')
    out.append(f'<text transform="translate(14 {TOP + 110}) rotate(-90)" text-anchor="middle">{escape(unit)}</text>')
    for i, row in enumerate(rows):
        middle = LEFT + STEP * (i + 0.5)
        out.append(f'<text transform="translate({middle:.0f} {TOP + 236}) rotate(-35)" text-anchor="end">'
                   f"{escape(row[name])}</text>")  # fmt: skip
        for k, pair in enumerate(pairs):
            if not row[pair[0]]:
                continue
            x, value = middle + 9.0 * (k - 0.5 * (len(pairs) - 1)), float(row[pair[0]])
            if len(pair) > 1:
                sd = float(row[pair[1]])
                out.append(f'<path d="M{x:.1f} {at(value - sd):.1f}V{at(value + sd):.1f}" stroke="{COLOURS[k]}"/>')
            out.append(f'<circle cx="{x:.1f}" cy="{at(value):.1f}" r="3.5" fill="{COLOURS[k]}"/>')
    for k, pair in enumerate(pairs):
        x, y = LEFT + STEP * len(rows) + 14, TOP + 12 + 20 * k
        out.append(f'<circle cx="{x}" cy="{y - 4}" r="4" fill="{COLOURS[k]}"/>')
        out.append(f'<text x="{x + 10}" y="{y}">{escape(pair[0].partition(" (")[0])}</text>')
    return "".join(out) + "</svg>\n"


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
