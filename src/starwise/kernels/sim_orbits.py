"""True satellites and true geometry of the simulator: orbits, satellite clocks, iterated light time.

Written apart from the kernels that evaluate broadcast messages: what is tested does not make its own truth.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from starwise.constants import (
    AE_GLO,
    C_LIGHT,
    J2_GLO,
    K_A_DOT,
    K_CIC,
    K_CIS,
    K_CRC,
    K_CRS,
    K_CUC,
    K_CUS,
    K_DELTA_N,
    K_E,
    K_I0,
    K_IDOT,
    K_M0,
    K_OMEGA,
    K_OMEGA0,
    K_OMEGA_DOT,
    K_SQRT_A,
    K_TOE_SOW,
    MU_GLO,
    OMEGA_E_GLO,
    OMEGA_E_GPS,
    WGS84_A,
    WGS84_E2,
)
from starwise.kernels._jit import njit

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
Eight = tuple[float, float, float, float, float, float, float, float]

ORBIT_KEPLER = 0
ORBIT_NODES = 1
REL_NONE = 0
REL_ECCENTRICITY = 1
REL_DOT_PRODUCT = 2
N_ERRORS = 4  # radial, along, across, clock: constant + one sinusoid each


class OrbitTable(NamedTuple):
    """True orbits and clocks of n satellites.

    Attributes
    ----------
    kind, relativity : (n,) int64
        ``ORBIT_*``, ``REL_*``.
    geo : (n,) int64
        1 where the elements refer to the inclined frame of BeiDou's geostationary satellites.
    mu, omega_e : (n,) float64
        Constants of the system.
    par : (n, N_EPH_PAR) float64
        Keplerian elements, columns ``K_*``.
    toe_ns, toc_ns : (n,) int64
        Reference times of elements and clock, GPST.
    clock : (n, 3) float64
        Polynomial of the clock, s, s/s, s/s^2.
    start_ns : int
        Time of the first node of tabulated orbits.
    step_s : float
        Their spacing.
    slot : (n,) int64
        Row in ``nodes``, -1 for Keplerian orbits.
    nodes : (m, n_nodes, 6) float64
        Position and velocity, ECEF of the node's instant.
    error : (n, N_ERRORS, 4) float64
        Error of the broadcast ephemeris, to be added to orbit and clock: constant m, amplitude m, rate rad/s,
        phase rad, for radial, along track, across track and clock.
    error_ns : int
        Origin of the sinusoids.
    """

    kind: I8
    relativity: I8
    geo: I8
    mu: F8
    omega_e: F8
    par: F8
    toe_ns: I8
    toc_ns: I8
    clock: F8
    start_ns: int
    step_s: float
    slot: I8
    nodes: F8
    error: F8
    error_ns: int


@njit
def _solved(M: float, e: float) -> float:
    """Eccentric anomaly by Halley's method."""
    E = M + e * math.sin(M) / (1.0 - math.sin(M + e) + math.sin(M))
    for _ in range(8):
        s, c = e * math.sin(E), e * math.cos(E)
        f = E - s - M
        step = f / (1.0 - c - 0.5 * f * s / (1.0 - c))
        E -= step
        if abs(step) < 1e-14:
            break
    return E


@njit
def kepler_truth(p: F8, mu: float, omega_e: float, geo: bool, t_k: float) -> Eight:
    """Position, velocity (ECEF of the instant, m, m/s), e sqrt(A) sin E and its rate, of Keplerian elements.

    The elements mean what they mean in a broadcast message (IS-GPS-200N table 20-IV; BDS-SIS-ICD-B1I-3.0
    5.2.4.12 for GEO); the orbit is put together from the plane's unit vectors.
    """
    e = p[K_E]
    A = p[K_SQRT_A] ** 2 + p[K_A_DOT] * t_k
    n = math.sqrt(mu) / p[K_SQRT_A] ** 3 + p[K_DELTA_N]
    M = p[K_M0] + n * t_k
    E = _solved(M - 2.0 * math.pi * math.floor(M / (2.0 * math.pi) + 0.5), e)
    sE, cE = math.sin(E), math.cos(E)
    d = 1.0 - e * cE
    E_dot = n / d
    q = math.sqrt((1.0 - e) * (1.0 + e))
    # argument of latitude: true anomaly by addition theorems, no arctangent of small differences
    cn, sn = (cE - e) / d, q * sE / d
    cw, sw = math.cos(p[K_OMEGA]), math.sin(p[K_OMEGA])
    c1, s1 = cn * cw - sn * sw, sn * cw + cn * sw
    phi_dot = q * E_dot / d
    c2, s2 = c1 * c1 - s1 * s1, 2.0 * s1 * c1
    du = p[K_CUS] * s2 + p[K_CUC] * c2
    r = A * d + p[K_CRS] * s2 + p[K_CRC] * c2
    i = p[K_I0] + p[K_IDOT] * t_k + p[K_CIS] * s2 + p[K_CIC] * c2
    u_dot = phi_dot * (1.0 + 2.0 * (p[K_CUS] * c2 - p[K_CUC] * s2))
    r_dot = p[K_A_DOT] * d + A * e * sE * E_dot + 2.0 * phi_dot * (p[K_CRS] * c2 - p[K_CRC] * s2)
    i_dot = p[K_IDOT] + 2.0 * phi_dot * (p[K_CIS] * c2 - p[K_CIC] * s2)
    cd, sd = math.cos(du), math.sin(du)
    cu, su = c1 * cd - s1 * sd, s1 * cd + c1 * sd

    node_dot = p[K_OMEGA_DOT] if geo else p[K_OMEGA_DOT] - omega_e
    node = p[K_OMEGA0] - omega_e * p[K_TOE_SOW] + node_dot * t_k
    cO, sO = math.cos(node), math.sin(node)
    ci, si = math.cos(i), math.sin(i)
    # unit vectors: along the radius and, in the plane, ahead of it; w is normal to the plane
    rx, ry, rz = cu * cO - su * ci * sO, cu * sO + su * ci * cO, su * si
    ax, ay, az = -su * cO - cu * ci * sO, -su * sO + cu * ci * cO, cu * si
    wx, wy, wz = si * sO, -si * cO, ci
    x, y, z = r * rx, r * ry, r * rz
    along, across = r * u_dot, r * su * i_dot
    vx = r_dot * rx + along * ax + across * wx - node_dot * y
    vy = r_dot * ry + along * ay + across * wy + node_dot * x
    vz = r_dot * rz + along * az + across * wz
    if geo:
        # out of the frame inclined by 5 deg about x, then into the one that turns with the Earth from toe on
        c5, s5 = math.cos(math.radians(5.0)), math.sin(math.radians(5.0))
        y, z = c5 * y - s5 * z, s5 * y + c5 * z
        vy, vz = c5 * vy - s5 * vz, s5 * vy + c5 * vz
        ct, st = math.cos(omega_e * t_k), math.sin(omega_e * t_k)
        x, y = ct * x + st * y, ct * y - st * x
        vx, vy = ct * vx + st * vy + omega_e * y, ct * vy - st * vx - omega_e * x
    return x, y, z, vx, vy, vz, e * p[K_SQRT_A] * sE, e * p[K_SQRT_A] * cE * E_dot


@njit
def _between_nodes(nodes: F8, step: float, t: float) -> Eight:
    """Cubic Hermite between nodes (position and velocity); NaN outside them."""
    n = nodes.shape[0]
    k = math.floor(t / step)
    if k < 0 or k >= n - 1:
        return np.nan, np.nan, np.nan, np.nan, np.nan, np.nan, 0.0, 0.0
    s = t / step - k
    a, b = nodes[k], nodes[k + 1]
    h00, h01 = (1.0 + 2.0 * s) * (1.0 - s) * (1.0 - s), s * s * (3.0 - 2.0 * s)
    h10, h11 = s * (1.0 - s) * (1.0 - s) * step, s * s * (s - 1.0) * step
    d00 = 6.0 * s * (s - 1.0) / step
    d10, d11 = (3.0 * s - 1.0) * (s - 1.0), s * (3.0 * s - 2.0)
    return (
        h00 * a[0] + h10 * a[3] + h01 * b[0] + h11 * b[3],
        h00 * a[1] + h10 * a[4] + h01 * b[1] + h11 * b[4],
        h00 * a[2] + h10 * a[5] + h01 * b[2] + h11 * b[5],
        d00 * (a[0] - b[0]) + d10 * a[3] + d11 * b[3],
        d00 * (a[1] - b[1]) + d10 * a[4] + d11 * b[4],
        d00 * (a[2] - b[2]) + d10 * a[5] + d11 * b[5],
        0.0,
        0.0,
    )


@njit
def true_state(table: OrbitTable, k: int, t_ns: int, dt: float) -> Eight:
    """Position, velocity (ECEF of the instant), clock offset (s) and drift of satellite k, dt seconds after t_ns."""
    if table.kind[k] == ORBIT_KEPLER:
        x, y, z, vx, vy, vz, ecc, ecc_dot = kepler_truth(
            table.par[k], table.mu[k], table.omega_e[k], table.geo[k] == 1, (t_ns - table.toe_ns[k]) * 1e-9 + dt
        )
    else:
        x, y, z, vx, vy, vz, ecc, ecc_dot = _between_nodes(
            table.nodes[table.slot[k]], table.step_s, (t_ns - table.start_ns) * 1e-9 + dt
        )
    t_c = (t_ns - table.toc_ns[k]) * 1e-9 + dt
    a = table.clock[k]
    clock = a[0] + t_c * (a[1] + t_c * a[2])
    drift = a[1] + 2.0 * t_c * a[2]
    w = OMEGA_E_GPS
    if table.relativity[k] == REL_ECCENTRICITY:
        F = -2.0 * math.sqrt(table.mu[k]) / (C_LIGHT * C_LIGHT)
        clock += F * ecc
        drift += F * ecc_dot
    elif table.relativity[k] == REL_DOT_PRODUCT:
        # -2 r.v / c^2 (IS-GPS-200N 20.3.3.3.3.1); the frame's rotation does not change r.v
        clock -= 2.0 * (x * vx + y * vy + z * vz) / (C_LIGHT * C_LIGHT)
        r = math.sqrt(x * x + y * y + z * z)
        v2 = (vx - w * y) ** 2 + (vy + w * x) ** 2 + vz * vz
        drift -= 2.0 * (v2 - table.mu[k] / r) / (C_LIGHT * C_LIGHT)
    err = table.error[k]
    if err[0, 0] != 0.0 or err[0, 1] != 0.0 or err[1, 1] != 0.0 or err[2, 1] != 0.0 or err[3, 1] != 0.0:
        t = (t_ns - table.error_ns) * 1e-9 + dt
        eR, dR = _sinusoid(err[0], t)
        eA, dA = _sinusoid(err[1], t)
        eC, dC = _sinusoid(err[2], t)
        eT, dT = _sinusoid(err[3], t)
        clock += eT / C_LIGHT
        drift += dT / C_LIGHT
        ix, iy, iz = vx - w * y, vy + w * x, vz  # inertial velocity along the axes of the instant
        r = math.sqrt(x * x + y * y + z * z)
        Rx, Ry, Rz = x / r, y / r, z / r
        hx, hy, hz = y * iz - z * iy, z * ix - x * iz, x * iy - y * ix
        h = math.sqrt(hx * hx + hy * hy + hz * hz)
        Cx, Cy, Cz = hx / h, hy / h, hz / h
        Ax, Ay, Az = Cy * Rz - Cz * Ry, Cz * Rx - Cx * Rz, Cx * Ry - Cy * Rx
        n = h / (r * r)
        dx, dy, dz = eR * Rx + eA * Ax + eC * Cx, eR * Ry + eA * Ay + eC * Cy, eR * Rz + eA * Az + eC * Cz
        gR, gA = dR - n * eA, dA + n * eR
        x, y, z = x + dx, y + dy, z + dz
        vx += gR * Rx + gA * Ax + dC * Cx + w * dy
        vy += gR * Ry + gA * Ay + dC * Cy - w * dx
        vz += gR * Rz + gA * Az + dC * Cz
    return x, y, z, vx, vy, vz, clock, drift


@njit
def _sinusoid(c: F8, t: float) -> tuple[float, float]:
    """Constant plus sinusoid, and its rate."""
    return c[0] + c[1] * math.sin(c[2] * t + c[3]), c[1] * c[2] * math.cos(c[2] * t + c[3])


@njit
def true_states(table: OrbitTable, index: I8, t_ns: I8, out: F8) -> None:
    """`true_state` of rows (satellite, time): (n, 8) position, velocity, clock, drift."""
    for i in range(len(index)):
        s = true_state(table, index[i], t_ns[i], 0.0)
        for j in range(8):
            out[i, j] = s[j]


@njit
def glonass_gravity(x: float, y: float, z: float, vx: float, vy: float) -> tuple[float, float, float]:
    """Acceleration in PZ-90 (turning): central body, second zonal harmonic, centrifugal and Coriolis."""
    r2 = x * x + y * y + z * z
    r = math.sqrt(r2)
    g = MU_GLO / (r2 * r)
    k = 1.5 * J2_GLO * (AE_GLO * AE_GLO) / r2
    f = 5.0 * z * z / r2
    w = OMEGA_E_GLO
    return (
        -g * x * (1.0 + k * (1.0 - f)) + w * (w * x + 2.0 * vy),
        -g * y * (1.0 + k * (1.0 - f)) + w * (w * y - 2.0 * vx),
        -g * z * (1.0 + k * (3.0 - f)),
    )


@njit
def integrate(nodes: F8, start: int, step: float) -> None:
    """Fill (n_nodes, 6) states of a satellite from node ``start`` in both directions.

    Equations of motion of GLONASS ICD L1/L2 5.1, A.3.1.2, without the Moon and the Sun; Runge-Kutta of order 4 with
    two steps a node (15 s: 1e-7 m in a day).
    """
    s = np.empty(6)
    k = np.empty((4, 6))
    for side in range(2):
        h = 0.5 * step if side == 0 else -0.5 * step
        at = start
        s[:] = nodes[start]
        while 0 <= at + (1 if side == 0 else -1) < nodes.shape[0]:
            for _ in range(2):
                for stage in range(4):
                    f = 0.0 if stage == 0 else (h if stage == 3 else 0.5 * h)
                    b = k[stage - 1] if stage > 0 else k[0]
                    y = np.empty(6)
                    for j in range(6):
                        y[j] = s[j] + (f * b[j] if stage > 0 else 0.0)
                    ax, ay, az = glonass_gravity(y[0], y[1], y[2], y[3], y[4])
                    k[stage, 0], k[stage, 1], k[stage, 2] = y[3], y[4], y[5]
                    k[stage, 3], k[stage, 4], k[stage, 5] = ax, ay, az
                for j in range(6):
                    s[j] += h / 6.0 * (k[0, j] + 2.0 * k[1, j] + 2.0 * k[2, j] + k[3, j])
            at += 1 if side == 0 else -1
            nodes[at] = s


@njit
def kepler_many(par: F8, mu: float, omega_e: float, geo: bool, t_k: F8, out: F8) -> None:
    """Positions (n, 3) of one set of elements at times since toe: for fitting messages."""
    for i in range(len(t_k)):
        s = kepler_truth(par, mu, omega_e, geo, t_k[i])
        out[i, 0], out[i, 1], out[i, 2] = s[0], s[1], s[2]


@njit
def directions(table: OrbitTable, t_ns: I8, pos_e: F8, elevation: F8, azimuth: F8) -> None:
    """Elevation and azimuth, rad, (n_epochs, n_satellites), with a nominal light time: for masks (to 1e-6 rad)."""
    for i in range(len(t_ns)):
        px, py, pz = pos_e[i, 0], pos_e[i, 1], pos_e[i, 2]
        ex, ey, ez, nx, ny, nz, ux, uy, uz = _local_axes(px, py, pz)
        for k in range(len(table.kind)):
            s = true_state(table, k, t_ns[i], -0.08)
            wt = OMEGA_E_GPS * 0.08
            dx, dy, dz = s[0] + wt * s[1] - px, s[1] - wt * s[0] - py, s[2] - pz
            d = math.sqrt(dx * dx + dy * dy + dz * dz)
            elevation[i, k] = math.asin((ux * dx + uy * dy + uz * dz) / d)
            azimuth[i, k] = math.atan2(ex * dx + ey * dy + ez * dz, nx * dx + ny * dy + nz * dz)


@njit
def _local_axes(
    px: float, py: float, pz: float
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """East, north and up (normal of the ellipsoid) at a position."""
    rho = math.sqrt(px * px + py * py)
    lat = math.atan2(pz, rho * (1.0 - WGS84_E2))
    for _ in range(3):
        s = math.sin(lat)
        lat = math.atan2(pz + WGS84_E2 * WGS84_A / math.sqrt(1.0 - WGS84_E2 * s * s) * s, rho)
    sl, cl = math.sin(lat), math.cos(lat)
    so, co = (py / rho, px / rho) if rho > 0.0 else (0.0, 1.0)
    return -so, co, 0.0, -sl * co, -sl * so, cl, cl * co, cl * so, sl


class Paths(NamedTuple):
    """True geometry of pairs (epoch, satellite): outputs, all (n,) but positions and velocities."""

    sat_pos: F8  # (n, 3) m, ECEF at transmission
    sat_vel: F8  # (n, 3) m/s
    sat_clock: F8  # s
    sat_drift: F8  # s/s
    range_m: F8  # c * light time
    range_rate: F8  # rate of c * light time against true time of reception, m/s
    code_m: F8  # c * (reading of the receiver - reading of the satellite)
    rate_mps: F8  # its rate against the receiver's clock
    elevation: F8  # rad
    azimuth: F8  # rad, 0..2 pi


@njit
def paths(
    table: OrbitTable, index: I8, epoch: I8, tag_ns: I8, bias_s: F8, drift: F8, pos_e: F8, vel_e: F8, out: Paths
) -> None:
    """Light paths of pairs (epoch, satellite), by iteration to the last digit.

    Parameters
    ----------
    table : OrbitTable
    index, epoch : (n,) int64
        Satellite and epoch of each pair.
    tag_ns : (m,) int64
        Receiver time tags, GPST ns.
    bias_s, drift : (m,) float64
        Receiver clock: reading minus true time, s, and its rate against the reading.
    pos_e, vel_e : (m, 3) float64
        Receiver at the *true* time of reception.
    out : Paths

    Notes
    -----
    ``c tau = |R(omega_e tau) s(t - tau) - p(t)|`` with t the true time of reception; its derivative gives the
    range rate without approximation. Groves (2013) 8.36 is its closed form to first order.
    """
    w = OMEGA_E_GPS
    for i in range(len(index)):
        k, m = index[i], epoch[i]
        px, py, pz = pos_e[m, 0], pos_e[m, 1], pos_e[m, 2]
        # the orbit is evaluated at a nominal light time, where a straight line from there says, and with that again
        # a straight line: 1e-13 s after the first round (curvature: 3e-5 m), rounding after the second
        tau = 0.075
        dx, dy, dz, d = 0.0, 0.0, 0.0, 1.0
        sx, sy, x, y, z = 0.0, 0.0, 0.0, 0.0, 0.0
        s = true_state(table, k, tag_ns[m], -bias_s[m] - tau)
        for turn in range(2):
            at = tau
            if turn == 1:
                s = true_state(table, k, tag_ns[m], -bias_s[m] - at)
            for _ in range(4):
                x, y, z = s[0] + (at - tau) * s[3], s[1] + (at - tau) * s[4], s[2] + (at - tau) * s[5]
                c, sn = math.cos(w * tau), math.sin(w * tau)
                sx, sy = c * x + sn * y, c * y - sn * x
                dx, dy, dz = sx - px, sy - py, z - pz
                d = math.sqrt(dx * dx + dy * dy + dz * dz)
                tau = d / C_LIGHT
        c, sn = math.cos(w * tau), math.sin(w * tau)
        rvx, rvy = c * s[3] + sn * s[4], c * s[4] - sn * s[3]
        ux, uy, uz = dx / d, dy / d, dz / d
        # c tau' = u . (R v_s (1 - tau') + (dR/dtau) s tau' - v_r)
        towards = ux * rvx + uy * rvy + uz * s[5]
        turning = w * (ux * sy - uy * sx)
        own = ux * vel_e[m, 0] + uy * vel_e[m, 1] + uz * vel_e[m, 2]
        tau_dot = (towards - own) / (C_LIGHT + towards - turning)
        out.sat_pos[i, 0], out.sat_pos[i, 1], out.sat_pos[i, 2] = x, y, z
        out.sat_vel[i, 0], out.sat_vel[i, 1], out.sat_vel[i, 2] = s[3], s[4], s[5]
        out.sat_clock[i], out.sat_drift[i] = s[6], s[7]
        out.range_m[i] = C_LIGHT * tau
        out.range_rate[i] = C_LIGHT * tau_dot
        out.code_m[i] = C_LIGHT * tau + C_LIGHT * (bias_s[m] - s[6])
        # d(reading of satellite)/d(reading of receiver) = (1 + drift_s)(1 - tau')(1 - drift_r), less one
        slow = drift[m] + tau_dot - drift[m] * tau_dot
        out.rate_mps[i] = C_LIGHT * (slow - s[7] * (1.0 - slow))
        ex, ey, ez, nx, ny, nz, vx, vy, vz = _local_axes(px, py, pz)
        e, n, u = ex * ux + ey * uy + ez * uz, nx * ux + ny * uy + nz * uz, vx * ux + vy * uy + vz * uz
        out.elevation[i] = math.asin(min(max(u, -1.0), 1.0))
        az = math.atan2(e, n)
        out.azimuth[i] = az if az >= 0.0 else az + 2.0 * math.pi
