"""Solutions made by hand, for tests of what stands downstream of the filters."""

import numpy as np

from starwise.constants import EPOCH_COASTED, EPOCH_NO_SOLUTION, EPOCH_RESET, EPOCH_SUSPECT, NS, ROW_GATED
from starwise.frames import ecef_from_geodetic
from starwise.signals import signal_id, sv_id
from starwise.types import Solution

T0 = 1_325_376_000 * NS
HERE = ecef_from_geodetic([np.radians(43.56), np.radians(-1.48), 207.0])


def random_covariances(rng: np.random.Generator, n: int, sigma: float) -> np.ndarray:
    a = rng.normal(size=(n, 3, 3)) * sigma
    return a @ a.transpose(0, 2, 1) + np.eye(3) * sigma**2


def handmade_solution(n: int = 40, *, seed: int = 1, centre: np.ndarray = HERE, step_ns: int = NS) -> Solution:
    """Positions scattered about a point exactly as their covariances say; a few epochs are special."""
    rng = np.random.default_rng(seed)
    cov = random_covariances(rng, n, 2.0)
    error = (np.linalg.cholesky(cov) @ rng.normal(size=(n, 3, 1)))[:, :, 0]
    pos = centre + error
    vel = rng.normal(size=(n, 3))
    cov_vel = random_covariances(rng, n, 0.1)
    status = np.zeros(n, dtype=np.uint8)
    if n >= 10:
        status[3], status[4], status[5], status[6] = EPOCH_NO_SOLUTION, EPOCH_COASTED, EPOCH_SUSPECT, EPOCH_RESET
        pos[3], vel[3], cov[3], cov_vel[3] = np.nan, np.nan, np.nan, np.nan
    clock = rng.normal(size=(n, 2))
    names = ("G05", "G31", "E07", "C60")
    ledger = {
        "t_ns": np.repeat(T0 + np.arange(n) * step_ns, len(names)),
        "sv": np.tile(np.array([sv_id(name) for name in names], dtype=np.int16), n),
        "sig": np.tile(np.array([signal_id(s) for s in ("1C", "1W", "1X", "2I")], dtype=np.int16), n),
        "sig2": np.tile(np.array([0, signal_id("2W"), 0, 0], dtype=np.int16), n),
        "status": np.tile(np.array([0, 0, 2, ROW_GATED], dtype=np.uint8), n),
        "rate_used": np.tile(np.array([True, False, True, True]), n),
        "elevation_rad": rng.uniform(0, 1.5, 4 * n),
        "innovation_m": np.where(rng.random(4 * n) < 0.2, np.nan, rng.normal(size=4 * n)),
    }
    return Solution(
        t_ns=T0 + np.arange(n) * step_ns,
        status=status,
        pos_e=pos,
        vel_e=vel,
        cov_pos=cov,
        cov_vel=cov_vel,
        clock_m=clock,
        drift_mps=clock / 10,
        clock_sigma_m=np.abs(clock),
        clock_names=("G", "E"),
        n_used=np.full(n, 9, dtype=np.int32),
        dop=np.tile([2.5, 2.0, 1.2, 1.6], (n, 1)),
        nis=rng.chisquare(18, n),
        dof=np.full(n, 18, dtype=np.int32),
        ledger=ledger,
        provenance={"starwise": "0.0", "config": {"method": "lsq"}, "summary": {"epochs": n}},
    )
