"""The word ``auto`` of `RunConfig.dynamics` made into one of the others, before a filter runs."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from starwise.config import ProcessNoise, RunConfig
from starwise.constants import EPOCH_OK
from starwise.errors import StarwiseError
from starwise.estimators.least_squares import least_squares
from starwise.models.dynamics import BLOCK, detect_motion
from starwise.models.process import MOVING
from starwise.models.pseudorange import prepare
from starwise.types import Ephemeris, IonosphereModel, Observations

EPOCHS_LOOKED_AT: Final = 5000
"""Of longer runs blocks of neighbouring epochs, evenly distributed: of a day at 1 Hz five seconds in every 86."""


def settle_dynamics(
    obs: Observations, ephemeris: Ephemeris, ionosphere: IonosphereModel, config: RunConfig
) -> tuple[RunConfig, dict[str, Any]]:
    """Configuration whose dynamics are not ``auto``, and how they were found.

    Least squares does without dynamics, and a process model of the user's own is not second-guessed: neither is looked
    into.

    Parameters
    ----------
    obs : Observations
        Those of the run.
    ephemeris, ionosphere, config
        As `starwise.estimators.run.solve_run`.

    Returns
    -------
    RunConfig
    dict
        ``used``, ``detected`` (False: as configured), and what `starwise.models.dynamics.Detected` says.
    """
    if config.dynamics != "auto":
        return config, {"used": config.dynamics, "detected": False}
    if config.method == "lsq" or config.process != ProcessNoise():
        return config.with_options({"dynamics": MOVING}), {"used": MOVING, "detected": False}
    look = config.with_options(
        {
            "method": "lsq", "error_model": "white", "combination": "single", "dynamics": MOVING, "session_s": None,
            "share": "auto", "adaptation": "none", "clock.isolate": False,
        }
    )  # fmt: skip
    try:
        prepared = prepare(obs.taken(_looked_at(obs.n_epochs)), ephemeris, ionosphere, look)
    except StarwiseError:
        # The run itself says what is wrong, in the terms of its own configuration.
        return config.with_options({"dynamics": MOVING}), {"used": MOVING, "detected": False}
    ep, _ = least_squares(prepared, look)
    trusted = (ep.status == EPOCH_OK) & np.isfinite(ep.pos).all(axis=1)
    found = detect_motion(prepared.epochs.t_ns, ep.pos, ep.cov_pos, ep.vel, ep.cov_vel, trusted)
    used = MOVING if found.moving else "static"
    return config.with_options({"dynamics": used}), {"used": used, "detected": True, **found.to_dict()}


def _looked_at(n_epochs: int) -> NDArray[np.bool_]:
    keep = np.ones(n_epochs, dtype=bool)
    if n_epochs > EPOCHS_LOOKED_AT:
        begins = np.linspace(0, n_epochs - BLOCK, EPOCHS_LOOKED_AT // BLOCK).astype(np.int64)
        keep[:] = False
        keep[(begins[:, None] + np.arange(BLOCK)).ravel()] = True
    return keep
