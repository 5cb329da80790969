"""Process models: exactly discretised, and composed as the calculus says."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from starwise.config import RunConfig
from starwise.frames import ecef_from_geodetic
from starwise.kernels.process import current_shape, noise_shape, predict
from starwise.kernels.process import motion as motion_kernel
from starwise.models.process import (
    CLOCKS,
    KINDS,
    PRESETS,
    Motion,
    clock_psd,
    driving,
    matrices,
    motion_from,
    process_numbers,
)

pytestmark = pytest.mark.laws
MODELS = [
    Motion("static", 2e-3, 2e-3),
    Motion("velocity", 0.5, 0.5),
    Motion("acceleration", 0.3, 0.3),
    Motion("singer", 4.0, 4.0, 7.0),
    Motion("singer", 1.0, 1.0, 3000.0),
    Motion("current", 4.0, 4.0, 7.0),
]
IDS = ["static", "velocity", "acceleration", "singer", "singer-slow", "current"]
# Sizes of a state's elements: makes one tolerance serve positions after an hour and accelerations after 10 ms.
REL = 1e-10  # rounding of the matrix exponential of the reference


def van_loan(A, W, dt):
    """Phi and Q by Van Loan (1978): exponential of [[-A, W], [0, A']] dt."""
    n = len(A)
    big = np.zeros((2 * n, 2 * n))
    big[:n, :n], big[:n, n:], big[n:, n:] = -A, W, A.T
    E = expm(big * dt)
    Phi = E[n:, n:].T
    return Phi, Phi @ E[:n, n:]


def close(a, b, rel=REL):
    scale = np.sqrt(np.abs(np.outer(np.diag(b), np.diag(b)))) + 1e-300
    assert (np.abs(a - b) / scale).max() < rel


@pytest.mark.parametrize("model", MODELS, ids=IDS)
@pytest.mark.parametrize("dt", [1e-3, 0.1, 1.0, 5.0, 30.0, 100.0])
def test_discretisation_is_van_loans(model, dt):
    if model.model in ("singer", "current") and dt / model.tau_s > 10.0:
        pytest.skip("the reference itself loses all digits: exp(+dt / tau) is in it")
    A, W = driving(model, CLOCKS, 2)
    Phi, Q = matrices(model, CLOCKS, 2, dt)
    Phi_ref, Q_ref = van_loan(A, W, dt)
    assert np.abs(Phi - Phi_ref).max() < 1e-9 * max(1.0, dt**2)
    close(Q, Q_ref, 1e-7)


@pytest.mark.parametrize("model", MODELS, ids=IDS)
@pytest.mark.parametrize(("ba", "cb"), [(1.0, 1.0), (0.02, 30.0), (3.0, 4.5), (600.0, 1.0)])
def test_transitions_and_noise_compose(model, ba, cb):
    """Phi(c,b) Phi(b,a) = Phi(c,a); Q likewise: the filter may be stopped anywhere between two epochs."""
    (P1, Q1), (P2, Q2) = matrices(model, CLOCKS, 3, ba), matrices(model, CLOCKS, 3, cb)
    P3, Q3 = matrices(model, CLOCKS, 3, ba + cb)
    assert np.abs(P2 @ P1 - P3).max() < 1e-11 * max(1.0, (ba + cb) ** 2)
    close(P2 @ Q1 @ P2.T + Q2, Q3)


@pytest.mark.parametrize("z", [1e-7, 1e-4, 0.01, 0.3, 0.999999, 1.000001, 3.0, 50.0])
def test_singer_has_no_cancellation(z):
    """Both branches, against 50-digit closed forms; the noise is positive definite even at dt = tau / 1e7."""
    from decimal import Decimal, getcontext

    getcontext().prec = 60
    d = Decimal(z)
    e, e2 = (-d).exp(), (-2 * d).exp()
    want = np.array(
        [
            [1 - e2 + 2 * d + 2 * d**3 / 3 - 2 * d * d - 4 * d * e, e2 + 1 - 2 * e + 2 * d * e - 2 * d + d * d,
             1 - e2 - 2 * d * e],
            [0, 4 * e - 3 - e2 + 2 * d, e2 + 1 - 2 * e],
            [0, 0, 1 - e2],
        ],
        dtype=float,
    )  # fmt: skip
    want = want + np.triu(want, 1).T
    F, G = np.empty((3, 3)), np.empty((3, 3))
    motion_kernel(KINDS["singer"], z, 1.0, F, G)
    close(G, want, 1e-13 if z < 1.0 else 1e-12)
    scale = 1.0 / np.sqrt(np.diag(G))
    assert np.linalg.eigvalsh(scale[:, None] * G * scale)[0] > 0.0
    assert F[0, 2] == pytest.approx(float(d - 1 + e), rel=1e-13)
    assert F[1, 2] == pytest.approx(float(1 - e), rel=1e-13)


def test_singer_spans_the_other_models():
    """tau to infinity: constant acceleration; the acceleration's variance is stationary at any dt."""
    F, G = np.empty((3, 3)), np.empty((3, 3))
    motion_kernel(KINDS["singer"], 2.0, 1e9, F, G)
    motion_kernel(KINDS["acceleration"], 2.0, 1.0, A := np.empty((3, 3)), B := np.empty((3, 3)))
    assert np.allclose(F, A, atol=1e-8)
    assert np.allclose(G * 1e9 / 2.0, B, rtol=1e-6)
    motion_kernel(KINDS["singer"], 2.0, 3.0, F, G)
    assert F[2, 2] ** 2 + G[2, 2] == pytest.approx(1.0, abs=1e-14)


@pytest.mark.parametrize("model", MODELS, ids=IDS)
@pytest.mark.parametrize("clocks", [1, 3])
def test_predict_is_phi_p_phi_plus_q(model, clocks):
    rng = np.random.default_rng(1)
    model = replace(model, vertical=0.2 * model.horizontal)
    nk, n, dt = model.nk, model.nk + 2 * clocks, 1.7
    A = rng.normal(size=(n, n))
    x, P = rng.normal(size=n), A @ A.T
    llh = np.array([0.7, 0.3, 120.0])
    pos = ecef_from_geodetic(llh)
    up = np.array([np.cos(0.7) * np.cos(0.3), np.cos(0.7) * np.sin(0.3), np.sin(0.7)])
    Phi, Q = matrices(model, CLOCKS, clocks, dt, up)
    process = process_numbers(model, CLOCKS)
    F, G, M = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    motion_kernel(process.kind, dt, process.tau_s, F, G)
    noise_shape(process, *pos, M)
    # 120 m above the ellipsoid its normal is off by far less than 1e-5 rad.
    assert (
        np.abs(M - (model.horizontal * np.eye(3) + (model.vertical - model.horizontal) * np.outer(up, up))).max() < 1e-6
    )
    got_x, got_P = np.append(x, 0.0), np.zeros((n + 1, n + 1))
    got_P[:n, :n] = P
    predict(got_x, got_P, nk, clocks, dt, process, F, G, M)
    if model.model == "current":  # the mean is the acceleration before: it stays
        Phi[:3, 6:9], Phi[3:6, 6:9], Phi[6:9, 6:9] = dt**2 / 2.0 * np.eye(3), dt * np.eye(3), np.eye(3)
        assert np.abs(got_x[:n] - Phi @ x).max() < 1e-11
        Phi, _ = matrices(model, CLOCKS, clocks, dt, up)
    else:
        assert np.abs(got_x[:n] - Phi @ x).max() < 1e-11
    assert np.abs(got_P[:n, :n] - (Phi @ P @ Phi.T + Q)).max() < 1e-5  # M above
    assert np.array_equal(got_P, got_P.T)


@pytest.mark.parametrize("lat", [-np.pi / 2.0, -0.4, 0.0, 0.9])
def test_variance_of_the_current_model_is_that_of_each_axis(lat):
    """East, north and up apart, by what is left to the largest acceleration; never nothing."""
    config = RunConfig(dynamics="vehicle", process={"model": "current", "acceleration_max_mps2": 4.0})
    process = process_numbers(motion_from(config), CLOCKS)
    assert process.a_max == pytest.approx(4.0)
    up = np.array([np.cos(lat), 0.0, np.sin(lat)])
    C = np.stack([[0.0, 1.0, 0.0], np.cross(up, [0.0, 1.0, 0.0]), up])  # on the meridian of Greenwich
    pos = ecef_from_geodetic(np.array([lat, 0.0, 0.0]))
    factor = (4.0 - np.pi) / np.pi
    for a, want in (
        ([0.0, 0.0, 0.0], [4.0, 4.0, 1.2]),
        ([-1.0, 2.5, 0.4], [3.0, 1.5, 0.8]),
        ([9.0, 0.0, -9.0], [0.4, 4.0, 0.12]),
    ):
        x = np.concatenate([pos, np.zeros(3), np.array(a) @ C])
        M = np.full((3, 3), np.nan)
        current_shape(process, x, M)
        assert np.abs(C @ M @ C.T - np.diag(factor * np.square(want))).max() < 1e-4  # normal of the ellipsoid


def test_presets_are_complete_and_configuration_overrides_them():
    for name, preset in PRESETS.items():
        assert motion_from(RunConfig(dynamics=name, error_model="white")) == preset
    changed = motion_from(
        RunConfig(dynamics="vehicle", process={"acceleration_sigma_mps2": 2.0, "acceleration_tau_s": 9.0})
    )
    # vertical keeps the proportion of the preset, (0.3 / 1.0)^2
    got = (changed.horizontal, changed.vertical, changed.tau_s, changed.acceleration_sigma0)
    assert got == pytest.approx((4.0, 0.36, 9.0, 2.0))
    for model, nk in (("static", 3), ("velocity", 6), ("acceleration", 9), ("singer", 9)):
        assert motion_from(RunConfig(dynamics="aircraft", process={"model": model})).nk == nk
    assert motion_from(RunConfig(dynamics="static", process={"position_psd_m2_per_s": 0.0})).horizontal == 0.0


def test_clock_densities_of_a_tcxo():
    """Brown and Hwang (2012) table 9.3 gives S_f 2e-19/2 and S_g 2 pi^2 2e-20 in s: here in metres."""
    bias, drift = clock_psd(2e-19, 2e-20)
    assert bias == pytest.approx(0.00899, rel=1e-3)  # m^2/s
    assert drift == pytest.approx(0.0355, rel=2e-3)  # m^2/s^3
