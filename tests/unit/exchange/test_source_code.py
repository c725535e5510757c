"""Source code that applies a calibration, compiled and run, against `Calibration.correct`."""

import ctypes
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest

from kreisel.calibration.result import Calibration
from kreisel.errors import SettingsError
from kreisel.exchange.exported import ExportRequest
from kreisel.exchange.targets import TARGETS
from kreisel.inertial.effects import EFFECTS, OF_CHANGE, reaches_further
from kreisel.inertial.sensor_model import SizeEffect

from ..calibration.example import calibration

N = 600
JITTER = np.random.default_rng(3).uniform(-0.2, 0.2, N)
STAMPS = 1_700_000_000_000_000_000 + (2_500_000 * (np.arange(N) + JITTER)).astype(np.int64)
STAMPS[300:] += 200_000_000  # a gap
PHASE = np.add(np.outer(np.arange(N) * 0.0025, [3.0, 5.0, 7.0]), [0.0, 1.0, 2.0])
RATES, FORCES = 2.0 * np.sin(PHASE), np.add(5.0 * np.cos(PHASE), [0.0, 0.0, 9.8])
WARM = 25.0 + np.sin(np.arange(N) * 0.01)
WARNINGS = ["-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion", "-Wshadow", "-Wdouble-promotion"]


def everything() -> Calibration:
    """Return a calibration with every effect there is."""
    own = calibration().in_axes("imu")
    rng = np.random.default_rng(5)
    size = {
        "gyro_g_sensitivity": (9, 1e-4), "gyro_g_squared": (9, 1e-5), "accel_smoothing": (1, 1e-6),
        "accel_delay": (1, 1e-3), "gyro_axis_smoothing": (3, 1e-6), "accel_axis_smoothing": (3, 1e-6),
    }  # fmt: skip
    others = {}
    for group in EFFECTS:
        if not group.endswith(("polynomial", "drift")):
            count, usual = size.get(group, (3, 1e-3))
            others[group] = usual * rng.normal(size=count)
    assert own.recording is not None
    return replace(
        own, sensors=replace(own.sensors, others=others), recording=replace(own.recording, temperature_c=24.0)
    )


def text(target: str, what: Calibration, name: str = "imu") -> str:
    return TARGETS[target].export(ExportRequest(what, name=name)).files[""]


def wanted(what: Calibration) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return which samples a stream returns, and what they are: three at both ends of a run have no cubic around.

    Three more have none of rates that are themselves corrected by a cubic.
    """
    omega, f = what.correct(RATES, FORCES, STAMPS, WARM)
    reach = 6 if reaches_further(what.sensors.others) else 3
    inner = np.r_[reach : 300 - reach, 300 + reach : N - reach]
    return inner, omega[inner], f[inner]


def compiler() -> str:
    found = shutil.which("cc") or shutil.which("gcc")
    if found is None:
        pytest.skip("no C compiler")
    return found


def without_change(what: Calibration) -> Calibration:
    """Return a calibration without effects by derivatives of the gyros' readings."""
    others = {group: value for group, value in what.sensors.others.items() if group not in OF_CHANGE}
    return replace(what, sensors=replace(what.sensors, others=others))


@pytest.mark.parametrize(
    ("real", "standard", "what"),
    [
        ("double", "c99", everything()), ("float", "c99", everything()), ("double", "c++11", everything()),
        ("double", "c99", without_change(everything())),
    ],
)  # fmt: skip
def test_the_header_does_what_python_does(tmp_path, real, standard, what):
    (tmp_path / "imu.h").write_text(text("c", what))
    (tmp_path / "main.c").write_text(f"""
        #define IMU_REAL {real}
        #include "imu.h"
        #ifdef __cplusplus
        extern "C"
        #endif
        int run(int n, const int64_t *t, const {real} *w, const {real} *a, const {real} *T, int64_t *at, {real} *out);
        int run(int n, const int64_t *t, const {real} *w, const {real} *a, const {real} *T, int64_t *at, {real} *out)
        {{
            imu_stream stream = {{ {{0}}, {{{{0}}}}, {{{{0}}}}, {{{{0}}}}, {{0}}, 0 }};
            imu_sample sample;
            int k, j, count = 0;
            for (k = 0; k < n; ++k)
                if (imu_push(&stream, t[k], w + 3 * k, a + 3 * k, T[k], &sample)) {{
                    at[count] = sample.stamp_ns;
                    for (j = 0; j < 3; ++j) {{
                        out[6 * count + j] = sample.rate[j];
                        out[6 * count + 3 + j] = sample.force[j];
                    }}
                    ++count;
                }}
            return count;
        }}
    """)
    library = tmp_path / "libimu.so"
    language = ["-x", "c++"] if standard == "c++11" else ["-x", "c"]
    command = [compiler(), *language, f"-std={standard}", *WARNINGS, "-O1", "-shared", "-fPIC"]
    subprocess.run([*command, str(tmp_path / "main.c"), "-o", str(library)], check=True)
    kind = np.float64 if real == "double" else np.float32
    at, out = np.zeros(N, dtype=np.int64), np.zeros((N, 6), dtype=kind)
    arrays = [STAMPS, *(np.ascontiguousarray(x, dtype=kind) for x in (RATES, FORCES, WARM)), at, out]
    run = ctypes.CDLL(str(library)).run
    count = run(N, *(x.ctypes.data_as(ctypes.c_void_p) for x in arrays))
    inner, omega, f = wanted(what)
    np.testing.assert_array_equal(at[:count], STAMPS[inner])
    largest = np.abs(out[:count, :3] - omega).max(), np.abs(out[:count, 3:] - f).max()
    print(f"largest difference: {largest[0]:.2g} rad/s, {largest[1]:.2g} m/s^2")
    # double: rounding; float: 24 bits of 10 m/s^2, and the cubic's
    # weights of 1 / 2.5 ms on rates of 2 rad/s at arms of 4 cm
    limits = (1e-14, 1e-12) if real == "double" else (1e-6, 1e-4)
    assert largest[0] < limits[0]
    assert largest[1] < limits[1]


@pytest.mark.parametrize("what", [everything(), without_change(everything())])
def test_the_module_for_rust_does_what_python_does(tmp_path, what):
    rustc = shutil.which("rustc")
    if rustc is None:
        pytest.skip("no Rust compiler")
    (tmp_path / "imu.rs").write_text(text("rust", what))
    (tmp_path / "main.rs").write_text("""
        #![deny(warnings)]
        mod imu;
        use std::io::BufRead;
        fn main() {
            let mut stream = imu::Stream::default();
            for line in std::io::stdin().lock().lines() {
                let line = line.unwrap();
                let cells: Vec<&str> = line.split(' ').collect();
                let x: Vec<f64> = cells[1..].iter().map(|c| c.parse().unwrap()).collect();
                let t: i64 = cells[0].parse().unwrap();
                if let Some(s) = stream.push(t, &[x[0], x[1], x[2]], &[x[3], x[4], x[5]], x[6]) {
                    println!("{} {:?} {:?}", s.stamp_ns, s.rate, s.force);
                }
            }
            assert!(imu::TEMPERATURE);
        }
    """)
    subprocess.run([rustc, "--edition", "2021", "-O", "main.rs"], cwd=tmp_path, check=True)
    rows = np.column_stack([RATES, FORCES, WARM]).tolist()
    lines = "".join(f"{t} {' '.join(map(repr, row))}\n" for t, row in zip(STAMPS.tolist(), rows, strict=True))
    done = subprocess.run([tmp_path / "main"], input=lines, capture_output=True, text=True, check=True)
    found = np.array(
        [line.replace("[", "").replace("]", "").replace(",", "").split() for line in done.stdout.split("\n")[:-1]]
    )
    inner, omega, f = wanted(what)
    np.testing.assert_array_equal(found[:, 0].astype(np.int64), STAMPS[inner])
    np.testing.assert_allclose(found[:, 1:].astype(float), np.hstack([omega, f]), rtol=0, atol=2e-11)


def test_the_function_for_matlab_does_what_python_does(tmp_path):
    octave = shutil.which("octave-cli") or shutil.which("octave")
    if octave is None:
        pytest.skip("no Octave")
    what = everything()
    (tmp_path / "imu.m").write_text(text("matlab", what))
    n = 250  # in one run
    seconds = (STAMPS[:n] - STAMPS[0]) * 1e-9
    np.savetxt(tmp_path / "in.txt", np.column_stack([seconds, RATES[:n], FORCES[:n], WARM[:n]]), fmt="%.17g")
    script = "x = load('in.txt'); [w, f] = imu(x(:,1), x(:,2:4), x(:,5:7), x(:,8)); dlmwrite('out.txt', [w f], "
    subprocess.run([octave, "--eval", script + "'delimiter', ' ', 'precision', '%.17g');"], cwd=tmp_path, check=True)
    found = np.loadtxt(tmp_path / "out.txt")
    omega, f = what.correct(RATES[:n], FORCES[:n], STAMPS[:n], WARM[:n])
    np.testing.assert_allclose(found, np.hstack([omega, f]), rtol=0, atol=1e-10)


def test_the_function_for_matlab_has_no_word_of_other_languages():
    """Where there is no Octave: every cast, suffix and index of C or Rust would be an error."""
    code = "\n".join(line.split("%")[0] for line in text("matlab", everything()).splitlines())
    assert "temperature_difference = temperature(:) - (" in code
    for word in ("real", "w[", "a[", "da[", "?", "{"):
        assert word not in code


@pytest.mark.parametrize("name", ["Imu", "1imu", "imu-left", "", "while", "a" * 60])
def test_a_name_that_is_none_is_refused(name):
    with pytest.raises(SettingsError, match="expected a name of small letters"):
        text("c", calibration().in_axes("imu"), name)


def test_no_text_of_a_user_ends_a_comment():
    what = calibration().in_axes("imu")
    assert what.recording is not None
    evil = replace(
        what, recording=replace(what.recording, device={"maker": "*/ #error", "type": "a\nb", "serial_number": "1"})
    )
    head = text("c", evil).split("#ifndef")[0]
    assert head.count("*/") == 1
    assert "\nb" not in head


def test_the_printed_form_of_the_size_effect_is_not_exported():
    with pytest.raises(SettingsError, match="for comparisons"):
        text("c", replace(calibration(), size_effect=SizeEffect.FOX2005))
