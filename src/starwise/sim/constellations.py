"""Constellations as Keplerian tables, each with its source. Angles are degrees, as the sources print them.

A table gives the orbits at its epoch; `starwise.sim.sky` moves them to the day of the scenario by their mean motion
and the drift of their nodes. Where an operator publishes slots instead of satellites, the numbers of the satellites
follow the slots (they are this table's, not those in orbit today).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from starwise.errors import StarwiseError


class Orbit(NamedTuple):
    """A satellite's mean orbit at the epoch of its table."""

    name: str
    a_m: float
    """Semi-major axis, m; 0 for a geosynchronous orbit whose ground track stays where it is."""
    e: float
    i_deg: float
    node_deg: float
    """Right ascension of the ascending node, or its longitude at the epoch: see `Constellation.node_is_longitude`."""
    perigee_deg: float
    anomaly_deg: float
    """Mean anomaly."""
    node_rate_deg_day: float
    """Drift of the node in inertial space."""
    channel: int = 0
    """GLONASS frequency channel."""


@dataclass(frozen=True)
class Constellation:
    """Orbits of one system at one epoch."""

    key: str
    title: str
    source: str
    epoch: str
    """ISO, GPST; with Z, UTC."""
    node_is_longitude: bool
    orbits: tuple[Orbit, ...]


_RAD: Final = 57.29577951308232
_DEG_DAY: Final = 86400.0 * _RAD

# -- GPS ----------------------------------------------------------------------------------------------------------
_GPS_ALMANAC: Final = (
    # PRN, e, i rad, rate of node 1e-9 rad/s, sqrt(A), node at the week's start rad, perigee rad, mean anomaly rad
    (1, 0.007319927, 0.9701853, -7.714607, 5153.631836, -0.7462948, 0.6140530, -3.1143870),
    (2, 0.017784595, 0.9491770, -7.908901, 5153.629883, -0.8051819, -1.8977904, -2.7272856),
    (3, 0.001184464, 0.9610354, -7.817468, 5153.507324, 0.2961500, 0.5013409, 2.2337835),
    # PRN 4 was not in service that week. It takes the widest gap of the plane of PRN 7, 24, 30 and 31
    (4, 0.001000000, 0.9599311, -7.850000, 5153.600000, 2.4060000, -3.0000000, -2.2530000),
    (5, 0.005273819, 0.9479486, -7.931759, 5153.584473, 0.2757851, 0.6256484, -0.1452743),
    (6, 0.001093864, 0.9699157, -7.726036, 5153.526367, -0.7546294, -1.2487596, -2.8527814),
    (7, 0.011160851, 0.9595074, -7.737465, 5153.644531, 2.4089550, -2.5441839, 2.4837295),
    (8, 0.003314018, 0.9684057, -8.091766, 5153.710449, -1.8110651, -0.5581267, -0.5309409),
    (9, 0.001167774, 0.9525865, -8.011762, 5153.622070, 1.3305381, 1.7504500, -0.6944791),
    (10, 0.003267765, 0.9611492, -7.783181, 5153.614746, 0.2926327, -2.8328940, 1.1281792),
    (11, 0.016739845, 0.9038946, -8.491782, 5153.696777, -1.1663096, 1.7396091, 2.4568698),
    (12, 0.006932259, 0.9877842, -7.748894, 5153.604980, -2.7845324, 0.9191328, 1.9015860),
    (13, 0.003690720, 0.9683517, -7.828897, 5153.602051, 1.4607036, 1.6253036, -2.3844275),
    (14, 0.009328842, 0.9609095, -7.897472, 5153.677246, 1.4194970, -1.9567311, -1.2682774),
    (15, 0.010167122, 0.9281866, -8.274630, 5153.620117, 1.2624156, 0.6668289, -1.7894197),
    (16, 0.009852886, 0.9882216, -7.737465, 5153.540527, -2.7656505, 0.4654239, -0.0102739),
    (17, 0.012361526, 0.9817681, -7.908901, 5153.713379, -1.7499687, -1.7931494, -1.0270792),
    (18, 0.018512249, 0.9268923, -8.137482, 5153.592285, 0.2411747, -1.7530453, 0.5765090),
    (19, 0.009720325, 0.9791975, -7.943188, 5153.652344, -1.7027209, 1.1226477, 1.9934552),
    (20, 0.004470825, 0.9283364, -8.126053, 5153.723145, 0.1902181, 1.7876494, -2.0985846),
    (21, 0.024415493, 0.9426815, -7.954617, 5153.716797, -0.7975768, -1.5964047, 1.4321280),
    (22, 0.007274151, 0.9250348, -8.160340, 5153.532227, 0.2405384, -1.6155158, -1.5914377),
    (23, 0.011968613, 0.9434245, -8.114624, 5153.534180, 1.3299025, -2.3976689, -2.2786689),
    (24, 0.006801605, 0.9425257, -7.931759, 5153.605957, 2.3510431, 0.5218299, -2.8653289),
    (25, 0.007158756, 0.9755123, -7.851756, 5153.643066, -2.8429521, 0.8091206, 1.4550130),
    (26, 0.002670288, 0.9571105, -8.011762, 5153.559082, -2.8629875, 0.0111408, 0.9551982),
    (27, 0.005474567, 0.9765729, -8.011762, 5153.629883, -1.8034431, 0.3544121, -0.8662831),
    (28, 0.019752502, 0.9870651, -7.726036, 5153.630859, -2.7613272, -1.5265854, -0.0502764),
    (29, 0.000495434, 0.9829965, -7.931759, 5153.691895, -1.7395061, 0.7489523, 0.4764291),
    (30, 0.003075600, 0.9451802, -7.886043, 5153.521973, 2.4440875, -3.1152562, 2.6507701),
    (31, 0.008842945, 0.9642052, -7.714607, 5153.560059, 2.4210052, -0.1564218, 2.2789996),
    (32, 0.001667023, 0.9569967, -7.954617, 5153.572754, 1.3349966, -2.6935684, -0.1253606),
)  # fmt: skip
_GPS_TOA_S: Final = 589824.0
_OMEGA_E: Final = 7.2921151467e-5


def _gps() -> tuple[Orbit, ...]:
    """Almanac entries with the node's longitude moved from the week's start to the time of applicability."""
    return tuple(
        Orbit(
            f"G{prn:02d}",
            root_a * root_a,
            e,
            i * _RAD,
            ((node + (rate * 1e-9 - _OMEGA_E) * _GPS_TOA_S) * _RAD) % 360.0,
            perigee * _RAD,
            anomaly * _RAD,
            rate * 1e-9 * _DEG_DAY,
        )
        for prn, e, i, rate, root_a, node, perigee, anomaly in _GPS_ALMANAC
    )


# -- GLONASS ------------------------------------------------------------------------------------------------------
_GLONASS_CHANNELS: Final = (
    1, -4, 5, 6, 1, -4, 5, 6, -2, -7, 0, -1, -2, -7, 0, -1, 4, -3, 3, 2, 4, -3, 3, 2,
)  # fmt: skip


def _glonass() -> tuple[Orbit, ...]:
    """Three planes of eight, 45 deg apart within a plane and 15 deg from plane to plane."""
    return tuple(
        Orbit(
            f"R{slot + 1:02d}", 25_508_000.0, 0.001, 64.8,
            (251.25 + 120.0 * (slot // 8)) % 360.0, 0.0,
            (145.0 - 45.0 * (slot % 8) + 15.0 * (slot // 8)) % 360.0, -0.03358, _GLONASS_CHANNELS[slot],
        )
        for slot in range(24)
    )  # fmt: skip


# -- Galileo ------------------------------------------------------------------------------------------------------
_GALILEO_PLANES: Final = ((317.632, 225.153), (77.632, 240.153), (197.632, 255.153))
"""Right ascension and argument of latitude of the first slot of planes A, B, C."""


def _galileo() -> tuple[Orbit, ...]:
    """24 slots, and the two satellites of the eccentric orbits."""
    numbers = [n for n in range(1, 27) if n not in (14, 18)]
    slots = tuple(
        Orbit(
            f"E{numbers[8 * plane + k]:02d}", 29_599_801.0, 0.0002, 56.0,
            node, 0.0, (first + 45.0 * k) % 360.0, -0.02764398,
        )
        for plane, (node, first) in enumerate(_GALILEO_PLANES)
        for k in range(8)
    )  # fmt: skip
    extended = tuple(
        Orbit(name, 27_977_600.0, 0.162, 49.85, 52.521, 56.198, anomaly, -0.03986760)
        for name, anomaly in (("E18", 316.069), ("E14", 136.069))
    )
    return tuple(sorted(slots + extended))


# -- BeiDou -------------------------------------------------------------------------------------------------------
def _geostationary(name: str, longitude_deg: float, i_deg: float = 0.5) -> Orbit:
    """On the node at the epoch, at the longitude wanted."""
    return Orbit(name, 0.0, 0.0003, i_deg, longitude_deg, 0.0, 0.0, 0.0)


def _inclined(name: str, crossing_deg: float, phase_deg: float, i_deg: float = 55.0) -> Orbit:
    """Geosynchronous; crosses the equator northwards at a longitude, ``phase_deg`` before the epoch's satellite."""
    return Orbit(
        name, 0.0, 0.002, i_deg, (crossing_deg + phase_deg) % 360.0, 180.0, (180.0 - phase_deg) % 360.0, -0.012
    )


def _beidou_meo(name: str, plane: int, slot: int) -> Orbit:
    """Slot 1..8 of plane 0..2 of the Walker 24/3/1 constellation."""
    return Orbit(
        name, 27_906_100.0, 0.0006, 55.0, 120.0 * plane, 0.0, (45.0 * (slot - 1) + 15.0 * plane) % 360.0, -0.0327
    )


_BEIDOU2_GEO: Final = (("C01", 140.0), ("C02", 80.0), ("C03", 110.5), ("C04", 160.0), ("C05", 58.75))


def _beidou2() -> tuple[Orbit, ...]:
    return (
        *(_geostationary(name, lon) for name, lon in _BEIDOU2_GEO),
        *(_inclined(f"C{6 + k:02d}", 118.0, 120.0 * k) for k in range(3)),
        _beidou_meo("C11", 0, 7), _beidou_meo("C12", 0, 8), _beidou_meo("C13", 1, 3), _beidou_meo("C14", 1, 4),
    )  # fmt: skip


def _beidou3() -> tuple[Orbit, ...]:
    numbers = (*range(19, 31), *range(32, 38), *range(41, 47))
    return (
        *(_beidou_meo(f"C{numbers[k]:02d}", k // 8, k % 8 + 1) for k in range(24)),
        *(_inclined(f"C{38 + k:02d}", 118.0, 120.0 * k + 60.0) for k in range(3)),
        *(_geostationary(name, lon) for name, lon in (("C59", 140.0), ("C60", 80.0), ("C61", 110.5))),
    )


# -- QZSS ---------------------------------------------------------------------------------------------------------
def _qzss() -> tuple[Orbit, ...]:
    """Three quasi-zenith orbits with their apogee in the north over 136 deg E, and one geostationary satellite."""

    def quasi_zenith(name: str, phase: float) -> Orbit:
        return Orbit(name, 0.0, 0.075, 41.0, (46.0 + phase) % 360.0, 270.0, (180.0 - phase) % 360.0, -0.012)

    return (
        quasi_zenith("J02", 0.0), quasi_zenith("J03", 130.0), quasi_zenith("J04", 230.0),
        _geostationary("J07", 127.0, 0.05),
    )  # fmt: skip


CONSTELLATIONS: Final[dict[str, Constellation]] = {
    c.key: c
    for c in (
        Constellation(
            "gps", "GPS, 32 satellites",
            "GPS almanac of week 1987 (NAVCEN, YUMA format, toa 589824 s), rounded; PRN 4 added",
            "2018-02-10T19:50:24", True, _gps(),
        ),
        Constellation(
            "glonass", "GLONASS, 24 satellites",
            "GLONASS ICD L1/L2 5.1, 3.3.4 and A.3.2 (nominal constellation); channels: IAC status pages",
            "2020-01-01T00:00:00", False, _glonass(),
        ),
        Constellation(
            "galileo", "Galileo, 24 slots and 2 satellites in eccentric orbits",
            "Galileo OS SDD 1.3, annex C / GSC reference constellation (orbital and technical parameters), 2016-11-21",
            "2016-11-21T00:00:00Z", False, _galileo(),
        ),
        Constellation(
            "beidou1", "BeiDou-1, 3 geostationary satellites (80, 110.5, 140 deg E)",
            "BDS-OS-PS-3.0 section 3.1; slots as in Gao and Tan (2007)",
            "2020-01-01T00:00:00", True, tuple(_geostationary(n, lon) for n, lon in _BEIDOU2_GEO[:3]),
        ),
        Constellation(
            "beidou2", "BeiDou-2 phase I, 12 satellites (5 GEO, 3 IGSO, 4 MEO)",
            "BDS-OS-PS-1.0 (2013) section 3.1; MEO slots A07, A08, B03, B04 of the Walker 24/3/1 constellation",
            "2020-01-01T00:00:00", True, _beidou2(),
        ),
        Constellation(
            "beidou3", "BeiDou-3, 30 satellites (3 GEO, 3 IGSO, 24 MEO)",
            "BDS-OS-PS-3.0 (2021) section 3.1", "2020-01-01T00:00:00", True, _beidou3(),
        ),
        Constellation(
            "qzss", "QZSS, 4 satellites (3 QZO, 1 GEO)",
            "IS-QZSS-PNT-005 section 3.1 (nominal orbits), PS-QZSS-003 table 3.2.3-1",
            "2020-01-01T00:00:00", True, _qzss(),
        ),
    )
}  # fmt: skip
"""Tables by the name a scenario uses."""


def constellations(names: Sequence[str]) -> tuple[Constellation, ...]:
    """Tables by name.

    Raises
    ------
    StarwiseError
        An unknown name, or two tables that give one satellite two orbits.
    """
    chosen: list[Constellation] = []
    seen: dict[str, Orbit] = {}
    for name in names:
        if name not in CONSTELLATIONS:
            raise StarwiseError("no such constellation", found=name, wanted=" | ".join(CONSTELLATIONS))
        table = CONSTELLATIONS[name]
        new = []
        for orbit in table.orbits:
            if orbit.name in seen and seen[orbit.name] != orbit:
                raise StarwiseError("two constellations give one satellite two orbits", found=f"{orbit.name} in {name}")
            if orbit.name not in seen:
                new.append(orbit)
                seen[orbit.name] = orbit
        if table not in chosen:
            chosen.append(
                Constellation(table.key, table.title, table.source, table.epoch, table.node_is_longitude, tuple(new))
            )
    return tuple(chosen)
