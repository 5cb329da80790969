"""Many station-days or drives: a list of units solved over all cores or a cluster, into one directory.

``OUT/unit=NAME/`` holds the result of a unit, ``OUT/summary.parquet`` a row for every unit, ``OUT/batch.json`` what was
done. See ``docs/batch.md``.
"""

from starwise.batch.index import read_index, read_summary
from starwise.batch.manifest import Manifest, read_manifest
from starwise.batch.run import run_batch
from starwise.batch.scan import scan
from starwise.batch.work import Unit

__all__ = ["Manifest", "Unit", "read_index", "read_manifest", "read_summary", "run_batch", "scan"]
