"""The compiled library's functions: float64 arrays in, float64 arrays out; no objects, no files, no clocks.

The sources are C++ and lie in `src/kernels`, one file for each concept, with the same names as the modules here. A
module here says what its functions take and give, and checks lengths and indices, which the library does not.

Arrays that hold one column for each sigma point or parameter set have it as their last axis, whose length is a multiple
of `arrays.LANES`: several of them are computed with one instruction.
"""
