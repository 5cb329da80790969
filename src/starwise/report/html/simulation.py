"""Page of a simulation: scenario, track, speeds, sky, faults."""

from collections.abc import Mapping, Sequence
from typing import Any

from starwise.report.html.epochs import epochs_payload, localised, shown_epochs
from starwise.report.html.page import rendered
from starwise.report.html.run import _sections, _span, flattened
from starwise.report.html.satellites import cells_of, satellites_payload
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
        span=_span(truth),
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
        has=_sections(truth, data),
    )


def faults_of(scenario: Mapping[str, Any]) -> list[str]:
    """Faults of a scenario in words."""
    faults = scenario.get("faults") or []
    items = faults if isinstance(faults, Sequence) and not isinstance(faults, str) else [faults]
    out = []
    for fault in items:
        rows = flattened(fault) if isinstance(fault, Mapping) else [("fault", str(fault))]
        said = [f"{key} {value}" for key, value in rows if key != "kind" and value not in ("default", "none")]
        kind = next((value for key, value in rows if key == "kind"), "fault").replace("_", " ")
        out.append(f"{kind}: " + ", ".join(said))
    return out


def _segments(vehicle: Mapping[str, Any]) -> list[str]:
    out = []
    for part in vehicle.get("segments", ()):
        rows = [(k, v) for k, v in flattened(part) if k != "kind" and v not in ("default", "no", "0")]
        out.append(f"{part.get('kind', '')}: " + ", ".join(f"{key} {value}" for key, value in rows))
    return out
