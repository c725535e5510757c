"""Result files that somebody changed: the entry is named."""

from __future__ import annotations

import copy
from typing import Any

import pytest

from kreisel.calibration.result_form import check_form

WHOLE: dict[str, Any] = {
    "gyroscope": {"cross_coupling": [[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]], "offset": [0.1, 0.2, 0.3]},
    "accelerometer": {
        "cross_coupling": [[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]], "offset": [0, 0, 0],
        "polynomial": {2: [0.1, 0.1, 0.1]}, "delay": 0.01,
    },
    "timing": {"offset": 0.1, "skew": None},
    "alignment": {"gravity": [0.0, 0.0, -9.8]},
    "derived": {},
    "verdict": {"accepted": True},
    "standard_deviation": {"gyroscope": {"offset": [None, 0.1, 0.1]}, "timing": {"offset": 1e-4}},
    "device_axes": {"imu": {"gyroscope": {"cross_coupling": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}}},
}  # fmt: skip


def test_a_whole_file_passes() -> None:
    check_form(WHOLE)


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        (("gyroscope",), None, "gyroscope is missing, expected a table"),
        (("gyroscope", "offset"), None, "gyroscope.offset is missing"),
        (("gyroscope", "offset"), "abc", r"gyroscope.offset is 'abc', expected 3 numbers"),
        (("gyroscope", "offset"), [1, True, 2], r"gyroscope.offset is \[1, True, 2\], expected 3 numbers"),
        (
            ("accelerometer", "cross_coupling"),
            [[1, 0], [0, 1]],
            r"cross_coupling is \[\[1, 0\], \[0, 1\]\], expected 3 x 3",
        ),
        (("accelerometer", "polynomial"), [[0, 0]], "accelerometer.polynomial is .* expected a table"),
        (("accelerometer", "delay"), "fast", "accelerometer.delay is 'fast', expected a number"),
        (("alignment", "gravity"), ["g", 0, 0], r"alignment.gravity\[0\] is 'g', expected a number"),
        (("timing",), 5, "timing is 5, expected a table"),
        (("estimator",), [1], r"estimator is \[1\], expected a table"),
        (("verdict",), "DELETED", "verdict is missing"),
        (("standard_deviation", "gyroscope", "offset"), [1, 2], "standard_deviation.gyroscope.offset is"),
        (("device_axes", "imu", "gyroscope", "cross_coupling"), [[1]], "device_axes.imu.gyroscope.cross_coupling is"),
    ],
)
def test_a_changed_entry_is_named(path: tuple[str, ...], value: object, said: str) -> None:
    document = copy.deepcopy(WHOLE)
    table = document
    for name in path[:-1]:
        table = table[name]
    table[path[-1]] = value
    if value == "DELETED":
        del table[path[-1]]
    with pytest.raises((ValueError, TypeError), match=said):
        check_form(document)
