"""Tutorials say what really comes out: their blocks are run as a reader would, and what is printed is read."""

import re
import sys
import tomllib
from pathlib import Path

import pytest

from doc_blocks import ROOT, Reader, blocks
from starwise.config_inertial import InertialConfig

TUTORIALS = ROOT / "docs" / "tutorials"
pytestmark = [pytest.mark.slow, pytest.mark.skipif(sys.platform == "win32", reason="commands of a POSIX shell")]


def reader(tmp_path: Path) -> Reader:
    folder = tmp_path / "reader"
    folder.mkdir()
    return Reader(folder)


def test_fuse_your_imu(tmp_path: Path) -> None:
    at = reader(tmp_path)
    said = []
    for block in blocks(TUTORIALS / "fuse-your-imu.md"):
        if block.language == "toml" and not block.text.startswith("# imu.toml"):
            InertialConfig.from_dict(tomllib.loads(block.text)["inertial"])
        if "rtk.pos" in block.text:
            at.shell("cp tight/solution.pos rtk.pos; cp drive/drive_imu.csv imu.csv")
        printed = at.read(block)
        said += [printed] if block.language == "sh" else []
    assert len(said) == 3
    assert "tight coupling" in said[1]
    rms = re.search(r"RMS 2D +([\d.]+) m", said[1])
    assert rms is not None
    assert float(rms.group(1)) < 0.5  # m: one seed, simulated receiver, a tunnel of 20 s
    assert re.search(r"yaw +[\d.]+ \+- [\d.]+ deg", said[2])


HONEST = next(name for name in ("is-my-filter-honest.md", "is-my-covariance-honest.md") if (TUTORIALS / name).exists())


def test_is_my_covariance_honest(tmp_path: Path) -> None:
    at = reader(tmp_path)
    said = []
    for block in blocks(TUTORIALS / HONEST):
        printed = at.read(block)
        said += [printed] if block.language == "sh" else []
    assert len(said) >= 5
    curves = re.findall(r"^  ellipsoid +([\d.]+) +([\d.]+) +([\d.]+)$", said[2], re.MULTILINE)
    white, colored = ([float(share) for share in curve] for curve in curves[:2])
    assert white[2] < 50.0  # % of epochs, one seed: far below 95, as the text says
    assert colored[2] > 90.0
    everything = "\n".join(said)
    assert re.search(r"^parts +3 +1801 ", everything, re.MULTILINE)
    assert "Parameters in errors.toml" in everything
    assert "errors as states" in everything
