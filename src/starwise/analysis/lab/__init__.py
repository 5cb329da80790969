"""The laboratory: whether a filter is consistent with what it measures, why not, and what to do about it.

`Consistency.of` takes a run with its ledger, `Consistency.from_innovations` a plain table of innovations of any
program.
"""

from starwise.analysis.lab.consistency import Consistency
from starwise.analysis.lab.findings import Cause, Finding
from starwise.analysis.lab.innovations import Channel, Innovations

__all__ = ["Cause", "Channel", "Consistency", "Finding", "Innovations"]
