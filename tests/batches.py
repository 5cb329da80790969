"""Small batches on the short drive of the demo, for the tests of batches and clusters."""

import json
from importlib import resources
from pathlib import Path

from starwise.batch import Manifest, Unit
from starwise.config import RunConfig

DATA = Path(str(resources.files("starwise.demo"))) / "data"
OBS, NAV, TRUTH = DATA / "demo_MO.rnx.gz", DATA / "demo_MN.rnx.gz", DATA / "demo_truth.csv"
QUICK = RunConfig(method="lsq", error_model="white", end="2026-03-21T12:20:20")


def unit(name: str, **changes) -> Unit:
    given = {"obs": (str(OBS),), "nav": (str(NAV),), "truth": str(TRUTH), "config": QUICK, **changes}
    return Unit(name, **given)


def of(*units: Unit) -> Manifest:
    return Manifest(lambda: units, len(units))


def masks(count: int) -> Manifest:
    """Units that differ in their elevation mask, so that no result is another's."""
    return of(*(unit(f"mask-{k:02d}", config=QUICK.with_options({"mask_deg": 5.0 + k})) for k in range(count)))


def contents(folder: Path) -> dict[str, bytes]:
    """Everything that must not depend on who did the work, when, and how fast."""
    found = {}
    for path in sorted(folder.glob("unit=*/*")):
        data = path.read_bytes()
        if path.name == "unit.json":
            record = json.loads(data)
            del record["row"]["seconds"]
            data = json.dumps(record, sort_keys=True).encode()
        found[str(path.relative_to(folder))] = data
    return found


def figures(table) -> list[tuple]:
    return table.drop("seconds", "resumed").rows()
