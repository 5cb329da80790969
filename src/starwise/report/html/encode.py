"""Numbers for a page: compact arrays in JSON that no input can break out of, thinned with their extremes kept."""

import base64
import json
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

_DTYPES: Final = {"f4": "<f4", "f8": "<f8", "u1": "|u1", "u2": "<u2", "u4": "<u4", "i2": "<i2", "i4": "<i4"}
_ESCAPES: Final = (("&", "\\u0026"), ("<", "\\u003c"), (">", "\\u003e"), ("\u2028", "\\u2028"), ("\u2029", "\\u2029"))


def packed(values: NDArray[Any], dtype: str = "f4") -> dict[str, str]:
    """Array as ``{"dtype", "bdata"}``: little-endian bytes in base64, as plotly and the page's script read them.

    Parameters
    ----------
    values : (n,) array
        Flattened if it has more dimensions. Integers are cut to the range of ``dtype``.
    dtype : {"f4", "f8", "u1", "u2", "u4", "i2", "i4"}
    """
    kind = np.dtype(_DTYPES[dtype])
    if kind.kind != "f":
        range_ = np.iinfo(kind)
        values = np.clip(np.nan_to_num(values), range_.min, range_.max)
    with np.errstate(over="ignore"):
        data = np.ascontiguousarray(values).astype(kind)
    return {"dtype": dtype, "bdata": base64.b64encode(data.tobytes()).decode("ascii")}


def safe_json(value: Any) -> str:
    """JSON that may stand inside ``<script>``: no ``<``, ``>``, ``&``, line or paragraph separator is left in it."""
    text = json.dumps(plain(value), ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    for character, escape in _ESCAPES:
        text = text.replace(character, escape)
    return text


def plain(value: Any) -> Any:
    """Value with numpy's scalars as Python's and what is not finite as None."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


def thinned(series: Sequence[F8], limit: int) -> I8:
    """Indices of at most about ``limit`` rows, the least and the greatest value of every series in every bucket kept.

    Parameters
    ----------
    series : sequence of (n,) float64
        All of the same length; NaN is no value, but the edges of gaps (a value beside NaN) are kept, too.
    limit : int
        Rows wanted; all rows if there are no more.

    Returns
    -------
    (m,) int64
        Increasing; the first and the last row are among them.
    """
    n = len(series[0]) if series else 0
    if n <= limit:
        return np.arange(n)
    buckets = max(2, limit // 2)
    while True:
        keep = np.zeros(n, dtype=bool)
        keep[[0, -1]] = True
        edges = np.linspace(0, n, buckets + 1).astype(np.int64)[:-1]
        keep[edges] = True
        for values in series:
            keep[_extremes(values, edges)] = True
        kept = np.flatnonzero(keep)
        if len(kept) <= limit or buckets <= 16:
            return kept
        buckets = max(16, int(buckets * min(0.8, limit / len(kept))))


def _extremes(values: F8, edges: I8) -> I8:
    """Row of the least and of the greatest value of each bucket, which begin at ``edges``."""
    n = len(values)
    bucket = np.zeros(n, dtype=np.int64)
    bucket[edges[1:]] = 1
    bucket = np.cumsum(bucket)
    found = []
    for filled, extreme in ((np.inf, np.minimum), (-np.inf, np.maximum)):
        known = np.where(np.isnan(values), filled, values)
        best = extreme.reduceat(known, edges)
        hits = np.flatnonzero((known == best[bucket]) & ~np.isnan(values))
        first = np.unique(bucket[hits], return_index=True)[1]
        found.append(hits[first])
    return np.concatenate(found)
