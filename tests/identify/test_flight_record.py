"""What is refused, and what is said, before a fit begins."""

import numpy as np
import pytest

from mufly.errors import InputError
from mufly.identify import FlightRecord, make_flight_record, read_columns, require_consistent_record, split_record
from mufly.identify.flight_record import estimate_noise_from_differences, record_to_dataset, smooth_motion

T = np.arange(600) * 0.01


def record(noise=0.01, **changes):
    rng = np.random.default_rng(0)
    roll = 0.2 * np.sin(3 * T)
    p = 0.6 * np.cos(3 * T)
    outputs = ("height", "roll", "pitch", "yaw", "p", "q", "r")
    measured = np.column_stack([1 + 0.1 * np.sin(T), roll, 0 * T, 0.1 * T, p, 0 * T, 0.1 + 0 * T])
    measured += noise * rng.standard_normal(measured.shape)
    inputs = np.column_stack([0.7 + 0.1 * np.sin(T), 0.75 + 0 * T, 0.1 * np.cos(T), 0.1 * np.sin(2 * T)])
    given = {"name": "flight", "time_s": T, "inputs": inputs, "output_names": outputs, "measured": measured}
    given.update(changes)
    return FlightRecord(**given)


def scaled(name, factor):
    r = record()
    measured = r.measured.copy()
    measured[:, r.output_names.index(name)] *= factor
    return record(measured=measured)


def test_a_good_record_passes_and_constant_inputs_are_said():
    said = require_consistent_record(record())
    assert said == ("flight: motor_lower is constant, so the record holds no information about its effects",)


def test_degrees_labelled_radians_are_guessed_from_the_rate():
    with pytest.raises(InputError, match=r"roll: changes 5\d times as fast as p says: it seems to be in degrees"):
        require_consistent_record(scaled("roll", 180 / np.pi))


def test_heights_in_millimetres_are_refused_without_a_vehicle():
    """Before: fitted, and "wind or the model" blamed."""
    with pytest.raises(InputError, match=r"height: .* centimetres or millimetres"):
        require_consistent_record(scaled("height", 1000))


def test_degrees_a_second_are_guessed():
    with pytest.raises(InputError, match=r"p: .* degrees a second"):
        require_consistent_record(scaled("p", 180 / np.pi))


def test_a_pitch_beyond_a_right_angle_is_taken_for_degrees():
    measured = record().measured.copy()
    measured[:, 2] = 5.0 * np.sin(T)
    r = record(measured=measured).select_outputs(["pitch", "height"])
    with pytest.raises(InputError, match=r"pitch: reaches .* degrees"):
        require_consistent_record(r)


def test_inputs_in_per_cent_and_in_microseconds_are_recognised():
    with pytest.raises(InputError, match="per cent"):
        require_consistent_record(record(inputs=record().inputs * 100))
    with pytest.raises(InputError, match="servo pulse"):
        require_consistent_record(record(inputs=record().inputs * 1500))


def test_a_record_in_which_nothing_moves_is_refused():
    with pytest.raises(InputError, match="no input varies"):
        require_consistent_record(record(inputs=np.tile(record().inputs[:1], (len(T), 1))))


def test_a_recording_survives_the_round_trip():
    r = record()
    again = make_flight_record(record_to_dataset(r), "flight")
    assert again.output_names == ("height", "roll", "pitch", "yaw", "p", "q", "r")
    assert np.allclose(again.measured, r.measured)
    assert np.allclose(again.inputs, r.inputs)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t[::-1], "does not increase"),
        (lambda t: np.where(t > 3, t + 1.0, t), "has a gap of 1"),
        (lambda t: np.where(t > 3, np.nan, t), "contains NaN"),
    ],
)  # fmt: skip
def test_clocks_that_cannot_be_are_refused(change, words):
    data = record_to_dataset(record())
    with pytest.raises(InputError, match=words):
        make_flight_record(data.assign_coords(time=change(T)), "flight")


def test_missing_inputs_are_named():
    with pytest.raises(InputError, match="servo_input: is not in this log"):
        make_flight_record(record_to_dataset(record()).drop_vars("servo_input"), "flight")


def test_yaw_is_made_continuous():
    r = record()
    measured = r.measured.copy()
    measured[:, 3] = np.angle(np.exp(1j * 5 * T))
    again = make_flight_record(record_to_dataset(record(measured=measured)), "flight")
    assert np.allclose(again.measured[:, 3], 5 * T, atol=1e-9)


def test_noise_from_third_differences():
    noise = estimate_noise_from_differences(record())
    assert np.all(np.abs(noise / 0.01 - 1) < 0.15)


def test_smoothed_motion_has_the_slopes():
    m = smooth_motion(record(noise=0.0))
    assert np.max(np.abs(m[50:-50, 5] + 0.1 * np.cos(T[50:-50]))) < 1e-4
    without_rates = smooth_motion(record(noise=0.0).select_outputs(["roll"]))
    assert np.max(np.abs(without_rates[50:-50, 9] - 0.6 * np.cos(3 * T[50:-50]))) < 2e-3


def test_split_keeps_everything_once():
    a, b = split_record(record(), 0.25)
    assert np.array_equal(np.concatenate([a.time_s, b.time_s]), T)
    assert len(b.time_s) == 150
    with pytest.raises(InputError, match="too short"):
        split_record(a, 0.01)


@pytest.mark.parametrize("separator", [";", "\t", " "])
def test_a_table_without_header_may_have_decimal_commas(tmp_path, separator):
    """Before: "the file has 4 columns; name each"."""
    rows = [f"{0.02 * k:.3f} {0.1 * k:.2f} {1.5 - 0.01 * k:.3f}" for k in range(60)]
    path = tmp_path / "de.csv"
    path.write_text("\n".join(rows).replace(".", ",").replace(" ", separator) + "\n", encoding="utf-8")
    found = read_columns(path, columns=("time=1", "u=2", "y=3"))
    assert found.columns["y"] == pytest.approx(1.5 - 0.01 * np.arange(60))
    with pytest.raises(InputError, match="4: is not a column of this log; it has: 2, 3"):
        read_columns(path, columns=("time=1", "u=4"))
