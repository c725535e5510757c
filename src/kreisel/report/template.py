"""Rendering of templates, with the figures drawn on the page."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemBytecodeCache, PackageLoader, StrictUndefined
from jinja2.bccache import Bucket
from markupsafe import Markup

from kreisel._version import __version__
from kreisel.errors import LibraryError
from kreisel.report.plots import PALETTES, Figure


class _Compiled(FileSystemBytecodeCache):
    """Templates compiled beside Python's own bytecode, where that may be written: they take a twentieth of a second."""

    def __init__(self) -> None:
        super().__init__(str(Path(__file__).with_name("__pycache__")))

    def dump_bytecode(self, bucket: Bucket) -> None:
        """Keep a template."""
        with suppress(OSError):
            if not sys.dont_write_bytecode:
                super().dump_bytecode(bucket)


def fill(template: str, drawn: Sequence[Figure], **values: Any) -> str:
    """Return a page made of a template that extends `page.html`, with the figures drawn on it."""
    environment = Environment(
        loader=PackageLoader("kreisel.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        bytecode_cache=_Compiled(),
    )
    return environment.get_template(template).render(
        version=__version__,
        plots_script=Markup(library("uPlot.iife.min.js")),  # uPlot's own text, not data
        plots_style=Markup(library("uPlot.min.css")),
        drawings=_script({f.name: f.plot for f in drawn}),
        palettes=_script(PALETTES),
        **values,
    )


def library(name: str) -> str:
    """Return a file of uPlot, which draws plots in a browser.

    Raises
    ------
    LibraryError
        If it is missing.
    """
    path = Path(__file__).with_name("uplot") / name
    if not path.is_file():
        raise LibraryError(f"a part of the package is missing: {path}; install kreisel again")
    return path.read_text(encoding="utf-8")


def _script(content: object) -> Markup:
    """Return JSON for use within a script: nothing in it can end the script or begin a comment."""
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    return Markup(text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026"))
