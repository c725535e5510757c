"""Rows of numbers from text, bit by bit as NumPy reads them, and to text, letter by letter as Python writes them."""

import io

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kreisel._kernels.decimal_rows import read_rows, write_rows

numbers = st.one_of(
    st.floats(),
    st.floats(-20.0, 20.0),
    st.integers(-(10**20), 10**20).map(float),
    st.sampled_from([0.0, -0.0, 5e-324, 2.2250738585072014e-308, 1.7976931348623157e308, 9007199254740993.0]),
)
forms = st.sampled_from(["%r", "%.17g", "%.16g", "%.18e", "%.9f", "%.3g", " %r", "%r\t", "%.25g"])
cells = st.tuples(forms, numbers).map(lambda pair: pair[0] % pair[1])
digits = st.from_regex(r"\A[-+]?(\d{1,25}\.?\d{0,25}|\.\d{1,25})([eE][-+]?\d{1,3})?\Z").filter(str.isascii)


def read(text, columns, *, whole):
    room = text.count("\n") + 1
    stamps, values = np.zeros(room if whole else 0, dtype=np.int64), np.zeros((room, columns))
    rows = read_rows(text.encode(), stamps, values)
    return rows, stamps, values


@given(st.lists(st.tuples(st.integers(-(10**18) + 1, 10**18 - 1), cells, cells | digits), min_size=1, max_size=8))
def test_numbers_are_those_that_numpy_reads(rows):
    text = "\n".join(f"{stamp},{a},{b}" for stamp, a, b in rows)
    found, stamps, values = read(text, 3, whole=True)
    expected = np.loadtxt(io.StringIO(text), delimiter=",", dtype=[("stamp", "i8"), ("a", "f8"), ("b", "f8")], ndmin=1)
    assert found == len(rows)
    np.testing.assert_array_equal(stamps[:found], expected["stamp"])
    for i, name in enumerate("ab", start=1):
        got, want = values[:found, i], expected[name]
        same = got.copy().view(np.int64) == want.copy().view(np.int64)
        assert np.all(same | (np.isnan(got) & np.isnan(want)))


@pytest.mark.parametrize("text", ["1,2\n3,4\n", "1,2\n\n\n3,4", "\n 1 , 2 \n3\t,4\n", "1e0,+2\n3.0,4.\n"])
def test_rows_are_lines_that_are_not_empty(text):
    found, _, values = read(text, 2, whole=False)
    assert found == 2
    np.testing.assert_array_equal(values[:2], [[1.0, 2.0], [3.0, 4.0]])


@pytest.mark.parametrize(
    "text",
    ["1,2,3\n", "1\n", "1,2 # two\n", "# 1,2\n", "a,2\n", "1,x\n", "1,\n", "1,1_0\n", "1.5,2\n",
     "1234567890123456789,2\n", "1;2\n", " \n", "1,2\r3,4\n", "1,0x10\n", "1,--2\n", "1,2e\n", "1,nan(3)\n"],
)  # fmt: skip
def test_what_is_not_regular_is_left_to_others(text):
    assert read(text, 2, whole=True)[0] is None


@given(st.binary(max_size=60))
def test_any_bytes_are_refused_or_read(text):
    stamps, values = np.zeros(70, dtype=np.int64), np.zeros((70, 2))
    rows = read_rows(text, stamps, values)
    assert rows is None or 0 <= rows <= text.count(b"\n") + 1
    assert read_rows(text, stamps[:0], values) is None or rows is None or rows >= 0


wholes, powers = st.integers(10**8, 10**9 - 1), st.integers(-30, 30)
exact_halves = st.builds(lambda whole, power: (whole + 0.5) * 10.0**power, wholes, powers)
near_powers = st.builds(
    lambda power, side: float(np.nextafter(10.0**power, side)), powers, st.sampled_from([0.0, 1e300])
)


@given(st.lists(st.tuples(*[numbers | exact_halves | near_powers] * 3), max_size=8))
def test_numbers_are_written_as_python_writes_nine_digits(rows):
    text = write_rows(np.array(rows, dtype=float).reshape(-1, 3)).decode()
    assert text == "".join(f"{a:.9g},{b:.9g},{c:.9g}\n" for a, b, c in rows)


def test_many_numbers_of_usual_sizes_are_written_as_python_writes_them():
    values = np.random.default_rng(4).standard_normal((20_000, 4)) * [1.0, 1e-4, 1e5, 1e-9]
    assert write_rows(values).decode() == "".join(",".join(f"{x:.9g}" for x in row) + "\n" for row in values)
