"""Federated filter: the laws that sharing and fusing obey, in numpy and compiled."""

import numpy as np
import pytest

from starwise.chi2 import chi_square_points
from starwise.estimators.federated import fuse_states, separations, share_state, shares
from starwise.kernels.federated import (
    LOCAL_ABSENT,
    LOCAL_JUMPED,
    LOCAL_OUT,
    LOCAL_USED,
    Locals,
    Options,
    auto_shares,
    fuse,
    share_out,
)
from starwise.kernels.federated_run import FederatedOut, Measured, federated_run
from starwise.types import Layout, State

BASE = np.array([6.37e6, -2.1e6, 4.2e6, 0.0, 0.0, 0.0])  # m: deviations must be fused, not such numbers


def options(K, nc=6, **changes):
    given = {
        "nc": nc, "reset": True, "auto_share": False, "least_share": 0.1, "share": np.full(K, 1.0 / K),
        "test_states": 0, "separation_gate": 1e9, "innovation_gate": np.full(40, 1e9), "patience": 3,
        "probation": 20, "clock": -1, "clock_psd": 1e-4, "clock_gate": 30.0,
    }  # fmt: skip
    return Options(**{**given, **changes})


def blank(n, K, nc):
    return FederatedOut(
        np.zeros((n, nc)), np.zeros((n, nc, nc)), np.zeros((n, K), np.int64), *(np.zeros((n, K)) for _ in range(3))
    )


def motion(dt=1.0, q=0.3):
    """Constant velocity on three axes."""
    Phi = np.kron([[1.0, dt], [0.0, 1.0]], np.eye(3))
    Q = q * np.kron([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]], np.eye(3))
    return Phi, Q


def run(opts, n_states, x0, P0, Phi, Q, per_epoch, present=None):
    """``per_epoch[e][k]`` is (H, z, r) of local k."""
    K, width, n = len(n_states), max(n_states), len(per_epoch)
    x, P = np.zeros((K, width)), np.zeros((K, width, width))
    F, W = np.zeros_like(P), np.zeros_like(P)
    for k, m in enumerate(n_states):
        x[k, :m], P[k, :m, :m] = x0[k], P0[k]
        F[k, :m, :m], W[k, :m, :m] = Phi[k], Q[k]
    offsets, H, z, r = np.zeros((n, K + 1), np.int64), [], [], []
    for e, row in enumerate(per_epoch):
        for k, (h, zz, rr) in enumerate(row):
            offsets[e, k] = len(z)
            for i in range(len(zz)):
                H.append(np.pad(h[i], (0, width - len(h[i]))))
                z.append(zz[i])
                r.append(rr[i])
        offsets[e, K] = len(z)
    here = np.ones((n, K), bool) if present is None else present
    out = blank(n, K, opts.nc)
    rows = Measured(offsets, here, np.array(z), np.array(r), np.array(H).reshape(-1, width))
    start = Locals(np.array(n_states), x, P, F, W, x.copy(), P.copy())
    federated_run(opts, start, rows, out)
    return out


def central(x, P, Phi, Q, per_epoch):
    """Centralised filter in deviations from its prediction, plain numpy."""
    xs, Ps = [], []
    for row in per_epoch:
        x, P = Phi @ x, Phi @ P @ Phi.T + Q
        H = np.vstack([h for h, z, _ in row if len(z)]) if any(len(z) for _, z, _ in row) else np.zeros((0, len(x)))
        v = np.concatenate([z - h @ x for h, z, _ in row if len(z)]) if len(H) else np.zeros(0)
        R = np.diag(np.concatenate([r for _, z, r in row if len(z)])) if len(H) else np.zeros((0, 0))
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        x = x + K @ v
        P = (np.eye(len(x)) - K @ H) @ P
        P = 0.5 * (P + P.T)
        xs.append(x)
        Ps.append(P)
    return np.array(xs), np.array(Ps)


def fixes(seed, n=60, sigmas=(10.0, 23.0, 5.0), rates=(1, 1, 1)):
    rng = np.random.default_rng(seed)
    H = np.hstack([np.eye(3), np.zeros((3, 3))])
    truth = BASE[:3] + np.outer(np.arange(1, n + 1), [3.0, -200.0, 10.0])
    return [
        [
            (H, truth[e] + s * rng.standard_normal(3), np.full(3, s * s))
            if e % rate == 0
            else (H[:0], np.zeros(0), np.zeros(0))
            for s, rate in zip(sigmas, rates, strict=True)
        ]
        for e in range(n)
    ]  # fmt: skip


SHARES = [(1 / 3, 1 / 6, 1 / 2), (0.01, 0.01, 0.98), (0.2, 0.6, 0.2)]


@pytest.mark.laws
@pytest.mark.parametrize("share", [*SHARES, None], ids=["paper", "extreme", "odd", "auto"])
@pytest.mark.parametrize("rates", [(1, 1, 1), (1, 5, 3)], ids=["equal", "rates"])
def test_with_reset_it_is_the_centralised_filter(share, rates):
    """Whatever the shares and the rates: 1e-8 m at 8e6 m (rounding of one such number is 1e-9 m)."""
    rows = fixes(1, rates=rates)
    Phi, Q = motion()
    P0 = np.diag([100.0] * 3 + [300.0**2] * 3)
    beta = np.array(share or (1 / 3,) * 3)
    opts = options(3, share=beta, auto_share=share is None)
    out = run(opts, [6] * 3, [BASE] * 3, [P0 / b for b in beta], [Phi] * 3, [Q] * 3, rows)
    x, P = central(BASE, P0, Phi, Q, rows)
    assert np.abs(out.x[:, :3] - x[:, :3]).max() < 1e-8  # m
    assert np.abs(out.x[:, 3:] - x[:, 3:]).max() < 1e-8  # m/s
    assert np.abs(out.P - P).max() < 1e-8 * P0.max()
    assert np.abs(out.P[20:, :3, :3] - P[20:, :3, :3]).max() < 1e-8  # m^2


@pytest.mark.laws
def test_the_order_of_the_locals_changes_nothing():
    rows = fixes(2)
    Phi, Q = motion()
    P0 = np.diag([100.0] * 3 + [300.0**2] * 3)
    beta = np.array(SHARES[0])
    a = run(options(3, share=beta), [6] * 3, [BASE] * 3, [P0 / b for b in beta], [Phi] * 3, [Q] * 3, rows)
    turned = [[row[2], row[0], row[1]] for row in rows]
    back = beta[[2, 0, 1]]
    b = run(options(3, share=back), [6] * 3, [BASE] * 3, [P0 / s for s in back], [Phi] * 3, [Q] * 3, turned)
    assert np.abs(a.x - b.x).max() < 1e-8  # m


@pytest.mark.laws
def test_a_local_filter_that_drops_out_and_comes_back():
    """With reset its share passes to the others: still the centralised filter without its rows."""
    rows = fixes(3)
    present = np.ones((60, 3), bool)
    present[20:35, 2] = False
    Phi, Q = motion()
    P0 = np.diag([100.0] * 3 + [300.0**2] * 3)
    beta = np.array(SHARES[0])
    out = run(options(3, share=beta), [6] * 3, [BASE] * 3, [P0 / b for b in beta], [Phi] * 3, [Q] * 3, rows, present)
    kept = [
        [row if here else (row[0][:0], row[1][:0], row[2][:0]) for row, here in zip(epoch, there, strict=True)]
        for epoch, there in zip(rows, present, strict=True)
    ]
    x, P = central(BASE, P0, Phi, Q, kept)
    assert np.abs(out.x - x).max() < 1e-8
    assert np.abs(out.P[30] - P[30]).max() < 1e-8
    assert (out.status[20:35, 2] == LOCAL_ABSENT).all()
    assert (out.status[35:, 2] == LOCAL_USED).all()
    assert np.allclose(out.share.sum(axis=1), 1.0)


@pytest.mark.laws
@pytest.mark.parametrize("period", [1, 10])
def test_without_reset_absent_filters_keep_the_fusion_honest(period):
    """Local filters that take turns: a share that passed to the others would count common noise twice.

    The covariance claimed is held against the true one of the same linear estimator: gains do not depend on data, so
    the fused state is linear in what goes in, and its response to every input, one at a time, is its covariance.
    """
    K, n = 2, 30
    Phi, Q = np.eye(1), np.eye(1)
    present = np.array([[(e // period) % K == k for k in range(K)] for e in range(n)])

    def fused(noise, errors, start):
        truth = start + np.cumsum(noise)
        H = np.eye(1)
        rows = [
            [(H, truth[e] + errors[e, k : k + 1], np.ones(1)) if present[e, k] else (H[:0], np.zeros(0), np.zeros(0))
             for k in range(K)]
            for e in range(n)
        ]  # fmt: skip
        opts = options(K, nc=1, reset=False)
        out = run(opts, [1] * K, [np.zeros(1)] * K, [np.eye(1) * 10.0 * K] * K, [Phi] * K, [Q] * K, rows, present)
        return out.x[:, 0] - truth, out.P[:, 0, 0]

    nothing = np.zeros((n, K))
    error, claimed = fused(np.zeros(n), nothing, np.sqrt(10.0))
    true = error**2
    for e in range(n):
        true += fused(np.eye(n)[e], nothing, 0.0)[0] ** 2
        for k in np.flatnonzero(present[e]):
            one = nothing.copy()
            one[e, k] = 1.0
            true += fused(np.zeros(n), one, 0.0)[0] ** 2
    assert (true <= claimed * (1.0 + 1e-9)).all()
    assert (true[5:] > 0.5 * claimed[5:]).all()  # a bound that is twice as large would say nothing


def test_noise_that_is_not_shared_is_too_optimistic():
    """The paper shares P alone: the fused covariance is then smaller than the centralised filter's."""
    rows = fixes(4)
    Phi, Q = motion()
    P0 = np.diag([100.0] * 3 + [300.0**2] * 3)
    out = run(options(3), [6] * 3, [BASE] * 3, [3.0 * P0] * 3, [Phi] * 3, [Q / 3.0] * 3, rows)
    _, P = central(BASE, P0, Phi, Q, rows)
    assert np.trace(out.P[-1]) < 0.9 * np.trace(P[-1])


def satellites(seed, n, ramp=None, K=4, common=False, sigma=1.5):
    """Code rows of K constellations with a clock each; states position, velocity | clock, drift. Truth is zero."""
    rng = np.random.default_rng(seed)
    counts = [7, 7, 8, 6][:K]
    u = [rng.standard_normal((c, 3)) for c in counts]
    for k in range(K):
        u[k][:, 2] = np.abs(u[k][:, 2]) + 0.2
        u[k] /= np.linalg.norm(u[k], axis=1)[:, None]
    out = []
    for e in range(n):
        row = []
        for k in range(K):
            H = np.hstack([-u[k], np.zeros((counts[k], 3)), np.ones((counts[k], 1)), np.zeros((counts[k], 1))])
            z = 10.0 * (k + 1) + sigma * rng.standard_normal(counts[k])
            if ramp is not None and k == ramp and e > 60:
                z[slice(None) if common else 0] += 50.0 / 60.0 * (e - 60)
            row.append((H, z, np.full(counts[k], sigma**2)))
        out.append(row)
    return out


def clocks(K, q=1e-3):
    Phi6, Q6 = motion(q=q)
    Phi, Q = np.zeros((8, 8)), np.zeros((8, 8))
    Phi[:6, :6], Q[:6, :6] = Phi6, Q6
    Phi[6:, 6:] = [[1.0, 1.0], [0.0, 1.0]]
    Q[6:, 6:] = [[0.01 + 1e-4 / 3, 5e-5], [5e-5, 1e-4]]
    P0 = K * np.diag([100.0] * 3 + [1.0] * 3 + [1e4 / K, 1.0 / K])
    return Phi, Q, P0


def isolating(K, **changes):
    return options(
        K, reset=False, test_states=3, separation_gate=chi_square_points(1e-7, 4)[3],
        innovation_gate=chi_square_points(1e-7, 20), **changes,
    )  # fmt: skip


@pytest.mark.parametrize("reset", [True, False], ids=["reset", "no reset"])
def test_private_clocks_are_an_upper_bound(reset):
    """Against the filter that carries all clocks at once: never more certain, hardly less accurate."""
    K, n = 4, 80
    rows = satellites(5, n)
    Phi, Q, P0 = clocks(K)
    opts = options(K, reset=reset)
    out = run(opts, [8] * K, [np.zeros(8)] * K, [P0] * K, [Phi] * K, [Q] * K, rows)
    N = 6 + 2 * K
    F, W, C = np.zeros((N, N)), np.zeros((N, N)), np.diag([100.0] * 3 + [1.0] * 3 + [1e4, 1.0] * K)
    F[:6, :6], W[:6, :6] = Phi[:6, :6], Q[:6, :6]
    whole = []
    for k in range(K):
        s = slice(6 + 2 * k, 8 + 2 * k)
        F[s, s], W[s, s] = Phi[6:, 6:], Q[6:, 6:]
    for epoch in rows:
        line = []
        for k, (H, z, r) in enumerate(epoch):
            big = np.zeros((len(z), N))
            big[:, :6], big[:, 6 + 2 * k : 8 + 2 * k] = H[:, :6], H[:, 6:]
            line.append((big, z, r))
        whole.append(line)
    x, P = central(np.zeros(N), C, F, W, whole)
    for e in (10, 40, 79):
        assert np.linalg.eigvalsh(out.P[e, :3, :3] - P[e, :3, :3]).min() > -1e-9
    fed, cen = (np.sqrt((a[20:, :3] ** 2).sum(axis=1).mean()) for a in (out.x, x))
    assert fed < 1.3 * cen + 0.05  # m


@pytest.mark.parametrize("faulty", [0, 2])
def test_a_bad_satellite_takes_its_constellation_out(faulty):
    n = 200
    Phi, Q, P0 = clocks(4)
    start = ([8] * 4, [np.zeros(8)] * 4, [P0] * 4, [Phi] * 4, [Q] * 4)
    out = run(isolating(4), *start, satellites(6, n, ramp=faulty))
    gone = [np.flatnonzero(out.status[:, k] == LOCAL_OUT) for k in range(4)]
    assert len(gone[faulty])
    assert 60 < gone[faulty][0] < 100
    assert all(len(gone[k]) == 0 for k in range(4) if k != faulty)
    assert (out.status[gone[faulty][0] :, faulty] == LOCAL_OUT).all()  # its ramp never ends
    # the master does not follow it: as without it, but for what came before it was found
    assert np.linalg.norm(out.x[:, :3], axis=1).max() < 6.0  # m


def test_a_constellation_comes_back_when_its_fault_ends():
    n = 260
    rows, good = satellites(7, n, ramp=2), satellites(7, n)
    mended = [a if e < 120 else b for e, (a, b) in enumerate(zip(rows, good, strict=True))]
    Phi, Q, P0 = clocks(4)
    out = run(isolating(4), [8] * 4, [np.zeros(8)] * 4, [P0] * 4, [Phi] * 4, [Q] * 4, mended)
    assert (out.status[110:120, 2] == LOCAL_OUT).all()
    assert (out.status[-40:, 2] == LOCAL_USED).all()


def test_a_common_ramp_hides_in_its_clock_unless_clocks_are_watched():
    n = 200
    Phi, Q, P0 = clocks(4)
    start = ([8] * 4, [np.zeros(8)] * 4, [P0] * 4, [Phi] * 4, [Q] * 4)
    rows = satellites(8, n, ramp=2, common=True)
    hidden = run(isolating(4), *start, rows)
    assert np.linalg.norm(hidden.x[:, :3], axis=1).max() < 4.0  # m
    watched = run(isolating(4, clock=6, clock_gate=chi_square_points(1e-7, 2)[1]), *start, rows)
    gone = np.flatnonzero(watched.status[:, 2] == LOCAL_OUT)
    assert len(gone)
    assert gone[0] < 100
    quiet = run(isolating(4, clock=6, clock_gate=chi_square_points(1e-7, 2)[1]), *start, satellites(8, n))
    assert (quiet.status == LOCAL_USED).all()


def test_a_clock_that_jumps_is_absorbed_and_named():
    """A microsecond; the very epoch, no other filter concerned, the position as without."""
    n = 150
    Phi, Q, P0 = clocks(4)
    start = ([8] * 4, [np.zeros(8)] * 4, [P0] * 4, [Phi] * 4, [Q] * 4)
    rows = satellites(9, n)
    calm = run(isolating(4), *start, rows)
    moved = [
        [(H, z + 299.8 * (k == 1 and e >= 100), r) for k, (H, z, r) in enumerate(epoch)] for e, epoch in enumerate(rows)
    ]
    jumped = run(isolating(4), *start, moved)
    assert np.argwhere(jumped.status == LOCAL_JUMPED).tolist() == [[100, 1]]
    assert (jumped.status[np.arange(n) != 100] == LOCAL_USED).all()
    assert np.linalg.norm(jumped.x[100:, :3] - calm.x[100:, :3], axis=1).max() < 1.0  # m: one clock learnt anew


def test_fusing_and_sharing_by_hand():
    x = np.array([[1.0, 5.0], [3.0, 5.0]])
    P = np.array([np.diag([1.0, 4.0]), np.diag([3.0, 4.0])])
    xg, Pg = np.zeros(2), np.zeros((2, 2))
    A, B = np.zeros((2, 2)), np.zeros((2, 2))
    assert fuse(x, P, np.ones(2, bool), -1, 1, np.zeros(2), xg, Pg, A, B)
    assert xg[0] == pytest.approx(1.5)
    assert Pg[0, 0] == pytest.approx(0.75)
    # a private state follows what it knows of the common one: regression 2, then x_p = 5 + 2 (1.5 - 1)
    P1 = np.array([[1.0, 2.0], [2.0, 6.0]])
    x1 = np.array([1.0, 5.0])
    assert share_out(x1, P1, 2, 1, xg, Pg, 0.5, A, B)
    assert x1 == pytest.approx([1.5, 6.0])
    assert pytest.approx(np.array([[1.5, 3.0], [3.0, 8.0]])) == P1
    assert not fuse(x, P, np.zeros(2, bool), -1, 1, np.zeros(2), xg, Pg, A, B)
    share = np.zeros(2)
    three = np.array([np.eye(3), 1e6 * np.eye(3)])
    auto_shares(three, np.ones(2, bool), 0.1, share)
    assert share == pytest.approx([1.0 / 1.05, 0.05 / 1.05], rel=1e-4)


# -- named beliefs


def belief(names, seed, t_ns=0):
    rng = np.random.default_rng(seed)
    n = len(names)
    A = rng.standard_normal((n, n))
    return State(t_ns, Layout(tuple(names)), rng.standard_normal(n), A @ A.T + np.eye(n))


COMMON = ("pos.x", "pos.y", "pos.z")


@pytest.mark.laws
def test_beliefs_are_fused_by_name():
    """Information added, whatever the order of the names, and about any base."""
    a, b = belief(("clk.G", *COMMON), 1), belief((*COMMON[::-1], "clk.R", "drift.R"), 2)
    both = fuse_states([a, b], COMMON)
    J = [np.linalg.inv(s.moved_to(Layout(COMMON)).P) for s in (a, b)]
    x = [s.moved_to(Layout(COMMON)).x for s in (a, b)]
    P = np.linalg.inv(J[0] + J[1])
    assert np.abs(both.P - P).max() < 1e-12
    assert np.abs(both.x - P @ (J[0] @ x[0] + J[1] @ x[1])).max() < 1e-12
    assert np.abs(fuse_states([b, a], COMMON, base=np.full(3, 5.0)).x - both.x).max() < 1e-12


@pytest.mark.laws
def test_shared_then_fused_is_what_was_shared():
    a, b = belief(("clk.G", *COMMON), 3), belief((*COMMON, "clk.R"), 4)
    whole = fuse_states([a, b], COMMON)
    shared = [share_state(s, whole, beta) for s, beta in ((a, 0.3), (b, 0.7))]
    again = fuse_states(shared, COMMON)
    assert np.abs(again.x - whole.x).max() < 1e-12
    assert np.abs(again.P - whole.P).max() < 1e-12
    assert shared[0].layout == a.layout
    # what the clock is, given the position, has not changed
    for before, after in ((a, shared[0]), (b, shared[1])):
        name = next(n for n in before.layout.names if n.startswith("clk"))
        G = [s.moved_to(Layout((*COMMON, name))).P for s in (before, after)]
        regression = [M[3, :3] @ np.linalg.inv(M[:3, :3]) for M in G]
        assert np.abs(regression[0] - regression[1]).max() < 1e-10
        rest = [M[3, 3] - M[3, :3] @ np.linalg.inv(M[:3, :3]) @ M[:3, 3] for M in G]
        assert rest[0] == pytest.approx(rest[1])


def test_separation_is_chi_square():
    """Mean 3 for beliefs that are as good as they say; large for one that is not."""
    rng = np.random.default_rng(5)
    seen = []
    for _ in range(300):
        beliefs = []
        for k in range(3):
            s = belief(COMMON, k)
            beliefs.append(State(0, s.layout, np.linalg.cholesky(s.P) @ rng.standard_normal(3), s.P))
        seen.append(separations(beliefs, COMMON))
    assert np.mean(seen, axis=0) == pytest.approx([3.0, 3.0, 3.0], rel=0.2)
    beliefs[1] = beliefs[1].plus(np.full(3, 50.0))
    far = separations(beliefs, COMMON)
    assert far.argmax() == 1
    assert np.isnan(separations(beliefs[:1], COMMON)).all()


def test_shares_and_bad_beliefs():
    a, b = belief(COMMON, 6), belief(COMMON, 7)
    assert shares([a, b], COMMON).sum() == pytest.approx(1.0)
    with pytest.raises(ValueError, match="one time"):
        fuse_states([a, belief(COMMON, 7, t_ns=5)], COMMON)
    with pytest.raises(ValueError, match="one time"):
        fuse_states([], COMMON)
    with pytest.raises(ValueError, match="singular"):
        fuse_states([State(0, a.layout, a.x, np.zeros((3, 3)))], COMMON)
    with pytest.raises(ValueError, match="not positive"):
        share_state(a, b, 0.0)
