"""`kreisel static --live`: a simulated device in the hand of somebody who does what it says, to the certificate."""

import asyncio
import json
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager, suppress
from urllib.request import urlopen

import numpy as np
import pytest

from kreisel.dashboard.guide_feed import ADVICE, GuideFeed
from kreisel.devices.simulators import TcpSimulator
from kreisel.protocols.samples import ImuSample
from kreisel.simulation.standstills import HandHeld
from kreisel.static.guide import HOLD

PROGRAM = [sys.executable, "-m", "kreisel.cli.main"]
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)

SPEED = 6.0
"""Seconds of the device in one of the test."""


class Hand:
    """Serves readings of a device that is held still, and turned to what the guide's file asks for."""

    def __init__(self, folder, grade="consumer-mems"):
        self._advice = folder / "guide.json"
        self._device = HandHeld(grade, np.random.default_rng(3))
        self.port = 0
        self._begun = self._over = False
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), daemon=True)

    def start(self):
        self._thread.start()
        while not self.port:
            time.sleep(0.01)

    def stop(self):
        self._over = True
        self._thread.join()

    async def _serve(self):
        simulator = TcpSimulator("csv", lambda: setattr(self, "_begun", True))
        self.port = await simulator.serve("127.0.0.1", 0)
        while not self._begun and not self._over:
            await asyncio.sleep(0.01)
        number = 0
        while not self._over:
            wanted = self._wanted()
            w, a = self._device.hold(0.5) if wanted is None else self._device.turn(wanted)
            for part in range(0, len(w), 20):
                samples = [
                    ImuSample(round((number + k) * 1e9 / self._device.rate), tuple(w[part + k]), tuple(a[part + k]))
                    for k in range(len(w[part : part + 20]))
                ]
                simulator.send(samples)
                number += len(samples)
                await asyncio.sleep(len(samples) / self._device.rate / SPEED)
        simulator.close()

    def _wanted(self):
        """Return the direction that is asked for, once the device has been held for long enough."""
        try:
            advice = json.loads(self._advice.read_text())
        except (OSError, ValueError):
            return None
        return advice["wanted"] if advice["step"] == "turn" and advice["held"] >= HOLD else None


@contextmanager
def hand(folder):
    one = Hand(folder)
    one.start()
    try:
        yield one
    finally:
        one.stop()


@pytest.mark.slow
def test_who_does_what_it_says_ends_with_a_certificate(tmp_path):
    out = tmp_path / "out"
    with hand(out) as device:
        done = subprocess.run(
            [*PROGRAM, "static", "--live", f"csv://127.0.0.1:{device.port}", "--gravity", "9.8089", "-o", str(out)],
            capture_output=True, text=True, timeout=240, check=False,
        )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "Turn it gently on its face" in done.stderr
    assert "Enough" in done.stderr
    assert "verdict: accepted" in done.stdout
    assert (out / "recording.mcap").is_file()
    assert (out / "report.html").is_file()
    made = subprocess.run(
        [*PROGRAM, "certificate", str(out), "-o", str(tmp_path / "c.html")], capture_output=True, text=True, check=False
    )
    assert made.returncode == 0, made.stderr
    again = subprocess.run(
        [*PROGRAM, "static", "--live", f"csv://127.0.0.1:{device.port}", "-o", str(out)],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert again.returncode == 1
    assert "exists already" in again.stderr


def test_the_page_shows_the_advice_and_an_interrupt_keeps_what_was_taken(tmp_path):
    playwright = pytest.importorskip("playwright.sync_api")
    if CHROMIUM is None:
        pytest.skip("no browser")
    out = tmp_path / "out"
    with hand(out) as device:
        command = ["static", "--live", f"csv://127.0.0.1:{device.port}", "-o", str(out), "--dashboard", "--port", "0"]
        running = subprocess.Popen(
            [*PROGRAM, *command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )  # fmt: skip
        try:
            address = running.stdout.readline().strip()
            assert address.startswith("http://127.0.0.1:")
            assert b"what to do next" in urlopen(address).read()
            with playwright.sync_playwright() as p:
                browser = p.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
                page = browser.new_page(viewport={"width": 390, "height": 844})
                page.goto(address)
                until = time.monotonic() + 60.0
                while int(page.inner_text("#count")) < 3 and time.monotonic() < until:
                    page.wait_for_timeout(200)
                assert int(page.inner_text("#count")) >= 3
                assert page.evaluate("document.documentElement.scrollWidth") <= 390
                assert page.inner_text("#text")
                browser.close()
        finally:
            running.send_signal(signal.SIGINT)
            _, stderr = running.communicate(timeout=60)
    assert running.returncode in (1, 3), stderr  # too few attitudes for a result
    assert "Traceback" not in stderr
    assert (out / "recording.mcap").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(["--live", "csv://127.0.0.1:1"], "no output is given"),
     (["--live", "nonsense", "-o", "out"], "nonsense"),
     (["--live", "csv://127.0.0.1:1", "-o", "out", "--until", "gyroscope.offset=3mm"], "'mm' is no unit of"),
     (["--live", "csv://127.0.0.1:1", "-o", "out", "--until", "gyroscope.offsets=3"], "unknown group"),
     ([], "give a recording, or --live")],
)  # fmt: skip
def test_wrong_input_is_one_line(tmp_path, arguments, message):
    done = subprocess.run(
        [*PROGRAM, "static", *arguments], capture_output=True, text=True, cwd=tmp_path, timeout=60, check=False
    )
    assert done.returncode == 1
    assert message in done.stderr
    assert "Traceback" not in done.stderr


def test_a_device_that_nobody_reaches_is_said_and_does_not_wait_for_ever(tmp_path):
    began = time.monotonic()
    done = subprocess.run(
        [*PROGRAM, "static", "--live", "csv://127.0.0.1:1", "-o", str(tmp_path / "out"), "--seconds", "6"],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert time.monotonic() - began < 30.0
    assert done.returncode == 1
    assert "No readings come from csv://127.0.0.1:1" in done.stderr
    assert not (tmp_path / "out" / "recording.mcap").exists()


def test_lines_that_cannot_be_read_end_it_with_the_reason(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as server:

        def send():
            connection, _ = server.accept()
            with connection, suppress(OSError):
                connection.sendall(b"#t [ms],w_x [rpm],w_y,w_z,a_x [g],a_y,a_z\n")
                for k in range(3000):
                    connection.sendall(f"{10 * k},0,0,0,0,0,1\n".encode())
                    time.sleep(0.01)

        threading.Thread(target=send, daemon=True).start()
        address = f"csv://127.0.0.1:{server.getsockname()[1]}"
        done = subprocess.run(
            [*PROGRAM, "static", "--live", address, "-o", str(tmp_path / "out")],
            capture_output=True, text=True, timeout=60, check=False,
        )  # fmt: skip
    assert done.returncode == 1
    last = done.stderr.splitlines()[-1]
    assert last.startswith(f"kreisel: no readings came from {address}: CSV line: column w_x is in 'rpm'; known units")


def test_the_page_is_told_what_is_new(tmp_path):
    feed = GuideFeed(tmp_path / "recording.mcap")
    assert feed.news() == feed.so_far() == []
    for text in ("{", "not JSON"):  # half a file, and a wrong one
        (tmp_path / ADVICE).write_text(text)
        assert feed.news() == []
    (tmp_path / ADVICE).write_text('{"kind": "advice", "held": 1.0}')
    assert feed.news() == feed.so_far() == [{"kind": "advice", "held": 1.0}]
    assert feed.news() == []
    assert feed.look() is None
