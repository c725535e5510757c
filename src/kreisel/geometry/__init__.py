"""Rotations: unit quaternions (scalar first, Hamilton), rotation vectors and matrices.

Arrays carry the components on their last axis, so that one call serves one rotation or a million.
A right perturbation is meant wherever a small rotation is added: ``q [+] d = q * exp(d)``.
"""
