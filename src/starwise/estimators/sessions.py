"""A run cut into sessions, each with an estimator that is started anew: a sample of what its covariance claims."""

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from starwise.config import RunConfig
from starwise.errors import StarwiseError
from starwise.estimators.dynamics import settle_dynamics
from starwise.estimators.run import solve_run
from starwise.gnsstime import session_numbers
from starwise.types import Ephemeris, IonosphereModel, Observations, Solution

Progress = Callable[[str, float], None]
F8 = NDArray[np.float64]


def solve_sessions(
    obs: Observations,
    ephemeris: Ephemeris,
    ionosphere: IonosphereModel,
    config: RunConfig,
    progress: Progress | None = None,
) -> Solution:
    """Solve sessions of ``config.session_s`` one after the other, as if each were all there is.

    Parameters and errors as `starwise.estimators.run.solve_run`, which does the whole run where there is no
    ``session_s``. A session that nothing can be positioned with is left out, with a note.
    """
    length = config.session_s
    if length is None:
        return solve_run(obs, ephemeris, ionosphere, config, progress)
    obs = obs.between(config.start_ns, config.end_ns, config.interval_s)
    config = config.with_options({"start": None, "end": None, "interval_s": None})
    say = progress or (lambda _what, _fraction: None)
    config, dynamics = settle_dynamics(obs, ephemeris, ionosphere, config)  # of the whole run: sessions are no motion
    number = session_numbers(obs.t_ns, length)
    parts: list[Solution] = []
    failed: list[StarwiseError] = []
    for i in range(int(number[-1]) + 1 if len(number) else 0):
        mine = obs.t_ns[number == i]
        if not len(mine):
            continue
        say(f"session {i + 1}", i / (number[-1] + 1))
        try:
            parts.append(solve_run(obs.between(int(mine[0]), int(mine[-1])), ephemeris, ionosphere, config))
        except StarwiseError as error:
            failed.append(error)
    if not parts:
        raise failed[0] if failed else StarwiseError("no epochs in the observations (or none between start and end)")
    notes = [f"{len(parts)} sessions of {length:g} s, each started anew"]
    notes += [f"{len(failed)} sessions left out: {failed[0].message}"] if failed else []
    whole = joined(parts)
    return replace(
        whole, provenance={**whole.provenance, "dynamics": dynamics, "notes": [*whole.provenance["notes"], *notes]}
    )


def joined(parts: list[Solution]) -> Solution:
    """Solutions of consecutive times as one; clocks are aligned by the names of their systems."""
    names = tuple(dict.fromkeys(name for part in parts for name in part.clock_names))

    def clocks(part: Solution, values: F8) -> F8:
        out = np.full((part.n_epochs, len(names)), np.nan)
        out[:, [names.index(name) for name in part.clock_names]] = values
        return out

    whole: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("t_ns", "status", "pos_e", "vel_e", "cov_pos", "cov_vel", "n_used", "dop", "nis", "dof")
    }
    return replace(
        parts[0],
        **whole,
        clock_m=np.concatenate([clocks(part, part.clock_m) for part in parts]),
        drift_mps=np.concatenate([clocks(part, part.drift_mps) for part in parts]),
        clock_sigma_m=np.concatenate([clocks(part, part.clock_sigma_m) for part in parts]),
        clock_names=names,
        extra={key: np.concatenate([part.extra[key] for part in parts]) for key in parts[0].extra},
        ledger={key: np.concatenate([part.ledger[key] for part in parts]) for key in parts[0].ledger},
        provenance={**parts[0].provenance, "notes": _notes(parts), **_events(parts)},
    )


def _events(parts: list[Solution]) -> dict[str, Any]:
    found = [part.provenance["events"] for part in parts if "events" in part.provenance]
    return {"events": [event for events in found for event in events]} if found else {}


def _notes(parts: list[Solution]) -> list[str]:
    """Notes of all parts; of those that differ in their numbers alone, the first, with the count of the others."""
    alike: dict[str, list[str]] = {}
    for part in parts:
        for note in part.provenance.get("notes", ()):
            alike.setdefault(re.sub(r"\d+", "0", note), []).append(str(note))
    return [
        notes[0] if len(set(notes)) == 1 else f"{notes[0]} (and alike in {len(notes) - 1} other sessions)"
        for notes in alike.values()
    ]
