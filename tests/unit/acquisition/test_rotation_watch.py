"""The IMU against the joints; the clock is the test's, and the IMU turns as the flange of the model does."""

import numpy as np
import pytest

from kreisel.acquisition.rotation_watch import RotationWatch
from kreisel.robot.kinematics import load_arm, motion

ARM = load_arm("ur10e")
HERE = np.radians([0.0, -90.0, 60.0, -60.0, -90.0, 0.0])
WAY = np.array([1.0, 0.2, -0.3, 0.4, 0.1, -0.5])
OFFSET = np.array([0.3, -0.03, 0.02])
"""rad/s; of a cheap gyro: 17 deg/s."""


class Cell:
    """Joints that turn at `speed` along `WAY`, and an IMU with an offset, late by some milliseconds."""

    def __init__(self, late=0.0, scale=1.0):
        self.watch, self.t, self.angle, self.speed, self.frozen = RotationWatch(ARM), 10.0, 0.0, 0.0, None
        self._late, self._scale, self._generator = late, scale, np.random.default_rng(4)

    def run(self, seconds):
        for _ in range(round(seconds / 0.004)):
            self.t += 0.004
            self.angle += 0.004 * self.speed
            joints = HERE + self.angle * WAY
            w = motion(ARM, joints[None], (self.speed * WAY)[None], np.zeros((1, 6))).rates[0]
            reading = self._scale * w + OFFSET + 2e-3 * self._generator.normal(size=3)
            at = round((self.t + self._late) * 1e9)
            self.watch.reading(at, round(self.t * 1e9), tuple(reading))
            told = joints if self.frozen is None else self.frozen
            self.watch.pose(round(self.t * 1e9), round(self.t * 1e9), tuple(told))

    def still(self):
        return self.watch.still(round(self.t * 1e9), 0.5)


@pytest.mark.parametrize(("late", "scale"), [(0.0, 1.0), (0.03, 1.1), (-0.03, 0.9)])
def test_an_imu_on_the_arm_agrees_however_it_moves(late, scale):
    cell = Cell(late, scale)
    cell.run(2.0)
    assert cell.still() is True  # a rate that does not change, before the offset is known
    cell.watch.learn_offset(0.5)
    for speed in (0.2, 0.0, 1.5, -1.5, 0.0, 0.7):
        cell.speed = speed
        cell.run(1.0)
        assert cell.watch.complaint is None
    assert not cell.watch.loose
    cell.speed = 0.0
    cell.run(1.0)
    assert cell.still() is True


def test_frozen_joints_are_noticed_within_a_third_of_a_second():
    cell = Cell()
    cell.run(2.0)
    cell.watch.learn_offset(0.5)
    cell.speed = 1.0
    cell.run(1.0)
    cell.frozen = HERE + cell.angle * WAY
    cell.run(0.34)
    assert "are the reported angles frozen" in cell.watch.complaint
    assert cell.still() is False


def test_joints_that_freeze_in_a_slow_move_are_noticed_after_a_few_degrees():
    cell = Cell()
    cell.run(2.0)
    cell.watch.learn_offset(0.5)
    cell.speed = 0.05
    cell.run(4.0)
    assert cell.watch.complaint is None
    cell.frozen = HERE + cell.angle * WAY
    cell.run(2.0)
    assert "are the reported angles frozen" in cell.watch.complaint


def test_vibration_and_sway_are_no_rotation():
    cell = Cell()
    cell.run(2.0)
    cell.watch.learn_offset(0.5)
    take = cell.watch.reading

    def shaken(host_ns, stamp_ns, rate):
        t = stamp_ns * 1e-9
        sway = 0.019 * np.sin(2 * np.pi * 3.0 * t) + 0.08 * np.sin(2 * np.pi * 45.0 * t)
        take(host_ns, stamp_ns, (rate[0], rate[1] + sway, rate[2]))

    cell.watch.reading = shaken
    for speed in (0.0, 0.05, 0.0, 0.7, 0.0):
        cell.speed = speed
        cell.run(2.5)
        assert cell.watch.complaint is None


class Bursts(Cell):
    """The same over networks that deliver each stream in bursts of so many seconds."""

    def __init__(self, of_imu=0.0, of_joints=0.0):
        super().__init__()
        self._every, self._held = {"imu": of_imu, "joints": of_joints}, {"imu": [], "joints": []}
        self._take = {"imu": self.watch.reading, "joints": self.watch.pose}
        self.watch.reading = lambda _, stamp, rate: self._keep("imu", stamp, rate)
        self.watch.pose = lambda _, stamp, joints: self._keep("joints", stamp, joints)

    def _keep(self, what, *content):
        held = self._held[what]
        held.append(content)
        if content[0] - held[0][0] >= self._every[what] * 1e9:
            for one in held:
                self._take[what](round(self.t * 1e9), *one)
            held.clear()


@pytest.mark.parametrize("bursts", [(0.0, 0.1), (0.0, 0.15), (0.15, 0.0), (0.1, 0.12)])
def test_bursts_neither_alarm_nor_hide_frozen_joints(bursts):
    cell = Bursts(*bursts)
    cell.run(2.0)
    cell.watch.learn_offset(0.5)
    for speed in (0.2, 0.0, 1.5, -1.5, 0.0, 1.0):
        cell.speed = speed
        cell.run(1.0)
        assert cell.watch.complaint is None
    cell.frozen = HERE + cell.angle * WAY
    cell.run(0.6)
    assert "are the reported angles frozen" in cell.watch.complaint


def test_joints_that_come_later_from_a_moment_on_are_compared_with_their_own_time():
    """A lag of 0.3 s that begins in mid-run, as of a congested network."""
    cell = Cell()
    cell.run(2.0)
    cell.watch.learn_offset(0.5)
    take = cell.watch.pose
    late = []

    def pose(host_ns, stamp_ns, joints):
        late.append((stamp_ns, joints))
        while late and late[0][0] <= host_ns - 300_000_000:
            take(host_ns, *late.pop(0))

    cell.watch.pose = pose
    for speed in (0.0, 0.7, 0.0, -0.7, 0.0):
        cell.speed = speed
        cell.run(1.2)
        assert cell.watch.complaint is None
    assert not cell.watch.loose


def test_an_imu_that_hangs_after_it_agreed_is_a_fault_and_not_loose():
    cell = Cell()
    cell.run(2.0)
    cell.watch.learn_offset(0.5)
    cell.speed = 0.5
    cell.run(2.5)
    cell._scale = 0.0
    cell.run(2.0)
    assert "though it turned with them before" in cell.watch.complaint
    assert not cell.watch.loose


def test_an_imu_that_lies_beside_the_arm_is_no_witness():
    cell = Cell(scale=0.0)
    cell.run(2.0)
    cell.watch.learn_offset(0.5)
    assert cell.still() is True
    cell.speed = 0.3
    cell.run(2.0)
    assert cell.watch.loose
    assert cell.still() is None
    assert cell.watch.complaint is None


def test_what_is_not_heard_is_not_known():
    watch = RotationWatch(ARM)
    assert watch.still(10**9, 0.5) is None
    assert watch.mean_speed(10**9, 0.1) == 0.0


def test_a_swing_is_no_standstill():
    """Four times a second: its mean rate over the time of a standstill is zero."""
    cell = Cell()
    cell.run(2.0)
    cell.watch.learn_offset(0.5)
    cell.frozen = HERE
    for k in range(100):
        cell.speed = 1.0 if (k // 12) % 2 else -1.0
        cell.run(0.01)
    assert cell.still() is False
