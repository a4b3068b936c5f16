"""Omnidirectional camera that images the spots of the laser ring, and the decoder of its picture.

The lasers shine in the x-y plane of the body; the camera sits a baseline b below it. A spot at the distance l appears
under the elevation (Fig. 2.7; triangulation)

    eps = atan(b / l),      so      dl = -(l^2 + b^2) / b deps :

a range error from a pixel of noise or calibration error grows with the square of the distance. The picture is polar:
rows are elevations, equally spaced from the horizon to a little above that of the shortest distance; columns are
directions. A spot is a Gaussian of the blur's radius with a brightness of I_1 / l^2 in units of pixel noise. Ambient
light adds an offset that differs from column to column; every pixel has unit noise.

The decoder knows the direction of each beam. It subtracts the median of each column around the beam and sums the
columns, weighted by the spot's profile. The range follows from the centroid around the brightest row, if that row
exceeds :data:`SPOT_THRESHOLD_SIGMAS` standard deviations of the noise. If no spot is found, the range is the maximum
range, as with ideal beams.

Thesis: Fig. 2.7.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.compiled.numba_intrinsics import borrow_arrays
from mufly.sensors.column_medians import median_comparators, write_column_medians
from mufly.sensors.periodic import ROW_FIRST_VALUE_INDEX, ROW_IS_VALID_INDEX, PeriodicSensor
from mufly.sensors.readings import Truth, beam_angles, beam_directions, measure_ranges
from mufly.sensors.rng import draw_normals, draw_uniforms
from mufly.vehicle import Vehicle
from mufly.vehicle.sensor_schema import RingCameraParameters as RingTable
from mufly.world import World

_Array = NDArray[np.float64]
SPOT_THRESHOLD_SIGMAS = 5.0
"""Detection threshold of a spot in standard deviations of the noise: one false spot in some million windows."""
_WINDOW_HALF_WIDTH_RADII = 3.0  # half width of the decoder's columns, in radii of a spot
ELEVATION_MARGIN_FACTOR = 1.25  # rows reach up to this multiple of the elevation of the shortest distance


@cached_njit(error_model="numpy")
def _draw_and_decode_spots(
    seen: _Array,
    comparators: _Array,
    distance: _Array,
    across: _Array,
    light: _Array,
    weight: _Array,
    offset: _Array,
    numbers: _Array,
    told: _Array,
) -> None:
    """Draw the laser spots into the picture ``seen``, which holds noise, and write the decoded ranges to ``told``.

    Parameters
    ----------
    seen : (rows * n * w,) array
        Unit noise of the w columns around each beam, row by row; becomes the picture.
    comparators : (k, 2) array
        Exchanges of :func:`mufly.sensors.column_medians.median_comparators`.
    distance : (n,) array
        Distance of each spot (m); infinite without a spot.
    across, light, weight : (n * w,) arrays
        Share of a spot's brightness, ambient light, and weight in the sum, of each column.
    offset : (n,) array
        Calibration error of each beam (rows).
    numbers : (6,) array
        Brightness at 1 m, blur (rows), elevation of a row (rad), baseline, shortest and longest distance (m).
    told : (n,) array
        Decoded distances (m); written only where a spot is found.
    """
    brightness, blur, row, baseline, nearest, farthest = (
        numbers[0], numbers[1], numbers[2], numbers[3], numbers[4], numbers[5],
    )  # fmt: skip
    lanes = across.size
    rows, wide = seen.size // lanes, lanes // distance.size
    reach = max(1, math.ceil(1.5 * blur))
    for r in range(rows):
        line = borrow_arrays(seen[r * lanes : (r + 1) * lanes])
        for k in range(lanes):
            line[k] += light[k]
    for k in range(distance.size):
        strength = brightness / max(distance[k], 0.05) ** 2
        spot = math.atan2(baseline, distance[k]) / row
        for r in range(rows):
            off = (r + 0.5 - spot) / blur
            if abs(off) < 8.0:  # beyond, a spot is darker than rounding
                bright = strength * math.exp(-0.5 * off * off)
                for c in range(k * wide, (k + 1) * wide):
                    seen[r * lanes + c] += bright * across[c]
    medians, sums = np.empty(lanes), np.empty(rows)
    write_column_medians(seen, light, comparators, rows, medians)
    for k in range(distance.size):
        best, median = 0, 0.0
        for c in range(k * wide, (k + 1) * wide):
            median += weight[c] * medians[c]
        for r in range(rows):
            total = -median
            for c in range(k * wide, (k + 1) * wide):
                total += weight[c] * seen[r * lanes + c]
            sums[r] = total
            if total > sums[best]:
                best = r
        if sums[best] < SPOT_THRESHOLD_SIGMAS:
            continue
        total = moment = 0.0
        for r in range(max(0, best - reach), min(rows, best + reach + 1)):
            part = max(sums[r], 0.0)
            total += part
            moment += part * (r + 0.5)
        place = moment / total + offset[k]
        if place > 0.0:
            found = baseline / math.tan(place * row)
            if nearest <= found <= farthest:
                told[k] = found


@cached_njit(error_model="numpy")
def _sample_ranges(
    t: float,
    x: _Array,
    attitude: _Array,
    supply: _Array,
    source: NDArray[np.uint64],
    parts: tuple[Any, ...],
    row: _Array,
) -> float:
    limits, numbers, directions, boxes, cylinders, walls, across, light, weight, offset, work, picture, network = parts
    distance, share = work[0], work[1]
    measure_ranges(x, directions, 0.0, math.inf, boxes, cylinders, walls, distance)
    draw_uniforms(source, share)
    row[ROW_IS_VALID_INDEX] = 1.0
    for k in range(share.size):
        row[ROW_FIRST_VALUE_INDEX + k] = limits[0]
        if share[k] < limits[1]:
            distance[k] = math.inf
    draw_normals(source, picture)
    _draw_and_decode_spots(
        picture, network, distance, across, light, weight, offset, numbers, row[ROW_FIRST_VALUE_INDEX:]
    )
    return 0.0


class RingCamera(PeriodicSensor):
    """Sensor of ``ranges`` (n,): distance along each beam (m), the ring's maximum range where nothing was decoded."""

    sample_function = _sample_ranges
    argument_dimensions = (1, 1, 2, 2, 2, 1, 1, 1, 1, 1, 2, 1, 2)

    def __init__(self, table: RingTable, vehicle: Vehicle, world: World, rng: np.random.Generator) -> None:
        c = table
        self._camera, self._world = c, world
        self._directions = beam_directions(vehicle)
        self._baseline, self._blur = float(c.baseline), float(c.spot_radius)
        self._nearest, self._farthest = float(c.min_range), float(c.max_range)
        self._no_return_range = float(vehicle.range_ring.max_range)
        self._max_elevation = ELEVATION_MARGIN_FACTOR * math.atan(self._baseline / self._nearest)
        self._row_elevation = self._max_elevation / c.radial_pixels  # elevation of a row
        column = 2 * math.pi / c.angular_pixels
        self._centres = np.mod(beam_angles(vehicle), 2 * math.pi) / column  # of the beams, in columns
        half = max(1, math.ceil(_WINDOW_HALF_WIDTH_RADII * self._blur))
        self._columns = np.floor(self._centres)[:, None].astype(int) + np.arange(-half, half + 1)  # (n, w), not wrapped
        self._rows = np.arange(c.radial_pixels) + 0.5
        self._calibration_offset = float(c.calibration_error) * rng.standard_normal(len(self._centres))
        self._ambient = float(c.ambient_light) * rng.uniform(0.5, 1.5, c.angular_pixels)
        self._column_profile = np.exp(-0.5 * ((self._columns + 0.5 - self._centres[:, None]) / self._blur) ** 2)
        # The weights keep the noise of the sum at one.
        self._column_weights = self._column_profile / np.sqrt((self._column_profile**2).sum(axis=1, keepdims=True))
        self._ambient_light = self._ambient[self._columns % c.angular_pixels]
        self._numbers = np.array(
            [
                float(c.spot_brightness),
                self._blur,
                self._row_elevation,
                self._baseline,
                self._nearest,
                self._farthest,
            ]
        )
        count = len(self._centres)
        parts = (
            np.array([self._no_return_range, float(c.missed_spot_probability)]),
            self._numbers,
            self._directions,
            *world.packed_tables,
            self._column_profile.ravel(),
            self._ambient_light.ravel(),
            self._column_weights.ravel(),
            self._calibration_offset,
            np.zeros((2, count)),
            np.zeros(self._rows.size * self._column_profile.size),
            median_comparators(self._rows.size),
        )
        self.published_readings = {"ranges": slice(0, count)}
        super().__init__(float(c.period), rng, parts)

    def error_free_readings(self, truth: Truth) -> dict[str, _Array]:
        return {"ranges": np.minimum(self.true_ranges_m(truth.state), self._no_return_range)}

    def true_ranges_m(self, state: _Array) -> _Array:
        """Return the distance along each beam (m), without a maximum."""
        out = np.empty(len(self._directions))
        measure_ranges(state, self._directions, 0.0, math.inf, *self._world.packed_tables, out)
        return out

    def render_picture(self, state: _Array) -> _Array:
        """Return the whole picture (rows, columns), in standard deviations of pixel noise, for display."""
        columns = np.arange(self._camera.angular_pixels)
        true = self.true_ranges_m(state)
        near = np.mod(columns + 0.5 - self._centres[:, None] + columns.size / 2, columns.size) - columns.size / 2
        light = (self._spot_brightness(true)[:, None, None] * self._spot_row_shares(true)[:, :, None]
                 * np.exp(-0.5 * (near / self._blur) ** 2)[:, None, :])  # fmt: skip
        return light.sum(axis=0) + self._ambient + self._rng.standard_normal(light.shape[1:])

    def _spot_brightness(self, distance: _Array) -> _Array:
        with np.errstate(divide="ignore"):
            return float(self._camera.spot_brightness) / np.maximum(distance, 0.05) ** 2

    def _spot_row_shares(self, distance: _Array) -> _Array:
        """Return the share of a spot's brightness in each row (n, rows)."""
        row = np.arctan2(self._baseline, distance) / self._row_elevation
        return np.exp(-0.5 * ((self._rows - row[:, None]) / self._blur) ** 2)
