"""The driver of an SD card on a model of the card, after chapter 7 of the SD Physical Layer Simplified Specification.

No real card has met it.
"""

from __future__ import annotations

import numpy as np
import pytest
from driver_library import load_drivers, needs_cc

pytestmark = needs_cc
DONE, BUSY, ERROR = range(3)
GOOD, SILENT, REFUSES, UNKNOWN, SLOW = range(5)
CSD_BLOCKS = 1024 * 60
RELEASES, RESTS = 9, 10  # phases of sd_card.c


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    sources = ["onboard/drivers/sd_card.c", "check/models/sd_bus_model.c"]
    return load_drivers(tmp_path_factory.mktemp("card"), sources, ["check/models/sd_bus_model"])


def _crc7(data) -> int:
    """Remainder of the division by x^7 + x^3 + 1."""
    bits = int.from_bytes(bytes(data), "big") << 7
    for k in range(bits.bit_length() - 1, 6, -1):
        if bits >> k & 1:
            bits ^= 0b10001001 << (k - 7)
    return bits


class Card:
    """A card on SPI, byte by byte; ``faults`` name what is wrong with it."""

    def __init__(self, library, *faults, delay=3, idle_answers=4) -> None:
        self.ffi, self.lib = library
        self.faults, self.delay, self.idle_answers = set(faults), delay, idle_answers
        self.blocks: dict[int, bytes] = {}
        self.command: list[int] = []
        self.answers: list[int] = []
        self.data: list[int] | None = None  # of a block that is being written, from its token on
        self.woken = self.busy = 0
        self.app = self.idle = False
        self.busy_answers = 0  # to the first commands
        self.fast, self.slow_bytes, self.periods_busy, self.left = False, 0, 1, 0
        self._call = (
            self.ffi.callback("bool(bool, uint8_t *, uint8_t *, int32_t)", self.begin),
            self.ffi.callback("int32_t(void)", self.poll),
            self.ffi.callback("void(bool)", self.speed),
        )
        self.model = self.ffi.new("sd_bus_model_t *")
        self.model.begin = self.ffi.cast(self.ffi.typeof(self.model.begin), self._call[0])
        self.model.poll, self.model.speed = self._call[1:]
        self.lib.sd_bus_model_attach(self.model)
        self.driver, self.now_us = self.ffi.new("sd_card_t *"), 2**32 - 300_000  # the clock runs over
        self.lib.sd_card_start(self.driver, self.now_us)

    def speed(self, fast) -> None:
        self.fast = fast

    def begin(self, selected, out, into, count) -> bool:
        if "bus refuses" in self.faults:
            return False
        for k in range(count):
            value = self.exchange(selected, 0xFF if out == self.ffi.NULL else out[k])
            if into != self.ffi.NULL:
                into[k] = value
        self.left = self.periods_busy
        return True

    def poll(self) -> int:
        self.left -= 1
        if "bus error" in self.faults:
            return ERROR
        return BUSY if self.left > 0 else DONE

    def exchange(self, selected, byte) -> int:
        if not selected:
            self.command, self.answers, self.data = [], [], None
            self.woken += byte == 0xFF
            return 0xFF
        assert self.woken >= 10, "a command before 80 clocks"
        if "pulled" in self.faults:
            return 0xFF
        said = self.answers.pop(0) if self.answers else 0x00 if self.busy else 0xFF
        self.busy -= self.busy > 0
        if self.data is not None:
            if self.data or byte == 0xFE:
                self.data.append(byte)
            if len(self.data) == 1 + 512 + 2:
                self.take_block()
            return said
        if self.command or byte & 0xC0 == 0x40:
            self.command.append(byte)
        if len(self.command) == 6:
            answer = self.answer(self.command)
            self.answers = [0xFF] * self.delay + answer if answer else []
            self.command = []
        return said

    def answer(self, frame) -> list[int]:
        number, argument, app = frame[0] & 63, int.from_bytes(bytes(frame[1:5]), "big"), self.app
        if number in (0, 8):
            assert frame[5] == _crc7(frame[:5]) << 1 | 1
        self.app = number == 55
        if not self.idle and number != 0 and not self.fast:
            self.slow_bytes += 1
        if number == 0:
            if "never idle" in self.faults or self.busy_answers > 0:
                self.busy_answers -= 1
                return [0]
            self.idle = True
            return [1]
        if number == 8:
            if "version 1" in self.faults:
                return [5]
            voltage = 0 if "voltage" in self.faults else 1
            return [1, 0, 0, voltage, 0xAB if "pattern" in self.faults else 0xAA]
        if number == 55:
            return [int(self.idle) | (4 if "no application" in self.faults else 0)]
        if number == 41 and app:
            assert argument == 1 << 30
            self.idle_answers -= 1
            self.idle = self.idle_answers > 0 or "never ready" in self.faults
            return [int(self.idle)]
        if number == 58:
            return [0, 0x80 if "standard capacity" in self.faults else 0xC0, 0xFF, 0x80, 0]
        if number == 9:
            size = 0x3FFFFF if "too large" in self.faults else CSD_BLOCKS // 1024 - 1
            csd = [0x40, 14, 0, 0x32, 0x5B, 0x59, 0, size >> 16, size >> 8 & 255, size & 255, 0x7F, 0x80, 10, 64, 0, 1]
            csd[0] = 0 if "csd" in self.faults else 0x40
            return [0, *[0xFF] * self.delay, 0xFE, *csd, 0x12, 0x34]
        if number in (17, 24) and (self.idle or argument >= CSD_BLOCKS or "refuses" in self.faults):
            return [0x40]
        if number == 17:
            if "no token" in self.faults:
                return [0]
            if "read error" in self.faults:
                return [0, 0xFF, 0x09]
            return [0, *[0xFF] * self.delay, 0xFE, *self.blocks.get(argument, bytes(512)), 0x56, 0x78]
        if number == 24:
            self.place, self.data = argument, []
            return [0]
        return [4]

    def take_block(self) -> None:
        block, self.data = bytes(self.data[1:513]), None
        if "write error" in self.faults:
            self.answers = [0xED]
            return
        if "no answer" in self.faults:
            return
        self.blocks[self.place] = block
        self.answers = [0xE5]
        self.busy = 10**9 if "busy for ever" in self.faults else 0 if "quick" in self.faults else 200

    def run(self, until, seconds=3.0) -> bool:
        for _ in range(int(seconds / 0.001)):
            self.now_us = (self.now_us + 1000) % 2**32
            self.lib.sd_card_step(self.driver, self.now_us)
            if until():
                return True
        return False

    def start(self) -> bool:
        return self.run(lambda: self.driver.is_ready or self.driver.fault != GOOD)

    def operate(self, block, memory, writes) -> int:
        assert self.lib.sd_card_begin(self.driver, block, memory, writes)
        assert not self.lib.sd_card_begin(self.driver, block, memory, writes)  # one at a time
        assert self.driver.result == BUSY
        assert self.run(lambda: self.driver.result != BUSY)
        return int(self.driver.result)


@pytest.mark.parametrize("delay", range(8))
def test_blocks_are_written_and_read_again(library, delay) -> None:
    card = Card(library, delay=delay)
    card.periods_busy = 1 + delay % 3
    ffi, lib = card.ffi, card.lib
    memory = ffi.new("uint32_t[128]")
    assert not lib.sd_card_begin(card.driver, 0, memory, True)  # not ready
    assert card.start()
    assert (card.driver.is_ready, card.driver.blocks, card.fast) == (True, CSD_BLOCKS, True)
    rng = np.random.default_rng(delay)
    for block in (0, CSD_BLOCKS - 1, 77):
        data = rng.bytes(512)
        ffi.memmove(memory, data, 512)
        assert card.operate(block, memory, True) == DONE
        assert card.blocks[block] == data
        assert card.busy == 0  # it holds nothing back
        ffi.memmove(memory, bytes(512), 512)
        assert card.operate(block, memory, False) == DONE
        assert bytes(ffi.buffer(memory)) == data
    for block in (-1, CSD_BLOCKS):
        assert not lib.sd_card_begin(card.driver, block, memory, True)


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        ("pulled", SILENT), ("version 1", UNKNOWN), ("pattern", UNKNOWN), ("voltage", UNKNOWN), ("never ready", SLOW),
        ("never idle", REFUSES), ("no application", REFUSES), ("standard capacity", UNKNOWN), ("csd", UNKNOWN),
        ("too large", UNKNOWN), ("bus error", SILENT),
    ],
)  # fmt: skip
def test_another_card_or_none_is_refused(library, fault, expected) -> None:
    card = Card(library, fault)
    assert card.start()
    assert (card.driver.is_ready, card.driver.fault, card.driver.blocks) == (False, expected, 0)
    assert not card.lib.sd_card_begin(card.driver, 0, card.ffi.new("uint32_t[128]"), False)


@pytest.mark.parametrize(
    ("fault", "writes", "expected"),
    [
        ("pulled", True, SILENT), ("pulled", False, SILENT), ("refuses", True, REFUSES), ("refuses", False, REFUSES),
        ("no token", False, SLOW), ("read error", False, REFUSES), ("write error", True, REFUSES),
        ("no answer", True, SILENT), ("busy for ever", True, SLOW), ("bus error", True, SILENT),
    ],
)  # fmt: skip
def test_an_operation_that_fails_ends_and_the_next_one_works(library, fault, writes, expected) -> None:
    card = Card(library)
    assert card.start()
    memory = card.ffi.new("uint32_t[128]", list(range(128)))
    card.faults = {fault}
    began = card.now_us
    assert card.operate(5, memory, writes) == ERROR
    assert card.driver.fault == expected
    assert (card.now_us - began) % 2**32 < 700_000
    card.faults, card.busy = set(), 0
    assert card.operate(6, memory, True) == DONE
    assert card.blocks[6] == bytes(card.ffi.buffer(memory))


def test_a_bus_that_takes_no_transfer_is_asked_again(library) -> None:
    card = Card(library, "bus refuses")
    assert not card.run(lambda: card.driver.is_ready, seconds=0.2)
    card.faults = set()
    assert card.start()
    assert card.driver.is_ready


def test_a_card_that_is_busy_at_first_or_quick_at_last_works(library) -> None:
    card = Card(library, "quick")
    card.busy_answers = 3
    assert card.start()
    assert card.driver.is_ready
    memory = card.ffi.new("uint32_t[128]", list(range(128)))
    assert card.operate(3, memory, True) == DONE  # it is not busy after the data
    assert card.blocks[3] == bytes(card.ffi.buffer(memory))


def test_the_bus_may_fail_in_the_last_byte_of_an_operation_and_of_a_start(library) -> None:
    """The byte after the deselection ends an operation; its fault is that of the operation."""
    memory_size = 128
    for ready in (True, False):
        card = Card(library)
        memory = card.ffi.new("uint32_t[128]", list(range(memory_size)))
        if ready:
            assert card.start()
            assert card.lib.sd_card_begin(card.driver, 3, memory, True)
        assert card.run(lambda c=card: c.driver.phase == RELEASES and c.driver.is_running)
        card.faults = {"bus error"}
        assert card.run(lambda c=card: c.driver.phase > RELEASES)
        assert card.driver.fault == SILENT
        assert card.driver.result == ERROR
        assert bool(card.driver.is_ready) == ready


def test_an_operation_waits_for_the_end_of_the_one_before(library) -> None:
    card = Card(library)
    assert card.start()
    memory = card.ffi.new("uint32_t[128]")
    assert card.lib.sd_card_begin(card.driver, 3, memory, True)
    assert card.run(lambda: card.driver.phase != RESTS)
    assert not card.lib.sd_card_begin(card.driver, 4, memory, True)
    assert card.run(lambda: card.driver.result == DONE)
