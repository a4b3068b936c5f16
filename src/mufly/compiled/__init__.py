"""Compiled code: Numba's cache and intrinsics, arithmetic equal in Python and C, records, and the C toolchain."""
