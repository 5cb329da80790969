"""Options files of RTKLIB (``.conf``) as options of a run.

Keys and values as in RTKLIB 2.4.3's options.c; values as words or as their numbers, comments behind ``#``. What has an
equivalent becomes an option of `starwise.config.RunConfig`; what has none and would change positions is named; what
changes nothing with single-point positions (ambiguities, antennas, base station, output formats) passes in silence.
Keys that are not in the file keep starwise's defaults, not RTKLIB's.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from starwise.errors import StarwiseError
from starwise.io.files import read_bytes
from starwise.io.inputs import peek
from starwise.signals import sv_id

Options = dict[str, Any]

_MODES: Final = (
    "single", "dgps", "kinematic", "static", "movingbase", "fixed", "ppp-kine", "ppp-static", "ppp-fixed",
)  # fmt: skip
_PPP: Final = ("ppp-kine", "ppp-static", "ppp-fixed")
_SWITCH: Final = ("off", "on")
_IONOSPHERE: Final = ("off", "brdc", "sbas", "dual-freq", "est-stec", "ionex-tec", "qzs-brdc", "qzs-lex", "stec")
_TROPOSPHERE: Final = ("off", "saas", "sbas", "est-ztd", "est-ztdgrad", "ztd")
_EPHEMERIS: Final = ("brdc", "precise", "brdc+sbas", "brdc+ssrapc", "brdc+ssrcom")
_TYPES: Final = ("forward", "backward", "combined", "combined-nophasereset")
_SYSTEMS: Final = {1: "G", 2: "S", 4: "R", 8: "E", 16: "J", 32: "C", 64: "I"}
_STATS: Final = {
    "stats-eratio1": 100.0, "stats-eratio2": 100.0, "stats-errphase": 0.003, "stats-errphaseel": 0.003,
    "stats-errphasebl": 0.0, "stats-errdoppler": 1.0,
}  # fmt: skip
"""Weights, with RTKLIB's defaults."""

SILENT: Final = re.compile(
    r"pos1-(dynamics|tidecorr|posopt[12346]|snrmask_b|snrmask_L[25]|snrmask_r)"
    r"|pos2-(?!rejgdop).*|ant[12]-.*|stats-.*|misc-(timeinterp|sbasatsel|pppopt|svrcycle|.*buf.*)"
    r"|out-(?!height|maxsolstd|timesys).*|file-(satantfile|rcvantfile|staposfile|geoidfile|eopfile|blqfile|tempdir"
    r"|geexefile|solstatfile|tracefile|elmaskfile)"
)
"""Keys that change no single-point position, or only how RTKLIB writes it."""
STREAMS: Final = re.compile(r"(inpstr|outstr|logstr|console|file-cmdfile|misc-(nmea|proxy|timeout|reconnect|pos)).*")
"""Keys of rtkrcv and str2str."""


@dataclass
class Imported:
    """What an options file comes to.

    Attributes
    ----------
    options : dict
        Fields of `RunConfig` with their values.
    notes : list of str
        What has no equivalent, key by key, and what is done instead.
    precise : bool or None
        Whether precise orbits are asked for (``pos1-sateph``); they come with the files of the run.
    filtered : bool
        The user has chosen an estimator: a filter may estimate what single-point positions of RTKLIB take from models.
    """

    options: Options = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    precise: bool | None = None
    filtered: bool = False

    def of_orbits(self, files: Sequence[str | Path]) -> list[str]:
        """What must be said of ``pos1-sateph`` when these files are solved."""
        if self.precise is None:
            return []
        given = any(peek(path).kind == "sp3" for path in files)
        if self.precise and not given:
            return ["pos1-sateph = precise: no SP3 file is given, broadcast ephemerides are taken"]
        if given and not self.precise:
            return ["pos1-sateph: an SP3 file is given, and used"]
        return []


@dataclass(frozen=True)
class _Entry:
    key: str
    value: str
    line: int
    file: str

    def word(self, words: tuple[str, ...]) -> str:
        """The value as one of the words, which may be written as its number."""
        text = self.value.lower()
        if text.isdigit() and int(text) < len(words):
            return words[int(text)]
        if text in words:
            return text
        raise self.error(", ".join(words))

    def number(self) -> float:
        match = re.match(r"[-+]?\d*\.?\d+(?:[eE][-+]?\d+)?", self.value)
        if match is None:
            raise self.error("a number")
        return float(match[0])

    def error(self, wanted: str) -> StarwiseError:
        return StarwiseError(
            f"{self.key} is not readable", file=self.file, line=self.line, found=self.value, wanted=wanted
        )

    def named(self, instead: str) -> str:
        return f"{self.key} = {self.value}: {instead}"


def read_rtklib_conf(path: str | Path, *, method_given: bool = False) -> Imported:
    """Options of a run out of an options file of RTKLIB.

    Parameters
    ----------
    path : path-like
        The file, as RTKPOST, RTKNAVI and ``rnx2rtkp -k`` have it.
    method_given : bool
        The user names the estimator: ``pos1-posmode`` then decides about the motion only, and modes that cannot be had
        are no error.

    Returns
    -------
    Imported

    Raises
    ------
    StarwiseError
        Not such a file; a value that RTKLIB does not know; a mode of positioning that cannot be had.
    """
    entries = _entries(path)
    out = Imported(filtered=method_given)
    mode = entries["pos1-posmode"].word(_MODES) if "pos1-posmode" in entries else "single"
    if "pos1-posmode" in entries:
        _mode(entries["pos1-posmode"], mode, out)
    for key, entry in entries.items():
        if key in _TAKEN:
            _TAKEN[key](entry, out)
    _signals(entries, out)
    _snr(entries, out)
    if out.precise and "file-satantfile" in entries and entries["file-satantfile"].value:
        out.notes.append(entries["file-satantfile"].named("phase centres of satellites are not applied"))
    _weights(entries, out)
    _unknown(entries, out)
    return out


def options_of(
    path: str | Path, options: Options, others: Mapping[str, object], files: Sequence[str | Path]
) -> tuple[Options, list[str]]:
    """Options of a run with those of the command line over them, and what ``run.json`` should say.

    Parameters
    ----------
    path : path-like
        Options file of RTKLIB.
    options : dict
        Those of the command line.
    others : mapping
        Options that cannot stand beside it, by name; None: not given.
    files : sequence of path-like
        Files of the run.

    Raises
    ------
    StarwiseError
        As `read_rtklib_conf`, or one of ``others`` is given.
    """
    for name, value in others.items():
        if value is not None:
            raise StarwiseError("--rtklib-conf", found=f"with {name}", wanted="one of them")
    imported = read_rtklib_conf(path, method_given="method" in options)
    notes = [f"options taken from {path}, where the command line does not say otherwise"]
    return {**imported.options, **options}, [*notes, *imported.notes, *imported.of_orbits(files)]


def values_of(path: str | Path) -> dict[str, str]:
    """Values of an options file of RTKLIB by key, as they are written.

    Raises
    ------
    StarwiseError
        Not such a file.
    """
    return {key: entry.value for key, entry in _entries(path).items()}


def _entries(path: str | Path) -> dict[str, _Entry]:
    text = read_bytes(path).decode("latin-1").removeprefix("\xef\xbb\xbf")
    entries: dict[str, _Entry] = {}
    for number, line in enumerate(text.splitlines(), 1):
        kept = line.split("#", 1)[0].strip()
        if not kept:
            continue
        key, equals, value = (part.strip() for part in kept.partition("="))
        if not equals or not key or not key.isprintable():
            raise StarwiseError(
                "not an option of RTKLIB", file=path, line=number, found=line.strip(), wanted="key = value"
            )
        entries[key] = _Entry(key, value, number, str(path))  # the last one counts, as in RTKLIB
    if not any(re.match(r"(pos[12]|out|stats|ant[12]|misc|file)-", key) for key in entries):
        raise StarwiseError("not an options file of RTKLIB", file=path, wanted="keys like pos1-posmode")
    return entries


def _mode(entry: _Entry, mode: str, out: Imported) -> None:
    if mode == "single":
        if not out.filtered:
            out.options |= {"method": "lsq", "error_model": "white"}
        return
    if not out.filtered:
        what, here = "positioning against a base", "the rover alone"
        if mode in _PPP:
            what, here = "carrier-phase positioning", "precise orbits with --ephemeris and --clock"
        raise StarwiseError(
            f"pos1-posmode = {mode}: {what} is not in starwise", file=entry.file, line=entry.line,
            wanted=f"pos1-posmode = single; or --method s3ekf, which positions by code and Doppler ({here})",
        )  # fmt: skip
    if mode in ("static", "ppp-static"):
        out.options["dynamics"] = "static"
    out.notes.append(entry.named("positioned by code and Doppler, as --method says"))


def _mask(entry: _Entry, out: Imported) -> None:
    out.options["mask_deg"] = entry.number()


def _ionosphere(entry: _Entry, out: Imported) -> None:
    word = entry.word(_IONOSPHERE)
    if word == "off":
        out.options["ionosphere"] = "none"
    elif word == "brdc":
        out.options["ionosphere"] = "broadcast"
    elif word != "dual-freq" and not (word in ("est-stec", "stec") and out.filtered):
        out.options["ionosphere"] = "broadcast"
        out.notes.append(entry.named("not here; the broadcast model is taken"))


def _troposphere(entry: _Entry, out: Imported) -> None:
    word = entry.word(_TROPOSPHERE)
    if out.filtered and word.startswith("est"):
        return  # a state of the filter
    # single-point positions of RTKLIB take Saastamoinen's model where a filter would estimate
    out.options["troposphere"] = "none" if word == "off" else "saastamoinen"
    if word in ("sbas", "ztd"):
        out.notes.append(entry.named("not here; Saastamoinen's model is taken"))


def _orbits(entry: _Entry, out: Imported) -> None:
    word = entry.word(_EPHEMERIS)
    out.precise = word == "precise"
    if word not in ("brdc", "precise"):
        out.notes.append(entry.named("corrections are not here; broadcast ephemerides are taken as they are"))


def _systems(entry: _Entry, out: Imported) -> None:
    try:
        mask = int(entry.value, 0)
    except ValueError:
        raise entry.error("a number: 1 GPS + 2 SBAS + 4 GLONASS + 8 Galileo + 16 QZSS + 32 BeiDou + 64 NavIC") from None
    letters = "".join(letter for bit, letter in _SYSTEMS.items() if mask & bit and letter not in "SI")
    left_out = [name for bit, name in ((2, "SBAS"), (64, "NavIC")) if mask & bit]
    if mask >> 7:
        left_out.append("others")
    if left_out:
        out.notes.append(entry.named(f"{' and '.join(left_out)} not positioned with"))
    if not letters:
        raise entry.error("a system that starwise positions with")
    out.options["systems"] = "".join(letter for letter in "GRECJ" if letter in letters)


def _excluded(entry: _Entry, out: Imported) -> None:
    names: list[str] = []
    kept: list[str] = []
    for text in entry.value.replace(",", " ").split():
        (kept if text.startswith("+") else names).append(_satellite(entry, text.lstrip("+")))
    if names:
        out.options["exclude"] = names
    if kept:
        out.notes.append(entry.named(f"{' '.join(kept)} not used while marked unhealthy"))


def _satellite(entry: _Entry, text: str) -> str:
    """RINEX name of a satellite as RTKLIB takes it: G05, or the number of a GPS, SBAS or QZSS satellite."""
    number = int(text) if text.isdigit() else 0
    name = text.upper()
    if number:
        name = f"G{number:02d}" if number <= 32 else f"S{number - 100:02d}" if number < 193 else f"J{number - 192:02d}"
    try:
        sv_id(name)
    except StarwiseError:
        raise entry.error("satellites like G05 R12") from None
    return name


def _fde(entry: _Entry, out: Imported) -> None:
    out.options["fde"] = entry.word(_SWITCH) == "on"


def _direction(entry: _Entry, out: Imported) -> None:
    if entry.word(_TYPES) != "forward":
        out.notes.append(entry.named("filters run forward only"))


def _height(entry: _Entry, out: Imported) -> None:
    if entry.word(("ellipsoidal", "geodetic")) == "geodetic":
        out.notes.append(entry.named("heights stay ellipsoidal (starwise export has --geoid)"))


def _times(entry: _Entry, out: Imported) -> None:
    if entry.word(("gpst", "utc", "jst")) != "gpst":
        out.notes.append(entry.named("times stay GPST (starwise export writes UTC where a format wants it)"))


def _limit(entry: _Entry, out: Imported) -> None:
    if entry.number() > 0.0:
        out.notes.append(
            entry.named("no epoch is left out for it; run.json and the parquet files say how sure each is")
        )


def _files(entry: _Entry, out: Imported) -> None:
    if entry.value:
        out.notes.append(entry.named("not read"))


_TAKEN: Final[dict[str, Callable[[_Entry, Imported], None]]] = {
    "pos1-elmask": _mask,
    "pos1-ionoopt": _ionosphere,
    "pos1-tropopt": _troposphere,
    "pos1-sateph": _orbits,
    "pos1-navsys": _systems,
    "pos1-exclsats": _excluded,
    "pos1-posopt5": _fde,
    "pos1-soltype": _direction,
    "out-height": _height,
    "out-timesys": _times,
    "out-maxsolstd": _limit,
    "pos2-rejgdop": _limit,
    "misc-rnxopt1": _files,
    "file-ionofile": _files,
    "file-dcbfile": _files,
}
_HANDLED: Final = (*_TAKEN, "pos1-posmode", "pos1-frequency", "pos1-snrmask_r", "pos1-snrmask_L1")


def _signals(entries: dict[str, _Entry], out: Imported) -> None:
    """Single-point positions of RTKLIB take the first frequency, or the ionosphere-free combination."""
    frequency = 1
    if "pos1-frequency" in entries:
        entry = entries["pos1-frequency"]
        match = re.fullmatch(r"([1-9])|l1((?:\+(?:l?[1-9]|e\w*))*)", entry.value.lower())
        if match is None:
            raise entry.error("l1, l1+l2 ... or a number")
        frequency = int(match[1]) if match[1] else 1 + match[2].count("+")
    dual = "pos1-ionoopt" in entries and entries["pos1-ionoopt"].word(_IONOSPHERE) == "dual-freq"
    if dual:
        out.options["combination"] = "ionosphere_free"
    elif not out.filtered or ("pos1-frequency" in entries and frequency == 1):
        out.options["combination"] = "single"


def _snr(entries: dict[str, _Entry], out: Imported) -> None:
    """Mask of C/N0 in nine steps of elevation (5, 15 ... 85 deg)."""
    switch = entries.get("pos1-snrmask_r")
    if switch is None or switch.word(_SWITCH) == "off":
        return
    entry = entries.get("pos1-snrmask_L1")
    if entry is None:
        return
    try:
        values = [float(text) for text in entry.value.split(",") if text.strip()]
    except ValueError:
        raise entry.error("nine numbers with commas, dB-Hz") from None
    least = min(values, default=0.0) if len(values) >= 9 else 0.0
    if not 0.0 <= least <= 99.0:
        raise entry.error("dB-Hz")
    out.options["cn0_min_dbhz"] = least
    other = entries.get("pos1-snrmask_L2")
    dual = out.options.get("combination") == "ionosphere_free"
    if dual and other is not None and other.value.replace(" ", "") != entry.value.replace(" ", ""):
        out.notes.append(other.named("not taken, one limit for all signals"))
    if values and (max(values) > least or len(values) < 9):
        out.notes.append(entry.named(f"no limits by elevation; {least:g} dB-Hz everywhere"))


def _weights(entries: dict[str, _Entry], out: Imported) -> None:
    changed = [key for key, usual in _STATS.items() if key in entries and entries[key].number() != usual]
    if changed:
        out.notes.append(f"{', '.join(changed)}: not taken, weights are starwise's own")


def _unknown(entries: dict[str, _Entry], out: Imported) -> None:
    rest = [key for key in entries if key not in _HANDLED and not SILENT.fullmatch(key)]
    streams = [key for key in rest if STREAMS.fullmatch(key)]
    if streams:
        more = "" if len(streams) == 1 else f" and {len(streams) - 1} more"
        out.notes.append(f"{streams[0]}{more}: keys of RTKLIB's real-time programs, not taken")
    others = [key for key in rest if key not in streams and entries[key].value]
    if others:
        out.notes.append(f"{', '.join(others)}: not known here, not taken")
