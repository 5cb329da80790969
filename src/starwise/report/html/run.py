"""Report of one solution: ``report.html``."""

from collections.abc import Mapping
from typing import Any

from starwise.gnsstime import iso
from starwise.report.html import words
from starwise.report.html.accuracy import compared, errors_by_epoch, statistics, truth_payload
from starwise.report.html.diagnosis import findings, lab_payload
from starwise.report.html.epochs import epochs_payload, localised, shown_epochs
from starwise.report.html.nis import nis_payload
from starwise.report.html.page import rendered
from starwise.report.html.satellites import autocorrelation_payload, cells_of, satellites_payload
from starwise.report.html.tables import input_row, settings, station
from starwise.types import Solution, Truth


def run_page(
    solution: Solution, truth: Truth | None = None, assessment: Mapping[str, Any] | None = None, *, title: str = ""
) -> bytes:
    """Report of a solution as one HTML file, UTF-8.

    Parameters
    ----------
    solution : Solution
        With its ledger, where it has one.
    truth : Truth, optional
        Of the antenna; adds errors, their distribution and the calibration curve.
    assessment : mapping, optional
        What ``assess.json`` holds: findings on consistency, observability and stability.
    title : str, optional
        In place of the marker or the name of the input.

    Raises
    ------
    StarwiseError
        Plotly's script is not installed.
    """
    matched = compared(solution, truth)
    stats = None if matched is None else statistics(solution, truth)
    local = localised(solution)
    errors = None if matched is None else errors_by_epoch(solution, matched)
    shown = shown_epochs(solution, local, errors)
    cells = cells_of(solution)
    nis = nis_payload(solution)
    rho = None if cells is None else autocorrelation_payload(solution, cells)
    lsq = solution.provenance.get("config", {}).get("method") == "lsq"
    data: dict[str, Any] = {
        "kind": "run",
        "epochs": epochs_payload(solution, local, shown),
        "sats": None if cells is None else satellites_payload(solution, cells),
        "truth": None,
        "nis": nis,
        "rho": rho,
        "counted": "fixes" if solution.provenance.get("command") == "fuse" else "satellites",
        "word": "residual" if lsq else "innovation",
        "reasons": words.REASONS,
        "kinds": words.KINDS,
        "lab": lab_payload(assessment),
    }
    if truth is not None and matched is not None and errors is not None:
        data["truth"] = truth_payload(solution, truth, matched, errors, local, shown)
    p = solution.provenance
    return rendered(
        "run.html",
        data,
        title=title or words.name_of(p),
        span=span(solution),
        lead=words.lead(solution, stats),
        readouts=words.readouts(solution, stats, nis),
        checks=words.checks(solution, stats, nis, rho, assessment),
        refusals=words.refusals(solution),
        systems=words.systems(solution),
        notes=[str(note) for note in p.get("notes", ())],
        problems=_problems(p),
        events=list(p.get("events", ()))[:200],
        inputs=[input_row(item) for item in p.get("inputs", ())],
        settings=settings(p),
        station=station(p),
        findings=findings(assessment),
        has=sections(solution, data),
        word=data["word"],
        stats=stats,
    )


def span(solution: Solution) -> str:
    """First and last epoch in words."""
    if not solution.n_epochs:
        return "no epochs"
    first, last = iso(int(solution.t_ns[0]), 0), iso(int(solution.t_ns[-1]), 0)
    end = last[11:] if first[:10] == last[:10] else last.replace("T", " ")
    return f"{first.replace('T', ' ')} – {end} GPST"


def sections(solution: Solution, data: Mapping[str, Any]) -> dict[str, bool]:
    """Which panels have something to draw."""
    epochs, sats = data["epochs"], data["sats"]
    extra = epochs["extra"]
    position = bool(solution.has_position.any())
    return {
        "track": position,
        "velocity": epochs["vel"] is not None,
        "sigma": epochs["sigma"] is not None,
        "truth": data["truth"] is not None,
        "calibration": data["truth"] is not None and data["truth"]["calibration"] is not None,
        "sats": sats is not None,
        "sky": sats is not None and "el" in sats and "az" in sats,
        "residuals": sats is not None and "vn" in sats and any(sats["table"].get("rms_n", ())),
        "nis": data["nis"] is not None,
        "rho": data["rho"] is not None,
        "dop": epochs["dop"] is not None,
        "count": bool((solution.n_used > 0).any()),
        "clocks": bool(epochs["clocks"]),
        "attitude": "yaw_deg" in extra,
        "extra": any(
            not name.startswith("sigma_") and name not in ("roll_deg", "pitch_deg", "yaw_deg") for name in extra
        ),
    }


def _problems(provenance: Mapping[str, Any]) -> list[dict[str, Any]]:
    return sorted(provenance.get("problems", ()), key=lambda item: -int(item.get("count", 0)))[:200]
