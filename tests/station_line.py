"""A station with simulated devices, and an operator who has a keyboard alone."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress

HOST = "127.0.0.1"
BUSY = ("Recording", "Waiting", "Calculating")
"""How the page's word begins while an attempt is at work."""

PROGRAM = [sys.executable, "-P", "-m", "kreisel.cli.main"]


class Plug:
    """A wire from a port that stays the same to that of the device at work, which can be pulled."""

    def __init__(self):
        self._listener = socket.create_server((HOST, 0))
        self.port = self._listener.getsockname()[1]
        self._device = None
        self._open = []
        self._closed = False
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def put(self, port):
        self._device = port

    def pull(self):
        self._device = None
        for one in self._open:
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()
        self._open.clear()

    def close(self):
        self.pull()
        self._closed = True
        socket.create_connection((HOST, self.port)).close()
        self._thread.join()
        self._listener.close()

    def _serve(self):
        while True:
            here, _ = self._listener.accept()
            if self._closed:
                here.close()
                return
            try:
                there = socket.create_connection((HOST, self._device or 1), 5.0)
            except OSError:
                here.close()
                continue
            self._open += [here, there]
            for a, b in ((here, there), (there, here)):
                threading.Thread(target=self._pass, args=(a, b), daemon=True).start()

    def _pass(self, a, b):
        with suppress(OSError):
            while data := a.recv(65536):
                b.sendall(data)
        for one in (a, b):
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)


class StationLine:
    """The station's program and the device that is clamped; both are processes of their own."""

    def __init__(self, folder, seconds=10, speed=9, more=()):
        self.folder, self.output = folder, folder / "line"
        self._seconds, self._speed, self._more = seconds, speed, list(more)
        self.imu, self.robot = Plug(), Plug()
        self._cell = self._station = None
        self.url = ""

    def clamp(self, seed):
        """Put another device on the arm; its recording.toml is that of the station."""
        self.release()
        cell = self.folder / f"cell-{seed}"
        own = ["virtual-cell", "--robot", "rtde", "--imu", "csv", "--speed", f"{self._speed}", "--seed", f"{seed}"]
        self._cell = subprocess.Popen([*PROGRAM, *own, "-o", str(cell)], stdout=subprocess.PIPE, text=True)
        ready = json.loads(self._cell.stdout.readline())
        self.imu.put(int(ready["imu"].rpartition(":")[2]))
        self.robot.put(int(ready["robot"].rpartition(":")[2]))
        return cell

    def release(self):
        self.imu.pull()
        self.robot.pull()
        if self._cell is not None:
            self._cell.terminate()
            self._cell.communicate()
            self._cell = None

    def start(self, cell, port=0):
        command = [
            *PROGRAM, "station", "--imu", f"csv://{HOST}:{self.imu.port}", "--robot", f"rtde://{HOST}:{self.robot.port}",
            "-o", str(self.output), "--seconds", f"{self._seconds}", "--settings", str(cell / "recording.toml"),
            "--port", f"{port}", "--name", "west", *self._more,
        ]  # fmt: skip
        self._station = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        self.url = self._station.stdout.readline().strip()
        return int(self.url.rpartition(":")[2])

    def kill(self):
        """End the station as a power cut does, its worker too."""
        children = subprocess.run(
            ["ps", "-o", "pid=", "--ppid", f"{self._station.pid}"], capture_output=True, text=True
        )
        for pid in [self._station.pid, *map(int, children.stdout.split())]:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self._station.communicate()

    def end(self):
        self.release()
        if self._station is not None and self._station.poll() is None:
            self._station.terminate()
            self._station.communicate(timeout=30)
        for plug in (self.imu, self.robot):
            plug.close()


class Operator:
    """Somebody at the page, without a mouse."""

    def __init__(self, page, url):
        self.page = page
        page.goto(url)
        self.wait(lambda: self.word != "Connecting")

    @property
    def word(self):
        return self.page.locator("#word").inner_text()

    def scan(self, serial):
        """Type as a scanner does; the field has the focus."""
        self.page.keyboard.type(serial)
        self.page.keyboard.press("Enter")

    def press(self, key):
        self.page.keyboard.press(key)

    def busy(self):
        """Wait until an attempt is at work."""
        self.wait(lambda: self.word.startswith(BUSY))

    def again(self):
        self.press("F2")
        self.busy()

    def refusal(self):
        self.wait(lambda: self.page.locator("#refused").inner_text())
        return self.page.locator("#refused").inner_text()

    def recording(self, share=0.2):
        """Wait until a share of the recording is there."""
        bar = self.page.locator("#bar")
        self.wait(lambda: bar.is_visible() and float(bar.get_attribute("aria-valuenow") or 0) >= 100 * share)

    def result(self, unit):
        """Return the word that the page shows for a unit in the end."""
        self.wait(lambda: self.page.locator("#unit").inner_text() == unit and not self.word.startswith(BUSY))
        return self.word

    def wait(self, until, most=120.0):
        end = time.monotonic() + most
        while not until():
            assert time.monotonic() < end, f"in vain; the page shows {self.word!r}"
            self.page.wait_for_timeout(100)
