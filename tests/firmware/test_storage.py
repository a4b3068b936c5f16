"""Settings in flash: nothing acknowledged is lost and nothing half-written is read, wherever the power is cut."""

from __future__ import annotations

import shutil
import struct
import zlib

import numpy as np
import pytest

from mufly.control import design_flight_controller
from mufly.firmware.emulated.image_build import build_host_board
from mufly.mission import load_mission
from mufly.vehicle import load_vehicle

pytestmark = pytest.mark.skipif(
    not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="no C compiler: install gcc or clang"
)
WORDS = 80
KINDS = 3
VERSION = 1


@pytest.fixture(scope="module")
def library():
    vehicle = load_vehicle("mufly-1.1")
    return build_host_board(vehicle, design_flight_controller(vehicle), load_mission("demonstration"), single=False)


class Flash:
    """Two sectors of flash with their faults, and the storage on them."""

    def __init__(self, library, words=WORDS, noise=1) -> None:
        self.ffi, self.lib = library
        self.array, self.weak = np.full(2 * words, 0xFFFFFFFF, np.uint32), np.zeros(2 * words, np.uint32)
        self.model = self.ffi.new("flash_model_t *", {"sector_words": words, "noise": noise})
        self.model.words = self.ffi.cast("uint32_t *", self.ffi.from_buffer(self.array))
        self.model.weak = self.ffi.cast("uint32_t *", self.ffi.from_buffer(self.weak))
        self.model.cut_after, self.model.worn_word, self.model.worn_sector = -1, -1, -1
        self.storage = self.ffi.new("storage_t *")
        self._buffer = self.ffi.new("uint32_t[]", words)

    def start(self, cut_after=-1) -> None:
        """Switch the power on; it is cut in the operation after so many, counted from now."""
        self.lib.flash_model_attach(self.model)
        self.model.operations, self.model.cut_after = 0, cut_after
        self.lib.flash_model_start(self.model)
        self.lib.storage_open(self.storage)

    def write(self, kind, payload) -> int:
        return self.lib.storage_write(self.storage, kind, VERSION, list(payload), len(payload))

    def read(self, kind) -> tuple[int, ...] | None:
        count = self.lib.storage_read(self.storage, kind, VERSION, self._buffer, len(self._buffer))
        return None if count < 0 else tuple(self._buffer[0:count])

    def contents(self) -> list[tuple[int, ...] | None]:
        return [self.read(k) for k in range(KINDS)]


def _writes(rng, count) -> list[tuple[int, tuple[int, ...]]]:
    """Return kinds and payloads; now and then a word is that of blank flash, or zero."""
    out = []
    for _ in range(count):
        payload = rng.integers(0, 2**32, int(rng.integers(0, 17)), dtype=np.uint32)
        payload[rng.random(len(payload)) < 0.1] = 0xFFFFFFFF
        payload[rng.random(len(payload)) < 0.1] = 0
        out.append((int(rng.integers(KINDS)), tuple(payload.tolist())))
    return out


def _write_until_cut(flash, writes, before) -> tuple[list, list]:
    """Write until one is not acknowledged; return what each kind may hold: what it held, what was on its way."""
    held, coming = list(before), list(before)
    for kind, payload in writes:
        coming[kind] = payload
        if flash.write(kind, payload) != flash.lib.STORAGE_DONE:
            break
        held[kind] = payload
    return held, coming


def _check(flash, held, coming) -> list:
    found = flash.contents()
    for kind in range(KINDS):
        assert found[kind] in (held[kind], coming[kind]), kind
    return found


def test_records_are_those_of_an_independent_reader(library) -> None:
    """The image, read by its layout alone, holds what was written; one made by the layout alone is read by the C."""
    flash, rng = Flash(library), np.random.default_rng(5)
    flash.start()
    latest: list = [None] * KINDS
    for kind, payload in _writes(rng, 200):
        assert flash.write(kind, payload) == flash.lib.STORAGE_DONE
        latest[kind] = payload
        assert flash.contents() == latest == _read_image(flash.array)
    assert flash.storage.generation > 10
    assert flash.storage.bad_words == flash.storage.bad_erases == 0
    other = Flash(library)
    other.array[WORDS:] = np.frombuffer(_make_sector(7, [(k, p) for k, p in enumerate(latest)]), np.uint32)
    other.start()
    assert other.contents() == latest
    assert (other.storage.generation, other.storage.sequence, other.storage.active) == (7, 3, 1)
    # A record whose sequence does not follow is none: sequences from 1 on, but not from 0 on.
    for first, found in ((1, [(5,), (6,), None]), (0, [None, None, None])):
        other.array[WORDS:] = np.frombuffer(_make_sector(7, [(0, (5,)), (1, (6,))], first), np.uint32)
        other.start()
        assert other.contents() == found


def _read_image(words) -> list[tuple[int, ...] | None]:
    sectors = [words[:WORDS].tobytes(), words[WORDS:].tobytes()]
    good = [s for s in sectors if s[:8] == b"mufu" + bytes([1, 0, 0, 0]) and _crc(s[:16]) == s[16:20]]
    found: list[tuple[int, ...] | None] = [None] * KINDS
    if not good:
        return found
    data, at = max(good, key=lambda s: s[8:12][::-1]), 20
    while at + 12 <= len(data):
        kind, version, count = struct.unpack_from("<BBH", data, at)
        if data[at : at + 4] == bytes(4):
            at += 4
            continue
        end = at + 8 + 4 * count
        if data[at : at + 4] == b"\xff" * 4 or end + 4 > len(data) or _crc(data[at:end]) != data[end : end + 4]:
            break
        assert version == VERSION
        found[kind] = struct.unpack_from(f"<{count}I", data, at + 8)
        at = end + 4
    return found


def _crc(data) -> bytes:
    return struct.pack("<I", zlib.crc32(data))


def _make_sector(generation, records, first=1) -> bytes:
    head = b"mufu" + struct.pack("<III", 1, generation, 5)
    data = head + _crc(head)
    for sequence, (kind, payload) in enumerate(records, first):
        record = struct.pack(f"<BBHI{len(payload)}I", kind, VERSION, len(payload), sequence, *payload)
        data += record + _crc(record)
    return data + b"\xff" * (4 * WORDS - len(data))


def test_a_record_that_does_not_end_in_its_sector_is_none(library) -> None:
    """A count that reaches one word too far is refused, even if that word, which is blank, equals the checksum."""
    for excess, expected in ((0, True), (1, False)):
        count = WORDS - 5 - 3 + excess
        data = struct.pack("<BBHI", 1, VERSION, count, 1) + bytes(4 * (count - 1))
        data += struct.pack("<I", zlib.crc32(data) ^ 0xFFFFFFFF)  # the checksum of the whole is that of blank flash
        assert _crc(data) == b"\xff" * 4
        flash = Flash(library)
        image = np.frombuffer(_make_sector(7, [])[:20] + data, np.uint32)
        flash.array[: len(image)] = image
        flash.start()
        assert flash.contents() == [None, struct.unpack(f"<{count}I", data[8:]) if expected else None, None]
        assert flash.write(2, (3, 4)) == (flash.lib.STORAGE_TOO_LARGE if expected else flash.lib.STORAGE_DONE)


def test_a_power_cut_at_every_operation_loses_nothing(library) -> None:
    writes = _writes(np.random.default_rng(2), 24)
    flash = Flash(library)
    flash.start()
    _write_until_cut(flash, writes, [None] * KINDS)
    operations = flash.model.operations
    assert flash.storage.generation > 3  # several sectors were handed over
    cut_in_erase = 0
    for cut in range(operations):
        for noise in range(1, 4):
            flash = Flash(library, noise=7919 * cut + noise)
            flash.start(cut)
            held, coming = _write_until_cut(flash, writes, [None] * KINDS)
            assert held != coming
            cut_in_erase += int(np.count_nonzero(flash.weak)) > 5
            flash.start()
            found = _check(flash, held, coming)
            # What is read counts from now on, and so does what is written next, however undecided bits read then.
            for k in range(4):
                kind, payload = (cut + k) % KINDS, (cut, k)
                assert flash.write(kind, payload) == flash.lib.STORAGE_DONE
                found[kind] = payload
                flash.start()
                assert flash.contents() == found
    assert cut_in_erase > 3


def test_power_cuts_at_random_instants_one_after_the_other_lose_nothing(library) -> None:
    """Cuts in starts and recoveries too. What a whole start has read counts at the next one."""
    rng = np.random.default_rng(3)
    flash, cuts = Flash(library, noise=11), [0, 0]
    possible: list[set] = [{None} for _ in range(KINDS)]
    for _ in range(6000):
        flash.start(int(rng.integers(0, 90)) if rng.random() < 0.4 else -1)
        if flash.model.cut_after < 0:
            flash.model.cut_after = flash.model.operations + int(rng.integers(0, 60))
        found = flash.contents()
        assert all(f in p for f, p in zip(found, possible, strict=True))
        if flash.model.is_off:
            cuts[0] += 1
            continue
        possible = [{f} for f in found]
        for kind, payload in _writes(rng, 6):
            if flash.write(kind, payload) != flash.lib.STORAGE_DONE:
                possible[kind].add(payload)
                break
            possible[kind] = {payload}
        cuts[1] += flash.model.is_off
    assert cuts[0] > 500
    assert cuts[1] > 3000


def test_a_worn_word_and_a_worn_sector_are_noticed(library) -> None:
    rng = np.random.default_rng(4)
    # A word that does not take: the other sector is used, and nothing is lost.
    for word in range(2 * WORDS):
        flash = Flash(library)
        flash.model.worn_word, flash.model.worn_bits = word, 0x00010000
        flash.start()
        held: list = [None] * KINDS
        refused = 0
        for kind, payload in _writes(rng, 40):
            answer = flash.write(kind, payload)
            if answer == flash.lib.STORAGE_DONE:
                held[kind] = payload
            else:
                assert answer == flash.lib.STORAGE_WORN
                refused += 1
            assert flash.contents() == held
        assert refused == 0 or flash.storage.bad_words > 0
        flash.start()
        assert flash.contents() == held
    # A sector that does not erase: what is stored stays, what has no room is refused.
    flash = Flash(library)
    flash.start()
    held = [None] * KINDS
    for kind, payload in _writes(rng, 8):
        assert flash.write(kind, payload) == flash.lib.STORAGE_DONE
        held[kind] = payload
    flash.model.worn_sector = 1 - flash.storage.active
    answers = []
    for kind, payload in _writes(rng, 12):
        answers.append(flash.write(kind, payload))
        if answers[-1] == flash.lib.STORAGE_DONE:
            held[kind] = payload
        assert flash.contents() == held
    assert flash.lib.STORAGE_WORN in answers
    assert flash.storage.bad_erases >= 2
    flash.start()
    assert flash.contents() == held


def test_what_does_not_fit_or_is_not_there_is_refused(library) -> None:
    flash = Flash(library)
    flash.start()
    assert flash.contents() == [None] * KINDS
    room = WORDS - 5 - 3
    assert flash.write(0, range(room + 1)) == flash.lib.STORAGE_TOO_LARGE
    assert flash.write(0, range(room)) == flash.lib.STORAGE_DONE
    assert flash.write(1, ()) == flash.lib.STORAGE_TOO_LARGE
    assert flash.read(0) == tuple(range(room))
    # Another version is not read; the same contents are not written again.
    count = flash.lib.storage_read(flash.storage, 0, VERSION + 1, flash._buffer, WORDS)
    assert count == -1
    before = flash.model.operations
    assert flash.write(0, range(room)) == flash.lib.STORAGE_DONE
    assert flash.model.operations == before
    flash.lib.flash_model_attach(flash.ffi.NULL)
    flash.lib.storage_open(flash.storage)
    assert flash.write(0, (1,)) == flash.lib.STORAGE_ABSENT
    # Any contents are borne: a flash that holds something else is in use after the first record.
    rng = np.random.default_rng(6)
    for _ in range(200):
        flash = Flash(library)
        flash.array[:] = rng.integers(0, 2**32, 2 * WORDS, dtype=np.uint32)
        if rng.random() < 0.5:
            flash.array[:WORDS] = np.frombuffer(_make_sector(9, [(0, (1, 2))]), np.uint32)
            flash.array[int(rng.integers(0, WORDS))] ^= np.uint32(1 << int(rng.integers(32)))
        flash.start()
        assert flash.contents() in ([None] * KINDS, [(1, 2), None, None])
        assert flash.write(2, (3, 4)) == flash.lib.STORAGE_DONE
        flash.start()
        assert flash.read(2) == (3, 4)


def test_records_of_unknown_kinds_and_wrong_lengths_are_passed_over(library) -> None:
    flash = Flash(library)
    flash.array[:WORDS] = np.frombuffer(_make_sector(3, [(0, (5,)), (KINDS + 4, (7, 8)), (1, (6, 9))]), np.uint32)
    flash.start()
    assert flash.contents() == [(5,), (6, 9), None]
    assert flash.storage.sequence == 3
    buffer = flash.ffi.new("uint32_t[2]", [77, 77])
    assert flash.lib.storage_read(flash.storage, 1, VERSION, buffer, 1) == -1  # no room for two words
    assert list(buffer) == [77, 77]
    for count in (-1, 0x10000):
        assert flash.lib.storage_write(flash.storage, 0, VERSION, buffer, count) == flash.lib.STORAGE_TOO_LARGE
    assert flash.contents() == [(5,), (6, 9), None]


def test_a_sector_that_lacks_records_which_it_took_over_is_not_used(library) -> None:
    head = b"mufu" + struct.pack("<III", 1, 9, 40)
    spoilt = head + _crc(head) + _make_sector(9, [(0, (5,))])[20:]
    for other, expected in ((_make_sector(8, [(1, (6,))]), [None, (6,), None]), (b"\xff" * 4 * WORDS, [None] * KINDS)):
        flash = Flash(library)
        flash.array[:WORDS] = np.frombuffer(spoilt, np.uint32)
        flash.array[WORDS:] = np.frombuffer(other, np.uint32)
        flash.start()
        assert flash.contents() == expected
        assert flash.write(2, (7,)) == flash.lib.STORAGE_DONE
        flash.start()
        assert flash.contents() == [*expected[:2], (7,)]
