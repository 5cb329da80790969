"""Navigation records of several files into one table: sorted, duplicates dropped, contradictions settled."""

from dataclasses import fields

import numpy as np
from numpy.typing import NDArray

from starwise.io.nav_records import Mask, Records

DIGITS = 1e-9
"""Relative difference below which two numbers are the same one written with fewer digits (12 of them or more)."""


def concatenate(parts: list[Records]) -> Records:
    """All records of several parts, in order."""
    return Records(**{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Records)})


def take(records: Records, rows: NDArray[np.intp] | NDArray[np.bool_]) -> Records:
    """Some of the records."""
    return Records(**{f.name: getattr(records, f.name)[rows] for f in fields(Records)})


def merge(records: Records) -> tuple[Records, int, NDArray[np.intp]]:
    """Records sorted by satellite, reference time, message and transmission time, each once.

    Two records are *the same* when satellite, message, toc, toe, issue of data, health and all numbers agree: the one
    transmitted first is kept. They *contradict* each other when all but the numbers agree: the numbers that most
    copies have are kept, among equals those transmitted last (Galileo receivers join a new orbit with group delays
    that they have not received anew yet), then those read first. Records that differ in health or issue of data are
    different messages, and stay.

    Returns
    -------
    Records
    int
        Identical duplicates dropped.
    (n,) indices
        Records (of the argument) dropped because others contradicted them.
    """
    r = records
    key = np.lexsort((r.t_tx_ns, r.health, r.iode, r.toc_ns, r.message, r.toe_ns, r.sv))
    starts = np.ones(len(key), dtype=bool)
    for name in ("sv", "toe_ns", "message", "toc_ns", "iode", "health"):
        column = getattr(r, name)[key]
        starts[1:] &= column[1:] == column[:-1]
    starts[1:] = ~starts[1:]
    group = np.cumsum(starts) - 1
    first = np.flatnonzero(starts)  # of every group of copies, in key order
    copies = np.flatnonzero(~starts)
    alike = np.ones(len(key), dtype=bool)
    alike[copies] = _alike(r, key[copies], key[first[group[copies]]])
    keep = starts.copy()
    contradicted: list[int] = []
    for g in np.unique(group[~alike]):
        members = np.flatnonzero(group == g)
        winner, losers = _vote(r, key, members)
        keep[members] = False
        keep[winner] = True
        contradicted += losers
    duplicates = len(key) - int(keep.sum()) - len(contradicted)
    order = key[keep]
    return take(records, order), duplicates, np.array(contradicted, dtype=np.intp)


def _alike(r: Records, a: NDArray[np.intp], b: NDArray[np.intp]) -> Mask:
    """Whether the numbers of records ``a`` and ``b`` agree, row by row."""
    rows_a = np.concatenate([r.par[a], r.tgd[a], r.accuracy_m[a, None]], axis=1)
    rows_b = np.concatenate([r.par[b], r.tgd[b], r.accuracy_m[b, None]], axis=1)
    with np.errstate(invalid="ignore"):
        near = np.abs(rows_a - rows_b) <= DIGITS * np.maximum(np.abs(rows_a), np.abs(rows_b))
    near |= (rows_a == rows_b) | np.isnan(rows_a) | np.isnan(rows_b)  # a blank contradicts nothing
    together: Mask = np.logical_and.reduce(near, axis=1)
    return together


def _vote(r: Records, key: NDArray[np.intp], members: NDArray[np.intp]) -> tuple[int, list[int]]:
    """Position of the winner of a group, and the records that lose."""
    classes: list[list[int]] = []
    for m in members:
        for c in classes:
            if _alike(r, key[[m]], key[[c[0]]])[0]:
                c.append(int(m))
                break
        else:
            classes.append([int(m)])
    best = max(classes, key=lambda c: (len(c), max(int(r.t_tx_ns[key[m]]) for m in c), -min(int(key[m]) for m in c)))
    losers = [int(key[m]) for c in classes if c is not best for m in c]
    return best[0], losers
