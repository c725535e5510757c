"""Usual units other than SI, and their size in SI; used only for input and output (files, reports, terminal)."""

from __future__ import annotations

import math

STANDARD_GRAVITY = 9.80665
"""m/s^2; exact by definition (CGPM 1901). The 'g' in mg."""

DEG = math.pi / 180.0
"""rad"""

DEG_PER_HOUR = DEG / 3600.0
"""rad/s"""

DEG_PER_ROOT_HOUR = DEG / 60.0
"""rad/sqrt(s), the unit of angle random walk"""

ZERO_CELSIUS = 273.15
"""K; exact by definition."""

MG = 1e-3 * STANDARD_GRAVITY
"""m/s^2"""

PPM = 1e-6
MRAD = 1e-3
MM = 1e-3
MS = 1e-3
"""1, rad, m and s; by the prefixes of the SI."""
