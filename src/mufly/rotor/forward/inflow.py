"""Induced velocity of a disc in any direction of flight: mean by momentum theory, gradients by Pitt and Peters.

Mean. With u_h the velocity that the load would induce in hover, V_z the axial and V the edgewise velocity of the air
through the disc, Glauert's momentum theory is

    u sqrt(V^2 + (V_z + u)^2) = u_h^2

In descent between V_z = 0 and -2 u_h it has no valid root at small V. There the axial curve of
:func:`mufly.rotor.bemt.induced_velocity_ratio` (Leishman 2006, eq. 2.99) gives the through-flow at V = 0. Its change
with V is interpolated between the roots at V_z = 0 and -2 u_h. This is an own rule, continuous everywhere.

Gradients, total form of Peters and HaQuang (J. Am. Helicopter Soc. 33(4), 1988). All velocities are over Omega R.
The inflow is lambda(r, psi) = l0 + r/R (lc cos psi + ls sin psi), psi = 0 aft. C_T, C_c, C_s are the thrust and the
cosine and sine moments of the load over rho A (Omega R)^2 and R. The angle of the wake is chi = atan2(mu, lz):

    lz = l0 + V_z        X = tan(chi / 2)

    l0 = C_T / (2 V_T) - (15 pi / 64) X C_c / V_e        V_T = sqrt(mu^2 + lz^2)

    lc = (15 pi / 64) X C_T / V_T + 4 cos chi / (1 + cos chi) C_c / V_e       V_e = (mu^2 + lz (lz + l0)) / V_T
    ls = 4 / (1 + cos chi) C_s / V_e
"""

from __future__ import annotations

import math

from mufly.compiled.numba_cache import cached_njit
from mufly.rotor.bemt import induced_velocity_ratio

_PITT_PETERS_COUPLING = 15.0 * math.pi / 64.0
_THROUGH_FLOW_FADE_START, _THROUGH_FLOW_FADE_END = (
    0.75,
    1.5,
)  # V / u_h between which the interpolated through-flow fades out


@cached_njit(error_model="numpy")
def _glauert_root(x: float, v: float) -> float:
    """Return the lowest root u of u^2 (v^2 + (x + u)^2) = 1, with velocities divided by the induced one in hover."""
    low, high = 0.0, 1.0 / max(v, 0.05) if x >= 0.0 else 2.0 - x
    bend = x * x - 8.0 * v * v
    if x < 0.0 and bend > 0.0:  # a greatest and a least value of the left side
        top = 0.25 * (-3.0 * x - math.sqrt(bend))
        if top * top * (v * v + (x + top) * (x + top)) >= 1.0:
            high = top
        else:
            low = 0.25 * (-3.0 * x + math.sqrt(bend))
    u = 0.5 * (low + high)
    for _ in range(80):
        m = v * v + (x + u) * (x + u)
        miss = u * u * m - 1.0
        if miss > 0.0:
            high = u
        else:
            low = u
        slope = 2.0 * u * m + 2.0 * u * u * (x + u)
        new = u - miss / slope if slope > 0.0 else low
        if not low < new < high:
            new = 0.5 * (low + high)
        if abs(new - u) < 1e-15:
            break
        u = new
    return u


@cached_njit(error_model="numpy")
def disc_through_flow(hover_m_s: float, axial_m_s: float, edgewise_m_s: float) -> float:
    """Return the magnitude of the axial velocity through a loaded disc (m/s), its own induced velocity included.

    Parameters
    ----------
    hover_m_s : float
        Velocity that the load induces in hover, above 0.
    axial_m_s : float
        Velocity of the air through the disc without induction, down positive.
    edgewise_m_s : float
        Velocity in the plane of the disc, 0 or more.
    """
    x, v = axial_m_s / hover_m_s, edgewise_m_s / hover_m_s
    if x >= 0.0:
        return hover_m_s * (x + _glauert_root(x, v))
    if x <= -2.0:
        if v <= 1e-6:
            return hover_m_s * (-0.5 * x + math.sqrt(max(0.25 * x * x - 1.0, 0.0)))
        return hover_m_s * abs(x + _glauert_root(x, v))
    level = _glauert_root(0.0, v)
    windmill = 1.0 if v <= 1e-6 else abs(-2.0 + _glauert_root(-2.0, v))
    flow = ((1.0 + 0.5 * x) * level - 0.5 * x * windmill) / induced_velocity_ratio(x)
    if v > _THROUGH_FLOW_FADE_START:
        s = min((v - _THROUGH_FLOW_FADE_START) / (_THROUGH_FLOW_FADE_END - _THROUGH_FLOW_FADE_START), 1.0)
        s = s * s * (3.0 - 2.0 * s)
        flow += s * (abs(x + _glauert_root(x, v)) - flow)
    return hover_m_s * flow


@cached_njit(error_model="numpy")
def momentum_induced_velocity(hover_squared: float, axial_m_s: float, edgewise_m_s: float) -> float:
    """Return the mean induced velocity (m/s) of a loaded disc; ``hover_squared`` is the signed square of that in hover
    (m^2/s^2).
    """
    size = math.sqrt(abs(hover_squared))
    if size < 1e-9:
        return 0.0
    sign = 1.0 if hover_squared > 0.0 else -1.0
    flow = disc_through_flow(size, sign * axial_m_s, edgewise_m_s)
    return sign * size * size / math.sqrt(edgewise_m_s * edgewise_m_s + flow * flow)


@cached_njit(error_model="numpy")
def pitt_peters_inflow(
    c_t: float, c_c: float, c_s: float, mean: float, axial: float, mu: float
) -> tuple[float, float, float, float]:
    """Return the mean inflow l0 and its two gradients lc, ls that the loads induce, over Omega R, and the cosine of the
    wake's skew angle chi.

    Parameters
    ----------
    c_t, c_c, c_s : float
        Thrust, cosine and sine moment of the load.
    mean : float
        Present l0, which defines the mass flow.
    axial, mu : float
        Axial velocity without induction (down positive), and edgewise velocity.
    """
    hover = math.sqrt(0.5 * abs(c_t)) + 1e-12
    sign = 1.0 if c_t >= 0.0 else -1.0
    flow = disc_through_flow(hover, sign * axial, mu) + 1e-9
    total = math.sqrt(mu * mu + flow * flow)
    lz = axial + mean
    rate = max((mu * mu + flow * flow + lz * mean) / total, 0.5 * total)
    cosine = flow / total
    half = mu / (total + flow)  # tan(chi / 2)
    l0 = sign * hover * hover / total - _PITT_PETERS_COUPLING * half * c_c / rate
    lc = _PITT_PETERS_COUPLING * half * c_t / total + 4.0 * cosine / (1.0 + cosine) * c_c / rate
    ls = 4.0 / (1.0 + cosine) * c_s / rate
    return l0, lc, ls, cosine
