"""The estimator in C: the same numbers as Python's to the last bit, whatever the readings and the compiler."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Sequence
from typing import Any

import cffi
import numpy as np
import pytest

from mufly.compiled.toolchain import build_cached_library
from mufly.control import design_flight_controller
from mufly.dynamics import find_trim, model_parameters
from mufly.dynamics.equations_of_motion import state_derivative_from_tilt_sines
from mufly.dynamics.model_state import MODEL_SPEED_UPPER, STATE_SIZE
from mufly.errors import MuflyError
from mufly.estimate import KalmanEstimator, filter_backend
from mufly.estimate.filter.c_records import PYTHON_ONLY_FIELDS, flight_model_record, render_records_header
from mufly.estimate.filter.filter_records import (
    ERROR_TERRAIN,
    NOMINAL_ATTITUDE,
    NOMINAL_FIX_BIAS,
    NOMINAL_TERRAIN,
    PHASE_FLYING,
    PHASE_LIFTING_OFF,
    PHASE_MOTORS_RUNNING,
    PHASE_ROTORS_COASTING,
    PHASE_STANDING,
    READING_RANGE_RING,
    READING_SONAR,
)
from mufly.estimate.filter.ud_filter import inflate_variance, state_variance
from mufly.estimate.filter_backend import BackendName
from mufly.flight import Flight
from mufly.mission import parse_mission
from mufly.sensors import Readings, make_fitted_sensors, parse_fault
from mufly.vehicle import Vehicle, load_vehicle, replace_parameters
from mufly.world import World

COMPILERS = [name for name in ("gcc", "clang") if shutil.which(name)]
needs_cc = pytest.mark.skipif(not COMPILERS, reason="there is no C compiler on this machine")
HOP = parse_mission(
    {
        "take_off": {"height_m": 1.0, "wait_s": 0.5},
        "waypoint": [{"position_m": [0.6, 0.3, -1.0], "wait_s": 1.0}],
        "room": {"north_m": [-1.5, 1.5], "east_m": [-1.5, 1.5], "height_m": 3.0},
    }
)
FAULTS = (
    "",
    "sonar.jump=0.3@4s+2s gyro.jump=0.3@6s position.dropout@4s+3s ring.insane@3s pressure.doubled@1s",
    "sonar.jump=0.1@0.5s+1s sonar.stuck=1.0@4s accelerometer.clip=12@5s ring.doubled@3s battery.jump@4s "
    "magnetometer.insane@5s",
    "position.late@4s pressure.drift@4s gyro.insane@6s+0.5s ring.outliers@3s gyro.outliers@7s sonar.outliers@5s",
    "position.drift=0.3@4s magnetometer.jump@4s pressure.jump@5s rotor_speed.jump@5s sonar.drift@4s",
    "accelerometer.drift=2@4s",
    "gyro.jump=6@8s+0.05s",  # too large for an offset, too long for a spike
)


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return replace_parameters(load_vehicle("mufly-2.0"), {"motor.friction_torque": 1e-4})


@pytest.fixture(scope="module")
def felt(vehicle: Vehicle) -> Callable[[str], list[tuple[Readings, np.ndarray]]]:
    """Readings of a unit with faults on a short flight, each with what acted: two seconds on the floor, then a hop."""
    truths, acted = [], []
    with Flight(
        vehicle,
        HOP,
        controller=design_flight_controller(vehicle),
        seed=5,
        wind=(0.4, 0.0, 0.0),
        gust=0.2,
        keep=False,
    ) as f:
        while f.time_s < 9.0:
            if f.time_s == 2.0:
                f.autopilot.arm(force=True, quiet=True)
                f.autopilot.start_mission()
            f.step_period()
            truths.append(f.status.truth)
            acted.append(f.status.actuators.input_array)

    def of(faults: str, mounted: dict[str, float] | None = None) -> list[tuple[Readings, np.ndarray]]:
        own = replace_parameters(vehicle, mounted or {})
        sensors = make_fitted_sensors(own, HOP.world, seed=10_000, faults=[parse_fault(x) for x in faults.split()])
        return [(sensors.read(t), a) for t, a in zip(truths, acted, strict=True)]

    return of


def estimator(vehicle: Vehicle, code: BackendName) -> KalmanEstimator:
    return KalmanEstimator(vehicle, HOP.world, 200.0, code=code)


def same(a: np.ndarray, b: np.ndarray) -> bool:
    names = [name for name in a.dtype.names or () if name not in PYTHON_ONLY_FIELDS]
    return all(a[name].tobytes() == b[name].tobytes() for name in names)


@needs_cc
@pytest.mark.parametrize("faults", FAULTS)
def test_c_remembers_what_python_remembers_to_the_last_bit(vehicle, felt, faults) -> None:
    """All that the filter holds, not only what it tells; with what goes wrong with sensors."""
    c, python = (estimator(vehicle, code) for code in ("c", "numba"))
    assert (c.backend.name, python.backend.name) == ("C", "Numba")
    disowned = spikes = 0
    for k, (r, a) in enumerate(felt(faults)):
        told, right = c.update(r, a), python.update(r, a)
        assert told.valid == right.valid
        assert c.memory["x_output"].tobytes() == python.memory["x_output"].tobytes(), k
        disowned += int(c.memory["is_accel_distrusted"])
        spikes = max(spikes, int(c.memory["spike_count"]))
        if k % 25 == 0:
            assert same(c._memory_array, python._memory_array), k
    assert same(c._memory_array, python._memory_array)
    assert (disowned > 0) == faults.startswith("accelerometer.drift")  # forces apart by six deviations
    assert (spikes == 8) == faults.startswith("gyro.jump=6")  # after so many in a row the readings count again
    longer_least = float(c.memory["sonar_effective_min_range"]) > float(c._settings["sonar_min_range"])
    assert longer_least == faults.startswith("sonar.jump=0.1@")  # on the floor
    if not faults:
        assert c.memory["flight_phase"] == PHASE_FLYING
        c.memory["x"][NOMINAL_TERRAIN] += 1e-15
        assert not same(c._memory_array, python._memory_array)  # the comparison can fail


@needs_cc
def test_rotors_that_hardly_turn_have_equal_loads_in_both_languages() -> None:
    """Below 1 rad/s the coefficient map reads another ratio of the speeds than at full speed."""
    mapped = replace_parameters(load_vehicle("mufly-2.0"), {"rotors.coefficient_map": "walkera-5g6-bemt"})
    p, still = model_parameters(mapped), np.zeros(3)
    sources = filter_backend.collect_filter_sources(render_records_header(p))
    ffi = cffi.FFI()
    ffi.cdef(
        "void flight_model(const double *x, const double *u, const double *wind, const void *p, const double *swash,"
        " double *dx);"
    )
    lib = ffi.dlopen(str(build_cached_library("estimate", sources)))
    record = ffi.from_buffer(flight_model_record(p))
    ours, theirs = np.empty(STATE_SIZE), np.empty(STATE_SIZE)
    for speeds in ((0.3, 0.7), (0.9, 0.2), (5e-4, 2e-4), (1.5, 1.2), (300.0, 310.0)):
        x, u = find_trim(mapped).state, np.array([0.1, 0.1, 0.0, 0.0])
        x[MODEL_SPEED_UPPER : MODEL_SPEED_UPPER + 2] = speeds
        state_derivative_from_tilt_sines(x, u, still, p, 0.0, 1.0, 0.0, 1.0, False, ours)
        buffers = (ffi.from_buffer("double[]", a) for a in (x, u, still))
        lib.flight_model(
            *buffers, record, ffi.new("double[4]", [0.0, 1.0, 0.0, 1.0]), ffi.from_buffer("double[]", theirs)
        )
        assert ours.tobytes() == theirs.tobytes(), speeds


@needs_cc
def test_a_tilted_inertial_unit_is_levelled_alike(vehicle: Vehicle, felt: Callable[..., Any]) -> None:
    """The unit is mounted 3 and -2 degrees off; nobody tells the filter. At rest it is turned level in both."""
    angles = {"sensors.imu.mount_roll": math.radians(3.0), "sensors.imu.mount_pitch": math.radians(-2.0)}
    c, python = (estimator(vehicle, code) for code in ("c", "numba"))
    plain = estimator(vehicle, "c")
    upright = felt("")
    for (r, a), (level, _) in zip(felt("", angles), upright, strict=True):
        told, right, without = c.update(r, a), python.update(r, a), plain.update(level, a)
    assert same(c._memory_array, python._memory_array)
    assert (c.memory["has_levelling_rotation"], plain.memory["has_levelling_rotation"]) == (1, 0)
    turned = c.memory["levelling_rotation"].reshape(3, 3)
    np.testing.assert_allclose(turned @ turned.T, np.eye(3), atol=1e-12)
    mounted = math.degrees(math.acos(turned[2, 2]))
    assert mounted == pytest.approx(math.hypot(3.0, 2.0), abs=1.3)  # legs and bias: a degree
    assert told.valid
    assert right.valid
    assert np.degrees(np.abs(told.attitude - without.attitude)[:2]).max() < 1.3
    assert told.auxiliary_states is not None
    raw = c.memory["last_value"][:3]
    assert told.auxiliary_states.specific_force.tolist() == raw.tolist()  # what was measured, not what was turned


@needs_cc
def test_a_filter_that_knows_of_no_bar_is_the_same(
    vehicle: Vehicle, felt: Callable[[str], list[tuple[Readings, np.ndarray]]]
) -> None:
    """The upper rotor of its flight model follows the mast: other numbers than with a bar, and the same in C."""
    bare = replace_parameters(vehicle, {"stabiliser_bar.fitted": False})
    c, python, barred = estimator(bare, "c"), estimator(bare, "numba"), estimator(vehicle, "c")
    for r, a in felt(""):
        for e in (c, python, barred):
            e.update(r, a)
    assert same(c._memory_array, python._memory_array)
    assert c.memory["flight_phase"] == PHASE_FLYING
    assert c.memory["x_output"].tobytes() != barred.memory["x_output"].tobytes()


@needs_cc
@pytest.mark.parametrize("settings", [{"model": 0}, {"model": 0, "fitted": 1}, {"fitted": 2}, {"fitted": 3}])
def test_a_vehicle_with_less_on_board_is_the_same(
    vehicle: Vehicle, felt: Callable[[str], list[tuple[Readings, np.ndarray]]], settings: dict[str, int]
) -> None:
    """Without a model of its rotors; with the inertial unit alone, with every second sensor, with all but that unit."""
    c, python = (estimator(vehicle, code) for code in ("c", "numba"))
    places = np.arange(c._settings["is_fitted"].size)
    there = {1: places < 2, 2: places % 2 == 0, 3: places >= 2}
    for e in (c, python):
        has = e._settings.copy()
        has["has_rotor_model"] = settings.get("model", 1)
        if "fitted" in settings:
            has["is_fitted"][:] *= there[settings["fitted"]]
        e.replace_settings_and_reset(has)
    for k, (r, a) in enumerate(felt("sonar.jump=0.3@5s gyro.dropout@7s+0.5s")[::2]):
        told, right = c.update(r, a), python.update(r, a)
        assert told.valid == right.valid
        assert c.memory["x_output"].tobytes() == python.memory["x_output"].tobytes(), k
    assert same(c._memory_array, python._memory_array)


@needs_cc
@pytest.mark.parametrize(
    ("floor_m", "sigma_m", "settles"), [(0.01, 0.03, True), (0.045, 0.012, False), (0.01, 0.005, False)]
)
def test_a_floor_that_may_be_the_room_s_is_taken_for_it_in_both(vehicle, felt, floor_m, sigma_m, settles) -> None:
    """Past an edge, with the sonar silent: what is known to lie higher stays so, what is known well is left alone."""
    c, python = (estimator(vehicle, code) for code in ("c", "numba"))
    for k, (r, a) in enumerate(felt("sonar.dropout@7s")[:1640]):
        for e in (c, python):
            m = e.memory
            if k == 1600:
                assert m["terrain_edge_weight"] == 0.0
                m["x"][NOMINAL_TERRAIN] = floor_m
                less = sigma_m**2 - state_variance(m["u_transposed"], m["ud_diagonal"], ERROR_TERRAIN)
                inflate_variance(m["u_transposed"], m["ud_diagonal"], ERROR_TERRAIN, less, m["u_transposed_h"])
                assert state_variance(m["u_transposed"], m["ud_diagonal"], ERROR_TERRAIN) == pytest.approx(sigma_m**2)
            e.update(r, a)
    assert same(c._memory_array, python._memory_array)
    assert (abs(c.memory["x"][NOMINAL_TERRAIN]) < 0.2 * floor_m) == settles


def told(r: Readings, name: str, value: np.ndarray) -> Readings:
    """With another value of a sensor."""
    return Readings(time_s=r.time_s, latest={**r.latest, name: r.latest[name]._replace(value=value)})


@needs_cc
def test_lasers_of_who_believes_to_be_outside_of_the_room_meet_no_wall_in_both(vehicle, felt) -> None:
    c, python = (estimator(vehicle, code) for code in ("c", "numba"))
    for k, (r, a) in enumerate(felt("position.dropout@7s")[:1700]):
        near = told(r, "ranges", 1.0 + 0.01 * np.sin(k + np.arange(r.latest["ranges"].value.size)))
        for e in (c, python):
            if k == 1500:
                e.memory["x"][:2] = 40.0, 40.0
            if k == 1600:  # lies on its side: what its beams meet first is the floor
                e.memory["x"][NOMINAL_ATTITUDE : NOMINAL_ATTITUDE + 4] = np.cos(0.7), np.sin(0.7), 0.0, 0.0
            e.update(near if k >= 1500 else r, a)
    assert same(c._memory_array, python._memory_array)
    assert c.memory["beams_seen"] == len(near.latest["ranges"].value)
    assert c.memory["status"][READING_RANGE_RING] != 1  # FUSED


@needs_cc
@pytest.mark.parametrize("remembers", [True, False])
def test_a_fix_apart_from_the_sonar_in_height_is_told_in_both(vehicle, felt, remembers) -> None:
    """By what it is believed to be off by, or by what it says for a second."""
    c, python = (estimator(vehicle, code) for code in ("c", "numba"))
    most = 0.0
    for k, (r, a) in enumerate(felt("")[:1700]):
        if not remembers and k >= 1200:
            r = told(r, "position_fix", r.latest["position_fix"].value - np.array([0.0, 0.0, 0.8, 0.0]))
        for e in (c, python):
            if remembers and k == 1500:
                e.memory["x"][NOMINAL_FIX_BIAS + 2] = 2.0
            e.update(r, a)
        most = max(most, c.memory["fix_sonar_height_difference"])
    assert same(c._memory_array, python._memory_array)
    assert most > (0.0 if remembers else 0.5)


@needs_cc
def test_whatever_they_remember_both_go_on_alike(vehicle, felt) -> None:
    """Heights, speeds, modes, doubts, offsets and ages as no flight has them together."""
    c, python = (estimator(vehicle, code) for code in ("c", "numba"))
    rng = np.random.default_rng(8)
    modes = set()
    with np.errstate(all="ignore"):
        for k, (r, a) in enumerate(felt("gyro.dropout@6s+0.5s")):
            if k % 8 == 7:
                x = np.zeros(c.memory["x"].size)
                x[0:3] = rng.normal(0.0, [2.0, 2.0, 0.1]) * (rng.random(3) < 0.3)
                x[5] = rng.normal(0.0, 0.5) * (rng.random() < 0.3)
                x[NOMINAL_TERRAIN] = rng.normal(0.0, 0.1) * (rng.random() < 0.3)
                shift = rng.normal(0.0, 4.0, 3) * (rng.random() < 0.2)
                mode, sensor, code = (
                    rng.integers(0, PHASE_FLYING + 1),
                    rng.integers(0, READING_RANGE_RING + 1),
                    rng.integers(0, 5),
                )
                edge, apart, ago = rng.choice([0.0, 0.5]), rng.choice([0.0, 0.3]), rng.integers(0, 200)
                for e in (c, python):
                    m = e.memory
                    m["x"][:] += x
                    m["gyro_offset_jump"][:] += shift
                    m["flight_phase"], m["terrain_edge_weight"], m["fix_sonar_height_difference"] = mode, edge, apart
                    m["status"][sensor], m["last_fused_tick"][READING_SONAR] = (
                        code,
                        max(int(m["tick"]) - int(ago), 0),
                    )
                    # On the floor the rotor runs down.
                    m["flight_model_state"][MODEL_SPEED_UPPER] += 200.0 if k < 200 else 0.0
            told, right = c.update(r, a), python.update(r, a)
            assert told.valid == right.valid
            assert c.memory["x_output"].tobytes() == python.memory["x_output"].tobytes(), k
            modes.add(int(c.memory["flight_phase"]))
    assert same(c._memory_array, python._memory_array)
    assert modes == {PHASE_STANDING, PHASE_ROTORS_COASTING, PHASE_MOTORS_RUNNING, PHASE_LIFTING_OFF, PHASE_FLYING}


def streams(vehicle: Vehicle, felt) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Rows as the step takes them: a flight's, then nonsense of every kind."""
    e = estimator(vehicle, "c")
    rows = []
    for r, a in felt("")[:1400]:
        e._fill_inputs(r, a)
        rows.append((e._input_values.copy(), e._input_is_new.copy(), e._input_age.copy()))
        e.backend.step_filter(e._memory_array)
    rng = np.random.default_rng(3)
    evil = np.array([np.nan, np.inf, -np.inf, 1e300, -1e300, 0.0, -0.0, 1e-310, 1e9, -2.0])
    for k in range(600):
        z, new, age = (x.copy() for x in rows[800 + k])
        z = np.where(rng.random(z.size) < 0.1, rng.choice(evil, z.size), z)
        z = np.where(rng.random(z.size) < 0.1, z * rng.normal(0.0, 3.0, z.size), z)
        age = np.where(rng.random(age.size) < 0.1, rng.choice(evil, age.size), age)
        new[rng.random(new.size) < 0.1] = rng.integers(-1, 5)  # 0 to 2 are codes
        rows.append((z, new, age))
    return rows


def replayed(e: KalmanEstimator, rows: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> list[bytes]:
    told = []
    with np.errstate(all="ignore"):
        for z, new, age in rows:
            e._input_values[:], e._input_is_new[:], e._input_age[:] = z, new, age
            valid = e.backend.step_filter(e._memory_array)
            told.append(e.memory["x_output"].tobytes() + e.memory["angles_output"].tobytes() + bytes([valid]))
    return [*told, *(e.memory[n].tobytes() for n in e.memory.dtype.names if n not in PYTHON_ONLY_FIELDS)]


@needs_cc
def test_nonsense_and_any_compiler_give_the_same(vehicle, felt, monkeypatch) -> None:
    rows = streams(vehicle, felt)
    right = replayed(estimator(vehicle, "numba"), rows)
    assert np.all(np.isfinite(np.frombuffer(right[len(rows)])))  # the first it remembers: the state of the horizon
    for cc in COMPILERS:
        for level in ("-O0", "-O2") if cc == "gcc" else ("-O3",):
            monkeypatch.setenv("CC", cc)
            e = estimator(vehicle, "numba")
            flags = ("-std=c99", level, "-ffp-contract=off")
            e.backend = filter_backend.make_c_backend(
                e._settings, e._parameters, e._input_values, e._input_is_new, e._input_age, flags
            )
            assert replayed(e, rows) == right, (cc, level)


def test_c_is_a_translation_of_these_sources() -> None:
    """Fails when a line of the filter's compiled functions changes: C has to follow, which the tests above tell; then
    this stamp is written into mufly/estimate/filter_backend.py."""
    assert filter_backend.source_stamp() == filter_backend.VERIFIED_STAMP
    assert all(hasattr(module, name) for module, names in filter_backend._TRANSLATED_MODULES for name in names)


@needs_cc
def test_who_computes_is_chosen_and_told(vehicle, monkeypatch) -> None:
    def chosen() -> tuple[str, str]:
        steps = KalmanEstimator(vehicle, World(), 200.0).backend
        return steps.name, steps.selection_reason

    monkeypatch.delenv("MUFLY_ESTIMATOR", raising=False)
    assert chosen() == ("C", "")
    assert KalmanEstimator(vehicle, World(), 200.0, np.float32).backend.selection_reason == "single precision"
    monkeypatch.setattr(filter_backend, "VERIFIED_STAMP", "of other sources")
    assert chosen()[0] == "Numba"
    assert "differ from those" in chosen()[1]
    monkeypatch.undo()
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.delenv("MUFLY_ESTIMATOR", raising=False)
    filter_backend._load_filter_library.cache_clear()
    assert chosen()[0] == "Numba"
    assert "no C compiler" in chosen()[1]
    monkeypatch.setenv("MUFLY_ESTIMATOR", "c")
    with pytest.raises(MuflyError, match="the estimator in C: there is no C compiler"):
        chosen()
