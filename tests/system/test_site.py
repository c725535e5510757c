"""The documentation site: it builds strictly, asks no other host for anything, and reads on wide and narrow screens."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    pytest.importorskip("mkdocs")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--site-dir", str(folder)]
    done = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    )
    assert done.returncode == 0, done.stderr
    return folder


def test_every_page_is_there_and_loads_nothing_from_other_hosts(site):
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 45
    assert (site / "reference" / "options.html").read_text().count("Usage: kreisel") >= 20
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert not re.search(r'<(script|img|iframe)[^>]* src="https?:', text), page.name
        assert not re.search(r'<link[^>]*rel="(stylesheet|preconnect)"[^>]*href="https?:', text), page.name


def test_notebooks_have_pages_and_can_be_downloaded(site):
    for notebook in (ROOT / "docs" / "notebooks").glob("*.ipynb"):
        page = (site / "notebooks" / f"{notebook.stem}.html").read_text(encoding="utf-8")
        assert f'href="{notebook.name}" download' in page
        assert (site / "notebooks" / notebook.name).is_file()
        for picture in re.findall(r"<img [^>]*>", re.search(r"<article.*?</article>", page, re.S)[0]):
            assert re.search(r' alt="[^"]{50,}"', picture), picture


def test_equations_are_typeset_without_scripts(site):
    source = (ROOT / "docs" / "explanation" / "model.md").read_text(encoding="utf-8")
    page = (site / "explanation" / "model.html").read_text(encoding="utf-8")
    for number in re.findall(r"\\tag\{(\d+)\}", source):
        assert re.search(rf'<div class="equation" id="equation-{number}">.*<span class="number">\({number}\)', page)
    assert page.count("<math") > 100
    article = re.search(r"<article.*?</article>", page, re.S)[0]
    assert "$" not in article
    assert "\\" not in article


@pytest.mark.browser
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
@pytest.mark.parametrize("width", [1400, 390])
def test_pages_read_offline_on_any_screen(site, width):
    playwright = pytest.importorskip("playwright.sync_api")
    with playwright.sync_playwright() as p:
        browser = p.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        context = browser.new_context(viewport={"width": width, "height": 900}, offline=True)
        page = context.new_page()
        heard: list[str] = []
        page.on("console", lambda message: heard.append(message.text))
        page.on("pageerror", lambda error: heard.append(str(error)))
        pages = ("index", "how-to/export", "explanation/accuracy", "explanation/model", "reference/options")
        for name in (*pages, "notebooks/own-data", "notebooks/figure-4"):
            page.goto((site / f"{name}.html").as_uri())
            assert page.evaluate("document.documentElement.scrollWidth - window.innerWidth") <= 0, name
        page.keyboard.press("/")
        page.keyboard.type("minisign")
        page.wait_for_selector(".md-search-result__article", timeout=20_000)
        assert heard == []
        browser.close()


@pytest.mark.browser
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
@pytest.mark.parametrize(("scheme", "width"), [("light", 1400), ("dark", 390)])
def test_pages_have_no_serious_finding_of_accessibility(site, scheme, width):
    playwright = pytest.importorskip("playwright.sync_api")
    axe = pytest.importorskip("axe_playwright_python.sync_playwright")
    with playwright.sync_playwright() as p:
        browser = p.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
        found = {}
        for name in ("index", "explanation/model", "how-to/production", "notebooks/own-data"):
            page.goto((site / f"{name}.html").as_uri())
            page.wait_for_timeout(200)
            violations = axe.Axe().run(page).response["violations"]
            found[name] = [one["help"] for one in violations if one["impact"] in ("serious", "critical")]
        browser.close()
    assert not any(found.values()), found
