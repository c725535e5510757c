"""A recording watched while it is made: the estimate, and the page in a real browser."""

import asyncio
import io
import json
import re
import shutil
import socket
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path
from urllib.error import HTTPError, URLError
from urllib.parse import urlsplit
from urllib.request import Request, urlopen

import numpy as np
import pytest
from websockets.sync.client import connect

import kreisel
from kreisel.acquisition.recorder import Recorder
from kreisel.acquisition.tail import Tail
from kreisel.dashboard import online as online_calibration
from kreisel.dashboard.feed import MAX_ESTIMATES, Feed
from kreisel.dashboard.live_estimate import LiveEstimate
from kreisel.dashboard.online import GROWN, SHARE, Online
from kreisel.devices.events import Arrival
from kreisel.devices.simulators import imu_samples, robot_samples
from kreisel.errors import RecordingError
from kreisel.recording.recording_settings import RecordingSettings
from kreisel.report.cells import pair

from ..small_cell import simulate

LIMIT = 300.0
"""Seconds after which what is waited for is taken not to come; reached by failures alone."""

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


@pytest.fixture(scope="module")
def small():
    return simulate(np.random.default_rng(11), 60.0, Path("small"))[1]


def chunks(recording, pieces):
    """Return what a recorder has written after each piece of a recording, and at the end."""
    stream = io.BytesIO()
    recorder = Recorder(stream, RecordingSettings(), None, 10**18, 0)
    events = sorted(
        [*imu_samples(recording.imu), *robot_samples(recording)],
        key=lambda sample: sample.stamp_ns - first(recording, sample),
    )
    out = []
    for part in np.array_split(np.arange(len(events)), pieces):
        for k in part:
            recorder.take("cell", Arrival(events[k], 1000 * int(k)))
        recorder.flush()
        out.append(stream.getvalue())
    recorder.finish()
    return [*out, stream.getvalue()]


def first(recording, sample):
    return (recording.imu if hasattr(sample, "rate") else recording.reference).stamps_ns[0]


def test_the_last_estimate_is_that_of_the_whole(small, tmp_path):
    file = tmp_path / "growing.mcap"
    tail, now = Tail(file), [0.0]
    online = Online(tail, clock=lambda: now[0])
    found = []
    for data in chunks(small, 8):
        file.write_bytes(data)
        tail.read()
        found.append(online.step())
        now[0] += 1000.0
    whole = kreisel.calibrate(kreisel.load(file))
    last = found[-1]
    assert tail.ended
    assert online.step() is None
    assert last.names == tuple(whole.names)
    assert np.array_equal(last.calibration.estimates[-1], whole.estimates[-1])
    assert np.array_equal(last.calibration.covariance, whole.covariance)
    spread = [np.sqrt(np.mean(e.deviations**2)) for e in found if len(e.names) == len(last.names)]
    assert spread == sorted(spread, reverse=True)


def test_estimates_of_a_long_recording_rest_and_the_last_is_that_of_the_whole(small, tmp_path, monkeypatch):
    monkeypatch.setattr("kreisel.acquisition.tail.MOST_READINGS", small.imu.stamps_ns.size // 3)
    file = tmp_path / "growing.mcap"
    tail, now = Tail(file, bounded=True), [0.0]
    online = Online(tail, clock=lambda: now[0])
    found, kept = [], []
    for data in chunks(small, 8):
        file.write_bytes(data)
        tail.read()
        found.append(online.step())
        kept.append(len(tail._kept["/imu/data_raw"].stamps_ns))
        now[0] += 1000.0
    resting = [k for k, one in enumerate(found) if one is None]
    assert resting
    assert "the next estimate comes when the recording ends" in found[resting[0] - 1].summary
    assert len(set(kept[resting[0] :])) == 1
    whole = kreisel.calibrate(kreisel.load(file))
    assert np.array_equal(found[-1].calibration.estimates[-1], whole.estimates[-1])
    assert "the next estimate" not in found[-1].summary


@pytest.mark.parametrize("bounded", [False, True])
def test_the_first_readings_of_all_are_too_few_and_that_is_all(small, tmp_path, bounded):
    file = tmp_path / "growing.mcap"
    online = Online(Tail(file, bounded=bounded), clock=lambda: 0.0)
    file.write_bytes(chunks(small, 600)[0])
    assert online.look().summary.startswith("nothing yet: ")


def test_a_tail_reads_through_any_cut(small, tmp_path):
    data = chunks(small, 3)[-1]
    file, rng = tmp_path / "growing.mcap", np.random.default_rng(3)
    tail = Tail(file)
    file.write_bytes(b"")
    tail.read()
    for end in sorted(rng.integers(0, len(data), 60)):
        file.write_bytes(data[:end])
        tail.read()
    file.write_bytes(data)
    tail.read()
    whole, again = kreisel.load(file), tail.recording()
    for a, b in ((whole.imu, again.imu), (whole.reference, again.reference)):
        assert np.array_equal(a.stamps_ns, b.stamps_ns)
    assert np.array_equal(whole.imu.rates, again.imu.rates)
    assert np.array_equal(whole.reference.quaternions, again.reference.quaternions)


def test_before_there_is_enough_it_says_why(small, tmp_path):
    file = tmp_path / "growing.mcap"
    file.write_bytes(chunks(small, 60)[0])
    tail = Tail(file)
    tail.read()
    found = Online(tail).step()
    assert found.names == ()
    assert "record longer" in found.summary


def test_calibrating_takes_its_share_and_no_more(small, tmp_path):
    file = tmp_path / "growing.mcap"
    file.write_bytes(chunks(small, 2)[1])
    tail, times = Tail(file), iter([0.0, 1.5, 7.4, 7.6, 9.0])
    tail.read()
    online = Online(tail, clock=lambda: next(times))
    assert online.step() is not None  # takes 1.5 s by this clock
    assert 1.5 / SHARE == 7.5
    assert online.step() is None
    assert online.step() is not None


@contextmanager
def page(file, *options):
    """Serve the page of a recording by the command itself."""
    process = subprocess.Popen(
        [sys.executable, "-m", "kreisel.cli.main", "watch", str(file), "--dashboard", "--port", "0", *options],
        stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        yield process.stdout.readline().strip()
    finally:
        process.terminate()
        process.communicate()


def grow(file, data):
    """Append what a recorder has written since."""
    with file.open("ab") as stream:
        stream.write(data[file.stat().st_size :])


def wait_until(what):
    ends = time.monotonic() + LIMIT
    while not what():
        assert time.monotonic() < ends
        time.sleep(0.1)


@pytest.mark.browser
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
def test_the_page_shows_what_was_recorded(small, tmp_path):
    playwright = pytest.importorskip("playwright.sync_api")
    file, parts = tmp_path / "growing.mcap", chunks(small, 4)
    file.write_bytes(parts[2])
    complaints, outside = [], []
    with page(file) as url, playwright.sync_playwright() as p:
        browser = p.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        tab = browser.new_page()
        tab.on("console", lambda message: complaints.append(message.text))
        tab.on("pageerror", lambda error: complaints.append(str(error)))
        tab.on("request", lambda request: outside.append(request.url))
        tab.goto(url)
        wait_until(lambda: tab.inner_text("#verdict") == "accepted")
        second = browser.new_page()
        second.goto(url)
        wait_until(lambda: second.inner_text("#verdict") == "accepted")
        assert second.evaluate("estimates.length") == tab.evaluate("estimates.length")
        grow(file, parts[-1])
        wait_until(lambda: tab.inner_text("#link") == "recording has ended")
        recording = kreisel.load(file)
        assert int(tab.inner_text("#imu-count")) == recording.imu.stamps_ns.size
        assert int(tab.inner_text("#robot-count")) == recording.reference.stamps_ns.size
        last = json.loads(tab.get_attribute("#rates", "data-last"))
        assert last[1:4] == recording.imu.rates[-1].tolist()
        assert last[4:7] == recording.imu.accelerations[-1].tolist()
        shown = [float(x) for x in tab.inner_text("#pose").removesuffix(" m").replace("−", "-").split()]
        assert shown == pytest.approx(recording.reference.positions[-1], abs=5.1e-4)
        whole = kreisel.calibrate(recording)
        cells = "#table td[data-name]"
        wait_until(lambda: tab.inner_text("#estimate-time") == f"after {recording.imu.seconds[-1]:.0f} s")
        found = {
            tab.locator(cells).nth(k).get_attribute("data-name"): float(
                tab.locator(cells).nth(k).get_attribute("data-value")
            )
            for k in range(tab.locator(cells).count())
        }
        bias = whole.derived["accel_bias_mg"]
        assert found == {f"accel_bias_mg[{i}]": value for i, value in enumerate(bias.value)}
        texts = [line.split("\t")[1:] for line in tab.inner_text("#table tbody").splitlines()]
        pairs = zip(bias.value, bias.deviation, strict=True)
        assert texts == [pair(value, sd).replace(" ± ", "|± ").split("|") for value, sd in pairs]
        wait_until(lambda: second.inner_text("#link") == "recording has ended")
        browser.close()
    assert complaints == []
    assert all(address.startswith(("http://127.0.0.1:", "ws://127.0.0.1:")) for address in outside)


def estimate(seconds):
    return LiveEstimate(seconds, ("timing.offset",), np.array([0.1]), np.array([0.2]), True, f"after {seconds}")


@contextmanager
def hub_of(file, monkeypatch):
    """Serve the page from here, where its hub can be told things; yield both, and what has the loop do something."""
    uvicorn = pytest.importorskip("uvicorn")
    from kreisel.dashboard import app as module

    hubs = []

    class Seen(module.Hub):
        def __init__(self, source):
            super().__init__(source)
            self.loop = None
            hubs.append(self)

        async def follow(self):
            self.loop = asyncio.get_running_loop()
            await super().follow()

    monkeypatch.setattr(module, "Hub", Seen)
    app, _ = module.make_app(Feed(file, Online(Tail(file)).look))
    server = uvicorn.Server(uvicorn.Config(app, log_level="warning", ws="websockets-sansio"))
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        serving = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
        serving.start()
        try:
            wait_until(lambda: hubs[0].loop is not None and hubs[0].source.so_far()[-1].get("imu"))
            yield hubs[0], port
        finally:
            server.should_exit = True
            serving.join()


def in_loop(hub, what):
    """Do something in the server's loop."""
    done = threading.Event()
    hub.loop.call_soon_threadsafe(lambda: (what(), done.set()))
    assert done.wait(LIMIT)


def much(k):
    return {"kind": "much", "text": np.random.default_rng(k).bytes(9000).hex()}


@pytest.mark.parametrize("reads", [True, False])
def test_a_browser_too_far_behind_is_told_to_come_again(small, tmp_path, monkeypatch, reads):
    """One that does not read while much is said finds, once it reads again, that it was let go."""
    sync = pytest.importorskip("websockets.sync.client")
    exceptions = pytest.importorskip("websockets.exceptions")
    file = tmp_path / "growing.mcap"
    file.write_bytes(chunks(small, 60)[1])
    with hub_of(file, monkeypatch) as (hub, port), sync.connect(f"ws://127.0.0.1:{port}/live", max_queue=1) as slow:
        slow.recv()
        if reads:
            in_loop(hub, lambda: [hub.tell({"kind": "little"}) for _ in range(1000)])
        for k in range(0 if reads else 2000):
            in_loop(hub, lambda k=k: hub.tell(much(k)))
        with pytest.raises(exceptions.ConnectionClosedError) as closed:
            list(slow)
        assert not reads or closed.value.rcvd.code == 1013
        with sync.connect(f"ws://127.0.0.1:{port}/live") as again:
            assert [json.loads(again.recv())["kind"] for _ in range(2)] == ["imu", "pose"]


def test_a_newcomer_after_hours_of_estimates_stays(small, tmp_path, monkeypatch):
    sync = pytest.importorskip("websockets.sync.client")
    file = tmp_path / "growing.mcap"
    file.write_bytes(chunks(small, 60)[1])
    with hub_of(file, monkeypatch) as (hub, port):
        in_loop(hub, lambda: [hub.source.estimate(estimate(float(k))) for k in range(1000)])
        with sync.connect(f"ws://127.0.0.1:{port}/live") as newcomer:
            first = [json.loads(newcomer.recv()) for _ in range(4)]
            assert [message["kind"] for message in first] == ["imu", "pose", "estimates", "status"]
            assert {e["seconds"] for e in first[2]["estimates"]} >= set(map(float, range(1000)))
            in_loop(hub, lambda: hub.tell({"kind": "more"}))
            while json.loads(newcomer.recv(timeout=LIMIT))["kind"] != "more":
                pass


def test_estimates_without_number_are_thinned_out_and_it_is_said(tmp_path):
    feed = Feed(tmp_path)
    for k in range(2 * MAX_ESTIMATES + 1):
        feed.estimate(estimate(float(k)))
    history = feed.so_far()[0]
    assert history["every"] == 3
    assert len(history["estimates"]) <= MAX_ESTIMATES
    assert history["estimates"][-1]["seconds"] == 2.0 * MAX_ESTIMATES
    assert set(np.diff([e["seconds"] for e in history["estimates"]])) == {3.0}


KEEP_WHAT_IS_SAID = """() => {
    window.said = [];
    const link = document.querySelector("#link");
    const keep = () => window.said.push(link.innerText);
    new MutationObserver(keep).observe(link, {childList: true, characterData: true, subtree: true});
}"""


@pytest.mark.browser
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
def test_a_page_that_was_let_go_comes_back_up_to_date(small, tmp_path, monkeypatch):
    playwright = pytest.importorskip("playwright.sync_api")
    file, parts = tmp_path / "growing.mcap", chunks(small, 60)
    file.write_bytes(parts[1])
    with hub_of(file, monkeypatch) as (hub, port), playwright.sync_playwright() as p:
        browser = p.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        tab = browser.new_page()
        tab.goto(f"http://127.0.0.1:{port}")
        wait_until(lambda: tab.inner_text("#link") == "live")
        tab.evaluate(KEEP_WHAT_IS_SAID)  # it may be live again before anybody looks
        in_loop(hub, lambda: [hub.tell({"kind": "pose", "pose": [9.0] * 7, "arm": None}) for _ in range(1000)])
        wait_until(lambda: any("connecting again" in said for said in tab.evaluate("said")))
        in_loop(hub, lambda: [hub.source.estimate(estimate(float(k))) for k in range(2 * MAX_ESTIMATES)])
        wait_until(lambda: tab.inner_text("#link") == "live")
        wait_until(lambda: "1 of 3 earlier estimates" in tab.inner_text("#thinned"))
        assert tab.evaluate("estimates.length") >= MAX_ESTIMATES / 2
        before = int(tab.inner_text("#imu-count"))
        grow(file, parts[2])
        wait_until(lambda: int(tab.inner_text("#imu-count")) > before)
        browser.close()


def test_a_complaint_is_shown_once_it_has_lasted(small, tmp_path, monkeypatch):
    """A faultless cell was told of a left-handed triad after five seconds; exchanged columns are told later."""
    file, parts = tmp_path / "growing.mcap", chunks(small, 40)
    said = ["the gyro axes form a left-handed triad, 1.5 times"]

    def calibration(recording, settings):
        del recording, settings
        raise RecordingError(f"{said[0]} {time.monotonic()}")

    monkeypatch.setattr(online_calibration, "run_calibration", calibration)
    file.write_bytes(parts[0])
    now = [0.0]
    online = Online(Tail(file), clock=lambda: now[0])
    summaries = []
    for part in parts[1:]:
        grow(file, part)
        now[0] += 100.0
        found = online.look()
        if found is not None and found.seconds > 0.0:
            summaries.append((found.seconds, found.summary))
    first = summaries[0][0]
    for seconds, summary in summaries:
        assert ("left-handed" in summary) == (seconds > GROWN * first)
        assert summary.startswith("nothing yet: ")
    assert "left-handed" in summaries[-1][1]


def test_strangers_are_kept_out(small, tmp_path):
    file = tmp_path / "growing.mcap"
    file.write_bytes(chunks(small, 2)[0])
    with page(file) as url:
        assert "<title>kreisel" in urlopen(url).read().decode()
        with pytest.raises(HTTPError, match="400"):  # another site's name led here
            urlopen(Request(url, headers={"Host": "evil.example"}))
    with page(file, "--host", "0.0.0.0") as url:
        port, token = re.fullmatch(r"http://0\.0\.0\.0:(\d+)/\?token=(\S{20,})", url).groups()
        for wrong in ("", "?token=", "?token=%C3%A4", f"?token={token[:-1]}"):
            with pytest.raises(HTTPError, match="403"):
                urlopen(f"http://127.0.0.1:{port}/{wrong}")
        assert "<title>kreisel" in urlopen(f"http://127.0.0.1:{port}/?token={token}").read().decode()


def test_connections_that_ask_for_nothing_are_closed(small, tmp_path):
    """Three hundred of them, some of which send half a request; a browser's stays."""
    file = tmp_path / "growing.mcap"
    file.write_bytes(chunks(small, 2)[0])
    with page(file) as url, ExitStack() as stack:
        where = urlsplit(url)
        idle = [stack.enter_context(socket.create_connection((where.hostname, where.port))) for _ in range(300)]
        for one in idle[::3]:
            one.sendall(b"GET / HTTP/1.1\r\nHost: 127")
        browser = stack.enter_context(connect(f"ws://{where.netloc}/live"))
        assert "<title>kreisel" in urlopen(url).read().decode()
        for one in idle:
            one.settimeout(LIMIT)
            assert one.recv(1) == b""
        for _ in range(250):  # more than come in ten seconds
            assert "kind" in json.loads(browser.recv(timeout=LIMIT))


def test_a_page_ends_with_its_recorder_however_that_ends(tmp_path):
    recorder = subprocess.Popen(
        [sys.executable, "-m", "kreisel.cli.main", "record", "--imu", "csv://127.0.0.1:9", "-o", "run",
         "--dashboard", "--port", "0"],
        cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
    )  # fmt: skip
    url = recorder.stdout.readline().strip()
    with urlopen(url) as answer:
        assert "<title>kreisel" in answer.read().decode()
    recorder.kill()
    recorder.communicate()

    def gone():
        try:
            urlopen(url, timeout=5.0).close()
        except URLError:
            return True
        return False

    wait_until(gone)


def test_other_pages_are_kept_out(small, tmp_path):
    """Of a page served from another port, by another scheme, or in a sandbox, whose origin is null."""
    sync = pytest.importorskip("websockets.sync.client")
    exceptions = pytest.importorskip("websockets.exceptions")
    file = tmp_path / "growing.mcap"
    file.write_bytes(chunks(small, 2)[0])
    with page(file) as url:
        url = url.rstrip("/")
        port = int(url.rpartition(":")[2])
        assert "<title>kreisel" in urlopen(Request(url, headers={"Origin": url})).read().decode()
        with sync.connect(f"{url.replace('http', 'ws')}/live", origin=url) as own:
            assert json.loads(own.recv())["kind"] == "imu"
        others = ("null", "", f"https://127.0.0.1:{port}", f"http://localhost:{port}", f"http://127.0.0.1:{port + 1}",
                  "http://127.0.0.1", f"ftp://127.0.0.1:{port}", f"//127.0.0.1:{port}", f"{url}/")  # fmt: skip
        for origin in others:
            with pytest.raises(HTTPError, match="403"):
                urlopen(Request(url, headers={"Origin": origin}))
            with pytest.raises(exceptions.InvalidStatus, match="403"):
                sync.connect(f"{url.replace('http', 'ws')}/live", additional_headers={"Origin": origin})


def test_watch_prints_lines_and_ends_with_the_recording(small, tmp_path):
    file = tmp_path / "done.mcap"
    file.write_bytes(chunks(small, 2)[-1])
    done = subprocess.run(
        [sys.executable, "-m", "kreisel.cli.main", "watch", str(file), "--json"],
        capture_output=True,
        text=True,
        check=True,
    )
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["accepted"]
    whole = kreisel.calibrate(kreisel.load(file)).document
    assert found["estimates"]["timing.offset"] == whole["timing"]["offset"]
