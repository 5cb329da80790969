"""The laboratory in one call: consistency, observability, stability and what-if of a finished run, as plain records."""

import json
import os
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from starwise.errors import StarwiseError
from starwise.io.results import ASSESSMENT
from starwise.types import F8, I8, Fixes, Solution, Truth

if TYPE_CHECKING:
    from starwise.analysis.lab import Consistency
    from starwise.analysis.lab.tuning import Tuning
    from starwise.analysis.run_system import AnySystem
    from starwise.config import RunConfig

SUGGESTION: Final = "suggested.toml"
WRONG_PLACE_M: Final = 1e4
"""Horizontal error from which the truth, not the solution, is doubted."""
PARTS: Final = ("consistency", "observability", "stability")
"""What is judged beside accuracy unless left out."""
_LEDGER: Final = frozenset({"innovation_m", "innovation_var_m2", "rate_innovation_mps", "rate_innovation_var_m2ps2"})
Progress = Callable[[str, float], None]
Rerun = Callable[["RunConfig"], Solution]


@dataclass(frozen=True)
class Laboratory:
    """What the laboratory shall do with a run.

    Attributes
    ----------
    parts : tuple of str
        Of `PARTS`.
    what_if : str or None
        Measurements to add or take away, like ``altimeter,-doppler``.
    windows : int
        Windows of the run for observability.
    steps : int or None
        Epochs that stability follows; None: all.
    tolerance_s, interpolate
        Matching with the truth; see `starwise.analysis.accuracy.match`.
    """

    parts: tuple[str, ...] = PARTS
    what_if: str | None = None
    windows: int = 8
    steps: int | None = 240
    tolerance_s: float = 0.05
    interpolate: bool = False

    def __post_init__(self) -> None:
        unknown = sorted(set(self.parts) - set(PARTS))
        if unknown:
            raise StarwiseError("the laboratory has no such part", found=unknown[0], wanted=", ".join(PARTS))
        if self.windows < 1 or (self.steps is not None and self.steps < 2):
            raise StarwiseError("the laboratory needs a window and two steps", found=f"{self.windows}, {self.steps}")
        if self.what_if is not None:
            from starwise.analysis.what_if_change import Change

            for text in self.what_if.split(","):
                Change.parse(text)

    @property
    def needed(self) -> bool:
        """Anything to do: the ledger is wanted."""
        return bool(self.parts) or self.what_if is not None

    def records(
        self, solution: Solution, truth: Truth | None, vertical: bool = True
    ) -> tuple[dict[str, Any], "Consistency | None"]:
        """Records of the parts asked for, by their names; a part that cannot be judged says why.

        Parameters
        ----------
        solution : Solution
            With its ledger.
        truth : Truth or None
        vertical : bool
            False: heights are not comparable.

        Returns
        -------
        dict
            ``consistency``, ``observability``, ``stability``, ``what_if`` (None unless asked for): see
            ``docs/formats.md``. A part without what it needs has the verdict ``not judged`` and the reason in
            ``explain``.
        Consistency or None
            The object behind its record.

        Raises
        ------
        StarwiseError
            A what-if that cannot be tried.
        """
        found: dict[str, Any] = dict.fromkeys((*PARTS, "what_if"))
        if "consistency" not in self.parts:
            return self._of_system(solution, found), None
        from starwise.analysis.lab import Consistency

        whole = solution if set(solution.ledger) >= _LEDGER else replace(solution, ledger={})
        with ThreadPoolExecutor(1) as other:  # beside the rest: most of both is numpy's, outside of the interpreter
            judged = other.submit(
                Consistency.of, whole, truth, tolerance_s=self.tolerance_s, interpolate=self.interpolate,
                vertical=vertical,
            )  # fmt: skip
            found = self._of_system(solution, found)
            consistency = judged.result()
        found["consistency"] = consistency.to_dict()
        return found, consistency

    def _of_system(self, solution: Solution, found: dict[str, Any]) -> dict[str, Any]:
        """Records of what is asked of the run's linear system."""
        of_system = [name for name in ("observability", "stability") if name in self.parts]
        if self.what_if is None and not of_system:
            return found
        try:
            system = _system(solution)
        except StarwiseError as error:
            if self.what_if is not None:
                raise
            return {**found, **dict.fromkeys(of_system, _not_judged(error))}
        if "observability" in of_system:
            from starwise.analysis.run_observability import Observability

            found["observability"] = _record(lambda: Observability.of(system, windows=self.windows))
        if "stability" in of_system:
            from starwise.analysis.run_stability import Stability

            found["stability"] = _record(lambda: Stability.of(system, steps=self.steps))
        if self.what_if is not None:
            from starwise.analysis.what_if import WhatIf

            found["what_if"] = WhatIf.of(system, self.what_if, sky=sky_of(solution)).to_dict()
        return found


def _record(make: Callable[[], Any]) -> dict[str, Any]:
    try:
        return dict(make().to_dict())
    except StarwiseError as error:
        return _not_judged(error)


def _not_judged(error: StarwiseError) -> dict[str, Any]:
    return {"verdict": "not judged", "explain": f"not judged: {error}"}


def _system(solution: Solution) -> "AnySystem":
    from starwise.analysis.run_system import system_of

    return system_of(solution, _fixes(solution))


def _fixes(solution: Solution) -> Fixes | None:
    """Fixes of an inertial run, read again from where ``run.json`` says that they are; None if they are not."""
    place = next((item["path"] for item in solution.provenance.get("inputs", ()) if item.get("kind") == "fixes"), None)
    if place is None or not Path(place).exists():
        return None
    from starwise.estimators.ins_tight import fixes_of
    from starwise.io.results import read_solution

    try:
        return fixes_of(read_solution(Path(place), ledger=False))
    except StarwiseError:
        return None  # the file is no longer what it was: the system says that its sigmas are not known


def sky_of(solution: Solution) -> Callable[[str, I8, F8], tuple[I8, Any, F8, F8]] | None:
    """Where satellites of a system are, by the navigation files of a run; None if they are no longer there.

    Orbits are broadcast ones, the nearest in time, at reception less 75 ms of flight: a thousandth of a degree.
    """
    files = [
        Path(item["path"])
        for item in solution.provenance.get("inputs", ())
        if item.get("kind") in ("navigation", "nav")
    ]
    if not files or not all(path.exists() for path in files):
        return None

    def sky(letter: str, t_ns: I8, pos_e: F8) -> tuple[I8, Any, F8, F8]:
        from starwise.constants import SAT_OK, SYSTEMS
        from starwise.frames import azimuth_elevation
        from starwise.io.rinex_nav import read_nav
        from starwise.physics.broadcast import BroadcastEphemeris

        ephemeris = BroadcastEphemeris(read_nav(*files))
        numbers = np.unique(ephemeris.records.sv)
        numbers = numbers[numbers >> 8 == SYSTEMS.index(letter)]
        k, m = len(t_ns), len(numbers)
        index, sv = np.repeat(np.arange(k), m), np.tile(numbers, k)
        states = ephemeris.states(t_ns[index], sv, np.full(k * m, 0.075 * 299_792_458.0), post=True)
        good = np.flatnonzero(states.status == SAT_OK)
        az, el = np.full(k * m, np.nan), np.full(k * m, -np.pi)
        for e in range(k):
            here = good[index[good] == e]
            if len(here):
                az[here], el[here] = azimuth_elevation(pos_e[e], states.pos_e[here])
        return index[good].astype(np.int64), sv[good], el[good], az[good]

    return sky


def suggested(
    solution: Solution,
    consistency: "Consistency | None" = None,
    *,
    rerun: Rerun | None = None,
    progress: Progress | None = None,
    needed: bool = True,
) -> "Tuning | None":
    """Configuration with which the filter would be more consistent; None: nothing to suggest.

    Parameters
    ----------
    solution : Solution
        With its ledger.
    consistency : Consistency, optional
        Of the solution; else it is made.
    rerun : callable, optional
        Solves the same measurements with another configuration: then by maximum likelihood of the innovations, which
        takes dozens of runs. Without it, from the sizes of the innovations at once.
    progress : callable, optional
    needed : bool
        False: None also where the solution does not say how it was made.

    Raises
    ------
    StarwiseError
        The solution does not say how it was made, or has no innovations.
    """
    from starwise.analysis.lab import Consistency

    given = solution.provenance.get("config")
    if not isinstance(given, Mapping) or "inertial" in given or not set(solution.ledger) >= _LEDGER:
        if not needed:
            return None
        raise StarwiseError("nothing to tune", wanted="a result directory of solve with satellites")
    known = Consistency.of(solution) if consistency is None else consistency
    tuning = known.tuning if rerun is None else known.tuned(rerun, progress=progress)
    used = solution.provenance.get("dynamics", {}).get("used")
    if tuning is None or not used or not any(key.startswith("process.") for key in tuning.settings):
        return tuning
    # Strengths of a process belong to its preset, which solve would else look for anew.
    return replace(tuning, settings={"dynamics": used, **tuning.settings})


def keep(
    report: Mapping[str, Any], source: Any, write: bool | str | Path, suggest: str | Path | None, suggestion: str | None
) -> None:
    """Details as ``assess.json`` and the suggested configuration, where they were asked for.

    Parameters
    ----------
    report : mapping
        What `starwise.assess` returns.
    source : object
        What was assessed: a directory of results takes the files.
    write : bool or path-like
        True: into ``source``, if that is such a directory; a directory, or a name that ends in ``.json``.
    suggest : path-like or None
        File for the suggestion.
    suggestion : str or None
        Its text.

    Raises
    ------
    StarwiseError
        They cannot be written.
    """
    folder: Path | None = None
    if isinstance(write, bool):
        if write and isinstance(source, str | Path) and (Path(source) / "run.json").is_file():
            folder = Path(source) if os.access(source, os.W_OK) else None
    else:
        folder = Path(write)
    if suggest is not None and suggestion is not None:
        write_text(Path(suggest), suggestion)
    if folder is None:
        return
    file = folder if folder.suffix == ".json" else folder / ASSESSMENT
    write_text(file, json.dumps(report, indent=1, ensure_ascii=False, allow_nan=False) + "\n")
    beside = file.with_name(SUGGESTION)
    if suggest is None and suggestion is not None:
        write_text(beside, suggestion)
    elif suggest is None and folder.suffix != ".json" and beside.is_file():
        beside.unlink()  # of an earlier assessment


def notes_of(
    solution: Solution, truth: Truth | None, vertical: bool, report: Mapping[str, Any], tolerance_s: float
) -> list[str]:
    """What somebody who reads errors against a truth must know of both, in words.

    Parameters
    ----------
    solution : Solution
    truth : Truth or None
    vertical : bool
        Whether heights are comparable.
    report : mapping
        Of `starwise.analysis.accuracy.assess`.
    tolerance_s : float
        Of matching in time.
    """
    notes = []
    if truth is not None and (report["rms_2d_m"] or 0.0) > WRONG_PLACE_M:
        notes.append(
            f"the truth is {1e-3 * report['rms_2d_m']:.0f} km away: of another place, or its numbers are not what they "
            "are taken for (ECEF metres, or latitude, longitude in degrees, in this order)"
        )
    untold = report["epochs_solved"] - report["epochs_compared"]
    if truth is not None and untold > 0:
        notes.append(f"{untold} solved epochs have no truth within {tolerance_s:g} s (--tolerance, --interpolate)")
    if not vertical and truth is not None:
        notes.append("heights are above the geoid: nothing vertical is compared (give --geoid)")
    if solution.provenance.get("week") == "not in the file":
        known = truth is not None and truth.t_ns is not None
        notes.append("the week is not in the file" + (": that of the truth is taken" if known else ""))
    if "point" in solution.provenance:
        notes.append(f"positions are of the {solution.provenance['point']}, not of the antenna")
    if "covariance" in solution.provenance:
        notes.append(f"covariance: {solution.provenance['covariance']}")
    return notes


def write_text(file: Path, text: str) -> Path:
    """A text file, complete or not at all."""
    temporary = file.with_name(f".{file.name}.{os.getpid()}.part")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_text(text, encoding="utf-8")
        os.replace(temporary, file)
    except OSError as error:
        raise StarwiseError(f"cannot be written ({error.strerror})", file=file) from None
    finally:
        temporary.unlink(missing_ok=True)
    return file
