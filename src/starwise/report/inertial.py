"""What ``solve --imu`` says to people."""

from pathlib import Path

import numpy as np

from starwise.constants import EPOCH_COASTED
from starwise.gnsstime import iso
from starwise.report.text import _field as field
from starwise.report.text import report_line
from starwise.types import Solution

_SHOWN = (
    ("roll_deg", "roll", "deg"), ("pitch_deg", "pitch", "deg"), ("yaw_deg", "yaw", "deg"),
    ("gyro_bias_x_dph", "gyro bias x", "deg/h"), ("gyro_bias_y_dph", "gyro bias y", "deg/h"),
    ("gyro_bias_z_dph", "gyro bias z", "deg/h"), ("accel_bias_x_mps2", "accelerometer bias x", "m/s^2"),
    ("accel_bias_y_mps2", "accelerometer bias y", "m/s^2"), ("accel_bias_z_mps2", "accelerometer bias z", "m/s^2"),
    ("mount_pitch_deg", "mount pitch", "deg"), ("mount_yaw_deg", "mount yaw", "deg"), ("axle_x_m", "axle ahead", "m"),
    ("lever_arm_x_m", "lever arm x", "m"), ("lever_arm_y_m", "lever arm y", "m"), ("lever_arm_z_m", "lever arm z", "m"),
    ("time_offset_s", "time offset", "s"),
)  # fmt: skip


def _estimate(label: str, value: float, sigma: float, unit: str) -> str:
    """A value and its sigma: two more decimals where three do not show the sigma."""
    digits = 5 if sigma < 0.0095 else 3
    return f"{label:22s} {value:{7 + digits}.{digits}f} +- {sigma:.{digits}f} {unit}"


def inertial_text(solution: Solution, directory: str | Path, elapsed_s: float) -> str:
    """Screen after ``starwise solve --imu``: inputs, epochs, last attitude and biases with their sigmas."""
    p, lines = solution.provenance, []
    for item in p["inputs"]:
        lines += field(item["kind"], f"{Path(item['path']).name} ({item['bytes'] / 1e6:.1f} MB)")
    smooth = ", smoothed" if p["config"]["inertial"]["smooth"] else ""
    lines += ["", *field("method", f"inertial, {p['config']['method']} coupling{smooth}")]
    n = solution.n_epochs
    if n:
        coasted = int((solution.status == EPOCH_COASTED).sum())
        span = f"{iso(int(solution.t_ns[0]))} to {iso(int(solution.t_ns[-1]))} GPST"
        lines += field("epochs", f"{n} from {span}" + (f", {coasted} without aid" if coasted else ""))
        told = np.isfinite(solution.nis) & (solution.dof > 0)
        if told.any():
            ratio = float(solution.nis[told].sum() / solution.dof[told].sum())
            of = "of the satellites" if p["config"]["method"] == "tight" else "of the positions"
            lines += field("NIS", f"{ratio:.2f} {of}, per degree of freedom (1: as claimed)")
        sigma = np.sqrt(np.trace(solution.cov_pos, axis1=1, axis2=2))
        lines += field("claimed", f"{np.median(sigma):.2f} m (1 sigma, 3D, median), at most {sigma.max():.2f} m")
        lines += ["", *field("at the end", "estimate and 1 sigma")]
        for name, label, unit in _SHOWN:
            if name in solution.extra:
                value, sd = solution.extra[name][-1], solution.extra[f"sigma_{name}"][-1]
                lines += field("", _estimate(label, value, sd, unit))
    for note in p.get("notes", ()):
        lines += field("note", str(note))
    for item in sorted(p.get("problems", ()), key=lambda problem: -problem["count"])[:5]:
        lines += field("problem", f"{item['what']} ({item['count']} x, first {Path(item['file']).name}:{item['line']})")
    lines += ["", *field("results", f"{directory}/  solution.parquet solution.pos ledger.parquet run.json")]
    lines += report_line(directory)
    lines += field("time", f"{elapsed_s:.2f} s")
    return "\n".join(lines)
