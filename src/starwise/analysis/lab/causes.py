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
from dataclasses import dataclass
from typing import Final

import numpy as np

from starwise.analysis.lab.checks import (
    MIN_ROWS,
    Check,
    Family,
    Split,
    groups,
    pooled_correlation,
    refusals,
    state_correlation,
)
from starwise.analysis.lab.findings import Cause, Finding
from starwise.analysis.lab.innovations import UNITS, Innovations
from starwise.analysis.lab.moments import sidak
from starwise.analysis.lab.series import Series, correlation_time, effective_share

ALPHA: Final = 0.05
MATTERS_SCALE: Final = 1.25
"""Ratio of true to assumed variance, or its inverse, from which an error of R or Q matters: 12 % in sigma."""
MATTERS_RHO: Final = 0.15
MATTERS_BIAS: Final = 0.25
"""Of the claimed sigma of an innovation."""
UNEVEN: Final = 1.3
"""Ratio between the noise of groups above which they are named one by one."""


@dataclass(frozen=True)
class Case:
    """All that causes are decided on."""

    table: Innovations
    stats: Series
    families: dict[str, Family]
    parts: dict[str, Split]

    def adjusted(self, name: str, p: float) -> float:
        """P-value corrected for the tests of its family, and for the families."""
        own = self.families[name]
        tested = sum(1 for f in self.families.values() if f.tests)
        return float(sidak(float(sidak(p, max(len(own.tests), 1))), max(tested, 1)))

    def members(self, kind: str) -> list[int]:
        """Channels of a sensor with enough rows."""
        return [i for i, c in enumerate(self.table.channels) if c.kind == kind and self.stats.n[i] >= MIN_ROWS]

    @property
    def kinds(self) -> list[str]:
        """Sensors that have channels to be judged."""
        return [k for k in dict.fromkeys(c.kind for c in self.table.channels) if self.members(k)]


def scale_gain(ratio: float, n: float) -> float:
    """Log likelihood gained by n innovations when their variance is taken ``ratio`` times as large, at its best."""
    return 0.5 * n * (ratio - 1.0 - math.log(max(ratio, 1e-300)))


def find(case: Case) -> list[Finding]:
    """Causes found, the one with the most evidence first."""
    found = [
        *size_findings(case), *correlated_findings(case), *bias_findings(case), *tail_findings(case),
        *delay_findings(case), *cross_findings(case),
    ]  # fmt: skip
    return sorted(found, key=lambda f: (not f.matters, -f.evidence))


def size_findings(case: Case) -> list[Finding]:
    """R and Q: too small or too large."""
    out: list[Finding] = []
    for kind in case.kinds:
        members = case.members(kind)
        rows = float(case.stats.square_mean[members].sum())
        ratio = float(case.stats.square[members].sum()) / rows
        part = case.parts.get(kind)
        if part is not None:
            p_noise = case.adjusted("state", part.noise_p)
            p_state = case.adjusted("state", part.state_p)
            if part.gain_state > part.gain_noise and p_state < ALPHA:
                out.append(_process(case, kind, part.state, p_state, part.gain_state))
                continue
            if p_noise < ALPHA:
                out += _noise(case, kind, members, part.noise, p_noise, part.gain_noise)
                continue
        else:
            p = min((t.p for t in case.families["size"].tests if set(t.group) <= set(members)), default=1.0)
            p = case.adjusted("size", p)
            rho, pairs = pooled_correlation(case.stats, members)
            t = float(rho[0]) * math.sqrt(float(pairs[0])) if math.isfinite(float(rho[0])) else 0.0
            if p < ALPHA and abs(t) > 3.0 and (ratio > 1.0) == (t > 0.0):
                out.append(_process(case, kind, ratio, p, scale_gain(ratio, rows)))
                continue
            if p < ALPHA and abs(ratio - 1.0) > 0.02:
                out += _noise(case, kind, members, ratio, p, scale_gain(ratio, rows))
                continue
        out += _uneven(case, kind, members, ratio)
    return out


def _process(case: Case, kind: str, ratio: float, p: float, evidence: float) -> Finding:
    small = ratio > 1.0
    amount = f"{ratio if small else 1.0 / ratio:.2g} x too {'small' if small else 'large'}"
    what = {"code": "position and clock", "rate": "velocity and drift"}.get(kind, "states")
    words = f"The predicted uncertainty of {what} is {amount} in variance (seen by {kind})."
    cure = (
        "Raise the process noise (motion, clock), or free what the filter holds fixed."
        if small
        else "Lower the process noise: the filter forgets what it knows."
    )
    return Finding(
        Cause.Q_TOO_SMALL if small else Cause.Q_TOO_LARGE, f"states, by {kind}", ratio, "true / assumed variance", p,
        evidence, not 1.0 / MATTERS_SCALE < ratio < MATTERS_SCALE, words, cure, {"process": ratio},
    )  # fmt: skip


def _noise(case: Case, kind: str, members: list[int], ratio: float, p: float, evidence: float) -> list[Finding]:
    """One finding for a sensor, or one for each of its groups where they differ."""
    uneven = _by_group(case, kind, members)
    if not uneven:
        return [_noise_finding(kind, ratio, p, evidence)]
    out = []
    for name, some in uneven.items():
        rows = float(case.stats.square_mean[some].sum())
        own = float(case.stats.square[some].sum()) / rows
        if abs(math.log(own)) * math.sqrt(rows / 2.0) > 4.0:
            out.append(_noise_finding(name, own, p, scale_gain(own, rows)))
    return out or [_noise_finding(kind, ratio, p, evidence)]


def _by_group(case: Case, kind: str, members: list[int]) -> dict[str, list[int]]:
    """Groups by system and signal of a sensor whose noise differs by more than `UNEVEN`, and provably; else none."""
    made: dict[str, list[int]] = {}
    for i in members:
        c = case.table.channels[i]
        made.setdefault(f"{c.system} {c.signal} {kind}".strip(), []).append(i)
    if len(made) < 2:
        return {}
    logs, weights = [], []
    for some in made.values():
        rows = float(case.stats.square_mean[some].sum())
        logs.append(math.log(max(float(case.stats.square[some].sum()) / rows, 1e-12)))
        weights.append(rows / 2.0)
    mean = float(np.average(logs, weights=weights))
    far = [
        abs(x - mean) > math.log(UNEVEN) and abs(x - mean) * math.sqrt(w) > 4.0
        for x, w in zip(logs, weights, strict=True)
    ]
    return made if any(far) else {}


def _noise_finding(where: str, ratio: float, p: float, evidence: float) -> Finding:
    small = ratio > 1.0
    amount = f"{ratio if small else 1.0 / ratio:.2g} x too {'small' if small else 'large'}"
    words = f"R of {where} is {amount} (variance)."
    factor = math.sqrt(ratio)
    cure = (
        f"Take its sigma {factor:.2g} times as large."
        if small
        else f"Take its sigma {factor:.2g} times as large as it is."
    )
    return Finding(
        Cause.R_TOO_SMALL if small else Cause.R_TOO_LARGE, where, ratio, "true / assumed variance", p, evidence,
        not 1.0 / MATTERS_SCALE < ratio < MATTERS_SCALE, words, cure, {"sigma": factor},
    )  # fmt: skip


def _uneven(case: Case, kind: str, members: list[int], ratio: float) -> list[Finding]:
    """Single channels and groups whose size is off while the sensor as a whole is right."""
    out = []
    for check in case.families["size"].tests:
        if not set(check.group) <= set(members) or len(check.group) == len(members):
            continue
        p = case.adjusted("size", check.p)
        if p < ALPHA:
            rows = float(case.stats.square_mean[list(check.group)].sum())
            out.append(_noise_finding(check.what, check.statistic, p, scale_gain(check.statistic, rows)))
    return sorted(out, key=lambda f: -f.evidence)[:5]


def correlated_findings(case: Case) -> list[Finding]:
    """Errors that last: autocorrelation of rows as far as they are noise."""
    out: list[Finding] = []
    p_family = case.families["whiteness"]
    for kind in case.kinds:
        members = case.members(kind)
        p = min((t.p for t in p_family.tests if set(t.group) <= set(members)), default=1.0)
        p = case.adjusted("whiteness", p)
        if p >= ALPHA:
            continue
        rho, pairs = pooled_correlation(case.stats, members)
        each = [
            i for i in members
            if np.isfinite(case.stats.rho[i, 0]) and case.stats.rho[i, 0] * math.sqrt(case.stats.pairs[i, 0]) > 4.0
        ]  # fmt: skip
        t, noise_rho = state_correlation(case.table, kind, False)
        tau = correlation_time(rho, pairs, case.stats.lags, case.table.interval_s)
        if float(rho[0]) > 0.0 and t > 3.0:
            evidence = (
                0.5 * t * t if noise_rho < 0.5 else -0.5 * float(pairs[0]) * math.log(1.0 - min(noise_rho, 0.9999) ** 2)
            )
            few = (
                [i for i in each if case.stats.rho[i, 0] > 2.0 * abs(float(rho[0]))]
                if len(each) * 3 < len(members)
                else []
            )
            if few and len(few) <= 3:
                out += [
                    _correlated(case, case.table.channels[i].label, case.stats.rho[i], case.stats.pairs[i], p)
                    for i in few
                ]
            else:
                out.append(_correlated_words(kind, float(rho[0]), tau, p, evidence, len(each), len(members)))
    return out


def _correlated(case: Case, name: str, rho: np.ndarray, pairs: np.ndarray, p: float) -> Finding:
    tau = correlation_time(rho, pairs, case.stats.lags, case.table.interval_s)
    first = float(rho[0])
    return _correlated_words(
        name, first, tau, p, -0.5 * float(pairs[0]) * math.log(1.0 - min(first, 0.9999) ** 2), 1, 1
    )


def _correlated_words(where: str, rho: float, tau: float, p: float, evidence: float, some: int, many: int) -> Finding:
    lasts = f" for about {tau:.2g} s" if math.isfinite(tau) else ""
    share = f" ({some} of {many} channels)" if many > 1 else ""
    words = f"Innovations of {where} are correlated{lasts}{share}: {rho:.2f} from one epoch to the next."
    cure = (
        f"Model a Markov error of {0.5 * tau:.2g}-{2.0 * tau:.2g} s (error_model colored), or inflate R."
        if math.isfinite(tau)
        else "Model a Markov error, or inflate R."
    )
    return Finding(
        Cause.CORRELATED, where, tau, "s", p, evidence, rho > MATTERS_RHO, words, cure, {"error_model": "colored"}
    )


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
                {"exclude": [c.sv]} if c.sv else {},
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
    words = (
        f"{100.0 * share:.2g} % of the rows are outside the gate, {100.0 * case.table.gate_probability:.2g} % expected."
        if worst.what == "gate"
        else f"Innovations of {worst.what} have heavy tails: kurtosis {worst.statistic:.2g}, 3 of a normal distribution."
    )
    evidence = refused * math.log(max(refused / expected, 1.0)) - max(refused - expected, 0.0)
    return [
        Finding(
            Cause.HEAVY_TAILS, worst.what, worst.statistic, "kurtosis" if worst.what != "gate" else "share", p, evidence,
            share > 0.01 or (worst.what != "gate" and worst.statistic > 4.0), words,
            "Keep the gate, use robust weights (early_sigma, late_sigma), or a mask on C/N0 and elevation.",
        )
    ]  # fmt: skip


def _scatter_of_means(case: Case, kind: str) -> float:
    """Standard deviation of channel means where errors last in most channels (lasting errors have means); else 0."""
    members = case.members(kind)
    first = case.stats.rho[members, 0] * np.sqrt(case.stats.pairs[members, 0])
    if len(members) < 4 or not np.mean(first > 3.0) > 0.5:
        return 0.0
    means = case.stats.mean_z[members]
    return 1.4826 * float(np.median(np.abs(means - np.median(means))))


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
        # The gate cuts what it measures by: the size of all, out of that of the rows inside, by a few steps.
        true = ratio
        for _ in range(20):
            true = ratio / max(_kept(limit / true), 0.05)
        total += n * float(erfc(math.sqrt(0.5 * limit / true)))
        ours += n * probability
    trials, _ = refusals(case.table)
    return total / max(ours, 1e-300) * trials * probability


def _kept(limit: float) -> float:
    """Mean square of a standard normal inside a gate, over that inside the gate as modelled."""
    from scipy.special import chdtr

    return float(chdtr(3, limit) / max(chdtr(1, limit), 1e-300))


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
    words = f"Positions are {'late' if late else 'early'} by {abs(best.statistic):.2g} s: innovations go with changes of velocity."
    return [
        Finding(
            Cause.DELAY, "positions", best.statistic, "s", p, best.evidence, True, words,
            "Correct the time tags, or tell the filter the delay (available_ns of fixes; state time_offset).",
        )
    ]  # fmt: skip


def cross_findings(case: Case) -> list[Finding]:
    """Channels whose errors go together."""
    own = case.families["cross"]
    out: list[Finding] = []
    for check in sorted(own.tests, key=lambda c: c.p)[:3]:
        p = case.adjusted("cross", check.p)
        if p >= ALPHA:
            break
        words = f"Innovations of {check.what} go together: correlation {check.statistic:+.2f}."
        out.append(
            Finding(
                Cause.CROSS_CORRELATED, check.what, check.statistic, "correlation", p, 0.0,
                abs(check.statistic) > 0.2, words, "Something they have in common is not in the state.",
            )
        )  # fmt: skip
    return out


__all__ = ["ALPHA", "Case", "find", "groups"]
