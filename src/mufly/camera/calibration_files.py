"""Conversion of calibrations by Kalibr, ROS camera_info, OpenCV, EuRoC, ORB-SLAM, VINS and COLMAP to camera files.

A calibration holds the picture size, the pinhole parameters and the distortion. The other tables of a camera file
(period, mount, shutter, quality, radio) come from a built-in camera. The distortion must be Brown's (radtan, plumb_bob,
OPENCV), with k1, k2, p1, p2 and k3 as in :mod:`mufly.camera.camera_model`; other models are refused by name.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from typing import Any
from xml.etree import ElementTree

from mufly.errors import InputError

_RADIAL_TANGENTIAL_LENS_NAMES = (
    "",
    "none",
    "radtan",
    "radial-tangential",
    "plumb_bob",
    "brown",
    "brown-conrady",
    "opencv",
    "pinhole",
)
_PINHOLE_CAMERA_NAMES = ("", "pinhole", "plumb_bob", "perspective", "mono")
_UNSUPPORTED_LENS_REMEDY = "undistort the pictures to a pinhole model, or calibrate the lens: mufly slam calibrate"
_YAML_KEY_PATTERN = re.compile(r"(\s*)(?:- )?([A-Za-z_][\w.\-]*|\"[^\"]+\")\s*:(?:\s+(.*))?$")
_DISTORTION_NAMES = ("k1", "k2", "p1", "p2", "k3")
_INTRINSIC_NAMES = ("fx", "fy", "cx", "cy")
# For each COLMAP model, the indices of f_x, f_y, c_x, c_y and the distortion coefficients.
_COLMAP_PARAMETER_ORDER = {
    "SIMPLE_PINHOLE": (0, 0, 1, 2), "PINHOLE": (0, 1, 2, 3), "SIMPLE_RADIAL": (0, 0, 1, 2, 3),
    "RADIAL": (0, 0, 1, 2, 3, 4), "OPENCV": (0, 1, 2, 3, 4, 5, 6, 7),
}  # fmt: skip


def convert_foreign_calibration(text: str, where: str, rest: Mapping[str, Any]) -> tuple[dict[str, Any], str]:
    """Convert another program's calibration to the tables of a camera file; return them and the program's name.

    Parameters
    ----------
    text : str
        Content of the calibration: YAML, JSON, XML, or COLMAP's ``cameras.txt``.
    where : str
        Name of the file for error messages.
    rest : mapping
        Tables of the camera that supplies the values a calibration lacks.

    Raises
    ------
    InputError
        If the text is none of these calibrations, or its lens has another model.
    """
    if (line := _find_colmap_line(text)) is not None:
        whose, size, focus, distortion, rate = "COLMAP's cameras", *_parse_colmap_line(line, where), 0.0
    else:
        whose, size, focus, distortion, rate = _parse_calibration(dict(_flatten_calibration_text(text, where)), where)
    lens = dict(zip(("focal_x", "focal_y", "centre_x", "centre_y"), focus, strict=True))
    lens |= dict(zip(_DISTORTION_NAMES, distortion, strict=False))
    known = {"unit": "1", "source": "measured"}
    tables = {
        **rest,
        "name": "calibrated",
        "description": f"{whose}; all but lens and size as {rest['name']}",
    }
    tables["lens"] = {name: {"value": value, **known} for name, value in lens.items()}
    tables["sensor"] = {**rest["sensor"], "width": size[0], "height": size[1]}
    if rate > 0:
        tables["sensor"]["period"] = {"value": 1.0 / rate, "unit": "s", "source": "measured"}
    return tables, whose


def _find_colmap_line(text: str) -> list[str] | None:
    lines = [s.split() for s in text.splitlines() if s.strip() and not s.startswith("#")]
    found = lines[0] if lines else []
    return found if len(found) > 4 and found[0].isdigit() and re.fullmatch(r"[A-Z_]+", found[1]) else None


def _parse_colmap_line(line: list[str], where: str) -> tuple[tuple[int, int], list[float], list[float]]:
    _, model, width, height, *numbers = line
    if model not in _COLMAP_PARAMETER_ORDER:
        raise InputError(where, model, "is a COLMAP model that mufly cannot read", _UNSUPPORTED_LENS_REMEDY)
    try:
        places, values = _COLMAP_PARAMETER_ORDER[model], [float(c) for c in numbers]
        f_x, f_y, c_x, c_y, *coefficients = (values[k] for k in places)
        size = int(width), int(height)
    except (ValueError, IndexError):
        raise InputError(
            where, model, "has too few or invalid numbers", "export the camera file again from COLMAP"
        ) from None
    # COLMAP puts the centre of the first pixel at (0.5, 0.5).
    return size, [f_x, f_y, c_x - 0.5, c_y - 0.5], coefficients


def _flatten_calibration_text(text: str, where: str) -> Iterator[tuple[str, Any]]:
    """Yield dotted keys and values (text, or a list of texts) of YAML, JSON or XML."""
    head = text.lstrip("\ufeff \t\r\n")
    try:
        if head.startswith("<"):
            yield from _flatten_xml(ElementTree.fromstring(head), "")
        elif head.startswith("{"):
            yield from _flatten_json(json.loads(head), "")
        else:
            yield from _flatten_yaml(text)
    except (ElementTree.ParseError, json.JSONDecodeError, RecursionError) as error:
        raise InputError(where, "", f"is damaged ({error})", "give another copy, or a camera file (TOML)") from error


def _flatten_json(value: Any, key: str) -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _flatten_json(inner, f"{key}.{name}" if key else str(name))
    elif isinstance(value, list) and value and isinstance(value[0], dict):
        yield from _flatten_json(value[0], key)  # only the first of several cameras is read
    else:
        yield key, _split_tokens(json.dumps(value)) if isinstance(value, list) else str(value)


def _flatten_xml(node: ElementTree.Element, key: str) -> Iterator[tuple[str, Any]]:
    for child in node:
        name = f"{key}.{child.tag}" if key else child.tag
        yield from _flatten_xml(child, name)
        if not len(child):
            text = (child.text or "").strip()
            yield name, _split_tokens(text) if child.tag == "data" else text


def _split_tokens(text: str) -> list[str]:
    return [t for t in re.split(r"[\s,\[\]]+", text) if t]


def _flatten_yaml(text: str) -> Iterator[tuple[str, Any]]:
    """Parse the subset of YAML that calibrations use: maps, lists of numbers, one value a line."""
    above: list[tuple[int, str]] = []
    listed: dict[str, list[str]] = {}
    lines = iter(text.splitlines())
    for raw in lines:
        line = re.sub(r"(^|\s)#.*", "", raw).rstrip()
        while line.count("[") > line.count("]"):
            more = next(lines, None)
            if more is None:
                break
            line += " " + re.sub(r"(^|\s)#.*", "", more).strip()
        found = _YAML_KEY_PATTERN.match(line)
        if found is None:
            if above and line.lstrip().startswith("-"):
                listed.setdefault(above[-1][1], []).extend(_split_tokens(line.replace("- ", " ")))
            continue
        spaces, key, text_value = found.groups()
        indent, name, value = (
            len(spaces),
            key.strip('"'),
            re.sub(r"^!!?\S+", "", (text_value or "")).strip(),
        )
        while above and above[-1][0] >= indent:
            above.pop()
        key = f"{above[-1][1]}.{name}" if above else name
        if not value:
            above.append((indent, key))
        else:
            yield key, _split_tokens(value) if value.startswith("[") else value.strip("\"'")
    yield from listed.items()


def _parse_calibration(
    values: dict[str, Any], where: str
) -> tuple[str, tuple[int, int], list[float], list[float], float]:
    """Return source program, picture size, focal lengths and centre, distortion, and picture rate (Hz; 0: unknown)."""
    cameras = sorted({k.partition(".")[0] for k in values if re.match(r"cam\d+\.", k)})
    first = f"{cameras[0]}." if cameras else ""
    v = {k.removeprefix(first).removesuffix(".data").lower(): x for k, x in values.items() if k.startswith(first)}
    v |= {k.partition(".")[2]: x for k, x in v.items() if k.startswith(("camera.", "camera1."))}
    for name in ("projection_parameters.", "distortion_parameters.", "value0.", "intrinsics.", "intrinsics."):
        v |= {k.removeprefix(name): x for k, x in v.items() if k.startswith(name)}
    model = str(v.get("camera_model", v.get("model_type", v.get("camera_type", v.get("type", ""))))).lower()
    bent = str(v.get("distortion_model", "")).lower()
    marks = {
        "ROS's camera_info": ("camera_name", "k"), "EuRoC's sensor": ("sensor_type",),
        "Basalt's calibration": ("camera_type",), "OpenCV's calibration": ("camera_matrix",),
    }  # fmt: skip
    whose = next((name for name, keys in marks.items() if any(k in v for k in keys)), "a calibration")
    whose = "Kalibr's camchain" if cameras else whose
    for kind, read in ((model, _PINHOLE_CAMERA_NAMES), (bent, _RADIAL_TANGENTIAL_LENS_NAMES)):
        if kind not in read:
            raise InputError(
                where,
                "",
                f"is {whose} with the model {kind!r}, which mufly cannot read",
                _UNSUPPORTED_LENS_REMEDY,
            )
    matrix = _find_numbers(v, ("camera_matrix", "intrinsic_matrix", "k", "m1"))
    focus = _find_numbers(v, ("intrinsics",))
    if not focus and len(matrix) == 9:
        f_x, _, c_x, _, f_y, c_y, *_ = matrix
        focus = [f_x, f_y, c_x, c_y]
    focus = focus or [_parse_float_or_nan(v.get(name)) for name in _INTRINSIC_NAMES]
    width, height = _find_numbers(v, ("resolution", "image_size")) or [
        _parse_float_or_nan(v.get(f"image_{side}", v.get(side))) for side in ("width", "height")
    ]
    if len(focus) != 4 or not all(map(math.isfinite, [*focus, width, height])):
        raise InputError(where, "", "is not a calibration in a known format, or has no size or focal lengths",
                         "give a camera file (TOML), or the YAML of Kalibr, ROS, OpenCV or EuRoC")  # fmt: skip
    names = ("distortion_coeffs", "distortion_coefficients", "distortion_coefficents", "dist_coeffs", "d")
    distortion = _find_numbers(v, names) or [_parse_float_or_nan(v.get(name, 0)) for name in _DISTORTION_NAMES]
    if any(distortion[len(_DISTORTION_NAMES) :]) or not all(map(math.isfinite, distortion)):
        problem = f"is {whose} with {len(distortion)} coefficients of distortion; mufly's model has five"
        raise InputError(where, "", problem, _UNSUPPORTED_LENS_REMEDY)
    rate = _parse_float_or_nan(v.get("rate_hz", v.get("fps", 0)))
    return whose, (round(width), round(height)), focus, distortion[:5], rate if math.isfinite(rate) else 0.0


def _find_numbers(values: Mapping[str, Any], names: tuple[str, ...]) -> list[float]:
    """Return the numbers of the first of ``names`` whose value is a list; an empty list if there is none."""
    return next(([_parse_float_or_nan(x) for x in values[n]] for n in names if isinstance(values.get(n), list)), [])


def _parse_float_or_nan(value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        return math.nan
