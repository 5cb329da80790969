"""Measurement models of the inertial filter against differences; update and smoothing against dense twins."""

import math
from typing import Any

import numpy as np
import pytest

from starwise.config_inertial import InertialConfig
from starwise.kernels.ins_error import feed_back
from starwise.kernels.ins_rows import (
    axle_rows,
    barometer_row,
    constraint_rows,
    odometer_row,
    position_rows,
    rest_rate_rows,
    rest_rows,
    velocity_rows,
)
from starwise.kernels.ins_run import new_motion
from starwise.kernels.ins_smooth import NODE, TRANSITION, Records, smooth
from starwise.kernels.ins_state import At, predict, reset_transition, update
from starwise.kernels.strapdown import dcm
from starwise.models.inertial import inertial_state
from starwise.models.process import Clocks

CONFIG = InertialConfig.from_dict(
    {
        "lever_arm_m": [0.4, -0.2, -1.1], "lever_arm_sigma_m": 0.1, "time_offset_sigma_s": 0.1, "constant_bias": True,
        "gyro": {"scale_ppm": 1000.0}, "accel": {"scale_ppm": 1000.0}, "vehicle": {"constraint": True},
    }
)  # fmt: skip
STATE = inertial_state(CONFIG, baro=True, odometer=True, clocks=("G", "E"), noise=Clocks(0.01, 0.04, 1e-4, 0, 1, 1, 1))
N = len(STATE.layout)
AT = STATE.at
OMEGA, FORCE = np.array([0.05, -0.2, 0.4]), np.array([1.5, -2.0, 0.3])
NAV = np.array([0.8, 0.1, -0.3, 0.5, 12.0, -7.0, 0.6, 0.7, -1.9, 320.0])
NAV[:4] /= np.linalg.norm(NAV[:4])
EST = np.linspace(0.01, 0.05, N)


def rows(name: str, nav: Any, est: Any, omega: Any) -> tuple[Any, Any]:
    C, H, J = np.empty((3, 3)), np.full((3, N), 7.0), np.empty((3, N))
    v, u, arm = np.zeros(3), np.empty(3), np.array(CONFIG.lever_arm_m)
    dcm(nav, C)
    if name == "position":
        position_rows(nav, est, N, AT, C, arm, NAV[7:10] + np.array([1e-6, -2e-6, 3.0]), H, v)
    elif name == "velocity":
        velocity_rows(nav, est, N, AT, C, arm, omega, FORCE, np.array([11.0, -8.0, 0.0]), H, v)
    elif name == "constraint":
        constraint_rows(nav, est, N, AT, C, omega, FORCE, J, u, H, v)
    elif name == "odometer":
        odometer_row(nav, est, N, AT, C, omega, FORCE, 13.0, J, u, H, v)
    elif name == "barometer":
        barometer_row(nav, est, N, AT, 300.0, H, v)
    elif name == "rest":
        rest_rows(nav, N, H, v)
    elif name == "rest_rate":
        rest_rate_rows(nav, est, N, AT, C, np.array([[0.01, 0.02, 0.03]]), 0, H, v)
    else:
        axle_rows(nav, est, N, AT, C, omega, FORCE, H, v)
        v = -v
    return H, v


SIZE = {
    "position": 3,
    "velocity": 3,
    "constraint": 2,
    "odometer": 1,
    "barometer": 1,
    "rest": 3,
    "rest_rate": 3,
    "axle": 3,
}


@pytest.mark.laws
@pytest.mark.parametrize("name", SIZE)
def test_jacobian_is_the_derivative_of_the_prediction(name: str) -> None:
    m = SIZE[name]
    H, _ = rows(name, NAV, EST, OMEGA)
    numeric = np.empty((m, N))
    step = np.full(N, 1e-5)
    step[6:9] = 1.0  # m: smaller ones drown in the rounding of latitudes
    for j in range(N):
        sides = []
        for sign in (1.0, -1.0):
            x, nav, est, bias = np.zeros(N), NAV.copy(), EST.copy(), np.zeros(6)
            x[j] = sign * step[j]
            moved = x.copy()
            feed_back(moved, nav, bias)
            est[9:] += x[9:]
            # the rate that lever arms see is the reading minus all biases
            omega = OMEGA - x[9:12] - x[AT.bgc : AT.bgc + 3]
            sides.append(rows(name, nav, est, omega)[1])
        numeric[:, j] = -(sides[0] - sides[1])[:m] / (2.0 * step[j])
    # units of the rows per rad, m/s, m ...; second order of the steps and of the acceleration's own axes
    where = np.ones(N, dtype=bool)
    if name == "constraint":  # axes of the slip terms are taken as known: 1 % of a coefficient times speed
        where[:3] = where[AT.mount : AT.mount + 2] = where[3:6] = False
        where[AT.axle] = where[9:12] = where[AT.bgc : AT.bgc + 3] = False
    np.testing.assert_allclose(H[:m, where], numeric[:, where], atol=3e-6)


@pytest.mark.laws
def test_constraint_is_the_axle_but_for_slip() -> None:
    est = EST.copy()
    est[AT.steer : AT.steer + 2] = 0.0
    got, _ = rows("constraint", NAV, est, OMEGA)
    axle, _ = rows("axle", NAV, est, OMEGA)
    same = [j for j in range(N) if j not in (AT.steer, AT.steer + 1)]
    np.testing.assert_array_equal(got[:2, same], axle[1:, same])


@pytest.mark.laws
def test_update_is_the_textbook_one() -> None:
    rng = np.random.default_rng(3)
    A = rng.normal(size=(N, N))
    P = A @ A.T
    H, v, R = rng.normal(size=(3, N)), rng.normal(size=3), np.diag([0.5, 1.0, 2.0])
    S = H @ P @ H.T + R
    K = P @ H.T @ np.linalg.inv(S)
    got, x = P.copy(), np.zeros(N)
    nis, weight = update(got, N, H, v, R, 3, np.inf, x, np.empty((3, N)), np.empty((3, N)), np.empty((3, 3)))
    np.testing.assert_allclose(x, K @ v, atol=1e-11)
    np.testing.assert_allclose(got, P - K @ H @ P, atol=1e-9)  # of variances of about 20
    np.testing.assert_array_equal(got, got.T)
    assert nis == pytest.approx(v @ np.linalg.solve(S, v), abs=1e-11)
    assert weight == 1.0
    x2, PH, K3, S3 = np.zeros(N), np.empty((3, N)), np.empty((3, N)), np.empty((3, 3))
    nis2, weight = update(P.copy(), N, H, 100.0 * v, R, 3, 5.0, x2, PH, K3, S3)
    assert nis2 == pytest.approx(1e4 * nis, rel=1e-12)
    assert weight == pytest.approx(5.0 / nis2, rel=1e-12)
    np.testing.assert_allclose(x2, 100.0 * weight * (K @ v), atol=1e-11)


@pytest.mark.laws
def test_smoothing_is_that_of_rauch_tung_and_striebel() -> None:
    # a small linear world in the form of the filter's records: full rows for nine states, a diagonal, a clock
    n, clk, steps = 17, 15, 12
    at = At(**{name: -1 for name in At._fields if name != "clk"}, clk=clk)
    rng = np.random.default_rng(8)
    P = np.diag(rng.uniform(0.5, 2.0, n)) * 1e-4
    nav0 = np.array([1.0, 0, 0, 0, 0, 0, 0, 0.5, 0.5, 100.0])
    x = np.zeros(n)  # estimate, linear: deviations from nav0
    kinds, data, nodes = [], [], []
    filtered: list[tuple[Any, Any]] = []
    predicted: list[tuple[Any, Any, Any]] = []
    for k in range(steps):
        Phi, Q = np.eye(n), np.diag(rng.uniform(0.0, 1e-5, n))
        Phi[:9] += 0.1 * rng.normal(size=(9, n))
        Phi[:9, clk:] = 0.0
        Phi[range(9, n), range(9, n)] = rng.uniform(0.8, 1.0, n - 9)
        Phi[clk, clk] = Phi[clk + 1, clk + 1] = 1.0
        Phi[clk, clk + 1] = 0.5
        if k:
            before = filtered[-1]
            x, P = Phi @ before[0], Phi @ before[1] @ Phi.T + Q
            predicted.append((x, P, Phi))
            row = np.zeros(10 * n + 12)
            row[: 9 * n] = Phi[:9].ravel()
            row[9 * n : 10 * n] = np.diag(Phi)
            row[10 * n] = 0.5
            kinds.append(TRANSITION), data.append(row), nodes.append(-1)
        H, R = rng.normal(size=(2, n)), np.diag([1e-4, 2e-4])
        v = rng.normal(size=2) * 1e-2
        S = H @ P @ H.T + R
        K = P @ H.T @ np.linalg.inv(S)
        x, P = x + K @ v, P - K @ S @ K.T
        row = np.zeros(10 * n + 12)
        row[: 2 * n], row[3 * n : 5 * n] = H.ravel(), K.T.ravel()
        inverse = np.zeros((3, 3))
        inverse[:2, :2] = np.linalg.inv(S)
        row[6 * n : 6 * n + 9], row[6 * n + 9 : 6 * n + 11] = inverse.ravel(), v
        kinds.append(2), data.append(row), nodes.append(-1)
        filtered.append((x, P))
        kinds.append(NODE), data.append(np.zeros(10 * n + 12)), nodes.append(k)
    wanted = [filtered[-1]]
    for k in range(steps - 2, -1, -1):
        (xf, Pf), (xp, Pp, Phi) = filtered[k], predicted[k]
        G = Pf @ Phi.T @ np.linalg.inv(Pp)
        xs, Ps = wanted[0]
        wanted.insert(0, (xf + G @ (xs - xp), Pf + G @ (Ps - Pp) @ G.T))
    rec = Records(np.array(kinds), np.array(nodes), np.array(data), np.array([len(kinds)]))
    nav, est, cov = np.tile(nav0, (steps, 1)), np.zeros((steps, n)), np.array([P for _, P in filtered])
    smooth(rec, n, at, nav, est, cov)
    for k in range(steps):
        np.testing.assert_allclose(est[k, 9:], (wanted[k][0] - filtered[k][0])[9:], atol=1e-10)
        np.testing.assert_allclose(nav[k, 4:7], (wanted[k][0] - filtered[k][0])[3:6], atol=1e-10)
        np.testing.assert_allclose(cov[k], wanted[k][1], atol=1e-12)  # of variances of 1e-5


def test_states_have_names_and_places() -> None:
    names = STATE.layout.names
    assert names[:15:3] == ("att.n", "vel.n", "pos.n", "bg.x", "ba.x")
    assert names[AT.mount : AT.mount + 2] == ("mount.pitch", "mount.yaw")
    assert names[AT.clk : AT.clk + 2] == ("clk.G", "drift")
    assert names[AT.isb] == "isb.E"
    assert STATE.sigma[AT.mount] == pytest.approx(math.radians(10.0))
    assert (STATE.rate[9:15] > 0.0).all()  # Markov, with constant parts beside them
    assert (STATE.rate[AT.bgc : AT.bgc + 3] == 0.0).all()


@pytest.mark.laws
def test_prediction_is_the_transition_that_smoothing_is_told_of() -> None:
    """P = Phi P Phi' with all options, biases that forget within a second, and no noise."""
    rng = np.random.default_rng(5)
    A = rng.normal(size=(N, N))
    P = A @ A.T
    before, est, mo, rate = P.copy(), EST.copy(), new_motion(N), np.zeros(N)
    rate[9:] = np.where(np.arange(9, N) < AT.clk, 1.0, 0.0)  # 1/s
    dcm(NAV, mo.C)
    reset_transition(N, mo)
    none = np.zeros((1, 3))
    dtheta, dv, dt = np.array([[0.01, -0.02, 0.03]]), np.array([[0.2, -0.1, -0.98]]), 0.1
    for _ in range(3):
        predict(NAV.copy(), est, P, N, AT, dtheta, dv, 0, 1.0, dt, none, none, rate, np.zeros(N), True, mo)
    Phi = np.diag(mo.diag)
    Phi[:9] = mo.top
    Phi[AT.clk, AT.clk + 1] = mo.since[0]
    assert mo.diag[9] == pytest.approx(math.exp(-0.3), abs=1e-3)  # second order in 0.1
    # of variances of about 40, rounding; a factor of 0.9 in the wrong place is 1e-2
    np.testing.assert_allclose(P, Phi @ before @ Phi.T, atol=1e-9)
    np.testing.assert_array_equal(P, P.T)
