"""Hand-made skies for tests: satellites on a sphere around a receiver, rows exact in the model or with noise."""

from __future__ import annotations

import numpy as np

from starwise.constants import C_LIGHT, N_SYSTEMS, OMEGA_E_GPS, ROW_USED
from starwise.frames import C_ne_enu, ecef_from_geodetic, geodetic_from_ecef
from starwise.kernels.rangemodel import Epochs, ModelOptions, Rows

RECEIVER = ecef_from_geodetic([np.radians(45.0), np.radians(8.0), 300.0])
T0 = 1_400_000_000 * 1_000_000_000  # ns, some time in 2024


def options(**changes: object) -> ModelOptions:
    """A model without atmosphere and with fixed noise, unless told otherwise."""
    base = ModelOptions(
        mask_rad=-1.0,
        cn0_min_dbhz=0.0,
        iono_model=np.zeros(N_SYSTEMS, dtype=np.int64),
        iono_coef=np.zeros((N_SYSTEMS, 8)),
        troposphere=0,
        code_sigma=np.full(N_SYSTEMS, 0.4),
        rate_sigma=0.1,
        fixed_code_sigma_m=1.0,
        fixed_rate_sigma_mps=0.1,
    )
    return base._replace(**changes)


def satellites(azimuth_deg: np.ndarray, elevation_deg: np.ndarray, receiver: np.ndarray = RECEIVER) -> np.ndarray:
    """ECEF positions (n, 3) at 26 560 km from the Earth's centre in given directions."""
    lat, lon, _ = geodetic_from_ecef(receiver)
    az, el = np.radians(azimuth_deg), np.radians(elevation_deg)
    enu = np.stack([np.cos(el) * np.sin(az), np.cos(el) * np.cos(az), np.sin(el)], axis=-1)
    u = enu @ C_ne_enu(lat, lon)
    b = u @ receiver
    return receiver + u * (-b + np.sqrt(b**2 - receiver @ receiver + 26_560e3**2))[:, None]


def sky(
    n: int,
    n_epochs: int = 1,
    *,
    seed: int = 0,
    systems: np.ndarray | None = None,
    clocks_m: np.ndarray | None = None,
    drift_mps: float = 0.0,
    velocity: np.ndarray | None = None,
    code_sigma: float = 0.0,
    rate_sigma: float = 0.0,
    step_s: float = 1.0,
    doppler: bool = True,
) -> tuple[Epochs, Rows, np.ndarray]:
    """n satellites for n_epochs, rows exact up to white noise; returns epochs, rows and true positions."""
    rng = np.random.default_rng(seed)
    systems = np.zeros(n, dtype=np.int64) if systems is None else systems
    _, clock = np.unique(systems, return_inverse=True)
    clocks_m = np.linspace(1e4, 2e4, clock.max() + 1) if clocks_m is None else clocks_m
    velocity = np.zeros(3) if velocity is None else velocity
    az = rng.uniform(0, 360, n)
    el = rng.uniform(10, 85, n)
    start = satellites(az, el)
    tangent = np.cross(start, rng.normal(size=(n, 3)))
    sat_v = 3900.0 * tangent / np.linalg.norm(tangent, axis=1)[:, None]
    blocks = []
    for e in range(n_epochs):
        t = e * step_s
        pos = RECEIVER + velocity * t
        sat = start + sat_v * t
        d = sat - pos
        rho = np.linalg.norm(d, axis=1)
        u = d / rho[:, None]
        k = OMEGA_E_GPS / C_LIGHT
        sagnac = k * (sat[:, 0] * pos[1] - sat[:, 1] * pos[0])
        sagnac_rate = k * (
            sat_v[:, 0] * pos[1] + sat[:, 0] * velocity[1] - sat_v[:, 1] * pos[0] - sat[:, 1] * velocity[0]
        )
        code = rho + sagnac + clocks_m[clock] + drift_mps * t + code_sigma * rng.normal(size=n)
        rate = (u * (sat_v - velocity)).sum(1) + sagnac_rate + drift_mps + rate_sigma * rng.normal(size=n)
        blocks.append((sat, sat_v, code, rate))
    m = n * n_epochs
    rows = Rows(
        sat_pos=np.concatenate([b[0] for b in blocks]),
        sat_vel=np.concatenate([b[1] for b in blocks]),
        clock_m=np.zeros(m),
        drift_mps=np.zeros(m),
        code_m=np.concatenate([b[2] for b in blocks]),
        rate_mps=np.concatenate([b[3] for b in blocks]) if doppler else np.full(m, np.nan),
        cn0_dbhz=np.full(m, 45.0),
        freq_hz=np.full(m, 1575.42e6),
        sigma_sat_m=np.zeros(m),
        noise_factor=np.ones(m),
        system=np.tile(systems, n_epochs),
        clock=np.tile(clock, n_epochs).astype(np.int64),
        status=np.full(m, ROW_USED, dtype=np.uint8),
    )
    t_ns = T0 + (np.arange(n_epochs) * step_s * 1e9).astype(np.int64)
    epochs = Epochs(t_ns, np.arange(0, m + 1, n, dtype=np.int64))
    return epochs, rows, RECEIVER + velocity * (np.arange(n_epochs) * step_s)[:, None]
