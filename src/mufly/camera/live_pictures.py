"""Live pictures from a camera of this machine (V4L2, by OpenCV) or an MJPEG stream over the network.

A thread reads and time-stamps each picture, so that slow processing does not delay the next one. A consumer slower than
the camera gets the newest picture; skipped ones are counted. A broken stream is reopened, with one line at the break
and one at the reconnection. After :data:`PICTURE_TIMEOUT_S` without a picture the source has ended.

The time of a picture is its arrival less ``delay_s``: half the exposure, readout, coding and transport. The user must
determine this delay, from a clock in the picture or from the lag between gyroscope and picture. Alternatively the
sender's time stamps (``X-Timestamp``) can be used.
"""

from __future__ import annotations

import base64
import http.client
import math
import threading
import time
import urllib.error
import urllib.request
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol
from urllib.parse import unquote, urlsplit, urlunsplit

import numpy as np
from numpy.typing import NDArray

from mufly.camera.camera_model import Camera, check_picture_size
from mufly.camera.mjpeg_stream import iterate_jpeg_parts, parse_boundary
from mufly.camera.renderer import decode_grey_picture
from mufly.errors import InputError, MuflyError

_Picture = NDArray[np.uint8]
PictureClock = Literal["arrival", "sender"]
PICTURE_TIMEOUT_S = 10.0
READ_TIMEOUT_S = 3.0
"""Silence (s) after which a stream counts as broken."""
MAX_QUEUED_PICTURES = 15
"""Length of the queue (pictures): half a second at 30 a second, the time to load compiled code."""
_REOPEN_DELAYS_S = (0.2, 2.0)  # first and longest delay between attempts to reopen


def is_live_source(place: str) -> bool:
    """Return whether a place is a camera or a stream, not a file: ``/dev/video0``, ``0``, ``http://...``."""
    return place.isdecimal() or place.startswith(("/dev/video", "http://", "https://"))


class _PictureSource(Protocol):
    def open(self) -> None: ...
    def read_picture(self) -> tuple[_Picture, float | None] | None: ...
    def close(self) -> None: ...


class DamagedPictureError(ValueError):
    """Error for a picture that cannot be decoded; the stream continues."""


class _MjpegStream:
    """MJPEG stream over HTTP."""

    def __init__(self, url: str) -> None:
        split = urlsplit(url)
        self._headers = {}
        if split.username:
            word = f"{unquote(split.username)}:{unquote(split.password or '')}"
            self._headers["Authorization"] = "Basic " + base64.b64encode(word.encode()).decode()
        self.name = urlunsplit(split._replace(netloc=split.netloc.rpartition("@")[2]))
        self._opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        self._answer: Any = None

    def open(self) -> None:
        try:
            request = urllib.request.Request(self.name, headers=self._headers)
            self._answer = self._opener.open(request, timeout=READ_TIMEOUT_S)
        except urllib.error.HTTPError as error:
            raise OSError(f"the server answers {error.code} {error.reason}") from None
        except urllib.error.URLError as error:
            why = error.reason
            raise OSError(str(getattr(why, "strerror", None) or why)) from None
        except (ValueError, http.client.HTTPException) as error:
            raise OSError(str(error)) from None
        self._parts = iterate_jpeg_parts(
            self._answer, parse_boundary(self._answer.headers.get("Content-Type", ""), self.name)
        )

    def read_picture(self) -> tuple[_Picture, float | None] | None:
        try:
            found = next(self._parts, None)
        except (http.client.HTTPException, ValueError) as error:
            raise OSError(str(error)) from None
        if found is None:
            return None
        try:
            return decode_grey_picture(found[0]), found[1]
        except ValueError as error:
            raise DamagedPictureError(str(error)) from None

    def close(self) -> None:
        if self._answer is not None:
            self._answer.close()
            self._answer = None


class _CameraDevice:
    """Camera of this machine."""

    def __init__(self, place: str, camera: Camera, cv2: Any) -> None:
        self.name = f"/dev/video{place}" if place.isdecimal() else place
        self._camera, self._cv2, self._video = camera, cv2, None

    def open(self) -> None:
        cv2, camera = self._cv2, self._camera
        if not Path(self.name).exists():
            raise OSError("there is no such device")
        video = cv2.VideoCapture(self.name, cv2.CAP_V4L2)
        if not video.isOpened():
            video.release()
            raise OSError(
                "cannot be opened; end other programs that use the camera, and check the "
                "permission to read it (group video)"
            )
        for name, value in (
            (cv2.CAP_PROP_FRAME_WIDTH, camera.sensor.width), (cv2.CAP_PROP_FRAME_HEIGHT, camera.sensor.height),
            (cv2.CAP_PROP_FPS, round(1.0 / float(camera.sensor.period))), (cv2.CAP_PROP_BUFFERSIZE, 1),
        ):  # fmt: skip
            video.set(name, value)
        self._video = video

    def read_picture(self) -> tuple[_Picture, float | None] | None:
        assert self._video is not None
        there, picture = self._video.read()
        if not there:
            return None
        return self._cv2.cvtColor(picture, self._cv2.COLOR_BGR2GRAY) if picture.ndim == 3 else picture, None

    def close(self) -> None:
        if self._video is not None:
            self._video.release()
            self._video = None


@dataclass
class PictureCounts:
    """Counts of a source: pictures received, skipped, damaged, of wrong size or out of order; reconnections."""

    received_count: int = 0
    skipped_count: int = 0
    damaged_count: int = 0
    out_of_order_count: int = 0
    reconnect_count: int = 0

    def describe_losses(self) -> list[str]:
        """Return one line for each kind of loss that occurred."""
        told = (
            (self.skipped_count, "pictures were skipped: processing was slower than the camera"),
            (self.damaged_count, "pictures were damaged, or of another size"),
            (self.out_of_order_count, "pictures had times not later than the previous picture"),
            (self.reconnect_count, "times the stream was interrupted and reconnected"),
        )
        return [f"{n} {text}" for n, text in told if n]


class LivePictures:
    """Pictures of a camera or a stream, with their times.

    Parameters
    ----------
    place : str
        A place for which :func:`is_live_source` holds.
    camera : Camera
        Camera that takes the pictures.
    delay_s : float
        Time from exposure to arrival (s).
    clock : "arrival" or "sender"
        Clock of the times; that of arrival counts from 1970.
    give_up_s : float
        Time without pictures (s) after which the source has ended.
    say : callable
        Called with a line of text when the source breaks, and when it is back.
    opencv : callable
        Returns the module OpenCV, for devices.

    Attributes
    ----------
    counts : PictureCounts

    Raises
    ------
    InputError
        If the source cannot be opened, or is no stream of pictures.
    """

    def __init__(
        self, place: str, camera: Camera, *, delay_s: float = 0.0, clock: PictureClock = "arrival",
        give_up_s: float = PICTURE_TIMEOUT_S, say: Callable[[str], None] = lambda line: None,
        opencv: Callable[[], Any] | None = None,
    ) -> None:  # fmt: skip
        if not 0.0 <= delay_s <= 5.0:
            raise InputError("--delay", "", f"{delay_s:g} s is out of range", "give 0 to 5 s")
        device = not place.startswith("http")
        if device and clock == "sender":
            raise InputError("--clock", "", "a camera device sends no time stamps", "omit it, and give --delay")
        self._camera, self._delay_s, self._clock = camera, delay_s, clock
        self._give_up_s, self._say = give_up_s, say
        assert not device or opencv is not None
        self._source: _PictureSource
        own = _CameraDevice(place, camera, opencv()) if device and opencv is not None else _MjpegStream(place)
        self._source, self.name = own, own.name
        self.counts = PictureCounts()
        self._ready: deque[tuple[float, _Picture]] = deque()
        self._change = threading.Condition()
        self._ended = False
        self._error: MuflyError | None = None
        self._broken, self._told, self._seen_s = "", False, time.monotonic()
        self._offset_s = time.time() - time.monotonic()
        try:
            self._source.open()
        except OSError as error:
            remedy = "check address and cable" if not device else "list the cameras: ls /dev/video*"
            raise InputError(self.name, "", str(error), remedy) from None
        self._thread = threading.Thread(target=self._read_loop, name="pictures", daemon=True)
        self._thread.start()

    def iterate_pictures(self) -> Iterator[tuple[float, _Picture]]:
        """Yield time (s) and picture until the source ends.

        Raises
        ------
        InputError
            If the pictures do not have the camera's size.
        """
        while True:
            with self._change:
                while not self._ready and not self._ended:
                    self._change.wait(0.2)
                if not self._ready:
                    break
                one = self._ready.popleft()
            yield one
        if self._error is not None:
            raise self._error

    def close(self) -> None:
        """Stop reading; queued pictures remain available."""
        with self._change:
            self._ended = True
            self._change.notify_all()

    def __enter__(self) -> LivePictures:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()
        self._thread.join(0.2)  # a silent stream ends at its timeout

    # Methods of the reading thread

    def _read_loop(self) -> None:
        last_s = math.nan
        try:
            while not self._ended:
                why = "it ended"
                try:
                    while not self._ended and (found := self._read_next()) is not None:
                        last_s = self._accept_picture(*found, last_s)
                except OSError as error:
                    why = "it sends nothing" if isinstance(error, TimeoutError) else str(error)
                self._source.close()
                if not self._ended and not self._reopen_source(why):
                    break
        except MuflyError as error:
            self._error = error
        except Exception as error:  # drivers may raise anything; the caller must still be able to finish its files
            self._error = MuflyError(f"{self.name}: {type(error).__name__}: {error}")
        finally:
            self._source.close()
            self.close()

    def _read_next(self) -> tuple[_Picture | None, float | None, float] | None:
        """Return the next picture (None if it is damaged), its stamp and its arrival time (s); None at the end."""
        try:
            found = self._source.read_picture()
        except DamagedPictureError as error:
            self._count_damaged(f"it is damaged: {error}", 0.0)
            return None, None, time.monotonic()
        return None if found is None else (*found, time.monotonic())

    def _count_damaged(self, why: str, last_s: float) -> float:
        if not self.counts.damaged_count:
            self._say(f"{self.name}: a picture is skipped, {why}")
        self.counts.damaged_count += 1
        return last_s

    def _accept_picture(self, picture: _Picture | None, stamp: float | None, came_s: float, last_s: float) -> float:
        if picture is None:
            return last_s
        self._mark_received(came_s)
        if self.counts.received_count:
            try:
                check_picture_size(self._camera, picture.shape, self.name)
            except InputError as error:
                return self._count_damaged(f"it {error.problem}", last_s)
        else:
            check_picture_size(self._camera, picture.shape, self.name)
        self.counts.received_count += 1
        if self._clock == "sender":
            if stamp is None:
                raise InputError(self.name, "", "sends no time stamps (X-Timestamp)", "leave out --clock sender")
            when_s = stamp - self._delay_s
        else:
            when_s = came_s + self._offset_s - self._delay_s
        if when_s <= last_s:
            if not self.counts.out_of_order_count:
                self._say(f"{self.name}: a picture is skipped, its time {when_s:.3f} s is not after {last_s:.3f} s")
            self.counts.out_of_order_count += 1
            return last_s
        with self._change:
            self._ready.append((when_s, picture))
            if len(self._ready) > MAX_QUEUED_PICTURES:
                self._ready.popleft()
                self.counts.skipped_count += 1
            self._change.notify_all()
        return when_s

    def _reopen_source(self, why: str) -> bool:
        """Reopen the source; return False after too long without a picture."""
        wait_s = _REOPEN_DELAYS_S[0]
        if not self._broken:
            self._broken = why
        while not self._ended and time.monotonic() - self._seen_s < self._give_up_s:
            try:
                self._source.open()
                return True
            except OSError as error:
                if not self._told:
                    self._say(f"{self.name}: broken ({why}; {error}); trying again for {self._give_up_s:g} s")
                    self._told = True
                left = self._seen_s + self._give_up_s - time.monotonic()
                with self._change:
                    self._change.wait(max(0.0, min(wait_s, left)))
                wait_s = min(2.0 * wait_s, _REOPEN_DELAYS_S[1])
        if not self._ended:
            self._say(f"{self.name}: ended after {self._give_up_s:g} s without a picture ({self._broken})")
        return False

    def _mark_received(self, now_s: float) -> None:
        """Note the arrival of a picture, and report a reconnection."""
        if self._broken:
            self.counts.reconnect_count += 1
            self._say(f"{self.name}: was interrupted ({self._broken}), reconnected after {now_s - self._seen_s:.1f} s")
        self._broken, self._told, self._seen_s = "", False, now_s
