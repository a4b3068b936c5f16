"""Integration of batches of vehicles, eight at a time in vector lanes.

The equations of motion are compiled on lanes (:mod:`mufly.dynamics.numba_lanes`) from the source of a single vehicle,
with selections for decisions (:mod:`mufly.dynamics.branch_selection`). The motion of a vehicle
is equal to the last bit in any block with any neighbours. :func:`mufly.dynamics.integrate_state`, for a single vehicle,
takes sine and cosine of the swash plate's tilt from the C library, so that its last bits differ.

The vehicles of a block share the decisions on parameters: whether they have maps, ground effect or a phase of the swash
plate, and the sizes of their tables. Vehicles are grouped by these (:func:`group_vehicles`).
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import cache
from types import FunctionType
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.dynamics.branch_selection import replace_branches_by_selection
from mufly.dynamics.equations_of_motion import state_derivative
from mufly.dynamics.lane_row_sums import LANE_ROW_SUMS
from mufly.dynamics.model_state import INPUT_SIZE, STATE_SIZE
from mufly.dynamics.numba_lanes import (
    LANE_NAMES,
    LANES,
    allocate_lane_record,
    make_rows,
    put_number,
    put_record,
    take_number,
)
from mufly.dynamics.simulation import normalise_state

_Array = NDArray[np.float64]
_Ints = NDArray[np.int64]

_MAP_PARAMETERS = ("map_node_count", "flight_map_node_count")


def group_vehicles(p: NDArray[np.void]) -> _Ints:
    """Return a group number (k,) for each record of :class:`ModelParameters`; vehicles in a block share their group."""
    traits = np.column_stack([
        p["map_node_count"], p["map_size"], p["flight_map_node_count"], p["flight_map_size"], p["contact_count"],
        p["ground_effect"] > 0.0, p["swash_phase"] != 0.0,
    ])  # fmt: skip
    return np.unique(traits, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)


def assign_vehicles_to_blocks(group: _Ints) -> _Ints:
    """Return the indices (b, 8) of the vehicles in each block; an incomplete block repeats its last vehicle."""
    order = np.argsort(group, kind="stable")
    ends = np.flatnonzero(np.diff(group[order])) + 1
    blocks = []
    for part in np.split(order, ends):
        missing = -len(part) % LANES
        blocks.append(np.concatenate([part, np.repeat(part[-1:], missing)]).reshape(-1, LANES))
    return np.concatenate(blocks)


def _compile_lanes(function: Any, absent: tuple[str, ...] = ()) -> Any:
    wrap = cached_njit(error_model="numpy")
    return replace_branches_by_selection(function, LANE_NAMES | LANE_ROW_SUMS, wrap=wrap, absent=absent, file=__file__)


_normalise, _derivative = _compile_lanes(normalise_state), _compile_lanes(state_derivative)


@cached_njit(error_model="numpy", nogil=True)
def _integrate_mapped(
    x: _Array, before: _Array, now: _Array, delay: _Ints, wind: _Array, p: NDArray[np.void], address: int,
    vehicle: _Ints, blocks: _Ints, dt: float, steps: int,
) -> None:  # fmt: skip
    """Integrate the vehicles of blocks (b, 8) in place; ``address`` is that of ``p``. See :func:`integrate_lanes`."""
    state, stage, inputs, air = make_rows(STATE_SIZE), make_rows(STATE_SIZE), make_rows(INPUT_SIZE), make_rows(3)
    k1, k2, k3, k4 = make_rows(STATE_SIZE), make_rows(STATE_SIZE), make_rows(STATE_SIZE), make_rows(STATE_SIZE)
    record = allocate_lane_record(p)
    for b in range(blocks.shape[0]):
        latest = 0
        for lane in range(LANES):
            k = blocks[b, lane]
            latest = max(latest, delay[k])
            for i in range(STATE_SIZE):
                put_number(state, i, lane, x[k, i])
            for i in range(INPUT_SIZE):
                put_number(inputs, i, lane, before[k, i] if delay[k] > 0 else now[k, i])
            for i in range(3):
                put_number(air, i, lane, wind[k, i])
            put_record(record, lane, address + vehicle[k] * p.itemsize)
        for step in range(steps):
            if 0 < step <= latest:
                for lane in range(LANES):
                    k = blocks[b, lane]
                    if delay[k] == step:
                        for i in range(INPUT_SIZE):
                            put_number(inputs, i, lane, now[k, i])
            _derivative(state, inputs, air, record, k1)
            for i in range(STATE_SIZE):
                stage[i] = state[i] + 0.5 * dt * k1[i]
            _derivative(stage, inputs, air, record, k2)
            for i in range(STATE_SIZE):
                stage[i] = state[i] + 0.5 * dt * k2[i]
            _derivative(stage, inputs, air, record, k3)
            for i in range(STATE_SIZE):
                stage[i] = state[i] + dt * k3[i]
            _derivative(stage, inputs, air, record, k4)
            for i in range(STATE_SIZE):
                middle = 2.0 * k2[i]
                state[i] += dt / 6.0 * (k1[i] + middle + 2.0 * k3[i] + k4[i])
            _normalise(state)
        for lane in range(LANES):
            for i in range(STATE_SIZE):
                x[blocks[b, lane], i] = take_number(state, i, lane)


def _compile_without_maps() -> Any:
    """Return :func:`_integrate_mapped` for vehicles without maps, which compiles in a third of the time."""
    plain = _integrate_mapped.py_func
    scope = {**plain.__globals__, "_derivative": _compile_lanes(state_derivative, _MAP_PARAMETERS)}
    function = FunctionType(plain.__code__, scope, "_integrate_plain")
    function.__qualname__ = "_integrate_plain"
    return cached_njit(error_model="numpy", nogil=True)(function)


_integrate_plain = _compile_without_maps()


def integrate_batch(x: _Array, u: _Array, wind: _Array, p: NDArray[np.void], dt: float, steps: int) -> None:
    """Integrate n vehicles in place on all cores, each with its own parameters and with constant inputs.

    Parameters
    ----------
    x : (n, 21) array
        States; overwritten.
    u : (n, 4) array
        Motor upper, motor lower, servo 1, servo 2.
    wind : (n, 3) array
        N-E-D (m/s).
    p : (n,) structured array of type :data:`~mufly.dynamics.PARAMETER_DTYPE`
        Parameters, one record for each vehicle.
    dt : float
        Step (s).
    steps : int
    """
    n, records = len(x), np.ascontiguousarray(p)
    integrate_lanes(
        x, u, u, np.zeros(n, dtype=np.int64), wind, records, np.arange(n),
        assign_vehicles_to_blocks(group_vehicles(records)), dt, steps, threads=numba.get_num_threads(),
    )  # fmt: skip


def integrate_lanes(
    x: _Array, before: _Array, now: _Array, delay: _Ints, wind: _Array, p: NDArray[np.void], vehicle: _Ints,
    blocks: _Ints, dt: float, steps: int, *, threads: int = 1,
) -> None:  # fmt: skip
    """Integrate n vehicles in place, each with inputs that change once, after its own delay.

    Parameters
    ----------
    x : (n, 21) array
        States; overwritten.
    before, now : (n, 4) array
        Inputs of the first ``delay`` steps, and of the others.
    delay : (n,) array
        Number of steps with the inputs ``before``.
    wind : (n, 3) array
        N-E-D (m/s).
    p : (k,) structured array of type :data:`~mufly.dynamics.PARAMETER_DTYPE`
        Parameters of the vehicles.
    vehicle : (n,) array
        Index of each vehicle's record in ``p``.
    blocks : (b, 8) array
        See :func:`assign_vehicles_to_blocks`.
    dt : float
        Step (s).
    steps : int
    threads : int
        Cores to use.
    """
    has_maps = any(bool(p[name].any()) for name in _MAP_PARAMETERS)
    integrate = _integrate_mapped if has_maps else _integrate_plain
    parts = [part for part in np.array_split(blocks, threads) if len(part)] if threads > 1 else [blocks]
    shared = (x, before, now, delay, wind, p, p.ctypes.data, vehicle)
    if len(parts) == 1:
        integrate(*shared, blocks, dt, steps)
        return
    submit: Any = _thread_pool(threads - 1).submit
    work = [submit(integrate, *shared, part, dt, steps) for part in parts[1:]]
    integrate(*shared, parts[0], dt, steps)
    for one in work:
        one.result()


@cache
def _thread_pool(count: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(count, thread_name_prefix="mufly-lanes")
