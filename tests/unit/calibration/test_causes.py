"""What tells causes apart that make poses look alike."""

import numpy as np
import pytest

from kreisel.calibration.causes import _lasting


@pytest.mark.parametrize(
    ("marked", "kept"),
    [
        ("..#..", "....."), (".#####.", "......."), (".######.", ".######."), ("#######", "#######"),
        ("#.##.######", ".....######"), ("######.######", "######.######"), ("######.######.######", 20 * "."),
    ],
)  # fmt: skip
def test_what_lasts_is_no_outlier(marked, kept):
    """Of a mount that slips, updates are gross until the filter follows: neither end of the run is an outlier."""
    found = _lasting(np.array([one == "#" for one in marked]))
    assert "".join("#" if one else "." for one in found) == kept
