"""Report and figures of the reproduced RDSS/SINS paper."""

from collections.abc import Callable, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

Result = dict[str, Any]
Curves = dict[str, dict[str, list[float]]]
_NAMES = {
    "optimal_prediction": "optimal prediction",
    "replay": "checkpoint and replay",
    "cloning": "stochastic cloning",
    "ignored": "delay ignored",
    "estimated": "delay estimated",
}


def write_report(result: Result, curves: Curves, base: Path) -> None:
    """Write ``report.md`` and, where matplotlib is installed, the figures as SVG.

    Raises
    ------
    StarwiseError
        A file cannot be written.
    """
    from starwise.studies.s3ekf import write_text

    drawn = draw(result, curves, base) if find_spec("matplotlib") else []
    write_text(report_text(result, drawn), base / "report.md")


def report_text(result: Result, figures: Sequence[str] = ()) -> str:
    """The report, Markdown."""
    s = result["settings"]
    lines = [
        "# RDSS/SINS with optimal prediction, reproduced",
        "",
        f"starwise {s['version']}, {s['runs']} runs of each experiment ({s['runs_beyond']} of everything beyond), seed "
        f"{s['seed']}. A strapdown navigator with feedback, 20 Hz, 26 minutes; a fix every {s['period_s']:g} s, each "
        f"{s['period_s']:g} s old. Statistics from {s['statistics_from_s']:g} s on. A window is {s['window']} fixes: "
        f"K = {s['K']} terms at each of {s['lags']} lags.",
        "",
        "## The two experiments, optimal prediction",
        "",
        *_table(("", "static", "dynamic, 60 m/s", "paper"), _experiment_rows(result)),
        "",
        *_paper(result["paper"]),
        "",
        *[line for name in ("static", "dynamic") for line in _methods(result, name)],
        *_equivalence(result),
        "",
        "## Jitter of 0.1 s in the instant that a fix is valid for",
        "",
        *_many(result["jitter"], check=False),
        "",
        "Replay and cloning lose nothing if the fix says what instant it is of. Optimal prediction as in the paper "
        "knows one delay only; not told, all ways are alike.",
        "",
        "## Ignored delay by speed, turns of 90 deg",
        "",
        *_many(result["speed"]),
        "",
        "## The blind spot",
        "",
        *_many(result["blind_spot"]),
        "",
        *_blind_spot(result),
        "",
        "## Wrong models, optimal prediction, 60 m/s",
        "",
        *_many(result["model"], check=False),
        "",
        "Whiteness does not see a wrong R, the size of the innovations does not see slightly coloured fixes, and "
        "neither sees well a constant error of the height that the ground station uses: it is a constant error of the "
        "position.",
        "",
        "## Errors of a fix (equation 4)",
        "",
        "8 m (orbit) and 13 m (ranging) to each satellite, 10 m of height; m, 1 sigma.",
        "",
        *_table(
            ("latitude", "longitude", "east: distance", "height", "whole", "north: distance", "height", "whole"),
            [
                (
                    f"{r['latitude_deg']:g}", f"{r['longitude_deg']:g}",
                    *(f"{r[k]:.1f}" for k in ("ew_distance", "ew_height", "ew", "ns_distance", "ns_height", "ns")),
                )
                for r in result["geometry"]
            ],
        ),
        "",
        *[f"![{name}]({name})" for name in figures],
    ]  # fmt: skip
    return "\n".join(lines).rstrip() + "\n"


def short_text(result: Result) -> str:
    """The main results for a terminal, 80 columns."""
    lines = [f"{result['settings']['runs']} runs; optimal prediction", ""]
    lines.append(f"{'':<8} {'RMS, m':>7} {'m/s':>6} {'NIS/dof':>8} {'NIS ok':>7} {'white':>7} {'95 %':>6}  consistent")
    for name in ("static", "dynamic"):
        r = result[name]
        lines.append(
            f"{name:<8} {r['rms_position_m']:7.2f} {r['rms_velocity_mps']:6.3f} {r['nis_per_dof_all']:8.3f} "
            f"{r['nis_pass_rate']:7.1%} {r['white_pass_rate']:7.1%} {r['coverage_95']:6.3f}  {_yes(r['consistent'])}"
        )
    lines += ["", "60 m/s with turns:"]
    for row in result["delay_methods"]:
        lines.append(
            f"  {_NAMES[row['method']]:<22} {row['rms_position_m']:7.2f} m   NIS/dof {row['nis_per_dof']:6.3f}   "
            f"consistent: {_yes(row['consistent'])}"
        )
    straight = result["blind_spot"][0]
    vector = result["paper"]["vector"]
    lines += [
        "",
        f"straight at 100 m/s, delay ignored: {straight['rms_position_m']:.0f} m wrong, NIS passes "
        f"{straight['nis_pass_rate']:.0%},",
        f"  whiteness {straight['white_pass_rate']:.0%}; the delay check calls it unverifiable in "
        f"{straight['delay_unverifiable_rate']:.0%}",
        f"the paper's rho(1) = -0.4054: bound {vector['bound']:.3f} for all eight lags, not white",
    ]
    return "\n".join(lines)


def _yes(value: bool) -> str:
    return "yes" if value else "no"


def _table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> list[str]:
    lines = [head, ["---"] * len(head), *rows]
    return ["| " + " | ".join(str(cell) for cell in line) + " |" for line in lines]


def _experiment_rows(result: Result) -> list[Sequence[object]]:
    both = [result["static"], result["dynamic"]]
    paper = result["paper"]

    def line(what: str, value: Callable[[Result], str], printed: str = "") -> Sequence[object]:
        return (what, *(value(r) for r in both), printed)

    return [
        line("RMS position, m", lambda r: f"{r['rms_position_m']:.2f}"),
        line("as the covariance expects, m", lambda r: f"{r['claimed_position_m']:.2f}"),
        line("RMS velocity, m/s", lambda r: f"{r['rms_velocity_mps']:.3f}"),
        line("inside the 95 % ellipse", lambda r: f"{r['coverage_95']:.3f}"),
        line("free navigator, RMS position, km", lambda r: f"{r['free_rms_position_m'] / 1e3:.1f}"),
        line("NIS per degree of freedom, all", lambda r: f"{r['nis_per_dof_all']:.4f}"),
        line("the same, last window", lambda r: f"{r['nis_per_dof']:.3f}", f"{paper['nis_per_dof']}"),
        line("its region", lambda r: f"{r['nis_low']:.3f} .. {r['nis_high']:.3f}", "0.74 .. 1.3"),
        line("rho(1..8), last window, mean", lambda r: ", ".join(f"{x:+.2f}" for x in r["rho"])),
        line(
            "rho(1..8), run 0",
            lambda r: ", ".join(f"{x:+.2f}" for x in r["first_run"]["rho"]),
            ", ".join(f"{x:+.2f}" for x in paper["rho"]),
        ),
        line("bound of all eight together", lambda r: f"{r['rho_bound']:.3f}", "0.2772"),
        line("windows that pass: NIS", lambda r: f"{r['nis_pass_rate']:.1%} of {r['windows']}"),
        line("whiteness", lambda r: f"{r['white_pass_rate']:.1%}"),
        line("both", lambda r: f"{r['both_pass_rate']:.1%}"),
        line("eq. 8 as printed, 0.2772", lambda r: f"{r['eq8_pass_rate']:.1%}"),
        line("north alone, each lag 0.2772", lambda r: f"{r['scalar_each_pass_rate']:.1%}"),
        line("north alone, joint bound", lambda r: f"{r['scalar_joint_pass_rate']:.1%}"),
        line("least that a correct filter has", lambda r: f"{r['least_pass_rate']:.1%}"),
        line("consistent", lambda r: _yes(r["consistent"]), "yes"),
    ]


def _paper(paper: Result) -> list[str]:
    one, two = paper["scalar"], paper["vector"]
    any_of_eight = one["chance_of_first_in_any_of_eight"]
    return [
        f"**The paper's own series is not white.** Its rho(1) = {paper['rho'][0]} lies outside the interval +-0.2772 "
        "that it prints, although the text says that all eight lie inside. A single lag of a white scalar series is so "
        f"far out with a chance of {one['chance_of_first']:.2%}, any of eight lags with {any_of_eight:.1%}; bound of "
        f"all eight together {one['bound']:.3f}. For the inner product of two-dimensional innovations, which equation "
        f"8 is, the chance is {two['chance_of_first']:.1e}, the bound {two['bound']:.3f}. Its NIS of "
        f"{paper['nis_per_dof']} passes. The lowest rho(1) in the last windows of all runs here is "
        f"{paper['lowest_here']:.2f}; differenced innovations (mean -0.5) or a gain that is too high would give it.",
    ]


def _methods(result: Result, name: str) -> list[str]:
    return [f"### Ways with the delay: {name}", "", *_many(result[name]["delay_methods"], name="method"), ""]


def _many(rows: Sequence[Result], *, check: bool = True, name: str = "") -> list[str]:
    head = ["RMS, m", "95 % ellipse", "NIS/dof", "NIS passes", "whiteness passes", "both", "consistent"]
    titles = [name] if name else ["experiment", "method"]
    if check:
        head += ["delay found, s", "check: wrong / unverifiable / confirmed"]
    body = []
    for r in rows:
        cells: list[object] = [] if name else [r["experiment"]]
        cells += [
            _NAMES[r["method"]], f"{r['rms_position_m']:.2f}", f"{r['coverage_95']:.3f}", f"{r['nis_per_dof']:.3f}",
            *(f"{r[k]:.1%}" for k in ("nis_pass_rate", "white_pass_rate", "both_pass_rate")), _yes(r["consistent"]),
        ]  # fmt: skip
        if check:
            cells += _check_cells(r)
        body.append(cells)
    return _table((*titles, *head), body)


def _check_cells(r: Result) -> list[str]:
    if r.get("tau_s") is not None:
        return [f"{r['tau_s']:.2f} +- {r['tau_sigma_s']:.2f} (state)", ""]
    kinds = ("wrong", "unverifiable", "confirmed")
    found = "" if r["delay_s"] is None else f"{r['delay_s']:+.2f} +- {r['delay_sigma_s']:.2f}"
    return [found, " / ".join(f"{r[f'delay_{k}_rate']:.0%}" for k in kinds)]


def _equivalence(result: Result) -> list[str]:
    lines = ["Largest difference of a position to checkpoint and replay, at exactly one period, m:", ""]
    rows = []
    for name, r in result["equivalence"].items():
        for way in ("optimal_prediction", "cloning"):
            rows.append((name, _NAMES[way], f"{r['linear_m'][way]:.1e}", f"{r['navigator_m'][way]:.1e}"))
    lines += _table(("", "", "linear 15-state system", "navigator with feedback, all runs"), rows)
    return [
        *lines,
        "",
        "In the linear system the ways are one, to rounding. In the navigator, replay flies the past again from the "
        "corrected state, the others carry the correction forward by Phi: what is left is the second order.",
    ]


def _blind_spot(result: Result) -> list[str]:
    row, found, five = [r for r in result["blind_spot"] if r["method"] == "ignored"][:3]
    return [
        f"Straight and steady, an ignored delay of 1.5 s is a constant position error of 1.5 s times speed, here "
        f"{row['rms_position_m']:.0f} m. The filter cannot tell it from the error of its start and takes it into its "
        "state; what is left in the innovations is white and small. No test on innovations can do better: the delay is "
        "unobservable there.",
        "",
        "The added check computes what a delay of 1 s *would* have added to each innovation and to the position (the "
        "response of the filter to that change of its measurements), fits it to the innovations, and asks how large a "
        "position error could hide behind the delays that are still possible. Straight flight: `unverifiable`, "
        "whichever way the delay is treated: nothing in the data says which is right. Turns of two degrees show "
        f"it in {found['delay_wrong_rate']:.0%} of the runs, of five in {five['delay_wrong_rate']:.0%}, while NIS and "
        f"whiteness still pass in {found['both_pass_rate']:.0%} and {five['both_pass_rate']:.0%} of the windows.",
    ]


def draw(result: Result, curves: Curves, base: Path) -> list[str]:
    """Figures as SVG; their names."""
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
        fig.legend(loc="outside upper center", ncols=3, frameon=False, fontsize="small")
        fig.savefig(base / name, metadata={"Date": None})
        plt.close(fig)
        drawn.append(name)

    for number, name in ((1, "static"), (3, "dynamic")):
        c = curves[name]
        errors = "fig1_static_errors.svg" if name == "static" else "dynamic_errors.svg"
        figure(errors, partial(_fill_errors, c=c), "time, s", "position error, m")
        inner = partial(_fill_innovations, c=c)
        figure(f"fig{number + 1}_{name}_innovations.svg", inner, "step", "innovation, m")
        figure(f"free_{name}.svg", partial(_fill_free, c=c), "time, s", "position error, m")
    figure("fig3_track.svg", lambda ax: _fill_track(ax, curves["dynamic"]), "east, km", "north, km")
    figure("rho.svg", lambda ax: _fill_rho(ax, result), "lag", "autocorrelation")
    figure("delay_methods.svg", lambda ax: _fill_methods(ax, curves["dynamic"]), "time, s", "position error, m")
    figure("blind_spot.svg", lambda ax: _fill_blind(ax, result), "turns, deg", "part of windows or runs")
    return drawn


def _fill_errors(ax: Any, c: dict[str, list[float]]) -> None:
    for axis, color in (("north", "C0"), ("east", "C1")):
        ax.plot(c["t_s"], c[f"optimal_prediction_{axis}_m"], color=color, lw=1.0, label=axis)
        two = [2.0 * s for s in c[f"sigma_{axis}_m"]]
        ax.plot(c["t_s"], two, color=color, lw=0.7, ls="--", label="2 sigma" if axis == "east" else None)
        ax.plot(c["t_s"], [-s for s in two], color=color, lw=0.7, ls="--")
    ax.set_ylim(-40.0, 40.0)


def _fill_innovations(ax: Any, c: dict[str, list[float]]) -> None:
    for axis, color in (("north", "C0"), ("east", "C1")):
        v, s = c[f"v_{axis}_m"][-55:], c[f"s_{axis}_m"][-55:]
        ax.plot(range(1, len(v) + 1), v, color=color, lw=1.0, marker=".", label=axis)
        two = "2 sigma" if axis == "east" else None
        ax.plot(range(1, len(v) + 1), [2.0 * x for x in s], color=color, lw=0.7, ls="--", label=two)
        ax.plot(range(1, len(v) + 1), [-2.0 * x for x in s], color=color, lw=0.7, ls="--")


def _fill_free(ax: Any, c: dict[str, list[float]]) -> None:
    for way, color in (("free", "C3"), ("optimal_prediction", "C0")):
        size = [(n * n + e * e) ** 0.5 for n, e in zip(c[f"{way}_north_m"], c[f"{way}_east_m"], strict=True)]
        ax.semilogy(c["t_s"], size, color=color, lw=1.0, label=_NAMES.get(way, "free navigator"))


def _fill_track(ax: Any, c: dict[str, list[float]]) -> None:
    def plane(east: Sequence[float], north: Sequence[float], **style: Any) -> None:
        ax.plot([x / 1e3 for x in east], [y / 1e3 for y in north], **style)

    def moved(way: str, axis: str) -> list[float]:
        return [t + e for t, e in zip(c[f"true_{axis}_m"], c[f"{way}_{axis}_m"], strict=True)]

    plane(c["fix_east_m"], c["fix_north_m"], color="0.7", lw=3.0, label="RDSS fixes")
    way = "optimal_prediction"
    plane(moved(way, "east"), moved(way, "north"), color="C0", lw=1.0, label=_NAMES[way])
    plane(moved("free", "east"), moved("free", "north"), color="C3", lw=1.0, label="free navigator")
    ax.set_aspect("equal")


def _fill_rho(ax: Any, result: Result) -> None:
    lags = range(1, len(result["paper"]["rho"]) + 1)
    for name, marker in (("static", "o"), ("dynamic", "s")):
        ax.plot(lags, result[name]["first_run"]["rho"], marker=marker, ls="", label=f"{name}, run 0")
    ax.plot(lags, result["paper"]["rho"], "kx", label="paper")
    for kind, style in (("vector", "-"), ("scalar", ":")):
        bound = result["paper"][kind]["bound"]
        ax.axhline(bound, color="k", lw=0.8, ls=style, label=f"all eight, {kind}")
        ax.axhline(-bound, color="k", lw=0.8, ls=style)
    ax.axhline(0.2772, color="C3", lw=0.8, ls="--", label="0.2772 of the paper")
    ax.axhline(-0.2772, color="C3", lw=0.8, ls="--")


def _fill_methods(ax: Any, c: dict[str, list[float]]) -> None:
    for k, way in enumerate(("ignored", "estimated", "optimal_prediction", "replay", "cloning")):
        size = [(n * n + e * e) ** 0.5 for n, e in zip(c[f"{way}_north_m"], c[f"{way}_east_m"], strict=True)]
        # three of them are one curve: wide, middle and narrow
        width = {"optimal_prediction": 4.0, "replay": 2.2}.get(way, 0.8)
        ax.semilogy(c["t_s"], size, color=f"C{k}", lw=width, label=_NAMES[way])


def _fill_blind(ax: Any, result: Result) -> None:
    rows = [r for r in result["blind_spot"] if r["method"] == "ignored"]
    x = [float(r["experiment"].split("turns of ")[1].split()[0]) for r in rows]
    for key, label in (
        ("both_pass_rate", "NIS and whiteness pass"),
        ("coverage_95", "inside the 95 % ellipse"),
        ("delay_wrong_rate", "delay found"),
        ("delay_unverifiable_rate", "called unverifiable"),
    ):
        ax.plot(x, [r[key] for r in rows], marker=".", label=label, clip_on=False)
    ax.set_xscale("symlog", linthresh=2.0)
    ax.set_xticks(x, [f"{value:g}" for value in x])
    ax.set_xticks([], minor=True)
