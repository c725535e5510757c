from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kreisel.errors import RecordingError, SettingsError
from kreisel.formats import bag_units
from kreisel.formats.bag import load_bag
from kreisel.formats.bag_topics import unit_of, unit_topics
from kreisel.formats.bag_units import BagUnits
from kreisel.formats.imus import ALL, imu_reader, imus_in
from kreisel.formats.loading import load
from kreisel.formats.mcap import Topic, read_mcap, stated_topics
from kreisel.formats.topic_names import IMU, topic_of
from kreisel.formats.write import write
from kreisel.recording.recording import Recording
from kreisel.recording.recording_settings import DeviceTable, ImuTable, RecordingSettings

from .test_bag import KINDS, N, imu_messages, reference_messages, write_bag

THREE = ("imu0", "imu1", "imu2")


def several(topics: dict[str, int]) -> list:
    return [m for topic, n in topics.items() for m in imu_messages(topic, n=n)] + reference_messages()


def recordings(path: Path) -> tuple[Recording, dict]:
    """Return a recording of one unit, and the readings of two more."""
    bag = write_bag(path, "ros1", several({"/imu": N}))
    imu = only_imu(bag)
    settings = RecordingSettings(
        imu=ImuTable(grade="industrial-mems"),
        imus={"imu0": ImuTable(grade="fog"), "imu2": ImuTable(grade="consumer-mems")},
        devices={"device0": DeviceTable(serial_number="0040"), "device1": DeviceTable(serial_number="0041")},
    )
    base = Recording(bag, imu, None, settings=settings.of_imu("imu0"))
    moved = {f"imu{k}": replace(imu, stamps_ns=imu.stamps_ns + k, rates=imu.rates + k) for k in (1, 2)}
    return base, moved


def only_imu(path: Path):
    [name] = imus_in(path)
    return imu_reader(path)(name)[0]


# Which IMUs


@pytest.mark.parametrize("kind", KINDS)
def test_topics_of_kreisel_are_units_in_every_kind_of_bag(tmp_path: Path, kind: str) -> None:
    topics = {"/imu10/data_raw": 12, "/imu2/data_raw": 11, "/imu/data_raw": 10, "/other": 13}
    path = write_bag(tmp_path, kind, several(topics))
    assert imus_in(path) == ("imu0", "imu2", "imu10")
    assert imus_in(path, ALL) == ("imu0", "imu2", "imu10", "imu11")
    read = imu_reader(path)
    for name, count in (("imu2", 11), ("imu0", 10), ("imu11", 13), ("imu2", 11)):
        imu, warnings = read(name)
        assert len(imu.stamps_ns) == count
        assert not warnings
    assert read("imu10")[0].source == path / "imu10" / "data_raw"
    with pytest.raises(RecordingError, match="unknown topic with IMU readings 'imu7'"):
        read("imu7")


@pytest.mark.parametrize("kind", KINDS)
def test_topics_of_others_are_units_if_all_are_asked_for(tmp_path: Path, kind: str) -> None:
    path = write_bag(tmp_path, kind, several({"/s10": 30, "/s9": 29, "/s100": 31}))
    assert imus_in(path) == ()
    assert imus_in(path, ALL) == THREE
    assert [len(imu_reader(path)(name)[0].stamps_ns) for name in THREE] == [29, 30, 31]
    assert len(load_bag(path, imu="imu1").imu.stamps_ns) == 30
    with pytest.raises(RecordingError, match="choose with --imu TOPIC, or take them all, .* with --imu all"):
        load_bag(path)
    with pytest.raises(SettingsError, match="name an IMU, as --imu imu1"):
        load(path, imu=ALL)


def test_one_imu_is_not_all(tmp_path: Path) -> None:
    path = write_bag(tmp_path, "mcap", several({"/imu": N}))
    assert imus_in(path) == ("imu0",)
    with pytest.raises(RecordingError, match="holds one IMU, expected several"):
        imus_in(path, ALL)
    with pytest.raises(RecordingError, match="no such file"):
        imus_in(tmp_path / "none.mcap")
    with pytest.raises(SettingsError, match="expected 'all'"):
        imus_in(path, "/imu")
    (tmp_path / "table.csv").write_text("a,b\n")
    assert imus_in(tmp_path / "table.csv") == ()
    with pytest.raises(RecordingError, match="no recording with IMUs"):
        imu_reader(tmp_path / "table.csv")


def test_readings_after_a_leap_of_the_clock_are_no_unit() -> None:
    names = ("/imu/data_raw", "/imu/data_raw_2", "/imu1/data_raw", "/imu1/data_raw_3", "/left", "/empty")
    topics = [Topic(name, IMU, "cdr", 0 if name == "/empty" else 5) for name in names]
    assert unit_topics(topics, everything=True) == {
        "imu0": "/imu/data_raw", "imu1": "/imu1/data_raw", "imu2": "/left"
    }  # fmt: skip
    assert unit_of("/left", topics) == "imu2"
    assert unit_of("/imu1/data_raw_3", topics) == "imu0"
    same = [Topic(name, IMU, "cdr", 5) for name in ("/imu0/data_raw", "/imu/data_raw")]
    assert list(unit_topics(same)) == ["imu0", "imu1"]


# Their readings


def test_units_are_read_in_few_passes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_bag(tmp_path, "mcap", several({f"/imu{k}/data_raw": 20 + k for k in range(5)}))
    passes = []
    whole = bag_units.read_contents
    monkeypatch.setattr(bag_units, "read_contents", lambda p, only: passes.append(only[IMU]) or whole(p, only))
    monkeypatch.setattr(bag_units, "TOGETHER", 70)
    read = BagUnits(path)
    assert [len(read(f"imu{k}")[0].stamps_ns) for k in (1, 2, 3, 4, 0)] == [21, 22, 23, 24, 20]
    assert [len(topics) for topics in passes] == [3, 1, 1]
    assert len(read("imu1")[0].stamps_ns) == 21
    assert passes[3:] == [{"/imu1/data_raw"}]


def test_a_unit_that_cannot_be_read_does_not_keep_others_from_it(tmp_path: Path) -> None:
    bodies = imu_messages("/imu1/data_raw", frame="a") + imu_messages("/imu1/data_raw", frame="b")
    path = write_bag(tmp_path, "mcap", bodies + several({"/imu/data_raw": N, "/imu2/data_raw": N}))
    read = imu_reader(path)
    assert len(read("imu0")[0].stamps_ns) == N
    with pytest.raises(RecordingError, match="2 bodies share the topic /imu1/data_raw"):
        read("imu1")
    assert len(read("imu2")[0].stamps_ns) == N


def test_the_end_of_a_file_states_its_topics(tmp_path: Path) -> None:
    base, further = recordings(tmp_path)
    path = tmp_path / "run.mcap"
    write(base, path, further)
    found = {topic.name: topic.count for topic in stated_topics(path)}
    assert set(found) == {topic_of(unit) for unit in range(3)}
    assert found == {topic.name: topic.count for topic in read_mcap(path, ()).topics}
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(path.read_bytes()[:-300])
    assert stated_topics(cut) is None
    assert imus_in(cut) == THREE
    imu, warnings = imu_reader(cut)("imu1")
    assert len(imu.stamps_ns) == N
    assert "cut or damaged" in str(warnings[0])


# Written, and their settings


@pytest.mark.parametrize("form", ["run.mcap", "run"])
def test_units_are_read_as_they_were_written(tmp_path: Path, form: str) -> None:
    base, further = recordings(tmp_path)
    base, further = with_more(base), {name: with_more(imu) for name, imu in further.items()}
    path = tmp_path / "new" / form
    write(base, path, further)
    assert imus_in(path) == THREE
    read = imu_reader(path)
    for name, imu in {"imu0": base.imu, **further}.items():
        got, _ = read(name)
        np.testing.assert_array_equal(got.stamps_ns, imu.stamps_ns)
        np.testing.assert_array_equal(got.rates, imu.rates)
        np.testing.assert_array_equal(got.accelerations, imu.accelerations)
    settings = load(path).settings
    assert [settings.of_imu(name).imu.grade for name in THREE] == ["fog", "industrial-mems", "consumer-mems"]
    assert [settings.of_imu(name).device.serial_number for name in THREE] == ["0040", "0041", None]
    assert settings == load(path, imu="imu1").settings.of_imu("imu0")
    assert settings.of_all_imus().imu.grade == "industrial-mems"


def with_more(one):
    """Return a recording, or its readings, of 6 s: fewer are not accepted."""
    if isinstance(one, Recording):
        return replace(one, imu=with_more(one.imu))
    t = np.arange(1200)
    turns = np.sin(0.01 * t)[:, None] * [1.0, 0.7, 0.4] + 0.001 * one.rates[0]
    forces = np.column_stack([np.sin(0.02 * t), np.cos(0.03 * t), 9.8 + 0.001 * np.sin(t)])
    return replace(one, stamps_ns=one.stamps_ns[0] + 5_000_000 * t, rates=turns, accelerations=forces)
