"""starwise: satellite and satellite/inertial navigation filters, and the means to check them.

The main entry points, imported when first used so that ``import starwise`` costs nothing:

* `solve`: observation, navigation and orbit files in, a `Solution` out;
* `assess`: errors of a solution against the truth; `pool`: the covariances of many runs against theirs;
* `fuse_files`: position fixes of several receivers in, one solution out;
* `read_obs`, `read_nav`, `read_sp3`, `read_clk`, `read_pos`, `read_residuals`, `read_solution`, `read_truth`: files as
  nouns;
* `write_results`: a solution as files; `export`: for maps and other programs;
* `Consistency`, `Observability`, `Stability`: what the laboratory says of a run (``.of(solution)``, ``.verdict``);
* `RunConfig`, `Solution`, `Observations`, `StarwiseError`: the nouns.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from starwise._version import __version__

if TYPE_CHECKING:
    from starwise.analysis.lab import Consistency
    from starwise.analysis.run_observability import Observability
    from starwise.analysis.run_stability import Stability
    from starwise.api import assess, info, pool, solve
    from starwise.api_export import export
    from starwise.config import RunConfig, load_config
    from starwise.errors import StarwiseError
    from starwise.io.clk import read_clk
    from starwise.io.pos import read_pos
    from starwise.io.residuals import read_residuals
    from starwise.io.results import read_solution, write_results
    from starwise.io.rinex_nav import read_nav
    from starwise.io.rinex_obs import read_obs
    from starwise.io.sp3 import read_sp3
    from starwise.io.truth import read_truth
    from starwise.studies.fusing import fuse_files
    from starwise.types import BroadcastRecords, Observations, Solution, Truth

_HOME = {
    "solve": "api",
    "assess": "api",
    "info": "api",
    "pool": "api",
    "export": "api_export",
    "fuse_files": "studies.fusing",
    "Consistency": "analysis.lab",
    "Observability": "analysis.run_observability",
    "Stability": "analysis.run_stability",
    "RunConfig": "config",
    "load_config": "config",
    "StarwiseError": "errors",
    "read_obs": "io.rinex_obs",
    "read_nav": "io.rinex_nav",
    "read_sp3": "io.sp3",
    "read_clk": "io.clk",
    "read_pos": "io.pos",
    "read_residuals": "io.residuals",
    "read_solution": "io.results",
    "write_results": "io.results",
    "read_truth": "io.truth",
    "BroadcastRecords": "types",
    "Observations": "types",
    "Solution": "types",
    "Truth": "types",
}

__all__ = [
    "BroadcastRecords",
    "Consistency",
    "Observability",
    "Observations",
    "RunConfig",
    "Solution",
    "Stability",
    "StarwiseError",
    "Truth",
    "__version__",
    "assess",
    "export",
    "fuse_files",
    "info",
    "load_config",
    "pool",
    "read_clk",
    "read_nav",
    "read_obs",
    "read_pos",
    "read_residuals",
    "read_solution",
    "read_sp3",
    "read_truth",
    "solve",
    "write_results",
]


def __getattr__(name: str) -> Any:
    home = _HOME.get(name)
    if home is None:
        raise AttributeError(f"module 'starwise' has no attribute {name!r}")
    value = getattr(import_module(f"starwise.{home}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
