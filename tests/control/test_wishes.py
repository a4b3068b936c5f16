"""Rotor speeds as measurements, and gains over forward speed: what the dissertation wished to know."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from mufly.cli.control import app
from mufly.control.analysis.rotor_speed_feedback import compare_rotor_speed_feedback, compute_back_emf_speed_noise
from mufly.control.analysis.speed_schedule import ScheduleComparison, compare_designs_over_speed
from mufly.errors import InputError
from mufly.vehicle import Vehicle, replace_parameters


def test_rotor_speeds_let_heave_be_faster_with_wider_margins(vehicle: Vehicle) -> None:
    found = compare_rotor_speed_feedback(vehicle, control_weights=(0.1, 0.025))
    plain, more = (replace(found, rows=found.rows[i : i + 2]).rows for i in (0, 2))
    for without, with_speeds in zip(plain, more, strict=True):
        assert not without.rotor_speeds
        assert with_speeds.rotor_speeds
        assert with_speeds.crossover_rad_s > 1.1 * without.crossover_rad_s
        assert with_speeds.disk_margin > without.disk_margin + 0.1
        assert with_speeds.height_m < 0.8 * without.height_m
        assert with_speeds.input < without.input
    # Less weight on the inputs: a faster loop with less margin, in both.
    for rows in (plain, more):
        assert rows[1].crossover_rad_s > rows[0].crossover_rad_s
        assert rows[1].disk_margin < rows[0].disk_margin
    assert "rotor speeds changes the height's deviation" in str(found)


def test_noisy_rotor_speeds_bring_less(vehicle: Vehicle) -> None:
    """The reading's noise over kE and the gear; a reading that is all noise is not used."""
    assert compute_back_emf_speed_noise(vehicle) == pytest.approx(0.01 / (0.0045 * 1.5))
    noisy = replace_parameters(vehicle, {"sensors.rotor_speed.voltage_noise": 50.0})
    good, bad = (compare_rotor_speed_feedback(v, control_weights=(0.1,)).rows for v in (vehicle, noisy))
    assert good[1].crossover_rad_s > good[0].crossover_rad_s
    assert bad[1].crossover_rad_s == pytest.approx(bad[0].crossover_rad_s, rel=0.05)
    assert bad[1].height_m == pytest.approx(bad[0].height_m, rel=0.2)


def test_a_schedule_is_judged_by_its_diagonal(vehicle: Vehicle) -> None:
    found = compare_designs_over_speed(vehicle, ["ltr"], speeds_m_s=(0.0, 2.0))
    (ltr,) = found.schedules
    assert ltr.disk_margin.shape == (2, 2)
    assert (ltr.disk_margin > 0.9).all()
    assert ltr.disk_margin[0, 0] == pytest.approx(1.02, abs=0.01)  # the design in hover
    assert "one design at the first speed is sufficient for all" in found.verdict_sentence
    assert "no flight map" in found.verdict_sentence
    wide = replace(ltr, disk_margin=np.array([[1.0, 0.5], [0.4, 0.9]]))
    assert wide.largest_disk_margin_increase == pytest.approx(0.4)
    judged = ScheduleComparison("vehicle", True, (ltr, wide))
    assert "gains at most 0.40 of disk margin (LQG/LTR): worthwhile." in judged.verdict_sentence


def test_commands_print_json_and_refuse_by_name(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["schedule", "--methods", "ltr", "--speed", "0", "--speed", "1", "--json"])
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["schedules"][0]["speeds_m_s"] == [0.0, 1.0]
    with pytest.raises(InputError, match="--methods: mu"):
        CliRunner().invoke(app, ["schedule", "--methods", "mu"], catch_exceptions=False)
    result = CliRunner().invoke(app, ["rotor-speeds", "--json"])
    assert result.exit_code == 0, result.output
    assert len(json.loads(result.stdout)["rows"]) == 12
