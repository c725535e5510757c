"""Every page that is written or served, checked by axe-core in a real browser, in light and in dark."""

import fcntl
import itertools
import json
import os
import re
import shutil
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kreisel.acquisition.tail import Tail
from kreisel.batch.batch_pages import write_batch, write_history
from kreisel.batch.lot import units_of
from kreisel.batch.unit_history import history_of
from kreisel.calibration.arm_calibration import arm_of
from kreisel.calibration.calibrate import run_calibration
from kreisel.calibration.data_sheet import QUANTITIES
from kreisel.calibration.injection import inject
from kreisel.calibration.method_comparison import compare_methods
from kreisel.dashboard import feed as of_feed
from kreisel.dashboard.feed import Feed
from kreisel.dashboard.live_goals import write_goals
from kreisel.dashboard.online import Online
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.preparation.resting_noise import allan_report
from kreisel.report.allan_page import write_allan
from kreisel.report.arm_page import write_arm
from kreisel.report.cells import pair
from kreisel.report.comparison_page import write_comparison
from kreisel.report.report_page import write_report
from kreisel.report.static_page import write_static
from kreisel.simulation.standstills import HandTurns, hand_turned
from kreisel.static.guide import Guide
from kreisel.static.static_result import calibrate_static

from ..small_cell import simulate
from ..unit.batch.test_lot import LIMITS, run
from ..unit.calibration.test_arm_calibration import cell
from ..unit.certificate.test_certificate import page as certificate
from ..unit.preparation.test_resting_noise import at_rest
from .test_report_browser import AXES, CLIPPED
from .test_watch import chunks

playwright = pytest.importorskip("playwright.sync_api")
axe = pytest.importorskip("axe_playwright_python.sync_playwright")
NAMES = "chromium", "chromium-browser", "google-chrome"
CHROMIUM = next(filter(None, map(shutil.which, NAMES)), None)
pytestmark = [pytest.mark.browser, pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")]

HOST = "http://kreisel.invalid/"
"""Where the served pages are; nothing is sent there."""

WRITTEN = "report", "gaps", "static", "comparison", "batch", "history", "allan", "arm", "certificate"
SERVED = "live", "guide", "station"
STATION = {
    "kind": "station", "station": "west", "phase": "ready", "attempt": None, "seconds": 60.0, "progress": {},
    "last": {"id": 2, "unit": "SN-0043", "kind": "unit", "outcome": "does not conform",
             "reason": "gyro bias x: 31 ± 2 deg/h", "has_certificate": False, "has_report": True},
    "recent": [
        {"id": 2, "unit": "SN-0043", "outcome": "does not conform", "state": "ended",
         "ended": "2026-01-01T08:02:00+00:00", "reason": "gyro bias x: 31 ± 2 deg/h"},
        {"id": 1, "unit": "SN-0042", "outcome": "conforms", "state": "ended", "ended": "2026-01-01T08:00:00+00:00",
         "reason": ""},
    ],
    "units": 2, "good": 1, "golden": "station checked with unit G-1", "golden_due": False, "limits": "limits.toml",
    "software": "kreisel",
}  # fmt: skip
"""What a station's page is sent after two units."""

SERIOUS = {"serious", "critical"}


@pytest.fixture(scope="module")
def small():
    return simulate(np.random.default_rng(11), 60.0, Path("small"), imu_rate=100.0)[1]


@pytest.fixture(scope="module")
def folder(small, tmp_path_factory):
    """Every page as a file, those that are served beside what they are sent; made once for all workers."""
    base = tmp_path_factory.getbasetemp()
    out = (base.parent if os.environ.get("PYTEST_XDIST_WORKER") else base) / "accessible-pages"
    with out.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not out.is_dir():
            out.mkdir()
            write_pages(small, out)
    return out


def write_pages(small, out):
    outcome = run_calibration(small, CalibrationSettings(), validate=True, budget=True)
    write_report(outcome, out / "report.html", injection=inject(outcome))
    lost = "gyroscope.cross_coupling[0,1]", "accelerometer.offset[2]"
    verdict = replace(outcome.verdict, unobservable=lost)
    seen = replace(outcome.observability, unobservable=lost)
    write_report(replace(outcome, observability=seen, verdict=verdict, cross=None, halves=None), out / "gaps.html")
    turned = hand_turned(HandTurns("fog-mems", attitudes=12, rest=3.0), np.random.default_rng(1))[1]
    write_static(calibrate_static(turned), out / "static.html")
    compared = compare_methods(small, ["ekf", "batch"])
    write_comparison([compared, compared], ["a", "b"], out / "comparison.html")
    runs = [run(k, 30.0 if k == 3 else float(k % 5)) for k in range(30)]
    tray = [replace(run(40 + k, 1.0), key=f"key/imu{k}", name=f"tray/imu{k}") for k in range(3)]
    write_batch(units_of([*runs, *tray], LIMITS), LIMITS, "lead", True, out / "batch.html")
    dated = [replace(one, date=f"20{10 + k}-05-01") for k, one in enumerate(runs[:6])]
    write_history(history_of("u", dated, LIMITS), LIMITS, out / "history.html")
    write_allan("rest", allan_report(at_rest(1200.0)), out / "allan.html")
    write_arm(arm_of(run_calibration(cell(0)[1], CalibrationSettings())), out / "arm.html")
    (out / "certificate.html").write_text(certificate(), encoding="utf-8")
    served(out, "live", "page.html", live_messages(small, out))
    served(out, "station", "station.html", [STATION])
    served(out, "guide", "guide.html", [Guide({"accelerometer.offset": 1e-3}).look(turned).document])


def served(out, name, file, messages):
    page = Path(of_feed.__file__).with_name(file).read_text(encoding="utf-8")
    (out / f"{name}.html").write_text(page, encoding="utf-8")
    (out / f"{name}.json").write_text(json.dumps(messages), encoding="utf-8")


def live_messages(recording, out):
    """Return what the page of a recording is sent: two estimates on the way, and all at the end."""
    file, parts = out / "growing.mcap", chunks(recording, 4)
    file.write_bytes(b"")
    feed, messages = Feed(file, Online(Tail(file), clock=itertools.count(step=1000.0).__next__).look), []
    for part in (parts[1], parts[2], parts[-1]):
        with file.open("ab") as stream:
            stream.write(part[file.stat().st_size :])
        if part == parts[2]:
            write_goals(file, {"accelerometer.offset": 1e-5, "gyroscope.offset": 1e-3})
        messages += [*feed.news(), feed.look()]
    return [message for message in messages if message is not None]


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as p:
        chromium = p.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield chromium
        chromium.close()


@contextmanager
def opened(browser, folder, name, scheme, width):
    """Yield a page with all that it shows, and what it complains of."""
    context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme, bypass_csp=True)
    page, complaints = context.new_page(), []
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    if name in SERVED:
        messages = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
        text = (folder / f"{name}.html").read_text(encoding="utf-8")
        page.route(HOST, lambda route: route.fulfill(body=text, content_type="text/html"))
        page.route("**/favicon.ico", lambda route: route.fulfill(body="", content_type="image/x-icon"))
        page.route_web_socket("ws://kreisel.invalid/live", lambda ws: [ws.send(json.dumps(one)) for one in messages])
        page.goto(HOST)
        page.wait_for_timeout(300)
    else:
        page.goto((folder / f"{name}.html").as_uri())
        if name != "certificate":
            page.wait_for_selector("html[data-drawn=all]", timeout=60_000)
    yield page, complaints
    context.close()


@pytest.mark.parametrize(("scheme", "width"), [("light", 1400), pytest.param("dark", 390, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", [*WRITTEN, *SERVED])
def test_no_page_has_a_serious_finding(browser, folder, name, scheme, width):
    with opened(browser, folder, name, scheme, width) as (page, complaints):
        found = axe.Axe().run(page).response["violations"]
        serious = [
            f"{one['impact']}: {one['help']}: {node['target']}: {node['failureSummary'][:200]}"
            for one in found for node in one["nodes"] if one["impact"] in SERIOUS
        ]  # fmt: skip
        assert serious == []
        assert complaints == []
        assert page.evaluate("document.documentElement.scrollWidth - window.innerWidth") <= 0


@pytest.mark.parametrize("width", [1400, 390])
def test_the_live_page_says_what_it_shows(browser, folder, width):
    messages = json.loads((folder / "live.json").read_text(encoding="utf-8"))
    last = [one for one in messages if one["kind"] == "estimate"][-1]
    with opened(browser, folder, "live", "light", width) as (page, complaints):
        for name in ("rates", "forces"):
            assert [text.split()[0] for text in page.inner_text(f"#{name}-now").splitlines()] == ["x", "y", "z"]
        offered = page.evaluate("[...document.querySelector('#group').options].map(o => [o.value, o.textContent])")
        assert {name for name, _ in offered} == set(last["quantities"])
        for name, title in offered:
            page.select_option("#group", name)
            page.wait_for_function("t => document.querySelector('#table caption').innerText.includes(t)", arg=title)
            cells = page.evaluate("[...document.querySelectorAll('#table td')].map(c => c.textContent)")
            values, deviations = last["quantities"][name]
            expected = [pair(v, sd).replace(" ± ", "|± ").split("|") for v, sd in zip(values, deviations, strict=True)]
            assert [cells[k : k + 2] for k in range(0, len(cells), 2)] == expected, name
        assert re.search("Accelerometer bias: goal ± .* mg, now ± .*; (about .* left|not in reach|time left)",
                         page.inner_text("#goals"))  # fmt: skip
        assert re.search("Gyro bias: goal .*; reached", page.inner_text("#goals"))
        page.select_option("#group", "accel_bias_mg")
        page.fill("#goal", str(0.8 * max(last["quantities"]["accel_bias_mg"][1])))
        page.wait_for_timeout(100)
        assert re.search(
            "now ± .*(left, if it keeps falling|hardly falls|time left: not known)", page.inner_text("#left")
        )
        assert page.evaluate(OVERLAPS) == []
        assert complaints == []


OVERLAPS = """() => {
  const parts = [...document.querySelectorAll("header > *, main > section")];
  const boxes = parts.map((part) => [part, part.getBoundingClientRect()]), out = [];
  const meet = (p, q) => p.left < q.right - 1 && q.left < p.right - 1 && p.top < q.bottom - 1 && q.top < p.bottom - 1;
  boxes.forEach(([a, p], i) => boxes.slice(i + 1).forEach(([b, q]) => {
    if (meet(p, q)) out.push([a.outerHTML.slice(0, 60), b.outerHTML.slice(0, 60)]);
  }));
  for (const part of document.querySelectorAll("main *, header *")) {
    const inside = part.closest("section, header").getBoundingClientRect(), own = part.getBoundingClientRect();
    const out_of = own.right > inside.right + 1 || own.left < inside.left - 1;
    if (own.width && out_of) out.push(part.outerHTML.slice(0, 80));
  }
  return out;
}"""
"""Parts of the live page that lie upon each other, or reach out of their sections."""


def test_the_live_page_has_the_titles_of_the_report(browser, folder):
    with opened(browser, folder, "live", "light", 1400) as (page, _):
        titles = page.evaluate(
            "Object.fromEntries(Object.entries(QUANTITIES).map(([name, own]) => [name, own.slice(0, 2)]))"
        )
    assert {one.name: [one.title, one.unit] for one in QUANTITIES}.items() <= titles.items()


@pytest.mark.parametrize("name", [name for name in WRITTEN if name != "certificate"])
def test_every_axis_has_two_ticks_on_paper(browser, folder, name):
    with opened(browser, folder, name, "dark", 703) as (page, complaints):
        page.emulate_media(media="print")
        for _ in range(200):
            if page.evaluate("printed"):
                break
            page.wait_for_timeout(50)
        axes = page.evaluate(AXES)
        assert axes
        assert [axis for axis in axes if len(axis["texts"]) < 2] == []
        assert [axis for axis in axes if not axis["title"]] == []
        assert page.evaluate("palette() === PALETTES.light")
        assert page.evaluate(CLIPPED) == []
        assert complaints == []
