"""Navigation files made by hand: a writer of a few lines, and a reader of a few lines that knows nothing of kernels."""

import datetime as dt
from pathlib import Path

EPOCH = dt.datetime(2024, 3, 30, 12, 0, 0)
SOW = 561_600.0  # seconds of the GPS week 2307 at EPOCH
GPS_WEEK, BDT_WEEK = 2307, 951


def e19(value: float | None) -> str:
    return " " * 19 if value is None else f"{value:19.12e}"


def header(version: str = "3.05", kind: str = "N: GNSS NAV DATA", extra: tuple[str, ...] = ()) -> str:
    first = f"{version:>9}{'':11}{kind:<20}{'M: MIXED':<20}RINEX VERSION / TYPE"
    return "\n".join([first, *extra, f"{'':60}END OF HEADER"]) + "\n"


def record(
    sv: str, clock: list[float], orbit: list[list[float | None]], epoch: dt.datetime = EPOCH, version: int = 3
) -> str:
    indent = "   " if version == 2 else "    "
    if version == 2:
        start = f"{int(sv[1:]):2d} {epoch:%y} {epoch.month:2d} {epoch.day:2d} {epoch.hour:2d} {epoch.minute:2d}"
        start += f"{epoch.second + epoch.microsecond / 1e6:5.1f}"
    else:
        start = f"{sv} {epoch:%Y %m %d %H %M %S}"
    lines = [start + "".join(e19(v) for v in clock)]
    lines += [indent + "".join(e19(v) for v in row) for row in orbit]
    return "\n".join(lines) + "\n"


def kepler(
    sqrt_a: float = 5153.7, sow: float = SOW, week: float | None = GPS_WEEK, t_tx: float | None = SOW - 7182.0
) -> list[list[float | None]]:
    """Orbit lines of a GPS LNAV record; replace single numbers for other messages."""
    return [
        [45.0, 12.5, 4.5e-9, 1.25],
        [1.5e-6, 0.0125, -2.5e-6, sqrt_a],
        [sow, 3.5e-8, -2.25, -4.5e-8],
        [0.96, 220.5, -1.75, -8.1e-9],
        [1.1e-10, 1.0, week, 0.0],
        [2.8, 0.0, -9.3e-9, 45.0],
        [t_tx, 4.0],
    ]


GPS_CLOCK = [-1.5e-4, 2.5e-12, 0.0]
GLONASS_CLOCK = [3.5e-5, -9.1e-13, 561_630.0 % 86_400]


def glonass(fourth: bool = False) -> list[list[float | None]]:
    rows: list[list[float | None]] = [
        [12_000.5, -1.25, 1.8e-9, 0.0],
        [-18_000.25, 0.5, -9.3e-10, -4.0],
        [13_500.75, 2.75, 0.0, 1.0],
    ]
    return [*rows, [179.0, 2.8e-9, 2.0, 3.0]] if fourth else rows


def write(tmp_path: Path, text: str, name: str = "made.rnx") -> Path:
    path = tmp_path / name
    path.write_bytes(text.encode("latin-1"))
    return path


def twin(text: str) -> list[tuple[str, dt.datetime, list[float | None]]]:
    """Records of a RINEX 3 file as (satellite, epoch label, numbers in file order)."""
    lines = text.split("END OF HEADER", 1)[1].splitlines()[1:]
    records: list[tuple[str, dt.datetime, list[float | None]]] = []
    for line in lines:
        if line[:1].isalpha():
            y, mo, d, h, mi, s = (int(line[a:b]) for a, b in ((4, 8), (9, 11), (12, 14), (15, 17), (18, 20), (21, 23)))
            records.append((line[:3].replace(" ", "0"), dt.datetime(y, mo, d, h, mi, s), []))
            fields = [line[23 + 19 * k : 42 + 19 * k] for k in range(3)]
        else:
            fields = [line[4 + 19 * k : 23 + 19 * k] for k in range(4)]
        for text_field in fields:
            number = text_field.strip().lower().replace("d", "e")
            records[-1][2].append(float(number) if number else None)
    return records
