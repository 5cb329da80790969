"""Adaptation rules: one interface, what each does, and that none breaks a filter."""

from dataclasses import replace

import numpy as np
import pytest

from starwise.errors import StarwiseError
from starwise.estimators import ekf
from starwise.estimators.adaptive import RULES, Adaptation, factors, step
from starwise.estimators.adaptive_fixes import KALMAN, LITERAL, literal_filter
from starwise.kernels.adapt import REJECTED
from starwise.kernels.adapt_run import adaptive_run
from starwise.studies.adaptive_federated_rules import CASES, _fixes
from starwise.types import Layout, Linear, State

LAYOUT = Layout(("pos.x", "vel.x"))
PHI = np.array([[1.0, 1.0], [0.0, 1.0]])
Q = 0.1 * np.array([[1 / 3, 0.5], [0.5, 1.0]])


def scalar(rule, values, p=4.0, q=1.0, r=9.0, beta=0.0):
    """Factors of a series of single innovations."""
    memory, out = rule.fresh(), []
    for v in values:
        found, r_out, memory = factors(rule, memory, np.array([v]), np.array([p]), np.array([q]), np.array([r]), beta)
        out.append((found.fading, found.q_factor, r_out[0]))
    return np.array(out)


@pytest.mark.golden
def test_fading_by_hand():
    """Eq. 12-20 of Sun et al. 2009 for one measurement: C_0 = v^2 / 2, then lambda v^2 / (1 + lambda)."""
    rule = Adaptation("paper", alpha=4.0, weight=500.0, limit=100.0, most=1e9)
    first = max(1.0, 4.0 * (0.5 * 81.0 - 10.0) / 4.0)
    second = max(1.0, 4.0 * (500.0 * first * 400.0 / (1.0 + first) - 10.0) / 4.0)
    third = max(1.0, 4.0 * (second * 1.0 / (1.0 + second) - 10.0) / 4.0)
    assert scalar(rule, [9.0, 20.0, 1.0])[:, 0] == pytest.approx([first, second, third])
    assert third == 1.0
    assert scalar(rule, [0.0], beta=30.0)[0, 0] == pytest.approx(4.0 * (30.0 - 10.0) / 4.0)


def test_fading_with_a_certain_start_does_not_divide_by_zero():
    assert scalar(RULES["fading_improved"], [50.0], p=0.0)[0, 0] == 1.0


def test_strong_tracking_by_hand():
    rule = Adaptation("strong_tracking", memory=0.95, softening=2.0, most=1e9)
    V1 = 100.0
    V2 = (0.95 * V1 + 400.0) / 1.95
    want = [max(1.0, (V - 1.0 - 18.0) / 4.0) for V in (V1, V2)]
    assert scalar(rule, [10.0, 20.0])[:, 0] == pytest.approx(want)


@pytest.mark.parametrize("name", ["iae_r", "sage_husa_r"])
@pytest.mark.parametrize("truth", [0.3, 1.0, 4.0])
def test_measurement_noise_is_found(name, truth):
    rng = np.random.default_rng(1)
    v = rng.standard_normal(4000) * np.sqrt(4.0 + 1.0 + truth * 9.0)
    found = scalar(RULES[name], v)[1000:, 2].mean() / 9.0
    assert found == pytest.approx(truth, rel=0.15)


@pytest.mark.parametrize("name", ["iae_q", "sage_husa_q"])
def test_process_noise_is_found(name):
    rng = np.random.default_rng(2)
    v = rng.standard_normal(4000) * np.sqrt(4.0 + 30.0 * 1.0 + 9.0)
    assert scalar(RULES[name], v)[1000:, 1].mean() == pytest.approx(30.0, rel=0.2)


@pytest.mark.parametrize("name", list(RULES))
def test_no_rule_makes_a_covariance_indefinite(name):
    """Any innovations, also absurd ones, none, and none at all: factors stay finite and positive."""
    rule = RULES[name]
    rng = np.random.default_rng(3)
    memory = rule.fresh()
    for k in range(300):
        v = rng.standard_normal(5) * 10.0 ** rng.uniform(-8.0, 8.0)
        if k % 7 == 0:
            v[:] = np.nan
        p = np.full(5, 10.0 ** rng.uniform(-12.0, 6.0))
        found, r, memory = factors(rule, memory, v, p, p * rng.random(), np.full(5, 4.0))
        assert found.fading >= 1.0
        assert found.q_factor > 0.0
        assert np.isfinite([found.fading, found.q_factor]).all()
        assert (r > 0.0).all()
        assert np.isfinite(r).all()


def test_robust_weights():
    v = np.array([0.5, 2.0, 3.9, 1e6])
    one = np.ones(4)
    for name, c in (("huber", 1.345), ("igg3", 1.5)):
        _, r, _ = factors(RULES[name], RULES[name].fresh(), v, 0.0 * one, 0.0 * one, one)
        assert r[0] == 1.0
        if name == "huber":
            assert r[1:] == pytest.approx(v[1:] / c)
        else:
            assert r[1] == pytest.approx(2.0 / c / ((4.0 - 2.0) / (4.0 - c)) ** 2)
            assert r[3] == pytest.approx(REJECTED)


def test_robust_rules_believe_measurements_that_agree():
    """Everything far off for a third epoch: it is the prediction that is wrong."""
    rule, memory = RULES["igg3"], RULES["igg3"].fresh()
    one = np.ones(6)
    used = []
    for _ in range(5):
        _, r, memory = factors(rule, memory, 50.0 * one, one, 0.0 * one, one)
        used.append(r[0] == 1.0)
    assert used == [False, False, True, True, True]


def line(rng, n, jump=None):
    """Positions of two receivers on a line; ``jump``: the motion changes there."""
    x = 3.0 * np.arange(n) + (0.0 if jump is None else np.where(np.arange(n) > jump, 20.0 * (np.arange(n) - jump), 0.0))
    return x, x[:, None] + np.array([2.0, 3.0]) * rng.standard_normal((n, 2))


def filtered(rule, z, sequential=False):
    state = State(0, LAYOUT, np.array([z[0, 0], 0.0]), np.diag([4.0, 100.0]))
    memory, out = rule.fresh(), []
    H = np.array([[1.0, 0.0], [1.0, 0.0]])
    for k in range(1, len(z)):

        def measure(s, row=z[k]):
            return Linear(row - H @ s.x, H, np.array([4.0, 9.0]), np.arange(2))

        groups = [[0], [1]] if sequential else None
        state, _, _, memory = step(state, PHI, Q, k, measure, rule, memory, groups)
        assert np.linalg.eigvalsh(state.P).min() > 0.0
        out.append(state.x[0])
    return np.array(out)


@pytest.mark.laws
@pytest.mark.parametrize("name", list(RULES))
def test_sequential_is_batch_under_every_rule(name):
    """The factors are known before the first row: both forms use the same ones."""
    _, z = line(np.random.default_rng(4), 60, jump=30)
    assert np.abs(filtered(RULES[name], z) - filtered(RULES[name], z, True)).max() < 1e-9  # m


@pytest.mark.laws
def test_no_rule_is_the_plain_filter():
    _, z = line(np.random.default_rng(5), 40)
    state = State(0, LAYOUT, np.array([z[0, 0], 0.0]), np.diag([4.0, 100.0]))
    H = np.array([[1.0, 0.0], [1.0, 0.0]])
    plain = []
    for k in range(1, 40):
        state = ekf.predict(state, PHI, Q, k)
        state, _ = ekf.update(state, Linear(z[k] - H @ state.x, H, np.array([4.0, 9.0]), np.arange(2)))
        plain.append(state.x[0])
    assert np.abs(filtered(RULES["none"], z) - plain).max() < 1e-12


def test_fading_follows_what_the_model_does_not_know():
    x, z = line(np.random.default_rng(6), 80, jump=40)
    late = slice(42, 60)
    plain, faded = (np.abs(filtered(RULES[n], z) - x[1:])[late].mean() for n in ("none", "strong_tracking"))
    assert faded < 0.5 * plain


@pytest.mark.parametrize("name", list(RULES))
@pytest.mark.parametrize("case", ["stiff", "outliers"])
def test_covariances_stay_positive_over_a_flight(name, case):
    """A thousand epochs of whatever a rule answers; fading once drove the two triangles of P apart."""
    n, fixes = 1001, _fixes(case, 777_000, 1)
    x, P, found = np.zeros((n, 3, 3)), np.zeros((n, 3, 3, 3)), np.zeros((n, 3))
    adaptive_run(CASES[case][1], RULES[name].numbers(), 1.0, fixes.z, fixes.r, x, P, found)
    assert np.abs(P - P.transpose(0, 1, 3, 2)).max() == 0.0
    scale = np.sqrt(np.einsum("naii->nai", P)[1:])
    assert np.linalg.eigvalsh(P[1:] / (scale[..., None] * scale[..., None, :])).min() > 0.0
    assert np.isfinite(x).all()


def test_bad_rules():
    with pytest.raises(StarwiseError, match="no such adaptation"):
        Adaptation("magic")
    with pytest.raises(StarwiseError, match="outside their limits"):
        Adaptation("huber", c=5.0)


@pytest.mark.laws
@pytest.mark.parametrize(
    "constants", [KALMAN, LITERAL, replace(LITERAL, beta="none")], ids=["plain", "full", "no beta"]
)
def test_the_compiled_literal_filter_is_the_papers_equations(constants):
    """Eq. 3-23 as they stand, in numpy with 4 x 4 matrices (long double, where R of 1e-4 m costs digits)."""
    constants = replace(constants, p0=(400.0, 9e4, 100.0, 100.0))
    rng = np.random.default_rng(7)
    n = 25
    path = np.outer(np.arange(n), [3.0, 300.0, 1.0])
    z = path[:, None] + np.array([10.0, 23.0, 5.0])[None, :, None] * rng.standard_normal((n, 3, 3))
    got = literal_filter(z, 1.0, constants)
    want = _literal(z, constants)
    # m: the floor of 1e-9 m^2 beside R of 1e-8 m^2, through lambda
    assert np.abs(got.pos - want).max() < 3e-3


@pytest.mark.parametrize("constants", [KALMAN, LITERAL], ids=["plain", "full"])
def test_the_paper_start_is_finite(constants):
    """P(0) = 0: no lambda and no inverse exist at first; the filter goes on all the same."""
    rng = np.random.default_rng(8)
    z = np.outer(np.arange(60), [3.0, 300.0, 1.0])[:, None] + 10.0 * rng.standard_normal((60, 3, 3))
    assert np.isfinite(literal_filter(z, 1.0, constants).pos).all()


def _literal(z, c):
    L = np.longdouble
    n, K, T = len(z), 3, L(1.0)
    H = np.array([1, 0, 0, 1], dtype=L)
    x = np.zeros((K, 3, 4), dtype=L)
    x[:, :, 0] = z[0]
    P = np.broadcast_to(np.diag(np.array(c.p0, dtype=L)), (K, 3, 4, 4)).copy()
    lam = np.ones(K, dtype=L)
    out = [_inv_fuse(x, P)[0][:, 0]]
    xg, Pg = _inv_fuse(x, P)
    x[:] = xg
    for k in range(K):
        P[k] = Pg / L(c.share[k])
    for e in range(1, n):
        for k in range(K):
            ta, tau = L(c.tau_a[k]), L(c.tau[k])
            F1, F = np.eye(4, dtype=L), np.eye(4, dtype=L)
            F1[0, 1] = F1[1, 2] = F[0, 1] = T
            F1[0, 2] = T * T / 2
            F1[3, 3] = F[3, 3] = np.exp(-T / tau)
            F[0, 2] = (T / ta - 1 + np.exp(-T / ta)) * ta**2
            F[1, 2] = (1 - np.exp(-T / ta)) * ta
            F[2, 2] = np.exp(-T / ta)
            Qs, M, N, v = [], L(0), L(0), np.zeros(3, dtype=L)
            beta = L(0)
            for a in range(3):
                s2 = L(c.sigma_a[k]) ** 2
                if c.adaptive:
                    s2 = (4 - L(np.pi)) / L(np.pi) * max(L(c.a_max) - abs(x[k, a, 2]), L(0)) ** 2
                Qs.append(np.diag(np.array([0, 0, s2, L(c.sigma[k]) ** 2], dtype=L)))
                ahead = F1 @ x[k, a]
                beta += (ahead[0] - x[k, a, 0]) ** 2 * L(c.eta) * (c.beta == "position")
                x[k, a] = ahead
                P[k, a] = F @ P[k, a] @ F.T
                M += H @ P[k, a] @ H
                N -= H @ Qs[a] @ H + L(c.R[k]) ** 2
                v[a] = L(z[e, k, a]) - H @ x[k, a]
            if c.adaptive:
                d = v @ v
                C0 = d / 2 if e == 1 else lam[k] * d / (1 + lam[k])
                N += (L(c.d0) if d >= c.limit else L(1)) * C0 + beta
                lam[k] = max(L(1), L(c.alpha) * N / M) if M > 0 else L(1)
            for a in range(3):
                Pm = lam[k] * P[k, a] + Qs[a]
                S = H @ Pm @ H + L(c.R[k]) ** 2
                G = Pm @ H / S
                x[k, a] = x[k, a] + G * v[a]
                P[k, a] = (np.eye(4, dtype=L) - np.outer(G, H)) @ Pm
                P[k, a] = (P[k, a] + P[k, a].T) / 2
        xg, Pg = _inv_fuse(x, P)
        out.append(xg[:, 0])
        x[:] = xg
        for k in range(K):
            P[k] = Pg / L(c.share[k])
    return np.array(out, dtype=float)


def _inv_fuse(x, P):
    """Eq. 21 and 22 per axis, deviations from the first local filter."""
    L = np.longdouble
    xg, Pg = np.zeros((3, 4), dtype=L), np.zeros((3, 4, 4), dtype=L)
    for a in range(3):
        J = sum(_inverse(P[k, a]) for k in range(3))
        y = sum(_inverse(P[k, a]) @ (x[k, a] - x[0, a]) for k in range(3))
        Pg[a] = _inverse(J)
        xg[a] = x[0, a] + Pg[a] @ y
    return xg, Pg


def _inverse(A):
    """Gauss-Jordan in long double."""
    L = np.longdouble
    n = len(A)
    M = np.concatenate([A.astype(L), np.eye(n, dtype=L)], axis=1)
    for i in range(n):
        p = i + int(np.argmax(np.abs(M[i:, i])))
        M[[i, p]] = M[[p, i]]
        M[i] /= M[i, i]
        for j in range(n):
            if j != i:
                M[j] -= M[j, i] * M[i]
    return M[:, n:]
