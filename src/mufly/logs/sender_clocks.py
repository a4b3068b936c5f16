"""Send times of packets from several senders, by arrival, packet numbers and each sender's clock.

An arrival minus the sender's clock is the instant of the sender's start plus the delay of the link. Within one run it
varies only with the delay, and a start lies after all earlier messages. Late packets (number or clock behind) and
restarts are distinguished accordingly: after a restart the clock shows at most the duration of the silence before, and
the following packets agree. After each start the clock is synchronised with the arrival of the fastest packet, which
had the least delay.

The *place* of a packet is its index in the order of the file, which is the order of arrival.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

MessageKey = tuple[int, int, str]
"""System, component, name of the message."""
PacketPlaces = Mapping[MessageKey, NDArray[np.int64]]
"""Indices of the packets of each sender and kind."""
SenderClock = tuple[str, NDArray[np.float64]]
"""Field with a clock, or ``"since 1970"``; and the clock (s)."""
_Array = NDArray[np.float64]
# A clock that steps back by more than this (s) was reset.
_MIN_CLOCK_RESET_S = 1.0
_MAX_LATENESS_S = 5.0
_LONGEST_UPTIME_S, _YEAR_2000_S = 1e8, 946_684_800.0
_WRAP_PERIOD_S, _NEAR_WRAP_S = 2**32 / 1e3, 60.0  # wrap of 32 bits in ms
_MIN_OUTLIER_S = 2.0
# Number of samples that must agree on a clock's offset.
_OFFSET_WINDOW_SAMPLES = 11
# A leap of the arrival beyond the first (s) while the clock advances by less than the second (s), and by so many usual
# steps.
_MIN_ARRIVAL_LEAP_S, _MAX_CLOCK_STEP_S, _MIN_LEAP_STEPS = 5.0, 2.0, 10.0
# Longest time (s) and most packets of the same sender between two copies of a doubled packet.
_DUPLICATE_WINDOW_S, _DUPLICATE_WINDOW_PACKETS = 1.0, 100
_LATE_PACKET_OFFSET_S = 1e-6  # distance of a late packet before its successor
# Fraction of packets out of order above which numbers are not used; silence in median steps.
_MAX_UNORDERED_FRACTION, _MIN_PAUSE_STEPS = 0.05, 20.0
_LATE_PACKET_WINDOW = 64  # packets within which a late one is followed by its successors


def repair_arrival_times(arrival: _Array, kept: NDArray[np.int64]) -> tuple[_Array, NDArray[np.int64], list[str]]:
    """Return arrival times that increase in file order; packets are stored in the order of their arrival.

    Single stamps far from both neighbours are interpolated; where the recording computer's clock was set back, later
    stamps are shifted to continue.

    Parameters
    ----------
    arrival : (n,) array
        Stamps by place (s).
    kept : (m,) int array
        Places of the packets in use, increasing.

    Returns
    -------
    arrival : (n,) array
        Increasing times of arrival (s).
    set_back : (k,) int array
        Places at which the computer's clock was set back.
    words : list of str
        Repairs, as sentences.
    """
    t = arrival[kept]
    words = []
    wild = np.abs(t - median_filter(t, size=5, mode="nearest")) > _MIN_OUTLIER_S
    if len(t) >= 5 and wild.any() and not wild.all():
        index = np.arange(len(t))
        t = np.where(wild, np.interp(index, index[~wild], t[~wild]), t)
        words.append(
            f"{int(wild.sum())} packets have a time of arrival far from their neighbours; interpolated "
            "between the neighbours"
        )
    back = np.minimum(np.diff(t, prepend=t[0]), 0.0)
    back[back > -_MIN_CLOCK_RESET_S] = 0.0
    if back.any():
        times = int((back < 0).sum())
        words.append(
            f"the recording computer's clock was set back {'once' if times == 1 else f'{times} times'}, by "
            f"{-back.min():.6g} s at most; times continue without the step"
        )
        t = t - np.cumsum(back)
    out = arrival.copy()
    out[kept] = t
    return out, kept[back < 0], words


def _unwrap_sequence_numbers(numbers: NDArray[np.int64], arrival: _Array) -> NDArray[np.int64] | None:
    """Unwrap the 8-bit numbers of one sender's packets to their order of sending; None if they are no count.

    Two links recorded together number their packets separately, and some programs do not number them.
    """
    step = (np.diff(numbers) + 128) % 256 - 128
    behind = np.flatnonzero(step <= 0)
    if len(behind) > _MAX_UNORDERED_FRACTION * len(numbers):
        return None
    pause = _MIN_PAUSE_STEPS * float(np.median(np.diff(arrival))) if len(arrival) > 1 else 0.0
    for k in behind.tolist():
        # A late packet precedes packets already received; after an outage or a restart the count continues.
        returns = np.cumsum(step[k : k + _LATE_PACKET_WINDOW]).max() > 0
        if step[k] == 0 or not returns or arrival[k + 1] - arrival[k] > pause:
            step[k] += 256
    return np.concatenate(([0], np.cumsum(step)))


def order_by_packet_number(
    places: PacketPlaces, arrival: _Array, number: NDArray[np.int64]
) -> tuple[_Array, NDArray[np.bool_]]:
    """Return arrival times in the order of the senders' packet numbers, and which packets are duplicates.

    Parameters
    ----------
    places : dict
        Places of the packets of each sender and kind.
    arrival : (n,) array
        Times of arrival by place (s).
    number : (n,) int array
        Checksum * 256 + packet number, by place.

    Returns
    -------
    arrival : (n,) array
        Times by which a late packet arrives no later than packets sent after it.
    again : (n,) bool array
        Whether a packet is a copy of an earlier one. Senders without numbers have none.
    """
    arrival, again = arrival.copy(), np.zeros(len(arrival), dtype=bool)
    senders: defaultdict[tuple[int, int], list[NDArray[np.int64]]] = defaultdict(list)
    for key, part in places.items():
        senders[key[:2]].append(part)
    for parts in senders.values():
        own = np.sort(np.concatenate(parts))
        order = np.argsort(number[own], kind="stable")
        same = np.diff(number[own[order]]) == 0
        same &= (np.diff(order) < _DUPLICATE_WINDOW_PACKETS) & (np.diff(arrival[own[order]]) < _DUPLICATE_WINDOW_S)
        repeated = np.zeros(len(own), dtype=bool)
        repeated[order[1:][same]] = True
        once = own[~repeated]
        count = _unwrap_sequence_numbers(number[once] % 256, arrival[once])
        if count is not None:
            again[own] = repeated
            sent = once[np.argsort(count, kind="stable")]
            came = np.minimum.accumulate(arrival[sent][::-1])[::-1]
            arrival[sent] = np.where(came < arrival[sent], came - _LATE_PACKET_OFFSET_S, came)
    return arrival, again


def find_sender_clock(fields: Mapping[str, NDArray[Any]]) -> SenderClock | None:
    """Return field and values of the sender's clock (s since its start or since 1970).

    None if no field is a clock, or a stamp was never set.
    """
    for name, tick in (("time_boot_ms", 1e3), ("time_usec", 1e6)):
        if name in fields:
            time = fields[name].astype(np.float64) / tick
            # A simulation may begin at 0; a later 0 is a stamp never set.
            rest = time[1:] if len(time) > 1 else time
            since_start = time.max() < _LONGEST_UPTIME_S
            if rest.min() > 0 and (since_start or time.min() > _YEAR_2000_S):
                return (name if since_start else "since 1970"), time
    return None


class _ClockSamples(NamedTuple):
    """Clock samples of one sender in file order: position in the file, arrival time and sender's clock."""

    file_positions: NDArray[np.int64]
    arrival_s: _Array
    clock_s: _Array


def _collect_clock_samples(
    arrival: _Array, places: PacketPlaces, clocks: Mapping[MessageKey, SenderClock], own: Sequence[MessageKey]
) -> _ClockSamples:
    lead = [key for key in own if clocks[key][0] == "time_boot_ms"] or list(own)
    at = np.concatenate([places[key] for key in lead])
    sent = np.concatenate([clocks[key][1] for key in lead])
    order = np.argsort(at, kind="stable")
    return _ClockSamples(at[order], arrival[at[order]], sent[order])


class _ClockRestart(NamedTuple):
    """Restart of a sender's clock.

    The fields are its first sample, whether the sender restarted (else its clock was set back), and the least
    difference of arrival time and clock afterwards (s).
    """

    first_sample: int
    sender_restarted: bool
    min_clock_offset_s: float


def _find_clock_restarts(run: _ClockSamples) -> list[_ClockRestart]:
    since = run.arrival_s - run.clock_s
    rest = np.minimum.accumulate(since[::-1])[::-1]
    silence = np.diff(run.arrival_s)
    back = (np.diff(run.clock_s) < -_MIN_CLOCK_RESET_S) & (rest[1:] > since[:-1] + _MIN_CLOCK_RESET_S / 4)
    new = (run.clock_s[1:] <= silence + _MIN_CLOCK_RESET_S) & (np.diff(since) > _MIN_CLOCK_RESET_S)
    out: list[_ClockRestart] = []
    for k in (np.flatnonzero(back | new) + 1).tolist():
        begun = out[-1].first_sample if out else 0
        # Of the continuing run, even if late packets of the run before are among it.
        level = max(float(since[begun]), float(np.median(since[max(begun, k - _OFFSET_WINDOW_SAMPLES) : k])))
        by = float(np.median(since[k : k + _OFFSET_WINDOW_SAMPLES])) - level
        if by <= _MIN_CLOCK_RESET_S:
            continue
        earliest = float(run.arrival_s[k - 1]) - _MIN_CLOCK_RESET_S
        if new[k - 1] and level + by >= earliest:
            out.append(_ClockRestart(k, True, earliest))
        elif back[k - 1] and len(since) - k >= _OFFSET_WINDOW_SAMPLES and rest[k] > level + 0.5 * by:
            # Set back to another time: the clock does not return to its former offset.
            out.append(_ClockRestart(k, False, level + 0.5 * by))
    return out


def _find_min_clock_differences(since: _Array, borders: Sequence[_ClockRestart]) -> _Array:
    """Return the least of ``since``, arrival time less sender's clock (s), between successive clock restarts.

    Late packets of the previous run are left out.
    """
    parts = np.split(since, [b.first_sample for b in borders])
    least = [-np.inf, *(b.min_clock_offset_s for b in borders)]
    return np.array([part[part >= bound].min() for part, bound in zip(parts, least, strict=True)])


def remove_arrival_leaps(
    arrival: _Array,
    places: PacketPlaces,
    clocks: Mapping[MessageKey, SenderClock],
    vehicle: tuple[int, int],
    set_back: NDArray[np.int64],
) -> tuple[_Array, list[str]]:
    """Return arrival times without the jumps that the vehicle's clock does not show, and notes on them.

    Such a jump arises when the recording computer's clock is set. A restart of the vehicle is no jump, because its
    clock begins at 0; nor is a stall of the link, after which both clocks agree again. The vehicle's clock gives the
    size of a step back (at the places ``set_back``).

    Returns
    -------
    arrival : (n,) array
        Times of arrival without the jumps (s).
    words : list of str
    """
    own = [key for key in clocks if key[:2] == vehicle and clocks[key][0] != "since 1970"]
    if not own:
        return arrival, []
    run = _collect_clock_samples(arrival, places, clocks, own)
    since, arrival = run.arrival_s - run.clock_s, arrival.copy()
    step = np.diff(since)
    usual = float(np.median(np.abs(step))) if len(step) else 0.0
    sudden = (step > max(_MIN_ARRIVAL_LEAP_S, _MIN_LEAP_STEPS * usual)) & (
        np.abs(np.diff(run.clock_s)) < _MAX_CLOCK_STEP_S
    )
    words: list[str] = []
    for place in set_back.tolist():
        k = int(np.searchsorted(run.file_positions, place))
        if 0 < k < len(since) and 0 <= run.clock_s[k] - run.clock_s[k - 1] < _MAX_CLOCK_STEP_S:
            by = float(
                since[k : k + _OFFSET_WINDOW_SAMPLES].min() - since[max(0, k - _OFFSET_WINDOW_SAMPLES) : k].min()
            )
            arrival[place:] -= by
            since[k:] -= by
    for k in (np.flatnonzero(sudden) + 1).tolist():
        before = float(since[max(0, k - _OFFSET_WINDOW_SAMPLES) : k].min())
        by = float(since[k : k + _OFFSET_WINDOW_SAMPLES].min()) - before
        if (
            len(since) - k >= _OFFSET_WINDOW_SAMPLES
            and by > _MIN_ARRIVAL_LEAP_S
            and since[k:].min() > before + 0.8 * by
        ):
            between = arrival[run.file_positions[k - 1] : run.file_positions[k] + 1]
            at = int(run.file_positions[k - 1] + 1 + np.diff(between).argmax())
            words.append(
                f"the time of arrival jumps by {by:.6g} s at {arrival[at - 1]:.0f} s, the vehicle's clock does not"
            )
            arrival[at:] -= by
            since[k:] -= by
    return arrival, words


def estimate_sending_times(
    arrival: _Array, places: PacketPlaces, clocks: Mapping[MessageKey, SenderClock], vehicle: tuple[int, int]
) -> tuple[dict[MessageKey, _Array], list[str]]:
    """Return the sending times of packets by their senders' clocks, synchronised with the arrival after every restart.

    Parameters
    ----------
    arrival : (n,) array
        Time of arrival of each packet, in the order of the file (s).
    places, clocks : dict
        Indices of the packets, and clocks (s), of each sender and kind of message; ``clocks`` omits kinds without a
        clock.
    vehicle : (system, component)
        MAVLink address of the vehicle.

    Returns
    -------
    times : dict
        Sending times of the messages whose clock can be synchronised (s).
    words : list of str
        Notes on the clocks.
    """
    out: dict[MessageKey, _Array] = {}
    words: list[str] = []
    senders: defaultdict[tuple[int, int, bool], list[MessageKey]] = defaultdict(list)
    for key, (name, _) in clocks.items():
        senders[key[0], key[1], name == "since 1970"].append(key)
    for (system, component, since_1970), own in senders.items():
        run = _collect_clock_samples(arrival, places, clocks, own)
        wrapped = np.flatnonzero((run.clock_s[:-1] > _WRAP_PERIOD_S - _NEAR_WRAP_S) & (run.clock_s[1:] < _NEAR_WRAP_S))
        after = int(run.file_positions[wrapped[0] + 1]) if len(wrapped) else len(arrival)
        run = run._replace(clock_s=_unwrap_clock(run.clock_s, run.file_positions, after))
        borders = _find_clock_restarts(run)
        at = np.array([b.first_sample for b in borders], dtype=np.int64)
        quickest = _find_min_clock_differences(run.arrival_s - run.clock_s, borders)
        for key in own:
            name, clock = clocks[key]
            clock = _unwrap_clock(clock, places[key], after) if name == "time_boot_ms" else clock
            came = arrival[places[key]]
            k = np.searchsorted(run.file_positions[at], places[key], side="right")
            # A packet may arrive after a restart, or a topic be the first after one.
            near = np.clip(k + np.array([[-1], [0], [1]]), 0, len(quickest) - 1)
            delay = came - clock - quickest[near]
            delay[delay < -_MIN_CLOCK_RESET_S / 2] = np.inf
            best = np.take_along_axis(near, delay.argmin(axis=0)[None], axis=0)[0]
            time = clock + quickest[np.where(np.isfinite(delay.min(axis=0)), best, k)]
            lag = came - time
            # A clock of another kind (of the GPS receiver) does not fit, a slow link does.
            if name == "time_boot_ms" or (lag.min() > -_MIN_CLOCK_RESET_S and np.median(lag) < _MAX_LATENESS_S):
                out[key] = time
        who = "the vehicle" if (system, component) == vehicle else f"component {system}.{component}"
        for started, what in ((True, "started anew"), (False, "had its clock set back")):
            when = ", ".join(f"{run.arrival_s[k]:.0f}" for k, new, _ in borders if new is started)
            if when and not since_1970:
                words.append(
                    f"{who} {what} at {when} s of the log; its clock was synchronised with the log's each time"
                )
    if not any(key[:2] == vehicle for key in out):
        words.append("no message contains the vehicle's clock; times are those of arrival, with the link's jitter")
    return out, words


def _unwrap_clock(clock: _Array, places: NDArray[np.int64], after: int) -> _Array:
    """Unwrap a 32-bit millisecond clock (s): from file position ``after`` on, small values are one period later."""
    return np.where((places >= after) & (clock < 0.5 * _WRAP_PERIOD_S), clock + _WRAP_PERIOD_S, clock)
