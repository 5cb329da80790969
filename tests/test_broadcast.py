"""Broadcast states: laws that hold for any record, and which record is taken when."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from records import T0, record, records
from starwise.constants import (
    C_LIGHT,
    K_A_DOT,
    K_AF0,
    K_CIC,
    K_CIS,
    K_CRC,
    K_CRS,
    K_CUC,
    K_CUS,
    K_DELTA_N,
    K_DELTA_N_DOT,
    K_E,
    K_I0,
    K_IDOT,
    K_M0,
    K_OMEGA,
    K_OMEGA0,
    K_OMEGA_DOT,
    K_SQRT_A,
    K_TOE_SOW,
    NS,
    R_TAU,
    R_X,
    SAT_INACCURATE,
    SAT_NO_EPHEMERIS,
    SAT_OK,
    SAT_TOO_OLD,
    SAT_UNHEALTHY,
    SYSTEMS,
)  # fmt: skip
from starwise.errors import StarwiseError
from starwise.kernels.glonass import N_NODES, glonass, runge_kutta
from starwise.kernels.kepler import MU, OMEGA_E, kepler
from starwise.physics.broadcast import BroadcastEphemeris, galileo_first
from starwise.physics.slots import misfiled
from starwise.signals import sv_id

KINDS = ["G05", "E11", "C21", "C03", "C60", "J02", "I03", "R01", "S23"]
NO_CODE = 0.0


def at(eph, sv, seconds, code_m=NO_CODE, post=True):
    """States of one satellite at ``T0 + seconds``."""
    t = np.atleast_1d(np.asarray(seconds, dtype=float))
    t_ns = T0 + np.round(t * NS).astype(np.int64)
    return eph.states(t_ns, np.full(len(t), sv_id(sv), dtype=np.int16), np.full(len(t), code_m), post)


def _twin(p, system, geo, t):
    """Plain position by IS-GPS-200N table 20-IV / 30-II and BDS-SIS-ICD-B1I-3.0 5.2.4.12."""
    mu, we = MU[system], OMEGA_E[system]
    a0 = p[K_SQRT_A] ** 2
    a = a0 + p[K_A_DOT] * t
    m = p[K_M0] + (math.sqrt(mu / a0**3) + p[K_DELTA_N] + 0.5 * p[K_DELTA_N_DOT] * t) * t
    ek = m
    for _ in range(50):
        ek = m + p[K_E] * math.sin(ek)
    nu = 2 * math.atan(math.sqrt((1 + p[K_E]) / (1 - p[K_E])) * math.tan(ek / 2))
    phi = nu + p[K_OMEGA]
    s2, c2 = math.sin(2 * phi), math.cos(2 * phi)
    u = phi + p[K_CUS] * s2 + p[K_CUC] * c2
    r = a * (1 - p[K_E] * math.cos(ek)) + p[K_CRS] * s2 + p[K_CRC] * c2
    i = p[K_I0] + p[K_IDOT] * t + p[K_CIS] * s2 + p[K_CIC] * c2

    def rx(w):
        return np.array([[1, 0, 0], [0, math.cos(w), math.sin(w)], [0, -math.sin(w), math.cos(w)]])

    def rz(w):
        return np.array([[math.cos(w), math.sin(w), 0], [-math.sin(w), math.cos(w), 0], [0, 0, 1]])

    node = p[K_OMEGA0] + (p[K_OMEGA_DOT] - (0 if geo else we)) * t - we * p[K_TOE_SOW]
    x = rz(-node) @ rx(-i) @ np.array([r * math.cos(u), r * math.sin(u), 0])
    return rz(we * t) @ rx(math.radians(-5)) @ x if geo else x


@pytest.mark.parametrize("sv", [k for k in KINDS if k[0] not in "RS"])
@pytest.mark.parametrize("t", [-7200.0, 0.0, 3333.3])
def test_kepler_equals_twin(sv, t):
    par = record(sv, par={K_A_DOT: 0.02, K_DELTA_N_DOT: 1e-14})["par"]
    geo = sv in ("C03", "C60")
    got = kepler(par, SYSTEMS.index(sv[0]), geo, t)[:3]
    # 1 um: rounding of 4e7 m, and Kepler's equation to 1e-15 on either side
    np.testing.assert_allclose(got, _twin(par, SYSTEMS.index(sv[0]), geo, t), atol=1e-6, rtol=0)


@pytest.mark.laws
@pytest.mark.parametrize("sv", KINDS)
def test_velocity_and_drift_are_derivatives(sv):
    rates = {} if sv[0] in "RS" else {K_A_DOT: 0.02, K_DELTA_N_DOT: 1e-14}
    eph = BroadcastEphemeris(records(record(sv, par=rates)))
    t = np.array([-300.0, -61.0, 0.5, 100.0, 299.0])
    h = 0.5
    a, b, c = at(eph, sv, t - h), at(eph, sv, t), at(eph, sv, t + h)
    # transmission differs from t by the clock; the step between the two transmissions is 2 h (1 - drift)
    step = (c.t_tx_ns - a.t_tx_ns)[:, None] / NS
    # 1e-4 m/s: third derivative of the orbit 6e-6 m/s^3 times h^2 / 6, rounding 1e-8 m / h, GLONASS steps
    np.testing.assert_allclose((c.pos_e - a.pos_e) / step, b.vel_e, atol=1e-4, rtol=0)
    # 1e-13 s/s (0.03 mm/s): rounding of a 3e-4 s clock over 1 s is 1e-19, the relativistic term's curvature 1e-18
    np.testing.assert_allclose((c.clock_s - a.clock_s) / step[:, 0], b.drift, atol=1e-13, rtol=0)
    assert (b.status == SAT_OK).all()


@pytest.mark.laws
@pytest.mark.parametrize("sv", KINDS)
@pytest.mark.parametrize("code_m", [0.0, 2.1e7, 4.2e7])
def test_light_time_closes(sv, code_m):
    """t_rx = t_tx + satellite clock + code / c: the satellite's reading at transmission is what was received."""
    eph = BroadcastEphemeris(records(record(sv)))
    s = at(eph, sv, [-200.0, 0.0, 123.456789], code_m)
    t_rx = T0 + np.round(np.array([-200.0, 0.0, 123.456789]) * NS).astype(np.int64)
    closing = (t_rx - s.t_tx_ns) * 1e-9 - s.clock_s - code_m / C_LIGHT
    assert np.abs(closing).max() < 1e-9  # s: t_tx_ns is rounded to the nanosecond


@pytest.mark.laws
def test_state_matches_its_transmission_time():
    """The state is that of t_tx: asking for the same instant by another pseudorange gives the same satellite."""
    eph = BroadcastEphemeris(records(record("E11")))
    far, near = at(eph, "E11", 10.0, 2.4e7), at(eph, "E11", 10.0 - 2.4e7 / C_LIGHT, 0.0)
    lag = (far.t_tx_ns - near.t_tx_ns)[:, None] / NS
    # 0.01 mm: request and transmission are rounded to 1 ns, satellites do 4 um in that
    np.testing.assert_allclose(far.pos_e, near.pos_e + lag * near.vel_e, atol=1e-5, rtol=0)


def test_relativity_is_minus_2_rv_over_c2():
    """F e sqrt(A) sin E equals -2 r v / c^2 (IS-GPS-200N 20.3.3.3.3.1) for a pure ellipse."""
    pure = dict.fromkeys((K_CUC, K_CUS, K_CRC, K_CRS, K_CIC, K_CIS, K_DELTA_N, K_IDOT, K_OMEGA_DOT), 0.0)
    eph = BroadcastEphemeris(records(record("G05", par=pure)))
    s = at(eph, "G05", np.linspace(-7000, 7000, 15))
    rv = (s.pos_e * s.vel_e).sum(axis=1)
    np.testing.assert_allclose(s.relativity_s, -2 * rv / C_LIGHT**2, atol=1e-15, rtol=0)  # s: 0.3 um
    assert np.abs(s.relativity_s).max() > 1e-8


@pytest.mark.laws
@pytest.mark.parametrize("seconds", [900.0, 1800.0, 59.0])
def test_glonass_forward_and_back_returns(seconds):
    par = record("R01")["par"]
    there = glonass(par, seconds, np.empty((2, N_NODES, 6)), np.zeros(2, dtype=np.int32))
    back = par.copy()
    back[2:8] = there
    home = glonass(back, -seconds, np.empty((2, N_NODES, 6)), np.zeros(2, dtype=np.int32))
    # 0.1 mm: truncation of Runge-Kutta at 60 s, the same order each way
    np.testing.assert_allclose(home[:3], par[2:5], atol=1e-4, rtol=0)
    np.testing.assert_allclose(home[3:], par[5:8], atol=1e-7, rtol=0)


@pytest.mark.laws
def test_glonass_step_is_short_enough():
    par = record("R01")["par"]
    for seconds, tolerance in ((900, 1e-3), (1800, 2e-3)):  # m, against steps of 5 s
        got = glonass(par, float(seconds), np.empty((2, N_NODES, 6)), np.zeros(2, dtype=np.int32))
        s = tuple(par[2:8])
        for _ in range(seconds // 5):
            s = runge_kutta(s, par[8], par[9], par[10], 5.0)
        assert math.dist(got[:3], s[:3]) < tolerance


@pytest.mark.laws
def test_glonass_memory_does_not_change_results():
    """Whatever was asked before, in whatever order, the same time gives the same bits."""
    t = np.array([1700.0, -3.0, -1700.0, 5.0, 60.0, 119.99, 0.0, -60.0, 900.0])
    eph = BroadcastEphemeris(records(record("R01")))
    once = at(eph, "R01", t)
    for i, one in enumerate(t):
        fresh = at(BroadcastEphemeris(records(record("R01"))), "R01", one)
        assert (fresh.pos_e[0] == once.pos_e[i]).all()
    assert (at(eph, "R01", t[::-1]).pos_e[::-1] == once.pos_e).all()


@pytest.mark.laws
def test_rows_are_independent():
    eph = BroadcastEphemeris(records(*[record(k) for k in KINDS]))
    rng = np.random.default_rng(3)
    sv = np.array([sv_id(k) for k in rng.choice(KINDS, 200)], dtype=np.int16)
    t, code = T0 + rng.integers(-200 * NS, 200 * NS, 200), rng.uniform(1.9e7, 4.2e7, 200)
    a, order = eph.states(t, sv, code, True), rng.permutation(200)
    b = eph.states(t[order], sv[order], code[order], True)
    assert (a.pos_e[order] == b.pos_e).all()
    assert (a.clock_s[order] == b.clock_s).all()


# -- which record


@pytest.mark.laws
@settings(max_examples=150, deadline=None)
@given(
    rows=st.lists(
        st.tuples(
            st.sampled_from(["G05", "E11", "R01", "C21"]), st.integers(-40, 40), st.integers(-20, 20), st.integers(0, 1)
        ),
        min_size=1,
        max_size=12,
    ),
    t=st.lists(st.integers(-45, 45), min_size=1, max_size=8),
)
def test_never_from_the_future(rows, t):
    """Without post-processing no record counts before it was transmitted; with it, the choice is at least as near."""
    rec = records(
        *[
            record(sv, toe * 600.0, tx_s=toe * 600.0 + lag * 300.0, message="FNAV" if second and sv == "E11" else None)
            for sv, toe, lag, second in rows
        ]
    )
    eph = BroadcastEphemeris(rec)
    for sv in {row[0] for row in rows}:
        now, later = at(eph, sv, np.array(t) * 600.0, post=False), at(eph, sv, np.array(t) * 600.0, post=True)
        t_ns = T0 + np.array(t) * 600 * NS
        has = now.record >= 0
        assert (rec.t_tx_ns[now.record[has]] <= t_ns[has]).all()
        assert (rec.sv[now.record[has]] == sv_id(sv)).all()
        # whatever can be had in real time can be had afterwards
        assert (later.record[has] >= 0).all()
        assert (now.status[~has] != SAT_OK).all()


def test_post_takes_the_nearest_and_real_time_the_last_sent():
    rec = records(record("G05", 0.0, tx_s=-7000.0), record("G05", 7200.0, tx_s=100.0))
    eph = BroadcastEphemeris(rec)
    assert list(at(eph, "G05", [50.0, 1000.0, 3599.0, 3601.0], post=True).record) == [0, 0, 0, 1]
    assert list(at(eph, "G05", [50.0, 1000.0, 3599.0, 3601.0], post=False).record) == [0, 1, 1, 1]
    assert list(at(eph, "G05", [-7100.0], post=False).status) == [SAT_NO_EPHEMERIS]
    assert list(at(eph, "G05", [-7100.0, -7300.0], post=True).status) == [SAT_OK, SAT_TOO_OLD]


def test_newest_upload_of_one_reference_time_wins():
    rec = records(record("G05", 0.0, tx_s=-3000.0, iode=8), record("G05", 0.0, tx_s=-100.0, iode=9))
    eph = BroadcastEphemeris(rec)
    for post in (True, False):
        assert rec.iode[at(eph, "G05", 0.0, post=post).record[0]] == 9
        assert rec.iode[at(eph, "G05", 0.0, post=post).record[0]] == 9
    assert rec.iode[at(eph, "G05", -200.0, post=False).record[0]] == 8


def test_post_prefers_a_record_within_its_fit():
    """Galileo and BeiDou orbits are worthless hours before toe: an older record that still fits is better."""
    rec = records(record("E11", 0.0), record("E11", 4 * 3600.0))
    assert list(at(BroadcastEphemeris(rec), "E11", [2.4 * 3600, 3.1 * 3600]).record) == [0, 1]


def test_sigma_widens_outside_the_fit():
    eph = BroadcastEphemeris(records(record("C21", accuracy_m=2.0)))
    sigma = at(eph, "C21", [0.0, 7200.0, 4 * 3600.0, 6 * 3600.0]).sigma_m
    assert sigma[0] == sigma[1] == 2.0
    assert 15 < sigma[2] < 25  # m: 5 m/h^2 over 2 h
    assert 70 < sigma[3] < 90


@pytest.mark.parametrize(
    ("sv", "limit"), [("G05", 7200), ("E11", 14400), ("C21", 21600), ("R01", 1800), ("J02", 7200), ("S23", 360)]
)
def test_limits(sv, limit):
    eph = BroadcastEphemeris(records(record(sv)))
    s = at(eph, sv, [-limit - 2, -limit, limit, limit + 2])
    assert list(s.status) == [SAT_TOO_OLD, SAT_OK, SAT_OK, SAT_TOO_OLD]
    assert np.isnan(s.pos_e[[0, 3]]).all()
    assert np.isfinite(s.pos_e[[1, 2]]).all()


def test_long_fit_interval_of_gps_is_respected():
    eph = BroadcastEphemeris(records(record("G05", fit_s=6 * 3600.0)))
    assert at(eph, "G05", 2.9 * 3600).status[0] == SAT_OK
    assert at(eph, "G05", 3.1 * 3600).status[0] == SAT_TOO_OLD


def test_preference_of_messages():
    rec = records(record("E11", 0.0), record("E11", 0.0, message="FNAV"), record("E11", 18000.0, message="FNAV"))
    inav, fnav = BroadcastEphemeris(rec), BroadcastEphemeris(rec, galileo_first("FNAV"))
    names = [int(m) for m in rec.message[at(inav, "E11", [0.0, 18000.0]).record]]
    assert names == [6, 7]  # I/NAV where there is one
    assert [int(m) for m in rec.message[at(fnav, "E11", [0.0, 18000.0]).record]] == [7, 7]
    off = BroadcastEphemeris(rec, {"E": ()})
    assert at(off, "E11", 0.0).status[0] == SAT_NO_EPHEMERIS
    with pytest.raises(StarwiseError, match="no such message"):
        BroadcastEphemeris(rec, {"E": (("INAW",),)})


@pytest.mark.parametrize(
    ("sv", "message", "health", "bad"),
    [
        ("G05", "LNAV", 63, True),
        ("G05", "LNAV", 1, True),
        ("G05", "CNAV", 1, False),  # L5 alone
        ("G05", "CNAV", 4, True),
        ("J02", "LNAV", 1, False),  # L1C/B, which no satellite sends together with L1 C/A
        ("J02", "LNAV", 62, True),
        ("E11", "INAV", 130, True),
        ("E11", "INAV", 16, False),  # E5a
        ("E11", "FNAV", 16, True),
        ("R01", "FDMA", 1, True),
        ("C21", "D1", 1, True),
    ],
)
def test_health(sv, message, health, bad):
    """Unhealthy satellites are computed all the same, and flagged."""
    s = at(BroadcastEphemeris(records(record(sv, message=message, health=health))), sv, 10.0)
    assert s.status[0] == (SAT_UNHEALTHY if bad else SAT_OK)
    assert np.isfinite(s.pos_e).all()


def test_accuracy():
    rec = records(record("G05", accuracy_m=np.inf), record("G06", accuracy_m=np.nan), record("G07", accuracy_m=4.0))
    eph = BroadcastEphemeris(rec)
    assert at(eph, "G05", 0.0).status[0] == SAT_INACCURATE
    assert at(eph, "G06", 0.0).sigma_m[0] == 5.0
    assert at(eph, "G07", 0.0).sigma_m[0] == 4.0


def test_unknown_satellite_and_nonsense():
    eph = BroadcastEphemeris(records(record("G05"), record("G06", par={K_E: 1.2}), record("R02", par={R_TAU: np.nan})))
    assert at(eph, "G31", 0.0).status[0] == SAT_NO_EPHEMERIS
    assert at(eph, "G06", 0.0).status[0] == SAT_NO_EPHEMERIS
    assert at(eph, "R02", 0.0).status[0] == SAT_NO_EPHEMERIS
    for code in (np.nan, np.inf, -np.inf, 1e30):
        s = at(eph, "G05", 0.0, code)
        assert np.isnan(s.pos_e).all()
        assert s.record[0] == 0
    assert np.isfinite(at(eph, "G05", 0.0, -1e6).pos_e).all()
    empty = eph.states(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int16), np.zeros(0))
    assert empty.pos_e.shape == (0, 3)
    with pytest.raises(ValueError, match="rows do not match"):
        eph.states(np.zeros(2, dtype=np.int64), np.zeros(1, dtype=np.int16), np.zeros(1))


def test_reference_times_may_differ():
    """toc and toe are separate clocks: a record whose toc is an hour after toe keeps its orbit."""
    one = record("G05", par={K_AF0: 0.0})
    two = {**one, "toc_ns": one["toc_ns"] + 3600 * NS}
    a, b = (at(BroadcastEphemeris(records(r)), "G05", 100.0) for r in (one, two))
    # the clocks differ by af1 x 3600 s = 30 ns: the satellite moves 0.1 mm in that
    np.testing.assert_allclose(a.pos_e, b.pos_e, atol=2e-4, rtol=0)
    assert abs(a.clock_s - b.clock_s)[0] == pytest.approx(8.3e-12 * 3600, rel=1e-3)


def test_glonass_records_under_the_wrong_slot_are_left_out():
    """R05 flies opposite R01 on the same channel: its record under R01 is on no orbit of R01."""
    first = record("R01", 0.0)
    there = {}
    for toe in (1800.0, 3600.0):
        memory = np.empty((2, N_NODES, 6)), np.zeros(2, dtype=np.int32)
        start = first["par"] if toe == 1800.0 else there[1800.0]
        there[toe] = start.copy()
        there[toe][R_X : R_X + 6] = glonass(start, 1800.0, *memory)
    across = there[1800.0].copy()
    across[R_X : R_X + 6] *= -1.0
    good = [first, *[{**record("R01", toe), "par": par} for toe, par in there.items()]]
    rec = records(*good, {**record("R01", 1800.0, tx_s=1900.0), "par": across})
    wrong = misfiled(rec)
    assert wrong.sum() == 1
    assert (rec.par[wrong][0] == across).all()
    eph = BroadcastEphemeris(rec)
    assert not wrong[at(eph, "R01", 1900.0, post=True).record[0]]
    assert "R01" in eph.notes[0]
    # two against two: nobody knows, all stay
    assert not misfiled(records(*good[:2], *[{**r, "par": -r["par"]} for r in good[:2]])).any()
    assert BroadcastEphemeris(records(record("G05"))).notes == ()
