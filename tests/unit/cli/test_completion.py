"""What a shell completes: the names that options take, as their own modules know them, within the time of one look."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from typer._completion_classes import BashComplete
from typer.main import get_command

from kreisel.calibration import sharing
from kreisel.calibration.device_axes import AXES
from kreisel.certificate.content import FIELDS
from kreisel.certificate.words import LANGUAGES
from kreisel.cli import completion
from kreisel.cli.main import app
from kreisel.cli.targets import targets
from kreisel.devices.address import IMUS, MOVERS, ROBOTS
from kreisel.exchange.targets import ARRAY_TARGETS, READERS, TARGETS
from kreisel.inertial.noise_figures import GRADES
from kreisel.inertial.sensor_model import SizeEffect
from kreisel.model import calibration_settings as settings
from kreisel.model.stated_parameters import place_of
from kreisel.recording.recording_settings import ColumnsTable
from kreisel.robot.arm_library import LIBRARY
from kreisel.robot.kinematics import MODELS
from kreisel.static.static_comparison import STATIC_ESTIMATORS
from kreisel.static.static_methods import METHODS
from kreisel.study import method_rows
from kreisel.study.situations import situations


def completed(*words: str) -> list[str]:
    """Return what follows words of a command line, of which the last one is incomplete."""
    shell = BashComplete(get_command(app), {}, "kreisel", "_KREISEL_COMPLETE")
    return [item.value for item in shell.get_completions(list(words[:-1]), words[-1])]


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (("calibrate", "r", "--estimator"), settings.ESTIMATORS),
        (("calibrate", "r", "--method"), ("dynamic", "static")),
        (("calibrate", "r", "--sigma-points"), completion.WEIGHTS),
        (("calibrate", "r", "--size-effect"), tuple(SizeEffect)),
        (("calibrate", "r", "--only"), settings.SENSORS),
        (("calibrate", "r", "--use"), settings.USES),
        (("calibrate", "r", "--same"), sharing.SHARED),
        (("calibrate", "r", "--own"), sharing.SHARED),
        (("calibrate", "r", "--estimate"), settings.BY_CHOICE),
        (("calibrate", "r", "--limits"), GRADES),
        (("robot", "r", "--estimate"), [name for name in settings.BY_CHOICE if name.startswith("robot_")]),
        (("export", "r", "--to"), {**TARGETS, **ARRAY_TARGETS}),
        (("export", "r", "--from"), READERS),
        (("export", "r", "--axes"), AXES),
        (("export", "r", "--grade"), GRADES),
        (("apply", "r", "raw.csv", "--axes"), AXES),
        (("certificate", "r", "--language"), LANGUAGES),
        (("certificate", "r", "--limits"), GRADES),
        (("certificate", "r", "--field"), [f"{name}=" for name in FIELDS]),
        (("batch", "r", "--limits"), GRADES),
        (("history", "r", "--limits"), GRADES),
        (("compare", "r", "--methods"), (*settings.ESTIMATORS, *STATIC_ESTIMATORS)),
        (("static", "r", "--method"), METHODS),
        (("static", "r", "--only"), settings.SENSORS),
        (("static", "--live"), [f"{name}://" for name in IMUS]),
        (("record", "--imu"), [f"{name}://" for name in IMUS]),
        (("record", "--robot"), [f"{name}://" for name in ROBOTS]),
        (("run", "p", "--mover"), [f"{name}://" for name in MOVERS]),
        (("run", "p", "--model"), [*MODELS, *LIBRARY]),
        (("study", "methods", "--methods"), method_rows.METHODS),
        (("study", "robustness", "--only"), dict.fromkeys(one.name for one in situations())),
        (
            ("info", "r", "--map"),
            [f"{table}.{name}=" for table, one in ColumnsTable() if table != "imus" for name in type(one).model_fields],
        ),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) and len(value) < 6 else "",
)
def test_values_are_those_that_the_option_takes(words, names):
    assert sorted(completed(*words, "")) == sorted(map(str, names))


def test_only_what_begins_as_typed():
    assert completed("export", "r", "--to", "k") == ["kalibr"]
    assert completed("compare", "r", "--methods", "spkf,ekf,b") == ["spkf,ekf,batch"]
    assert "spkf,spkf" not in completed("compare", "r", "--methods", "spkf,s")


def test_groups_and_parameters_can_be_fixed():
    """Each name that is offered is one that the option takes."""
    groups = completed("calibrate", "r", "--fix", "")
    owners = [name for name in groups if name.endswith(".")]
    assert {"gyroscope.", "accelerometer.", "timing."} <= set(owners)
    for name in set(groups) - set(owners):
        settings.CalibrationSettings(fixed=(name,), polynomial_order=2)
    for owner in owners:
        names = completed("batch", "r", "--fix", owner)
        assert names
        for name in names:
            place_of(name, 2)
    assert completed("calibrate", "r", "--fix", "accelerometer.offset") == [
        f"accelerometer.offset[{i}]" for i in range(3)
    ]
    assert "gyroscope.offset[0]=" in completed("calibrate", "r", "--prior", "gyroscope.o")


def test_accuracies_are_those_that_can_be_reached():
    for command in (("static", "--until"), ("run", "p", "--until")):
        names = completed(*command, "")
        assert "accelerometer.offset=" in names
        assert len(targets([f"{name}1e-3" for name in names])) == len(names)


def test_streams_are_those_in_the_recording(tmp_path):
    for name in ("imu0", "vicon0", "cam0"):
        (tmp_path / name).mkdir()
        if name != "cam0":
            (tmp_path / name / "data.csv").touch()
    for command in ("calibrate", "info", "static", "convert"):
        assert completed(command, str(tmp_path), "--imu", "") == ["imu0", "vicon0"]
    assert completed("robot", str(tmp_path), "--reference", "v") == ["vicon0"]
    assert completed("info", str(tmp_path / "none"), "--imu", "") == []


@pytest.mark.parametrize(
    ("words", "heavy"),
    [
        (("export", "r", "--to"), ("numpy", "rich", "mcap", "rosbags", "ruamel", "jinja2")),
        (("static", "r", "--method"), ("numpy", "rich", "mcap", "rosbags", "ruamel", "jinja2")),
        (("calibrate", "r", "--fix"), ("rich", "mcap", "rosbags", "ruamel", "jinja2")),
        (("certificate", "r", "--limits"), ("rich", "mcap", "rosbags", "ruamel", "jinja2")),
    ],
    ids=lambda value: value[-1],
)
def test_completion_imports_nothing_heavy(words, heavy):
    """Names of groups and grades need NumPy, others not even that; nothing needs what reads or writes files."""
    code = (
        "import sys\nfrom kreisel.cli.main import app\nfrom typer._completion_classes import BashComplete\n"
        "from typer.main import get_command\n"
        "shell = BashComplete(get_command(app), {}, 'kreisel', '')\n"
        f"assert shell.get_completions({list(words)}, '')\n"
        f"print([name for name in {heavy} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_bash_completes(tmp_path):
    """The script that the program prints, in a shell."""
    bash, program = shutil.which("bash"), Path(sys.executable).with_name("kreisel")
    if bash is None or not program.is_file():
        pytest.skip("no bash, or kreisel is not installed as a program")
    script = (
        f'eval "$({program} --show-completion bash)"\n'
        "COMP_WORDS=(kreisel certificate result --limits fo) COMP_CWORD=4\n"
        f'_kreisel_completion {program}\nprintf "%s\\n" "${{COMPREPLY[@]}}"\n'
    )
    kept = {**os.environ, "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
    done = subprocess.run([bash, "--norc", "-c", script], capture_output=True, text=True, check=True, env=kept)
    assert done.stdout.split() == ["fog", "fog-mems"]
