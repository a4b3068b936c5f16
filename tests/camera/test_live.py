"""Pictures as they come: our own stream read back, what breaks, and a device at OpenCV's boundary."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mufly.camera import (
    Camera,
    LivePictures,
    StreamServer,
    decode_grey_picture,
    encode_jpeg,
    is_live_source,
    load_camera,
)
from mufly.errors import InputError, MuflyError

CAMERA = load_camera("webcam")
RNG = np.random.default_rng(3)
PICTURES = [encode_jpeg(RNG.integers(0, 255, (240, 320), dtype=np.uint8), 80) for _ in range(3)]


@pytest.fixture
def server() -> Iterator[StreamServer]:
    with StreamServer() as one:
        yield one


def sent(server: StreamServer, pictures: list[bytes], first: int = 0) -> None:
    """Send them one by one, when somebody looks."""
    while not server.client_count:
        time.sleep(0.001)
    for k, jpeg in enumerate(pictures):
        server.publish_picture(jpeg, 5.0 + 0.1 * (first + k))
        time.sleep(0.01)


def in_thread(work: Callable[[], None]) -> threading.Thread:
    thread = threading.Thread(target=work)
    thread.start()
    return thread


def test_what_is_live() -> None:
    assert all(map(is_live_source, ("0", "/dev/video2", "http://cam/stream", "https://cam")))
    assert not any(map(is_live_source, ("flight.avi", "folder", "/tmp/video0")))


def test_a_stream_is_read_with_the_senders_time_or_the_arrivals(server: StreamServer) -> None:
    with (
        LivePictures(server.url, CAMERA, clock="sender", delay_s=0.02) as theirs,
        LivePictures(server.url, CAMERA, delay_s=0.02) as ours,
    ):
        while server.client_count < 2:
            time.sleep(0.001)
        in_thread(lambda: sent(server, PICTURES)).join()
        by_sender, by_arrival = (
            [next(p) for _ in range(3)] for p in (theirs.iterate_pictures(), ours.iterate_pictures())
        )
    assert [t for t, _ in by_sender] == pytest.approx([4.98, 5.08, 5.18])
    assert (by_sender[2][1] == decode_grey_picture(PICTURES[2])).all()
    assert by_arrival[-1][0] == pytest.approx(time.time() - 0.02, abs=0.5)
    assert by_arrival[0][0] < by_arrival[1][0] < by_arrival[2][0]


def test_a_broken_stream_is_opened_again_and_said_once(server: StreamServer) -> None:
    lines: list[str] = []
    port = int(server.url.removesuffix("/stream").rpartition(":")[2])
    with LivePictures(server.url, CAMERA, clock="sender", give_up_s=1.0, say=lines.append) as live:
        some = live.iterate_pictures()
        in_thread(lambda: sent(server, PICTURES[:2])).join()
        assert [next(some)[0], next(some)[0]] == pytest.approx([5.0, 5.1])
        server.close()
        time.sleep(0.05)
        with StreamServer(port=port) as again:
            in_thread(
                lambda: sent(again, [PICTURES[0][:400], encode_jpeg(np.zeros((48, 64), np.uint8), 80), PICTURES[2]], 2)
            ).join()
            assert next(some)[0] == pytest.approx(5.4)
            in_thread(lambda: sent(again, [PICTURES[0]], 0)).join()
            in_thread(lambda: sent(again, [PICTURES[0]], 5)).join()
            assert next(some)[0] == pytest.approx(5.5)
        began = time.monotonic()
        assert list(some) == []
        assert time.monotonic() - began < 2.5
    said = [line.partition("stream: ")[2] for line in lines]
    assert sum("reconnected after" in line for line in said) == 1, said
    assert sum("damaged" in line for line in said) == 1
    assert sum("is not after" in line for line in said) == 1
    assert said[-1].startswith("ended after 1 s")
    assert live.counts.damaged_count == 2
    assert live.counts.reconnect_count == live.counts.out_of_order_count == 1
    assert len(live.counts.describe_losses()) == 3


def test_what_cannot_be_opened_is_one_line(server: StreamServer) -> None:
    for place, why in (
        (server.url + "s", "the server answers 404"),
        ("http://127.0.0.1:9/stream", "refused"),
        (server.url.removesuffix("stream"), "sends text/html, which is not a stream of JPEGs"),
    ):
        with pytest.raises(InputError, match=why):
            LivePictures(place, CAMERA)
    with pytest.raises(InputError, match="/dev/video77: there is no such device; list the cameras"):
        LivePictures("77", CAMERA, opencv=lambda: None)
    with pytest.raises(InputError, match="a camera device sends no time stamps"):
        LivePictures("0", CAMERA, clock="sender", opencv=lambda: None)
    server.publish_picture(encode_jpeg(np.zeros((48, 64), np.uint8), 80), 0.0)
    with pytest.raises(InputError, match="is 64 by 48 pixels"), LivePictures(server.url, CAMERA) as live:
        list(live.iterate_pictures())


def stub(reads: list[Any]) -> Any:
    """OpenCV as far as a device needs it; reads that are errors are raised."""
    state = SimpleNamespace(opened=0, released=0, set={})

    class VideoCapture:
        def __init__(self, name: str, api: int) -> None:
            state.opened += 1

        def isOpened(self) -> bool:
            return True

        def set(self, name: int, value: float) -> None:
            state.set[name] = value

        def read(self) -> tuple[bool, Any]:
            one = reads.pop(0)
            if isinstance(one, Exception):
                raise one
            return one is not None, one

        def release(self) -> None:
            state.released += 1

    return SimpleNamespace(
        VideoCapture=VideoCapture, state=state, CAP_V4L2=200, CAP_PROP_FRAME_WIDTH=3, CAP_PROP_FRAME_HEIGHT=4,
        CAP_PROP_FPS=5, CAP_PROP_BUFFERSIZE=38, COLOR_BGR2GRAY=6, cvtColor=lambda p, _: p[:, :, 1],
    )  # fmt: skip


def test_a_device_by_opencv(tmp_path: Path) -> None:
    """No camera is at hand: what stands in for it is OpenCV's VideoCapture."""
    (tmp_path / "video0").touch()
    colour = np.zeros((240, 320, 3), np.uint8)
    colour[:, :, 1] = 7
    cv2 = stub([colour, colour, None, colour, RuntimeError("driver")])
    lines: list[str] = []

    def watched(camera: Camera) -> list[Any]:
        with LivePictures(str(tmp_path / "video0"), camera, say=lines.append, opencv=lambda: cv2) as live:
            return list(live.iterate_pictures())

    with pytest.raises(MuflyError, match="video0: RuntimeError: driver"):
        watched(CAMERA)
    assert cv2.state.opened == 2  # it was pulled, and put back
    assert cv2.state.set[3] == 320
    assert "reconnected after" in lines[0]
    cv2 = stub([colour, colour, RuntimeError("gone")])
    with (
        LivePictures(str(tmp_path / "video0"), CAMERA, opencv=lambda: cv2) as live,
        pytest.raises(MuflyError, match="gone"),
    ):
        list(live.iterate_pictures())
    assert live.counts.received_count == 2
