"""Coefficient maps: against the solver point by point, resumed, filled, refused; interpolation against closed forms."""

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from mufly.errors import InputError, MuflyError
from mufly.rotor import (
    OperatingCondition,
    RotorSystem,
    compute_coax_map,
    load_rotor,
    make_climb_axis_over_tip_speed,
    prepare_blading,
    solve_system,
)
from mufly.rotor import compute_coax_map as room_function
from mufly.rotor.coax_maps import _fill_unsolved_points, interpolate_map, order_points_by_neighbour
from mufly.rotor.wake import WakeSettings
from mufly.vehicle import CoefficientMap, MapTables, format_coefficient_map_toml, load_coefficient_map
from mufly.vehicle.coefficient_map import format_map_table

PITCH = np.radians(14.0)
SPEEDS, RATIOS = (300.0, 500.0), (0.8, 1.0, 1.2)
PAIR = {"spacing_m": 0.04, "upper_pitch_rad": PITCH, "lower_pitch_rad": PITCH}


@pytest.fixture(scope="module")
def blading():
    return prepare_blading(load_rotor("walkera-5g6"))


@pytest.fixture(scope="module")
def axes(blading):
    climbs = make_climb_axis_over_tip_speed([-1.0, 0.0, 1.0, 2.0], SPEEDS, float(blading.radius_m[0]))
    return {"mean_speed_rad_s": SPEEDS, "ratio": RATIOS, "climb_ratio": climbs.tolist()}


@pytest.fixture(scope="module")
def made(blading, axes):
    return compute_coax_map(blading, blading, **PAIR, **axes, name="pair")


def made_map(function, axes) -> CoefficientMap:
    grid = np.meshgrid(*axes, indexing="ij")
    values = [np.broadcast_to(v, grid[0].shape) for v in function(*grid)]
    return CoefficientMap(
        name="made", method="other", upper="a", lower="a", radius_m=0.1, spacing_m=0.04, upper_pitch_deg=14,
        lower_pitch_deg=14, density_kg_m3=1.2, viscosity_Pa_s=1.81e-5,
        table=format_map_table(MapTables(*axes, *values, np.ones(grid[0].shape, dtype=bool))),
    )  # fmt: skip


def test_points_are_the_solver_s(made, blading) -> None:
    t = made.decode_map_tables()
    assert t.solved.all()
    for k, j, i in ((0, 2, 1), (1, 2, 3), (1, 1, 2), (0, 0, 0)):
        mean, r, m = t.mean_speed_rad_s[k], t.ratio[j], t.climb_ratio[i]
        up = 2 * mean / (1 + r)
        alone = solve_system(
            RotorSystem.from_coaxial_pair(blading, blading, spacing_m=0.04),
            OperatingCondition(PITCH, (up, r * up), climb_m_s=m * mean * 0.0875),
        )
        found = [t[c][k, j, i] for c in range(3, 7)]
        expected = [alone.upper.c_T, alone.upper.c_Q, alone.lower.c_T, alone.lower.c_Q]
        # A solution depends a little on where it starts from: sections that hardly lift have more than one.
        assert_allclose(found[:2], expected[:2], rtol=3e-3)
        assert_allclose(found[2:], expected[2:], rtol=3e-3 if i and j else 0.05)
        assert_allclose(interpolate_map(made, mean, r, m)[0], found, rtol=1e-9)


def test_physics(made) -> None:
    t = made.decode_map_tables()
    total = t.cT_upper + t.cT_lower
    assert np.all(np.diff(total, axis=2) < 0)  # climb lowers the thrust
    assert np.all(np.diff(t.cT_lower, axis=1) > 0)  # a slower upper rotor sends down less
    assert np.all(np.diff(t.cT_upper, axis=1) < 0)  # a faster lower rotor draws more
    hover = t.climb_ratio == 0.0
    assert np.all(t.cT_lower[..., hover] < t.cT_upper[..., hover])


def test_interpolation_is_exact_for_lines_continuous_in_slope_and_held_at_the_edges() -> None:
    axes = (np.array([200.0, 400.0]), np.linspace(0.6, 1.6, 6), np.linspace(-0.04, 0.1, 8))
    line = made_map(lambda s, r, m: (1e-5 * s + 0.01 * r - 0.05 * m, 0.002 * r, 0.01 + 0 * r, 0.001 - 0.01 * m), axes)
    rng = np.random.default_rng(1)
    s, r, m = (rng.uniform(a[0], a[-1], 50) for a in axes)
    values, outside = interpolate_map(line, s, r, m)
    assert not outside.any()
    expected = np.stack([1e-5 * s + 0.01 * r - 0.05 * m, 0.002 * r, 0.01 + 0 * r, 0.001 - 0.01 * m], axis=-1)
    assert_allclose(values, expected, atol=2e-8)
    edge, beyond = interpolate_map(line, 300.0, [1.6, 1.9], [0.1, 0.2])
    assert_array_equal(beyond, [False, True])
    assert_allclose(edge[1], edge[0])

    wavy = made_map(lambda s, r, m: [0.01 * np.sin(5 * r) * np.cos(30 * m)] * 4, axes)
    h = 1e-6
    for x in axes[1][1:-1]:
        left, here, right = (interpolate_map(wavy, 300.0, x + d, 0.03)[0][0] for d in (-h, 0.0, h))
        assert (right - here) / h == pytest.approx((here - left) / h, abs=1e-5)
    fine = rng.uniform(0.8, 1.4, 200), rng.uniform(0.0, 0.06, 200)
    error = interpolate_map(wavy, 300.0, *fine)[0][:, 0] - 0.01 * np.sin(5 * fine[0]) * np.cos(30 * fine[1])
    assert np.max(np.abs(error)) < 0.05 * 0.01


def test_file_round_trip(made, tmp_path) -> None:
    file = tmp_path / "pair.toml"
    file.write_text(format_coefficient_map_toml(made), encoding="utf-8")
    assert load_coefficient_map(file) == made
    assert load_coefficient_map("pair.toml", tmp_path) == made
    for ours, theirs in zip(load_coefficient_map(file).decode_map_tables(), made.decode_map_tables(), strict=True):
        assert_array_equal(ours, theirs)


def test_a_stopped_run_goes_on(blading, axes, made, tmp_path) -> None:
    kept = tmp_path / "pair.points"

    def stop(done: int, total: int) -> None:
        if done == 7:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        compute_coax_map(blading, blading, **PAIR, **axes, name="pair", kept=kept, progress=stop)
    lines = kept.read_text().splitlines()
    assert len(lines) == 8
    # A point that is known is not solved again: make one recognisable. A line cut off in mid-write is dropped.
    point, values = json.loads(lines[2])
    lines[2] = json.dumps([point, [0.5, *values[1:]]])
    kept.write_text("\n".join([*lines[:5], lines[5][:9]]))
    seen: list[int] = []
    resumed = compute_coax_map(
        blading,
        blading,
        **PAIR,
        **axes,
        name="pair",
        kept=kept,
        progress=lambda done, total: seen.append(done),
    )
    assert seen[-1] == 24
    assert not kept.exists()
    t, full = resumed.decode_map_tables(), made.decode_map_tables()
    assert t.cT_upper[tuple(point)] == 0.5
    other = np.ones(t.grid_shape, dtype=bool)
    other[tuple(point)] = False
    assert_allclose(t.cT_upper[other], full.cT_upper[other], rtol=1e-5)

    kept.write_text("\n".join(lines))
    with pytest.raises(InputError, match="another map"):
        compute_coax_map(blading, blading, **{**PAIR, "spacing_m": 0.05}, **axes, kept=kept)


def test_gaps_are_filled_from_their_neighbours_and_marked() -> None:
    rng = np.random.default_rng(0)
    values, solved = rng.uniform(1, 2, size=(2, 4, 5, 4)), np.ones((2, 4, 5), dtype=bool)
    solved[0, 1, 2] = False
    solved[:, 3, :] = False
    filled = _fill_unsolved_points(values, solved)
    assert_array_equal(filled[solved], values[solved])
    around = [values[1, 1, 2], values[0, 0, 2], values[0, 2, 2], values[0, 1, 1], values[0, 1, 3]]
    assert_allclose(filled[0, 1, 2], np.mean(around, axis=0))
    assert_allclose(filled[:, 3], values[:, 2])


def test_every_point_is_a_neighbour_of_the_last() -> None:
    points = np.array(order_points_by_neighbour((3, 4, 5)))
    assert len({tuple(p) for p in points.tolist()}) == 60
    assert np.all(np.abs(np.diff(points, axis=0)).sum(axis=1) == 1)


def test_wakes_start_from_their_neighbours_and_are_marked_where_they_do_not_settle(blading, monkeypatch) -> None:
    # The wake method itself takes seconds a point and has its own tests; blade elements stand in for it here.
    calls = []

    def stands_in(system, condition, method, *, settings, start):
        assert method == "wake"
        climb, (upper, lower) = condition.climb_m_s, condition.speed_rad_s
        calls.append((climb, lower / upper, start))
        return replace(solve_system(system, condition), converged=not climb < -0.5)

    monkeypatch.setitem(room_function.__globals__, "solve_system", stands_in)
    small = {"mean_speed_rad_s": [420.0], "ratio": [1.0, 1.2], "climb_ratio": [-0.03, 0.0, 0.03]}
    made = compute_coax_map(blading, blading, **PAIR, **small, method="wake", settings=WakeSettings(step_deg=30.0))
    t = made.decode_map_tables()
    assert made.method == "wake"
    assert "free wake, step 30 deg" in made.settings
    assert_array_equal(t.solved[0], [[False, True, True]] * 2)
    assert_allclose(t.cT_upper[0, :, 0], t.cT_upper[0, :, 1])  # filled from hover, the only neighbour
    # From climb through hover to descent; one that does not settle is tried once more without a start.
    assert [round(c, 1) for c, _, _ in calls] == [1.1, 0.0, -1.1, -1.1, -1.1, 0.0, 1.1]
    starts = [s is not None for *_, s in calls]
    assert starts == [False, True, True, False, False, False, True]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"ratio": [1.0]}, "give 2 or more"),
        ({"ratio": [0.5, 1.0, 1.2]}, "evenly"),
        ({"ratio": [-0.5, 0.5]}, "above 0"),
        ({"climb_ratio": [0.01, 0.02]}, "does not include 0"),
        ({"climb_ratio": [0.0, np.nan]}, "does not increase"),
        ({"ratio": np.linspace(0.5, 1.5, 99).tolist()}, "512 at most"),
        ({"spacing_m": 0.0}, "above 0"),
    ],
)
def test_what_cannot_be_mapped_is_refused(blading, axes, change, words) -> None:
    with pytest.raises(InputError, match=words):
        compute_coax_map(blading, blading, **{**PAIR, **axes, **change})


def test_rotors_of_two_radii_are_refused(blading, axes) -> None:
    other = prepare_blading(load_rotor("naca0012-r60-c20"))
    with pytest.raises(InputError, match="the same radius"):
        compute_coax_map(blading, other, **PAIR, **axes)


def test_a_map_that_is_mostly_guessed_is_refused(blading, axes, monkeypatch) -> None:
    def fails(*_, **__):
        raise MuflyError("no answer")

    monkeypatch.setitem(room_function.__globals__, "solve_system", fails)
    with pytest.raises(MuflyError, match=r"only 0 of 24 .*no answer"):
        compute_coax_map(blading, blading, **PAIR, **axes)
