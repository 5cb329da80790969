"""What EKF and S3EKF do beyond the paper: a bad start, another order, few satellites, a bad satellite."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

import numpy as np

from starwise.constants import NS, ROW_LOW_ELEVATION, ROW_USED
from starwise.estimators import ekf, s3ekf
from starwise.kernels.filter_epoch import linearise
from starwise.kernels.rangemodel import RowModel
from starwise.models.process import clocks_from, matrices
from starwise.models.pseudorange import empty_row_model
from starwise.signals import sv_name
from starwise.sim.scenario import load_scenario
from starwise.studies.s3ekf_filter import SCENARIOS, Method, paper_config, paper_motion, solve_paper
from starwise.studies.scene import Scene, Sky
from starwise.types import F8, I8, Layout, Linear, State

FORMS: Final[tuple[Method, ...]] = ("ekf", "s3ekf")
START_ERRORS_M: Final = (100e3, 1000e3)
Say = Callable[[float], None]


def robustness(seed: int | None = None, say: Say = lambda _: None) -> list[dict[str, Any]]:
    """All cases of both forms on run 0 of the scenarios.

    Returns
    -------
    list of dict
        ``case``, ``form`` and what came out, in metres and seconds.
    """
    scenes = {k: Scene(load_scenario(SCENARIOS[k - 1]), seed) for k in (1, 3)}
    still, turn = (scene.run(0, paper_config("s3ekf")) for scene in scenes.values())
    out: list[dict[str, Any]] = []
    for error in START_ERRORS_M:
        out += bad_start(still, error)
        say(len(out) / 30.0)
    out += other_orders(turn)
    for satellites in (3, 2, 0):
        out += few_satellites(turn, satellites, 65.0, "in the turn")
        out += few_satellites(turn, satellites, 130.0, "straight")
    out += bad_satellite(still)
    out += changing_sky(turn)
    say(1.0)
    return out


# -- a bad start ------------------------------------------------------------------------------------------------------
def bad_start(sky: Sky, error_m: float) -> list[dict[str, Any]]:
    """A start that is off by ``error_m`` and says so (1 sigma per axis): the literal equations and starwise's.

    ``literal``: eq. 2 and eq. 5, every row linearised once. ``relinearised``: the kernels, which do an update that
    moved the position by more than 20 m once more, linearised at its result. ``guarded``: restarts allowed, as in
    ``starwise solve``: more than 10 km of uncertainty means least squares.
    """
    nc = sky.n_clocks
    n = 9 + 2 * nc
    x0, sigma = np.zeros(n), np.concatenate([np.full(3, error_m), np.full(6, 1.0), np.full(nc, 1e5), np.full(nc, 1e3)])
    aside = np.random.default_rng(1).normal(size=3)
    x0[:3] = sky.pos_e[0] + error_m * aside / np.linalg.norm(aside)
    start = (x0, np.diag(sigma**2))
    table = []
    for form in FORMS:
        runs = {
            "literal": _literal(sky, form, start, 61),
            "relinearised": solve_paper(sky, form, start).pos,
            "guarded": solve_paper(sky, form, start, restarts=True).pos,
        }
        for variant, pos in runs.items():
            off = np.linalg.norm(pos - sky.pos_e[: len(pos)], axis=1)
            table.append(
                {
                    "case": f"start off by {error_m / 1e3:.0f} km",
                    "form": form,
                    "variant": variant,
                    "error_after_1_epoch_m": _number(off[0]),
                    "error_after_10_epochs_m": _number(off[9]),
                    "error_after_60_epochs_m": _number(off[60]),
                }
            )
    return table


def _literal(sky: Sky, form: Method, start: tuple[F8, F8], epochs: int) -> F8:
    """Positions by the equations of the paper as they stand, from the generic estimators, (epochs, 3)."""
    config = paper_config(form)
    motion, clocks, nc = paper_motion(), clocks_from(config), sky.n_clocks
    names = [*motion.names, *(f"clk.{k}" for k in range(nc)), *(f"drift.{k}" for k in range(nc))]
    state = State(int(sky.epochs.t_ns[0]), Layout(tuple(names)), start[0].copy(), start[1].copy())
    model = empty_row_model(len(sky.rows.code_m))
    model.troposphere[:], model.ionosphere[:] = 0.0, 0.0
    pos = np.empty((epochs, 3))

    def one_satellite(belief: State, i: int) -> Linear:
        return _linear(sky, model, belief.x, np.array([i], dtype=np.int64))

    for e in range(epochs):
        t = int(sky.epochs.t_ns[e])
        Phi, Q = matrices(motion, clocks, nc, (t - state.t_ns) / NS)
        state = ekf.predict(state, Phi, Q, t)
        rows = np.arange(sky.epochs.offsets[e], sky.epochs.offsets[e + 1])
        if form == "ekf":
            state, _ = ekf.update(state, _linear(sky, model, state.x, rows))
        else:
            state, _ = s3ekf.update(state, one_satellite, [int(i) for i in rows])
        pos[e] = state.x[:3]
    return pos


def _linear(sky: Sky, model: RowModel, x: F8, rows: I8) -> Linear:
    """Code and rate of satellites, linearised at a state."""
    v, H = np.empty(2 * len(rows)), np.zeros((2 * len(rows), len(x)))
    r = np.tile([sky.model.fixed_code_sigma_m**2, sky.model.fixed_rate_sigma_mps**2], len(rows))
    for k, i in enumerate(rows):
        c = 9 + int(sky.rows.clock[i])
        d = c + sky.n_clocks
        v[2 * k], v[2 * k + 1], ux, uy, uz, gx, gy, gz = linearise(sky.rows, model, int(i), x, True, c, d)
        H[2 * k, :3], H[2 * k, c] = (-ux, -uy, -uz), 1.0
        H[2 * k + 1, :3], H[2 * k + 1, 3:6], H[2 * k + 1, d] = (gx, gy, gz), (-ux, -uy, -uz), 1.0
    return Linear(v, H, r, np.repeat(rows, 2))


# -- order, few satellites, a bad one ---------------------------------------------------------------------------------
def other_orders(sky: Sky) -> list[dict[str, Any]]:
    """Satellites of every epoch in reverse and in random order: largest change of the position, m."""
    rng = np.random.default_rng(1)
    bounds = list(zip(sky.epochs.offsets[:-1], sky.epochs.offsets[1:], strict=True))
    orders = {
        "reversed": np.concatenate([np.arange(b - 1, a - 1, -1) for a, b in bounds]),
        "shuffled": np.concatenate([rng.permutation(np.arange(a, b)) for a, b in bounds]),
    }
    table = []
    for form in FORMS:
        given = solve_paper(sky, form).pos
        for name, order in orders.items():
            rows = type(sky.rows)(*(np.ascontiguousarray(column[order]) for column in sky.rows))
            changed = solve_paper(replace(sky, rows=rows, sv=sky.sv[order]), form).pos
            table.append(
                {"case": f"satellites {name}", "form": form, "largest_change_m": float(np.abs(changed - given).max())}
            )
    return table


def few_satellites(sky: Sky, satellites: int, start_s: float, where: str) -> list[dict[str, Any]]:
    """At most so many satellites for 30 s."""
    t_s = (sky.epochs.t_ns - sky.epochs.t_ns[0]) / NS
    inside = (t_s >= start_s) & (t_s < start_s + 30.0)
    status = sky.rows.status.copy()
    for e in np.flatnonzero(inside):
        status[sky.epochs.offsets[e] + satellites : sky.epochs.offsets[e + 1]] = ROW_LOW_ELEVATION
    poor = replace(sky, rows=sky.rows._replace(status=status))
    solved = {form: solve_paper(poor, form).pos for form in FORMS}
    apart = float(np.linalg.norm(solved["ekf"] - solved["s3ekf"], axis=1).max())
    after = np.flatnonzero(t_s >= start_s + 30.0)
    table = []
    for form in FORMS:
        off = np.linalg.norm(solved[form] - sky.pos_e, axis=1)
        late = after[off[after] > 10.0]
        table.append(
            {
                "case": f"{satellites} satellites for 30 s, {where}",
                "form": form,
                "error_before_m": _number(off[np.flatnonzero(inside)[0] - 1]),
                "largest_error_inside_m": _number(off[inside].max()),
                "first_error_after_m": _number(off[after[0]]),
                "seconds_until_below_10_m": float(t_s[late[-1]] - t_s[after[0]] + 1.0) if len(late) else 0.0,
                "ekf_to_s3ekf_m": apart,
            }
        )
    return table


def changing_sky(sky: Sky, period_s: float = 10.0) -> list[dict[str, Any]]:
    """Every 10 s another third of the satellites is missing: continuity where the sky changes.

    The jump is the largest change, from one epoch to the next, of the distance to the solution with all satellites.
    """
    t_s = (sky.epochs.t_ns - sky.epochs.t_ns[0]) / NS
    turn = (t_s // period_s).astype(np.int64)
    epoch = np.repeat(np.arange(len(t_s)), np.diff(sky.epochs.offsets))
    order = np.arange(len(epoch)) - sky.epochs.offsets[epoch]
    missing = (order + turn[epoch]) % 3 == 0
    status = np.where(missing, np.uint8(ROW_LOW_ELEVATION), sky.rows.status)
    changing = replace(sky, rows=sky.rows._replace(status=status))
    at_change, settled = np.diff(turn) != 0, t_s[1:] > 2.0 * period_s
    solved = {form: solve_paper(changing, form).pos for form in FORMS}
    table = []
    for form in FORMS:
        jump = np.linalg.norm(np.diff(solved[form] - solve_paper(sky, form).pos, axis=0), axis=1)
        table.append(
            {
                "case": f"another third of the satellites missing every {period_s:.0f} s",
                "form": form,
                "largest_jump_at_change_m": float(jump[at_change & settled].max()),
                "largest_jump_elsewhere_m": float(jump[~at_change & settled].max()),
                "largest_error_m": float(np.linalg.norm(solved[form] - sky.pos_e, axis=1)[1:][settled].max()),
                "ekf_to_s3ekf_m": float(np.linalg.norm(solved["ekf"] - solved["s3ekf"], axis=1).max()),
            }
        )
    return table


def bad_satellite(sky: Sky, step_m: float = 100.0, start_s: float = 100.0) -> list[dict[str, Any]]:
    """One satellite whose pseudorange steps by 100 m: without a gate, as in the paper, and with starwise's."""
    t_s = (sky.epochs.t_ns - sky.epochs.t_ns[0]) / NS
    epoch = np.repeat(np.arange(len(t_s)), np.diff(sky.epochs.offsets))
    first = int(np.searchsorted(t_s, start_s))
    sv = sky.sv[sky.epochs.offsets[first]]
    code = sky.rows.code_m + np.where((sky.sv == sv) & (t_s[epoch] >= start_s), step_m, 0.0)
    assert (sky.rows.status == ROW_USED).all()
    bad = replace(sky, rows=sky.rows._replace(code_m=code))
    table = []
    for gated, name in ((False, "no gate"), (True, "gate of starwise solve")):
        solved = {form: solve_paper(bad, form, gated=gated).pos for form in FORMS}
        clean = {form: solve_paper(sky, form, gated=gated).pos for form in FORMS}
        for form in FORMS:
            table.append(
                {
                    "case": f"{sv_name(int(sv))} steps by {step_m:.0f} m",
                    "form": form,
                    "variant": name,
                    "largest_shift_m": float(np.linalg.norm(solved[form] - clean[form], axis=1).max()),
                    "largest_error_m": _number(np.linalg.norm(solved[form] - sky.pos_e, axis=1)[first:].max()),
                    "ekf_to_s3ekf_m": float(np.linalg.norm(solved["ekf"] - solved["s3ekf"], axis=1).max()),
                }
            )
    return table


def _number(value: float) -> float | None:
    """For JSON: None where it is not finite."""
    return float(value) if np.isfinite(value) else None
