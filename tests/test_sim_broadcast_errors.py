"""Errors of simulated navigation messages that are those of real ones, system by system."""

import numpy as np
import pytest

from starwise.constants import C_LIGHT, NS
from starwise.errors import StarwiseError
from starwise.gnsstime import parse_time
from starwise.signals import sv_id, sv_name
from starwise.sim.broadcast_errors import TYPICAL, constellation_of, range_error, typical_sizes
from starwise.sim.sections import EphemerisError, Sky
from starwise.sim.seeds import streams
from starwise.sim.sky import build_sky

T0 = parse_time("2024-03-30T12:00:00")


@pytest.mark.golden
@pytest.mark.parametrize(
    ("name", "published"),
    # Montenbruck, Steigenberger, Hauschild (2018), abstract
    [("gps", 0.6), ("galileo", 0.2), ("beidou2", 1.0), ("glonass", 2.0)],
)
def test_range_errors_are_those_published(name: str, published: float) -> None:
    # Published with one digit: half a unit of it, as a fraction of the smallest, is more than this.
    assert abs(range_error(name) / published - 1.0) < 0.06


def test_generation_of_beidou_by_number() -> None:
    assert constellation_of(sv_id("C03")) == constellation_of(sv_id("C16")) == "beidou2"
    assert constellation_of(sv_id("C19")) == constellation_of(sv_id("C60")) == "beidou3"


def test_simulated_messages_have_them() -> None:
    clean = build_sky(Sky(), T0, T0 + 3600 * NS, streams(1))
    t = np.full(len(clean.sv), T0 + 600 * NS)
    right = clean.states(t, clean.sv)
    square = np.zeros((len(clean.sv), 2))
    runs = 60
    for run in range(runs):
        wrong = clean.with_error(EphemerisError(model="typical"), streams(3, run)).states(t, clean.sv)
        square[:, 0] += np.sum((wrong[:, :3] - right[:, :3]) ** 2, axis=1) / runs
        square[:, 1] += ((wrong[:, 6] - right[:, 6]) * C_LIGHT) ** 2 / runs
    for letter in "GREC":
        mine = np.array([sv_name(int(sv))[0] == letter for sv in clean.sv])
        size = typical_sizes(int(clean.sv[mine][0]))
        wanted = np.array([np.sum(size[:3] ** 2), size[3] ** 2])
        # at least 24 satellites x 60 runs: a mean square is known to sqrt(2 / 1440) = 3.7 % (1 sigma); 5 sigma
        assert np.abs(square[mine].mean(axis=0) / wanted - 1.0).max() < 0.19


def test_sizes_beside_typical_are_refused() -> None:
    with pytest.raises(StarwiseError, match="typical excludes sizes"):
        EphemerisError(model="typical", clock_m=1.0)
    assert set(TYPICAL) == {constellation_of(sv_id(n)) for n in ("G01", "R01", "E01", "C06", "C30", "J01")}
