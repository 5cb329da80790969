"""Observations and an ephemeris made into rows that least squares and filters take."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from starwise.config import RunConfig
from starwise.config_errors import ErrorParameters
from starwise.constants import (
    C_LIGHT,
    N_SYSTEMS,
    ROW_BAD_EPHEMERIS,
    ROW_EPHEMERIS_TOO_OLD,
    ROW_INACCURATE,
    ROW_NO_CLOCK,
    ROW_NO_EPHEMERIS,
    ROW_UNHEALTHY,
    ROW_USED,
    SAT_BAD_EPHEMERIS,
    SAT_INACCURATE,
    SAT_NO_CLOCK,
    SAT_NO_EPHEMERIS,
    SAT_TOO_OLD,
    SAT_UNHEALTHY,
    SYS_C,
    SYS_J,
    SYS_R,
    SYSTEMS,
)
from starwise.errors import StarwiseError
from starwise.kernels.error_states import ErrorModel, ErrorRows
from starwise.kernels.rangemodel import (
    IONO_BDS,
    IONO_GPS,
    IONO_NONE,
    TROPO_NONE,
    TROPO_SAASTAMOINEN,
    TROPO_SEASONAL,
    Epochs,
    ModelOptions,
    RowModel,
    Rows,
)
from starwise.models.error_model import error_model, error_rows, no_errors, second_signals, slow_sigma
from starwise.models.select import select
from starwise.physics.broadcast import empty_states
from starwise.signals import frequency_table, signal_name
from starwise.types import F8, I2, I8, U1, Ephemeris, IonosphereModel, Observations, SatStates, Sightings

_ROW_OF_SAT = np.zeros(16, dtype=np.uint8)
for _sat, _row in (
    (SAT_NO_EPHEMERIS, ROW_NO_EPHEMERIS),
    (SAT_UNHEALTHY, ROW_UNHEALTHY),
    (SAT_TOO_OLD, ROW_EPHEMERIS_TOO_OLD),
    (SAT_BAD_EPHEMERIS, ROW_BAD_EPHEMERIS),
    (SAT_NO_CLOCK, ROW_NO_CLOCK),
    (SAT_INACCURATE, ROW_INACCURATE),
):
    _ROW_OF_SAT[_sat] = _row

UNKNOWN_GROUP_DELAY_SIGMA_M = 3.0
"""1 sigma, m, added where a signal's group delay is not broadcast: the size of the delays themselves (GPS TGD
-20..+20 ns, IS-GPS-200N 20.3.3.3.3.2, typically 3-4 m rms; BeiDou TGD1 likewise)."""
EPHEMERIS_SIGMA_M = np.array([0.8, 5.0, 0.4, 1.2, 1.0, 2.0, 5.0])
"""Orbit and clock error of broadcast ephemerides in the line of sight as measured against precise products, 1 sigma m,
G R E C J I S (Montenbruck, Steigenberger, Hauschild, "Multi-GNSS signal-in-space range error assessment", Adv. Space
Res. 61, 2018, and their later tables; geostationary and old satellites counted in). GLONASS: about 2.5 m of that,
and the delays of its channels, for which nobody broadcasts a correction: 5 m, as RTKLIB takes them, too."""
EPHEMERIS_BEST_CLAIM_M = np.array([2.5, 5.0, 3.2, 2.5, 2.5, 2.5, 5.0])
"""Claims up to here, m, are the best index that a system broadcasts (URA 0: 2.4 m, IS-GPS-200N 20.3.3.3.1.3;
SISA 3.12 m, the only value that Galileo uses; 5 m stands for none): bounds for integrity, above the real error.
What a claim, or the age of a record, has beyond that is added in variance."""
CODE_NOISE_FACTOR = {SYS_R: 2.0}
"""Code noise and multipath as a multiple of ``noise.code_m``: GLONASS chips are twice as long as those of GPS C/A
(0.511 against 1.023 Mchip/s)."""


TROPOSPHERE = {"none": TROPO_NONE, "seasonal": TROPO_SEASONAL, "saastamoinen": TROPO_SAASTAMOINEN}


@dataclass(frozen=True)
class Prepared:
    """Everything that a run over epochs needs, and that only depends on inputs and configuration."""

    sightings: Sightings
    states: SatStates
    group_delay_m: F8
    row_status: U1
    """`ROW_*` of every observation row as selection left it."""
    rows: Rows
    epochs: Epochs
    options: ModelOptions
    clock_names: tuple[str, ...]
    """System letter of each receiver clock; QZSS shares that of GPS where both are used."""
    errors: ErrorModel
    error_rows: ErrorRows
    bias_names: tuple[str, ...]
    """Receiver code biases among the error states."""
    notes: tuple[str, ...]
    """What was decided where the inputs are silent: for the summary."""


def prepare(obs: Observations, ephemeris: Ephemeris, ionosphere: IonosphereModel, config: RunConfig) -> Prepared:
    """Select signals, attach satellites and lay out the rows of a run.

    Raises
    ------
    StarwiseError
        No observation is left to position with, and why.
    """
    if obs.n_epochs == 0:
        raise StarwiseError("no epochs in the observations (or none between start and end)")
    if_free = config.combination == "ionosphere_free"
    s, row_status = select(
        obs,
        config.systems,
        ionosphere_free=if_free,
        second_signal=second_signals(config),
        signals=config.signals,
        exclude=config.exclude,
        channels=ephemeris.channels,
    )
    use = np.flatnonzero(s.status == ROW_USED)
    if len(use) == 0:
        raise StarwiseError(
            "no pseudorange of the chosen systems and signals",
            found=", ".join(f"{k}: {' '.join(v)}" for k, v in obs.header.signals.items()) or "no declared signals",
            wanted=f"systems {config.systems}",
        )
    t_rx = np.repeat(s.t_ns, np.diff(s.offsets))
    states = _scatter(ephemeris.states(t_rx[use], s.sv[use], s.code_m[use], post=config.post), use, len(s.sv))
    status = s.status.copy()
    bad = _ROW_OF_SAT[states.status[use]]
    status[use] = np.where(bad != 0, bad, ROW_USED)
    delay = np.full(len(s.sv), np.nan)
    pair = s.sig2 if if_free else np.zeros_like(s.sig2)
    delay[use] = ephemeris.group_delay(states.record[use], s.sv[use], s.sig[use], pair[use])
    sigma = _ephemeris_sigma(states.sigma_m, s.sv >> 8)
    unknown_delay = ~np.isfinite(delay)
    sigma = np.where(unknown_delay, np.hypot(sigma, UNKNOWN_GROUP_DELAY_SIGMA_M), sigma)
    clock_names, clock = _clocks(s, status)
    options, notes = model_options(config, ionosphere)
    notes = [*ephemeris.notes, *notes]
    if not config.post:
        notes += _waiting(ephemeris, t_rx[use], s.sv[use], s.code_m[use], states.status[use])
    cn0 = s.cn0_dbhz
    if not _is_dbhz(obs.header.cn0_unit, cn0[use]):
        cn0 = np.full(len(cn0), np.nan)
        notes.append("signal strengths are not in dB-Hz: weights from elevation alone")
    if unknown_delay[use].any():
        which = _named_signals(s.sv[use][unknown_delay[use]], s.sig[use][unknown_delay[use]])
        notes.append(f"group delays not known of {which}: taken as 0, sigmas widened by 3 m")
    rows = Rows(
        sat_pos=states.pos_e,
        sat_vel=states.vel_e,
        clock_m=C_LIGHT * states.clock_s - np.where(unknown_delay, 0.0, delay),
        drift_mps=C_LIGHT * states.drift,
        code_m=s.code_m,
        rate_mps=s.rate_mps,
        cn0_dbhz=cn0,
        freq_hz=s.freq_hz,
        sigma_sat_m=sigma,
        noise_factor=s.noise_factor,
        system=(s.sv >> 8).astype(np.int64),
        clock=clock,
        status=status,
    )
    errors, extra = no_errors()
    bias_names: tuple[str, ...] = ()
    if config.error_model == "colored":
        errors, extra, bias_names = _colored(obs, s, states, ephemeris, rows, delay, config)
        left = (s.status == ROW_USED) & (s.row2 >= 0) & ~np.isfinite(extra.code2_m)
        if second_signals(config) and left.any():
            notes.append(
                f"second signals without a known group delay left out: {_named_signals(s.sv[left], s.sig2[left])}"
            )
    return Prepared(
        s, states, delay, row_status, rows, Epochs(s.t_ns, s.offsets), options, clock_names, errors, extra,
        bias_names, tuple(notes),
    )  # fmt: skip


def _named_signals(sv: I2, sig: I2) -> str:
    """Systems and signals of rows, each once, like ``G 1C, R 2C``."""
    pairs = np.flatnonzero(np.bincount((sv.astype(np.int64) >> 8 << 12) + sig))  # a signal has 12 bits
    return ", ".join(sorted(f"{SYSTEMS[pair >> 12]} {signal_name(pair & 0xFFF)}" for pair in pairs.tolist()))


def with_parameters(prepared: Prepared, p: ErrorParameters) -> Prepared:
    """The same run with other parameters of the coloured error model (which it must have); outputs fresh."""
    s, rows = prepared.sightings, prepared.error_rows
    steps = np.diff(s.t_ns)
    interval_s = float(np.median(steps)) * 1e-9 if len(steps) else 1.0
    extra = rows._replace(
        slow_m=slow_sigma(p, s.sv, prepared.rows.sigma_sat_m, EPHEMERIS_SIGMA_M[s.sv >> 8]),
        v2=np.full(len(s.sv), np.nan),
        s2=np.full(len(s.sv), np.nan),
        used=np.zeros(len(s.sv), dtype=np.uint8),
    )
    errors = error_model(p, prepared.errors.dual, prepared.errors.n_bias, interval_s)
    return replace(prepared, errors=errors, error_rows=extra)


def _colored(
    obs: Observations, s: Sightings, states: SatStates, ephemeris: Ephemeris, rows: Rows, delay: F8, config: RunConfig
) -> tuple[ErrorModel, ErrorRows, tuple[str, ...]]:
    """The coloured error model of a run and what it needs of each row."""
    dual = second_signals(config)
    delay2 = np.full(len(s.sv), np.nan)
    if dual:
        second = np.flatnonzero((s.status == ROW_USED) & (s.row2 >= 0))
        none = np.zeros(len(second), dtype=np.int16)
        delay2[second] = ephemeris.group_delay(states.record[second], s.sv[second], s.sig2[second], none)
    extra, bias_names = error_rows(
        obs,
        s if dual else replace(s, row2=np.full_like(s.row2, -1)),  # a combination is one code
        slow_sigma(config.errors, s.sv, rows.sigma_sat_m, EPHEMERIS_SIGMA_M[s.sv >> 8]),
        rows.clock_m,
        delay,
        delay2,
        frequency_table({**ephemeris.channels, **obs.channels}),
        obs.cn0_dbhz if np.isfinite(rows.cn0_dbhz).any() else None,
    )
    dual = dual and bool(np.isfinite(extra.code2_m).any())
    steps = np.diff(s.t_ns)
    interval_s = float(np.median(steps)) * 1e-9 if len(steps) else 1.0
    return error_model(config.errors, dual, len(bias_names), interval_s), extra, bias_names


def _waiting(ephemeris: Ephemeris, t_rx_ns: I8, sv: I2, code_m: F8, status: NDArray[np.int8]) -> list[str]:
    """A note on satellites whose ephemeris had not been sent yet: what ``post`` would add."""
    late = np.flatnonzero((status == SAT_NO_EPHEMERIS) | (status == SAT_TOO_OLD))
    if not len(late):
        return []
    later = ephemeris.states(t_rx_ns[late], sv[late], code_m[late], post=True).status
    late = late[(later != SAT_NO_EPHEMERIS) & (later != SAT_TOO_OLD)]
    if not len(late):
        return []
    rows = f"{len(late)} pseudoranges of {len(np.unique(sv[late]))} satellites wait"
    return [f"{rows} for an ephemeris that had not been sent yet (--post takes it from the future)"]


def _is_dbhz(unit: str, values: F8) -> bool:
    """Whether signal strengths can be dB-Hz: the header does not say otherwise and their middle is a receiver's.

    Tracking loops lose signals below about 20 dB-Hz, and nothing arrives above 60. RINEX 2 leaves the unit of S1 and
    S2 to the receiver.
    """
    known = values[np.isfinite(values)]
    if unit.strip() and unit.strip().upper().replace("-", "").replace("_", "") != "DBHZ":
        return False
    return len(known) == 0 or 20.0 <= float(np.median(known)) <= 65.0


def _scatter(found: SatStates, use: NDArray[np.intp], n: int) -> SatStates:
    """States of the usable rows spread over all rows."""
    if len(use) == n:
        return found
    states = empty_states(n)
    unknown = {"t_tx_ns": 0, "status": SAT_NO_EPHEMERIS, "record": -1}
    for name, values in vars(states).items():
        values.fill(unknown.get(name, np.nan))
        values[use] = getattr(found, name)
    return states


def _ephemeris_sigma(claim_m: F8, system: NDArray[np.int16]) -> F8:
    """1-sigma range error of the ephemeris, m, out of what it claims of itself (NaN: nothing)."""
    best, real = EPHEMERIS_BEST_CLAIM_M[system], EPHEMERIS_SIGMA_M[system]
    claim = np.where(np.isfinite(claim_m), claim_m, best)
    excess = np.maximum(claim**2 - best**2, 0.0)
    return np.where(claim < real, claim, np.sqrt(real**2 + excess))


def _clocks(s: Sightings, status: U1) -> tuple[tuple[str, ...], NDArray[np.int64]]:
    """Names of the receiver clocks of a run and the clock of every row."""
    present = set(np.unique(s.sv[status == ROW_USED] >> 8).tolist())
    share = SYS_J in present and 0 in present  # QZSST is steered to GPST (IS-QZSS-PNT-005 3.2.1)
    if share:
        present.discard(SYS_J)
    order = sorted(present)
    column = np.zeros(N_SYSTEMS, dtype=np.int64)
    for k, system in enumerate(order):
        column[system] = k
    if share:
        column[SYS_J] = column[0]
    return tuple(SYSTEMS[k] for k in order) or ("G",), column[s.sv >> 8]


def model_options(config: RunConfig, ionosphere: IonosphereModel) -> tuple[ModelOptions, list[str]]:
    """Numbers of the measurement model, and notes on what was decided."""
    notes: list[str] = []
    model = np.full(N_SYSTEMS, IONO_NONE, dtype=np.int64)
    coef = np.zeros((N_SYSTEMS, 8))
    if config.ionosphere == "broadcast" and config.combination != "ionosphere_free":
        common = next((ionosphere.klobuchar[k] for k in ("G", "J", "E", "I") if k in ionosphere.klobuchar), None)
        beidou = ionosphere.klobuchar.get("C")
        if common is not None:
            model[:], coef[:] = IONO_GPS, common
        elif beidou is not None:
            model[:], coef[:] = IONO_BDS, beidou
        else:
            notes.append("no broadcast ionosphere coefficients: no ionosphere correction, sigmas widened")
        if beidou is not None:
            model[SYS_C], coef[SYS_C] = IONO_BDS, beidou
    code_sigma = np.full(N_SYSTEMS, config.noise.code_m)
    for index, factor in CODE_NOISE_FACTOR.items():
        code_sigma[index] *= factor
    options = ModelOptions(
        mask_rad=math.radians(config.mask_deg),
        cn0_min_dbhz=config.cn0_min_dbhz,
        iono_model=model,
        iono_coef=coef,
        troposphere=TROPOSPHERE[config.troposphere],
        code_sigma=code_sigma,
        rate_sigma=config.noise.rate_mps,
        fixed_code_sigma_m=0.0,
        fixed_rate_sigma_mps=0.0,
    )
    return options, notes


def empty_row_model(n: int) -> RowModel:
    """Outputs for ``n`` rows, NaN."""
    small = ("status", "rate_used")
    # One piece of memory: see `starwise.estimators.run.make_ledger`.
    block = iter(np.full((len(RowModel._fields) - len(small), n), np.nan))
    columns: dict[str, Any] = {
        name: np.zeros(n, dtype=np.uint8) if name in small else next(block) for name in RowModel._fields
    }
    return RowModel(**columns)
