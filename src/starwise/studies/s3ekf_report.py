"""Report and figures of the reproduced S3EKF paper."""

from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

Errors = dict[str, list[float]]
Result = dict[str, Any]
_NAMES = {"lsq": "LSM", "ekf": "EKF", "s3ekf": "S3EKF"}


def write_report(result: Result, errors: Errors, base: Path) -> None:
    """Write ``report.md`` and, where matplotlib is installed, the figures as SVG.

    Raises
    ------
    StarwiseError
        A file cannot be written.
    """
    from starwise.studies.s3ekf import write_text

    drawn = draw(result, errors, base) if find_spec("matplotlib") else []
    write_text(report_text(result, drawn), base / "report.md")


def report_text(result: Result, figures: Sequence[str] = ()) -> str:
    """The report, Markdown."""
    s = result["settings"]
    lines = [
        "# S3EKF reproduced",
        "",
        f"starwise {s['version']}, {s['runs']} runs of each scenario, seeds {', '.join(map(str, s['seeds']))}. "
        f"White jerk {s['jerk_psd_m2_per_s5']:g} m^2/s^5, one filter for all scenarios; statistics from "
        f"{s['statistics_from_s']:g} s on. Paper's figures in brackets; +- is the spread of single runs.",
        "",
        "## Table 1: 2RMS",
        "",
        *_table(
            ("scenario", "method", "horizontal, m", "vertical, m", "velocity, m/s"),
            [
                (row["scenario"], _NAMES[row["method"]], *(_with_paper(row, k) for k in _SIZES))
                for row in result["table1"]
            ],
        ),
        "",
        f"EKF and S3EKF: at most {result['max_difference_m'] * 1e3:.4f} mm apart at any epoch of any run.",
        "",
        "What the covariances of least squares and filter expected (2 sigma):",
        "",
        *_table(
            ("scenario", "method", "horizontal, m", "vertical, m", "velocity, m/s"),
            [
                (row["scenario"], _NAMES[row["method"]], *(f"{row['expected_' + k]:.3g}" for k in _SIZES))
                for row in result["table1"]
                if row["method"] != "ekf"
            ],
        ),
        "",
        "### Differences from the paper, explained",
        "",
        *_explanations(result),
        "",
        "## Velocity gain over least squares",
        "",
        *_table(
            ("rate noise, m/s", "gain", "paper", "by scenario"),
            [
                (
                    f"{row['rate_noise_mps']:g}",
                    f"{row['gain']:.1%}",
                    f"{row['paper_gain']:.0%}",
                    ", ".join(f"{g:.1%}" for g in row["by_scenario"]),
                )
                for row in result["velocity_gain"]
            ],
        ),
        "",
        "### Other process noise",
        "",
        "The same with the white jerk of the filter changed (fewer runs); what is above was not chosen by it.",
        "",
        *_table(
            ("jerk PSD, m^2/s^5", "horizontal, m", "vertical, m", "velocity, m/s", "velocity gain"),
            [
                (
                    f"{row['jerk_psd']:g}",
                    *(", ".join(f"{value:.2f}" for value in row[k]) for k in _SIZES),
                    ", ".join(f"{value:.0%}" for value in row["velocity_gain"]),
                )
                for row in result["sensitivity"]
            ],
        ),
        "",
        "## Operations saved by the sequential form (figure 7)",
        "",
        *_operations(result),
        "",
        "## Measured time of one update, 13 states",
        "",
        *_table(
            ("satellites", "batch, us", "sequential, us", "compressed, us", "seq. / batch", "compr. / seq."),
            [
                (
                    row["n"],
                    *(f"{row[k]:.2f}" for k in ("batch_us", "sequential_us", "compressed_us")),
                    *(f"{row[k]:.2f}" for k in ("sequential_over_batch", "compressed_over_sequential")),
                )
                for row in result["time_ratio"]
            ],
        ),
        "",
        "## Real data",
        "",
        *_real(result["real"]),
        "",
        "## Beyond the paper",
        "",
        *[f"- {_sentence(row)}" for row in result["robustness"]],
        "",
        "## Scenario 2, one run",
        "",
        _sentence(result["scenario2"]) + ".",
        "",
        *[f"![{name}]({name})" for name in figures],
    ]
    return "\n".join(lines).rstrip() + "\n"


def short_text(result: Result) -> str:
    """The main results for a terminal, 80 columns."""
    lines = [f"{result['settings']['runs']} runs; 2RMS, the paper's in brackets", ""]
    lines.append(f"{'':>2} {'method':<6} {'horizontal, m':>17} {'vertical, m':>17} {'velocity, m/s':>17}")
    for row in result["table1"]:
        cells = " ".join(f"{row[k]:9.{d}f} ({row['paper_' + k]:5.2f})" for k, d in zip(_SIZES, (2, 2, 3), strict=True))
        lines.append(f"{row['scenario']:>2} {_NAMES[row['method']]:<6} {cells}")
    gain = {(row["n"], row["states"]): row for row in result["operation_gain"]}
    times = {row["n"]: row for row in result["time_ratio"]}
    lines += ["", f"EKF to S3EKF: at most {result['max_difference_m'] * 1e3:.4f} mm"]
    lines += [
        f"velocity gain at {row['rate_noise_mps']:g} m/s: {row['gain']:.1%} (paper {row['paper_gain']:.0%})"
        for row in result["velocity_gain"]
    ]
    lines += [
        f"{n} satellites: operations saved {gain[n, 13]['paper_rule']:.1%} (paper's rule), "
        f"{gain[n, 13]['own_rule']:.1%} (own); time {times[n]['sequential_over_batch']:.2f}"
        for n in (7, 8, 15)
    ]
    return "\n".join(lines)


_SIZES = ("horizontal_2rms_m", "vertical_2rms_m", "velocity_2rms_mps")


def _explanations(result: Result) -> list[str]:
    """Why the numbers differ from the paper's, with the numbers that show it."""
    rows = {(row["scenario"], row["method"]): row for row in result["table1"]}
    lsq = [rows[k, "lsq"] for k in range(1, 5)]

    def against(key: str) -> str:
        return ", ".join(f"{row[key] / row['paper_' + key] - 1.0:+.0%}" for row in lsq)

    first = lsq[0]
    pdop = (first["paper_horizontal_2rms_m"] ** 2 + first["paper_vertical_2rms_m"] ** 2) ** 0.5 / 12.0
    second = rows[2, "s3ekf"]
    stiff = result["sensitivity"]
    return [
        f"- **Least squares, position** ({against('horizontal_2rms_m')} horizontal, {against('vertical_2rms_m')} "
        "vertical, scenarios 1 to 4). It is geometry alone, and comes out as its covariance expects. The paper names "
        "neither place nor time; its own rows differ by 12 % between scenarios, ours do not, because all four fly at "
        "one place and time.",
        f"- **Velocity.** The paper's rows contradict each other: its position rows mean a PDOP of {pdop:.2f}, so "
        f"0.1 m/s of rate noise gives {0.2 * pdop:.2f} m/s of 2RMS in three dimensions, not "
        f"{first['paper_velocity_2rms_mps']:.2f}. That is once the RMS; half of ours is "
        f"{first['velocity_2rms_mps'] / 2.0:.3f}.",
        f"- **Filter, scenario 2** (paper {second['paper_horizontal_2rms_m']:.2f} and "
        f"{second['paper_vertical_2rms_m']:.2f} m, here {second['horizontal_2rms_m']:.2f} and "
        f"{second['vertical_2rms_m']:.2f}). The motion is level, so the paper's vertical error cannot come from it; no "
        f"process noise between {stiff[0]['jerk_psd']:g} and {stiff[-1]['jerk_psd']:g} m^2/s^5 gives it (below). With "
        "rates of 0.1 m/s a filter that has settled has about 1 to 2 m whatever the motion. A start-up included in the "
        "statistics, or another noise there, would explain it; the paper does not say.",
        "- **Filter, other scenarios.** Of the paper's size, mostly below it; process noise, P0, clock and length of "
        "the runs are not given by the paper.",
        "- **Velocity gain.** It depends on the process noise; no single value gives the paper's 22 % and 63 % "
        "together (below).",
    ]


def _with_paper(row: Result, key: str) -> str:
    digits = 3 if key == "velocity_2rms_mps" else 2
    return f"{row[key]:.{digits}f} +- {row[key + '_spread']:.{digits}f} ({row['paper_' + key]:.2f})"


def _table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> list[str]:
    lines = [head, ["---"] * len(head), *rows]
    return ["| " + " | ".join(str(cell) for cell in line) + " |" for line in lines]


def _operations(result: Result) -> list[str]:
    states = sorted({row["states"] for row in result["operation_gain"]})
    by = {(row["n"], row["states"]): row for row in result["operation_gain"]}
    paper = {row["n"]: row["gain"] for row in result["paper"]["operation_gain"]}
    head = ["satellites", "paper"] + [f"rule, N = {N}" for N in states] + [f"own, N = {N}" for N in states]
    rows = [
        (
            n,
            f"{paper[n]:.1%}" if n in paper else "",
            *(f"{by[n, N]['paper_rule']:.1%}" for N in states),
            *(f"{by[n, N]['own_rule']:.1%}" for N in states),
        )
        for n in (4, 6, 7, 8, 10, 15, 20, 30, 45, 60)
    ]
    return _table(head, rows)


def _real(rows: Sequence[Result]) -> list[str]:
    there = [row for row in rows if "absent" not in row]
    lines = [f"- {row['data']}: not compared, {row['absent']}" for row in rows if "absent" in row]
    if there:
        head = ("data", "systems", "satellites", "apart, mm", "same decisions", "EKF, us", "S3EKF, us", "ratio")
        body = [
            (
                row["data"], row["systems"], f"{row['n_min']}-{row['n_max']}", f"{row['max_difference_m'] * 1e3:.4f}",
                "yes" if row["same_decisions"] else "no", f"{row['ekf_us']:.1f}", f"{row['s3ekf_us']:.1f}",
                f"{row['ratio']:.2f}",
            )
            for row in there
        ]  # fmt: skip
        lines += ([""] if lines else []) + _table(head, body)
    return lines


def _sentence(row: Result) -> str:
    """A record of results in words: ``case, form: name value, ...``."""
    head = ", ".join(str(row[k]) for k in ("case", "form", "variant") if k in row)
    rest = [k for k in row if k not in ("case", "form", "variant")]

    def value(v: object) -> str:
        return "none" if v is None else f"{v:.3g}" if isinstance(v, float) else str(v)

    body = ", ".join(f"{k.replace('_', ' ')} {value(row[k])}" for k in rest)
    return f"{head}: {body}" if head else body


def draw(result: Result, errors: Errors, base: Path) -> list[str]:
    """Figures 3 to 7 and the measured times as SVG; their names."""
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
            ax.legend(frameon=False, fontsize="small")
        fig.savefig(base / name, metadata={"Date": None})
        plt.close(fig)
        drawn.append(name)

    def against_time(quantity: str) -> Callable[[Any], None]:
        def fill(ax: Any) -> None:
            for method, style in (("lsq", "0.7"), ("ekf", "C1"), ("s3ekf", "C0")):
                width, dash = (2.4, "-") if method == "ekf" else (1.0, "--" if method == "s3ekf" else "-")
                ax.plot(errors["t_s"], errors[f"{method}_{quantity}"], color=style, lw=width, ls=dash,
                        label=_NAMES[method])  # fmt: skip

        return fill

    figure("fig3_horizontal.svg", against_time("horizontal_m"), "time, s", "horizontal error, m")
    figure("fig4_vertical.svg", against_time("vertical_m"), "time, s", "vertical error, m")
    figure("fig5_velocity.svg", against_time("velocity_mps"), "time, s", "velocity error, m/s")
    figure("fig6_satellites.svg", lambda ax: ax.step(errors["t_s"], errors["satellites"], where="post"),
           "time, s", "satellites")  # fmt: skip
    figure("fig7_operations.svg", lambda ax: _fill_operations(ax, result), "satellites", "operations saved")
    figure("time_ratio.svg", lambda ax: _fill_times(ax, result), "satellites", "time of one update, us")
    return drawn


def _fill_operations(ax: Any, result: Result) -> None:
    for k, N in enumerate(sorted({row["states"] for row in result["operation_gain"]})):
        rows = [row for row in result["operation_gain"] if row["states"] == N and 4 <= row["n"] <= 30]
        n = [row["n"] for row in rows]
        ax.plot(n, [row["paper_rule"] for row in rows], color=f"C{k}", label=f"paper's rule, N = {N}")
        ax.plot(n, [row["own_rule"] for row in rows], color=f"C{k}", ls="--", label=f"own update, N = {N}")
    paper = result["paper"]["operation_gain"]
    ax.plot([p["n"] for p in paper], [p["gain"] for p in paper], "kx", label="paper's figures")
    ax.axhline(0.0, color="k", lw=0.6)


def _fill_times(ax: Any, result: Result) -> None:
    rows = result["time_ratio"]
    for key in ("batch", "sequential", "compressed"):
        ax.loglog([row["n"] for row in rows], [row[f"{key}_us"] for row in rows], marker=".", label=key)
