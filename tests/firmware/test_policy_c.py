"""A learned policy: its file, its C code equal bit for bit, and what is refused."""

from __future__ import annotations

import dataclasses
import itertools
import json
import shutil
from pathlib import Path

import cffi
import numpy as np
import pytest

from mufly.compiled.toolchain import COMPILER_FLAGS, compile_library
from mufly.control import design_flight_controller
from mufly.errors import InputError
from mufly.estimate import Estimate
from mufly.firmware import export_policy
from mufly.flight.policy import (
    LearnedPolicy,
    PolicyControllers,
    PolicyLayer,
    load_policy,
    save_policy,
)
from mufly.flight.policy.observation import OBS_HEIGHT, map_action_to_inputs, observation_limits, observation_units
from mufly.flight.policy.policy_controllers import find_action_for_inputs, step_policy
from mufly.flight.policy.policy_network import evaluate_policy
from mufly.vehicle import load_vehicle

needs_cc = pytest.mark.skipif(not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="there is no C compiler")

_DECLARATIONS = """
typedef struct { real_t position[3], velocity[3], attitude[3], rates[3], voltage; } motion_estimate_t;
typedef struct { real_t position[3], velocity[3], acceleration[3]; } path_t;
typedef struct { real_t motor_input[2], servo_input[2]; } actuators_t;
void policy_evaluate(const real_t *observation, real_t *action);
void policy_step(const motion_estimate_t *now, const path_t *reference, real_t heading, real_t *action,
                 actuators_t *out);
"""


def make_policy(task: str = "hover", activation: str = "tanh", seed: int = 0) -> LearnedPolicy:
    """A small network with random numbers and a random normalisation."""
    rng, n = np.random.default_rng(seed), len(observation_units(task))
    widths = (n, 9, 7, 4)
    last = 0.6 if activation == "tanh" else 0.02  # actions inside their limits
    layers = tuple(
        PolicyLayer(
            rng.normal(0.0, 0.6 if b != 4 else last, (b, a)),
            rng.normal(0.0, 0.3, b),
            activation if b != 4 else "linear",
        )
        for a, b in itertools.pairwise(widths)
    )
    return LearnedPolicy(
        task, "mufly-1.1", 0.02, np.array([0.68, 0.75, 0.01, -0.02]), 7.2, rng.normal(0.0, 0.2, n),
        rng.uniform(0.2, 2.0, n), 10.0, layers, {"seed": seed},
    )  # fmt: skip


def compile_policy(policy: LearnedPolicy, folder: Path, *flags: str) -> tuple[cffi.FFI, object]:
    export_policy(policy, folder)
    library = folder / f"policy{''.join(flags)}.so"
    strict = ("-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-pedantic", "-Werror")
    compile_library(sorted(folder.rglob("*.c")), library, flags=(*COMPILER_FLAGS, *strict, *flags, f"-I{folder}"))
    ffi = cffi.FFI()
    ffi.cdef(f"typedef {'float' if flags else 'double'} real_t;{_DECLARATIONS}")
    return ffi, ffi.dlopen(str(library))


def draw_observations(policy: LearnedPolicy, count: int) -> np.ndarray:
    """Observations in and beyond the limits, with zeros, infinities and NaN among them."""
    rng, high = np.random.default_rng(1), observation_limits(policy.task)[1]
    seen = rng.normal(0.0, 0.3, (count, high.size)) * high * rng.choice([0.01, 0.3, 4.0], (count, 1))
    for k, odd in enumerate((np.nan, np.inf, -np.inf, -0.0, 1e-310)):
        seen[k, rng.integers(high.size)] = odd
    return seen


@needs_cc
@pytest.mark.parametrize(("task", "activation"), [("hover", "tanh"), ("waypoint", "relu"), ("land", "linear")])
def test_network_in_c_is_that_in_python_to_the_last_bit(task: str, activation: str, tmp_path: Path) -> None:
    policy = make_policy(task, activation)
    ffi, lib = compile_policy(policy, tmp_path / "c")
    given, got, interpreted = ffi.new("double[4]"), [], np.empty(4)
    seen = draw_observations(policy, 300)
    for row in seen:
        lib.policy_evaluate(row.tolist(), given)
        got.append(list(given))
    assert np.array(got).tobytes() == policy.find_action(seen).tobytes()
    assert len(np.unique(got, axis=0)) > 250
    for row, action in zip(seen[:20], got, strict=False):
        evaluate_policy.py_func(policy.packed_arrays, row, interpreted)
        assert interpreted.tolist() == action


@needs_cc
def test_policy_step_in_c_is_that_in_python_to_the_last_bit(tmp_path: Path) -> None:
    policy, rng = make_policy(seed=3), np.random.default_rng(2)
    ffi, lib = compile_policy(policy, tmp_path / "c")
    now, path, out = ffi.new("motion_estimate_t *"), ffi.new("path_t *"), ffi.new("actuators_t *")
    in_c, action, inputs = ffi.new("double[4]"), np.zeros(4), np.zeros(4)
    for _ in range(100):
        position, velocity, attitude, rates = rng.normal(0.0, 1.0, (4, 3))
        voltage, reference = float(rng.uniform(5.0, 9.0)), rng.normal(0.0, 1.0, 7)
        now.position, now.velocity, now.attitude = position.tolist(), velocity.tolist(), attitude.tolist()
        now.rates, now.voltage = rates.tolist(), voltage
        path.position, path.velocity = reference[:3].tolist(), reference[3:6].tolist()
        lib.policy_step(now, path, reference[6], in_c, out)
        step_policy.py_func(
            policy.packed_arrays, policy.trim_inputs, policy.nominal_voltage_V, position, velocity, attitude, rates,
            voltage, reference, action, inputs,
        )  # fmt: skip
        assert list(in_c) == action.tolist()
        assert [*out.motor_input, *out.servo_input] == inputs.tolist()


@needs_cc
def test_single_precision_differs_by_rounding_only(tmp_path: Path) -> None:
    policy = make_policy()
    ffi, lib = compile_policy(policy, tmp_path / "c", "-DMUFLY_FLOAT")
    given, seen = ffi.new("float[4]"), draw_observations(policy, 100)[5:]
    for row, action in zip(seen, policy.find_action(seen), strict=True):
        lib.policy_evaluate(row.tolist(), given)
        assert list(given) == pytest.approx(action, abs=2e-5)


def test_network_is_the_closed_form_of_its_equations() -> None:
    policy = make_policy()
    seen = np.random.default_rng(4).normal(0.0, 0.3, (20, 20))
    y = np.clip((seen - policy.observation_mean) / policy.observation_scale, -10.0, 10.0)
    for layer in policy.layers:
        y = y @ layer.weights.T + layer.bias
        y = np.tanh(y) if layer.activation == "tanh" else y
    assert policy.find_action(seen) == pytest.approx(np.clip(y, -1.0, 1.0), abs=1e-14)


def test_file_gives_the_policy_back_to_the_last_bit(tmp_path: Path) -> None:
    policy, path = make_policy(), tmp_path / "policy.json"
    save_policy(policy, path)
    again = load_policy(path)
    for a, b in zip(policy.packed_arrays, again.packed_arrays, strict=True):
        assert np.asarray(a).tobytes() == np.asarray(b).tobytes()
    assert again.trim_inputs.tolist() == policy.trim_inputs.tolist()
    assert (again.task, again.vehicle_name, again.period_s) == ("hover", "mufly-1.1", 0.02)
    assert again.training == {"seed": 0}


def test_policy_of_the_documents_turns_towards_its_target() -> None:
    policy = load_policy(Path(__file__).parents[2] / "docs" / "examples" / "hover-policy.json")
    seen = np.zeros(20)
    seen[[8, 13, 19]] = 1.0  # level, at the wanted heading, 1 m high
    for place, output, sign in ((0, 2, 1), (1, 3, 1), (2, 0, -1), (12, 1, 1)):
        one = np.array([seen, seen])
        one[:, place] = 0.3, -0.3
        actions = policy.find_action(one)[:, output]
        assert sign * (actions[0] - actions[1]) > 0.1


@pytest.mark.parametrize(("change", "message"), [
    (lambda c: c["layers"][0]["bias"].__setitem__(0, 0.5), "sha256: is not the checksum of the content"),
    (lambda c: c["observation"].pop(), "observation: has 19 inputs, but the task hover has 20"),
    (lambda c: c["observation"][2].update(name="depth"), r"observation: has the input depth \(m\)"),
    (lambda c: c["observation"][2].update(scale=0.0), r"observation\[3\].scale: 0.0 is out of range"),
    (lambda c: c["layers"][1]["weights"].pop(), r"layers\[2\]: weights or bias do not fit 9 inputs and 7 "
    r"outputs"),
    (lambda c: c.update(version=2), "version"),
    (lambda c: c.pop("trim"), "trim: is missing"),
    (lambda c: c["action"].reverse(), "action: has unknown or reordered outputs"),
])  # fmt: skip
def test_damaged_and_unfit_files_are_refused_in_one_line(change: object, message: str, tmp_path: Path) -> None:
    path = tmp_path / "policy.json"
    save_policy(make_policy(), path)
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=message) as caught:
        load_policy(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_files_that_are_no_policy_are_refused(tmp_path: Path) -> None:
    for text in ("", "[1, 2]", "weights"):
        (tmp_path / "x.json").write_text(text)
        with pytest.raises(InputError, match=r"x\.json: is not"):
            load_policy(tmp_path / "x.json")
    with pytest.raises(InputError, match="cannot be read"):
        load_policy(tmp_path / "none.json")
    (tmp_path / "held").mkdir()
    (tmp_path / "held" / "thesis.txt").write_text("x")
    with pytest.raises(InputError, match="contains files of another origin"):
        export_policy(make_policy(), tmp_path / "held")


@pytest.fixture(scope="module")
def design():
    return design_flight_controller(load_vehicle("mufly-1.1"))


def test_policies_of_another_vehicle_task_or_period_do_not_fly(design) -> None:
    right = make_policy()
    PolicyControllers(design, right)
    for change, message in (
        ({"vehicle_name": "mufly-2.0"}, "trained for mufly-2.0, not for mufly-1.1"),
        ({"period_s": 0.01}, r"0.01 s, but the mission logic has 0.02 s; train with period_s=0.02"),
    ):
        with pytest.raises(InputError, match=message):
            PolicyControllers(design, dataclasses.replace(right, **change))
    with pytest.raises(InputError, match="'land' cannot follow a mission"):
        PolicyControllers(design, make_policy("land"))


def test_policy_acts_every_fourth_period_and_hands_over_to_a_pilot(design) -> None:
    """The policy holds its inputs between two actions; sticks (a tilt of their own) bring the control law back."""
    controllers, zero = PolicyControllers(design, make_policy()), np.zeros(3)
    now = Estimate(0.0, np.array([0.0, 0.0, -1.0]), zero, zero, zero, np.zeros(8), 7.4)
    heave_yaw = np.array([-1.0, 0.0, 0.0, 0.0])
    controllers.engage_heave_yaw(now, np.array([0.6, 0.7]))
    controllers.engage_roll_pitch(now)
    given = []
    for k in range(8):
        if k % 4 == 0:
            tilt = controllers.compute_tilt_command(now, np.array([0.3, 0.0, -1.0]), zero, zero)
        given.append(controllers.step(now, heave_yaw, tilt).input_array.tolist())
    assert given[0] == given[3] != given[4] == given[7]
    pilot = controllers.step(now, heave_yaw, np.zeros(2))
    assert pilot.motor_input == pytest.approx(given[7][:2], abs=0.02)  # bumpless
    assert pilot.servo_input == pytest.approx(np.zeros(2), abs=0.02)


def test_action_before_is_that_of_the_inputs_before() -> None:
    trim, action, inputs = np.array([0.6, 0.7, 0.0, 0.0]), np.array([0.5, -0.3, 0.2, -0.9]), np.empty(4)
    map_action_to_inputs.py_func(action, trim, inputs)
    assert find_action_for_inputs(inputs, trim) == pytest.approx(action, abs=1e-15)
    assert find_action_for_inputs(np.zeros(4), trim)[0] == -1.0


def test_height_and_relative_velocity_are_observed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Following a reference at its velocity looks like hover: the network gets the same numbers, but for the height."""
    import mufly.flight.policy.policy_controllers as module

    seen: list[np.ndarray] = []
    monkeypatch.setattr(module, "evaluate_policy", lambda p, x, a: seen.append(x.copy()))
    zero, policy = np.zeros(3), make_policy()

    def look(position: list[float], velocity: list[float], reference: list[float]) -> np.ndarray:
        step_policy.py_func(
            policy.packed_arrays, policy.trim_inputs, 7.2, np.array(position), np.array(velocity), zero, zero, 7.2,
            np.array(reference), np.zeros(4), np.zeros(4),
        )  # fmt: skip
        return seen[-1]

    still = look([0.0, 0.0, -1.0], [0.0, 0.0, 0.0], [0.1, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0])
    moving = look([3.0, 2.0, -0.5], [0.4, -0.2, 0.1], [3.1, 2.0, -0.5, 0.4, -0.2, 0.1, 0.0])
    assert moving[:OBS_HEIGHT] == pytest.approx(still[:OBS_HEIGHT], abs=1e-15)
    assert (still[OBS_HEIGHT], moving[OBS_HEIGHT]) == (1.0, 0.5)
