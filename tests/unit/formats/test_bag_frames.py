from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kreisel.errors import RecordingError
from kreisel.formats.bag import load_bag
from kreisel.geometry import rotation
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.preparation.prepare import prepare_recording

from .test_bag import KINDS, Message, N, imu_messages, reference_messages, stamps, write_bag

TF = "tf2_msgs/msg/TFMessage"
TURNING, LIFTED, TOOL, BASE = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (0.1, 0.2, -0.3), (0.5, 0.0, 1.2)

Link = tuple[str, str, Sequence[float], Sequence[float], float]
"""Parent, child, place, axis, and angle per message."""

ARM: list[Link] = [
    ("base_link", "link_1", (0.0, 0.0, 0.4), TURNING, 0.03),
    ("link_1", "link_2", (0.3, 0.0, 0.1), LIFTED, -0.02),
    ("link_2", "link_3", (0.0, 0.1, 0.5), TURNING, 0.05),
]


def placed(types: dict[str, Any], head: Any, link: Link, k: int) -> Any:
    _, child, place, axis, angle = link
    half = 0.5 * (0.3 + angle * k)
    x, y, z = np.sin(half) * np.array(axis)
    turn = types["geometry_msgs/msg/Quaternion"](x, y, z, np.cos(half))
    moved = types["geometry_msgs/msg/Transform"](types["geometry_msgs/msg/Vector3"](*place), turn)
    return types["geometry_msgs/msg/TransformStamped"](head, child, moved)


def frames(
    links: Sequence[Link], topic: str = "/tf", n: int = N, shift_ns: int = 0, msgtype: str = TF
) -> list[Message]:
    """Return messages with all links together."""

    def build(k: int) -> Any:
        def message(types: dict[str, Any], head: Any) -> Any:
            heads = [replace(head, frame_id=link[0]) for link in links]
            return types[msgtype]([placed(types, one, link, k) for one, link in zip(heads, links, strict=True)])

        return message

    return [Message(topic, msgtype, s + shift_ns, build(k)) for k, s in enumerate(stamps(n))]


def expected(links: Sequence[Link], k: int) -> np.ndarray:
    """Return the matrix of the last link in the first one's parent, by rotations about axes."""
    T = np.eye(4)
    for _, _, place, axis, angle in links:
        K = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
        size = np.linalg.norm(axis)
        about, turned = (
            K / size,
            2.0 * np.arctan2(np.sin(0.5 * (0.3 + angle * k)) * size, np.cos(0.5 * (0.3 + angle * k))),
        )
        step = np.eye(4)
        step[:3, :3] = np.eye(3) + np.sin(turned) * about + (1.0 - np.cos(turned)) * about @ about
        step[:3, 3] = place
        T = T @ step
    return T


def assert_poses(path: Path, links: Sequence[Link], reference: str | None = None) -> Any:
    got = load_bag(path, reference)
    assert got.reference is not None
    np.testing.assert_array_equal(got.reference.stamps_ns, stamps())
    for k in (0, 7, N - 1):
        want = expected(links, k)
        np.testing.assert_allclose(got.reference.positions[k], want[:3, 3], atol=1e-12)
        np.testing.assert_allclose(rotation.matrix(got.reference.quaternions[k]), want[:3, :3], atol=1e-12)
    return got


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("msgtype", [TF, "tf/msg/tfMessage"])
def test_the_only_frame_that_moves_and_carries_no_other_is_the_reference(
    tmp_path: Path, kind: str, msgtype: str
) -> None:
    messages = imu_messages() + frames(ARM, msgtype=msgtype)
    got = assert_poses(write_bag(tmp_path, kind, messages), ARM)
    assert [str(w) for w in got.warnings] == [
        "topics: took the frame 'link_3' in 'base_link' on /tf; --reference '/tf@BASE:TOOL' chooses others"
    ]


@pytest.mark.parametrize("name", ["/tf@world:tool0", "tf@world:tool0", "/tf@tool0"])
def test_constant_frames_above_and_below(tmp_path: Path, name: str) -> None:
    fixed: list[Link] = [
        ("link_3", "tool0", (0.0, 0.0, 0.2), (0.6, 0.0, 0.8), 0.0),
        ("world", "base_link", BASE, (0.0, 1.0, 0.0), 0.0),
    ]
    messages = imu_messages() + frames(fixed, "/tf_static", n=1) + frames(ARM)
    path = write_bag(tmp_path, "mcap", messages)
    assert_poses(path, [fixed[1], *ARM, fixed[0]], name)
    assert_poses(path, ARM[1:], "/tf@link_1:link_3")


def test_a_frame_that_is_published_without_changes_is_constant(tmp_path: Path) -> None:
    flange: Link = ("link_3", "flange", (0.0, 0.0, 0.2), TURNING, 0.0)
    later = frames([flange], n=5, shift_ns=500_000_123)
    assert_poses(write_bag(tmp_path, "sqlite3", imu_messages() + frames(ARM) + later), [*ARM, flange], "/tf@flange")


def test_another_reference_is_preferred_and_frames_can_be_asked_for(tmp_path: Path) -> None:
    path = write_bag(tmp_path, "mcap", imu_messages() + frames(ARM) + reference_messages())
    assert load_bag(path).reference.name == "/pose"
    assert_poses(path, ARM, "/tf@base_link:link_3")


def left_out(path: Path, message: str) -> None:
    got = load_bag(path)
    assert got.reference is None
    with pytest.raises(RecordingError, match=f"no reference poses.*{message}"):
        prepare_recording(got, CalibrationSettings())


def test_of_several_frames_one_must_be_chosen(tmp_path: Path) -> None:
    finger: Link = ("link_2", "finger", (0.0, 0.0, 0.1), TURNING, 0.01)
    path = write_bag(tmp_path, "mcap", imu_messages() + frames([*ARM, finger]))
    left_out(path, "on /tf one frame must.*/tf@base_link:finger, /tf@base_link:link_3. Choose with --reference")
    assert_poses(path, ARM, "/tf@link_3")
    with pytest.raises(RecordingError, match=r"these do: .*finger"):
        load_bag(path, "/tf")


def test_a_frame_that_turns_on_the_spot_may_be_of_the_device_itself(tmp_path: Path) -> None:
    own: Link = ("world", "imu", (0.0, 0.0, 0.0), TURNING, 0.01)
    path = write_bag(tmp_path, "mcap", imu_messages() + frames([own]))
    left_out(path, "one frame must change its place.*these do: none")
    assert_poses(path, [own], "/tf@imu")


@pytest.mark.parametrize(
    ("more", "name", "message"),
    [
        (
            frames([("odom", "base_link", BASE, TURNING, 0.01)], shift_ns=3_000_000),
            "/tf@odom:link_3",
            "different times",
        ),
        ([], "/tf@tool0", "frame on /tf 'tool0'; "),
        ([], "/tf@world:link_3", "no frames on /tf lead from 'link_3' up to 'world', only to 'base_link'"),
        ([], "/tf@link_3:link_1", "lead from 'link_1' up to 'link_3'"),
        ([], "/tf@link_3:link_3", "'link_3' does not move in 'link_3'"),
        (frames([("link_3", "tool", BASE, TURNING, 0.0)]), "/tf@link_3:tool", "'tool' does not move in 'link_3'"),
        (frames([("world", "link_1", BASE, TURNING, 0.01)]), "/tf@link_3", "'link_1' on /tf is in 'base_link' and in"),
        (frames([("link_3", "base_link", BASE, TURNING, 0.01)]), "/tf@link_3", "carry each other"),
    ],
)
def test_frames_that_give_no_poses(tmp_path: Path, more: list[Message], name: str, message: str) -> None:
    path = write_bag(tmp_path, "mcap", imu_messages() + frames(ARM) + more)
    with pytest.raises(RecordingError, match=message):
        load_bag(path, name)


def test_messages_without_frames(tmp_path: Path) -> None:
    left_out(write_bag(tmp_path, "sqlite3", imu_messages() + frames([])), "one frame must change its place")
