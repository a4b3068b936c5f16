"""The STM32F405 board: its drivers on a model of the registers, and its image on QEMU's STM32F405.

The model follows the reference manual RM0090: what hardware sets, clears and refuses. No board has run this code.
"""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import time

import numpy as np
import pytest
from driver_library import STRICT, load_drivers, needs_cc

os.environ.setdefault("MAVLINK20", "1")

from pymavlink import mavutil

from mufly.control import design_flight_controller
from mufly.firmware.export.source_export import export_firmware
from mufly.mission import load_mission
from mufly.vehicle import load_vehicle

DRIVERS = ("core", "serial", "internal_flash", "spi", "outputs")
needs_arm = pytest.mark.skipif(
    not (shutil.which("arm-none-eabi-gcc") and shutil.which("make")),
    reason="no compiler for the Cortex-M4: install gcc-arm-none-eabi and make",
)


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    sources = [*(f"boards/stm32/{name}.c" for name in DRIVERS), "check/models/register_access.c"]
    headers = ["boards/stm32/stm32f405", "check/models/register_access", "onboard/drivers/sd_card"]
    return load_drivers(tmp_path_factory.mktemp("stm32"), sources, headers, "-DREGISTER_MODEL", "-DMUFLY_FLOAT")


RCC, FLASH, USART1, SPI1, ADC1, DMA2 = 0x40023800, 0x40023C00, 0x40011000, 0x40013000, 0x40012000, 0x40026400
SPI3, DMA1 = 0x40003C00, 0x40026000
TIM2, TIM3, TIM5, TIM8, IWDG = 0x40000000, 0x40000400, 0x40000C00, 0x40010400, 0x40003000
MEMORY, SECTOR_2 = 0x20000000, 0x08008000


class Chip:
    """The registers of an STM32F405, as far as the drivers use them; ``faults`` names what is broken."""

    def __init__(self, library, *faults) -> None:
        self.ffi, self.lib = library
        self.faults = set(faults)
        self.values: dict[int, int] = {FLASH + 0x10: 1 << 31, RCC + 0x74: 0, FLASH + 0x0C: 0}
        self.flash = np.full(2 * 4096, 0xFFFFFFFF, np.uint32)
        self.keys: list[int] = []
        self.writes: list[tuple[int, int]] = []
        self.received: list[int] = []  # waits in the serial port
        self.sent: list[int] = []
        self.tx_free, self.line_state = 1, 0
        self.device: list[int] = []  # what the selected device answers
        self.busy = self.fed = 0
        self.held, self.was_held_at = False, []
        self._get = self.ffi.callback("uint32_t(uint32_t)", self.get)
        self._set = self.ffi.callback("void(uint32_t, uint32_t)", self.set)
        self._hold = self.ffi.callback("void(bool)", self.hold)
        self.model = self.ffi.new("register_model_t *", {"get": self._get, "set": self._set, "hold": self._hold})
        self.lib.register_model_attach(self.model)

    def hold(self, held) -> None:
        self.held = held

    def get(self, address) -> int:
        v = self.values.get(address, 0)
        if SECTOR_2 <= address < SECTOR_2 + 0x8000:
            return int(self.flash[(address - SECTOR_2) // 4])
        if address == RCC:
            v |= (v & 1 << 16) << 1 if "crystal" not in self.faults else 0
            v |= (v & 1 << 24) << 1 if "pll" not in self.faults else 0
        elif address == RCC + 8:
            v = v & ~12 | (v & 3) << 2 if "switch" not in self.faults else v & ~12
        elif address == FLASH + 0x0C:
            self.busy -= self.busy > 0
            v |= (self.busy > 0) << 16
        elif address == USART1:
            return (self.tx_free > 0) << 7 | (32 if self.received else 0) | self.line_state
        elif address == USART1 + 4:
            self.line_state = 0
            return self.received.pop(0) if self.received else 0
        elif address == ADC1 and "adc" not in self.faults:
            return 2 if self.values.get(ADC1 + 8, 0) >> 30 & 1 else 0
        elif address == TIM2 + 0x24:
            return 123456
        elif "stream" in self.faults and address in (DMA2 + 0x10, DMA2 + 0x10 + 0x18 * 5):
            v |= 1
        return v

    def set(self, address, value) -> None:
        self.writes.append((address, value))
        before = self.values.get(address, 0)
        if SECTOR_2 <= address < SECTOR_2 + 0x8000:
            self.program(address, value)
            return
        if address == FLASH + 4:
            self.keys = [*self.keys, value][-2:]
            if self.keys == [0x45670123, 0xCDEF89AB]:
                self.values[FLASH + 0x10] &= ~(1 << 31)
        elif address == FLASH + 0x0C:
            self.values[address] = before & ~value
            return
        elif address == FLASH + 0x10:
            if before >> 31 and not value >> 31:
                return  # locked
            if value & 1 << 16 and value & 2:
                self.erase(value)
                value &= ~(1 << 16)
        elif address == IWDG:
            self.fed += value == 0xAAAA
        elif address == USART1 + 4:
            self.sent.append(value)
            self.tx_free -= 1
            return
        elif address == DMA2 + 8:
            self.values[DMA2] = self.values.get(DMA2, 0) & ~value
        elif address == RCC + 0x74 and value & 1 << 24:
            value = 0
        elif address == DMA1 + 8:
            self.values[DMA1] = self.values.get(DMA1, 0) & ~value
        self.values[address] = value
        if address in (SPI1 + 4, SPI3 + 4) and value == 3 and "dma" not in self.faults:
            self.transfer(address - 4, *((DMA2, 3) if address < SPI1 + 8 and address > SPI3 + 8 else (DMA1, 0)))

    def program(self, address, value) -> None:
        control = self.values[FLASH + 0x10]
        assert (control & 1, control >> 8 & 3, control >> 31) == (1, 2, 0), "not set to program words"
        self.was_held_at.append(self.held)
        self.busy = 3 if "flash" not in self.faults else 10**9
        if "write protection" in self.faults:
            self.values[FLASH + 0x0C] |= 16
        else:
            self.flash[(address - SECTOR_2) // 4] &= np.uint32(value)

    def erase(self, control) -> None:
        self.was_held_at.append(self.held)
        self.busy = 50
        sector = (control >> 3 & 15) - 2
        assert sector in (0, 1), "a sector of the program"
        self.flash[4096 * sector : 4096 * sector + 4096] = 0xFFFFFFFF

    def memory(self, address):
        return self.ffi.cast("uint8_t *", self.model.memory[address - MEMORY])

    def transfer(self, spi, dma, channel) -> None:
        """Let both streams of the DMA move their bytes through the SPI, as they are set up."""
        rx, tx = dma + 0x10, dma + 0x10 + 0x18 * 5
        for stream, direction in ((rx, 0), (tx, 1)):
            control = self.values[stream]
            assert (control & 1, control >> 6 & 3, control >> 25 & 7) == (1, direction, channel)
            assert self.values[stream + 8] == spi + 0x0C
        count = self.values[tx + 4]
        assert self.values[rx + 4] == count
        assert self.values[spi] & 0x344 == 0x344, "SPI is off"
        if "overrun" in self.faults:
            self.values[spi + 8] = 1 << 6
            return
        step_in, step_out = (self.values[stream] >> 10 & 1 for stream in (rx, tx))
        self.heard = [self.memory(self.values[tx + 0x0C])[step_out * k] for k in range(count)]
        for k in range(count):
            self.memory(self.values[rx + 0x0C])[step_in * k] = (self.device + [0] * count)[k]
        self.values[dma] = 0x20

    def moving_streams(self, dma) -> list[int]:
        """Return the streams of a DMA controller that are enabled; no register outside its streams was written."""
        registers = {dma + 0x10 + 0x18 * stream + 4 * k for stream in range(8) for k in range(6)} | {dma + 8, dma + 12}
        assert {address for address, _ in self.writes if dma - 0x80 <= address < dma + 0x400} <= registers
        return [stream for stream in range(8) if self.values.get(dma + 0x10 + 0x18 * stream, 0) & 1]

    def pin(self, port, number) -> int:
        for address, value in reversed(self.writes):
            if address == port + 0x18 and value & (1 << number | 1 << number + 16):
                return int(value >> number & 1)
        raise AssertionError("the pin was never set")


@needs_cc
def test_the_clock_runs_at_full_speed_or_says_that_it_does_not(library) -> None:
    chip = Chip(library)
    assert chip.lib.clock_start() == 168_000_000
    order = [address for address, _ in chip.writes]
    assert order.index(FLASH) < order.index(RCC + 8)  # wait states before the clock rises
    pll = chip.values[RCC + 4]
    assert 8e6 / (pll & 63) * (pll >> 6 & 511) / 2 == 168e6
    assert pll >> 22 & 1
    assert 8e6 / (pll & 63) * (pll >> 6 & 511) / (pll >> 24 & 15) == 48e6
    assert (chip.values[RCC + 8] >> 10 & 7, chip.values[RCC + 8] >> 13 & 7) == (5, 4)  # 42 and 84 MHz
    chip = Chip(library, "crystal")
    assert chip.lib.clock_start() == 168_000_000
    pll = chip.values[RCC + 4]
    assert 16e6 / (pll & 63) * (pll >> 6 & 511) / 2 == 168e6
    assert not pll >> 22 & 1
    for broken in ("pll", "switch"):
        chip = Chip(library, broken)
        assert chip.lib.clock_start() == 16_000_000
        assert chip.values[RCC + 8] & 3 == 0


@needs_cc
def test_causes_of_a_reset_watchdog_and_timers(library) -> None:
    flags = {"BOR": 25, "PIN": 26, "POR": 27, "SFT": 28, "IWDG": 29}
    for names, cause in (("POR BOR PIN", 0), ("BOR PIN", 1), ("IWDG PIN", 2), ("SFT PIN", 3), ("PIN", 4)):
        chip = Chip(library)
        chip.values[RCC + 0x74] = sum(1 << flags[name] for name in names.split())
        assert chip.lib.reset_cause() == cause, names
        assert chip.values[RCC + 0x74] == 0  # cleared for the next one
    chip = Chip(library)
    chip.lib.watchdog_start()
    assert [v for a, v in chip.writes if a == IWDG] == [0xCCCC, 0x5555, 0xAAAA]
    assert (chip.values[IWDG + 8] + 1) * 4 / 32000 == 0.05
    for clock, tick in ((168_000_000, 84e6), (16_000_000, 16e6)):
        chip.lib.timers_start(clock, 200)
        assert tick / (chip.values[TIM2 + 0x28] + 1) == 1e6
        assert tick / (chip.values[TIM5 + 0x28] + 1) / (chip.values[TIM5 + 0x2C] + 1) == 200
    assert chip.lib.timer_us() == 123456
    assert chip.values[0xE000E104] == 1 << 50 - 32
    chip.values[TIM5 + 0x10] = 1
    chip.lib.timer_end_interrupt()
    assert chip.values[TIM5 + 0x10] == 0


@needs_cc
def test_pins_have_their_functions_and_no_device_is_selected(library) -> None:
    chip = Chip(library)
    chip.lib.pins_start()
    a, b, c = 0x40020000, 0x40020400, 0x40020800
    functions = {
        (a, 9): 7, (a, 10): 7, (a, 3): 7, (a, 5): 5, (a, 6): 5, (a, 7): 5, (b, 0): 2, (b, 1): 2, (c, 6): 3, (c, 7): 3,
        (c, 10): 6, (c, 11): 6, (c, 12): 6, (b, 8): 4, (b, 9): 4,
    }  # fmt: skip
    for (port, pin), function in functions.items():
        assert chip.values[port + 0x20 + 4 * (pin // 8)] >> 4 * (pin % 8) & 15 == function, (port, pin)
        assert chip.values[port] >> 2 * pin & 3 == 2
        assert chip.values[port + 8] >> 2 * pin & 3 == 2
    assert chip.values[c] >> 10 & 3 == 3  # battery
    for port, pin in ((c, 2), (b, 3), (c, 1)):
        assert chip.values[port] >> 2 * pin & 3 == 1
        assert chip.pin(port, pin) == 1
        mode = next(k for k, (address, _) in enumerate(chip.writes) if address == port)
        high = next(k for k, one in enumerate(chip.writes) if one == (port + 0x18, 1 << pin))
        assert high < mode  # before it becomes an output
    assert set(chip.values) <= {FLASH + 0x10, RCC + 0x74, FLASH + 0x0C} | {
        port + offset for port in (a, b, c) for offset in (0, 8, 0x18, 0x20, 0x24)
    }


@needs_cc
def test_the_serial_port_loses_no_byte_and_counts_the_bad_ones(library) -> None:
    chip = Chip(library)
    ffi, lib = chip.ffi, chip.lib
    port = ffi.new("serial_port_t *")
    lib.serial_start(port, USART1, 84_000_000, 115_200, False)
    assert 84e6 / chip.values[USART1 + 8] == pytest.approx(115_200, rel=0.01)
    assert chip.values[0xE000E104] == 1 << 37 - 32
    rng = np.random.default_rng(1)
    data, taken, got = bytes(rng.integers(0, 256, 3000, dtype=np.uint8)), 0, b""
    out, to = bytes(rng.integers(0, 256, 3000, dtype=np.uint8)), ffi.new("uint8_t[64]")
    for k, byte in enumerate(data):
        chip.received.append(byte)
        chip.tx_free = 1  # the transmitter is free again
        lib.serial_interrupt(port)
        if k % 40 == 0:
            got += bytes(to[0 : lib.serial_read(port, to, 64)])
            taken += lib.serial_write(port, out[taken : taken + 64], len(out[taken : taken + 64]))
    got += bytes(to[0 : lib.serial_read(port, to, 64)])
    assert got == data
    assert port.errors == 0
    for _ in range(1000):
        chip.tx_free = 1
        lib.serial_interrupt(port)
    assert bytes(chip.sent) == out[:taken]
    assert taken > 2500
    assert not chip.values[USART1 + 0x0C] & 128  # nothing to send: no interrupt of the transmitter
    # Parity, frame, noise and overrun; the byte of an overrun before it is kept.
    for state, kept in ((1, 0), (2, 0), (4, 0), (8, 1)):
        before = port.errors
        chip.received, chip.line_state = [0x55], state
        lib.serial_interrupt(port)
        assert (port.errors - before, lib.serial_read(port, to, 64)) == (1, kept)
    # A reader with little room gets no byte more, and the rest next time.
    chip.received = [1, 2, 3, 4, 5]
    for _ in range(5):
        lib.serial_interrupt(port)
    to[3] = 0xEE
    assert (lib.serial_read(port, to, 3), bytes(to[0:4])) == (3, b"\x01\x02\x03\xee")
    assert (lib.serial_read(port, to, 64), bytes(to[0:2])) == (2, b"\x04\x05")
    # A full ring drops and counts.
    chip.received = [7] * 600
    for _ in range(600):
        lib.serial_interrupt(port)
    assert port.errors == 4 + 600 - 256
    # An overrun without a byte of its own counts as an error; what the port takes at once needs no interrupt.
    port.tail, before = port.head, port.errors
    chip.received, chip.line_state = [], 8
    lib.serial_interrupt(port)
    assert (port.errors - before, lib.serial_read(port, to, 64)) == (1, 0)
    chip.tx_free = 10
    assert lib.serial_write(port, b"abc", 3) == 3
    assert bytes(chip.sent[-3:]) == b"abc"
    assert not chip.values[USART1 + 0x0C] & 128
    lib.serial_start(port, 0x40004400, 42_000_000, 100_000, True)  # the second port
    assert chip.values[0xE000E104] == 1 << 38 - 32
    lib.serial_start(port, USART1, 84_000_000, 100_000, True)  # SBUS: 8E2
    assert chip.values[USART1 + 0x0C] & 0x1400 == 0x1400
    assert chip.values[USART1 + 0x10] == 2 << 12


@needs_cc
def test_flash_is_programmed_and_erased_with_its_errors(library) -> None:
    chip = Chip(library)
    lib = chip.lib
    for sector, word, value in ((0, 0, 0x12345678), (1, 4095, 7), (0, 9, 0)):
        assert lib.internal_flash_program(sector, word, value)
        assert lib.internal_flash_read(sector, word) == value
        assert chip.values[FLASH + 0x10] >> 31  # locked again
        assert chip.values[FLASH] & (1 << 10 | 1 << 12) == 1 << 10  # the data cache was emptied
    fed = chip.fed
    assert lib.internal_flash_erase(0)
    assert chip.fed - fed > 40  # the watchdog is fed while the sector is erased
    assert (lib.internal_flash_read(0, 0), lib.internal_flash_read(1, 4095)) == (0xFFFFFFFF, 7)
    assert (all(chip.was_held_at), chip.held) == (True, False)  # interrupts, whose code lies in flash, wait
    writes = len(chip.writes)
    for sector, word in ((-1, 0), (2, 0), (0, -1), (0, 4096)):
        assert not lib.internal_flash_program(sector, word, 0)
        assert lib.internal_flash_read(sector, word) == 0xFFFFFFFF
    assert not lib.internal_flash_erase(2)
    assert len(chip.writes) == writes
    for broken in ("write protection", "flash"):
        chip = Chip(library, broken)
        assert not chip.lib.internal_flash_program(0, 1, 0)
        assert chip.values[FLASH + 0x10] >> 31
        assert not chip.held
    chip.busy, chip.faults = 0, set()
    chip.values[FLASH + 0x10] &= ~(1 << 31)  # unlocked already: the keys would fault
    chip.keys = []
    assert chip.lib.internal_flash_program(0, 3, 5)
    assert not chip.keys
    chip.values[FLASH + 0x0C] = 16  # an old error does not count
    assert chip.lib.internal_flash_program(0, 2, 5)


@needs_cc
def test_spi_moves_bytes_by_dma_and_ends_after_faults(library) -> None:
    done, busy, error = range(3)
    chip = Chip(library)
    ffi, lib = chip.ffi, chip.lib
    lib.spi_start()
    assert lib.spi_poll() == error  # nothing is under way
    port, into = 0x40020800, ffi.new("uint8_t[32]")
    chip.device = [0xFF, 0x47, 2, 3]
    assert lib.spi_begin(port, 2, bytes([0xF5]), 1, into, 3)
    assert (chip.pin(port, 2), chip.moving_streams(DMA2)) == (0, [0, 5])
    assert not lib.spi_begin(port, 2, bytes([1]), 1, into, 1)  # one at a time
    assert lib.spi_poll() == done
    assert (chip.moving_streams(DMA2), chip.values[SPI1 + 4]) == ([], 0)  # both streams and both requests are off
    assert (chip.heard, bytes(into[0:3])) == ([0xF5, 0, 0, 0], bytes([0x47, 2, 3]))
    assert chip.pin(port, 2) == 1
    assert lib.spi_begin(port, 2, bytes([0x4E, 0x0F]), 2, ffi.NULL, 0)
    assert lib.spi_poll() == done
    assert chip.heard == [0x4E, 0x0F]
    for count in (0, 41):
        assert not lib.spi_begin(port, 2, bytes(41), count, ffi.NULL, 0)
    # The device's clock line is dead: nothing ends, until the driver gives up; then the bus works again.
    chip.faults = {"dma"}
    assert lib.spi_begin(port, 2, bytes([1]), 1, into, 1)
    assert [lib.spi_poll() for _ in range(5)] == [busy] * 5
    lib.spi_abort()
    assert (chip.pin(port, 2), chip.moving_streams(DMA2), chip.values[SPI1 + 4]) == (1, [], 0)
    chip.faults = {"overrun"}
    assert lib.spi_begin(port, 2, bytes([1]), 1, into, 1)
    assert lib.spi_poll() == error
    assert (chip.pin(port, 2), chip.moving_streams(DMA2), chip.values[SPI1 + 4]) == (1, [], 0)
    chip.values[SPI1 + 8], chip.faults = 0, set()
    assert lib.spi_begin(port, 2, bytes([1]), 1, into, 1)
    chip.values[DMA2] = 1 << 3  # transfer error of the DMA
    assert lib.spi_poll() == error
    assert lib.spi_begin(port, 2, bytes([1]), 1, into, 1)
    assert lib.spi_poll() == done


@needs_cc
def test_spi_is_done_when_its_last_byte_is_and_a_stream_may_stay_on(library) -> None:
    done, busy, error = range(3)
    chip = Chip(library)
    ffi, lib = chip.ffi, chip.lib
    lib.spi_start()
    port, into = 0x40020800, ffi.new("uint8_t[32]")
    for counts in ((0, 1), (1, -1), (20, 21)):
        assert not lib.spi_begin(port, 2, bytes(41), counts[0], into, counts[1])
    lib.spi_abort()  # nothing is under way
    assert lib.spi_poll() == error
    assert lib.spi_begin(port, 2, bytes([1]), 1, into, 1)
    chip.values[SPI1 + 8] = 1 << 7  # the last byte is still on the line
    assert [lib.spi_poll() for _ in range(3)] == [busy] * 3
    assert chip.pin(port, 2) == 0
    chip.values[SPI1 + 8] = 0
    assert lib.spi_poll() == done
    # A stream that does not go off is waited for a bounded time.
    chip.faults = {"stream"}
    assert lib.spi_begin(port, 2, bytes([1]), 1, into, 1)
    assert lib.spi_poll() == done
    # The port itself takes neither a second transfer nor an empty one, and can be ended twice.
    card = ffi.new("spi_port_t *")
    chip.faults = set()
    lib.spi_port_start(card, SPI3, 0, 0)
    assert not lib.spi_port_begin(card, ffi.NULL, into, 0)
    assert lib.spi_port_begin(card, ffi.NULL, into, 4)
    assert not lib.spi_port_begin(card, ffi.NULL, into, 4)
    for _ in range(2):
        lib.spi_port_abort(card)
        assert not card.is_running
    assert lib.spi_port_poll(card) == error


@needs_cc
def test_the_bus_of_the_card_sends_ones_and_drops_bytes(library) -> None:
    chip = Chip(library)
    ffi, lib = chip.ffi, chip.lib
    lib.card_bus_start()
    assert chip.values[SPI3] >> 3 & 7 == 6  # 42 MHz / 128 for the start
    lib.sd_bus_speed(True)
    assert chip.values[SPI3] & 0x37B == 0x340  # mode 0, 42 MHz / 2
    into = ffi.new("uint8_t[4]")
    chip.device = [9, 8, 7, 6]
    assert lib.sd_bus_begin(True, ffi.NULL, into, 4)
    assert chip.pin(0x40020800, 1) == 0
    assert not lib.sd_bus_begin(True, ffi.NULL, into, 4)
    assert chip.moving_streams(DMA1) == [0, 5]
    assert lib.sd_bus_poll() == 0
    assert (chip.moving_streams(DMA1), chip.values[SPI3 + 4]) == ([], 0)
    assert (chip.heard, bytes(into)) == ([0xFF] * 4, bytes([9, 8, 7, 6]))
    assert chip.pin(0x40020800, 1) == 0  # selected until told otherwise
    assert lib.sd_bus_begin(False, bytes([1, 2, 3]), ffi.NULL, 3)
    assert lib.sd_bus_poll() == 0
    assert chip.heard == [1, 2, 3]
    assert chip.pin(0x40020800, 1) == 1
    lib.sd_bus_speed(False)
    assert chip.values[SPI3] >> 3 & 7 == 6
    chip.faults = {"dma"}
    assert lib.sd_bus_begin(True, ffi.NULL, into, 4)
    assert lib.sd_bus_poll() == 1
    lib.card_bus_start()
    chip.faults = {"overrun"}
    assert lib.sd_bus_begin(True, ffi.NULL, into, 4)
    assert lib.sd_bus_poll() == 2
    assert (chip.moving_streams(DMA1), chip.values[SPI3 + 4]) == ([], 0)


@needs_cc
def test_motors_servos_and_battery(library) -> None:
    for clock in (168_000_000, 16_000_000):
        chip = Chip(library)
        ffi, lib = chip.ffi, chip.lib
        lib.outputs_start(clock)
        assert clock / (chip.values[TIM8 + 0x2C] + 1) == pytest.approx(300e3, rel=0.02)  # DShot300
        tick = clock / 2 if clock > 16e6 else clock
        assert tick / (chip.values[TIM3 + 0x28] + 1) / (chip.values[TIM3 + 0x2C] + 1) == 50
        assert (chip.values[TIM3 + 0x3C], chip.values[TIM3 + 0x40]) == (1500, 1500)
        assert (chip.values[TIM8 + 0x34], chip.values[TIM8 + 0x38]) == (0, 0)  # no pulse before the first frame
    frames = [ffi.new("uint32_t[17]", list(range(n, n + 17))) for n in (0, 100)]
    lib.motors_send(frames[0], frames[1], 17)
    for stream, compare, frame in ((2, 0x34, frames[0]), (3, 0x38, frames[1])):
        at = DMA2 + 0x10 + 0x18 * stream
        control = chip.values[at]
        assert (control & 1, control >> 25 & 7, control >> 6 & 3) == (1, 7, 1)
        assert (control >> 11 & 3, control >> 13 & 3) == (2, 2)  # words
        assert (chip.values[at + 4], chip.values[at + 8]) == (17, TIM8 + compare)
        assert chip.model.memory[chip.values[at + 0x0C] - MEMORY] == frame
    lib.servos_set(1000, 2000)
    assert (chip.values[TIM3 + 0x3C], chip.values[TIM3 + 0x40]) == (1000, 2000)
    lib.adc_start()
    chip.values[ADC1 + 0x4C] = 2500
    assert [lib.adc_read() for _ in range(2)] == [0xFFFF, 2500]
    chip.faults = {"adc"}
    chip.values[ADC1] = 0
    assert lib.adc_read() == 0xFFFF


@pytest.fixture(scope="module")
def image(tmp_path_factory):
    tree = tmp_path_factory.mktemp("image") / "fw"
    vehicle, mission = load_vehicle("mufly-1.1"), load_mission("demonstration")
    export_firmware(design_flight_controller(vehicle), tree, vehicle, mission.world, mission)
    done = subprocess.run(["make", "stm32", f"WARN={' '.join(STRICT)}"], cwd=tree, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return tree / "board.elf"


@needs_arm
def test_the_image_leaves_the_settings_alone_and_fits(image) -> None:
    said = subprocess.run(
        ["arm-none-eabi-objdump", "-h", str(image)], capture_output=True, text=True, check=True
    ).stdout
    sections = {}
    for line in said.splitlines():
        parts = line.split()
        if len(parts) == 7 and parts[0].isdigit():
            sections[parts[1]] = [int(p, 16) for p in parts[2:5]]  # size, address, place in flash
    size, address, _ = sections[".vectors"]
    assert (size, address) == (4 * (16 + 82), 0x08000000)
    for name, (size, address, place) in sections.items():
        if address < 0x40000000 and size:
            assert place + size <= SECTOR_2 or place >= SECTOR_2 + 0x8000, name
    assert sections[".text"][0] < 128 * 1024
    assert sections[".bss"][0] + sections[".data"][0] < 32 * 1024
    assert sections[".data"][0] > 0  # code that waits for the flash lies in RAM


@needs_arm
@pytest.mark.skipif(shutil.which("qemu-system-arm") is None, reason="install qemu-system-arm")
def test_the_image_starts_on_an_emulated_stm32f405_and_answers(image) -> None:
    """Start-up, clock without hardware, timers, both serial ports: without sensors it answers and does not arm.

    QEMU has neither RCC, DMA, flash interface nor pins of this chip; its timer 5 runs at another rate.
    """
    with socket.socket() as a, socket.socket() as b:
        for one in (a, b):
            one.bind(("127.0.0.1", 0))
        ports = a.getsockname()[1], b.getsockname()[1]
    serial = [word for p in ports for word in ("-serial", f"tcp:127.0.0.1:{p},server=on,wait=off,nodelay=on")]
    command = ["qemu-system-arm", "-M", "netduinoplus2", "-display", "none", "-monitor", "none", *serial]
    process = subprocess.Popen([*command, "-kernel", str(image)], stderr=subprocess.DEVNULL)
    try:
        c = mavutil.mavlink_connection(f"tcp:127.0.0.1:{ports[0]}", source_system=255, retries=100)
        beat = c.wait_heartbeat(timeout=30)
        assert (beat.type, beat.base_mode & 128) == (3, 0)
        c.mav.param_request_list_send(1, 1)
        c.mav.command_long_send(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
        names, texts, answers = set(), [], []
        pilot = socket.create_connection(("127.0.0.1", ports[1]))
        until, count = time.monotonic() + 60.0, 0
        while time.monotonic() < until and not (len(names) == count > 0 and answers and texts):
            m = c.recv_match(blocking=True, timeout=1)
            if m is None:
                continue
            if m.get_type() == "PARAM_VALUE":
                names.add(m.param_id)
                count = m.param_count
            elif m.get_type() == "COMMAND_ACK":
                answers.append((m.command, m.result))
            elif m.get_type() == "STATUSTEXT":
                texts.append(m.text)
        assert len(names) == count > 20
        assert answers == [(400, 1)]  # temporarily rejected
        # The arm switch of a pilot at the second port is refused too, with the reasons.
        said = len(texts)
        while time.monotonic() < until and len(texts) == said:
            for value in (172, 1811):
                channels = [992, 992, 172, 992, value, 172, 172, *[992] * 9]
                body = b"\x16" + sum(v << 11 * k for k, v in enumerate(channels)).to_bytes(22, "little")
                crc = 0
                for byte in body:
                    crc ^= byte
                    for _ in range(8):
                        crc = (crc << 1 ^ (0xD5 if crc & 0x80 else 0)) & 0xFF
                for _ in range(4):
                    pilot.sendall(b"\xc8\x18" + body + bytes([crc]))
                    m = c.recv_match(type="STATUSTEXT", blocking=True, timeout=0.1)
                    texts += [m.text] if m is not None else []
        assert len(texts) > said, texts
    finally:
        process.kill()
        process.wait()
