"""Report of the reproduced adaptive federated paper: Markdown, and SVG figures where matplotlib is installed."""

from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

Errors = dict[str, list[float]]
Result = dict[str, Any]
_NAMES = {
    "least_squares": "least-squares combination",
    "kalman": "Kalman filter, as in the paper",
    "kalman_discretised": "Kalman filter, Q exact, eps apart",
    "literal": "adaptive, literal",
    "improved": "adaptive, improved",
    "adaptive": "adaptive filter",
}
_TWO = ("longitude", "latitude")
_COLOURS = {"least_squares": "0.75", "kalman": "C1", "literal": "C3", "improved": "C0"}


def write_report(result: Result, errors: Errors, base: Path) -> None:
    """Write ``report.md`` and, where matplotlib is installed, the figures as SVG.

    Raises
    ------
    StarwiseError
        A file cannot be written.
    """
    from starwise.studies.s3ekf import write_text

    drawn = draw(errors, base) if find_spec("matplotlib") else []
    write_text(report_text(result, drawn), base / "report.md")


def report_text(result: Result, figures: Sequence[str] = ()) -> str:
    """The report, Markdown."""
    s = result["settings"]
    lines = [
        "# Adaptive federated filter reproduced",
        "",
        f"starwise {s['version']}, {s['runs']} runs, seed {s['seed']}. One flight of 1000 s: {s['steady_epochs']} "
        f"steady epochs, {s['maneuver_epochs']} in and 10 s after manoeuvres. Receivers: white errors of "
        f"{', '.join(f'{v:g}' for v in s['sigma_m'])} m per axis.",
        "",
        "## Table 1: steady |error|",
        "",
        *_table1(result["table1"]),
        "",
        "The paper's:",
        "",
        *_table(
            ("filter", "axis", "mean, m", "variance, m^2"),
            [(_NAMES[r["filter"]], r["axis"], r["mean_abs_m"], r["var_abs_m2"]) for r in result["paper"]["table1"]],
        ),
        "",
        "## What the improved filter reaches",
        "",
        *_table(
            ("", "value", "wanted", "met"),
            [(c["what"], f"{c['value']:.3f}", _limits(c), "yes" if c["met"] else "no") for c in result["checks"]],
        ),
        "",
        "## Receivers out of simulated constellations",
        "",
        "Fixes by least squares from simulated GPS, GLONASS and Galileo; errors of a receiver are correlated between "
        "axes and larger in height.",
        "",
        *_table1(result["constellations"]["table1"]),
        "",
        "## Noise of another size than the filter is told",
        "",
        *_table(
            ("true / nominal", "steady / least squares", "manoeuvre RMS / least squares", "NEES steady", "diverged"),
            [
                (
                    f"{r['scale']:g}",
                    _pair(r["steady_over_least_squares"]),
                    _pair(r["maneuver_rms_over_least_squares"]),
                    _pair(r["nees_steady"], 2),
                    r["diverged"],
                )
                for r in result["scales"]
            ],
        ),
        "",
        "## Errors correlated in time",
        "",
        "The correlation is estimated from the receivers' differences, and variances grow by (1 + rho) / (1 - rho); "
        "beside it the filter that takes errors as white. With a correlation of seconds no filter can have 0.25: an "
        "error that lasts does not average.",
        "",
        *_table(
            ("tau, s", "errors", "steady / least squares", "manoeuvre RMS / least squares", "NEES steady", "manoeuvre"),
            [
                (
                    f"{r['tau_s']:g}",
                    "estimated" if r["variant"] == "improved" else "as white",
                    _pair(r["steady_over_least_squares"]),
                    _pair(r["maneuver_rms_over_least_squares"]),
                    _pair(r["nees_steady"], 2),
                    _pair(r["nees_maneuver"], 2),
                )
                for r in result["taus"]
            ],
        ),
        "",
        "## Weak points of the equations, one thing changed at a time",
        "",
        *_table(
            ("", "changed", "steady / least squares", "manoeuvre RMS / l. s.", "first 30 s, RMS, m", "median fading"),
            [
                (
                    r["name"],
                    r["change"],
                    f"{r['steady_longitude']:.2f}, {r['steady_latitude']:.2f}",
                    f"{r['maneuver_rms_longitude']:.2f}, {r['maneuver_rms_latitude']:.2f}",
                    f"{r['start_rms_m']:.1f}",
                    f"{r['fading_median']:.0f}",
                )
                for r in result["experiments"]
            ],
        ),
        "",
        "## Adaptation rules in filters that believe the wrong thing",
        "",
        "RMS over least squares, steady and in manoeuvres; NEES per axis, steady and in manoeuvres.",
        "",
        *_rules(result["rules"]),
        "",
        "## Fault isolation, one local filter per constellation",
        "",
        *_faults(result["faults"]),
        "",
        *[f"![{name}]({name})" for name in figures],
    ]  # fmt: skip
    return "\n".join(lines).rstrip() + "\n"


def short_text(result: Result) -> str:
    """The main results for a terminal, 80 columns."""
    lines = [f"{result['settings']['runs']} runs; steady |error|, longitude and latitude", ""]
    lines.append(f"{'':<34} {'mean, m':>15} {'variance, m^2':>15} {'man. max':>11}")
    rows = {(r["filter"], r["axis"]): r for r in result["table1"]}
    for name in dict.fromkeys(f for f, _ in rows):
        a, b = (rows[name, axis] for axis in _TWO)
        lines.append(
            f"{_NAMES[name]:<34} {a['mean_abs_m']:7.3f} {b['mean_abs_m']:7.3f} {a['var_abs_m2']:7.3f} "
            f"{b['var_abs_m2']:7.3f} {a['maneuver_max_m']:5.1f} {b['maneuver_max_m']:5.1f}"
        )
    lines.append("")
    lines += [f"{c['what']:<58} {c['value']:6.3f}  {'' if c['met'] else 'NOT '}{_limits(c)}" for c in result["checks"]]
    return "\n".join(lines)


def _limits(check: Result) -> str:
    return f"<= {check['most']:g}" if check["least"] is None else f"{check['least']:g} to {check['most']:g}"


def _pair(values: Result, digits: int = 3) -> str:
    return ", ".join(f"{values[axis]:.{digits}f}" for axis in _TWO)


def _table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> list[str]:
    lines = [head, ["---"] * len(head), *rows]
    return ["| " + " | ".join(str(cell).replace("|", "\\|") for cell in line) + " |" for line in lines]


def _table1(rows: Sequence[Result]) -> list[str]:
    def cell(value: float | None, digits: int) -> str:
        return "" if value is None else f"{value:.{digits}f}"

    head = ("filter", "axis", "mean, m", "variance, m^2", "RMS, m", "mean error, m", "manoeuvre RMS, m",
            "manoeuvre max, m", "95 %", "NEES steady", "manoeuvre")  # fmt: skip
    body = [
        (
            _NAMES[r["filter"]], r["axis"], cell(r["mean_abs_m"], 3), cell(r["var_abs_m2"], 3), cell(r["rms_m"], 3),
            cell(r["mean_m"], 3), cell(r["maneuver_rms_m"], 2), cell(r["maneuver_max_m"], 1),
            cell(r["maneuver_max_95_m"], 1), cell(r["nees_steady"], 2), cell(r["nees_maneuver"], 2),
        )
        for r in rows
    ]  # fmt: skip
    return _table(head, body)


def _rules(rows: Sequence[Result]) -> list[str]:
    cases = list(dict.fromkeys(r["case"] for r in rows))
    cells = {(r["rule"], r["case"]): r for r in rows}
    body = []
    for rule in dict.fromkeys(r["rule"] for r in rows):
        mine = [cells[rule, case] for case in cases]
        body.append(
            (
                rule,
                *(
                    f"{c['steady']:.2f}, {c['maneuver']:.3g}; {c['nees_steady']:.2g}, {c['nees_maneuver']:.2g}"
                    for c in mine
                ),
            )
        )
    return _table(("rule", *cases), body)


def _faults(faults: Result) -> list[str]:
    def seconds(row: Result) -> str:
        return "" if row["delay_median_s"] is None else f"{row['delay_median_s']:.0f} ({row['delay_max_s']:.0f})"

    lines = _table(
        ("50 m/min on", "of", "clocks watched", "named", "another named", "delay median (max), s",
         "peak median (max), m", "centralised without detection, m", "ratio"),
        [
            (
                r["ramp"], r["faulty"], "yes" if r["clocks_watched"] else "no", f"{r['named']} of {r['runs']}",
                r["wrong"], seconds(r), f"{r['peak_median_m']:.1f} ({r['peak_max_m']:.1f})",
                f"{r['central_peak_median_m']:.1f}", f"{r['peak_over_central']:.2f}",
            )
            for r in faults["ramps"]
        ],
    )  # fmt: skip
    lines += ["", "A constellation's clock that jumps by a microsecond:", ""]
    lines += _table(
        ("of", "absorbed and named", "anything else", "peak 3D in the minute before, m", "after, m"),
        [
            (
                r["faulty"],
                f"{r['named']} of {r['runs']}",
                r["wrong"],
                f"{r['peak_before_median_m']:.1f}",
                f"{r['peak_after_median_m']:.1f}",
            )
            for r in faults["jumps"]
        ],
    )
    for r in faults["fault_free"]:
        lines += [
            "",
            f"Without a fault, clocks {'' if r['clocks_watched'] else 'not '}watched: {r['false_alarms']} false alarms "
            f"in {r['runs']} runs of {r['epochs']} epochs; 3D RMS {r['rms_m']:.2f} m, centralised "
            f"{r['central_rms_m']:.2f} m; NEES per axis {r['nees_per_axis']:.2f}.",
        ]  # fmt: skip
    return lines


def draw(errors: Errors, base: Path) -> list[str]:
    """Figures 2 to 5 as SVG; their names."""
    import matplotlib

    matplotlib.use("Agg")
    matplotlib.rcParams["svg.hashsalt"] = "starwise"
    from matplotlib import pyplot as plt

    drawn: list[str] = []

    def figure(name: str, fill: Callable[[Any], None], xlabel: str, ylabel: str) -> None:
        fig, ax = plt.subplots(figsize=(7.0, 3.6), layout="constrained")
        fill(ax)
        ax.set(xlabel=xlabel, ylabel=ylabel)
        ax.grid(alpha=0.3)
        if ax.get_legend_handles_labels()[0]:
            ax.legend(frameon=False, fontsize="small", ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))
        fig.savefig(base / name, metadata={"Date": None})
        plt.close(fig)
        drawn.append(name)

    def against_time(axis: str, begin: int, end: int) -> Callable[[Any], None]:
        def fill(ax: Any) -> None:
            for name, colour in _COLOURS.items():
                # the literal filter stays near least squares and would cover it
                y = errors[f"{name}_{axis}_m"][begin:end]
                width, alpha = (1.2 if name == "improved" else 0.7), (0.6 if name == "literal" else 1.0)
                ax.plot(errors["t_s"][begin:end], y, color=colour, label=_NAMES[name], lw=width, alpha=alpha)

        return fill

    def path(ax: Any) -> None:
        ax.plot([x / 1e3 for x in errors["east_m"]], [y / 1e3 for y in errors["north_m"]], color="C0")
        ax.set_aspect("equal", adjustable="datalim")

    def height(ax: Any) -> None:
        ax.plot(errors["t_s"], errors["up_m"], color="C0")

    figure("fig2_path.svg", path, "east, km", "north, km")
    figure("fig2_height.svg", height, "time, s", "above the start, m")
    # the first half minute of filters that begin with P(0) = 0 would hide everything else
    figure("fig3_longitude.svg", against_time("longitude", 40, 1001), "time, s", "error along longitude, m")
    figure("fig4_latitude.svg", against_time("latitude", 40, 1001), "time, s", "error along latitude, m")
    figure("fig5_maneuver.svg", against_time("longitude", 580, 680), "time, s", "error along longitude, m")
    return drawn
