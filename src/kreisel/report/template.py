"""Rendering of templates, with the figures drawn on the page."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from kreisel._version import __version__
from kreisel.report.plots import PALETTES, Figure


def fill(template: str, drawn: Sequence[Figure], **values: Any) -> str:
    """Return a page made of a template that extends `page.html`, with the figures drawn on it."""
    environment = Environment(
        loader=PackageLoader("kreisel.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(
        version=__version__,
        plotlyjs=Markup(get_plotlyjs()),  # plotly's own script, not data
        drawings=_script({f.name: f.plot for f in drawn}),
        palettes=_script(PALETTES),
        **values,
    )


def _script(content: object) -> Markup:
    """Return JSON for use within a script: nothing in it can end the script or begin a comment."""
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    return Markup(text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026"))
