"""Navigation records of several files into one table: sorted, duplicates dropped, contradictions settled."""

from dataclasses import fields

import numpy as np
from numpy.typing import NDArray

from starwise.io.nav_records import Records

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
    same = np.ones(max(len(key) - 1, 0), dtype=bool)
    for name in ("sv", "toe_ns", "message", "toc_ns", "iode", "health"):
        column = getattr(r, name)[key]
        same &= column[1:] == column[:-1]
    group = np.concatenate([[0], np.cumsum(~same)]).astype(np.int64)[: len(key)]
    keep = np.ones(len(key), dtype=bool)
    first = np.flatnonzero(np.concatenate([[True], ~same])[: len(key)])  # start of every group, in key order
    alike = _alike(r, key, key[first[group]]) if len(key) else np.zeros(0, dtype=bool)
    starts = np.zeros(len(key), dtype=bool)
    starts[first] = True
    keep[alike & ~starts] = False
    duplicates = int((~keep).sum())
    contradicted: list[int] = []
    for g in np.unique(group[~alike]):
        members = np.flatnonzero(group == g)
        winner, copies, losers = _vote(r, key, members)
        keep[members] = False
        keep[winner] = True
        duplicates += copies - 1 - int((alike[members] & ~starts[members]).sum())
        contradicted += losers
    order = key[keep]
    return take(records, order), duplicates, np.array(contradicted, dtype=np.intp)


def _alike(r: Records, a: NDArray[np.intp], b: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Whether the numbers of records ``a`` and ``b`` agree, row by row."""
    good = _close(r.par[a], r.par[b]).all(axis=1) & _close(r.tgd[a], r.tgd[b]).all(axis=1)
    return good & _close(r.accuracy_m[a], r.accuracy_m[b])


def _close(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.bool_]:
    with np.errstate(invalid="ignore"):
        near = np.abs(a - b) <= DIGITS * np.maximum(np.abs(a), np.abs(b))
    return near | (a == b) | np.isnan(a) | np.isnan(b)  # a blank contradicts nothing


def _vote(r: Records, key: NDArray[np.intp], members: NDArray[np.intp]) -> tuple[int, int, list[int]]:
    """Position of the winner of a group, copies of it, and the records that lose."""
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
    return best[0], len(best), losers
