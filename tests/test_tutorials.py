"""Tutorials do what they say: their commands and programs are run as a reader would, from top to bottom."""

import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

from starwise.config_inertial import InertialConfig

TUTORIALS = Path(__file__).resolve().parents[1] / "docs" / "tutorials"
pytestmark = [pytest.mark.slow, pytest.mark.skipif(sys.platform == "win32", reason="commands of a POSIX shell")]


def blocks(name: str) -> list[tuple[str, str]]:
    """Language and text of every block of code of a tutorial."""
    text = (TUTORIALS / name).read_text(encoding="utf-8")
    return re.findall(r"^```(\w+)\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


def reader(tmp_path: Path) -> Callable[..., str]:
    """What runs a command as a reader in an empty folder would, and gives what it printed."""
    program = tmp_path / "bin" / "starwise"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m starwise "$@"\n')
    program.chmod(0o755)
    path = os.pathsep.join([str(program.parent), os.environ["PATH"]])
    environment = {**os.environ, "PATH": path, "COLUMNS": "80"}

    def done(*command: str) -> str:
        ran = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300)
        assert ran.returncode == 0, ran.stderr
        assert all(len(line) <= 80 for line in ran.stdout.splitlines())
        return ran.stdout

    return done


def test_fuse_your_imu(tmp_path: Path) -> None:
    done = reader(tmp_path)
    said = []
    for language, text in blocks("fuse-your-imu.md"):
        if language == "toml" and text.startswith("# imu.toml"):
            (tmp_path / "imu.toml").write_text(text)
        elif language == "toml":
            InertialConfig.from_dict(tomllib.loads(text)["inertial"])
        elif language == "sh":
            if "rtk.pos" in text:
                done("sh", "-c", "cp tight/solution.pos rtk.pos; cp drive/drive_imu.csv imu.csv")
            said.append(done("sh", "-e", "-c", text))
        else:
            done(sys.executable, "-c", text)
    assert len(said) == 3
    assert "tight coupling" in said[1]
    rms = re.search(r"RMS 2D +([\d.]+) m", said[1])
    assert rms is not None
    assert float(rms.group(1)) < 0.5  # m: one seed, simulated receiver, a tunnel of 20 s
    assert re.search(r"yaw +[\d.]+ \+- [\d.]+ deg", said[2])


def test_is_my_covariance_honest(tmp_path: Path) -> None:
    done = reader(tmp_path)
    said = []
    for language, text in blocks("is-my-covariance-honest.md"):
        if language == "toml":
            (tmp_path / "sets.toml").write_text(text)
        else:
            said.append(done("sh", "-e", "-c", text))
    assert len(said) == 5
    curves = re.findall(r"^  ellipsoid +([\d.]+) +([\d.]+) +([\d.]+)$", said[2], re.MULTILINE)
    white, colored = ([float(share) for share in curve] for curve in curves)
    assert white[2] < 50.0  # % of epochs, one seed: far below 95, as the text says
    assert colored[2] > 90.0
    assert re.search(r"^parts +3 +1801 ", said[3], re.MULTILINE)
    assert "Parameters in errors.toml" in said[4]
    assert "errors as states" in said[4]
