"""What a page says in words: what went in, what came out, whether to trust it, what was not used and why."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any, Final

import numpy as np

from starwise.constants import EPOCH_COASTED, EPOCH_NO_SOLUTION, EPOCH_RESET, EPOCH_SUSPECT
from starwise.report.text import _WHY as WHY
from starwise.report.text import SYSTEM_NAMES
from starwise.types import Solution

REASONS: Final = {
    **WHY,
    "used": "used",
    "combined": "second signal of a used pair",
    "not_selected": "another signal preferred",
}
KINDS: Final = {
    "gated": "test", "excluded": "test", "low_elevation": "mask", "low_cn0": "mask", "unhealthy": "health",
    "inaccurate": "health", "no_ephemeris": "ephemeris", "ephemeris_too_old": "ephemeris",
    "bad_ephemeris": "ephemeris", "no_clock": "ephemeris", "used": "used",
}  # fmt: skip
"""Families of reasons, each with a colour of its own; what is not named is ``other``."""


@dataclass(frozen=True)
class Check:
    """A statement about trust: ``good``, ``caution``, ``bad`` or ``unknown``."""

    level: str
    what: str
    text: str


@dataclass(frozen=True)
class Readout:
    """A number with its name, for the head of a page."""

    name: str
    value: str
    unit: str
    note: str = ""
    level: str = ""


def number(value: float | None, digits: int = 3) -> str:
    """Number with about ``digits`` significant digits, no exponent where it can be avoided; a dash for none."""
    if value is None or not np.isfinite(value):
        return "–"
    size = abs(value)
    if size >= 10.0**6 or (0.0 < size < 1e-4):
        return f"{value:.{digits - 1}e}"
    decimals = max(0, digits - 1 - int(np.floor(np.log10(size)))) if size > 0.0 else 0
    text = f"{value:.{decimals}f}"
    return text.replace("-", "−")


def duration(seconds: float) -> str:
    """Length of time in words, like ``2 h 30 min``."""
    seconds = round(seconds)
    h, rest = divmod(seconds, 3600)
    m, s = divmod(rest, 60)
    parts = [f"{h} h" if h else "", f"{m} min" if m else "", f"{s} s" if s and not h else ""]
    return " ".join(part for part in parts if part) or "0 s"


def percent(part: float, whole: float) -> str:
    """Share in per cent; 100 only where it is all, 0 only where it is none."""
    if not whole:
        return "–"
    share = 100.0 * part / whole
    if part < whole and share > 99.9:
        return "> 99.9 %"
    if part > 0 and share < 0.1:
        return "< 0.1 %"
    return f"{share:.1f} %" if share not in (0.0, 100.0) else f"{share:.0f} %"


def name_of(provenance: Mapping[str, Any]) -> str:
    """What the solution is of: the marker, or the first input's file name."""
    marker = (provenance.get("station") or {}).get("marker")
    if marker:
        return str(marker)
    paths = [item.get("path") or item.get("file") for item in provenance.get("inputs", ())]
    names = [PurePath(str(path)).name for path in paths if path]
    if provenance.get("command") == "fuse":
        return " + ".join(names)
    return names[0] if names else "Solution"


def listing(words: list[str]) -> str:
    """Words with commas and an ``and``."""
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1] if words else ""


def method_of(provenance: Mapping[str, Any]) -> str:
    """Estimator in words."""
    config = provenance.get("config", {})
    method = str(config.get("method", ""))
    if "inertial" in config:
        return f"inertial navigation, {method} coupling" + (", smoothed" if config["inertial"].get("smooth") else "")
    if provenance.get("command") == "fuse":
        return f"fusion of position fixes ({method})"
    named = {
        "lsq": "least squares, epoch by epoch", "ekf": "extended Kalman filter",
        "s3ekf": "sequential Kalman filter (S3EKF)", "federated": "federated filter, one per constellation",
    }  # fmt: skip
    return named.get(method, method or "unknown")


def lead(solution: Solution, stats: Mapping[str, Any] | None) -> list[str]:
    """Sentences at the head of a page."""
    p = solution.provenance
    solved = solution.has_position & (solution.status != EPOCH_NO_SOLUTION)
    seconds = float(solution.t_ns[-1] - solution.t_ns[0]) / 1e9 if solution.n_epochs > 1 else 0.0
    systems = p.get("summary", {}).get("systems", {})
    used = [SYSTEM_NAMES.get(k, k) for k, item in systems.items() if item.get("satellites_used")]
    count = sum(item.get("satellites_used", 0) for item in systems.values())
    text = f"{_count(int(solved.sum()), solution.n_epochs)} epochs over {duration(seconds)} have a position"
    text += f", from {count} satellites of {listing(used)}" if used else ""
    out = [text + "."] + ([f"Estimator: {method_of(p)}."] if p.get("config") else [])
    dynamics = p.get("dynamics")
    if isinstance(dynamics, Mapping) and dynamics.get("used"):
        how = f"found: {dynamics.get('reason')}" if dynamics.get("detected") else "as given"
        out.append(f"The user's motion: {dynamics['used']} ({how}).")
    if stats is not None:
        claimed = stats.get("sigma_3d_mean_m")
        of = "3D" if stats.get("rms_3d_m") is not None else "2D"
        rms = stats.get("rms_3d_m") if of == "3D" else stats.get("rms_2d_m")
        text = f"Against the truth the error is {number(rms)} m ({of}, RMS)"
        out.append(text + (f"; the covariance claims {number(claimed)} m." if claimed is not None else "."))
    return out


def _count(part: int, whole: int) -> str:
    return f"All {whole}" if part == whole else f"{part} of {whole}"


def readouts(solution: Solution, stats: Mapping[str, Any] | None, nis: Mapping[str, Any] | None) -> list[Readout]:
    """Numbers at the head of a page."""
    solved = solution.has_position & (solution.status != EPOCH_NO_SOLUTION)
    s = solution.provenance.get("summary", {})
    out = [
        Readout("epochs with a position", f"{int(solved.sum())}", f"/ {solution.n_epochs}",
                percent(int(solved.sum()), solution.n_epochs))
    ]  # fmt: skip
    if stats is not None:
        of = "3d" if stats.get("rms_3d_m") is not None else "2d"
        note = f"95 %: {number(stats[f'p95_{of}_m'])} m"
        out.append(Readout(f"error, RMS {of.upper()}", number(stats[f"rms_{of}_m"]), "m", note))
    elif s.get("scatter_enu_m"):
        e, n, u = s["scatter_enu_m"]
        out.append(Readout("spread about the mean", number(float(np.sqrt(e * e + n * n + u * u))), "m",
                           "motion and errors together; no truth given"))  # fmt: skip
    with np.errstate(invalid="ignore"):
        sigma = np.sqrt(np.trace(solution.cov_pos[solved], axis1=1, axis2=2))
    if np.isfinite(sigma).any():
        out.append(Readout("claimed, 1σ 3D", number(float(np.nanmean(sigma))), "m",
                           f"at most {number(float(np.nanmax(sigma)))} m"))  # fmt: skip
    if stats is not None and stats.get("coverage_95") is not None:
        inside = stats["coverage_95"]
        out.append(Readout("truth inside the 95 % ellipsoid", f"{100 * inside:.0f}", "%", "95 % expected",
                           "good" if inside >= 0.9 else "bad" if inside < 0.75 else "caution"))  # fmt: skip
    if nis is not None:
        whole = nis["all"]
        level = "good" if 0.5 <= whole["mean"] <= whole["high"] else "caution"
        out.append(Readout("NIS per degree of freedom", number(whole["mean"]), "", "1 expected", level))
    if "rows_used" in s:
        out.append(Readout("satellites used per epoch", number(s.get("satellites_used_mean")), "",
                           f"{sum(i.get('satellites', 0) for i in s.get('systems', {}).values())} seen"))  # fmt: skip
    return out


def checks(
    solution: Solution,
    stats: Mapping[str, Any] | None,
    nis: Mapping[str, Any] | None,
    rho: Mapping[str, Any] | None,
    assessment: Mapping[str, Any] | None,
) -> list[Check]:
    """Whether the solution is to be trusted, as far as its own data and the truth, if given, can say."""
    out = [*_epochs(solution), *_against_truth(stats), *_innovations(solution, nis, rho)]
    for key, what in (("consistency", "Consistency"), ("observability", "Observability"), ("stability", "Stability")):
        part = (assessment or {}).get(key)
        if isinstance(part, Mapping) and part.get("verdict"):
            verdict = str(part["verdict"])
            level = _level(str(part.get("grade") or verdict), verdict)
            out.append(Check(level, what, verdict[:1].upper() + verdict[1:] + "."))
    wrong = sum(int(item.get("count", 0)) for item in solution.provenance.get("problems", ()))
    if wrong:
        out.append(Check("caution", "Inputs", f"{wrong} defects in the files were found and dealt with; listed below."))
    return out


def _level(grade: str, verdict: str) -> str:
    """Level of a finding: bad where it is unsafe, caution where it only is not as it should be."""
    first, text = grade.lower(), verdict.lower()
    if first == "unknown" or "not judged" in text:
        return "unknown"
    if any(word in text for word in ("too small", "unstable", "not observable", "diverg", "optimistic", "wrong")):
        return "bad"
    return "good" if first.startswith(("consistent", "observable", "stable", "asymptotically")) else "caution"


def _epochs(solution: Solution) -> list[Check]:
    n = solution.n_epochs
    count = {code: int(np.count_nonzero(solution.status == code))
             for code in (EPOCH_NO_SOLUTION, EPOCH_COASTED, EPOCH_SUSPECT, EPOCH_RESET)}  # fmt: skip
    named = {
        EPOCH_NO_SOLUTION: "without a position", EPOCH_COASTED: "coasted (predicted, nothing measured)",
        EPOCH_SUSPECT: "suspect by their own test", EPOCH_RESET: "started anew",
    }  # fmt: skip
    odd = [f"{count[code]} {text}" for code, text in named.items() if count[code]]
    if not odd:
        return [Check("good", "Epochs", f"None of {n} is flagged: all have a position that passed its own test.")]
    flagged = sum(count.values())
    level = "bad" if flagged > 0.2 * n else "caution"
    return [Check(level, "Epochs", f"Of {n} epochs {listing(odd)}. Flagged epochs are marked in every panel.")]


def _against_truth(stats: Mapping[str, Any] | None) -> list[Check]:
    if stats is None:
        return [Check("unknown", "Accuracy", "No truth was given: nothing here proves the errors. "
                      "starwise report DIR --truth X,Y,Z or FILE adds it.")]  # fmt: skip
    inside, nees = stats.get("coverage_95"), stats.get("nees_mean")
    if inside is None:
        return [Check("unknown", "Covariance", "The solution claims no covariance that could be compared.")]
    text = f"The 95 % ellipsoid holds the truth in {100 * inside:.1f} % of {stats['epochs_compared']} epochs"
    text += f"; NEES {number(nees)} of 3 expected." if nees is not None else "."
    if inside < 0.75:
        return [Check("bad", "Covariance", text + " It claims too much.")]
    if inside < 0.9:
        return [Check("caution", "Covariance", text + " It claims somewhat too much.")]
    wide = nees is not None and nees < 0.75
    text += " It is on the safe side: errors are smaller than it says." if wide else " It tells the errors."
    return [Check("good", "Covariance", text)]


def _innovations(solution: Solution, nis: Mapping[str, Any] | None, rho: Mapping[str, Any] | None) -> list[Check]:
    out = []
    lsq = solution.provenance.get("config", {}).get("method") == "lsq"
    what = "Residuals" if lsq else "Innovations"
    if nis is not None:
        mean, high = nis["all"]["mean"], nis["all"]["high"]
        text = (
            f"NIS is {number(mean)} per degree of freedom, {100 * nis['inside']:.0f} % of windows inside their bounds. "
        )
        uneven = nis["inside"] < 0.5
        if mean > max(high, 1.3):
            out.append(Check("bad", what, text + "They are larger than the covariance says: it is too small."))
        elif mean > high:
            out.append(Check("caution", what, text + "They are slightly larger than the covariance says."))
        elif mean < 0.5:
            out.append(Check("caution", what, text + "They are much smaller than the covariance says: it is cautious."))
        elif uneven:
            out.append(Check("caution", what, text + "As small as the covariance says on average, not at all times."))
        else:
            out.append(Check("good", what, text + "They are as small as the covariance says."))
    if rho is not None and not lsq:
        first = rho["rho"][0]
        white = abs(first) < max(0.1, rho["all"])
        text = f"Correlation from epoch to epoch is {number(first, 2)} (white: within {number(rho['all'], 2)}). "
        text += (
            "Nothing slow is left in them." if white else "Slow errors are left: the filter has not modelled them all."
        )
        out.append(Check("good" if white else "caution", "Whiteness", text))
    return out


def refusals(solution: Solution) -> list[dict[str, Any]]:
    """What was not used and why: reason, family, rows, share of the largest, satellites most affected."""
    s = solution.provenance.get("summary", {})
    rows = s.get("rows_refused", {})
    most = max(rows.values(), default=1)
    return [
        {
            "reason": REASONS.get(name, name),
            "kind": KINDS.get(name, "other"),
            "count": count,
            "share": count / most,
            "of_all": percent(count, s.get("rows", 0)),
            "satellites": s.get("satellites_most_refused", {}).get(name, []),
        }
        for name, count in rows.items()
    ]


def systems(solution: Solution) -> list[dict[str, Any]]:
    """What went in, per system: satellites seen and used, signals."""
    out = []
    for letter, item in solution.provenance.get("summary", {}).get("systems", {}).items():
        total = sum(item["signals"].values()) or 1
        often = [f"{name} {100 * n / total:.0f} %" for name, n in item["signals"].items() if 100 * n >= total]
        out.append({
            "letter": letter, "name": SYSTEM_NAMES.get(letter, letter), "seen": item["satellites"],
            "used": item["satellites_used"], "rows": item["rows_used"], "signals": ", ".join(often),
        })  # fmt: skip
    return out
