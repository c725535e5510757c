"""Rotations: unit quaternions (scalar first, Hamilton), rotation vectors and matrices.

Arrays carry the components on their last axis, so that one call serves one rotation or a million.
A right perturbation is meant wherever a small rotation is added: ``q [+] d = q * exp(d)``.
"""

from kreisel.geometry.rotation import (
    apply,
    conjugate,
    exp,
    from_matrix,
    from_two_vectors,
    inverse_right_jacobian,
    log,
    matrix,
    multiply,
    nearest_rotation,
    right_jacobian,
    skew,
)

__all__ = [
    "apply",
    "conjugate",
    "exp",
    "from_matrix",
    "from_two_vectors",
    "inverse_right_jacobian",
    "log",
    "matrix",
    "multiply",
    "nearest_rotation",
    "right_jacobian",
    "skew",
]
