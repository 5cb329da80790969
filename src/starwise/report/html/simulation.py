"""Page of a simulation: scenario, track, speeds, sky, faults."""

from collections.abc import Mapping, Sequence
from typing import Any

from starwise.report.html.epochs import epochs_payload, localised, shown_epochs
from starwise.report.html.page import rendered
from starwise.report.html.run import sections, span
from starwise.report.html.satellites import cells_of, satellites_payload
from starwise.report.html.tables import flattened
from starwise.report.html.words import KINDS, REASONS, Readout, duration, number
from starwise.types import Solution


def simulation_page(
    truth: Solution,
    scenario: Mapping[str, Any],
    record: Mapping[str, Any],
) -> bytes:
    """Report of a simulated scenario as one HTML file.

    Parameters
    ----------
    truth : Solution
        What really happened, as a solution without covariance; its ledger has a row per epoch and satellite in view
        with elevation, azimuth, and C/N0 of the first signal.
    scenario : mapping
        The scenario as it was run.
    record : mapping
        What ``run.json`` of the simulation holds.
    """
    local = localised(truth)
    shown = shown_epochs(truth, local)
    cells = cells_of(truth)
    data: dict[str, Any] = {
        "kind": "simulation",
        "epochs": epochs_payload(truth, local, shown),
        "sats": None if cells is None else satellites_payload(truth, cells),
        "truth": None,
        "nis": None,
        "rho": None,
        "word": "error",
        "reasons": {**REASONS, "used": "in view", "excluded": "with a fault"},
        "kinds": KINDS,
        "kind_names": {"used": "in view", "test": "with a fault"},
    }
    seconds = float(truth.t_ns[-1] - truth.t_ns[0]) / 1e9 if truth.n_epochs > 1 else 0.0
    speed = (truth.vel_e**2).sum(axis=1) ** 0.5
    low, high = record["satellites_min"], record["satellites_max"]
    readouts = [
        Readout("epochs", str(truth.n_epochs), "", duration(seconds)),
        Readout(
            "satellites in view", f"{low}–{high}" if low != high else str(low), "", f"{record['rows']} observations"
        ),
        Readout("greatest speed", number(float(speed.max())), "m/s", f"{number(float(speed.max()) * 3.6)} km/h"),
        Readout("seed", str(record["seed"]), "", "the same seed gives the same files"),
    ]
    return rendered(
        "simulation.html",
        data,
        title=str(record["scenario"]),
        span=span(truth),
        description=str(scenario.get("description", "")),
        readouts=readouts,
        faults=faults_of(scenario),
        files=list(record.get("files", {}).items()),
        montecarlo=list(record.get("montecarlo", ())),
        settings=[
            (name.capitalize(), flattened(part))
            for name, part in scenario.items()
            if isinstance(part, Mapping) and part and name not in ("vehicle",)
        ],
        segments=_segments(scenario.get("vehicle", {})),
        has=sections(truth, data),
    )


def faults_of(scenario: Mapping[str, Any]) -> list[str]:
    """Faults of a scenario in words."""
    faults = scenario.get("faults") or []
    items = faults if isinstance(faults, Sequence) and not isinstance(faults, str) else [faults]
    return [_fault(fault) for fault in items if isinstance(fault, Mapping)]


def _fault(fault: Mapping[str, Any]) -> str:
    sensor = fault.get("sensor", "gnss")
    if sensor == "gnss":
        who = ", ".join(fault.get("satellites") or ()) or "all satellites"
        who += "".join(f" {signal}" for signal in fault.get("signals") or ())
    else:
        who = f"{sensor} {', '.join(fault.get('axes') or ())}"
    kind = str(fault.get("kind", "fault")).replace("_", " ")
    what = "" if kind in ("outage", "spoof", "clock jump", "cycle slip") else f" of the {fault.get('observable', '')}"
    size = fault.get("size")
    unit = {"ramp": "m/s", "spoof": "m/s", "cycle slip": "cycles"}.get(kind, "m") if sensor == "gnss" else ""
    if fault.get("observable") == "rate" and sensor == "gnss":
        unit += "/s"
    much = f" of {size:g} {unit}".rstrip() if isinstance(size, int | float) and size else ""
    start, length = float(fault.get("start_s") or 0.0), fault.get("duration_s")
    when = f"from {start:g} s to the end" if length is None else f"from {start:g} to {start + float(length):g} s"
    return f"{kind[:1].upper()}{kind[1:]}{much}{what if sensor == 'gnss' else ''}, {when}: {who}"


def _segments(vehicle: Mapping[str, Any]) -> list[str]:
    out = []
    for part in vehicle.get("segments", ()):
        rows = [(k, v) for k, v in flattened(part) if k != "kind" and v not in ("default", "no", "0")]
        out.append(f"{part.get('kind', '')}: " + ", ".join(f"{key} {value}" for key, value in rows))
    return out
