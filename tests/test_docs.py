"""Documentation that names every column, key and option there is."""

import dataclasses
import re
from pathlib import Path

from handmade import HERE, handmade_solution
from starwise.analysis.accuracy import assess
from starwise.config import ClockNoise, ProcessNoise, RunConfig
from starwise.config_errors import ErrorParameters
from starwise.config_inertial import AccelNoise, GyroNoise, InertialConfig, VehicleConfig
from starwise.constants import EPOCH_STATUS_NAMES, ROW_STATUS_NAMES
from starwise.estimators.ins_output import _UNITS
from starwise.io.imu_config import ImuAccel, ImuFile, ImuGyro, ImuTime
from starwise.io.results import solution_table
from starwise.report.summary import summarise
from starwise.studies.calibration import SetFile
from starwise.types import Truth

ROOT = Path(__file__).resolve().parents[1]
NAMED = set(re.findall(r"`([^`\n]+)`", (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")))


def test_columns_of_the_solution() -> None:
    columns = {name for name in solution_table(handmade_solution()).columns if "_E_" not in name}
    assert columns <= NAMED


def test_columns_of_the_ledger() -> None:
    source = (ROOT / "src" / "starwise" / "estimators" / "run.py").read_text(encoding="utf-8")
    names = re.findall(r'^        "(\w+)": ', source[source.index("def make_ledger") :], re.MULTILINE)
    assert len(names) > 10
    at_the_edge = {"t_ns": "t_gpst_ns", "sig": "signal", "sig2": "signal2"}
    wanted = {at_the_edge.get(name, name.replace("_rad", "_deg")) for name in names}
    assert wanted <= NAMED
    assert set(ROW_STATUS_NAMES) <= NAMED
    assert set(EPOCH_STATUS_NAMES) <= NAMED


def test_keys_of_reports() -> None:
    solution = handmade_solution()
    assert set(assess(solution, Truth(HERE))) <= NAMED
    assert set(summarise(solution)) <= NAMED


def test_keys_of_the_configuration() -> None:
    for kind in (RunConfig, ProcessNoise, ClockNoise, InertialConfig, GyroNoise, AccelNoise, VehicleConfig):
        assert {item.name for item in dataclasses.fields(kind)} <= NAMED


def test_keys_of_the_error_model_and_their_defaults() -> None:
    keys = {item.name for item in dataclasses.fields(ErrorParameters)}
    assert keys | {item.name for item in dataclasses.fields(SetFile)} <= NAMED
    text = (ROOT / "docs" / "error-model.md").read_text(encoding="utf-8")
    told = [(key, float(number)) for key, number in re.findall(r"`(\w+)` (\d[\d.]*\d|\d)", text) if key in keys]
    assert len(told) > 20
    default = ErrorParameters()
    assert [(key, getattr(default, key)) for key, _ in told] == told


def test_columns_of_inertial_results() -> None:
    first = {"lever_arm_{}_m": "x", "mount_{}_deg": "yaw", "steer_{}": "slip"}
    assert {name.format(first.get(name, "x")) for name, _ in _UNITS.values()} <= NAMED
    assert {"roll_deg", "pitch_deg", "yaw_deg", "nis_per_dof", "final"} <= NAMED


def test_keys_of_descriptions_of_inertial_files() -> None:
    text = (ROOT / "docs" / "imu_files.md").read_text(encoding="utf-8")
    described = {name.rpartition(".")[2] for name in re.findall(r"`([^`\n]+)`", text)}
    described |= set(re.findall(r"^\[?(\w+)(?: = |\])", text, re.MULTILINE))  # of the example
    for kind in (ImuFile, ImuTime, ImuGyro, ImuAccel):
        assert {item.name for item in dataclasses.fields(kind)} - {"gyro", "accel"} <= described
