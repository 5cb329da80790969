"""Every block of code in README and documentation runs as it stands, or says why it does not.

Files that readers are asked to have (``rover.obs``, ``brdc.nav``, ``groundtruth.csv`` ...) are of one simulated drive.
"""

import os
import re
import shutil
import sys
from pathlib import Path

import pytest

from doc_blocks import ROOT, RUN, SHOWN, Reader, blocks, commands_outside_fences, documents

CHECKED_ELSEWHERE = {"fuse-your-imu.md", "is-my-covariance-honest.md", "is-my-filter-honest.md"}
"""Run by test_tutorials.py, which also reads what they print."""
DOCUMENTS = documents()
SCENARIO = """
name = "rover"
time = {start = "2024-03-30T12:00:00", duration_s = 150.0, interval_s = 1.0}
output = {truth = "csv"}
[vehicle]
start = [48.1, 11.5, 560.0]
heading_deg = 40.0
segments = [
  {kind = "static", duration_s = 10.0},
  {kind = "straight", speed_mps = 9.0, duration_s = 8.0, smooth = true},
  {kind = "straight", distance_m = 200.0},
  {kind = "turn", radius_m = 15.0, angle_deg = 90.0, roll_in_s = 1.0},
  {kind = "straight"},
]
[receiver]
lever_arm_m = [0.5, 0.0, -1.0]
ephemeris = {model = "typical"}
ionosphere = {model = "broadcast", scale = 1.2}
troposphere = {model = "saastamoinen"}
[imu]
grade = "industrial"
"""
IMU = 'like = "starwise-increments"\n[inertial]\nlever_arm_m = [0.5, 0.0, -1.0]\n'


def ids(document: Path) -> str:
    return str(document.relative_to(ROOT))


@pytest.mark.parametrize("document", DOCUMENTS, ids=ids)
def test_every_block_is_run_or_says_why_not(document: Path) -> None:
    for block in blocks(document):
        where = f"{ids(document)}:{block.line}"
        if block.excuse:
            assert len(block.excuse) > 10, f"{where}: that is no reason"
            continue
        assert block.language in (*RUN, *SHOWN), (
            f"{where}: a block of '{block.language}' is not run; name its language ({', '.join((*RUN, *SHOWN))}), "
            "or write <!-- no-run: reason --> on the line before it"
        )
    assert commands_outside_fences(document) == [], "commands belong into fenced blocks, so that they are run"


def test_an_unmarked_block_is_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "a\n\n<!-- no-run: needs a satellite -->\n```sh\nlaunch\n```\n\n```\nwhat\n```\n\n    starwise demo\n"
    )
    first, second = blocks(page)
    assert (first.line, first.language, first.text, first.excuse) == (4, "sh", "launch\n", "needs a satellite")
    assert (second.line, second.language, second.excuse) == (8, "", "")
    assert commands_outside_fences(page) == ["starwise demo"]


@pytest.fixture(scope="session")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files that readers of the documentation have."""
    folder = tmp_path_factory.mktemp("drive")
    (folder / "rover.toml").write_text(SCENARIO)
    reader = Reader(folder)
    reader.shell(
        "starwise simulate rover.toml -o rover; starwise solve rover/rover_MO.rnx rover/rover_MN.rnx -o solved"
    )
    has = tmp_path_factory.mktemp("has")
    for file, name in (
        ("rover/rover_MO.rnx", "rover.obs"),
        ("rover/rover_MN.rnx", "brdc.nav"),
        ("rover/rover_truth.csv", "groundtruth.csv"),
        ("rover/rover_imu.csv", "imu.csv"),
        ("solved/solution.pos", "rtk.pos"),
        ("solved/solution.pos", "a.pos"),
        ("solved/solution.pos", "b.pos"),
    ):
        shutil.copy(folder / file, has / name)
    (has / "imu.toml").write_text(IMU)
    return has


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="commands of a POSIX shell")
@pytest.mark.parametrize(
    "document",
    [d for d in DOCUMENTS if d.name not in CHECKED_ELSEWHERE and any(b.language in RUN for b in blocks(d))],
    ids=ids,
)
def test_blocks_run(document: Path, drive: Path, tmp_path: Path) -> None:
    folder = tmp_path / "reader"
    shutil.copytree(drive, folder)
    shutil.copytree(ROOT / "examples", folder / "examples")
    reader = Reader(folder)
    for block in blocks(document):
        if block.language in RUN and not block.excuse:
            try:
                reader.read(block)
            except AssertionError as error:
                raise AssertionError(f"{ids(document)}:{block.line}: {error}") from None
            except Exception as error:
                error.add_note(f"{ids(document)}:{block.line}")
                raise


def test_links_between_documents_lead_somewhere() -> None:
    """Those of README, which the site does not check."""
    for link in re.findall(r"\]\((?!https?:)([^)#]+)", (ROOT / "README.md").read_text(encoding="utf-8")):
        assert (ROOT / link).exists(), link
    assert os.path.isdir(ROOT / "docs")
