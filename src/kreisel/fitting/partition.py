"""Where the blocks of a recording end, of which each is asked what it says by itself."""

from __future__ import annotations

import numpy as np

from kreisel.model.problem import Problem

MIN_BLOCK_SECONDS, _AT_LEAST = 4.0, 1.0
"""s; shortest block, longer than errors of a reference on its path are correlated, and that in a short recording."""

MAX_BLOCKS = 120
"""Number of blocks at most: of more, each says little, and each costs an inverse."""

MIN_BLOCKS, _WANTED = 8, 10
"""Number of blocks from which their scatter says something, and that which a short recording is divided into."""


def block_ends(problem: Problem) -> list[int]:
    """Return where blocks end: at the beginning of standstills where there are some, else by time."""
    updates, stamps = problem.schedule.updates, problem.sensor.readings.stamps
    times = stamps[np.array([update.last for update in updates])]
    whole = float(times[-1] - times[0])
    shortest = max(_AT_LEAST, min(MIN_BLOCK_SECONDS, whole / _WANTED), whole / MAX_BLOCKS)
    resting = standstills_in(problem) >= MIN_BLOCKS
    ends, begun = [], float(times[0])
    for i, update in enumerate(updates[1:], start=1):
        fitting = update.new_standstill if resting else True
        if (fitting and times[i] - begun >= shortest) or times[i] - begun >= 3.0 * shortest:
            ends.append(i + 1)
            begun = float(times[i])
    if ends and len(updates) - ends[-1] < 3:
        ends.pop()
    return [*(end for end in ends if end < len(updates)), len(updates)]


def nearest_end(problem: Problem, count: int, least: int = 1) -> int:
    """Return the number of updates up to the end of the block that ends nearest to a number of them.

    If no block ends with at least some updates before and after it, it is that number itself.
    """
    ends = [end for end in block_ends(problem) if least <= end <= len(problem.schedule.updates) - least]
    return min(ends, key=lambda end: abs(end - count), default=count)


def standstills_in(problem: Problem) -> int:
    """Return the number of standstills."""
    return sum(update.new_standstill for update in problem.schedule.updates)
