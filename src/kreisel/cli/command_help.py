"""What `kreisel --help` and the manual say of each command in a line, and examples that its own help ends with.

Examples work as they stand where the files are there; the tests read them by the commands' own options.
"""

from __future__ import annotations

from typing import NamedTuple


class CommandHelp(NamedTuple):
    """A command in one line, and lines that show its use; one that ends with a backslash goes on."""

    summary: str
    examples: tuple[str, ...] = ()

    @property
    def epilog(self) -> str | None:
        """The end of the command's help; None without examples."""
        return epilog(self.examples)


def epilog(lines: tuple[str, ...]) -> str | None:
    """Return examples as the end of a help; the first character keeps lines as they are."""
    return "\n".join(("\b", "Examples:", *(f"  {line}" for line in lines))) if lines else None


COMMANDS = {
    "calibrate": CommandHelp(
        "Calibrate an IMU from readings and reference poses.",
        (
            "kreisel calibrate recording/ -o result",
            "kreisel calibrate recording/ -o result --limits fog-mems --fix time_skew=0",
            "kreisel calibrate monday/ tuesday/ -o result --joint --same mount",
        ),
    ),
    "info": CommandHelp(
        "Print the contents of a recording, and warnings.",
        (
            "kreisel info recording/",
            "kreisel info log.csv --map 'imu.time=t [ms]' \\",
            "    --map 'imu.rate=gx, gy, gz [deg/s]'",
        ),
    ),
    "apply": CommandHelp(
        "Write true rates and specific forces of raw readings.",
        (
            "kreisel apply result raw.csv -o corrected.csv --axes imu",
            "kreisel apply result csv://127.0.0.1:4000 -o - --seconds 60",
            "kreisel apply tray recording/ --fuse -o fused.csv",
        ),
    ),
    "export": CommandHelp(
        "Write a calibration for another program, or as source code.",
        (
            "kreisel export result --to c -o imu.h",
            "kreisel export result --to kalibr --grade fog-mems -o imu.yaml",
            "kreisel export tray --to urdf -o imus.urdf",
        ),
    ),
    "certificate": CommandHelp(
        "Write the certificate of a calibration, PDF or HTML.",
        (
            "kreisel certificate result -o certificate.pdf --limits industrial-mems",
            "kreisel certificate result -o schein.html --language de --field place=Jena",
        ),
    ),
    "verify": CommandHelp(
        "Verify the signature of a certificate.",
        ("kreisel verify certificate.pdf --public-key lab.pub --calibration result",),
    ),
    "key": CommandHelp(
        "Make a pair of keys for signatures.",
        ("kreisel key -o lab",),
    ),
    "batch": CommandHelp(
        "Calibrate all recordings in a folder.",
        (
            "kreisel batch recordings/ -o lot --limits industrial-mems --jobs 4",
            "kreisel batch trial/ -o lot --simulate 12 --jobs 1",
        ),
    ),
    "history": CommandHelp(
        "Write the history of a unit over the years.",
        ("kreisel history 0042 --db lot/results.db -o 0042.html --limits fog",),
    ),
    "station": CommandHelp(
        "Calibrate unit after unit, by an operator at a page.",
        (
            "kreisel station --imu csv://H:4000 --robot rtde://R -o line --limits fog",
            "kreisel station --imu csv://H:4000 --robot rtde://R -o line --golden g",
        ),
    ),
    "gauge": CommandHelp(
        "Study a gauge: units calibrated several times.",
        ("kreisel gauge lot/results.db --limits limits.toml -o gauge.html",),
    ),
    "static": CommandHelp(
        "Calibrate an IMU without robot and poses, by standstills.",
        (
            "kreisel static recording/ -o result --gravity 9.8089",
            "kreisel static --live csv://192.168.1.30:4000 -o result --dashboard",
        ),
    ),
    "robot": CommandHelp(
        "Calibrate the robot by the IMU that it moves.",
        ("kreisel robot monday/ tuesday/ -o arm",),
    ),
    "allan": CommandHelp(
        "Print noise figures of readings at rest, or in motion.",
        (
            "kreisel allan at-rest/ -o noise",
            "kreisel allan recording/ --in-motion --json",
        ),
    ),
    "array": CommandHelp(
        "Locate the IMUs of an array that was moved by hand.",
        ("kreisel array recording/ -o array",),
    ),
    "repeat": CommandHelp(
        "Compare calibrations of one device with each other.",
        ("kreisel repeat monday/ tuesday/ wednesday/ -o repeated",),
    ),
    "compare": CommandHelp(
        "Compare estimators on recordings.",
        ("kreisel compare recording/ --methods spkf,ekf,batch -o comparison",),
    ),
    "convert": CommandHelp(
        "Convert a recording from one kind to another.",
        (
            "kreisel convert flight.bag recording/ --reference /vicon/imu/imu",
            "kreisel convert recording/ poses.tum",
        ),
    ),
    "simulate": CommandHelp(
        "Simulate a recording, with its truth.",
        (
            "kreisel simulate -o recording",
            "kreisel simulate --example > cell.toml",
            "kreisel simulate cell.toml -o recording --seed 7 --seconds 120",
        ),
    ),
    "record": CommandHelp(
        "Record an IMU and a robot; move nothing.",
        (
            "kreisel record --imu csv://192.168.1.30:4000 --robot rtde://192.168.1.20 \\",
            "    -o recording.mcap --dashboard",
        ),
    ),
    "run": CommandHelp(
        "Move a robot through a program, and record.",
        (
            "kreisel run moves.toml --robot rtde://192.168.1.20 --model ur10e \\",
            "    --imu csv://192.168.1.30:4000 -o recording.mcap",
        ),
    ),
    "krl": CommandHelp(
        "Write the program for a KUKA controller.",
        ("kreisel krl -o krl --ip 172.31.1.147",),
    ),
    "recover": CommandHelp(
        "Write a readable copy of a damaged recording.",
        ("kreisel recover recording.mcap",),
    ),
    "watch": CommandHelp(
        "Calibrate a recording again and again while it grows.",
        ("kreisel watch recording.mcap --dashboard",),
    ),
    "virtual-cell": CommandHelp(
        "Play a simulated robot and IMU over the network.",
        (
            "kreisel virtual-cell --robot rtde --imu csv -o cell",
            "kreisel virtual-cell cell.toml --robot rtde --imu csv --obey",
        ),
    ),
    "demo": CommandHelp(
        "Simulate and calibrate the paper's three devices.",
        ("kreisel demo -o demo --seconds 120",),
    ),
    "doctor": CommandHelp(
        "Check the installation.",
        ("kreisel doctor",),
    ),
    "study": CommandHelp(
        "Monte-Carlo studies in the virtual cell.",
    ),
    "study consistency": CommandHelp(
        "Check standard deviations over many trials.",
        ("kreisel study consistency --trials 20 -o study",),
    ),
    "study accuracy": CommandHelp(
        "Compare rms errors with the smallest possible ones.",
        ("kreisel study accuracy cell.toml --trials 20 -o study --workers 4",),
    ),
    "study bound": CommandHelp(
        "Print the smallest possible errors.",
        ("kreisel study bound cell.toml --trials 3",),
    ),
    "study robustness": CommandHelp(
        "Calibrate cells with errors outside the model.",
        ("kreisel study robustness --seeds 1 --only clean -o robustness",),
    ),
    "study methods": CommandHelp(
        "Compare estimators in many cells.",
        ("kreisel study methods --methods spkf,ekf,batch --seeds 3 -o methods",),
    ),
}

START = (
    "kreisel simulate -o recording           # without a robot",
    "kreisel calibrate recording -o result",
    "kreisel certificate result -o certificate.html",
)
"""Examples of the whole program."""


def help_of(command: str) -> CommandHelp:
    """Return what is said of a command; `study methods` is one of a group.

    Raises
    ------
    KeyError
        If nothing is.
    """
    return COMMANDS[command]
