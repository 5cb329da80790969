"""The coloured filter once more, as a textbook has it: named states, dense matrices, all formulas written anew.

Satellites, clocks and motion enter and leave by name; the update is `starwise.estimators.s3ekf.update`.
"""

from __future__ import annotations

import numpy as np

from starwise.constants import C_LIGHT, OMEGA_E_GPS, WGS84_E2
from starwise.estimators import s3ekf
from starwise.frames import C_ne_enu, geodetic_from_ecef
from starwise.kernels.error_states import ErrorModel, ErrorRows
from starwise.kernels.rangemodel import Epochs, Rows
from starwise.models.maneuver import AxisMotion
from starwise.models.process import Clocks, Motion, matrices
from starwise.types import Layout, Linear, State

K = OMEGA_E_GPS / C_LIGHT
L1, EARTH, SHELL = 1575.42e6, 6371.0, 450.0


class Twin:
    """One filter; `step` takes an epoch."""

    def __init__(self, errors: ErrorModel, motion: Motion, clocks: Clocks, rate_sigma: float, sequential: bool):
        self.e, self.motion, self.clocks, self.rate_sigma = errors, motion, clocks, rate_sigma
        self.sequential = sequential
        self.state: State | None = None
        self.clock_seen: dict[int, int] = {}
        self.sat_seen: dict[int, int] = {}
        self.iono = 0.0  # modelled slant delay: none in these skies

    def start(self, t_ns: int, x0: np.ndarray, P0: np.ndarray, n_clocks: int) -> None:
        names = [*self.motion.names, *(f"clk.{k}" for k in range(n_clocks)), *(f"drift.{k}" for k in range(n_clocks))]
        sky = ["trop", "iono.v", "iono.n", "iono.e", "slope.1", "slope.2", *(f"bias.{b}" for b in range(self.e.n_bias))]
        base = State(t_ns, Layout(tuple(names)), np.array(x0, float), np.array(P0, float))
        self.state = base.moved_to(Layout((*names, *sky)), dict.fromkeys(sky, (0.0, 1.0)))
        self.clock_seen = dict.fromkeys(range(n_clocks), t_ns)

    def taus(self, name: str, speed: float) -> float:
        e, kind = self.e, name.split(".")[0]
        if kind in ("slope", "bias"):
            return np.inf
        if kind == "mp1" or kind == "mp2":
            return 1.0 / (1.0 / e.multipath_tau + speed / e.multipath_length)
        if name in ("iono.v", "iono.n", "iono.e"):
            return e.vertical_tau
        return {"trop": e.troposphere_tau, "slow": e.slow_tau, "iono": e.ionosphere_tau, "sig1": e.signal_tau,
                "sig2": e.signal_tau}[kind]  # fmt: skip

    def predict(self, t_ns: int) -> None:
        s = self.before = self.state
        dt = (t_ns - s.t_ns) * 1e-9
        active = [k for k in sorted(self.clock_seen) if f"clk.{k}" in s.layout]
        Phi1, mean, Q1 = self.motion_matrices(dt, len(active), s.x)
        names = [*self.motion.names, *(f"clk.{k}" for k in active), *(f"drift.{k}" for k in active)]
        at = s.layout.indices(names)
        n = len(s.layout)
        Phi, Q = np.zeros((n, n)), np.zeros((n, n))
        Phi[np.ix_(at, at)], Q[np.ix_(at, at)] = Phi1, Q1
        x = s.x.copy()
        x[at] = mean @ s.x[at]
        speed = 0.0
        if self.motion.nk > 3:
            v = s.layout.indices(["vel.x", "vel.y", "vel.z"])
            noise = (Phi @ s.P @ Phi.T + Q)[v, v]  # an estimate at rest is not at rest
            speed = float(np.sqrt(max(x[v] @ x[v] - noise.sum(), 0.0)))
        for i, name in enumerate(s.layout.names):
            if i not in at:
                Phi[i, i] = np.exp(-dt / self.taus(name, speed))
                Q[i, i] = 1.0 - Phi[i, i] ** 2
        moved = x[at]
        x = Phi @ s.x
        x[at] = moved
        self.state = State(t_ns, s.layout, x, Phi @ s.P @ Phi.T + Q)

    def motion_matrices(self, dt: float, n_clocks: int, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Phi of the covariance, Phi of the state and Q, motion and clocks."""
        up = x[:3] / [1.0, 1.0, 1.0 - WGS84_E2]
        up /= np.linalg.norm(up)
        Phi, Q = matrices(self.motion, self.clocks, n_clocks, dt, up)
        mean = Phi.copy()
        if self.motion.model == "current":
            east = np.cross([0.0, 0.0, 1.0], up)
            C = np.stack([east / np.linalg.norm(east), np.cross(up, east / np.linalg.norm(east)), up])
            _, Phi_1, G = AxisMotion("current", 1.0, self.motion.tau_s).matrices(dt)
            most = np.sqrt(np.array([self.motion.horizontal] * 2 + [self.motion.vertical]) * np.pi / (4.0 - np.pi))
            room = np.maximum(1.0 - np.abs(C @ x[6:9]) / most, 0.1)
            M = C.T @ np.diag((4.0 - np.pi) / np.pi * (most * room) ** 2) @ C
            mean[:9, :9], Q[:9, :9] = np.kron(Phi_1, np.eye(3)), np.kron(G, M)
        return Phi, mean, Q

    def before_update(self, everything) -> None:
        """What happens between the prediction and the first row: nothing."""

    def take_clocks(self, present: set[int], options: dict[str, float]) -> None:
        """Systems absent for long leave; those that appear start as the best known clock plus a wide offset."""
        s = self.state
        keep = [k for k in self.clock_seen if k in present or (s.t_ns - self.clock_seen[k]) * 1e-9 <= options["absent"]]
        fresh = sorted(present - set(keep))
        gone = [k for k in self.clock_seen if k not in keep]
        names = [n for n in s.layout.names if n not in [f"{a}.{k}" for k in gone for a in ("clk", "drift")]]
        s = s.moved_to(Layout(tuple(names)))
        self.clock_seen = {k: self.clock_seen[k] for k in keep}
        for k in fresh:
            ref = min(keep, key=lambda j: s.P[s.layout.index(f"clk.{j}"), s.layout.index(f"clk.{j}")])
            n = len(s.layout)
            T = np.zeros((n + 2, n))
            T[:n] = np.eye(n)
            T[n, s.layout.index(f"clk.{ref}")] = T[n + 1, s.layout.index(f"drift.{ref}")] = 1.0
            extra = np.zeros(n + 2)
            extra[n:] = options["intersystem"] ** 2, options["intersystem_drift"] ** 2
            s = State(
                s.t_ns, Layout((*s.layout.names, f"clk.{k}", f"drift.{k}")), T @ s.x, T @ s.P @ T.T + np.diag(extra)
            )
            self.clock_seen[k] = s.t_ns
        self.state = s

    def take_satellites(self, present: list[int]) -> None:
        s = self.state
        gone = {f".{v}" for v, t in self.sat_seen.items() if (s.t_ns - t) * 1e-9 > self.e.absent_s}
        kinds = ["slow", "iono", "sig1"]
        kinds += ["sig2"] if self.e.dual else []
        kinds += ["mp1"] if self.e.multipath else []
        kinds += ["mp2"] if self.e.multipath and self.e.dual else []
        of_sat = tuple(f"{k}." for k in kinds)
        names = [
            n for n in s.layout.names if not (n.startswith(of_sat) and n[n.index(".") :] in gone and n[-1].isdigit())
        ]
        new = [f"{k}.{v}" for v in present for k in kinds if f"{k}.{v}" not in names]
        # In two steps: a satellite that returns is not the one that was forgotten.
        s = s.moved_to(Layout(tuple(names)))
        self.state = s.moved_to(Layout((*names, *new)), dict.fromkeys(new, (0.0, 1.0)))
        self.sat_seen = {v: t for v, t in self.sat_seen.items() if f".{v}" not in gone}
        self.sat_seen.update(dict.fromkeys(present, s.t_ns))

    def code_row(self, rows: Rows, x: ErrorRows, i: int, second: bool, el: float, az: float) -> tuple[dict, float]:
        """Coefficients of the error states by name, and the variance of white noise."""
        e, s, v = self.e, max(np.sin(el), 0.05), int(x.sv[i])  # 3 deg: nothing grows below
        f, cn0 = (x.freq2_hz[i], x.cn02_dbhz[i]) if second else (rows.freq_hz[i], rows.cn0_dbhz[i])
        M = 1.0 / np.sqrt(1.0 - (EARTH / (EARTH + SHELL) * np.cos(el)) ** 2)
        g = (L1 / f) ** 2
        psi = np.pi / 2.0 - el - np.arcsin(EARTH / (EARTH + SHELL) * np.cos(el))
        h = {f"slow.{v}": x.slow_m[i], "trop": e.troposphere / (s + 0.02)}
        vertical = np.hypot(e.vertical_fraction * self.iono / M, e.vertical_floor)
        if self.iono == 0.0:
            vertical = max(vertical, 5.0)
        gradient = np.hypot(e.gradient_fraction * self.iono / M, e.gradient_floor) * psi * EARTH / 1000.0
        h[f"iono.{v}"] = g * np.hypot(e.ionosphere_fraction * self.iono, e.ionosphere_floor * M)
        h["iono.v"], h["iono.n"], h["iono.e"] = (
            g * M * vertical,
            g * M * gradient * np.cos(az),
            g * M * gradient * np.sin(az),
        )
        h["slope.1" if f > 1.4e9 else "slope.2"] = e.slope * (1.0 / max(s, 0.1) - 1.5)
        bias = x.bias2[i] if second else x.bias1[i]
        if bias >= 0:
            h[f"bias.{bias}"] = e.receiver_bias
        h[f"{'sig2' if second else 'sig1'}.{v}"] = e.signal_bias[rows.system[i]]
        weak = e.weak_sigma * 10.0 ** ((e.weak_cn0 - cn0) / e.weak_decade)
        white = e.code_white[rows.system[i]] ** 2 * (0.5 * 10.0 ** (max(45.0 - cn0, 0.0) / 10.0) + 0.5 / s**2)
        white += (1.0 - e.weak_share) * weak**2
        multipath = np.sqrt((e.multipath_sigma[rows.system[i]] / s) ** 2 + e.weak_share * weak**2)
        if e.multipath:
            h[f"{'mp2' if second else 'mp1'}.{v}"] = multipath
        else:
            white += multipath**2
        return h, white

    def rows_of(self, state: State, rows: Rows, x: ErrorRows, i: int, el: float, az: float) -> Linear:
        """Both codes and the rate of row i at a belief."""
        e, names, n = self.e, state.layout, len(state.layout)
        p = state.x[:3]
        w = state.x[3:6] if self.motion.nk > 3 else np.zeros(3)
        sat, sv = rows.sat_pos[i], rows.sat_vel[i]
        rho = np.linalg.norm(sat - p)
        u = (sat - p) / rho
        k = rows.clock[i]
        grad = -u + K * np.array([-sat[1], sat[0], 0.0])
        model = rho + K * (sat[0] * p[1] - sat[1] * p[0]) + state.x[names.index(f"clk.{k}")]
        v, H, r = [], [], []
        for second, code, clock in ((False, rows.code_m[i], rows.clock_m[i]), (True, x.code2_m[i], x.clock2_m[i])):
            if second and not (e.dual and np.isfinite(code)):
                continue
            h, white = self.code_row(rows, x, i, second, el, az)
            row = np.zeros(n)
            row[:3], row[names.index(f"clk.{k}")] = grad, 1.0
            for name, value in h.items():
                row[names.index(name)] = value
            v.append(code - (model - clock) - sum(value * state.x[names.index(name)] for name, value in h.items()))
            H.append(row)
            r.append(white)
        if np.isfinite(rows.rate_mps[i]):
            rel = sv - w
            rate = u @ rel + K * (sv[0] * p[1] + sat[0] * w[1] - sv[1] * p[0] - sat[1] * w[0])
            row = np.zeros(n)
            row[:3] = ((u @ rel) * u - rel) / rho + K * np.array([-sv[1], sv[0], 0.0])
            if self.motion.nk > 3:
                row[3:6] = grad
            row[names.index(f"drift.{k}")] = 1.0
            weak = e.weak_sigma * 10.0 ** ((e.weak_cn0 - rows.cn0_dbhz[i]) / e.weak_decade)
            speed2 = min(float(self.speed @ self.speed), 40.0**2)
            v.append(rows.rate_mps[i] - (rate + state.x[names.index(f"drift.{k}")] - rows.drift_mps[i]))
            H.append(row)
            r.append(self.rate_sigma**2 + speed2 * (e.rate_motion**2 + (e.rate_weak * weak) ** 2))
        return Linear(np.array(v), np.array(H), np.array(r), np.full(len(v), i))

    def step(self, t_ns: int, rows: Rows, x: ErrorRows, index: list[int], options: dict[str, float]) -> float:
        """Take the rows of an epoch; NIS."""
        if t_ns != self.state.t_ns:
            self.predict(t_ns)
        if not index:
            return 0.0
        self.take_clocks({int(rows.clock[i]) for i in index}, options)
        self.take_satellites([int(x.sv[i]) for i in index])
        for i in index:
            self.clock_seen[int(rows.clock[i])] = t_ns
        s = self.state
        self.speed = s.x[3:6] if self.motion.nk > 3 else np.zeros(3)
        lat, lon, _ = geodetic_from_ecef(s.x[:3])
        d = rows.sat_pos[index] - s.x[:3]
        enu = d @ C_ne_enu(lat, lon).T / np.linalg.norm(d, axis=1)[:, None]
        el, az = np.arcsin(enu[:, 2]), np.arctan2(enu[:, 0], enu[:, 1])

        def one(state: State, j: int) -> Linear:
            return self.rows_of(state, rows, x, index[j], el[j], az[j])

        def everything(state: State, _: int) -> Linear:
            parts = [one(state, j) for j in range(len(index))]
            return Linear(*(np.concatenate([getattr(p, a) for p in parts]) for a in ("v", "H", "r", "row")))

        self.before_update(everything)
        s = self.state
        if self.sequential:
            self.state, info = s3ekf.update(s, one, range(len(index)))
        else:
            self.state, info = s3ekf.update(s, everything, [0])
        return info.nis

    def run(self, epochs: Epochs, rows: Rows, x: ErrorRows, options: dict[str, float]):
        """Positions, their covariances and NIS of all epochs."""
        pos, cov, clocks, nis = [], [], [], []
        for e, t in enumerate(epochs.t_ns):
            nis.append(self.step(int(t), rows, x, list(range(epochs.offsets[e], epochs.offsets[e + 1])), options))
            pos.append(self.state.x[:3].copy())
            cov.append(self.state.P[:3, :3].copy())
            found = {k: self.state.layout.index(f"clk.{k}") for k in self.clock_seen}
            clocks.append({k: (self.state.x[i], self.state.P[i, i]) for k, i in found.items()})
        return np.array(pos), np.array(cov), clocks, np.array(nis)
