"""The library of parts: compiled beside the package's, from the same sources, when a test asks for it first."""

from __future__ import annotations

import fcntl
import hashlib
import importlib.util
import os
from pathlib import Path

from kreisel._kernels.compiled import Library

ROOT = Path(__file__).resolve().parents[2]
PARTS = Path(__file__).with_name("parts.cpp")


def built() -> Path:
    """Return the library's file: the one that `KREISEL_KERNEL_PARTS` names, or one compiled from these sources."""
    if named := os.environ.get("KREISEL_KERNEL_PARTS"):
        return Path(named)
    specification = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    build = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(build)
    key = hashlib.sha256(build.source_hash(ROOT).encode() + PARTS.read_bytes()).hexdigest()[:16]
    file = ROOT / "build" / f"kernel-parts-{key}.so"
    file.parent.mkdir(exist_ok=True)
    with (file.parent / "kernel-parts.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # tests run in several processes
        if not file.is_file():
            for old in file.parent.glob("kernel-parts-*.so"):
                old.unlink()
            build.compile_library(ROOT, file, exports=PARTS)
    return file


function = Library(built()).function
