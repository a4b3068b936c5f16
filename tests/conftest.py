"""Keeps Hypothesis repeatable and without a clock.

A first call compiles, so an example may take seconds; and a red suite has to be red again on the next run.
"""

from hypothesis import settings

settings.register_profile("mufly", deadline=None, derandomize=True)
settings.load_profile("mufly")
