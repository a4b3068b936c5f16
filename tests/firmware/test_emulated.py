"""The loop of a board flies: on this machine, equal to Python, and on an emulated processor, equal to this machine."""

from __future__ import annotations

import math
import shutil

import numpy as np
import pytest
from typer.testing import CliRunner

from mufly.cli import app
from mufly.control import design_flight_controller
from mufly.errors import MuflyError
from mufly.estimate import KalmanEstimator
from mufly.firmware import GenericFirmwareSoftware, describe_missing_tools
from mufly.firmware.emulated import fly_board, make_board
from mufly.firmware.emulated.board_flight import BoardEstimator, make_board_software
from mufly.firmware.emulated.board_memory import MemoryLayout
from mufly.flight import Flight, fly_mission
from mufly.flight.controllers import Actuators
from mufly.flight.mission_flight import await_estimate_and_start
from mufly.mission import load_mission
from mufly.sensors import parse_fault
from mufly.vehicle import load_vehicle

COMPILERS = [c for c in ("cc", "gcc", "clang") if shutil.which(c)]
needs_cc = pytest.mark.skipif(not COMPILERS, reason="no C compiler")
needs_qemu = pytest.mark.skipif(
    bool(describe_missing_tools()) or not COMPILERS, reason=describe_missing_tools() or "no C compiler"
)

HOP = """
name = "hop"
[take_off]
height_m = 0.4
wait_s = 0.2
[[waypoint]]
position_m = [0.3, 0.0, -0.4]
wait_s = 0.2
"""


@pytest.fixture(scope="module")
def hop(tmp_path_factory):
    file = tmp_path_factory.mktemp("hop") / "hop.toml"
    file.write_text(HOP)
    return file


@pytest.fixture(scope="module")
def vehicle():
    return load_vehicle("mufly-1.1")


@needs_cc
def test_the_loop_in_double_precision_flies_as_python_does(hop, vehicle) -> None:
    faults = [parse_fault("position.dropout@9s+1s")]
    conditions = {"wind": [0.3, 0.0, 0.0], "gust": 0.2, "seed": 3, "faults": faults}
    python = fly_mission(vehicle, hop, sensors="fitted", **conditions)
    board, compared = fly_board(vehicle, load_mission(hop), emulated=False, single=False, **conditions)
    assert python.attrs["outcome"] == board.attrs["outcome"] == "succeeded"
    assert compared.periods == 0
    for name in python.data_vars:
        one, other = python[name].values, board[name].values
        assert np.array_equal(one, other, equal_nan=one.dtype.kind == "f"), name


@needs_qemu
def test_the_emulated_board_flies_and_no_byte_differs(hop, tmp_path) -> None:
    done = CliRunner().invoke(app, ["firmware", "fly", "--qemu", str(hop), "--seed", "5", "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    said = " ".join(done.output.split())
    assert "No byte of its memory differs from this machine's in" in said
    assert "times real time" in said
    assert {"flight.mcap", "summary.json", "board.json"} <= {p.name for p in tmp_path.iterdir()}


@needs_qemu
def test_a_difference_is_named_and_a_dead_emulation_reported(hop, vehicle) -> None:
    controller = design_flight_controller(vehicle)
    board = make_board(vehicle, controller, load_mission(hop), emulated=True)
    period, request = board.ffi.new("board_period_t *"), board.ffi.new("board_request_t *")
    try:
        board.compute_estimate(period)
        board.compute_control(request)
        assert (board.mismatch_count, board.first_mismatch) == (0, "")
        board._twin.record.software.watch.lost_s += 1.0
        period.time_s = 0.005
        board.compute_estimate(period)
        assert board.mismatch_count == 1
        assert "software.watch.lost_s" in board.first_mismatch
        board._process.kill()
        with pytest.raises(MuflyError, match="ended by itself"):
            board.compute_control(request)
    finally:
        board.close()


@needs_cc
def test_memories_are_compared_by_fields(hop, vehicle) -> None:
    board = make_board(vehicle, design_flight_controller(vehicle), load_mission(hop), emulated=False)
    layout = MemoryLayout(board.ffi, "board_t")
    other = board.memory.copy()
    assert layout.describe_first_difference(board.memory, other) == ""
    record = board.ffi.cast("board_t *", board.ffi.from_buffer(other))
    record.belief.motion.rates[1] = -0.0
    board.record.belief.motion.rates[1] = 0.0
    assert layout.describe_first_difference(board.memory, other) == "belief.motion.rates[1]: 0.0 and -0.0"
    # Two numbers that are none are equal, whatever their bits; a number and none are not.
    board.record.belief.motion.rates[1] = math.nan
    record.belief.motion.rates[1] = -math.nan
    assert board.memory.tobytes() != other.tobytes()
    assert layout.describe_first_difference(board.memory, other) == ""
    board.record.software.is_lifted = True
    assert layout.describe_first_difference(board.memory, other) == "software.is_lifted: True and False"
    board.record.software.is_lifted = False
    # Padding after a flag does not count.
    padding = next(k for k in range(layout.size) if not layout._used[k])
    other[padding] ^= 0xFF
    assert layout.describe_first_difference(board.memory, other) == ""


# Periods that the processor misses


def _fly_with_lost_periods(vehicle, mission, estimator, controller, software, lost, *, made_up=True):
    """Fly for 12 s while the processor misses periods: readings are lost, the actuators keep their inputs."""
    with Flight(
        vehicle, mission, controller=controller, controllers=software, estimator=estimator, sensors="fitted", seed=4
    ) as flight:
        update, step = estimator.update, flight.autopilot.step
        count, missed, rows = 0, 0, []

        def update_or_miss(readings, acting):
            nonlocal count, missed
            count += 1
            if count in lost:
                missed += 1
                return flight.estimate
            before, missed = missed if made_up else 0, 0
            return update(readings, acting, before)

        def step_or_miss(estimate):
            if missed:
                flight.acting_actuators = Actuators(flight._acted[:2], flight._acted[2:])
                return flight.sent_actuators
            return step(estimate)

        estimator.update, flight.autopilot.step = update_or_miss, step_or_miss
        await_estimate_and_start(flight)
        while flight.time_s < 12.0 and not flight.plant.crash_cause:
            flight.step_period()
            m = flight.estimate
            rows.append(
                [*m.position, *m.velocity, *m.attitude, *flight.sent_actuators.input_array, *flight.truth.attitude]
            )
        assert not flight.plant.crash_cause
        return np.array(rows)


@needs_cc
def test_lost_periods_are_made_up_alike_in_both_languages(hop, vehicle) -> None:
    controller, mission = design_flight_controller(vehicle), load_mission(hop)
    lost = {k + j for k in range(500, 2400, 37) for j in range(1 + k % 3)}
    board = make_board(vehicle, controller, mission, emulated=False, single=False)
    c = _fly_with_lost_periods(
        vehicle,
        mission,
        BoardEstimator(board, vehicle, mission.world, 200.0),
        controller,
        make_board_software(board),
        lost,
    )
    ours = [KalmanEstimator(vehicle, mission.world, 200.0) for _ in range(2)]
    software = GenericFirmwareSoftware
    python = _fly_with_lost_periods(vehicle, mission, ours[0], controller, software, lost)
    assert python.tobytes() == c.tobytes()
    flown = slice(1600, None)
    error = np.abs(python[flown, 6:8] - python[flown, -3:-1]).max()
    skipped = _fly_with_lost_periods(vehicle, mission, ours[1], controller, software, lost, made_up=False)
    worse = np.abs(skipped[flown, 6:8] - skipped[flown, -3:-1]).max()
    assert error < 0.8 * worse
