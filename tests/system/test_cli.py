"""The command line as a user meets it: files, exit statuses, what goes where."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from ruamel.yaml import YAML

import kreisel
from kreisel.formats.write import write_folder
from kreisel.recording.recording_settings import RecordingSettings
from kreisel.simulation.standstills import HandTurns, hand_turned

from ..foreign_tables import PLAIN, plain
from ..small_cell import simulate
from .breaking import assert_one_line, command


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cell") / "recording"
    _, recording = simulate(np.random.default_rng(5), 60.0, folder)
    write_folder(recording, folder)
    return folder


def run(*arguments):
    command = [sys.executable, "-m", "kreisel.cli.main", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)


@pytest.fixture
def refused(monkeypatch, capsys):
    """Return a function that runs a command in this process and checks that it is refused in one line, with words."""
    call = command(monkeypatch, capsys)

    def check(words, *arguments):
        ended = call(*arguments)
        assert ended.status == 1
        assert_one_line(ended.err, (words,))

    return check


def test_calibrate_writes_a_result_folder(cell, tmp_path):
    out = tmp_path / "out"
    done = run("calibrate", cell, "-o", out, "--inject")
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""  # progress only to a terminal
    assert "verdict: accepted" in done.stdout
    assert "injected errors" in done.stdout
    assert {p.name for p in out.iterdir()} == {"calibration.yaml", "report.html", "estimates.csv", "covariance.npz"}
    calibration = kreisel.Calibration.load(out)
    assert calibration.accepted
    rows = np.genfromtxt(out / "estimates.csv", delimiter=",", skip_header=1)
    assert rows.shape[1] == 1 + 2 * len(calibration.names)
    with np.load(out / "covariance.npz") as data:
        assert data["covariance"].shape == 2 * (len(calibration.names),)


def test_json_is_one_object_on_standard_output(cell):
    done = run("calibrate", cell, "--json")
    document = json.loads(done.stdout)
    assert document["schema"] == "kreisel/calibration/2"
    parts = "gyroscope accelerometer timing alignment derived consistency verdict formula frames estimator recording"
    assert set(parts.split()) <= document.keys()
    for sensor in ("gyroscope", "accelerometer", "timing", "alignment"):
        assert document["standard_deviation"][sensor].keys() == document[sensor].keys()


def test_an_error_is_an_object_too(cell, tmp_path):
    done = run("calibrate", tmp_path / "none", "--json")
    assert done.returncode == 1
    assert json.loads(done.stdout) == {"error": done.stderr.strip().removeprefix("kreisel: ")}
    assert run("calibrate", tmp_path / "none").stdout == ""
    plain(kreisel.load(cell), tmp_path)
    done = run("calibrate", tmp_path, "--json")
    assert done.returncode == 1
    assert json.loads(done.stdout)["proposal"] == run("calibrate", tmp_path).stdout.rstrip("\n")


def test_sigma_points_and_fixed_groups(cell):
    fast = json.loads(run("calibrate", cell, "--json", "--sigma-points", "unscented", "--fix", "lever_arms").stdout)
    assert (fast["estimator"]["name"], fast["estimator"]["sigma_points"]) == ("spkf", "unscented")
    assert np.all(np.array(fast["standard_deviation"]["accelerometer"]["lever_arms"]) == 0.0)


def test_quadratic_terms_are_found_to_be_nothing(cell):
    document = json.loads(run("calibrate", cell, "--json", "--polynomial-order", "2").stdout)
    for sensor in ("gyroscope", "accelerometer"):
        value = np.array(document[sensor]["polynomial"]["2"])
        deviation = np.array(document["standard_deviation"][sensor]["polynomial"]["2"])
        assert np.all(np.abs(value) < 4.0 * deviation)


def test_usage_errors_have_status_two(cell):
    assert run("calibrate").returncode == 2
    assert run("calibrate", cell, "--no-such-option").returncode == 2


@pytest.mark.parametrize(
    ("arguments", "telling"),
    [
        (["--estimator", "magic"], "spkf"),
        (["--fix", "magic"], "lever_arms"),
        (["--reference", "magic"], "pose0"),
        (["--size-effect", "magic"], "fox2005"),
        (["--polynomial-order", "9"], "1 to 5"),
        (["-o", __file__], "give a folder"),
    ],
)
def test_wrong_choices_list_the_right_ones(cell, refused, arguments, telling):
    refused(telling, "calibrate", cell, *arguments)


def test_info_and_convert(cell, tmp_path):
    facts = json.loads(run("info", cell, "--json").stdout)
    assert facts["imu"]["rate Hz"] == pytest.approx(200.0)
    assert facts["together"]["correlation of rates"] > 0.99
    mcap = tmp_path / "cell.mcap"
    assert run("convert", cell, mcap).returncode == 0
    a, b = kreisel.load(cell), kreisel.load(mcap)
    np.testing.assert_array_equal(a.imu.rates, b.imu.rates)
    # loading makes quaternions unit length once more
    np.testing.assert_allclose(a.reference.quaternions, b.reference.quaternions, rtol=0, atol=1e-15)
    assert Path(mcap).stat().st_size < 4e6


def test_recordings_of_one_device_are_compared(cell, tmp_path):
    recording = kreisel.load(cell)
    for name, half in (("first", slice(0, 6000)), ("second", slice(6000, None))):
        imu = recording.imu
        part = replace(imu, stamps_ns=imu.stamps_ns[half], rates=imu.rates[half], accelerations=imu.accelerations[half])
        write_folder(replace(recording, imu=part), tmp_path / name)
    assert run("calibrate", tmp_path / "second", "-o", tmp_path / "result", "--no-validate").returncode == 0
    out = tmp_path / "out"
    done = run("repeat", tmp_path / "first", tmp_path / "result", "-o", out)
    assert done.returncode == 0, done.stderr
    assert "Runs differ as much as their standard deviations say." in done.stdout
    document = json.loads((out / "repeatability.json").read_text())
    assert document["runs"] == ["first", "result"]
    assert all(0.0 <= one["chi_square"] < 5.0 for one in document["quantities"].values())
    assert "repeatability" in (out / "repeatability.html").read_text().lower()
    assert run("repeat", cell).returncode == 1


def test_estimators_are_compared(cell, refused, tmp_path):
    out = tmp_path / "out"
    done = run("compare", cell, "--methods", "spkf, ekf,batch", "-o", out)
    assert done.returncode == 0, done.stderr
    assert "difference from spkf, in its deviations" in done.stdout
    assert max(map(len, done.stdout.splitlines())) <= 120
    document = json.loads((out / "comparison.json").read_text())
    assert set(document["methods"]) == {"spkf", "ekf", "batch"}
    one = document["methods"]["batch"]
    assert one["standard_deviation"].keys() <= one["estimate"].keys()
    assert "comparison" in (out / "comparison.html").read_text().lower()
    file = tmp_path / "mine.py"
    file.write_text(
        "import kreisel\n\n\nclass Mine:\n    name = 'mine'\n\n    def estimate(self, measured):\n"
        "        print('starts')\n"
        "        own = measured.start['gyroscope']['offset']\n"
        "        table = {'gyroscope': {'offset': own}}\n"
        "        return kreisel.Estimates(table, {'gyroscope': {'offset': abs(own) + 1e-4}})\n"
    )
    done = run("compare", cell, cell, "--methods", f"ekf,{file}:Mine", "--json")
    assert done.returncode == 0, done.stderr
    found, squares = (json.loads(done.stdout)[key] for key in ("recordings", "chi_square"))
    assert len(found) == 2
    assert squares["mine"]["gyro_bias_deg_h"] == pytest.approx(0.0, abs=1e-9)
    assert squares["mine"]["accel_bias_mg"] is None
    for own in found.values():
        assert own["methods"]["mine"]["accepted"] is None
        assert own["methods"]["mine"]["passes"] > 0.0
        assert set(own["methods"]["mine"]["difference"]) == {f"gyroscope.offset[{i}]" for i in range(3)}
    refused("has no Other", "compare", cell, "--methods", f"spkf,{file}:Other")
    again = f"{file.parent}/../{file.parent.name}/mine.py:Mine"
    refused("two estimators are called mine", "compare", cell, "--methods", f"{file}:Mine,{again}")
    refused("unknown estimator 'magic'", "compare", cell, "--methods", "spkf,magic")
    refused("give two or more", "compare", cell, "--methods", "spkf")
    refused("give two or more", "compare", cell, "--methods", ",")


def test_ways_without_a_reference_side_by_side(refused, tmp_path):
    _, recording = hand_turned(HandTurns(attitudes=16), np.random.default_rng(6))
    write_folder(recording, tmp_path / "hand")
    done = run("compare", tmp_path / "hand", "-o", tmp_path / "compared")
    assert done.returncode == 0, done.stderr
    document = json.loads((tmp_path / "compared" / "comparison.json").read_text())
    assert list(document["methods"]) == ["static", "constant-offsets", "tedaldi"]
    assert document["methods"]["tedaldi"]["accepted"] is None
    matrices = [
        {name: value for name, value in document["methods"][way]["estimate"].items() if "cross_coupling" in name}
        for way in ("static", "tedaldi")
    ]
    assert matrices[1] == pytest.approx(matrices[0], abs=5e-3)
    assert "gyroscope.cross_coupling[0,0]" in document["methods"]["tedaldi"]["difference"]
    assert "tedaldi differs from static by up to" in " ".join(done.stdout.split())
    refused("unknown estimator 'spkf'", "compare", tmp_path / "hand", "--methods", "spkf,ekf")


def test_noise_figures_at_rest(cell, refused, tmp_path):
    rng = np.random.default_rng(1)
    rows = np.column_stack([0.02 * rng.normal(size=(6000, 3)), rng.normal(size=(6000, 3)) + np.array([0.0, 0.0, 9.8])])
    (tmp_path / "rest" / "imu0").mkdir(parents=True)
    head = "#timestamp [ns],w_x [rad s^-1],w_y [rad s^-1],w_z [rad s^-1],a_x [m s^-2],a_y [m s^-2],a_z [m s^-2]"
    stamps = (20_000_000 * np.arange(6000)).astype(str)
    lines = [f"{t},{','.join(f'{x:.9g}' for x in row)}" for t, row in zip(stamps, rows, strict=True)]
    (tmp_path / "rest" / "imu0" / "data.csv").write_text("\n".join([head, *lines]) + "\n")
    done = run("allan", tmp_path / "rest", "-o", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert "too short for bias instability and random walk" in " ".join(done.stdout.split())
    document = json.loads((tmp_path / "out" / "allan.json").read_text())
    assert document["gyroscope"]["noise_density"] == pytest.approx([0.02 * 50.0**-0.5] * 3, rel=0.1)
    assert document["accelerometer"]["random_walk"] == [None, None, None]
    assert json.loads(run("allan", tmp_path / "rest", "--json").stdout) == document
    assert "Allan deviation" in (tmp_path / "out" / "allan.html").read_text()
    refused("are not at rest", "allan", cell)
    refused("has no poses", "allan", tmp_path / "rest", "--in-motion")


def test_noise_figures_in_motion_reach_kalibr(cell, refused, tmp_path):
    done = run("allan", cell, "--in-motion", "-o", tmp_path / "noise")
    assert done.returncode == 0, done.stderr
    assert "on data not used" in " ".join(done.stdout.split())
    document = json.loads((tmp_path / "noise" / "allan.json").read_text())
    assert document["gyroscope"]["factor"] == pytest.approx(1.0, abs=0.4)
    assert "Noise in motion" in (tmp_path / "noise" / "allan.html").read_text()
    assert run("calibrate", cell, "-o", tmp_path / "result").returncode == 0
    to = ("export", tmp_path / "result", "--to", "kalibr", "--grade", "fog-mems", "-o", tmp_path / "imu.yaml")
    done = run(*to, "--noise", tmp_path / "noise" / "allan.json")
    assert done.returncode == 0, done.stderr
    written = YAML(typ="safe").load((tmp_path / "imu.yaml").read_text())["imu0"]
    assert written["gyroscope_noise_density"] == pytest.approx(document["filter"]["gyro_noise_density"])
    assert "in motion, allan.json" in (tmp_path / "imu.yaml").read_text()
    refused("not an allan.json", *to, "--noise", tmp_path / "imu.yaml")


def test_a_device_turned_by_hand_is_calibrated_applied_and_certified(cell, refused, tmp_path):
    _, recording = hand_turned(HandTurns(attitudes=16), np.random.default_rng(6))
    write_folder(recording, tmp_path / "hand")
    write_folder(replace(recording, settings=RecordingSettings()), tmp_path / "unsaid")
    out = tmp_path / "out"
    done = run("static", tmp_path / "hand", "--gravity", "9.8089", "-o", out)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert "verdict: accepted" in done.stdout
    assert {p.name for p in out.iterdir()} == {"calibration.yaml", "report.html", "estimates.csv", "covariance.npz"}
    document = YAML(typ="safe").load((out / "calibration.yaml").read_text())
    schema = json.loads((Path(kreisel.__file__).parent / "calibration" / "result-schema.json").read_text())
    jsonschema.validate(document, schema)
    assert document["estimator"]["name"] == "multi-position"
    assert document["frames"].startswith("b: the accelerometers' own frame")
    K_a = np.array(document["accelerometer"]["cross_coupling"])
    assert np.array_equal(K_a, np.triu(K_a))
    printed = json.loads(run("static", tmp_path / "hand", "--gravity", "9.8089", "--json").stdout)
    assert printed["accelerometer"] == document["accelerometer"]
    assert "Vertical after each turn" in (out / "report.html").read_text()
    done = run("apply", out, tmp_path / "hand", "-o", tmp_path / "applied.csv")
    assert done.returncode == 0, done.stderr
    done = run("export", out, "--to", "kalibr", "--grade", "consumer-mems", "-o", tmp_path / "imu.yaml")
    assert done.returncode == 0, done.stderr
    done = run("certificate", out, "-o", tmp_path / "certificate.html")
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "certificate.html").read_text()
    assert "at standstills in several attitudes" in page
    assert "Static calibration by gravity" in page
    assert "gravity is not known well" in " ".join(run("static", tmp_path / "unsaid").stdout.split())
    refused("`kreisel static` does without", "calibrate", tmp_path / "hand")
    refused("unknown method 'guesswork'", "static", tmp_path / "hand", "--method", "guesswork")
    refused("no table0/data.csv", "static", tmp_path / "hand", "--method", "turntable")
    refused("six-position needs all six faces", "static", tmp_path / "hand", "--method", "six-position")


@pytest.mark.slow
def test_raw_counts_are_calibrated_and_applied_to_counts(cell, refused, tmp_path):
    """Six faces with whole turns, in counts about half of the converter's range."""
    how = HandTurns("industrial-mems", attitudes=12, laid="whole turns")
    _, recording = hand_turned(how, np.random.default_rng(7))
    imu = recording.imu
    w, a = np.round(imu.rates / 1.33e-4 + 32768.0), np.round(imu.accelerations / 6e-4 + 32768.0)
    write_folder(replace(recording, imu=replace(imu, rates=w, accelerations=a)), tmp_path / "raw")
    file = tmp_path / "raw" / "imu0" / "data.csv"
    file.write_text(file.read_text().replace("[rad s^-1]", "[counts]").replace("[m s^-2]", "[counts]"))
    done = run("static", tmp_path / "raw", "-o", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert "ferraris: all standstills are on the six faces" in " ".join(done.stdout.split())
    document = YAML(typ="safe").load((tmp_path / "out" / "calibration.yaml").read_text())
    schema = json.loads((Path(kreisel.__file__).parent / "calibration" / "result-schema.json").read_text())
    jsonschema.validate(document, schema)
    assert document["recording"]["counts"]["rate"]["size"] == pytest.approx(1.33e-4, rel=0.05)
    done = run("apply", tmp_path / "out", tmp_path / "raw", "-o", tmp_path / "applied.csv")
    assert done.returncode == 0, done.stderr
    force = np.genfromtxt(tmp_path / "applied.csv", delimiter=",", skip_header=1)[:400, 4:7]
    assert np.linalg.norm(force, axis=1).mean() == pytest.approx(9.81, abs=0.02)
    done = run("export", tmp_path / "out", "--to", "c", "-o", tmp_path / "imu.h")
    assert "Of counts, first: rates (count - " in " ".join(done.stdout.split())
    done = run("apply", tmp_path / "out", cell, "-o", tmp_path / "wrong.csv")
    assert done.returncode == 1
    assert "one of raw counts" in done.stderr
    assert not (tmp_path / "wrong.csv").exists()
    refused("raw counts", "allan", tmp_path / "raw")


@pytest.mark.slow
def test_a_robot_stops_and_is_calibrated(cell, tmp_path):
    """`calibrate --method static` and `kreisel robot` on a simulated cell."""
    text = "seed = 2\nseconds = 80\n"
    (tmp_path / "CELL.toml").write_text(text)
    assert run("simulate", tmp_path / "CELL.toml", "-o", tmp_path / "cell").returncode == 0
    done = run("calibrate", tmp_path / "cell", "--method", "static", "-o", tmp_path / "still")
    assert done.returncode == 0, done.stderr
    document = YAML(typ="safe").load((tmp_path / "still" / "calibration.yaml").read_text())
    schema = json.loads((Path(kreisel.__file__).parent / "calibration" / "result-schema.json").read_text())
    jsonschema.validate(document, schema)
    assert document["estimator"]["name"] == "static"
    assert "Reported attitude at a standstill" in (tmp_path / "still" / "report.html").read_text()
    done = run("robot", tmp_path / "cell", "-o", tmp_path / "arm")
    assert done.returncode == 0, done.stderr
    assert "poses of first half, not used" in " ".join(done.stdout.split())
    written = {"robot.yaml", "robot.urdf", "report.html", "calibration.yaml", "estimates.csv", "covariance.npz"}
    assert {p.name for p in (tmp_path / "arm").iterdir()} == written
    for wrong in (("--joint",), ("--inject",)):
        done = run("calibrate", tmp_path / "cell", tmp_path / "cell", "--method", "static", *wrong)
        assert done.returncode == 1
        assert "--method static" in done.stderr


@pytest.mark.slow
def test_recordings_of_one_device_are_calibrated_together(refused, tmp_path):
    for number in (1, 2):
        made = run("simulate", "--seed", "31", "--run", str(number), "--seconds", "50", "-o", tmp_path / f"run{number}")
        assert made.returncode == 0, made.stderr
    both = (tmp_path / "run1", tmp_path / "run2")
    out, broken = tmp_path / "out", tmp_path / "broken"
    (broken / "imu0").mkdir(parents=True)
    (broken / "imu0" / "data.csv").write_text("#timestamp [ns]\n")
    done = run("calibrate", both[0], broken, both[1], "--joint", "--same", "mount", "-o", out)
    assert done.returncode == 0, done.stderr
    assert "broken: not used; refused: " in " ".join(done.stdout.split())
    assert "the same in all: device, mount, robot, site, reference" in done.stdout
    document = YAML(typ="safe").load((out / "calibration.yaml").read_text())
    schema = json.loads((Path(kreisel.__file__).parent / "calibration" / "result-schema.json").read_text())
    jsonschema.validate(document, schema)
    assert document["recording"]["name"] == "run1 + run2"
    assert len(document["joint"]["recordings"]) == 2
    assert len((out / "estimates.csv").read_text().splitlines()) == 3
    alone = json.loads(run("calibrate", both[0], "--json").stdout)
    sd = [np.array(d["standard_deviation"]["gyroscope"]["cross_coupling"]) for d in (document, alone)]
    assert (sd[0] < sd[1]).all()
    for arguments, words in (
        (both, "kreisel repeat"), ((both[0], "--joint"), "two or more"), ((both[0], "--own", "site"), "--joint"),
        ((*both, "--joint", "--same", "weather"), "'weather'"), ((*both, "--joint", "--inject"), "one recording"),
        ((*both, "--joint", "--same", "site", "--own", "site"), "cannot be both"),
    ):  # fmt: skip
        refused(words, "calibrate", *arguments)


def test_parameters_are_fixed_and_given_priors(cell, refused):
    name = "gyroscope.cross_coupling[0,1]"
    given = ("--fix", "timing.skew=0", "--fix", "accelerometer.lever_arms[0,2]=0.08", "--prior", f"{name}=0.01 +- 1e-3")
    done = run("calibrate", cell, *given, "--json")
    document = json.loads(done.stdout)
    assert document["estimator"]["fixed"] == ["timing.skew", "accelerometer.lever_arms[0,2]"]
    assert document["standard_deviation"]["accelerometer"]["lever_arms"][0][2] == 0.0
    assert document["accelerometer"]["lever_arms"][0][2] == pytest.approx(0.08, abs=1e-7)
    for arguments, words in (
        (("--prior", f"{name}=1"), "expected 'value +- standard deviation'"),
        (("--prior", "gyroscope.bias[0]=0+-1"), "unknown parameter 'gyroscope.bias[0]'"),
        (("--fix", "gyroscope.bias[0]"), "unknown parameter 'gyroscope.bias[0]'"),
        (("--fix", "gravity=1"), "expected 9.7 to 9.9"),
        (("--fix", "gravity=heavy"), "expected a number"),
        (("--fix", "gyro_offset", "--prior", "gyro_offset=0+-1"), "is fixed"),
    ):
        refused(words, "calibrate", cell, *arguments)


def test_columns_of_a_foreign_table_are_proposed_and_used(cell, tmp_path):
    recording = kreisel.load(cell)
    plain(recording, tmp_path)
    refused = run("calibrate", tmp_path)
    assert refused.returncode == 1
    assert refused.stderr.count("\n") == 1
    assert "no mapping says which columns of imu.csv, poses.csv hold what" in refused.stderr
    (tmp_path / "recording.toml").write_text((cell / "recording.toml").read_text() + refused.stdout)
    mapped = json.loads(run("calibrate", tmp_path, "--json").stdout)
    usual = json.loads(run("calibrate", cell, "--json").stdout)
    for sensor in ("gyroscope", "accelerometer"):
        np.testing.assert_allclose(mapped[sensor]["cross_coupling"], usual[sensor]["cross_coupling"], atol=1e-9)
    given = [f"--map={name}={value}" for name, value in PLAIN.items()]
    (tmp_path / "recording.toml").unlink()
    assert run("info", tmp_path, *given).returncode == 0
    assert run("convert", tmp_path, tmp_path / "clean", *given).returncode == 0
    assert kreisel.load(tmp_path / "clean").reference.stamps_ns.size == recording.reference.stamps_ns.size
