"""pymavlink, every parameter and missions of many sizes: what docs/examples/fly_with_pymavlink.py does, and all of it.

python tests/interop/fly_pymavlink.py udpin:127.0.0.1:14550
"""

from __future__ import annotations

import importlib.util
import math
import sys
from pathlib import Path
from types import ModuleType

SCRIPT = Path(__file__).resolve().parents[2] / "docs" / "examples" / "fly_with_pymavlink.py"


def example() -> ModuleType:
    """The script of the docs, as a module."""
    spec = importlib.util.spec_from_file_location("fly_with_pymavlink", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def close(a: float, b: float) -> bool:
    return math.isclose(a, b, rel_tol=1e-5, abs_tol=1e-6)


def main(url: str) -> None:
    fly = example()
    vehicle = fly.Vehicle(url)
    mavlink = fly.mavlink

    before = vehicle.parameters()
    changed, kept = 0, []
    for name, (value, kind) in before.items():
        # Another value that is valid: a little more or less, whichever the vehicle takes; then back.
        for other in (value * 0.98, value * 1.02, value + 1.0, value - 1.0, 1.0 - value):
            if kind != mavlink.MAV_PARAM_TYPE_REAL32:
                other = float(round(other))
            if close(other, value):
                continue
            now = vehicle.set_parameter(name, other, kind)
            if close(now, other):
                changed += 1
                break
            assert close(now, value), f"{name}: asked for {other}, was {value}, now {now}"
        else:
            kept.append(name)
        assert close(vehicle.set_parameter(name, value, kind), value), name
    after = vehicle.parameters()
    assert after.keys() == before.keys()
    assert all(close(after[n][0], before[n][0]) for n in before)
    print(f"{len(before)} parameters, {changed} changed and set back, kept by the vehicle: {kept}", flush=True)
    for name in list(before)[:5]:
        told = vehicle.fetch(
            lambda n=name: vehicle.link.mav.param_request_read_send(1, 1, n.encode(), -1),
            "PARAM_VALUE",
            lambda m, n=name: m.param_id == n,
        )
        assert close(told.param_value, before[name][0])
    print("parameters read one by one", flush=True)

    for count in (1, 2, 25, 90):
        places = [(0.01 * k, 0.5, -1.0 - 0.001 * k) for k in range(count)]
        result = vehicle.upload(places)
        assert result == mavlink.MAV_MISSION_ACCEPTED, f"{result}: {vehicle.wait('STATUSTEXT').text}"
        back = vehicle.download()
        assert len(back) == count
        assert all(math.dist(a, b) < 1e-4 for a, b in zip(places, back, strict=True))
        assert vehicle.clear() == mavlink.MAV_MISSION_ACCEPTED
        assert vehicle.download() == []
        print(f"mission of {count}: up, down, cleared", flush=True)
    result = vehicle.upload([(0.0, 0.0, 5.0)])  # five metres under the floor
    assert result != mavlink.MAV_MISSION_ACCEPTED
    assert vehicle.download() == []
    print(f"mission under the floor refused with {mavlink.enums['MAV_MISSION_RESULT'][result].name}", flush=True)
    print("end of the list", flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
