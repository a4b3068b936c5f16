"""How does it fly quickly? Many periods of a flight with the exported software in one compiled call."""

from mufly.firmware.quick.many import Many

__all__ = ["Many"]
