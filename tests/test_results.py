"""Results say what their fields are, in every form."""

import json
import math
from dataclasses import FrozenInstanceError

import numpy as np
import pytest

from mufly.results import csv_text, meaning_of, meanings, plain, result, rows


@result(eq=False)
class Point:
    """A made-up point.

    Attributes
    ----------
    thrust_N, torque_Nm : float
        Of the rotor. More words.
    density : float
        Of the air (kg/m3).
    gain : float
        How much of it; see :func:`abc`.
    loads_N : (n,) array
    part : Part or None
    """

    thrust_N: float
    torque_Nm: float
    density: float
    gain: float
    loads_N: np.ndarray
    part: object = None

    @property
    def thrust_per_power_N_W(self) -> float:
        """Thrust over power."""
        return 0.1


POINT = Point(0.25, math.nan, 1.2, 3.0, np.arange(9.0))


def test_units_come_from_names_and_from_the_docstring() -> None:
    found = meanings(Point)
    assert [found[k].unit for k in ("thrust_N", "torque_Nm", "density", "gain")] == ["N", "N m", "kg/m3", ""]
    assert found["thrust_N"].label == "thrust"
    assert found["torque_Nm"].meaning == "Of the rotor. More words."
    assert found["thrust_per_power_N_W"] == (
        "thrust_per_power_N_W",
        "thrust per power",
        "N/W",
        "Thrust over power.",
    )
    assert meaning_of(Point(1, 1, 1, 1, np.ones(1), POINT), "part.thrust_N").unit == "N"


def test_a_result_prints_itself_with_units_and_meaning() -> None:
    lines = str(POINT).splitlines()
    assert lines[0] == "Point: A made-up point."
    assert lines[1].split() == ["thrust", "0.25", "N", "Of", "the", "rotor."]
    assert lines[2].split()[1] == "-"
    assert "9 values, 0 to 8 N" in " ".join(lines[5].split())
    assert "How much of it" in lines[4]
    assert "abc" not in lines[4]
    assert POINT._repr_html_().count("<tr>") == 6
    assert [r.unit for r in rows(POINT, ["density"])] == ["kg/m3"]


def test_json_and_csv() -> None:
    assert json.loads(json.dumps(plain(POINT)))["torque_Nm"] is None
    assert plain({"a": [np.float64(1.5), 1 + 2j, POINT]})["a"][1] == {"real": 1.0, "imag": 2.0}
    assert csv_text([POINT, POINT], ["thrust_N", "gain"]) == "thrust_N,gain\n0.25,3.0\n0.25,3.0\n"


def test_results_are_frozen() -> None:
    with pytest.raises(FrozenInstanceError):
        POINT.gain = 1.0  # type: ignore[misc]


def test_a_result_of_the_package_prints_with_units() -> None:
    from mufly.dynamics import hover_performance, trim
    from mufly.vehicle import load_vehicle

    vehicle = load_vehicle("mufly-1.1")
    lines = str(hover_performance(vehicle)).splitlines()
    assert lines[0].startswith("HoverPerformance: ")
    assert any(line.split()[:1] == ["thrust"] and " N " in f"{line} " for line in lines)
    assert str(trim(vehicle)).startswith("steady at")  # its own words
