"""Proof of the exported C: comparison on host and emulator, fuzzing, branch coverage and the report."""
