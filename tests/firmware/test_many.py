"""Many periods in one call: the same flight to the last bit, however it is computed."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from mufly.control import design_flight_controller
from mufly.firmware import FirmwareSoftware, GenericFirmwareSoftware
from mufly.firmware import host_build as built
from mufly.firmware.compiled_software import diff_fields
from mufly.flight import fly_mission
from mufly.flight.flight_software import FlightSoftware
from mufly.flight.simulated_flight import Flight
from mufly.mission import parse_mission
from mufly.sensors import parse_fault
from mufly.vehicle import load_vehicle, replace_parameters

needs_cc = pytest.mark.skipif(
    not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="there is no C compiler on this machine"
)
HOP = {
    "take_off": {"height_m": 0.5, "wait_s": 0.2},
    "waypoint": [{"position_m": [0.4, 0.1, -0.5], "wait_s": 0.2, "heading_deg": 30}],
    "cylinder": [{"centre_m": [1.4, 0.0], "radius_m": 0.1, "height_m": 2.0}],
}
FAULTS = (
    "gyro.bias=0.05@4s+0.5s",
    "position.dropout@5s+1s",
    "sonar.outliers@4.5s+0.4s",
    "ring.insane@6s+0.1s",
)


def _flown(software, **how):
    vehicle, events, heard = load_vehicle("mufly-1.1"), [], []
    # Another one than its controllers know.
    true = replace_parameters(vehicle, {"body.mass": float(vehicle.body.mass) * 1.03})
    data = fly_mission(
        true,
        parse_mission(HOP),
        controller=design_flight_controller(vehicle),
        designed_for=vehicle,
        controllers=software,
        on_event=events.append,
        on_tick=lambda truth, m: heard.append((truth, m)),
        tick_every=7,
        **how,
    )
    return data, events, heard


def _same(a, b) -> None:
    assert a[1] == b[1]
    assert a[0].attrs["outcome"] == b[0].attrs["outcome"]
    assert a[0].attrs["reason"] == b[0].attrs["reason"]
    for (truth, m), (same_truth, same_m) in zip(a[2], b[2], strict=True):
        assert diff_fields(truth, same_truth) == []
        assert diff_fields(m, same_m) == []
    for name in a[0].data_vars:
        x, y = a[0][name].values, b[0][name].values
        np.testing.assert_array_equal(x, y, err_msg=name)


@needs_cc
@pytest.mark.parametrize(
    "how",
    [
        {"wind": (0.4, -0.2, 0.0), "gust": 0.3, "seed": 2},
        {"wind": (4.0, 0.0, 0.0), "gust": 1.0, "seed": 1, "brief": True},  # which tips it over
        {"wind": (0.3, 0.0, 0.0), "gust": 0.2, "seed": 5, "sensors": "fitted", "brief": True},
    ],
    ids=["ideal, recorded in full", "a crash", "sensors and their faults"],
)
def test_a_flight_is_the_same_in_python_and_in_the_loop(how, monkeypatch: pytest.MonkeyPatch) -> None:
    if "sensors" in how:
        how = {**how, "faults": [parse_fault(text) for text in FAULTS]}
    reference = _flown(FlightSoftware, **how)
    assert len(reference[1]) > 2
    singly, tick = [], Flight.step_period
    monkeypatch.setattr(Flight, "step_period", lambda self: singly.append(self.time_s) or tick(self))
    looped = _flown(GenericFirmwareSoftware, **how)
    _same(reference, looped)
    if looped[0].attrs["outcome"] == "succeeded":
        # A loop that gave way to single periods would be the same flight, and slow.
        assert len(singly) < 0.15 * 200 * float(looped[0].time[-1])


def test_without_a_compiler_python_flies(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(built, "_load_generic_firmware", lambda: built.find_compiler())
    monkeypatch.setenv("CC", "")
    monkeypatch.setenv("PATH", "")
    vehicle = load_vehicle("mufly-1.1")
    made = GenericFirmwareSoftware(vehicle, design_flight_controller(vehicle), parse_mission(HOP))
    assert type(made) is FlightSoftware
    assert issubclass(GenericFirmwareSoftware, FirmwareSoftware)
