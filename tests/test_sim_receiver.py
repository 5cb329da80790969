"""The simulated receiver: laws of light paths, terms, streams, masks, faults, and what a solver makes of it."""

from __future__ import annotations

import numpy as np
import pytest

from starwise.config import RunConfig
from starwise.constants import C_LIGHT, NS, OMEGA_E_GPS, SYS_C, SYS_G, SYS_R
from starwise.errors import StarwiseError
from starwise.estimators.run import solve_run
from starwise.frames import azimuth_elevation, ecef_from_geodetic
from starwise.gnsstime import parse_time
from starwise.kernels.rangemodel import range_los, range_rate
from starwise.physics.broadcast import BroadcastEphemeris
from starwise.signals import frequency_table, signal_id, sv_id
from starwise.sim.receiver import Motion, receive
from starwise.sim.sections import (
    Clock,
    EphemerisError,
    Fault,
    Ionosphere,
    Multipath,
    Noise,
    Receiver,
    Sky,
    Troposphere,
)
from starwise.sim.seeds import streams
from starwise.sim.sky import build_sky

T0 = parse_time("2024-03-30T11:00:00")
PLACE = ecef_from_geodetic([np.radians(30.5), np.radians(114.3), 50.0])
SILENT = Noise(model="fixed", code_m=0.0, phase_m=0.0, rate_mps=0.0, cn0_sigma_db=0.0)
ALL = ("gps", "glonass", "galileo", "beidou2", "beidou3", "qzss")
_SKIES = {}


def sky_of(names=ALL, seconds=3600):
    key = (names, seconds)
    if key not in _SKIES:
        _SKIES[key] = build_sky(Sky(constellations=names), T0, T0 + seconds * NS, streams(1))
    return _SKIES[key]


def tags(n, step_s=1.0):
    return T0 + np.round(np.arange(n) * step_s * NS).astype(np.int64)


def moving(t_ns, clock_s=3.3e-4, drift=1e-7, speed=300.0, acceleration=5.0):
    """An aircraft on a parabola in ECEF, with a receiver clock that drifts."""
    s = (t_ns - T0) / NS
    clock = clock_s + drift * s
    true = (s - clock)[:, None]
    v0, a = speed * np.array([0.3, -0.5, 0.8]), acceleration * np.array([0.2, 0.9, -0.1])
    n = len(t_ns)
    return Motion(
        t_ns, clock, np.full(n, drift), np.zeros(n), PLACE * 1.001 + true * v0 + 0.5 * true**2 * a, v0 + true * a,
        np.tile(a, (n, 1)), np.zeros((n, 3)),
    )  # fmt: skip


def run(receiver=None, faults=(), motion=None, n=60, names=ALL, seed=1, number=0, step_s=1.0):
    motion = Motion.at_rest(tags(n, step_s), PLACE) if motion is None else motion
    return receive(receiver or Receiver(), faults, sky_of(names), motion, streams(seed, number))


# -- geometry --------------------------------------------------------------------------------------------------------
@pytest.mark.laws
@pytest.mark.parametrize("still", [True, False])
def test_iterated_light_time_and_closed_form_agree_to_fractions_of_a_millimetre(still):
    motion = Motion.at_rest(tags(5, 600.0), PLACE) if still else moving(tags(5, 100.0))
    _, truth = run(motion=motion)
    p = truth.paths
    for k in range(len(p.sv)):
        pos = motion.pos_e[p.epoch[k]]
        rho, sagnac, *_ = range_los(*pos, *p.sat_pos_e[k])
        closed = p.range_m[k] - rho - sagnac
        # m: the closed form leaves out ((omega tau)^2 s.p + sagnac^2) / 2 rho: 0.13 mm for the highest MEO
        assert 0.0 <= closed + 1e-5 < (1.5e-4 if np.linalg.norm(p.sat_pos_e[k]) < 31e6 else 3.5e-4)
        turned = OMEGA_E_GPS * p.range_m[k] / C_LIGHT
        second = (turned**2 * (p.sat_pos_e[k, :2] @ pos[:2]) + sagnac**2) / (2.0 * rho)
        assert abs(closed - second) < 2e-8  # m: rounding of 4e7 m


@pytest.mark.laws
def test_range_rate_is_the_model_s_up_to_terms_of_second_order():
    motion = moving(tags(3, 30.0))
    _, truth = run(motion=motion)
    p = truth.paths
    for k in range(len(p.sv)):
        m = p.epoch[k]
        pos, vel = motion.pos_e[m], motion.vel_e[m]
        *_, ux, uy, uz = range_los(*pos, *p.sat_pos_e[k])
        model = range_rate(pos[0], pos[1], *vel, ux, uy, uz, p.sat_pos_e, p.sat_vel_e, k)
        # m/s: the satellite's part counts 1 - rate / c (4 km/s times 1 km/s over c: 13 mm/s at most)
        assert abs(model - p.range_rate_mps[k]) < 0.015


@pytest.mark.laws
def test_doppler_is_the_derivative_of_phase_and_code_against_the_receiver_s_clock():
    receiver = Receiver(
        noise=SILENT,
        ionosphere=Ionosphere(model="layer", residual_m=1.0, residual_tau_s=600.0),
        troposphere=Troposphere(model="saastamoinen", zenith_offset_m=0.1, residual_m=0.05),
        ephemeris=EphemerisError(radial_m=1.0),
        signals={"G": ("1C", "2W"), "R": ("1C",), "E": ("1C",), "C": ("2I",), "J": ("1C",)},
    )
    t = T0 + 600 * NS + np.array([-1, 0, 1]) * NS // 2
    obs, _ = run(receiver, motion=moving(t))
    a, b, c = (slice(obs.offsets[k], obs.offsets[k + 1]) for k in range(3))
    assert np.array_equal(obs.sv[a], obs.sv[c])
    wave = C_LIGHT / frequency_table(obs.channels)[obs.sv[b] >> 8, obs.sv[b] & 255, obs.sig[b] >> 8]
    over_s = 1.0
    phase_rate = wave * (obs.phase_cyc[c] - obs.phase_cyc[a]) / over_s
    # m/s: third derivative of the range over 24, and the curvature of the air's delay at 5 deg
    assert np.abs(phase_rate + wave * obs.doppler_hz[b]).max() < 4e-4
    assert np.abs((obs.code_m[c] - obs.code_m[a]) / over_s + wave * obs.doppler_hz[b]).max() < 0.2  # dispersion


@pytest.mark.laws
def test_terms_add_up_to_the_observations():
    receiver = Receiver(
        ionosphere=Ionosphere(model="broadcast", residual_m=0.5),
        troposphere=Troposphere(model="saastamoinen", residual_m=0.05),
        multipath=Multipath(sigma_m=0.7),
        clock=Clock(intersystem_m={"C": 12.0, "R": -3.0}),
    )
    faults = (Fault(kind="step", size=50.0, satellites=("G",), start_s=10.0), Fault(kind="cycle_slip", size=3.0))
    obs, truth = run(receiver, faults, moving(tags(40)))
    p, r = truth.paths, truth.rows
    k, m = r.path, truth.paths.epoch[r.path]
    clocks = C_LIGHT * (truth.clock_s[m] - p.sat_clock_s[k])
    code = (
        p.range_m[k] + clocks + r.ionosphere_m + p.troposphere_m[k] + r.group_delay_m + r.intersystem_m
        + r.multipath_m + r.code_noise_m + r.code_fault_m
    )  # fmt: skip
    assert np.abs(code - obs.code_m).max() < 1e-6  # m: rounding
    wave = C_LIGHT / frequency_table(obs.channels)[obs.sv >> 8, obs.sv & 255, obs.sig >> 8]
    phase = (
        p.range_m[k] + clocks - C_LIGHT * truth.steered_s[m] - r.ionosphere_m + p.troposphere_m[k]
        + r.phase_multipath_m + r.phase_noise_m + r.phase_fault_m
    )  # fmt: skip
    assert np.abs(phase / wave + r.ambiguity_cyc - obs.phase_cyc).max() < 1e-6  # cycles
    rate = r.rate_mps + r.rate_noise_mps + r.rate_fault_mps
    assert np.abs(rate + wave * obs.doppler_hz).max() < 1e-9
    assert obs.epoch_of_row().tolist() == m.tolist()
    table = truth.rows_to_polars(obs.sig)
    assert table.height == obs.n_rows
    assert np.array_equal(table["code_fault_m"].to_numpy(), r.code_fault_m)
    assert truth.epochs_to_polars().height == 40


@pytest.mark.laws
def test_ionosphere_scales_with_the_square_of_the_wavelength_and_changes_sign_on_the_phase():
    base = Receiver(noise=SILENT, signals={"G": ("1C", "2W", "5Q")}, mask_deg=10.0)
    with_air = Receiver(
        noise=SILENT, signals={"G": ("1C", "2W", "5Q")}, mask_deg=10.0, ionosphere=Ionosphere(model="layer")
    )
    a, _ = run(base, n=3, names=("gps",))
    b, truth = run(with_air, n=3, names=("gps",))
    delay = b.code_m - a.code_m
    wave = C_LIGHT / frequency_table({})[b.sv >> 8, b.sv & 255, b.sig >> 8]
    advance = wave * (a.phase_cyc - b.phase_cyc)
    assert np.abs(delay - advance).max() < 1e-6  # m
    assert delay.min() > 1.0
    one = b.sig == signal_id("1C")
    for name, f in (("2W", 1227.60), ("5Q", 1176.45)):
        other = b.sig == signal_id(name)
        assert np.abs(delay[other] - delay[one] * (1575.42 / f) ** 2).max() < 1e-6
    vertical = truth.paths.ionosphere_m / (1.0 / np.sqrt(1 - (6371 / 6771 * np.cos(truth.paths.elevation)) ** 2))
    # 20 TECU at 14 h local time are 3.25 m on L1; here it is 18:37 and the gradients count
    assert 0.3 < vertical.min() < vertical.max() < 3.5


# -- what a solver makes of it ---------------------------------------------------------------------------------------
def solved(obs, sky, **options):
    config = RunConfig.from_dict({"method": "lsq", "systems": "GRECJ", "mask_deg": 5.0, **options})
    return solve_run(obs, BroadcastEphemeris(sky.records), sky.records.ionosphere, config)


@pytest.mark.laws
def test_without_errors_least_squares_finds_the_truth():
    receiver = Receiver(
        noise=SILENT, signals={s: (f,) for s, f in (("G", "1C"), ("R", "1C"), ("E", "1C"), ("C", "2I"))}
    )
    motion = moving(tags(5, 60.0))
    obs, truth = run(receiver, motion=motion, names=ALL[:5])
    found = solved(obs, sky_of(ALL[:5]), ionosphere="none", troposphere="none", systems="GREC")
    off = np.linalg.norm(found.pos_e - truth.pos_e, axis=1)
    assert off.max() < 5e-3  # m: GLONASS messages of 2 mm, times DOP
    assert np.linalg.norm(found.vel_e - truth.vel_e, axis=1).max() < 0.02  # m/s: second-order terms of the rate
    assert np.abs(found.clock_m - C_LIGHT * truth.clock_s[:, None]).max() < 5e-3


@pytest.mark.laws
def test_with_the_model_s_own_atmosphere_least_squares_finds_the_truth():
    receiver = Receiver(
        noise=SILENT,
        ionosphere=Ionosphere(model="broadcast", scale=1.0),
        troposphere=Troposphere(model="saastamoinen"),
        signals={"G": ("1C",), "E": ("1C",), "C": ("2I",)},
    )
    obs, truth = run(receiver, n=4, step_s=300.0, names=("gps", "galileo", "beidou3"))
    found = solved(obs, sky_of(("gps", "galileo", "beidou3")), systems="GEC")
    # m: elevations from the satellite at transmission instead of reception, 6e-6 rad
    assert np.linalg.norm(found.pos_e - truth.pos_e, axis=1).max() < 5e-3


def test_atmosphere_that_is_not_the_model_is_seen():
    receiver = Receiver(
        noise=SILENT, ionosphere=Ionosphere(model="layer", vtec_tecu=60.0), troposphere=Troposphere("saastamoinen", 0.1)
    )
    obs, truth = run(receiver, n=2, names=("gps", "galileo", "beidou3"))
    found = solved(obs, sky_of(("gps", "galileo", "beidou3")), systems="GEC")
    assert 0.3 < np.linalg.norm(found.pos_e - truth.pos_e, axis=1).max() < 20.0


# -- randomness ------------------------------------------------------------------------------------------------------
FULL = {
    "noise": Noise(),
    "multipath": Multipath(sigma_m=0.5),
    "ionosphere": Ionosphere(model="broadcast", residual_m=0.5),
    "troposphere": Troposphere(model="saastamoinen", residual_m=0.05),
    "ephemeris": EphemerisError(),
}
SOURCES = {
    "code_noise_m": {"noise": Noise(code_m=0.0)},
    "phase_noise_m": {"noise": Noise(phase_m=0.0)},
    "rate_noise_mps": {"noise": Noise(rate_mps=0.0)},
    "multipath_m": {"multipath": Multipath()},
    "ionosphere_m": {"ionosphere": Ionosphere()},
}


@pytest.mark.laws
@pytest.mark.parametrize("off", SOURCES)
def test_turning_one_source_off_changes_no_other(off):
    _, with_all = run(Receiver(**FULL), n=20)
    _, without = run(Receiver(**{**FULL, **SOURCES[off]}), n=20)
    for name in (*SOURCES, "ambiguity_cyc", "group_delay_m"):
        a, b = getattr(with_all.rows, name), getattr(without.rows, name)
        if name == off:
            assert np.abs(a).max() > 0.0
            assert np.abs(b).max() == 0.0
        elif not (name == "phase_multipath_m" and off == "multipath_m"):
            assert np.array_equal(a, b), name
    assert np.array_equal(with_all.paths.troposphere_m, without.paths.troposphere_m)


@pytest.mark.laws
def test_masking_satellites_and_dropping_signals_changes_no_number_of_the_others():
    a, _ = run(n=20)
    b, _ = run(Receiver(mask_deg=25.0, signals={"G": ("5Q",), "R": ("1C",)}), n=20)
    seen = {(int(e), int(s), int(g)): c for e, s, g, c in zip(a.epoch_of_row(), a.sv, a.sig, a.code_m, strict=True)}
    assert 0 < b.n_rows < a.n_rows
    for e, s, g, c in zip(b.epoch_of_row(), b.sv, b.sig, b.code_m, strict=True):
        assert seen[int(e), int(s), int(g)] == c


@pytest.mark.laws
def test_a_seed_and_a_run_give_the_same_numbers_and_others_do_not():
    a, _ = run(n=5, seed=4, number=7)
    b, _ = run(n=5, seed=4, number=7)
    c, _ = run(n=5, seed=4, number=8)
    assert np.array_equal(a.code_m, b.code_m)
    assert np.array_equal(a.phase_cyc, b.phase_cyc)
    assert not np.array_equal(a.code_m, c.code_m)


@pytest.mark.parametrize("model", ["fixed", "elevation", "cn0"])
def test_noise_has_the_size_asked_for(model):
    receiver = Receiver(
        noise=Noise(model=model, code_m=6.0, rate_mps=0.1, phase_m=0.002, cn0_sigma_db=0.0), mask_deg=5.0
    )
    obs, truth = run(receiver, n=600)
    sin_el = np.sin(truth.paths.elevation[truth.rows.path])
    factor = {"fixed": 1.0, "elevation": 1.0 / sin_el, "cn0": 10 ** ((45.0 - obs.cn0_dbhz) / 20.0)}[model]
    n = obs.n_rows
    for values, sigma in (
        (truth.rows.code_noise_m, 6.0), (truth.rows.rate_noise_mps, 0.1), (truth.rows.phase_noise_m, 0.002),
    ):  # fmt: skip
        unit = values / factor / sigma
        assert abs(unit.mean()) < 5.0 / np.sqrt(n)  # 5 sigma
        assert abs(unit.std() - 1.0) < 5.0 / np.sqrt(2.0 * n)
        assert abs((unit[:-1] * unit[1:]).mean()) < 5.0 / np.sqrt(n)
    assert obs.cn0_dbhz[np.argmax(sin_el)] > obs.cn0_dbhz[np.argmin(sin_el)] + 8.0


def test_multipath_is_correlated_as_asked():
    receiver = Receiver(
        multipath=Multipath(sigma_m=1.0, tau_s=20.0), noise=SILENT, signals={"G": ("1C",), "E": ("1C",)}
    )
    _, truth = run(receiver, n=3600, names=("gps", "galileo"))
    sin_el = np.maximum(np.sin(truth.paths.elevation[truth.rows.path]), 0.05)
    unit = truth.rows.multipath_m * sin_el
    sv = truth.paths.sv[truth.rows.path]
    at_lag = {0: [], 20: []}
    for one in np.unique(sv):
        x = unit[sv == one]
        for lag in at_lag:
            at_lag[lag].append((x[: len(x) - lag] * x[lag:]).mean())
    # about 20 satellites of 3600 s, 90 independent samples each: 1 sigma 0.03
    assert abs(np.mean(at_lag[0]) - 1.0) < 0.15
    assert abs(np.mean(at_lag[20]) - np.exp(-1.0)) < 0.15


# -- masks, arcs, faults ---------------------------------------------------------------------------------------------
def test_masks_by_elevation_and_azimuth():
    receiver = Receiver(mask_deg=12.0, azimuth_masks_deg=((300.0, 60.0, 50.0),))
    motion = Motion.at_rest(tags(3, 600.0), PLACE)
    obs, truth = run(receiver, motion=motion)
    open_sky, _ = run(Receiver(mask_deg=12.0), motion=motion)
    p = truth.paths
    az, el = np.degrees(p.azimuth), np.degrees(p.elevation)
    assert el.min() > 12.0 - 1e-3
    north = (az >= 300.0) | (az <= 60.0)
    assert el[north].min() > 50.0 - 1e-3
    assert el[~north].min() < 40.0
    assert obs.n_rows < open_sky.n_rows
    for k in range(0, len(p.sv), 7):
        a, e = azimuth_elevation(PLACE, p.sat_pos_e[k])
        assert abs(a - p.azimuth[k]) * np.cos(e) < 2e-5  # rad: the Earth turns by 1e-5 during the flight
        assert abs(e - p.elevation[k]) < 2e-5


def test_nothing_in_view_is_one_line():
    south = ecef_from_geodetic([np.radians(-60.0), np.radians(-70.0), 0.0])
    with pytest.raises(StarwiseError, match=r"no satellite is visible at any time; found '3 in the sky, highest at -"):
        run(motion=Motion.at_rest(tags(3), south), names=("beidou1",))
    with pytest.raises(StarwiseError, match="an outage covers them all"):
        run(faults=(Fault(kind="outage"),), n=3)


def test_epochs_without_satellites_stay():
    obs, truth = run(faults=(Fault(kind="outage", start_s=2.0, duration_s=3.0),), n=8)
    assert np.array_equal(np.diff(obs.offsets) > 0, [1, 1, 0, 0, 0, 1, 1, 1])
    assert np.array_equal(truth.visible == 0, [0, 0, 1, 1, 1, 0, 0, 0])


def test_an_outage_breaks_the_phase_and_says_so():
    obs, truth = run(
        Receiver(noise=SILENT, mask_deg=10.0),
        (Fault(kind="outage", satellites=("G",), start_s=2.0, duration_s=2.0),),
        n=8,
    )
    gps = obs.sv >> 8 == SYS_G
    epoch = obs.epoch_of_row()
    assert set(epoch[gps]) == {0, 1, 4, 5, 6, 7}
    assert (obs.lli[gps & (epoch == 4)] == 1).all()
    assert obs.lli.sum() == (gps & (epoch == 4)).sum()
    before, after = (truth.rows.ambiguity_cyc[gps & (epoch == e)] for e in (1, 4))
    assert (before != after).all()


def test_outage_of_one_signal_leaves_the_other():
    obs, _ = run(faults=(Fault(kind="outage", satellites=("G",), signals=("1C",)),), n=2)
    assert set(obs.sig[obs.sv >> 8 == SYS_G]) == {signal_id("5Q")}
    assert signal_id("1C") in obs.sig


def changed(fault, **options):
    """Differences that one fault makes: obs with, obs without, wavelength, time of rows."""
    a, _ = run(Receiver(**options), n=30)
    b, truth = run(Receiver(**options), (fault,), n=30)
    wave = C_LIGHT / frequency_table(b.channels)[b.sv >> 8, b.sv & 255, b.sig >> 8]
    return a, b, wave, b.epoch_of_row().astype(float), truth


def test_step_ramp_and_spoof():
    a, b, _, t, truth = changed(Fault(kind="step", size=100.0, satellites=("G05",), start_s=5.0, duration_s=10.0))
    hit = (b.sv == sv_id("G05")) & (t >= 5) & (t < 15)
    assert hit.sum() == 20
    assert np.allclose(b.code_m - a.code_m, np.where(hit, 100.0, 0.0), atol=1e-6, rtol=0)
    assert np.array_equal(a.phase_cyc, b.phase_cyc)
    assert np.array_equal(truth.rows.code_fault_m != 0, hit)

    for kind in ("ramp", "spoof"):
        extra = {"observable": "all"} if kind == "ramp" else {}
        fixed = Noise(model="fixed")  # a stronger signal is less noisy by the model of C/N0
        a, b, wave, t, _ = changed(Fault(kind=kind, size=2.0, satellites=("R",), start_s=4.0, **extra), noise=fixed)
        hit = (b.sv >> 8 == SYS_R) & (t >= 4)
        grown = np.where(hit, 2.0 * (t - 4.0), 0.0)
        assert np.allclose(b.code_m - a.code_m, grown, atol=1e-6, rtol=0)
        assert np.allclose(wave * (b.phase_cyc - a.phase_cyc), grown, atol=1e-6, rtol=0)
        assert np.allclose(-wave * (b.doppler_hz - a.doppler_hz), np.where(hit, 2.0, 0.0), atol=1e-9, rtol=0)
        assert np.allclose(b.cn0_dbhz - a.cn0_dbhz, np.where(hit & (kind == "spoof"), 3.0, 0.0))


def test_cycle_slip_is_on_the_phase_and_indicated_once():
    a, b, _, t, _ = changed(Fault(kind="cycle_slip", size=7.0, satellites=("G05",), signals=("1C",), start_s=6.0))
    hit = (b.sv == sv_id("G05")) & (b.sig == signal_id("1C")) & (t >= 6)
    assert np.allclose(b.phase_cyc - a.phase_cyc, np.where(hit, 7.0, 0.0), atol=1e-6, rtol=0)
    assert np.array_equal(a.code_m, b.code_m)
    assert np.array_equal(b.lli == 1, hit & (t == 6))


def test_clock_jump_moves_everything_and_stays():
    a, b, wave, t, truth = changed(Fault(kind="clock_jump", size=3000.0, start_s=10.0, duration_s=1.0))
    moved = np.where(t >= 10, 3000.0, 0.0)
    # m: received 10 us earlier, satellites move by up to 1 km/s towards the receiver
    assert np.abs(b.code_m - a.code_m - moved).max() < 0.02
    assert np.abs(wave * (b.phase_cyc - a.phase_cyc) - moved).max() < 0.02
    assert np.array_equal(truth.clock_s > 0, np.arange(30) >= 10)


def test_burst_is_noise_of_its_size():
    a, b, _, t, _ = changed(Fault(kind="burst", size=500.0, start_s=10.0, duration_s=10.0))
    hit = (t >= 10) & (t < 20)
    d = b.code_m - a.code_m
    assert np.abs(d[~hit]).max() == 0.0
    assert abs(d[hit].std() / 500.0 - 1.0) < 5.0 / np.sqrt(2.0 * hit.sum())


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (Fault(kind="step", size=1.0, satellites=("I03",)), "not in the sky; found 'I03'"),
        (Fault(kind="step", size=1.0, signals=("9Z",)), "not received; found '9Z'"),
        (Fault(kind="step", size=1.0, start_s=1e4), "starts after the end"),
    ],
)
def test_faults_that_cannot_act_are_refused(fault, message):
    with pytest.raises(StarwiseError, match=message):
        run(faults=(fault,), n=3)


def test_satellites_send_the_signals_of_their_generation():
    obs, _ = run(Receiver(signals={"C": ("2I", "7I", "7D", "1P")}), n=1)
    for sv in np.unique(obs.sv):
        number = int(sv) & 255
        expected = {"2I", "7I"} if number <= 18 else {"2I", "7D", "1P"}
        assert set(obs.sig[obs.sv == sv]) == {signal_id(s) for s in expected}
        assert sv >> 8 == SYS_C


def test_phase_and_doppler_can_be_left_out():
    obs, _ = run(Receiver(phase=False, doppler=False), n=2)
    assert np.isnan(obs.phase_cyc).all()
    assert np.isnan(obs.doppler_hz).all()
    assert np.isfinite(obs.code_m).all()


def test_steering_by_milliseconds_moves_code_and_not_phase():
    n = 20
    free = 4.995e-4 + 1e-7 * np.arange(n)
    steered = np.where(np.arange(n) >= 10, -1e-3, 0.0)
    still = Motion.at_rest(tags(n), PLACE)
    motion = Motion(
        still.t_ns, free + steered, np.full(n, 1e-7), steered, still.pos_e, still.vel_e, still.acc_e, still.euler
    )
    obs, _ = run(Receiver(noise=SILENT, signals={"G": ("1C",)}), motion=motion, names=("gps",))
    one = obs.sv == obs.sv[0]
    code = np.diff(obs.code_m[one])
    phase = np.diff(obs.phase_cyc[one]) * C_LIGHT / 1575.42e6
    # sampled 1 ms later: the satellite moves by less than 1 m in that time
    assert abs(code[9] - code[8] + 1e-3 * C_LIGHT) < 2.0
    assert np.abs(np.diff(phase)).max() < 2.0
