"""Other people's clients against our simulators, over the loopback. They are extras: `pip install 'kreisel[peers]'`."""

import asyncio
import shutil
import socket
import subprocess
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from tests.system.live import Enough, free_port, record_until

from kreisel.acquisition.virtual_cell import running
from kreisel.devices.ros2_simulator import free_domain
from kreisel.devices.simulators import Pace, TcpSimulator, play_datagrams
from kreisel.errors import DeviceError
from kreisel.formats.bag import load_bag
from kreisel.protocols import varproxy
from kreisel.protocols.samples import ImuSample, RobotSample
from kreisel.recording.recording import ImuSamples, JointAngles, Recording, ReferencePoses

HOST = "127.0.0.1"
LIMIT = 60.0
"""Seconds after which what is waited for is taken not to come; reached by failures alone."""

pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
"""Clients of others leave sockets open."""


def poses(count, interval_ns):
    for k in range(count):
        angle = 1e-3 * k
        q = (np.cos(0.5 * angle), 0.0, 0.0, np.sin(0.5 * angle))
        yield RobotSample(
            10**9 + k * interval_ns, (0.1 + 1e-4 * k, 0.2, 0.3), tuple(map(float, q)), (angle, -1.0, 1.0, 0.0, 0.5, 0.0)
        )


def readings(count, interval_ns):
    for k in range(count):
        yield ImuSample(10**9 + k * interval_ns, (1e-3 * k, 0.25, -0.5), (0.0, 1e-2 * k, 9.75))


@pytest.fixture
def background():
    """Run coroutines in a thread with a loop of its own."""
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever, daemon=True)
    thread.start()
    yield lambda coroutine: asyncio.run_coroutine_threadsafe(coroutine, loop)

    async def end():
        others = [task for task in asyncio.all_tasks() if task is not asyncio.current_task()]
        for task in others:
            task.cancel()
        await asyncio.gather(*others, return_exceptions=True)
        await asyncio.sleep(0.05)  # for transports to close
        loop.stop()

    asyncio.run_coroutine_threadsafe(end(), loop)
    thread.join()
    loop.close()


class Begin:
    """A beginning that comes with the first client."""

    def __init__(self):
        self.at = None

    def __call__(self):
        self.at = self.at or time.monotonic() + 0.3


def test_ur_rtde_receives_from_the_twin_at_500_hz():
    rtde_receive = pytest.importorskip("rtde_receive")
    k = np.arange(15_000)
    stamps = 10**9 + 2_000_000 * k
    positions = np.column_stack([0.1 + 1e-4 * k, np.full(k.size, 0.2), np.full(k.size, 0.3)])
    quaternions = np.column_stack([np.cos(5e-4 * k), 0 * k, 0 * k, np.sin(5e-4 * k)])
    angles = np.column_stack([1e-3 * k, *(np.full(k.size, value) for value in (-1.0, 1.0, 0.0, 0.5, 0.0))])
    recording = Recording(
        Path("cell"),
        ImuSamples(stamps, np.zeros((k.size, 3)), np.zeros((k.size, 3)), Path("imu")),
        ReferencePoses("pose0", stamps, positions, quaternions, Path("pose")),
        JointAngles(stamps, angles, Path("joint")),
    )
    seen = {}
    try:
        # the client knows one port alone, and holds the interpreter while it connects
        with running(recording, "rtde", "csv", robot_port=30004) as (urls, _):
            with socket.create_connection((HOST, int(urls.imu.rpartition(":")[2]))):  # begins the motion
                client = rtde_receive.RTDEReceiveInterface(HOST, 500.0, ["timestamp", "actual_q", "actual_TCP_pose"])
                ends = time.monotonic() + LIMIT
                while len(seen) < 400 and time.monotonic() < ends:  # it keeps only the newest package
                    seen[client.getTimestamp()] = (client.getActualQ(), client.getActualTCPPose())
                    time.sleep(0.0005)
            client.disconnect()
    except DeviceError:
        pytest.skip("port 30004 is taken")
    seen.pop(0.0, None)
    assert len(seen) > 200
    for stamp, (q, pose) in seen.items():
        n = round((stamp - 1.0) / 0.002)
        assert q == pytest.approx(angles[n], abs=1e-12)
        assert pose == pytest.approx([*positions[n], 0.0, 0.0, 1e-3 * n], abs=1e-9)


def test_the_vendors_client_reads_the_simulated_imu(background):
    ixcom = pytest.importorskip("ixcom")
    begin = Begin()
    simulator = TcpSimulator("ixcom", begin)
    port = background(simulator.serve(HOST, 0)).result(5)
    background(simulator.play(readings(400, 2_500_000), Pace(lambda: begin.at)))
    client = ixcom.Client(HOST, port, timeout=5)
    found = []
    client.add_callback(lambda message, *_: found.append(message) if message.header.msgID == 0 else None)
    client.open_channel(0)
    client.add_log_sync(0, 1)
    ends = time.monotonic() + LIMIT
    while len(found) < 400 and time.monotonic() < ends:
        time.sleep(0.05)
    assert len(found) == 400
    last = found[-1].payload.data
    assert last["omg"] == pytest.approx([0.399, 0.25, -0.5], abs=1e-6)
    assert last["acc"] == pytest.approx([0.0, 3.99, 9.75], abs=1e-6)


def test_abbs_library_reads_the_simulated_controller(background):
    egm = pytest.importorskip("ABBRobotEGM")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((HOST, 0))
        port = probe.getsockname()[1]
    client = egm.EGM(port)
    began = time.monotonic() + 0.1
    background(play_datagrams("egm", poses(250, 4_000_000), HOST, port, Pace(lambda: began)))
    angles = []
    for _ in range(250):
        received, state = client.receive_from_robot(timeout=LIMIT)
        assert received
        angles.append(state.joint_angles[0])
    client.close()
    assert np.radians(angles) == pytest.approx(1e-3 * np.arange(250), abs=1e-9)


def test_openshowvar_talks_to_our_proxy(background):
    openshowvar = pytest.importorskip("py_openshowvar").openshowvar
    values = {"$OV_PRO": "100"}

    async def talk(reader, writer):
        splitter = varproxy.splitter()
        while data := await reader.read(4096):
            for number, content in splitter.receive(data):
                request = varproxy.decode_request(number, content)
                if request.value is not None:
                    values[request.name] = request.value
                known = request.name in values
                answer = varproxy.Answer(number, values.get(request.name, ""), known)
                writer.write(varproxy.encode_answer(answer))
        writer.close()
        await writer.wait_closed()
        ended.set()

    ended = threading.Event()
    server = background(asyncio.start_server(talk, HOST, 0)).result(5)
    client = openshowvar(HOST, server.sockets[0].getsockname()[1])
    assert client.read("$OV_PRO", debug=False) == b"100"
    client.write("$OV_PRO", "50", debug=False)
    assert client.read("$OV_PRO", debug=False) == b"50"
    client.close()
    assert ended.wait(LIMIT)

    async def close():
        server.close()

    background(close()).result(5)


def recorded(tmp_path, imu, robot=None, seconds=1.0):
    """Record devices until there are enough readings; return the recorder's state and the recording."""

    async def all_of_it():
        enough = Enough(seconds, poses=100 if robot else 0, with_robot=robot is not None)
        return await record_until(enough, imu, robot, tmp_path / "run")

    return asyncio.run(all_of_it()), tmp_path / "run"


def test_an_autopilot_of_the_mavlink_library_is_recorded(tmp_path):
    """A thread with the library sends, answers and counts as an autopilot does; it streams once it is asked."""
    mavutil = pytest.importorskip("pymavlink.mavutil")
    port, asked, ends = free_port(), [], threading.Event()

    def fly():
        link = mavutil.mavlink_connection(f"udpout:{HOST}:{port}", source_system=3, source_component=1)
        began = beaten = time.monotonic()
        k = 0
        while not ends.is_set():
            now = time.monotonic()
            if now >= beaten:
                beaten += 0.2
                link.mav.heartbeat_send(2, 12, 0, 0, 3, 3)
            while message := link.recv_match(blocking=False):
                if message.get_type() == "COMMAND_LONG" and message.command == 511:
                    asked.append(message.param2)
                    link.mav.command_ack_send(511, 0)
                if message.get_type() == "TIMESYNC" and message.tc1 == 0:
                    link.mav.timesync_send(int((now - began) * 1e9), message.ts1)
            if asked:
                link.mav.highres_imu_send(
                    1_000_000 + 2500 * k, 0.0, 1e-2 * k, 9.75, 1e-3 * k, 0.25, -0.5, *(0.0,) * 7, 0x3F
                )
                link.mav.attitude_send(k, *(0.0,) * 6)
                k += 1
            time.sleep(0.0025)
        link.close()

    thread = threading.Thread(target=fly, daemon=True)
    thread.start()
    try:
        status, path = recorded(tmp_path, f"mavlink://{HOST}:{port}?rate=400")
    finally:
        ends.set()
        thread.join()
    imu = load_bag(path).imu
    k = (imu.stamps_ns - 10**9) / 2_500_000
    assert asked[0] == 2500.0
    assert status.imu.missing == status.imu.late == 0
    assert np.diff(imu.stamps_ns) == pytest.approx(2_500_000)
    assert imu.rates[:, 0] == pytest.approx(1e-3 * k, abs=1e-6)
    assert imu.accelerations[:, 1] == pytest.approx(1e-2 * k, abs=1e-6)
    assert not [note for note in status.notes if "lost" in note]


@pytest.fixture(scope="module")
def fast_dds(tmp_path_factory):
    """Return the path of a publisher on Fast DDS, by default the network of ROS 2; it is compiled here."""
    compiler = shutil.which("g++")
    if compiler is None or not Path("/usr/include/fastdds").is_dir():
        pytest.skip("needs g++ and libfastrtps-dev")
    program = tmp_path_factory.mktemp("peer") / "fastdds_peer"
    source = Path(__file__).with_name("fastdds_peer.cpp")
    libraries = ["-lfastrtps", "-lfastcdr"]
    subprocess.run([compiler, "-std=c++14", "-o", program, source, *libraries], check=True, timeout=300)
    return program


def test_a_ros_2_system_on_fast_dds_is_recorded(tmp_path, fast_dds):
    pytest.importorskip("cyclonedds")
    domain = free_domain(HOST)
    frames = "pose=/tf&joints=/joint_states&base=base_link&tool=tool0"
    with subprocess.Popen([fast_dds, str(domain), str(int(LIMIT))]) as peer:
        try:
            where = f"ros2://{HOST}?domain={domain}"
            status, path = recorded(tmp_path, where, f"{where}&{frames}")
        finally:
            peer.kill()
    recording = load_bag(path)
    imu, reference, joints = recording.imu, recording.reference, recording.joints
    k = (imu.stamps_ns - 10**9) / 2_500_000
    assert imu.rates[:, 0] == pytest.approx(1e-3 * k, abs=1e-12)
    assert imu.accelerations == pytest.approx(np.column_stack([0 * k, 1e-2 * k, 0 * k + 9.75]), abs=1e-12)
    k = (reference.stamps_ns - 10**9) / 2_500_000
    place = np.column_stack([0.5 * np.cos(1e-3 * k), 0.5 * np.sin(1e-3 * k), 0 * k + 1.0])
    assert reference.positions == pytest.approx(place, abs=1e-12)
    assert joints.angles == pytest.approx(np.column_stack([1e-4 * k, *(0 * k + n for n in range(2, 7))]), abs=1e-12)
    assert status.imu.late == status.robot.late == 0
