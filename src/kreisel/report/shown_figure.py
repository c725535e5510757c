"""A figure that notebooks show by themselves, and that nothing keeps when it is no longer used."""

from __future__ import annotations

from io import BytesIO

from matplotlib.figure import Figure

_DOTS = 110
"""Per inch, of the picture in a notebook."""


class ShownFigure(Figure):
    """A figure outside pyplot: a notebook shows it where it is a cell's last value; no list of open figures grows."""

    def _repr_png_(self) -> bytes:
        """Return the picture for a notebook."""
        out = BytesIO()
        self.savefig(out, format="png", dpi=_DOTS)
        return out.getvalue()
