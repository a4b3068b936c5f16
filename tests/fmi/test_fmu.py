"""Co-simulation units: flights equal those of the Python model, to the last bit; the interface keeps its rules."""

import ctypes as c
import math
import re
import zipfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

import mufly
from mufly.cli import app
from mufly.compiled.toolchain import compile_library, find_compiler
from mufly.dynamics import (
    STATE_SIZE,
    body_to_ned_matrix,
    compute_battery_supply,
    initial_state,
    integrate_state,
    model_parameters,
    scale_vehicle_by_similarity,
    state_derivative,
)
from mufly.dynamics.edgewise_loads import edgewise_load_factors
from mufly.dynamics.equations_of_motion import compute_axial_climb_velocity, ground_effect_thrust_increment, rotor_loads
from mufly.errors import InputError, MuflyError
from mufly.estimate import ERROR_STATES, AuxiliaryStates, Estimate
from mufly.fmi import UnitInstance, UnitLibrary, compare_fmu_with_model, compare_sensed_fmu_with_model, export_fmu
from mufly.fmi.fmu_export import SOURCE_FOLDER
from mufly.fmi.model_description import unit_exponents
from mufly.fmi.unit_flight import _sensed_values
from mufly.sensors import Readings
from mufly.vehicle import Vehicle, list_builtin_coefficient_maps, list_builtin_flight_maps, replace_parameters

try:
    find_compiler()
except MuflyError as error:
    pytest.skip(f"no units without a compiler: {error}", allow_module_level=True)

KNOWN = mufly.load_vehicle("mufly-1.1")
VEHICLES = {
    "mufly-1.1": KNOWN,
    "of mass and radius": scale_vehicle_by_similarity(KNOWN, "my-helicopter", mass_kg=0.12, radius_m=0.09),
    "with maps, ground effect and phase": replace_parameters(KNOWN, {
        "rotors.coefficient_map": list_builtin_coefficient_maps()[0],
        "rotors.flight_map": list_builtin_flight_maps()[0],
        "rotors.ground_effect": 0.7, "swash_plate.phase": 0.3,
    }),
}  # fmt: skip
INPUTS = ("motor_input_upper", "motor_input_lower", "servo_input_1", "servo_input_2")
WIND = ("wind_north", "wind_east", "wind_down")


@pytest.fixture(scope="module")
def units(tmp_path_factory: pytest.TempPathFactory) -> dict[str, UnitLibrary]:
    made: dict[str, UnitLibrary] = {}

    class OnDemand(dict):
        def __missing__(self, name: str) -> UnitLibrary:
            folder = tmp_path_factory.mktemp("unit")
            export_fmu(VEHICLES[name], folder / "unit.fmu")
            self[name] = UnitLibrary(folder / "unit.fmu", folder / "extracted")
            return self[name]

    return OnDemand(made)


@pytest.fixture
def unit(units: dict[str, UnitLibrary]) -> UnitLibrary:
    return units["mufly-1.1"]


MOVING = {
    "start.position_north": 0.4, "start.position_down": -0.25, "start.velocity_north": 1.1, "start.velocity_east": -0.6,
    "start.velocity_down": 0.3, "start.roll": 0.2, "start.pitch": -0.15, "start.yaw": 2.0, "start.roll_rate": 0.7,
    "start.pitch_rate": -0.4, "start.yaw_rate": 1.2, "start.swash_roll": 0.03, "start.swash_pitch": -0.02,
    "start.bar_roll": 0.1, "start.bar_pitch": -0.05, "start.rotor_speed_upper": 350.0,
    "start.rotor_speed_lower": 420.0, "start.battery_charge": 0.73,
}  # fmt: skip


def moving_state() -> np.ndarray:
    s = {name.removeprefix("start."): value for name, value in MOVING.items()}
    x = initial_state(
        position=(s["position_north"], 0.0, s["position_down"]),
        velocity=(s["velocity_north"], s["velocity_east"], s["velocity_down"]),
        attitude=(s["roll"], s["pitch"], s["yaw"]), rates=(s["roll_rate"], s["pitch_rate"], s["yaw_rate"]),
        rotor_speed=(s["rotor_speed_upper"], s["rotor_speed_lower"]), bar_attitude=(s["bar_roll"], s["bar_pitch"]),
        charge=s["battery_charge"],
    )  # fmt: skip
    x[13:15] = s["swash_roll"], s["swash_pitch"]
    return x


@pytest.mark.parametrize("name", VEHICLES)
def test_flight_equals_that_of_the_model_to_the_last_bit(name: str, units: dict[str, UnitLibrary]) -> None:
    compared = compare_fmu_with_model(units[name], model_parameters(VEHICLES[name]))
    assert compared.different == 0
    assert compared.steps > 500
    assert 20 < compared.on_floor < compared.steps - 20, "the flight is in the air and on the floor"


def test_start_values_are_those_of_initial_state(unit: UnitLibrary) -> None:
    assert np.array_equal(UnitInstance(unit).initialise(MOVING).get_values()[:21], moving_state())


def test_the_comparison_sees_one_bit_of_the_mass(unit: UnitLibrary) -> None:
    p = model_parameters(KNOWN)
    p["mass"] = np.nextafter(p["mass"], 1.0)
    compared = compare_fmu_with_model(unit, p, duration_s=0.5)
    assert compared.different > 10
    assert 0.0 < compared.largest_difference < 1e-9


@pytest.mark.parametrize("name", list(VEHICLES)[::2])
def test_outputs_beside_the_state(name: str, units: dict[str, UnitLibrary]) -> None:
    vehicle = VEHICLES[name]
    instance, p = UnitInstance(units[name]).initialise(MOVING), model_parameters(vehicle)
    u, wind = np.array([0.7, 1.3, 0.2, -0.1]), np.array([0.5, -1.0, 0.3])
    assert instance.set_values_by_name(dict(zip((*INPUTS, *WIND), (*u, *wind), strict=True))) == 0
    out = dict(zip(units[name].outputs, instance.get_values(), strict=True))
    x, dx = moving_state(), np.empty(21)
    angles = [out["roll"], out["pitch"], out["yaw"]]
    assert angles == pytest.approx([MOVING["start.roll"], MOVING["start.pitch"], MOVING["start.yaw"]], abs=1e-15)
    assert (out["battery_voltage"], out["battery_current"]) == compute_battery_supply(x, 0.7, 1.0, p)
    free = rotor_loads(p, x[18], x[19], compute_axial_climb_velocity(x, wind))[:2]
    factors = [f[0] for f in edgewise_load_factors(x, wind, p)] if p["flight_map_node_count"] else [1.0, 1.0]
    down = body_to_ned_matrix(x[6:10])[2, 2]
    across = float(np.sum((x[3:5] - wind[:2]) ** 2))
    near = [
        ground_effect_thrust_increment(t, -x[2] - down * p[z], across, p)
        for t, z in zip(free, ("z_up", "z_dw"), strict=True)
    ]
    expected = np.array(free) * factors + near
    assert [out["thrust_upper"], out["thrust_lower"]] == pytest.approx(expected, rel=1e-14)
    state_derivative(x, u, wind, p, dx)
    force = body_to_ned_matrix(x[6:10]).T @ (dx[3:6] - [0.0, 0.0, mufly.dynamics.GRAVITY])
    assert [out[f"specific_force_{axis}"] for axis in "xyz"] == pytest.approx(force, abs=1e-13)


def test_start_is_hover(unit: UnitLibrary) -> None:
    instance = UnitInstance(unit).initialise()
    before = instance.get_values()
    assert instance.do_step(0.0, 0.5) == 0
    after = instance.get_values()
    assert after[:10] == pytest.approx(before[:10], abs=1e-3), "position, velocity and attitude"
    assert after[18:20] == pytest.approx(before[18:20], rel=1e-3), "rotor speeds: the battery drains"
    assert before[unit.outputs.index("thrust_upper")] > 0.3


def test_instances_are_apart_and_restart_equally(unit: UnitLibrary) -> None:
    first, second = UnitInstance(unit).initialise(), UnitInstance(unit).initialise(MOVING)
    rolled, alone = {"servo_input_2": 0.3}, UnitInstance(unit).initialise(MOVING)
    alone.do_step(0.0, 0.1)
    first.set_values_by_name(rolled)
    first.do_step(0.0, 0.1)
    second.do_step(0.0, 0.1)
    assert np.array_equal(second.get_values(), alone.get_values())
    flown = first.get_values()
    assert first.call_fmi_function("fmi3Reset") == 0
    first.initialise(rolled).do_step(0.0, 0.1)
    assert np.array_equal(first.get_values(), flown)


def test_states_are_kept_serialised_and_set_again(unit: UnitLibrary) -> None:
    one, other = UnitInstance(unit).initialise(MOVING), UnitInstance(unit).initialise()
    one.set_values_by_name({"body.mass": 0.11, "wind_east": 2.0})
    one.do_step(0.0, 0.05)
    kept, size, again = c.c_void_p(), c.c_size_t(), c.c_void_p()
    assert one.call_fmi_function("fmi3GetFMUState", c.byref(kept)) == 0
    assert one.call_fmi_function("fmi3SerializedFMUStateSize", kept, c.byref(size)) == 0
    raw = (c.c_uint8 * size.value)()
    assert one.call_fmi_function("fmi3SerializeFMUState", kept, raw, size) == 0
    one.do_step(0.05, 0.2)
    after = one.get_values()
    assert one.call_fmi_function("fmi3SetFMUState", kept) == 0
    one.do_step(0.05, 0.2)
    assert np.array_equal(one.get_values(), after)
    assert other.call_fmi_function("fmi3DeserializeFMUState", raw, size, c.byref(again)) == 0
    assert other.call_fmi_function("fmi3SetFMUState", again) == 0
    other.do_step(0.05, 0.2)
    assert np.array_equal(other.get_values(), after), "the other instance has the mass and the wind, too"
    raw[3] ^= 1
    assert other.call_fmi_function("fmi3DeserializeFMUState", raw, size, c.byref(again)) == 3
    assert other.messages == ["fmi3DeserializeFMUState: the bytes are not a state of this unit"]
    for state in (kept, again):
        assert other.call_fmi_function("fmi3FreeFMUState", c.byref(state)) == 0
        assert state.value is None


def test_parameters_act_as_in_the_vehicle_file(unit: UnitLibrary) -> None:
    """All at once: parameters that share a factor must not undo each other; two that were zero are among them."""
    keys = [n for n in unit.starts if n.split(".")[0] in KNOWN.model_dump() and n != "swash_plate.phase"]
    changed = {key: unit.starts[key] * (1.0 + 0.02 * (-1) ** k) for k, key in enumerate(keys) if unit.starts[key]}
    changed |= {"rotors.ground_effect": 0.5, "motor.friction_torque": 1e-5, "swash_plate.phase": 0.1}
    assert len(changed) > 35
    instance, other = UnitInstance(unit).initialise(MOVING), replace_parameters(KNOWN, changed)
    assert instance.set_values_by_name(changed) == 0, instance.messages
    x, u = moving_state(), np.array([unit.starts[name] for name in INPUTS])
    instance.do_step(0.0, 0.3)
    integrate_state(x, u, np.zeros(3), model_parameters(other), 1e-3, 300)
    assert instance.get_values()[:21] == pytest.approx(x, rel=1e-9, abs=1e-9)
    # One by one, a parameter with a field of its own is equal to the last bit.
    one, x = UnitInstance(unit).initialise({**MOVING, "body.mass": 0.12}), moving_state()
    one.do_step(0.0, 0.3)
    p = model_parameters(replace_parameters(KNOWN, {"body.mass": 0.12}))
    integrate_state(x, u, np.zeros(3), p, 1e-3, 300)
    assert np.array_equal(one.get_values()[:21], x)


def test_calls_that_make_no_sense_are_errors_with_a_message(unit: UnitLibrary) -> None:
    instance = UnitInstance(unit)
    assert instance.do_step(0.0, 0.01) == 3
    assert instance.set_values_by_name({"wind_north": math.nan}) == 3
    assert instance.set_values_by_name({"body.mass": 0.0}) == 3
    assert "wind_north: nan is out of range" in instance.messages[1]
    assert "body.mass: 0 is out of range" in instance.messages[2]
    instance.initialise()
    assert instance.set_values_by_name({"start.roll": 0.1}) == 3
    assert instance.messages[-1] == "start.roll: cannot be set after initialisation"
    assert instance.set_values_by_name({"roll": 0.1}) == 3
    assert instance.do_step(0.0, 0.0) == 3
    assert instance.set_values_by_name({"swash_plate.time_constant": 1e-5, "servo_input_1": 0.1}) == 0
    assert instance.do_step(0.0, 0.5) == 3
    assert "the state is not finite at t = 0.5 s: give a smaller solver.step" in instance.messages[-1]
    count = c.c_size_t(1)
    assert instance.call_fmi_function("fmi3GetInt32", (c.c_uint32 * 1)(1), count, (c.c_int32 * 1)(), count) == 3
    assert "fmi3GetInt32: not supported by this unit" in instance.messages[-1]
    strange = UnitInstance(unit, token="{another}")
    assert strange.handle.value is None
    assert "instantiation token" in strange.messages[0]


def test_the_archive_has_all_that_a_user_needs(unit: UnitLibrary, tmp_path: Path) -> None:
    root = Path(__file__).parents[2]
    assert (SOURCE_FOLDER / "license.txt").read_text() == (root / "LICENSE").read_text(), "one licence"
    assert mufly.load_vehicle(unit.folder / "resources/vehicle.toml") == KNOWN
    page = (unit.folder / "documentation/index.html").read_text()
    assert all(f">{name}</" in page for name in (*unit.starts, *unit.outputs, "rotors.radius"))
    assert "-ffp-contract=off" in (unit.folder / "sources/buildDescription.xml").read_text()
    made = export_fmu(KNOWN, tmp_path / "again.fmu", binary=False)
    assert made.platform == ""
    with zipfile.ZipFile(tmp_path / "again.fmu") as archive:
        assert archive.read("modelDescription.xml") == (unit.folder / "modelDescription.xml").read_bytes()
        assert not [n for n in archive.namelist() if n.startswith("binaries")]


def test_units_have_the_dimension_of_their_name() -> None:
    assert unit_exponents("N m/A") == {"kg": 1, "m": 2, "s": -2, "A": -1}
    assert unit_exponents("N s/m") == {"kg": 1, "s": -1}
    assert unit_exponents("1") == {}
    with pytest.raises(MuflyError, match="furlong"):
        unit_exponents("furlong")


def test_a_vehicle_that_cannot_hover_is_refused(tmp_path: Path) -> None:
    heavy: Vehicle = replace_parameters(KNOWN, {"body.mass": 0.5})
    with pytest.raises(InputError, match="too heavy to hover"):
        export_fmu(heavy, tmp_path / "heavy.fmu")


def test_fmpy_validates_and_simulates_it(unit: UnitLibrary) -> None:
    fmpy = pytest.importorskip("fmpy", reason="fmpy is not installed: pip install 'mufly[fmi]'")
    from fmpy.validation import validate_fmu

    archive = str(unit.folder.parent / "unit.fmu")
    assert validate_fmu(archive) == []
    lower = np.array([(0.0, 0.72), (0.5, 0.75)], dtype=[("time", float), ("motor_input_lower", float)])
    recorded = fmpy.simulate_fmu(
        archive, stop_time=1.0, output_interval=0.01, input=lower, output=["position_down", "yaw_rate"],
        start_values={"body.mass": 0.1},
    )  # fmt: skip
    instance = UnitInstance(unit).initialise({"body.mass": 0.1})
    for k in range(100):
        instance.set_values_by_name(
            {"motor_input_lower": float(np.interp(0.01 * k, lower["time"], lower["motor_input_lower"]))}
        )
        instance.do_step(0.01 * k, 0.01)
    assert recorded["position_down"][-1] == pytest.approx(instance.get_values(["position_down"])[0], abs=1e-12)


@pytest.fixture(scope="module")
def sensed(tmp_path_factory: pytest.TempPathFactory) -> UnitLibrary:
    folder = tmp_path_factory.mktemp("sensed")
    made = export_fmu(KNOWN, folder / "unit.fmu", seeds=2)
    assert made.seed_count == 2
    return UnitLibrary(folder / "unit.fmu", folder / "extracted")


def test_readings_and_estimate_equal_those_of_python_to_the_last_bit(sensed: UnitLibrary) -> None:
    for seed in (0, 1):
        compared = compare_sensed_fmu_with_model(sensed, KNOWN, seed=seed, duration_s=1.5)
        assert (compared.steps, compared.different) == (300, 0)
    heavier = replace_parameters(KNOWN, {"sensors.imu.accelerometer_bias": 0.3})
    assert compare_sensed_fmu_with_model(sensed, heavier, duration_s=0.05).different == 11, (
        "every reading has another bias"
    )


def test_deviations_of_angles_are_those_of_roll_pitch_and_yaw() -> None:
    """The filter's sigma is about N, E, D: at a heading of 90 degrees that about north is the one of pitch."""
    zero = np.zeros(3)
    covariance = np.diag([*[1.0] * 6, 0.01, 0.04, 0.09, *[1.0] * 3])
    more = AuxiliaryStates(zero, zero, 0.0, np.zeros(4), np.zeros(2), 1.0, np.full(len(ERROR_STATES), 7.0))
    estimate = Estimate(0.0, zero, zero, zero, zero, np.ones(8), 7.4, covariance, True, more)
    truth = SimpleNamespace(state=np.zeros(STATE_SIZE))
    values = _sensed_values([f"state_{k}" for k in range(STATE_SIZE)], truth, Readings(0.0, {}), estimate)
    assert [values[f"estimate.sigma.{a}"] for a in ("roll", "pitch", "yaw")] == pytest.approx([0.1, 0.2, 0.3])


def test_sensors_keep_their_period_in_any_communication_step(sensed: UnitLibrary) -> None:
    hover = {"motor_input_upper": 0.7, "motor_input_lower": 0.75}
    one, two, three = (UnitInstance(sensed).initialise({"sensors.seed": 1.0, **hover}) for _ in range(3))
    for k in range(40):
        assert one.do_step(0.01 * k, 0.01) == 0
        assert two.do_step(0.01 * k, 0.005) == two.do_step(0.01 * k + 0.005, 0.005) == 0
    assert np.array_equal(one.get_values(), two.get_values(), equal_nan=True)
    steps = [0.0007] * 500 + [0.05]
    for k, step in enumerate(steps):
        assert three.do_step(sum(steps[:k]), step) == 0
    readings = [name for name in sensed.outputs if name.startswith("sensor.")]
    assert three.get_values(readings) == pytest.approx(one.get_values(readings), rel=1e-6, abs=1e-6, nan_ok=True)


def test_a_unit_with_sensors_keeps_its_state_and_its_seed(sensed: UnitLibrary) -> None:
    one, other = UnitInstance(sensed), UnitInstance(sensed).initialise()
    assert one.set_values_by_name({"sensors.seed": 0.5}) == one.set_values_by_name({"sensors.seed": 2.0}) == 3
    assert "sensors.seed: 0.5 is no whole number" in one.messages[0]
    one.initialise({"sensors.seed": 1.0, "start.roll": 0.01})
    assert one.get_values(["roll", "pitch"])[0] == pytest.approx(0.01)
    assert one.get_values(["pitch"])[0] != other.get_values(["pitch"])[0], "legs of another length"
    one.do_step(0.0, 0.3)
    kept = c.c_void_p()
    assert one.call_fmi_function("fmi3GetFMUState", c.byref(kept)) == 0
    one.do_step(0.3, 0.2)
    assert other.call_fmi_function("fmi3SetFMUState", kept) == 0
    other.do_step(0.3, 0.2)
    assert np.array_equal(one.get_values(), other.get_values(), equal_nan=True)
    assert one.call_fmi_function("fmi3Reset") == other.call_fmi_function("fmi3FreeFMUState", c.byref(kept)) == 0
    again, fresh = one.initialise().get_values(), UnitInstance(sensed).initialise().get_values()
    assert np.array_equal(again, fresh, equal_nan=True)


def test_fmpy_validates_a_unit_with_sensors(sensed: UnitLibrary) -> None:
    fmpy = pytest.importorskip("fmpy", reason="fmpy is not installed: pip install 'mufly[fmi]'")
    from fmpy.validation import validate_fmu

    archive = str(sensed.folder.parent / "unit.fmu")
    assert validate_fmu(archive) == []
    values = {"sensors.seed": 1.0, "motor_input_upper": 0.5, "motor_input_lower": 0.5}
    outputs = ["sensor.acceleration_z", "estimate.position_down"]
    flown = fmpy.simulate_fmu(archive, stop_time=0.5, output_interval=0.01, start_values=values, output=outputs)
    instance = UnitInstance(sensed).initialise(values)
    for k in range(50):
        instance.do_step(0.01 * k, 0.01)
    assert [flown[name][-1] for name in outputs] == pytest.approx(instance.get_values(outputs), abs=1e-12)


def test_a_vehicle_without_sensors_has_no_unit_with_them(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="sensors: there is no such table"):
        export_fmu(KNOWN.model_copy(update={"sensors": None}), tmp_path / "unit.fmu", seeds=1)


def test_types_and_functions_are_those_of_the_standard_headers(unit: UnitLibrary, tmp_path: Path) -> None:
    fmpy = pytest.importorskip(
        "fmpy", reason="fmpy, which brings the headers, is not installed: pip install 'mufly[fmi]'"
    )
    for source in (unit.folder / "sources").iterdir():
        (tmp_path / source.name).write_bytes(source.read_bytes())
    own, headers = tmp_path / "fmi3.h", Path(fmpy.__file__).parent / "c-code"
    # C11 allows a typedef twice if the type is the same; enumerations are not compared.
    without_enums = re.sub(r"typedef enum \{.*?\} \w+;", "", own.read_text(), flags=re.S)
    own.write_text(without_enums.replace("#define FMI3_H\n", f'#define FMI3_H\n#include "{headers}/fmi3Functions.h"\n'))
    compile_library([tmp_path / "cosimulation_unit.c"], tmp_path / "unit.so")


def test_command_writes_and_checks_a_unit(tmp_path: Path) -> None:
    made = CliRunner().invoke(app, ["vehicle", "export", "mufly-1.1", "--out", str(tmp_path / "m.fmu"), "--check"])
    assert made.exit_code == 0, made.output
    assert "model differ after 0 of" in made.output
    assert "rotors.radius" in made.output
    assert zipfile.is_zipfile(tmp_path / "m.fmu")
    for arguments, message in (
        (["--out", "m.zip"], "does not end in .fmu"),
        (["--out", "m.fmu", "--sources-only", "--check"], "needs the compiled library"),
        (["--out", str(tmp_path / "none" / "m.fmu")], "its folder does not exist"),
    ):
        refused = CliRunner().invoke(app, ["vehicle", "export", "mufly-1.1", *arguments])
        assert isinstance(refused.exception, InputError)
        assert message in str(refused.exception)
