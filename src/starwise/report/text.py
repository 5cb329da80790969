"""What the command line says to people, in at most 80 columns."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from starwise.report.residuals import residual_lines

WIDTH = 80
SYSTEM_NAMES = {
    "G": "GPS", "R": "GLONASS", "E": "Galileo", "C": "BeiDou", "J": "QZSS", "I": "NavIC", "S": "SBAS",
}  # fmt: skip
_WHY = {
    "no_code": "pseudorange blank",
    "bad_code": "pseudorange impossible",
    "no_ephemeris": "no ephemeris",
    "unhealthy": "marked unhealthy",
    "ephemeris_too_old": "ephemeris out of date",
    "bad_ephemeris": "ephemeris is no orbit",
    "no_clock": "no satellite clock",
    "inaccurate": "no accuracy promised",
    "low_elevation": "below the elevation mask",
    "low_cn0": "below the C/N0 limit",
    "gated": "outside the filter's gate",
    "excluded": "excluded as faulty",
    "epoch_unsolved": "its epoch has no solution",
    "no_pair": "second frequency missing",
    "no_frequency": "carrier unknown",
    "system_off": "system not asked for",
    "excluded_by_user": "excluded by option",
}


def solve_text(provenance: Mapping[str, Any], directory: str | Path, elapsed_s: float) -> str:
    """Screen after ``starwise solve``: what was read, used, refused and found, and where it is."""
    config, summary = provenance["config"], provenance["summary"]
    lines = [*_read_lines(provenance), ""]
    lasting = "errors correlated" if config["method"] == "lsq" else "errors as states"
    errors = lasting if config.get("error_model") == "colored" else "errors white"
    lines += _field("method", f"{config['method']}, {errors}, mask {config['mask_deg']:g} deg")
    if config["method"] != "lsq":
        lines += _field("dynamics", _dynamics(provenance["dynamics"]))
    lines += _field("ephemeris", _ephemeris(provenance))
    lines += _system_lines(summary)
    lines += _refused_lines(summary)
    lines += ["", *_result_lines(summary)]
    lines += _event_lines(provenance)
    lines += _notes(provenance)
    lines += ["", *_field("results", f"{directory}/  solution.parquet ledger.parquet solution.pos run.json")]
    lines += report_line(directory)
    lines += _field("time", f"{elapsed_s:.2f} s")
    return "\n".join(lines)


def report_line(directory: str | Path) -> list[str]:
    """Where the report is, if it was written."""
    page = Path(directory) / "report.html"
    return _field("report", f"{page}  (opens in any browser)") if page.is_file() else []


def _dynamics(record: Mapping[str, Any]) -> str:
    if not record["detected"]:
        return str(record["used"])
    return f"{record['used']} (detected: {record['reason']}; --dynamics overrides)"


def _ephemeris(provenance: Mapping[str, Any]) -> str:
    if any(item["kind"] == "orbits" for item in provenance["inputs"]):
        return "precise orbits"
    if provenance["config"]["post"]:
        return "broadcast, the nearest in time, also from after the epoch"
    return "broadcast, as sent by the time of the epoch"


def _read_lines(provenance: Mapping[str, Any]) -> list[str]:
    lines = []
    for item in provenance["inputs"]:
        size = item["bytes"] / 1e6
        lines += _field(item["kind"], f"{Path(item['path']).name} ({size:.1f} MB)")
    station = provenance["station"]
    what = [text for text in (station["marker"], station["receiver"], station["antenna"]) if text]
    if what:
        lines += _field("station", ", ".join(what))
    summary = provenance["summary"]
    if summary["epochs"]:
        every = "" if summary["interval_s"] is None else f", every {summary['interval_s']:g} s"
        lines += _field(
            "epochs",
            f"{summary['epochs']} from {summary['first_epoch_gpst']} to {summary['last_epoch_gpst']} GPST{every}",
        )
    return lines


def _system_lines(summary: Mapping[str, Any]) -> list[str]:
    lines = []
    for letter, item in summary.get("systems", {}).items():
        if item["rows_used"]:
            total = sum(item["signals"].values())
            often = [(name, count) for name, count in item["signals"].items() if 200 * count >= total]
            signals = ", ".join(f"{name} {_share(count, total)}" for name, count in often)
            lines += _field(
                SYSTEM_NAMES[letter],
                f"{item['satellites_used']} of {item['satellites']} satellites used, on {signals}",
            )
        else:
            lines += _field(SYSTEM_NAMES[letter], f"not used ({item['satellites']} seen)")
    return lines


def _share(part: int, whole: int) -> str:
    return f"{100.0 * part / whole:.0f} %"


def _refused_lines(summary: Mapping[str, Any]) -> list[str]:
    lines = []
    for i, (name, count) in enumerate(list(summary.get("rows_refused", {}).items())[:6]):
        worst = " ".join(summary["satellites_most_refused"].get(name, ()))
        lines += _field("not used" if i == 0 else "", f"{count:8d}  {_WHY.get(name, name)}; most: {worst}")
    return lines


def _result_lines(summary: Mapping[str, Any]) -> list[str]:
    status = summary["epochs_by_status"]
    odd = ", ".join(f"{count} {name}" for name, count in status.items() if count and name not in ("ok", "none"))
    solved, epochs = summary["epochs_solved"], summary["epochs"]
    lines = _field("solved", f"{solved} of {epochs} epochs" + (f" ({odd})" if odd else ""))
    if summary["mean_llh"] is None:
        return lines
    lat, lon, h = summary["mean_llh"]
    lines += _field("mean", f"{lat:.7f} {lon:.7f} deg, {h:.2f} m above the ellipsoid")
    e, n, u = summary["scatter_enu_m"]
    lines += _field("scatter", f"{e:.2f} east, {n:.2f} north, {u:.2f} up, m (1 sigma about the mean)")
    if summary["sigma_3d_mean_m"] is not None:
        lines += _field("claimed", f"{summary['sigma_3d_mean_m']:.2f} m (1 sigma, 3D, mean of the covariances)")
    if summary["speed_mean_mps"] is not None:
        lines += _field("speed", f"{summary['speed_mean_mps']:.2f} m/s on average")
    return lines


def _event_lines(provenance: Mapping[str, Any]) -> list[str]:
    events = provenance.get("events", ())
    lines: list[str] = []
    for event in events[:6]:
        who = event["satellite"] or SYSTEM_NAMES[event["constellation"]]
        lines += _field("" if lines else "events", f"{event['gpst']} {who}: {event['cause']}, {event['size_m']:.1f} m")
    return [*lines, *_field("", f"and {len(events) - 6} more in run.json")] if len(events) > 6 else lines


def _notes(provenance: Mapping[str, Any]) -> list[str]:
    lines = []
    for note in provenance.get("notes", ()):
        lines += _field("note", str(note))
    problems = sorted(provenance.get("problems", ()), key=lambda item: -item["count"])
    for item in problems[:5]:
        where = f"{Path(item['file']).name}:{item['line']}" if item["line"] else Path(item["file"]).name
        lines += _field("problem", f"{item['what']} ({item['count']} x, first {where})")
    if len(problems) > 5:
        lines += _field("", f"and {len(problems) - 5} more kinds of problem in run.json")
    return ["", *lines] if lines else []


def assess_text(name: str, report: Mapping[str, Any]) -> str:
    """Screen of ``starwise assess`` for one solution."""
    judged = report.get("consistency") or {}
    residuals = residual_lines(judged) if "sizes" in judged else []
    if "reference" not in report:  # residuals alone
        return "\n".join([name, *residuals, *(line for note in report["notes"] for line in _field("note", note))])
    reference = "the truth" if report["reference"] == "truth" else "the solution's own median: scatter, not accuracy"
    lines = [name]
    lines += _field("against", f"{reference} ({report['truth']})" if report["reference"] == "truth" else reference)
    lines += _field(
        "epochs",
        f"{report['epochs']}, solved {report['epochs_solved']}, compared {report['epochs_compared']}, "
        f"flagged {report['epochs_flagged']}",
    )
    lines += ["", f"{'':12}{'all solved':>14}{'not flagged':>14}{'flagged':>14}"]
    columns: Sequence[Mapping[str, Any]] = (report, report["unflagged"], report["flagged"])
    for key, label in (
        ("mean_e_m", "mean east"),
        ("mean_n_m", "mean north"),
        ("mean_u_m", "mean up"),
        ("rms_2d_m", "RMS 2D"),
        ("rms_3d_m", "RMS 3D"),
        ("p95_2d_m", "95 % 2D"),
        ("p95_3d_m", "95 % 3D"),
        ("sigma_3d_mean_m", "claimed 3D"),
    ):
        lines.append(f"{label:12}" + "".join(_cell(column[key], "m") for column in columns))
    lines.append(
        f"{'NEES mean':12}" + "".join(_cell(column["nees_mean"], " ") for column in columns) + "  (3 expected)"
    )
    for share in (50, 68, 95):
        cells = "".join(_percent(column[f"coverage_{share}"]) for column in columns)
        lines.append(f"in {share} % ell." + cells + f"  ({share} % expected)")
    if "calibration" in report:
        lines += [
            "",
            *_calibration_lines(report["calibration"], "truth" if report["reference"] == "truth" else "median"),
        ]
    if residuals:
        lines += ["", *residuals]
    for note in report.get("notes", ()):
        lines += _field("note", note)
    return "\n".join(lines)


def pool_text(record: Mapping[str, Any]) -> str:
    """Screen of ``starwise assess --pool``: a line per run, one for all, and the calibration curve."""
    head = f"{'':6}{'epochs':>8}{'RMS 3D':>8}{'claimed':>9}{'NEES':>7}{'50 %':>8}{'68 %':>8}{'95 %':>8}"
    runs = record["runs"]
    width = WIDTH - len(head)
    lines = [f"{'':{width}}{'sess.':>6}" + head[6:]]
    lines += [_pool_line(_short(run["name"], width - 1), run, width) for run in runs]
    lines += ["", _pool_line("all sessions", record, width)]
    nominal = "".join(f"{share:8.1f}" for share in (50.0, 68.0, 95.0))
    lines += [f"{'nominal':{width}}{'':6}{'':8}{'':8}{'':9}{1.0:7.2f}{nominal}", ""]
    lines += _calibration_lines(record["calibration"])
    lines += ["", "RMS, claimed (1 sigma): 3D, m. NEES per degree of freedom. Sessions weigh alike"]
    return "\n".join(lines)


def _pool_line(name: str, item: Mapping[str, Any], width: int) -> str:
    held = "".join(_number(item[f"coverage_{share}"], 8, 1, 100.0) for share in (50, 68, 95))
    return (
        f"{name:{width}}{item['sessions']:6d}{item['epochs_compared']:8d}{_number(item['rms_3d_m'], 8, 2)}"
        f"{_number(item['sigma_3d_mean_m'], 9, 2)}{_number(item['nees_mean'], 7, 2)}{held}"
    )


def _short(name: str, width: int) -> str:
    return name if len(name) <= width else "..." + name[3 - width :]


def _number(value: float | None, width: int, digits: int, factor: float = 1.0) -> str:
    return f"{'-':>{width}}" if value is None else f"{factor * value:{width}.{digits}f}"


def _calibration_lines(curves: Mapping[str, Any], what: str = "truth") -> list[str]:
    """The calibration curve: shares of epochs, %, inside regions that claim to hold so many."""
    lines = [f"{f'{what} inside, %, of regions of':34}" + "".join(f"{100.0 * p:10.0f} %" for p in curves["nominal"])]
    for key, label in (("3d", "ellipsoid"), ("horizontal", "ellipse, horizontal"), ("vertical", "interval, vertical")):
        shares = curves[key] or [None] * len(curves["nominal"])
        lines.append(f"  {label:32}" + "".join(_number(share, 10, 1, 100.0) + "  " for share in shares).rstrip())
    return lines


def _cell(value: float | None, unit: str) -> str:
    if value is None:
        return f"{'-':>12}  "
    return f"{value:12.3f} {unit}" if abs(value) < 1e6 else f"{value:12.4g} {unit}"


def _percent(value: float | None) -> str:
    return f"{'-':>12}  " if value is None else f"{100.0 * value:12.1f} %"


_LABELS = {
    "antenna_height_east_north_m": "antenna h e n",
    "approximate_position": "position",
    "first_gpst": "first (GPST)",
    "last_gpst": "last (GPST)",
    "first_epoch_gpst": "first (GPST)",
    "last_epoch_gpst": "last (GPST)",
    "unhealthy_at_some_time": "unhealthy",
    "epochs_by_status": "status",
    "mean_pos_e_m": "mean ECEF, m",
    "mean_llh": "lat lon h",
    "scatter_enu_m": "scatter e n u",
    "sigma_3d_mean_m": "claimed 3D, m",
    "speed_mean_mps": "speed, m/s",
    "satellites_used_mean": "satellites",
    "positions_missing": "no position",
    "clocks_missing": "no clock",
}
_NOT_SHOWN = ("what", "kind", "file", "satellites_most_refused")


def info_text(name: str, described: Mapping[str, Any]) -> str:
    """Screen of ``starwise info`` for one file: keys and values, tables last."""
    lines = [f"{name}: {described['what']}"]
    for key, value in described.items():
        label = _LABELS.get(key, key.replace("_", " "))
        if key in _NOT_SHOWN or value in (None, "", [], {}):
            continue
        if key == "problems":
            for item in value:
                lines += _field("problem", f"line {item['line']}: {item['what']} ({item['count']} x)")
        elif key == "signals":
            lines += _field("signals", "rows with code, phase, Doppler")
            for system, signals in value.items():
                lines += _field("", f"{system}  " + "   ".join(f"{s} {_value(n)}" for s, n in signals.items()))
        elif isinstance(value, Mapping) and any(isinstance(item, list | Mapping) for item in value.values()):
            for i, (inner, item) in enumerate(value.items()):
                count = f" ({len(item)})" if isinstance(item, list) and key == "satellites" else ""
                lines += _field(label if i == 0 else "", f"{inner}{count}: {_value(item)}")
        else:
            lines += _field(label, _value(value))
    return "\n".join(lines)


def _value(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.10g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_value(item)}" for key, item in value.items())
    if isinstance(value, list | tuple):
        return " ".join(_value(item) for item in value)
    return str(value)


def _field(label: str, text: str) -> list[str]:
    """A labelled line, wrapped to `WIDTH` under its own start; control characters never reach the terminal."""
    import textwrap

    clean = "".join(ch if ch.isprintable() else "?" for ch in text)
    wrapped = textwrap.wrap(clean, WIDTH - 14, subsequent_indent="  ") or [""]
    return [f"{label if i == 0 else '':<14}{part}" for i, part in enumerate(wrapped)]


_WHAT_TO_DO = {
    "no_ephemeris": "are the navigation files of these hours and systems?",
    "ephemeris_too_old": "are the navigation files of these hours and systems?",
    "unhealthy": "all satellites say that they are not to be used",
    "no_code": "the observations have no pseudoranges",
    "bad_code": "the pseudoranges are not of this time, or not in metres",
    "system_off": "--systems leaves these satellites out",
    "low_elevation": "--mask is above the satellites",
    "low_cn0": "cn0_min_dbhz is above the signals",
    "no_pair": "second frequencies are missing: --combination single",
    "epoch_unsolved": "too few satellites at a time, or measurements that contradict each other",
}


def unsolved_text(summary: Mapping[str, Any]) -> str:
    """Why no epoch has a position and what may help, in a line; the summary is that of `starwise.report.summary`."""
    refused = sorted(summary.get("rows_refused", {}).items(), key=lambda item: -item[1])
    if not refused:
        return "no epoch could be solved: there is nothing to solve in these files"
    counts = ", ".join(f"{count} {name}" for name, count in refused[:2])
    hint = _WHAT_TO_DO.get(refused[0][0])
    return f"no epoch could be solved; rows: {counts}" + (f"; {hint}" if hint else "; the ledger says more")
