"""The pages of the API reference: `python design/api_pages.py FOLDER`.

The public names of `kreisel` are imported when they are asked for; here they are, so that their pages have signatures,
shapes and text.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy.typing
import pdoc
import pdoc.render


class ArrayLike:
    """What numpy takes for an array: its own definition fills a page."""

    __module__ = "numpy.typing"


numpy.typing.ArrayLike = ArrayLike  # type: ignore[assignment]

import kreisel  # noqa: E402 - after the name above


def write(folder: Path) -> None:
    """Write the pages of all packages into a folder."""
    for name in kreisel.__all__:
        setattr(kreisel, name, getattr(kreisel, name))
    root = Path(kreisel.__file__).parent
    packages = sorted(path.parent.name for path in root.glob("*/__init__.py") if path.parent.name != "_kernels")
    pdoc.render.configure(docformat="numpy")
    pdoc.pdoc("kreisel", *(f"kreisel.{name}" for name in packages), output_directory=folder)


if __name__ == "__main__":
    write(Path(sys.argv[1]))
