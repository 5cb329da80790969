"""Keplerian broadcast orbits of every system by one kernel: GPS, Galileo, BeiDou, QZSS, NavIC.

The constellation is data: the constants of `MU` and `OMEGA_E`. The only branch is the frame of BeiDou's
geostationary satellites.
"""

import math

import numpy as np
from numpy.typing import NDArray

from starwise.constants import (
    C_LIGHT,
    K_A_DOT,
    K_CIC,
    K_CIS,
    K_CRC,
    K_CRS,
    K_CUC,
    K_CUS,
    K_DELTA_N,
    K_DELTA_N_DOT,
    K_E,
    K_I0,
    K_IDOT,
    K_M0,
    K_OMEGA,
    K_OMEGA0,
    K_OMEGA_DOT,
    K_SQRT_A,
    K_TOE_SOW,
    MU_BDS,
    MU_GAL,
    MU_GLO,
    MU_GPS,
    OMEGA_E_BDS,
    OMEGA_E_GLO,
    OMEGA_E_GPS,
)
from starwise.kernels._jit import njit

F8 = NDArray[np.float64]

#                 G        R        E       C       J       I (IRNSS SPS ICD 1.1, app. A)  S
MU: F8 = np.array([MU_GPS, MU_GLO, MU_GAL, MU_BDS, MU_GPS, MU_GPS, MU_GPS])
OMEGA_E: F8 = np.array([OMEGA_E_GPS, OMEGA_E_GLO, OMEGA_E_GPS, OMEGA_E_BDS, OMEGA_E_GPS, OMEGA_E_GPS, OMEGA_E_GPS])
_SIN5, _COS5 = math.sin(math.radians(-5.0)), math.cos(math.radians(-5.0))
_MAX_ITERATIONS = 12  # Newton from E = M: 4 at e = 0.02, 8 at e = 0.9
_LAST_STEP = 1e-8  # rad: Newton doubles the digits, so what remains after such a step is below 1e-16

State = tuple[float, float, float, float, float, float, float, float]


@njit
def eccentric_anomaly(M_k: float, e: float) -> tuple[float, float]:
    """Sine and cosine of the eccentric anomaly of a mean anomaly by Newton's method. IS-GPS-200N table 20-IV."""
    E_k = M_k + e * math.sin(M_k)
    for _ in range(_MAX_ITERATIONS):
        sin_E, cos_E = math.sin(E_k), math.cos(E_k)
        step = (M_k - E_k + e * sin_E) / (1.0 - e * cos_E)
        E_k += step
        if not abs(step) > _LAST_STEP:
            return _turned(sin_E, cos_E, step)
    return math.sin(E_k), math.cos(E_k)


@njit
def _turned(s: float, c: float, small: float) -> tuple[float, float]:
    """Sine and cosine of an angle plus a small one (up to 1e-3 rad) by its series: rounding, no further error."""
    s2, c2 = small * (1.0 - small * small / 6.0), 1.0 - small * small / 2.0 * (1.0 - small * small / 12.0)
    return s * c2 + c * s2, c * c2 - s * s2


@njit
def kepler(p: F8, system: int, geo: bool, t_k: float) -> State:
    """Position and velocity, ECEF m and m/s, and relativistic clock term, s and s/s, of a Keplerian record.

    Parameters
    ----------
    p : (N_EPH_PAR,) float64
        Columns ``K_*``.
    system : int
        Index in `SYSTEMS`: selects mu and the Earth's rate.
    geo : bool
        BeiDou geostationary satellite: the elements refer to a frame inclined by -5 deg.
    t_k : float
        Time since toe, s.

    Returns
    -------
    tuple of 8 floats
        x, y, z, vx, vy, vz, F e sqrt(A) sin(E_k) and its rate. The frame is that of the instant ``t_k``.

    References
    ----------
    IS-GPS-200N 20.3.3.4.3, table 20-IV, and 30.3.3.1.3, table 30-II (A_dot, delta_n_dot); Galileo OS SIS ICD
    2.1, 5.1.1; BDS-SIS-ICD-B1I-3.0, 5.2.4.12 (GEO); velocities are the time derivatives of the same formulas.
    """
    mu = MU[system]
    omega_e = OMEGA_E[system]
    e = p[K_E]

    # -- orbit plane
    A_0 = p[K_SQRT_A] * p[K_SQRT_A]
    A_k = A_0 + p[K_A_DOT] * t_k
    n_0 = math.sqrt(mu / (A_0 * A_0 * A_0))
    n_A = n_0 + p[K_DELTA_N] + 0.5 * p[K_DELTA_N_DOT] * t_k
    M_dot = n_0 + p[K_DELTA_N] + p[K_DELTA_N_DOT] * t_k
    sin_E, cos_E = eccentric_anomaly(p[K_M0] + n_A * t_k, e)
    root = math.sqrt(1.0 - e * e)
    sin_nu, cos_nu = root * sin_E / (1.0 - e * cos_E), (cos_E - e) / (1.0 - e * cos_E)
    E_dot = M_dot / (1.0 - e * cos_E)
    nu_dot = root * E_dot / (1.0 - e * cos_E)

    # -- second harmonic perturbations of phi_k = nu_k + omega
    so, co = math.sin(p[K_OMEGA]), math.cos(p[K_OMEGA])
    sp, cp = sin_nu * co + cos_nu * so, cos_nu * co - sin_nu * so
    s2, c2 = 2.0 * sp * cp, cp * cp - sp * sp
    du = p[K_CUS] * s2 + p[K_CUC] * c2
    r_k = A_k * (1.0 - e * cos_E) + p[K_CRS] * s2 + p[K_CRC] * c2
    i_k = p[K_I0] + p[K_IDOT] * t_k + p[K_CIS] * s2 + p[K_CIC] * c2
    u_dot = nu_dot * (1.0 + 2.0 * (p[K_CUS] * c2 - p[K_CUC] * s2))
    r_dot = p[K_A_DOT] * (1.0 - e * cos_E) + A_k * e * sin_E * E_dot + 2.0 * nu_dot * (p[K_CRS] * c2 - p[K_CRC] * s2)
    i_dot = p[K_IDOT] + 2.0 * nu_dot * (p[K_CIS] * c2 - p[K_CIC] * s2)

    # -- position in the orbital plane
    su, cu = _turned(sp, cp, du)  # u_k = phi_k + du
    xp, yp = r_k * cu, r_k * su
    xp_dot = r_dot * cu - yp * u_dot
    yp_dot = r_dot * su + xp * u_dot

    # -- longitude of the ascending node; for GEO without the Earth's rotation
    Omega_dot = p[K_OMEGA_DOT] if geo else p[K_OMEGA_DOT] - omega_e
    Omega_k = p[K_OMEGA0] + Omega_dot * t_k - omega_e * p[K_TOE_SOW]
    sO, cO = math.sin(Omega_k), math.cos(Omega_k)
    si, ci = math.sin(i_k), math.cos(i_k)

    # -- Earth fixed (GEO: the inertial frame of BDS-SIS-ICD-B1I-3.0, 5.2.4.12)
    x = xp * cO - yp * ci * sO
    y = xp * sO + yp * ci * cO
    z = yp * si
    w_dot = yp_dot * ci - yp * si * i_dot
    vx = xp_dot * cO - w_dot * sO - y * Omega_dot
    vy = xp_dot * sO + w_dot * cO + x * Omega_dot
    vz = yp_dot * si + yp * ci * i_dot
    if geo:
        # R_Z(omega_e t_k) R_X(-5 deg)
        so, co = math.sin(omega_e * t_k), math.cos(omega_e * t_k)
        yi, zi = _COS5 * y + _SIN5 * z, -_SIN5 * y + _COS5 * z
        wy, wz = _COS5 * vy + _SIN5 * vz, -_SIN5 * vy + _COS5 * vz
        vx, vy, vz = (
            co * vx + so * wy + omega_e * (co * yi - so * x),
            co * wy - so * vx - omega_e * (co * x + so * yi),
            wz,
        )
        x, y, z = co * x + so * yi, co * yi - so * x, zi

    # -- relativity: F = -2 sqrt(mu) / c^2, IS-GPS-200N 20.3.3.3.3.1
    F = -2.0 * math.sqrt(mu) / (C_LIGHT * C_LIGHT)
    rel = F * e * p[K_SQRT_A] * sin_E
    rel_dot = F * e * p[K_SQRT_A] * cos_E * E_dot
    return x, y, z, vx, vy, vz, rel, rel_dot
