"""The catalogue of faults: how each is written, what it does, and that it does nothing else."""

import math

import numpy as np
import pytest

from mufly.errors import InputError
from mufly.sensors import FAULT_KINDS, FAULT_TARGETS, make_fitted_sensors, parse_fault
from mufly.world import World

EVERY = [
    *(f"gyro.{kind}" for kind in FAULT_KINDS),
    *(f"{name}.jump" for name in FAULT_TARGETS),
    "accelerometer.clip",
    "sonar.late",
]


def flown(vehicle, at, fault, seconds=2.0, **more):
    sensors = make_fitted_sensors(vehicle, World(), seed=1, faults=[parse_fault(fault)] if fault else [])
    return [sensors.read(at(k / 200, rotor_speed=(376.0, 443.0), **more)) for k in range(round(200 * seconds))]


def test_faults_are_written_in_words() -> None:
    f = parse_fault("sonar.jump=0.3@15s+2s")
    assert (f.name, f.kind, f.amount, f.start_s, f.stop_s) == ("sonar", "jump", 0.3, 15.0, 17.0)
    f = parse_fault("accelerometer.clip@20s")
    assert (f.start_s, f.stop_s, f.amount) == (
        20.0,
        math.inf,
        FAULT_TARGETS["accelerometer"].default_amounts["clip"],
    )
    assert str(parse_fault("gyro.freeze")) == "gyro.freeze@0s"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("sonar", "write NAME.KIND"), ("radar.jump@1s", "is not a sensor; use one of: accelerometer"),
        ("sonar.explode@1s", "is not a fault; use one of: freeze"), ("sonar.jump@5s+0s", "is not a time"),
        ("sonar.jump=1e@3s", "unit 'e' in '1e' is unknown"), ("sonar.jump@1e999s", "is not finite"),
    ],
)  # fmt: skip
def test_what_is_no_fault_is_said_in_one_line(text, why) -> None:
    with pytest.raises(InputError, match=why) as said:
        parse_fault(text)
    assert "\n" not in str(said.value)


def test_every_fault_leaves_the_other_readings_as_they_were(vehicle, at) -> None:
    healthy = flown(vehicle, at, "", 0.6)[-1]
    on_board = [text for text in EVERY if getattr(vehicle.sensors, FAULT_TARGETS[text.split(".")[0]].sensor)]
    assert len(on_board) >= len(FAULT_KINDS) + 11  # a sensor of the table may be absent from this vehicle
    for text in on_board:
        wrong = flown(vehicle, at, f"{text}@0.2s", 0.6)[-1]
        name = FAULT_TARGETS[text.split(".")[0]].reading
        assert set(wrong.latest) - {name} == set(healthy.latest) - {name}
        for other, r in wrong.latest.items():
            if other != name and not (other == "clipping" and "clip" in text):
                np.testing.assert_array_equal(r.value, healthy[other].value, err_msg=f"{text}: {other}")


def test_before_and_after_it_is_healthy(vehicle, at) -> None:
    plain, wrong = (flown(vehicle, at, text) for text in ("", "gyro.jump=0.5@0.5s+0.5s"))
    off = np.array([w["rates"].value - p["rates"].value for w, p in zip(wrong, plain, strict=True)])
    assert not off[:100].any()
    np.testing.assert_allclose(off[100:200], 0.5)
    assert not off[200:].any()


def test_what_each_kind_does(vehicle, at) -> None:
    plain = flown(vehicle, at, "")

    def gyro(kind: str) -> np.ndarray:
        said = flown(vehicle, at, f"gyro.{kind}@1s")
        return np.array([r["rates"].value for r in said])

    healthy = np.array([r["rates"].value for r in plain])
    assert (gyro("freeze")[200:] == healthy[199]).all()
    np.testing.assert_allclose(gyro("drift=0.1")[-1] - healthy[-1], 0.1 * 0.995, atol=1e-9)
    np.testing.assert_allclose(gyro("bias=0.1")[300] - healthy[300], 0.05, atol=1e-9)
    assert (gyro("stuck=0.25")[200:] == 0.25).all()
    assert np.abs(gyro("clip=0.001")[200:]).max() <= 0.001
    off = np.abs(gyro("outliers=1") - healthy)[200:].max(axis=1) > 0
    assert 0.1 < off.mean() < 0.4
    assert not np.isfinite(gyro("insane")[200:]).all() or (np.abs(gyro("insane")[200:]) > 1e20).any()


def test_a_dropout_grows_old_and_late_ones_come_late(vehicle, at) -> None:
    gone = flown(vehicle, at, "sonar.dropout@1s")
    assert gone[-1]["ground_distance"].time_s < 1.0
    late = flown(vehicle, at, "position.late=0.5@0.5s", 3.0)
    fix = late[-1]["position_fix"]
    healthy = flown(vehicle, at, "", 3.0)[-1]["position_fix"]
    assert 0.4 < healthy.time_s - fix.time_s < 0.6
    assert "position_fix" not in flown(vehicle, at, "position.dropout@0s", 1.0)[-1]
    doubled = flown(vehicle, at, "sonar.doubled@1s")
    times = [r["ground_distance"].time_s for r in doubled[300:]]
    assert len(set(times)) > 1.5 * 0.5 / 0.05  # new times without new echoes


def test_an_accelerometer_clips_at_its_element(vehicle, at) -> None:
    """Bounded before the filter: its mean is no bound of what comes out."""
    wrong = flown(vehicle, at, "accelerometer.clip=5@0.5s", 1.5)
    assert wrong[-1]["clipping"].value[2] > 0.5  # it carries 9.8 m/s^2
    assert -6.0 < wrong[-1]["acceleration"].value[2] < -3.0
    assert wrong[90]["clipping"].value[2] == 0.0


def test_a_fault_of_a_sensor_that_is_not_on_board_is_refused(vehicle) -> None:
    blind = vehicle.model_copy(update={"sensors": vehicle.sensors.model_copy(update={"sonar": None})})
    with pytest.raises(InputError, match=r"has no sensors\.sonar; name another"):
        make_fitted_sensors(blind, World(), faults=[parse_fault("sonar.jump@1s")])
