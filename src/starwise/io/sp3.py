"""SP3 precise orbits (versions a, b, c, d) as `PreciseOrbits`. Source: SP3-d format description (Hilla, 2016)."""

from bisect import bisect_left
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from starwise.errors import StarwiseError
from starwise.io.files import read_bytes
from starwise.io.lines import labels_to_gpst, line_starts
from starwise.kernels.precise import (
    FLAG_ORBIT_PREDICTED,
    ROW_BAD_NUMBER,
    ROW_BAD_SV,
    ROW_OK,
    ROW_SHORT,
    parse_sp3,
)
from starwise.types import F8, I8, U1, PreciseOrbits, Problem

_RADIUS_M: Final = (6.4e6, 1e8)
"""Positions outside are no satellite's: from the ground to well above geosynchronous orbits."""
_NO_CLOCK_US: Final = 999_999.0
"""Clock values from here on mean "bad or absent"."""


@dataclass
class _Header:
    version: str
    agency: str
    frame: str
    time_system: str = "GPS"
    pos_base: float = 0.0
    clock_base: float = 0.0
    satellites: list[str] = field(default_factory=list)
    exponents: list[int] = field(default_factory=list)


@dataclass
class _Rows:
    """Position lines of one file, epochs in GPST."""

    header: _Header
    t_ns: I8
    sv: I8
    pos_e: F8
    clock_s: F8
    pos_sigma_m: F8
    clock_sigma_s: F8
    predicted: np.ndarray
    problems: list[Problem]


def read_sp3(*paths: str | Path) -> PreciseOrbits:
    """Satellite positions, ECEF of the product, and clocks out of one or more SP3 files.

    Files are merged: where several have a satellite at an epoch, an observed position wins over a predicted one, then
    the file named first; position and clock come from the same file. Velocities (``V``) and correlations (``EP``,
    ``EV``) are not used; neither are satellites of no navigation system. Damaged lines, and epochs that break the
    order or the interval of the file, are left out and noted.

    Raises
    ------
    StarwiseError
        A file cannot be read, is no SP3 file, or holds no usable position.
    """
    if not paths:
        raise StarwiseError("no SP3 file given")
    files = [_read_file(path) for path in paths]
    t_ns = np.unique(np.concatenate([f.t_ns for f in files]))
    sv = np.unique(np.concatenate([f.sv for f in files]))
    shape = (len(sv), len(t_ns))
    pos_e, clock_s = np.full((*shape, 3), np.nan), np.full(shape, np.nan)
    pos_sigma_m, clock_sigma_s = np.full(shape, np.nan), np.full(shape, np.nan)
    predicted = np.zeros(shape, dtype=bool)
    for wanted in (True, False):  # what is written last stays
        for f in reversed(files):
            rows = f.predicted == wanted
            at = np.searchsorted(sv, f.sv[rows]), np.searchsorted(t_ns, f.t_ns[rows])
            pos_e[at], clock_s[at] = f.pos_e[rows], f.clock_s[rows]
            pos_sigma_m[at], clock_sigma_s[at] = f.pos_sigma_m[rows], f.clock_sigma_s[rows]
            predicted[at] = wanted
    problems = [p for f in files for p in f.problems]
    frames = {f.header.frame for f in files}
    if len(frames) > 1:
        problems.append(Problem(str(paths[0]), 1, f"files in different frames: {', '.join(sorted(frames))}"))
    return PreciseOrbits(
        t_ns=t_ns,
        sv=sv.astype(np.int16),
        pos_e=pos_e,
        clock_s=clock_s,
        pos_sigma_m=pos_sigma_m,
        clock_sigma_s=clock_sigma_s,
        predicted=predicted,
        time_system=files[0].header.time_system,
        frame=files[0].header.frame,
        agency=files[0].header.agency,
        problems=tuple(problems),
    )


def _read_file(path: str | Path) -> _Rows:
    file = str(path)
    data = read_bytes(Path(path))
    if not data[:4096].strip() and not data.strip():
        raise StarwiseError("the file is empty", file=file, wanted="an SP3 file")
    problems: list[Problem] = []
    if not data.rstrip().endswith(b"EOF"):
        problems.append(Problem(file, data.count(b"\n") + 1, "the file ends without EOF"))
        data = data[: data.rfind(b"\n") + 1] or data  # a last line without its end may be cut anywhere
    buf = np.frombuffer(data, dtype=np.uint8)
    lines, first = line_starts(buf)
    epoch_lines = np.flatnonzero(first == ord("*")).astype(np.int64)
    last = int(epoch_lines[0]) if len(epoch_lines) else len(first)
    header = _parse_header(data[: int(lines[last]) - 1].decode("latin-1").splitlines(), file)
    pos_lines = np.flatnonzero(first == ord("P")).astype(np.int64)
    pos_lines = pos_lines[pos_lines > last]
    if len(epoch_lines) == 0 or len(pos_lines) == 0:
        raise StarwiseError("no positions after the header", file=file, line=last, wanted="epoch and P lines")
    return _body(file, header, buf, lines, epoch_lines, pos_lines, problems)


def _body(
    file: str, header: _Header, buf: U1, lines: I8, epoch_lines: I8, pos_lines: I8, problems: list[Problem]
) -> _Rows:
    def note(what: str, bad: np.ndarray, at: I8) -> None:
        if bad.any():
            problems.append(Problem(file, int(at[bad][0]) + 1, f"{what}: left out", int(bad.sum())))

    n = len(pos_lines)
    labels = np.empty(len(epoch_lines), dtype=np.int64)
    sv, state, flags = (np.empty(n, dtype=np.int64) for _ in range(3))
    numbers = np.empty((n, 8))
    has_flags = header.version in "cd"
    parse_sp3(buf, lines, epoch_lines, pos_lines, has_flags, labels, sv, state, numbers, flags)
    note("epoch not readable", labels < 0, epoch_lines)
    in_order = _in_order(labels)
    note("epoch out of order or off the interval", (labels >= 0) & ~in_order, epoch_lines)
    for code, what in (
        (ROW_BAD_SV, "satellite of no navigation system"),
        (ROW_BAD_NUMBER, "number not readable"),
        (ROW_SHORT, "line cut short"),
    ):
        note(what, state == code, pos_lines)
    epoch = np.searchsorted(epoch_lines, pos_lines) - 1
    pos_e = numbers[:, :3] * 1e3
    absent = (numbers[:, :3] == 0.0).all(axis=1) | np.isnan(numbers[:, :3]).any(axis=1)
    radius = np.sqrt((pos_e**2).sum(axis=1))
    ok = (state == ROW_OK) & in_order[epoch]
    odd = ok & ~absent & ~((radius > _RADIUS_M[0]) & (radius < _RADIUS_M[1]))
    note("position of no satellite", odd, pos_lines)
    twice = _again(epoch, sv, ok)
    note("satellite a second time in an epoch", twice, pos_lines)
    use = ok & ~absent & ~odd & ~twice
    if not use.any():
        raise StarwiseError("no usable position", file=file, line=int(pos_lines[0]) + 1)
    clock_us = np.where(np.abs(numbers[:, 3]) < _NO_CLOCK_US, numbers[:, 3], np.nan)
    pos_sigma_m, clock_sigma_s = _sigmas(header, sv, numbers)
    return _Rows(
        header=header,
        t_ns=labels_to_gpst(labels[epoch[use]], header.time_system, file),
        sv=sv[use],
        pos_e=pos_e[use],
        clock_s=clock_us[use] * 1e-6,
        pos_sigma_m=pos_sigma_m[use],
        clock_sigma_s=clock_sigma_s[use],
        predicted=(flags[use] & FLAG_ORBIT_PREDICTED) != 0,
        problems=problems,
    )


def _in_order(labels: I8) -> np.ndarray:
    """Epochs on the grid that most share, and in the longest increasing sequence of them.

    A damaged epoch line would put good positions at a wrong time; where it breaks the grid or the order it shows.
    """
    good = labels >= 0
    known = labels[good]
    if len(known) > 2:
        step = int(np.median(np.diff(known)))
        if step > 0:
            phases, counts = np.unique(known % step, return_counts=True)
            if counts.max() * 2 > len(known):
                good &= labels % step == phases[counts.argmax()]
    tails: list[int] = []
    links: list[int] = []
    before = np.full(len(labels), -1)
    for i in np.flatnonzero(good).tolist():
        k = bisect_left(tails, int(labels[i]))
        before[i] = links[k - 1] if k else -1
        tails[k : k + 1] = [int(labels[i])]
        links[k : k + 1] = [i]
    chain = np.zeros(len(labels), dtype=bool)
    at = links[-1] if links else -1
    while at >= 0:
        chain[at] = True
        at = int(before[at])
    return chain


def _again(epoch: I8, sv: I8, ok: np.ndarray) -> np.ndarray:
    """Rows whose satellite stood in the same epoch before."""
    rows = np.flatnonzero(ok)
    _, first = np.unique(epoch[rows] << 16 | sv[rows], return_index=True)
    twice = ok.copy()
    twice[rows[first]] = False
    return twice


def _sigmas(header: _Header, sv: I8, numbers: F8) -> tuple[F8, F8]:
    """1 sigma of positions (mean over the axes), m, and clocks, s: of the line, else of the header, else NaN."""
    with np.errstate(over="ignore", invalid="ignore"):
        if header.pos_base > 1.0:
            axes = header.pos_base ** numbers[:, 4:7] * 1e-3
            pos = np.sqrt((axes**2).mean(axis=1))
        else:
            pos = np.full(len(sv), np.nan)
        clock = header.clock_base ** numbers[:, 7] * 1e-12 if header.clock_base > 1.0 else np.full(len(sv), np.nan)
    from_header = np.full(1 << 12, np.nan)
    for name, exponent in zip(header.satellites, header.exponents, strict=False):
        index = _sv_index(name)
        if exponent > 0 and 0 <= index < len(from_header):
            from_header[index] = 2.0**exponent * 1e-3
    return np.where(np.isnan(pos), from_header[np.clip(sv, 0, len(from_header) - 1)], pos), clock


def _sv_index(name: str) -> int:
    letter, number = name[:1], name[1:].strip()
    system = 0 if letter == " " else "GRECJIS".find(letter)
    return system << 8 | int(number) if system >= 0 and number.isdigit() else -1


def _parse_header(text: list[str], file: str) -> _Header:
    line = text[0] if text else ""
    if len(line) < 30 or line[0] != "#" or line[1] not in " abcd" or line[3:7].strip().isdigit() is False:
        raise StarwiseError("not an SP3 file", file=file, line=1, found=line, wanted="#a, #b, #c or #d and a date")
    header = _Header(version=line[1].strip() or "a", agency=line[56:60].strip(), frame=line[46:51].strip())
    scales = bases = 0
    for number, line in enumerate(text[1:], start=2):
        try:
            if line.startswith("++"):
                header.exponents += [int(line[9 + 3 * k : 12 + 3 * k] or 0) for k in range(17)]
            elif line.startswith("+"):
                names = (line[9 + 3 * k : 12 + 3 * k] for k in range(17))
                header.satellites += [name for name in names if name.strip() not in ("", "0")]
            elif line.startswith("%c"):
                if scales == 0:
                    name = line[9:12].strip()
                    header.time_system = "GPS" if name in ("", "ccc") else name
                scales += 1
            elif line.startswith("%f"):
                if bases == 0:
                    header.pos_base, header.clock_base = float(line[3:13] or 0), float(line[14:26] or 0)
                bases += 1
        except ValueError:
            raise StarwiseError("header line not readable", file=file, line=number, found=line) from None
    return header
