"""Report of one solution: ``report.html``."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from starwise.gnsstime import iso
from starwise.report.html import words
from starwise.report.html.accuracy import compared, errors_by_epoch, statistics, truth_payload
from starwise.report.html.epochs import epochs_payload, localised, shown_epochs
from starwise.report.html.nis import nis_payload
from starwise.report.html.page import rendered
from starwise.report.html.satellites import autocorrelation_payload, cells_of, satellites_payload
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
        "word": "residual" if lsq else "innovation",
        "reasons": words.REASONS,
        "kinds": words.KINDS,
    }
    if truth is not None and matched is not None and errors is not None:
        data["truth"] = truth_payload(solution, truth, matched, errors, local, shown)
    p = solution.provenance
    return rendered(
        "run.html",
        data,
        title=title or words.name_of(p),
        span=_span(solution),
        lead=words.lead(solution, stats),
        readouts=words.readouts(solution, stats, nis),
        checks=words.checks(solution, stats, nis, rho, assessment),
        refusals=words.refusals(solution),
        systems=words.systems(solution),
        notes=[str(note) for note in p.get("notes", ())],
        problems=_problems(p),
        events=list(p.get("events", ()))[:200],
        inputs=[_input(item) for item in p.get("inputs", ())],
        settings=settings(p),
        station=station(p),
        findings=findings(assessment),
        has=_sections(solution, data),
        word=data["word"],
        stats=stats,
    )


def _span(solution: Solution) -> str:
    if not solution.n_epochs:
        return "no epochs"
    first, last = iso(int(solution.t_ns[0]), 0), iso(int(solution.t_ns[-1]), 0)
    end = last[11:] if first[:10] == last[:10] else last.replace("T", " ")
    return f"{first.replace('T', ' ')} – {end} GPST"


def _sections(solution: Solution, data: Mapping[str, Any]) -> dict[str, bool]:
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


def _input(item: Mapping[str, Any]) -> dict[str, str]:
    size = item.get("bytes")
    return {
        "kind": str(item.get("kind", "input")),
        "path": str(item.get("path", item.get("file", ""))),
        "size": "" if size is None else f"{size / 1e6:.2f} MB",
        "sha256": str(item.get("sha256", "")),
    }


def settings(provenance: Mapping[str, Any]) -> list[tuple[str, list[tuple[str, str]]]]:
    """Configuration as given and as it came into effect: tables of (key, value)."""
    out = []
    for title, key in (("Configuration as given", "config"), ("In effect, from presets and tables", "effective"),
                       ("Motion, as found", "dynamics")):  # fmt: skip
        value = provenance.get(key)
        if isinstance(value, Mapping) and value:
            out.append((title, flattened(value)))
    return out


def flattened(value: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Nested tables as dotted keys with their values in words."""
    rows: list[tuple[str, str]] = []
    for key, item in value.items():
        if isinstance(item, Mapping) and item:
            rows += flattened(item, f"{prefix}{key}.")
        else:
            rows.append((f"{prefix}{key}", _worded(item)))
    return rows


def _worded(item: Any) -> str:
    if item is None:
        return "default"
    if isinstance(item, bool):
        return "yes" if item else "no"
    if isinstance(item, float):
        return f"{item:.9g}"
    if isinstance(item, list | tuple):
        return ", ".join(_worded(i) for i in item) or "none"
    return str(item)


def station(provenance: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What the observation file says of its station."""
    rows = flattened(provenance.get("station") or {})
    return [(key, value) for key, value in rows if value not in ("default", "", "none")]


def findings(assessment: Mapping[str, Any] | None) -> list[dict[str, Any]]:
    """Consistency, observability, stability and what-if of an assessment: verdict, words, table."""
    out = []
    for key in ("consistency", "observability", "stability", "what_if"):
        part = (assessment or {}).get(key)
        if not part:
            continue
        if not isinstance(part, Mapping):
            part = {"rows": part}
        rows = [
            (name, value) for name, value in part.items() if name not in ("verdict", "explain", "explanation", "text")
        ]
        out.append({
            "key": key,
            "title": key.replace("_", " ").capitalize(),
            "verdict": str(part.get("verdict", "")),
            "text": str(part.get("explain") or part.get("explanation") or part.get("text") or ""),
            "rows": _scalars(rows),
        })  # fmt: skip
    return out


def _scalars(rows: list[tuple[str, Any]]) -> list[tuple[str, str]]:
    """Numbers and words of a record; long series are left to the JSON file."""
    out = []
    for name, value in rows:
        if isinstance(value, Mapping):
            out += [(f"{name}.{key}", text) for key, text in _scalars(list(value.items()))]
        elif isinstance(value, list | tuple):
            if len(value) <= 12 and all(isinstance(item, str | int | float) for item in value):
                out.append((name, ", ".join(_short(item) for item in value)))
        elif value is not None:
            out.append((name, _short(value)))
    return out


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) and np.isfinite(value) else _worded(value)
