"""``mufly slam``: data sets of pictures, visual SLAM over them, and its errors."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

from mufly.cli.options import CommandGroup, JsonOption, SeedOption, define_argument, define_option
from mufly.cli.output import (
    check_output_place,
    print_answer,
    print_lines,
    progress_bar,
    save_figure,
    write_text_file,
)
from mufly.errors import InputError, MuflyError, convert_write_errors
from mufly.results import make_lines_block, select_fields, tabulate_results

if TYPE_CHECKING:
    from mufly.slam import CameraFrame, TrackingResult

app = CommandGroup(
    help="Run visual SLAM with a downward camera on recorded or live pictures; evaluate and calibrate it; "
    "render data sets, and serve them as a stream. "
    "Equations and assumptions: docs/explanation/slam.md.",
    no_args_is_help=True,
)

_CameraOption = Annotated[
    str,
    define_option(
        "--camera NAME|FILE",
        "Camera: a built-in one (mufly-2.0, webcam, worst), a camera file (TOML), or a calibration (Kalibr, ROS, ...).",
    ),
]
_HeightOption = Annotated[
    float | None,
    define_option("--height", "Height above the floor, where the files do not state it.", unit="m"),
]


@app.command()
def render(
    out: Annotated[Path, define_option("--out -o DIR", "Folder for the data set.")],
    camera: _CameraOption = "mufly-2.0",
    floor: Annotated[
        str,
        define_option(
            "--floor NAME|PICTURE",
            "Floor: rich, poor, tiles, plain, a name of `mufly slam floors`, or a picture file.",
        ),
    ] = "rich",
    floor_width: Annotated[
        float | None,
        define_option(
            "--floor-width --width",
            "Width of the floor's picture, from west to east. Default: that of floors.toml beside it, or 2 m.",
            unit="m",
        ),
    ] = None,
    recording: Annotated[
        Path | None,
        define_option("--from FILE", "Recording (flight.mcap) whose path is flown, instead of rounds of a square."),
    ] = None,
    motion: Annotated[
        Literal["square", "hand"],
        define_option(
            "--motion WHICH",
            "Motion: rounds of a square, or by hand with still rotors and the errors of a small inertial unit.",
        ),
    ] = "square",
    duration: Annotated[float, define_option("--duration", "Length of the data set.", unit="s")] = 20.0,
    side: Annotated[float, define_option("--side", "Side of the square that is flown; 0 hovers.", unit="m")] = 3.0,
    height: Annotated[float, define_option("--height", "Height of the path above the floor.", unit="m")] = 1.0,
    speed: Annotated[float, define_option("--speed", "Speed along the path.", unit="m/s")] = 0.4,
    shadows: Annotated[
        float, define_option("--shadows", "Darkness of the shadows: share of the light removed, 0 to 1.", unit="1")
    ] = 0.3,
    light: Annotated[
        float,
        define_option("--light", "Light of the room over that of the camera's file, 0.001 to 1.", unit="1"),
    ] = 1.0,
    boxes: Annotated[int, define_option("--boxes N", "Number of low boxes on the floor.")] = 0,
    layout: Annotated[
        Literal["mufly", "euroc", "tum"], define_option("--layout NAME", "Layout of the folder: mufly, euroc or tum.")
    ] = "mufly",
    seed: SeedOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Render a data set: pictures of a floor along a path, with the vehicle's telemetry and the truth.

    Examples: mufly slam render -o tiles --floor tiles; mufly slam render -o mine --floor parquet.jpg --floor-width 1.2
    --from flights/last/flight.mcap
    """
    from mufly.camera import find_floor, load_camera
    from mufly.logs import read_recording
    from mufly.slam import (
        make_square_path,
        path_from_recording,
        render_frames,
        write_dataset,
    )
    from mufly.slam.datasets.dataset_writers import ideal_imu_rows
    from mufly.slam.datasets.synthetic_datasets import add_imu_errors, make_handheld_path, scatter_boxes

    for name, value, low, high in (
        ("--duration", duration, 0.1, 3600), ("--side", side, 0, 50), ("--height", height, 0.15, 50),
        ("--speed", speed, 0, 5), ("--shadows", shadows, 0, 1), ("--light", light, 0.001, 1),
        ("--boxes", boxes, 0, 30), ("--seed", seed, 0, 2**31),
    ):  # fmt: skip
        if not low <= value <= high:
            raise InputError(name, "", f"{value:g} is out of range", f"give {low:g} to {high:g}")
    lens = load_camera(camera)
    ground = find_floor(floor, floor_width).make_floor(seed, shadows)
    if recording is not None:
        path = path_from_recording(read_recording(recording), str(recording))
        duration = min(duration, float(path.time_s[-1] - path.time_s[0]))
    elif motion == "hand":
        path = make_handheld_path(duration_s=duration, height_m=height, seed=seed)
    else:
        path = make_square_path(duration_s=duration, side_m=side, height_m=height, speed_m_s=speed, seed=seed)
    check_output_place("--out", out)
    made = render_frames(
        lens,
        ground,
        path,
        duration_s=duration,
        world=scatter_boxes(boxes, side, seed),
        seed=seed,
        light=lambda t: light,
    )
    total = int(duration / float(lens.sensor.period))
    with convert_write_errors("--out", key=str(out)), progress_bar("pictures", not as_json) as bar:
        count = write_dataset(
            out, lens, path, made, layout, (lambda k: None) if bar is None else (lambda k: bar(k + 1, total)),
            add_imu_errors(ideal_imu_rows(path), seed) if motion == "hand" and recording is None else None,
        )  # fmt: skip
    print_answer(
        as_json, {"pictures": count, "floor": ground.name, "camera": lens.name},
        lambda: print_lines(f"{count} pictures of a {ground.name} floor by {lens.name}, layout {layout}"), [out],
    )  # fmt: skip


@app.command()
def floors(
    out: Annotated[
        Path | None,
        define_option("--out -o DIR", "Folder to which to copy the pictures, with floors.toml for width and licence."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """List the floors for `--floor`: generated ones, and photographs from installed packages.

    Photographs are not part of mufly. `pip install 'mufly\\[floors]'` installs scikit-image, with brick, grass and
    gravel; miniworld and robosuite have more. Their widths are estimates.

    Example: mufly slam floors -o floors; mufly fly --position camera --floor floors/gravel.png
    """
    from mufly.camera import FLOOR_KINDS, PACKAGE_FLOORS, copy_package_floors

    check_output_place("--out", out)
    written = [] if out is None else copy_package_floors(out)
    keys = "name width_m package licence installed"
    rows = [select_fields(floor, keys) for floor in PACKAGE_FLOORS.values()]
    content = {"generated": list(FLOOR_KINDS), "pictures": rows, "written": [f.name for f in written]}
    blocks = (make_lines_block(f"generated: {', '.join(FLOOR_KINDS)}"), tabulate_results(rows, keys.split()))
    print_answer(as_json, content, blocks, [] if out is None else [out])


@app.command()
def run(
    place: Annotated[
        str,
        define_argument(
            "PICTURES",
            "Pictures: a folder (mufly's, EuRoC's or TUM's layout), a recording or its folder, a video, a "
            "camera (/dev/video0) or an MJPEG stream (http://...).",
        ),
    ],
    camera: Annotated[
        str | None,
        define_option(
            "--camera NAME|FILE", "Camera that took the pictures. Default: camera.toml in the folder or the recording."
        ),
    ] = None,
    height: _HeightOption = None,
    telemetry: Annotated[
        Path | None,
        define_option(
            "--telemetry FILE",
            "Recording (or telemetry.csv) with attitude and height, interpolated at the pictures' times.",
        ),
    ] = None,
    offset: Annotated[
        float, define_option("--offset", "Clock of --telemetry minus the clock of the pictures.", unit="s")
    ] = 0.0,
    rate: Annotated[
        float | None, define_option("--rate", "Picture rate of a video. Default: the video's own.", unit="Hz")
    ] = None,
    times: Annotated[
        Path | None,
        define_option("--times FILE", "Table of a video's picture times, one a row. Default: NAME.csv beside it."),
    ] = None,
    delay: Annotated[
        float,
        define_option("--delay", "Latency of a camera or stream, from exposure to arrival.", unit="s"),
    ] = 0.0,
    clock: Annotated[
        Literal["arrival", "sender"],
        define_option("--clock WHICH", "Time stamps of a stream: arrival, or sender (its X-Timestamp)."),
    ] = "arrival",
    link: Annotated[
        str | None,
        define_option(
            "--link ENDPOINT",
            "MAVLink endpoint of a vehicle (udp:0.0.0.0:14560, serial:DEVICE:BAUD), which sends attitude "
            "and height and receives VISION_POSITION_ESTIMATE; for a camera or stream.",
        ),
    ] = None,
    give_up: Annotated[
        float,
        define_option("--give-up", "Time without pictures after which a camera or stream has ended.", unit="s"),
    ] = 10.0,
    duration: Annotated[
        float | None,
        define_option(
            "--duration", "Time after which to stop; Ctrl-C stops as well. Default: the end of the pictures.", unit="s"
        ),
    ] = None,
    floor_map: Annotated[
        Path | None, define_option("--map FILE", "Map file in which to localise. Default: a new map.")
    ] = None,
    save_map: Annotated[Path | None, define_option("--save-map FILE", "Map file to write.")] = None,
    out: Annotated[
        Path | None, define_option("--out -o DIR", "Folder for the trajectory (TUM's text, MCAP) and pictures.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Estimate the vehicle's trajectory, with its covariance, from recorded or live pictures.

    If the data set holds the truth, errors are reported. The trajectory up to a stop or a failure is written.

    Examples:

      mufly slam run tiles -o result

      mufly slam run film.avi --camera camera.toml --telemetry flight.ulg --offset 12.3

      mufly slam run /dev/video0 --camera webcam --height 1.2 -o result

      mufly slam run http://127.0.0.1:8090/stream --camera mufly-2.0 --height 1
    """
    from mufly.camera import LivePictures, is_live_source, load_camera, load_recording_camera
    from mufly.cli.station import ShutdownHandler
    from mufly.link import parse_endpoint
    from mufly.link.companion import CompanionPort
    from mufly.logs import write_log
    from mufly.slam import (
        TOO_NEAR_REASON,
        FloorMap,
        SlamSummary,
        SlamSystem,
        evaluate_trajectory,
        import_opencv,
        make_estimate_function_from_height,
        open_live_pictures,
        open_picture_source,
        plot_trajectory,
        read_telemetry_interpolator,
        require_picture_overlap,
        run_slam,
    )

    import_opencv()
    for name, value, most in (("--give-up", give_up, 3600.0), ("--duration", duration, 1e6)):
        if value is not None and not 0.0 < value <= most:
            raise InputError(name, "", f"{value:g} s is out of range", f"give up to {most:g} s")
    if link is not None and not is_live_source(place):
        raise InputError("--link", "", "is for live pictures", "give a camera or a stream, or --telemetry")
    told = None if telemetry is None else read_telemetry_interpolator(telemetry, offset)
    check_output_place("--out", out)
    known = None if floor_map is None else FloorMap.load(floor_map)
    with contextlib.ExitStack() as stack:
        ending = ShutdownHandler(patient=False)
        port: CompanionPort | None = None
        if is_live_source(place):
            if camera is None:
                raise InputError(place, "", "does not name its camera", "give --camera, a name or a file")
            lens = load_camera(camera)
            if told is None and link is None:
                told = make_estimate_function_from_height(height, place)
            if link is not None:
                port = CompanionPort(parse_endpoint(link, "station"))
                port.companion.has_sender_stamps = clock == "sender"
                stack.callback(port.close)
            live = stack.enter_context(LivePictures(
                place, lens, delay_s=delay, clock=clock, give_up_s=give_up,
                say=lambda line: print_lines(line, mark="Note", style="yellow"), opencv=import_opencv,
            ))  # fmt: skip
            source = open_live_pictures(live, port.frame_infos_at if port is not None else cast(Any, told))
        else:
            lens = load_recording_camera(Path(place), camera)
            source = open_picture_source(place, lens, height_m=height, rate_Hz=rate, times=times, told=told)
            source.check_picture_interval()
        truth = source.truth
        start = (0.0, 0.0, 0.0) if truth is None else (*truth[1][0, :2], truth[2][0])
        slam = SlamSystem(lens, known, start=start)
        failed: list[MuflyError] = []
        bar = stack.enter_context(progress_bar("pictures", not as_json))
        stack.enter_context(ending)
        ending.waits_for_loop = True

        seen: list[CameraFrame] = []

        def iterate_frames() -> Iterator[CameraFrame]:
            first = None
            try:
                for frame in source.read_frames():
                    first = frame.time_s if first is None else first
                    if ending.stop_requested.is_set() or (duration is not None and frame.time_s - first > duration):
                        return
                    seen[:] = [frame]
                    yield frame
            except MuflyError as error:
                failed.append(error)

        def pass_on_result(k: int, a: TrackingResult) -> None:
            if port is not None:
                port.send_position(
                    port.companion.stationary_result(a.time_s, seen[0].vehicle_estimate)
                    if a.reason == TOO_NEAR_REASON
                    else a
                )
            if bar is not None:
                bar(k + 1, source.frame_count)

        found = run_slam(slam, iterate_frames(), pass_on_result)
    if port is not None and not found.pictures and not failed:
        raise InputError("--link", str(link), "received no attitude and height", "check both ends of the link")
    if failed and len(found.time) < 3:
        raise failed[0]
    if not failed and found.pictures:
        require_picture_overlap(source, len(found.time) / found.pictures)
    if len(found.time) < 3:
        why = max(found.failure_reason_counts, key=lambda k: found.failure_reason_counts[k], default="there were none")
        raise InputError(
            place,
            "",
            f"{len(found.time)} of {found.pictures} pictures have a position: {why}",
            "see docs/explanation/slam.md",
        )
    result = None
    if truth is not None:
        result = evaluate_trajectory(
            found.time, found.position, found.heading, found.covariance, *truth, found.pictures
        )
    files = []
    if save_map is not None:
        with convert_write_errors("--save-map", "give another file", str(save_map)):
            slam.floor_map.save(save_map)
        files.append(save_map)
    if out is not None:
        with convert_write_errors("--out", key=str(out)):
            found.write_tum_file(out / "trajectory.txt")
        files += [out / "trajectory.txt", write_log(found.to_dataset(), out / "trajectory.mcap")]
        files.append(save_figure(plot_trajectory(found, slam, truth), out, "trajectory"))
    summary = SlamSummary(
        found, live.counts.describe_losses() if is_live_source(place) else [], len(slam.floor_map.keyframes),
        sum(e.is_loop_closure for e in slam.floor_map.edges), slam.camera_verdicts, result,
        str(failed[0]) if failed else "",
    )  # fmt: skip
    print_answer(as_json, summary, files=files)
    if failed:
        raise failed[0]


@app.command()
def serve(
    place: Annotated[Path, define_argument("VIDEO|FOLDER", "Pictures, as for `mufly slam run`.")],
    camera: Annotated[
        str | None,
        define_option("--camera NAME|FILE", "Camera that took the pictures. Default: camera.toml in the folder."),
    ] = None,
    at: Annotated[
        str, define_option("--stream [HOST:]PORT", "Address of the stream; port alone: this machine only.")
    ] = "8090",
    speed: Annotated[
        float, define_option("--speed FACTOR", "Speed relative to that at which the pictures were taken.")
    ] = 1.0,
) -> None:
    """Send recorded pictures as an MJPEG stream in real time; the stream starts when the first viewer connects.

    For testing programs that read a camera's stream: browsers, OpenCV (VideoCapture("http://127.0.0.1:8090/stream")),
    `mufly slam run`. Example: mufly slam render -o rich; mufly slam serve rich
    """
    import time

    from mufly.camera import StreamServer, encode_jpeg, is_local_host, load_recording_camera, parse_address
    from mufly.slam import open_picture_source

    if not 0.05 <= speed <= 20.0:
        raise InputError("--speed", "", f"{speed:g} is out of range", "give 0.05 to 20")
    source = open_picture_source(place, load_recording_camera(place, camera), height_m=1.0)
    host, port = parse_address(at)
    with StreamServer(host, port) as server:
        print_lines(f"{source.frame_count} pictures at {server.url}, from the first viewer on; Ctrl-C ends the stream")
        if not is_local_host(host):
            print_lines(
                f"the pictures are open to every program that can reach {host}:{port}", mark="Warning", style="yellow"
            )
        try:
            while not server.client_count:
                time.sleep(0.01)
            began, first = time.monotonic(), math.nan
            for frame in source.read_frames():
                first = frame.time_s if math.isnan(first) else first
                time.sleep(max(0.0, began + (frame.time_s - first) / speed - time.monotonic()))
                server.publish_picture(encode_jpeg(frame.picture, 95), frame.time_s)
            time.sleep(0.2)
        except KeyboardInterrupt:
            return
    print_lines("All pictures were sent.")


@app.command()
def evaluate(
    trajectory: Annotated[
        Path, define_argument("FILE", "Trajectory in TUM's text format, as `mufly slam run` writes it.")
    ],
    truth: Annotated[
        Path, define_argument("FILE|FOLDER", "Ground truth: a trajectory in TUM's text format, or a data set.")
    ],
    offset: Annotated[
        float, define_option("--offset", "Clock of the trajectory minus the clock of the truth.", unit="s")
    ] = 0.0,
    as_json: JsonOption = False,
) -> None:
    """Compare a trajectory with the truth: errors, drift, and consistency of its covariance."""
    import numpy as np

    from mufly.slam import evaluate_trajectory, read_trajectory, read_truth_trajectory
    from mufly.slam.trajectory_evaluation import find_better_fitting_axes

    one = read_trajectory(trajectory)
    true = read_truth_trajectory(truth)
    if true is None:
        raise InputError(str(truth), "", "contains no truth", "give a folder with truth.txt, or a trajectory")
    time = one.time - offset
    covariance = one.covariance if np.isfinite(one.covariance).all() else None
    result = evaluate_trajectory(time, one.position, one.heading, covariance, *true, one.pictures)
    better = find_better_fitting_axes(time, one.position, true[0], true[1])
    content = {"errors": result, "left_out": one.failure_reason_counts.get("left out", 0), "other_axes": better}
    note = (
        f"with y and z inverted it fits better ({better}); its axes may differ from the truth's. A comment line states "
        "them: # N-E-D, or # x north, y west, z up"
    )
    blocks = (*result.make_printed_blocks(), make_lines_block(*[note] if better else [], mark="Note", style="yellow"))
    print_answer(as_json, content, blocks)


@app.command()
def calibrate(
    pictures: Annotated[
        Path,
        define_argument(
            "FOLDER", "Folder with pictures of a chessboard, or (--by hand) of a floor with imu.csv (mufly, EuRoC)."
        ),
    ],
    by: Annotated[
        Literal["board", "hand"],
        define_option(
            "--by WHICH",
            "Method: a chessboard for the lens, or a motion by hand over a floor for focal length, mount and delay.",
        ),
    ] = "board",
    board: Annotated[str, define_option("--board CxR", "Inner corners of the board along both sides, as 9x6.")] = "9x6",
    square: Annotated[float, define_option("--square", "Side of a square of the board.", unit="m")] = 0.025,
    height: _HeightOption = None,
    camera: Annotated[
        str | None,
        define_option(
            "--camera NAME|FILE",
            "Camera that supplies the initial and all other values. Default: mufly-2.0; by hand: camera.toml in the "
            "folder.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        define_option("--out FILE", "Camera file to write, with the values found and the rest of --camera."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Calibrate a camera: the lens by pictures of a chessboard, or mount, delay and focal length from a motion by hand.

    By hand: take the vehicle, rotors off, hold it 0.3 to 1.5 m over a level floor with texture, and turn it by 20
    degrees about all axes for 60 s. Heights come from sonar.csv or --height.

    Examples:

      mufly slam calibrate boards --board 9x6 --out lens.toml

      mufly slam calibrate turned --by hand --camera lens.toml --out camera.toml
    """
    from mufly.camera import load_camera, load_recording_camera
    from mufly.slam import calibrate_lens, format_camera_toml, list_board_pictures
    from mufly.slam.calibration.hand_calibration import calibrate_from_folder

    if by == "hand":
        initial = load_recording_camera(pictures, camera)
        with progress_bar("pictures", not as_json) as bar:
            held = calibrate_from_folder(pictures, initial, height_m=height, on_picture=bar)
        if out is not None:
            write_text_file(out, format_camera_toml(held.camera), "give another file")
        print_answer(as_json, held, files=[] if out is None else [out])
        return
    try:
        columns, rows = (int(n) for n in board.lower().split("x"))
    except ValueError:
        raise InputError("--board", "", f"{board!r} is not a board size", "give inner corners: 9x6") from None
    lens, files = load_camera(camera or "mufly-2.0"), list_board_pictures(pictures)
    with progress_bar("pictures", not as_json) as bar:
        found = calibrate_lens(files, lens, columns=columns, rows=rows, square_m=square, on_picture=bar)
    if out is not None:
        write_text_file(out, format_camera_toml(found.camera), "give another file")

    print_answer(as_json, found, files=[] if out is None else [out])
