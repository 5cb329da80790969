"""Files of inertial readings: text tables, with everything about them declared in a description (`imu_config`)."""

import re
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from starwise.constants import NS, WEEK_S
from starwise.errors import StarwiseError
from starwise.gnsstime import iso, parse_time, utc_to_gpst
from starwise.io.files import read_bytes
from starwise.io.imu_check import check_imu
from starwise.io.imu_config import ImuFile, ImuTime, load_imu_config
from starwise.types import F8, I8, Inertial, Problem

GAP: Final = 1.5
"""Steps longer than so many periods are gaps."""
_SEPARATORS: Final = {"comma": ",", "semicolon": ";", "tab": "\t", "whitespace": None}
_UNIX_EPOCH_NS: Final = -315_964_800 * NS
_FEW: Final = 0.01  # part of the rows that may be damaged or run back before the file is refused


def read_imu(path: str | Path, config: ImuFile | str | Path) -> Inertial:
    """Inertial readings of a text file in body axes forward, right, down, SI, GPST.

    Rows that are cut, not numbers or NaN, and rows with the time of the row before, are left out and counted in
    ``problems``, as long as they are few; gaps are left as gaps: there ``dt_s`` is one period, shorter than the step of
    ``t_ns``. Nothing is bridged here.

    Parameters
    ----------
    path : path-like
        The file, compressed or not.
    config : ImuFile or path-like or str
        Its description, the TOML file with it, or the name of a layout in the package.

    Raises
    ------
    StarwiseError
        Not readable; more than 1 % of the rows damaged or running back in time; readings that contradict the
        description, with the likely mistake (unless it says ``check = false``).
    """
    described = config if isinstance(config, ImuFile) else load_imu_config(config)
    name = str(path)
    text = read_bytes(path).decode("utf-8-sig", errors="replace")
    if "\0" in text[:1000]:
        raise StarwiseError("not a text file", file=name, wanted="a table of inertial readings")
    lines = text.split("\n")
    at = _columns(lines, described, name)
    table, numbers, problems = _rows(lines, at, described, name)
    t_ns = _times(table, described.time, numbers, name)
    readings = np.column_stack([table[f"c{k}"] for k in range(len(at) - 6, len(at))])
    keep = np.isfinite(readings).all(axis=1)
    _note(problems, ~keep, numbers, name, "not numbers: left out")
    t_ns, readings, numbers = t_ns[keep], readings[keep], numbers[keep]
    t_ns, readings, numbers = _ordered(t_ns, readings, numbers, described, name, problems)
    inertial = _assembled(t_ns, readings, numbers, described, name, problems)
    if described.check:
        for finding in check_imu(inertial, described.rate_hz):
            if finding.severe:
                raise StarwiseError(
                    finding.text, file=name, found=finding.found, wanted=f"{finding.wanted} (or check = false)"
                )
            problems.append(Problem(name, int(numbers[0]), f"{finding.text}; found {finding.found}"))
    return Inertial(inertial.t_ns, inertial.dt_s, inertial.gyro, inertial.accel, inertial.increments, tuple(problems))


def _columns(lines: list[str], described: ImuFile, name: str) -> list[int]:
    """Indices from 0 of the columns that the description names."""
    separator = _SEPARATORS[described.delimiter]
    head: list[str] = []
    if described.header_lines:
        row = lines[described.header_lines - 1] if len(lines) >= described.header_lines else ""
        row = row.strip().removeprefix(described.comment or "")
        head = [cell.strip().strip('"') for cell in row.split(separator)]
    at = []
    for column in described.columns:
        if column.isdecimal():
            at.append(int(column) - 1)
        elif column in head:
            at.append(head.index(column))
        else:
            raise StarwiseError(
                f"no column '{column}'", file=name, line=described.header_lines, found=", ".join(head),
                wanted="the names that the description uses",
            )  # fmt: skip
    return at


def _rows(lines: list[str], at: list[int], described: ImuFile, name: str) -> tuple[NDArray[Any], I8, list[Problem]]:
    """Columns c0, c1 ... (structured), the line number of each row, and damaged rows as problems."""
    first, separator = described.header_lines, _SEPARATORS[described.delimiter]
    body = [line.rstrip("\r") for line in lines[first:]]
    numbers = np.arange(first + 1, first + 1 + len(body), dtype=np.int64)
    mark = described.comment
    filled = np.array([bool(s) and not s.isspace() and not (mark and s.lstrip().startswith(mark)) for s in body], bool)
    body, numbers = [line for line, there in zip(body, filled, strict=True) if there], numbers[filled]
    if not body:
        raise StarwiseError("no readings in the file", file=name)
    kind = _time_kind(described.time)
    types = [(f"c{i}", kind if i == 0 else "f8") for i in range(len(at))]
    try:
        # whole seconds or ns as integers first: 64 bits of a float do not hold ns since 1980
        table = np.loadtxt(body, dtype=types, delimiter=separator, comments=None, usecols=at, ndmin=1)
        return table, numbers, []
    except ValueError:
        pass
    good: list[tuple[Any, ...]] = []
    bad = np.zeros(len(body), dtype=bool)
    of_time: Callable[[str], Any] = str if kind.startswith("U") else int if kind == "i8" else float
    for i, line in enumerate(body):
        cells = line.split(separator)
        try:
            row = [of_time(cells[at[0]].strip()), *(float(cells[k].strip() or "nan") for k in at[1:])]
            if isinstance(row[0], float) and not np.isfinite(row[0]):
                raise ValueError
        except (ValueError, IndexError, OverflowError):
            bad[i] = True
        else:
            good.append(tuple(row))
    if bad.sum() > max(2, _FEW * len(body)) or not good:
        raise StarwiseError(
            "row not readable", file=name, line=int(numbers[bad][0]), found=body[int(np.flatnonzero(bad)[0])].strip(),
            wanted=f"at least {max(at) + 1} columns with numbers, {described.delimiter} between them",
        )  # fmt: skip
    problems: list[Problem] = []
    _note(problems, bad, numbers, name, "row not readable: left out")
    return np.array(good, dtype=types), numbers[~bad], problems


def _time_kind(time: ImuTime) -> str:
    if time.scale in ("gpst", "utc"):
        return "U40"
    return "i8" if time.unit == "ns" else "f8"


def _note(problems: list[Problem], where: NDArray[np.bool_], numbers: I8, name: str, what: str) -> None:
    """Count rows as one problem."""
    if where.any():
        problems.append(Problem(name, int(numbers[where][0]), what, int(where.sum())))


def _times(table: NDArray[Any], time: ImuTime, numbers: I8, name: str) -> I8:
    """GPST, ns, of every row."""
    tags = table["c0"]
    if time.scale in ("gpst", "utc"):
        t_ns = np.empty(len(tags), dtype=np.int64)
        for i, text in enumerate(tags):
            try:
                t_ns[i] = parse_time(_iso_text(text, utc=time.scale == "utc"))
            except StarwiseError:
                raise StarwiseError(
                    "not a date", file=name, line=int(numbers[i]), found=str(text), wanted="like 2024-03-30T12:00:00.01"
                ) from None
    else:
        if tags.dtype.kind == "f" and not np.isfinite(tags).all():
            line = int(numbers[np.flatnonzero(~np.isfinite(tags))[0]])
            raise StarwiseError("time is not a number", file=name, line=line)
        t_ns = _scaled(tags, table, time, numbers, name)
    if time.clock_rate != 1.0:
        t_ns = t_ns[0] + np.rint((t_ns - t_ns[0]) * time.clock_rate).astype(np.int64)
    t_ns = t_ns + round(time.offset_s * NS)
    if not ((t_ns >= 0) & (t_ns < 1 << 62)).all():
        line = int(numbers[np.flatnonzero((t_ns < 0) | (t_ns >= 1 << 62))[0]])
        raise StarwiseError("time out of range", file=name, line=line, wanted=f"{time.unit} of '{time.scale}'")
    return t_ns


def _iso_text(text: str, *, utc: bool) -> str:
    text = re.sub(r"^(\d{4})/(\d\d)/(\d\d)", r"\1-\2-\3", str(text).strip().strip('"'))
    return text.removesuffix("Z") + "Z" if utc else text


def _scaled(tags: NDArray[Any], table: NDArray[Any], time: ImuTime, numbers: I8, name: str) -> I8:
    """GPST, ns, of tags that are numbers."""
    limit = (1 << 62) / NS / time.unit_s
    if tags.dtype.kind == "f" and not (np.abs(tags) < limit).all():
        line = int(numbers[np.flatnonzero(~(np.abs(tags) < limit))[0]])
        raise StarwiseError("time out of range", file=name, line=line, wanted=f"{time.unit} of '{time.scale}'")
    if tags.dtype.kind == "i":
        ns = tags.astype(np.int64)
    else:
        # whole units apart from fractions: the product with 1e9 would lose the last digits
        whole = np.floor(tags)
        per = round(time.unit_s * NS)
        ns = whole.astype(np.int64) * per + np.rint((tags - whole) * per).astype(np.int64)
    if time.scale == "gps_seconds":
        return ns
    if time.scale == "unix":
        return utc_to_gpst(_UNIX_EPOCH_NS + ns)
    if time.scale == "seconds":
        assert time.origin is not None
        return parse_time(time.origin) + ns - (ns[0] if time.origin_at == "first" else 0)
    bad = (ns < 0) | (ns > WEEK_S * NS)
    if bad.any():
        line = int(numbers[np.flatnonzero(bad)[0]])
        raise StarwiseError(
            "not a time of week", file=name, line=line, found=f"{tags[bad][0]} {time.unit}", wanted="0 to 604800 s"
        )
    if time.week_column is not None:
        weeks = table["c1"]
        if not (np.isfinite(weeks) & (weeks >= 0) & (weeks < 10_000)).all():
            raise StarwiseError("not a GPS week", file=name, found=str(weeks[0]), wanted="0 to 9999")
        return weeks.astype(np.int64) * WEEK_S * NS + ns
    assert time.week is not None
    over = np.cumsum(np.diff(ns, prepend=ns[0]) < -WEEK_S * NS // 2)  # Saturday midnight
    return (time.week + over) * WEEK_S * NS + ns


def _ordered(
    t_ns: I8, readings: F8, numbers: I8, described: ImuFile, name: str, problems: list[Problem]
) -> tuple[I8, F8, I8]:
    """Rows with strictly increasing times; repeated and late ones left out and counted."""
    if not len(t_ns):
        raise StarwiseError("no reading is a number", file=name)
    newest = np.maximum.accumulate(t_ns)
    before = np.concatenate([[np.iinfo(np.int64).min], newest[:-1]])
    back, same = t_ns < before, t_ns == before
    if back.sum() > max(2, _FEW * len(t_ns)):
        i = int(np.flatnonzero(back)[0])
        raise StarwiseError(
            "time runs back", file=name, line=int(numbers[i]),
            found=f"{iso(int(t_ns[i]))} after {iso(int(before[i]))}", wanted="rows in order of time",
        )  # fmt: skip
    if same.sum() > max(2, 0.2 * len(t_ns)):
        i = int(np.flatnonzero(same)[0])
        raise StarwiseError(
            "times repeated in many rows", file=name, line=int(numbers[i]), found=f"{same.sum()} of {len(t_ns)} rows",
            wanted=f"tags finer than the rate of {described.rate_hz:g} Hz ('time.unit' right?)",
        )  # fmt: skip
    if described.readings == "increments" and same.any():
        # each row is motion of its own: what is repeated whole is one row, what differs was lost in the time tag
        differs = same & (np.abs(np.diff(readings, axis=0, prepend=readings[:1])).max(axis=1) > 0.0)
        if differs.any():
            i = int(np.flatnonzero(differs)[0])
            raise StarwiseError(
                "two increments with one time", file=name, line=int(numbers[i]), found=iso(int(t_ns[i]), 9),
                wanted="a time of its own for each: leaving one out would lose motion",
            )  # fmt: skip
    _note(problems, back, numbers, name, "time before that of an earlier row: left out")
    _note(problems, same, numbers, name, "time repeated: left out")
    keep = ~(back | same)
    return t_ns[keep], readings[keep], numbers[keep]


def _assembled(t_ns: I8, readings: F8, numbers: I8, described: ImuFile, name: str, problems: list[Problem]) -> Inertial:
    """The noun, with gaps noted."""
    period = NS / described.rate_hz
    if len(t_ns) < 2:
        raise StarwiseError("only one reading in the file", file=name)
    step = np.diff(t_ns)
    usual = float(np.median(step))
    if described.check and not 0.9 < usual / period < 1.1:
        raise StarwiseError(
            "rate is not as declared", file=name, found=f"{NS / usual:.4g} Hz",
            wanted=f"{described.rate_hz:g} Hz ('rate_hz', 'time.unit' or 'time.column' wrong?)",
        )  # fmt: skip
    gap = step > GAP * max(period, usual)
    if gap.any():
        i = int(np.flatnonzero(gap)[0])
        problems.append(
            Problem(
                name,
                int(numbers[i + 1]),
                f"gap of {step[i] / NS:.3f} s (longest {step[gap].max() / NS:.3f} s)",
                int(gap.sum()),
            )
        )
    if described.time.tags == "uniform":
        t_ns = _uniform(t_ns, np.flatnonzero(gap))
        step = np.diff(t_ns)
    dt_s = np.concatenate([[period], np.where(gap, np.minimum(usual, step), step)]) / NS
    C = described.C_bs()
    return Inertial(
        t_ns=t_ns,
        dt_s=dt_s,
        gyro=np.ascontiguousarray(described.gyro_si * readings[:, :3] @ C.T),
        accel=np.ascontiguousarray(described.accel_si * readings[:, 3:] @ C.T),
        increments=described.readings == "increments",
    )


def _uniform(t_ns: I8, gaps: NDArray[np.intp]) -> I8:
    """Tags of every stretch without a gap replaced by the line through them (least squares)."""
    out = t_ns.copy()
    bounds = [0, *(int(g) + 1 for g in gaps), len(t_ns)]
    for a, b in pairwise(bounds):
        if b - a > 2:
            k = np.arange(b - a) - 0.5 * (b - a - 1)
            t0 = int(t_ns[a])
            y = (t_ns[a:b] - t0).astype(np.float64)
            out[a:b] = t0 + np.rint(y.mean() + k * ((k * y).sum() / (k * k).sum())).astype(np.int64)
    if not (np.diff(out) > 0).all():  # lines of two stretches may cross in a short gap
        return t_ns
    return out
