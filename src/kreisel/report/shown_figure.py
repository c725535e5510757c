"""A figure that notebooks show by themselves, and that nothing keeps when it is no longer used."""

from __future__ import annotations

from io import BytesIO

from matplotlib.figure import Figure

_DOTS, _FINE = 100, 2
"""Pixels per inch of a page, and dots per such a pixel, so that the picture is sharp on fine screens, too."""


class ShownFigure(Figure):
    """A figure outside pyplot: a notebook shows it where it is a cell's last value; no list of open figures grows."""

    def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
        """Return the picture for a notebook, and its size on the page."""
        out = BytesIO()
        self.savefig(out, format="png", dpi=_FINE * _DOTS)
        width, height = (round(_DOTS * float(inches)) for inches in self.get_size_inches())
        return out.getvalue(), {"width": width, "height": height}
