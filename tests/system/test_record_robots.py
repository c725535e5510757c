"""Controllers recorded over the loopback while everything goes wrong: what was lost, and what was said."""

import asyncio
import itertools
import re
import time

import numpy as np
import pytest

from kreisel.devices.simulators import Pace, TcpSimulator
from kreisel.formats.bag import load_bag
from kreisel.protocols import egm, line, rsi, rtde
from kreisel.protocols.samples import RobotSample

from .live import (
    CYCLE_NS,
    HOST,
    INTERVAL_NS,
    Enough,
    free_port,
    lines,
    paced,
    pose,
    reading,
    run,
    said,
    sending,
    serving,
    steady,
    times_said,
    with_robot,
)


def test_all_is_recorded_with_both_clocks(tmp_path):
    """The robot's clock goes with that of the IMU, so that both tell the same time however late they are."""
    sent = [0]

    def readings():
        for sent[0] in itertools.count():
            yield line.encode(reading(sent[0]))

    def poses():
        k = 0
        while True:
            due = k * CYCLE_NS <= sent[0] * INTERVAL_NS
            yield rsi.encode(pose(k)) if due else None
            k += due

    async def all_of_it():
        port = free_port()
        async with serving(lines(readings)) as imu_port, sending(port, poses(), interval=1e-3):
            return await run(tmp_path, imu_port, f"rsi://{HOST}:{port}")

    status, path = asyncio.run(all_of_it())
    recording = load_bag(path)
    k = np.arange(recording.imu.stamps_ns.size)
    assert status.imu.missing == status.robot.missing == 0
    assert np.array_equal(recording.imu.stamps_ns, 10**9 + INTERVAL_NS * (recording.imu.rates[:, 2] * 1e3).round())
    assert recording.imu.rates[0, 2] + 1e-3 * k == pytest.approx(recording.imu.rates[:, 2], abs=1e-12)
    assert k.size * INTERVAL_NS == pytest.approx(np.ptp(recording.reference.stamps_ns), rel=0.15)
    assert np.diff(recording.reference.stamps_ns) == pytest.approx(CYCLE_NS)
    assert recording.joints.angles[-1] == pytest.approx(recording.reference.positions[-1, [0] * 6], abs=2e-6)


def test_lost_datagrams_are_counted(tmp_path):
    rng = np.random.default_rng(1)
    sent = (rsi.encode(pose(k)) if rng.random() > 0.05 else None for k in itertools.count())
    status, path = with_robot(tmp_path, sent, seconds=2.0)
    recording = load_bag(path)
    steps = np.diff(recording.reference.stamps_ns) // CYCLE_NS
    assert 0.01 < np.mean(steps > 1) < 0.12
    assert status.robot.missing == pytest.approx(np.sum(steps - 1), abs=3)  # the first few tell the interval
    assert status.imu.missing == 0


def test_what_comes_twice_or_late_is_left_out(tmp_path):
    order = itertools.chain.from_iterable((k, k, k + 2, k + 1) for k in range(0, 10_000, 3))
    status, path = with_robot(tmp_path, (rsi.encode(pose(k)) for k in order))
    recording = load_bag(path)
    assert status.robot.late > 50
    assert np.all(np.diff(recording.reference.stamps_ns) > 0)


@pytest.mark.parametrize(
    ("rubbish", "complaint"),
    [
        (b"\x00\xff" * 30, "not UTF-8"),
        (b'<!DOCTYPE a [<!ENTITY b "c">]><Rob/>', "declaration"),
        (b"<Rob>" + b" " * 20_000 + b"</Rob>", "20011 bytes"),
        (b"<Rob><IPOC>12</IPOC></Rob>", "neither RIst nor AIPos"),
    ],
)
def test_rubbish_between_telegrams_costs_nothing(tmp_path, rubbish, complaint):
    sent = (part for k in itertools.count() for part in (rsi.encode(pose(k)), rubbish))
    status, path = with_robot(tmp_path, sent)
    said(status, complaint)
    assert len([note for note in status.notes if complaint in note]) <= 3  # told once a second
    assert np.diff(load_bag(path).reference.stamps_ns) == pytest.approx(CYCLE_NS)


def test_a_silent_controller_is_told_and_the_gap_marked(tmp_path):
    sent = (None if 100 <= k < 450 else rsi.encode(pose(k)) for k in itertools.count())
    status, path = with_robot(tmp_path, sent, seconds=2.5)
    said(status, "nothing is received")
    said(status, "messages are received again")
    said(status, "gap of 1.4")
    recording = load_bag(path)
    assert any("gap of 1.4" in warning.message for warning in recording.warnings)
    assert recording.reference.stamps_ns.size > 200


def test_a_controller_started_anew_has_a_topic_of_its_own(tmp_path):
    sent = (rsi.encode(pose(k) if k < 120 else pose(k - 120, 10**9)) for k in itertools.count())
    status, path = with_robot(tmp_path, sent)
    leap = float(next(found[1] for note in status.notes if (found := re.search(r"leapt by (-[\d.]+) s", note))))
    back = -119e-9 * CYCLE_NS - 4.0  # by the stamps; the host's clock went on meanwhile
    late = 0.2  # s, by which a telegram may arrive later than another on a busy machine
    assert back - status.seconds < leap < back + late
    assert status.robot.epoch == 2
    recording = load_bag(path)
    assert recording.reference.name == "/robot/pose"
    assert recording.reference.stamps_ns[-1] == pose(119).stamp_ns
    again = load_bag(path, reference="/robot/pose_2")
    assert again.reference.stamps_ns[0] == 10**9


def test_a_clock_that_leaps_forward_is_told(tmp_path):
    sent = (rsi.encode(pose(k) if k < 120 else pose(k, 500 * 10**9)) for k in itertools.count())
    status, _ = with_robot(tmp_path, sent)
    said(status, "leapt by +49")


def test_single_telegrams_of_another_clock_are_dropped(tmp_path):
    sent = (rsi.encode(pose(k, 500 * 10**9) if k % 50 in (48, 49) else pose(k)) for k in itertools.count())
    status, path = with_robot(tmp_path, sent)
    said(status, "readings dropped: stamps on another clock")
    assert status.robot.epoch == 1
    assert status.robot.odd >= 8
    assert load_bag(path).reference.stamps_ns[-1] < 10 * 10**9


@pytest.mark.parametrize("scheme", ["rsi", "egm"])
def test_telegrams_of_another_sender_are_dropped_and_reported(tmp_path, scheme):
    """Perfect ones, from another port of the same host, on the same clock, from another place."""
    encode = {"rsi": lambda sample, _: rsi.encode(sample), "egm": egm.encode}[scheme]

    def elsewhere(k):
        return encode(RobotSample(pose(k).stamp_ns + 1_000_000, (9.0, 9.0, 9.0), (1.0, 0.0, 0.0, 0.0), (0.5,) * 6), k)

    async def all_of_it():
        port = free_port()
        others = (None if k < 25 else elsewhere(k) for k in itertools.count())
        right = (encode(pose(k), k) for k in itertools.count())
        async with serving(lines(steady)) as imu_port, sending(port, right), sending(port, others):
            return await run(tmp_path, imu_port, f"{scheme}://{HOST}:{port}")

    status, path = asyncio.run(all_of_it())
    reports = [note for note in status.notes if "dropped" in note]
    assert "1 so far: this port accepts only 127.0.0.1:" in reports[0]
    assert len(reports) <= 3
    assert load_bag(path).reference.positions[:, 0].max() < 5.0
    assert np.all(np.diff(load_bag(path).reference.stamps_ns) == CYCLE_NS)


def test_only_the_kept_sender_is_answered(tmp_path):
    async def all_of_it():
        port, answers = free_port(), []

        class Other(asyncio.DatagramProtocol):
            def datagram_received(self, data, addr):
                answers.append(data)

        telegrams = (rsi.encode(pose(k)) for k in itertools.count())
        async with serving(lines(steady)) as imu_port, sending(port, telegrams):
            enough = Enough(0.5, with_robot=True)
            recording = asyncio.ensure_future(run(tmp_path, imu_port, f"rsi://{HOST}:{port}?answer=yes", enough=enough))
            await enough.heard.wait()
            transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(Other, remote_addr=(HOST, port))
            for k in range(20):
                transport.sendto(rsi.encode(pose(k)))
            await recording
            transport.close()
        return answers

    assert asyncio.run(all_of_it()) == []


def test_a_controller_restarted_on_another_port_is_taken_after_silence(tmp_path):
    async def all_of_it():
        port = free_port()
        async with serving(lines(steady)) as imu_port:
            recording = asyncio.ensure_future(run(tmp_path, imu_port, f"rsi://{HOST}:{port}", 4.0))
            async with sending(port, (rsi.encode(pose(k)) for k in itertools.count())):
                await asyncio.sleep(0.5)
            async with sending(port, (rsi.encode(pose(k, 10**9)) for k in itertools.count())):
                return await recording

    status, path = asyncio.run(all_of_it())
    (silent,) = times_said(status, r"was silent for (\S+) s; now 127\.0\.0\.1:")
    assert 2.0 <= silent < 4.0
    assert status.robot.epoch == 2
    assert load_bag(path, reference="/robot/pose_2").reference.stamps_ns[0] > 10**9


def test_datagrams_that_are_no_telegrams_do_not_hide_a_silent_controller(tmp_path):
    sent = (rsi.encode(pose(k)) if k < 100 else b"<Rob>" for k in itertools.count())
    status, _ = with_robot(tmp_path, sent, until="nothing is received")
    said(status, "nothing is received")


def test_egm_is_recorded_too(tmp_path):
    status, path = with_robot(tmp_path, (egm.encode(pose(k), k) for k in itertools.count()), "egm")
    assert status.robot.missing == 0
    assert load_bag(path).reference.positions[-1, 2] == 1.0


@pytest.mark.parametrize("answer", ["yes", "no"])
def test_answers_that_reach_the_controller_late_are_told(tmp_path, answer):
    """It counts them; who does not answer has none to lose."""
    late = (0 if k < 60 else 2 if k < 120 else 3 for k in itertools.count())
    datagrams = (rsi.encode(pose(k), missed) for k, missed in zip(itertools.count(), late))
    status, _ = with_robot(tmp_path, datagrams, options=f"?answer={answer}")
    told = [note for note in status.notes if "answers reached the controller late" in note]
    assert len(told) == (2 if answer == "yes" else 0)
    if told:
        assert "2 answers reached the controller late, 2 in all" in told[0]
        assert "1 answers reached the controller late, 3 in all" in told[1]
    assert status.robot.missing == 0


def test_rsi_is_answered_where_that_is_wanted(tmp_path):
    async def all_of_it():
        port, answers = free_port(), []

        class Controller(asyncio.DatagramProtocol):
            def datagram_received(self, data, addr):
                answers.append(rsi.decode_answer(data))

        async with serving(lines(steady)) as imu_port:
            loop = asyncio.get_running_loop()
            transport, _ = await loop.create_datagram_endpoint(Controller, remote_addr=(HOST, port))

            async def send():
                async for k in paced(range(10_000), CYCLE_NS * 1e-9):
                    transport.sendto(rsi.encode(pose(k)))

            task = asyncio.ensure_future(send())
            await run(tmp_path, imu_port, f"rsi://{HOST}:{port}?answer=yes", 0.5)
            task.cancel()
            transport.close()
        return answers

    answers = asyncio.run(all_of_it())
    assert np.all(np.diff(answers) == CYCLE_NS // 10**6)


def test_a_proxy_is_asked_for_poses(tmp_path):
    """The simulated one, whose poses move on by a millimetre every 4 ms."""

    async def all_of_it():
        proxy, imu, began = TcpSimulator("varproxy"), TcpSimulator("csv"), time.monotonic()
        ports = [await simulator.serve(HOST, 0) for simulator in (proxy, imu)]
        pace = Pace(lambda: began)
        playing = [
            asyncio.ensure_future(proxy.play((pose(k) for k in range(100_000)), pace)),
            asyncio.ensure_future(imu.play((reading(k) for k in range(100_000)), pace)),
        ]
        enough = Enough(0.5, poses=50)
        status, _ = await run(tmp_path, ports[1], f"varproxy://{HOST}:{ports[0]}?rate=100", enough=enough)
        for task, simulator in zip(playing, (proxy, imu), strict=True):
            task.cancel()
            simulator.close()
        await asyncio.sleep(0.05)  # for the transports to close
        return status

    status = asyncio.run(all_of_it())
    reference = load_bag(tmp_path / "run").reference
    assert status.robot.count >= 50
    assert np.quantile(np.diff(reference.stamps_ns), 0.1) < 20e6  # where the machine lets it
    moved = np.linalg.norm(reference.positions - reference.positions[0], axis=1)
    assert np.all(np.diff(moved) >= 0.0)
    assert moved[-1] > 0.05


@pytest.mark.parametrize(
    ("answer", "complaint"),
    [
        (rtde.package(ord("V"), b"\x00"), "refuses protocol version 2"),
        (b"\xff\xff\x00", "message of 65535 bytes"),
        (rtde.package(ord("S"), b"\x01"), "while waiting for version"),
    ],
)
def test_a_controller_that_refuses_is_told(tmp_path, answer, complaint):
    async def talk(reader, writer):
        await reader.read(4096)
        writer.write(answer)
        await asyncio.sleep(5.0)

    async def all_of_it():
        async with serving(talk) as robot_port, serving(lines(steady)) as imu_port:
            return await run(tmp_path, imu_port, f"rtde://{HOST}:{robot_port}", 0.8, until=complaint)

    status, path = asyncio.run(all_of_it())
    said(status, complaint)
    assert load_bag(path).imu.stamps_ns.size > 200  # the IMU is recorded all the while
