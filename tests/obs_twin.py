"""A slow, plain reader of RINEX observation text and a writer of it: what the tests compare the real reader with."""

import datetime as dt
from dataclasses import dataclass, field

GPS_EPOCH = dt.datetime(1980, 1, 6)

# RINEX 2 -> 3 for the codes that occur in the samples, written down by hand, per system
V2 = {
    "G": {"C1": "C1C", "P1": "C1W", "C2": "C2X", "P2": "C2W", "C5": "C5X"},
    "R": {"C1": "C1C", "P1": "C1P", "C2": "C2C", "P2": "C2P"},
    "E": {"C1": "C1X", "C5": "C5X", "C6": "C6X", "C7": "C7X", "C8": "C8X"},
    "S": {"C1": "C1C", "C5": "C5X"},
    "J": {"C1": "C1C", "C2": "C2X", "C5": "C5X", "C6": "C6X"},
}


@dataclass
class Twin:
    version: float
    codes: dict[str, list[str]] = field(default_factory=dict)
    epochs: list[tuple[int, int, dict[str, dict[str, tuple[float, str, str]]]]] = field(default_factory=list)
    """(label ns, flag, {satellite: {code as written: (value, lli, ssi)}}); blank and zero values are absent."""


def _ns(year: int, month: int, day: int, hour: int, minute: int, seconds: str) -> int:
    whole, fraction = seconds.strip().split(".")
    label = (dt.datetime(year, month, day) - GPS_EPOCH) // dt.timedelta(seconds=1)
    label += hour * 3600 + minute * 60 + int(whole)
    return label * 10**9 + int(fraction.ljust(9, "0")[:9])


def _fields(text: str, codes: list[str]) -> dict[str, tuple[float, str, str]]:
    found = {}
    for i, code in enumerate(codes):
        cell = text[16 * i : 16 * i + 16].ljust(16)
        if cell[:14].strip() and float(cell[:14]) != 0.0:
            found[code] = (float(cell[:14]), cell[14], cell[15])
    return found


def read(text: str) -> Twin:
    """Well-formed files only: any irregularity raises."""
    lines = text.replace("\r\n", "\n").split("\n")
    twin = Twin(float(lines[0][:9]))
    at, system = 0, ""
    while "END OF HEADER" not in lines[at]:
        line, label = lines[at], lines[at][60:].strip()
        if label == "# / TYPES OF OBSERV":
            twin.codes.setdefault("", []).extend(line[6:60].split())
        if label == "SYS / # / OBS TYPES":
            system = line[0] if line[0] != " " else system
            twin.codes.setdefault(system, []).extend(line[6:60].split())
        at += 1
    at += 1
    while at < len(lines):
        if not lines[at].strip():
            at += 1
        elif twin.version >= 3:
            at = _epoch3(lines, at, twin)
        else:
            at = _epoch2(lines, at, twin)
    return twin


def _epoch3(lines: list[str], at: int, twin: Twin) -> int:
    line = lines[at]
    assert line[0] == ">"
    flag, count = int(line[31]), int(line[32:35])
    if flag > 1:
        return at + 1 + count
    y, mo, d, h, mi = (int(v) for v in (line[2:6], line[7:9], line[10:12], line[13:15], line[16:18]))
    rows = {}
    for one in lines[at + 1 : at + 1 + count]:
        sv = one[:3].replace(" ", "0")
        rows[sv] = _fields(one[3:], twin.codes[sv[0]])
    twin.epochs.append((_ns(y, mo, d, h, mi, line[18:29]), flag, rows))
    return at + 1 + count


def _epoch2(lines: list[str], at: int, twin: Twin) -> int:
    line = lines[at]
    flag, count = int(line[28]), int(line[29:32])
    if flag > 1:
        return at + 1 + count
    y, mo, d, h, mi = (int(line[i : i + 2]) for i in (1, 4, 7, 10, 13))
    y += 1900 if y >= 80 else 2000
    label = _ns(y, mo, d, h, mi, line[15:26])
    names = ""
    for i in range((count + 11) // 12):
        names += lines[at + i][32:68].ljust(36)
    at += (count + 11) // 12
    per = (len(twin.codes[""]) + 4) // 5
    rows = {}
    for i in range(count):
        sv = names[3 * i : 3 * i + 3]
        sv = ("G" + sv[1:] if sv[0] == " " else sv).replace(" ", "0")
        text = "".join(one[:80].ljust(80) for one in lines[at : at + per])
        assert at + per <= len(lines)
        rows[sv] = _fields(text, twin.codes[""])
        at += per
    twin.epochs.append((label, flag, rows))
    return at


# -- writer -------------------------------------------------------------------------------------------------
Epoch = tuple[dt.datetime, int, dict[str, dict[str, float]]]


def head(text: str, label: str) -> str:
    return f"{text:<60}{label}"


def header3(codes: dict[str, list[str]], version: str = "3.04", extra: list[str] | None = None,
            time: str = "GPS") -> list[str]:  # fmt: skip
    lines = [head(f"{version:>9}{'':11}OBSERVATION DATA    M", "RINEX VERSION / TYPE")]
    for system, names in codes.items():
        for i in range(0, len(names), 13):
            left = f"{system}  {len(names):3d}" if i == 0 else " " * 6
            lines.append(head(left + "".join(f" {c}" for c in names[i : i + 13]), "SYS / # / OBS TYPES"))
    lines += extra or []
    first = f"  2024     1     1     0     0    0.0000000     {time}"
    return [*lines, head(first, "TIME OF FIRST OBS"), head("", "END OF HEADER")]


def header2(codes: list[str], system: str = "M", version: str = "2.11", time: str = "GPS") -> list[str]:
    lines = [head(f"{version:>9}{'':11}OBSERVATION DATA    {system}", "RINEX VERSION / TYPE")]
    for i in range(0, len(codes), 9):
        left = f"{len(codes):6d}" if i == 0 else " " * 6
        lines.append(head(left + "".join(f"    {c}" for c in codes[i : i + 9]), "# / TYPES OF OBSERV"))
    first = f"  2024     1     1     0     0    0.0000000     {time}"
    return [*lines, head(first, "TIME OF FIRST OBS"), head("", "END OF HEADER")]


def cell(value: float | None, tail: str = "  ") -> str:
    return " " * 16 if value is None else f"{value:14.3f}{tail}"


def epoch3(t: dt.datetime, rows: dict[str, list[float | None]], flag: int = 0, count: int | None = None) -> list[str]:
    n = len(rows) if count is None else count
    stamp = f"> {t:%Y %m %d %H %M} {t.second + t.microsecond / 1e6:10.7f}  {flag}{n:3d}"
    return [stamp, *(sv + "".join(cell(v) for v in values).rstrip() for sv, values in rows.items())]


def epoch2(t: dt.datetime, rows: dict[str, list[float | None]], flag: int = 0) -> list[str]:
    names = list(rows)
    stamp = f" {t:%y} {t.month:2d} {t.day:2d} {t.hour:2d} {t.minute:2d}{t.second + t.microsecond / 1e6:11.7f}"
    lines = [f"{stamp}  {flag}{len(names):3d}" + "".join(names[:12])]
    lines += [" " * 32 + "".join(names[i : i + 12]) for i in range(12, len(names), 12)]
    for values in rows.values():
        for i in range(0, len(values), 5):
            lines.append("".join(cell(v) for v in values[i : i + 5]).rstrip())
    return lines
