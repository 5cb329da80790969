"""Orbits of the simulated sky: elements from tables, states from two-line elements, messages fitted to either."""

import math
import re
from collections.abc import Sequence
from typing import Final

import numpy as np

from starwise.constants import (
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
    MU_BDS,
    MU_GAL,
    MU_GLO,
    MU_GPS,
    N_EPH_PAR,
    NS,
    OMEGA_E_BDS,
    OMEGA_E_GLO,
    OMEGA_E_GPS,
    SYS_C,
    SYS_E,
    SYS_G,
    SYS_J,
    SYS_R,
    SYSTEMS,
    WEEK_S,
)
from starwise.errors import StarwiseError
from starwise.gnsstime import BDT_OFFSET_S, gpst_to_utc, to_datetime
from starwise.kernels.sim_orbits import kepler_many
from starwise.signals import sv_id
from starwise.types import F8, I8

MU: Final = {SYS_G: MU_GPS, SYS_R: MU_GLO, SYS_E: MU_GAL, SYS_C: MU_BDS, SYS_J: MU_GPS}
OMEGA_E: Final = {
    SYS_G: OMEGA_E_GPS, SYS_R: OMEGA_E_GLO, SYS_E: OMEGA_E_GPS, SYS_C: OMEGA_E_BDS, SYS_J: OMEGA_E_GPS,
}  # fmt: skip
NODE_STEP_S: Final = 30.0
"""Spacing of tabulated orbits: the cubic between nodes is 0.03 mm off at most (r n^4 h^4 / 384)."""


def wrapped(angle: float) -> float:
    """Angle in -pi..pi."""
    return math.remainder(angle, 2.0 * math.pi)


def is_geo(sv: int) -> bool:
    """Whether a satellite's message uses BeiDou's frame of geostationary satellites."""
    number = sv & 255
    return sv >> 8 == SYS_C and (number <= 5 or 59 <= number <= 63)


def sow(t_ns: int, system: int) -> float:
    """Seconds of the system's own week."""
    own = t_ns - (BDT_OFFSET_S * NS if system == SYS_C else 0)
    return (own % (WEEK_S * NS)) / NS


def gmst(t_ns: int) -> float:
    """Greenwich mean sidereal time, rad, of a GPST; UT1 is taken as UTC (below 0.9 s, 15 m on the ground a second).

    References
    ----------
    IAU 1982: Aoki et al., Astron. Astrophys. 105 (1982).
    """
    utc = gpst_to_utc(int(t_ns))
    days = (utc - 630_763_200 * NS) / (86_400 * NS)  # since J2000.0, 2000-01-01 12:00 UTC
    T = days / 36_525.0
    s = 67_310.54841 + (876_600.0 * 3_600.0 + 8_640_184.812866) * T + 0.093104 * T**2 - 6.2e-6 * T**3
    return math.radians(s / 240.0) % (2.0 * math.pi)


def elements(
    system: int,
    toe_ns: int,
    a: float,
    e: float,
    i: float,
    longitude: float,
    perigee: float,
    anomaly: float,
    node_rate: float,
    geo: bool = False,
) -> F8:
    """Keplerian parameters (N_EPH_PAR,) of an orbit given by the longitude of its node at ``toe_ns``. Angles rad.

    For geostationary satellites the elements are turned into the inclined frame; their ``node_rate`` must be 0.
    """
    par = np.zeros(N_EPH_PAR)
    if geo:
        i, longitude, perigee = _inclined(i, longitude, perigee)
    par[K_SQRT_A], par[K_E], par[K_I0] = math.sqrt(a), e, i
    par[K_OMEGA], par[K_M0], par[K_OMEGA_DOT] = wrapped(perigee), wrapped(anomaly), node_rate
    par[K_TOE_SOW] = sow(toe_ns, system)
    par[K_OMEGA0] = wrapped(longitude + OMEGA_E[system] * par[K_TOE_SOW])
    return par


def _inclined(i: float, node: float, perigee: float) -> tuple[float, float, float]:
    """Inclination, node and perigee of a plane in the frame turned by 5 deg about x (BDS-SIS-ICD-B1I-3.0 5.2.4.12)."""
    c5, s5 = math.cos(math.radians(5.0)), math.sin(math.radians(5.0))
    R = np.array([[1.0, 0.0, 0.0], [0.0, c5, s5], [0.0, -s5, c5]])
    M = R @ _plane(i, node, perigee)
    inclination = math.acos(min(max(M[2, 2], -1.0), 1.0))
    return inclination, math.atan2(M[0, 2], -M[1, 2]), math.atan2(M[2, 0], M[2, 1])


def _plane(i: float, node: float, perigee: float) -> F8:
    """Columns: directions of perigee, 90 deg ahead of it, and the plane's normal."""
    ci, si, cO, sO, cw, sw = (f(v) for v in (i, node, perigee) for f in (math.cos, math.sin))
    return np.array(
        [
            [cO * cw - sO * sw * ci, -cO * sw - sO * cw * ci, sO * si],
            [sO * cw + cO * sw * ci, -sO * sw + cO * cw * ci, -cO * si],
            [sw * si, cw * si, ci],
        ]
    )


def rebased(par: F8, toe_ns: int, new_toe_ns: int, system: int) -> F8:
    """The same orbit with another reference time (exact; not for geostationary frames or changing axes)."""
    D = (new_toe_ns - toe_ns) / NS
    out = par.copy()
    n = math.sqrt(MU[system]) / par[K_SQRT_A] ** 3 + par[K_DELTA_N]
    out[K_M0] = wrapped(par[K_M0] + math.fmod(n * D, 2.0 * math.pi))
    out[K_I0] = par[K_I0] + par[K_IDOT] * D
    out[K_TOE_SOW] = sow(new_toe_ns, system)
    turned = out[K_TOE_SOW] - par[K_TOE_SOW] - D  # whole weeks
    out[K_OMEGA0] = wrapped(par[K_OMEGA0] + par[K_OMEGA_DOT] * D + OMEGA_E[system] * turned)
    return out


# -- fitting a message --------------------------------------------------------------------------------------------
_HARMONICS: Final = (K_CUC, K_CUS, K_CRC, K_CRS, K_CIC, K_CIS)
_STEP: Final = np.array(
    # of A m, e cos w, e sin w, i0, Omega0, w + M0, delta_n, Omega_dot, i_dot, Cuc, Cus, Crc, Crs, Cic, Cis
    [10.0, 1e-6, 1e-6, 1e-6, 1e-6, 1e-6, 1e-10, 1e-10, 1e-10, 1e-6, 1e-6, 10.0, 10.0, 1e-6, 1e-6]
)
_PRIOR: Final = np.array(
    # 1 sigma about zero (infinite for the six elements): messages hold no more (IS-GPS-200N table 20-III)
    [np.inf] * 6 + [5e-9, 2e-8, 1e-9, 3e-5, 3e-5, 1e3, 1e3, 3e-5, 3e-5]
)
_FIT_SIGMA_M: Final = 1e-3


def _par_of(x: F8, toe_sow: float, system: int) -> F8:
    par = np.zeros(N_EPH_PAR)
    par[K_SQRT_A], par[K_E] = math.sqrt(x[0]), math.hypot(x[1], x[2])
    par[K_OMEGA] = math.atan2(x[2], x[1])
    par[K_I0], par[K_OMEGA0] = x[3], wrapped(x[4] + OMEGA_E[system] * toe_sow)
    par[K_M0] = wrapped(x[5] - par[K_OMEGA])
    par[K_DELTA_N], par[K_OMEGA_DOT], par[K_IDOT] = x[6:9]
    par[list(_HARMONICS)] = x[9:15]
    par[K_TOE_SOW] = toe_sow
    return par


def fitted(sv: int, toe_ns: int, t_ns: I8, pos_e: F8, vel_e: F8) -> tuple[F8, float]:
    """Keplerian message (N_EPH_PAR,) closest to an orbit, and the RMS of what remains, m.

    Parameters
    ----------
    sv : int
    toe_ns : int
        Reference time, GPST.
    t_ns : (n,) int64
        Times of the samples, around ``toe_ns``; one of them nearest to it gives the start.
    pos_e, vel_e : (n, 3) float64
        ECEF of each instant, m, m/s.

    Notes
    -----
    Gauss-Newton on the non-singular elements e cos w, e sin w, w + M0, with weak priors on rates and harmonics.
    """
    system = sv >> 8
    geo = is_geo(sv)
    mu, omega = MU[system], OMEGA_E[system]
    t_k = (t_ns - toe_ns) / NS
    near = int(np.argmin(np.abs(t_k)))
    start = _osculating(pos_e[near], vel_e[near], mu, omega, geo, float(t_k[near]))
    x = np.concatenate([start, np.zeros(9)])
    toe_sow = sow(toe_ns, system)
    target = np.ascontiguousarray(pos_e).ravel()
    prior = _FIT_SIGMA_M / _PRIOR

    def model(values: F8) -> F8:
        out = np.empty((len(t_k), 3))
        kepler_many(_par_of(values, toe_sow, system), mu, omega, geo, t_k, out)
        return out.ravel()

    residual = target - model(x)
    for _ in range(12):
        J = np.stack([(model(x + d) - model(x - d)) / (2.0 * h) for d, h in zip(np.diag(_STEP), _STEP, strict=True)])
        A = np.concatenate([J.T, np.diag(prior)]) * _STEP
        b = np.concatenate([residual, -prior * x])
        step = np.linalg.lstsq(A, b, rcond=1e-13)[0] * _STEP
        x = x + step
        residual = target - model(x)
        if np.abs(step / _STEP).max() < 1e-6:
            break
    return _par_of(x, toe_sow, system), float(np.sqrt(np.mean(residual**2) * 3.0))


def _osculating(pos: F8, vel: F8, mu: float, omega: float, geo: bool, t_k: float) -> F8:
    """A, e cos w, e sin w, i, longitude of the node at toe, w + M at toe, of a state ``t_k`` after toe."""
    v = vel + omega * np.array([-pos[1], pos[0], 0.0])
    turn = omega * t_k  # into axes that stand still since toe
    c, s = math.cos(turn), math.sin(turn)
    Z = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    if geo:
        c5, s5 = math.cos(math.radians(5.0)), math.sin(math.radians(5.0))
        Z = np.array([[1.0, 0.0, 0.0], [0.0, c5, s5], [0.0, -s5, c5]]) @ Z
    r, v = Z @ pos, Z @ v
    h = np.cross(r, v)
    a = 1.0 / (2.0 / np.linalg.norm(r) - v @ v / mu)
    ecc = np.cross(v, h) / mu - r / np.linalg.norm(r)
    inc = math.acos(h[2] / np.linalg.norm(h))
    node = math.atan2(h[0], -h[1])
    to_node = np.array([math.cos(node), math.sin(node), 0.0])
    ahead = np.cross(h / np.linalg.norm(h), to_node)
    ex, ey = ecc @ to_node, ecc @ ahead
    u = math.atan2(r @ ahead, r @ to_node)
    e, w = math.hypot(ex, ey), math.atan2(ey, ex)
    nu = u - w
    E = 2.0 * math.atan2(math.sqrt(1.0 - e) * math.sin(nu / 2.0), math.sqrt(1.0 + e) * math.cos(nu / 2.0))
    M = E - e * math.sin(E)
    return np.array([a, ex, ey, inc, node, w + M - math.sqrt(mu / a**3) * t_k])


# -- two-line elements ---------------------------------------------------------------------------------------------
def read_tle(text: str, file: str) -> list[tuple[str, str, str]]:
    """Satellite name, first and second line of every navigation satellite of a three-line TLE text.

    The name line says which satellite it is: ``(PRN 13)``, ``(PRN E11)``, ``(C19)``, ``QZSS/PRN 184`` or a RINEX name.
    GLONASS lines carry no slot: R01, R02 ... in the order of the file.

    Raises
    ------
    StarwiseError
        A line is no element set, or there is no navigation satellite.
    """
    lines = [(k, line.rstrip()) for k, line in enumerate(text.splitlines(), 1) if line.strip()]
    found: list[tuple[str, str, str]] = []
    glonass = 0
    name = ""
    for at, (number, line) in enumerate(lines):
        if not re.match(r"1 [ 0-9A-Z]{5}", line):
            if not line.startswith("2 "):
                name = line
            continue
        second = lines[at + 1][1] if at + 1 < len(lines) else ""
        if len(line) < 64 or len(second) < 63 or not second.startswith("2 ") or second[2:7] != line[2:7]:
            raise StarwiseError(
                "not a two-line element set", file=file, line=number, found=line, wanted="lines 1 and 2 of a satellite"
            )
        sv = _tle_satellite(name)
        if sv == "R":
            glonass += 1
            sv = f"R{glonass:02d}"
        if sv:
            found.append((sv, line, second))
    if not found:
        raise StarwiseError(
            "no navigation satellite in the two-line elements", file=file, wanted="(PRN 13) in a name line"
        )
    return found


def _tle_satellite(name: str) -> str:
    """RINEX name, ``R`` for GLONASS, empty for others."""
    text = name.upper()
    if match := re.search(r"QZSS?/?\s*PRN\s*(\d{3})", text):
        prn = int(match.group(1))
        return f"J{prn - (192 if prn > 192 else 182):02d}"
    if match := re.search(r"\bPRN\s+([GEC]?)(\d{1,2})\b", text):
        return f"{match.group(1) or 'G'}{int(match.group(2)):02d}"
    if match := re.search(r"\(C(\d\d)\)", text):
        return f"C{match.group(1)}"
    if re.match(r"(0 )?(COSMOS|GLONASS)", text):
        return "R"
    if match := re.match(rf"(0 )?([{SYSTEMS}]\d\d)$", text.strip()):
        return match.group(2)
    return ""


def tle_nodes(sets: Sequence[tuple[str, str, str]], start_ns: int, n_nodes: int) -> tuple[list[int], F8]:
    """Satellites, and their states at nodes (n_sv, n_nodes, 6) ECEF m and m/s, from two-line elements by SGP4.

    True equator, mean equinox (TEME) to Earth-fixed by mean sidereal time; polar motion and UT1 - UTC left out (they
    turn the whole sky by 15 m on the ground at most, which nobody in it can see). Velocities are derivatives of the
    positions.

    Raises
    ------
    StarwiseError
        The package sgp4 is not installed, or a set cannot be propagated to the day.
    """
    try:
        from sgp4.api import Satrec
    except ImportError:
        raise StarwiseError("two-line elements need the package sgp4", wanted="pip install 'starwise[tle]'") from None
    pad = 4
    t_ns = start_ns + (np.arange(n_nodes + 2 * pad) - pad) * round(NODE_STEP_S * NS)
    utc = gpst_to_utc(t_ns.astype(np.int64))
    days, rest = np.divmod(utc, 86_400 * NS)
    jd = days + 2_444_244.5  # 1980-01-06
    theta = np.unwrap([gmst(int(t)) for t in t_ns])
    c, s = np.cos(theta), np.sin(theta)
    svs, states = [], []
    seen: set[int] = set()
    for name, one, two in sets:
        if sv_id(name) in seen:
            continue
        error, r, _ = Satrec.twoline2rv(one, two).sgp4_array(jd, rest / (86_400 * NS))
        if error.any():
            raise StarwiseError(
                f"two-line elements of {name} cannot be propagated to {to_datetime(start_ns):%Y-%m-%d}",
                found=f"SGP4 error {int(error.max())}",
            )
        r = r * 1e3
        pos = np.stack([c * r[:, 0] + s * r[:, 1], c * r[:, 1] - s * r[:, 0], r[:, 2]], axis=1)
        # central differences of order 8 (error h^8 r n^9 / 630: nothing)
        w = (4 / 5, -1 / 5, 4 / 105, -1 / 280)
        vel = sum(
            w[k - 1] * (pos[pad + k : len(pos) - pad + k] - pos[pad - k : len(pos) - pad - k]) for k in range(1, 5)
        )
        seen.add(sv_id(name))
        svs.append(sv_id(name))
        states.append(np.concatenate([pos[pad:-pad], np.asarray(vel) / NODE_STEP_S], axis=1))
    return svs, np.array(states)
