"""Position by camera in flight: the other process, its answers' times, and what goes wrong with the camera."""

from __future__ import annotations

import cmath
import math
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from mufly.camera import Camera, decode_grey_picture, load_camera, parse_camera, read_pictures, unproject_pixels
from mufly.dynamics import initial_state
from mufly.errors import MuflyError
from mufly.estimate import Estimate, KalmanEstimator
from mufly.estimate.filter.filter_records import ERROR_FIX_BIAS
from mufly.flight import Flight, FlightEvent, fly_mission, read_recording, replay_estimator
from mufly.flight.fixes.camera_sensor import CameraConfig, CameraSensor, make_camera, replace_fix_by_camera
from mufly.flight.fixes.external_fixes import ExternalFixes
from mufly.flight.fixes.onboard_camera import PictureStreamServer, parse_camera_fault
from mufly.mission import load_mission
from mufly.sensors import Reading, Truth
from mufly.slam import (
    CameraFrame,
    MapView,
    SlamSystem,
    TrackedPicture,
    TrackingResult,
    find_distorted_inlier_pixels,
    import_opencv,
    open_picture_source,
    read_telemetry_interpolator,
    run_slam,
)
from mufly.slam.image_tools import pinhole_parameters
from mufly.vehicle import load_vehicle
from mufly.world import World


def test_faults_of_the_camera_are_read_or_refused_in_a_line() -> None:
    assert parse_camera_fault("covered@20s+5s").stop_s == 25.0
    assert math.isinf(parse_camera_fault("unplugged").stop_s)
    for text, words in (
        ("blind@3s", "use one of: covered, dark, unplugged"),
        ("dark@x", "'x' is not a number"),
        ("dark@3s+0s", "is not a time span"),
    ):
        with pytest.raises(MuflyError, match=words):
            parse_camera_fault(text)


def test_the_camera_takes_the_place_of_the_statistical_fix() -> None:
    camera = load_camera("mufly-2.0")
    fix = replace_fix_by_camera(load_vehicle("mufly-2.0"), camera).sensors.position_fix  # type: ignore[union-attr]
    assert fix is not None
    assert float(fix.latency) == pytest.approx(0.2)
    assert float(fix.period) == pytest.approx(0.066)


MISSION = """
[take_off]
height_m = 0.6
wait_s = 0.5

[[waypoint]]
position_m = [0.4, 0.0, -0.6]
wait_s = 4.0
"""


SIGHTS: list[TrackedPicture] = []


class Watched(CameraSensor):
    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.on_map_view = SIGHTS.append


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("camera")


@pytest.fixture(scope="module")
def flown(folder: Path) -> tuple[xr.Dataset, list[FlightEvent]]:
    """A hop over a rich floor by a good camera, whose lens is covered on the way."""
    pytest.importorskip("cv2")
    path = folder / "hop.toml"
    path.write_text(MISSION)
    events: list[FlightEvent] = []
    eye = CameraConfig(load_camera("webcam"), camera_faults=(parse_camera_fault("covered@8.5s+1s"),))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mufly.flight.simulated_flight.CameraSensor", Watched)
        ds = fly_mission(
            "mufly-1.1", path, sensors="fitted", seed=3, eye=eye, on_event=events.append,
            path=folder / "flight.mcap",
        )  # fmt: skip
    return ds, events


def test_a_hop_on_pictures_ends_where_it_was_to(flown: tuple[xr.Dataset, list[FlightEvent]]) -> None:
    ds, events = flown
    assert ds.attrs["outcome"] == "succeeded", [e.text for e in events]
    assert ds.attrs["camera"] == "webcam"
    assert np.hypot(*(ds["truth_position"].values[-1, :2] - [0.4, 0.0])) < 0.15
    # It sees nothing with its lens on the floor: nobody has to be warned of that.
    assert [e.text for e in events if "is missing" in e.text and e.time_s > 12.0] == []


def test_a_covered_lens_is_told_within_a_second_and_borne(
    flown: tuple[xr.Dataset, list[FlightEvent]],
) -> None:
    ds, events = flown
    said = [(e.time_s, e.text) for e in events if "camera" in e.text]
    assert said[0][1].startswith("no position from the camera: too few points of the floor")
    assert 8.5 < said[0][0] < 9.5
    assert said[1][1] == "position from the camera is available again"
    # When it finds itself again hangs on the last bit of OpenCV's sums; that it does, in the air, does not.
    height = np.interp(said[1][0], ds.time.values, -ds.truth_position.values[:, 2])
    assert height > 0.3, said


def test_what_is_seen_is_shown(flown: tuple[xr.Dataset, list[FlightEvent]]) -> None:
    ds, _ = flown
    on_floor = [s for s in SIGHTS if s.result is None]
    looked = [s for s in SIGHTS if s.result is not None]
    assert len(on_floor) > 10
    last = looked[-1].counts
    assert last.taken_count >= last.processed_count + last.lost_count > 100
    assert last.processed_count > last.trusted_count
    assert 0 < last.lost_count < 0.12 * last.taken_count
    good = next(s for s in reversed(looked) if s.result is not None and s.result.trusted)
    answer = good.result
    assert answer is not None
    assert decode_grey_picture(good.jpeg).shape == (240, 320)
    assert good.feature_pixels.shape == (answer.inlier_count, 2)
    assert ((good.feature_pixels > 0) & (good.feature_pixels < [319, 239])).all()
    assert 0.2 <= good.latency_s < 0.4
    assert 0.0 < good.processing_time_s < 5.0
    # The map is drawn under the way, which is drawn where the answers were.
    nodes, true = good.map_view.keyframe_poses, ds.truth_position.values[:, :2]
    assert len(nodes) >= 2
    assert good.map_view.edge_indices[:, :2].max() < len(nodes)
    for drawn in (nodes[:, :2], good.path_points_m):
        off = np.hypot(*(drawn[:, None] - true[None, ::20]).T).min(axis=0)
        assert off.max() < 0.2
    assert all(s.is_standing for s in on_floor)
    assert looked[-1].is_standing  # it has landed, and nothing is wrong with that
    covered = [s for s in looked if s.result is not None and 8.9 < s.result.time_s < 9.5]
    assert covered[-1].warning.startswith("too few points of the floor")
    assert not covered[-1].is_standing
    assert np.mean(decode_grey_picture(covered[-1].jpeg)) < 20


def test_its_recording_is_looked_at_again(flown: tuple[xr.Dataset, list[FlightEvent]], folder: Path) -> None:
    """Pictures, camera and what was told are in ``camera.mcap``, the truth is in the flight beside it."""
    kept = read_pictures(folder / "flight.mcap")
    camera = parse_camera(kept.camera_file_text, "")
    assert camera == load_camera("webcam")
    source = open_picture_source(folder, camera)
    answered = [s for s in SIGHTS if s.result is not None]
    assert abs(source.frame_count - len(answered)) < 30  # on their way when it ended
    frames = [f for f in source.read_frames() if f.time_s < 8.4]
    assert frames[-1].vehicle_estimate.place is not None
    assert source.truth is not None
    found = run_slam(SlamSystem(camera, seed=3), frames)
    assert len(found.time) > 0.8 * len(frames)
    truth = np.stack([np.interp(found.time, source.truth[0], c) for c in source.truth[1].T], axis=1)
    assert np.sqrt(np.mean(np.sum((found.position - truth)[:, :2] ** 2, axis=1))) < 0.06
    # Without what was told with each picture the state in the recording does.
    by_state = read_telemetry_interpolator(folder / "flight.mcap")(np.array([frames[50].time_s]))[0]
    assert by_state.roll == pytest.approx(frames[50].vehicle_estimate.roll, abs=0.02)
    assert by_state.height_m == pytest.approx(frames[50].vehicle_estimate.height_m, abs=0.03)


def test_its_recording_gives_the_same_estimate_again(flown: tuple[xr.Dataset, list[FlightEvent]], folder: Path) -> None:
    """To the bit: each fix is weighed by the covariance that it had in flight, which the file keeps."""
    data = read_recording(folder / "flight.mcap")
    came = np.isfinite(data.measured_position_fix_time.values)
    kept = data.measured_position_fix_variance.values
    assert np.isfinite(kept[came]).all()
    assert np.isnan(kept[~came]).all()
    assert kept[came].max() > 4 * kept[came].min()
    vehicle = replace_fix_by_camera(load_vehicle("mufly-1.1"), load_camera("webcam"))
    again = replay_estimator(
        data, KalmanEstimator(vehicle, load_mission(folder / "hop.toml").world, data.attrs["rate_Hz"])
    )
    assert (np.array([e.position for e in again]) == data.estimated_position.values).all()
    sigma = np.sqrt([e.covariance.diagonal()[:3] for e in again])
    assert (sigma == data.estimated_position_sigma.values).all()


def test_features_lie_where_the_lens_has_them() -> None:
    camera = load_camera("mufly-2.0")
    seen = unproject_pixels(camera, np.array([[40.0, 30.0], [250.0, 180.0]]))
    focal, middle = pinhole_parameters(camera)
    answer = TrackingResult(0.0, True, inlier_pixels=focal * seen + middle)
    assert find_distorted_inlier_pixels(camera, answer) == pytest.approx(np.array([[40, 30], [250, 180]]), abs=1e-3)


def test_what_the_map_is_unsure_of_wanders_in_the_filter() -> None:
    """Not noise: fifteen a second of that would be known to a quarter of it at once."""
    camera = load_camera("mufly-2.0")
    filter_ = KalmanEstimator(replace_fix_by_camera(load_vehicle("mufly-1.1"), camera), World(), 250.0)
    filter_.uses_fix_covariance, filter_.fix_correlation_s = True, 3.0
    settings = filter_.backend.settings
    of_file = float(settings["fix_variance"])

    def hear(time_s: float, sigma: float) -> tuple[float, float]:
        fix = Reading(np.zeros(4), time_s, True, np.diag([sigma**2] * 4))
        filter_.write_input_readings({"position_fix": fix}, time_s + 0.2)
        return math.sqrt(settings["fix_variance"]), float(settings["initial_sigma"][ERROR_FIX_BIAS])

    assert hear(1.0, 0.02) == pytest.approx((math.sqrt(of_file), 0.03))
    noise, wander = hear(6.0, 0.3)  # found again after five seconds, where it believes to be
    assert wander == pytest.approx(0.3)
    assert noise > 2.0
    for k in range(1, 300):
        noise, _ = hear(6.0 + 0.066 * k, 0.3)
    assert noise < 0.02
    assert hear(30.0, 0.02) == pytest.approx((math.sqrt(of_file), 0.03))
    hear(31.0, 0.3)
    filter_.reset()
    assert float(settings["fix_variance"]) == of_file


def _hover_on_results(
    monkeypatch: pytest.MonkeyPatch, make_result: Callable[[float], TrackingResult], fault: str = "",
    long_fit: tuple[complex, float] = (1.0 + 0.0j, math.inf),
) -> tuple[list[tuple[float, Reading]], list[tuple[float, str]]]:  # fmt: skip
    """Hover for 2 s on the results that a stand-in gives for the pictures; return the fixes, and what is reported."""
    answers = []

    class Stub:
        sketch, work_s = MapView(), 0.004

        def __init__(self, camera: Camera, **more: object) -> None: ...
        def send_frame(self, frame: CameraFrame) -> None:
            answers.append(make_result(frame.time_s))

        def receive_result(self) -> TrackingResult:
            return answers.pop(0)

        def close(self) -> None: ...

    monkeypatch.setattr("mufly.flight.fixes.camera_sensor.SlamProcess", Stub)
    sensor = CameraSensor(
        CameraConfig(load_camera("webcam"), camera_faults=(parse_camera_fault(fault),) if fault else ()),
        load_vehicle("mufly-1.1"),
        World(),
        (0.2, -0.1, 0.3),
        1,
    )
    sensor._monitor.long_fit = long_fit
    state = initial_state(position=(0.2, -0.1, -0.8), attitude=(0.0, 0.0, 0.3), rotor_speed=(380.0, 420.0))
    seen: list[tuple[float, Reading]] = []
    news, now = [], 0.0
    x, zero = np.array([0.2, -0.1, -0.8]), np.zeros(3)
    sensor.estimate_source = lambda: (
        Estimate(now, x, zero, np.array([0.0, 0.0, 0.3]), zero, covariance=1e-5 * np.eye(12)),
        0.75,
    )
    for k in range(400):
        now = k * 0.005
        truth = Truth(now, k, state, np.array([0.0, 0.0, 0.3]), np.zeros(3), 11.0, 5.0)
        fix = sensor.read(truth).get("position_fix")
        if fix is not None and (not seen or fix is not seen[-1][1]):
            seen.append((now, fix))
        if said := sensor.take_tracking_report():
            news.append((now, said))
    return seen, news


def _good_result(time_s: float) -> TrackingResult:
    return TrackingResult(time_s, True, "", np.array([0.2, -0.1, -0.8]), 0.3, 1e-4 * np.eye(4))


def test_answers_come_late_with_the_time_of_their_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    seen, news = _hover_on_results(monkeypatch, _good_result, "unplugged@1s")
    late = [t - f.time_s for t, f in seen]
    assert min(late) >= 0.2 - 1e-9
    assert np.mean(late) < 0.25
    assert 8 < len(seen) <= 16
    assert max(f.time_s for _, f in seen) < 1.0
    assert [text for _, text in news] == ["no position from the camera: no pictures arrive"]
    assert news[0][0] < 2.0


def test_a_fault_found_after_the_fixes_have_stopped_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tracking fails at 0.3 s, the fault is found at 1.2 s; the report of the missing fixes comes in between."""

    def track(time_s: float) -> TrackingResult:
        if time_s < 0.3:
            return _good_result(time_s)
        fault = "the camera is upside down" if time_s > 1.2 else ""
        return TrackingResult(time_s, False, fault or "the points scatter too much", camera_fault=fault)

    _, news = _hover_on_results(monkeypatch, track)
    assert [text for _, text in news] == [
        "no position from the camera: the points scatter too much",
        "no position from the camera: the camera is upside down",
    ]
    (stopped_s, _), (found_s, _) = news
    assert 0.8 < stopped_s < 1.2
    assert 1.4 - 1e-9 < found_s < 1.6  # 0.2 s by radio


def test_a_fault_that_leaves_a_position_is_reported_once(monkeypatch: pytest.MonkeyPatch) -> None:
    _, news = _hover_on_results(
        monkeypatch, lambda t: replace(_good_result(t), camera_fault="dirt" if 0.3 < t < 0.9 else "")
    )
    assert [text for _, text in news] == ["camera: dirt"]


def test_a_path_that_contradicts_the_accelerometers_is_refused_without_an_estimate(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fixes, news = _hover_on_results(monkeypatch, _good_result, long_fit=(cmath.exp(0.2j), 0.03))
    assert not fixes
    assert [text for _, text in news] == [
        "no position from the camera: the camera is turned against the accelerometers: check mount.turn"
    ]
    fixes, news = _hover_on_results(monkeypatch, _good_result, long_fit=(cmath.exp(0.2j), 0.05))
    assert fixes
    assert not news


def test_who_wants_a_camera_gets_one_line_without_opencv(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    import_opencv.cache_clear()
    try:
        with pytest.raises(MuflyError, match=r"pip install 'mufly\[vision\]'"):
            fly_mission("mufly-1.1", sensors="fitted", eye=CameraConfig(load_camera("webcam")))
    finally:
        import_opencv.cache_clear()
    with pytest.raises(MuflyError, match="ideal sensors use no pictures"):
        fly_mission("mufly-1.1", eye=CameraConfig(load_camera("webcam")))


def test_a_flight_on_places_from_outside_sends_its_pictures() -> None:
    """Stamped by the vehicle's clock, so that whoever finds places in them need not guess it."""
    sent: list[tuple[float, np.ndarray]] = []

    class Server:
        def publish_picture(self, jpeg: bytes, time_s: float) -> None:
            sent.append((time_s, decode_grey_picture(jpeg)))

        def close(self) -> None:
            sent.clear()

    vehicle, eye = (
        load_vehicle("mufly-1.1"),
        CameraConfig(load_camera("webcam"), camera_faults=(parse_camera_fault("unplugged@0.5s"),)),
    )
    server: Any = Server()
    stream: Any = PictureStreamServer(make_camera(eye, vehicle, World(), 1), server)
    sensor = ExternalFixes(vehicle, stream)
    state = initial_state(position=(0.2, -0.1, -0.8), rotor_speed=(380.0, 420.0))
    for k in range(200):
        assert not sensor.read(Truth(k * 0.005, k, state, np.zeros(3), np.zeros(3), 11.0, 5.0))
    times = np.array([t for t, _ in sent])
    assert 13 <= len(sent) <= 16  # thirty a second, half a second long
    assert np.diff(times) == pytest.approx(1 / 30, abs=0.006)
    assert sent[-1][1].shape == (240, 320)
    assert sent[-1][1].std() > 10
    sensor.close()
    assert not sent
    with pytest.raises(MuflyError, match="pictures have no receiver"):
        Flight(vehicle, "demonstration", eye=eye, outside=True, sensors="fitted")
