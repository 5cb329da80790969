"""Constellations named by a filter of all of them, whose clocks are one oscillator with slowly varying biases.

A ramp common to one constellation hides in that constellation's clock if the clock is its own. Tied, the clocks of all
constellations are predicted together (`starwise.models.process.Clocks`: an inter-system bias wanders by decimetres in
an hour), so that the codes of the faulty one leave what the others expect, all to the same side, and the gate refuses
them. Three satellites name it. It takes three constellations: of two, nothing says whose clock it is; and where half of
the constellations or more leave at once, it is the others.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from starwise.config import RunConfig
from starwise.constants import NS
from starwise.estimators.federated_faults import (
    CLOCK_DRIFT,
    CLOCK_JUMP,
    QUIET_S,
    Event,
    alarms,
    in_order,
    leaves,
    satellite_events,
)
from starwise.estimators.federated_local import Local, make_locals
from starwise.kernels.rangemodel import RowModel
from starwise.kernels.spp import EpochOut
from starwise.models.pseudorange import Prepared
from starwise.types import F8

LEAST_CONSTELLATIONS: Final = 3
SAME: Final = 0.3
"""A jump was not there the epoch before and is as large one epoch later, to within this part; a ramp grows."""


def constellation_views(prepared: Prepared, config: RunConfig, ep: EpochOut, out: RowModel) -> list[Local]:
    """Rows of every receiver clock, with what the filter of all made of them, in the form of local filters."""
    K = len(prepared.clock_names)
    made = make_locals(prepared, config, np.full(K, 1.0 / K))
    for local in made:
        targets: tuple[NDArray[Any], ...] = local.out
        sources: tuple[NDArray[Any], ...] = out
        for part, whole in zip(targets, sources, strict=True):
            part[...] = whole[local.at]
        local.ep.status[:] = ep.status
    return made


def tied_events(prepared: Prepared, config: RunConfig, ep: EpochOut, out: RowModel) -> list[Event]:
    """Satellites and constellations that leave the others in a filter of all, in the order of time.

    Parameters
    ----------
    prepared, config
        Of the run.
    ep, out
        As `starwise.estimators.filter.run_filter` left them.
    """
    made = constellation_views(prepared, config, ep, out)
    events = [event for local in made for event in satellite_events(local)]
    t_ns = prepared.epochs.t_ns
    left = np.stack([leaves(local) for local in made], axis=1) if made else np.zeros((len(t_ns), 0), dtype=np.bool_)
    seen = np.stack([np.diff(local.epochs.offsets) > 0 for local in made], axis=1).sum(axis=1) if made else 0 * t_ns
    sure = (seen >= LEAST_CONSTELLATIONS) & (2 * left.sum(axis=1) < seen)
    for k, local in enumerate(made):
        found, last = alarms(local), -np.inf
        for e in np.flatnonzero(left[:, k]).tolist():
            fresh = t_ns[e] - last > QUIET_S * NS
            last = t_ns[e] if sure[e] or not fresh else last
            if fresh and sure[e]:
                before, size, later = (_middle(found.size, at) for at in (e - 1, e, e + 1))
                jump = max(abs(before), abs(later - size)) <= SAME * abs(size)
                cause = CLOCK_JUMP if jump else CLOCK_DRIFT
                events.append(Event(int(t_ns[e]), local.name, None, cause, size))
    return in_order(events)


def _middle(size: F8, e: int) -> float:
    """Median innovation of the satellites seen in an epoch, m; before the first and after the last, that of these."""
    row = size[max(0, min(e, len(size) - 1))]
    row = row[row != 0.0]
    return float(np.median(row)) if len(row) else 0.0
