"""Wheels are what their names say: files, hashes, and a library for the platform of the tag."""

import base64
import hashlib
import importlib.util
import struct
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def loaded(name):
    """Return a module that stands beside the package."""
    spec = importlib.util.spec_from_file_location(name, ROOT / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


check = loaded("wheel_check")
TARGETS = loaded("hatch_build").TARGETS


def elf(machine, glibc="2.17"):
    return b"\x7fELF\x02\x01".ljust(18, b"\0") + struct.pack("<H", machine) + f"\0GLIBC_2.3\0GLIBC_{glibc}\0".encode()


def macho(machine, oldest=(11, 0), *, signed=True):
    commands = [struct.pack("<IIII", 0x32, 16, 1, oldest[0] << 16 | oldest[1] << 8)]
    commands += [struct.pack("<IIQ", 0x1D, 16, 0)] if signed else []
    head = b"\xcf\xfa\xed\xfe" + struct.pack("<IIIIIII", machine, 0, 6, len(commands), 16 * len(commands), 0, 0)
    return head + b"".join(commands)


def pe(machine):
    return b"MZ".ljust(0x3C, b"\0") + struct.pack("<I", 0x40) + b"PE\0\0" + struct.pack("<H", machine)


LIBRARIES = {
    "linux-x86_64": ("libkernels.so", elf(0x3E)),
    "linux-arm64": ("libkernels.so", elf(0xB7)),
    "macos-x86_64": ("libkernels.dylib", macho(0x01000007)),
    "macos-arm64": ("libkernels.dylib", macho(0x0100000C)),
    "windows-x86_64": ("kernels.dll", pe(0x8664)),
}


def wheel(folder, target, files, tags=None, change=None):
    """Write a wheel of a platform with some libraries; `change` alters a file after its hash is taken."""
    tag = TARGETS[target].tag
    path = folder / f"kreisel-1.0-py3-none-{tag}.whl"
    stated = "".join(f"Tag: py3-none-{one}\n" for one in (tags or tag).split("."))
    content = {"kreisel/__init__.py": b"", "kreisel-1.0.dist-info/WHEEL": stated.encode()}
    content |= {f"kreisel/_kernels/{name}": data for name, data in files}
    rows = []
    for name, data in content.items():
        own = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
        rows.append(f"{name},sha256={own},{len(data)}\n")
    record = "kreisel-1.0.dist-info/RECORD"
    content[record] = "".join([*rows, f"{record},,\n"]).encode()
    content |= change or {}
    with zipfile.ZipFile(path, "w") as out:
        for name, data in content.items():
            out.writestr(name, data)
    return path


def test_there_is_one_for_each_platform(tmp_path):
    assert LIBRARIES.keys() == TARGETS.keys()
    for target, library in LIBRARIES.items():
        assert library[0] == TARGETS[target].file
        check.check_wheel(wheel(tmp_path, target, [library]))


@pytest.mark.parametrize("target", TARGETS)
def test_a_library_for_another_platform_is_refused(target, tmp_path):
    for other, (_, content) in LIBRARIES.items():
        if other != target:
            with pytest.raises(check.WheelError, match="its library is one for"):
                check.check_wheel(wheel(tmp_path, target, [(TARGETS[target].file, content)]))


@pytest.mark.parametrize(
    ("target", "content", "said"),
    [
        ("linux-x86_64", elf(0x3E, "2.28"), r"needs glibc 2\.28"),
        ("macos-x86_64", macho(0x01000007, (12, 0)), r"needs macOS 12\.0"),
        ("macos-arm64", macho(0x0100000C, signed=False), "without a signature"),
        ("linux-x86_64", elf(0x28), "unknown machine"),
        ("windows-x86_64", b"!<arch>\n", "no shared library"),
        ("linux-arm64", b"\x7fELF\x02\x01", "unknown machine"),
    ],
)
def test_a_library_that_would_not_be_loaded_is_refused(target, content, said, tmp_path):
    with pytest.raises(check.WheelError, match=said):
        check.check_wheel(wheel(tmp_path, target, [(TARGETS[target].file, content)]))


def test_files_that_are_missing_or_changed_are_noticed(tmp_path):
    library = LIBRARIES["linux-x86_64"]
    both = [library, LIBRARIES["windows-x86_64"]]
    for files, more, said in (
        ([], {}, "expected one library, found none"),
        (both, {}, "expected one library, found"),
        ([library], {"tags": "linux_x86_64"}, "has the tags linux_x86_64"),
        ([library], {"change": {"kreisel/__init__.py": b"#"}}, r"__init__\.py is not as RECORD says"),
        ([library], {"change": {"kreisel/more.py": b""}}, "RECORD and files differ"),
    ):
        with pytest.raises(check.WheelError, match=said):
            check.check_wheel(wheel(tmp_path, "linux-x86_64", files, **more))


@pytest.mark.slow
def test_one_command_builds_the_wheels_of_all_platforms(tmp_path):
    """It checks them itself; the one for this machine is loaded by a Python that has nothing else of kreisel."""
    if importlib.util.find_spec("ziglang") is None:
        pytest.skip("no ziglang, the compiler for other platforms")
    build = [sys.executable, ROOT / "hatch_build.py", "--wheels", "-o", tmp_path]
    done = subprocess.run(build, capture_output=True, text=True, check=True, cwd=ROOT)
    made = [Path(line) for line in done.stdout.split() if line.endswith(".whl")]
    assert sorted(path.name.split("-none-")[1] for path in made) == sorted(f"{t.tag}.whl" for t in TARGETS.values())
    if sys.platform != "linux":
        return
    own = next(path for path in made if path.name.endswith("_x86_64.whl") and "manylinux" in path.name)
    with zipfile.ZipFile(own) as archive:
        archive.extractall(tmp_path / "there")
    code = "import kreisel; from kreisel._kernels import compiled; print(kreisel.__file__, compiled.variant)"
    loads = [sys.executable, "-P", "-c", f"import sys; sys.path.insert(0, {str(tmp_path / 'there')!r}); {code}"]
    assert str(tmp_path) in subprocess.run(loads, capture_output=True, text=True, check=True).stdout
