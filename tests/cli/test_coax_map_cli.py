"""``mufly coax map``: the file it writes, its picture, and what it says when something is wrong; then flown."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from mufly.cli.coax import app
from mufly.dynamics import find_trim
from mufly.errors import InputError, MuflyError
from mufly.vehicle import format_vehicle_toml, load_coefficient_map, load_vehicle

runner = CliRunner()
SMALL = ("--rpm", "4000", "--ratio", "0.8:1.4:0.2", "--climb", "-1:2:1m/s")


def output(*arguments: str) -> str:
    result = runner.invoke(app, ["map", *arguments])
    assert result.exit_code == 0, result.exception
    return result.stdout


def fault(*arguments: str) -> str:
    result = runner.invoke(app, ["map", *arguments])
    assert isinstance(result.exception, MuflyError), result.exception
    assert "\n" not in str(result.exception)
    return str(result.exception)


def test_writes_a_map_that_a_vehicle_flies_with(tmp_path) -> None:
    file = tmp_path / "pair.toml"
    text = output("walkera-5g6", *SMALL, "--pitch", "13,14", "--out", str(file))
    assert "pair" in text
    assert sorted(f.name for f in tmp_path.iterdir()) == ["pair.png", "pair.toml"]
    made = load_coefficient_map(file)
    assert (made.upper_pitch_deg, made.lower_pitch_deg, made.spacing_m) == (13, 14, 0.04)
    t = made.decode_map_tables()
    np.testing.assert_allclose(t.ratio, [0.8, 1.0, 1.2, 1.4])
    np.testing.assert_allclose(t.climb_ratio * 4000 * np.pi / 30 * 0.0875, [-1, 0, 1, 2], atol=1e-6)

    vehicle = format_vehicle_toml(load_vehicle("mufly-1.1")).replace(
        'map_level = "computed"', 'coefficient_map = "pair.toml"'
    )
    (tmp_path / "mine.toml").write_text(vehicle, encoding="utf-8")
    hover = find_trim(load_vehicle(tmp_path / "mine.toml"))
    assert hover.inside_map
    assert 0.9 < hover.rotor_speed[1] / hover.rotor_speed[0] < 1.1


def test_json_is_json_with_units_in_the_names() -> None:
    found = json.loads(output("walkera-5g6", *SMALL, "--json"))
    assert found["radius_m"] == pytest.approx(0.0875)
    assert np.shape(found["cT_upper"]) == (1, 4, 4)
    assert found["files"] == []


def test_hover_at_the_edge_is_said() -> None:
    assert "edge of the map" in " ".join(
        output("walkera-5g6", "--rpm", "4000", "--ratio", "1:1.2:0.2", "--climb", "0:1:1").split()
    )


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("walkera",), "no such rotor"),
        (("walkera-5g6", "--spacing", "40"), "--spacing: 40 m is out of range"),
        (("walkera-5g6", "--spacing", "0mm"), "out of range"),
        (("walkera-5g6", "--rpm", "fast"), "--rpm: 'fast' is not a number"),
        (("walkera-5g6", "--rpm", "0:4000"), "--rpm: 0 rpm is out of range"),
        (("walkera-5g6", "--ratio", "1.6:0.6"), "let it rise"),
        (("walkera-5g6", "--climb", "1:2"), "does not include 0"),
        (("walkera-5g6", "--method", "guess"), "use one of: bemt, wake"),
        (("walkera-5g6", "--method", "wake", "--wake", "frozen"), "'frozen' is unknown"),
        (("walkera-5g6", "--pitch", "1,2,3"), "neither one value nor two"),
        (("walkera-5g6", "--out", "pair.nc"), "end in .toml"),
        (("walkera-5g6", "naca0012-r60-c20"), "have the same radius"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(arguments, words) -> None:
    said = fault(*arguments)
    assert words in said
    assert InputError.__name__ not in said
