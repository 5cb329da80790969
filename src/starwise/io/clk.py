"""RINEX clock files (2.00, 3.00 to 3.04) as `PreciseClocks`."""

from pathlib import Path
from typing import Final

import numpy as np

from starwise.errors import StarwiseError
from starwise.io.files import read_bytes
from starwise.io.lines import labels_to_gpst, line_starts
from starwise.kernels.precise import ROW_BAD_EPOCH, ROW_BAD_NUMBER, ROW_BAD_SV, ROW_OK, ROW_SHORT, parse_clk
from starwise.types import F8, I8, PreciseClocks, Problem

_MAX_CLOCK_S: Final = 1.0
"""A clock further off than this is no navigation satellite's."""


def read_clk(*paths: str | Path) -> PreciseClocks:
    """Satellite clocks, s, out of one or more RINEX clock files.

    Only ``AS`` records are used; ``AR`` (receivers), ``CR``, ``DR`` and ``MS`` are counted. Where several files have
    a satellite at an epoch, the file named first wins. Within a file, values that contradict each other, and records
    whose epoch breaks the order of their neighbours, are left out and noted.

    Raises
    ------
    StarwiseError
        A file cannot be read, is no clock file, or holds no usable satellite clock.
    """
    if not paths:
        raise StarwiseError("no clock file given")
    problems: list[Problem] = []
    parts = [_read_file(path, problems) for path in paths]
    sv = np.concatenate([p[0] for p in parts])
    t_ns = np.concatenate([p[1] for p in parts])
    clock = np.concatenate([p[2] for p in parts])
    order = np.lexsort((t_ns, sv))  # stable: the first file stays first
    sv, t_ns, clock = sv[order], t_ns[order], clock[order]
    fresh = np.concatenate([[True], (sv[1:] != sv[:-1]) | (t_ns[1:] != t_ns[:-1])])
    sv, t_ns, clock = sv[fresh], t_ns[fresh], clock[fresh]
    names, starts = np.unique(sv, return_index=True)
    return PreciseClocks(
        sv=names.astype(np.int16),
        offsets=np.append(starts, len(sv)).astype(np.int64),
        t_ns=t_ns,
        clock_s=np.ascontiguousarray(clock[:, 0]),
        sigma_s=np.where(clock[:, 1] > 0.0, clock[:, 1], np.nan),
        problems=tuple(problems),
    )


def _read_file(path: str | Path, problems: list[Problem]) -> tuple[I8, I8, F8]:
    file = str(path)
    data = read_bytes(Path(path))
    if not data[:4096].strip() and not data.strip():
        raise StarwiseError("the file is empty", file=file, wanted="a RINEX clock file")
    body, header_lines, system = _parse_header(data, file)
    if not data.endswith(b"\n"):
        problems.append(Problem(file, data.count(b"\n") + 1, "the last line has no end: left out if it is cut"))
    buf = np.frombuffer(data, dtype=np.uint8)[body:]
    lines, first = line_starts(buf)
    second = buf[np.minimum(lines[:-1] + 1, max(len(buf) - 1, 0))] if len(buf) else first
    rows = np.flatnonzero((first == ord("A")) & (second == ord("S"))).astype(np.int64)
    others = np.flatnonzero((first > 32) & (first != ord("A")) | (first == ord("A")) & (second == ord("R")))
    if len(others):
        problems.append(
            Problem(file, header_lines + int(others[0]) + 1, "records of other kinds than AS: not used", len(others))
        )
    n = len(rows)
    if n == 0:
        raise StarwiseError("no satellite clocks", file=file, line=header_lines, wanted="AS records")
    labels, sv, state = (np.empty(n, dtype=np.int64) for _ in range(3))
    numbers = np.empty((n, 2))
    parse_clk(buf, lines, rows, labels, sv, state, numbers)
    if not data.endswith(b"\n") and rows[-1] == len(first) - 1:
        state[-1] = ROW_SHORT  # where it was cut cannot be seen
    at_line = header_lines + rows + 1

    def note(what: str, bad: np.ndarray) -> None:
        if bad.any():
            problems.append(Problem(file, int(at_line[bad][0]), f"{what}: left out", int(bad.sum())))

    for code, what in (
        (ROW_BAD_SV, "satellite not readable"),
        (ROW_BAD_EPOCH, "epoch not readable"),
        (ROW_BAD_NUMBER, "number not readable"),
        (ROW_SHORT, "line cut short"),
    ):
        note(what, state == code)
    good = state == ROW_OK
    wild = good & ~(np.abs(numbers[:, 0]) < _MAX_CLOCK_S)
    note("clock of no satellite", wild)
    good &= ~wild
    astray = np.zeros(n, dtype=bool)
    astray[good] = _out_of_order(labels[good])
    note("epoch out of order", astray)
    good &= ~astray
    torn = np.zeros(n, dtype=bool)
    torn[good] = _contradicts(sv[good], labels[good], numbers[good, 0])
    note("values that contradict each other", torn)
    good &= ~torn
    if not good.any():
        raise StarwiseError("no usable satellite clock", file=file, line=int(at_line[0]))
    return sv[good], labels_to_gpst(labels[good], system, file), numbers[good]


def _out_of_order(labels: I8) -> np.ndarray:
    """Records whose epoch is not between those of their neighbours, while the neighbours are in order."""
    bad = np.zeros(len(labels), dtype=bool)
    before, here, after = labels[:-2], labels[1:-1], labels[2:]
    bad[1:-1] = (before <= after) & ((here < before) | (here > after))
    return bad


def _contradicts(sv: I8, labels: I8, clock: F8) -> np.ndarray:
    """Records of a satellite and epoch that occur with different values."""
    order = np.lexsort((labels, sv))
    s, t, c = sv[order], labels[order], clock[order]
    same = (s[1:] == s[:-1]) & (t[1:] == t[:-1]) & (c[1:] != c[:-1])
    bad = np.zeros(len(sv), dtype=bool)
    bad[order[1:][same]] = True
    bad[order[:-1][same]] = True
    return bad


def _parse_header(data: bytes, file: str) -> tuple[int, int, str]:
    """Byte after the header, lines in it, and the time system."""
    end = data.find(b"END OF HEADER")
    first = data[: data.find(b"\n") + 1 or len(data)].decode("latin-1").rstrip()
    if "RINEX VERSION / TYPE" not in first or first[9:40].strip()[:1] != "C":
        raise StarwiseError("not a RINEX clock file", file=file, line=1, found=first, wanted="type C")
    try:
        version = float(first[:9])
    except ValueError:
        version = 0.0
    if not 2.0 <= version < 4.0:
        raise StarwiseError(
            "clock file version not supported", file=file, line=1, found=first[:9], wanted="2.00 to 3.04"
        )
    if end < 0:
        raise StarwiseError("the header does not end", file=file, wanted="END OF HEADER")
    stop = data.find(b"\n", end)
    stop = len(data) if stop < 0 else stop + 1
    header = data[:stop].decode("latin-1").splitlines()
    system = "GPS"
    for line in header:
        if line[58:].strip() == "TIME SYSTEM ID":
            system = line[:9].strip() or "GPS"
    return stop, data.count(b"\n", 0, stop), system
