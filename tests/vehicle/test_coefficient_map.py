"""Maps in vehicle files: named, carried along, refused in one line."""

import tomllib

import numpy as np
import pytest
import tomli_w

from mufly.errors import InputError
from mufly.vehicle import (
    format_coefficient_map_toml,
    format_vehicle_toml,
    list_builtin_coefficient_maps,
    list_parameters,
    load_coefficient_map,
    load_vehicle,
    replace_parameters,
)

MAP = "walkera-5g6-bemt"


@pytest.fixture(scope="module")
def vehicle():
    return load_vehicle("mufly-1.1")


def written(vehicle, folder, **rotors):
    tables = tomllib.loads(format_vehicle_toml(vehicle))
    tables["rotors"].update(rotors)
    file = folder / "mine.toml"
    file.write_text(tomli_w.dumps(tables), encoding="utf-8")
    return file


def test_a_vehicle_file_names_a_map_beside_it_or_a_built_in_one(vehicle, tmp_path, monkeypatch) -> None:
    coefficients = load_coefficient_map(MAP)
    assert MAP in list_builtin_coefficient_maps()
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "pair.toml").write_text(format_coefficient_map_toml(coefficients), encoding="utf-8")
    monkeypatch.chdir("/")
    for name in ("maps/pair.toml", str(tmp_path / "maps" / "pair.toml"), MAP):
        assert load_vehicle(written(vehicle, tmp_path, coefficient_map=name)).rotors.coefficient_map == coefficients
    assert vehicle.rotors.coefficient_map is None


def test_a_vehicle_carries_its_map(vehicle, tmp_path) -> None:
    mapped = replace_parameters(vehicle, {"rotors.coefficient_map": MAP, "rotors.map_level": "constants"})
    text = format_vehicle_toml(mapped)
    alone = tmp_path / "alone.toml"
    alone.write_text(text, encoding="utf-8")
    assert load_vehicle(alone) == mapped
    assert max(len(line) for line in text.splitlines()) < 2000  # a table to be read, not one endless line
    assert list_parameters(mapped) == list_parameters(vehicle)
    assert replace_parameters(mapped, {"rotors.coefficient_map": None, "rotors.map_level": "computed"}) == vehicle
    assert replace_parameters(mapped, {"body.mass": 0.08}).rotors.coefficient_map == mapped.rotors.coefficient_map


def test_tables_cannot_be_written_to() -> None:
    with pytest.raises(ValueError, match="read-only"):
        load_coefficient_map(MAP).decode_map_tables().cT_upper[0, 0, 0] = 1.0


def without_row(text):
    lines = text.splitlines()
    return "\n".join(lines[:5] + lines[6:])


def squeezed(text):
    head, *lines = text.splitlines()
    rows = np.array([[float(v) for v in line.split()] for line in lines])
    rows[:, 1] = rows[:, 1] ** 2
    return "\n".join([head, *(" ".join(f"{v:.7g}" for v in row) for row in rows)])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (without_row, "do not fill a grid"),
        (squeezed, "evenly spaced"),
        (lambda t: t.replace("cT_upper", "CT"), "does not name the columns"),
        (lambda t: t + "1 2 3\n", "is not 8 finite numbers: 1 2 3"),
        (lambda t: t.replace(" 1\n", " x\n", 1), "line 2 is not 8"),
        (lambda t: t.replace(" 1\n", " nan\n", 1), "finite"),
        (lambda t: "", "does not name the columns"),
        (lambda t: t.splitlines()[0], "has no line of numbers"),
    ],
)
def test_a_damaged_map_is_refused(vehicle, tmp_path, change, words) -> None:
    good = load_coefficient_map(MAP)
    tables = {**good.model_dump(), "table": change(good.table)}
    (tmp_path / "bad.toml").write_text(tomli_w.dumps(tables), encoding="utf-8")
    with pytest.raises(InputError, match=words) as caught:
        load_vehicle(written(vehicle, tmp_path, coefficient_map="bad.toml"))
    assert "bad.toml: table" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_is_no_map_is_refused(vehicle, tmp_path) -> None:
    for name, words in (
        ("none.toml", "no such coefficient map"),
        ("mine.toml", "not a coefficient map"),
        (5, "not a file name"),
    ):
        with pytest.raises(InputError, match=words):
            load_vehicle(written(vehicle, tmp_path, coefficient_map=name))
    with pytest.raises(InputError, match=r"rotors\.map_level"):
        load_vehicle(written(vehicle, tmp_path, map_level="loud"))
    with pytest.raises(InputError, match=r"for rotors of 87\.5 mm, these have 60 mm"):
        replace_parameters(vehicle, {"rotors.coefficient_map": MAP, "rotors.radius": 0.06})
