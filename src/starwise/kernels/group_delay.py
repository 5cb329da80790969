"""Satellite group delays of signals and combinations, m, from what the navigation messages broadcast."""

import numpy as np
from numpy.typing import NDArray

from starwise.constants import (
    C_LIGHT,
    ISC_1,
    ISC_2,
    ISC_3,
    ISC_4,
    ISC_5,
    ISC_6,
    MSG_FNAV,
    N_TGD,
    SYS_C,
    SYS_E,
    SYS_G,
    SYS_I,
    SYS_J,
    SYS_R,
    SYS_S,
    TGD_B1CP,
    TGD_B2AP,
    TGD_MAIN,
    TGD_SECOND,
)
from starwise.kernels._jit import njit

F8 = NDArray[np.float64]
I4 = NDArray[np.int32]
I2 = NDArray[np.int16]
I1 = NDArray[np.int8]

# Columns after those of `starwise.constants`, for what shares a column there or stands among the orbit's numbers.
TGD_B2B = N_TGD  # BeiDou CNV3: B2b I against B3I
DTAU = N_TGD + 1  # GLONASS: G2 against G1
N_DELAYS = N_TGD + 2

_A, _B, _C, _D, _I, _L, _P, _Q, _S, _X, _Z = 65, 66, 67, 68, 73, 76, 80, 81, 83, 88, 90


@njit
def _gps(d: F8, band: int, attr: int, qzss: bool, f: F8) -> float:
    """GPS and QZSS: IS-GPS-200N 20.3.3.3.3.2, 30.3.3.3.1.1; IS-GPS-705J 20.3.3.3.1.2; IS-QZSS-PNT-005 5.6."""
    tgd: float = d[TGD_MAIN]
    isc: float = np.nan
    if band == 1:
        isc = 0.0
        if attr == _C and d[ISC_1] == d[ISC_1] and not qzss:
            isc = d[ISC_1]
        elif attr == _S and d[ISC_5] == d[ISC_5]:
            isc = d[ISC_5]
        elif attr in (_L, _X) and d[ISC_6] == d[ISC_6]:
            isc = d[ISC_6]
        return tgd - isc
    if band == 2:
        if attr in (_S, _L, _X) and d[ISC_2] == d[ISC_2]:
            return float(tgd - d[ISC_2])
        return float((f[1] / f[2]) ** 2 * tgd)
    if band == 5:
        return float(tgd - (d[ISC_3] if attr == _I else d[ISC_4]))
    return np.nan


@njit
def _galileo(d: F8, band: int, fnav: bool, f: F8) -> float:
    """Galileo OS SIS ICD 2.1, 5.1.5: BGD(E1, E5x) = (delay(E1) - delay(E5x)) / (1 - (f1 / f5x)^2)."""
    a: float = d[TGD_MAIN]
    b: float = d[TGD_SECOND]
    one = a if fnav else b  # delay of E1 against the pair of the message's clock
    e5a: float = one - (1.0 - (f[1] / f[5]) ** 2) * a
    e5b: float = one - (1.0 - (f[1] / f[7]) ** 2) * b
    if band == 1:
        return one
    if band == 5:
        return e5a
    if band == 7:
        return e5b
    if band == 8:
        return 0.5 * (e5a + e5b)  # E5 AltBOC: not broadcast; its two halves differ by decimetres
    return np.nan


@njit
def _beidou(d: F8, band: int, attr: int) -> float:
    """BeiDou, clock of B3I: BDS-SIS-ICD-B1I-3.0 5.2.4.10, B1C-1.0 7.6, B2a-1.0 7.6, B2b-1.0 7.5."""
    legacy = attr in (_I, _Q, _X)
    if band == 2:
        return float(d[TGD_MAIN])
    if band == 6:
        return 0.0 if legacy else np.nan
    if band == 7:
        return float(d[TGD_SECOND] if legacy else d[TGD_B2B])
    if band == 1:
        return float(d[TGD_B1CP] + (d[ISC_1] if attr == _D else 0.0))
    if band == 5:
        return float(d[TGD_B2AP] + (d[ISC_2] if attr == _D else 0.0))
    if band == 8:
        return 0.5 * float(d[TGD_B2AP] + d[TGD_B2B])
    return np.nan


@njit
def signal_delay(d: F8, message: int, system: int, sig: int, f: F8) -> float:
    """Group delay, s, of one signal against the clock of the record that ``d`` belongs to; NaN if not known.

    Parameters
    ----------
    d : (N_DELAYS,) float64
        Broadcast delays of the record.
    message : int
        ``MSG_*``: Galileo's clock depends on it.
    system : int
        Index in `SYSTEMS`.
    sig : int
        Signal identifier.
    f : (10,) float64
        Carrier frequencies by band, Hz.
    """
    band, attr = sig >> 8, sig & 255
    if system in (SYS_G, SYS_J):
        return _gps(d, band, attr, system == SYS_J, f)
    if system == SYS_E:
        return _galileo(d, band, message == MSG_FNAV, f)
    if system == SYS_C:
        return _beidou(d, band, attr)
    if system == SYS_R:
        # DeltaTau = t(G2) - t(G1), clock of G1: GLONASS ICD L1/L2 5.1, 4.4 and 3.3.1.4
        if band == 1:
            return 0.0
        return float(d[DTAU]) if band == 2 else np.nan
    if system == SYS_I:
        # IRNSS SPS ICD 1.1, 6.2.1.5: S with TGD, L5 with (fS / f5)^2 TGD
        if band == 9:
            return float(d[TGD_MAIN])
        return float((f[9] / f[5]) ** 2 * d[TGD_MAIN]) if band == 5 else np.nan
    return 0.0 if system == SYS_S and band == 1 else np.nan


@njit
def combined_delay(d: F8, message: int, system: int, sig: int, sig2: int, f: F8) -> float:
    """Group delay, s, of a signal (``sig2`` 0) or of the ionosphere-free combination of two."""
    one = signal_delay(d, message, system, sig, f)
    if sig2 == 0:
        return one
    f1, f2 = f[sig >> 8], f[sig2 >> 8]
    g = f1 * f1 / (f1 * f1 - f2 * f2)
    return float(g * one + (1.0 - g) * signal_delay(d, message, system, sig2, f))


@njit
def group_delays(
    record: I4, sv: I2, sig: I2, sig2: I2, delays: F8, message: I1, frequency: F8, ref: I2, out: F8
) -> None:
    """Group delays, m, of rows; NaN where not known.

    Parameters
    ----------
    record, sv, sig, sig2 : (n,)
        Record number (-1: none), satellite, first signal, second or 0.
    delays : (n_records, N_DELAYS) float64
    message : (n_records,) int8
    frequency : (7, 256, 10) float64
        `starwise.signals.frequency_table`.
    ref : (7, 2) int16
        Pair of signals, by system, whose ionosphere-free combination the clock belongs to; 0 for the clock of
        the record itself.
    out : (n,) float64
    """
    for i in range(len(sv)):
        out[i] = np.nan
        if record[i] < 0 or sig[i] <= 0:
            continue
        system = sv[i] >> 8
        f = frequency[system, sv[i] & 255]
        d, m = delays[record[i]], message[record[i]]
        s = combined_delay(d, m, system, sig[i], sig2[i], f)
        if ref[system, 0] > 0:
            s -= combined_delay(d, m, system, ref[system, 0], ref[system, 1], f)
        out[i] = C_LIGHT * s
