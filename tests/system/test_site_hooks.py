"""What the site's build makes of pages: formulas, and tables of measurements from docs/data."""

import importlib.util
import re
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("mkdocs")
markdown = pytest.importorskip("markdown")
pytest.importorskip("latex2mathml")

DOCS = Path(__file__).resolve().parents[2] / "docs"
CONFIG = SimpleNamespace(docs_dir=str(DOCS))
PAGE = SimpleNamespace(file=SimpleNamespace(src_uri="how-to/own.md"))


@pytest.fixture(scope="module")
def hooks():
    spec = importlib.util.spec_from_file_location("hooks", DOCS / "hooks.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    "text",
    [
        "the trace ($TRACE) of `$AXIS_ACT` or `$a$`",
        "it costs 5 $ or 6 $",
        "between $a and b$c",
        "```sh\n$ kreisel calibrate run\n$$x$$\n```",
        "    $$x$$",
    ],
)
def test_dollar_signs_that_are_no_formulas_stay(hooks, text):
    page = markdown.markdown(text, extensions=["pymdownx.superfences", hooks.Equations()])
    assert "<math" not in page
    assert re.sub("<.*?>", "", page).count("$") == text.count("$")


def test_formulas_become_mathml(hooks):
    text = "with $K_\\omega$, and\n\n$$x < y_1 * z_1 * u_1 \\tag{7}$$\n\nafter"
    page = markdown.markdown(text, extensions=[hooks.Equations()])
    assert page.count("<math") == 2
    assert "<em>" not in page
    assert '<div class="equation" id="equation-7">' in page
    assert "(7)</span>" in page
    assert "&lt;" in page or "&#x0003C;" in page
    assert "$" not in page


def test_a_notebook_becomes_a_page(hooks):
    png = {"data": {"image/png": "iVBORw0KGgo="}, "metadata": {"image/png": {"width": 640}}}
    notebook = {
        "cells": [
            {"cell_type": "markdown", "source": ["# Title\n", "\n", "text"]},
            {
                "cell_type": "code",
                "source": ["draw()"],
                "metadata": {"alt": 'a "line" < 1'},
                "outputs": [{"text": ["one\n"]}, {"text": ["two\n"]}, png, {"data": {"text/html": ["<b>3</b>"]}}],
            },
        ]
    }
    page, pictures = hooks.notebook_page(notebook, "own")
    assert page.startswith('# Title\n\n<a href="own.ipynb" download>')
    assert page.index("text") < page.index("```python\ndraw()\n```") < page.index("```text\none\ntwo\n```")
    assert '<img src="own-1.png" alt="a &quot;line&quot; &lt; 1" width="640" loading="lazy">' in page
    assert '<div class="result"><b>3</b></div>' in page
    assert pictures == {"own-1.png": b"\x89PNG\r\n\x1a\n"}


def test_a_picture_without_a_description_is_refused(hooks):
    png = {"data": {"image/png": "iVBORw0KGgo="}, "metadata": {"image/png": {"width": 640}}}
    cell = {"cell_type": "code", "source": ["draw()"], "metadata": {}, "outputs": [png]}
    with pytest.raises(KeyError, match="alt"):
        hooks.notebook_page({"cells": [cell]}, "own")


def test_links_to_notebooks_lead_to_their_pages(hooks):
    text = "[own](../notebooks/own-data.ipynb), [other](own.ipynb)"
    assert hooks.on_page_markdown(text, CONFIG, PAGE) == "[own](../notebooks/own-data.md), [other](own.md)"
