"""Residuals of every satellite as other programs write them."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from starwise.errors import StarwiseError
from starwise.signals import sv_name
from starwise.types import F8, I2, I8

if TYPE_CHECKING:
    import polars as pl


@dataclass(frozen=True)
class Residuals:
    """Residuals after a fit, a row per epoch, satellite and channel, sorted so.

    Attributes
    ----------
    t_ns : (n,) int64
        GPST, ns.
    sv : (n,) int16
        Satellites.
    channel : (n,) int16
        Index in ``channels``.
    channels : tuple of str
        Frequencies or signals, as the program calls them.
    azimuth_rad, elevation_rad : (n,) float64
        Of the satellite; NaN if not told.
    code_m, phase_m : (n,) float64
        Residual of pseudorange and carrier phase, m; NaN where there is none.
    cn0_dbhz : (n,) float64
    valid : (n,) bool
        The row took part in the fit.
    source, format : str
    notes : tuple of str
        What a reader should know.
    sigma_m : (n,) float64 or None
        What the program thought of the pseudorange's error, 1 sigma, if it says so.
    """

    t_ns: I8
    sv: I2
    channel: I2
    channels: tuple[str, ...]
    azimuth_rad: F8
    elevation_rad: F8
    code_m: F8
    phase_m: F8
    cn0_dbhz: F8
    valid: NDArray[np.bool_]
    source: str = ""
    format: str = ""
    notes: tuple[str, ...] = ()
    sigma_m: F8 | None = None

    @property
    def n(self) -> int:
        """Number of rows."""
        return len(self.t_ns)

    def to_polars(self) -> "pl.DataFrame":
        """Table with names in place of numbers and degrees in place of radians."""
        import polars as pl

        columns = {
            "t_gpst_ns": self.t_ns,
            "sv": [sv_name(int(code)) for code in self.sv],
            "channel": [self.channels[i] for i in self.channel.tolist()],
            "azimuth_deg": np.degrees(self.azimuth_rad),
            "elevation_deg": np.degrees(self.elevation_rad),
            "code_m": self.code_m,
            "phase_m": self.phase_m,
            "cn0_dbhz": self.cn0_dbhz,
            "valid": self.valid,
        }
        return pl.DataFrame(columns, nan_to_null=True)


def read_residuals(path: str | Path) -> Residuals:
    """Residuals of a file of another program: RTKLIB's ``.stat``, or a table of gnss_lib_py.

    What a file is, is told by its content.

    Raises
    ------
    StarwiseError
        Not such a file, no residuals in it, or a row that cannot be read.
    """
    from starwise.io.foreign import kind_of

    kind = kind_of(path)
    if kind == "stat":
        from starwise.io.stat import read_stat_residuals

        return read_stat_residuals(path)
    if kind == "gnss_lib_py residuals":
        from starwise.io.gnss_lib_py import read_gnss_lib_py_residuals

        return read_gnss_lib_py_residuals(path)
    raise StarwiseError(
        "no residuals", file=path, found=kind, wanted="RTKLIB's .stat, or a gnss_lib_py table with residuals_m"
    )
