"""``mufly slam``: data sets of pictures, visual SLAM over them, and how good it was."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

from mufly.cli.options import Commands, JsonOption, argument, one_of, option
from mufly.cli.present import (
    answer,
    check_folder,
    print_table,
    progress_bar,
    save_picture,
    say,
    writing,
)
from mufly.errors import InputError, MuflyError

if TYPE_CHECKING:
    from mufly.camera import Camera
    from mufly.slam import Answer, Evaluation, Frame

app = Commands(
    help="Visual SLAM with a camera that looks down: run it over pictures, recorded or as they come, evaluate, "
    "calibrate; render data sets, and serve them as a stream. "
    "Equations and what it assumes: docs/slam.md.",
    no_args_is_help=True,
)

_CameraOption = Annotated[
    str,
    option(
        "--camera NAME|FILE",
        "A built-in camera (mufly-2.0, webcam, worst), a camera file (TOML), or a calibration (Kalibr, ROS, ...).",
    ),
]
_HeightOption = Annotated[
    float | None, option("--height", "Height above the floor, where the files do not tell it.", unit="m")
]


@app.command()
def render(
    out: Annotated[Path, option("--out -o DIR", "Folder for the data set.")],
    camera: _CameraOption = "mufly-2.0",
    floor: Annotated[
        str, option("--floor KIND|PICTURE", "rich, poor, tiles, plain, or a picture of a floor.")
    ] = "rich",
    width: Annotated[float, option("--width", "Of a picture of a floor, from west to east.", unit="m")] = 2.0,
    recording: Annotated[
        Path | None, option("--from FILE", "Fly the path of this recording (flight.mcap) instead of rounds.")
    ] = None,
    duration: Annotated[float, option("--duration", "Length of the data set.", unit="s")] = 20.0,
    side: Annotated[float, option("--side", "Of the square that is flown round; 0 hovers.", unit="m")] = 3.0,
    height: Annotated[float, option("--height", "Of the path above the floor.", unit="m")] = 1.0,
    speed: Annotated[float, option("--speed", "Along the path.", unit="m/s")] = 0.4,
    shadows: Annotated[float, option("--shadows", "Of the light that shadows take, 0 to 1.", unit="1")] = 0.3,
    boxes: Annotated[int, option("--boxes N", "Low boxes on the floor.")] = 0,
    layout: Annotated[str, option("--layout NAME", "mufly, euroc or tum.")] = "mufly",
    seed: Annotated[int, option("--seed K", "Same seed, same floor, path and noise.")] = 0,
    as_json: JsonOption = False,
) -> None:
    """Render a data set: pictures of a floor along a path, with what the vehicle tells beside them, and the truth.

    Examples: mufly slam render -o tiles --floor tiles; mufly slam render -o mine --floor parquet.jpg --width 1.2
    --from flights/last/flight.mcap
    """
    from mufly.camera import FLOORS, floor_of_picture, load_camera, make_floor
    from mufly.logs import read_recording
    from mufly.slam import LAYOUTS, frames, path_of, rounds, write_dataset

    one_of("--layout", layout, LAYOUTS)
    for name, value, low, high in (
        ("--duration", duration, 0.1, 3600), ("--side", side, 0, 50), ("--height", height, 0.15, 50),
        ("--speed", speed, 0, 5), ("--shadows", shadows, 0, 1), ("--boxes", boxes, 0, 30), ("--seed", seed, 0, 2**31),
    ):  # fmt: skip
        if not low <= value <= high:
            raise InputError(name, "", f"{value:g} is out of range", f"give {low:g} to {high:g}")
    lens = load_camera(camera)
    if floor in FLOORS:
        ground = make_floor(floor, seed, shadows=shadows)
    elif Path(floor).suffix:
        ground = floor_of_picture(floor, width, seed=seed, shadows=shadows)
    else:
        raise InputError(
            "--floor", "", f"{floor!r} is unknown", f"use one of: {', '.join(FLOORS)}, or a picture"
        )
    if recording is not None:
        path = path_of(read_recording(recording), str(recording))
        duration = min(duration, float(path.time[-1] - path.time[0]))
    else:
        path = rounds(duration_s=duration, side_m=side, height_m=height, speed_m_s=speed, seed=seed)
    check_folder("--out", out)
    made = frames(lens, ground, path, duration_s=duration, world=_boxes(boxes, side, seed), seed=seed)
    total = int(duration / float(lens.sensor.period))
    with writing(out), progress_bar("pictures", not as_json) as bar:
        count = write_dataset(
            out, lens, path, made, layout, (lambda k: None) if bar is None else (lambda k: bar(k + 1, total))
        )
    answer(
        as_json, lambda: {"pictures": count, "floor": ground.name, "camera": lens.name},
        lambda: say(f"{count} pictures of a {ground.name} floor by {lens.name}, layout {layout}"), [out],
    )  # fmt: skip


def _boxes(count: int, side: float, seed: int) -> Any:
    import numpy as np

    from mufly.world import Box, World

    rng = np.random.default_rng([seed, 77])
    out = []
    for _ in range(count):
        size = (*rng.uniform(0.1, 0.35, 2), rng.uniform(0.03, 0.12))
        n, e = rng.uniform(-0.8, side + 0.8, 2)
        out.append(Box((n, e, -0.5 * size[2]), size, rng.uniform(0, 3.1)))
    return World(boxes=tuple(out))


@app.command()
def run(
    place: Annotated[
        str,
        argument(
            "PICTURES",
            "A folder (ours, EuRoC's or TUM's layout), a recording with pictures or its folder, a video, a camera "
            "(/dev/video0) or an MJPEG stream (http://...).",
        ),
    ],
    camera: Annotated[
        str | None,
        option(
            "--camera NAME|FILE", "That made them; by default camera.toml in the folder or the recording."
        ),
    ] = None,
    height: _HeightOption = None,
    telemetry: Annotated[
        Path | None,
        option(
            "--telemetry FILE",
            "Attitude and height out of this recording (or telemetry.csv), at the pictures' times.",
        ),
    ] = None,
    offset: Annotated[
        float, option("--offset", "Of --telemetry: its clock less that of the pictures.", unit="s")
    ] = 0.0,
    rate: Annotated[
        float | None, option("--rate", "Of a video that does not say so itself.", unit="Hz")
    ] = None,
    times: Annotated[
        Path | None,
        option(
            "--times FILE", "Of a video: the time of each picture, one a row; by default NAME.csv beside it."
        ),
    ] = None,
    delay: Annotated[
        float,
        option("--delay", "Of a camera or stream: how much older pictures are than they came.", unit="s"),
    ] = 0.0,
    clock: Annotated[
        str, option("--clock WHICH", "Of a stream: arrival, or sender (its X-Timestamp).")
    ] = "arrival",
    link: Annotated[
        str | None,
        option(
            "--link ENDPOINT",
            "Of a camera or stream: a vehicle's MAVLink (udp:0.0.0.0:14560, serial:DEVICE:BAUD) tells attitude and "
            "height, and is told VISION_POSITION_ESTIMATE.",
        ),
    ] = None,
    give_up: Annotated[
        float,
        option("--give-up", "Of a camera or stream: it has ended when nothing came for so long.", unit="s"),
    ] = 10.0,
    duration: Annotated[
        float | None, option("--duration", "Stop after so long; Ctrl-C stops, too.", unit="s")
    ] = None,
    floor_map: Annotated[
        Path | None, option("--map FILE", "Find yourself in this map, instead of beginning one.")
    ] = None,
    save_map: Annotated[Path | None, option("--save-map FILE", "Keep the map.")] = None,
    out: Annotated[Path | None, option("--out -o DIR", "Trajectory (TUM's text, MCAP) and pictures.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Go through pictures, recorded or as they come: where was the vehicle, and how well is that known?

    With a truth beside them errors are told, too. What was answered before it ends, is stopped or fails is written.

    Examples: mufly slam run tiles -o result; mufly slam run flights/last -o result; mufly slam run film.avi --camera
    camera.toml --telemetry flight.ulg --offset 12.3; mufly slam run /dev/video0 --camera webcam --height 1.2 -o result;
    mufly slam run http://127.0.0.1:8090/stream --camera mufly-2.0 --height 1
    """
    from mufly.camera import LivePictures, is_live, load_camera
    from mufly.cli.station import Ending
    from mufly.link import parse_endpoint
    from mufly.link.companion import CompanionPort
    from mufly.logs import write_log
    from mufly.slam import (
        TOO_NEAR,
        Map,
        Slam,
        draw,
        evaluate,
        open_live,
        open_pictures,
        opencv,
        read_telemetry,
        run,
        standing_at,
    )

    opencv()
    one_of("--clock", clock, ("arrival", "sender"))
    for name, value, most in (("--give-up", give_up, 3600.0), ("--duration", duration, 1e6)):
        if value is not None and not 0.0 < value <= most:
            raise InputError(name, "", f"{value:g} s is out of range", f"give up to {most:g}")
    if link is not None and not is_live(place):
        raise InputError(
            "--link", "", "is for pictures as they come", "give a camera or a stream, or --telemetry"
        )
    told = None if telemetry is None else read_telemetry(telemetry, offset)
    check_folder("--out", out)
    known = None if floor_map is None else Map.load(floor_map)
    with contextlib.ExitStack() as stack:
        ending = Ending(patient=False)
        port: CompanionPort | None = None
        if is_live(place):
            if camera is None:
                raise InputError(place, "", "does not tell of its camera", "give --camera, a name or a file")
            lens = load_camera(camera)
            if told is None and link is None:
                told = standing_at(height, place)
            if link is not None:
                port = CompanionPort(parse_endpoint(link, "station"))
                port.companion.stamped = clock == "sender"
                stack.callback(port.close)
            live = stack.enter_context(LivePictures(
                place, lens, delay_s=delay, clock=cast(Any, clock), give_up_s=give_up,
                say=lambda line: say(line, mark="Note", style="yellow"), opencv=opencv,
            ))  # fmt: skip
            source = open_live(live, port.told if port is not None else cast(Any, told))
        else:
            lens = _camera_of(Path(place), camera)
            source = open_pictures(place, lens, height_m=height, rate_Hz=rate, times=times, told=told)
        truth = source.truth
        start = (0.0, 0.0, 0.0) if truth is None else (*truth[1][0, :2], truth[2][0])
        slam = Slam(lens, known, start=start)
        failed: list[MuflyError] = []
        bar = stack.enter_context(progress_bar("pictures", not as_json))
        stack.enter_context(ending)
        ending.patient = True

        seen: list[Frame] = []

        def frames() -> Iterator[Frame]:
            first = None
            try:
                for frame in source.frames():
                    first = frame.time_s if first is None else first
                    if ending.asked.is_set() or (duration is not None and frame.time_s - first > duration):
                        return
                    seen[:] = [frame]
                    yield frame
            except MuflyError as error:
                failed.append(error)

        def answered(k: int, a: Answer) -> None:
            if port is not None:
                port.say(port.companion.stands(a.time_s, seen[0].told) if a.reason == TOO_NEAR else a)
            if bar is not None:
                bar(k + 1, source.count)

        found = run(slam, frames(), answered)
    if port is not None and not found.pictures and not failed:
        raise InputError(
            "--link", str(link), "no vehicle told attitude and height there", "look at both its ends"
        )
    if failed and len(found.time) < 3:
        raise failed[0]
    if len(found.time) < 3:
        why = max(found.reasons, key=lambda k: found.reasons[k], default="there were none")
        raise InputError(
            place,
            "",
            f"{len(found.time)} of {found.pictures} pictures were answered: {why}",
            "see docs/slam.md",
        )
    result = None
    if truth is not None:
        result = evaluate(found.time, found.position, found.heading, found.covariance, *truth, found.pictures)
    files = []
    if save_map is not None:
        with writing(save_map, "give another file", "--save-map"):
            slam.map.save(save_map)
        files.append(save_map)
    if out is not None:
        with writing(out):
            found.write(out / "trajectory.txt")
        files += [out / "trajectory.txt", write_log(found.dataset(), out / "trajectory.mcap")]
        files.append(save_picture(draw(found, slam, truth), out, "trajectory"))
    missed = live.counted.words() if is_live(place) else []
    content = {
        "pictures": found.pictures, "answered": len(found.time), "not_answered": found.reasons, "missed": missed,
        "keyframes": len(slam.map.keyframes), "closures": sum(e.closes for e in slam.map.edges), "errors": result,
        "stopped_by": str(failed[0]) if failed else "",
    }  # fmt: skip

    def show() -> None:
        say(f"{len(found.time)} of {found.pictures} pictures answered")
        say(f"{content['keyframes']} keyframes, {content['closures']} loops closed")
        say(*(f"  {n} not: {why}" for why, n in sorted(found.reasons.items(), key=lambda r: -r[1])))
        say(*(f"  {line}" for line in missed))
        if result is not None:
            _print(result)

    answer(as_json, lambda: content, show, files)
    if failed:
        raise failed[0]


@app.command()
def serve(
    place: Annotated[Path, argument("VIDEO|FOLDER", "Pictures, as of `mufly slam run`.")],
    camera: Annotated[
        str | None, option("--camera NAME|FILE", "That made them; by default camera.toml in the folder.")
    ] = None,
    at: Annotated[str, option("--stream [HOST:]PORT", "Where.")] = "8090",
    speed: Annotated[float, option("--speed FACTOR", "Times as fast as they were taken.")] = 1.0,
) -> None:
    """Send recorded pictures as an MJPEG stream, each at its time, once somebody looks.

    For trying programs that take a camera's stream: browsers, OpenCV (VideoCapture("http://127.0.0.1:8090/stream")),
    `mufly slam run`. Example: mufly slam render -o rich; mufly slam serve rich
    """
    import time

    from mufly.camera import StreamServer, encode, is_local, parse_address
    from mufly.slam import open_pictures

    if not 0.05 <= speed <= 20.0:
        raise InputError("--speed", "", f"{speed:g} is out of range", "give 0.05 to 20")
    source = open_pictures(place, _camera_of(place, camera), height_m=1.0)
    host, port = parse_address(at)
    with StreamServer(host, port) as server:
        say(f"{source.count} pictures at {server.url}, as soon as somebody looks; Ctrl-C ends it")
        if not is_local(host):
            say(f"anyone who reaches {host}:{port} sees them", mark="Warning", style="yellow")
        try:
            while not server.watchers:
                time.sleep(0.01)
            began, first = time.monotonic(), math.nan
            for frame in source.frames():
                first = frame.time_s if math.isnan(first) else first
                time.sleep(max(0.0, began + (frame.time_s - first) / speed - time.monotonic()))
                server.publish(encode(frame.picture, 95), frame.time_s)
            time.sleep(0.2)
        except KeyboardInterrupt:
            return
    say("all were sent")


def _camera_of(place: Path, given: str | None) -> Camera:
    """The camera of pictures: the one that is given, or that of their folder or recording."""
    from mufly.camera import CAMERA_RECORDING, camera_from, load_camera, read_pictures

    if not place.exists():
        raise InputError(str(place), "", "no such folder, video or recording", "give one with pictures")
    if given is not None:
        return load_camera(given)
    recording = place / CAMERA_RECORDING if place.is_dir() else place
    if recording.suffix == ".mcap" and recording.is_file() and (text := read_pictures(recording).camera):
        return camera_from(text, f"{recording}: camera.toml")
    if place.is_dir() and not any(place.iterdir()):
        raise InputError(str(place), "", "is empty", "give a folder with pictures, a video or a recording")
    names = ("camera.toml", "mav0/cam0/sensor.yaml", "cam0/sensor.yaml")
    beside = next((place / name for name in names if (place / name).is_file()), None)
    if beside is None:
        raise InputError(str(place), "camera.toml", "is not there", "give --camera")
    return load_camera(beside)


@app.command()
def evaluate(
    trajectory: Annotated[Path, argument("FILE", "Trajectory in TUM's text, as `mufly slam run` writes it.")],
    truth: Annotated[Path, argument("FILE|FOLDER", "The truth: TUM's text, or a data set.")],
    offset: Annotated[
        float, option("--offset", "Of the trajectory: its clock less the truth's.", unit="s")
    ] = 0.0,
    as_json: JsonOption = False,
) -> None:
    """Compare a trajectory with the truth: errors, drift, and whether its covariance is true."""
    import numpy as np

    from mufly.slam import evaluate, read_trajectory, read_truth
    from mufly.slam.evaluation import other_axes

    one = read_trajectory(trajectory)
    true = read_truth(truth)
    if true is None:
        raise InputError(str(truth), "", "holds no truth", "give a folder with truth.txt, or a trajectory")
    time = one.time - offset
    covariance = one.covariance if np.isfinite(one.covariance).all() else None
    result = evaluate(time, one.position, one.heading, covariance, *true, one.pictures)
    better = other_axes(time, one.position, true[0], true[1])
    content = {"errors": result, "left_out": one.reasons.get("left out", 0), "other_axes": better}

    def show() -> None:
        _print(result)
        if better:
            said = f"with y and z the other way round it fits better ({better}): are its axes those of the truth? "
            say(
                said + "A comment line tells them: # N-E-D, or # x north, y west, z up",
                mark="Note",
                style="yellow",
            )

    answer(as_json, lambda: content, show)


def _print(e: Evaluation) -> None:
    rows = [
        ("answered", f"{1 - e.lost:.1%}"),
        ("horizontal error, rms (cm)", f"{100 * e.rms_m:.1f}"),
        ("... worst (cm)", f"{100 * e.worst_m:.1f}"),
        ("... at the end (cm)", f"{100 * e.end_m:.1f}"),
        ("height error, rms (cm)", f"{100 * e.height_rms_m:.1f}"),
        ("heading error, rms (deg)", f"{math.degrees(e.heading_rms_rad):.2f}"),
        ("ATE (cm)", f"{100 * e.ate_m:.1f}"),
        ("RPE over 1 s (cm)", f"{100 * e.rpe_m:.1f}"),
        ("way (m)", f"{e.way_m:.1f}"),
        ("NEES/n", "-" if math.isnan(e.nees) else f"{e.nees:.2f}"),
        ("inside the 95 % ellipsoid", "-" if math.isnan(e.inside) else f"{e.inside:.1%}"),
    ]
    print_table(("", ""), rows)


@app.command()
def calibrate(
    pictures: Annotated[Path, argument("FOLDER", "Pictures of a chessboard, from many sides.")],
    board: Annotated[str, option("--board CxR", "Inner corners along both sides.")] = "9x6",
    square: Annotated[float, option("--square", "Side of a square.", unit="m")] = 0.025,
    camera: _CameraOption = "mufly-2.0",
    out: Annotated[
        Path | None, option("--out FILE", "Camera file to write: the lens as found, the rest as given.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Find a camera's lens from pictures of a chessboard."""
    from mufly.camera import load_camera
    from mufly.slam import board_pictures, calibrate, camera_toml

    try:
        columns, rows = (int(n) for n in board.lower().split("x"))
    except ValueError:
        raise InputError("--board", "", f"{board!r} is no board", "give inner corners: 9x6") from None
    lens, files = load_camera(camera), board_pictures(pictures)
    with progress_bar("pictures", not as_json) as bar:
        found = calibrate(files, lens, columns=columns, rows=rows, square_m=square, on_picture=bar)
    if out is not None:
        with writing(out, "give another file"):
            out.write_text(camera_toml(found.camera), encoding="utf-8")

    def show() -> None:
        say(f"{found.used} of {found.of} pictures show the board; residual {found.residual_px:.2f} pixels")
        rows = [(n, f"{found.values[n]:.4g}", f"{found.deviations[n]:.2g}") for n in found.values]
        print_table(("", "found", "sigma"), rows)

    content = {
        "values": found.values,
        "deviations": found.deviations,
        "residual_px": found.residual_px,
        "used": found.used,
    }
    answer(as_json, lambda: content, show, [] if out is None else [out])
