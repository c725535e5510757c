"""Rotations: unit quaternions (scalar first, Hamilton), rotation vectors and matrices.

The components are on the last axis of an array, so that one call works for one rotation or a million.
A small rotation is always added as a right perturbation: ``q [+] d = q * exp(d)``.
"""
