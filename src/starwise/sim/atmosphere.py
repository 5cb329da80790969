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
    code, coef, scale = _ionosphere(iono, klobuchar)
    delays(
        code, coef, scale, TROPO_MODEL if tropo.model != "none" else TROPO_NONE, zenith, tag_ns, epoch,
        pos_e, vel_e, p.sat_pos, p.sat_vel, p.azimuth, p.elevation, out,
    )  # fmt: skip
    if tropo.model != "none" and zenith_rate.any():
        out[:, 3] += zenith_rate[epoch] / np.maximum(np.sin(p.elevation), 0.03)
    if iono.model != "none" and iono.residual_m > 0.0:
        s = 6371.0 / 6771.0 * np.cos(np.maximum(p.elevation, 0.0))
        mapping = 1.0 / np.sqrt(1.0 - s * s)
        for one in np.unique(sv):
            rows = np.flatnonzero(sv == one)
            value, rate = smooth_markov(tag_ns, iono.residual_tau_s, streams(f"ionosphere/{sv_name(int(one))}"))
            out[rows, 0] += iono.residual_m * value[epoch[rows]] * mapping[rows]
            out[rows, 1] += iono.residual_m * rate[epoch[rows]] * mapping[rows]
    return out


def _zenith(tropo: Troposphere, tag_ns: I8, streams: Streams) -> tuple[F8, F8]:
    """Zenith delay beyond the model, m, and its rate, m/s, by epoch."""
    zenith, rate = np.full(len(tag_ns), tropo.zenith_offset_m), np.zeros(len(tag_ns))
    if tropo.model != "none" and tropo.residual_m > 0.0:
        value, change = smooth_markov(tag_ns, tropo.residual_tau_s, streams("troposphere"))
        zenith, rate = zenith + tropo.residual_m * value, tropo.residual_m * change
    return zenith, rate


def _ionosphere(iono: Ionosphere, klobuchar: F8) -> tuple[int, F8, float]:
    coef = np.zeros(8)
    if iono.model == "broadcast":
        coef[:] = klobuchar
        return IONO_BROADCAST, coef, iono.scale
    if iono.model == "layer":
        coef[:3] = iono.vtec_tecu, iono.north_tecu_per_deg, iono.east_tecu_per_deg
        return IONO_LAYER, coef, 1.0
    return IONO_NONE, coef, 1.0
