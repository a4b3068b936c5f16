"""The I2C of the STM32F405 on a model of the peripheral with a device at its lines.

The model follows section 27.3.3 of the reference manual RM0090: which flags a byte sets, which accesses clear them, and
when an acknowledge or a stop comes too late. No board has run this code.
"""

from __future__ import annotations

import pytest
from driver_library import load_drivers, needs_cc

pytestmark = needs_cc
I2C1, GPIO_B, TIM2 = 0x40005400, 0x40020400, 0x40000000
CR1, CR2, DR, SR1, SR2, CCR, TRISE = 0x00, 0x04, 0x10, 0x14, 0x18, 0x1C, 0x20
PE, START, STOP, ACK, POS, SWRST = 1, 1 << 8, 1 << 9, 1 << 10, 1 << 11, 1 << 15
ITERREN, ITEVTEN, ITBUFEN = 1 << 8, 1 << 9, 1 << 10
SB, ADDR, BTF, RXNE, TXE, BERR, ARLO, AF, OVR = 1, 2, 4, 1 << 6, 1 << 7, 1 << 8, 1 << 9, 1 << 10, 1 << 11
SCL, SDA = 8, 9
DONE, BUSY, ERROR = range(3)


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    sources = ["boards/stm32/i2c.c", "boards/stm32/core.c", "check/models/register_access.c"]
    headers = ["boards/stm32/stm32f405", "check/models/register_access"]
    return load_drivers(tmp_path_factory.mktemp("i2c"), sources, headers, "-DREGISTER_MODEL", "-DMUFLY_FLOAT")


class Peripheral:
    """I2C 1 with one device: registers behind an address byte, counted up."""

    def __init__(self, library, address=0x29, clock_Hz=42_000_000) -> None:
        self.ffi, self.lib = library
        self.address, self.memory = address, {k: (7 * k + 3) & 0xFF for k in range(256)}
        self.values: dict[int, int] = {}
        self.seen: list[str] = []  # on the lines
        self.flags, self.busy, self.time_us = 0, False, 0
        self.is_silent = self.is_stuck = False
        self.clocks, self.low = 0, set()
        self.pointer, self.first, self.reads = 0, True, False
        self.data, self.shift, self.nacked, self.stops = None, None, False, False
        self.sr1_read, self.count = False, 0
        self.lib.register_model_attach(self._attach())
        self.lib.i2c_start(clock_Hz)

    def _attach(self):
        self._calls = (
            self.ffi.callback("uint32_t(uint32_t)", self.get),
            self.ffi.callback("void(uint32_t, uint32_t)", self.set),
            self.ffi.callback("void(bool)", lambda held: None),
        )
        self.model = self.ffi.new("register_model_t *", dict(zip(("get", "set", "hold"), self._calls, strict=True)))
        return self.model

    def get(self, address) -> int:
        if address == TIM2 + 0x24:
            self.time_us += 1
            return self.time_us
        if address == I2C1 + SR1:
            self.sr1_read = True
            return self.flags
        if address == I2C1 + SR2:
            if self.sr1_read and self.flags & ADDR:
                self.flags &= ~ADDR
                self.flags |= 0 if self.reads else TXE
            return 2 * (self.busy or self.is_stuck)
        if address == I2C1 + DR:
            assert self.data is not None, "nothing to read"
            byte, self.data, self.shift = self.data, self.shift, None
            self.flags &= ~(BTF | (RXNE if self.data is None else 0))
            return byte
        return self.values.get(address, 0)

    def set(self, address, value) -> None:
        before = self.values.get(address, 0)
        if address == GPIO_B + 0x18:
            self.pin(value)
        elif address == I2C1 + SR1:
            self.flags &= value | 0xFF
        elif address == I2C1 + DR:
            self.write_data(value)
        elif address == I2C1 + CR1:
            assert not value & (START | STOP) or value & PE
            if value & SWRST:
                self.flags, self.busy, self.data, self.shift, self.stops = 0, False, None, None, False
            elif value & START:
                assert not value & STOP
                self.values[address] = value & ~START
                self.start()
                return
            elif value & STOP:
                self.values[address] = value & ~STOP
                self.stop()
                return
        self.values[address] = value
        assert address != I2C1 + CCR or not before & PE

    def pin(self, value) -> None:
        for number in (SCL, SDA):
            if value >> number & 1:
                if number == SCL and SCL in self.low:
                    self.clocks += self.values.get(GPIO_B, 0) >> 2 * SCL & 3 == 1
                    self.is_stuck = self.is_stuck and self.clocks < 9
                self.low.discard(number)
            if value >> number + 16 & 1:
                self.low.add(number)

    def start(self) -> None:
        if self.is_silent:
            return
        self.seen.append("S")
        self.flags = self.flags & ~BTF & ~TXE | SB
        self.busy = True

    def stop(self) -> None:
        if self.reads and not self.nacked:
            self.stops = True  # after the byte that is on its way
        else:
            self.seen.append("P")
            self.busy = self.stops = False
        self.flags &= ~(BTF | TXE) if not self.reads else 0xFFFF

    def write_data(self, value) -> None:
        if self.flags & SB:
            assert self.sr1_read
            self.flags &= ~SB
            self.reads, self.first, self.nacked = bool(value & 1), True, False
            self.seen.append(f"{value >> 1:02x}{'r' if self.reads else 'w'}")
            self.flags |= ADDR if value >> 1 == self.address else AF
            return
        assert self.flags & TXE, "a byte is lost"
        self.seen.append(f"{value:02x}")
        if self.first:
            self.pointer, self.first = value, False
        else:
            self.memory[self.pointer] = value
            self.pointer += 1
        self.flags |= TXE | BTF

    def pass_time(self) -> None:
        """Let the device send a byte, where the clock runs."""
        if not self.reads or self.nacked or self.flags & (ADDR | SB) or self.shift is not None or not self.busy:
            return
        control = self.values[I2C1 + CR1]
        assert bool(control & POS) == (self.count == 2), "for two bytes only"
        byte, self.pointer = self.memory[self.pointer], self.pointer + 1
        second = self.data is not None or self.seen[-1] not in (f"{self.address:02x}r",)
        acknowledges = bool(control & ACK) or bool(control & POS and not second)  # POS: ACK is that of the second byte
        self.seen.append(f"{byte:02x}{'+' if acknowledges else '-'}")
        self.nacked = not acknowledges
        if self.data is None:
            self.data = byte
            self.flags |= RXNE
        else:
            self.shift = byte
            self.flags |= BTF
        if self.stops:
            assert self.nacked, "the device holds the data line"
            self.stop()

    def run(self, limit=200) -> None:
        """Let interrupts happen until nothing more comes."""
        for _ in range(limit):
            self.pass_time()
            enabled, self.sr1_read = self.values[I2C1 + CR2], False
            waiting = self.flags & (SB | ADDR | BTF | (RXNE | TXE if enabled & ITBUFEN else 0))
            if self.flags & (BERR | ARLO | AF | OVR) and enabled & ITERREN:
                self.lib.i2c_error_interrupt()
            elif waiting and enabled & ITEVTEN:
                self.lib.i2c_event_interrupt()
            elif not self.reads or self.nacked or not self.busy:
                return

    def transfer(self, out, count, address=None):
        self.out, self.into = self.ffi.new("uint8_t[]", bytes(out)), self.ffi.new("uint8_t[40]", b"\xee" * 40)
        self.seen.clear()
        self.count = count
        begun = self.lib.i2c_begin(self.address if address is None else address, self.out, len(out), self.into, count)
        self.run()
        return begun


def test_the_clock_is_that_of_the_bus_and_the_lines_are_open_drain(library) -> None:
    for clock in (42_000_000, 16_000_000):
        bus = Peripheral(library, clock_Hz=clock)
        assert bus.values[I2C1 + CR2] == clock // 1_000_000
        assert clock / (2 * bus.values[I2C1 + CCR]) == 100e3
        assert (bus.values[I2C1 + TRISE] - 1) / clock == pytest.approx(1e-6)
        assert bus.values[GPIO_B + 4] == 1 << SCL | 1 << SDA
        assert bus.values[0xE000E100] == 1 << 31
        assert bus.values[0xE000E104] == 1
        assert bus.lib.i2c_poll() == ERROR  # nothing is under way


def test_bytes_are_written_with_a_stop(library) -> None:
    bus = Peripheral(library)
    for _ in range(3):
        assert bus.transfer([0x10, 1, 2, 3], 0)
        assert bus.seen == ["S", "29w", "10", "01", "02", "03", "P"]
        assert bus.lib.i2c_poll() == DONE
        assert bus.lib.i2c_poll() == ERROR
    assert [bus.memory[k] for k in (0x10, 0x11, 0x12)] == [1, 2, 3]


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 17, 32])
def test_the_last_byte_is_not_acknowledged_whatever_the_count(library, count) -> None:
    bus = Peripheral(library)
    for _ in range(2):
        assert bus.transfer([0x20], count)
        data = [bus.memory[0x20 + k] for k in range(count)]
        assert bus.seen == ["S", "29w", "20", "S", "29r", *(f"{b:02x}+" for b in data[:-1]), f"{data[-1]:02x}-", "P"]
        assert bus.lib.i2c_poll() == DONE
        assert list(bus.into[0:40]) == data + [0xEE] * (40 - count)  # not a byte more


def test_a_missing_device_and_errors_of_the_bus_are_reported(library) -> None:
    bus = Peripheral(library)
    assert bus.transfer([1], 2, address=0x70)
    assert bus.seen == ["S", "70w", "P"]
    assert bus.lib.i2c_poll() == ERROR
    assert bus.transfer([1], 2)
    assert bus.lib.i2c_poll() == DONE
    for flag in (BERR, ARLO, OVR):
        bus.flags = 0
        assert bus.lib.i2c_begin(0x29, bus.out, 1, bus.into, 2)
        bus.flags |= flag
        bus.lib.i2c_error_interrupt()
        assert not bus.flags & flag
        assert not bus.values[I2C1 + CR2] & (ITEVTEN | ITERREN | ITBUFEN)
        assert bus.lib.i2c_poll() == ERROR
        bus.busy = False
        bus.lib.i2c_abort()
        assert bus.transfer([1], 2)
        assert bus.lib.i2c_poll() == DONE
    for counts in ((0, 1), (1, -1)):
        assert not bus.lib.i2c_begin(0x29, bus.out, counts[0], bus.into, counts[1])
    assert bus.lib.i2c_begin(0x29, bus.out, 1, bus.into, 2)
    assert not bus.lib.i2c_begin(0x29, bus.out, 1, bus.into, 2)  # one at a time
    bus.run()
    assert bus.lib.i2c_poll() == DONE


def test_silence_is_aborted_and_a_held_line_is_clocked_free(library) -> None:
    bus = Peripheral(library)
    bus.is_silent = True
    assert bus.transfer([1], 2)
    assert [bus.lib.i2c_poll() for _ in range(5)] == [BUSY] * 5
    bus.lib.i2c_abort()
    bus.is_silent = False
    bus.clocks = 0
    bus.is_stuck = True
    assert not bus.transfer([1], 2)  # refused, and freed for the next one
    assert bus.clocks == 9 + 1  # and that of the stop
    assert not bus.low  # both lines are released
    assert bus.values[GPIO_B] >> 2 * SCL & 15 == 0b1010  # the peripheral's again
    assert bus.transfer([1], 2)
    assert bus.lib.i2c_poll() == DONE


def test_interrupts_without_a_flag_and_late_bytes_are_waited_for(library) -> None:
    """An interrupt whose flag is not set yet changes nothing: the transfer goes on at the next one."""
    bus = Peripheral(library)
    original = bus.run

    def run(limit=200) -> None:
        for _ in range(limit):
            kept, bus.flags = bus.flags, 0
            before = len(bus.seen), bus.values[I2C1 + CR2]
            bus.lib.i2c_event_interrupt()
            assert (len(bus.seen), bus.values[I2C1 + CR2]) == before
            bus.flags = kept
            original(1)

    bus.run = run
    for count in (0, 1, 2, 3, 5):
        assert bus.transfer([0x20], count)
        assert bus.lib.i2c_poll() == DONE
        assert list(bus.into[0:count]) == [bus.memory[0x20 + k] for k in range(count)]
    bus.lib.i2c_event_interrupt()  # of no transfer
    assert bus.lib.i2c_poll() == ERROR


def test_a_transfer_ends_with_the_stop_on_the_bus(library) -> None:
    bus = Peripheral(library)
    assert bus.transfer([0x10, 1], 0)
    bus.busy = True  # the stop is not there yet
    assert bus.lib.i2c_poll() == BUSY
    bus.busy = False
    assert bus.lib.i2c_poll() == DONE


def test_the_timer_may_stand_still_while_a_line_is_clocked_free(library) -> None:
    bus = Peripheral(library)
    bus.clocks, bus.is_stuck = 0, True
    original = bus.get
    bus.get = lambda address: 0 if address == TIM2 + 0x24 else original(address)
    bus.lib.register_model_attach(bus._attach())
    assert not bus.transfer([1], 2)
    assert bus.clocks == 9 + 1
    bus.get = original
    bus.lib.register_model_attach(bus._attach())
    assert bus.transfer([1], 2)
