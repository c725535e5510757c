"""What libraries warn of does not reach the terminal."""

import os
import subprocess
import sys

PROGRAM = """
import logging, subprocess, sys, warnings
import numpy as np
from kreisel.cli.main import app, run

@app.command("noisy")
def noisy():
    np.mean(np.array([]))
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.warn("said by a library", RuntimeWarning)
    logging.getLogger("library").warning("logged by a library")
    child = "import warnings; warnings.warn('said by a child')"
    subprocess.run([sys.executable, "-c", child], check=True)
    print("done")

run()
"""


def run_noisy(**more: str) -> subprocess.CompletedProcess[str]:
    kept = {name: value for name, value in os.environ.items() if name not in ("PYTHONWARNINGS", "KREISEL_DEBUG")}
    return subprocess.run(
        [sys.executable, "-c", PROGRAM, "noisy"], capture_output=True, text=True, check=True, env=kept | more
    )


def test_warnings_of_libraries_do_not_reach_the_terminal() -> None:
    """Neither those of this process, whatever filters a library sets, nor those of processes that it starts."""
    done = run_noisy()
    assert done.stdout == "done\n"
    assert done.stderr == ""


def test_they_are_shown_for_finding_faults() -> None:
    said = run_noisy(KREISEL_DEBUG="1").stderr
    for text in ("Mean of empty slice", "said by a library", "logged by a library", "said by a child"):
        assert text in said


def test_what_libraries_in_c_write_does_not_reach_the_terminal() -> None:
    """Only while they work: what follows is written, also after an error."""
    code = (
        "import os, sys\nfrom kreisel.cli.foreign_warnings import kept_from_standard_error\n"
        "try:\n    with kept_from_standard_error():\n        os.write(2, b'of a library')\n        raise ValueError\n"
        "except ValueError:\n    print('our own', file=sys.stderr)\n"
    )
    kept = {name: value for name, value in os.environ.items() if name != "KREISEL_DEBUG"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=kept)
    assert done.stderr == "our own\n"
    shown = kept | {"KREISEL_DEBUG": "1"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=shown)
    assert done.stderr == "of a libraryour own\n"
