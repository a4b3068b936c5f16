"""A network that loses, doubles, delays and swaps packets, the same way every time."""

from __future__ import annotations

import heapq
from dataclasses import dataclass, field

import numpy as np


@dataclass
class Channel:
    """One direction of a link, on a clock that the test steps.

    Parameters
    ----------
    seed : int
    loss, doubles : float
        Shares of packets that are lost, and that come twice.
    delay_s, jitter_s : float
        How long a packet takes: delay plus up to jitter, evenly; jitter beyond the gap between packets swaps them.
    """

    seed: int
    loss: float = 0.0
    doubles: float = 0.0
    delay_s: float = 0.0
    jitter_s: float = 0.0
    _under_way: list[tuple[float, int, bytes]] = field(default_factory=list)
    _count: int = 0

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)

    def send(self, now_s: float, data: bytes) -> None:
        """Put a packet in."""
        for _ in range(2 if self._random.random() < self.doubles else 1):
            if self._random.random() >= self.loss:
                self._count += 1
                late = now_s + self.delay_s + self.jitter_s * self._random.random()
                heapq.heappush(self._under_way, (late, self._count, data))

    def arrived(self, now_s: float) -> list[bytes]:
        """Take out what has arrived by now."""
        out = []
        while self._under_way and self._under_way[0][0] <= now_s:
            out.append(heapq.heappop(self._under_way)[2])
        return out
