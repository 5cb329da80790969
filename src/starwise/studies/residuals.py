"""Residuals of other programs in the laboratory: whiteness, bias and relative size, satellite by satellite.

Programs write residuals without their variances. What remains to be judged is whether they are white, free of a bias,
and of the sizes *relative to each other* that the program's weights assume; the common scale is that of the residuals.
For single-point positions of RTKLIB the weights are those of its manual (version 2.4.2, appendix E.6):

    sigma^2 = F^2 R^2 (a^2 + b^2 / sin el) + sigma_ephemeris^2 + sigma_ionosphere^2 + sigma_troposphere^2 + sigma_bias^2

with F 1 (GLONASS 1.5, SBAS 3), R = 100, a = b = 3 mm, times 3 for the ionosphere-free combination. The variances of
ephemeris and ionosphere are not in any file: what is computed here is the rest, which is less than what RTKLIB claims.
"""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from starwise.analysis.lab import Consistency
from starwise.constants import SYS_G, SYS_J, SYS_R, SYS_S
from starwise.errors import StarwiseError
from starwise.io.foreign import kind_of
from starwise.io.residuals import Residuals, read_residuals
from starwise.io.rtklib_conf import values_of
from starwise.io.stat import has_residuals
from starwise.signals import sv_name
from starwise.types import F8, I8, Solution, Truth

_RATIO: Final = 100.0
_A_M: Final = 0.003
_B_M: Final = 0.003
_BIAS_M: Final = 0.3
_TROPOSPHERE_M: Final = 0.3
_FEWEST: Final = 20
"""Rows from which on anything is said."""


@dataclass(frozen=True)
class Weights:
    """Weights of RTKLIB's single-point positions; its defaults.

    Attributes
    ----------
    a_m, b_m : float
        ``stats-errphase`` and ``stats-errphaseel``, m.
    ionosphere_free : bool
        ``pos1-ionoopt = dual-freq``.
    """

    a_m: float = _A_M
    b_m: float = _B_M
    ionosphere_free: bool = False

    def measurement_var(self, elevation_rad: F8, system: I8) -> F8:
        """Variance of the measurement itself, m^2: the first term."""
        factor = np.select([system == SYS_R, system == SYS_S], [1.5, 3.0], 1.0) * (3.0 if self.ionosphere_free else 1.0)
        sine = np.sin(np.maximum(elevation_rad, math.radians(5.0)))
        return np.asarray((factor * _RATIO) ** 2 * (self.a_m**2 + self.b_m**2 / sine))

    def known_var(self, elevation_rad: F8, system: I8) -> F8:
        """Variance without those of ephemeris and ionosphere, m^2."""
        sine = np.sin(np.maximum(elevation_rad, math.radians(5.0)))
        return self.measurement_var(elevation_rad, system) + _BIAS_M**2 + (_TROPOSPHERE_M / (sine + 0.1)) ** 2


@dataclass(frozen=True)
class ResidualReport:
    """What the laboratory says of a table of residuals.

    Attributes
    ----------
    consistency : Consistency
        Of the residuals over the sizes that they have on average: its findings of size are relative ones.
    sizes : dict
        ``rows``, ``epochs``, ``satellites``, ``code_rms_m``, ``phase_rms_m`` (None: none), ``zenith_sigma_m`` (error of
        a code at the zenith that the residuals show, after the degrees of freedom of the fit; single-point positions),
        ``claimed_ratio`` (that error over what RTKLIB's options claim without ephemeris and ionosphere).
    notes : tuple of str
    """

    consistency: Consistency
    sizes: dict[str, Any]
    notes: tuple[str, ...] = field(default=())

    @property
    def verdict(self) -> str:
        """One line."""
        return self.consistency.verdict

    def explain(self) -> str:
        """Several lines of at most 79 columns."""
        from starwise.report.residuals import size_lines

        return "\n".join([*size_lines(self.sizes), "", self.consistency.explain()])

    def to_dict(self) -> dict[str, Any]:
        """Plain values, ready for JSON: what `Consistency` has, with ``sizes`` and ``notes``."""
        return {**self.consistency.to_dict(), "sizes": self.sizes, "notes": list(self.notes)}


def weights_of(conf: str | Path) -> Weights:
    """Weights that an options file of RTKLIB asks for.

    Raises
    ------
    StarwiseError
        Not such a file.
    """
    values = values_of(conf)
    try:
        a_m, b_m = (float(values.get(f"stats-errphase{end}", usual)) for end, usual in (("", _A_M), ("el", _B_M)))
    except ValueError:
        raise StarwiseError("stats-errphase or stats-errphaseel is no number", file=conf) from None
    if not (0.0 <= a_m < 1e3 and 0.0 <= b_m < 1e3 and a_m + b_m > 0.0):
        raise StarwiseError("not the sizes of errors", file=conf, found=f"{a_m:g}, {b_m:g} m", wanted="stats-errphase")
    return Weights(a_m, b_m, ionosphere_free=values.get("pos1-ionoopt", "").lower() in ("dual-freq", "3"))


def source_of_residuals(path: str | Path, conf: str | Path | None = None) -> tuple[Path | None, bool]:
    """File with the residuals of a solution, and whether the solution's own file has positions, too.

    Parameters
    ----------
    path : path-like
        Any solution. A `.pos` file has the residuals of the ``.pos.stat`` that RTKLIB wrote beside it.
    conf : path-like, optional
        Options that RTKLIB ran with: there must be a ``.stat``.

    Raises
    ------
    StarwiseError
        Options without a ``.stat``.
    """
    path = Path(path)
    kind = kind_of(path) if path.is_file() else ""
    stat = path if kind == "stat" else path.with_name(f"{path.name}.stat") if kind == "pos" else None
    if stat is not None and not (stat.is_file() and kind_of(stat) == "stat" and has_residuals(stat)):
        stat = None
    if conf is not None and stat is None:
        raise StarwiseError("options of RTKLIB without residuals", file=path, wanted="a .stat with $SAT records")
    # The positions of a gnss_lib_py table of measurements are those of the data set, not of its solution.
    return (path, False) if kind == "gnss_lib_py residuals" else (stat, True)


def judge_residuals(
    source: str | Path | Residuals,
    *,
    conf: str | Path | None = None,
    solution: Solution | None = None,
    truth: Truth | None = None,
    vertical: bool = True,
) -> ResidualReport:
    """Whether the residuals of another program are white, without bias, and of the sizes that its weights assume.

    Parameters
    ----------
    source : path-like or Residuals
        A file that `starwise.io.residuals.read_residuals` reads.
    conf : path-like, optional
        Options that RTKLIB ran with; default: its defaults.
    solution, truth, vertical : optional
        Positions of the same run, the truth, and whether their heights compare, for what is said of positions.

    Raises
    ------
    StarwiseError
        A file that cannot be read.
    """
    table = source if isinstance(source, Residuals) else read_residuals(source)
    weights = Weights() if conf is None else weights_of(conf)
    system = (table.sv >> 8).astype(np.int64)
    rtklib = table.format == "rtklib stat"
    shape = weights.known_var(table.elevation_rad, system) if rtklib else np.ones(table.n)
    code = table.valid & np.isfinite(table.code_m) & np.isfinite(shape)
    phase = table.valid & np.isfinite(table.phase_m) & (table.phase_m != 0.0)
    relative = any("double differences" in note for note in table.notes)
    sizes: dict[str, Any] = {
        "rows": int(code.sum() + phase.sum()),
        "epochs": len(np.unique(table.t_ns[code | phase])),
        "satellites": len(np.unique(table.sv[code | phase])),
        "code_rms_m": _rms(table.code_m[code]),
        "phase_rms_m": _rms(table.phase_m[phase]),
        "zenith_sigma_m": None,
        "claimed_ratio": None,
    }
    notes = [*table.notes, "sizes are judged relative to each other; the common scale is that of the residuals"]
    if rtklib and not relative and not phase.any() and code.sum() >= _FEWEST:
        scale = _scale(table.t_ns[code], system[code], table.code_m[code] ** 2 / shape[code])
        if scale is not None:
            zenith = weights.known_var(np.array([math.pi / 2.0]), np.zeros(1, np.int64))[0]
            sizes |= {"zenith_sigma_m": scale * math.sqrt(zenith), "claimed_ratio": scale}
            notes.append("variances of ephemeris and ionosphere, which RTKLIB adds, are in no file")
    parts = [(code, table.code_m, shape, "code"), (phase, table.phase_m, np.ones(table.n), "phase")]
    kept = [(rows, v[rows], s[rows] * _mean_square(v[rows], s[rows]), kind) for rows, v, s, kind in parts if rows.any()]
    at = np.concatenate([np.flatnonzero(rows) for rows, _, _, _ in kept]) if kept else np.zeros(0, dtype=np.int64)
    names = np.array([sv_name(int(code)) for code in table.sv], dtype=np.str_)
    consistency = Consistency.from_innovations(
        table.t_ns[at],
        np.concatenate([v for _, v, _, _ in kept]) if kept else np.zeros(0),
        np.concatenate([s for _, _, s, _ in kept]) if kept else np.zeros(0),
        sv=names[at],
        signal=np.array(table.channels, dtype=np.str_)[table.channel[at]],
        kind=np.concatenate([np.full(len(v), kind) for _, v, _, kind in kept]) if kept else "code",
        residuals=True,
        solution=solution,
        truth=truth,
        vertical=vertical,
    )
    return ResidualReport(consistency, sizes, tuple(notes))


def _rms(values: F8) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None


def _mean_square(v: F8, s: F8) -> float:
    """Scale that makes the mean square of v / sqrt(s) one; 1 if all residuals are 0."""
    return float(np.mean(v**2 / s)) or 1.0


def _scale(t_ns: I8, system: I8, square: F8) -> float | None:
    """Root of the weighted squares over the degrees of freedom: rows less three coordinates and a clock per system.

    QZSS and SBAS share the clock of GPS (``rescode`` in RTKLIB 2.4.3's pntpos.c).
    """
    system = np.where(np.isin(system, (SYS_J, SYS_S)), SYS_G, system)
    epoch = np.unique(t_ns, return_inverse=True)[1]
    rows = np.bincount(epoch)
    clocks = np.bincount(np.unique(np.stack([epoch, system]), axis=1)[0], minlength=len(rows))
    free = rows - 3 - clocks
    used = free > 0
    if not used.any():
        return None
    return math.sqrt(float(np.bincount(epoch, weights=square)[used].sum() / free[used].sum()))
