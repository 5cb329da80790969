"""Broadcast records made by hand for tests."""

import numpy as np

from starwise.constants import (
    K_A_DOT,
    K_AF0,
    K_AF1,
    K_AF2,
    K_CIC,
    K_CIS,
    K_CRC,
    K_CRS,
    K_CUC,
    K_CUS,
    K_DELTA_N,
    K_DELTA_N_DOT,
    K_E,
    K_I0,
    K_IDOT,
    K_M0,
    K_OMEGA,
    K_OMEGA0,
    K_OMEGA_DOT,
    K_SQRT_A,
    K_TOE_SOW,
    MESSAGE_NAMES,
    N_EPH_PAR,
    N_TGD,
    NS,
    R_AX,
    R_CHANNEL,
    R_DTAU,
    R_GAMMA,
    R_TAU,
    R_VX,
    R_X,
    WEEK_S,
)  # fmt: skip
from starwise.signals import sv_id
from starwise.types import BroadcastRecords

T0 = (2199 * WEEK_S + 7200) * NS  # 2022-02-27 02:00 GPST
_KEPLER = {
    K_AF0: -3.1e-4, K_AF1: -8.3e-12, K_AF2: 1e-19, K_E: 0.0123, K_I0: 0.961, K_OMEGA0: -1.37, K_OMEGA: 0.82,
    K_M0: -2.1, K_DELTA_N: 4.5e-9, K_OMEGA_DOT: -8.1e-9, K_IDOT: 3.2e-10, K_CUC: -1.1e-6, K_CUS: 9.2e-6,
    K_CRC: 215.3, K_CRS: -21.8, K_CIC: 1.3e-7, K_CIS: -8.9e-8, K_A_DOT: 0.0, K_DELTA_N_DOT: 0.0,
}  # fmt: skip
_GLONASS = {  # about what R01 sent on 2021-01-01
    R_TAU: 3.2e-5, R_GAMMA: 9.1e-13, R_X: 12_317_934.08, R_X + 1: -2_245_613.28, R_X + 2: 22_212_173.34,
    R_VX: -1027.01, R_VX + 1: 2706.43, R_VX + 2: 844.37, R_AX: 1.9e-6, R_AX + 1: 9.3e-7, R_AX + 2: -9.3e-7,
    R_CHANNEL: 1.0, R_DTAU: -1.8e-9,
}  # fmt: skip
_SBAS = {
    R_TAU: 1e-7, R_GAMMA: 1e-12, R_X: 40_602_000.0, R_X + 1: -11_354_000.0, R_X + 2: 21_000.0, R_VX: 0.1,
    R_VX + 1: 0.4, R_VX + 2: 1.1, R_AX: 1e-5, R_AX + 1: 2e-5, R_AX + 2: -5e-5, R_CHANNEL: np.nan,
}  # fmt: skip
SQRT_A = {"G": 5153.7, "E": 5440.6, "C": 5282.6, "J": 6493.4, "I": 6493.2}


def record(sv="G05", toe_s=0.0, message=None, tx_s=None, **over):
    """One record, reference time ``T0 + toe_s``; columns of ``par`` by number in ``par``, others by name."""
    system = sv[0]
    message = message or {"G": "LNAV", "R": "FDMA", "E": "INAV", "C": "D1", "S": "SBAS"}.get(system, "LNAV")
    par = np.zeros(N_EPH_PAR)
    toe_ns = T0 + round(toe_s * NS)
    if system in "RS":
        columns = _GLONASS if system == "R" else _SBAS
    else:
        offset = 14 if system == "C" else 0
        columns = {**_KEPLER, K_SQRT_A: SQRT_A[system], K_TOE_SOW: (toe_ns / NS - offset) % WEEK_S}
        if system == "C" and (int(sv[1:]) <= 5 or int(sv[1:]) >= 59):
            columns = {**columns, K_SQRT_A: 6493.4, K_I0: 0.11, K_E: 3e-4}
    for column, value in {**columns, **over.pop("par", {})}.items():
        par[column] = value
    tgd = np.full(N_TGD, np.nan)
    for column, value in over.pop("tgd", {}).items():
        tgd[column] = value
    one = {
        "sv": sv_id(sv), "message": MESSAGE_NAMES.index(message), "toc_ns": toe_ns, "toe_ns": toe_ns,
        "t_tx_ns": toe_ns if tx_s is None else T0 + round(tx_s * NS), "par": par, "tgd": tgd, "accuracy_m": 2.0,
        "health": 0, "iode": 1, "iodc": 1, "fit_s": np.nan, "source": 0,
    }  # fmt: skip
    assert set(over) <= set(one), over
    return {**one, **over}


def records(*rows):
    """`BroadcastRecords` of rows made by `record`, sorted as readers do."""
    rows = sorted(rows, key=lambda r: (r["sv"], r["toe_ns"]))
    types = {
        "sv": np.int16, "message": np.int8, "health": np.int32, "iode": np.int32, "iodc": np.int32, "source": np.int32
    }  # fmt: skip
    columns = {k: np.array([r[k] for r in rows], dtype=types.get(k)) for k in rows[0]}
    return BroadcastRecords(**columns)
