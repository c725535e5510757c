"""Advice for a calibration by hand: somebody who follows it gets an accepted result, and others are told why not."""

import itertools
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kreisel.calibration.device_axes import turned, upper_triangular
from kreisel.recording.recording import ImuSamples, Recording
from kreisel.recording.recording_settings import RecordingSettings
from kreisel.simulation.standstills import GRAVITY, GRAVITY_SD, HandHeld
from kreisel.static.guide import CANDIDATES, ENOUGH, HOLD, Guide
from kreisel.validation.checks import check_streams

SITE = RecordingSettings.model_validate({"site": {"gravity": GRAVITY, "gravity_sd": GRAVITY_SD}})


class Session:
    """A device, its readings so far, and a guide that sees them."""

    def __init__(self, targets=None, seed=1):
        self.device = HandHeld("consumer-mems", np.random.default_rng(seed))
        self.guide = Guide(targets)
        self.pieces = [self.device.hold(5.5)]

    def recording(self):
        w, a = (np.concatenate(part) for part in zip(*self.pieces, strict=True))
        stamps = np.round(np.arange(len(w)) * 1e9 / self.device.rate).astype(np.int64)
        return check_streams(Recording(Path("hand"), ImuSamples(stamps, w, a, Path("hand")), None, settings=SITE))

    def look(self):
        return self.guide.look(self.recording())


def followed(session, most=40):
    """Do what is asked for until it is enough; return the advice at each step."""
    out = []
    for _ in range(most):
        session.pieces.append(session.device.hold(HOLD + 0.6))
        out.append(session.look())
        if out[-1].step == "done":
            break
        assert out[-1].step == "turn"
        session.pieces.append(session.device.turn(out[-1].wanted))
        assert session.look().step != "done"
    return out


@pytest.mark.slow
def test_who_follows_it_gets_an_accepted_result_within_its_deviations():
    session = Session()
    steps = followed(session)
    assert steps[-1].step == "done"
    assert ENOUGH <= len(steps[-1].had) <= ENOUGH + 6
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
    assert len(steps[-1].had) < ENOUGH
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
        texts.append(session.guide.look(replace(recording, imu=wrong)).text)
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
