"""Picture: a filter that calls range errors white beside one that does not, on a quarter of an hour at a known point.

    python benchmarks/white_is_sure.py [-o docs/img/white-is-sure.svg]

prints how often the 95 % ellipsoid of either held the truth.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib
import numpy as np

from datasets import DATA, ROOT, STATIC, truth_ecef

matplotlib.use("Agg")
import matplotlib.pyplot as plt

import starwise
from starwise.frames import C_ne_enu, geodetic_from_ecef

COLOURS = {"white": "#b0413e", "colored": "#2a6f97"}
TITLES = {"white": "errors taken as white", "colored": "errors as states that last"}


def main() -> None:
    """Solve both ways, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "docs/img/white-is-sure.svg")
    output = parser.parse_args().output
    data = next(d for d in STATIC if d.name == "tlse_2024 15 min")
    assert data.truth is not None
    truth = truth_ecef(data.truth)
    lat, lon, _ = geodetic_from_ecef(truth)
    C = C_ne_enu(lat, lon)
    plt.rcParams.update(
        {"font.size": 10, "svg.fonttype": "none", "svg.hashsalt": "starwise", "font.family": "sans-serif"}
    )
    figure, axes = plt.subplots(1, 2, figsize=(8.4, 3.2), sharey=True, layout="constrained")
    for axis, model in zip(axes, ("white", "colored"), strict=True):
        solution = starwise.solve(
            DATA / data.obs, *(DATA / name for name in data.nav), error_model=model, dynamics="static"
        )
        e = solution.pos_e - truth
        nees = np.einsum("ni,ni->n", e, np.linalg.solve(solution.cov_pos, e[:, :, None])[:, :, 0])
        up = e @ C[2]
        sigma = np.sqrt(np.einsum("i,nij,j->n", C[2], solution.cov_pos, C[2]))
        minutes = (solution.t_ns - solution.t_ns[0]) / 60e9
        axis.fill_between(minutes, -1.96 * sigma, 1.96 * sigma, color=COLOURS[model], alpha=0.18, lw=0)
        axis.plot(minutes, up, color=COLOURS[model], lw=1.4)
        axis.axhline(0.0, color="#555555", lw=0.8)
        inside = 100.0 * float(np.mean(nees < 7.815))
        axis.set_title(f"{TITLES[model]}: truth inside in {inside:.0f} % of epochs", fontsize=9.5)
        axis.set_xlabel("minutes")
        axis.set_ylim(-6.0, 6.0)
        axis.set_xlim(0.0, 15.0)
        axis.spines[["top", "right"]].set_visible(False)
        print(f"{model:<8} 95 % ellipsoid holds the truth in {inside:5.1f} % of {len(nees)} epochs")
    axes[0].set_ylabel("height error and claimed 95 %, m")
    figure.savefig(output, metadata={"Date": None})
    print(output)


if __name__ == "__main__":
    main()
