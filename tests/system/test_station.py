"""The station: simulated devices, a real browser, keyboard alone; pulled plugs, kills, and what is refused."""

import json
import shutil
import sqlite3
import subprocess
import urllib.error
import urllib.request
from importlib import resources

import jsonschema
import pytest

from kreisel.formats.loading import load

from ..station_line import PROGRAM, Operator, StationLine

playwright = pytest.importorskip("playwright.sync_api")
NAMES = "chromium", "chromium-browser", "google-chrome"
CHROMIUM = next(filter(None, map(shutil.which, NAMES)), None)
pytestmark = [pytest.mark.browser, pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")]


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as p:
        chromium = p.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield chromium
        chromium.close()


@pytest.fixture
def line(tmp_path):
    (tmp_path / "limits.toml").write_text("[limits]\ngyro_scale_error_ppm = 1e5\naccel_scale_error_ppm = 1e5\n")
    own = StationLine(tmp_path, more=("--limits", str(tmp_path / "limits.toml"), "--retests", "0"))
    yield own
    own.end()


def rows(line, text):
    with sqlite3.connect(line.output / "results.db") as database:
        return database.execute(text).fetchall()


def ask(url, path, what=None, **headers):
    headers = {"content-type": "application/json", **headers}
    asked = urllib.request.Request(url + path, None if what is None else json.dumps(what).encode(), headers)
    try:
        with urllib.request.urlopen(asked) as answer:
            return answer.status, answer.read()
    except urllib.error.HTTPError as error:
        return error.code, error.read()


@pytest.mark.slow
def test_a_shift(line, browser):
    port = line.start(line.clamp(3))
    page = browser.new_page()
    operator = Operator(page, line.url)
    page.keyboard.press("Tab")
    page.keyboard.type("ada")
    page.keyboard.press("Shift+Tab")

    operator.scan("A-1")
    assert operator.result("A-1") == "✓ PASS"
    operator.press("F4")
    operator.wait(lambda: rows(line, "select printed from attempts where id = 1") == [(1,)])

    operator.scan("B 2/é")  # any characters; the plug is pulled
    operator.recording(0.02)
    line.imu.pull()
    assert operator.result("B 2/é") == "! NOT TESTED"
    assert "no readings of the IMU" in page.locator("#why").inner_text()

    line.clamp(5)
    operator.again()
    operator.recording()
    line.kill()
    operator.wait(lambda: operator.word == "No connection")
    line.start(line.folder / "cell-5", port)
    operator.wait(lambda: operator.word == "! NOT TESTED")
    assert "killed while it recorded" in page.locator("#why").inner_text()

    operator.again()
    operator.recording()
    operator.press("Escape")
    assert operator.result("B 2/é") == "! NOT TESTED"
    operator.again()
    assert operator.result("B 2/é") == "✓ PASS"
    operator.press("F2")
    assert "set it aside" in operator.refusal()
    page.close()

    found = rows(line, "select unit, station, operator, state, outcome from attempts order by id")
    assert {row[1:4] for row in found} == {("west", "ada", "ended")}
    assert [(unit, outcome) for unit, *_, outcome in found] == [
        ("A-1", "conforms"), ("B 2/é", "interrupted"), ("B 2/é", "interrupted"), ("B 2/é", "interrupted"),
        ("B 2/é", "conforms"),
    ]  # fmt: skip
    # nothing lost: every attempt has its recording, also those of the pulled plug and of the kill
    for (recording,) in rows(line, "select recording from attempts"):
        assert load(line.output / recording).imu.stamps_ns.size > 100
    assert len(rows(line, "select key from runs where unit = 'B 2/é'")) == 1
    schema = json.loads(resources.files("kreisel.batch").joinpath("unit-schema.json").read_text())
    for path in line.output.glob("results/*/unit.json"):
        jsonschema.validate(json.loads(path.read_text()), schema)
    # the same recording by the command gives the same outcome
    first = line.output / rows(line, "select recording from attempts where id = 1")[0][0]
    limits = ["--limits", str(line.folder / "limits.toml")]
    assert subprocess.run([*PROGRAM, "calibrate", str(first), *limits], capture_output=True).returncode == 0


def test_what_is_refused(line):
    line.start(line.clamp(3))
    status, body = ask(line.url, "/start", {"serial": " \t"})
    assert (status, "1 to 100 characters" in body.decode()) == (409, True)
    assert ask(line.url, "/start", {"serial": "A"}, origin="http://elsewhere.example")[0] == 403
    assert ask(line.url, "/start", {"serial": "A"}, **{"content-type": "text/plain"})[0] == 409
    assert ask(line.url, "/start", {"serial": "A" * 9000})[0] == 409
    assert ask(line.url, "/certificate/..%2F..%2Fetc")[0] in (404, 409)
    assert ask(line.url, "/report/7")[0] == 409
    assert ask(line.url, "/printed", {"attempt": None})[0] == 409
    assert rows(line, "select count(*) from attempts") == [(0,)]
    other = [*PROGRAM, "station", "--imu", "csv://127.0.0.1:9", "--robot", "rtde://127.0.0.1:9", "-o", str(line.output)]
    found = subprocess.run([*other, "--port", "0"], capture_output=True, text=True)
    assert found.returncode == 1
    assert "another station is at work there" in found.stderr


@pytest.mark.slow
def test_the_known_unit_comes_first(line, browser, tmp_path):
    cell = line.clamp(3)
    recording, result = tmp_path / "golden.mcap", tmp_path / "golden"
    addresses = ["--imu", f"csv://127.0.0.1:{line.imu.port}", "--robot", f"rtde://127.0.0.1:{line.robot.port}"]
    settings = tmp_path / "golden.toml"
    settings.write_text((cell / "recording.toml").read_text() + '\n[device]\nserial_number = "G-1"\n')
    taking = [*PROGRAM, "record", *addresses, "-o", str(recording), "--seconds", "10", "--settings", str(settings)]
    subprocess.run(taking, check=True, capture_output=True)
    subprocess.run([*PROGRAM, "calibrate", str(recording), "-o", str(result)], check=True, capture_output=True)
    line._more += ["--golden", str(result)]
    line.start(cell)
    page = browser.new_page()
    operator = Operator(page, line.url)
    operator.scan("A-1")
    assert "scan the known unit G-1" in operator.refusal()
    line.clamp(4)  # another device in the place of the known one
    operator.scan("G-1")
    assert operator.result("G-1 (known unit)") == "✗ FAIL"
    operator.scan("A-1")
    assert "did not agree" in operator.refusal()
    line.clamp(3)
    operator.scan("G-1")
    operator.busy()
    assert operator.result("G-1 (known unit)") == "✓ PASS"
    operator.scan("A-1")
    operator.busy()
    page.close()
