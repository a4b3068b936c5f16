"""The report: self-contained, complete, honest about bounds, and written for fits of any kind."""

import base64
import re
from dataclasses import replace

import numpy as np
import pytest

from mufly.errors import InputError
from mufly.identify import FitResult, ParameterEstimate, RecordPrediction, ReportSection, write_fit_report
from mufly.identify.fit_pictures import estimate_coherence
from mufly.identify.fit_report import format_number


def record(role, n=200, inputs=2, outputs=1, seed=0):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.normal(size=(n // 10, inputs)), 10, axis=0) if inputs else np.zeros((n, 0))
    y = rng.normal(size=(n, outputs)) * 0.1 + (u[:, :1] if inputs else 0.0)
    predicted = np.broadcast_to(u[:, :1] if inputs else np.zeros((n, 1)), y.shape).copy()
    names = ("q", "p", "r")[:outputs]
    return RecordPrediction(
        f"{role} <flight>", role, 0.02 * np.arange(n), names, ("rad/s",) * outputs, y, predicted,
        np.full(outputs, 0.1), u, ("lon", "lat")[:inputs],
    )  # fmt: skip


def fit(*records, **changes):
    estimates = (
        ParameterEstimate("M_q", "body.damping", "1/s", -2.0, -3.0, 0.1, -3.2, -2.8),
        ParameterEstimate("tau", "", "s", 0.1, 0.0, 0.5, -1.0, 1.0, at_bound=True),
    )
    made = FitResult(
        "model <x>", estimates, np.diag([0.01, 0.25]), np.array([[1.0, -0.6], [-0.6, 1.0]]),
        ("only the ratio of a and b is seen",), 12.5,
        tuple({"iteration": k, "cost": 20.0 - 7.5 * k, "M_q": -2.0 - k, "tau": 0.1} for k in range(2)),
        "output error", 42, 1.5, True, "cost stands still", tuple(records),
    )  # fmt: skip
    return replace(made, **changes)


def test_the_page_needs_nothing_else_and_holds_what_was_asked(tmp_path):
    path = write_fit_report(
        fit(record("fit"), record("held out", seed=1)), tmp_path / "new", command="mufly identify x"
    )
    page = path.read_text()
    assert not re.search(r'(src|href|srcset)="(?!data:image/png;base64,)', page)
    for words in (
        "Parameters", "Convergence", "Parameters that the data cannot separate", "only the ratio of a and b is seen",
        "mufly identify x", "at a bound", "-3.2 … -2.8", "held out", "Theil", "prefers-color-scheme: dark",
    ):  # fmt: skip
        assert words in page
    assert "model &lt;x&gt;" in page
    assert "fit &lt;flight&gt;" in page
    assert "<x>" not in page
    images = re.findall(r"base64,([A-Za-z0-9+/=]+)", page)
    assert len(images) == len(list(path.parent.glob("*.png")))
    assert all(base64.b64decode(i).startswith(b"\x89PNG") for i in images)
    wanted = {
        "correlation",
        "theil",
        "history",
        "1-fit-prediction",
        "1-fit-residuals",
        "1-fit-cross",
        "1-fit-coherence",
    }
    assert wanted <= {p.stem for p in path.parent.glob("*.png")}


def test_an_interval_at_a_bound_is_not_shown_as_one(tmp_path):
    page = write_fit_report(fit(), tmp_path).read_text()
    assert "-1 … 1" not in page


def test_bench_fits_without_inputs_short_records_and_gaps_are_reported_too(tmp_path):
    gappy = record("held out", outputs=2, seed=2)
    gappy.measured[20:60, 1] = np.nan
    page = write_fit_report(fit(record("fit", n=12, inputs=0), gappy, converged=False), tmp_path).read_text()
    assert "did not converge" in page
    assert estimate_coherence(gappy) is None


def test_sections_of_a_command_are_shown(tmp_path):
    section = ReportSection("Structures tried", ("Why <so>.",), ("name", "score"), (("a", "1.0"),))
    page = write_fit_report(fit(), tmp_path, sections=[section]).read_text()
    assert "Structures tried" in page
    assert "Why &lt;so&gt;." in page


def test_a_folder_that_cannot_be_is_one_line(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="cannot be written"):
        write_fit_report(fit(), tmp_path / "file")


def test_coherence_of_a_linear_response_is_in_the_measurement_and_not_in_the_residual():
    measured, left = estimate_coherence(record("fit", n=4000))
    assert measured.coherence[:, 0].mean() > 0.8
    assert left.coherence[:, 0].mean() < 0.4


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (1234.5, "1234"), (1.5e-7, "1.5·10^-7"), (float("nan"), "–"), (-0.25, "-0.25")],
)
def test_numbers_are_short(value, text):
    assert format_number(value) == text
