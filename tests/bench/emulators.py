"""The far end of each driver's serial line: a pseudo-terminal, the same bytes, and the troubles of cables and boards.

All of them look at one simulated bench (:class:`mufly.bench.rig.simulated_rig.SimulatedRig`), whose time runs ``pace``
times as fast as ours. They serve from one thread, or from a process of their own (:func:`serve`).
"""

import contextlib
import os
import pty
import random
import struct
import threading
import time
import tty

import numpy as np

from mufly.bench.rig.epos_controller import EPOS_PROTOCOLS, FrameParser, build_frame
from mufly.bench.rig.serial_line import append_checksum, compute_crc16
from mufly.quantities.units import RPM

WATCHDOG_s = 0.5


class Far:
    """One end of a pseudo-terminal, with faults between it and the device behind.

    Attributes
    ----------
    lose, flip : float
        Share of the bytes that go missing, or arrive with another bit, in both directions.
    mute : bool
        Nothing goes out.
    """

    def __init__(self, world, seed=0):
        self.world = world
        self.master, slave = pty.openpty()
        tty.setraw(slave)
        os.set_blocking(self.master, False)
        self.port = os.ttyname(slave)
        self._slave = slave  # kept, so that the line stays up while nobody has it open
        self.lose = self.flip = 0.0
        self.mute = False
        self._random = random.Random(seed)

    def _through(self, data):
        if not (self.lose or self.flip):
            return data
        out = bytearray()
        for byte in data:
            if self._random.random() < self.lose:
                continue
            out.append(byte ^ (1 << self._random.randrange(8)) if self._random.random() < self.flip else byte)
        return bytes(out)

    def send(self, data):
        if not self.mute:
            # A buffer that nobody empties is full: what does not fit is gone, as on a wire.
            with contextlib.suppress(BlockingIOError):
                os.write(self.master, self._through(data))

    def receive(self):
        try:
            return self._through(os.read(self.master, 65536))
        except (BlockingIOError, OSError):
            return b""

    def step(self, samples):
        """Answer what came, and say what there is to say; ``samples`` of the bench since the last call."""
        raise NotImplementedError

    def close(self):
        for number in (self.master, self._slave):
            with contextlib.suppress(OSError):
                os.close(number)


class FarEpos(Far):
    """An EPOS: states of CiA 402, a few objects, errors as the guide has them."""

    def __init__(self, world, axis, generation=4, node=1, seed=0):
        super().__init__(world, seed)
        self.axis, self.kind, self.node = axis, EPOS_PROTOCOLS[generation], node
        self.frames, self.objects = FrameParser(), {}
        self.status, self.rpm, self.milliampere = 0x0040, 0, 0

    def reset(self):
        self.status, self.frames = 0x0040, FrameParser()
        self.world.commanded_speed[self.axis] = 0.0

    def step(self, samples):
        if samples:
            self.rpm = round(float(samples[f"speed_{self.axis}"].mean()) / RPM)
            self.milliampere = round(1000 * float(samples[f"current_{self.axis}"].mean()))
        for opcode, data in self.frames.feed_bytes(self.receive()):
            self.answer(opcode, data)
        if self.frames.broken_frame_count:
            self.frames.broken_frame_count = 0
            self.send(build_frame(0x00, struct.pack("<I", 0x05040005)))

    def answer(self, opcode, data):
        if opcode not in (self.kind.read_opcode, self.kind.write_opcode) or len(data) < 4:
            return self.send(build_frame(0x00, struct.pack("<I", 0x05040001)))
        if self.kind.node_comes_first:
            node, index, sub = struct.unpack("<BHB", data[:4])
        else:
            index, sub, node = struct.unpack("<HBB", data[:4])
        if node != self.node:
            return None
        if opcode == self.kind.read_opcode:
            value = self.value((index, sub))
            if value is None:
                return self.send(build_frame(0x00, struct.pack("<Ii", 0x06020000, 0)))
            return self.send(build_frame(0x00, struct.pack("<Ii", 0, value)))
        self.put((index, sub), struct.unpack("<i", data[4:8])[0])
        return self.send(build_frame(0x00, struct.pack("<I", 0)))

    def value(self, item):
        known = {
            (0x6041, 0): self.status, self.kind.velocity_object: self.rpm, (0x603F, 0): 0,
            self.kind.current_object: self.milliampere if self.kind.node_comes_first else self.milliampere & 0xFFFF,
        }  # fmt: skip
        return known.get(item, self.objects.get(item))

    def put(self, item, value):
        self.objects[item] = value
        if item == (0x6040, 0):
            if value == 0x0F and self.status == 0x0021:
                self.status = 0x0027
            elif value == 0x06:
                self.status = 0x0021
            elif value == 0x02:
                self.status = 0x0040
        on = self.status == 0x0027
        self.world.commanded_speed[self.axis] = self.objects.get((0x60FF, 0), 0) * RPM if on else 0.0


class FarText(Far):
    """A board that speaks lines with check sums."""

    def __init__(self, world, seed=0):
        super().__init__(world, seed)
        self.rest, self.number = b"", 0

    def say(self, *cells):
        self.send(append_checksum(",".join(str(c) for c in cells)))

    def heard(self):
        *whole, self.rest = (self.rest + self.receive()).split(b"\n")
        for raw in whole:
            body, star, total = raw[raw.rfind(b"$") + 1 :].rpartition(b"*")
            if star and total == b"%04X" % compute_crc16(body):
                yield body.decode().split(",")


class FarEsc(FarText):
    """The sketch esc_bridge.ino."""

    def __init__(self, world, axes=("upper",), seed=0):
        super().__init__(world, seed)
        self.axes, self.spoken_s, self.watchdog_trips = axes, time.monotonic(), 0

    def reset(self):
        for a in self.axes:
            self.world.commanded_speed[a] = 0.0
        self.rest = b""
        self.say("B", "esc", 1)

    def step(self, samples):
        for cells in self.heard():
            self.spoken_s = time.monotonic()
            if cells[0] == "X":
                for a in self.axes:
                    self.world.commanded_speed[a] = 0.0
                self.say("OK", "X")
            elif cells[0] == "S":
                self.world.commanded_speed[self.axes[int(cells[1])]] = float(cells[2]) * RPM
                self.say("OK", *cells)
        if time.monotonic() - self.spoken_s > WATCHDOG_s and any(self.world.commanded_speed[a] for a in self.axes):
            self.watchdog_trips += 1
            for k, a in enumerate(self.axes):
                self.world.commanded_speed[a] = 0.0
                self.say("F", k, "watchdog")
        if samples:
            row = []
            for a in self.axes:
                row += [
                    round(float(samples[f"speed_{a}"].mean()) / RPM),
                    round(1e3 * float(samples[f"current_{a}"].mean())),
                    round(1e3 * float(samples[f"voltage_{a}"].mean())),
                    round(100 * float(samples[f"motor_temperature_{a}"].mean())),
                ]  # fmt: skip
            self.say("T", self.number, *row)
            self.number += 1


class FarCells(FarText):
    """The sketch hx711_cells.ino: volts of the simulated cells as counts."""

    def __init__(self, world, channels=("thrust_raw", "torque_raw"), counts=1e6, seed=0):
        super().__init__(world, seed)
        self.channels, self.counts, self.air_s = channels, counts, -10.0

    def reset(self):
        self.number = 0
        self.say("B", "cells", 1)

    def step(self, samples):
        list(self.heard())
        if not samples:
            return
        for row in zip(*(samples[c] for c in self.channels), strict=True):
            self.say("C", self.number % 65536, *(round(self.counts * float(v)) for v in row))
            self.number += 1
        if self.world.time_s - self.air_s >= 1.0:
            self.air_s = self.world.time_s
            t, p, h = (float(samples[n].mean()) for n in ("temperature", "pressure", "humidity"))
            self.say("A", round(100 * (t - 273.15)), round(p), round(1000 * h))


class FarStand(Far):
    """A thrust stand: rows of numbers, a pulse for the controller, speed in proportion to the pulse but for a droop."""

    HEAD = b"#time (s),thrust (N),torque (N m),voltage (V),current (A),rpm,remark\n"

    def __init__(self, world, seed=0):
        super().__init__(world, seed)
        self.rest, self.pulse = b"", 1000.0

    def reset(self):
        self.pulse = 1000.0
        self.world.commanded_speed["upper"] = 0.0

    def step(self, samples):
        *whole, self.rest = (self.rest + self.receive()).split(b"\n")
        for raw in whole:
            words = raw.decode("ascii", "replace").strip().split(",")
            if words[0] == "head":
                self.send(self.HEAD)
            elif words[0] == "stop":
                self.reset()
            elif words[0] == "esc":
                with contextlib.suppress(ValueError, IndexError):
                    self.pulse = min(max(float(words[1]), 1000.0), 2000.0)
        x = (self.pulse - 1000.0) / 1000.0
        self.world.commanded_speed["upper"] = 9500 * RPM * x * (1.0 - 0.25 * x)
        if samples:
            readings = np.array([[samples["thrust_raw"].mean(), samples["torque_raw"].mean()]])
            load = self.world.facts.cell_calibration().readings_to_loads(readings, np.array([0.12, -0.4]))[0]
            self.send(
                f"{self.world.time_s:.3f},{load[0]:.5f},{load[1]:.7f},{samples['voltage_upper'].mean():.3f},"
                f"{samples['current_upper'].mean():.4f},{samples['speed_upper'].mean() / RPM:.1f},0\n".encode()
            )


class Bench:
    """Serves some far ends from a thread, at a pace.

    Parameters
    ----------
    world : SimulatedRig
    ends : list of Far
    pace : float
    """

    def __init__(self, world, ends, pace=1.0):
        self.world, self.ends, self.pace = world, ends, pace
        self.lock, self.running = threading.Lock(), True
        self.thread = threading.Thread(target=self.run, daemon=True)

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.running = False
        self.thread.join()
        for end in self.ends:
            end.close()

    def run(self):
        last = time.monotonic()
        while self.running:
            now = time.monotonic()
            samples = None
            with self.lock:
                # As many as have fallen due at 100 Hz of the bench's time, 20 ms of it at least.
                due = self.pace * (now - last)
                if due >= 0.02:
                    last = now
                    samples = self.world.advance_time(round(min(due, 0.5) * 100) / 100)
                for end in self.ends:
                    end.step(samples)
            time.sleep(0.0005)


def serve(connection, make, pace):
    """Serve in a process of its own: sends the ports, then mounts what comes until None does."""
    world, ends = make()
    with Bench(world, ends, pace) as bench:
        connection.send([e.port for e in ends])
        while (asked := connection.recv()) is not None:
            with bench.lock:
                kind, value = asked
                if kind == "mount":
                    world.record_mounting(value)
                    connection.send(world.time_s)
                elif kind == "truth":
                    speeds = {a: world.speed[a] for a in value}
                    nominal = world.true_loads(speeds, as_mounted=False)
                    connection.send(world.true_loads(speeds) | {f"nominal_{k}": v for k, v in nominal.items()})
                elif kind == "facts":
                    connection.send(world.facts)
