"""Filters over position fixes of several receivers, on axes in which cruise is straight: literal and improved."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from starwise.kernels.adapt import NONE, PAPER, Rule
from starwise.kernels.adapt_literal import BETA_ACCELERATION, BETA_NONE, BETA_POSITION, Literal, literal_run
from starwise.kernels.imm import BankOut, bank_run
from starwise.models.maneuver import Maneuvers
from starwise.types import F8


@dataclass(frozen=True)
class Track:
    """Estimates per epoch on three axes.

    Attributes
    ----------
    pos, vel, acc : (n, 3) float64
        m, m/s, m/s^2; NaN where there is none.
    cov_pos, cov_vel : (n, 3, 3) float64
    cruise : (n,) float64
        Probability of cruise; NaN for filters that do not ask.
    scale : (n,) float64
        Factor on the standard deviations of the fixes that their differences show; 1 where not estimated.
    correlation : (n,) float64
        Of the fixes' errors from epoch to epoch, likewise; 0 where not estimated.
    fading : (n, receivers) float64
        Fading factors of the local filters; 1 for filters without.
    used : (n, receivers) bool
        Fixes that took part.
    nis : (n,) float64
        Of the combined fix against the prediction, chi-square with 3 dof; NaN where not computed.
    """

    pos: F8
    vel: F8
    acc: F8
    cov_pos: F8
    cov_vel: F8
    cruise: F8
    scale: F8
    correlation: F8
    fading: F8
    used: NDArray[np.bool_]
    nis: F8


@dataclass(frozen=True)
class LiteralFilter:
    """The paper's constants and switches; see `starwise.kernels.adapt_literal.Literal`."""

    tau_a: tuple[float, ...] = (10.0, 1.0, 100.0)
    sigma_a: tuple[float, ...] = (3.0, 4.0, 1.5)
    tau: tuple[float, ...] = (0.1, 0.1, 0.1)
    sigma: tuple[float, ...] = (10.0, 23.0, 5.0)
    R: tuple[float, ...] = (1e-3, 5e-3, 1e-4)
    share: tuple[float, ...] = (1 / 3, 1 / 6, 1 / 2)
    alpha: float = 4.0
    d0: float = 500.0
    limit: float = 120.0**2
    eta: float = 1e4
    a_max: float = 30.0
    """Not in the paper: 3 g."""
    adaptive: bool = True
    beta: str = "position"
    discretised: bool = False
    fuse_eps: bool = True
    share_noise: bool = False
    p0: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)

    def numbers(self) -> tuple[Literal, Rule]:
        """The same as plain numbers for kernels."""
        vectors = {k: np.array(getattr(self, k)) for k in ("tau_a", "sigma_a", "tau", "sigma", "R", "share", "p0")}
        options = Literal(
            **vectors,
            adaptive_variance=self.adaptive,
            a_max=self.a_max,
            eta=self.eta,
            beta=BETAS[self.beta],
            discretised=self.discretised,
            fuse_eps=self.fuse_eps,
            share_noise=self.share_noise,
        )
        rule = Rule(
            PAPER if self.adaptive else NONE, self.alpha, self.d0, self.limit, 0.95, 1.0, 1, 0, 1.5, 4.0, 1e-6, np.inf
        )
        return options, rule


BETAS: Final = {"none": BETA_NONE, "position": BETA_POSITION, "acceleration": BETA_ACCELERATION}
LITERAL: Final = LiteralFilter()
KALMAN: Final = replace(LITERAL, adaptive=False, beta="none")


def least_squares(z: F8, r: F8) -> tuple[F8, F8]:
    """Inverse-variance combination (n, 3) of fixes (n, receivers, 3), and its variances; NaN where no fix is."""
    weight = np.where(np.isnan(z), 0.0, 1.0 / r)
    total = weight.sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        combined = np.where(np.isnan(z), 0.0, z * weight).sum(axis=1) / total
        return combined, np.where(total > 0.0, 1.0 / total, np.nan)


def literal_filter(z: F8, dt_s: float = 1.0, constants: LiteralFilter = LITERAL) -> Track:
    """The paper's federated filter, plain or adaptive, over fixes (n, receivers, 3) at a constant period."""
    n, K, _ = z.shape
    x, P, fading = np.zeros((n, 3, 3)), np.zeros((n, 3, 3, 3)), np.ones((n, K))
    options, rule = constants.numbers()
    literal_run(options, rule, dt_s, np.ascontiguousarray(z), x, P, fading)
    eye = np.eye(3)
    nothing = np.full(n, np.nan)
    return Track(
        x[:, :, 0], x[:, :, 1], x[:, :, 2],
        P[:, :, 0, 0, None] * eye, P[:, :, 1, 1, None] * eye,
        nothing, np.ones(n), np.zeros(n), fading, np.ones((n, K), dtype=np.bool_), nothing,
    )  # fmt: skip


def improved_filter(
    t_s: F8, z: F8, r: F8, bank: Maneuvers | None = None, share: NDArray[np.float64] | None = None
) -> Track:
    """Federated filters with reset under hypotheses of cruise and manoeuvre; see `starwise.kernels.imm`.

    Parameters
    ----------
    t_s : (n,) float64
        s, increasing, from any zero near.
    z, r : (n, receivers, 3) float64
        Fixes, m (NaN: none), and their variances, m^2.
    bank : Maneuvers, optional
    share : (receivers,) float64, optional
        Information shares; equal ones without. They do not change the result.
    """
    n, K, _ = z.shape
    out = BankOut(
        x=np.zeros((n, 3, 3)),
        cov_pos=np.zeros((n, 3, 3)),
        cov_vel=np.zeros((n, 3, 3)),
        cruise=np.zeros(n),
        scale=np.ones(n),
        correlation=np.zeros(n),
        nis=np.zeros(n),
        used=np.zeros((n, K), dtype=np.bool_),
    )
    shares = np.full(K, 1.0 / K) if share is None else np.asarray(share, dtype=np.float64)
    numbers = (bank or Maneuvers()).numbers()
    bank_run(numbers, np.asarray(t_s, dtype=np.float64), np.ascontiguousarray(z), np.ascontiguousarray(r), shares, out)
    x = out.x
    return Track(
        x[:, :, 0], x[:, :, 1], x[:, :, 2], out.cov_pos, out.cov_vel,
        out.cruise, out.scale, out.correlation, np.ones((n, K)), out.used, out.nis,
    )  # fmt: skip
