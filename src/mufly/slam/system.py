"""Where is it? Pictures in, places with covariance out: tracking against keyframes, closing loops, finding itself
again.

A picture is straightened, and where it should be from is reckoned by the last answer, velocity and turning. The
keyframe that shares most floor with it is warped to there, its points are followed into the picture
(:mod:`vision`), and where the camera is comes from them (:mod:`pose`). What fits moves the keyframe's points by
what they were off: shaking and noise are averaged out of the map while it is looked at. When little floor is shared
a new keyframe is made of the picture.

Now and then a keyframe that is not tied to the present one, but should be in sight, is tried in the same way. It
closes a loop if enough points agree, if what it says lies within the covariance of the map, and if no other place
within reach looks alike: on a floor of tiles the covariance alone decides, and where it cannot, nothing does.

Answers that are not trusted are not given; :class:`Answer` says why. What it lost it seeks first around where it
should be, later in all of the map by ORB (Rublee et al. 2011), and believes that when three pictures in a row agree.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.camera import Camera, body_from_camera, check_size
from mufly.slam.frame import Frame, Way
from mufly.slam.graph import Edge, placed, relation, slopes_of
from mufly.slam.mapping import Keyframe, Map, composed, overlap, unexplained
from mufly.slam.pose import POSE, SHAKES, Pose, View, bent, level, slopes, solve, two_points
from mufly.slam.recognition import ENOUGH, correlated, recognised, told_apart
from mufly.slam.vision import Straightener, as_bright, corners, on, overlaid, tracked, warped

_Array = NDArray[np.float64]
CORRELATION = 0.5
LEAST_M = 0.1  # height of the camera from which a map begins
TOO_NEAR = "too near to the floor"
"""Why there is no answer before."""
FEW = 30  # points that agree, below which a new keyframe may see more
NEW_BELOW = 0.55  # share of floor that a keyframe has to see of the picture
CLOSE_ABOVE, CLOSE_EVERY = 0.4, 8
CLOSURE_CHI2 = 28.0  # of eight numbers: one true closure in 2000 is turned away
_MAY_BE = 2.5  # deviations within which a keyframe is looked for
INFLATE = 3.0
"""Of variances of all points together over those of each, as errors of neighbouring points hang together. Chosen on
twelve floors (docs/slam.md): edges against the truth, with true tilts given, ask for 3.9, answers for less."""
_WHITE, _MOST_WHITE = 248, 0.02
"""Grey, and share of a picture that may be whiter for it to become a keyframe: a camera that was covered sees too
bright for half a second, and what was white then has no corners."""
_STRAY = 5.0  # pixels that a point may be off for no reason
_TURNED = 0.005
"""Of the height: what tilts told wrong move a place by from picture to picture (docs/slam.md has it measured)."""
_LOST_S, _SEEK_EVERY = 0.7, 4
_AGREE = 3
_SHAKES_GAIN, _SHAKES_LEARNT, _SHAKES_LEFT = 0.02, 150, 0.3
"""Of a picture in what is learnt of the shaking; after so many pictures so much is left of what is not known of it."""
_BRIDGE_S, _BRIDGE_YOUNG_S, _YOUNG, _LONG = 1.5, 0.1, 5, 25
"""After how long it goes on from where it is believed to be (s); with a map of so few keyframes that nothing is found
in it at once, else once so many pictures were seen so."""


@dataclass(frozen=True)
class Answer:
    """What was made of a picture.

    Attributes
    ----------
    time_s : float
        Of the picture.
    trusted : bool
    reason : str
        Why it is not.
    position : (3,) array
        N, E, D (m) of the vehicle's centre of gravity; NaN where nothing is known.
    heading : float
        rad.
    covariance : (4, 4) array
        Of N, E, D, heading.
    keyframe : int
        Against which it was seen.
    tracked, agreed : int
        Points that were found, that agree.
    pixels : (n, 2) array
        Where those are that agree, in the straight picture.
    scatter : float
        Of their residuals, over what was expected.
    made, closed : bool
        Whether it became a keyframe, whether a loop was closed.
    """

    time_s: float
    trusted: bool
    reason: str = ""
    position: _Array = field(default_factory=lambda: np.full(3, math.nan))
    heading: float = math.nan
    covariance: _Array = field(default_factory=lambda: np.full((4, 4), math.nan))
    keyframe: int = -1
    tracked: int = 0
    agreed: int = 0
    pixels: _Array = field(default_factory=lambda: np.zeros((0, 2)), repr=False)
    scatter: float = math.nan
    made: bool = False
    closed: bool = False


@dataclass(frozen=True)
class _Match:
    """A picture seen against a keyframe."""

    keyframe: int
    pose: Pose
    which: NDArray[np.intp]  # points that agree
    pixels: _Array  # there, in the straight picture
    seconds: _Array
    sigma: _Array
    tracked: int
    shift: float  # pixels by which it was off before

    @property
    def node(self) -> _Array:
        x = self.pose.x
        return np.array([x[0], x[1], x[3], math.log(x[2])])


class Slam:
    """Visual SLAM over a floor.

    Parameters
    ----------
    camera : Camera
    floor_map : Map, optional
        To find itself in; by default a new one that begins at the first picture.
    start : (3,) array_like
        N, E (m), heading (rad) of the vehicle at the first picture of a new map.
    seed : int
        Of the points drawn by chance.
    """

    def __init__(
        self, camera: Camera, floor_map: Map | None = None, *, start: Any = (0.0, 0.0, 0.0), seed: int = 0
    ) -> None:
        self.camera = camera
        self.map = Map(start) if floor_map is None else floor_map
        self._straight = Straightener(camera)
        self._given = floor_map is not None
        self._axes, self._mount = body_from_camera(camera), camera.mount.place.array()[0]
        self._rng = np.random.default_rng(seed)
        size, focal = self._straight.size, self._straight.focal
        self._wide, self._high = size[0] / focal, size[1] / focal
        self._rolls = float(camera.shutter.readout) > 0.005
        shaking = float(camera.quality.shaking)
        self._shake_sigma, self._shake_rms = 0.5 * shaking, shaking / math.sqrt(2.0)
        self._shakes, self._shaken = np.zeros(SHAKES), 0  # amplitudes as learnt, from so many pictures
        self._shake_tilt = 0.0
        self._reference = -1
        self._node = np.zeros(4)  # where it was last
        self._velocity = np.zeros(2)
        # What tilt and sonar are off by, and how that hangs together with the newest keyframe's
        self._off, self._hangs = np.zeros(3), [np.zeros(3), np.ones(3)]
        self._way: Way | None = None  # since then
        self._frame_s = math.nan
        self._spread = 0.0  # of the place that is reckoned (m)
        self._count = self._tried = 0
        self._found: list[tuple[float, _Array]] = []
        # How often a loop to a keyframe was tried in vain, and how much floor it seemed to share at the last time
        self._vain: dict[int, tuple[int, float]] = {}
        self._trial = 0  # pictures seen against a keyframe that was begun anew; 0: there is none
        self.picture: NDArray[np.uint8] | None = None
        self.closes = True  # whether loops are closed
        self.on_closure: Callable[[int, int], None] = lambda a, b: None

    # ------------------------------------------------------------------ one picture

    def step(self, frame: Frame) -> Answer:
        """Take a picture in.

        Raises
        ------
        InputError
            If it is not of the camera's size.
        """
        check_size(self.camera, frame.picture.shape, f"picture at {frame.time_s:g} s")
        if frame.time_s <= self._frame_s:
            return Answer(frame.time_s, False, "older than the picture before")
        self._frame_s = frame.time_s
        self._count += 1
        picture = self.picture = self._straight.straight(frame.picture)
        view = self._view(frame)
        if not self.map.keyframes:
            return self._begin(frame, view, picture)
        if self._way is None:
            return self._seek(frame, view, picture, "not found in the map yet")
        self._way = self._way.to(frame.time_s, frame.told)
        elapsed = self._way.since_s
        node = self._reckon(frame, view, self._way)
        pixels_off = self._spread / view.height * view.focal
        match = None
        for k in self._references(node, elapsed > _LOST_S):
            match = self._match(k, view, picture, node, coarse=pixels_off > 12.0)
            if match is not None:
                break
        why = self._distrust(match, view, node)
        if match is None or why:
            if len(self.map.keyframes) == 1 and frame.told.place is not None and not self._given:
                # Near the floor one picture shares little with the next: nothing hangs on a map of one.
                self.map = Map(self.map.start)
                return self._begin(frame, view, picture)
            if self._bridges(frame, view, elapsed):
                return self._bridge(frame, view, picture, why)
            if elapsed > _LOST_S or self._trial > 0:
                return self._seek(frame, view, picture, why)
            return Answer(frame.time_s, False, why, keyframe=self._reference)
        if self._trial > 0 and (answer := self._tried_on(frame, view, picture, match)) is not None:
            return answer
        return self._accept(frame, view, picture, match)

    def _view(self, frame: Frame) -> View:
        told = frame.told
        # Where all rows are taken at once, shaking is a tilt like another one, and only its phase tells it apart.
        modelled = bool(told.rotor_speed.any()) and (self._rolls or told.rotor_phase is not None)
        self._shake_tilt = 0.0 if self._rolls or modelled else self._shake_rms / self._straight.focal
        view = View(
            self._straight.focal,
            self._axes,
            told.roll,
            told.pitch,
            told.rates,
            np.zeros(3),
            1.0,
            told.height_sigma,
            self._shake_sigma if modelled else 0.0,
            told.rotor_speed,
        )
        if told.rotor_phase is not None:
            view = view._replace(rotor_phase=told.rotor_phase, shakes=self._shakes)
            if self._shaken > _SHAKES_LEARNT:
                view = view._replace(shake_sigma=_SHAKES_LEFT * view.shake_sigma)
        height = max(LEAST_M, told.height_m)
        self._off, *self._hangs = self.map.hangs(
            frame.time_s, (told.tilt_sigma, told.tilt_time_s, self._shake_tilt),
            (told.height_sigma / height, told.height_time_s),
        )  # fmt: skip
        view = view._replace(tilt=self._off[:2])
        turn = level(view, None, self._node[2])
        velocity = np.array([*self._velocity, 0.0]) if told.velocity is None else told.velocity
        velocity = velocity + turn @ np.cross(told.rates, self._mount)
        return view._replace(
            velocity=velocity, height=max(0.05, told.height_m - float((turn @ self._mount)[2]))
        )

    def _reckon(self, frame: Frame, view: View, way: Way) -> _Array:
        """Where it should be, and in ``_spread`` how well that is known (m): by the way since the last answer, or after
        a while without one by what the vehicle believes, if it tells and that is known better."""
        moved, self._spread = way.reckoned(self._velocity)
        believed = 0.05 + 2.0 * frame.told.place_sigma[0]
        if way.since_s > _LOST_S and frame.told.place is not None and believed < self._spread:
            n, e, heading = frame.told.place
            self._spread = believed
            return self._seven(self._believed(view, n, e, heading))[:4]
        return np.append(self._node[:3] + moved, math.log(view.height))

    def _references(self, node: _Array, lost: bool) -> list[int]:
        """Keyframes to look at it from: that of before, if another is not much better; all, if it was lost."""
        near = (
            range(len(self.map.keyframes))
            if lost
            else {self._reference, *self.map.neighbours(self._reference)}
        )
        share = {k: overlap(self.map.nodes[k], node, self._wide, self._high) for k in near}
        share[self._reference] += 0.1
        ordered = sorted(share, key=lambda k: -share[k])
        return [k for k in ordered[:2] if share[k] > 0.15] or [self._reference]

    # ------------------------------------------------------------------ against a keyframe

    def _match(self, k: int, view: View, picture: Any, node: _Array, coarse: bool = False) -> _Match | None:
        """See a picture against keyframe ``k`` from about ``node``; None if it does not fit."""
        straight, keyframe, at = self._straight, self.map.keyframes[k], self.map.nodes[k]
        shift = 0.0
        if coarse:
            found = self._coarse(k, view, picture, node, 3.0 * self._spread + 0.03)
            if found is None:
                return None
            shift = math.hypot(*(found[:2] - node[:2])) / view.height * view.focal
            node = found
        homography = self._homography(k, view, node)
        template, covered = overlaid(as_bright(keyframe.picture, picture), homography, picture)
        h = np.column_stack([keyframe.pixels, np.ones(len(keyframe.pixels))]) @ homography.T
        there = h[:, :2] / h[:, 2:]
        use = np.nonzero((h[:, 2] > 0) & (keyframe.missed < 8) & on(covered, there))[0]
        if len(use) < ENOUGH:
            return None
        tilts = self.map.belief(k, *self._hangs)[4:8, 4:8][np.ix_([2, 3, 0, 1], [2, 3, 0, 1])]
        # Who was found further away than all that is unknown has found its like: on tiles the next one's
        unsure = 0.0 if coarse else self._spread / view.height * view.focal
        tilted = view.focal * math.sqrt(tilts[0, 0] + tilts[2, 2])
        reach = _STRAY + 4.0 * unsure + 3.0 * (self._shake_rms + tilted)
        # A floor that repeats nothing is seen best by all that a picture holds.
        looked = reach if len(self.map.alike(k, view.focal)) else math.inf
        seen, correlation, sigma = tracked(template, picture, there[use], straight.smooth, looked)
        good = (correlation > CORRELATION) & (sigma < 1.5)
        good &= on(straight.seen, seen) & (np.hypot(*(seen - there[use]).T) < reach)
        if good.sum() < ENOUGH:
            return None
        use, seen, sigma = use[good], seen[good], sigma[good]
        seconds, pixels = straight.seconds(seen), seen - straight.middle
        points = self.map.points(k)[use]
        # In pixels of now
        own = np.sqrt(keyframe.variance[use]) * math.exp(at[3]) / view.height * view.focal
        sigma = np.hypot(np.hypot(sigma, 0.08), own)
        rough = np.hypot(np.hypot(sigma, 0.5), self._shake_rms) / view.focal
        _, _, _, fits = two_points(
            points[:, 0] + 1j * points[:, 1], slopes(view, pixels, seconds, level(view), view.shakes), rough,
            view.height, view.height_sigma, self._rng,
        )  # fmt: skip
        if fits.sum() < ENOUGH:
            return None
        begin = np.array([node[0], node[1], view.height, node[2]])
        bend = self.map.bend(k)[use]
        pose = solve(view, begin, points[fits], bend[fits], tilts, pixels[fits], seconds[fits], sigma[fits])
        if pose.inliers.sum() < ENOUGH:
            return None
        keep = np.nonzero(fits)[0][pose.inliers]
        pose = solve(
            view, pose.x[:4], points[keep], bend[keep], tilts, pixels[keep], seconds[keep], sigma[keep]
        )
        out = np.ones(len(use), bool)
        out[keep] = False
        keyframe.missed[use[out]] += 1
        keyframe.missed[use[keep]] = np.maximum(keyframe.missed[use[keep]] - 2, -4)
        return _Match(k, pose, use[keep], seen[keep], seconds[keep], sigma[keep], len(use), shift)

    def _homography(self, k: int, view: View, node: _Array) -> _Array:
        """From the straight picture of a keyframe to the one that is seen from a node, over the floor."""
        keyframe, at = self.map.keyframes[k], self.map.nodes[k]
        c, s = math.cos(at[2]), math.sin(at[2])
        x, y = at[4:6] - keyframe.tilt
        tilt = np.array([[1.0, 0.0, y], [0.0, 1.0, -x], [-y, x, 1.0]])
        then = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ tilt @ keyframe.turn
        now = level(view, None, node[2]) @ self._axes
        h = math.exp(at[3])
        way = np.array([at[0] - node[0], at[1] - node[1], view.height - h])
        plane = h * np.eye(3) + np.outer(way, [0.0, 0.0, 1.0])
        m = self._straight.matrix
        return m @ now.T @ plane @ then @ np.linalg.inv(m)

    def _coarse(self, k: int, view: View, picture: Any, node: _Array, reach: float) -> _Array | None:
        """Where it is by the correlation of small pictures, within a reach (m); None if that is not told apart."""
        seen = warped(self.map.keyframes[k].picture, self._homography(k, view, node), self._straight.size)
        pixel = correlated(seen, picture, max(10.0, reach / view.height * view.focal))
        if pixel is None:
            return None
        # What is seen at x now is where the warped keyframe has it shifted: the camera has moved by as much over
        # the floor.
        d = level(view, None, node[2]) @ self._axes @ np.append(pixel / view.focal, 0.0)
        return node + np.array([d[0] * view.height, d[1] * view.height, 0.0, 0.0])

    def _distrust(self, match: _Match | None, view: View, node: _Array) -> str:
        """Why an answer is not to be trusted; "" if it is."""
        if match is None:
            return "too little of the floor is recognised"
        pose = match.pose
        if len(match.which) < max(ENOUGH, 0.4 * match.tracked):
            return f"only {len(match.which)} of {match.tracked} points agree"
        if pose.scale > 4.0:
            return "points scatter more than they may"
        sigma = math.sqrt(max(pose.covariance[0, 0], pose.covariance[1, 1]))
        if sigma > 0.1 + 0.03 * view.height:
            return "the place is not known well enough"
        way = pose.x[:2] - node[:2]
        off = math.hypot(*way)
        if off > 4.0 * (self._spread + sigma) + 0.08 * view.height:
            return f"{off:.2f} m off from where it should be"
        if self._way is None or not self._way.complete or self._way.told.place is None:
            return ""  # nothing tells places apart that look alike, and nothing could be begun anew
        alike = self.map.alike(match.keyframe, view.focal)
        unsure = math.hypot(self._spread, math.sqrt(2.0) * sigma, _TURNED * view.height)
        if not told_apart(way, alike, unsure):
            nearest = np.hypot(*alike.T).min()
            return f"the floor repeats every {nearest:.2f} m, and {off:.2f} m off it may be another place"
        return ""

    # ------------------------------------------------------------------ what is made of it

    def _accept(self, frame: Frame, view: View, picture: Any, match: _Match) -> Answer:
        assert self._way is not None
        elapsed, node = self._way.since_s, match.node
        if 0.0 < elapsed < 0.5:
            gain = min(1.0, 3.0 * elapsed)
            self._velocity = self._velocity + gain * ((node[:2] - self._node[:2]) / elapsed - self._velocity)
        else:
            self._velocity = np.zeros(2)
        self._node, self._way, self._reference = node, Way(frame.time_s, frame.told), match.keyframe
        self._found = []
        self._refine(view, match)
        made = closed = False
        share = overlap(self.map.nodes[match.keyframe], node, self._wide, self._high)
        few = share < 0.85 and len(match.which) < FEW
        if (share < NEW_BELOW or few) and len(match.which) >= ENOUGH:
            made = self._make(frame, view, picture, match)
        self._tried += 1
        if self.closes and (self._tried >= CLOSE_EVERY or made):
            self._tried = 0
            made, closed = self._close(frame, view, picture, match, made)
        return self._answer(frame, view, match, made, closed)

    def _refine(self, view: View, match: _Match) -> None:
        """Move the keyframe's points by what they were off, and learn how it shakes.

        Turning at two turns a picture, a rotor shakes neighbouring pictures alike: a picture against the one before
        tells little of it, and the floor would be bent by it for good. What is learnt slowly, at all phases, is.
        """
        if view.rotor_phase.any():
            self._shaken += 1
            gain = max(_SHAKES_GAIN, 1.0 / self._shaken)
            self._shakes = self._shakes + gain * (match.pose.shakes - self._shakes)
        keyframe, at = self.map.keyframes[match.keyframe], self.map.nodes[match.keyframe]
        seen = self._slopes(view, match.pose, match.pixels, match.seconds)
        z = match.pose.x[2] * np.exp(1j * match.pose.x[3])
        c = complex(match.pose.x[0], match.pose.x[1])
        to_keyframe = (c - complex(at[0], at[1]) + z * seen) / np.exp(at[3] + 1j * at[2])
        ratio = match.pose.x[2] / math.exp(at[3])
        # Back to the tilt by which its slopes were reckoned
        tilt = self.map.nodes[match.keyframe, 4:6] + match.pose.x[6:8] - keyframe.tilt
        move = bent(keyframe.slopes[match.which]) @ tilt
        to_keyframe = to_keyframe - (move[:, 0] + 1j * move[:, 1])
        # What tilt and sonar were told wrong by, and pose and tilts took no part of, is not the floor's shape.
        own = keyframe.slopes[match.which]
        to_keyframe = own + unexplained(to_keyframe - own, own, seen, 1.0 / match.sigma)
        keyframe.refine(match.which, to_keyframe, (match.sigma * ratio / view.focal) ** 2 + 1e-12, view.focal)

    def _slopes(self, view: View, pose: Pose, pixels: _Array, seconds: _Array) -> NDArray[np.complex128]:
        """Slopes with heading 0 of what is seen at pixels of the straight picture, as from its middle in time."""
        turn = level(view, pose.x[4:6], pose.x[3])
        m = slopes(view, pixels - self._straight.middle, seconds, turn, pose.shakes)
        move = (view.velocity[0] + 1j * view.velocity[1]) * seconds
        down = 1.0 - view.velocity[2] * seconds / pose.x[2]
        return (m * down + move / pose.x[2]) * np.exp(-1j * pose.x[3])

    def _keyframe(self, frame: Frame, view: View, picture: Any, pose: Pose, sigma: float) -> Keyframe | None:
        pixels = corners(picture, self._straight.seen)
        if len(pixels) < ENOUGH or np.mean(picture > _WHITE) > _MOST_WHITE:
            return None
        seconds = self._straight.seconds(pixels)
        turn = _unheaded(level(view, pose.x[4:6], pose.x[3]), pose.x[3])
        return Keyframe(
            frame.time_s, picture.copy(), turn @ self._axes, pixels, self._slopes(view, pose, pixels, seconds),
            np.full(len(pixels), (sigma / view.focal) ** 2), np.zeros(len(pixels), np.int64),
            pose.x[4:6].copy(), math.log(view.height), view.height_sigma / view.height, frame.told.height_time_s,
            frame.told.tilt_sigma, frame.told.tilt_time_s, self._shake_tilt,
        )  # fmt: skip

    def _begin(self, frame: Frame, view: View, picture: Any) -> Answer:
        """The first keyframe: here the map begins."""
        if view.height < LEAST_M:
            return Answer(frame.time_s, False, TOO_NEAR)
        if frame.told.place is not None:
            self.map.start, self.map.start_sigma = frame.told.place, frame.told.place_sigma
        n, e, heading = self.map.start
        pose = self._believed(view, n, e, heading)
        keyframe = self._keyframe(frame, view, picture, pose, math.hypot(0.5, self._shake_rms))
        if keyframe is None:
            return Answer(frame.time_s, False, "no corners on the floor to begin a map with, or too bright")
        self._reference = self.map.add(keyframe, self._seven(pose), [])
        self._node = self.map.nodes[self._reference, :4].copy()
        self._way = Way(frame.time_s, frame.told)
        nobody = np.zeros(0, np.intp)
        match = _Match(0, pose, nobody, np.zeros((0, 2)), np.zeros(0), np.zeros(0), 0, 0.0)
        answer = self._answer(frame, view, match, True, False)
        if frame.told.place is None:
            return answer
        # What it would say is what it was told.
        return replace(answer, trusted=False, reason="the map begins")

    def _bridges(self, frame: Frame, view: View, elapsed: float) -> bool:
        """Whether to go on from where the vehicle believes to be, as nothing is recognised."""
        if frame.told.place is None or view.height < LEAST_M or self._seeks:
            return False
        return self._trial > 0 or elapsed > (_BRIDGE_YOUNG_S if self._young else _BRIDGE_S)

    @property
    def _seeks(self) -> bool:
        """Whether it is the turn of seeking in all of the map."""
        return not self._young and (bool(self._found) or self._count % _SEEK_EVERY == 0)

    @property
    def _young(self) -> bool:
        """Whether the map is so small that it is not worth to be sought in."""
        return len(self.map.keyframes) - (self._trial > 0) <= _YOUNG

    def _tried_on(self, frame: Frame, view: View, picture: Any, match: _Match) -> Answer | None:
        """One more picture seen against the keyframe on trial; None if it is one to be trusted now.

        Until then the rest of the map is sought in, too: who finds itself there need not believe.
        """
        if self._seeks and (found := self._find(frame, view, picture)) is not None:
            return self._accept(frame, view, picture, found)
        self._trial += 1
        if self._trial <= (_AGREE if self._young else _LONG):
            self._node, self._way = match.node, Way(frame.time_s, frame.told)
            self._refine(view, match)
            return Answer(frame.time_s, False, "begun anew, to be confirmed")
        self._trial = 0
        return None

    def _bridge(self, frame: Frame, view: View, picture: Any, why: str) -> Answer:
        """Begin a keyframe where the vehicle believes to be, tied to the last by what that is off by; on trial."""
        if self._trial > 0:
            self.map.drop_last()
            self._reference = len(self.map.keyframes) - 1
            self._trial = 0
        assert frame.told.place is not None
        n, e, heading = (float(q) for q in frame.told.place)
        pose = self._believed(view, n, e, heading)
        keyframe = self._keyframe(frame, view, picture, pose, math.hypot(0.5, self._shake_rms))
        if keyframe is None:
            return Answer(frame.time_s, False, "no corners on the floor, or too bright")
        place, turn = frame.told.place_sigma
        last, second = self._reference, len(self.map.keyframes)
        node, before = self._seven(pose), self.map.nodes[last]
        h = math.exp(before[3])
        off = np.array([place / h, place / h, max(turn, 1e-3), 0.1])
        edge = Edge(
            last, second, np.concatenate([relation(before, node), before[4:6], node[4:6]]),
            np.diag(np.concatenate([off**-2, np.zeros(4)])),
        )  # fmt: skip
        self._reference = self.map.add(keyframe, node, [edge])
        self._node, self._way = self.map.nodes[self._reference, :4].copy(), Way(frame.time_s, frame.told)
        self._trial = 1
        return Answer(frame.time_s, False, why)

    def _believed(self, view: View, n: float, e: float, heading: float) -> Pose:
        """The pose of a vehicle that stands at N, E (m) with a heading (rad), as far as that is known."""
        lever = level(view, None, heading) @ self._mount
        x = np.array([n + lever[0], e + lever[1], view.height, heading, *view.tilt, 0.0, 0.0])
        nothing = np.zeros((POSE, POSE))
        return Pose(x, self._shakes, nothing, nothing, np.zeros(POSE), 1.0, np.zeros(0), np.zeros((0, 2)))

    def _make(self, frame: Frame, view: View, picture: Any, match: _Match) -> bool:
        """Make a keyframe of the picture."""
        keyframe = self._keyframe(frame, view, picture, match.pose, 0.4)
        if keyframe is None:
            return False
        # Others that see it too hold it better
        others = sorted(
            self.map.neighbours(match.keyframe),
            key=lambda k: -overlap(self.map.nodes[k], match.node, self._wide, self._high),
        )
        node = match.node
        k = self.map.add(keyframe, self._seven(match.pose), [self._edge(match, len(self.map.keyframes))])
        # It is the newest now
        self._hangs, view = [np.ones(3), np.full(3, 1e-10)], view._replace(tilt=self.map.nodes[k, 4:6].copy())
        for other in others[:1]:
            if overlap(self.map.nodes[other], node, self._wide, self._high) > 0.25:
                second = self._match(other, view, picture, node)
                if second is not None and not self._distrust(second, view, node):
                    self.map.tie(self._edge(second, k))
        self._reference, self._node = k, self.map.nodes[k, :4].copy()
        return True

    def _seven(self, pose: Pose) -> _Array:
        """The node of a pose: N, E, heading, ln h, errors of the tilt and of the sonar."""
        x = pose.x
        return np.array([x[0], x[1], x[3], math.log(x[2]), x[4], x[5], self._off[2]])

    def _edge(self, match: _Match, second: int, closes: bool = False) -> Edge:
        """What a picture that is node ``second`` says of the keyframe that it was seen against."""
        at, x = self.map.nodes[match.keyframe], match.pose.x
        _, by_b = slopes_of(at, match.node)
        # N, E, height, heading, tilt of the picture, of the keyframe of the edge's eight numbers
        change = np.zeros((POSE, 8))
        change[:4, :4] = np.linalg.inv(by_b)[[0, 1, 3, 2]]
        change[2] *= x[2]
        change[4:6, 6:8] = change[6:8, 4:6] = np.eye(2)
        return Edge(
            match.keyframe, second, np.concatenate([relation(at, match.node), at[4:6] + x[6:8], x[4:6]]),
            change.T @ match.pose.seen @ change / INFLATE, change.T @ match.pose.pull / INFLATE, closes,
        )  # fmt: skip

    def _close(self, frame: Frame, view: View, picture: Any, match: _Match, made: bool) -> tuple[bool, bool]:
        """Try to see it against a keyframe that is not tied to the present one; return whether it is a keyframe now,
        and whether a loop was closed.

        Those are tried that may be in sight: as near as the map's covariance lets them be.
        """
        here = self._reference
        most = _MAY_BE * math.sqrt(np.linalg.eigvalsh(self.map.covariance(here)[:2, :2])[-1])
        near, may = {here, *self.map.neighbours(here)}, []
        for k in range(len(self.map.keyframes)):
            t = relation(self.map.nodes[k], self._node)
            way, h = math.hypot(t[0], t[1]), math.exp(self.map.nodes[k, 3])
            if k in near or h * way > most + h * math.hypot(self._wide, self._high):
                continue
            sigma = math.sqrt(np.linalg.eigvalsh(self.map.covariance_between(k, here)[:2, :2])[-1])
            t[:2] *= max(0.0, 1.0 - _MAY_BE * sigma / max(way, 1e-9))
            node = composed(self.map.nodes[k], t)
            if overlap(self.map.nodes[k], node, self._wide, self._high) > CLOSE_ABOVE:
                share = overlap(self.map.nodes[k], self._node, self._wide, self._high)
                tries, before = self._vain.get(k, (0, 0.0))
                may.append((-round(share - before, 1), tries, -share, k, node, h * sigma))
        if not may:
            return made, False
        # First what has come into sight most since it was tried
        _, tries, share, k, node, sigma = min(may, key=lambda m: m[:3])
        self._vain[k] = (tries + 1, -share)
        return self._tie(k, frame, view, picture, match, made, node, sigma)

    def _tie(
        self, k: int, frame: Frame, view: View, picture: Any, match: _Match, made: bool, node: _Array, sigma: float
    ) -> tuple[bool, bool]:  # fmt: skip
        """Close a loop to keyframe ``k`` if all gates let it pass; from ``node`` it would see it, ``sigma`` (m) is
        what its place may be off by."""
        spread, self._spread = self._spread, 2.0 * sigma
        # Always: whether another place within reach looks alike is asked there.
        other = self._match(k, view, picture, node, coarse=True)
        self._spread = spread
        if (
            other is None
            or len(other.which) < max(1.5 * ENOUGH, 0.5 * other.tracked)
            or other.pose.scale > 3.0
        ):
            return made, False
        if not made and not self._make(frame, view, picture, match):
            return False, False
        here = self._reference
        edge = self._edge(other, here, closes=True)
        off = edge.off(self.map.nodes[k], self.map.nodes[here])
        if edge.chi2(off, self.map.covariance_between(k, here)) > CLOSURE_CHI2 or not self.map.tie(
            edge, CLOSURE_CHI2
        ):
            return True, False
        self._node = self.map.nodes[here, :4].copy()
        self._vain = {}
        self.on_closure(k, here)
        return True, True

    def _answer(self, frame: Frame, view: View, match: _Match, made: bool, closed: bool) -> Answer:
        """What is told: the place by all that the map, tilts, sonar and pixels say together."""
        pose, here = match.pose, self._reference
        if made:  # it is in the map
            node, known = self.map.nodes[here, :4], self.map.covariance(here)[:4, :4]
        else:
            at = self.map.nodes[here]
            tilts = np.concatenate([pose.x[4:6] - view.tilt, pose.x[6:8]])
            seen, pull = pose.seen / INFLATE, pose.pull / INFLATE
            belief, height = self.map.belief(here, *self._hangs), math.log(view.height) - self._off[2]
            node, known = placed(at[:4], belief, match.node, tilts, seen, pull, height)
        lever = level(view, pose.x[4:6], node[2]) @ self._mount
        h = math.exp(node[3])
        position = np.array([node[0] - lever[0], node[1] - lever[1], -h - lever[2]])
        to = np.zeros((4, 4))  # N, E, D, heading of N, E, heading, ln h
        to[0, 0] = to[1, 1] = to[3, 2] = 1.0
        to[2, 3] = -h
        return Answer(
            frame.time_s, True, "", position, (node[2] + math.pi) % (2 * math.pi) - math.pi, to @ known @ to.T, here,
            match.tracked, len(match.which), match.pixels, pose.scale, made, closed,
        )  # fmt: skip

    # ------------------------------------------------------------------ lost

    def _seek(self, frame: Frame, view: View, picture: Any, why: str) -> Answer:
        """Look for it in all of the map, by ORB; believed when several in a row agree."""
        lost = Answer(frame.time_s, False, why or "lost", keyframe=-1)
        if self._count % _SEEK_EVERY and not self._found:
            return lost
        match = self._find(frame, view, picture)
        if match is not None:
            return self._accept(frame, view, picture, match)
        return replace(lost, reason="found, to be confirmed") if self._found else lost

    def _find(self, frame: Frame, view: View, picture: Any) -> _Match | None:
        """See it against any keyframe that is not on trial; None until several pictures in a row agree."""
        found, self._found = self._found, []
        known = len(self.map.keyframes) - (self._trial > 0)
        node = recognised(self.map, known, view, picture, self._straight, self._shake_rms, self._rng)
        match = None if node is None else self._match(node[0], view, picture, node[1])
        if match is None or len(match.which) < 1.5 * ENOUGH or match.pose.scale > 3.0:
            return None
        here = match.node
        if found and math.hypot(*(here[:2] - found[-1][1][:2])) > 0.1 + 1.0 * (frame.time_s - found[-1][0]):
            found = []
        self._found = [*found, (frame.time_s, here)]
        if len(self._found) < _AGREE:
            return None
        if self._trial > 0:
            self.map.drop_last()
            self._trial = 0
        self._way, self._velocity, self._node = Way(frame.time_s, frame.told), np.zeros(2), here
        return match


def _unheaded(turn: _Array, heading: float) -> _Array:
    c, s = math.cos(heading), math.sin(heading)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ turn
