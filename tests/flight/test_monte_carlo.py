"""Many flights: what varies, who flies them, how they are judged, and that nothing is lost."""

import json
import multiprocessing
import time
from collections.abc import Iterable, Iterator
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from mufly.control import design_flight_controller
from mufly.errors import InputError
from mufly.flight import fly_mission
from mufly.flight.monte_carlo import (
    Campaign,
    FlightCase,
    FlightResult,
    WorkerPool,
    case_from_result,
    compute_flight_result,
    compute_wilson_interval,
    draw_distributions,
    draw_influences,
    flight_severity,
    fly_case,
    parse_variations,
    results_dataset,
    run_campaign,
    search_worst_case,
    sort_by_severity,
    summarise_outcome,
)
from mufly.flight.monte_carlo.worker_pool import StopCheck, _end_with_parent
from mufly.mission import Mission, parse_mission
from mufly.results import to_plain_data
from mufly.study import read_study_results, write_study_results
from mufly.vehicle import Vehicle, load_vehicle
from mufly.vehicle import replace_parameters as changed

HOP = parse_mission(
    {
        "take_off": {"height_m": 0.4, "wait_s": 0.2},
        "waypoint": [{"position_m": [0.1, 0.0, -0.4], "wait_s": 0.1}],
    }
)


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle("mufly-1.1")


@pytest.fixture(scope="module")
def campaign(vehicle: Vehicle) -> Campaign:
    return Campaign.create_checked(
        vehicle, HOP, variations=parse_variations(["parameters=8%", "m=normal:1%"], vehicle), wind=0.2, gust=0.1,
        sensors="ideal", seed=3, mission_name="hop.toml",
    )  # fmt: skip


@pytest.fixture(scope="module")
def flights(campaign: Campaign) -> list[FlightResult]:
    """By one process, one after the other."""
    with WorkerPool(1) as crew:
        return run_campaign(campaign, 6, crew=crew)


# What varies


def test_spreads_and_ranges_are_kept_and_the_particular_takes_precedence(vehicle: Vehicle) -> None:
    everything, mass, legs = parse_variations(
        ["parameters=10%", "body.mass=90:100g", "contact.stiffness=normal:2N/m"], vehicle
    )
    assert "body.mass" not in everything.keys
    assert "contact.stiffness" not in everything.keys
    assert not any(k.startswith(("sensors", "mass_budget", "range_ring")) for k in everything.keys)
    assert everything.variable_count == len(everything.keys)
    rng = np.random.default_rng(1)
    drawn = np.array(
        [list(everything.parameter_values(everything.draw_normalised_variables(rng)).values()) for _ in range(400)]
    )
    off = np.abs(drawn / everything.nominal_values - 1.0)
    assert off.max() <= 0.1 + 1e-12
    assert off.max() > 0.099
    masses = [mass.parameter_values(mass.draw_normalised_variables(rng))["body.mass"] for _ in range(400)]
    assert 0.09 <= min(masses) < 0.0902
    assert 0.0998 < max(masses) <= 0.1
    stiff = [legs.parameter_values(legs.draw_normalised_variables(rng))["contact.stiffness"] for _ in range(2000)]
    assert np.mean(stiff) == pytest.approx(150.0, abs=0.2)
    assert np.std(stiff) == pytest.approx(2.0, rel=0.06)


def test_an_identified_covariance_is_drawn_from(tmp_path: Path, vehicle: Vehicle) -> None:
    """Two coefficients of which only the sum is known well, one that the data do not see, one at its bound, a delay."""
    keys = [
        "rotors.upper.thrust_coefficient",
        "rotors.lower.thrust_coefficient",
        "body.inertia_xx",
        "body.mass",
        "",
    ]
    values, std = [0.014, 0.012, 1e-4, 0.09, 0.02], [4e-4, 5e-4, None, 1e-3, 1e-3]
    rows = [
        {"symbol": "x", "key": k, "value": v, "std": s, "at_bound": k == "body.mass"}
        for k, v, s in zip(keys, values, std, strict=True)
    ]
    correlation = np.eye(5)
    correlation[0, 1] = correlation[1, 0] = -0.99
    file = tmp_path / "fit.json"
    file.write_text(json.dumps({"parameters": rows, "correlation": correlation.tolist()}))
    (found,) = parse_variations([str(file)], vehicle)
    assert found.keys == (keys[0], keys[1], keys[3])
    assert "body.mass at a bound" in found.note
    assert "body.inertia_xx not determined" in found.note
    rng = np.random.default_rng(0)
    drawn = np.array(
        [list(found.parameter_values(found.draw_normalised_variables(rng)).values()) for _ in range(20_000)]
    )
    covariance = np.cov(drawn[:, :2].T)
    wanted = np.array([[1.6e-7, -0.99 * 2e-7], [-0.99 * 2e-7, 2.5e-7]])
    np.testing.assert_allclose(covariance, wanted, rtol=0.03)
    np.testing.assert_allclose(drawn.mean(axis=0), [0.014, 0.012, 0.09], rtol=1e-3)
    assert np.ptp(drawn[:, 2]) == 0.0


@pytest.mark.parametrize(
    ("texts", "why"),
    [
        (["parameters=5"], "could mean a value or a spread"),
        (["wings=5%"], "is not a parameter of mufly-1.1"),
        (["m=+-2furlong"], "use one of: kg, g, mg, lb, oz, or %"),
        (["rotors=+-2"], "vary them in %"),
        (["m=100:90g"], "contains no value"),
        (["m=300:50%"], "contains no value"),
        (["m=-50:300%"], "changes its sign; give shares of 0 % or more"),
        (["m=50:high%"], "'50:high%' is not a variation"),
        (["motor.friction_torque=50:300%"], "has no percentage"),
        (["standart"], "did you mean 'standard'"),
        (["m=100%"], "includes zero"),
        (["m=0%"], "above 0"),
        (["motor.friction_torque=5%"], "has no percentage"),
        (["body.inertia_zz=std"], "no standard deviation is stated"),
        (["body.mass"], "names no parameter"),
        (["m=5%", "body.mass=3%"], "is varied by 'm=5%'"),
        (["nowhere.json"], "cannot be read"),
    ],
)
def test_what_is_no_variation_is_said(texts: list[str], why: str, vehicle: Vehicle) -> None:
    with pytest.raises(InputError, match=why):
        parse_variations(texts, vehicle)


def test_vehicles_that_cannot_be_are_drawn_again_and_counted(campaign: Campaign, vehicle: Vehicle) -> None:
    # A torque constant above the back-EMF constant would make energy: most of these draws are refused.
    often = replace(campaign, variations=parse_variations(["motor.torque_constant=3.5:9.5mN m/A"], vehicle))
    cases = [often.draw_case(k) for k in range(40)]
    assert sum(c.refused_draws for c in cases) > 40
    assert all(c.parameter_values["motor.torque_constant"] <= 1.02 * 0.0045 for c in cases)
    never = replace(campaign, variations=parse_variations(["gear.efficiency=1.1:1.2"], vehicle))
    with pytest.raises(InputError, match=r"are impossible .*gear.efficiency"):
        never.draw_case(0)


def test_wind_of_a_speed_comes_from_anywhere(campaign: Campaign) -> None:
    winds = np.array([campaign.draw_case(k).wind for k in range(200)])
    np.testing.assert_allclose(np.hypot(winds[:, 0], winds[:, 1]), 0.2)
    assert np.abs(winds[:, :2].mean(axis=0)).max() < 0.03
    assert len({campaign.draw_case(k).seed for k in range(200)}) == 200


# Who flies


def test_flights_are_the_same_whoever_flies_them(campaign: Campaign, flights: list[FlightResult]) -> None:
    with WorkerPool(2) as crew:
        assert to_plain_data(run_campaign(campaign, 6, crew=crew)) == to_plain_data(flights)
    with WorkerPool(3, how="threads") as crew:
        assert to_plain_data(run_campaign(campaign, 3, crew=crew)) == to_plain_data(flights[:3])
        backwards = crew.fly_cases(campaign, [(campaign.draw_case(k), None) for k in (2, 0)])
        assert to_plain_data(sorted(backwards, key=lambda f: f.index)) == to_plain_data([flights[0], flights[2]])


def test_a_cluster_gives_the_same_flights(campaign: Campaign, flights: list[FlightResult]) -> None:
    distributed = pytest.importorskip("distributed", reason="dask.distributed, an extra, is not installed")
    with (
        distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None) as cluster,
        WorkerPool(cluster=cluster.scheduler_address) as crew,
    ):
        assert to_plain_data(run_campaign(campaign, 2, crew=crew)) == to_plain_data(flights[:2])


def _has_a_worker(says: Connection) -> None:
    context = multiprocessing.get_context("fork")
    context.Process(target=_works, args=(says,)).start()
    time.sleep(60.0)


def _works(says: Connection) -> None:
    says.send("begun")
    _end_with_parent()
    time.sleep(60.0)


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="no fork on this system")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_a_worker_ends_with_the_process_that_is_killed() -> None:
    context = multiprocessing.get_context("fork")
    hears, says = context.Pipe(duplex=False)
    parent = context.Process(target=_has_a_worker, args=(says,))
    parent.start()
    says.close()
    assert hears.recv() == "begun"
    parent.kill()
    parent.join()
    assert hears.poll(20.0)  # nobody holds the other end any more
    with pytest.raises(EOFError):
        hears.recv()


def test_a_campaign_that_was_killed_goes_on(tmp_path: Path, campaign: Campaign, flights: list[FlightResult]) -> None:
    flown: list[int] = []

    def progress(done: int, total: int) -> None:
        flown.append(done)

    with WorkerPool(1) as crew:
        stopped = run_campaign(campaign, 6, crew=crew, folder=tmp_path, progress=progress, stop=lambda: len(flown) > 2)
        assert 2 <= len(stopped) < 6
        file = tmp_path / "flights.jsonl"
        assert len(file.read_bytes().splitlines()) == len(stopped)
        file.write_bytes(file.read_bytes() + b'{"index": 5, "se')  # killed in mid-line
        flown.clear()
        assert to_plain_data(run_campaign(campaign, 6, crew=crew, folder=tmp_path, progress=progress)) == to_plain_data(
            flights
        )
        assert flown[0] == len(stopped)
        assert len(flown) == 7 - len(stopped)
        with pytest.raises(InputError, match="another campaign"):
            run_campaign(replace(campaign, tolerance_m=0.2), 6, crew=crew, folder=tmp_path)
        file.write_bytes(b"nonsense\n" + file.read_bytes())
        with pytest.raises(InputError, match="damaged"):
            run_campaign(campaign, 6, crew=crew, folder=tmp_path)


def test_a_flight_flown_again_with_a_recording_is_the_same(
    tmp_path: Path, campaign: Campaign, flights: list[FlightResult]
) -> None:
    again = fly_case(campaign, case_from_result(flights[1]), tmp_path / "flight.mcap")
    assert to_plain_data(again) == to_plain_data(flights[1])


def test_the_software_believes_in_the_vehicle_it_was_designed_for(vehicle: Vehicle) -> None:
    heavy = changed(vehicle, {"body.mass": 0.105})
    taken = fly_mission(heavy, HOP, designed_for=vehicle, brief=True)
    same = fly_mission(heavy, HOP, controller=design_flight_controller(vehicle), brief=True)
    known = fly_mission(heavy, HOP, brief=True)
    assert taken.attrs["designed_for"] == "mufly-1.1"
    np.testing.assert_array_equal(taken.truth_position, same.truth_position)
    assert not np.array_equal(taken.truth_position[:400], known.truth_position[:400])


# How it is judged


def ended(data: xr.Dataset, name: str, values: object) -> xr.Dataset:
    """With another last instant."""
    other = data[name].values.copy()
    other[-1] = values
    return data.assign({name: data[name].copy(data=other)})


def test_what_the_state_machine_says_is_not_enough(campaign: Campaign) -> None:
    data = fly_mission(campaign.vehicle, HOP, controller=campaign.controller, brief=True)
    common = {"index": 0, "seed": 0, "refused": 0, "wind": None, "values": {}}

    def why(recording: xr.Dataset, mission: Mission = HOP, tolerance_m: float = 0.3) -> str:
        flown = compute_flight_result(recording, mission, tolerance_m, **common)
        assert flown.reported_outcome.startswith("succeeded")
        assert flown.success == (not flown.reason)
        return flown.reason

    assert why(data) == ""
    x = data.truth_position.values[-1]
    assert "above the take-off position" in why(ended(data, "truth_position", np.subtract(x, [0.0, 0.0, 0.05])))
    assert "from the landing position" in why(ended(data, "truth_position", np.add(x, [0.5, 0.0, 0.0])))
    assert "final tilt 20 degrees" in why(ended(data, "truth_attitude", [np.radians(20.0), 0.0, 0.0]))
    assert "final speed" in why(ended(data, "truth_velocity", [0.2, 0.0, 0.0]))
    assert "motors still running" in why(ended(data, "motor_input", [0.1, 0.0]))
    assert "reported as reached from" in why(data, tolerance_m=1e-6)
    far = HOP.model_copy(update={"waypoint": (HOP.waypoint[0].model_copy(update={"position_m": (3.0, 0.0, -0.4)}),)})
    assert why(data, far) == "waypoint 1 was not reached"


def test_a_flight_that_cannot_take_off_is_a_failure_with_a_reason(campaign: Campaign) -> None:
    case = replace(campaign.draw_case(0), parameter_values={"body.mass": 0.19})
    flown = fly_case(campaign, case)
    assert not flown.success
    assert flown.reported_outcome.startswith("failed")
    broken = replace(campaign, faults=("sonar.jump",))  # of sensors that ideal flights have not
    assert fly_case(broken, case).reason.startswith("did not fly: ")


def test_wilson_interval_is_the_published_one() -> None:
    """Newcombe (1998), Statistics in Medicine 17, 857-872, Table I, method 3."""
    for successes, flights, low, high in (
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ):
        np.testing.assert_allclose(compute_wilson_interval(successes, flights), (low, high), atol=5e-5)
    assert compute_wilson_interval(20, 20)[1] == 1.0
    with pytest.raises(InputError, match="21 successes in 20 flights"):
        compute_wilson_interval(21, 20)


def test_wilson_interval_holds_the_truth_as_often_as_it_says() -> None:
    """Summed over the binomial distribution: about 95 % for any truth, where p +- z sqrt(pq/n) has 40 %."""
    from scipy.stats import binom

    n = 50
    intervals = np.array([compute_wilson_interval(k, n) for k in range(n + 1)])
    for p in (0.5, 0.9, 0.99):
        inside = (intervals[:, 0] <= p) & (p <= intervals[:, 1])
        assert 0.90 < binom.pmf(np.arange(n + 1), n, p)[inside].sum() < 0.99


def test_results_say_which_flight_is_the_worst(tmp_path: Path, campaign: Campaign, flights: list[FlightResult]) -> None:
    lost = replace(flights[0], index=6, success=False, reason="a rotor hit the wall 3 at [1.0, 2.0] m, 3.1 s")
    lost = replace(lost, tilt_peak_deg=80.0, reported_outcome="succeeded")
    told = summarise_outcome(
        [*flights, lost, replace(lost, index=7, reason="a rotor hit the wall 3 at [1.5, 2.0] m, 4 s")], 0.3
    )
    assert told.failed == (6, 7)
    assert told.reasons == (("a rotor hit the wall ... at ... m, ... s", 2),)
    assert told.successes == sum(f.success for f in flights)
    assert told.reported_successes == told.successes + 2
    tilt = next(w for w in told.metric_summaries if w.label.startswith("tilt"))
    assert (tilt.worst, tilt.flight, tilt.unit) == (80.0, 6, "deg")
    assert "flights succeeded" in told.describe_success()
    assert "Wilson" in told.describe_success()
    table = results_dataset(flights, campaign)
    write_study_results(table, tmp_path, "flights")
    back = read_study_results(tmp_path / "flights.nc")
    np.testing.assert_array_equal(back.overshoot_m, [f.overshoot_m for f in flights])
    assert back.body_mass.attrs["units"] == "kg"
    assert back.seed.values.tolist() == [str(f.seed) for f in flights]
    figure = draw_distributions(flights, 0.3, "hop")
    labels = [a.get_xlabel() for a in figure.axes]
    assert "tilt, peak (deg)" in labels
    assert all("(" in text for text in labels)
    assert draw_influences(flights, campaign) is None  # too few to say anything


# The worst case


class Pretended(WorkerPool):
    """Flies nothing: what is heaviest tracks worst, with the wind from the south-east."""

    def fly_cases(
        self, campaign: Campaign, cases: Iterable[tuple[FlightCase, Path | None]], stop: StopCheck = bool
    ) -> Iterator[FlightResult]:
        for case, _ in cases:
            if stop():
                return
            assert case.wind is not None
            how_bad = case.parameter_values["body.mass"] * (
                2.0 - np.hypot(case.wind[0] + 0.1414, case.wind[1] - 0.1414)
            )
            yield FlightResult(
                case.index,
                case.seed,
                True,
                "succeeded",
                "",
                "succeeded",
                0,
                case.wind,
                case.parameter_values,
                tracking_peak_m=float(how_bad),
            )


def test_the_search_finds_the_worst_corner_and_goes_on(tmp_path: Path, campaign: Campaign, vehicle: Vehicle) -> None:
    heavier = replace(campaign, variations=parse_variations(["m=85:115g"], vehicle))
    crew = Pretended(1)
    whole = search_worst_case(heavier, 90, crew=crew)
    worst = sort_by_severity(whole, 0.3)[0]
    assert worst.values["body.mass"] > 0.114
    assert worst.wind is not None
    np.testing.assert_allclose(worst.wind[:2], (-0.1414, 0.1414), atol=0.02)
    told: list[int] = []
    part = search_worst_case(
        heavier,
        90,
        crew=crew,
        folder=tmp_path,
        progress=lambda k, n: told.append(k),
        stop=lambda: len(told) > 20,
    )
    assert 20 < len(part) < 90
    assert to_plain_data(search_worst_case(heavier, 90, crew=crew, folder=tmp_path)) == to_plain_data(whole)
    with pytest.raises(InputError, match="only the noise varies"):
        search_worst_case(replace(heavier, variations=(), wind=None), 6, crew=crew)


def test_failures_are_worse_than_any_success_and_the_sooner_the_worse(flights: list[FlightResult]) -> None:
    wild = replace(flights[0], success=True, tilt_peak_deg=1e4)
    late, soon = (replace(flights[0], success=False, duration_s=t) for t in (60.0, 3.0))
    assert flight_severity(wild, 0.3) < flight_severity(late, 0.3) < flight_severity(soon, 0.3)
    assert flight_severity(replace(flights[0], tilt_peak_deg=15.0, railed_s=0.0), 10.0) == pytest.approx(0.5)
