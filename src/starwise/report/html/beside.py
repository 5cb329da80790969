"""What a paper printed beside what came out here, number by number."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from starwise.report.html.words import number

Result = Mapping[str, Any]


@dataclass(frozen=True)
class Pair:
    """A number of the paper and ours; ``left``, ``width`` ...: places on the group's axis, %."""

    label: str
    ours: str
    paper: str
    ratio: str
    at_ours: float
    at_paper: float

    @property
    def left(self) -> float:
        """Where the line between the two begins, %."""
        return min(self.at_ours, self.at_paper)

    @property
    def width(self) -> float:
        """Length of the line between the two, %."""
        return abs(self.at_ours - self.at_paper)


@dataclass(frozen=True)
class Group:
    """Pairs with a common axis from ``low`` to ``high``; ``zero``: its place on it, %."""

    title: str
    pairs: tuple[Pair, ...]
    low: str
    high: str
    zero: float


def beside(paper: str, result: Result) -> list[Group]:
    """Groups of pairs of a paper's result (``reproduce.json``); none for what is not known."""
    maker = {"s3ekf": _s3ekf, "adaptive_federated": _adaptive, "rdss_sins": _rdss, "stability": _stability}.get(paper)
    if maker is None:
        return []
    groups = ((title, [row for row in rows if None not in row]) for title, rows in maker(result))
    return [_group(title, rows) for title, rows in groups if rows]


Rows = list[tuple[str, Any, Any]]


def _group(title: str, rows: Rows) -> Group:
    values = [float(value) for row in rows for value in row[1:]]
    low, high = min(0.0, *values), max(0.0, *values)
    span = (high - low) * 1.04 or 1.0

    def at(value: float) -> float:
        return round(100.0 * (value - low) / span, 2)

    pairs = tuple(
        Pair(label, number(ours), number(paper), _ratio(ours, paper), at(ours), at(paper))
        for label, ours, paper in rows
    )
    return Group(title, pairs, number(low, 2), number(low + span, 2), at(0.0))


def _ratio(ours: float, paper: float) -> str:
    return f"{ours / paper:.2f}" if paper and ours / paper > 0.0 else ""


def _s3ekf(result: Result) -> list[tuple[str, Rows]]:
    names = {"lsq": "least squares", "s3ekf": "S3EKF"}
    rows = [row for row in result.get("table1", ()) if row["method"] in names]
    out = [
        (title, [(f"scenario {r['scenario']}, {names[r['method']]}", r.get(key), r.get(f"paper_{key}")) for r in rows])
        for key, title in (
            ("horizontal_2rms_m", "Horizontal 2RMS, m"),
            ("vertical_2rms_m", "Vertical 2RMS, m"),
            ("velocity_2rms_mps", "Velocity 2RMS, m/s"),
        )
    ]
    gains = [
        (f"rates of {r['rate_noise_mps']:g} m/s", 100 * r["gain"], 100 * r["paper_gain"])
        for r in result.get("velocity_gain", ())
    ]
    rule = {r["n"]: r["paper_rule"] for r in result.get("operation_gain", ()) if r["states"] == 13}
    saved = [
        (f"{r['n']} satellites", 100 * rule[r["n"]], 100 * r["gain"])
        for r in result.get("paper", {}).get("operation_gain", ())
        if r["n"] in rule
    ]
    return [*out, ("Velocity gain over least squares, %", gains), ("Operations saved, by the paper's rule, %", saved)]


def _adaptive(result: Result) -> list[tuple[str, Rows]]:
    own = {(r["filter"], r["axis"]): r for r in result.get("table1", ())}
    same = {
        "least_squares": ("least_squares", "least squares"),
        "kalman": ("kalman", "Kalman filter"),
        "adaptive": ("improved", "adaptive, ours improved"),
    }
    out = []
    for key, title in (("mean_abs_m", "Table 1: mean of the error, m"), ("var_abs_m2", "Table 1: its variance, m²")):
        rows: Rows = []
        for r in result.get("paper", {}).get("table1", ()):
            name, label = same.get(r["filter"], (r["filter"], r["filter"]))
            found = own.get((name, r["axis"]))
            if found is not None:
                rows.append((f"{label}, {r['axis']}", found.get(key), r.get(key)))
        out.append((title, rows))
    return out


def _rdss(result: Result) -> list[tuple[str, Rows]]:
    paper = result.get("paper", {})
    here = result.get("dynamic", {})
    rho = [
        (f"lag {k}", a, b) for k, (a, b) in enumerate(zip(here.get("rho", ()), paper.get("rho", ()), strict=False), 1)
    ]
    nis = [(name, result.get(name, {}).get("nis_per_dof"), paper.get("nis_per_dof")) for name in ("static", "dynamic")]
    return [("NIS per degree of freedom, last window", nis), ("Autocorrelation of the innovations, in motion", rho)]


def _stability(result: Result) -> list[tuple[str, Rows]]:
    rows = [
        (r["name"], r.get("covariance_50s"), None if r.get("paper") is None else abs(r["paper"]))
        for r in result.get("degree_table", ())
    ]
    return [("Degree of observability (paper: absolute; ours: 1 − sigma/sigma0 after 50 s)", rows)]
