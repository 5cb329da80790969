"""Motion of one axis, the plane in which straight is straight, and the bank of hypotheses."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from starwise.errors import StarwiseError
from starwise.estimators.adaptive_fixes import improved_filter, least_squares
from starwise.estimators.fuse_plane import unroll
from starwise.frames import ecef_from_geodetic
from starwise.kernels.maneuver import current_variance, mean_input
from starwise.models.maneuver import BANKS, AxisMotion, Maneuvers
from starwise.sim.sections import Vehicle
from starwise.sim.segments import Straight
from starwise.sim.trajectory import from_segments

MODELS = [
    AxisMotion("velocity", 0.5),
    AxisMotion("acceleration", 0.3),
    AxisMotion("singer", 4.0, 7.0),
    AxisMotion("current", 9.0, 10.0),
    AxisMotion("current", 0.0, 100.0, a_max=30.0, eps_sigma=10.0, eps_tau_s=0.1),
    AxisMotion("singer", 1.0, 1.0, eps_sigma=23.0, eps_tau_s=5.0),
]


def van_loan(A, W, dt):
    """Phi and Q by Van Loan (1978): exponential of [[-A, W], [0, A']] dt."""
    n = len(A)
    big = np.zeros((2 * n, 2 * n))
    big[:n, :n], big[:n, n:], big[n:, n:] = -A, W, A.T
    E = expm(big * dt)
    Phi = E[n:, n:].T
    return Phi, Phi @ E[:n, n:]


@pytest.mark.laws
@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.model + ("+eps" if m.eps_sigma else ""))
@pytest.mark.parametrize("dt", [0.01, 0.25, 1.0, 3.0])
def test_discretisation_is_van_loans(model, dt):
    """1e-6 of each element's size: the reference's exponential holds exp(+dt / tau), e^30 at worst."""
    Phi, _, Q = model.matrices(dt, 4.0)
    if dt / model.eps_tau_s > 10.0 and model.eps_sigma:
        pytest.skip("the reference itself loses all digits")
    Phi_ref, Q_ref = van_loan(*model.driving(4.0), dt)
    assert np.abs(Phi - Phi_ref).max() < 1e-9 * max(1.0, dt**2)
    size = np.sqrt(np.outer(np.diag(Q_ref), np.diag(Q_ref)))
    assert (np.abs(Q - Q_ref) / size).max() < 1e-6


@pytest.mark.laws
@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.model + ("+eps" if m.eps_sigma else ""))
def test_transitions_compose(model):
    (A, A1, QA), (B, B1, QB), (C, C1, QC) = (model.matrices(dt, 4.0) for dt in (0.7, 2.0, 2.7))
    assert np.abs(B @ A - C).max() < 1e-12 * 10.0
    assert np.abs(B1 @ A1 - C1).max() < 1e-11
    assert np.abs(B @ QA @ B.T + QB - QC).max() < 1e-10 * np.abs(QC).max()


@pytest.mark.laws
@pytest.mark.parametrize("z", [1e-6, 0.01, 0.29, 0.31, 2.0, 20.0])
def test_mean_of_the_current_model(z):
    """Phi x + U a_hat = Phi_1 x, and U is the response to a mean acceleration: [A B; 0 0] exponentiated."""
    tau = 5.0
    dt = z * tau
    U = np.zeros(3)
    mean_input(dt, tau, U)
    Phi, Phi_1, _ = AxisMotion("current", 9.0, tau).matrices(dt)
    x = np.array([10.0, 3.0, 2.0])
    assert np.abs(Phi @ x + U * x[2] - Phi_1 @ x).max() < 1e-13 * max(dt * dt, 100.0)
    big = np.zeros((4, 4))
    big[0, 1] = big[1, 2] = 1.0
    big[2, 2], big[2, 3] = -1.0 / tau, 1.0 / tau
    assert pytest.approx(expm(big * dt)[:3, 3], rel=1e-9, abs=1e-18) == U


def test_current_variance():
    """(4 - pi) / pi (a_max - |a|)^2, and nothing beyond a_max."""
    k = (4.0 - np.pi) / np.pi
    assert current_variance(0.0, 30.0) == pytest.approx(k * 900.0)
    assert current_variance(-10.0, 30.0) == current_variance(10.0, 30.0) == pytest.approx(k * 400.0)
    assert current_variance(31.0, 30.0) == 0.0
    assert AxisMotion("current", 9.0).noise_strength(5.0) == 9.0


def test_bad_numbers():
    with pytest.raises(StarwiseError, match="no such model"):
        AxisMotion("noval", 1.0)
    with pytest.raises(StarwiseError, match="negative"):
        AxisMotion("singer", 1.0, -1.0)
    with pytest.raises(StarwiseError, match="bank"):
        Maneuvers(tau_s=(1.0,), sigma_mps2=(1.0, 2.0))


@pytest.mark.parametrize(("lat", "heading"), [(32.0, 0.0), (32.0, 90.0), (-60.0, 45.0), (70.0, 250.0), (5.0, 130.0)])
def test_a_geodesic_is_straight_in_the_plane(lat, heading):
    vehicle = Vehicle(kind="aircraft", start=(lat, 179.8, 5000.0), heading_deg=heading, speed_mps=300.0,
                      segments=(Straight(),))  # fmt: skip
    t_ns = 10**18 + 10**9 * np.arange(601)
    truth = from_segments(vehicle, 10**18, 600.0).states(t_ns)
    plane = unroll(truth.pos_e)
    bend = np.diff(plane.s, 2, axis=0)
    assert np.abs(bend).max() < 1e-6  # m/s^2: 1e-6 for 100 s is 5 mm
    speed = np.linalg.norm(plane.rotated_from_ecef(truth.vel_e), axis=1)
    assert np.abs(np.linalg.norm(np.diff(plane.s, axis=0), axis=1) - speed[1:]).max() < 1e-5  # m/s


def test_the_plane_and_back():
    rng = np.random.default_rng(1)
    base = ecef_from_geodetic([0.5, 2.0, 300.0]) + rng.standard_normal((50, 3)) * 20.0
    base += np.outer(np.arange(50), [30.0, -20.0, 5.0])
    plane = unroll(base)
    near = base + rng.standard_normal((50, 3)) * 100.0
    assert np.abs(plane.to_ecef(plane.from_ecef(near)) - near).max() < 1e-8  # m
    many = np.stack([near, base], axis=1)
    assert np.abs(plane.from_ecef(many)[:, 0] - plane.from_ecef(near)).max() == 0.0
    assert np.abs(plane.from_ecef(many)[:, 1] - plane.s).max() < 1e-9
    cov = np.broadcast_to(np.diag([1.0, 4.0, 9.0]), (50, 3, 3))
    assert np.abs(plane.cov_to_ecef(plane.cov_from_ecef(cov)) - cov).max() < 1e-12
    v = rng.standard_normal((50, 3))
    assert np.abs(plane.rotated_to_ecef(plane.rotated_from_ecef(v)) - v).max() < 1e-14


def drive(seed, n=160, sigmas=(10.0, 23.0, 5.0), accelerate=(60, 75)):
    rng = np.random.default_rng(seed)
    acc = np.zeros((n, 3))
    acc[accelerate[0] : accelerate[1], 0] = 8.0
    vel = np.array([50.0, 300.0, 0.0]) + np.cumsum(acc, axis=0)
    pos = np.cumsum(vel, axis=0)
    z = pos[:, None] + np.array(sigmas)[None, :, None] * rng.standard_normal((n, len(sigmas), 3))
    return pos, z, np.broadcast_to(np.square(sigmas)[None, :, None], z.shape).copy()


WHITE = replace(BANKS["aircraft"], most_inflation=1.0, scale_window=0.0)


@pytest.mark.laws
def test_shares_and_order_of_receivers_change_nothing():
    """Every hypothesis is a federated filter with full reset, so that it equals the centralised one."""
    _, z, r = drive(1)
    t = np.arange(len(z), dtype=float)
    a = improved_filter(t, z, r, WHITE, np.array([1 / 3, 1 / 6, 1 / 2]))
    b = improved_filter(t, z, r, WHITE, np.array([0.02, 0.96, 0.02]))
    c = improved_filter(t, z[:, ::-1], r[:, ::-1], WHITE)
    for other in (b, c):
        assert np.abs(a.pos - other.pos).max() < 1e-6  # m; rounding grows where hypotheses compete
        assert np.abs(a.cruise - other.cruise).max() < 1e-6
    zc, rc = least_squares(z, r)
    d = improved_filter(t, zc[:, None], rc[:, None], WHITE)
    assert np.abs(a.pos - d.pos).max() < 1e-6
    assert np.abs(a.cov_pos - d.cov_pos).max() < 1e-6


def test_one_cruise_hypothesis_is_a_kalman_filter():
    """Against the plain equations: a bank that never leaves cruise."""
    _, z, r = drive(2, accelerate=(0, 0))
    t = np.arange(len(z), dtype=float)
    only = replace(WHITE, cruise_s=1e12, maneuver_s=1e-9, tau_s=(1.0,), sigma_mps2=(1e-9,))
    got = improved_filter(t, z, r, only)
    zc, rc = least_squares(z, r)
    F, Q = np.array([[1.0, 1.0], [0.0, 1.0]]), 1e-5 * np.array([[1 / 3, 0.5], [0.5, 1.0]])
    for a in range(3):
        x, P = np.array([zc[0, a], 0.0]), np.diag([rc[0, a], 300.0**2])
        for e in range(1, len(z)):
            x, P = F @ x, F @ P @ F.T + Q
            K = P[:, 0] / (P[0, 0] + rc[e, a])
            x, P = x + K * (zc[e, a] - x[0]), P - np.outer(K, P[0])
        assert got.pos[-1, a] == pytest.approx(x[0], abs=1e-4)  # m
        assert got.cov_pos[-1, a, a] == pytest.approx(P[0, 0], rel=1e-3)


def test_cruise_is_told_from_manoeuvre():
    pos, z, r = drive(3)
    got = improved_filter(np.arange(len(z), dtype=float), z, r, WHITE)
    assert got.cruise[50:58].mean() > 0.9
    assert got.cruise[64:75].max() < 0.2
    assert got.cruise[110:].mean() > 0.9
    zc, _ = least_squares(z, r)
    assert np.abs(got.pos - pos)[130:].mean() < 0.35 * np.abs(zc - pos)[130:].mean()


def test_scale_and_correlation_out_of_differences():
    rng = np.random.default_rng(4)
    pos, z, r = drive(5, n=400, accelerate=(0, 0))
    t = np.arange(400.0)
    assert improved_filter(t, z, r / 4.0).scale[-1] == pytest.approx(2.0, rel=0.1)
    e = np.zeros_like(z)
    w = rng.standard_normal(z.shape) * np.sqrt(r)
    e[0] = w[0]
    for k in range(1, 400):
        e[k] = 0.9 * e[k - 1] + np.sqrt(0.19) * w[k]
    got = improved_filter(t, pos[:, None] + e, r)
    assert got.correlation[-1] == pytest.approx(0.8, abs=0.12)  # 0.9 less the dead band of 2 / sqrt(dof)
    white = improved_filter(t, z, r)
    assert np.median(white.correlation[50:]) == 0.0
    error = (got.pos - pos)[100:]
    nees = (error**2 / np.einsum("nii->ni", got.cov_pos)[100:]).mean()
    assert nees < 3.0  # taken as white it is above 5


def test_missing_and_wrong_fixes():
    pos, z, r = drive(6, n=300, accelerate=(0, 0))
    t = np.arange(300.0)
    z[50:80, 2] = np.nan
    z[100:110] = np.nan
    z[200:230, 1] += 400.0
    gated = replace(BANKS["aircraft"], gate=30.7)
    got = improved_filter(t, z, r, gated)
    assert not got.used[50:80, 2].any()
    assert not got.used[200:230, 1].any()
    assert got.used[120:199].all()
    assert np.isfinite(got.pos).all()
    assert np.abs(got.pos - pos)[60:].max() < 12.0  # m
    blind = improved_filter(t, z, r, replace(gated, gate=np.inf, scale_window=0.0, most_inflation=1.0))
    assert np.abs(blind.pos - pos)[200:230].max() > 12.0


def test_nothing_before_the_first_fix():
    _, z, r = drive(7, n=30)
    z[:10] = np.nan
    got = improved_filter(np.arange(30.0), z, r)
    assert np.isnan(got.pos[:10]).all()
    assert np.isfinite(got.pos[10:]).all()
