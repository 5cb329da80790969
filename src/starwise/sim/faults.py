"""What faults of a scenario do to satellite observations; each row's share is kept in the truth."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from starwise.constants import C_LIGHT, SYSTEMS
from starwise.errors import StarwiseError
from starwise.signals import signal_id, signal_name, sv_id, sv_name
from starwise.sim.sections import Fault
from starwise.types import F8, I2

SPOOF_DB = 3.0
"""A spoofed signal is stronger by this."""


@dataclass(frozen=True)
class FaultTerms:
    """What faults add to rows, all (n,)."""

    code_m: F8
    phase_m: F8
    rate_mps: F8
    cn0_db: F8
    slip: NDArray[np.bool_]
    """Rows at which the receiver says that lock was lost."""
    code_sigma_m: F8
    rate_sigma_mps: F8
    phase_sigma_m: F8
    """White noise of bursts."""


def gnss_faults(faults: Sequence[Fault]) -> list[Fault]:
    """Those of the satellite receiver."""
    return [fault for fault in faults if fault.sensor == "gnss"]


def concerned(fault: Fault, sv: I2, sig: I2 | None = None) -> NDArray[np.bool_]:
    """Rows (satellite, signal) that a fault acts on."""
    hit = np.ones(len(sv), dtype=bool)
    if fault.satellites:
        letters = [SYSTEMS.index(s) for s in fault.satellites if len(s) == 1]
        svs = [sv_id(s) for s in fault.satellites if len(s) > 1]
        hit = np.isin(sv, svs) | np.isin(sv >> 8, letters)
    if fault.signals and sig is not None:
        hit &= np.isin(sig, [signal_id(s) for s in fault.signals])
    return np.asarray(hit)


def check_faults(faults: Sequence[Fault], sv: I2, sig: I2, duration_s: float) -> None:
    """Check that every fault can act.

    Raises
    ------
    StarwiseError
        A fault names a satellite, system or signal that is not simulated, or starts after the end.
    """
    known = {sv_name(int(s)) for s in sv} | {SYSTEMS[int(s) >> 8] for s in sv}
    signals = {signal_name(int(s)) for s in np.unique(sig)}
    for fault in gnss_faults(faults):
        for name in fault.satellites:
            plain = name if len(name) == 1 else sv_name(sv_id(name))
            if plain not in known:
                raise StarwiseError(f"'faults' {fault.kind} names what is not in the sky", found=name)
        for name in fault.signals:
            if name not in signals:
                raise StarwiseError(
                    f"'faults' {fault.kind} names a signal that is not received",
                    found=name,
                    wanted=" ".join(sorted(signals)),
                )
        if fault.start_s > duration_s:
            raise StarwiseError(
                f"'faults' {fault.kind} starts after the end",
                found=f"{fault.start_s:g} s",
                wanted=f"at most {duration_s:g} s",
            )


def outages(faults: Sequence[Fault], t_s: F8, sv: I2, sig: I2 | None = None) -> NDArray[np.bool_]:
    """Rows (time since the start, satellite and, if given, signal) of which nothing is received.

    Without signals only outages of whole satellites count; with them, only those of single signals.
    """
    out = np.zeros(len(sv), dtype=bool)
    for fault in gnss_faults(faults):
        if fault.kind == "outage" and bool(fault.signals) == (sig is not None):
            out |= fault.active(t_s) & concerned(fault, sv, sig)
    return out


def clock_jumps_s(faults: Sequence[Fault], t_s: F8) -> F8:
    """What jumps add to the receiver clock at times since the start, s."""
    out = np.zeros(len(t_s))
    for fault in gnss_faults(faults):
        if fault.kind == "clock_jump":
            out += np.where(t_s >= fault.start_s, fault.size / C_LIGHT, 0.0)
    return out


def fault_terms(faults: Sequence[Fault], t_s: F8, sv: I2, sig: I2, wavelength_m: F8) -> FaultTerms:
    """What faults add to rows.

    Parameters
    ----------
    faults : sequence of Fault
    t_s : (n,) float64
        Time of each row since the start of the scenario, s, not decreasing.
    sv, sig : (n,) int16
    wavelength_m : (n,) float64
    """
    n = len(t_s)
    sums = {name: np.zeros(n) for name in ("code", "phase", "rate")}
    variance = {name: np.zeros(n) for name in ("code", "phase", "rate")}
    cn0 = np.zeros(n)
    slip = np.zeros(n, dtype=bool)
    for fault in gnss_faults(faults):
        hit = concerned(fault, sv, sig)
        on = hit & fault.active(t_s)
        since = t_s - fault.start_s
        targets = ("code", "phase", "rate") if fault.observable == "all" else (fault.observable,)
        if fault.kind == "step":
            for name in targets:
                # a constant error of position of the whole signal leaves its rate alone
                if not (name == "rate" and fault.observable == "all"):
                    sums[name][on] += fault.size
        elif fault.kind == "ramp":
            for name in targets:
                grown = fault.size if name == "rate" and fault.observable == "all" else fault.size * since[on]
                sums[name][on] += grown
        elif fault.kind == "spoof":
            sums["code"][on] += fault.size * since[on]
            sums["phase"][on] += fault.size * since[on]
            sums["rate"][on] += fault.size
            cn0[on] += SPOOF_DB
        elif fault.kind == "cycle_slip":
            after = hit & (since >= 0.0)
            sums["phase"][after] += fault.size * wavelength_m[after]
            slip |= _first(after, sv, sig)
        elif fault.kind == "burst":
            for name in targets:
                variance[name][on] += fault.size**2
    sigma = {name: np.sqrt(values) for name, values in variance.items()}
    return FaultTerms(
        sums["code"], sums["phase"], sums["rate"], cn0, slip, sigma["code"], sigma["rate"], sigma["phase"]
    )


def _first(on: NDArray[np.bool_], sv: I2, sig: I2) -> NDArray[np.bool_]:
    """First row of each (satellite, signal) where ``on`` holds; rows are in order of time."""
    out = np.zeros(len(on), dtype=bool)
    rows = np.flatnonzero(on)
    _, first = np.unique(sv[rows].astype(np.int64) << 16 | sig[rows].astype(np.int64), return_index=True)
    out[rows[first]] = True
    return out
