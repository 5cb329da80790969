"""The summary of a batch as text of 80 columns."""

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from starwise.batch.run import counts, span
from starwise.batch.work import FAILED, OK, UNPAIRED

if TYPE_CHECKING:
    import polars as pl

ALL: Final = 40
"""Up to so many units each has its line; of more, the failed and the worst ones."""
WORST: Final = 10
_NAME: Final = 27


def batch_text(table: "pl.DataFrame", output: str, wall_s: float) -> str:
    """Table and totals of a batch."""
    import polars as pl

    n = counts(table)
    shown = table
    lead = ""
    if table.height > ALL:
        bad = table.filter(pl.col("status") != OK).head(ALL // 2)
        by = "rms_3d_m" if table["rms_3d_m"].count() else "sigma_3d_m"
        worst = table.filter(pl.col("status") == OK).sort(by, descending=True, nulls_last=True).head(WORST)
        shown = pl.concat([bad, worst])
        what = "RMS" if by == "rms_3d_m" else "sigma"
        lead = f"{table.height} units; first {bad.height} not solved, {worst.height} of largest {what}\n"
    heads = (("epochs", 7), ("solved", 6), ("s", 6), ("sigma", 7), ("RMS 3D", 7), ("95 %", 5), ("notes", 6))
    lines = [" ".join([f"{'unit':<{_NAME}}", *(f"{name:>{width}}" for name, width in heads)])]
    for row in shown.iter_rows(named=True):
        lines += _lines(row)
    return lead + "\n".join([*lines, "", *_totals(table, n, output, wall_s)])


def _lines(row: dict[str, Any]) -> list[str]:
    name = row["unit"]
    if row["status"] in (FAILED, UNPAIRED):
        return [f"{_short(name, 70)} {row['status']}", *_wrapped(row["message"] or "")]
    share = f"{100 * row['solved'] / row['epochs']:.0f} %" if row["epochs"] else "--"
    return [
        f"{_short(name, _NAME):<{_NAME}} {row['epochs']:>7} {share:>6} {row['seconds']:>6.1f}"
        f" {_metres(row['sigma_3d_m']):>7} {_metres(row['rms_3d_m']):>7} {_percent(row['coverage_95']):>5}"
        f" {row['problems'] or '':>6}"
    ]


def _short(name: str, width: int) -> str:
    return name if len(name) <= width else name[: width - 2] + ".."


def _wrapped(text: str) -> list[str]:
    import textwrap

    return textwrap.wrap(text, 76, initial_indent="    ", subsequent_indent="    ", max_lines=3, placeholder=" ...")


def _metres(value: float | None) -> str:
    return "--" if value is None else f"{value:.2f} m" if value < 1000 else f"{value / 1e3:.1f} km"


def _percent(value: float | None) -> str:
    return "--" if value is None else f"{100 * value:.0f}"


def _totals(table: "pl.DataFrame", n: dict[str, int], output: str, wall_s: float) -> list[str]:
    words = {"ok": "solved", "no_solution": "without a position", "failed": "failed", "unpaired": "not paired"}
    said = ", ".join(f"{count} {words[name]}" for name, count in n.items() if count)
    again = int(table["resumed"].sum())
    lines = [f"{said}{f' ({again} from before)' if again else ''}; {span(wall_s)}"]
    judged = table.filter(table["rms_3d_m"].is_not_null())
    if judged.height:
        epochs, rms = (judged[name].to_numpy() for name in ("compared", "rms_3d_m"))
        held = judged["coverage_95"].fill_null(float("nan")).to_numpy()
        inside = np.nansum(held * epochs) / max(1, epochs[~np.isnan(held)].sum())
        pooled = np.sqrt((rms**2 * epochs).sum() / epochs.sum())
        lines += [
            f"{judged.height} judged, {epochs.sum()} epochs: RMS 3D {pooled:.2f} m (median {np.median(rms):.2f} m),",
            f"the 95 % ellipsoid holds {100 * inside:.0f} %",
        ]
    return [*lines, f"in {output}: summary.parquet, unit=*/solution.parquet"]
