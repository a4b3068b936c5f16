"""Simulate many periods of a flight with the exported software in one compiled call."""

from mufly.firmware.quick.compiled_flight import CompiledFlight

__all__ = ["CompiledFlight"]
