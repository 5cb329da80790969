"""``starwise fuse``: files of position fixes in, one solution out."""

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from starwise._version import __version__
from starwise.errors import StarwiseError
from starwise.estimators.fuse import FuseConfig, Receiver, fuse_fixes
from starwise.io.results import prepare_directory, read_solution, write_results
from starwise.io.truth import read_truth
from starwise.types import Solution, Truth

Progress = Callable[[str, float], None]


def read_receiver(path: str | Path, geoid_m: float | None = None) -> Receiver:
    """Fixes of a file: RTKLIB ``.pos`` in any form, NMEA, a table (CSV), or a result of this program.

    Parameters
    ----------
    path : path-like
    geoid_m : float, optional
        Geoid height, m, for files with heights above the geoid.

    Raises
    ------
    StarwiseError
        Not such a file; heights above the geoid without ``geoid_m``; one position instead of a series.
    """
    from starwise.analysis.accuracy import raised

    file = Path(path)
    if file.suffix.lower() in (".csv", ".txt") and file.is_file() and not _looks_like_pos(file):
        table = read_truth(str(file))
        assert table.t_ns is not None
        return Receiver(str(file), table.t_ns, table.pos_e, np.full((len(table.t_ns), 3, 3), np.nan))
    solution = read_solution(file, ledger=False)
    pos = solution.pos_e
    if solution.provenance.get("height") == "geodetic":
        if geoid_m is None:
            raise StarwiseError(
                "heights are above the geoid, and fusing needs them above the ellipsoid", file=file, wanted="--geoid M"
            )
        pos = raised(Truth(pos, solution.t_ns), geoid_m).pos_e
    return Receiver(str(file), solution.t_ns, pos, solution.cov_pos)


def _looks_like_pos(file: Path) -> bool:
    """Whether a text file is a position file or NMEA rather than a table with commas and names."""
    with file.open("rb") as stream:
        head = stream.read(64).lstrip()
    return head.startswith((b"%", b"$G"))


def fuse_files(
    files: Sequence[str | Path],
    config: FuseConfig | None = None,
    output: str | Path | None = None,
    geoid_m: float | None = None,
    progress: Progress | None = None,
    report: bool = True,
) -> Solution:
    """Fused solution of position files of several receivers, also written to a folder.

    Parameters
    ----------
    files : sequence of path-like
        One per receiver, two or more; see `read_receiver`.
    config : FuseConfig, optional
    output : path-like, optional
        Folder for ``solution.parquet``, ``ledger.parquet``, ``solution.pos``, ``run.json`` and ``report.html``.
    geoid_m : float, optional
    progress : callable, optional
    report : bool
        Write ``report.html``, too.

    Raises
    ------
    StarwiseError
        Fewer than two files, or one of them twice; a file that cannot be read; nothing to fuse.
    """
    options, say = config or FuseConfig(), progress or (lambda _what, _fraction: None)
    paths = [Path(f) for f in files]
    if len(paths) < 2:
        raise StarwiseError("fusing takes the fixes of two receivers or more", found=f"{len(paths)} file")
    seen: set[Path] = set()
    for path in paths:
        if path.resolve() in seen:
            raise StarwiseError("given twice", file=path, wanted="a file of another receiver")
        seen.add(path.resolve())
    if output is not None:
        prepare_directory(output)
    say("reading", 0.0)
    receivers = [read_receiver(path, geoid_m) for path in paths]
    say("fusing", 0.5)
    solution = fuse_fixes(receivers, options)
    from dataclasses import replace

    provenance: dict[str, Any] = {
        "starwise": __version__,
        "command": "fuse",
        "config": options.to_dict(),
        "inputs": [{"file": str(path), "sha256": _hash(path)} for path in paths],
        **solution.provenance,
        "summary": _summary(solution),
    }
    solution = replace(solution, provenance=provenance)
    if output is not None:
        say("writing", 0.9)
        from starwise.report.html import run_page

        write_results(solution, output, (lambda: run_page(solution)) if report else None)
    say("done", 1.0)
    return solution


def _hash(path: Path) -> str:
    if path.is_dir():
        path = path / "solution.parquet"
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _summary(solution: Solution) -> dict[str, Any]:
    sigma = np.sqrt(np.einsum("nii->n", solution.cov_pos))
    out: dict[str, Any] = {
        "epochs": solution.n_epochs,
        "duration_s": float(solution.t_ns[-1] - solution.t_ns[0]) * 1e-9,
        "sigma_3d_median_m": float(np.median(sigma)),
    }
    told = np.isfinite(solution.nis)
    if told.any():
        out["nis_per_dof"] = float(solution.nis[told].mean() / 3.0)
    return out


def fuse_text(record: dict[str, Any], output: Path | None) -> str:
    """Outcome in words, for a terminal."""
    s = record["summary"]
    lines = [f"{s['epochs']} epochs in {s['duration_s']:.0f} s, sigma (3D, median) {s['sigma_3d_median_m']:.2f} m"]
    rows = zip(record["receivers"], record["fixes"], record["refused"], strict=True)
    lines += [f"  {name}: {fixes} fixes, {refused} refused" for name, fixes, refused in rows]
    if record.get("noise_scale") is not None:
        lines.append(
            f"  noise against that claimed: x {record['noise_scale']:.2f}; "
            f"correlation from epoch to epoch {record['noise_correlation']:.2f}"
        )
    elif "noise_scale" in record:
        why = ": no epoch has two fixes to compare (--tolerance)" if record["config"]["scale"] else ""
        lines.append(f"  noise taken as the files claim{why}")
    if output is not None:
        lines.append(f"  in {output}")
    return "\n".join(lines)
