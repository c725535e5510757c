"""What is seen of an arm: whether it stands, and what is missing. The clock is the test's."""

import numpy as np
import pytest

from kreisel.acquisition.motion_watch import Watch
from kreisel.devices.events import Arrival
from kreisel.protocols.samples import ImuSample, RobotSample
from kreisel.robot.kinematics import load_arm

ARM = load_arm("ur10e")
HERE = np.radians([0.0, -90.0, 60.0, -60.0, -90.0, 0.0])
STEP_NS = 8_000_000


class Seen:
    """A watch with a clock of its own, and joints that are given as functions of time."""

    def __init__(self):
        self.now_ns = 10**12
        self.watch = Watch(ARM, lambda: self.now_ns)

    def imu(self):
        self.watch.take(Arrival(ImuSample(self.now_ns, (0.0, 0.0, 0.0), (0.0, 0.0, 9.8)), self.now_ns))

    def pose(self, joints, stamp_ns=None, **more):
        stamp_ns = self.now_ns if stamp_ns is None else stamp_ns
        self.watch.take(Arrival(RobotSample(stamp_ns, None, None, tuple(joints), **more), self.now_ns))

    def play(self, seconds, joints, **more):
        for k in range(round(seconds * 1e9 / STEP_NS)):
            self.now_ns += STEP_NS
            self.imu()
            self.pose(joints(k * STEP_NS * 1e-9), **more)


def still(_):
    return HERE


def test_joints_that_stand_are_seen_after_the_time_asked_for():
    seen = Seen()
    seen.play(0.4, still)
    assert not seen.watch.stands(0, 0.5)
    seen.play(0.2, still)
    assert seen.watch.stands(0, 0.5)
    assert not seen.watch.stands(seen.now_ns - 300_000_000, 0.5)  # not since the stop was sent


@pytest.mark.parametrize("rate", [3.0, 0.1, 5e-4])
def test_joints_that_move_do_not_stand_however_slowly(rate):
    """The slowest program is 0.05 rad/s at a hundredth."""
    seen = Seen()
    seen.play(2.0, lambda t: HERE + rate * t * np.array([0, 0, 0, 0, 0, 1]))
    assert not seen.watch.stands(0, 0.5)


def test_joints_with_the_noise_of_encoders_stand():
    rng, seen = np.random.default_rng(1), Seen()
    seen.play(2.0, lambda _: HERE + 2e-5 * rng.standard_normal(6))
    assert seen.watch.stands(0, 0.5)


def test_readings_that_were_held_up_and_come_together_do_not_show_that_it_stands():
    seen = Seen()
    for k in range(200):
        seen.pose(HERE, 10**9 + k * STEP_NS)
    assert not seen.watch.stands(0, 0.5)


def test_a_stream_that_has_ended_shows_nothing():
    seen = Seen()
    seen.play(2.0, still)
    seen.now_ns += 400_000_000
    assert not seen.watch.hears()
    assert not seen.watch.stands(0, 0.5)


@pytest.mark.parametrize(
    ("missing", "words"), [("pose", "no joint angles for 1.6 s"), ("imu", "no readings of the IMU")]
)
def test_a_device_that_brings_nothing_any_more_is_a_reason_to_stop(missing, words):
    seen = Seen()
    seen.play(0.1, still)
    assert seen.watch.reason is None
    for _ in range(200):
        seen.now_ns += STEP_NS
        if missing == "imu":
            seen.pose(HERE)
        else:
            seen.imu()
    assert words in seen.watch.reason


def test_a_clock_of_the_robot_that_leaps_is_a_reason_to_stop():
    seen = Seen()
    seen.play(0.1, still)
    seen.pose(HERE, 5)
    assert "was its controller restarted" in seen.watch.reason


def test_another_number_of_joints_than_the_models_is_a_reason_to_stop():
    seen = Seen()
    seen.pose([0.0] * 7)
    assert seen.watch.alarm == "the robot reports 7 joint angles, and the model has 6 joints"


def test_a_move_that_the_controller_ends_is_seen_once_the_arm_stands():
    seen = Seen()
    seen.watch.begin_move()
    seen.play(2.0, still, running=False)
    assert not seen.watch.ended()  # it has not begun
    seen.play(0.5, still, running=True)
    seen.play(0.9, still, running=False)
    assert not seen.watch.ended()
    seen.play(0.3, still, running=False)
    assert seen.watch.ended()
    seen.watch.begin_move()
    assert not seen.watch.ended()


def test_a_controller_that_does_not_report_its_program_ends_no_move():
    seen = Seen()
    seen.watch.begin_move()
    seen.play(5.0, still)
    assert not seen.watch.ended()
