"""What is in a file: one screen for each kind."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from starwise.constants import MESSAGE_NAMES, SYSTEMS
from starwise.errors import StarwiseError
from starwise.frames import geodetic_from_ecef
from starwise.gnsstime import iso
from starwise.io.foreign import kind_of
from starwise.io.inputs import peek
from starwise.signals import signal_name, sv_name
from starwise.types import Observations, Problem, Solution

Described = dict[str, Any]


def describe(path: Path) -> Described:
    """Contents of a RINEX observation or navigation file, SP3, CLK, position file or result, as plain values.

    ``what`` is a line for people, ``kind`` the kind of file; the other keys depend on it (``docs/formats.md``).

    Raises
    ------
    StarwiseError
        The file cannot be read, or is of no kind that is known.
    """
    if path.is_dir():
        return _solution(path, "result of starwise")
    readers: dict[str, Callable[[Path, str], Described]] = {
        "rinex_obs": _observations,
        "rinex_nav": _navigation,
        "sp3": _sp3,
        "clk": _clk,
    }
    kind = peek(path)
    if kind.kind in readers:
        return {"kind": kind.kind, **readers[kind.kind](path, kind.version)}
    if kind.kind != "unknown":
        return {"kind": kind.kind, "what": f"{kind.kind} {kind.version} (known, not read)"}
    if path.suffix.lower() in (".pos", ".parquet", ".nmea") or kind_of(path) != "pos":
        return _solution(path, "solution")
    raise StarwiseError(
        "not a known kind of file", file=path, wanted="RINEX, SP3, CLK, .pos, NMEA, .stat or a result of starwise"
    )


def _observations(path: Path, version: str) -> Described:
    from starwise.io.rinex_obs import read_obs

    obs = read_obs(path)
    head = obs.header
    steps = np.diff(obs.t_ns)
    interval = float(np.median(steps)) / 1e9 if len(steps) else None
    gaps = int(np.count_nonzero(steps > 1.5 * np.median(steps))) if len(steps) else 0
    return {
        "what": f"RINEX {version} observations",
        "marker": head.marker,
        "receiver": head.receiver,
        "antenna": head.antenna,
        "antenna_height_east_north_m": list(head.antenna_hen),
        "approximate_position": _place(head.approx_pos_e),
        "time_system": head.time_system,
        **_span(obs.t_ns),
        "epochs": obs.n_epochs,
        "interval_s": interval,
        "gaps": gaps,
        "satellites": _by_system(obs.sv),
        "signals": _signals(obs),
        "problems": _problems(obs.problems),
    }


def _place(pos_e: tuple[float, float, float] | None) -> str | None:
    if pos_e is None or not any(pos_e):
        return None
    lat, lon, h = geodetic_from_ecef(pos_e)
    return f"{np.degrees(lat):.6f} {np.degrees(lon):.6f} deg, {h:.1f} m"


def _span(t_ns: NDArray[np.int64]) -> Described:
    return {"first_gpst": iso(int(t_ns.min())), "last_gpst": iso(int(t_ns.max()))} if len(t_ns) else {}


def _by_system(sv: NDArray[np.int16]) -> dict[str, list[str]]:
    names: dict[str, list[str]] = {}
    for code in np.unique(sv).tolist():
        names.setdefault(SYSTEMS[code >> 8], []).append(sv_name(code)[1:])
    return names


def _signals(obs: Observations) -> dict[str, dict[str, list[int]]]:
    """Per system and signal, the number of rows with a pseudorange, a phase and a Doppler."""
    out: dict[str, dict[str, list[int]]] = {}
    system = obs.sv >> 8
    for code in np.unique(system).tolist():
        for sig in np.unique(obs.sig[system == code]).tolist():
            rows = (system == code) & (obs.sig == sig)
            values = (obs.code_m[rows], obs.phase_cyc[rows], obs.doppler_hz[rows])
            counts = [int(np.count_nonzero(np.isfinite(column))) for column in values]
            out.setdefault(SYSTEMS[code], {})[signal_name(sig)] = counts
    return out


def _problems(problems: tuple[Problem, ...]) -> list[dict[str, Any]]:
    return [{"line": p.line, "what": p.what, "count": p.count} for p in problems]


def _navigation(path: Path, version: str) -> Described:
    from starwise.io.rinex_nav import read_nav

    nav = read_nav(path)
    records: dict[str, dict[str, int]] = {}
    system = nav.sv.astype(np.int64) >> 8
    for code in np.unique(system).tolist():
        counts = np.bincount(nav.message[system == code], minlength=len(MESSAGE_NAMES))
        records[SYSTEMS[code]] = {MESSAGE_NAMES[i]: int(n) for i, n in enumerate(counts) if n}
    unhealthy = np.unique(nav.sv[nav.health != 0])
    return {
        "what": f"RINEX {version} navigation",
        **_span(nav.toe_ns),
        "records": records,
        "satellites": _by_system(nav.sv),
        "unhealthy_at_some_time": [sv_name(int(sv)) for sv in unhealthy],
        "ionosphere": {f"Klobuchar {name}": values.tolist() for name, values in nav.ionosphere.klobuchar.items()},
        "leap_seconds": nav.leap_s,
        "counts": dict(nav.counts),
        "problems": _problems(nav.problems),
    }


def _sp3(path: Path, version: str) -> Described:
    from starwise.io.sp3 import read_sp3

    orbits = read_sp3(path)
    steps = np.diff(orbits.t_ns)
    return {
        "what": f"SP3-{version} orbits of {orbits.agency.strip() or 'an unnamed centre'}",
        "frame": orbits.frame,
        "time_system": orbits.time_system,
        **_span(orbits.t_ns),
        "epochs": len(orbits.t_ns),
        "interval_s": float(np.median(steps)) / 1e9 if len(steps) else None,
        "satellites": _by_system(orbits.sv),
        "positions_missing": int(np.count_nonzero(np.isnan(orbits.pos_e).any(axis=2))),
        "clocks_missing": int(np.count_nonzero(np.isnan(orbits.clock_s))),
        "predicted": int(np.count_nonzero(orbits.predicted)),
        "problems": _problems(orbits.problems),
    }


def _clk(path: Path, version: str) -> Described:
    from starwise.io.clk import read_clk

    clocks = read_clk(path)
    inside = np.diff(clocks.t_ns)
    return {
        "what": f"RINEX {version} clocks",
        **_span(clocks.t_ns),
        "interval_s": float(np.median(inside[inside > 0])) / 1e9 if (inside > 0).any() else None,
        "satellites": _by_system(clocks.sv),
        "samples": len(clocks.t_ns),
        "problems": _problems(clocks.problems),
    }


def _solution(path: Path, what: str) -> Described:
    from starwise.io.results import read_solution
    from starwise.report.summary import summarise

    solution: Solution = read_solution(path)
    said = ("format", "coordinates", "time", "height", "covariance", "week", "checksums", "quality")
    form: Described = {key: solution.provenance[key] for key in said if key in solution.provenance}
    config = solution.provenance.get("config", {})
    return {"kind": "solution", "what": what, **form, "method": config.get("method"), **summarise(solution)}
