"""A tray's places and clocks in other programs' files: values derived by hand, and a proof that finds wrong ones."""

from dataclasses import replace
from io import StringIO
from xml.etree import ElementTree

import numpy as np
import pytest
from ruamel.yaml import YAML

from kreisel.array.array_file import is_array, load_array
from kreisel.errors import RecordingError, SettingsError
from kreisel.exchange.chain_proof import FORCE_FLOOR, RATE_FLOOR, proved
from kreisel.exchange.exported import ArrayRequest, ExportRequest, PlacedUnit
from kreisel.exchange.exported_noise import NAMES, ExportNoise
from kreisel.exchange.kalibr import read
from kreisel.exchange.losses import clock_losses
from kreisel.exchange.ros_frames import MAX_DIFFERENCE
from kreisel.exchange.targets import ARRAY_TARGETS, TARGETS, array_target_named, target_named
from kreisel.inertial.sensor_model import SensorParameters

from ..calibration.example import calibration
from .small_tray import CLOCK, placed, units, write_tray

NOISE = ExportNoise(dict.fromkeys(NAMES, 1e-3), dict.fromkeys(NAMES, "a test"))
TURNED = [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
"""x of the unit is y of the reference unit, y is z, z is x."""


def request_of(folder):
    found = load_array(folder)
    requests = [
        PlacedUnit(unit, ExportRequest(unit.calibration.in_axes("imu"), NOISE, rate_hz=400.0, topic=f"/{unit.name}"))
        for unit in found.units
    ]
    return ArrayRequest("tray", tuple(requests), found.left_out)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_tray(tmp_path_factory.mktemp("tray"), units())


@pytest.fixture(scope="module")
def request_(folder):
    return request_of(folder)


@pytest.fixture(scope="module")
def chain(request_):
    return ARRAY_TARGETS["kalibr"].export(request_)


@pytest.fixture(scope="module")
def by_hand(tmp_path_factory):
    """Return a tray of two devices without errors, one turned and moved; each measures in a single point."""
    base = replace(calibration(), sensors=SensorParameters.ideal())
    R, p = np.array(TURNED), np.array([0.1, 0.2, 0.3])
    moved = replace(base.sensors, K_omega=R, K_a=R, lever_arms=np.tile(p, (3, 1)))
    tray = {"imu0": base, "imu1": replace(base, sensors=moved)}
    place = {
        "position": p.tolist(),
        "rotation": TURNED,
        "standard_deviation": {"position": [1e-4, 2e-4, 3e-4], "rotation": [1e-5, 2e-5, 3e-5]},
        "clock": CLOCK,
    }
    return request_of(write_tray(tmp_path_factory.mktemp("by-hand"), tray, {"imu1": place}))


def test_the_files_transform_and_offset_by_hand(by_hand):
    """Kalibr: p_i = T_i_b p_b, t_imu0 = t_imu1 + time_offset."""
    text = ARRAY_TARGETS["kalibr"].export(by_hand).files[""]
    table = YAML(typ="safe").load(text)
    assert list(table) == ["imu0", "imu1"]
    # the unit's x is y of imu0, of which it is 0.2 m away, and so on
    hand = [[0.0, 1.0, 0.0, -0.2], [0.0, 0.0, 1.0, -0.3], [1.0, 0.0, 0.0, -0.1], [0.0, 0.0, 0.0, 1.0]]
    np.testing.assert_allclose(table["imu1"]["T_i_b"], hand, atol=1e-15)
    assert table["imu0"]["T_i_b"] == np.eye(4).tolist()
    # t_reference = t + offset
    assert table["imu1"]["time_offset"] == -1.5
    assert table["imu0"]["time_offset"] == 0.0
    assert table["imu1"]["rostopic"] == "/imu1"
    assert "[0.0001, 0.0002, 0.0003] m, of the rotation [1e-05, 2e-05, 3e-05] rad; of time_offset 1.5e-05 s" in text
    assert "skew 2e-05, standard deviation 1e-07" in text
    assert "# Left out: imu7: did not turn" in text


def test_links_and_transforms_by_hand(by_hand):
    """A turn of 120 deg about (1, 1, 1) takes x to y, y to z and z to x: (1, 1, 1, 1) / 2."""
    launch = ElementTree.fromstring(ARRAY_TARGETS["ros-tf"].export(by_hand).files[""])
    node = launch.find("node")
    words = node.attrib["args"].split()
    value = dict(zip(words[::2], words[1::2], strict=True))
    np.testing.assert_allclose([float(value[f"--q{axis}"]) for axis in "wxyz"], 0.5, atol=1e-15)
    assert [float(value[f"--{axis}"]) for axis in "xyz"] == [0.1, 0.2, 0.3]
    assert (value["--frame-id"], value["--child-frame-id"]) == ("imu0", "imu1")
    urdf = ElementTree.fromstring(ARRAY_TARGETS["urdf"].export(by_hand).files[""])
    assert [link.attrib["name"] for link in urdf.iter("link")] == ["imu0", "imu1"]
    joint = urdf.find("joint")
    assert joint.attrib["type"] == "fixed"
    assert (joint.find("parent").attrib["link"], joint.find("child").attrib["link"]) == ("imu0", "imu1")
    origin = joint.find("origin").attrib
    assert [float(x) for x in origin["xyz"].split()] == [0.1, 0.2, 0.3]
    # Rz(90 deg) Ry(0) Rx(90 deg) takes x to y, y to z
    np.testing.assert_allclose([float(x) for x in origin["rpy"].split()], [np.pi / 2, 0.0, np.pi / 2], atol=1e-15)


def test_one_motion_is_one_in_kalibrs_file(chain, request_):
    proof = proved(chain.files[""], [one.unit for one in request_.units])
    one, own = proof.at_one_place, proof.at_own_places
    assert one.rate < 1e-12
    assert one.force < 1e-8
    assert (one.rate_bound, one.force_bound) == pytest.approx((RATE_FLOOR, FORCE_FLOOR), rel=0.1)
    # Kalibr's size effect is along other axes: as large as is told, and within the bound that follows from it
    assert 1e-5 < own.force < own.force_bound
    assert own.rate < own.rate_bound
    assert chain.notes[0] == proof.sentence
    assert sum("along axes that are not orthogonal" in text for text in chain.lost) == 3


def changed(text, name, key, change):
    table = YAML(typ="safe").load(text)
    value = np.array(table[name][key])
    change(value)
    table[name][key] = value.tolist()
    stream = StringIO()
    YAML().dump(table, stream)
    return stream.getvalue()


def transposed(T):
    T[:3, :3] = T[:3, :3].T.copy()


def inverted(T):
    T[:] = np.linalg.inv(T)


def nudged(T):
    T[1, 3] += 1e-6


def moved_arm(T):
    T[0, 3] = -T[0, 3]


@pytest.mark.parametrize("change", [transposed, inverted, nudged, moved_arm])
@pytest.mark.parametrize("name", ["imu1", "imu2"])
def test_the_proof_finds_a_wrong_transform(change, name, chain, request_):
    text = changed(chain.files[""], name, "T_i_b", change)
    with pytest.raises(RecordingError, match=f"{name}: the (rate|force) of one motion .* do not belong together"):
        proved(text, [one.unit for one in request_.units])


def test_the_proof_finds_an_offset_of_the_wrong_sign_and_one_of_a_microsecond(chain, request_):
    own = [one.unit for one in request_.units]
    for change in (lambda value: np.negative(value, out=value), lambda value: np.add(value, 1e-6, out=value)):
        with pytest.raises(RecordingError, match="imu2: the rate"):
            proved(changed(chain.files[""], "imu2", "time_offset", change), own)


def test_places_of_another_tray_are_refused(tmp_path):
    tray = units()
    base = tray["imu0"].sensors
    places = {name: placed(base, tray[name].sensors) for name in ("imu1", "imu2")}
    places["imu1"]["rotation"] = np.array(places["imu1"]["rotation"]).T.tolist()
    with pytest.raises(RecordingError, match="imu1: the rate of one motion"):
        ARRAY_TARGETS["kalibr"].export(request_of(write_tray(tmp_path, tray, places)))


def test_a_clock_since_1970_costs_its_last_digit_only(tmp_path):
    """Doubles of 1.7e9 s resolve 0.24 us: the bound follows."""
    tray = units()
    places = {name: placed(tray["imu0"].sensors, tray[name].sensors) for name in ("imu1", "imu2")}
    places["imu1"]["clock"] = {**CLOCK, "offset": 1.7e9 + 1.0 / 3.0}
    request = request_of(write_tray(tmp_path, tray, places))
    proof = proved(ARRAY_TARGETS["kalibr"].export(request).files[""], [one.unit for one in request.units])
    assert 1e-8 < proof.at_one_place.rate < proof.at_one_place.rate_bound < 1e-4


def test_each_imu_of_the_chain_is_that_of_its_own_export(chain, request_):
    """One way to write an IMU: all but place, clock and topic are those of a single unit's file."""
    table = YAML(typ="safe").load(chain.files[""])
    for k, one in enumerate(request_.units):
        alone = YAML(typ="safe").load(TARGETS["kalibr"].export(one.request).files[""])["imu0"]
        for key in alone.keys() - {"T_i_b", "time_offset"}:
            assert table[f"imu{k}"][key] == alone[key], key


def test_the_chain_is_read_by_its_first_imu(chain, tmp_path):
    (tmp_path / "imus.yaml").write_text(chain.files[""])
    assert read(tmp_path / "imus.yaml").recording.imu_rate_hz == 400.0


def test_skew_is_told_as_a_loss(chain):
    assert clock_losses(2e-5) == ("the clock's skew: 20 ppm, 12 ms after ten minutes",)
    assert clock_losses(1e-8) == ()
    assert [text for text in chain.lost if "skew" in text] == [
        f"{name}: the clock's skew: 20 ppm, 12 ms after ten minutes" for name in ("imu1", "imu2")
    ]


@pytest.mark.parametrize("target", ["urdf", "ros-tf"])
def test_places_are_read_back(target, request_):
    done = ARRAY_TARGETS[target].export(request_)
    assert f"(bound {MAX_DIFFERENCE:.0e})" in done.notes[0]
    assert "imu1: the clock's offset: -1.5 s" in done.lost
    wrong = replace(request_.units[1], unit=replace(request_.units[1].unit, rotation=np.diag([1.0, 1.0, 1.01])))
    with pytest.raises(RecordingError, match="read back differ by"):
        ARRAY_TARGETS[target].export(replace(request_, units=(request_.units[0], wrong)))


def test_formats_of_one_and_of_several_are_told_apart():
    with pytest.raises(SettingsError, match=r"openvins is of a single IMU: export the folders .*imu0, imu1"):
        array_target_named("openvins", ["imu0", "imu1"])
    with pytest.raises(SettingsError, match=r"urdf is of several IMUs: give the result folder that has array\.yaml"):
        target_named("urdf")
    with pytest.raises(SettingsError, match=r"unknown format 'x'; known are: .*ros-tf"):
        array_target_named("x", [])


def edited(old, new):
    """Return what replaces a text in `array.yaml`, which must be there."""

    def edit(folder):
        text = (folder / "array.yaml").read_text()
        assert old in text
        (folder / "array.yaml").write_text(text.replace(old, new, 1))

    return edit


def rewritten(change):
    """Return what changes the entry of imu1 in `array.yaml`."""

    def edit(folder):
        document = YAML(typ="safe").load((folder / "array.yaml").read_text())
        change(document["imus"]["imu1"])
        with (folder / "array.yaml").open("w") as stream:
            YAML().dump(document, stream)

    return edit


def without_number(place):
    place["clock"]["skew"] = float("nan")


def not_orthogonal(place):
    place["rotation"][0][0] += 1e-3


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (edited("kreisel-array-1", "kreisel-array-9"), "schema is 'kreisel-array-9', expected 'kreisel-array-1'"),
        (edited("reference: imu0", "reference: ../imu0"), "a unit is named '../imu0'"),
        (rewritten(without_number), "expected finite numbers"),
        (edited("offset:", "offsets:"), "incomplete or changed: 'offset'"),
        (rewritten(not_orthogonal), "the rotation of imu1 is none"),
        (edited("schema", "[schema"), "not valid YAML"),
        (lambda folder: (folder / "array.yaml").unlink(), "give the result folder of `kreisel calibrate` of several"),
        (lambda folder: (folder / "imu2" / "calibration.yaml").unlink(), "imu2.*cannot be read"),
    ],
)
def test_folders_that_are_not_those_of_a_tray_are_refused(damage, said, tmp_path):
    write_tray(tmp_path, units())
    assert is_array(tmp_path)
    assert not is_array(tmp_path / "imu0")
    damage(tmp_path)
    with pytest.raises(RecordingError, match=said):
        load_array(tmp_path)
