"""The pages of the API reference: `python design/api_pages.py FOLDER [PACKAGE…]`.

The public names of `kreisel` are imported when they are asked for; here they are, so that their pages have signatures,
shapes and text.
"""

from __future__ import annotations

import re
import sys
import warnings
from pathlib import Path

import numpy.typing
import pdoc
import pdoc.render


class ArrayLike:
    """What numpy takes for an array: its own definition fills a page."""

    __module__ = "numpy.typing"


numpy.typing.ArrayLike = ArrayLike  # type: ignore[assignment]

import kreisel  # noqa: E402 - after the name above


def write(folder: Path, *only: str) -> None:
    """Write the pages of all packages into a folder, or of some only."""
    for name in kreisel.__all__:
        setattr(kreisel, name, getattr(kreisel, name))
    root = Path(kreisel.__file__).parent
    packages = sorted(path.parent.name for path in root.glob("*/__init__.py") if path.parent.name != "_kernels")
    pdoc.render.configure(docformat="numpy", template_directory=Path(__file__).with_name("api_templates"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of names that are imported for types alone
        names = ("kreisel", *(f"kreisel.{name}" for name in only or packages))
        pdoc.pdoc(*names, output_directory=folder)
    for page in folder.rglob("*.html"):
        page.write_text(accessible(page.read_text(encoding="utf-8")), encoding="utf-8")


def accessible(text: str) -> str:
    """Return a page whose links have names, and whose signatures that scroll take the focus."""
    text = re.sub(
        r'<a class="headerlink" href="#([^"]+)">', r'<a class="headerlink" href="#\1" aria-label="link to \1">', text
    )
    return re.sub(r'<div class="attr (\w+)">', r'<div class="attr \1" tabindex="0">', text)


if __name__ == "__main__":
    write(Path(sys.argv[1]), *sys.argv[2:])
