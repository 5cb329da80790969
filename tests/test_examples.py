"""Example programs run as they stand, and say what their first lines promise."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
PROMISED = {
    "simulate_and_solve.py": r"601 epochs, 2D RMS [\d.]+ m, 3D RMS [\d.]+ m\nthe 95 % ellipsoid holds",
    "compare_error_models.py": r"  2  white .*\n  2  colored .*%",
    "monte_carlo.py": r"as it is +[\d.]+  consistent\n.*not consistent\n.*not consistent",
    "own_measurement.py": r"NIS per degree of freedom .*passed True",
    "consistency_of_a_run.py": r"NIS per degree of freedom [\d.]+(.*\n)+G\d\d .*(.*\n)+picture: nis.pdf",
    "fuse_fixes.py": r"both, fused +[\d.]+, 95 %",
}


def test_every_example_is_listed_in_the_documentation() -> None:
    names = {path.name for path in EXAMPLES.glob("*.py")}
    assert names == set(PROMISED)
    text = (EXAMPLES.parent / "docs" / "examples.md").read_text(encoding="utf-8")
    assert names == set(re.findall(r"^\| `(\w+\.py)`", text, re.MULTILINE))


@pytest.mark.parametrize("name", sorted(PROMISED))
def test_example(name: str, tmp_path: Path) -> None:
    environment = {**os.environ, "COLUMNS": "80"}
    command = [sys.executable, str(EXAMPLES / name)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300, env=environment)
    assert done.returncode == 0, done.stderr
    assert re.search(PROMISED[name], done.stdout), done.stdout
    assert max(map(len, done.stdout.splitlines())) <= 100
    assert not done.stderr
    assert len((EXAMPLES / name).read_text(encoding="utf-8").splitlines()) <= 50  # examples are short
