"""Writers of RINEX 3.05 observation and navigation files: what a simulated receiver would have recorded."""

import datetime as dt
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from starwise.constants import (
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
    K_E,
    K_I0,
    K_IDOT,
    K_M0,
    K_OMEGA,
    K_OMEGA0,
    K_OMEGA_DOT,
    K_SQRT_A,
    K_TOE_SOW,
    MSG_D1,
    MSG_D2,
    MSG_FDMA,
    MSG_FNAV,
    MSG_INAV,
    MSG_LNAV,
    NS,
    R_AX,
    R_CHANNEL,
    R_DTAU,
    R_GAMMA,
    R_TAU,
    R_VX,
    R_X,
    SYS_C,
    SYS_G,
    SYS_J,
    SYSTEMS,
    TGD_MAIN,
    TGD_SECOND,
    WEEK_S,
)
from starwise.errors import StarwiseError
from starwise.gnsstime import (
    BDT_OFFSET_S,
    BDT_WEEK_OFFSET,
    GPS_EPOCH,
    gpst_to_utc,
    leap_seconds,
)
from starwise.kernels.sim_format import FIELD, SATELLITE, observation_lines
from starwise.signals import signal_id, signal_name, sv_name
from starwise.types import BroadcastRecords, Observations

PROGRAM: Final = "starwise"
_GLONASS_FT: Final = (1.0, 2.0, 2.5, 4.0, 5.0, 7.0, 10.0, 12.0, 14.0, 16.0, 32.0, 64.0, 128.0, 256.0, 512.0)
_PHASE_SHIFT: Final = "SYS / PHASE SHIFT"


def _line(text: str, label: str) -> str:
    return f"{text[:60]:<60}{label:<20}".rstrip() + "\n"


def _date() -> str:
    """Creation date: fixed, so that equal input gives equal files."""
    return "19800106 000000 UTC"


# -- observations ----------------------------------------------------------------------------------------------------
def write_obs(obs: Observations, path: str | Path, program: str = PROGRAM) -> None:
    """Write observations as RINEX 3.05.

    Parameters
    ----------
    obs : Observations
        Rows by epoch, satellites together.
    path : path-like
    program : str
        For the header.

    Raises
    ------
    StarwiseError
        No epoch, more than nine digits before the point, or the file cannot be written.

    Notes
    -----
    Code, phase and Doppler are rounded to 0.001 m, cycles and Hz, C/N0 to 0.001 dB-Hz, time tags to 0.1 us.
    """
    if obs.n_epochs == 0:
        raise StarwiseError("no epoch to write", file=path)
    signals = _signals_of(obs)
    kinds = _kinds_of(obs)
    text = _obs_header(obs, signals, kinds, program).encode("ascii", "replace")
    _write(path, text + _obs_body(obs, signals, kinds))


def _signals_of(obs: Observations) -> dict[str, list[str]]:
    """Signals by system letter: those of the header first, then what else occurs."""
    pairs = np.unique(np.stack([obs.sv >> 8, obs.sig], axis=1), axis=0)
    found: dict[str, list[str]] = {}
    for letter in SYSTEMS:
        present = [signal_name(int(g)) for s, g in pairs if SYSTEMS[s] == letter]
        if present:
            declared = [code[1:] for code in obs.header.signals.get(letter, ()) if code[1:] in present]
            declared = list(dict.fromkeys(declared))
            found[letter] = declared + [s for s in present if s not in declared]
    return found


def _kinds_of(obs: Observations) -> str:
    """Kinds of observations that occur: the pseudorange and ``L``, ``D``, ``S`` where there are any."""
    columns = {"L": obs.phase_cyc, "D": obs.doppler_hz, "S": obs.cn0_dbhz}
    return "C" + "".join(kind for kind, values in columns.items() if np.isfinite(values).any())


def _obs_header(obs: Observations, signals: dict[str, list[str]], kinds: str, program: str) -> str:
    h = obs.header
    systems = set(signals)
    kind = systems.pop() if len(systems) == 1 else "M"
    first = _calendar(int(obs.t_ns[0]), 7)
    last = _calendar(int(obs.t_ns[-1]), 7)
    x, y, z = h.approx_pos_e or (0.0, 0.0, 0.0)
    out = [
        _line(f"{'3.05':>9}{'':11}{'OBSERVATION DATA':<20}{kind:<20}", "RINEX VERSION / TYPE"),
        _line(f"{program:<20}{'':<20}{_date():<20}", "PGM / RUN BY / DATE"),
        _line(h.marker or "SIMU", "MARKER NAME"),
        _line(f"{'SIMULATED':<20}{'':<40}", "OBSERVER / AGENCY"),
        _line(f"{'0':<20}{h.receiver[:20]:<20}{'1':<20}", "REC # / TYPE / VERS"),
        _line(f"{'0':<20}{h.antenna[:20]:<20}", "ANT # / TYPE"),
        _line(f"{x:14.4f}{y:14.4f}{z:14.4f}", "APPROX POSITION XYZ"),
        _line("".join(f"{v:14.4f}" for v in h.antenna_hen), "ANTENNA: DELTA H/E/N"),
    ]
    for letter, names in signals.items():
        types = [kind + name for name in names for kind in kinds]
        for k in range(0, len(types), 13):
            head = f"{letter}  {len(types):3d}" if k == 0 else " " * 6
            out.append(_line(head + "".join(f" {t}" for t in types[k : k + 13]), "SYS / # / OBS TYPES"))
    out.append(_line("DBHZ", "SIGNAL STRENGTH UNIT"))
    if h.interval_s:
        out.append(_line(f"{h.interval_s:10.3f}", "INTERVAL"))
    out.append(_line(f"{first}{'':5}GPS", "TIME OF FIRST OBS"))
    out.append(_line(f"{last}{'':5}GPS", "TIME OF LAST OBS"))
    for letter, names in signals.items():
        out.extend(_line(f"{letter} L{name}", _PHASE_SHIFT) for name in names)
    if "R" in signals:
        slots = sorted(obs.channels.items())
        for k in range(0, max(len(slots), 1), 8):
            head = f"{len(slots):3d}" if k == 0 else "   "
            part = "".join(f" {sv_name(sv)} {channel:2d}" for sv, channel in slots[k : k + 8])
            out.append(_line(head + part, "GLONASS SLOT / FRQ #"))
        biases = "".join(f" {code} {0.0:8.3f}" for code in ("C1C", "C1P", "C2C", "C2P"))
        out.append(_line(biases, "GLONASS COD/PHS/BIS"))
    out.append(_line(f"{leap_seconds(int(obs.t_ns[0])):6d}", "LEAP SECONDS"))
    out.append(_line("", "END OF HEADER"))
    return "".join(out)


def _calendar(t_ns: int, decimals: int) -> str:
    """Epoch of a header: 5 I6, F13.7."""
    seconds, rest = divmod(t_ns, NS)
    at = GPS_EPOCH + dt.timedelta(seconds=seconds)
    return f"{at.year:6d}{at.month:6d}{at.day:6d}{at.hour:6d}{at.minute:6d}{at.second + rest / NS:13.{decimals}f}"


def _obs_body(obs: Observations, signals: dict[str, list[str]], kinds: str) -> bytes:
    """Epoch records."""
    column = np.zeros((len(SYSTEMS), 1 << 15), dtype=np.int64)
    n_columns = np.zeros(len(SYSTEMS), dtype=np.int64)
    for letter, names in signals.items():
        system = SYSTEMS.index(letter)
        n_columns[system] = len(kinds) * len(names)
        for k, name in enumerate(names):
            column[system, signal_id(name)] = len(kinds) * k
    epoch = obs.epoch_of_row()
    new = np.ones(obs.n_rows, dtype=bool)
    new[1:] = (obs.sv[1:] != obs.sv[:-1]) | (epoch[1:] != epoch[:-1])
    satellites = np.bincount(epoch[new], minlength=obs.n_epochs)
    lines = [
        _epoch_line(int(t), int(flag), int(n), float(offset))
        for t, flag, n, offset in zip(obs.t_ns, obs.flag, satellites, obs.clock_offset_s, strict=True)
    ]
    text = np.frombuffer("".join(lines).encode("ascii"), dtype=np.uint8)
    starts = np.concatenate([[0], np.cumsum([len(line) for line in lines])]).astype(np.int64)
    values = np.stack([obs.code_m, obs.phase_cyc, obs.doppler_hz, obs.cn0_dbhz], axis=1)
    if np.nanmax(np.abs(values), initial=0.0) >= 1e10:
        raise StarwiseError("an observation does not fit into a RINEX file", found=f"{np.nanmax(np.abs(values)):g}")
    size = len(text) + int((SATELLITE + FIELD * n_columns[obs.sv[new] >> 8] + 1).sum())
    out = np.empty(size, dtype=np.uint8)
    letters = np.frombuffer(SYSTEMS.encode(), dtype=np.uint8)
    place = np.array([kinds.find(kind) for kind in "CLDS"], dtype=np.int64)
    used = observation_lines(
        obs.offsets, text, starts, np.ascontiguousarray(obs.sv), column[obs.sv >> 8, obs.sig], place, n_columns,
        letters, np.ascontiguousarray(values), np.ascontiguousarray(obs.lli), out,
    )  # fmt: skip
    return out[:used].tobytes()


def _epoch_line(t_ns: int, flag: int, n_satellites: int, offset_s: float) -> str:
    """RINEX 3.05 table A3: the epoch record."""
    ticks = (t_ns + 50) // 100
    seconds, rest = divmod(ticks, NS // 100)
    at = GPS_EPOCH + dt.timedelta(seconds=seconds)
    offset = "" if offset_s != offset_s else f"{'':6}{offset_s:15.12f}"
    return (
        f"> {at.year:4d} {at.month:02d} {at.day:02d} {at.hour:02d} {at.minute:02d} {at.second:2d}.{rest:07d}"
        f"  {flag:1d}{n_satellites:3d}{offset}\n"
    )


# -- navigation --------------------------------------------------------------------------------------------------------
_ORBIT_LINES: Final = (
    # columns of orbit lines 1 to 4; None: issue of data
    (None, K_CRS, K_DELTA_N, K_M0),
    (K_CUC, K_E, K_CUS, K_SQRT_A),
    (K_TOE_SOW, K_CIC, K_OMEGA0, K_CIS),
    (K_I0, K_CRC, K_OMEGA, K_OMEGA_DOT),
)


def write_nav(records: BroadcastRecords, path: str | Path, program: str = PROGRAM) -> None:
    """Write broadcast records as RINEX 3.05: LNAV, INAV and FNAV, D1 and D2, FDMA.

    Raises
    ------
    StarwiseError
        A message that RINEX 3.05 cannot hold, no record, or the file cannot be written.
    """
    if records.n == 0:
        raise StarwiseError("no record to write", file=path)
    known = (MSG_LNAV, MSG_INAV, MSG_FNAV, MSG_D1, MSG_D2, MSG_FDMA)
    if not np.isin(records.message, known).all():
        raise StarwiseError("a message that RINEX 3.05 cannot hold", file=path, wanted="LNAV INAV FNAV D1 D2 FDMA")
    body = [_nav_record(records, int(i)) for i in np.lexsort((records.message, records.sv, records.toc_ns))]
    _write(path, (_nav_header(records, program) + "".join(body)).encode("ascii", "replace"))


def _nav_header(records: BroadcastRecords, program: str) -> str:
    systems = {SYSTEMS[int(s) >> 8] for s in np.unique(records.sv)}
    kind = systems.pop() if len(systems) == 1 else "M"
    out = [
        _line(f"{'3.05':>9}{'':11}{'N: GNSS NAV DATA':<20}{kind:<20}", "RINEX VERSION / TYPE"),
        _line(f"{program:<20}{'':<20}{_date():<20}", "PGM / RUN BY / DATE"),
    ]
    names = {"G": "GPS", "J": "QZS", "C": "BDS", "I": "IRN"}
    for letter, values in sorted(records.ionosphere.klobuchar.items()):
        for mark, part in (("A", values[:4]), ("B", values[4:])):
            text = f"{names[letter] + mark:<5}" + "".join(f"{v:12.4E}" for v in part)
            out.append(_line(text, "IONOSPHERIC CORR"))
    if records.ionosphere.nequick is not None:
        text = "GAL  " + "".join(f"{v:12.4E}" for v in records.ionosphere.nequick)
        out.append(_line(text, "IONOSPHERIC CORR"))
    if records.leap_s is not None:
        out.append(_line(f"{records.leap_s:6d}", "LEAP SECONDS"))
    out.append(_line("", "END OF HEADER"))
    return "".join(out)


def _number(value: float) -> str:
    """D19.12 of RINEX; blank if there is none."""
    return " " * 19 if value != value else f"{value:19.12E}"


def _numbers(values: Sequence[float]) -> str:
    return ("    " + "".join(_number(v) for v in values)).rstrip() + "\n"


def _nav_record(records: BroadcastRecords, i: int) -> str:
    sv = int(records.sv[i])
    system = sv >> 8
    toc = int(records.toc_ns[i])
    if records.message[i] == MSG_FDMA:
        return _glonass_record(records, i, sv, toc)
    own = BDT_OFFSET_S * NS if system == SYS_C else 0
    p = records.par[i]
    iode = float(records.iode[i])
    lines = [_first(sv, toc - own, (p[K_AF0], p[K_AF1], p[K_AF2]))]
    lines += [_numbers([iode if c is None else float(p[c]) for c in columns]) for columns in _ORBIT_LINES]
    toe = int(records.toe_ns[i]) - own
    week = toe // (WEEK_S * NS) - (BDT_WEEK_OFFSET if system == SYS_C else 0)
    t_tx = (int(records.t_tx_ns[i]) - own - toe) / NS + float(p[K_TOE_SOW])
    accuracy = float(records.accuracy_m[i])
    health = float(records.health[i])
    tgd, tgd2 = (float(records.tgd[i, c]) for c in (TGD_MAIN, TGD_SECOND))
    fit = float(records.fit_s[i])
    if system in (SYS_G, SYS_J):
        codes = 1.0 if system == SYS_G else 2.0
        lines.append(_numbers([p[K_IDOT], codes, float(week), 0.0]))
        lines.append(_numbers([accuracy, health, tgd, float(records.iodc[i])]))
        flag = fit / 3600.0 if system == SYS_G else float(fit > 7200.0)
        lines.append(_numbers([t_tx, 0.0 if fit != fit else flag]))
    elif system == SYS_C:
        lines.append(_numbers([p[K_IDOT], 0.0, float(week), 0.0]))
        lines.append(_numbers([accuracy, health, tgd, tgd2]))
        lines.append(_numbers([t_tx, float(records.iodc[i])]))
    else:
        lines.append(_numbers([p[K_IDOT], float(records.source[i]), float(week), 0.0]))
        lines.append(_numbers([accuracy, health, tgd, tgd2]))
        lines.append(_numbers([t_tx]))
    return "".join(lines)


def _first(sv: int, label_ns: int, clock: Sequence[float]) -> str:
    at = GPS_EPOCH + dt.timedelta(seconds=label_ns // NS)
    return f"{sv_name(sv)} {at:%Y %m %d %H %M %S}" + "".join(_number(float(v)) for v in clock) + "\n"


def _glonass_record(records: BroadcastRecords, i: int, sv: int, toc: int) -> str:
    """RINEX 3.05 table A10: km, UTC."""
    p = records.par[i]
    utc = int(gpst_to_utc(toc))
    sent = int(gpst_to_utc(int(records.t_tx_ns[i]))) % (WEEK_S * NS) / NS
    health = int(records.health[i])
    lines = [_first(sv, utc, (p[R_TAU], p[R_GAMMA], sent))]
    fourth = (float(health & 7), float(p[R_CHANNEL]), 0.0)
    for k in range(3):
        lines.append(_numbers([p[R_X + k] / 1e3, p[R_VX + k] / 1e3, p[R_AX + k] / 1e3, fourth[k]]))
    accuracy = float(records.accuracy_m[i])
    index = _GLONASS_FT.index(accuracy) if accuracy in _GLONASS_FT else 15
    dtau = float(p[R_DTAU])
    flags = (4 if health & 8 else 0) | (2 if health & 16 else 1)
    lines.append(_numbers([0.0, 0.999999999999e9 if dtau != dtau else dtau, float(index), float(flags)]))
    return "".join(lines)


def _write(path: str | Path, data: bytes) -> None:
    try:
        Path(path).write_bytes(data)
    except OSError as error:
        raise StarwiseError(f"cannot be written ({error.strerror})", file=path) from None
