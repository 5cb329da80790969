"""Better numbers for a filter: from the size of innovations at once, or by their likelihood with the filter run again.

The likelihood of innovations is

    log L = -1/2 sum (v^2 / s + log s)            (Schweppe 1965; rows outside the gate count up to its edge)

It has two faults that make it a bad master where errors last. It counts every row for a new witness, although an error
of an hour says the same thing a hundred times; and where a model of lasting errors is rougher from second to second
than the errors are, it makes them small to be paid for smoothness, and the position is then surer than it is right.
Both are met by what is known beforehand: log L counts as many rows as there are independent errors (a channel and an
hour each); each parameter has a prior, log-normal about the package's default, whose width is what is known of it
from orbits, the atmosphere and receivers; and as the likelihood errs towards small, it is believed where it asks for
more than the default, not where it asks for less. What is found is the maximum of both together.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from starwise.analysis.lab.findings import Cause, Finding
from starwise.analysis.lab.innovations import Innovations, of_solution
from starwise.analysis.lab.plain import plain
from starwise.config import RunConfig
from starwise.errors import StarwiseError
from starwise.models.process import CLOCKS, motion_from
from starwise.types import Solution

Rerun = Callable[[RunConfig], Solution]
"""Solves the same measurements with another configuration; its ledger is all that is looked at."""
Progress = Callable[[str, float], None]
FAR: Final = 10.83
"""Normalised innovation squared (chance 1e-3) from which a row costs only its logarithm: one outlier decides
nothing."""
ONLY_UP: Final = 0.0
"""Least value of sizes of errors, in standard deviations of the prior: the default. At rest reflections show in no
innovation, and what is wrong by the same for hours shows in none: small innovations do not prove small errors."""
LASTING_S: Final = 3600.0
"""Time after which a lasting error is a new one: orbits, clocks and the ionosphere change within about an hour."""


@dataclass(frozen=True)
class Parameter:
    """One number to be found: a factor on one or more keys of the configuration.

    Attributes
    ----------
    name : str
        For people.
    defaults : mapping
        Keys of the configuration (with dots) and their prior median.
    spread : float
        Factor by which the true value is off the median, one standard deviation.
    low, high : float
        Least and largest value, in such standard deviations.
    """

    name: str
    defaults: Mapping[str, float]
    spread: float
    low: float = ONLY_UP
    high: float = 3.0

    def settings(self, log_factor: float) -> dict[str, float]:
        """Values of the keys at a factor."""
        return {key: _rounded(value * math.exp(log_factor)) for key, value in self.defaults.items()}


@dataclass(frozen=True)
class Tuning:
    """Suggested configuration.

    Attributes
    ----------
    settings : mapping
        Keys of the configuration (with dots), and values.
    reasons : tuple of str
        For people, one a setting or more.
    method : str
        ``moments``: from the size of innovations; ``likelihood``: the filter was run again.
    gain : float
        Logarithm of how much more likely innovations and priors are together than with the present configuration
        (likelihood only).
    evaluations : int
        Times that the filter was run.
    """

    settings: Mapping[str, Any]
    reasons: tuple[str, ...]
    method: str = "moments"
    gain: float = math.nan
    evaluations: int = 0
    factors: Mapping[str, float] = field(default_factory=dict)

    def to_toml(self) -> str:
        """Configuration for ``solve --config``."""
        lines = [f"# {reason}" for reason in self.reasons]
        tables: dict[str, list[str]] = {}
        for key, value in self.settings.items():
            table, _, name = key.rpartition(".")
            tables.setdefault(table, []).append(f"{name} = {_toml(value)}")
        lines += tables.pop("", [])
        for table, entries in tables.items():
            lines += ["", f"[{table}]", *entries]
        return "\n".join([*lines, ""])

    def to_dict(self) -> dict[str, Any]:
        """Plain values, ready for JSON."""
        names = ("settings", "reasons", "method", "gain", "evaluations", "factors")
        return {**{name: plain(getattr(self, name)) for name in names}, "toml": self.to_toml()}


def _toml(value: Any) -> str:
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return repr(float(value)) if isinstance(value, float) else str(value)


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")


SLOW: Final = (
    "slow_gps_m", "slow_glonass_m", "slow_galileo_m", "slow_beidou_m", "slow_beidou_geo_m", "slow_qzss_m",
)  # fmt: skip
IONOSPHERE: Final = (
    "ionosphere_fraction", "ionosphere_floor_m", "vertical_fraction", "vertical_floor_m", "gradient_fraction",
    "gradient_floor_m",
)  # fmt: skip


def parameters_of(config: RunConfig, interval_s: float) -> list[Parameter]:
    """What can be found for a configuration, priors about the package's defaults; epochs are ``interval_s`` apart."""
    plain_config = RunConfig(error_model=config.error_model, dynamics=config.dynamics, process=replace_process(config))
    noise, errors = plain_config.noise, plain_config.errors
    found = [Parameter("Doppler noise", {"noise.rate_mps": noise.rate_mps}, 2.0)]
    if config.error_model == "colored":

        def group(name: str, keys: Sequence[str], spread: float) -> Parameter:
            return Parameter(name, {f"errors.{key}": float(getattr(errors, key)) for key in keys}, spread)

        found += [
            group("code noise", ("code_white_m", "code_white_glonass_m"), 2.0),
            group("multipath", ("multipath_m",), 1.5),
            group("orbits and clocks", SLOW, 1.5),
            group("ionosphere", IONOSPHERE, 1.5),
            group("troposphere and slope", ("troposphere_m", "slope_m"), 1.5),
            group("signal biases", ("signal_bias_m", "signal_bias_glonass_m"), 1.5),
        ]
        if interval_s < 0.5 * errors.multipath_tau_s:  # else it has no states
            found.append(
                Parameter("duration of multipath", {"errors.multipath_tau_s": errors.multipath_tau_s}, 1.5, -1.5, 1.5)
            )
    else:
        found.append(Parameter("code noise", {"noise.code_m": noise.code_m}, 2.0))
    motion = motion_key(plain_config)
    if motion is not None:
        resting = motion[0] == "process.position_psd_m2_per_s"
        found.append(Parameter("motion", dict([motion]), 3.0, ONLY_UP if resting else -3.0))
    clock = {"clock.bias_psd_m2_per_s": CLOCKS.bias_psd, "clock.drift_psd_m2_per_s3": CLOCKS.drift_psd}
    found.append(Parameter("receiver clock", clock, 3.0))
    return found


def replace_process(config: RunConfig) -> Any:
    """The process of a configuration without its strengths: they shall come from the preset."""
    return type(config.process)(model=config.process.model)


def motion_key(config: RunConfig) -> tuple[str, float] | None:
    """Key of the strength of the motion, and its value; None where the model has none of the usual ones."""
    m = motion_from(config)
    return {
        "static": ("process.position_psd_m2_per_s", m.horizontal),
        "velocity": ("process.acceleration_psd_m2_per_s3", m.horizontal),
        "acceleration": ("process.jerk_psd_m2_per_s5", m.horizontal),
        "singer": ("process.acceleration_sigma_mps2", math.sqrt(m.horizontal)),
    }.get(m.model)


def log_likelihood(table: Innovations) -> tuple[float, int]:
    """Logarithm of the likelihood of innovations, and the number of rows; rows outside the gate count to its edge."""
    square = table.z**2
    square = np.where(square > FAR, FAR + FAR * np.log(np.maximum(square, FAR) / FAR), square)
    return -0.5 * float((square + np.log(table.s)).sum()), table.n


def independent_rows(table: Innovations) -> float:
    """Number of independent lasting errors: one for each channel and each `LASTING_S` that it was there."""
    counts = np.bincount(table.channel, minlength=len(table.channels)).astype(np.float64)
    return float(np.maximum(1.0, counts * table.interval_s / LASTING_S).sum())


def maximise(
    rerun: Rerun,
    config: RunConfig,
    *,
    parameters: Sequence[Parameter] | None = None,
    rounds: int = 2,
    progress: Progress | None = None,
) -> Tuning:
    """Configuration with the largest likelihood of the innovations and prior together.

    One parameter after another is moved by its prior's standard deviation, then by half of it, as long as that helps.
    The search begins at the defaults. A filter with white errors whose innovations show lasting ones gets the coloured
    error model first.

    Parameters
    ----------
    rerun : callable
        Gives the solution, with its ledger, for a configuration.
    config : RunConfig
        As the run was made.
    parameters : sequence of Parameter, optional
        Default: `parameters_of` the configuration.
    rounds : int
        Times that every parameter is tried.
    progress : callable, optional

    Raises
    ------
    StarwiseError
        The run has no innovations; what a rerun raises.
    """
    from starwise.analysis.lab.consistency import Consistency

    run = rerun(config)
    first = _innovations(run)
    at_once = by_moments(Consistency.of(run).findings, config)
    if at_once is not None and at_once.settings.get("error_model") == "colored":
        config = config.with_options({"error_model": "colored"})
        first = _innovations(rerun(config))
    found = list(parameters_of(config, first.interval_s) if parameters is None else parameters)
    search = _Search(rerun, config, found, first)
    best = [0.0] * len(found)
    top = search.value(best)
    before = search.scored(first, search.present())
    step = [1.0] * len(found)
    for number in range(rounds):
        for k, parameter in enumerate(found):
            if progress is not None:
                progress(f"round {number + 1}, {parameter.name}", (number + k / len(found)) / rounds)
            best, top, moved = search.line(best, top, k, step[k])
            if not moved:
                step[k] *= 0.5
    factors = {p.name: math.exp(x * math.log(p.spread)) for p, x in zip(found, best, strict=True)}
    settings: dict[str, Any] = {"error_model": config.error_model}
    reasons = []
    for parameter, x in zip(found, best, strict=True):
        settings.update(parameter.settings(x * math.log(parameter.spread)))
        factor = factors[parameter.name]
        said = "as by default" if abs(math.log(factor)) < 0.01 else f"{factor:.2g} times the default"
        reasons.append(f"{parameter.name}: {said}")
    head = f"likelihood of {search.rows} innovations that are worth {search.weight * search.rows:.0f}, with priors"
    return Tuning(settings, (head, *reasons), "likelihood", top - before, search.evaluations, factors)


def _innovations(solution: Solution) -> Innovations:
    table = of_solution(solution)
    if table is None or not table.n:
        raise StarwiseError("no innovations to judge a configuration by", wanted="a run of a filter")
    return table


class _Search:
    """Scores of configurations; x are parameters in standard deviations of their priors."""

    def __init__(self, rerun: Rerun, config: RunConfig, parameters: list[Parameter], first: Innovations) -> None:
        self.rerun, self.config, self.parameters = rerun, config, parameters
        self.evaluations, self.rows = 1, first.n
        self.weight = min(1.0, independent_rows(first) / first.n)
        self.known: dict[tuple[float, ...], float] = {}

    def options(self, x: Sequence[float]) -> dict[str, Any]:
        out: dict[str, Any] = {}
        for parameter, value in zip(self.parameters, x, strict=True):
            out.update(parameter.settings(value * math.log(parameter.spread)))
        return out

    def present(self) -> list[float]:
        """The present configuration in standard deviations of the priors; the first key of each parameter counts."""
        flat = self.config.to_dict()
        out = []
        for parameter in self.parameters:
            key, default = next(iter(parameter.defaults.items()))
            table, _, name = key.rpartition(".")
            value = (flat.get(table) or {}).get(name)
            at = math.log(float(value) / default) if value else 0.0
            out.append(at / math.log(parameter.spread))
        return out

    def scored(self, table: Innovations, x: Sequence[float]) -> float:
        value, rows = log_likelihood(table)
        return self.weight * value * self.rows / rows - 0.5 * sum(v * v for v in x)

    def value(self, x: Sequence[float]) -> float:
        key = tuple(round(v, 6) for v in x)
        if key not in self.known:
            self.evaluations += 1
            self.known[key] = self.scored(_innovations(self.rerun(self.config.with_options(self.options(x)))), x)
        return self.known[key]

    def line(self, best: list[float], top: float, k: int, step: float) -> tuple[list[float], float, bool]:
        """Best along one parameter, its score, and whether it moved."""
        for sign in (-1.0, 1.0):
            moved = False
            for _ in range(6):
                trial = best.copy()
                trial[k] = min(max(trial[k] + sign * step, self.parameters[k].low), self.parameters[k].high)
                if trial[k] == best[k]:
                    break
                got = self.value(trial)
                if not got > top + 0.02:
                    break
                best, top, moved = trial, got, True
            if moved:
                return best, top, True
        return best, top, False


def by_moments(findings: Sequence[Finding], config: RunConfig | None) -> Tuning | None:
    """What the sizes of innovations say at once, without another run; None where they say nothing.

    Of R the noise of codes and rates, of Q the motion; lasting errors with white noise: the coloured error model.
    Single signals have no key of their own.
    """
    if config is None:
        return None
    settings: dict[str, Any] = {}
    reasons: list[str] = []
    colored = config.error_model == "colored"
    for finding in findings:
        if not finding.matters:
            continue
        if finding.cause is Cause.CORRELATED and not colored and "error_model" not in settings:
            settings["error_model"] = "colored"
            reasons.append(f"{finding.where}: errors last, for about {finding.size:.2g} s")
        if finding.cause in (Cause.R_TOO_LARGE, Cause.R_TOO_SMALL):
            keys = _noise_keys(finding.where, colored)
            for key in keys:
                if key not in settings:
                    least = _value(RunConfig(), key)  # small innovations do not prove small errors
                    settings[key] = _rounded(max(least, _value(config, key) * min(math.sqrt(finding.size), 20.0)))
                    if settings[key] == _rounded(_value(config, key)):
                        del settings[key]
            if keys:
                reasons.append(finding.words.rstrip("."))
        if finding.cause in (Cause.Q_TOO_LARGE, Cause.Q_TOO_SMALL):
            motion = motion_key(config)
            if motion is not None and motion[0] not in settings:
                ratio = min(max(finding.size, 0.01), 100.0)
                sigma = motion[0].endswith("sigma_mps2")
                settings[motion[0]] = _rounded(motion[1] * (math.sqrt(ratio) if sigma else ratio))
                reasons.append(finding.words.rstrip("."))
    if settings.get("error_model") == "colored":  # sizes seen with white errors say nothing of those of the coloured
        settings = {"error_model": "colored"}
        reasons = [reason for reason in reasons if "errors last" in reason]
    return Tuning(settings, tuple(reasons)) if settings else None


def _noise_keys(where: str, colored: bool) -> list[str]:
    if where == "rate":
        return ["noise.rate_mps"]
    if where == "code":
        return ["errors.code_white_m", "errors.code_white_glonass_m"] if colored else ["noise.code_m"]
    return []


def _value(config: RunConfig, key: str) -> float:
    table, _, name = key.rpartition(".")
    return float(getattr(getattr(config, table), name))
