"""Make what the package needs besides its sources, when it is built or installed.

That is the library of `src/kernels`, and the script that draws the plots of reports. Run by hand,
``python hatch_build.py`` compiles the library into the package's folder; ``--help`` lists what else it does.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import os
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

SOURCES = Path("src/kernels")
PACKAGE = Path("src/kreisel/_kernels")
FLAGS = (
    "-std=c++17", "-O3", "-funroll-loops", "-fPIC", "-fvisibility=hidden",
    "-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math",
    "-Wall", "-Wextra", "-Werror", "-Wno-psabi", "-Wno-unused-function", "-Wno-unknown-warning-option",
)  # fmt: skip
MADE = "libkernels.made"
"""What the library in the package's folder was made by, and its content: an installation with nothing new compiles
nothing."""

SANITIZERS = ("-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-fno-omit-frame-pointer")


class Target(NamedTuple):
    """A platform: what the compiler calls it, what wheels call it, and the library's file."""

    triple: str
    tag: str
    file: str

    @property
    def x86(self) -> bool:
        """Whether the library has a variant for AVX2."""
        return self.triple.startswith("x86_64")


TARGETS = {
    "linux-x86_64": Target("x86_64-linux-gnu.2.17", "manylinux_2_17_x86_64.manylinux2014_x86_64", "libkernels.so"),
    "linux-arm64": Target("aarch64-linux-gnu.2.17", "manylinux_2_17_aarch64.manylinux2014_aarch64", "libkernels.so"),
    "macos-x86_64": Target("x86_64-macos.11.0", "macosx_11_0_x86_64", "libkernels.dylib"),
    "macos-arm64": Target("aarch64-macos.11.0", "macosx_11_0_arm64", "libkernels.dylib"),
    "windows-x86_64": Target("x86_64-windows-gnu", "win_amd64", "kernels.dll"),
}
"""Platforms that `KREISEL_TARGET` may name: wheels for them are compiled by zig on any machine."""


def this_machine() -> Target:
    """Return the platform the build runs on."""
    platform = sysconfig.get_platform()
    machine = "x86_64" if platform.endswith(("x86_64", "amd64")) else "other"
    file = {"darwin": "libkernels.dylib", "win32": "kernels.dll"}.get(sys.platform, "libkernels.so")
    return Target(machine, platform.replace("-", "_").replace(".", "_"), file)


def zig() -> list[str] | None:
    """Return the compiler of the package `ziglang`, if it is installed."""
    return [sys.executable, "-P", "-m", "ziglang", "c++"] if importlib.util.find_spec("ziglang") else None


def native_compiler() -> list[str] | None:
    """Return the C++ compiler that `CXX` names, or the first that is found."""
    if os.environ.get("CXX"):
        return shlex.split(os.environ["CXX"])
    found = (shutil.which(name) for name in ("g++", "clang++", "c++"))
    return next(([path] for path in found if path), None)


def source_hash(root: Path) -> str:
    """Return a hash of the sources, which the library keeps."""
    return hashlib.sha256(b"".join(f.read_bytes() for f in sorted((root / SOURCES).glob("*.?pp")))).hexdigest()[:16]


def made_by(root: Path) -> str:
    """Return a hash of all that a library of this machine is made of: sources, this script, and the compiler."""
    compiler = native_compiler() or zig() or []
    runs = compiler and shutil.which(compiler[0])
    version = subprocess.run([*compiler, "--version"], capture_output=True, check=False).stdout if runs else b""
    parts = [source_hash(root).encode(), (root / "hatch_build.py").read_bytes(), shlex.join(compiler).encode(), version]
    return hashlib.sha256(b"".join(parts)).hexdigest()[:16]


def _content_hash(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()[:16] if file.is_file() else ""


def compile_library(
    root: Path, out: Path, target: str | None = None, *, sanitize: bool = False, exports: Path | None = None
) -> None:
    """Compile the library for this machine, or for one of the `TARGETS`, into a file.

    exports: the file with its functions; that of the package by default.

    Raises
    ------
    SystemExit
        If there is no compiler, or it fails; its message has been printed.
    """
    platform = this_machine() if target is None else TARGETS[target]
    compiler = zig() if target is not None else native_compiler() or zig()
    if compiler is None:
        raise SystemExit(
            "kreisel: no C++ compiler found. Install g++ or clang++, name one in CXX, or run `pip install ziglang`, "
            "which is a compiler, and try again."
        )
    flags = [*FLAGS, *(SANITIZERS if sanitize else ())] + ([] if target is None else ["-target", platform.triple])
    if "windows" in platform.triple:
        flags.remove("-fPIC")
    # What sanitizers find is in the sources: one set of instructions will do, and halves the time.
    variants = {"baseline": [], **({"avx2": ["-mavx2", "-mfma"]} if platform.x86 and not sanitize else {})}
    with tempfile.TemporaryDirectory() as scratch:
        works = {
            "choose": [str(root / SOURCES / "choose.cpp"), f'-DSOURCES="{source_hash(root)}"'],
            **{
                name: [str(exports or root / SOURCES / "exports.cpp"), f"-DVARIANT={name}", *more]
                for name, more in variants.items()
            },
        }
        objects = [str(Path(scratch, f"{name}.o")) for name in works]
        running = [
            subprocess.Popen([*compiler, *flags, "-c", *work, "-o", name])
            for work, name in zip(works.values(), objects, strict=True)
        ]
        failed = [name for name, work in zip(works, running, strict=True) if work.wait() != 0]
        static = ["-static-libstdc++", "-static-libgcc"] if compiler[0].endswith("g++") and not sanitize else []
        link = [*compiler, *flags, "-shared", *objects, *static, "-o", str(Path(scratch, platform.file))]
        if failed or subprocess.run(link, check=False).returncode != 0:
            raise SystemExit(f"kreisel: {shlex.join(compiler)} failed: {', '.join(failed) or 'linking'}")
        out.parent.mkdir(parents=True, exist_ok=True)
        aside = out.with_suffix(".new")  # a process may have the old one open
        shutil.copyfile(Path(scratch, platform.file), aside)
        aside.replace(out)


class LibraryHook(BuildHookInterface[Any]):
    """What hatchling calls before it builds a wheel, or installs the package from a checkout."""

    PLUGIN_NAME = "custom"

    def dependencies(self) -> list[str]:
        """Return what the build needs besides the backend: a compiler, where there is none."""
        needs_zig = os.environ.get("KREISEL_TARGET") or native_compiler() is None
        return ["ziglang"] if needs_zig else []

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile the library and add it to the wheel."""
        del version
        name = os.environ.get("KREISEL_TARGET") or None
        if name is not None and name not in TARGETS:
            raise SystemExit(f"kreisel: KREISEL_TARGET is {name!r}; expected one of {', '.join(TARGETS)}")
        target = this_machine() if name is None else TARGETS[name]
        root = Path(self.root)
        out = root / (PACKAGE if name is None else Path("build", name)) / target.file
        kept, made = out.parent / MADE, made_by(root)
        if name is not None or not kept.is_file() or kept.read_text() != f"{made} {_content_hash(out)}":
            compile_library(root, out, name)
            if name is None:
                kept.write_text(f"{made} {_content_hash(out)}")
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{target.tag}"
        build_data["force_include"][str(out)] = f"kreisel/_kernels/{target.file}"


def build_wheels(root: Path, out: Path) -> list[Path]:
    """Build a wheel for each of the `TARGETS` by zig, check them, and return them.

    Raises
    ------
    SystemExit
        If zig is missing, a build fails, or a wheel is not what its name says.
    """
    from wheel_check import WheelError, check_wheel

    if zig() is None:
        raise SystemExit("kreisel: wheels for other platforms are compiled by zig: run `pip install ziglang` first")
    made = []
    for name, target in TARGETS.items():
        build = [sys.executable, "-P", "-m", "hatchling", "build", "-t", "wheel", "-d", str(out.resolve())]
        if subprocess.run(build, cwd=root, env={**os.environ, "KREISEL_TARGET": name}, check=False).returncode != 0:
            raise SystemExit(f"kreisel: the wheel for {name} was not built")
        wheel = max(out.glob(f"kreisel-*-py3-none-{target.tag}.whl"), key=lambda path: path.stat().st_mtime)
        try:
            check_wheel(wheel)
        except WheelError as error:
            raise SystemExit(f"kreisel: {error}") from error
        made.append(wheel)
    return made


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", dest="out", type=Path, help="the file to write, or with --wheels the folder")
    parser.add_argument("--target", choices=TARGETS, help="compile for another platform, with zig")
    parser.add_argument(
        "--exports", type=Path, help="the file with the library's functions; the tests have another one"
    )
    parser.add_argument("--sanitize", action="store_true", help="with address and undefined-behaviour sanitizers")
    parser.add_argument("--compiler", action="store_true", help="only say which C++ compiler is used; fail without one")
    parser.add_argument("--wheels", action="store_true", help="build and check the wheels of all platforms, with zig")
    options = parser.parse_args()
    if options.wheels:
        for path in build_wheels(Path(__file__).resolve().parent, options.out or Path("dist")):
            print(path)  # noqa: T201
        sys.exit()
    if options.compiler:
        sys.exit(print(shlex.join(found)) if (found := native_compiler() or zig()) else "no C++ compiler")  # noqa: T201
    here, file = Path(__file__).parent, options.out or PACKAGE / this_machine().file
    compile_library(here, file, options.target, sanitize=options.sanitize, exports=options.exports)
