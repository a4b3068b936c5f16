"""Parameters, calibration and mission of a board after a restart: what a station set, within its bounds."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from board_station import Station
from board_station import mission_item as _item
from pymavlink.dialects.v20 import common as mavlink

from mufly.control import design_flight_controller
from mufly.estimate.filter.filter_records import (
    READING_ACCELERATION,
    READING_RANGE_RING,
    READING_RATES,
    READING_SONAR,
    READING_STARTS,
)
from mufly.firmware import describe_missing_tools
from mufly.firmware.emulated import HostBoard, make_board
from mufly.firmware.emulated.image_build import build_host_board
from mufly.firmware.proof.evidence_report import BOARD_MEMORY_TARGET_BYTES, measure_board_memory
from mufly.mission import load_mission
from mufly.vehicle import load_vehicle

COMPILERS = [c for c in ("cc", "gcc", "clang") if shutil.which(c)]
pytestmark = pytest.mark.skipif(not COMPILERS, reason="no C compiler: install gcc or clang")
needs_qemu = pytest.mark.skipif(bool(describe_missing_tools()), reason=describe_missing_tools())
OTHER_VERSION, REFUSED, OTHER_MISSION = 2, 4, 8  # bits of SETTINGS_... in settings.h
STORAGE = mavlink.MAV_CMD_PREFLIGHT_STORAGE


@pytest.fixture(scope="module")
def vehicle():
    return load_vehicle("mufly-1.1")


@pytest.fixture(scope="module")
def library(vehicle):
    return build_host_board(vehicle, design_flight_controller(vehicle), load_mission("demonstration"), single=False)


class Pilot(Station):
    """A station that sets, reads and restarts."""

    def set(self, name, value) -> float:
        self.heard.clear()
        self.send(mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, 9))
        return round(float(self.wait_for("PARAM_VALUE").param_value), 5)

    def get(self, name) -> float:
        self.heard.clear()
        self.send(mavlink.MAVLink_param_request_read_message(1, 1, name.encode(), -1))
        return round(float(self.wait_for("PARAM_VALUE").param_value), 5)

    def upload(self, items) -> int:
        self.heard.clear()
        self.send(mavlink.MAVLink_mission_count_message(1, 1, len(items), 0))
        for item in items:
            self.wait_for("MISSION_REQUEST_INT")
            self.send(item)
        return int(self.wait_for("MISSION_ACK").type)

    def texts(self, periods=3) -> str:
        for _ in range(periods):
            self.step()
        return " ".join(m.text for m in self.heard if m.get_type() == "STATUSTEXT")

    def restart(self) -> None:
        self.board.restart()
        self.heard.clear()
        self.k = 0

    def mission(self) -> tuple:
        p = self.board.record.plan
        places = [tuple(np.round(list(p.waypoint[k].position), 5)) for k in range(p.count)]
        return (places, p.at_end, round(p.take_off_height, 5))


ITEMS = [
    _item(0, 22, z=-0.7),
    _item(1, 16, 0.5, -0.25, -0.8, p1=2.0),
    _item(2, 16, -1.0, 1.5, -1.2, p4=90.0),
    _item(3, 20),
]
OTHER = [_item(0, 22, z=-0.9), _item(1, 16, 1.5, -0.25, -0.8), _item(2, 21)]


def test_what_is_set_is_there_after_a_restart(library) -> None:
    s = Pilot(library)
    image = s.mission()
    assert s.set("STK_TILT", 5.0) == 5.0
    assert s.set("CAL_GYRO0_YOFF", 0.0125) == 0.0125
    assert s.upload(ITEMS) == mavlink.MAV_MISSION_ACCEPTED
    loaded = s.mission()
    assert loaded == ([(0.5, -0.25, -0.8), (-1.0, 1.5, -1.2)], 2, 0.7)
    s.restart()
    assert s.mission() == loaded
    assert s.get("STK_TILT") == pytest.approx(5.0, rel=1e-6)
    assert s.board.record.supervisor.settings.stick_tilt == pytest.approx(np.radians(5.0), rel=1e-6)
    assert s.get("CAL_GYRO0_YOFF") == 0.0125
    assert s.get("COM_DL_LOSS_T") == 10.0
    # Mission and parameter both hold the take-off height: what came last counts.
    assert s.set("MIS_TAKEOFF_ALT", 1.25) == 1.25
    s.restart()
    assert (s.get("MIS_TAKEOFF_ALT"), s.mission()[:2]) == (1.25, loaded[:2])
    assert s.upload(ITEMS) == mavlink.MAV_MISSION_ACCEPTED
    s.restart()
    assert s.mission() == loaded
    # The image's values come back on request: parameters, calibration, mission.
    assert s.command(STORAGE, 2, -1) == mavlink.MAV_RESULT_ACCEPTED
    s.restart()
    assert (round(s.get("STK_TILT"), 5), s.get("CAL_GYRO0_YOFF")) == (8.0, 0.0125)
    assert s.command(STORAGE, 3, 2) == mavlink.MAV_RESULT_ACCEPTED
    s.restart()
    assert (s.get("CAL_GYRO0_YOFF"), s.mission()) == (0.0, image)
    assert s.command(STORAGE, 1, 1) == mavlink.MAV_RESULT_ACCEPTED
    assert "stored" not in s.texts()


def test_calibration_and_receiver_have_their_bounds_and_share_no_place(library) -> None:
    """The other parameters have the bounds of the simulated vehicle: see test_board_link.py."""
    ffi, lib, record = *library, Pilot(library).board.record
    t = ffi.new("tunables_t *")
    t.plan, t.supervisor = ffi.addressof(record, "plan"), ffi.addressof(record, "supervisor", "settings")
    t.calibration, t.rc = ffi.addressof(record, "settings", "calibration"), ffi.addressof(record, "rc", "settings")
    offset, scale = {"CAL_ACC0": 2.0, "CAL_GYRO0": 0.5, "CAL_RING": 0.2, "CAL_SONAR": 0.2}, (0.8, 1.2)
    names = [ffi.string(lib.parameter_name(k)).decode() for k in range(lib.PARAMETERS)]
    checked = [n for n in names if n.startswith(("CAL_", "RC_", "COM_RC_"))]
    assert len(checked) == 21
    for k, name in ((k, n) for k, n in enumerate(names) if n in checked):
        first = "_".join(name.split("_")[:2])
        least, most = (-offset[first], offset[first]) if name.endswith("OFF") else scale
        least, most = {"RC_MAP": (0.0, 16.0), "COM_RC": (0.1, 5.0)}.get(first, (least, most))
        others = [lib.parameter_get(t, n) for n in range(lib.PARAMETERS) if n != k]
        for bound, beyond in ((least, least - 1e-5 * most), (most, 1.00001 * most), (most, float("nan"))):
            assert lib.parameter_set(t, k, bound), name
            assert lib.parameter_get(t, k) == bound
            assert not lib.parameter_set(t, k, beyond), name
            assert lib.parameter_get(t, k) == bound
        assert [lib.parameter_get(t, n) for n in range(lib.PARAMETERS) if n != k] == others


def test_values_set_in_flight_are_stored_after_it(library) -> None:
    s = Pilot(library)
    s.board.record.supervisor.armed = True
    written = s.board.flash_model.operations
    assert s.set("STK_CLIMB", 0.25) == 0.25
    assert s.set("CAL_ACC0_XOFF", 0.5) == 0.0
    assert "calibration needs motors off" in s.texts()
    assert s.command(STORAGE, 1) == mavlink.MAV_RESULT_TEMPORARILY_REJECTED
    assert s.board.flash_model.operations == written
    s.board.record.supervisor.armed = False
    s.step()
    assert s.board.flash_model.operations > written
    s.restart()
    assert s.get("STK_CLIMB") == 0.25


def test_readings_are_calibrated_once(library) -> None:
    s = Pilot(library)
    for name, value in (
        ("CAL_ACC0_YOFF", 0.5), ("CAL_ACC0_YSCALE", 1.1), ("CAL_GYRO0_ZOFF", -0.02), ("CAL_SONAR_OFF", 0.05),
        ("CAL_RING_OFF", -0.1), ("CAL_RING_SCALE", 0.9),
    ):  # fmt: skip
        s.set(name, value)
    s.restart()
    for fresh in (1, 0):
        r = s.period.readings
        for k in (READING_ACCELERATION, READING_RATES, READING_SONAR, READING_RANGE_RING):
            r.fresh[k] = fresh
        (
            r.z[READING_STARTS[READING_ACCELERATION] + 1],
            r.z[READING_STARTS[READING_RATES] + 2],
            r.z[READING_STARTS[READING_SONAR]],
        ) = (
            2.0,
            0.1,
            0.4,
        )
        r.ranges[3] = 1.5
        s.board.compute_estimate(s.period)
        z = s.board.record.readings
        assert z.z[READING_STARTS[READING_ACCELERATION] + 1] == pytest.approx(1.65)
        assert z.z[READING_STARTS[READING_RATES] + 2] == pytest.approx(0.12)
        assert z.z[READING_STARTS[READING_SONAR]] == pytest.approx(0.35)
        assert z.ranges[3] == pytest.approx(1.44)


def _store(s, kind, words, version=1) -> None:
    """Store a record past all checks, as other software may have done."""
    storage = s.ffi.addressof(s.board.record.settings, "storage")
    assert s.lib.storage_write(storage, kind, version, words, len(words)) == s.lib.STORAGE_DONE


def _entry(name, value) -> list[int]:
    text = name.encode().ljust(16, b"\0")
    return [int.from_bytes(text[k : k + 4], "little") for k in range(0, 16, 4)] + [
        int(np.float32(value).view(np.uint32))
    ]


def test_stored_values_out_of_bounds_are_refused_and_reported(library) -> None:
    s = Pilot(library)
    image = s.mission()
    s.upload(ITEMS)
    entries = (("STK_TILT", 40.0), ("STK_CLIMB", 0.3), ("LIM_REACH", np.nan), ("NO_SUCH", 1.0), ("CAL_RING_OFF", 0.1))
    _store(s, s.lib.STORED_PARAMETERS, [w for name, value in entries for w in _entry(name, value)])
    s.restart()
    assert (round(s.get("STK_TILT"), 4), round(s.get("STK_CLIMB"), 4), s.get("CAL_RING_OFF")) == (8.0, 0.3, 0.0)
    assert np.isfinite(s.get("LIM_REACH"))
    s.restart()
    s.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    assert "out of bounds" in s.texts()
    assert s.texts().count("out of bounds") == 1
    # A mission with one waypoint too high, one too slow, too many waypoints: that of the image counts.
    storage = s.ffi.addressof(s.board.record.settings, "storage")
    buffer = s.ffi.new("uint32_t[]", 300)
    count = s.lib.storage_read(storage, s.lib.STORED_MISSION, 1, buffer, 300)
    good = list(buffer[0:count])
    assert count == 3 + 7 * 2
    bad = {5: np.float32(-60.0), 7: np.float32(0.0), 10: np.float32(np.nan), 2: np.float32(0.0)}
    for at, value in bad.items():
        words = list(good)
        words[at] = int(value.view(np.uint32))
        _store(s, s.lib.STORED_MISSION, words)
        s.restart()
        assert s.mission() == image, at
        assert s.board.record.settings.faults & REFUSED
    for words in ([good[0], 33, *good[2:]], good[:-1], [good[0], good[1] | 0x30000, *good[2:]]):
        _store(s, s.lib.STORED_MISSION, words)
        s.restart()
        assert s.mission() == image
    # The mission that replaced that of another image, and a record of another version, are not used.
    _store(s, s.lib.STORED_MISSION, [good[0] ^ 1, *good[1:]])
    s.restart()
    assert (s.mission(), s.board.record.settings.faults) == (
        image,
        OTHER_MISSION | REFUSED,
    )
    _store(s, s.lib.STORED_MISSION, good, version=2)
    s.restart()
    assert s.mission() == image
    assert s.board.record.settings.faults & OTHER_VERSION
    _store(s, s.lib.STORED_MISSION, good)
    s.restart()
    assert s.mission() != image


def test_a_worn_flash_is_reported_and_missions_that_are_not_stored_are_refused(library) -> None:
    s = Pilot(library)
    s.upload(ITEMS)
    before = s.mission()
    s.board.flash_model.worn_sector = 1 - s.board.record.settings.storage.active
    s.board.flash_model.worn_word = (
        s.board.record.settings.storage.active * 4096 + s.board.record.settings.storage.end + 5
    )
    s.board.flash_model.worn_bits = 0xFFFFFFFF
    s.board.flash_model.words[4096 * s.board.flash_model.worn_sector] = 0
    assert s.upload(OTHER) == mavlink.MAV_MISSION_ERROR
    assert "worn" in s.texts()
    assert s.mission() == before
    assert s.set("STK_TILT", 6.0) == pytest.approx(6.0)  # in force, but not stored
    assert "worn" in s.texts()
    operations = s.board.flash_model.operations
    s.texts(50)
    assert s.board.flash_model.operations == operations  # not tried again in every period
    assert s.command(STORAGE, 1) == mavlink.MAV_RESULT_FAILED
    # A load drops what is not stored.
    assert s.set("CAL_SONAR_OFF", 0.1) == pytest.approx(0.1)
    assert s.command(STORAGE, 0) == mavlink.MAV_RESULT_ACCEPTED
    assert (s.get("STK_TILT"), s.get("CAL_SONAR_OFF")) == (8.0, 0.0)
    s.restart()
    assert (s.mission(), round(s.get("STK_TILT"), 4)) == (before, 8.0)


def test_a_board_without_flash_works_and_keeps_nothing(library) -> None:
    s = Pilot(library)
    s.board.flash_model.sector_words = 0
    s.restart()
    assert s.set("STK_TILT", 5.0) == 5.0
    assert s.set("CAL_SONAR_OFF", 0.1) == 0.1
    assert s.upload(ITEMS) == mavlink.MAV_MISSION_ACCEPTED
    assert s.command(STORAGE, 1, 1) == mavlink.MAV_RESULT_ACCEPTED
    assert "stored" not in s.texts(300)
    s.restart()
    assert (s.get("STK_TILT"), s.get("CAL_SONAR_OFF")) == (8.0, 0.0)


def test_calibration_that_is_not_stored_is_owed_until_the_flash_takes_it(library) -> None:
    s = Pilot(library)
    settings, model = s.board.record.settings, s.board.flash_model
    s.set("STK_TILT", 5.0)
    cut = model.operations
    model.cut_after = cut  # the flash takes nothing any more
    assert [s.set("CAL_SONAR_OFF", value) for value in (0.05, 0.1)] == [0.05, 0.1]
    assert (settings.owes_parameters, settings.owes_calibration, settings.has_failed) == (False, True, True)
    assert "worn" in s.texts()
    assert s.command(STORAGE, 1, 1) == mavlink.MAV_RESULT_FAILED
    model.cut_after, model.is_off = -1, False
    assert s.command(STORAGE, 1) == mavlink.MAV_RESULT_ACCEPTED
    assert not settings.owes_calibration
    s.restart()
    assert (s.get("STK_TILT"), s.get("CAL_SONAR_OFF")) == (5.0, 0.1)
    # Set while armed, calibration is refused; a calibration that waits is stored once the motors are off.
    s.board.record.supervisor.armed = True
    assert s.set("CAL_SONAR_OFF", 0.15) == 0.1
    settings.owes_calibration, settings.calibration.sonar_offset = True, 0.15
    s.board.record.supervisor.armed = False
    s.step()
    s.restart()
    assert s.get("CAL_SONAR_OFF") == 0.15


def test_the_shape_of_a_stored_mission_is_kept(library) -> None:
    s = Pilot(library)
    assert s.upload(ITEMS) == mavlink.MAV_MISSION_ACCEPTED
    for spline in (True, False):
        s.board.record.plan.spline = spline
        assert s.command(STORAGE, 9, 1) == mavlink.MAV_RESULT_ACCEPTED
        s.restart()
        assert bool(s.board.record.plan.spline) == spline
        s.texts(200)


def test_each_number_of_a_stored_mission_has_its_bounds(library) -> None:
    s = Pilot(library)
    image = s.mission()
    assert s.upload(ITEMS) == mavlink.MAV_MISSION_ACCEPTED
    loaded = s.mission()
    storage, buffer = s.ffi.addressof(s.board.record.settings, "storage"), s.ffi.new("uint32_t[]", 300)
    count = s.lib.storage_read(storage, s.lib.STORED_MISSION, 1, buffer, 300)
    good = list(buffer[0:count])
    speed = float(s.board.record.plan.limits.speed)
    # Places in the record: take-off height 2; of the second waypoint N 10, E 11, D 12, wait 13, speed 14, heading 16.
    bad = {
        2: (0.05, 60.0), 10: (2e4, np.nan), 11: (-2e4,), 12: (0.0, -0.05, -51.0, np.nan), 13: (-1.0, 3601.0, np.nan),
        14: (0.0, -1.0, 1.01 * speed, np.nan), 16: (1001.0, np.nan),
    }  # fmt: skip
    for at, value in ((at, v) for at, values in bad.items() for v in values):
        words = list(good)
        words[at] = int(np.float32(value).view(np.uint32))
        _store(s, s.lib.STORED_MISSION, words)
        s.restart()
        assert s.mission() == image, (at, value)
        assert s.board.record.settings.faults & REFUSED, (at, value)
    at_bound = {12: (-50.0,), 13: (0.0, 3600.0), 14: (speed,), 16: (-1000.0, 1000.0)}
    for at, value in ((at, v) for at, values in at_bound.items() for v in values):
        words = list(good)
        words[at] = int(np.float32(value).view(np.uint32))
        _store(s, s.lib.STORED_MISSION, words)
        s.restart()
        assert s.mission() != image, (at, value)
        assert not s.board.record.settings.faults & REFUSED, (at, value)
    _store(s, s.lib.STORED_MISSION, good)
    s.restart()
    assert s.mission() == loaded
    for kind in (s.lib.STORED_PARAMETERS, s.lib.STORED_CALIBRATION):
        _store(s, kind, [], version=2)
        s.restart()
        assert s.board.record.settings.faults & OTHER_VERSION


def test_the_power_is_cut_at_random_instants_of_a_session(library) -> None:
    """300 cuts while a station sets parameters and loads missions: what was answered is there."""
    rng = np.random.default_rng(8)
    s = Pilot(library)
    s.board.flash_model.sector_words = 64  # small sectors are full soon
    s.restart()
    missions = {}
    for items in (ITEMS, OTHER):
        s.upload(items)
        missions[id(items)] = s.mission()
    tilt, mission, cuts = round(s.get("STK_TILT"), 4), s.mission(), 0
    model = s.board.flash_model
    for n in range(300):
        model.cut_after = model.operations + int(rng.integers(0, 80))
        new_tilt, new_mission = tilt, mission
        for _ in range(6):
            if rng.random() < 0.7:
                new_tilt = float(rng.integers(1, 16))
                s.set("STK_TILT", new_tilt)
            else:
                items = ITEMS if rng.random() < 0.5 else OTHER
                new_mission = missions[id(items)]
                s.upload(items)
            if model.is_off:
                break
            tilt, mission = new_tilt, new_mission
        cuts += model.is_off
        model.cut_after = -1
        s.restart()
        found = (round(s.get("STK_TILT"), 4), s.mission())
        assert found[0] in (tilt, new_tilt), n
        assert found[1] in (mission, new_mission), n
        tilt, mission = found
    assert cuts > 250
    assert s.board.record.settings.storage.generation > 100


@needs_qemu
def test_the_emulated_board_keeps_its_settings_over_a_restart(vehicle) -> None:
    """The memory of QEMU that takes the place of flash outlasts the emulation, and equals that of this machine."""
    board = make_board(vehicle, design_flight_controller(vehicle), load_mission("demonstration"), emulated=True)
    period, request = board.ffi.new("board_period_t *"), board.ffi.new("board_request_t *")
    try:
        twin = HostBoard(board.ffi, board.lib)
        storage, words = board.ffi.new("storage_t *"), _entry("STK_TILT", 11.0)
        board.lib.flash_model_attach(twin.flash_model)
        board.lib.storage_open(storage)
        board.lib.storage_write(storage, board.lib.STORED_PARAMETERS, 1, words, len(words))
        board._twin.flash[:] = board.flash[:] = twin.flash
        for n in range(2):
            board.restart()
            for k in range(3):
                period.time_s = 0.005 * k
                board.compute_estimate(period)
                board.compute_control(request)
            assert board.mismatch_count == 0, board.first_mismatch
            assert board.record.supervisor.settings.stick_tilt == pytest.approx(np.radians(11.0))
            assert board.flash.tobytes() == board._twin.flash.tobytes(), n
    finally:
        board.close()


@needs_qemu
def test_a_whole_board_fits_its_processor(vehicle) -> None:
    """Loop, estimator, MAVLink, receiver and settings: flash, RAM, and the stack of the deepest path of calls."""
    found = measure_board_memory(vehicle)
    assert found.keys() == BOARD_MEMORY_TARGET_BYTES.keys()
    for name, size in found.items():
        assert 0.3 * BOARD_MEMORY_TARGET_BYTES[name] < size < BOARD_MEMORY_TARGET_BYTES[name], name
