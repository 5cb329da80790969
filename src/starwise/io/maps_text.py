"""GeoJSON, CSV and NMEA texts of a track."""

import json
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from starwise.constants import EPOCH_COASTED, EPOCH_STATUS_NAMES, EPOCH_SUSPECT
from starwise.gnsstime import decimals_of, gpst_to_utc, labels
from starwise.io.maps import Track
from starwise.types import Solution

F8 = NDArray[np.float64]

_KNOT_MPS: Final = 1852.0 / 3600.0


# -- GeoJSON ------------------------------------------------------------------------------------------------


def geojson(tracks: Sequence[Track]) -> bytes:
    """GeoJSON of tracks (RFC 7946): a line for every stretch of each, and a point with properties for every epoch."""
    features = [text for track in tracks for text in (*_lines(track), *_points(track))]
    head = {"heights": sorted({track.height for track in tracks}), "coordinates": "WGS 84 longitude, latitude, height"}
    body = ",\n".join(features)
    text = f'{{"type": "FeatureCollection",\n"starwise": {json.dumps(head)},\n"features": [\n{body}\n]}}\n'
    return text.encode("utf-8")


def _coordinates(track: Track) -> list[str]:
    table = np.column_stack([track.lon_deg, track.lat_deg, track.height_m]).tolist()
    return [f"[{lon:.9f}, {lat:.9f}, {h:.4f}]" for lon, lat, h in table]


def _lines(track: Track) -> list[str]:
    places, times = _coordinates(track), track.utc()
    name = json.dumps(track.name)
    out = []
    for part in track.segments:
        if part.stop - part.start > 1:
            out.append(
                f'{{"type": "Feature", "properties": {{"name": {name}, "first_utc": "{times[part.start]}", '
                f'"last_utc": "{times[part.stop - 1]}", "epochs": {part.stop - part.start}}}, "geometry": '
                f'{{"type": "LineString", "coordinates": [{", ".join(places[part])}]}}}}'
            )
    return out


def _points(track: Track) -> list[str]:
    gpst = labels(track.t_ns, decimals_of(track.t_ns))
    columns = {
        **{f"sigma_{a}_m": track.sigma_enu_m[:, i] for i, a in enumerate("enu")},
        **{f"v{a}_mps": track.vel_enu_mps[:, i] for i, a in enumerate("enu")},
        "pdop": track.dop[:, 1],
    }
    seen = {name: values for name, values in columns.items() if np.isfinite(values).any()}
    numbers = [
        ", ".join(f'"{key}": {_number(value)}' for key, value in zip(seen, row, strict=True))
        for row in np.column_stack([*seen.values(), np.zeros(len(track.t_ns))])[:, :-1].tolist()
    ]
    name, told = json.dumps(track.name), track.n_used.any()
    used = [f', "satellites": {n}' if told else "" for n in track.n_used.tolist()]
    rows = zip(track.status.tolist(), gpst, track.utc(), used, numbers, _coordinates(track), strict=True)
    return [
        f'{{"type": "Feature", "properties": {{"name": {name}, "gpst": "{at}", "utc": "{utc}", '
        f'"status": "{EPOCH_STATUS_NAMES[status]}"{satellites}{", " if values else ""}{values}}}, '
        f'"geometry": {{"type": "Point", "coordinates": {place}}}}}'
        for status, at, utc, satellites, values, place in rows
    ]


def _number(value: float) -> str:
    return f"{value:.4f}" if -1e12 < value < 1e12 else "null"


# -- CSV ----------------------------------------------------------------------------------------------------


def csv_table(solution: Solution) -> bytes:
    """Table of the solution with the columns of ``solution.parquet`` and a ``utc`` beside ``gpst``."""
    import polars as pl

    from starwise.io.results import solution_table

    table = solution_table(solution)
    utc_ns = gpst_to_utc(solution.t_ns)
    at = table.columns.index("gpst")
    table = table.with_columns(pl.Series("gpst", labels(solution.t_ns, decimals_of(solution.t_ns, 3))))
    table.insert_column(at + 1, pl.Series("utc", labels(utc_ns, decimals_of(utc_ns, 3), "{date}T{time}Z")))
    return table.write_csv().encode("utf-8")


# -- NMEA ---------------------------------------------------------------------------------------------------


def nmea(tracks: Sequence[Track]) -> bytes:
    """NMEA 0183 sentences GGA, RMC and, where there is a covariance, GST of every epoch; talker GN.

    A ZDA at the beginning has the date, without which some readers (RTKLIB) leave out the first GGA.
    Quality of GGA: 1 a position, 6 predicted only, 0 suspect (readers skip it; RMC says V). The age of corrections and
    RMS of residuals are empty. Without a geoid height the altitude is the ellipsoidal one and the separation is 0, so
    that their sum, which is what a reader should take, is right. With heights above a geoid of unknown height it is
    empty.
    """
    return "".join(_sentences(track) for track in tracks).encode("ascii")


def _sentences(track: Track) -> str:
    decimals = max(2, decimals_of(track.utc_ns))
    clock = [text.replace(":", "") for text in labels(track.utc_ns, decimals, "{time}")]
    dates = [f"{text[8:10]}{text[5:7]}{text[2:4]}" for text in labels(track.utc_ns, 0, "{date}")]
    lat, lon = _angles(track.lat_deg, "NS", 2), _angles(track.lon_deg, "EW", 3)
    quality = np.select([track.status == EPOCH_COASTED, track.status == EPOCH_SUSPECT], [6, 0], 1).tolist()
    separation = "" if track.height == "mean sea level" else "0.000"
    if track.geoid_m is not None:
        separation = f"{track.geoid_m:.3f}"
    hdop = [f"{v:.1f}" if 0.0 <= v < 99.95 else "" for v in track.dop[:, 2].tolist()]
    speed = np.hypot(track.vel_enu_mps[:, 0], track.vel_enu_mps[:, 1])
    course = np.degrees(np.arctan2(track.vel_enu_mps[:, 0], track.vel_enu_mps[:, 1])) % 360.0
    moving = np.isfinite(speed)
    pairs = zip((speed / _KNOT_MPS).tolist(), course.tolist(), moving.tolist(), strict=True)
    motion = [f"{v:.3f},{c:.2f}" if known else "," for v, c, known in pairs]
    told = track.n_used.any()
    heights = track.height_m.tolist()
    used = [f"{n:02d}" if told else "" for n in np.clip(track.n_used, 0, 99).tolist()]
    ellipse = _ellipses(track)
    day = labels(track.utc_ns[:1], 0, "{date}")[0]
    out = [f"GNZDA,{clock[0]},{day[8:10]},{day[5:7]},{day[:4]},00,00"]
    for i, at in enumerate(clock):
        place = f"{lat[i]},{lon[i]}"
        valid = "V" if quality[i] == 0 else "A"
        mode = {1: "A", 6: "E", 0: "N"}[quality[i]]
        out.append(f"GNGGA,{at},{place},{quality[i]},{used[i]},{hdop[i]},{heights[i]:.3f},M,{separation},M,,")
        out.append(f"GNRMC,{at},{valid},{place},{motion[i]},{dates[i]},,,{mode}")
        if ellipse[i]:
            out.append(f"GNGST,{at},,{ellipse[i]}")
    sums = np.bitwise_xor.reduceat(np.frombuffer("".join(out).encode("ascii"), np.uint8), _starts(out)).tolist()
    return "".join([f"${body}*{total:02X}\r\n" for body, total in zip(out, sums, strict=True)])


def _starts(texts: Sequence[str]) -> NDArray[np.int64]:
    """Where each text begins when they are joined; none is empty."""
    return np.cumsum([0, *(len(text) for text in texts[:-1])])


def _angles(degrees: F8, signs: str, digits: int) -> list[str]:
    """Angles as ``ddmm.mmmmmmm,N``: 1e-7 minutes are 0.2 mm."""
    units = np.rint(np.abs(degrees) * 60e7).astype(np.int64)
    whole, rest = np.divmod(units, 600_000_000)
    minutes, fraction = np.divmod(rest, 10_000_000)
    table = zip(whole.tolist(), minutes.tolist(), fraction.tolist(), (degrees < 0.0).tolist(), strict=True)
    return [f"{d:0{digits}d}{m:02d}.{f:07d},{signs[negative]}" for d, m, f, negative in table]


def _ellipses(track: Track) -> list[str]:
    """Fields of GST behind the RMS: semi-axes of the ellipse, its bearing from north, sigmas north, east, up."""
    e2, n2 = track.sigma_enu_m[:, 0] ** 2, track.sigma_enu_m[:, 1] ** 2
    mean, half = 0.5 * (n2 + e2), 0.5 * (n2 - e2)
    radius = np.hypot(half, track.cov_en_m2)
    major, minor = np.sqrt(mean + radius), np.sqrt(np.maximum(mean - radius, 0.0))
    bearing = np.degrees(0.5 * np.arctan2(track.cov_en_m2, half)) % 180.0
    table = np.column_stack([major, minor, bearing, track.sigma_enu_m[:, [1, 0, 2]]])
    known = np.isfinite(table).all(axis=1).tolist()
    return [
        ",".join([f"{value:.4f}" for value in row]) if ok else "" for row, ok in zip(table.tolist(), known, strict=True)
    ]
