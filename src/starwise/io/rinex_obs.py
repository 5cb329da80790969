"""Reader of RINEX observation files (versions 2.0x, 2.1x, 3.0x, 4.0x), plain or packed, into `Observations`."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from starwise.constants import NS
from starwise.errors import StarwiseError
from starwise.gnsstime import BDT_OFFSET_S, utc_to_gpst
from starwise.io.files import unpack
from starwise.io.rinex_codes import translate
from starwise.io.rinex_header import Header, Problems, apply_lines, read_header
from starwise.kernels import rinex_records as kernel
from starwise.types import I8, U1, Observations, Problem

_WHAT: Final = {
    kernel.BAD_EPOCH: "epoch record that cannot be read, or lines that belong to none: skipped",
    kernel.SAT_COUNT: "number of satellites differs from the epoch record: those present were read",
    kernel.JUNK_LINE: "line that is no record: skipped",
    kernel.UNDECLARED: "satellite of a system for which the header declares no signals: skipped",
    kernel.BAD_VALUE: "value that is not a number or is cut short: left blank",
    kernel.SAT_TWICE: "satellite listed twice in an epoch: the first kept",
    kernel.CUT_LINE: "last line cut off within an epoch: its satellite dropped",
    kernel.SLIP_RECORDS: "cycle slip records (flag 6): skipped",
    kernel.LOST_EPOCH: "lines of an epoch do not fit its satellites: epoch dropped",
    kernel.BAD_NAME: "satellite name that cannot be read: skipped",
    kernel.EXTRA: "more on a satellite's line than the header declares: not read",
    kernel.TOO_MANY: "more satellite lines than an epoch can have: skipped",
}
_FLAGS: Final = {2: "antenna moves", 3: "new site", 4: "header lines", 5: "external event"}


def read_obs(*paths: str | Path, limit: int | None = None) -> Observations:
    """Observations of one receiver from one or several files, spliced in time.

    Epochs are sorted; of epochs with the same time the one that is in sequence with its neighbours in the file
    stays, else the first. What was dealt with is counted in ``problems``.

    Parameters
    ----------
    *paths : path-like
        RINEX 2, 3 or 4 observation files; plain, ``.gz .Z .zip .bz2`` and compact RINEX, told by content.
    limit : int, optional
        Largest unpacked size of a file, bytes (`starwise.io.files.unpacked_limit`).

    Raises
    ------
    StarwiseError
        A file that cannot be read or is not one of observations; a body with text but no epoch.

    Notes
    -----
    Sources: RINEX 2.11 (2007), 3.05 (2020) and 4.02 (2024). Time tags are those of the receiver: the clock offset
    of an epoch record is kept beside them and not applied. Blank and 0.000 values are missing. Where a signal's
    strength is not among the observations, it is the middle of the class (6 dB-Hz wide) that the digit beside
    its phase or code gives. Scale factors are applied; phase shifts and GLONASS code-phase biases are not.
    """
    if not paths:
        raise StarwiseError("no observation file given")
    parts: list[Observations] = []
    for path in paths:
        unpacked = unpack(path, limit)
        parts.append(parse_obs(unpacked.data, str(path), unpacked.warnings))
    return parts[0] if len(parts) == 1 else splice(parts)


def parse_obs(data: bytes, file: str = "", warnings: Sequence[str] = ()) -> Observations:
    """Observations in the text of one RINEX file; see `read_obs`.

    Parameters
    ----------
    data : bytes
        Plain text (`starwise.io.files.read_bytes`).
    file : str
        Name for messages.
    warnings : sequence of str
        What the unpacking had to say; it becomes problems.
    """
    problems = Problems(file)
    for words in warnings:
        problems.add(1, words[:200])
    return _Body(data, problems).read()


def splice(parts: Sequence[Observations]) -> Observations:
    """Observations of the same receiver from several sources, in one, sorted in time; see `read_obs`.

    Header and signals are those of the first part; GLONASS channels are united.
    """
    counts = np.concatenate([np.diff(p.offsets) for p in parts])
    channels: dict[int, int] = {}
    for part in reversed(parts):
        channels |= part.channels
    joined: dict[str, Any] = {
        name: np.concatenate([getattr(p, name) for p in parts])
        for name in ("t_ns", "flag", "clock_offset_s", "sv", "sig", "code_m", "phase_cyc", "doppler_hz",
                     "cn0_dbhz", "lli")
    }  # fmt: skip
    both = Observations(
        offsets=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        channels=channels,
        header=parts[0].header,
        problems=tuple(p for part in parts for p in part.problems),
        **joined,
    )
    _one_receiver(parts)
    n_same = int(both.n_epochs - len(np.unique(both.t_ns)))
    if n_same:
        file = " ".join(sorted({p.file for p in both.problems})) or "several files"
        what = "epoch that another file has already: dropped"
        both = replace(both, problems=(*both.problems, Problem(file, 1, what, n_same)))
    return _in_order(both)


def _one_receiver(parts: Sequence[Observations]) -> None:
    """Refuse files that disagree about the same epochs: two receivers do not make one trajectory."""
    known: dict[int, float] = {}
    same = other = 0
    for part in parts:
        if not part.n_epochs:
            continue
        sums = np.add.reduceat(np.append(np.nan_to_num(part.code_m), 0.0), part.offsets[:-1])
        for t, total in zip(part.t_ns.tolist(), sums.tolist(), strict=True):
            if t in known:
                same, other = same + (known[t] == total), other + (known[t] != total)
            else:
                known[t] = total
    if other > max(same, 2):
        raise StarwiseError(
            "observation files of different receivers",
            found=f"{other} epochs that stand in two files with different pseudoranges",
            wanted="the files of one receiver",
        )


def _in_order(obs: Observations) -> Observations:
    """Epochs sorted by time, one kept of those that are equal.

    A damaged time tag must not replace the epoch whose time it took: of equal epochs the first that is not before
    its predecessor nor after its successor stays, if there is one.
    """
    t = obs.t_ns
    if len(t) < 2 or bool((np.diff(t) > 0).all()):
        return obs
    back = np.diff(t) < 0
    astray = np.append(back, False) | np.append(False, back)
    order = np.lexsort((np.arange(len(t)), astray, t))
    keep = np.ones(len(t), dtype=bool)
    keep[1:] = np.diff(t[order]) > 0
    order = order[keep]
    counts = np.diff(obs.offsets)[order]
    offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    rows = np.arange(offsets[-1]) + np.repeat(obs.offsets[order] - offsets[:-1], counts)
    return Observations(
        t_ns=t[order],
        offsets=offsets,
        flag=obs.flag[order],
        clock_offset_s=obs.clock_offset_s[order],
        sv=obs.sv[rows],
        sig=obs.sig[rows],
        code_m=obs.code_m[rows],
        phase_cyc=obs.phase_cyc[rows],
        doppler_hz=obs.doppler_hz[rows],
        cn0_dbhz=obs.cn0_dbhz[rows],
        lli=obs.lli[rows],
        channels=obs.channels,
        header=obs.header,
        problems=obs.problems,
    )


class _Body:
    """One file while it is being read: the kernel runs until it needs a new layout or more room."""

    def __init__(self, data: bytes, problems: Problems) -> None:
        self.data = data
        self.buf: U1 = np.frombuffer(data, dtype=np.uint8)
        self.problems = problems
        self.header, body, self.line = read_header(data, 0, 1, problems)
        self.body = body
        self.state = np.zeros(kernel.N_STATE, dtype=np.int64)
        self.state[kernel.POS] = body
        self.found = np.zeros((kernel.N_PROBLEMS, 2), dtype=np.int64)
        # a value takes 16 bytes, a row mostly 3 or 4 of them, an epoch seldom less than 10 lines
        size = len(data) - body
        self.out = _room(None, size // 320 + 64, size // 40 + 256)
        self.segments: list[tuple[int, str]] = [(0, self.header.time_system)]
        self.signals: dict[str, tuple[str, ...]] = {}
        self.counted = (0, 1)  # a byte position and its line number
        self._relayout(1)

    def _relayout(self, line: int) -> None:
        self.layout, signals = translate(self.header, line, self.problems)
        width = int(self.layout.sig.shape[1])
        self.scratch = kernel.new_scratch(width, -(-width // self.layout.per_line))
        for letter, codes in signals.items():
            known = self.signals.get(letter, ())
            self.signals[letter] = known + tuple(c for c in codes if c not in known)

    def _line(self, pos: int) -> int:
        """Line number, from 1, of a byte position; counted from the last one asked for, if that is before."""
        start, line = self.counted if pos >= self.counted[0] else (0, 1)
        self.counted = (int(pos), line + self.data.count(b"\n", start, int(pos)))
        return self.counted[1]

    def read(self) -> Observations:
        first = replace(self.header)  # what the file says of itself; events may change what follows
        run = _kernel(first)
        while True:
            ended = run(self.buf, self.layout, self.state, self.found, self.scratch, self.out)
            if ended == kernel.DONE:
                break
            if ended == kernel.FULL:
                rows = int(self.state[kernel.ROWS] + self.state[kernel.NEED])
                self.out = _room(self.out, 2 * len(self.out.t), max(2 * len(self.out.sv), 2 * rows))
            elif ended == kernel.EVENT:
                self._event()
            else:
                self._second_header()
                run = _kernel(self.header)
        for what, text in _WHAT.items():
            count, pos = self.found[what]
            if count:
                self.problems.add(self._line(pos), text, int(count))
        return self._observations(first)

    def _event(self) -> None:
        """Special records: header lines may change what follows; a wrong number of them is told."""
        at, to = int(self.state[kernel.AT]), int(self.state[kernel.TO])
        lines = [text.decode("latin-1").rstrip() for text in self.data[at:to].split(b"\n")]
        if lines and not lines[-1]:
            lines.pop()
        number = self._line(at)
        flag = int(self.state[kernel.FLAG])
        if flag != 4:
            self.problems.add(number - 1, f"event: {_FLAGS[flag]} (flag {flag})")
        if len(lines) != self.state[kernel.WANTED]:
            self.problems.add(number - 1, "number of lines differs from the event record")
        before = ({k: tuple(v) for k, v in self.header.codes.items()}, dict(self.header.scale))
        apply_lines(self.header, lines, number, self.problems)
        if before != ({k: tuple(v) for k, v in self.header.codes.items()}, self.header.scale):
            self._relayout(number)

    def _second_header(self) -> None:
        """Another file glued on: its header replaces the one before."""
        pos = int(self.state[kernel.POS])
        line = self._line(pos)
        self.problems.add(line, "another header within the file: used from there on")
        channels = self.header.channels
        self.header, body, _ = read_header(self.data, pos, line, self.problems)
        self.header.channels = channels | self.header.channels
        self.segments.append((int(self.state[kernel.EPOCHS]), self.header.time_system))
        self.state[kernel.POS] = body
        self._relayout(line)

    def _observations(self, first: Header) -> Observations:
        n, m = int(self.state[kernel.EPOCHS]), int(self.state[kernel.ROWS])
        if n == 0:
            if self.data[self.body :].strip():
                raise StarwiseError(
                    "no epoch could be read", file=self.problems.file, line=self.line, wanted="epoch records"
                )
            self.problems.add(self.line, "the file has no epochs")
        out = self.out
        t = out.t[:n].copy()
        ends = [start for start, _ in self.segments[1:]] + [n]
        for (start, system), end in zip(self.segments, ends, strict=True):
            t[start:end] = _to_gpst(t[start:end], system)
        if n > 1:
            late = t < np.maximum.accumulate(t)
            same = n - len(np.unique(t))
            if late.any():
                at = self._line(int(out.at[int(np.argmax(late))]))
                self.problems.add(at, "epoch out of order: sorted", int(late.sum()))
            if same:
                order = np.argsort(t, kind="stable")
                twice = order[1:][np.diff(t[order]) == 0]
                at = self._line(int(out.at[int(twice.min())]))
                self.problems.add(at, "epoch with the time of another: one kept", same)
        code, phase, doppler, cn0 = (out.values[kind, :m] for kind in range(4))
        channels = first.channels | self.header.channels
        return _in_order(
            Observations(
                t_ns=t,
                offsets=out.offsets[: n + 1].copy(),
                flag=out.flag[:n].copy(),
                clock_offset_s=out.clock[:n].copy(),
                sv=out.sv[:m],
                sig=out.sig[:m],
                code_m=code,
                phase_cyc=phase,
                doppler_hz=doppler,
                cn0_dbhz=cn0,
                lli=out.lli[:m],
                channels=channels,
                header=first.public(self.signals),
                problems=self.problems.all(),
            )
        )


def _kernel(header: Header) -> Callable[..., int]:
    """The kernel for this version; only the one needed is loaded."""
    if header.version >= 3.0:
        from starwise.kernels.rinex_obs import read_body

        return read_body
    from starwise.kernels.rinex_obs2 import read_body2

    return read_body2


def _to_gpst(label_ns: I8, system: str) -> I8:
    if system == "BDT":
        return label_ns + BDT_OFFSET_S * NS
    if system in ("GLO", "UTC"):
        return utc_to_gpst(label_ns)
    return label_ns


def _room(old: kernel.Output | None, epochs: int, rows: int) -> kernel.Output:
    """Outputs of this size, with the content of the old ones. Memory that is never written to costs nothing."""

    def grown(dtype: Any, size: int, before: NDArray[Any] | None) -> NDArray[Any]:
        new = np.empty(size, dtype=dtype)
        if before is not None:
            new[: len(before)] = before
        return new

    o: Any = old or [None] * 9
    values = np.empty((4, rows))
    if old is not None:
        values[:, : old.values.shape[1]] = old.values
    offsets = grown(np.int64, epochs + 1, o[4])
    offsets[0] = 0
    return kernel.Output(
        t=grown(np.int64, epochs, o[0]),
        flag=grown(np.uint8, epochs, o[1]),
        clock=grown(np.float64, epochs, o[2]),
        at=grown(np.int64, epochs, o[3]),
        offsets=offsets,
        sv=grown(np.int16, rows, o[5]),
        sig=grown(np.int16, rows, o[6]),
        values=values,
        lli=grown(np.uint8, rows, o[8]),
    )
