"""A solution in a few numbers: what was used, what was refused and why, where the receiver was."""

from typing import Any

import numpy as np

from starwise.constants import (
    EPOCH_NO_SOLUTION,
    EPOCH_STATUS_NAMES,
    EPOCH_SUSPECT,
    ROW_COMBINED,
    ROW_NOT_SELECTED,
    ROW_STATUS_NAMES,
    ROW_USED,
    SYSTEMS,
)
from starwise.frames import enu_from_ecef, geodetic_from_ecef
from starwise.gnsstime import iso
from starwise.signals import signal_name, sv_name
from starwise.types import Solution


def summarise(solution: Solution) -> dict[str, Any]:
    """Summary of a solution, plain values ready for JSON; described in ``docs/formats.md``."""
    solved = solution.has_position & (solution.status != EPOCH_NO_SOLUTION)
    summary: dict[str, Any] = {
        "epochs": solution.n_epochs,
        "epochs_solved": int(solved.sum()),
        "epochs_by_status": {
            name: int(np.count_nonzero(solution.status == code)) for code, name in enumerate(EPOCH_STATUS_NAMES)
        },
        "first_epoch_gpst": iso(int(solution.t_ns[0])) if solution.n_epochs else None,
        "last_epoch_gpst": iso(int(solution.t_ns[-1])) if solution.n_epochs else None,
        "interval_s": float(np.median(np.diff(solution.t_ns))) / 1e9 if solution.n_epochs > 1 else None,
        **_position(solution, solved),
    }
    if "events" in solution.provenance:
        causes = [str(event["cause"]) for event in solution.provenance["events"]]
        summary["events"] = {cause: causes.count(cause) for cause in dict.fromkeys(causes)}
    if "status" in solution.ledger:
        summary.update(_rows(solution))
    return summary


def _position(solution: Solution, solved: np.typing.NDArray[np.bool_]) -> dict[str, Any]:
    trusted = solved & (solution.status != EPOCH_SUSPECT)
    used = trusted if trusted.any() else solved
    if not used.any():
        return {"mean_pos_e_m": None, "mean_llh": None, "scatter_enu_m": None, "sigma_3d_mean_m": None}
    pos_e = solution.pos_e[used]
    middle = pos_e.mean(axis=0)
    lat, lon, h = geodetic_from_ecef(middle)
    scatter = enu_from_ecef(pos_e, middle).std(axis=0)
    sigma = np.sqrt(np.trace(solution.cov_pos[used], axis1=1, axis2=2))
    speed = np.linalg.norm(solution.vel_e[used], axis=1)
    return {
        "mean_pos_e_m": [round(float(v), 4) for v in middle],
        "mean_llh": [round(float(np.degrees(lat)), 9), round(float(np.degrees(lon)), 9), round(float(h), 4)],
        "scatter_enu_m": [round(float(v), 4) for v in scatter],
        "sigma_3d_mean_m": _finite(sigma),
        "speed_mean_mps": _finite(speed),
        "satellites_used_mean": round(float(solution.n_used[used].mean()), 2),
    }


def _finite(values: np.typing.NDArray[np.float64]) -> float | None:
    finite = values[np.isfinite(values)]
    return round(float(finite.mean()), 4) if len(finite) else None


def _rows(solution: Solution) -> dict[str, Any]:
    ledger = solution.ledger
    status = ledger["status"]
    counts = np.bincount(status, minlength=len(ROW_STATUS_NAMES))
    sv = ledger["sv"].astype(np.int64)
    used = status == ROW_USED
    seen = np.flatnonzero(np.bincount(sv))
    seen_used = np.flatnonzero(np.bincount(sv[used])) if used.any() else seen[:0]
    used_system = sv[used] >> 8
    by_system = {
        SYSTEMS[i]: {
            "satellites": int(np.count_nonzero(seen >> 8 == i)),
            "satellites_used": int(np.count_nonzero(seen_used >> 8 == i)),
            "rows_used": int(np.count_nonzero(used_system == i)),
            "signals": _signals(solution, np.flatnonzero(used)[used_system == i]),
        }
        for i in range(len(SYSTEMS))
        if (seen >> 8 == i).any()
    }
    quiet = (ROW_USED, ROW_COMBINED, ROW_NOT_SELECTED)
    refused = {
        name: int(counts[code]) for code, name in enumerate(ROW_STATUS_NAMES) if counts[code] and code not in quiet
    }
    worst = {name: _worst(sv[status == ROW_STATUS_NAMES.index(name)]) for name in refused}
    return {
        "rows": len(status),
        "rows_used": int(counts[ROW_USED]),
        "rows_refused": dict(sorted(refused.items(), key=lambda item: -item[1])),
        "satellites_most_refused": worst,
        "systems": by_system,
    }


def _signals(solution: Solution, which: np.typing.NDArray[np.intp]) -> dict[str, int]:
    """Satellites' epochs by signal, or by pair of signals (``1W+2W``), most frequent first."""
    # the row of a second signal beside the first has no terms of its own
    terms = solution.ledger.get("geometric_m")
    if terms is not None:
        which = which[np.isfinite(terms[which])]
    first, second = solution.ledger["sig"][which].astype(np.int64), solution.ledger["sig2"][which].astype(np.int64)
    pairs, counts = np.unique(first << 16 | second, return_counts=True)
    order = np.argsort(-counts, kind="stable")
    out = {}
    for pair, count in zip(pairs[order].tolist(), counts[order].tolist(), strict=True):
        name = signal_name(pair >> 16)
        out[name + (f"+{signal_name(pair & 0xFFFF)}" if pair & 0xFFFF else "")] = count
    return out


def _worst(sv: np.typing.NDArray[np.int64]) -> list[str]:
    """The three satellites that occur most."""
    counts = np.bincount(sv)
    return [sv_name(int(i)) for i in np.argsort(-counts, kind="stable")[:3] if counts[i]]
