"""BeiDou-1 fixes into a strapdown navigator, as they come: late. A whole run with feedback, five ways with the delay.

States: those of ``starwise.kernels.sins15``, behind them two clones of the position, or the delay tau, s.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from starwise.kernels._jit import njit
from starwise.kernels.late import CLONING, ESTIMATED, IGNORED, OPTIMAL_PREDICTION, REPLAY
from starwise.kernels.sins15 import N0, Mind, SinsModel, feed_back, gain_and_update, keep_mind, new_mind, roll
from starwise.kernels.strapdown import NAV, radii

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

FREE = -1
"""Method: no fix is used."""


class SinsFixes(NamedTuple):
    """Fixes in the order of arrival; step k is the end of increment k - 1.

    Attributes
    ----------
    lat, lon : (F,)
        rad.
    R : (F, 2, 2)
        North, east, m^2.
    valid, there : (F,) int64
        Steps at which the filter believes them valid, and of their arrival.
    """

    lat: F8
    lon: F8
    R: F8
    valid: I8
    there: I8


class SinsOut(NamedTuple):
    """By fix, at its arrival and after it has been used.

    Attributes
    ----------
    nav : (F, 10)
        Navigation state.
    P : (F, 4, 4)
        Covariance of velocity and position, N E N E.
    v : (F, 2), S : (F, 2, 2)
        Innovation and its covariance, m.
    tau : (F, 2)
        Estimated delay and sigma, s.
    signature : (F, 2), effect : (F, 2)
        What a further delay of 1 s adds to the innovation and to the position estimate, m.
    """

    nav: F8
    P: F8
    v: F8
    S: F8
    tau: F8
    signature: F8
    effect: F8


@njit
def _innovation(lat: float, lon: float, lat0: float, lon0: float, h: float, v: F8) -> None:
    """Fix minus navigator, north and east, m (the paper's Z with the sign of truth minus estimate)."""
    R_M, R_N = radii(math.sin(lat0) ** 2)
    v[0] = (lat - lat0) * (R_M + h)
    v[1] = (lon - lon0) * (R_N + h) * math.cos(lat0)


@njit
def _record(f: int, mind: Mind, v: F8, S: F8, g: F8, out: SinsOut) -> None:
    for i in range(NAV):
        out.nav[f, i] = mind.nav[i]
    for i in range(4):
        for j in range(4):
            out.P[f, i, j] = mind.P[3 + i, 3 + j]
    for a in range(2):
        out.v[f, a], out.signature[f, a], out.effect[f, a] = v[a], g[a], mind.s[5 + a]
        for b in range(2):
            out.S[f, a, b] = S[a, b]


@njit
def sins_run(
    method: int, model: SinsModel, dtheta: F8, dv: F8, nav0: F8, P0: F8, fixes: SinsFixes, tau0: float,
    sigma_tau: float, out: SinsOut,
) -> None:  # fmt: skip
    """A whole run: navigation, late fixes treated in one way, feedback.

    Parameters
    ----------
    method : int
        `FREE` or a method of ``starwise.kernels.late``. `OPTIMAL_PREDICTION` needs fixes that are asked for no earlier
        than the answer before has come.
    model : SinsModel
    dtheta, dv : (n, 3)
        Increments as read, rad and m/s.
    nav0 : (10,), P0 : (15, 15)
        Start.
    fixes : SinsFixes
    tau0, sigma_tau : float
        `ESTIMATED`: prior of the delay, s.
    out : SinsOut
        Out.
    """
    N = N0
    if method == CLONING:
        N = N0 + 4
    if method == ESTIMATED:
        N = N0 + 1
    mind, old = new_mind(N), new_mind(N)
    for i in range(NAV):
        mind.nav[i] = nav0[i]
    for i in range(N0):
        for j in range(N0):
            mind.P[i, j] = P0[i, j]
    if method == ESTIMATED:
        mind.P[N0, N0] = sigma_tau * sigma_tau
    tau = tau0
    Psi, track = np.eye(N0), np.zeros((len(dtheta) + 1, 4))
    track[0, 0], track[0, 1], track[0, 2], track[0, 3] = nav0[7], nav0[8], nav0[4], nav0[5]
    H, v, S, dx, g, D = np.zeros((2, N)), np.zeros(2), np.zeros((2, 2)), np.zeros(N), np.zeros(2), np.zeros(2)
    clone = np.zeros((2, 2))  # latitude and longitude of either clone
    now, asked, kept = 0, 0, -1
    for f in range(len(fixes.lat)):
        s, j = fixes.valid[f], fixes.there[f]
        if method == FREE:
            roll(mind, dtheta, dv, now, j, model, Psi, track, False)
        elif method in (IGNORED, ESTIMATED):
            roll(mind, dtheta, dv, now, j, model, Psi, track, False)
            if method == IGNORED:
                _aim(H, N, 5)
                lat0, lon0 = mind.nav[7], mind.nav[8]
                D[0], D[1] = -mind.nav[4], -mind.nav[5]
            else:
                lat0, lon0 = _aim_back(H, tau, j, model.dt, track)
            _innovation(fixes.lat[f], fixes.lon[f], lat0, lon0, model.height, v)
            gain_and_update(mind, H, v, fixes.R[f], D, S, dx, g)
            feed_back(mind, dx, model.height)
            if method == ESTIMATED:
                tau = max(tau + dx[N0], 0.0)
                _shift(track, j, model.dt, dx, model.height)
                out.tau[f, 0], out.tau[f, 1] = tau, math.sqrt(mind.P[N0, N0])
        elif method == OPTIMAL_PREDICTION:
            s = max(s, now)
            roll(mind, dtheta, dv, now, s, model, Psi, track, False)
            keep_mind(mind, old)  # belief for the time of the request; from here Psi and Q alone
            for i in range(N0):
                for k in range(N0):
                    mind.P[i, k] = 0.0
                    Psi[i, k] = 1.0 if i == k else 0.0
            roll(mind, dtheta, dv, s, j, model, Psi, track, True)
            _aim(H, N, 5)
            D[0], D[1] = -old.nav[4], -old.nav[5]
            _innovation(fixes.lat[f], fixes.lon[f], old.nav[7], old.nav[8], model.height, v)
            gain_and_update(old, H, v, fixes.R[f], D, S, dx, g)
            _predict_on(Psi, old, mind, dx)
            feed_back(mind, dx, model.height)
        elif method == REPLAY:
            if kept != f:
                roll(mind, dtheta, dv, now, s, model, Psi, track, False)
                keep_mind(mind, old)
                now = s
            roll(mind, dtheta, dv, now, j, model, Psi, track, False)
            _aim(H, N, 5)
            D[0], D[1] = -old.nav[4], -old.nav[5]
            _innovation(fixes.lat[f], fixes.lon[f], old.nav[7], old.nav[8], model.height, v)
            gain_and_update(old, H, v, fixes.R[f], D, S, dx, g)
            feed_back(old, dx, model.height)
            keep_mind(old, mind)  # the past as it is known now, then the way to the present again
            now = s
            if f + 1 < len(fixes.lat) and fixes.valid[f + 1] < j:
                now = max(fixes.valid[f + 1], s)
                roll(mind, dtheta, dv, s, now, model, Psi, track, False)
                keep_mind(mind, old)
                kept = f + 1
            roll(mind, dtheta, dv, now, j, model, Psi, track, False)
        else:
            while asked < len(fixes.lat) and asked < f + 2 and fixes.valid[asked] <= j:
                roll(mind, dtheta, dv, now, fixes.valid[asked], model, Psi, track, False)
                now = fixes.valid[asked]
                _copy_position(mind, N0 + 2 * (asked % 2))
                clone[asked % 2, 0], clone[asked % 2, 1] = mind.nav[7], mind.nav[8]
                asked += 1
            roll(mind, dtheta, dv, now, j, model, Psi, track, False)
            _aim(H, N, N0 + 2 * (f % 2))
            D[0], D[1] = -track[s, 2], -track[s, 3]
            _innovation(fixes.lat[f], fixes.lon[f], clone[f % 2, 0], clone[f % 2, 1], model.height, v)
            gain_and_update(mind, H, v, fixes.R[f], D, S, dx, g)
            R_M, R_N = radii(math.sin(mind.nav[7]) ** 2)
            for c in range(2):
                clone[c, 0] += dx[N0 + 2 * c] / (R_M + model.height)
                clone[c, 1] += dx[N0 + 2 * c + 1] / ((R_N + model.height) * math.cos(mind.nav[7]))
            feed_back(mind, dx, model.height)
        now = j
        _record(f, mind, v, S, g, out)


@njit
def _aim(H: F8, N: int, at: int) -> None:
    for k in range(N):
        H[0, k], H[1, k] = 0.0, 0.0
    H[0, at], H[1, at + 1] = 1.0, 1.0


@njit
def _aim_back(H: F8, tau: float, j: int, dt: float, track: F8) -> tuple[float, float]:
    """Jacobian of the position tau ago, and the navigator's position there."""
    back = min(tau / dt, float(j))
    i = min(int(j - back), j - 1)
    part = j - back - i
    lat = track[i, 0] + part * (track[i + 1, 0] - track[i, 0])
    lon = track[i, 1] + part * (track[i + 1, 1] - track[i, 1])
    _aim(H, N0 + 1, 5)
    H[0, 3], H[1, 4] = -tau, -tau
    H[0, N0], H[1, N0] = -track[i, 2], -track[i, 3]
    return lat, lon


@njit
def _shift(track: F8, j: int, dt: float, dx: F8, h: float) -> None:
    """Put a correction into the navigator's last seconds, too, as far as a delay reaches back."""
    R_M, R_N = radii(math.sin(track[j, 0]) ** 2)
    c = math.cos(track[j, 0])
    for i in range(max(0, j - int(10.0 / dt)), j + 1):
        ago = dt * (j - i)
        track[i, 0] += (dx[5] - ago * dx[3]) / (R_M + h)
        track[i, 1] += (dx[6] - ago * dx[4]) / ((R_N + h) * c)
        track[i, 2] += dx[3]
        track[i, 3] += dx[4]


@njit
def _predict_on(Psi: F8, old: Mind, mind: Mind, dx: F8) -> None:
    """P = Psi P(request) Psi' + Q, dx = Psi dx, s = Psi s; ``mind.P`` holds Q on entry."""
    W, y = np.empty((N0, N0)), np.empty(N0)
    for i in range(N0):
        y[i], mind.s[i] = 0.0, 0.0
        for k in range(N0):
            y[i] += Psi[i, k] * dx[k]
            mind.s[i] += Psi[i, k] * old.s[k]
        for j in range(N0):
            t = 0.0
            for k in range(N0):
                t += Psi[i, k] * old.P[k, j]
            W[i, j] = t
    for i in range(N0):
        dx[i] = y[i]
        for j in range(i + 1):
            t = mind.P[i, j]
            for k in range(N0):
                t += W[i, k] * Psi[j, k]
            mind.P[i, j] = t
            mind.P[j, i] = t


@njit
def _copy_position(mind: Mind, at: int) -> None:
    """Clone the position into elements ``at``, ``at + 1``."""
    P, N = mind.P, len(mind.s)
    for a in range(2):
        mind.s[at + a] = mind.s[5 + a]
        for j in range(N):
            P[at + a, j], P[j, at + a] = 0.0, 0.0
    for a in range(2):
        for j in range(N):
            if j < at or j > at + 1:
                P[at + a, j] = P[5 + a, j]
                P[j, at + a] = P[5 + a, j]
    for a in range(2):
        for b in range(2):
            P[at + a, at + b] = P[5 + a, 5 + b]
