"""Damaged files through the whole chain: an error of one line, a flagged epoch, or a position that is still right.

STARWISE_FUZZ_SOLVE sets the number of mutations (default 1000) and STARWISE_FUZZ_SEED where they start.
"""

import os
import random
from pathlib import Path

import numpy as np
import pytest

import starwise.demo
from starwise.config import RunConfig
from starwise.constants import EPOCH_OK
from starwise.errors import StarwiseError
from starwise.estimators.run import solve_run
from starwise.frames import ecef_from_geodetic
from starwise.gnsstime import from_week_tow
from starwise.io.files import read_bytes
from starwise.io.rinex_nav import read_nav
from starwise.io.rinex_obs import parse_obs
from starwise.physics.broadcast import BroadcastEphemeris

COUNT = int(os.environ.get("STARWISE_FUZZ_SOLVE", "1000"))
SEED = int(os.environ.get("STARWISE_FUZZ_SEED", "0"))
EPOCHS = 4
DATA = Path(starwise.demo.__file__).parent / "data"


def short_observations() -> bytes:
    """Header and the first epochs of the demo's observation file."""
    lines = read_bytes(DATA / "demo_MO.rnx.gz").decode().splitlines(keepends=True)
    starts = [i for i, line in enumerate(lines) if line.startswith(">")]
    return "".join(lines[: starts[EPOCHS]]).encode()


def truth() -> dict[int, np.ndarray]:
    rows = np.genfromtxt(DATA / "demo_truth.csv", delimiter=",", names=True)
    names = rows.dtype.names
    llh = np.stack([np.radians(rows[names[2]]), np.radians(rows[names[3]]), rows[names[4]]], axis=1)
    pos = ecef_from_geodetic(llh)
    return {from_week_tow(int(w), float(t)): p for w, t, p in zip(rows[names[0]], rows[names[1]], pos, strict=True)}


def mutated(data: bytes, rng: random.Random) -> bytes:
    out = bytearray(data)
    kind = rng.randrange(6)
    if kind == 0:  # bits flipped
        for _ in range(rng.choice([1, 1, 2, 8, 64])):
            out[rng.randrange(len(out))] ^= 1 << rng.randrange(8)
    elif kind == 1:  # cut
        return bytes(out[: rng.randrange(len(out))])
    elif kind == 2:  # a piece taken out
        start = rng.randrange(len(out))
        del out[start : start + rng.choice([1, 16, 80, 500])]
    elif kind == 3:  # a line doubled
        lines = data.splitlines(keepends=True)
        i = rng.randrange(len(lines))
        return b"".join([*lines[:i], lines[i], *lines[i:]])
    elif kind == 4:  # two lines exchanged
        lines = data.splitlines(keepends=True)
        i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
        lines[i], lines[j] = lines[j], lines[i]
        return b"".join(lines)
    else:  # digits replaced
        for _ in range(rng.choice([1, 4, 16])):
            i = rng.randrange(len(out))
            if 48 <= out[i] <= 57:
                out[i] = rng.randrange(48, 58)
    return bytes(out)


@pytest.mark.parametrize("method", ["lsq", "s3ekf"])
@pytest.mark.parametrize("what", ["observations", "navigation"])
def test_no_silent_wrong_position(what: str, method: str, tmp_path: Path) -> None:
    obs_bytes, nav_bytes = short_observations(), read_bytes(DATA / "demo_MN.rnx.gz")
    where = truth()
    config = RunConfig(method=method)
    whole_obs, whole_nav = parse_obs(obs_bytes), read_nav(DATA / "demo_MN.rnx.gz")
    nav_file = tmp_path / "mutated.rnx"
    rng = random.Random(SEED)
    solved = refused = 0
    for i in range(COUNT // 4):
        data = mutated(obs_bytes if what == "observations" else nav_bytes, rng)
        try:
            obs = parse_obs(data) if what == "observations" else whole_obs
            records = whole_nav
            if what == "navigation":
                nav_file.write_bytes(data)
                records = read_nav(nav_file)
            solution = solve_run(obs, BroadcastEphemeris(records), records.ionosphere, config)
        except StarwiseError as error:
            assert "\n" not in str(error)
            refused += 1
            continue
        for t, status, pos in zip(solution.t_ns, solution.status, solution.pos_e, strict=True):
            # A damaged time tag is another time: no truth there to compare with, and no position unless it is flagged
            # or consistent, which satellites that moved kilometres make impossible beyond a few ms.
            if status != EPOCH_OK or int(t) not in where:
                continue
            solved += 1
            error_m = float(np.linalg.norm(pos - where[int(t)]))
            # 60 m: the demo's noise leaves up to 20 m, and a flipped digit below the test's threshold some more.
            assert error_m < 60.0, f"mutation {i} of seed {SEED}: epoch {t} is {error_m:.0f} m wrong and not flagged"
    assert solved > COUNT // 4  # most mutations leave most epochs whole
    assert refused < COUNT // 4
