"""What is assumed of the errors of a channel: a share of the reading, a share of full scale, an absolute part.

``"1%"`` is of the reading, ``"0.5%fs"`` of the largest reading, a bare number is in SI units; parts are added with
``+`` and count as independent: ``"1%+0.02"``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError

__all__ = ["ChannelNoise", "parse_noise"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ChannelNoise:
    """Standard deviation of a channel's errors.

    Attributes
    ----------
    reading, full_scale : float
        Shares of the reading and of the largest reading.
    absolute : float
        SI units of the channel.
    """

    reading: float = 0.01
    full_scale: float = 0.003
    absolute: float = 0.0

    def std(self, value: Array) -> Array:
        """Return standard deviations for readings (n,)."""
        full = self.full_scale * float(np.max(np.abs(value)))
        return np.sqrt((self.reading * value) ** 2 + full**2 + self.absolute**2)


def parse_noise(text: str | None, channels: tuple[str, ...]) -> dict[str, ChannelNoise]:
    """Read ``"current=1%+0.01,voltage=0.02"``; channels that are not named keep the default.

    Raises
    ------
    InputError
        If a channel is unknown or an amount is no number above zero.
    """
    result = {name: ChannelNoise() for name in channels}
    for part in (text or "").split(","):
        if not part.strip():
            continue
        name, _, amounts = (t.strip() for t in part.partition("="))
        if name not in result:
            raise InputError("--noise", name, "is no channel", f"use one of {', '.join(channels)}")
        amount = {"reading": 0.0, "full_scale": 0.0, "absolute": 0.0}
        for piece in amounts.lower().replace(" ", "").split("+"):
            kind, number = "absolute", piece
            if piece.endswith("%fs"):
                kind, number = "full_scale", piece[:-3]
            elif piece.endswith("%"):
                kind, number = "reading", piece[:-1]
            try:
                value = float(number) * (1.0 if kind == "absolute" else 0.01)
            except ValueError:
                value = math.nan
            if not (math.isfinite(value) and value >= 0):
                raise InputError(
                    "--noise", name, f"{piece!r} is no amount", "write 1%, 0.5%fs or a number in SI units"
                )
            amount[kind] += value
        if not any(amount.values()):
            raise InputError("--noise", name, "is zero", "leave it out, or give an amount above zero")
        result[name] = ChannelNoise(**amount)
    return result
