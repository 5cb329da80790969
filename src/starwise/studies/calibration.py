"""Parameters of the coloured error model by maximum likelihood, from receivers whose positions are known.

What is maximised is the probability density that a filter gave to the true position before it was told (the
logarithmic score, a proper one: it rewards a covariance that is honest *and* sharp), averaged over the epochs of a
session, then over sessions, sets and stations, so that a long file does not outweigh a short one. The filter is started
anew in every session: the error of a receiver at rest is one slow number, and two hours say little less about it than
a day. Parameters are positive, so steps are factors. Those that the data do not determine stay where physics put them:
the score is taken less ``stiffness`` times the squared logarithm of the change from the start.

No parameter belongs to a set. `cross_validate` leaves each station out in turn, finds the parameters without it, and
judges it with them.
"""

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np

from starwise.checked import Checked, Positive, Range, read_toml
from starwise.config import RunConfig
from starwise.config_errors import ErrorParameters
from starwise.errors import StarwiseError
from starwise.kernels.rangemodel import Epochs
from starwise.models.pseudorange import Prepared, with_parameters
from starwise.types import F8, Truth

Progress = Callable[[str, float], None]

NAMES: Final = (
    "vertical_fraction", "gradient_fraction", "ionosphere_fraction", "slow_gps_m", "slow_galileo_m", "slow_beidou_m",
    "slow_beidou_geo_m", "slope_m", "signal_bias_m", "multipath_m", "code_white_m", "slow_tau_s",
    "ionosphere_tau_s", "vertical_tau_s",
)  # fmt: skip
"""Parameters that are fitted; the others hardly matter to a position, or the data do not determine them."""
STIFFNESS: Final = 0.45
"""Price of a change by a factor of e, in the mean logarithm of the density: 1 / (2 s^2 n) with s = 0.4, sizes being
known to a factor of 1.5 from orbits, atmosphere and receivers, and n = 7 stations: all of a day at one station is about
one sample of what matters. Without it the sets at hand are fitted too closely (coverage of the 95 % ellipsoid 91 % on
them), and the next station finds the filter too sure."""
FAR: Final = 30.0
"""NEES (3 degrees of freedom) from which a score grows like its logarithm: one wild epoch shall not decide."""
CHI2: Final = {"coverage_50": 2.36597, "coverage_68": 3.50588, "coverage_95": 7.81473}
"""Quantiles of chi-square with 3 degrees of freedom."""


@dataclass(frozen=True)
class SetFile(Checked):
    """One measurement with known positions."""

    name: str
    observations: str
    navigation: tuple[str, ...]
    truth: str
    """As for ``assess --truth``: ``X,Y,Z``, ``lat,lon,h`` or a file."""
    station: str | None = None
    """Sets of one station are left out together; default the name."""
    systems: str = "GRECJ"
    dynamics: tuple[Literal["static", "pedestrian", "vehicle", "aircraft"], ...] = ("static", "vehicle")
    """Presets with which it is judged."""
    combination: tuple[Literal["uncombined", "single"], ...] = ("uncombined", "single")
    """Two frequencies and one: the priors of the ionosphere weigh most where there is one."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for key in ("observations", "navigation", "truth", "dynamics", "combination"):
            if not getattr(self, key):
                raise StarwiseError(f"'{key}' of set '{self.name}' is empty")


@dataclass(frozen=True)
class CalibrationFile(Checked):
    """A list of measurements, as TOML: ``[[set]]`` tables."""

    set: tuple[SetFile, ...] = ()
    session_s: Positive = 7200.0
    every: Annotated[int, Range(1)] = 1
    """Use every n-th session of a set that has more than two."""


@dataclass(frozen=True)
class Case:
    """A set ready to be run: rows, and the truth at its epochs (NaN where there is none)."""

    name: str
    station: str
    dynamics: tuple[str, ...]
    systems: str
    prepared: Prepared
    truth_e: F8
    windows: tuple[tuple[int, int], ...]


ABSURD_M = 100e3
"""Distance of a truth from the solution, m, beyond which it is of another place."""


def read_cases(path: Path) -> list[Case]:
    """Measurements of a TOML file (see `CalibrationFile`); their files stand relative to it.

    Raises
    ------
    StarwiseError
        The file, or one that it names, cannot be used.
    """
    listed = CalibrationFile.from_dict(read_toml(path), file=str(path))
    if not listed.set:
        raise StarwiseError("no measurements to calibrate on", file=path, wanted="[[set]] tables")
    return [_case(item, path.parent, listed, kind) for item in listed.set for kind in item.combination]


def _case(item: SetFile, folder: Path, listed: CalibrationFile, combination: Literal["uncombined", "single"]) -> Case:
    from starwise.io.rinex_nav import read_nav
    from starwise.io.rinex_obs import read_obs
    from starwise.io.truth import read_truth
    from starwise.models.pseudorange import prepare
    from starwise.physics.broadcast import BroadcastEphemeris

    obs = read_obs(folder / item.observations)
    records = read_nav(*(folder / name for name in item.navigation))
    config = RunConfig(systems=item.systems, combination=combination)
    prepared = prepare(obs, BroadcastEphemeris(records), records.ionosphere, config)
    where = folder / item.truth
    truth = _truth_at(read_truth(str(where) if where.is_file() else item.truth), obs.t_ns)
    windows = _windows(obs.t_ns, truth, listed.session_s)
    if not windows:
        raise StarwiseError(
            "no session with a truth", file=folder / item.observations, wanted="20 epochs of one, or more"
        )
    if len(windows) > 2:
        windows = windows[:: listed.every]
    name = item.name if combination == "uncombined" else f"{item.name}, L1"
    case = Case(name, item.station or item.name, item.dynamics, item.systems, prepared, truth, tuple(windows))
    error, _ = errors_of(case, ErrorParameters(), case.dynamics[0], windows[0])
    away = float(np.median(np.linalg.norm(error, axis=1))) if len(error) else 0.0
    if away > ABSURD_M:  # parameters made to explain this would be wrong for everybody
        raise StarwiseError(
            "the truth is not where the measurements were made",
            file=folder / item.observations, found=f"{away / 1e3:.0f} km from the solution ({item.truth})",
            wanted=f"less than {ABSURD_M / 1e3:.0f} km",
        )  # fmt: skip
    return case


def _truth_at(truth: Truth, t_ns: np.ndarray) -> F8:
    if truth.t_ns is None:
        return np.broadcast_to(truth.pos_e, (len(t_ns), 3)).copy()
    at = np.full((len(t_ns), 3), np.nan)
    k = np.clip(np.searchsorted(truth.t_ns, t_ns - 50_000_000), 0, len(truth.t_ns) - 1)
    near = np.abs(truth.t_ns[k] - t_ns) <= 50_000_000
    at[near] = truth.pos_e[k[near]]
    return at


def _windows(t_ns: np.ndarray, truth_e: F8, session_s: float) -> list[tuple[int, int]]:
    """First and last + 1 epoch of the sessions that have a truth for 20 epochs or more."""
    number = (t_ns - t_ns[0]) // round(session_s * 1e9)
    edges = np.flatnonzero(np.diff(number)) + 1
    pairs = zip([0, *edges.tolist()], [*edges.tolist(), len(t_ns)], strict=True)
    return [(a, b) for a, b in pairs if np.isfinite(truth_e[a:b, 0]).sum() >= 20]


def errors_of(case: Case, p: ErrorParameters, dynamics: str, window: tuple[int, int]) -> tuple[F8, F8]:
    """Position errors (n, 3) and covariances (n, 3, 3) of a session, ECEF m, where there is a truth and a solution."""
    from starwise.estimators.filter import filter_rows

    a, b = window
    ready = with_parameters(case.prepared, p)
    config = RunConfig(systems=case.systems, dynamics=dynamics, errors=p)  # type: ignore[arg-type]
    epochs = Epochs(ready.epochs.t_ns[a:b], ready.epochs.offsets[a : b + 1])
    ep, _ = filter_rows(
        epochs, ready.rows, ready.options, len(ready.clock_names), config, colored=(ready.errors, ready.error_rows)
    )
    e = ep.pos - case.truth_e[a:b]
    ok = np.isfinite(e[:, 0])
    return e[ok], ep.cov_pos[ok]


def _nees(e: F8, cov: F8) -> F8:
    nees: F8 = np.einsum("ni,ni->n", e, np.linalg.solve(cov, e[:, :, None])[:, :, 0])
    return nees


def session_score(e: F8, cov: F8) -> float:
    """Mean logarithm of the density of the truth over a session, less the constant."""
    nees = _nees(e, cov)
    nees = np.where(nees > FAR, FAR + FAR * np.log(np.maximum(nees, FAR) / FAR), nees)
    return float(np.mean(-0.5 * (nees + np.linalg.slogdet(cov)[1])))


def score(cases: Sequence[Case], p: ErrorParameters) -> float:
    """Mean over stations of the mean over their sets and presets of motion of the mean over sessions."""
    by_station: dict[str, list[float]] = {}
    for case in cases:
        for dynamics in case.dynamics:
            mean = np.mean([session_score(*errors_of(case, p, dynamics, w)) for w in case.windows])
            by_station.setdefault(case.station, []).append(float(mean))
    return float(np.mean([np.mean(scores) for scores in by_station.values()]))


def maximise(
    cases: Sequence[Case],
    start: ErrorParameters,
    *,
    names: Sequence[str] = NAMES,
    rounds: int = 2,
    stiffness: float = STIFFNESS,
    progress: Progress | None = None,
) -> tuple[ErrorParameters, float]:
    """Parameters of the greatest score, one after another by factors, and that score with its penalty.

    Parameters
    ----------
    cases : sequence of Case
    start : ErrorParameters
        Where the search begins, and to where the penalty pulls.
    names : sequence of str
    rounds : int
        Times that every parameter is tried; the step of one that does not improve is halved.
    stiffness : float
    progress : callable, optional
    """

    def value(p: ErrorParameters) -> float:
        pull = sum(math.log(getattr(p, k) / getattr(start, k)) ** 2 for k in names)
        return score(cases, p) - stiffness * pull

    best, top = start, value(start)
    step = dict.fromkeys(names, 0.6)
    for number in range(rounds):
        for place, name in enumerate(names):
            if progress is not None:
                progress(f"round {number + 1}, {name}", (number + place / len(names)) / rounds)
            for sign in (1.0, -1.0):
                moved = False
                while True:
                    trial = replace(best, **{name: getattr(best, name) * math.exp(sign * step[name])})
                    got = value(trial)
                    if not got > top + 5e-4:
                        break
                    best, top, moved = trial, got, True
                if moved:
                    break
            else:
                step[name] *= 0.5
    return best, top


def judge(cases: Sequence[Case], p: ErrorParameters) -> list[dict[str, Any]]:
    """Calibration of every set and preset of motion with given parameters.

    Returns
    -------
    list of dict
        ``name, station, dynamics, sessions, coverage_50, coverage_68, coverage_95, nees_mean`` (per degree of freedom),
        ``sigma_3d_mean_m, rms_3d_m``; each session has the same weight.
    """
    table = []
    for case in cases:
        for dynamics in case.dynamics:
            sessions = []
            for window in case.windows:
                e, cov = errors_of(case, p, dynamics, window)
                nees = _nees(e, cov)
                sessions.append(
                    {
                        **{key: float(np.mean(nees <= limit)) for key, limit in CHI2.items()},
                        "nees_mean": float(np.mean(nees)) / 3.0,
                        "sigma_3d_mean_m": float(np.mean(np.sqrt(np.trace(cov, axis1=1, axis2=2)))),
                        "mse": float(np.mean(np.sum(e * e, axis=1))),
                    }
                )
            mean = {key: float(np.mean([s[key] for s in sessions])) for key in sessions[0]}
            rms = math.sqrt(mean.pop("mse"))
            head = {"name": case.name, "station": case.station, "dynamics": dynamics, "sessions": len(sessions)}
            table.append({**head, **mean, "rms_3d_m": rms})
    return table


def pooled(table: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Calibration over all sessions of a table of `judge`."""
    weight = np.array([row["sessions"] for row in table], dtype=np.float64)
    keys = ("coverage_50", "coverage_68", "coverage_95", "nees_mean", "sigma_3d_mean_m")
    out = {key: float(np.average([row[key] for row in table], weights=weight)) for key in keys}
    rms = math.sqrt(np.average([row["rms_3d_m"] ** 2 for row in table], weights=weight))
    return {**out, "rms_3d_m": rms, "sessions": int(weight.sum())}


def cross_validate(
    cases: Sequence[Case], start: ErrorParameters, *, rounds: int = 1, progress: Progress | None = None
) -> list[dict[str, Any]]:
    """Calibration of every station with the parameters that the other stations give; rows as of `judge`."""
    stations = list(dict.fromkeys(case.station for case in cases))
    table: list[dict[str, Any]] = []
    for k, station in enumerate(stations):
        if progress is not None:
            progress(f"without {station}", k / len(stations))
        rest = [case for case in cases if case.station != station]
        p, _ = maximise(rest, start, rounds=rounds)
        table += judge([case for case in cases if case.station == station], p)
    return table


def calibrate(
    path: Path, *, rounds: int = 2, folds: bool = True, output: Path | None = None, progress: Progress | None = None
) -> dict[str, Any]:
    """Parameters of the coloured error model found on the measurements of a TOML file, judged, and written.

    Parameters
    ----------
    path : Path
        See `CalibrationFile`.
    rounds : int
        See `maximise`; 0 only judges the present defaults.
    folds : bool
        Also leave each station out in turn.
    output : Path, optional
        A configuration file for ``solve --config``, with the parameters as ``[errors]``.
    progress : callable, optional

    Returns
    -------
    dict
        ``parameters`` (all), ``changed`` (those that moved: old and new), ``score_before``, ``score_after``,
        ``sets`` and ``pooled`` (see `judge`), ``cross_validation`` and ``cross_validation_pooled`` likewise.

    Raises
    ------
    StarwiseError
        A file cannot be used.
    """
    say = progress or (lambda _what, _part: None)
    cases = read_cases(path)
    if output is not None and not output.absolute().parent.is_dir():  # now, not after hours
        raise StarwiseError("no such folder", file=output, wanted="a file that can be written")
    start = ErrorParameters()
    found = start
    if rounds > 0:
        found, _ = maximise(cases, start, rounds=rounds, progress=lambda what, part: say(what, 0.3 * part))
        found = replace(found, **{name: float(f"{getattr(found, name):.2g}") for name in NAMES})
    before = score(cases, start)
    sets = judge(cases, found)
    result: dict[str, Any] = {
        "parameters": found.to_dict(),
        "changed": {
            name: [getattr(start, name), getattr(found, name)]
            for name in NAMES
            if getattr(start, name) != getattr(found, name)
        },
        "score_before": before,
        "score_after": before if found == start else score(cases, found),
        "sets": sets,
        "pooled": pooled(sets),
    }
    if folds and len({case.station for case in cases}) > 1:
        table = cross_validate(
            cases, start, rounds=max(rounds, 1), progress=lambda what, part: say(what, 0.35 + 0.65 * part)
        )
        result["cross_validation"] = table
        result["cross_validation_pooled"] = pooled(table)
    if output is not None:
        lines = [f"{key} = {value!r}" for key, value in found.to_dict().items()]
        temporary = output.with_name(f".{output.name}.{os.getpid()}.part")
        try:
            temporary.write_text("\n".join(["# Coloured error model, for solve --config", "[errors]", *lines, ""]))
            os.replace(temporary, output)
        except OSError as error:
            raise StarwiseError(f"cannot be written ({error.strerror})", file=output) from None
    return result
