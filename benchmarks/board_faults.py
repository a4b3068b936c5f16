"""Interrupt a board at random instants of a flight: resets, failing log, worn flash.

    nice -n 19 python benchmarks/board_faults.py --instants 200

One flight of the demonstration (wind 0.5 m/s, gusts 0.3 m/s) is flown by the host's single-precision build of the
board, and its inputs are kept. Each case replays them to an instant, applies a fault and goes on:

- brown-out, watchdog, software, pin: the board starts anew. Its motors stay off, the kept record names the cause and
  whether the motors ran, the first request to arm is refused after an interrupted flight, settings and the log before
  the instant are whole.
- failing log (refuses, silent, worn, full) and worn flash: the actuators of the next two seconds are bit for bit those
  of the flight without the fault, and a fault of the log is reported.

Lost link, lost receiver and a stuck sensor bus need the plant; they are not in here.
"""

from __future__ import annotations

import argparse
from collections import Counter
from typing import Any

import numpy as np

from mufly.control import design_flight_controller
from mufly.firmware.emulated import HostBoard, make_board
from mufly.firmware.emulated.board_flight import BoardEstimator, make_board_software
from mufly.flight import fly_mission
from mufly.logs.block_log import split_image_into_sessions
from mufly.mission import load_mission
from mufly.vehicle import load_vehicle

AFTER_PERIODS = 400
ARMING_INTERRUPTED = 128  # bit of supervisor.h
RESET_CAUSES = {"brown-out": 1, "watchdog": 2, "software": 3, "pin": 4}  # RESET_BY_... of fault_record.h


def record_inputs(board: HostBoard, seed: int) -> list[tuple[bytes, bytes]]:
    """Fly, and return the records of each period that the board has got."""
    vehicle, mission = load_vehicle("mufly-1.1"), load_mission("demonstration")
    controller = design_flight_controller(vehicle)
    inputs: list[list[bytes]] = []
    estimate, control = board.compute_estimate, board.compute_control

    def compute_estimate(period: Any) -> None:
        inputs.append([bytes(board.ffi.buffer(period))])
        estimate(period)

    def compute_control(request: Any) -> None:
        inputs[-1].append(bytes(board.ffi.buffer(request)))
        control(request)

    board.compute_estimate, board.compute_control = compute_estimate, compute_control  # type: ignore[method-assign]
    flown = fly_mission(
        vehicle, mission, controller=controller, wind=[0.5, 0.0, 0.0], gust=0.3, seed=seed, sensors="fitted",
        estimator=BoardEstimator(board, vehicle, mission.world, controller.rate_Hz),
        controllers=make_board_software(board),
    )  # fmt: skip
    board.compute_estimate, board.compute_control = estimate, control  # type: ignore[method-assign]
    print(f"flight: {flown.attrs['outcome']}, {len(inputs)} periods", flush=True)
    return [(one[0], one[1]) for one in inputs if len(one) == 2]


class Replay:
    """A board that gets the inputs of a flight again, with its state at the instants."""

    def __init__(self, board: HostBoard, inputs: list[tuple[bytes, bytes]]) -> None:
        self.board, self.inputs, self.ffi, self.lib = board, inputs, board.ffi, board.lib
        self.period, self.request = self.ffi.new("board_period_t *"), self.ffi.new("board_request_t *")
        self.kept = self.ffi.new("fault_record_t *")

    def step(self, k: int, given: bool = True) -> bytes:
        period, request = self.inputs[k]
        self.ffi.memmove(self.period, period, len(period))
        self.ffi.memmove(self.request, request, len(request))
        self.request.is_given = given
        self.board.compute_estimate(self.period)
        self.board.compute_control(self.request)
        r = self.board.record
        motors_run = r.software.motors != 0
        self.lib.fault_record_update(self.kept, motors_run, r.software.mission.state, r.belief.time_s)
        return bytes(self.ffi.buffer(self.ffi.addressof(r, "sent")))

    def save(self) -> tuple[Any, ...]:
        b = self.board
        blocks = b.log_blocks[: b.record.log.device.place + 64].copy()
        return (
            b.memory.copy(),
            b.flash.copy(),
            blocks,
            bytes(self.ffi.buffer(b.block_model)),
            bytes(self.ffi.buffer(self.kept)),
        )

    def restore(self, saved: tuple[Any, ...]) -> None:
        b = self.board
        memory, flash, blocks, model, kept = saved
        b.memory[:], b.flash[:] = memory, flash
        b.log_blocks[:] = 0
        b.log_blocks[: len(blocks)] = blocks
        self.ffi.memmove(b.block_model, model, len(model))
        self.ffi.memmove(self.kept, kept, len(kept))
        b.flash_model.worn_sector = b.flash_model.worn_word = -1


def check_restart(r: Replay, k: int, cause: int) -> list[str]:
    """Restart at an instant; return what is wrong."""
    b, lib = r.board, r.lib
    ran = b.record.software.motors != 0
    logged = split_image_into_sessions(b.log_blocks[: b.record.log.device.place + 1].tobytes())
    flash, wrong = b.flash.copy(), []
    kind = lib.fault_record_begin(r.kept, cause)
    expected = lib.RESTART_IN_FLIGHT if ran else lib.RESTART_ON_FLOOR
    if (kind, r.kept.cause) != (expected, cause):
        wrong.append(f"kind {kind}, cause {r.kept.cause} kept")
    b.memory[:] = 0  # the start-up code clears all but the kept record
    lib.board_start(b.record, b._fitted, kind)
    if not np.array_equal(flash, b.flash) and b.record.settings.storage.active >= 0:
        wrong.append("stored settings changed")
    ask = r.ffi.new("user_request_t *")
    ask.kind = lib.USER_ARM
    refused = 0
    for j in range(min(AFTER_PERIODS, len(r.inputs) - k)):
        sent = r.step(k + j, given=False)
        if any(sent):
            wrong.append(f"actuators run {j} periods after the restart")
            break
        if j == 300:
            s = b.record
            lib.supervisor_request(
                r.ffi.addressof(s, "supervisor"), r.ffi.addressof(lib.mufly_setup), r.ffi.addressof(s, "software"),
                r.ffi.addressof(s, "belief"), ask,
            )  # fmt: skip
            refused = s.supervisor.arming_faults & ARMING_INTERRUPTED
            if ran and (s.supervisor.armed or not refused):
                wrong.append("the first request to arm was not refused for the interrupted flight")
    now = {s.number: s.ulog for s in split_image_into_sessions(b.log_blocks[:4096].tobytes())}
    if any(now.get(s.number) != s.ulog for s in logged):
        wrong.append("the log before the restart changed")
    return wrong


def check_device_fault(r: Replay, k: int, fault: str, sent: list[bytes]) -> list[str]:
    """Let log or flash fail at an instant; the actuators must not differ. Return what is wrong."""
    b, device = r.board, r.board.record.log.device
    worn = np.ones(b.block_model.blocks, np.uint8)
    if fault == "worn flash":
        b.flash_model.worn_sector, b.flash_model.worn_word = 0, 3
    elif fault == "full log":
        device.used_places = b.block_model.blocks - 33
    elif fault == "worn log":
        b.block_model.worn = r.ffi.cast("uint8_t *", r.ffi.from_buffer(worn))
    else:
        setattr(b.block_model, {"log refuses": "refuses", "log silent": "is_silent"}[fault], True)
    wrong, many = [], min(AFTER_PERIODS + 60, len(r.inputs) - k)
    for j in range(many):
        if r.step(k + j) != sent[k + j]:
            wrong.append(f"actuators differ {j} periods after the fault")
            break
    if many > AFTER_PERIODS and fault != "worn flash":
        expected = r.lib.BLOCK_LOG_FULL if fault == "full log" else r.lib.BLOCK_LOG_FAILED
        if (device.state, device.faults != 0) != (expected, True):
            wrong.append(f"the log's state is {device.state}, faults {device.faults}")
    b.block_model.worn = r.ffi.NULL
    return wrong


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--instants", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    vehicle, mission = load_vehicle("mufly-1.1"), load_mission("demonstration")
    board = make_board(vehicle, design_flight_controller(vehicle), mission, emulated=False)
    assert isinstance(board, HostBoard)
    inputs = record_inputs(board, given.seed)
    board.log_blocks[:] = 0
    board.restart()
    replay = Replay(board, inputs)
    board.lib.fault_record_begin(replay.kept, board.lib.RESET_BY_POWER)
    rng = np.random.default_rng(given.seed)
    instants = sorted(rng.choice(len(inputs) - 1, given.instants, replace=False).tolist())
    sent, saved, running = [], {}, 0
    for k in range(len(inputs)):
        if k in instants:
            saved[k] = replay.save()
            running += board.record.software.motors != 0
        sent.append(replay.step(k))
    faults = ("worn flash", "full log", "worn log", "log refuses", "log silent")
    bad: Counter[str] = Counter()
    for k in instants:
        for name, cause in RESET_CAUSES.items():
            replay.restore(saved[k])
            for wrong in check_restart(replay, k, cause):
                bad[name] += 1
                print(f"{name} in period {k}: {wrong}", flush=True)
        for name in faults:
            replay.restore(saved[k])
            for wrong in check_device_fault(replay, k, name, sent):
                bad[name] += 1
                print(f"{name} in period {k}: {wrong}", flush=True)
    print(f"{running} of {given.instants} instants with running motors")
    for name in (*RESET_CAUSES, *faults):
        print(f"{name}: {given.instants} instants, {bad[name]} wrong")


if __name__ == "__main__":
    main()
