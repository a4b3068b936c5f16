"""When to ask again in a transfer, and when to give it up.

An answer is expected after a round trip; the time after which it is asked for again follows the round trips seen.
"""

from __future__ import annotations

__all__ = ["GIVE_UP_S", "Pace"]

RETRY_S = (0.25, 1.5)
"""Least and greatest time before asking again (s); MAVLink recommends 0.25 s for items and 1.5 s for the rest."""

FIRST_RETRY_S = 0.8
"""Before any round trip was seen (s): longer than one over a link of 300 ms each way."""

GIVE_UP_S = 12.0
"""A transfer that has not moved for so long is given up (s).

With 30 % lost and 300 ms each way an item is asked for 16 times by then; each time it comes with probability 0.49, so
one item in 48 000 is given up.
"""


class Pace:
    """When to ask again, and when to stop asking."""

    def __init__(self) -> None:
        self._round_trip_s: float | None = None
        self._asked_s = self._moved_s = 0.0
        self._repeated = False

    def moved(self, now_s: float) -> None:
        """Note that the transfer got on, and that the next question goes out now."""
        took = now_s - self._asked_s
        # After a repetition nobody knows which one was answered.
        if not self._repeated and took > 0.0:
            old = self._round_trip_s
            self._round_trip_s = took if old is None else 0.7 * old + 0.3 * took
        self._asked_s = self._moved_s = now_s
        self._repeated = False

    def begin(self, now_s: float) -> None:
        """Note that the first question goes out now."""
        self._asked_s = self._moved_s = now_s
        self._repeated = False

    def again(self, now_s: float) -> bool:
        """Whether to ask again now; notes that it was done."""
        trip = self._round_trip_s
        wait = FIRST_RETRY_S if trip is None else min(max(1.1 * trip + 0.05, RETRY_S[0]), RETRY_S[1])
        if now_s - self._asked_s < wait:
            return False
        self._asked_s, self._repeated = now_s, True
        return True

    def hopeless(self, now_s: float) -> bool:
        """Whether nothing has moved for too long."""
        return now_s - self._moved_s > GIVE_UP_S
