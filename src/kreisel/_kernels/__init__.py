"""Compiled kernels: float64 arrays in, float64 arrays out; no exceptions, no objects, no SciPy.

Arrays that hold one column for each sigma point have the sigma point as their last axis, so that the
compiler can work on several of them with one instruction.
"""
