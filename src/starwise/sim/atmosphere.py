"""The simulated atmosphere: what really delays the signals, correlated in time, not what a receiver corrects with."""

import math

import numpy as np

from starwise.constants import NS
from starwise.kernels.sim_orbits import Paths
from starwise.kernels.sim_receiver import (
    IONO_BROADCAST,
    IONO_LAYER,
    IONO_NONE,
    TROPO_MODEL,
    TROPO_NONE,
    Air,
    delays,
    markov,
)
from starwise.signals import sv_name
from starwise.sim.sections import Ionosphere, Receiver, Troposphere
from starwise.sim.seeds import Streams
from starwise.types import F8, I2, I8

_KNOTS_PER_TAU = 10


def smooth_markov(t_ns: I8, tau_s: float, rng: np.random.Generator) -> tuple[F8, F8]:
    """First-order Markov process of unit variance, made differentiable, and its rate, at times.

    Exact at knots a tenth of ``tau_s`` apart, a cubic (Catmull-Rom) between them: air and ionosphere do not jump from
    one measurement to the next.

    Parameters
    ----------
    t_ns : (n,) int64
        GPST, ns, increasing.
    tau_s : float
        Correlation time.
    rng : numpy Generator

    Returns
    -------
    values, rates : (n,) float64
    """
    step = tau_s / _KNOTS_PER_TAU
    x = (t_ns - t_ns[0]) / NS / step
    n = int(x[-1]) + 4
    unit = rng.standard_normal(n)
    knots = np.empty(n)
    markov(unit, np.full(n, math.exp(-1.0 / _KNOTS_PER_TAU)), knots)
    k = np.floor(x).astype(np.int64)
    s = x - k
    a, b, c, d = knots[k], knots[k + 1], knots[k + 2], knots[k + 3]
    p1, p2, p3 = 0.5 * (c - a), a - 2.5 * b + 2.0 * c - 0.5 * d, 0.5 * (d - a) + 1.5 * (b - c)
    return b + s * (p1 + s * (p2 + s * p3)), (p1 + s * (2.0 * p2 + s * 3.0 * p3)) / step


def atmosphere(
    receiver: Receiver, klobuchar: F8, streams: Streams, tag_ns: I8, pos_e: F8, vel_e: F8, sv: I2, epoch: I8, p: Paths
) -> F8:
    """Delays of light paths, (n, 4): L1 ionosphere m, its rate m/s, troposphere m, its rate m/s.

    Streams ``ionosphere/<satellite>`` and ``troposphere``.

    Parameters
    ----------
    receiver : Receiver
    klobuchar : (8,) float64
        Broadcast coefficients of the sky.
    streams : Streams
    tag_ns : (m,) int64
    pos_e, vel_e : (m, 3) float64
        Antenna.
    sv : (n,) int16
    epoch : (n,) int64
        Satellite and epoch of each path.
    p : Paths
        Their geometry.
    """
    out = np.zeros((len(sv), 4))
    iono, tropo = receiver.ionosphere, receiver.troposphere
    if iono.model == "none" and tropo.model == "none":
        return out
    zenith, zenith_rate = _zenith(tropo, tag_ns, streams)
    air = _air(iono, klobuchar, TROPO_MODEL if tropo.model != "none" else TROPO_NONE, zenith, zenith_rate)
    vertical, vertical_rate = np.zeros(len(sv)), np.zeros(len(sv))
    if iono.model != "none" and iono.residual_m > 0.0:
        for one in np.unique(sv):
            rows = np.flatnonzero(sv == one)
            value, rate = smooth_markov(tag_ns, iono.residual_tau_s, streams(f"ionosphere/{sv_name(int(one))}"))
            vertical[rows] = iono.residual_m * value[epoch[rows]]
            vertical_rate[rows] = iono.residual_m * rate[epoch[rows]]
    delays(air, tag_ns, epoch, pos_e, vel_e, p.sat_pos, p.sat_vel, p.azimuth, p.elevation, vertical, vertical_rate, out)
    return out


def _zenith(tropo: Troposphere, tag_ns: I8, streams: Streams) -> tuple[F8, F8]:
    """Zenith delay beyond the model, m, and its rate, m/s, by epoch."""
    zenith, rate = np.full(len(tag_ns), tropo.zenith_offset_m), np.zeros(len(tag_ns))
    if tropo.model != "none" and tropo.residual_m > 0.0:
        value, change = smooth_markov(tag_ns, tropo.residual_tau_s, streams("troposphere"))
        zenith, rate = zenith + tropo.residual_m * value, tropo.residual_m * change
    return zenith, rate


def _air(iono: Ionosphere, klobuchar: F8, tropo: int, zenith: F8, zenith_rate: F8) -> Air:
    coef = np.zeros(8)
    code, scale = IONO_NONE, 1.0
    if iono.model == "broadcast":
        coef[:] = klobuchar
        code, scale = IONO_BROADCAST, iono.scale
    elif iono.model == "layer":
        coef[:3] = iono.vtec_tecu, iono.north_tecu_per_deg, iono.east_tecu_per_deg
        code = IONO_LAYER
    return Air(code, coef, scale, tropo, zenith, zenith_rate)
