"""Elementary functions with equal results, to the last bit, on every machine with IEEE 754 arithmetic.

The functions of C libraries differ in the last bit. On-board code (docs/reference/firmware.md) must give the same
results on a processor and in simulation, so it uses additions and multiplications only:

    n = the integer nearest to 2 x / pi,   r = x - n pi/2,   pi/2 in three pieces of which the first two are short
                                                             enough for n times them to be exact for |n| < 2^20
    sin r = r - r^3/3! + ... + r^17/17!,          |r| <= pi/4: what is left out is below 1e-19
    cos r = 1 - r^2/2! + ... + r^16/16!,          below 3e-18

and the quadrant of ``n`` selects function and sign. Errors are at most one unit in the last place (two after thousands
of turns). An angle beyond 1e5 rad or not a number is a fault of the caller and counts as zero. Sources: Taylor; Cody
and Waite, Software Manual for the Elementary Functions, 1980, for the pieces.

Decay is ``exp(-x) = 2^-n exp(-r)``, n the integer nearest to ``x / ln 2``, ``r = x - n ln 2``, by the same method.

The angle of a direction (x, y), small <= big the two magnitudes:

    n = the integer nearest to 8 small / big,  c = n / 8,   atan(small / big) = atan c + atan r,
    r = (small - c big) / (big + c small),  |r| <= 1/16,    atan r = r - r^3/3 + ... + r^13/13: below 4e-19 is left out

and quadrant and octant select the final angle (error two units in the last place). A length is the root of the sum of
squares, from left to right; for lengths in metres neither overflows.
"""

from __future__ import annotations

import math

from numba.extending import register_jitable

from mufly.compiled.numba_cache import cached_njit

# The C sources contain the same numbers; tests compare both.
TWO_OVER_PI = float.fromhex("0x1.45f306dc9c883p-1")
HALF_PI_PARTS = (
    float.fromhex("0x1.921fb54400000p+0"),
    float.fromhex("0x1.0b4611a600000p-34"),
    float.fromhex("0x1.3198a2e037073p-69"),
)
"""Parts of pi/2 with 33, 33 and 53 bits."""

MAX_ANGLE_RAD = 1e5

_HALF_PI_1, _HALF_PI_2, _HALF_PI_3 = HALF_PI_PARTS


@cached_njit(error_model="numpy")
def sine_cosine(x: float) -> tuple[float, float]:
    """Return sine and cosine of an angle (rad)."""
    if not abs(x) < MAX_ANGLE_RAD:
        return 0.0, 1.0
    n = int(x * TWO_OVER_PI + (0.5 if x >= 0.0 else -0.5))
    r = ((x - n * _HALF_PI_1) - n * _HALF_PI_2) - n * _HALF_PI_3
    q = r * r
    s = 1.0 / 355687428096000.0
    s = -1.0 / 1307674368000.0 + q * s
    s = 1.0 / 6227020800.0 + q * s
    s = -1.0 / 39916800.0 + q * s
    s = 1.0 / 362880.0 + q * s
    s = -1.0 / 5040.0 + q * s
    s = 1.0 / 120.0 + q * s
    s = -1.0 / 6.0 + q * s
    s = r + r * (q * s)
    c = 1.0 / 20922789888000.0
    c = -1.0 / 87178291200.0 + q * c
    c = 1.0 / 479001600.0 + q * c
    c = -1.0 / 3628800.0 + q * c
    c = 1.0 / 40320.0 + q * c
    c = -1.0 / 720.0 + q * c
    c = 1.0 / 24.0 + q * c
    c = -0.5 + q * c
    c = 1.0 + q * c
    quadrant = n % 4
    if quadrant == 0:
        return s, c
    if quadrant == 1:
        return c, -s
    if quadrant == 2:
        return -s, -c
    return -c, s


LN2_PARTS = (float.fromhex("0x1.62e42fee00000p-1"), float.fromhex("0x1.a39ef35793c76p-33"))
"""ln 2 in two pieces, the first of 32 bits."""

_LN2_1, _LN2_2 = LN2_PARTS
_INVERSE_LN2 = float.fromhex("0x1.71547652b82fep+0")


@cached_njit(error_model="numpy")
def exp_decay(x: float) -> float:
    """Return exp(-x) for x >= 0; 1 for negative x, 0 above 40 (where it is below 1e-17)."""
    if not x > 0.0:
        return 1.0
    if x > 40.0:
        return 0.0
    n = int(x * _INVERSE_LN2 + 0.5)
    r = (x - n * _LN2_1) - n * _LN2_2
    # Taylor series to r^13.
    s = -1.0 / 6227020800.0
    s = 1.0 / 479001600.0 + r * s
    s = -1.0 / 39916800.0 + r * s
    s = 1.0 / 3628800.0 + r * s
    s = -1.0 / 362880.0 + r * s
    s = 1.0 / 40320.0 + r * s
    s = -1.0 / 5040.0 + r * s
    s = 1.0 / 720.0 + r * s
    s = -1.0 / 120.0 + r * s
    s = 1.0 / 24.0 + r * s
    s = -1.0 / 6.0 + r * s
    s = 0.5 + r * s
    s = 1.0 - r * (1.0 - r * s)
    for _ in range(n):
        s = 0.5 * s
    return s


_TWO_PI_1, _TWO_PI_2 = float.fromhex("0x1.921fb544p+2"), float.fromhex("0x1.0b46p-32")
"""Parts whose sum is 2 pi; n times either part is exact for |n| < 2^20."""
_ATAN_OF_EIGHTHS = tuple(
    float.fromhex(x)
    for x in (
        "0x0.0p+0", "0x1.fd5ba9aac2f6ep-4", "0x1.f5b75f92c80ddp-3", "0x1.6f61941e4def1p-2", "0x1.dac670561bb4fp-2",
        "0x1.1e00babdefeb4p-1", "0x1.4978fa3269ee1p-1", "0x1.700a7c5784634p-1", "0x1.921fb54442d18p-1",
    )
)  # fmt: skip
"""atan(n / 8)."""
_MAX_ATAN2_COMPONENT = 1e30


def wrap_angle(angle: float) -> float:
    """Return the angle (rad) wrapped to [-pi, pi]; 0 from :data:`MAX_ANGLE_RAD` on.

    The multiple of 2 pi is subtracted in two parts, each an exact product.
    """
    if not abs(angle) < MAX_ANGLE_RAD:
        return 0.0
    if abs(angle) <= math.pi:
        return angle
    n = int(angle * (0.25 * TWO_OVER_PI) + (0.5 if angle >= 0.0 else -0.5))
    return (angle - n * _TWO_PI_1) - n * _TWO_PI_2


def portable_atan2(y: float, x: float) -> float:
    """Return the angle (rad) from the first axis to (x, y), as ``atan2``; zero for a zero vector."""
    a, b = abs(x), abs(y)
    big, small = (a, b) if a >= b else (b, a)
    if not (0.0 < big < _MAX_ATAN2_COMPONENT and small <= big):
        return 0.0
    n = int(8.0 * small / big + 0.5)
    c = 0.125 * n
    r = (small - c * big) / (big + c * small)
    q = r * r
    s = 1.0 / 13.0
    s = -1.0 / 11.0 + q * s
    s = 1.0 / 9.0 + q * s
    s = -1.0 / 7.0 + q * s
    s = 1.0 / 5.0 + q * s
    s = -1.0 / 3.0 + q * s
    angle = _ATAN_OF_EIGHTHS[n] + (r + r * (q * s))
    if b > a:
        angle = 0.5 * math.pi - angle
    if x < 0.0:
        angle = math.pi - angle
    return math.copysign(angle, y)


def vector_length(x: float, y: float, z: float = 0.0) -> float:
    """Return the length of a vector."""
    return math.sqrt(x * x + y * y + z * z)


@register_jitable
def floor_int(x: float) -> int:
    """Return the greatest integer not above ``x``; zero beyond 1e9 or for NaN."""
    if not abs(x) < 1e9:
        return 0
    n = int(x)
    return n - 1 if x < n else n


# Plain functions when called from Python, inlined in compiled functions.
for _function in (wrap_angle, portable_atan2, vector_length):
    register_jitable(_function)
