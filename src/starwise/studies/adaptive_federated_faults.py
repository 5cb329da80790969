"""Fault isolation in simulation: one local filter per constellation with a clock of its own, and a ramp in one of them.

Linear in the deviation from a known straight flight: lines of sight are those of simulated GPS, GLONASS, Galileo and
BeiDou, the receiver's clock is one TCXO for all, codes are white. Everything that isolates is
`starwise.kernels.federated_run`; the centralised filter is the same with one local filter that carries all clocks.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np

from starwise.chi2 import chi_square_points
from starwise.constants import C_LIGHT, NS
from starwise.frames import ecef_from_geodetic, rotations_ne_enu
from starwise.gnsstime import parse_time
from starwise.kernels.federated import LOCAL_JUMPED, LOCAL_OUT, LOCAL_USED, Locals, Options
from starwise.kernels.federated_run import FederatedOut, Measured, federated_run
from starwise.models.process import CLOCKS, Motion, matrices
from starwise.sim.sections import Constellation, Sky
from starwise.sim.seeds import streams
from starwise.sim.sky import build_sky
from starwise.types import F8, I8

NAMES: Final = ("GPS", "GLONASS", "Galileo", "BeiDou")
SIGMA_M: Final = (1.5, 3.0, 1.0, 1.5)
"""Code noise by constellation, m."""
CONSTELLATIONS: Final[tuple[Constellation, ...]] = ("gps", "glonass", "galileo", "beidou3")
MASK_DEG: Final = 10.0
EPOCHS: Final = 600
RAMP_MPS: Final = 50.0 / 60.0
RAMP_AT_S: Final = 200
JUMP_M: Final = 1e-6 * C_LIGHT
ISB_PSD: Final = 1e-4
"""Random walk of the difference of two constellations' clocks, m^2/s: a metre in three hours."""
FALSE_ALARM: Final = 1e-6
PATIENCE: Final = 2
MOTION: Final = Motion("velocity", 0.1, 0.1, velocity_sigma0=3.0)
RAMPS: Final = ("one satellite", "spread", "common")
_NC: Final = 6
_N: Final = 8


@dataclass(frozen=True)
class Scene:
    """Lines of sight.

    ``H`` (epochs, rows, 8) in states position (ENU), velocity | clock, drift; constellation of each row; where the
    rows of each begin.
    """

    H: F8
    which: I8
    bounds: I8


@lru_cache(maxsize=1)
def scene() -> Scene:
    """Satellites above the mask for the whole time, over 32 N, 118 E."""
    t0 = parse_time("2009-05-15T04:00:00")
    t_ns = t0 + NS * np.arange(EPOCHS, dtype=np.int64)
    place = ecef_from_geodetic([np.radians(32.0), np.radians(118.0), 10_000.0])
    C = rotations_ne_enu(np.radians([32.0]), np.radians([118.0]))[0]
    blocks: list[F8] = []
    which: list[int] = []
    for k, name in enumerate(CONSTELLATIONS):
        sky = build_sky(Sky(constellations=(name,)), t0 - NS, int(t_ns[-1]) + NS, streams(2009, 0))
        m = len(sky.sv)
        states = sky.states(np.repeat(t_ns, m), np.tile(sky.sv, EPOCHS)).reshape(EPOCHS, m, -1)[:, :, :3]
        los = states - place
        u = (los / np.linalg.norm(los, axis=2)[:, :, None]) @ C.T
        seen = u[:, :, 2].min(axis=0) > np.sin(np.radians(MASK_DEG))
        blocks.append(u[:, seen])
        which += [k] * int(seen.sum())
    u = np.concatenate(blocks, axis=1)
    H = np.zeros((EPOCHS, u.shape[1], _N))
    H[:, :, :3], H[:, :, 6] = -u, 1.0
    bounds = np.searchsorted(which, np.arange(len(NAMES) + 1))
    return Scene(H, np.array(which, dtype=np.int64), np.asarray(bounds, dtype=np.int64))


def codes(seed: int, run: int, faulty: int | None, ramp: str) -> F8:
    """Codes (epochs, rows) less the range: clock, noise and the ramp, m."""
    sc, rng = scene(), streams(seed, run)
    noise = np.array(SIGMA_M)[sc.which] * rng("codes").standard_normal(sc.H.shape[:2])
    w = rng("clock").standard_normal((2, EPOCHS))
    drift = np.cumsum(np.sqrt(CLOCKS.drift_psd) * w[0])
    clock = np.cumsum(drift + np.sqrt(CLOCKS.bias_psd) * w[1])
    out = noise + clock[:, None]
    if faulty is None:
        return np.asarray(out)
    grown = RAMP_MPS * np.clip(np.arange(EPOCHS) - RAMP_AT_S, 0.0, None)
    mine = np.flatnonzero(sc.which == faulty)
    if ramp == "one satellite":
        out[:, mine[run % len(mine)]] += grown
    elif ramp == "spread":
        out[:, mine] += grown[:, None] * np.linspace(-1.0, 1.0, len(mine))
    else:
        out[:, mine] += grown[:, None]
    return np.asarray(out)


def _options(K: int, isolate: bool, watch: bool) -> Options:
    return Options(
        nc=_NC,
        reset=False,
        auto_share=False,
        least_share=0.1,
        share=np.full(K, 1.0 / K),
        test_states=3 if isolate else 0,
        separation_gate=float(chi_square_points(FALSE_ALARM, 4)[3]),
        # without detection nothing is taken for a clock that jumped, either
        innovation_gate=chi_square_points(FALSE_ALARM, 40) if isolate else np.full(40, np.inf),
        patience=PATIENCE,
        probation=60,
        clock=6 if watch else -1,
        clock_psd=ISB_PSD,
        clock_gate=float(chi_square_points(FALSE_ALARM, 2)[1]),
    )


def _blank(K: int) -> FederatedOut:
    n = EPOCHS
    each = [np.zeros((n, K)) for _ in range(3)]
    return FederatedOut(np.zeros((n, _NC)), np.zeros((n, _NC, _NC)), np.zeros((n, K), dtype=np.int64), *each)


def federated(z: F8, *, isolate: bool = True, watch: bool = False) -> FederatedOut:
    """One local filter per constellation, without reset."""
    sc, K = scene(), len(NAMES)
    Phi, Q = matrices(MOTION, CLOCKS, 1, 1.0)
    # the prior of the common states is shared, a private clock knows nothing
    P0 = np.diag([K * 100.0] * 3 + [K * MOTION.velocity_sigma0**2] * 3 + [1e4, 900.0**2])
    rows = Measured(
        offsets=sc.bounds[None] + sc.H.shape[1] * np.arange(EPOCHS, dtype=np.int64)[:, None],
        present=np.ones((EPOCHS, K), dtype=np.bool_),
        z=z.ravel(),
        r=np.tile(np.square(SIGMA_M)[sc.which], EPOCHS),
        H=sc.H.reshape(-1, _N),
    )
    beliefs = np.zeros((K, _N)), np.broadcast_to(P0, (K, _N, _N)).copy()
    start = Locals(
        np.full(K, _N, dtype=np.int64), beliefs[0], beliefs[1],
        np.broadcast_to(Phi, (K, _N, _N)).copy(), np.broadcast_to(Q, (K, _N, _N)).copy(),
        beliefs[0].copy(), beliefs[1].copy(),
    )  # fmt: skip
    out = _blank(K)
    federated_run(_options(K, isolate, watch), start, rows, out)
    return out


def centralised(z: F8) -> FederatedOut:
    """All satellites in one filter with four clocks, without detection."""
    sc, K = scene(), len(NAMES)
    Phi, Q = matrices(MOTION, CLOCKS, K, 1.0)
    n = _NC + 2 * K
    H = np.zeros((EPOCHS, sc.H.shape[1], n))
    H[:, :, :_NC] = sc.H[:, :, :_NC]
    H[:, np.arange(len(sc.which)), _NC + sc.which] = 1.0
    P0 = np.diag([100.0] * 3 + [MOTION.velocity_sigma0**2] * 3 + [1e4] * K + [900.0**2] * K)
    m = H.shape[1]
    rows = Measured(
        offsets=np.arange(EPOCHS, dtype=np.int64)[:, None] * m + np.array([[0, m]]),
        present=np.ones((EPOCHS, 1), dtype=np.bool_),
        z=z.ravel(),
        r=np.tile(np.square(SIGMA_M)[sc.which], EPOCHS),
        H=H.reshape(-1, n),
    )
    x, P = np.zeros((1, n)), P0[None].copy()
    start = Locals(np.array([n], dtype=np.int64), x, P, Phi[None], Q[None], x.copy(), P.copy())
    out = _blank(1)
    federated_run(_options(1, False, False), start, rows, out)
    return out


def fault_isolation(seed: int, runs: int, progress: Callable[[float], None] | None = None) -> dict[str, Any]:
    """Ramps of 50 m/min in every constellation and way, and runs without a fault.

    Returns
    -------
    dict
        ``ramps``: a record per ramp, constellation and whether clocks are watched, with runs in which the right
        constellation was taken out (``named``) or another one (``wrong``), delays, peaks of the 3D error.
        ``jumps``: clocks of one constellation that jump by a microsecond: named, and what it does to the position.
        ``fault_free``: false alarms and RMS of both filters.
    """
    say = progress or (lambda _fraction: None)
    ramps: list[dict[str, Any]] = []
    jobs = [(ramp, k) for ramp in RAMPS for k in range(len(NAMES))]
    for i, (ramp, faulty) in enumerate(jobs):
        ramps += _one(seed, runs, ramp, faulty)
        say((i + 1) / (len(jobs) + 1))
    return {
        "ramps": ramps,
        "jumps": [_jump(seed, runs, faulty) for faulty in range(len(NAMES))],
        "fault_free": [_fault_free(seed, runs, watch) for watch in (False, True)],
    }


def _jump(seed: int, runs: int, faulty: int) -> dict[str, Any]:
    """The clock of one constellation jumps by a microsecond and stays."""
    named, others, peaks, before = 0, 0, [], []
    for run in range(runs):
        z = codes(seed, run, None, "")
        z[RAMP_AT_S:, scene().which == faulty] += JUMP_M
        out = federated(z, watch=True)
        named += bool(out.status[RAMP_AT_S, faulty] == LOCAL_JUMPED)
        others += bool((np.delete(out.status, faulty, axis=1) != LOCAL_USED).any())
        others += bool((out.status == LOCAL_OUT).any())
        size = np.linalg.norm(out.x[:, :3], axis=1)
        peaks.append(float(size[RAMP_AT_S : RAMP_AT_S + 60].max()))
        before.append(float(size[RAMP_AT_S - 60 : RAMP_AT_S].max()))
    return {
        "faulty": NAMES[faulty],
        "jump_m": JUMP_M,
        "runs": runs,
        "named": named,
        "wrong": others,
        "peak_after_median_m": float(np.median(peaks)),
        "peak_before_median_m": float(np.median(before)),
    }


def _one(seed: int, runs: int, ramp: str, faulty: int) -> list[dict[str, Any]]:
    """One ramp in one constellation: clocks not watched, and watched."""
    measured = [codes(seed, run, faulty, ramp) for run in range(runs)]
    central = [_peak(centralised(z)) for z in measured]
    out = []
    for watch in (False, True):
        delays, peaks, wrong = [], [], 0
        for z in measured:
            result = federated(z, watch=watch)
            gone = result.status == LOCAL_OUT
            wrong += bool(np.delete(gone, faulty, axis=1).any())
            mine = np.flatnonzero(gone[:, faulty])
            if len(mine):
                delays.append(float(mine[0] - RAMP_AT_S))
            peaks.append(_peak(result))
        out.append(
            {
                "ramp": ramp,
                "faulty": NAMES[faulty],
                "clocks_watched": watch,
                "runs": runs,
                "named": len(delays),
                "wrong": wrong,
                "delay_median_s": float(np.median(delays)) if delays else None,
                "delay_max_s": max(delays) if delays else None,
                "peak_median_m": float(np.median(peaks)),
                "peak_max_m": max(peaks),
                "central_peak_median_m": float(np.median(central)),
                "peak_over_central": float(np.median(peaks) / np.median(central)),
            }
        )
    return out


def _peak(out: FederatedOut) -> float:
    return float(np.linalg.norm(out.x[RAMP_AT_S:, :3], axis=1).max())


def _fault_free(seed: int, runs: int, watch: bool) -> dict[str, Any]:
    alarms, square, base, nees = 0, 0.0, 0.0, 0.0
    for run in range(runs):
        z = codes(seed, run, None, "")
        out, ref = federated(z, watch=watch), centralised(z)
        alarms += bool((out.status == LOCAL_OUT).any())
        late = slice(60, None)
        square += float((out.x[late, :3] ** 2).sum(axis=1).mean()) / runs
        base += float((ref.x[late, :3] ** 2).sum(axis=1).mean()) / runs
        W = np.linalg.inv(out.P[late, :3, :3])
        nees += float(np.einsum("ni,nij,nj->n", out.x[late, :3], W, out.x[late, :3]).mean()) / 3.0 / runs
    return {
        "clocks_watched": watch,
        "runs": runs,
        "epochs": EPOCHS,
        "false_alarms": alarms,
        "rms_m": square**0.5,
        "central_rms_m": base**0.5,
        "nees_per_axis": nees,
    }
