"""Advice for a calibration by hand: somebody who follows it gets an accepted result, and others are told why not."""

import itertools
import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from kreisel.calibration.device_axes import turned, upper_triangular
from kreisel.errors import SettingsError
from kreisel.recording.recording import ImuSamples, Recording
from kreisel.recording.recording_settings import RecordingSettings
from kreisel.simulation.standstills import GRAVITY, GRAVITY_SD, HandHeld
from kreisel.static.guide import HOLD, Guide
from kreisel.static.guide_plans import CANDIDATES, PLANS
from kreisel.static.static_result import calibrate_static
from kreisel.validation.checks import check_streams

SITE = RecordingSettings.model_validate({"site": {"gravity": GRAVITY, "gravity_sd": GRAVITY_SD}})


class Session:
    """A device, its readings so far, and a guide that sees them."""

    def __init__(self, targets=None, seed=1, **how):
        self.device = HandHeld("consumer-mems", np.random.default_rng(seed))
        self.guide = Guide(partial(calibrate_static, **how), targets, method=how.get("method"), only=how.get("only"))
        self.range = np.inf
        self.pieces = [self.device.hold(5.5)]

    def recording(self):
        w, a = (np.concatenate(part) for part in zip(*self.pieces, strict=True))
        w = np.clip(w, -self.range, self.range)
        stamps = np.round(np.arange(len(w)) * 1e9 / self.device.rate).astype(np.int64)
        return check_streams(Recording(Path("hand"), ImuSamples(stamps, w, a, Path("hand")), None, settings=SITE))

    def look(self, recording=None):
        recording = recording or self.recording()
        advice = self.guide.look(recording)
        if self.guide.due:
            self.guide.estimate(recording, advice)
            return self.guide.look(recording)
        return advice


def followed(session, most=40, obey=None):
    """Do what is asked for until it is enough; return the advice at each step."""
    obey = obey or (lambda advice: session.device.turn(advice.wanted))
    out = []
    for _ in range(most):
        session.pieces.append(session.device.hold(HOLD + 0.6))
        out.append(session.look())
        if out[-1].step == "done":
            break
        assert out[-1].step == "turn"
        session.pieces.append(obey(out[-1]))
        assert session.look().step != "done"
    return out


@pytest.mark.slow
def test_who_follows_it_gets_an_accepted_result_within_its_deviations():
    session = Session()
    steps = followed(session)
    assert steps[-1].step == "done"
    assert PLANS[None].standstills <= len(steps[-1].had) <= PLANS[None].standstills + 6
    calibration = session.guide.outcome.calibration
    assert calibration.accepted
    assert not calibration.verdict.unobservable
    true = turned(session.device.truth, upper_triangular(session.device.truth.K_a)[0], np.zeros(3))
    scores = np.abs((calibration.sensors.K_omega - true.K_omega) / calibration.sensor_sd.K_omega)
    assert scores.max() < 4.0
    assert 90.0 < session.recording().imu.seconds[-1] < 240.0  # minutes, not hours
    faces = np.array([step.wanted for step in steps[:5] if step.wanted is not None])
    assert (np.abs(faces).max(axis=1) > 0.99).all()  # faces come first


@pytest.mark.slow
def test_it_ends_when_what_is_asked_for_is_reached_and_not_before():
    loose, strict = (Session({"gyroscope.cross_coupling": sd}) for sd in (3e-3, 1e-5))
    steps = followed(loose)
    assert steps[-1].step == "done"
    assert steps[-1].known["gyroscope.cross_coupling"] <= 3e-3
    assert len(steps[-1].had) < PLANS[None].standstills
    assert all(step.step == "turn" for step in followed(strict, most=14))


def test_a_standstill_is_counted_down():
    session = Session()
    session.pieces.append(session.device.turn([1.0, 0.0, 0.0]))
    session.pieces.append(session.device.hold(1.6))
    advice = session.look()
    assert advice.step == "hold"
    assert "Hold still: 1." in advice.text
    assert 1.0 < advice.held < 2.1
    np.testing.assert_allclose(advice.up, [1.0, 0.0, 0.0], atol=0.25)


def test_a_vehicle_is_told_that_tilting_it_a_little_shows_nothing():
    session = Session()
    session.pieces = [session.device.turn([0.0, 0.0, 1.0])]
    rng = np.random.default_rng(2)
    for _ in range(10):
        session.pieces.append(session.device.hold(HOLD + 0.6))
        session.pieces.append(session.device.turn(np.array([0.0, 0.0, 1.0]) + rng.normal(0.0, 0.08, 3)))
    session.pieces.append(session.device.hold(HOLD + 0.6))
    advice = session.look()
    assert advice.step == "turn"
    assert "nearly alike" in advice.note
    assert np.arccos(advice.wanted @ [0.0, 0.0, 1.0]) > 0.3


def test_an_attitude_that_was_had_already_is_said():
    session = Session()
    for up in ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]):
        session.pieces += [session.device.turn(np.array(up)), session.device.hold(HOLD + 0.6)]
    assert session.look().note == "This attitude is one that you have had."


def test_what_is_asked_for_stays_while_the_device_turns_to_it():
    session = Session()
    for up in CANDIDATES[:10]:
        session.pieces += [session.device.turn(up), session.device.hold(HOLD + 0.6)]
    asked = session.look().wanted
    w, a = session.device.turn(asked)
    for share in (0.2, 0.5, 0.8):
        session.pieces.append((w[: int(share * len(w))], a[: int(share * len(w))]))
        advice = session.look()
        session.pieces.pop()
        if advice.wanted is not None:
            np.testing.assert_array_equal(advice.wanted, asked)


def test_rates_in_another_unit_stop_it_after_seven_attitudes():
    session = Session()
    texts = []
    for up in CANDIDATES[:9]:
        session.pieces += [session.device.turn(up), session.device.hold(HOLD + 0.6)]
        recording = session.recording()
        wrong = replace(recording.imu, rates=recording.imu.rates * np.pi / 180.0)
        texts.append(session.look(replace(recording, imu=wrong)).text)
    assert texts[4].startswith("Turn it")
    assert texts[-1].startswith("Stop, for more attitudes do not help")
    assert "are they in deg/s, and not in rad/s?" in texts[-1] or "deg/s" in texts[-1]


def test_directions_are_all_faces_edges_and_corners():
    assert len(CANDIDATES) == 26
    np.testing.assert_allclose(np.linalg.norm(CANDIDATES, axis=1), 1.0)
    assert min(np.linalg.norm(a - b) for a, b in itertools.combinations(CANDIDATES, 2)) > 0.5


@pytest.mark.parametrize("count", [0, 3])
def test_the_document_is_plain(count):
    session = Session()
    for up in np.eye(3)[:count]:
        session.pieces += [session.device.turn(up), session.device.hold(HOLD + 0.6)]
    advice = session.look()
    document = advice.document
    assert document["kind"] == "advice"
    assert all(isinstance(value, (str, float, list, dict, type(None))) for value in document.values())
    unknown = replace(advice, known={"accelerometer.lever_arms": np.inf, "gyroscope.offset": 1e-3}).document
    assert unknown["known"] == {"accelerometer.lever_arms": None, "gyroscope.offset": 1e-3}
    json.dumps(unknown, allow_nan=False)  # a browser reads no other numbers


def laid(session, ups):
    for up in ups:
        session.pieces += [session.device.turn(np.asarray(up)), session.device.hold(HOLD + 0.6)]


@pytest.mark.slow
def test_who_asks_for_accelerometers_alone_is_done_although_gyros_are_cut_off():
    session = Session(only="accelerometer")
    session.range = 1.0
    steps = followed(session)
    assert steps[-1].step == "done"
    assert set(steps[-1].known) == {"accelerometer.cross_coupling", "accelerometer.offset"}
    assert "turn more slowly" in steps[-2].note


@pytest.mark.slow
def test_six_positions_are_six_faces_and_each_of_them_twice():
    session = Session(method="six-position")
    steps = followed(session)
    assert steps[-1].step == "done"
    assert len(steps[-1].had) >= 12
    asked = np.array([step.wanted for step in steps[:-1]])
    assert (np.abs(asked).max(axis=1) > 0.99).all()
    assert session.guide.outcome.method == "six-position"


@pytest.mark.slow
def test_ferraris_asks_for_a_whole_turn_about_each_axis():
    session = Session(method="ferraris")
    asked = []

    def obey(advice):
        if "once round" not in advice.text:
            return session.device.turn(advice.wanted)
        asked.append(int(np.argmax(np.abs(advice.up))))
        return session.device.rotate(2.0 * np.pi * advice.up, 5.0)

    steps = followed(session, obey=obey)
    assert steps[-1].step == "done"
    assert set(asked) == {0, 1, 2}
    assert len(asked) <= 6
    assert session.guide.outcome.method == "ferraris"


def test_half_a_turn_instead_of_a_whole_one_is_said_and_another_face_is_next():
    session = Session(method="ferraris")
    laid(session, [[1.0, 0.0, 0.0]])
    texts = [session.look().text]
    for _ in range(3):
        up = session.look().up
        session.pieces += [session.device.rotate(np.pi * up, 3.0), session.device.hold(HOLD + 0.6)]
        texts.append(session.look().text)
    assert texts[0].startswith("Leave it on this face")
    assert "by 360 deg (that was about 180 deg)." in texts[1]
    assert texts[3].startswith("Turn it gently on its face")
    assert "nearly alike" not in session.look().note


def test_readings_that_do_not_change_are_said():
    session = Session()
    laid(session, np.eye(3)[:1])
    recording = session.recording()
    imu = recording.imu
    stamps = imu.stamps_ns[-1] + np.arange(1, 2401) * 5_000_000
    frozen = replace(
        imu, stamps_ns=np.concatenate([imu.stamps_ns, stamps]),
        rates=np.vstack([imu.rates, np.tile(imu.rates[-1], (2400, 1))]),
        accelerations=np.vstack([imu.accelerations, np.tile(imu.accelerations[-1], (2400, 1))]),
    )  # fmt: skip
    note = session.guide.look(replace(recording, imu=frozen)).note
    assert note == "All readings have been the same for 12 s: does the device still measure?"


@pytest.mark.slow
def test_a_hinge_is_turned_and_the_device_mounted_another_way():
    session = Session(method="hinge")
    axes = itertools.cycle(np.array([[1.0, 0.05, 0.02], [0.03, 1.0, -0.04], [-0.05, 0.02, 1.0]]))
    at = {"axis": next(axes)}

    def obey(advice):
        if "another of its axes" in advice.text:
            at["axis"] = next(axes)
            return session.device.turn(advice.up + np.roll(advice.up, 1))
        assert "by about 90 deg" in advice.text
        return session.device.rotate(0.5 * np.pi * at["axis"] / np.linalg.norm(at["axis"]), 2.0)

    steps = followed(session, obey=obey)
    assert steps[-1].step == "done"
    assert steps[-1].wanted is None
    assert session.guide.outcome.method == "hinge"


def test_a_hinge_along_the_same_axis_as_before_is_said():
    session = Session(method="hinge")
    texts = []
    for mounting in range(2):
        for _ in range(5):
            session.pieces.append(session.device.hold(HOLD + 0.6))
            texts.append(session.guide.look(session.recording()).text)
            session.pieces.append(session.device.rotate([0.0, 0.0, 0.5 * np.pi], 2.0))
        session.pieces[-1] = session.device.turn([1.0, 0.3 + mounting, 0.2])
    again = ["about the same of its axes as before" in text for text in texts]
    assert again == [False] * 6 + [True] * 3 + [False]
    assert "another of its axes" in texts[4]


def test_a_hand_that_sags_is_said_and_one_that_does_not_is_not():
    session = Session()
    laid(session, np.eye(3))
    assert "held still" not in session.look().note
    for up in np.eye(3):
        session.pieces += [session.device.turn(-up), session.device.rotate([8e-3, 8e-3, 8e-3], HOLD + 0.6)]
    session.pieces.append(session.device.turn([1.0, 1.0, 0.0]))
    note = session.look().note
    assert note.startswith("The device turns by ")
    assert 8.0 < float(note.split()[4]) < 13.0


def test_a_hand_that_is_too_restless_after_a_table_is_said():
    session = Session()
    laid(session, np.eye(3))
    rng = np.random.default_rng(7)
    session.pieces.append(session.device.turn([1.0, 1.0, 0.0]))
    for _ in range(60):
        session.pieces.append(session.device.rotate(rng.normal(0.0, 4e-3, 3), 0.1))
    assert session.look().note.startswith("It moves too much for a standstill")
    session.pieces.append(session.device.hold(HOLD))
    assert "moves too much" not in session.look().note


def test_a_face_that_is_laid_askew_is_said_and_asked_for_again_first():
    session = Session(method="six-position")
    faces = np.vstack([np.eye(3), -np.eye(3)])
    for k, up in enumerate(faces):
        askew = np.array([0.0, 0.4, 0.0]) if k == 3 else np.zeros(3)
        session.pieces += [session.device.turn(up + askew), session.device.hold(HOLD + 0.6)]
        advice = session.guide.look(session.recording())
        assert ("deg askew" in advice.note) == (k == 3)
    np.testing.assert_array_equal(advice.wanted, [-1.0, 0.0, 0.0])


def test_two_faces_in_turn_are_never_enough():
    session = Session()
    laid(session, 11 * [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    assert session.look().step == "turn"


def test_accelerometers_at_the_end_of_their_range_are_said():
    session = Session()
    laid(session, np.eye(3))
    recording = session.recording()
    clipped = replace(recording.imu, accelerations=np.clip(recording.imu.accelerations, -9.5, 9.5))
    assert "at the end of its range" in session.guide.look(replace(recording, imu=clipped)).note


def test_what_will_never_be_reached_is_said_and_what_takes_long_with_a_number():
    never, long = Session({"gyroscope.offset": 1e-9}), Session({"gyroscope.cross_coupling": 1e-4})
    for session in (never, long):
        laid(session, CANDIDATES[:18])
        session.note = session.look().note
    assert "times as uncertain as asked for, and further attitudes hardly lower" in never.note
    assert "attitudes more to be as accurate as asked for" in long.note


@pytest.mark.parametrize(
    ("targets", "how", "message"),
    [({"accelerometer.lever_arms": 1e-3}, {}, "not estimated here"),
     ({"gyroscope.offset": 1e-3}, {"only": "accelerometer"}, "not estimated here"),
     ({}, {"method": "turntable"}, "does not guide the method turntable")],
)  # fmt: skip
def test_what_it_cannot_guide_is_refused_before_the_recording(targets, how, message):
    with pytest.raises(SettingsError, match=message):
        Guide(calibrate_static, targets, **how)


def test_an_estimate_ends_when_its_progress_does():
    session = Session()
    laid(session, CANDIDATES[:7])
    recording = session.recording()
    advice = session.guide.look(recording)
    assert session.guide.due

    def stopped(step, share):
        raise InterruptedError

    with pytest.raises(InterruptedError):
        session.guide.estimate(recording, advice, stopped)
