"""Which cause makes innovations what they are: decided by what tells the causes apart.

| cause | size | autocorrelation | where |
|---|---|---|---|
| R wrong | off in every row, as far as the row is noise | none | differs by signal and satellite |
| Q wrong | off in rows as far as they are doubt about the states | of the states: positive if too stiff | all alike |
| lasting errors | near one or below | positive, each satellite by itself | rows of pure noise, too |
| bias | | none beside the mean | one satellite's mean |
| late fix | | | goes with changes of the velocity |
| heavy tails | | | rows outside the gate, kurtosis |
"""

import math
from dataclasses import replace
from typing import Final

import numpy as np

from starwise.analysis.lab.case import ALPHA, MATTERS_SCALE, Case, num
from starwise.analysis.lab.causes_size import size_findings
from starwise.analysis.lab.checks import MIN_ROWS, Check
from starwise.analysis.lab.checks_series import pooled_correlation, refusals, state_correlation
from starwise.analysis.lab.findings import Cause, Finding
from starwise.analysis.lab.innovations import UNITS
from starwise.analysis.lab.moments import before_gate
from starwise.analysis.lab.series import correlation_time, effective_share
from starwise.types import F8

MATTERS_RHO: Final = 0.05
MATTERS_BIAS: Final = 0.25
"""Of the claimed sigma of an innovation."""
ONE_EPOCH: Final = "A position of one epoch does not mind; a filter, or a mean of positions, must know it."
ONE_MEAN: Final = 0.5
"""Part of the squares of all channel means that one of them has if it is one channel's bias."""
MATTERS_DELAY: Final = 0.01
"""Of the variance of the innovations, explained by changes of the velocity."""
ONE_SIDE: Final = 0.8
"""Mean sign of rows outside the gate from which they are off to one side."""
LASTING_MEANS: Final = 4.0
"""Median of channel means, in their standard deviations, from which lasting errors are meant, not single biases."""
SAFE: Final = frozenset({Cause.R_TOO_LARGE, Cause.Q_TOO_LARGE, Cause.MODEST})
"""Causes by which a filter claims less than it knows: blunt, not wrong."""
RANK: Final = {
    Cause.OVERCONFIDENT: 1, Cause.LOST: 1, Cause.R_TOO_LARGE: 2, Cause.Q_TOO_LARGE: 2, Cause.MODEST: 3,
    Cause.CROSS_CORRELATED: 4,
}  # fmt: skip
"""Order in which findings are told: causes by which a covariance is too small (0), that it is too small or the filter
lost, causes by which it is too large, that it is, and what is a symptom of any of them."""
MANY_REFUSED: Final = 0.1
"""Part of the rows outside the gate from which they are no tails, if the rows inside are too large as well."""
FAR_TOO_LARGE: Final = 2.0
"""Ratio of true to assumed variance that explains so many."""


def find(case: Case) -> list[Finding]:
    """Causes found, the one with the most evidence first."""
    means = {f.where: f for f in bias_findings(case)}
    tails = []
    for f in tail_findings(case):  # a satellite that the gate refuses: its mean is told with the rows refused
        mean = means.pop(f.where, None) if f.cause is Cause.BIAS else None
        tails.append(f if mean is None else replace(f, evidence=max(f.evidence, mean.evidence)))
    found = [*size_findings(case), *correlated_findings(case), *means.values(), *tails, *delay_findings(case)]
    found = _too_many_for_tails(case, _not_both(case, found))
    late = next((f for f in found if f.cause is Cause.DELAY), None)
    if late is not None and late.matters:
        # What goes with changes of the velocity to this extent is no chance, and makes all else look wrong, too.
        most = max((f.evidence for f in found if f.cause not in SAFE), default=0.0)
        if late.evidence > 0.2 * most:
            found = [replace(f, evidence=most + 1.0) if f is late else f for f in found]
    return ranked([*found, *cross_findings(case, any(f.matters for f in found))])


def _not_both(case: Case, found: list[Finding]) -> list[Finding]:
    """A sensor whose errors last so that their sum is more than is claimed has no R too large, small as its rows are.

    "Inflate R" and "R is too large" would be said of the same rows.
    """
    lasting = {f.where for f in found if f.cause is Cause.CORRELATED and f.matters}
    kinds = {kind for kind in case.kinds if kind in lasting}
    safe = {f.where for f in found if f.cause is Cause.R_TOO_LARGE and f.where.rpartition(" ")[2] in kinds}
    return [replace(f, matters=False) if f.cause is Cause.R_TOO_LARGE and f.where in safe else f for f in found]


def _too_many_for_tails(case: Case, found: list[Finding]) -> list[Finding]:
    """Where R or Q is far too small the gate refuses rows by the dozen: that is what follows, not another cause."""
    trials, refused = refusals(case.table)
    far = [f for f in found if f.cause in (Cause.R_TOO_SMALL, Cause.Q_TOO_SMALL) and f.size > FAR_TOO_LARGE]
    if not far or refused < MANY_REFUSED * trials:
        return found
    cure = "So many are no outliers: mend the sizes first."
    return [replace(f, evidence=0.0, cure=cure) if f.cause is Cause.HEAVY_TAILS else f for f in found]


def ranked(found: list[Finding]) -> list[Finding]:
    """Findings that matter first; of them those that make a covariance too small; then by evidence."""
    return sorted(found, key=lambda f: (not f.matters, RANK.get(f.cause, 0), -f.evidence))


def correlated_findings(case: Case) -> list[Finding]:
    """Errors that last: autocorrelation of rows as far as they are noise."""
    out: list[Finding] = []
    for kind in case.kinds:
        members = case.members(kind)
        p = case.smallest("whiteness", members)
        means = _means(case, members)
        one = float((means**2).max()) > ONE_MEAN * float((means**2).sum())  # a bias, of which all others have a part
        if len(members) >= 4 and not one and float(np.median(np.abs(means))) > LASTING_MEANS:
            out.append(_lasting(case, kind, members, means))
            continue
        if p >= ALPHA:
            continue
        first = case.first_lags(members)
        some = [i for i, t in zip(members, first, strict=True) if t > 4.0]
        t, noise_rho = state_correlation(case.table, kind, False)
        if len(some) >= len(members) / 3 or (t > 4.0 and len(some) > 3):
            if t > 3.0:
                evidence = max(0.5 * t * t, _gain(noise_rho, float(case.stats.pairs[members, 0].sum())))
                rho, pairs = pooled_correlation(case.stats, members)
                out.append(_correlated(case, kind, members, rho, pairs, p, evidence, len(some)))
        else:
            for i in some[:3]:
                rho, pairs = case.stats.rho[i], case.stats.pairs[i]
                name = case.table.channels[i].label
                out.append(_correlated(case, name, [i], rho, pairs, p, _gain(float(rho[0]), float(pairs[0])), 1))
    return out


def _means(case: Case, members: list[int]) -> F8:
    """Means of channels in their standard deviations, as the scatter about each mean gives them."""
    stats = case.stats
    spread = np.maximum(stats.square[members] / stats.n[members] - stats.mean_z[members] ** 2, 1e-12)
    return np.asarray(stats.mean_z[members] * np.sqrt(stats.n[members] / spread))


def _lasting(case: Case, kind: str, members: list[int], means: F8) -> Finding:
    """Errors that last longer than satellites are seen: most channels have a mean of their own."""
    stats = case.stats
    n = stats.n[members].astype(np.float64)
    long_run = float(np.average(stats.mean_z[members] ** 2 * n + stats.nis[members], weights=n))
    evidence = 0.5 * float((means**2).sum())
    common = float(np.median(stats.mean_z[members]))
    if abs(common) > 3.0 * max(_scatter(stats.mean_z[members]), 1.0 / math.sqrt(float(np.median(n)))):
        return _common(case, kind, members, common, evidence)
    words = f"Most channels of {kind} have a mean of their own: errors last longer than a satellite is seen."
    cure = "Give each satellite an error state of an hour or more (error_model colored), or inflate R"
    cure += f" {num(long_run)} x."
    if case.colored:
        cure = "Error states are there: longer or larger ones ([errors]), or an error that is not in them."
    if long_run <= MATTERS_SCALE:
        cure = "Harmless here: they are so small that even their sum is within what is claimed."
    if case.memoryless:
        cure = ONE_EPOCH
    seen = float(np.median(n)) * case.table.interval_s
    matters = long_run > MATTERS_SCALE and not case.memoryless
    return Finding(Cause.CORRELATED, kind, seen, "s", 0.0, evidence, matters, words, cure)


def _scatter(means: F8) -> float:
    """Standard deviation of channel means, whatever a few of them are."""
    return 1.4826 * float(np.median(np.abs(means - np.median(means))))


def _common(case: Case, kind: str, members: list[int], mean_z: float, evidence: float) -> Finding:
    """Channels that are all off by about the same: not their own errors, but what they share."""
    size = float(np.median(case.stats.bias[members]))
    words = f"All channels of {kind} are off by about the same: mean innovation {size:+.2g} {UNITS[kind]}."
    cure = "Something they share lags or is not in the state: a clock, a bias of the sensor, a sign."
    return Finding(Cause.BIAS, kind, size, UNITS[kind], 0.0, evidence, abs(mean_z) > MATTERS_BIAS, words, cure)


def _gain(rho: float, pairs: float) -> float:
    """Log likelihood gained by an autoregression of first order."""
    return -0.5 * pairs * math.log(1.0 - min(abs(rho), 0.9999) ** 2)


def _correlated(
    case: Case, where: str, members: list[int], rho: F8, pairs: F8, p: float, evidence: float, some: int
) -> Finding:
    """Correlated innovations; they matter as far as their sum varies by more than the filter claims."""
    tau = correlation_time(rho, pairs, case.stats.lags, case.table.interval_s)
    ratio, _ = case.ratio(members)
    long_run = ratio / effective_share(rho, case.stats.lags)
    lasts = f" for {num(tau)} s" if tau > case.table.interval_s else ""
    share = f" ({some} of {len(members)} channels)" if len(members) > 1 else ""
    words = f"Innovations of {where} are correlated{lasts}{share}: {rho[0]:.2f} from one epoch to the next."
    cure = f"Model a Markov error of {num(0.5 * tau)}-{num(2.0 * tau)} s (error_model colored), or inflate R"
    cure += f" {num(long_run)} x."
    if case.colored:
        cure = f"Error states are there, but do not hold this: one of {num(0.5 * tau)}-{num(2.0 * tau)} s ([errors])."
    if long_run <= 1.0:
        cure = "Harmless here: they are so small that even their sum is within what is claimed."
    if case.memoryless:
        cure = ONE_EPOCH
    matters = float(rho[0]) > MATTERS_RHO and long_run > MATTERS_SCALE and not case.memoryless
    return Finding(Cause.CORRELATED, where, tau, "s", p, evidence, matters, words, cure)


def bias_findings(case: Case) -> list[Finding]:
    """Means that are not zero, with the rows that count when errors last."""
    out: list[Finding] = []
    kind_of = [c.kind for c in case.table.channels]
    others = {kind: _scatter_of_means(case, kind) for kind in case.kinds}
    for check in case.families["bias"].tests:
        if case.adjusted("bias", check.p) >= ALPHA:
            continue
        i = check.group[0]
        stats, n = case.stats, float(case.stats.n[i])
        t1 = float(stats.rho[i, 0]) * math.sqrt(float(stats.pairs[i, 0]))
        share = effective_share(stats.rho[i], stats.lags) if t1 > 3.0 else 1.0
        spread = max(float(stats.nis[i]) - float(stats.mean_z[i]) ** 2, 1e-12)
        t = float(stats.mean_z[i]) / math.hypot(math.sqrt(spread / (n * share)), others[kind_of[i]])
        p = case.adjusted("bias", math.erfc(abs(t) / math.sqrt(2.0)))
        if p >= ALPHA:
            continue
        c = case.table.channels[i]
        words = f"{c.label}: mean innovation {float(stats.bias[i]):+.2g} {UNITS[c.kind]}."
        out.append(
            Finding(
                Cause.BIAS, c.label, float(stats.bias[i]), UNITS[c.kind], p, 0.5 * t * t,
                abs(float(stats.mean_z[i])) > MATTERS_BIAS, words, f"Leave {c.sv} out, or estimate its bias.",
                            )
        )  # fmt: skip
    return sorted(out, key=lambda f: -f.evidence)[:8]


def tail_findings(case: Case) -> list[Finding]:
    """More large innovations than a normal distribution has, of whatever size it is."""
    own = case.families["tails"]
    bad = [
        check for check in own.tests
        if case.adjusted("tails", check.p) < ALPHA and (check.what == "gate" or check.statistic > 3.0)
    ]  # fmt: skip
    if not bad:
        return []
    trials, refused = refusals(case.table)
    worst = min(bad, key=lambda check: check.p)
    share = refused / max(trials, 1)
    p = case.adjusted("tails", worst.p)
    expected = max(expected_refusals(case), 0.5)
    if worst.what == "gate" and refused < 2.0 * expected:
        return []  # the size of the rest explains them
    gate = worst.what == "gate"
    if gate and (alone := _refused_satellite(case, p, refused, expected)) is not None:
        return [alone]
    words = f"Innovations of {worst.what} have heavy tails: kurtosis {worst.statistic:.2g}, 3 if normal."
    matters = share > 0.01 or (not gate and worst.statistic > 4.0 and case.ratio(list(worst.group))[0] > 0.5)
    if gate:
        nominal = 100.0 * case.table.gate_probability
        words = f"{100.0 * share:.2g} % of the rows are outside the gate, {nominal:.2g} % expected."
    evidence = refused * math.log(max(refused / expected, 1.0)) - max(refused - expected, 0.0)
    cure = "Keep the gate, use robust weights (early_sigma, late_sigma), or a mask on C/N0 and elevation."
    unit = "share" if gate else "kurtosis"
    return [Finding(Cause.HEAVY_TAILS, worst.what, worst.statistic, unit, p, evidence, matters, words, cure)]


def _refused_satellite(case: Case, p: float, refused: int, expected: float) -> Finding | None:
    """The satellite of which most rows outside the gate are, all to one side: a bias, and no tails; or None."""
    table = case.table
    names = sorted({c.sv for c in table.channels if c.sv})
    if len(names) < 4:
        return None
    place = np.array([names.index(c.sv) if c.sv else len(names) for c in table.channels])[table.channel]
    out = np.bincount(place[~table.used], minlength=len(names) + 1)[:-1]
    rows = np.bincount(place, minlength=len(names) + 1)[:-1]
    worst = int(np.argmax(out))
    rest = (out.sum() - out[worst]) / max(rows.sum() - rows[worst], 1)
    if out[worst] < MIN_ROWS or 2 * out[worst] < out.sum() or rest > 0.2 * out[worst] / rows[worst]:
        return None
    here = ~table.used & (place == worst)
    channel = int(np.argmax(np.bincount(table.channel[here], minlength=len(table.channels))))
    own = table.channel == channel
    if abs(float(np.sign(table.v[own & here]).mean())) < ONE_SIDE:
        return None
    c, size = table.channels[channel], float(table.v[own].mean())
    share = 100.0 * float(np.mean(~table.used[own]))
    words = f"{c.label}: mean innovation {size:+.2g} {UNITS[c.kind]}, and {share:.0f} % of its rows outside the gate."
    evidence = refused * math.log(max(refused / expected, 1.0)) - max(refused - expected, 0.0)
    return Finding(
        Cause.BIAS, c.label, size, UNITS[c.kind], p, evidence, True, words, f"Leave {c.sv} out, or estimate its bias."
    )


def _scatter_of_means(case: Case, kind: str) -> float:
    """Standard deviation of channel means where errors last in most channels (lasting errors have means); else 0."""
    members = case.members(kind)
    first = case.stats.rho[members, 0] * np.sqrt(case.stats.pairs[members, 0])
    far = np.abs(_means(case, members))
    if len(members) < 4 or not (np.mean(first > 3.0) > 0.5 or float(np.median(far)) > LASTING_MEANS):
        return 0.0
    return _scatter(case.stats.mean_z[members])


def expected_refusals(case: Case) -> float:
    """Rows outside the gate if innovations are normal with the size that those inside it have."""
    from scipy.special import chdtri, erfc

    probability = case.table.gate_probability
    if probability == 0.0:
        return 0.0
    total, ours = 0.0, 0.0
    for kind in case.kinds:
        members = case.members(kind)
        n = float(case.stats.n[members].sum() + case.stats.refused[members].sum())
        ratio = float(case.stats.square[members].sum() / case.stats.square_mean[members].sum())
        limit = float(chdtri(1, probability))
        total += n * float(erfc(math.sqrt(0.5 * limit / before_gate(ratio, probability))))
        ours += n * probability
    trials, _ = refusals(case.table)
    return total / max(ours, 1e-300) * trials * probability


def delay_findings(case: Case) -> list[Finding]:
    """Positions that are late against what predicts them."""
    own = case.families["delay"]
    if not own.tests:
        return []
    best: Check = own.best
    p = case.adjusted("delay", best.p)
    if p >= ALPHA:
        return []
    late = best.statistic > 0.0
    said = f"{'late' if late else 'early'} by {num(abs(best.statistic))} s"
    words = f"Positions are {said}: innovations go with changes of velocity."
    cure = "Correct the time tags, or tell the filter the delay (available_ns of fixes; state time_offset)."
    rows = sum(int(case.stats.n[case.members(kind)].sum()) for kind in ("code", "position"))
    matters = 2.0 * best.evidence > MATTERS_DELAY * max(rows, 1)
    return [Finding(Cause.DELAY, "positions", best.statistic, "s", p, best.evidence, matters, words, cure)]


def cross_findings(case: Case, explained: bool) -> list[Finding]:
    """Channels whose errors go together: a cause by itself only where no other is found."""
    own = case.families["cross"]
    out: list[Finding] = []
    for check in sorted(own.tests, key=lambda c: c.p)[:3]:
        p = case.adjusted("cross", check.p)
        if p >= ALPHA:
            break
        words = f"Innovations of {check.what} go together: correlation {check.statistic:+.2f}."
        cure = "Something they have in common is not in the state."
        matters = abs(check.statistic) > 0.2 and not explained
        cause = Cause.CROSS_CORRELATED
        out.append(Finding(cause, check.what, check.statistic, "correlation", p, 0.0, matters, words, cure))
    return out
