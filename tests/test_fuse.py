"""Fusing position fixes of several receivers: nouns, files of every kind, faults, the command."""

import json

import numpy as np
import pytest

from starwise.__main__ import main
from starwise.constants import EPOCH_OK, NS
from starwise.errors import StarwiseError
from starwise.estimators.fuse import FuseConfig, Receiver, fuse_fixes
from starwise.frames import C_ne_enu, ecef_from_geodetic, geodetic_from_ecef
from starwise.io.pos import write_pos
from starwise.io.results import read_solution
from starwise.studies.fusing import _summary, fuse_files, fuse_text, read_receiver
from starwise.types import Solution

T0 = 1_100_000_000 * NS
PLACE = ecef_from_geodetic([np.radians(45.0), np.radians(7.0), 300.0])
C = C_ne_enu(np.radians(45.0), np.radians(7.0))


def path(t_s):
    """Straight on at 20 m/s to the north-east for a minute, then a turn of 90 deg in 10 s, then straight on."""
    t = np.asarray(t_s, dtype=float)
    turn = np.clip(t - 60.0, 0.0, 10.0) * np.radians(9.0)
    fine = np.arange(0.0, 400.0, 0.01)
    course = np.radians(45.0) + np.clip(fine - 60.0, 0.0, 10.0) * np.radians(9.0)
    way = np.cumsum(20.0 * np.stack([np.sin(course), np.cos(course), 0.0 * fine], axis=1) * 0.01, axis=0)
    assert len(turn) == len(t)
    enu = np.stack([np.interp(t, fine, way[:, a]) for a in range(3)], axis=1)
    return PLACE + enu @ C


def receiver(name, t_s, sigma, seed, claims=True):
    rng = np.random.default_rng(seed)
    e = rng.standard_normal((len(t_s), 3)) * sigma
    cov = np.full((len(t_s), 3, 3), np.nan)
    if claims:
        cov[:] = sigma**2 * np.eye(3)
    return Receiver(name, T0 + np.rint(np.asarray(t_s) * NS).astype(np.int64), path(t_s) + e @ C, cov)


def errors(solution):
    return (solution.pos_e - path((solution.t_ns - T0) / NS)) @ C.T


T = np.arange(0.0, 200.0)
WHITE = FuseConfig(lasting=0.0)


def test_three_receivers():
    three = [receiver("a", T, 3.0, 1), receiver("b", T, 6.0, 2), receiver("c", T, 2.0, 3)]
    best, mean = fuse_fixes(three, WHITE), fuse_fixes(three, FuseConfig(method="lsq"))
    assert best.n_epochs == 200
    assert (best.status == EPOCH_OK).all()
    assert (best.n_used == 3).all()
    size = [np.sqrt((errors(s)[20:] ** 2).sum(axis=1).mean()) for s in (best, mean)]
    assert size[1] == pytest.approx(np.sqrt(3.0 / (1 / 9 + 1 / 36 + 1 / 4)), rel=0.1)
    assert size[0] < 0.7 * size[1]
    assert np.linalg.norm(best.vel_e[40]) == pytest.approx(20.0, abs=1.0)
    assert np.isnan(mean.vel_e).all()
    nees = np.einsum("ni,nij,nj->n", errors(best), np.linalg.inv(C @ best.cov_pos @ C.T), errors(best))
    assert 0.4 < nees[20:].mean() / 3.0 < 1.6


def test_rates_and_offsets_may_differ():
    """1 Hz, 5 Hz half a second off, and one every 10 s: an epoch wherever any receiver has a fix."""
    fast = np.arange(0.05, 199.0, 0.2)
    solution = fuse_fixes(
        [receiver("a", T, 3.0, 1), receiver("b", fast, 3.0, 2), receiver("c", T[::10], 1.0, 3)], WHITE
    )
    assert solution.n_epochs == len(T) + len(fast)
    assert (np.diff(solution.t_ns) > 0).all()
    assert sorted(set(solution.n_used.tolist())) == [1, 2]
    assert np.sqrt((errors(solution)[100:] ** 2).sum(axis=1).mean()) < 2.0  # m


def test_tags_that_nearly_agree_are_one_epoch():
    late = receiver("b", T + 0.001, 3.0, 2)
    assert fuse_fixes([receiver("a", T, 3.0, 1), late], WHITE).n_epochs == 200
    assert fuse_fixes([receiver("a", T, 3.0, 1), late], FuseConfig(tolerance_s=0.0)).n_epochs == 400


def test_a_receiver_that_fails_is_refused_and_comes_back():
    bad = receiver("b", T, 3.0, 2)
    shifted = bad.pos_e.copy()
    shifted[100:140] += [60.0, 0.0, 0.0]
    three = [receiver("a", T, 3.0, 1), Receiver("b", bad.t_ns, shifted, bad.cov_e), receiver("c", T, 3.0, 3)]
    solution = fuse_fixes(three, WHITE)
    refused = ~solution.ledger["used"]
    assert set(solution.ledger["receiver"][refused]) == {1}
    assert solution.provenance["refused"] == [0, 40, 0]
    assert np.abs(errors(solution)[90:150]).max() < 8.0  # m
    every = fuse_fixes(three, FuseConfig(false_alarm=0.0, lasting=0.0))
    assert every.provenance["refused"] == [0, 0, 0]


def test_of_two_that_disagree_the_one_that_jumped_goes():
    bad = receiver("b", T, 3.0, 2)
    shifted = bad.pos_e.copy()
    shifted[100:120] += [100.0, 0.0, 0.0]
    solution = fuse_fixes([receiver("a", T, 3.0, 1), Receiver("b", bad.t_ns, shifted, bad.cov_e)], WHITE)
    assert solution.provenance["refused"] == [0, 20]
    assert (solution.status[100:120] != EPOCH_OK).all()


def test_epochs_that_never_meet_tell_nothing_of_the_noise():
    solution = fuse_fixes([receiver("a", T, 3.0, 1), receiver("b", T + 0.5, 3.0, 2)])
    assert solution.n_epochs == 400
    assert solution.provenance["noise_scale"] is None
    assert "no epoch has two fixes" in fuse_text(
        {**solution.provenance, "config": FuseConfig().to_dict(), "summary": _summary(solution)}, None
    )


def test_sigmas_that_nobody_claims():
    """The scale comes from the differences."""
    solution = fuse_fixes([receiver(str(k), T, 9.0, k, claims=False) for k in range(3)], WHITE)
    given = np.sqrt((2.0 * 3.0**2 + 6.0**2) / 3.0)
    assert given * solution.provenance["noise_scale"] == pytest.approx(9.0, rel=0.35)


def test_errors_that_last_widen_the_covariance():
    three = [receiver("a", T, 3.0, 1), receiver("b", T, 6.0, 2), receiver("c", T, 2.0, 3)]
    own, shared = fuse_fixes(three, WHITE), fuse_fixes(three, FuseConfig(lasting=0.5))
    assert np.abs(own.pos_e - shared.pos_e).max() == 0.0
    extra = 0.25 / (1 / 9 + 1 / 36 + 1 / 4)
    assert np.diag(shared.cov_pos[50] - own.cov_pos[50]) == pytest.approx(np.full(3, extra), rel=1e-6)


def test_what_cannot_be_fused():
    a = receiver("a", T, 3.0, 1)
    with pytest.raises(StarwiseError, match="no position fixes"):
        fuse_fixes([])
    with pytest.raises(StarwiseError, match="no position fix"):
        fuse_fixes([a, Receiver("b", a.t_ns, np.full_like(a.pos_e, np.nan), a.cov_e)])
    far = Receiver("b", a.t_ns, a.pos_e + 3e5, a.cov_e)
    with pytest.raises(StarwiseError, match="not of one place"):
        fuse_fixes([a, far])
    with pytest.raises(StarwiseError, match="never near each other") as caught:
        # 85 km apart, and claimed to 500 km
        fuse_fixes([a, Receiver("b", a.t_ns, a.pos_e + np.array([6e4, 6e4, 0.0]), 1e10 * a.cov_e)])
    assert caught.value.file == "b"
    with pytest.raises(StarwiseError, match="never near each other"):
        fuse_fixes([a, Receiver("b", a.t_ns + NS // 2, a.pos_e + np.array([150.0, 0.0, 700.0]), a.cov_e)])  # never meet
    late = Receiver("late", a.t_ns + 3600 * NS, a.pos_e, a.cov_e)
    with pytest.raises(StarwiseError, match="no time in common") as caught:
        fuse_fixes([a, receiver("b", T, 3.0, 2), late])
    assert caught.value.file == "late"
    with pytest.raises(StarwiseError, match="outside its limits"):
        FuseConfig(lasting=2.0)
    with pytest.raises(StarwiseError, match="no such choice"):
        FuseConfig(method="magic")


# -- files


def solution_of(r):
    n = len(r.t_ns)
    none, nan3 = np.full((n, 0), np.nan), np.full((n, 3, 3), np.nan)
    return Solution(
        t_ns=r.t_ns, status=np.full(n, EPOCH_OK, np.uint8), pos_e=r.pos_e, vel_e=np.full((n, 3), np.nan),
        cov_pos=r.cov_e, cov_vel=nan3, clock_m=none, drift_mps=none, clock_sigma_m=none, clock_names=(),
        n_used=np.full(n, 9, np.int32), dop=np.full((n, 4), np.nan), nis=np.full(n, np.nan), dof=np.zeros(n, np.int32),
    )  # fmt: skip


def nmea(r):
    lines = []
    for t_ns, llh in zip(r.t_ns, geodetic_from_ecef(r.pos_e), strict=True):
        day = (t_ns // NS - 18) % 86400  # leap seconds of that day: 15, see below
        h, m, s = day // 3600, day // 60 % 60, day % 60
        lat, lon = np.degrees(llh[:2])
        where = f"{int(lat):02d}{lat % 1 * 60:010.7f},N,{int(lon):03d}{lon % 1 * 60:010.7f},E"
        time = f"{h:02d}{m:02d}{s:02d}.00"
        lines.append(f"$GPRMC,{time},A,{where},0.0,0.0,131114,,")
        lines.append(f"$GPGGA,{time},{where},1,09,1.0,{llh[2]:.3f},M,0.0,M,,")
    return "\n".join(lines) + "\n"


@pytest.fixture
def files(tmp_path):
    a, b, c = receiver("a", T, 2.0, 1), receiver("b", T, 3.0, 2), receiver("c", T, 3.0, 3)
    (tmp_path / "a.pos").write_bytes(write_pos(solution_of(a)))
    llh = geodetic_from_ecef(b.pos_e)
    rows = ["t_gpst_ns,lat,lon,height"]
    rows += [f"{t},{np.degrees(p[0]):.9f},{np.degrees(p[1]):.9f},{p[2]:.4f}" for t, p in zip(b.t_ns, llh, strict=True)]
    (tmp_path / "b.csv").write_text("\n".join(rows) + "\n")
    (tmp_path / "c.pos").write_bytes(write_pos(solution_of(c)))
    return [tmp_path / name for name in ("a.pos", "b.csv", "c.pos")]


def test_files_of_every_kind(files, tmp_path):
    solution = fuse_files(files, WHITE, tmp_path / "out")
    assert solution.n_epochs == 200
    assert solution.provenance["fixes"] == [200, 200, 200]
    assert np.sqrt((errors(solution)[20:] ** 2).sum(axis=1).mean()) < 2.0  # m
    back = read_solution(tmp_path / "out")
    assert np.abs(back.pos_e - solution.pos_e).max() < 1e-6
    assert back.provenance["command"] == "fuse"
    assert set(back.ledger) == {"t_ns", "receiver", "used", "east_m", "north_m", "up_m"}


def test_nmea(tmp_path):
    r = receiver("n", T[:20], 1.0, 1)
    (tmp_path / "n.nmea").write_text(nmea(r))
    read = read_receiver(tmp_path / "n.nmea")
    assert len(read.t_ns) == 20
    assert np.abs(read.pos_e - r.pos_e).max() < 1e-2  # m: seven decimals of a minute, mm of height
    assert np.isnan(read.cov_e).all()


def test_a_fused_result_can_be_fused_again(files, tmp_path):
    fuse_files(files[:2], WHITE, tmp_path / "two")
    again = fuse_files([tmp_path / "two", files[2]], WHITE)
    assert again.n_epochs == 200


def test_bad_files(files, tmp_path):
    with pytest.raises(StarwiseError, match="two receivers or more"):
        fuse_files(files[:1])
    with pytest.raises(StarwiseError, match="given twice"):
        fuse_files([files[0], files[0]])
    with pytest.raises(StarwiseError, match="no such file"):
        fuse_files([files[0], tmp_path / "nothing.pos"])
    above = tmp_path / "msl.pos"
    above.write_text(files[0].read_text().replace("ellipsoidal", "geodetic"))
    with pytest.raises(StarwiseError, match="above the geoid"):
        fuse_files([files[1], above])
    assert fuse_files([files[1], above], geoid_m=0.0).n_epochs == 200


def test_command(files, tmp_path, capsys):
    out = tmp_path / "made"
    assert main(["fuse", *map(str, files), "-o", str(out), "--dynamics", "vehicle"]) == 0
    text = capsys.readouterr().out
    assert "200 epochs" in text
    assert max(len(line) for line in text.splitlines()) < 200
    assert (out / "solution.pos").is_file()
    assert main(["fuse", *map(str, files), "--json", "--method", "lsq"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["summary"]["epochs"] == 200
    assert main(["fuse", str(files[0])]) == 2
    assert "two receivers" in capsys.readouterr().err
    assert main(["fuse", *map(str, files), "--method", "magic"]) == 2
    assert "no such choice" in capsys.readouterr().err


@pytest.mark.real
def test_real_fixes(shared_data):
    """A phone's and a car receiver's formats as they come: NMEA of an hour and a .pos of a drive are read."""
    nmea_file = shared_data / "kinematic/google_mtv_20200206/MTV.Local1.ublox-F9K.20200206-181434.nmea"
    read = read_receiver(nmea_file)
    assert len(read.t_ns) > 1000
    twin = Receiver("twin", read.t_ns, read.pos_e + 1.0, read.cov_e)
    solution = fuse_fixes([read, twin], FuseConfig(sigma_horizontal_m=1.0, sigma_vertical_m=2.0))
    middle = 0.5 * (read.pos_e[-1] + twin.pos_e[-1])
    assert np.linalg.norm(solution.pos_e[-1] - middle) < 3.0  # m: the mean of the two, filtered
