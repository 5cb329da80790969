"""The coloured error model of a run: parameters and rows as the kernels take them."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from starwise.config import RunConfig
from starwise.config_errors import ErrorParameters
from starwise.constants import N_SYSTEMS, ROW_USED, SYS_C, SYS_E, SYS_G, SYS_J, SYS_R, SYSTEMS
from starwise.kernels.error_states import ErrorModel, ErrorRows
from starwise.signals import signal_name, sv_name
from starwise.types import F8, I8, Observations, Sightings

MAX_SLOTS = 64
"""Satellites with states at once: more than are ever above the horizon, and those that just left."""
MULTIPATH_STATES_BELOW = 1.6
"""Multipath gets states where epochs are nearer than so many correlation times (exp(-1.6) = 0.2); else it is white."""
VERTICAL_UNKNOWN_M = 5.0
"""Sigma of the zenith delay where no broadcast model says anything of it."""
GEO = frozenset([*range(1, 6), *range(59, 64)])
"""BeiDou satellites in geostationary orbit (BDS-SIS-ICD-B1I-3.0 and the constellation's status)."""


def second_signals(config: RunConfig) -> bool:
    """Whether a run takes two frequencies, uncombined."""
    return config.error_model == "colored" and config.combination in ("auto", "uncombined")


def no_errors() -> tuple[ErrorModel, ErrorRows]:
    """The white model: nothing."""
    model = error_model(ErrorParameters(), False, 0, 1.0)._replace(on=False, floor=0.0)
    none = np.zeros(0)
    i8 = np.zeros(0, np.int64)
    return model, ErrorRows(i8, none, i8, i8, none, none, none, none, none, none, np.zeros(0, np.uint8))


def slow_sigma(p: ErrorParameters, sv: NDArray[np.int16], claim_m: F8, nominal_m: F8) -> F8:
    """Sigma of orbit and clock per row: the parameter of the system, precise where the ephemeris claims to be.

    ``claim_m`` is what `starwise.models.pseudorange` made of the ephemeris' own claim, ``nominal_m`` the same for a
    healthy broadcast record: what exceeds it (age, poor accuracy, an unknown group delay) is added in variance.
    """
    table = np.full(N_SYSTEMS, 1.0)
    for known, value in (
        (SYS_G, p.slow_gps_m),
        (SYS_R, p.slow_glonass_m),
        (SYS_E, p.slow_galileo_m),
        (SYS_C, p.slow_beidou_m),
        (SYS_J, p.slow_qzss_m),
    ):
        table[known] = value
    system = sv >> 8
    slow = table[system]
    geo = (system == SYS_C) & np.isin(sv & 255, list(GEO))
    slow = np.where(geo, p.slow_beidou_geo_m, slow)
    precise = claim_m < nominal_m
    excess = np.sqrt(np.maximum(claim_m**2 - nominal_m**2, 0.0))
    return np.where(precise, np.hypot(p.precise_fraction * slow, claim_m), np.hypot(slow, excess))


def code_biases(
    sv: NDArray[np.int16], sig: NDArray[np.int16], sig2: NDArray[np.int16]
) -> tuple[I8, I8, tuple[str, ...]]:
    """Index of the receiver code bias of the first and second signals; names. QZSS shares GPS's clock."""
    key1 = (sv >> 8).astype(np.int64) << 16 | sig
    key2 = (sv >> 8).astype(np.int64) << 16 | sig2
    index: dict[int, int] = {}
    bias_names: list[str] = []
    systems = sv >> 8
    for system in np.unique(systems).tolist():
        here = systems == system
        names, counts = np.unique(sig[here & (sig > 0)], return_counts=True)
        if not len(names):
            continue
        lead = int(names[np.argmax(counts)])
        if system == SYS_J and bool((systems == SYS_G).any()):
            lead = -1  # its first signal, too, is delayed against that of GPS
        others = set(names.tolist()) | set(np.unique(sig2[here & (sig2 > 0)]).tolist())
        for name in sorted(others - {lead}):
            index[system << 16 | name] = len(index)
            bias_names.append(f"bias.{SYSTEMS[system]}.{signal_name(name)}")

    def look(key: I8, valid: NDArray[np.bool_]) -> I8:
        out = np.full(len(key), -1, dtype=np.int64)
        for value, place in index.items():
            out[(key == value) & valid] = place
        return out

    return look(key1, sig > 0), look(key2, sig2 > 0), tuple(bias_names)


def error_rows(
    obs: Observations,
    s: Sightings,
    slow_m: F8,
    clock_m: F8,
    delay_m: F8,
    delay2_m: F8,
    frequency: F8,
    cn0_dbhz: F8 | None,
) -> tuple[ErrorRows, tuple[str, ...]]:
    """Rows of the coloured error model, and the names of the receiver code biases.

    Parameters
    ----------
    obs, s
        Observations, and what was selected of them.
    slow_m : (n,)
        Sigma of orbit and clock.
    clock_m : (n,)
        Satellite clock less the group delay of the first signal, m (`Rows.clock_m`).
    delay_m, delay2_m : (n,)
        Group delays, m; NaN: not known.
    frequency : (7, 256, 10)
        Carriers, Hz.
    cn0_dbhz : (n_rows,) or None
        Of the observation rows; None: not in dB-Hz.
    """
    n = len(s.sv)
    # GLONASS broadcasts no delay for its second signal: its signal bias is as large as what is missing.
    known = np.isfinite(delay2_m) | (s.sv >> 8 == SYS_R)
    use = (s.status == ROW_USED) & (s.row2 >= 0) & known
    bias1, bias2, bias_names = code_biases(s.sv, s.sig, np.where(use, s.sig2, np.int16(0)))
    code2, freq2, cn02, clock2 = np.full(n, np.nan), np.full(n, np.nan), np.full(n, np.nan), np.full(n, np.nan)
    row2 = s.row2[use]
    code2[use] = obs.code_m[row2]
    if cn0_dbhz is not None:
        cn02[use] = cn0_dbhz[row2]
    freq2[use] = frequency[s.sv[use] >> 8, s.sv[use] & 255, s.sig2[use] >> 8]
    known1, known2 = np.nan_to_num(delay_m), np.nan_to_num(delay2_m)
    clock2[use] = (clock_m + known1 - known2)[use]
    rows = ErrorRows(
        sv=s.sv.astype(np.int64),
        slow_m=slow_m,
        bias1=bias1,
        bias2=bias2,
        code2_m=code2,
        clock2_m=clock2,
        freq2_hz=freq2,
        cn02_dbhz=cn02,
        v2=np.full(n, np.nan),
        s2=np.full(n, np.nan),
        used=np.zeros(n, dtype=np.uint8),
    )
    return rows, bias_names


def error_model(p: ErrorParameters, dual: bool, n_bias: int, interval_s: float) -> ErrorModel:
    """Numbers of the coloured error model; epochs are ``interval_s`` apart in the middle."""
    multipath = interval_s < MULTIPATH_STATES_BELOW * p.multipath_tau_s
    block = 3
    signal2 = multipath1 = multipath2 = -1
    if dual:
        signal2, block = block, block + 1
    if multipath:
        multipath1, block = block, block + 1
        if dual:
            multipath2, block = block, block + 1
    signal_bias, white = np.full(N_SYSTEMS, p.signal_bias_m), np.full(N_SYSTEMS, p.code_white_m)
    signal_bias[SYS_R], white[SYS_R] = p.signal_bias_glonass_m, p.code_white_glonass_m
    return ErrorModel(
        on=True,
        dual=dual,
        multipath=multipath,
        n_bias=n_bias,
        block=block,
        signal2=signal2,
        multipath1=multipath1,
        multipath2=multipath2,
        slow_tau=p.slow_tau_s,
        ionosphere_fraction=p.ionosphere_fraction,
        ionosphere_floor=p.ionosphere_floor_m,
        ionosphere_tau=p.ionosphere_tau_s,
        vertical_fraction=p.vertical_fraction,
        vertical_floor=p.vertical_floor_m,
        vertical_unknown=VERTICAL_UNKNOWN_M,
        gradient_fraction=p.gradient_fraction,
        gradient_floor=p.gradient_floor_m,
        vertical_tau=p.vertical_tau_s,
        troposphere=p.troposphere_m,
        troposphere_tau=p.troposphere_tau_s,
        slope=p.slope_m,
        receiver_bias=p.receiver_bias_m,
        signal_bias=signal_bias,
        signal_tau=p.signal_tau_s,
        code_white=white,
        multipath_sigma=np.full(N_SYSTEMS, p.multipath_m),
        multipath_tau=p.multipath_tau_s,
        multipath_length=p.multipath_length_m,
        weak_cn0=p.weak_cn0_dbhz,
        weak_sigma=p.weak_m,
        weak_decade=p.weak_decade_db,
        weak_share=p.weak_share,
        rate_motion=p.rate_motion,
        rate_weak=p.rate_weak_per_m,
        scale_max=p.scale_max,
        scale_rise=p.scale_rise_s,
        scale_fall=p.scale_fall_s,
        late=p.late_sigma,
        early=p.early_sigma,
        floor=p.floor_m,
        absent_s=p.absent_s,
    )


def error_names(errors: ErrorModel, bias_names: tuple[str, ...], satellites: Sequence[int]) -> tuple[str, ...]:
    """Names of the error states in their order, for a `starwise.types.Layout` behind motion and clocks.

    Parameters
    ----------
    errors : ErrorModel
    bias_names : tuple of str
        Receiver code biases.
    satellites : sequence of int
        Identifiers of the satellites with states, in the order of their slots.
    """
    names = ["trop", "iono.v", "iono.n", "iono.e", "slope.1", "slope.2", *bias_names]
    block = ["slow", "iono", "sig1"]
    if errors.signal2 >= 0:
        block.append("sig2")
    if errors.multipath1 >= 0:
        block.append("mp1")
    if errors.multipath2 >= 0:
        block.append("mp2")
    return (*names, *(f"{kind}.{sv_name(sv)}" for sv in satellites for kind in block))
