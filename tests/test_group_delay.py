"""Group delays: each system's rule by its ICD, and what must cancel."""

import numpy as np
import pytest

from records import T0, record, records
from starwise.constants import (
    C_LIGHT,
    ISC_1,
    ISC_2,
    ISC_3,
    ISC_4,
    NS,
    R_DTAU,
    TGD_B1CP,
    TGD_B2AP,
    TGD_MAIN,
    TGD_SECOND,
)  # fmt: skip
from starwise.physics.broadcast import BroadcastEphemeris
from starwise.physics.group_delay import PRECISE_CLOCK
from starwise.signals import frequency, signal_id, sv_id

GPS_12 = (1575.42 / 1227.60) ** 2
GPS_15 = (1575.42 / 1176.45) ** 2
E1_5A, E1_5B = (1575.42 / 1176.45) ** 2, (1575.42 / 1207.14) ** 2


def delay(eph, sv, one, two="", reference=None):
    """Delay, ns, of a signal or a combination by the satellite's record at T0."""
    s = np.array([sv_id(sv)], dtype=np.int16)
    rec = eph.states(np.array([T0]), s, np.zeros(1), True).record
    pair = [np.array([signal_id(x) if x else 0], dtype=np.int16) for x in (one, two)]
    return eph.group_delay(rec, s, *pair, reference)[0] / C_LIGHT * 1e9


def test_gps_lnav():
    eph = BroadcastEphemeris(records(record("G05", tgd={TGD_MAIN: -5e-9})))
    assert delay(eph, "G05", "1C") == pytest.approx(-5.0)  # clock of an L1 user: dt - TGD
    assert delay(eph, "G05", "1W") == pytest.approx(-5.0)
    assert delay(eph, "G05", "2W") == pytest.approx(-5.0 * GPS_12)
    assert np.isnan(delay(eph, "G05", "5Q"))
    assert delay(eph, "G05", "1W", "2W") == pytest.approx(0.0, abs=1e-9)
    assert delay(eph, "G05", "1C", "2W") == pytest.approx(0.0, abs=1e-9)


def test_gps_isc_comes_from_cnav():
    """LNAV gives the orbit, CNAV of the same satellite the ISC (IS-GPS-200N 30.3.3.3.1.1)."""
    isc = {TGD_MAIN: -5e-9, ISC_1: 1e-9, ISC_2: 3e-9, ISC_3: 6e-9, ISC_4: 7e-9}
    eph = BroadcastEphemeris(
        records(
            record("G05", tgd={TGD_MAIN: -5e-9}),
            record("G05", 3600.0, message="CNAV", tgd=isc),
            record("G06", tgd={TGD_MAIN: -4e-9}),
        )
    )
    assert delay(eph, "G05", "1C") == pytest.approx(-5.0 - 1.0)
    assert delay(eph, "G05", "1W") == pytest.approx(-5.0)
    assert delay(eph, "G05", "2L") == pytest.approx(-5.0 - 3.0)
    assert delay(eph, "G05", "2W") == pytest.approx(-5.0 * GPS_12)
    assert delay(eph, "G05", "5I") == pytest.approx(-5.0 - 6.0)
    assert delay(eph, "G05", "5Q") == pytest.approx(-5.0 - 7.0)
    # IS-GPS-200N 30.3.3.3.1.1.2, L1 C/A and L5: PR = (PR5 - g PR1 + c (ISC5 - g ISC1)) / (1 - g) - c TGD
    want = -5.0 - (7.0 - GPS_15 * 1.0) / (1 - GPS_15)
    assert delay(eph, "G05", "1C", "5Q") == pytest.approx(want)
    assert delay(eph, "G06", "1C") == pytest.approx(-4.0)


def test_galileo():
    """Galileo OS SIS ICD 2.1, 5.1.5: an E1 user of the clock (E1, E5x) takes dt - BGD(E1, E5x)."""
    bgd = {TGD_MAIN: 2e-9, TGD_SECOND: 3e-9}
    eph = BroadcastEphemeris(records(record("E11", tgd=bgd), record("E12", message="FNAV", tgd=bgd)))
    assert delay(eph, "E11", "1C") == pytest.approx(3.0)
    assert delay(eph, "E11", "7Q") == pytest.approx(3.0 * E1_5B)
    assert delay(eph, "E11", "1C", "7Q") == pytest.approx(0.0, abs=1e-9)
    assert delay(eph, "E12", "1C") == pytest.approx(2.0)
    assert delay(eph, "E12", "5Q") == pytest.approx(2.0 * E1_5A)
    assert delay(eph, "E12", "1X", "5X") == pytest.approx(0.0, abs=1e-9)
    # I/NAV clock on (E1, E5a): differs from F/NAV's by exactly what the two clocks differ, BGD_b - BGD_a
    assert delay(eph, "E11", "1C", "5Q") == pytest.approx(3.0 - 2.0)
    # differences between signals are the satellite's and do not know which clock is used
    for one, two in (("1C", "5Q"), ("1C", "7Q"), ("7X", "5X")):
        by_inav = delay(eph, "E11", one) - delay(eph, "E11", two)
        assert by_inav == pytest.approx(delay(eph, "E12", one) - delay(eph, "E12", two))
    assert np.isnan(delay(eph, "E11", "6C"))


def test_galileo_fnav_of_rinex_3_has_no_second_delay():
    eph = BroadcastEphemeris(records(record("E12", message="FNAV", tgd={TGD_MAIN: 2e-9, TGD_SECOND: 0.0})))
    assert delay(eph, "E12", "5Q") == pytest.approx(2.0 * E1_5A)
    assert np.isnan(delay(eph, "E12", "7Q"))


def test_beidou():
    d1 = {TGD_MAIN: 4e-9, TGD_SECOND: -2e-9}
    cnv1 = {TGD_B1CP: 1e-9, TGD_B2AP: -3e-9, ISC_1: 0.5e-9}
    cnv2 = {TGD_B1CP: 1e-9, TGD_B2AP: -3e-9, ISC_2: 0.25e-9}
    cnv3 = {TGD_B2AP: -7e-9}
    eph = BroadcastEphemeris(
        records(
            record("C06", tgd=d1),
            record("C21", tgd=d1),
            record("C21", message="CNV1", tgd=cnv1),
            record("C21", message="CNV2", tgd=cnv2),
            record("C21", message="CNV3", tgd=cnv3),
        )
    )
    assert delay(eph, "C06", "2I") == pytest.approx(4.0)
    assert delay(eph, "C06", "7I") == pytest.approx(-2.0)
    assert delay(eph, "C06", "6I") == pytest.approx(0.0)
    g = 1561.098**2 / (1561.098**2 - 1268.52**2)
    assert delay(eph, "C06", "2I", "6I") == pytest.approx(g * 4.0)
    assert np.isnan(delay(eph, "C06", "1P"))
    for name, want in (("2I", 4.0), ("1P", 1.0), ("1D", 1.5), ("5P", -3.0), ("5D", -2.75), ("7D", -7.0)):
        assert delay(eph, "C21", name) == pytest.approx(want), name


def test_glonass():
    eph = BroadcastEphemeris(records(record("R01", par={R_DTAU: -1.8e-9})))
    assert delay(eph, "R01", "1C") == 0.0
    assert delay(eph, "R01", "2P") == pytest.approx(-1.8)
    f1, f2 = frequency(1, 1, 1), frequency(1, 2, 1)
    assert delay(eph, "R01", "1C", "2C") == pytest.approx(1.8 * f2**2 / (f1**2 - f2**2))


@pytest.mark.laws
def test_precise_clocks_have_no_delay_on_their_own_pair():
    tgd = {TGD_MAIN: -5e-9, TGD_SECOND: 3e-9}
    eph = BroadcastEphemeris(records(*[record(sv, tgd=tgd) for sv in ("G05", "E11", "C21", "J02", "R01")]))
    for sv in ("G05", "E11", "C21", "J02", "R01"):
        assert delay(eph, sv, *PRECISE_CLOCK[sv[0]], PRECISE_CLOCK) == pytest.approx(0.0, abs=1e-9)
    # and a single frequency keeps its distance to the other
    one, two = PRECISE_CLOCK["C"]
    assert delay(eph, "C21", one, "", PRECISE_CLOCK) - delay(eph, "C21", two, "", PRECISE_CLOCK) == pytest.approx(-5.0)


def test_no_record_is_nan():
    eph = BroadcastEphemeris(records(record("G05", tgd={TGD_MAIN: 1e-9})))
    i2 = np.array([sv_id("G05")] * 2, dtype=np.int16)
    sig = np.full(2, signal_id("1C"), dtype=np.int16)
    out = eph.group_delay(np.array([-1, 0], dtype=np.int32), i2, sig, np.zeros(2, dtype=np.int16))
    assert np.isnan(out[0])
    assert out[1] == pytest.approx(C_LIGHT * 1e-9)
    assert NS == 10**9
