"""Pictures of the gallery's pages, by a headless Chromium: python design/gallery_pictures.py GALLERY PICTURES.

Without a Chromium nothing is written, and the gallery is a list of links.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

PAGES = {
    "devices": "demo/report.html",
    "report": "demo/iNAV-FMS/result/report.html",
    "certificate": "certificate.html",
    "kalibrierschein": "kalibrierschein.html",
    "batch": "batch/batch.html",
    "static": "static/report.html",
    "compare": "compare/comparison.html",
}
"""Names of pictures, and the pages below the gallery."""

WIDTH, HEIGHT, SETTLE = 1200, 800, 500
"""px, and ms for the figures to be drawn."""


def main(gallery: Path, pictures: Path) -> None:
    """Write a picture of the beginning of every page that is there."""
    found = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if found is None:
        print("no Chromium: the gallery has no pictures")
        return
    from playwright.sync_api import sync_playwright

    pictures.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=found, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT}, color_scheme="light")
        for name, path in PAGES.items():
            if (gallery / path).is_file():
                page.goto((gallery / path).resolve().as_uri())
                page.wait_for_timeout(SETTLE)
                page.screenshot(path=pictures / f"gallery-{name}.png")
        browser.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
