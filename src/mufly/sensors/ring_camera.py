"""The omnidirectional camera that sees the spots of the laser ring, pixel by pixel, and what a decoder makes of it.

The lasers shine in the x-y plane of the body; the camera sits a baseline b below it. A spot at the distance l appears
under the elevation (Fig. 2.7; triangulation)

    eps = atan(b / l),      so      dl = -(l^2 + b^2) / b deps :

an error of a pixel grows with the square of the distance, be it of noise or of the calibration of a beam. The picture
is polar: rows are elevations, equally spaced from the horizon to a little above that of the shortest distance;
columns are directions. A spot is a Gaussian of the blur's radius, as bright as I_1 / l^2 over the noise of a pixel;
ambient light adds an offset that differs from column to column; every pixel has unit noise.

The decoder knows where each beam points. It takes the columns around it, takes away the median of each, adds them up
with the spot's own profile as weight, finds the brightest row, and the centroid around it if that stands out of the
noise by :data:`THRESHOLD` deviations. Too near, too dark or swallowed: nothing seen, which reads as the greatest
distance, as with ideal beams.

Thesis: Fig. 2.7.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mufly.compiled import compiled
from mufly.sensors.drawing import normals, uniforms
from mufly.sensors.periodic import STANDS, VALUES, Periodic
from mufly.sensors.readings import Truth, beam_angles, beam_directions, see
from mufly.vehicle import Vehicle
from mufly.vehicle.sensing import RingCamera as RingTable
from mufly.world import World

_Array = NDArray[np.float64]
THRESHOLD = 5.0
"""A spot has to stand this many standard deviations above the noise: one false spot in some million windows."""
_WIDE = 3.0  # columns on either side that the decoder looks at, in radii of a spot
_MARGIN = 1.25  # rows reach this much above the elevation of the shortest distance


@compiled(error_model="numpy")
def _median(a):  # type: ignore[no-untyped-def]
    """Median of numbers, whose order changes (Hoare's selection; that of NumPy takes two seconds to compile)."""
    middle, low, high = a.size // 2, 0, a.size - 1
    while low < high:
        pivot, i, j = a[(low + high) // 2], low, high
        while i <= j:
            while a[i] < pivot:
                i += 1
            while a[j] > pivot:
                j -= 1
            if i <= j:
                a[i], a[j] = a[j], a[i]
                i += 1
                j -= 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            break
    if a.size % 2:
        return a[middle]
    below = a[0]
    for i in range(1, middle):
        below = max(below, a[i])
    return 0.5 * (below + a[middle])


@compiled(error_model="numpy")
def _decode(picture, distance, across, light, weight, offset, numbers, told):  # type: ignore[no-untyped-def]
    """Put the spots into a picture of noise and find them again.

    Parameters
    ----------
    picture : (n, rows, w) array
        Unit noise of the columns around each beam; becomes what is seen.
    distance : (n,) array
        Of each spot (m); infinite where there is none.
    across, light, weight : (n, w) arrays
        Share of a spot's brightness, ambient light, and weight in the sum, of each column.
    offset : (n,) array
        What the decoder is off by (rows).
    numbers : (6,) array
        Brightness at 1 m, blur (rows), elevation of a row (rad), baseline, nearest and greatest distance (m).
    told : (n,) array
        Overwritten where a spot is found (m).
    """
    brightness, blur, row, baseline, nearest, farthest = (
        numbers[0], numbers[1], numbers[2], numbers[3], numbers[4], numbers[5],
    )  # fmt: skip
    rows, wide = picture.shape[1], picture.shape[2]
    reach = max(1, math.ceil(1.5 * blur))
    column, line, profile = np.empty(rows), np.empty(rows), np.empty(rows)
    for k in range(picture.shape[0]):
        strength = brightness / max(distance[k], 0.05) ** 2
        spot = math.atan2(baseline, distance[k]) / row
        first, last = rows, 0  # of the rows that a spot reaches: beyond, it is darker than rounding
        for r in range(rows):
            line[r] = 0.0
            off = (r + 0.5 - spot) / blur
            if abs(off) < 8.0:
                first, last = min(first, r), r + 1
                profile[r] = math.exp(-0.5 * off * off)
        for c in range(wide):
            bright = strength * across[k, c]
            for r in range(rows):
                column[r] = picture[k, r, c] + light[k, c]
            for r in range(first, last):
                column[r] += bright * profile[r]
            for r in range(rows):
                picture[k, r, c] = column[r]
            middle = _median(column)
            for r in range(rows):
                line[r] += weight[k, c] * (picture[k, r, c] - middle)
        best = 0
        for r in range(rows):
            if line[r] > line[best]:
                best = r
        if line[best] < THRESHOLD:
            continue
        total = moment = 0.0
        for r in range(max(0, best - reach), min(rows, best + reach + 1)):
            part = max(line[r], 0.0)
            total += part
            moment += part * (r + 0.5)
        place = moment / total + offset[k]
        if place > 0.0:
            found = baseline / math.tan(place * row)
            if nearest <= found <= farthest:
                told[k] = found


@compiled(error_model="numpy")
def _seen(t, x, attitude, supply, source, parts, row):  # type: ignore[no-untyped-def]
    limits, numbers, directions, boxes, cylinders, walls, across, light, weight, offset, work, picture = parts
    distance, share = work[0], work[1]
    see(x, directions, 0.0, math.inf, boxes, cylinders, walls, distance)
    uniforms(source, share)
    row[STANDS] = 1.0
    for k in range(share.size):
        row[VALUES + k] = limits[0]
        if share[k] < limits[1]:
            distance[k] = math.inf
    normals(source, picture)
    _decode(picture, distance, across, light, weight, offset, numbers, row[VALUES:])
    return 0.0


class RingCamera(Periodic):
    """Reads ``ranges`` (n,): distance along each beam of the ring (m), its greatest range where nothing was decoded."""

    compute = _seen

    def __init__(self, table: RingTable, vehicle: Vehicle, world: World, rng: np.random.Generator) -> None:
        c = table
        self._camera, self._world = c, world
        self._directions = beam_directions(vehicle)
        self._baseline, self._blur = float(c.baseline), float(c.blur)
        self._nearest, self._farthest = float(c.min_range), float(c.max_range)
        self._nothing = float(vehicle.range_ring.max_range)
        self._top = _MARGIN * math.atan(self._baseline / self._nearest)
        self._row = self._top / c.radial_pixels  # elevation of a row
        column = 2 * math.pi / c.angular_pixels
        self._centres = np.mod(beam_angles(vehicle), 2 * math.pi) / column  # of the beams, in columns
        half = max(1, math.ceil(_WIDE * self._blur))
        self._columns = np.floor(self._centres)[:, None].astype(int) + np.arange(
            -half, half + 1
        )  # (n, w), not wrapped
        self._rows = np.arange(c.radial_pixels) + 0.5
        self._offset = float(c.calibration) * rng.standard_normal(len(self._centres))
        self._ambient = float(c.ambient) * rng.uniform(0.5, 1.5, c.angular_pixels)
        self._across = np.exp(-0.5 * ((self._columns + 0.5 - self._centres[:, None]) / self._blur) ** 2)
        # Weights are such that the noise of the sum stays one.
        self._weight = self._across / np.sqrt((self._across**2).sum(axis=1, keepdims=True))
        self._light = self._ambient[self._columns % c.angular_pixels]
        self._numbers = np.array(
            [float(c.brightness), self._blur, self._row, self._baseline, self._nearest, self._farthest]
        )
        count = len(self._centres)
        parts = (
            np.array([self._nothing, float(c.missed)]), self._numbers, self._directions, *world.packed, self._across,
            self._light, self._weight, self._offset, np.empty((2, count)),
            np.empty((count, self._rows.size, self._across.shape[1])),
        )  # fmt: skip
        self.says = {"ranges": slice(0, count)}
        super().__init__(float(c.period), rng, parts)

    def right(self, truth: Truth) -> dict[str, _Array]:
        return {"ranges": np.minimum(self.true_ranges_m(truth.state), self._nothing)}

    def true_ranges_m(self, state: _Array) -> _Array:
        """Distance along each beam (m), however far."""
        out = np.empty(len(self._directions))
        see(state, self._directions, 0.0, math.inf, *self._world.packed, out)
        return out

    def picture(self, state: _Array) -> _Array:
        """The whole picture (rows, columns), in deviations of a pixel's noise: for people to look at."""
        columns = np.arange(self._camera.angular_pixels)
        true = self.true_ranges_m(state)
        near = (
            np.mod(columns + 0.5 - self._centres[:, None] + columns.size / 2, columns.size) - columns.size / 2
        )
        light = (self._brightness(true)[:, None, None] * self._profile(true)[:, :, None]
                 * np.exp(-0.5 * (near / self._blur) ** 2)[:, None, :])  # fmt: skip
        return light.sum(axis=0) + self._ambient + self._rng.standard_normal(light.shape[1:])

    def _brightness(self, distance: _Array) -> _Array:
        with np.errstate(divide="ignore"):
            return float(self._camera.brightness) / np.maximum(distance, 0.05) ** 2

    def _profile(self, distance: _Array) -> _Array:
        """Share of a spot's brightness in each row (n, rows)."""
        row = np.arctan2(self._baseline, distance) / self._row
        return np.exp(-0.5 * ((self._rows - row[:, None]) / self._blur) ** 2)
