"""A Universal Robots controller with faults, on raw sockets: it shares no code with the package.

Ports for RTDE, scripts and the dashboard, and an IMU that sends lines of text. One thread moves the arm; joints turn at
constant speed. What it was told is in `told`, with the time.

On a busy machine the threads run late. Joints, stamps and readings then are those of the time that has passed, as those
of a real arm are: fewer of them are sent, and the motion takes as long as ever. Tests wait for what they need to see.
"""

import math
import re
import socket
import struct
import threading
import time
from contextlib import suppress

HOST = "127.0.0.1"
TICK = 0.008
LIMIT = 150.0
"""Seconds after which what is waited for is taken not to come; reached by failures alone."""

UR10E = ((0.1807, 0.0, math.pi / 2), (0.0, -0.6127, 0.0), (0.0, -0.57155, 0.0), (0.17415, 0.0, math.pi / 2),
         (0.11985, 0.0, -math.pi / 2), (0.11655, 0.0, 0.0))  # fmt: skip
UR5E = ((0.1625, 0.0, math.pi / 2), (0.0, -0.425, 0.0), (0.0, -0.3922, 0.0), (0.1333, 0.0, math.pi / 2),
        (0.0997, 0.0, -math.pi / 2), (0.0996, 0.0, 0.0))  # fmt: skip
"""Denavit-Hartenberg parameters d, a, alpha, as the maker publishes them."""

TYPES = {
    "timestamp": ("DOUBLE", "d"), "actual_q": ("VECTOR6D", "6d"), "actual_TCP_pose": ("VECTOR6D", "6d"),
    "safety_status": ("INT32", "i"), "safety_mode": ("INT32", "i"), "robot_mode": ("INT32", "i"),
    "runtime_state": ("UINT32", "I"),
}  # fmt: skip
GUARD = re.compile(r'\s*rtde_set_watchdog\("input_int_register_(\d+)",\s*([\d.]+),\s*"stop"\)')
MOVE = re.compile(r"\s*movej\(\[([^\]]+)\],\s*a=([\d.]+),\s*v=([\d.]+)\)")


def times(a, b):
    return [[sum(a[i][k] * b[k][j] for k in range(4)) for j in range(4)] for i in range(4)]


def tool_frame(q, table):
    """Return the flange's frame, 4 x 4."""
    T = [[float(i == j) for j in range(4)] for i in range(4)]
    for angle, (d, a, alpha) in zip(q, table, strict=True):
        c, s, ca, sa = math.cos(angle), math.sin(angle), math.cos(alpha), math.sin(alpha)
        T = times(T, [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1.0]])
    return T


def tool_pose(q, table):
    """Return position and rotation vector of the flange."""
    T = tool_frame(q, table)
    return [T[0][3], T[1][3], T[2][3], *rotation_vector(T)]


def turned(before, after, seconds):
    """Return the angular rate between two frames, rad/s, in the axes of the first."""
    R = [[sum(before[k][i] * after[k][j] for k in range(3)) for j in range(3)] for i in range(3)]
    return [x / seconds for x in rotation_vector(R)]


def rotation_vector(R):
    """Return the rotation vector of a rotation matrix, by its largest column of the quaternion's outer product."""
    trace = R[0][0] + R[1][1] + R[2][2]
    outer = [
        [1 + trace, R[2][1] - R[1][2], R[0][2] - R[2][0], R[1][0] - R[0][1]],
        [R[2][1] - R[1][2], 1 + 2 * R[0][0] - trace, R[0][1] + R[1][0], R[0][2] + R[2][0]],
        [R[0][2] - R[2][0], R[0][1] + R[1][0], 1 + 2 * R[1][1] - trace, R[1][2] + R[2][1]],
        [R[1][0] - R[0][1], R[0][2] + R[2][0], R[1][2] + R[2][1], 1 + 2 * R[2][2] - trace],
    ]
    w, *axis = max(outer, key=lambda row: sum(x * x for x in row))
    w, axis = (w, axis) if w >= 0.0 else (-w, [-x for x in axis])
    length = math.sqrt(sum(x * x for x in axis))
    scale = 2.0 * math.atan2(length, w) / length if length > 1e-12 else 0.0
    return [scale * x for x in axis]


class UrSimulator:
    """The controller.

    Parameters
    ----------
    joints_deg
        Where the arm stands at first.
    offered
        RTDE fields it has besides the first three.
    robot
        Denavit-Hartenberg parameters of the real arm.
    deaf
        Connections for scripts, counted from 0, on which stops are ignored; "all" for every one, the dashboard, and
        watchdogs.
    dashboard
        Whether there is a dashboard server.
    pieces
        Whether the state on the script port comes in pieces of a few bytes, at odd times.
    delay
        Seconds before a move begins.
    frozen, factor, gyro_offset, held_imu, in_turn, foreign
        Set by a test: joint angles that are reported whatever the arm does; a factor on the speed of moves; rad/s
        of the gyro x; whether the
        IMU is held still instead of being on the flange; whether joints turn one after another;
        whether the controller goes on with another program.
    patience
        Seconds that its watchdogs wait besides: the client shares the machine, and may be late where that is busy.
        Tests of watchdogs give none.
    registers
        Integer registers that a client may write, and those that another client writes already ("in use").
    """

    def __init__(self, joints_deg, *, offered=tuple(TYPES)[3:], robot=UR10E, deaf=(), dashboard=True, pieces=False,
                 delay=0.0, registers=range(48), in_use=(), patience=0.5):  # fmt: skip
        self.told = []
        self.q = [math.radians(a) for a in joints_deg]
        self.safety, self.program = 1, 1
        self.script_state = (0, 0)  # emergency, protective
        self.silent = self.cut = False
        self.frozen = None
        self.factor, self.gyro_offset = 1.0, 0.0
        self.held_imu = self.in_turn = self.foreign = False
        self.ticks = 0
        self._offered, self._robot, self._deaf, self._pieces, self._delay = offered, robot, deaf, pieces, delay
        self._target, self._speed, self._begins = None, 0.0, 0.0
        self.barked = []
        self._registers, self._in_use, self._patience = registers, in_use, patience
        self._written, self._guards, self._pending = {}, {}, {}
        self._over = threading.Event()
        self._now = time.monotonic()
        self._booted = self._now - 5.0
        self._streams, self._scripts, self._sockets = {}, [], []
        self._listeners = {name: self._listen(name) for name in ("rtde", "script", "imu")}
        port = self._listen("dashboard").getsockname()[1] if dashboard else self._free_port()
        ports = {name: of.getsockname()[1] for name, of in self._listeners.items()}
        self.robot = f"rtde://{HOST}:{ports['rtde']}?rate=125&script={ports['script']}&dashboard={port}"
        self.imu = f"csv://{HOST}:{ports['imu']}"
        self._start(self._live)

    # what a test does

    def moves(self):
        return [line for _, _, line in self.told if line.startswith("movej")]

    def wait_for_move(self, number, angle_deg=1.0):
        """Wait until so many moves were sent, and the arm has turned on the last one."""
        self.wait(lambda: len(self.moves()) >= number)
        begun = list(self.q)
        self.wait(lambda: max(abs(a - b) for a, b in zip(self.q, begun, strict=True)) > math.radians(angle_deg))

    def wait(self, done, seconds=LIMIT):
        ends = time.monotonic() + seconds
        while not done():
            assert time.monotonic() < ends, f"not within {seconds} s; told: {self.told}"
            time.sleep(0.005)

    def wait_for_ticks(self, count, seconds=0.0):
        """Wait until the arm has lived for so many ticks from now on, and so much time has passed."""
        begun, ends = self.ticks, time.monotonic() + seconds
        self.wait(lambda: self.ticks >= begun + count and time.monotonic() >= ends)

    def told_to_stop(self):
        """Return the times of the stops by script that it was told."""
        return [at for at, _, line in self.told if line.startswith("stopj")]

    def close_scripts(self, *, listen=True):
        """Close the connections for scripts; the arm goes on."""
        if not listen:
            self._close(self._listeners["script"])
        for connection in list(self._scripts):  # the client may already open the next one
            self._close(connection)

    def close_rtde(self):
        self._close(self._listeners["rtde"])
        for connection in list(self._streams):
            self._close(connection)

    def halt(self):
        """Stop the arm as the controller does by itself."""
        self._target, self.program = None, 1

    def dwell(self, seconds):
        """Stand for so long in the move under way."""
        self._begins = time.monotonic() + seconds

    def push(self, joints_deg, speed=0.5):
        """Move the arm as somebody else's program does, rad/s."""
        self._speed, self._begins = speed, 0.0
        self._target = [math.radians(a) for a in joints_deg]

    def close(self):
        self._over.set()
        for one in self._sockets:
            self._close(one)

    # the controller

    def _live(self):
        while not self._over.wait(TICK):
            before, now = self._now, time.monotonic()
            self._watch(now)
            self._now, target = now, self._target
            if target is not None and now >= self._begins:
                far = max(abs(b - a) for a, b in zip(self.q, target, strict=True))
                share = (
                    min(1.0, self.factor * self._speed * (now - max(before, self._begins)) / far) if far > 0.0 else 1.0
                )
                if self.in_turn:
                    k = next((i for i, (a, b) in enumerate(zip(self.q, target, strict=True)) if abs(b - a) > 1e-9), 0)
                    step = self._speed * (now - max(before, self._begins))
                    left = target[k] - self.q[k]
                    self.q[k] += math.copysign(min(abs(left), step), left)
                    share = 0.0 if any(abs(b - a) > 1e-9 for a, b in zip(self.q, target, strict=True)) else 1.0
                else:
                    self.q = [a + share * (b - a) for a, b in zip(self.q, target, strict=True)]
                if share == 1.0:
                    self._target, self.program = None, 1
            if not self.silent and not self.cut:
                for connection, fields in list(self._streams.items()):
                    self._quietly(connection, self._package(ord("U"), b"\x01" + self._values(fields)))
            self.ticks += 1

    def _watch(self, now):
        """Stop the program whose register was not written in time; watchdogs end with their program."""
        if self._target is None or self._deaf == "all":
            self._guards = {}
        if now - self._now > 5.0 * TICK:  # this thread was late: the one that reads comes first
            self._written = dict.fromkeys(self._written, now)
        for register, (least, since) in list(self._guards.items()):
            if now - max(since, self._written.get(register, -math.inf)) > 1.0 / least + 2.0 * TICK + self._patience:
                self.barked.append(now)
                self.halt()
                self._guards = {}

    def _values(self, fields):
        known = {
            "timestamp": [self._now - self._booted], "actual_q": self.frozen or self.q,
            "actual_TCP_pose": tool_pose(self.frozen or self.q, self._robot),
            "safety_status": [self.safety], "safety_mode": [self.safety], "robot_mode": [7],
            "runtime_state": [2 if self.foreign else self.program],
        }  # fmt: skip
        return b"".join(struct.pack(">" + TYPES[name][1], *known[name]) for name in fields)

    def _rtde(self, connection):
        buffer, fields, numbers = b"", [], []
        while data := connection.recv(4096):
            if self.cut:
                continue
            buffer += data
            while len(buffer) >= 3 and len(buffer) >= (size := struct.unpack(">H", buffer[:2])[0]):
                kind, payload, buffer = buffer[2:3], buffer[3:size], buffer[size:]
                if kind == b"V":
                    answer = b"\x01" if payload == b"\x00\x02" else b"\x00"
                elif kind == b"O":
                    fields = payload[8:].decode().split(",")
                    has = [name in tuple(TYPES)[:3] or name in self._offered for name in fields]
                    types = [TYPES[name][0] if known else "NOT_FOUND" for name, known in zip(fields, has, strict=True)]
                    answer = (b"\x01" if all(has) else b"\x00") + ",".join(types).encode()
                elif kind == b"I":
                    names = payload.decode().split(",")
                    numbers = [int(name.removeprefix("input_int_register_")) for name in names]
                    types = [
                        "IN_USE" if n in self._in_use else "INT32" if n in self._registers else "NOT_FOUND"
                        for n in numbers
                    ]
                    answer = (b"\x01" if set(types) == {"INT32"} else b"\x00") + ",".join(types).encode()
                elif kind == b"U":
                    recipe, *values = struct.unpack(f">B{len(numbers)}i", payload)
                    assert recipe == 1
                    changed = dict.fromkeys(numbers, time.monotonic())
                    self._written.update(changed)
                    assert len(values) == len(changed)
                    continue
                elif kind == b"S":
                    answer = b"\x01"
                connection.sendall(self._package(kind[0], answer))
                if kind == b"S":
                    self._streams[connection] = fields

    def _script(self, connection):
        number = len(self._scripts)
        self._scripts.append(connection)
        self._start(self._tell_state, connection)
        buffer = b""
        while data := connection.recv(4096):
            if self.cut:
                continue
            buffer += data
            *lines, buffer = buffer.split(b"\n")
            for line in lines:
                self._obey(line.decode(), number)

    def _obey(self, line, number):
        if line.strip() in ("end", "") or line.startswith("def "):
            return
        if guard := GUARD.match(line):
            self._pending[number] = (int(guard[1]), float(guard[2]))
            return
        self.told.append((time.monotonic(), number, line))
        found = MOVE.match(line)
        watched = self._pending.pop(number, None)
        if found and self.safety == 1:
            self._guards = {} if watched is None else {watched[0]: (watched[1], time.monotonic())}
            self._speed, self._begins = float(found[3]), time.monotonic() + self._delay
            self._target, self.program = [float(x) for x in found[1].split(",")], 2
        elif line.startswith("stopj") and self._deaf != "all" and number not in self._deaf:
            self.halt()

    def _tell_state(self, connection):
        while not self._over.wait(0.1):
            if self.cut:
                continue
            emergency, protective = self.script_state
            mode = struct.pack(">Q7B2B3d", 10**6, 1, 1, 1, emergency, protective, 0, 0, 7, 0, 1.0, 1.0, 1.0)
            part = struct.pack(">IB", 5 + len(mode), 0) + mode
            other = struct.pack(">IB", 5 + 40, 5) + bytes(40)
            data = struct.pack(">IB", 5 + len(other) + len(part), 16) + other + part
            pieces = [data[at : at + 7] for at in range(0, len(data), 7)] if self._pieces else [data]
            for piece in pieces:
                if not self._quietly(connection, piece):
                    return
                time.sleep(0.003 if self._pieces else 0.0)

    def _take_dashboard(self, connection):
        connection.sendall(b"Connected: Universal Robots Dashboard Server\n")
        for line in connection.makefile("rb"):
            self.told.append((time.monotonic(), "dashboard", line.decode().strip()))
            if line.strip() == b"stop" and self._deaf != "all":
                self.halt()
                connection.sendall(b"Stopped\n")
            else:
                connection.sendall(b"Failed to execute: stop\n")

    def _send_imu(self, connection):
        connection.sendall(b"#t [ns],w_x [rad/s],w_y,w_z,a_x [m/s^2],a_y,a_z\n")
        at, frame = time.monotonic(), tool_frame(self.q, self._robot)
        while not self._over.wait(0.01):
            if self.cut:
                continue
            before, earlier = frame, at
            at, frame = time.monotonic(), tool_frame(self.q, self._robot)
            k = round((at - self._booted) * 1e2)
            rate = [0.0] * 3 if self.held_imu else turned(before, frame, at - earlier)
            values = [
                w + 1e-4 * math.sin(k + phase)
                for phase, w in enumerate([rate[0] + self.gyro_offset, *rate[1:], 0.0, 0.0, 9.8])
            ]
            stamp = round((at - self._booted) * 1e9)
            connection.sendall(f"{stamp},{','.join(map(str, values))}\n".encode())

    # sockets

    def _listen(self, name):
        listener = socket.create_server((HOST, 0))
        self._sockets.append(listener)
        serve = {"rtde": self._rtde, "script": self._script, "imu": self._send_imu, "dashboard": self._take_dashboard}

        def accept():
            with suppress(OSError):
                while True:
                    connection, _ = listener.accept()
                    self._sockets.append(connection)
                    self._start(serve[name], connection)

        threading.Thread(target=accept, daemon=True).start()
        return listener

    def _start(self, target, *arguments):
        def quietly():
            with suppress(OSError):
                target(*arguments)

        threading.Thread(target=quietly, daemon=True).start()

    def _quietly(self, connection, data):
        try:
            connection.sendall(data)
        except OSError:
            self._streams.pop(connection, None)
            return False
        return True

    @staticmethod
    def _close(one):
        with suppress(OSError):
            one.shutdown(socket.SHUT_RDWR)
        one.close()

    @staticmethod
    def _package(kind, payload):
        return struct.pack(">HB", 3 + len(payload), kind) + payload

    @staticmethod
    def _free_port():
        with socket.socket() as probe:
            probe.bind((HOST, 0))
            return probe.getsockname()[1]
