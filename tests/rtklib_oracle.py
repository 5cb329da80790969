"""RTKLIB (through pyrtklib) as an oracle: plain lists in, numbers out. Importing it skips when absent."""

import pytest

rtk = pytest.importorskip("pyrtklib", reason="oracle pyrtklib is not installed")


def array(values):
    """A C array of doubles."""
    out = rtk.Arr1Ddouble(len(values))
    for i, value in enumerate(values):
        out[i] = float(value)
    return out
