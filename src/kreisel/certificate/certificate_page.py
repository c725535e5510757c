"""A certificate as a page: HTML, and PDF of the same page."""

from __future__ import annotations

from kreisel._version import __version__
from kreisel.certificate.content import Certificate
from kreisel.errors import LibraryError

_SIZES = (9.2, 8.6, 8.0, 7.4, 6.8)
"""Sizes of type in points, the first that gives one page is taken."""


def html(certificate: Certificate) -> str:
    """Return the page, complete in one file."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("kreisel.certificate"), autoescape=True, undefined=StrictUndefined, lstrip_blocks=True
    )
    return environment.get_template("certificate.html").render(c=certificate, version=__version__)


def pdf(page: str) -> bytes:
    """Return a page as a PDF file; type is made smaller until it is one page, if that is possible.

    Raises
    ------
    LibraryError
        If weasyprint, or the system's Pango, is missing; the message says what does the same.
    """
    try:
        from weasyprint import CSS, HTML
    except (ImportError, OSError) as error:
        raise LibraryError(
            "a PDF needs weasyprint and the system's Pango: pip install 'kreisel[certificate]', and on Debian apt "
            f"install libpango-1.0-0 libpangoft2-1.0-0; or print the .html in a browser ({str(error)[:60]})"
        ) from error
    for size in _SIZES:
        document = HTML(string=page).render(stylesheets=[CSS(string=f"html {{ font-size: {size}pt !important }}")])
        if len(document.pages) == 1:
            break
    return bytes(document.write_pdf())
