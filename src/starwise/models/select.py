"""Which signal of each satellite is used: by a stated preference, written into the ledger."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from starwise.constants import N_SYSTEMS, SYSTEMS
from starwise.errors import StarwiseError
from starwise.kernels.select import COMBINED, SINGLE, UNCOMBINED, count_sightings, select_signals
from starwise.signals import DEFAULT_PAIRS, DEFAULT_PREFERENCE, DEFAULT_SECOND, frequency_table, signal_id, sv_id
from starwise.types import U1, Observations, Sightings


def _ranks(preference: Mapping[str, Sequence[str]]) -> NDArray[np.int64]:
    table = np.full((N_SYSTEMS, 10, 128), -1, dtype=np.int64)
    for letter, names in preference.items():
        if letter not in SYSTEMS:
            raise StarwiseError("unknown system in signal preference", found=letter, wanted=f"one of {SYSTEMS}")
        for place, name in enumerate(names):
            sig = signal_id(name)
            table[SYSTEMS.index(letter), sig >> 8, sig & 127] = place
    return table


def select(
    obs: Observations,
    systems: str = "GRECJ",
    *,
    ionosphere_free: bool = False,
    second_signal: bool = False,
    signals: Mapping[str, Sequence[str]] | None = None,
    exclude: Sequence[str] = (),
    channels: Mapping[int, int] | None = None,
) -> tuple[Sightings, U1]:
    """Choose one signal (or pair) per satellite and epoch.

    Parameters
    ----------
    obs : Observations
    systems : str
        System letters to use.
    ionosphere_free : bool
        Two frequencies combined instead of one signal.
    second_signal : bool
        A second signal on another frequency beside the first, where there is one.
    signals : mapping, optional
        Preference by system letter, best first, in place of `DEFAULT_PREFERENCE` (single frequency); with two
        frequencies, the first signal is taken from it and the second from the bands of the others.
    exclude : sequence of str
        Satellites not to use.
    channels : mapping, optional
        GLONASS channels known from elsewhere (navigation files); those of the observation file come first.

    Returns
    -------
    Sightings
    (n_rows,) uint8 array
        ``ROW_*`` of every observation row as far as selection decides it.

    Raises
    ------
    StarwiseError
        A name is not a system, a signal or a satellite.
    """
    for letter in systems:
        if letter not in SYSTEMS:
            raise StarwiseError("unknown system", found=letter, wanted=f"letters of {SYSTEMS}")
    if ionosphere_free:
        first = {k: v[0] for k, v in DEFAULT_PAIRS.items()}
        second = {k: v[1] for k, v in DEFAULT_PAIRS.items()}
        for letter, names in (signals or {}).items():
            lead = names[0][0] if names else ""
            first[letter] = tuple(n for n in names if n[0] == lead)
            second[letter] = tuple(n for n in names if n[0] != lead)
    else:
        first, second = {**DEFAULT_PREFERENCE, **{k: tuple(v) for k, v in (signals or {}).items()}}, {}
        if second_signal:
            second = dict(DEFAULT_SECOND)
            for letter, names in (signals or {}).items():
                second[letter] = tuple(n for n in names if n[0] != names[0][0])
    on = np.array([s in systems for s in SYSTEMS], dtype=np.uint8)
    excluded = np.zeros((N_SYSTEMS, 256), dtype=np.uint8)
    for name in exclude:
        sv = sv_id(name)
        excluded[sv >> 8, sv & 255] = 1
    n = count_sightings(obs.offsets, obs.sv)
    row_status = np.zeros(obs.n_rows, dtype=np.uint8)
    s = Sightings(
        t_ns=obs.t_ns,
        offsets=np.zeros(obs.n_epochs + 1, dtype=np.int64),
        sv=np.zeros(n, dtype=np.int16),
        sig=np.zeros(n, dtype=np.int16),
        sig2=np.zeros(n, dtype=np.int16),
        row=np.zeros(n, dtype=np.int64),
        row2=np.zeros(n, dtype=np.int64),
        code_m=np.zeros(n),
        rate_mps=np.zeros(n),
        cn0_dbhz=np.zeros(n),
        freq_hz=np.zeros(n),
        noise_factor=np.ones(n),
        status=np.zeros(n, dtype=np.uint8),
    )
    select_signals(
        obs.offsets, obs.sv, obs.sig, obs.code_m, obs.doppler_hz, obs.cn0_dbhz,
        on, excluded, _ranks(first), _ranks(second),
        COMBINED if ionosphere_free else UNCOMBINED if second_signal else SINGLE,
        frequency_table({**(channels or {}), **obs.channels}),
        row_status, s.offsets, s.sv, s.sig, s.sig2, s.row, s.row2, s.code_m, s.rate_mps, s.cn0_dbhz, s.freq_hz,
        s.noise_factor, s.status,
    )  # fmt: skip
    return s, row_status
