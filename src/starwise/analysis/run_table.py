"""Measurements of a finished run as its filter weighed them: directions, variances, error states, out of the ledger."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from starwise.config import RunConfig
from starwise.constants import EPOCH_NO_SOLUTION, EPOCH_RESET, ROW_USED, SYS_R, SYSTEMS
from starwise.errors import StarwiseError
from starwise.kernels.colored import K_MAX
from starwise.kernels.error_states import SHELL_RATIO, ErrorModel, ErrorRows
from starwise.kernels.rangemodel import F_L1, Epochs, RowModel, Rows
from starwise.models.error_model import code_biases, error_model, no_errors, second_signals, slow_sigma
from starwise.models.pseudorange import EPHEMERIS_SIGMA_M, empty_row_model, model_options
from starwise.signals import DEFAULT_PREFERENCE, DEFAULT_SECOND, frequency_table, signal_id
from starwise.types import F8, I8, IonosphereModel, Solution

Mask = NDArray[np.bool_]

_COLUMNS = (
    "t_ns", "sv", "sig", "sig2", "status", "rate_used", "elevation_rad", "azimuth_rad", "cn0_dbhz", "code_m",
    "ionosphere_m", "innovation_m", "innovation_var_m2", "rate_innovation_mps", "rate_innovation_var_m2ps2",
)  # fmt: skip
PRECISE_SIGMA_M = 0.05
"""Claim of precise orbits and clocks, m, where the ledger does not repeat it."""


@dataclass(frozen=True)
class RunTable:
    """A row per epoch and satellite whose direction is known, sorted by epoch.

    Attributes
    ----------
    t_ns : (m,) int64
        Epochs of the run.
    offsets : (m + 1,) int64
    fresh : (m,) bool
        Epochs that started the filter.
    sv, clock : (n,)
        Satellite; index of the receiver clock that it sees, -1: none.
    direction : (n, 3) float64
        Unit vector from the receiver, east, north, up.
    usable : (n,) bool
        Nothing but the filter's choice of systems speaks against the row: above the mask, with an ephemeris.
    used : (n, 3) bool
        First code, second code, rate.
    white : (n, 3) float64
        Variances of white noise of the three, m^2 and m^2/s^2.
    extra : (n, 3) float64
        Variance by which the filter's robust weights widened each.
    lasting : (n, 2) float64
        Prior variance of the lasting errors of both codes, m^2.
    scale : (m,) float64
        Factor on the variance of code noise and multipath.
    errors : ErrorModel
    bias_names : tuple of str
    clock_names : tuple of str
    """

    t_ns: I8
    offsets: I8
    fresh: Mask
    sv: NDArray[np.int16]
    clock: I8
    direction: F8
    usable: Mask
    used: Mask
    white: F8
    extra: F8
    lasting: F8
    scale: F8
    errors: ErrorModel
    bias_names: tuple[str, ...]
    clock_names: tuple[str, ...]
    source: tuple[Rows, ErrorRows, RowModel]

    def states_of(self, rows: I8) -> tuple[I8, F8, I8]:
        """Error states of the codes of some rows, see `starwise.kernels.run_terms.row_states`; errors must last."""
        from starwise.kernels.run_terms import row_states

        k = len(rows)
        idx, val, count = np.zeros((k, 2, K_MAX), np.int64), np.zeros((k, 2, K_MAX)), np.zeros((k, 2), np.int64)
        row_states(self.errors, *self.source, rows.astype(np.int64), self.scale[self.epoch[rows]], idx, val, count)
        return idx, val, count

    @cached_property
    def epoch(self) -> I8:
        """Epoch of every row."""
        return np.repeat(np.arange(len(self.t_ns), dtype=np.int64), np.diff(self.offsets))


def starts(solution: Solution, config: RunConfig) -> Mask:
    """Epochs at which the estimator began, or began again, (n,)."""
    there = solution.has_position & (solution.status != EPOCH_NO_SOLUTION)
    before = np.concatenate([[False], there[:-1]])
    fresh = there & (~before | (solution.status == EPOCH_RESET))
    if config.session_s is not None and len(fresh):
        number = (solution.t_ns - solution.t_ns[0]) // round(config.session_s * 1e9)
        fresh[1:] |= there[1:] & (np.diff(number) > 0)
    return np.asarray(fresh)


def run_table(solution: Solution, config: RunConfig, precise: bool = False) -> RunTable:
    """Measurements of a run out of its ledger.

    Parameters
    ----------
    solution : Solution
        With its ledger.
    config : RunConfig
        As the run was made, ``dynamics`` settled.
    precise : bool
        Orbits and clocks were precise.

    Raises
    ------
    StarwiseError
        No ledger, or none of satellites.
    """
    from starwise.kernels.run_terms import run_terms

    ledger = solution.ledger
    if not set(_COLUMNS) <= set(ledger) or not len(ledger["sv"]):
        raise StarwiseError(
            "no ledger of satellites in this solution", wanted="a result directory of starwise solve with satellites"
        )
    at = np.flatnonzero(np.isfinite(ledger["elevation_rad"]))
    epoch = np.searchsorted(solution.t_ns, ledger["t_ns"][at])
    offsets = np.searchsorted(epoch, np.arange(len(solution.t_ns) + 1)).astype(np.int64)
    sv, sig = ledger["sv"][at], ledger["sig"][at]
    sig2 = np.where(ledger["sig2"][at] > 0, ledger["sig2"][at], np.int16(0)).astype(np.int16)
    system = (sv >> 8).astype(np.int64)
    combined = config.combination == "ionosphere_free"
    dual = second_signals(config) and bool((sig2 > 0).any())
    second = _second_rows(ledger, at, sig2) if dual else np.full(len(at), -1)
    options, _ = model_options(config, IonosphereModel())
    rows = _rows(ledger, at, sig2, combined, precise)
    out = empty_row_model(len(at))._replace(
        elevation=ledger["elevation_rad"][at], azimuth=ledger["azimuth_rad"][at],
        ionosphere=np.nan_to_num(ledger["ionosphere_m"][at]), v_code=ledger["innovation_m"][at],
        s_code=ledger["innovation_var_m2"][at],
    )  # fmt: skip
    errors, extra, bias_names = _errors(solution, config, sv, sig, sig2, second, rows, dual)
    fresh = starts(solution, config)
    n, m = len(at), len(solution.t_ns)
    lasting, white, rate, scale = np.zeros((n, 2)), np.full((n, 2), np.nan), np.full(n, np.nan), np.ones(m)
    run_terms(
        options, errors, Epochs(solution.t_ns, offsets), rows, extra, out, fresh.astype(np.uint8),
        _speed2(solution), lasting, white, rate, scale,
    )  # fmt: skip
    status = ledger["status"]
    used = np.zeros((n, 3), dtype=bool)
    used[:, 0] = status[at] == ROW_USED
    used[:, 2] = ledger["rate_used"][at]
    there = np.flatnonzero(second >= 0)
    used[there, 1] = status[second[there]] == ROW_USED
    stretched = _stretched(ledger, at, second, errors) if errors.on else np.zeros((n, 3))
    el, az = out.elevation, out.azimuth
    columns = {name: k for k, name in enumerate(solution.clock_names)}
    if "J" not in columns and "G" in columns:
        columns["J"] = columns["G"]
    lookup = np.array([columns.get(letter, -1) for letter in SYSTEMS], dtype=np.int64)
    return RunTable(
        t_ns=solution.t_ns, offsets=offsets, fresh=fresh, sv=sv, clock=lookup[system],
        direction=np.stack([np.cos(el) * np.sin(az), np.cos(el) * np.cos(az), np.sin(el)], axis=1),
        usable=el >= options.mask_rad,
        used=used, white=np.column_stack([white, rate]), extra=stretched, lasting=lasting, scale=scale,
        errors=errors, bias_names=bias_names, clock_names=solution.clock_names, source=(rows, extra, out),
    )  # fmt: skip


def _rows(
    ledger: dict[str, NDArray[np.generic]], at: I8, sig2: NDArray[np.int16], combined: bool, precise: bool
) -> Rows:
    """What variances and error states of a row are made of."""
    sv, sig = np.asarray(ledger["sv"][at]), np.asarray(ledger["sig"][at])
    system = (sv >> 8).astype(np.int64)
    table = _frequencies()
    freq = table[system, sv & 255, sig >> 8]
    factor = np.ones(len(at))
    if combined:
        f2 = table[system, sv & 255, sig2 >> 8]
        pair = (sig2 > 0) & np.isfinite(f2)
        a, b = freq[pair] ** 2, f2[pair] ** 2
        factor[pair] = np.hypot(a, b) / np.abs(a - b)
        freq = np.where(pair, np.inf, freq)
    if "ephemeris_sigma_m" in ledger:
        sigma = np.asarray(ledger["ephemeris_sigma_m"][at], dtype=np.float64)
    else:  # an older result: the usual ones
        sigma = np.full(len(at), PRECISE_SIGMA_M) if precise else EPHEMERIS_SIGMA_M[system]
    n, none = len(at), np.zeros((0, 3))
    zero, i8 = np.zeros(n), np.zeros(n, np.int64)
    return Rows(
        none, none, zero, zero, zero, zero, np.asarray(ledger["cn0_dbhz"][at], dtype=np.float64), freq, sigma, factor,
        system, i8, np.zeros(n, np.uint8),
    )  # fmt: skip


def _frequencies() -> F8:
    """Carriers; GLONASS as on its middle channel, which the ledger does not repeat (0.3 % at most)."""
    return frequency_table({SYS_R << 8 | number: 0 for number in range(256)})


def _second_rows(ledger: dict[str, NDArray[np.generic]], at: I8, sig2: NDArray[np.int16]) -> I8:
    """Ledger row of the second signal of each row, -1: none."""
    t = np.asarray(ledger["t_ns"])
    epoch = np.concatenate([[0], np.cumsum(np.diff(t) != 0)]).astype(np.int64)  # a number is enough

    def key(which: I8 | slice, sig: NDArray[np.generic]) -> I8:
        return np.asarray(
            epoch[which] << 32 | np.asarray(ledger["sv"][which]).astype(np.int64) << 16 | sig.astype(np.int64)
        )

    keys = key(slice(None), ledger["sig"])
    order = np.argsort(keys, kind="stable")
    wanted = key(at, sig2)
    place = np.minimum(np.searchsorted(keys, wanted, sorter=order), len(keys) - 1)
    found = order[place]
    return np.where((keys[found] == wanted) & (sig2 > 0), found, -1)


def _errors(
    solution: Solution, config: RunConfig, sv: NDArray[np.int16], sig: NDArray[np.int16], sig2: NDArray[np.int16],
    second: I8, rows: Rows, dual: bool,
) -> tuple[ErrorModel, ErrorRows, tuple[str, ...]]:  # fmt: skip
    """The coloured error model of the run and its rows; nothing where errors were white."""
    if config.error_model != "colored":
        return (*no_errors(), ())
    ledger, n = solution.ledger, len(sv)
    pair = second >= 0
    bias1, bias2, names = code_biases(sv, sig, np.where(pair, sig2, np.int16(0)))
    nan = np.full(n, np.nan)
    code2, freq2, cn02, v2, s2 = nan.copy(), nan.copy(), nan.copy(), nan.copy(), nan.copy()
    row2 = second[pair]
    code2[pair] = np.where(np.isfinite(ledger["innovation_m"][row2]), ledger["code_m"][row2], np.nan)
    freq2[pair] = _frequencies()[sv[pair] >> 8, sv[pair] & 255, sig2[pair] >> 8]
    cn02[pair] = ledger["cn0_dbhz"][row2]
    v2[pair], s2[pair] = ledger["innovation_m"][row2], ledger["innovation_var_m2"][row2]
    steps = np.diff(solution.t_ns)
    interval = float(np.median(steps)) * 1e-9 if len(steps) else 1.0
    model = error_model(config.errors, dual, len(names), interval)
    extra = ErrorRows(
        sv=sv.astype(np.int64), slow_m=slow_sigma(config.errors, sv, rows.sigma_sat_m, EPHEMERIS_SIGMA_M[sv >> 8]),
        bias1=bias1, bias2=bias2, code2_m=code2, clock2_m=nan, freq2_hz=freq2, cn02_dbhz=cn02, v2=v2, s2=s2,
        used=np.zeros(n, np.uint8),
    )  # fmt: skip
    return model, extra, names


def _stretched(ledger: dict[str, NDArray[np.generic]], at: I8, second: I8, errors: ErrorModel) -> F8:
    """Variance that robust weights added to the rows: (stretch - 1) times the innovation's variance (Huber)."""

    def added(v: F8, s: F8, late: float, early: float) -> F8:
        with np.errstate(invalid="ignore", divide="ignore"):
            t = v / np.sqrt(s)
            stretch = np.maximum(1.0, np.abs(t) / np.where(t > 0.0, late, early))
        return np.nan_to_num((stretch - 1.0) * s)

    v, s = np.asarray(ledger["innovation_m"], dtype=float), np.asarray(ledger["innovation_var_m2"], dtype=float)
    rate_v = np.asarray(ledger["rate_innovation_mps"], dtype=float)[at]
    rate_s = np.asarray(ledger["rate_innovation_var_m2ps2"], dtype=float)[at]
    two = np.where(second >= 0, second, 0)
    code2 = np.where(second >= 0, added(v[two], s[two], errors.late, errors.early), 0.0)
    return np.column_stack(
        [added(v[at], s[at], errors.late, errors.early), code2, added(rate_v, rate_s, errors.early, errors.early)]
    )


def _speed2(solution: Solution) -> F8:
    """Squared speed at each epoch, (m/s)^2; 0 where not known."""
    return np.asarray(np.nan_to_num((solution.vel_e**2).sum(axis=1)))


def with_rows(
    solution: Solution, config: RunConfig, letter: str, epoch: I8, sv: NDArray[Any], elevation: F8, azimuth: F8
) -> tuple[dict[str, NDArray[np.generic]], tuple[str, ...]]:
    """Ledger with satellites of another system as if they had been used, and the names of the clocks with theirs."""
    ledger, system = solution.ledger, SYSTEMS.index(letter)
    first = signal_id((config.signals or {}).get(letter, DEFAULT_PREFERENCE[letter])[0])
    second = signal_id(DEFAULT_SECOND[letter][0]) if letter in DEFAULT_SECOND else 0
    rates = bool(np.asarray(ledger["rate_used"]).any())
    dual = second_signals(config) and second > 0 and bool((np.asarray(ledger["sig2"]) > 0).any())
    n = len(sv)
    keep = np.asarray(ledger["sv"]) >> 8 != system
    at = np.flatnonzero(np.isfinite(ledger["ionosphere_m"]) & (np.asarray(ledger["elevation_rad"]) > 0.1))
    vertical = 0.0
    if len(at):  # on L1, at the zenith, as the run's own rows have it
        freq = _frequencies()[ledger["sv"][at] >> 8, ledger["sv"][at] & 255, ledger["sig"][at] >> 8]
        slant = np.asarray(ledger["ionosphere_m"][at]) * (freq / F_L1) ** 2
        vertical = float(np.nanmedian(slant / _mapping(np.asarray(ledger["elevation_rad"][at]))))
    f1 = _frequencies()[system, sv & 255, first >> 8]
    made: dict[str, NDArray[np.generic]] = {
        "t_ns": solution.t_ns[epoch], "sv": sv.astype(np.int16), "sig": np.full(n, first, np.int16),
        "sig2": np.full(n, second if dual else 0, np.int16), "status": np.full(n, ROW_USED, np.uint8),
        "rate_used": np.full(n, rates), "elevation_rad": elevation, "azimuth_rad": azimuth,
        "cn0_dbhz": np.full(n, 45.0), "ionosphere_m": vertical * _mapping(elevation) * (F_L1 / f1) ** 2,
        "ephemeris_sigma_m": EPHEMERIS_SIGMA_M[np.full(n, system)], "group_delay_m": np.zeros(n),
    }  # fmt: skip
    blocks = [made]
    if dual:
        nan = np.full(n, np.nan)
        other = {**made, "sig": np.full(n, second, np.int16), "sig2": np.zeros(n, np.int16), "elevation_rad": nan,
                 "azimuth_rad": nan, "rate_used": np.zeros(n, bool), "innovation_m": np.zeros(n),
                 "innovation_var_m2": np.zeros(n), "code_m": np.zeros(n)}  # fmt: skip
        blocks.append(other)
    joined = {}
    for name, values in ledger.items():
        blank = np.full(n, np.nan, dtype=values.dtype) if values.dtype.kind == "f" else np.zeros(n, values.dtype)
        joined[name] = np.concatenate([values[keep], *(np.asarray(b.get(name, blank), values.dtype) for b in blocks)])
    order = np.lexsort((joined["sv"], joined["t_ns"]))
    names = solution.clock_names
    shares = letter == "J" and "G" in names
    names = names if letter in names or shares else (*names, letter)
    return {name: values[order] for name, values in joined.items()}, names


def _mapping(elevation: F8) -> F8:
    """Slant over vertical ionosphere of a thin shell, as `starwise.kernels.error_states.shell_mapping`."""
    return np.asarray(1.0 / np.sqrt(1.0 - (SHELL_RATIO * np.cos(elevation)) ** 2))
