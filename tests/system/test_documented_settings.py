"""Every setting that the documentation of recording.toml names, once through `calibrate -o`."""

import re
import tomllib
from pathlib import Path

import pytest

from kreisel.formats.write import write_folder
from kreisel.recording.recording_settings import RecordingSettings

from .breaking import Command, command, simulated

PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "recording.md"


@pytest.fixture
def kreisel(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    return command(monkeypatch, capsys)


def documented() -> list[str]:
    """Return a document of one setting for each line of the page's example, those after comment signs included."""
    (block,) = re.findall(r"```toml\n(\[imu\].*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    table, out = "", []
    for line in block.splitlines():
        if line.startswith("["):
            table = line.split("]")[0] + "]"
        setting = re.match(r'#? ?("?[\w.\[\],]+"? = .*)', line)
        if setting is not None:
            out.append(f"{table}\n{setting[1]}\n")
    return out


CLOCKS = ['[imu]\ntime_base = "imu"\n', '[imu]\ntime_base = "reference"\n', '[reference]\nkind = "mocap"\n']


@pytest.mark.parametrize("text", documented(), ids=lambda text: " ".join(text.split())[:60])
def test_a_documented_setting_is_read(text: str) -> None:
    RecordingSettings.model_validate(tomllib.loads(text))


@pytest.mark.slow
@pytest.mark.parametrize("text", [*documented(), *CLOCKS], ids=lambda text: " ".join(text.split())[:60])
def test_a_documented_setting_is_read_and_its_result_written(text: str, kreisel: Command, tmp_path: Path) -> None:
    tomllib.loads(text)
    _, recording = simulated()
    write_folder(recording, tmp_path / "run")
    if any(key in text for key in ("urdf =", "tcp =", "model =")):
        pytest.skip(
            "needs an arm: tests/system/test_simulate.py and tests/unit/preparation/test_arm_of_poses.py have one"
        )
    (tmp_path / "run" / "recording.toml").write_text(text, encoding="utf-8")
    ended = kreisel("calibrate", tmp_path / "run", "-o", tmp_path / "out")
    assert ended.status in (0, 3), ended.err
    assert (tmp_path / "out" / "calibration.yaml").is_file()
    assert (tmp_path / "out" / "report.html").is_file()


def test_the_example_names_every_table():
    """What is read here is the example, not a part of it."""
    tables = {text.split("]")[0][1:] for text in documented()}
    # [imu1] and [device1] are tables as [imu] and [device], see `test_tray`
    assert tables >= set(RecordingSettings.model_fields) - {"columns", "joints", "times", "imus", "devices"}
    assert len(documented()) > 20
