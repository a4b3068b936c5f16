"""Recording of a flight's pictures in ``camera.mcap`` beside ``flight.mcap``, as the ground station received them.

Topic ``/camera`` holds JPEGs as ``foxglove.CompressedImage`` (Foxglove shows them; JSON, the picture in base64). Topic
``/camera/told`` holds the vehicle's data for each picture. The camera's file is an attachment. A chunk is written each
second, so a truncated file is readable up to its last whole second.
"""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import orjson

from mufly.camera.camera_model import Camera, load_camera, parse_camera
from mufly.errors import InputError, MuflyError, convert_write_errors
from mufly.logs.mcap import McapWriter, read_mcap
from mufly.logs.mcap_recording import foxglove_time, json_object_schema

PICTURE_RECORDING_FILE_NAME = "camera.mcap"
IMAGE_SCHEMA_NAME = "foxglove.CompressedImage"
_MCAP_CHUNK_DURATION_S = 1.0
_RECORDING_TOPICS = ("/camera", "/camera/told")
_TEXT_TYPE, _NUMBER_TYPE, _INTEGER_TYPE = {"type": "string"}, {"type": "number"}, {"type": "integer"}
_TIME_SCHEMA = json_object_schema({"sec": _INTEGER_TYPE, "nsec": _INTEGER_TYPE}, "time")
_IMAGE_SCHEMA = json_object_schema(
    {
        "timestamp": _TIME_SCHEMA,
        "frame_id": _TEXT_TYPE,
        "data": {**_TEXT_TYPE, "contentEncoding": "base64"},
        "format": _TEXT_TYPE,
    },
    IMAGE_SCHEMA_NAME,
)


class PictureRecorder:
    """Writer of pictures and their data to an MCAP file.

    Parameters
    ----------
    path : Path
        File to write; overwritten.
    camera : str
        Content of the camera's file.
    start_ns : int
        Wall time of the instant 0 (ns since 1970).
    facts : mapping
        Names and texts of metadata: floor, ...

    Raises
    ------
    InputError
        If the file cannot be written.
    """

    def __init__(self, path: Path, camera: str, start_ns: int, facts: Mapping[str, str]) -> None:
        with convert_write_errors(path, "choose another folder"):
            path.parent.mkdir(parents=True, exist_ok=True)
            self._out = path.open("wb")
        self._start_ns, self._waiting, self._due_s = start_ns, list[tuple[int, int, bytes]](), -1e9
        self._path = path
        self._file = McapWriter(self._out, "mufly")
        self._file.write_metadata("mufly.camera", {**facts, "start_ns": str(start_ns)})
        self._file.write_attachment("camera.toml", "text/plain", camera.encode(), start_ns)
        told = orjson.dumps({"title": "mufly.Told", "type": "object"})
        self._image = self._file.add_channel(_RECORDING_TOPICS[0], IMAGE_SCHEMA_NAME, orjson.dumps(_IMAGE_SCHEMA))
        self._told = self._file.add_channel(_RECORDING_TOPICS[1], "mufly.Told", told)

    def add_picture(self, time_s: float, jpeg: bytes, told: Mapping[str, Any]) -> None:
        """Add a picture and the vehicle's data for it; raise MuflyError if the disk is full."""
        if time_s >= self._due_s:
            self._flush_chunk()
            self._due_s = time_s + _MCAP_CHUNK_DURATION_S
        at = self._start_ns + round(time_s * 1e9)
        image = {
            "timestamp": foxglove_time(at),
            "frame_id": "camera",
            "data": base64.b64encode(jpeg).decode(),
            "format": "jpeg",
        }
        self._waiting.append((self._image, at, orjson.dumps(image)))
        self._waiting.append((self._told, at, orjson.dumps(told, option=orjson.OPT_SERIALIZE_NUMPY)))

    def _flush_chunk(self) -> None:
        if not self._waiting:
            return
        try:
            self._file.write_chunk(self._waiting)
        except OSError as error:
            raise MuflyError(f"{self._path}: pictures cannot be written ({error.strerror})") from error
        self._waiting = []

    def close(self) -> None:
        """Write the last chunk and the index."""
        if self._out.closed:
            return
        with suppress(OSError, MuflyError):  # on a full disk, the chunks already written stay readable
            self._flush_chunk()
            self._file.finish_file()
        with suppress(OSError):
            self._out.close()


@dataclass(frozen=True)
class RecordedPictures:
    """Pictures of a camera in a recording.

    Attributes
    ----------
    path : Path
    camera_file_text : str
        Content of the camera's file; "" if it is missing.
    times_s : list of float
        Times on the recording's clock (s).
    frame_infos : list of dict
        Vehicle data passed to :meth:`PictureRecorder.add_picture`; empty if there are none.
    """

    path: Path
    camera_file_text: str
    times_s: list[float]
    frame_infos: list[dict[str, Any]]
    _images: list[bytes]

    def iterate_jpegs(self) -> Iterator[bytes]:
        """Yield the bytes of the pictures.

        Raises
        ------
        InputError
            If a message is no picture.
        """
        for t, content in zip(self.times_s, self._images, strict=True):
            try:
                yield base64.b64decode(orjson.loads(content)["data"])
            except (ValueError, KeyError, TypeError):
                raise InputError(
                    str(self.path),
                    f"picture at {t:.3f} s",
                    "is damaged",
                    "give another copy of the recording",
                ) from None


def read_pictures(path: Path) -> RecordedPictures:
    """Read the pictures of a recording.

    The path may name ``camera.mcap``, the flight beside it, or any MCAP with a topic of ``foxglove.CompressedImage`` in
    JSON.

    Raises
    ------
    InputError
        If there are no pictures.
    """
    beside = path.with_name(PICTURE_RECORDING_FILE_NAME)
    contents = read_mcap(path)
    images = contents.messages_by_topic.get(_RECORDING_TOPICS[0]) or _find_image_messages(contents.messages_by_topic)
    if not images and path.name != PICTURE_RECORDING_FILE_NAME and beside.is_file():
        path, contents = beside, read_mcap(beside)
        images = contents.messages_by_topic.get(_RECORDING_TOPICS[0], [])
    if not images:
        raise InputError(
            str(path),
            "",
            "contains no pictures",
            f"give {PICTURE_RECORDING_FILE_NAME} of a flight on the camera (mufly fly --position camera), or one with "
            f"{IMAGE_SCHEMA_NAME} in JSON",
        )
    facts = contents.metadata.get("mufly.camera", {})
    start_ns = int(facts.get("start_ns", images[0][0]))
    tellings = contents.messages_by_topic.get(_RECORDING_TOPICS[1], [])
    if tellings and not contents.is_complete:  # a picture and its data have the same time
        both = {t for t, _ in images} & {t for t, _ in tellings}
        images, tellings = ([m for m in kind if m[0] in both] for kind in (images, tellings))
    told = [orjson.loads(c) for _, c in tellings]
    count = min(len(images), len(told)) if told else len(images)  # the file may end between the two
    camera = contents.attachments.get("camera.toml", b"").decode()
    times = [(t - start_ns) * 1e-9 for t, _ in images[:count]]
    return RecordedPictures(path, camera, times, told[:count], [c for _, c in images[:count]])


def _find_image_messages(messages: Mapping[str, list[tuple[int, bytes]]]) -> list[tuple[int, bytes]]:
    """Return the messages of the first topic that looks like pictures."""
    for found in messages.values():
        if found and b'"data"' in found[0][1] and b'"format"' in found[0][1]:
            return found
    return []


def load_recording_camera(place: Path, given: str | None = None) -> Camera:
    """Return the camera that took pictures: the one named by ``given`` (name or file), else the one stored with them.

    Raises
    ------
    InputError
        If there are no pictures, or no file describes their camera.
    """
    if not place.exists():
        raise InputError(str(place), "", "no such folder, video or recording", "give one with pictures")
    if given is not None:
        return load_camera(given)
    recording = place / PICTURE_RECORDING_FILE_NAME if place.is_dir() else place
    if recording.suffix == ".mcap" and recording.is_file() and (text := read_pictures(recording).camera_file_text):
        return parse_camera(text, f"{recording}: camera.toml")
    if place.is_dir() and not any(place.iterdir()):
        raise InputError(str(place), "", "is empty", "give a folder with pictures, a video or a recording")
    names = ("camera.toml", "mav0/cam0/sensor.yaml", "cam0/sensor.yaml")
    beside = next((place / name for name in names if (place / name).is_file()), None)
    if beside is None:
        raise InputError(str(place), "camera.toml", "is missing", "give --camera")
    return load_camera(beside)
