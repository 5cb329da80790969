"""What a batch left, as tables that can be queried."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from starwise.batch.work import NO_SOLUTION, OK, Row
from starwise.errors import StarwiseError

if TYPE_CHECKING:
    import polars as pl

SUMMARY: Final = "summary.parquet"
_COLUMNS: Final[dict[str, str]] = {
    "number": "Int64", "unit": "String", "status": "String", "marker": "String", "first_gpst": "String",
    "last_gpst": "String", "interval_s": "Float64", "epochs": "Int64", "solved": "Int64", "satellites": "Float64",
    "sigma_3d_m": "Float64", "compared": "Int64", "rms_2d_m": "Float64", "rms_3d_m": "Float64", "p95_3d_m": "Float64",
    "mean_u_m": "Float64", "coverage_50": "Float64", "coverage_68": "Float64", "coverage_95": "Float64",
    "nees_mean": "Float64", "clocks": "String", "problems": "Int64", "message": "String", "seconds": "Float64",
    "bytes_in": "Int64", "bytes_out": "Int64", "resumed": "Boolean",
}  # fmt: skip
_MANY: Final = 4096
"""Rows that are kept as dictionaries before they become a table."""


class Rows:
    """Rows of a summary as they come, small in memory, in the order of the manifest at the end."""

    def __init__(self) -> None:
        self._new: list[Row] = []
        self._tables: list[Any] = []

    def add(self, row: Row) -> None:
        """Keep a row."""
        self._new.append(row)
        if len(self._new) >= _MANY:
            self._pack()

    def _pack(self) -> None:
        import polars as pl

        schema = {name: getattr(pl, kind)() for name, kind in _COLUMNS.items()}
        self._tables.append(pl.DataFrame(self._new, schema=schema))
        self._new = []

    def table(self) -> "pl.DataFrame":
        """All rows; columns are described in ``docs/batch.md``."""
        import polars as pl

        self._pack()
        self._tables = [pl.concat(self._tables)]
        table: pl.DataFrame = self._tables[0]
        return table.sort("number")


def read_summary(directory: str | Path) -> "pl.DataFrame":
    """Summary of a batch: a row for every unit, in the order of its manifest.

    Parameters
    ----------
    directory : path-like
        Folder or URL of the batch.

    Raises
    ------
    StarwiseError
        There is none.
    """
    import polars as pl

    from starwise.batch.store import fetched

    place = f"{str(directory).rstrip('/')}/{SUMMARY}"
    try:
        with fetched((place,)) as local:
            return pl.read_parquet(local[place])
    except (OSError, pl.exceptions.PolarsError) as error:
        raise StarwiseError(f"no summary of a batch ({str(error).splitlines()[0]})", file=place) from None


def read_index(directory: str | Path) -> "pl.LazyFrame":
    """All solutions of a batch as one lazy table: the columns of ``solution.parquet``, and ``unit``.

    Clocks of systems that a unit did not have are null. Only units that the summary calls solved are in it.

    Parameters
    ----------
    directory : path-like
        Folder or URL of the batch.

    Raises
    ------
    StarwiseError
        No summary, or no solution in it.
    """
    import polars as pl

    base = str(directory).rstrip("/")
    summary = read_summary(base).filter(pl.col("status").is_in([OK, NO_SOLUTION]))
    if summary.is_empty():
        raise StarwiseError("no unit of this batch was solved", file=base)
    # one file of every set of clocks: together they have all columns
    first = summary.unique("clocks", keep="first", maintain_order=True)["unit"].to_list()
    schema: dict[str, Any] = {}
    for unit in first:
        schema.update(pl.read_parquet_schema(f"{base}/unit={unit}/solution.parquet"))
    return pl.scan_parquet(
        [f"{base}/unit={unit}/solution.parquet" for unit in summary["unit"]],
        schema=schema,
        missing_columns="insert",
        hive_partitioning=True,
        hive_schema={"unit": pl.String},
    )
