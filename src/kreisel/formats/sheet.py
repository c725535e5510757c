"""Tables of any shape: delimited text with or without header, MATLAB files, Parquet."""

from __future__ import annotations

import csv
import gzip
import io
import re
import struct
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kreisel.errors import RecordingError, unknown_name
from kreisel.formats.budget import MAX_CHUNK, MAX_EXPANSION, Budget, TooLargeError
from kreisel.formats.csv_table import is_number
from kreisel.formats.preamble import COMMENTS, without_preamble
from kreisel.geometry.rotation import Array
from kreisel.recording.header import split_unit

TEXT = (".csv", ".tsv", ".txt", ".dat", ".log", ".asc", ".tum")
SUFFIXES = (*TEXT, *(f"{suffix}.gz" for suffix in TEXT), ".mat", ".parquet")
"""Ends of the names of files that may hold a table."""

_DELIMITERS = (";", "\t", ",", " ")
_EMPTY = frozenset({"", "nan", "na", "n/a", "null", "none", "-"})
_MAX_BYTES = 1 << 31
"""Bytes of text after unpacking, 2 GiB. Chosen: the text is held whole, with lists of its lines; a few packed bytes can
stand for any number of them."""

_COMPRESSED = 15  # kind of an element, by the description of MATLAB's files of version 5
_PIECE = 1 << 20  # bytes unpacked at once
_CELL = 8  # bytes of a number

_SNIFFED = 60
"""Lines that show the delimiter: all have as many cells. Chosen: more than those in which another character comes as
often by chance; the first three may be a header."""

_EXACT = 2.0**53
"""Largest whole number up to which float64 holds all of them (IEEE 754)."""

_POINT = re.compile(r"\d\.\d|^\s*-?\.\d")


@dataclass(frozen=True)
class Sheet:
    """A table: names, units (None where none is stated) and columns, each (n,) of numbers or of text.

    Numbers that are missing are NaN. Columns without a name are called #1, #2, … `lengths` are those of separate
    arrays, before they were filled up to the longest. `scalars` are single numbers beside them, by name. `cut` is a
    last line without an end, which was left out.
    """

    source: Path
    names: tuple[str, ...]
    units: tuple[str | None, ...]
    columns: tuple[NDArray[Any], ...]
    lengths: tuple[int, ...] = ()
    scalars: tuple[tuple[str, float], ...] = ()
    cut: str = ""

    def check_lengths(self, names: Iterable[str]) -> None:
        """Check that arrays that belong together have as many values; shorter ones were filled up at their end.

        Raises
        ------
        RecordingError
            If they do not: nobody knows which values belong together.
        """
        found = {name: self.lengths[self.place(name)] for name in names} if self.lengths else {}
        if len(set(found.values())) > 1:
            sizes = ", ".join(f"{name} has {size}" for name, size in found.items())
            raise RecordingError(
                f"arrays that belong together have different numbers of values: {sizes}", file=self.source
            )

    @property
    def rows(self) -> int:
        """The number of rows."""
        return int(self.columns[0].size)

    def place(self, name: str) -> int:
        """Return the index of a column, by its name, with or without capitals, or by its number (#3).

        Raises
        ------
        RecordingError
            If there is none, or more than one.
        """
        if re.fullmatch(r"#\d+", name) and name not in self.names:
            k = int(name[1:]) - 1
            if not 0 <= k < len(self.names):
                raise RecordingError(f"column {name}: there are {len(self.names)} columns", file=self.source)
            return k
        exact = name in self.names
        found = [k for k, own in enumerate(self.names) if own == name or (not exact and own.lower() == name.lower())]
        if len(found) > 1:
            raise RecordingError(
                f"{len(found)} columns are called '{name}'; give their numbers, as #{found[0] + 1}", file=self.source
            )
        if found:
            return found[0]
        raise RecordingError(unknown_name("column", name, self.names), file=self.source)

    def numbers(self, name: str) -> Array:
        """Return a column of numbers.

        Raises
        ------
        RecordingError
            If it holds text.
        """
        k = self.place(name)
        if (text := self.text_in(k)) is not None:
            raise RecordingError(f"{text}, expected numbers", file=self.source)
        return np.asarray(self.columns[k], dtype=np.float64)

    def text_in(self, k: int) -> str | None:
        """Return what is said of a column that holds text, with its first row; None for numbers."""
        values = self.columns[k]
        if values.dtype.kind not in "OUS":
            return None
        bad = next((i for i, cell in enumerate(values) if not _is_number_or_empty(str(cell))), 0)
        return f"column '{self.names[k]}' holds text ('{str(values[bad])[:40]}' in row {bad + 1})"


def is_sheet(path: Path) -> bool:
    """Return whether the name of a file is that of a table."""
    return path.name.lower().endswith(SUFFIXES)


def read_sheet(path: Path) -> Sheet:
    """Return the table in a file.

    Raises
    ------
    RecordingError
        If it is not one that can be read; the message names the line.
    """
    suffix = path.suffix.lower()
    if not path.is_file():
        raise RecordingError("no such file", file=path)
    try:
        if suffix == ".mat":
            return _from_arrays(path, _mat_arrays(path))
        if suffix == ".parquet":
            return _from_arrays(path, _parquet_arrays(path))
        return _from_text(path, _text_of(path))
    except OSError as error:
        raise RecordingError(f"cannot be read: {error.strerror or error}", file=path) from error


def _from_arrays(path: Path, arrays: dict[str, NDArray[Any]]) -> Sheet:
    """Return a table of named arrays.

    A matrix (n, k) gives columns NAME(1) to NAME(k), n matrices (n, k, k) or (k, k, n) give NAME(1,1) to NAME(k,k).
    """
    columns: list[tuple[str, str | None, NDArray[Any]]] = []
    scalars: list[tuple[str, float]] = []
    for whole, values in arrays.items():
        name, unit = split_unit(whole)
        array = np.atleast_1d(np.squeeze(values))
        if array.dtype.kind not in "fiubMOUS" or array.ndim > 3 or array.size == 0:
            continue
        if array.size == 1 and array.dtype.kind in "fiu":
            scalars.append((whole, float(array[0])))
        unit = "ns" if array.dtype.kind == "M" else unit
        columns += [(called, unit, column) for called, column in _array_columns(name, array)]
    rows = max((column.size for *_, column in columns), default=0)
    columns = [(name, unit, column) for name, unit, column in columns if column.size > 1]
    if rows < 2 or not columns:
        raise RecordingError("holds no columns of numbers", file=path)
    names, units, _ = zip(*columns, strict=True)
    lengths = tuple(int(column.size) for *_, column in columns)
    return Sheet(path, names, units, tuple(_padded(column, rows) for *_, column in columns), lengths, tuple(scalars))


def _array_columns(name: str, array: NDArray[Any]) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the columns of an array with their names."""
    if array.ndim == 1:
        yield name, array
        return
    if array.ndim == 3:  # as MATLAB stacks matrices, or as others do
        array = np.moveaxis(array, 2, 0) if array.shape[0] == array.shape[1] != array.shape[2] else array
        for i, k in np.ndindex(array.shape[1:]):
            yield f"{name}({i + 1},{k + 1})", array[:, i, k]
        return
    for k, column in enumerate(array.T if array.shape[0] >= array.shape[1] else array):
        yield f"{name}({k + 1})", column


def _padded(column: NDArray[Any], rows: int) -> NDArray[Any]:
    """Return a column with NaN after its end; whole numbers keep their digits where they fill it."""
    if column.dtype.kind == "M":
        ns = column.astype("datetime64[ns]")
        column = np.where(np.isnat(ns), np.nan, ns.astype(np.float64)) if np.isnat(ns).any() else ns.astype(np.int64)
    if column.dtype.kind == "O":
        column = _of_objects(column)
    if column.size == rows and column.dtype.kind in "iu":
        return column.astype(np.int64)
    if column.dtype.kind in "OUS":
        return np.append(column.astype(str), np.full(rows - column.size, ""))
    return np.append(column.astype(np.float64), np.full(rows - column.size, np.nan))


def _of_objects(column: NDArray[Any]) -> NDArray[Any]:
    """Return numbers of another type (decimals, numbers with empty cells) as floats, all else as text."""
    try:
        return np.array([np.nan if cell is None else float(cell) for cell in column])
    except (TypeError, ValueError):
        return np.array(["" if cell is None else str(cell) for cell in column])


def _mat_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of a MATLAB file; fields of structures are called STRUCT.FIELD."""
    with path.open("rb") as file:
        newer = file.read(128).startswith(b"MATLAB 7.3") or _is_hdf5(path)
    if newer:
        return _hdf5_arrays(path)
    try:
        from scipy.io import loadmat
        from scipy.io.matlab import MatReadError
    except ImportError as error:
        raise RecordingError("MATLAB files need SciPy: pip install 'kreisel[tables]'", file=path) from error
    _check_packed(path)
    try:
        content = loadmat(path, squeeze_me=True, struct_as_record=False)
    except (MatReadError, ValueError, TypeError, NotImplementedError, EOFError, LookupError, zlib.error) as error:
        raise RecordingError(f"is not a MATLAB file that can be read: {error}", file=path) from error
    out: dict[str, NDArray[Any]] = {}
    waiting = [(name, value) for name, value in content.items() if not name.startswith("__")]
    while waiting:
        name, value = waiting.pop(0)
        fields = getattr(value, "_fieldnames", None)
        if fields is not None:
            waiting += [(f"{name}.{field}", getattr(value, field)) for field in fields]
        elif isinstance(value, np.ndarray | int | float) and np.asarray(value).dtype.kind in "fiub":
            out[name] = np.asarray(value)
    return out


def _check_packed(path: Path) -> None:
    """Raise an error if the compressed elements of a MATLAB file (version 5) are larger than real ones can be."""
    budget, at, data = Budget(path.stat().st_size), 128, path.read_bytes()
    order = ">" if data[126:128] == b"MI" else "<"
    with _told(path), suppress(zlib.error):  # what is damaged is told by the reader
        while at + 8 <= len(data):
            kind, size = struct.unpack_from(f"{order}II", data, at)
            element, left = zlib.decompressobj(), data[at + 8 : at + 8 + size] if kind == _COMPRESSED else b""
            while left and not element.eof:
                budget.take(len(element.decompress(left, _PIECE)))
                left = element.unconsumed_tail
            at += 8 + size


@contextmanager
def _told(path: Path) -> Iterator[None]:
    """Tell what is too large for memory as an error of the file."""
    try:
        yield
    except TooLargeError as error:
        raise RecordingError(f"is not unpacked: {error}", file=path) from error


def _is_hdf5(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(1024).find(b"\x89HDF\r\n\x1a\n") >= 0


def _hdf5_arrays(path: Path) -> dict[str, NDArray[Any]]:
    try:
        import h5py
    except ImportError as error:
        raise RecordingError("MATLAB 7.3 files need h5py: pip install 'kreisel[tables]'", file=path) from error
    out: dict[str, NDArray[Any]] = {}
    budget = Budget(path.stat().st_size)

    def add(name: str, item: Any) -> None:
        _check_inside(name, item, path)
        if isinstance(item, h5py.Dataset):
            with _told(path):
                budget.take(item.size * item.dtype.itemsize)
        if isinstance(item, h5py.Dataset) and item.dtype.kind in "fiub" and not name.startswith("#"):
            with suppress(TypeError, ValueError, OSError):  # empty or odd ones that nobody needs
                out[name.replace("/", ".")] = np.asarray(item).T  # MATLAB's first index is the last one here

    try:
        with h5py.File(path, "r") as file:
            _check_inside("/", file, path)
            file.visititems(add)
    except (OSError, RuntimeError, ValueError) as error:
        raise RecordingError(f"is not a MATLAB file that can be read: {error}", file=path) from error
    return out


def _check_inside(name: str, item: Any, path: Path) -> None:
    """Refuse numbers that HDF5 would take from another file: a recording must not read what its sender names."""
    from h5py import Dataset, ExternalLink

    if isinstance(item, Dataset):
        outside = "of another file" if item.external else "put together from other datasets" if item.is_virtual else ""
    else:
        linked = (key for key in item if isinstance(item.get(key, getlink=True), ExternalLink))
        outside = f"linked to another file ('{key}')" if (key := next(linked, None)) is not None else ""
    if outside:
        raise RecordingError(
            f"'{name}' is {outside}; expected all numbers in the file itself: save it again with them", file=path
        )


def _parquet_arrays(path: Path) -> dict[str, NDArray[Any]]:
    try:
        from pyarrow import ArrowException, parquet
    except ImportError as error:
        raise RecordingError("Parquet files need pyarrow: pip install 'kreisel[tables]'", file=path) from error
    try:
        facts = parquet.read_metadata(path)
        with _told(path):
            Budget(path.stat().st_size).take(facts.num_rows * facts.num_columns * _CELL)
        table = parquet.read_table(path)
    except (ArrowException, ValueError) as error:
        raise RecordingError(f"is not a Parquet file that can be read: {error}", file=path) from error
    out: dict[str, NDArray[Any]] = {}
    for k, name in enumerate(table.column_names):
        with suppress(ArrowException, ValueError, UnicodeDecodeError):  # lists and bytes that nobody needs
            values = table.column(k).to_numpy()
            if values.dtype.kind != "O" or not isinstance(values[0] if values.size else None, bytes | np.ndarray):
                out[name] = values
    return out


def _text_of(path: Path) -> str:
    """Return the text of a file, unpacked and decoded."""
    with path.open("rb") as file:
        packed = file.read(2) == b"\x1f\x8b"
    try:
        most = min(_MAX_BYTES, MAX_CHUNK + MAX_EXPANSION * path.stat().st_size) if packed else _MAX_BYTES
        with gzip.open(path) if packed else path.open("rb") as stream:
            data = stream.read(most + 1)
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise RecordingError(f"is not a whole gzip file ({error}); copy it again", file=path) from error
    if len(data) > most:
        raise RecordingError(f"is longer than {most} bytes{' when unpacked' if packed else ''}; split it", file=path)
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16", errors="replace")
    if b"\0" in data[:4096]:
        raise RecordingError("holds zero bytes: it is not text", file=path)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _from_text(path: Path, text: str) -> Sheet:
    above = without_preamble(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"))
    lines = above.lines
    head = _head(lines, path)
    body, cut = lines[head.first :], ""
    if not text.endswith(("\n", "\r")) and len(body) > 2:
        *body, cut = body  # as after a recorder was stopped
    names = head.names or [""] * head.count
    split = [split_unit(name.strip().lstrip("#").strip().strip("\"'")) for name in names]
    units = [own or under for (_, own), under in zip(split, head.units or [None] * head.count, strict=True)]
    called = tuple(name or f"#{k + 1}" for k, (name, _) in enumerate(split))
    return Sheet(path, called, tuple(units), tuple(_columns(body, head, path)), scalars=above.scalars, cut=cut)


@dataclass(frozen=True)
class _Head:
    """How a text is divided: delimiter (also after the last cell), decimal commas, columns, header, first line."""

    delimiter: str
    trailing: bool
    decimal_comma: bool
    count: int
    names: list[str] | None
    units: list[str | None] | None
    first: int


def _head(lines: Sequence[str], path: Path) -> _Head:
    data = [(k, line) for k, line in enumerate(lines[:2000]) if line.strip() and not _is_comment(line)]
    if len(data) < 2:
        raise RecordingError("holds no rows", file=path)
    sample = [line for _, line in data[-_SNIFFED:]] if len(data) < _SNIFFED else [line for _, line in data[3:_SNIFFED]]
    sample = sample or [line for _, line in data]
    delimiter = next((d for d in _DELIMITERS if _divides(d, sample)), None)
    if delimiter is None:
        raise RecordingError("rows do not have the same number of columns, whatever divides them", file=path)
    trailing = delimiter != " " and all(line.rstrip().endswith(delimiter) for _, line in data)
    count = len(_split(sample[-1], delimiter)) - trailing
    comma = delimiter != "," and any(re.fullmatch(r"\s*[-+]?\d*,\d+([eE][-+]?\d+)?\s*", cell)
                                     for cell in _split(sample[-1], delimiter))  # fmt: skip
    head = _Head(delimiter, trailing, comma, count, None, None, 0)
    names, units, first = None, None, data[0][0]
    for place, line in data[:4]:
        cells = _cells(line, head)
        if names is None and [cell.strip() for cell in cells] in _numbered(count):
            names, first = cells, place + 1
            continue
        if len(cells) != count or any(is_number(cell) and cell.strip().lower() not in _EMPTY for cell in cells):
            first = place
            break
        if names is None:
            names = cells
        else:
            units = [cell.strip().strip("[]()-") or None for cell in cells]
        first = place + 1
    if names is None:  # the last comment above the data
        above = [line for line in lines[:first] if _is_comment(line)]
        cells = _split(above[-1].strip().lstrip("#%/ "), delimiter) if above else []
        names = cells if len(cells) == count else None
    return _Head(delimiter, trailing, comma, count, names, units, first)


def _numbered(count: int) -> tuple[list[str], list[str]]:
    """Return headers that are only numbers of columns."""
    return [str(k) for k in range(count)], [str(k + 1) for k in range(count)]


def _divides(delimiter: str, sample: Sequence[str]) -> bool:
    counts = {len(_split(line, delimiter)) for line in sample}
    return len(counts) == 1 and counts != {1}


def _split(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return line.split()
    try:
        return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:
        return []


def _cells(line: str, head: _Head) -> list[str]:
    cells = _split(line, head.delimiter)
    if head.trailing and cells and not cells[-1].strip():
        cells = cells[:-1]
    return [cell.replace(",", ".") for cell in cells] if head.decimal_comma else cells


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith(COMMENTS)


def _is_number_or_empty(cell: str) -> bool:
    return is_number(cell) or cell.strip().lower() in _EMPTY


def _columns(body: Sequence[str], head: _Head, path: Path) -> Iterator[NDArray[Any]]:
    """Yield the columns of rows of text: of numbers, of whole numbers with many digits, or of text."""
    plain = "\n".join(body)
    if not head.decimal_comma and '"' not in plain:
        try:
            table = np.loadtxt(
                io.StringIO(plain), delimiter=None if head.delimiter == " " else head.delimiter, ndmin=2, comments="#"
            )
        except ValueError:
            table = np.zeros((0, 0))
        if table.shape[0] and table.shape[1] == head.count and not (np.abs(table) > _EXACT).any():
            yield from table.T
            return
    rows = []
    for k, line in enumerate(body):
        if not line.strip() or _is_comment(line):
            continue
        cells = _cells(line, head)
        if head.decimal_comma and any(_POINT.search(cell) for cell in _split(line, head.delimiter)):
            raise RecordingError(
                "numbers with points and numbers with commas: which divide decimals, and which thousands? Write all "
                "numbers with points, without marks between thousands",
                file=path,
                line=head.first + k + 1,
            )
        if len(cells) != head.count:
            few, many = sorted((len(cells), head.count))
            halved = head.delimiter == "," and many == 2 * few - 1  # all but the first, a number of nanoseconds
            raise RecordingError(
                f"{len(cells)} cells, expected {head.count}; "
                + (
                    "are decimals divided by commas, as columns are? Write numbers with points, or columns with "
                    "semicolons between"
                    if halved
                    else "repair or delete the row"
                ),
                file=path,
                line=head.first + k + 1,
            )
        rows.append(cells)
    for column in zip(*rows, strict=True):
        yield _column(column)


def _column(cells: Sequence[str]) -> NDArray[Any]:
    """Return cells as numbers, exact where they are whole ones; as text if one is neither number nor empty."""
    texts = [cell.strip() for cell in cells]
    if not all(map(_is_number_or_empty, texts)):
        return np.array(texts)
    if all(re.fullmatch(r"[-+]?\d{1,19}", text) for text in texts):
        whole = [int(text) for text in texts]
        if max(map(abs, whole)) < 2**63:
            return np.array(whole, dtype=np.int64)
    return np.array([np.nan if text.lower() in _EMPTY else float(text) for text in texts])
