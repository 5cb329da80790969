"""Solutions of other programs, told apart by what is in the file, and read into a `Solution`."""

from io import BytesIO
from pathlib import Path
from typing import Final

import numpy as np

from starwise.errors import StarwiseError
from starwise.io.files import read_bytes
from starwise.types import Solution

_HEAD: Final = 1 << 16


def kind_of(path: str | Path) -> str:
    """What a text file of a solution is, by its content.

    Returns
    -------
    str
        ``stat``, ``nmea``, ``gnss_lib_py``, ``gnss_lib_py residuals``, ``kf-gins``, ``kf-gins std``, ``csv`` (as
        ``starwise export`` writes it), or ``pos``: anything else, which the reader of position files shall judge.
    """
    return kind_of_text(read_bytes(path)[:_HEAD].decode("latin-1"))


def kind_of_text(head: str) -> str:
    """What the beginning of a file is; see `kind_of`."""
    from starwise.io import gnss_lib_py, kf_gins, nmea, stat

    head = head.removeprefix("\xef\xbb\xbf")
    first = head.split("\n", 1)[0]
    if stat.looks_like_stat(head):
        return "stat"
    if first.startswith("t_gpst_ns,") and ",status," in first:
        return "csv"
    if gnss_lib_py.looks_like_residuals(head):
        return "gnss_lib_py residuals"
    if gnss_lib_py.looks_like_state(head):
        return "gnss_lib_py"
    if kf_gins.looks_like_nav(head):
        return "kf-gins"
    if kf_gins.looks_like_std(head):
        return "kf-gins std"
    if not head.lstrip().startswith("%") and nmea.looks_like_nmea(head):
        return "nmea"
    return "pos"


def read_foreign(path: str | Path) -> Solution:
    """Solution of a file of another program: `.pos`, ``.stat``, NMEA, gnss_lib_py, KF-GINS; or of ``export --to csv``.

    Raises
    ------
    StarwiseError
        None of these, or a row that cannot be read.
    """
    path = Path(path)
    kind = kind_of(path)
    if kind == "stat":
        from starwise.io.stat import read_stat

        return read_stat(path)
    if kind == "nmea":
        from starwise.io.nmea import parse_nmea

        return parse_nmea(read_bytes(path).decode("latin-1"), str(path))
    if kind == "gnss_lib_py":
        from starwise.io.gnss_lib_py import read_gnss_lib_py

        return read_gnss_lib_py(path)
    if kind == "gnss_lib_py residuals":
        from starwise.io.gnss_lib_py import looks_like_state, read_gnss_lib_py

        head = read_bytes(path)[:_HEAD].decode("latin-1").replace("residuals_m", "")
        if looks_like_state(head):
            return read_gnss_lib_py(path)
        raise StarwiseError("residuals without positions", file=path, wanted="starwise assess, for residuals")
    if kind in ("kf-gins", "kf-gins std"):
        return _kf_gins(path, kind)
    if kind == "csv":
        return _table(path)
    return _pos(path)


def _table(path: Path) -> Solution:
    """Solution of a table that ``starwise export --to csv`` wrote."""
    import polars as pl

    from starwise.io.results import solution_of_table

    try:
        table = pl.read_csv(BytesIO(read_bytes(path)), infer_schema_length=None)
        with np.errstate(invalid="raise"):  # blanks among whole numbers
            return solution_of_table(table, {}, {"file": str(path), "format": "starwise csv"})
    except (KeyError, ValueError, TypeError, ArithmeticError, pl.exceptions.PolarsError) as error:
        raise StarwiseError(f"not a solution table ({str(error).splitlines()[0]})", file=path) from None


def _pos(path: Path) -> Solution:
    from starwise.io.pos import read_pos

    try:
        return read_pos(path)
    except StarwiseError as error:
        if error.line != 1 or path.suffix.lower() == ".pos":
            raise
        raise StarwiseError(
            "not a solution of a kind that is known", file=path, found=error.found,
            wanted="a result of starwise, RTKLIB .pos or .stat, NMEA, a gnss_lib_py table, or a KF-GINS result",
        ) from None  # fmt: skip


def _kf_gins(path: Path, kind: str) -> Solution:
    from starwise.io.kf_gins import NAV_NAME, nav_beside, read_kf_gins

    if kind == "kf-gins":
        return read_kf_gins(path)
    nav = nav_beside(path)
    if nav is None:
        raise StarwiseError(
            "standard deviations of KF-GINS without their positions", file=path, wanted=f"{NAV_NAME} beside it"
        )
    return read_kf_gins(nav, path)
