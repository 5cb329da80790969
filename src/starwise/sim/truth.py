"""Truth of a simulation: the receiver, every light path, and every term of every observation."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from starwise.frames import geodetic_from_ecef
from starwise.signals import signal_name, sv_name
from starwise.types import F8, I2, I8, Truth

if TYPE_CHECKING:
    import polars as pl


@dataclass(frozen=True)
class PathTruth:
    """Light paths: one per (epoch, satellite) received, (n_paths,) but positions and velocities.

    Attributes
    ----------
    epoch : (n,) int64
    sv : (n,) int16
    sat_pos_e, sat_vel_e : (n, 3) float64
        ECEF of the instant of transmission, m, m/s.
    sat_clock_s, sat_drift : (n,) float64
        Satellite clock at transmission, relativity included, s, s/s.
    range_m, range_rate_mps : (n,) float64
        c times the light time in vacuum, and its rate.
    elevation, azimuth : (n,) float64
        rad.
    ionosphere_m : (n,) float64
        Delay of a code on 1575.42 MHz.
    troposphere_m : (n,) float64
    """

    epoch: I8
    sv: I2
    sat_pos_e: F8
    sat_vel_e: F8
    sat_clock_s: F8
    sat_drift: F8
    range_m: F8
    range_rate_mps: F8
    elevation: F8
    azimuth: F8
    ionosphere_m: F8
    troposphere_m: F8


@dataclass(frozen=True)
class RowTruth:
    """Terms of observations, row-aligned with `Observations`.

    Laws, with c = 299 792 458 m/s and lambda the wavelength::

        code  = range + c (receiver clock - satellite clock) + ionosphere + troposphere + group delay
                + intersystem + multipath + code noise + code fault
        phase = (range + c (oscillator - satellite clock) - ionosphere + troposphere
                + phase multipath + phase noise + phase fault) / lambda + ambiguity
        -lambda doppler = d code / dt without noise - ... : `rate_mps` + rate noise + rate fault
    """

    path: I8
    """Row in `PathTruth`."""
    ionosphere_m: F8
    group_delay_m: F8
    intersystem_m: F8
    multipath_m: F8
    phase_multipath_m: F8
    code_noise_m: F8
    phase_noise_m: F8
    rate_noise_mps: F8
    code_fault_m: F8
    phase_fault_m: F8
    rate_fault_mps: F8
    rate_mps: F8
    """True rate of the carrier's path against the receiver's clock: -lambda times the Doppler without errors."""
    ambiguity_cyc: F8


@dataclass(frozen=True)
class SimTruth:
    """What really happened.

    Attributes
    ----------
    t_ns : (n_epochs,) int64
        Receiver time tags, GPST ns (those of the observations).
    clock_s, drift : (n_epochs,) float64
        Receiver clock: the signal was received at ``t - clock``; its rate, s/s.
    steered_s : (n_epochs,) float64
        Part of the clock that steering added: the carrier phase does not follow it.
    pos_e, vel_e : (n_epochs, 3) float64
        Antenna at the true time of reception, ECEF, m, m/s.
    acc_e : (n_epochs, 3) float64
        Acceleration of the body's origin, ECEF, m/s^2.
    euler : (n_epochs, 3) float64
        Roll, pitch, heading of the body, rad.
    paths : PathTruth
    rows : RowTruth
    visible : (n_epochs,) int32
        Satellites received.
    """

    t_ns: I8
    clock_s: F8
    drift: F8
    steered_s: F8
    pos_e: F8
    vel_e: F8
    acc_e: F8
    euler: F8
    paths: PathTruth
    rows: RowTruth
    visible: NDArray[np.int32]

    def reference(self) -> Truth:
        """Antenna positions by receiver time tag, for assessment."""
        return Truth(self.pos_e, self.t_ns, "simulation", self.vel_e)

    def epochs_to_polars(self) -> "pl.DataFrame":
        """A row per epoch: time, antenna, body, clock; degrees and metres."""
        import polars as pl

        llh = geodetic_from_ecef(self.pos_e)
        columns: dict[str, NDArray[np.generic]] = {"t_gpst_ns": self.t_ns}
        columns |= {"lat_deg": np.degrees(llh[:, 0]), "lon_deg": np.degrees(llh[:, 1]), "height_m": llh[:, 2]}
        for name, values in (("pos", self.pos_e), ("vel", self.vel_e), ("acc", self.acc_e)):
            unit = {"pos": "m", "vel": "mps", "acc": "mps2"}[name]
            columns |= {f"{name}_{axis}_{unit}": values[:, k] for k, axis in enumerate("xyz")}
        roll, pitch, heading = np.degrees(self.euler).T
        columns |= {"roll_deg": roll, "pitch_deg": pitch, "heading_deg": heading}
        columns |= {"clock_s": self.clock_s, "drift": self.drift, "steered_s": self.steered_s, "n_sat": self.visible}
        return pl.DataFrame(columns)

    def rows_to_polars(self, sig: I2) -> "pl.DataFrame":
        """A row per observation with every term by name.

        Parameters
        ----------
        sig : (n_rows,) int16
            Signals of the observations.
        """
        import polars as pl

        p, at = self.paths, self.rows.path
        svs, sv_at = np.unique(p.sv, return_inverse=True)
        sigs, sig_at = np.unique(sig, return_inverse=True)
        columns: dict[str, NDArray[np.generic] | pl.Series] = {
            "t_gpst_ns": self.t_ns[p.epoch[at]],
            "sv": pl.Series([sv_name(int(s)) for s in svs], dtype=pl.String).gather(sv_at[at]),
            "signal": pl.Series([signal_name(int(s)) for s in sigs], dtype=pl.String).gather(sig_at),
            "elevation_deg": np.degrees(p.elevation[at]),
            "azimuth_deg": np.degrees(p.azimuth[at]),
            "range_m": p.range_m[at],
            "range_rate_mps": p.range_rate_mps[at],
            "sat_clock_s": p.sat_clock_s[at],
            "troposphere_m": p.troposphere_m[at],
        }
        for name in (
            "ionosphere_m", "group_delay_m", "intersystem_m", "multipath_m", "phase_multipath_m", "code_noise_m",
            "phase_noise_m", "rate_noise_mps", "code_fault_m", "phase_fault_m", "rate_fault_mps", "ambiguity_cyc",
        ):  # fmt: skip
            columns[name] = getattr(self.rows, name)
        return pl.DataFrame(columns)
