"""Innovations too large or too small: R or Q, of which sensor, system and signal."""

import math
from typing import Final

import numpy as np

from starwise.analysis.lab.case import ALPHA, Case, num, off, scale_gain, times
from starwise.analysis.lab.checks import Family
from starwise.analysis.lab.checks_series import pooled_correlation
from starwise.analysis.lab.findings import Cause, Finding
from starwise.analysis.lab.moments import before_gate

NO_NOISE_SEEN: Final = 1e-3
"""Ratio of variances below which it has no figures: the estimate is at its end."""
UNEVEN: Final = 1.3
"""Ratio between sizes of groups above which they are told apart."""


def size_findings(case: Case) -> list[Finding]:
    """R and Q: too small or too large."""
    out: list[Finding] = []
    for kind in case.kinds:
        members = case.members(kind)
        out += _split(case, kind, members) if kind in case.parts else _by_signs(case, kind, members)
    return out


def _split(case: Case, kind: str, members: list[int]) -> list[Finding]:
    """Where it is known how much of each row is noise: whichever of noise and states explains more."""
    part = case.parts[kind]
    p_noise, p_state = case.adjusted("state", part.noise_p), case.adjusted("state", part.state_p)
    if part.gain_state > part.gain_noise and p_state < ALPHA:
        found = [_process(case, kind, part.state, p_state, part.gain_state)]
        if part.gain_both - part.gain_state > 10.0 and p_noise < ALPHA and off(part.noise):
            found += _noise(case, kind, members, part.noise, p_noise, part.gain_both - part.gain_state)
        return found
    if p_noise < ALPHA:
        return _noise(case, kind, members, part.noise, p_noise, part.gain_noise)
    return _single(case, kind, members)


def _by_signs(case: Case, kind: str, members: list[int]) -> list[Finding]:
    """Where it is not: the gain of the filter, too low or too high, shows in the sign of the correlation (Mehra 1970).

    Innovations that are too large and follow each other: the filter is too stiff, Q too small. Too large and
    alternating: it follows the noise, R too small. Too small: the other way round.
    """
    ratio, rows = case.ratio(members)
    p = case.smallest("size", members)
    if p >= ALPHA:
        return []
    rho, pairs = pooled_correlation(case.stats, members)
    t = float(np.nan_to_num(rho[0])) * math.sqrt(float(pairs[0]))
    if abs(t) > 4.0 and (ratio > 1.0) == (t > 0.0) and off(ratio):
        return [_process(case, kind, ratio, p, scale_gain(ratio, rows))]
    if abs(ratio - 1.0) > 0.02:
        return _noise(case, kind, members, ratio, p, scale_gain(ratio, rows))
    return _single(case, kind, members)


def _process(case: Case, kind: str, ratio: float, p: float, evidence: float) -> Finding:
    seen = {"code": "position and clock", "rate": "velocity and clock drift", "velocity": "velocity"}
    what = seen.get(kind, "position")
    if case.colored and kind == "code":
        what = "position, clock and lasting errors"
    words = f"The predicted variance of {what} is {times(ratio)}, seen by the innovations of {kind}."
    cure = (
        "Raise the process noise, or give what the filter holds fixed some freedom."
        if ratio > 1.0
        else "Lower the process noise: the filter forgets what it knows."
    )
    cause = Cause.Q_TOO_SMALL if ratio > 1.0 else Cause.Q_TOO_LARGE
    return Finding(cause, f"states by {kind}", ratio, "true / assumed variance", p, evidence, off(ratio), words, cure)


def _noise(case: Case, kind: str, members: list[int], ratio: float, p: float, evidence: float) -> list[Finding]:
    """One finding for a sensor, with the range where its groups differ; or for the few groups that are wrong."""
    groups = _groups(case, kind, members)
    ratios = {name: case.ratio(some) for name, some in groups.items()}
    wrong = {name: (r, n) for name, (r, n) in ratios.items() if off(r) and abs(math.log(r)) * math.sqrt(n / 2.0) > 4.0}
    if len(groups) > 1 and len(wrong) <= len(groups) // 2 and wrong:
        return [_noise_finding(case, name, r, p, scale_gain(r, n)) for name, (r, n) in wrong.items()]
    known = {name: r for name, (r, _) in ratios.items()}
    low, high = min(known, key=lambda k: known[k]), max(known, key=lambda k: known[k])
    if len(known) < 2 or known[high] < UNEVEN * known[low]:
        return [_noise_finding(case, kind, ratio, p, evidence)]
    ends = [(name, known[name] if ratio > 1.0 else 1.0 / known[name]) for name in (low, high)]
    span = "".join(f", {num(size)} x with {name.removesuffix(kind).strip()}" for name, size in ends)
    return [_noise_finding(case, kind, case.ratio(members)[0], p, evidence, span)]


def _groups(case: Case, kind: str, members: list[int]) -> dict[str, list[int]]:
    """Channels of a sensor by system and signal."""
    made: dict[str, list[int]] = {}
    for i in members:
        c = case.table.channels[i]
        made.setdefault(f"{c.system} {c.signal} {kind}".strip(), []).append(i)
    return made


def _noise_finding(case: Case, where: str, seen: float, p: float, evidence: float, span: str = "") -> Finding:
    ratio = before_gate(seen, case.table.gate_probability)
    words = f"R of {where} is {times(ratio)}{span} (variance)."
    if seen <= NO_NOISE_SEEN:
        words = f"R of {where} is too large: no noise of its own is seen beside the doubt about the states."
    factor = num(math.sqrt(ratio))
    cure = (
        f"Take its sigma {factor} times as large."
        if ratio > 1.0
        else f"Its sigma could be {'less' if seen <= NO_NOISE_SEEN else f'{factor} of what it is'}, if no error lasts: "
        "small innovations alone do not prove it."
    )
    cause = Cause.R_TOO_SMALL if ratio > 1.0 else Cause.R_TOO_LARGE
    return Finding(cause, where, ratio, "true / assumed variance", p, evidence, off(ratio), words, cure)


def _single(case: Case, kind: str, members: list[int]) -> list[Finding]:
    """Single channels and groups whose size is off while the sensor as a whole is right."""
    out = []
    for check in case.families["size"].tests:
        if not set(check.group) <= set(members) or len(check.group) == len(members):
            continue
        p = case.adjusted("size", check.p)
        if p < ALPHA:
            rows = float(case.stats.square_mean[list(check.group)].sum())
            size = max(check.statistic, 1e-12)
            out.append(_noise_finding(case, check.what, size, p, scale_gain(size, rows)))
    return sorted(out, key=lambda f: -f.evidence)[:3]


def epoch_findings(sizes: Family) -> list[Finding]:
    """What the NIS of whole epochs says: too large or too small, and nothing of the cause."""
    if sizes.p >= ALPHA:
        return []
    ratio = sizes.best.statistic
    words = f"NIS of the epochs is {num(ratio)} per degree of freedom: what is claimed is {times(ratio)} (variance)."
    cure = "R or Q: single innovations would tell which."
    cause = Cause.R_TOO_SMALL if ratio > 1.0 else Cause.R_TOO_LARGE
    return [Finding(cause, "epochs", ratio, "true / assumed variance", sizes.p, 0.0, off(ratio), words, cure)]
