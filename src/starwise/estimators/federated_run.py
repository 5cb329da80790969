"""Federated filter over the constellations of a run: local filters, isolation, master."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from starwise.config import RunConfig, parse_shares
from starwise.constants import (
    EPOCH_COASTED,
    EPOCH_NO_SOLUTION,
    EPOCH_OK,
    EPOCH_RESET,
    EPOCH_SUSPECT,
    ROW_EXCLUDED,
    ROW_USED,
)
from starwise.errors import StarwiseError
from starwise.estimators.federated_faults import CHUNK, Event, clock_events, in_order, isolate, satellite_events
from starwise.estimators.federated_local import Local, information_shares, make_locals, run_locals
from starwise.estimators.federated_master import beliefs, fuse
from starwise.estimators.least_squares import empty_epochs
from starwise.kernels.rangemodel import RowModel
from starwise.kernels.spp import EpochOut
from starwise.models.pseudorange import Prepared, empty_row_model
from starwise.types import F8, U1


def run_federated(prepared: Prepared, config: RunConfig) -> tuple[EpochOut, RowModel, list[Event]]:
    """Fused position and velocity, clocks of the local filters, and what was found faulty.

    Parameters
    ----------
    prepared : Prepared
    config : RunConfig
        ``share`` and what the filter takes; ``fde`` false: nobody is taken out.

    Returns
    -------
    EpochOut, RowModel
        Per epoch and per sighting; rows of a constellation that is out are ``excluded``.
    list of Event
        In the order of time.

    Raises
    ------
    StarwiseError
        No share for a constellation that is there.
    """
    made = make_locals(prepared, config, shares_of(prepared, config))
    run_locals(made, prepared, config)
    events: list[Event] = []
    use = np.ones((len(prepared.epochs.t_ns), len(made)), dtype=np.bool_)
    if config.fde:
        use, events = isolate(made, prepared.errors.floor)
        events += clock_events(made, use)
        for local in made:
            events += satellite_events(local)
    return _epochs(made, use, prepared), _rows(made, use, prepared), in_order(events)


def shares_of(prepared: Prepared, config: RunConfig) -> F8:
    """Shares of the constellations of a run, sum 1."""
    given = parse_shares(config.share)
    if given is None:
        return information_shares(prepared)
    missing = [name for name in prepared.clock_names if name not in given]
    if missing:
        raise StarwiseError(
            f"no share for {', '.join(missing)}", found=config.share, wanted=f"all of {' '.join(prepared.clock_names)}"
        )
    shares = np.array([given[name] for name in prepared.clock_names])
    return np.asarray(shares / shares.sum())


def _epochs(made: list[Local], use: NDArray[np.bool_], prepared: Prepared) -> EpochOut:
    m, K = use.shape
    ep = empty_epochs(m, K)
    floor = prepared.errors.floor**2 * np.eye(3)
    moving = made[0].numbers.process.nk > 3
    for first in range(0, m, CHUNK):
        end = min(first + CHUNK, m)
        x, P = fuse(beliefs(made, first, end), use[first:end])
        ep.pos[first:end], ep.cov_pos[first:end] = x[:, :3], P[:, :3, :3] + floor
        known = np.isfinite(x[:, :1])
        ep.vel[first:end] = x[:, 3:6] if moving else np.where(known, 0.0, np.nan)
        ep.cov_vel[first:end] = P[:, 3:6, 3:6] if moving else np.where(known[:, :, None], np.zeros((3, 3)), np.nan)
    counts = np.stack([np.where(use[:, k], local.ep.n_used, 0) for k, local in enumerate(made)], axis=1)
    for k, local in enumerate(made):
        ep.clock[:, k], ep.clock_var[:, k] = local.ep.clock[:, 0], local.ep.clock_var[:, 0]
        ep.drift[:, k] = local.ep.drift[:, 0]
    ep.n_used[:] = counts.sum(axis=1)
    sums = [np.where(use[:, k] & np.isfinite(local.ep.nis), local.ep.nis, 0.0) for k, local in enumerate(made)]
    ep.nis[:] = np.sum(sums, axis=0)
    ep.dof[:] = np.sum([np.where(use[:, k], local.ep.dof, 0) for k, local in enumerate(made)], axis=0)
    ep.rates[:] = np.max([local.ep.rates for local in made], axis=0)
    ep.status[:] = _status(made, use, ep, counts)
    _dops(made, use, ep.dop)
    return ep


def _status(made: list[Local], use: NDArray[np.bool_], ep: EpochOut, counts: F8) -> U1:
    """Of the fusion: as good as its best local filter; several that cannot check themselves check each other."""
    mine = np.stack([np.where(use[:, k], local.ep.status, EPOCH_NO_SOLUTION) for k, local in enumerate(made)], axis=1)
    sound = (mine == EPOCH_OK) | (mine == EPOCH_RESET)
    status = np.full(len(mine), EPOCH_SUSPECT, dtype=np.uint8)
    checked = sound.any(axis=1) | (ep.n_used > 3 + (counts > 0).sum(axis=1))
    certain = np.trace(ep.cov_pos, axis1=1, axis2=2) <= made[0].numbers.spp.max_sigma_m ** 2
    status[checked & certain] = EPOCH_OK
    there = mine != EPOCH_NO_SOLUTION
    status[(sound == (mine == EPOCH_RESET)).all(axis=1) & (mine == EPOCH_RESET).any(axis=1) & certain] = EPOCH_RESET
    status[(~there | (mine == EPOCH_COASTED)).all(axis=1)] = EPOCH_COASTED
    status[~there.any(axis=1)] = EPOCH_NO_SOLUTION
    return status


def _dops(made: list[Local], use: NDArray[np.bool_], dop: F8) -> None:
    """GDOP, PDOP, HDOP, VDOP of the used rows with one common clock, NaN below four satellites (Groves 9.4.3)."""
    m = len(use)
    N, count = np.zeros((m, 4, 4)), np.zeros(m, dtype=np.int64)
    for k, local in enumerate(made):
        epoch = np.repeat(np.arange(m), np.diff(local.epochs.offsets))
        at = np.flatnonzero((local.out.status == ROW_USED) & use[epoch, k])
        el, az = local.out.elevation[at], local.out.azimuth[at]
        h = np.stack([np.cos(el) * np.sin(az), np.cos(el) * np.cos(az), np.sin(el), np.ones(len(at))], axis=1)
        for i in range(4):
            for j in range(i, 4):
                N[:, i, j] += np.bincount(epoch[at], weights=h[:, i] * h[:, j], minlength=m)
                N[:, j, i] = N[:, i, j]
        count += np.bincount(epoch[at], minlength=m)
    some = (count >= 4) & (np.linalg.cond(N) < 1e12)
    Q = np.diagonal(np.linalg.inv(N[some]), axis1=1, axis2=2)
    sums = (Q.sum(axis=1), Q[:, :3].sum(axis=1), Q[:, :2].sum(axis=1), Q[:, 2])
    dop[some] = np.sqrt(np.stack(sums, axis=1))


def _rows(made: list[Local], use: NDArray[np.bool_], prepared: Prepared) -> RowModel:
    out = empty_row_model(len(prepared.rows.code_m))
    out.status[:] = prepared.rows.status
    for k, local in enumerate(made):
        targets: tuple[NDArray[Any], ...] = out
        for whole, part in zip(targets, local.out, strict=True):
            whole[local.at] = part
        epoch = np.repeat(np.arange(len(use)), np.diff(local.epochs.offsets))
        idle = ~use[epoch, k] & (local.out.status == ROW_USED)
        out.status[local.at[idle]] = ROW_EXCLUDED
        if len(prepared.error_rows.sv):
            for name in ("v2", "s2", "used"):
                getattr(prepared.error_rows, name)[local.at] = getattr(local.extra, name)
    return out
