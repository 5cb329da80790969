"""Choice of signals: preference, blanks, pairs, exclusions, and a reason for every row."""

import numpy as np
import pytest

from starwise import constants as c
from starwise.errors import StarwiseError
from starwise.models.select import select
from starwise.signals import frequency, signal_id, sv_id
from starwise.types import Observations


def observations(rows: list[tuple[str, str, float, float]], channels=None) -> Observations:
    """One epoch of (satellite, signal, code, doppler)."""
    n = len(rows)
    return Observations(
        t_ns=np.array([10**18], dtype=np.int64),
        offsets=np.array([0, n], dtype=np.int64),
        flag=np.zeros(1, dtype=np.uint8),
        clock_offset_s=np.full(1, np.nan),
        sv=np.array([sv_id(r[0]) for r in rows], dtype=np.int16),
        sig=np.array([signal_id(r[1]) for r in rows], dtype=np.int16),
        code_m=np.array([r[2] for r in rows]),
        phase_cyc=np.full(n, np.nan),
        doppler_hz=np.array([r[3] for r in rows]),
        cn0_dbhz=np.full(n, 45.0),
        lli=np.zeros(n, dtype=np.uint8),
        channels=channels or {},
    )


NAN = float("nan")


def test_preference_blank_and_reason():
    obs = observations(
        [
            ("G01", "2W", 2.2e7, NAN),
            ("G01", "1C", 2.1e7, 1000.0),
            ("G02", "1C", NAN, NAN),
            ("G03", "1C", 5.0, NAN),
            ("R05", "1C", 2.0e7, NAN),
            ("E11", "5Q", 2.4e7, NAN),
            ("I02", "5A", 3.7e7, NAN),
        ]
    )
    s, status = select(obs, "GRE", exclude=["E11"])
    assert s.row[0] == 1
    assert s.rate_mps[0] == pytest.approx(-1000.0 * c.C_LIGHT / 1575.42e6, abs=1e-9)
    expected = [
        c.ROW_NOT_SELECTED,
        c.ROW_USED,
        c.ROW_NO_CODE,
        c.ROW_BAD_CODE,
        c.ROW_NO_FREQUENCY,  # GLONASS channel not known
        c.ROW_EXCLUDED_BY_USER,
        c.ROW_SYSTEM_OFF,
    ]
    assert status.tolist() == expected
    assert s.status.tolist() == expected[1:]


def test_glonass_channel_gives_the_frequency():
    obs = observations([("R05", "1C", 2.0e7, 500.0)], {sv_id("R05"): -3})
    s, _ = select(obs)
    assert s.freq_hz[0] == frequency(c.SYS_R, 1, -3) == pytest.approx(1602e6 - 3 * 0.5625e6, abs=0.1)
    assert select(observations([("R05", "1C", 2e7, 0.0)]), channels={sv_id("R05"): 4})[0].freq_hz[0] > 1602e6


def test_ionosphere_free_pair_cancels_the_first_order():
    f1, f2 = 1575.42e6, 1176.45e6
    iono = 7.0
    rows = [
        ("E11", "1C", 2.4e7 + iono, 100.0),
        ("E11", "5Q", 2.4e7 + iono * (f1 / f2) ** 2, NAN),
        ("E12", "1C", 2e7, NAN),
    ]
    s, status = select(observations(rows), ionosphere_free=True)
    assert s.code_m[0] == pytest.approx(2.4e7, abs=1e-7)
    assert s.noise_factor[0] == pytest.approx(2.588, abs=1e-3)  # E1/E5a: sqrt(2.261^2 + 1.261^2)
    assert status.tolist() == [c.ROW_USED, c.ROW_COMBINED, c.ROW_NO_PAIR]


def test_doppler_comes_from_another_signal_of_the_satellite():
    f2 = 1227.6e6
    s, _ = select(observations([("G01", "1C", 2.1e7, NAN), ("G01", "2W", 2.1e7, 800.0)]))
    assert s.rate_mps[0] == pytest.approx(-800.0 * c.C_LIGHT / f2, abs=1e-9)


def test_own_preference_and_unknown_names():
    obs = observations([("G01", "1C", 2.1e7, NAN), ("G01", "2W", 2.1e7, NAN)])
    assert select(obs, signals={"G": ["2W"]})[0].row[0] == 1
    assert select(obs, signals={"G": ["5Q"]})[0].status[0] == c.ROW_NOT_SELECTED
    for bad in ({"signals": {"X": ["1C"]}}, {"signals": {"G": ["C1C"]}}, {"exclude": ["Z9"]}, {"systems": "GX"}):
        with pytest.raises(StarwiseError):
            select(obs, **bad)
