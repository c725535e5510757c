"""Motion that turns about a few fixed axes only, one after the other.

Each of these axes is known as well as the arm. If the arm turns about an axis that is 20 mrad off the one it reports,
so is one column of the gyros' matrix, and nothing in such a recording contradicts it.
"""

from __future__ import annotations

import numpy as np

from kreisel.geometry.rotation import Array, conjugate, lengths, log, multiply
from kreisel.recording.recording import ReferencePoses

_SECONDS, _MIN_TURNS = 0.5, 40
"""s over which rotations are compared, and how many of them there must be."""

_LARGE, _CONE, _MAX = 0.3, np.radians(8.0), 3
"""Share of the larger rotations that counts, half angle of the rotations about one axis (rad), and number of axes."""

_NEARLY_ALL = 0.9
"""Share of the rotation that must be about these axes."""


def turns(reference: ReferencePoses) -> Array:
    """Return the rotations between poses half a second apart, in b, (n, 3), rad; none without orientations."""
    q = reference.quaternions
    if q is None:
        return np.zeros((0, 3))
    stride = max(1, round(_SECONDS / float(np.median(np.diff(reference.seconds)))))
    return log(multiply(conjugate(q[:-stride]), q[stride:])[:: max(1, stride // 2)])


def turning_axes(reference: ReferencePoses) -> Array:
    """Return the axes in b (3, 3; rows) that nearly all rotation is about; (0, 3) where it is about others too."""
    vectors, none = turns(reference), np.zeros((0, 3))
    if len(vectors) < _MIN_TURNS:
        return none
    angle = lengths(vectors)
    vectors = vectors[angle > _LARGE * np.percentile(angle, 95.0)]
    weight = lengths(vectors)
    directions, left, axes = vectors / weight[:, None], weight.copy(), []
    for _ in range(_MAX):
        near = np.abs(directions @ directions[int(np.argmax(left))]) > np.cos(_CONE)
        axis = np.linalg.svd(directions[near] * left[near, None])[2][0]
        left[np.abs(directions @ axis) > np.cos(_CONE)] = 0.0
        axes.append(axis)
        if not left.any():
            break
    independent = len(axes) == _MAX and abs(np.linalg.det(np.array(axes))) > np.sin(_CONE)
    return np.array(axes) if independent and left.sum() < (1.0 - _NEARLY_ALL) * weight.sum() else none
