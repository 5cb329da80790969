"""KML and GPX texts of a track."""

from collections.abc import Sequence
from typing import Final
from xml.sax.saxutils import escape

import numpy as np

from starwise.constants import EPOCH_STATUS_NAMES
from starwise.io.maps import Track

POINTS: Final = 2000
"""Most epochs of a track that KML shows as points of their own; the line has all."""
_COLOURS: Final = {"ok": "ffb27200", "coasted": "ff009fe6", "suspect": "ff0055d5", "reset": "ffa779cc"}
"""Colours by status, alpha blue green red; of a palette that colour-blind readers can tell apart."""
_NAMESPACE: Final = "https://starwise.invalid/gpx/1"


def _text(value: str) -> str:
    """Text for XML 1.0: escaped, and without the control characters that it cannot hold."""
    return escape(
        "".join(
            ch if ch in "\t\n\r" or (ch >= " " and ch not in "\ufffe\uffff" and not "\ud800" <= ch <= "\udfff") else "?"
            for ch in value
        ),
        {'"': "&quot;"},
    )


# -- GPX ----------------------------------------------------------------------------------------------------


def gpx(tracks: Sequence[Track]) -> bytes:
    """GPX 1.1 (topografix.com/GPX/1/1) of tracks: a ``trk`` each, a ``trkseg`` per stretch, ``type`` the status.

    Sigmas east, north, up, m, stand in ``extensions``.
    """
    out = [
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        '<gpx version="1.1" creator="starwise" xmlns="http://www.topografix.com/GPX/1/1" '
        f'xmlns:s="{_NAMESPACE}">\n'
    ]
    for track in tracks:
        points = _trackpoints(track)
        out.append(f"<trk><name>{_text(track.name)}</name><desc>heights: {track.height}</desc>\n")
        for part in track.segments:
            out += ["<trkseg>\n", *points[part], "</trkseg>\n"]
        out.append("</trk>\n")
    out.append("</gpx>\n")
    return "".join(out).encode("utf-8")


def _trackpoints(track: Track) -> list[str]:
    geoid = "" if track.geoid_m is None else f"<geoidheight>{track.geoid_m:.3f}</geoidheight>"
    table = np.column_stack([track.lat_deg, track.lon_deg, track.height_m]).tolist()
    dops = _dops(track)
    sigmas = [
        f'<extensions><s:sigma e="{e:.4f}" n="{n:.4f}" u="{u:.4f}"/></extensions>' if e + n + u < 1e12 else ""
        for e, n, u in track.sigma_enu_m.tolist()
    ]
    told = track.n_used.any()
    rows = zip(table, track.utc(), track.status.tolist(), track.n_used.tolist(), dops, sigmas, strict=True)
    return [
        f'<trkpt lat="{lat:.9f}" lon="{lon:.9f}"><ele>{h:.4f}</ele><time>{at}</time>{geoid}'
        f"<type>{EPOCH_STATUS_NAMES[status]}</type>{f'<sat>{used}</sat>' if told else ''}{dop}{sigma}</trkpt>\n"
        for (lat, lon, h), at, status, used, dop, sigma in rows
    ]


def _dops(track: Track) -> list[str]:
    out = []
    for row in track.dop[:, [2, 3, 1]].tolist():
        named = zip(("hdop", "vdop", "pdop"), row, strict=True)
        out.append("".join(f"<{name}>{value:.2f}</{name}>" for name, value in named if 0.0 <= value < 1e6))
    return out


# -- KML ----------------------------------------------------------------------------------------------------


def kml(tracks: Sequence[Track]) -> bytes:
    """KML 2.2 (OGC 07-147r2) of tracks: each a ``gx:Track`` with its times, and points coloured by status.

    Where the height above sea level is not known, shapes are clamped to the ground. Of a track with more than `POINTS`
    epochs, so many evenly spaced ones are points; the line has all.
    """
    styles = "".join(
        f'<Style id="{name}"><IconStyle><color>{colour}</color><scale>0.4</scale><Icon><href>'
        "http://maps.google.com/mapfiles/kml/shapes/shaded_dot.png</href></Icon></IconStyle>"
        "<LabelStyle><scale>0</scale></LabelStyle></Style>\n"
        for name, colour in _COLOURS.items()
    )
    out = [
        '<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="http://www.opengis.net/kml/2.2" '
        'xmlns:gx="http://www.google.com/kml/ext/2.2">\n<Document>\n',
        f"<name>{_text(', '.join(track.name for track in tracks))}</name>\n",
        f'{styles}<Style id="line"><LineStyle><color>{_COLOURS["ok"]}</color><width>2</width></LineStyle>'
        "<IconStyle><scale>0.5</scale></IconStyle></Style>\n",
    ]
    for track in tracks:
        out += _folder(track)
    out.append("</Document>\n</kml>\n")
    return "".join(out).encode("utf-8")


def _folder(track: Track) -> list[str]:
    mode = "absolute" if track.height == "mean sea level" else "clampToGround"
    times = track.utc()
    table = np.column_stack([track.lon_deg, track.lat_deg, track.height_m]).tolist()
    out = [
        f"<Folder><name>{_text(track.name)}</name><description>heights: {track.height}</description>\n",
        f"<Placemark><name>{_text(track.name)}</name><styleUrl>#line</styleUrl><gx:MultiTrack>\n",
    ]
    for part in track.segments:
        out.append(f"<gx:Track><altitudeMode>{mode}</altitudeMode>\n")
        out += [f"<when>{at}</when>\n" for at in times[part]]
        out += [f"<gx:coord>{lon:.9f} {lat:.9f} {h:.4f}</gx:coord>\n" for lon, lat, h in table[part]]
        out.append("</gx:Track>\n")
    out.append("</gx:MultiTrack></Placemark>\n<Folder><name>epochs</name>\n")
    n = len(times)
    chosen = np.unique(np.linspace(0, n - 1, min(n, POINTS)).astype(np.int64)).tolist()
    sigmas, told = track.sigma_enu_m.tolist(), track.n_used.any()
    for i in chosen:
        status = EPOCH_STATUS_NAMES[int(track.status[i])]
        lon, lat, h = table[i]
        data = {"status": status}
        if told:
            data["satellites"] = str(int(track.n_used[i]))
        if np.isfinite(track.sigma_enu_m[i]).all():
            data |= {f"sigma_{axis}_m": f"{value:.4f}" for axis, value in zip("enu", sigmas[i], strict=True)}
        values = "".join(f'<Data name="{key}"><value>{value}</value></Data>' for key, value in data.items())
        out.append(
            f"<Placemark><name>{times[i]}</name><TimeStamp><when>{times[i]}</when></TimeStamp>"
            f"<styleUrl>#{status}</styleUrl><ExtendedData>{values}</ExtendedData><Point><altitudeMode>{mode}"
            f"</altitudeMode><coordinates>{lon:.9f},{lat:.9f},{h:.4f}</coordinates></Point></Placemark>\n"
        )
    out.append("</Folder></Folder>\n")
    return out
