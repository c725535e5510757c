"""The report in a real browser, without a network."""

import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kreisel.calibration.calibrate import run_calibration
from kreisel.calibration.injection import inject
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.report.report_page import write_report

from ..small_cell import simulate

playwright = pytest.importorskip("playwright.sync_api")
NAMES = "chromium", "chromium-browser", "google-chrome"
CHROMIUM = next(filter(None, map(shutil.which, NAMES)), None)
pytestmark = [pytest.mark.browser, pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")]

WIDE, NARROW, TALL = 1280, 420, 900


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    recording = simulate(np.random.default_rng(7), 60.0, folder / "small")[1]
    outcome = run_calibration(recording, CalibrationSettings(), validate=True)
    path = folder / "report.html"
    write_report(outcome, path, injection=inject(outcome))
    return path


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with playwright.sync_playwright() as p:
        chromium = p.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield chromium
        chromium.close()


INKED = """plot => {
  let inked = 0;
  for (const canvas of plot.querySelectorAll("canvas")) {
    const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
    for (let i = 3; i < data.length; i += 4) inked += data[i] > 0;
  }
  return inked;
}"""
"""How many pixels of a figure are drawn."""


class Visit:
    """A page opened offline; it notes what the browser complains of and asks for."""

    def __init__(self, browser: Any, report: Path, scheme: str, width: int) -> None:
        self.complaints: list[str] = []
        self.requests: list[str] = []
        self.context = browser.new_context(viewport={"width": width, "height": TALL}, color_scheme=scheme, offline=True)
        self.page = self.context.new_page()
        self.page.on("console", lambda message: self.complaints.append(message.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.goto(report.as_uri())
        self.page.wait_for_selector("html[data-drawn=all]", timeout=60_000)

    def wait_until(self, condition: str) -> None:
        """Wait for a condition in JavaScript; the page's own policy forbids the evaluation playwright would use."""
        for _ in range(200):
            if self.page.evaluate(condition):
                return
            self.page.wait_for_timeout(50)
        pytest.fail(f"not in ten seconds: {condition}")


@pytest.fixture
def visit(browser: Any, report: Path, request: pytest.FixtureRequest) -> Iterator[Visit]:
    scheme, width = getattr(request, "param", ("light", WIDE))
    visit = Visit(browser, report, scheme, width)
    yield visit
    visit.context.close()


@pytest.mark.parametrize(
    "visit", [("light", WIDE), ("dark", WIDE), ("light", NARROW)], indirect=True, ids=["light", "dark", "narrow"]
)
def test_it_opens_offline_and_draws_every_plot(visit: Visit, report: Path) -> None:
    assert visit.complaints == []
    assert visit.requests == [report.as_uri()]
    plots = visit.page.query_selector_all(".plot")
    assert len(plots) >= 19
    for plot in plots:
        name = plot.get_attribute("data-figure")
        assert plot.query_selector("canvas") is not None, name
        assert visit.page.evaluate(INKED, plot) > 100, name
        assert plot.bounding_box()["width"] > 200, name
    across = visit.page.evaluate("document.documentElement.scrollWidth - window.innerWidth")
    assert across <= 0


def test_light_and_dark_differ_and_follow_the_system(visit: Visit) -> None:
    colour = "charts.get(document.querySelector('[data-figure=rates]'))[0].axes[0].stroke().toString()"
    ground = "getComputedStyle(document.body).backgroundColor"
    light = visit.page.evaluate(colour), visit.page.evaluate(ground)
    visit.page.emulate_media(color_scheme="dark")
    visit.wait_until(f"{colour} !== '{light[0]}'")
    assert visit.page.evaluate(ground) != light[1]
    assert visit.complaints == []


def test_time_axes_of_a_section_move_together(visit: Visit) -> None:
    scale = "charts.get(document.querySelector('[data-figure={}]'))[0].scales.x"
    chart = scale.format("rates").removesuffix(".scales.x")
    visit.page.evaluate(f"{chart}.zoomed = true, {chart}.setScale('x', {{min: 10, max: 20}})")
    visit.wait_until(f"{scale.format('accelerations')}.min === 10 && {scale.format('accelerations')}.max === 20")
    assert visit.page.evaluate(f"{scale.format('nis')}.min") != 10


def test_it_prints(visit: Visit) -> None:
    before = visit.page.evaluate("document.querySelector('[data-figure=rates]').offsetHeight")
    paper = visit.page.pdf(format="A4")
    assert paper.startswith(b"%PDF")
    assert 5 <= len(re.findall(rb"/Type\s*/Page\b", paper)) <= 12
    visit.wait_until(f"document.querySelector('[data-figure=rates]').offsetHeight === {before}")
    assert visit.complaints == []


AXES = """() => [...document.querySelectorAll(".plot")].flatMap((plot) => charts.get(plot).flatMap((u, row) => u.axes
  .filter((axis) => axis.show && !(axis.side === 2 && row < charts.get(plot).length - 1))
  .map((axis) => ({
    name: `${plot.dataset.figure}, panel ${row}, ${axis.side === 2 ? "x" : "y"}`,
    texts: (axis._values || []).filter((text) => text !== ""),
    title: axis.label, room: axis.side === 2 ? u.over.clientWidth : u.over.clientHeight, font: axis.labelFont,
    canvas: u.root.clientWidth, holder: plot.parentElement.clientWidth,
  }))))"""
"""Every axis that is drawn with texts: what they are, its title and the room beside it."""

CLIPPED = """() => [...document.querySelectorAll("figcaption, figure h3, p, caption, dd, li")].filter((part) =>
  !part.closest("noscript, nav, .readout, details:not([open])") && !part.matches(".readout") && (
    part.getClientRects().length === 0 || part.scrollHeight > part.clientHeight + 3 && part.clientHeight > 0))
  .map((part) => part.textContent.trim().slice(0, 60))"""
"""Beginnings of captions and paragraphs that are not shown, or not to their ends."""


def on_paper(visit: Visit) -> Any:
    visit.page.set_viewport_size({"width": 703, "height": TALL})  # an A4 page without its margins
    visit.page.emulate_media(media="print")
    visit.wait_until("printed")
    return visit.page


@pytest.mark.parametrize("paper", [False, True], ids=["screen", "paper"])
def test_every_axis_has_two_ticks_and_its_whole_title(visit: Visit, paper: bool) -> None:
    page = on_paper(visit) if paper else visit.page
    axes = page.evaluate(AXES)
    assert len(axes) >= 40
    measure = """([text, font]) => {
      const c = document.createElement("canvas").getContext("2d");
      c.font = font;
      return c.measureText(text).width;
    }"""
    ratio = page.evaluate("uPlot.pxRatio")
    for axis in axes:
        assert len(axis["texts"]) >= 2, axis
        assert len(set(axis["texts"])) == len(axis["texts"]), axis
        assert page.evaluate(measure, [axis["title"], axis["font"][0]]) / ratio <= axis["room"] + 2, axis
        assert axis["canvas"] <= axis["holder"] + 1, axis


@pytest.mark.parametrize("paper", [False, True], ids=["screen", "paper"])
def test_discs_are_round(visit: Visit, paper: bool) -> None:
    page = on_paper(visit) if paper else visit.page
    for name in ("coverage", "path"):
        chart = f"charts.get(document.querySelector('[data-figure={name}]'))[0]"
        across, down = (
            page.evaluate(f"Math.abs({chart}.valToPos(1, '{axis}') - {chart}.valToPos(0, '{axis}'))") for axis in "xy"
        )
        assert across == pytest.approx(down, rel=0.01), name


def test_paper_shows_all_text_that_the_screen_shows(visit: Visit) -> None:
    assert on_paper(visit).evaluate(CLIPPED) == []


@pytest.mark.skipif(shutil.which("pdftotext") is None, reason="no pdftotext on this machine")
def test_captions_are_in_the_printed_file_and_no_heading_ends_a_page(visit: Visit, tmp_path: Path) -> None:
    captions, headings = (
        visit.page.evaluate(f"[...document.querySelectorAll('{kind}')].map((one) => one.textContent)")
        for kind in ("figcaption", "h2, h3, caption")
    )
    visit.page.pdf(path=tmp_path / "report.pdf", format="A4")
    command = ["pdftotext", "-enc", "UTF-8", "-layout", str(tmp_path / "report.pdf"), "-"]
    pages = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split("\f")
    for sheet in pages[:-1]:
        lines = [line.strip() for line in sheet.strip().splitlines() if line.strip()]
        assert len(lines) > 3
        assert re.split(r" {3,}", lines[-1])[0] not in headings
    command.remove("-layout")
    printed = "".join(subprocess.run(command, check=True, capture_output=True, text=True).stdout.split())
    assert len(captions) >= 17
    for caption in captions:
        assert "".join(caption.split()) in printed
