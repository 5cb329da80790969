"""The simulated sky: tables, messages against truth, fits, two-line elements, the sky of a real day."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from starwise.constants import (
    C_LIGHT,
    K_CIC,
    K_CIS,
    K_CRC,
    K_CRS,
    K_CUC,
    K_CUS,
    K_DELTA_N,
    K_E,
    K_I0,
    K_IDOT,
    K_M0,
    K_OMEGA,
    K_OMEGA0,
    K_OMEGA_DOT,
    K_SQRT_A,
    K_TOE_SOW,
    N_EPH_PAR,
    NS,
    SAT_OK,
    SYS_C,
    SYS_E,
    SYS_G,
    SYS_R,
    SYSTEMS,
)
from starwise.errors import StarwiseError
from starwise.frames import geodetic_from_ecef
from starwise.gnsstime import parse_time
from starwise.kernels.kepler import kepler
from starwise.kernels.sim_orbits import kepler_truth
from starwise.physics.broadcast import BroadcastEphemeris
from starwise.signals import sv_id
from starwise.sim.constellations import CONSTELLATIONS, constellations
from starwise.sim.orbits import MU, OMEGA_E, fitted, gmst, read_tle, rebased
from starwise.sim.sections import EphemerisError, Sky
from starwise.sim.seeds import streams
from starwise.sim.sky import build_sky

T0 = parse_time("2024-03-30T11:00:00")
HOUR = 3600 * NS
ALL = ("gps", "glonass", "galileo", "beidou2", "beidou3", "qzss")


def sky_of(*names, start=T0, end=T0 + HOUR, **options):
    return build_sky(Sky(constellations=names or ALL, **options), start, end, streams(1))


@pytest.mark.golden
def test_tables_have_the_satellites_their_operators_list():
    counts = {key: len(table.orbits) for key, table in CONSTELLATIONS.items()}
    assert counts == {
        "gps": 32, "glonass": 24, "galileo": 26, "beidou1": 3, "beidou2": 12, "beidou3": 30, "qzss": 4,
    }  # fmt: skip
    assert all(table.source for table in CONSTELLATIONS.values())


@pytest.mark.golden
@pytest.mark.parametrize(
    ("name", "longitudes"),
    [
        ("beidou1", {80.0, 110.5, 140.0}),
        ("beidou2", {58.75, 80.0, 110.5, 140.0, 160.0}),
        ("beidou3", {80.0, 110.5, 140.0}),
    ],
)
def test_geostationary_satellites_stand_over_their_longitudes(name, longitudes):
    sky = sky_of(name, start=T0, end=T0 + 20 * HOUR)
    geo = sky.sv[[int(s) & 255 <= 5 or int(s) & 255 >= 59 for s in sky.sv]]
    for hour in (0, 7, 20):
        pos = sky.states(np.full(len(geo), T0 + hour * HOUR), geo)[:, :3]
        lat, lon, h = geodetic_from_ecef(pos).T
        # inclination 0.5 deg, eccentricity 3e-4: 2 e = 0.04 deg of longitude, 26 km of height
        assert {round(x * 4) / 4 for x in np.degrees(lon)} == longitudes
        assert np.abs(np.degrees(lat)).max() < 0.55
        assert np.abs(h - 35_786e3).max() < 30e3


def test_planes_of_gps_are_filled_as_in_orbit():
    """Six planes 60 deg apart, no two satellites of a plane closer than 10 deg."""
    table = CONSTELLATIONS["gps"]
    nodes = np.array([o.node_deg for o in table.orbits])
    u = np.array([(o.perigee_deg + o.anomaly_deg) % 360.0 for o in table.orbits])
    order = np.sort(nodes)
    gaps = np.diff(order, append=order[0] + 360.0)
    assert (gaps > 25.0).sum() == 6
    for plane in range(6):
        starts = np.sort(order[np.roll(gaps > 25.0, 1)])
        members = ((nodes - starts[plane]) % 360.0) < 25.0
        apart = np.diff(np.sort(u[members]), append=np.sort(u[members])[0] + 360.0)
        assert 5 <= members.sum() <= 6
        assert apart.min() > 10.0


@pytest.mark.laws
@pytest.mark.parametrize("post", [False, True])
def test_messages_describe_the_truth(post):
    """Without ephemeris error starwise's broadcast orbits are the true ones, at every epoch and for every system."""
    sky = sky_of(end=T0 + 5 * HOUR)
    eph = BroadcastEphemeris(sky.records)
    for minute in range(0, 300, 17):
        t = np.full(len(sky.sv), T0 + minute * 60 * NS)
        got = eph.states(t, sky.sv, np.full(len(sky.sv), 2.4e7), post=post)
        assert (got.status == SAT_OK).all()
        true = sky.states(got.t_tx_ns, sky.sv)
        off = np.linalg.norm(got.pos_e - true[:, :3], axis=1)
        glonass = sky.sv >> 8 == SYS_R
        assert off[~glonass].max() < 2e-5  # m: transmission times are rounded to 1 ns, 4 um; GEO are fitted
        assert off[glonass].max() < 5e-3  # m: steps of 60 s in the reader's integration, up to 30 min
        assert np.abs(got.vel_e - true[:, 3:6]).max() < 1e-5  # m/s
        assert np.abs(got.clock_s - true[:, 6]).max() * C_LIGHT < 1e-6  # m
        assert np.abs(got.drift - true[:, 7]).max() * C_LIGHT < 1e-9  # m/s


@pytest.mark.laws
def test_group_delays_are_those_that_the_messages_say():
    sky = sky_of()
    eph = BroadcastEphemeris(sky.records)
    sv = sky.sv
    got = eph.states(np.full(len(sv), T0), sv, np.full(len(sv), 2.4e7))
    for system, bands in ((SYS_G, "12"), (SYS_E, "157"), (SYS_C, "267"), (SYS_R, "12")):
        rows = np.flatnonzero(sv >> 8 == system)
        for band in bands:
            attribute = {"G": "W", "E": "X", "C": "I", "R": "C"}[SYSTEMS[system]]
            sig = np.full(len(rows), int(band) << 8 | ord(attribute), dtype=np.int16)
            said = eph.group_delay(got.record[rows], sv[rows], sig, np.zeros_like(sig))
            index = np.searchsorted(sky.sv, sv[rows])
            assert np.abs(said - C_LIGHT * sky.delay_s[index, int(band)]).max() < 1e-9  # m


@pytest.mark.laws
def test_both_galileo_messages_give_the_same_pseudorange():
    """I/NAV and F/NAV clocks differ by their group delays only: E1 and E5a leave the satellite once."""
    sky = sky_of("galileo")
    values = []
    for message in ("INAV", "FNAV"):
        eph = BroadcastEphemeris(sky.records, {"E": ((message,),)})
        got = eph.states(np.full(len(sky.sv), T0), sky.sv, np.full(len(sky.sv), 2.4e7))
        for name in ("1C", "5Q"):
            sig = np.full(len(sky.sv), int(name[0]) << 8 | ord(name[1]), dtype=np.int16)
            delay = eph.group_delay(got.record, sky.sv, sig, np.zeros_like(sig))
            values.append(delay - C_LIGHT * got.clock_s)
    assert np.abs(values[0] - values[2]).max() < 1e-6  # m, E1
    assert np.abs(values[1] - values[3]).max() < 1e-6  # m, E5a


def _elements(draw):
    par = np.zeros(N_EPH_PAR)
    par[K_SQRT_A] = draw(st.floats(5050.0, 6500.0))
    par[K_E] = draw(st.floats(0.0, 0.2))
    par[K_I0] = draw(st.floats(0.01, 1.2))
    for column in (K_OMEGA, K_OMEGA0, K_M0):
        par[column] = draw(st.floats(-math.pi, math.pi))
    for column, size in (
        (K_DELTA_N, 5e-9), (K_OMEGA_DOT, 1e-8), (K_IDOT, 1e-9), (K_CUC, 2e-5), (K_CUS, 2e-5), (K_CIC, 2e-5),
        (K_CIS, 2e-5), (K_CRC, 900.0), (K_CRS, 900.0),
    ):  # fmt: skip
        par[column] = draw(st.floats(-size, size))
    par[K_TOE_SOW] = draw(st.floats(0.0, 604_800.0))
    return par


@pytest.mark.laws
@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_two_independent_evaluations_of_a_message_agree(data):
    par = _elements(data.draw)
    system = data.draw(st.sampled_from([SYS_G, SYS_E, SYS_C]))
    geo = system == SYS_C and data.draw(st.booleans())
    t = data.draw(st.floats(-20_000.0, 20_000.0))
    one = np.array(kepler(par, system, geo, t))
    two = np.array(kepler_truth(par, MU[system], OMEGA_E[system], geo, t))
    assert np.abs(one[:3] - two[:3]).max() < 5e-6  # m: rounding of angles of 50 rad at 42 000 km
    assert np.abs(one[3:6] - two[3:6]).max() < 1e-8  # m/s
    assert abs(one[6] + 2.0 * math.sqrt(MU[system]) / C_LIGHT**2 * two[6]) * C_LIGHT < 1e-8  # m


@pytest.mark.laws
@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_a_new_reference_time_does_not_move_the_orbit(data):
    par = _elements(data.draw)
    toe = T0 // NS * NS
    week = (toe // NS) % 604_800
    par[K_TOE_SOW] = float(week)
    shift = data.draw(st.integers(-100, 100)) * 3600
    moved = rebased(par, toe, toe + shift * NS, SYS_G)
    for t in (-3600.0, 0.0, 5000.0):
        a = np.array(kepler_truth(par, MU[SYS_G], OMEGA_E[SYS_G], False, t + shift))
        b = np.array(kepler_truth(moved, MU[SYS_G], OMEGA_E[SYS_G], False, t))
        # m: the harmonic terms do not change, so nothing but rounding remains
        assert np.abs(a[:3] - b[:3]).max() < 1e-5


@pytest.mark.laws
@pytest.mark.parametrize("geo", [False, True])
def test_fit_returns_the_elements_behind_an_orbit(geo):
    par = np.zeros(N_EPH_PAR)
    par[[K_SQRT_A, K_E, K_I0, K_OMEGA0, K_OMEGA, K_M0]] = 6493.4, 4e-4, 0.09, 0.4, 1.0, -2.0
    par[[K_CUC, K_CRS, K_IDOT, K_DELTA_N]] = 3e-6, 60.0, 1e-10, 1e-9
    sv = sv_id("C03" if geo else "C38")
    toe = parse_time("2024-03-30T11:00:14")
    par[K_TOE_SOW] = ((toe - 14 * NS) // NS) % 604_800
    t = toe + np.arange(-7200, 7201, 450) * NS
    states = np.array([kepler_truth(par, MU[SYS_C], OMEGA_E[SYS_C], geo, float(x - toe) / NS)[:6] for x in t])
    got, rms = fitted(sv, toe, t, states[:, :3], states[:, 3:])
    assert rms < 2e-3  # m: weak priors pull by less than their 1 mm
    again = np.array([kepler_truth(got, MU[SYS_C], OMEGA_E[SYS_C], geo, float(x - toe) / NS)[:3] for x in t])
    assert np.linalg.norm(again - states[:, :3], axis=1).max() < 5e-3


@pytest.mark.laws
def test_true_velocity_is_the_derivative_of_the_position():
    sky = sky_of().with_error(EphemerisError(radial_m=3.0, along_m=5.0, cross_m=4.0, clock_m=2.0), streams(5))
    t = np.full(len(sky.sv), T0 + 1234 * NS)
    h = NS // 2
    a, b, c = (sky.states(t + d, sky.sv) for d in (-h, 0, h))
    assert np.abs((c[:, :3] - a[:, :3]) - b[:, 3:6]).max() < 2e-5  # m/s: third derivative h^2 / 6
    assert np.abs((c[:, 6] - a[:, 6]) - b[:, 7]).max() * C_LIGHT < 1e-6  # m/s


def test_ephemeris_error_has_the_size_asked_for():
    clean = sky_of()
    asked = EphemerisError(radial_m=1.0, along_m=4.0, cross_m=2.0, clock_m=3.0)
    errors = []
    for run in range(30):
        wrong = clean.with_error(asked, streams(3, run))
        t = np.full(len(clean.sv), T0 + 600 * NS)
        a, b = clean.states(t, clean.sv), wrong.states(t, clean.sv)
        v = a[:, 3:6] + 7.2921151467e-5 * np.stack([-a[:, 1], a[:, 0], 0 * a[:, 0]], axis=1)
        radial = a[:, :3] / np.linalg.norm(a[:, :3], axis=1)[:, None]
        cross = np.cross(a[:, :3], v)
        cross /= np.linalg.norm(cross, axis=1)[:, None]
        d = b[:, :3] - a[:, :3]
        along = np.cross(cross, radial)
        axes = [np.einsum("ij,ij->i", d, u) for u in (radial, along, cross)]
        errors.append(np.stack([*axes, (b[:, 6] - a[:, 6]) * C_LIGHT]))
    sigma = np.concatenate(errors, axis=1).std(axis=1)
    # 3840 independent draws: 1.1 % (1 sigma) of each; 5 sigma
    assert np.abs(sigma / np.array([1.0, 4.0, 2.0, 3.0]) - 1.0).max() < 0.06


def test_sky_is_the_same_for_the_same_seed_and_times_outside_do_not_matter():
    a, b = sky_of("gps", "glonass"), sky_of("gps", "glonass")
    assert np.array_equal(a.records.par, b.records.par, equal_nan=True)
    c = sky_of("gps", end=T0 + 9 * HOUR)
    t = np.full(32, T0 + 100 * NS)
    assert np.array_equal(a.states(t, c.sv), c.states(t, c.sv))


def test_excluded_satellites_are_not_there():
    sky = sky_of("gps", exclude=("G05",))
    assert sv_id("G05") not in sky.sv
    assert sv_id("G05") not in sky.records.sv
    with pytest.raises(StarwiseError, match="no satellite in the sky"):
        sky_of("beidou1", exclude=("C01", "C02", "C03"))


def test_constellations_that_share_satellites_join():
    assert [len(t.orbits) for t in constellations(("beidou2", "beidou1"))] == [12, 0]
    with pytest.raises(StarwiseError, match="no such constellation"):
        constellations(("glonas",))


@pytest.mark.golden
def test_sidereal_time_of_the_almanac():
    """Greenwich mean sidereal time at 0 h UT1 of 1987 April 10: 13 h 10 m 46.3668 s (Meeus, example 12.a)."""
    t = parse_time("1987-04-10T00:00:00Z")
    wanted = (13 + 10 / 60 + 46.3668 / 3600) / 24 * 2 * math.pi
    assert abs(gmst(t) - wanted) < 1e-8  # rad: 4 printed decimals of a second are 7e-9 rad


# -- two-line elements -----------------------------------------------------------------------------------------------
def tle(number: int, epoch: str, i: float, node: float, e: float, perigee: float, anomaly: float, n: float):
    """A two-line element set with correct columns (checksums are not read)."""
    one = f"1 {number:05d}U 00000A   {epoch}  .00000000  00000-0  00000-0 0  9990"
    two = f"2 {number:05d} {i:8.4f} {node:8.4f} {round(e * 1e7):07d} {perigee:8.4f} {anomaly:8.4f} {n:11.8f}    10"
    return one, two


SETS = {
    "GPS BIIR-2  (PRN 13)": tle(24876, "24090.25000000", 55.5, 120.0, 0.0034, 93.4, 267.0, 2.00565243),
    "COSMOS 2433 (720)": tle(32275, "24090.25000000", 64.8, 20.0, 0.0007, 100.0, 30.0, 2.13102),
    "GSAT0210 (PRN E01)": tle(41859, "24090.25000000", 56.0, 200.0, 0.0002, 10.0, 80.0, 1.70475),
    "BEIDOU-3 M1 (C19)": tle(43001, "24090.25000000", 55.0, 310.0, 0.0006, 50.0, 10.0, 1.86230),
    "BEIDOU-3 G1 (C59)": tle(43683, "24090.25000000", 1.2, 70.0, 0.0003, 50.0, 10.0, 1.00273),
    "QZS-2 (QZSS/PRN 184)": tle(42738, "24090.25000000", 41.0, 250.0, 0.0750, 270.0, 20.0, 1.00270),
    "ISS (ZARYA)": tle(25544, "24090.25000000", 51.6, 250.0, 0.0005, 270.0, 20.0, 15.5),
}


def test_messages_fitted_to_two_line_elements():
    pytest.importorskip("sgp4", reason="sgp4 is not installed")
    text = "\n".join(f"{name}\n{one}\n{two}" for name, (one, two) in SETS.items())
    sets = read_tle(text, "test.tle")
    assert [s[0] for s in sets] == ["G13", "R01", "E01", "C19", "C59", "J02"]
    section = Sky(source="tle", files=("test.tle",), constellations=ALL)
    sky = build_sky(section, T0, T0 + HOUR, streams(1), tle=sets)
    eph = BroadcastEphemeris(sky.records)
    for minute in (0, 25, 60):
        t = np.full(len(sky.sv), T0 + minute * 60 * NS)
        got = eph.states(t, sky.sv, np.full(len(sky.sv), 2.4e7))
        assert (got.status == SAT_OK).all()
        true = sky.states(got.t_tx_ns, sky.sv)
        off = np.linalg.norm(got.pos_e - true[:, :3], axis=1)
        # m: 15 elements follow SGP4's lunar and solar terms over 4 h to a decimetre (real messages do as well), the
        # constant acceleration of a GLONASS message over 30 min likewise
        assert off.max() < 0.3


def test_two_line_elements_that_are_none():
    with pytest.raises(StarwiseError, match=r"a.tle:2: not a two-line element set"):
        read_tle("GPS (PRN 13)\n1 24876U 97035A   18042.38585711  .00000063  00000-0\n2 24876\n", "a.tle")
    with pytest.raises(StarwiseError, match="no navigation satellite"):
        read_tle("ISS\n" + "\n".join(SETS["ISS (ZARYA)"]), "a.tle")


# -- the sky of a real day -------------------------------------------------------------------------------------------
@pytest.mark.real
def test_sky_of_a_real_day(shared_data: Path):
    from starwise.io.rinex_nav import read_nav

    nav = read_nav(shared_data / "static/tlse_2024001/BRDC00IGS_R_20240010000_01D_MN.rnx.gz")
    start = parse_time("2024-01-01T12:10:00")
    section = Sky(source="nav", files=("x",), constellations=ALL)
    sky = build_sky(section, start, start + HOUR, streams(1), nav)
    real, own = BroadcastEphemeris(nav), BroadcastEphemeris(sky.records)
    t = np.full(len(sky.sv), start + HOUR // 2)
    code = np.full(len(sky.sv), 2.4e7)
    a, b = real.states(t, sky.sv, code, post=True), own.states(t, sky.sv, code)
    both = (a.status == SAT_OK) & (b.status == SAT_OK)
    assert (b.status == SAT_OK).all()
    assert both.sum() > 40
    # slot 19 of GLONASS got another satellite in that hour, on the other side of the Earth
    both &= sky.sv != sv_id("R19")
    # m: at the middle of the hour each satellite is on the very record nearest to it; GLONASS without Moon and Sun
    off = np.linalg.norm(a.pos_e - b.pos_e, axis=1)
    glonass = sky.sv >> 8 == SYS_R
    assert off[both & ~glonass].max() < 1e-3
    assert (both & glonass).sum() > 10
    assert off[both & glonass].max() < 1.0
    assert np.abs(a.clock_s - b.clock_s)[both].max() * C_LIGHT < 1e-3
    true = sky.states(b.t_tx_ns, sky.sv)
    assert np.linalg.norm(b.pos_e - true[:, :3], axis=1).max() < 5e-3


def test_sky_of_another_day_is_refused():
    records = sky_of("gps").records
    section = Sky(source="nav", files=("x",), constellations=("gps",))
    late = T0 + 100 * 24 * HOUR
    with pytest.raises(StarwiseError, match="no broadcast record within a day"):
        build_sky(section, late, late + HOUR, streams(1), records)
