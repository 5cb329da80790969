"""Known points measured by real receivers: least squares beside RTKLIB, EKF beside S3EKF."""

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

import starwise

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
import datasets

SETS = ("tlse_2022 1 h", "tlse_2024 15 min", "tlse_2024 1 h", "kiru_2024 2 h", "nagoya rover", "nagoya base")


@pytest.mark.real
@pytest.mark.parametrize("name", SETS)
def test_accuracy_at_a_known_point(name: str, shared_data: Path, tmp_path: Path) -> None:
    if shutil.which("rnx2rtkp") is None:
        pytest.skip("rnx2rtkp (Debian package rtklib) is not installed")
    data = next(d for d in datasets.STATIC if d.name == name)
    truth = datasets.truth_ecef(data.truth or "")
    files = [shared_data / data.obs, *(shared_data / nav for nav in data.nav)]

    def rms(pos_e: np.ndarray) -> float:
        return float(np.sqrt(((pos_e - truth) ** 2).sum(axis=1).mean()))

    _, rtklib, _ = datasets.rtklib_spp(data, tmp_path)
    # RTKLIB takes the nearest record, also from the future
    options = {"method": "lsq", "error_model": "white", "troposphere": "saastamoinen", "post": True}
    lsq = starwise.solve(*files, systems=data.systems, **options)
    assert lsq.has_position.sum() >= len(rtklib)
    assert rms(lsq.pos_e[lsq.has_position]) <= 1.05 * rms(rtklib)  # asked for on each set, with the same models
    ekf, s3ekf = (starwise.solve(*files, method=m, systems=data.systems, dynamics="static") for m in ("ekf", "s3ekf"))
    assert np.nanmax(np.linalg.norm(ekf.pos_e - s3ekf.pos_e, axis=1)) < 1e-3  # m
