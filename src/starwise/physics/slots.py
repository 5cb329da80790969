"""GLONASS records under the wrong slot number: found by the orbit that the slot's other records describe.

Two satellites at opposite points of a plane share a frequency channel, and a receiver that has not read the slot
number yet files the records of one under the other. Broadcast files merged from many stations have runs of such
records, half an hour to two hours long: orbits that are 51 000 km away.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from starwise.constants import NS, OMEGA_E_GLO, R_VX, R_X, SYS_R
from starwise.types import F8, BroadcastRecords

_MEAN_MOTION: Final = 2.0 * np.pi / 40_544.0
"""Mean motion of every GLONASS satellite, rad/s: 11 h 15 min 44 s (GLONASS ICD L1/L2 5.1, section 3.2.2)."""
_ALIKE: Final = 0.94
"""Cosine of the angle (20 deg) within which two records put a satellite at the same place of its orbit.

Slots are 45 deg apart; satellites of a slot drift by less than a degree in a day against the mean motion.
"""


def misfiled(records: BroadcastRecords) -> NDArray[np.bool_]:
    """GLONASS records that are not on the orbit of most of their slot's records, (n,).

    Every record is carried to one instant along a circle; directions that agree belong to one satellite. Where no
    direction has more than half of the records, nothing is marked.
    """
    wrong = np.zeros(records.n, dtype=bool)
    rows = np.flatnonzero(records.sv >> 8 == SYS_R)
    if len(rows) < 3:
        return wrong
    place = _directions(records, rows)
    for sv in np.unique(records.sv[rows]):
        mine = np.flatnonzero(records.sv[rows] == sv)
        alike = (place[mine] @ place[mine].T > _ALIKE).sum(axis=1)
        most = int(alike.argmax())
        if 2 * alike[most] > len(mine):
            wrong[rows[mine[place[mine] @ place[mine[most]] < _ALIKE]]] = True
    return wrong


def _directions(records: BroadcastRecords, rows: NDArray[np.intp]) -> F8:
    """Unit vectors, in axes that do not rotate, of records' positions carried to the time of the first record."""
    r, v = records.par[rows, R_X : R_X + 3], records.par[rows, R_VX : R_VX + 3]
    v = v + OMEGA_E_GLO * np.stack([-r[:, 1], r[:, 0], np.zeros(len(rows))], axis=1)
    t = (records.toe_ns[rows] - records.toe_ns[rows].min()) / NS
    with np.errstate(invalid="ignore", divide="ignore"):
        radial = r / np.linalg.norm(r, axis=1)[:, None]
        normal = np.cross(r, v)
        along = np.cross(normal / np.linalg.norm(normal, axis=1)[:, None], radial)
    back = (_MEAN_MOTION * t)[:, None]
    at_start = np.cos(back) * radial - np.sin(back) * along
    s, c = np.sin(OMEGA_E_GLO * t), np.cos(OMEGA_E_GLO * t)
    x, y, z = at_start.T
    return np.asarray(np.nan_to_num(np.stack([c * x - s * y, s * x + c * y, z], axis=1)))
