"""Make the short drive of tests and warm-up: ten minutes under a sky of GPS, Galileo and BeiDou, all synthetic.

    python tools/make_demo.py [DIRECTORY]        default: src/starwise/demo/data

Written: RINEX 3.05 observations and navigation messages (gzip) and the truth (week, tow, lat, lon, height). Every
satellite, delay and error is made up here from the seed below; no measurement of anybody is used. The sky is computed
here on its own, so that the data do not depend on what they are used to show.
"""

import gzip
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

SEED = 20260320
C = 299_792_458.0
F = {"G": 1575.42e6, "E": 1575.42e6, "C": 1561.098e6}
MU = {"G": 3.986005e14, "E": 3.986004418e14, "C": 3.986004418e14}
OMEGA_E = {"G": 7.2921151467e-5, "E": 7.2921151467e-5, "C": 7.2921150e-5}
WEEK, TOE = 2410, 561_600.0  # 2026-03-21 12:00:00 GPST
EPOCHS, START = 600, TOE + 1200.0
BDT = 14.0
LAT0, LON0, H0 = np.radians(52.35), np.radians(5.25), 46.0
KLOBUCHAR = {
    "G": ([1.3970e-08, 2.2352e-08, -1.1921e-07, -1.1921e-07], [1.0854e05, 1.3107e05, -1.3107e05, -3.2768e05]),
    "C": ([1.4901e-08, 2.2352e-08, -1.1921e-07, -5.9605e-08], [1.1469e05, 9.8304e04, -1.3107e05, -2.6214e05]),
}
FAULTY, FAULT_FROM, FAULT_TO, FAULT_M = "G", 240, 360, 60.0
CANYON_FROM, CANYON_TO = 400, 450


@dataclass
class Satellite:
    """One satellite: its broadcast message (which is also its true orbit) and what the message does not know."""

    name: str
    elements: dict[str, float]
    tgd_s: float
    error_m: float  # orbit and clock error along the line of sight, the same for all of the drive
    iode: int

    @property
    def system(self) -> str:
        return self.name[0]


def make_sky(rng: np.random.Generator) -> list[Satellite]:
    """Three Walker-like constellations with slightly irregular orbits."""
    shells = (
        ("G", 26_559.8e3, 55.0, 6, 5, 8e-3, 1),
        ("E", 29_600.2e3, 56.0, 3, 8, 4e-4, 1),
        ("C", 27_906.1e3, 55.0, 3, 8, 8e-4, 19),
    )
    sky = []
    for system, a, inclination, planes, slots, e_max, first in shells:
        for k in range(planes * slots):
            plane, slot = divmod(k, slots)
            sky.append(
                Satellite(
                    name=f"{system}{first + k:02d}",
                    elements={
                        "af0": rng.normal(0, 2e-4),
                        "af1": rng.normal(0, 4e-12),
                        "sqrt_a": np.sqrt(a + rng.normal(0, 2e3)),
                        "e": rng.uniform(0.1, 1.0) * e_max,
                        "i0": np.radians(inclination + rng.normal(0, 0.5)),
                        "Omega0": wrap(2 * np.pi * plane / planes + rng.normal(0, 0.02) + 0.4),
                        "omega": rng.uniform(-np.pi, np.pi),
                        "M0": wrap(2 * np.pi * (slot / slots + plane / planes / slots * 1.5) + rng.normal(0, 0.05)),
                        "delta_n": rng.normal(4.5e-9, 3e-10),
                        "Omega_dot": rng.normal(-8.0e-9, 3e-10),
                        "idot": rng.normal(0, 2e-10),
                        "cuc": rng.normal(0, 3e-6),
                        "cus": rng.normal(8e-6, 2e-6),
                        "crc": rng.normal(200, 60),
                        "crs": rng.normal(0, 60),
                        "cic": rng.normal(0, 8e-8),
                        "cis": rng.normal(0, 8e-8),
                    },
                    tgd_s=rng.normal(0, 5e-9),
                    error_m=rng.normal(0, 0.6),
                    iode=int(rng.integers(1, 120)),
                )
            )
    for sat in sky:  # the argument of latitude, not of perigee, is what places satellites regularly
        sat.elements["M0"] = wrap(sat.elements["M0"] - sat.elements["omega"])
        sat.elements = {key: float(f"{value:.12E}") for key, value in sat.elements.items()}
        sat.tgd_s = float(f"{sat.tgd_s:.12E}")
    return sky


def wrap(angle: float) -> float:
    return float((angle + np.pi) % (2 * np.pi) - np.pi)


def orbit(sat: Satellite, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position in the Earth-fixed frame of time t, m, and clock offset with relativity, s (IS-GPS-200 table 20-IV)."""
    p, mu, omega_e = sat.elements, MU[sat.system], OMEGA_E[sat.system]
    tk = t - TOE
    a = p["sqrt_a"] ** 2
    m = p["M0"] + (np.sqrt(mu / a**3) + p["delta_n"]) * tk
    ecc = m
    for _ in range(12):
        ecc = m + p["e"] * np.sin(ecc)
    nu = np.arctan2(np.sqrt(1 - p["e"] ** 2) * np.sin(ecc), np.cos(ecc) - p["e"])
    phi = nu + p["omega"]
    s2, c2 = np.sin(2 * phi), np.cos(2 * phi)
    u = phi + p["cus"] * s2 + p["cuc"] * c2
    r = a * (1 - p["e"] * np.cos(ecc)) + p["crs"] * s2 + p["crc"] * c2
    i = p["i0"] + p["idot"] * tk + p["cis"] * s2 + p["cic"] * c2
    sow_toe = TOE - (BDT if sat.system == "C" else 0.0)
    node = p["Omega0"] + (p["Omega_dot"] - omega_e) * tk - omega_e * sow_toe
    x, y = r * np.cos(u), r * np.sin(u)
    pos = np.stack(
        [
            x * np.cos(node) - y * np.cos(i) * np.sin(node),
            x * np.sin(node) + y * np.cos(i) * np.cos(node),
            y * np.sin(i),
        ],
        axis=-1,
    )
    relativity = -2 * np.sqrt(mu) / C**2 * p["e"] * p["sqrt_a"] * np.sin(ecc)
    return pos, p["af0"] + p["af1"] * tk + relativity


def drive() -> np.ndarray:
    """East, north, up (m) every tenth of a second: rest, laps of a block with rounded corners, a stop, rest."""
    dt, n = 0.1, EPOCHS * 10 + 20
    t = np.arange(n) * dt
    target = np.where((t > 45) & (t < 270), 11.0, 0.0) + np.where((t > 300) & (t < 560), 13.0, 0.0)
    speed = np.zeros(n)
    for k in range(1, n):
        speed[k] = speed[k - 1] + np.clip(target[k] - speed[k - 1], -2.0 * dt, 1.5 * dt)
    s = np.cumsum(speed) * dt
    side, radius = 200.0, 60.0
    corner = radius * np.pi / 2
    lap = s % (4 * (side + corner))
    leg, along = np.divmod(lap, side + corner)
    heading = leg * np.pi / 2 + np.where(along > side, (along - side) / radius, 0.0)
    east, north = np.cumsum(speed * np.sin(heading)) * dt, np.cumsum(speed * np.cos(heading)) * dt
    return np.stack([east, north, 3.0 * np.sin(s / 180.0)], axis=1)


def ecef(lat: float, lon: float, h: float) -> np.ndarray:
    a, f = 6_378_137.0, 1 / 298.257223563
    e2 = f * (2 - f)
    n = a / np.sqrt(1 - e2 * np.sin(lat) ** 2)
    return np.array(
        [(n + h) * np.cos(lat) * np.cos(lon), (n + h) * np.cos(lat) * np.sin(lon), (n * (1 - e2) + h) * np.sin(lat)]
    )


def geodetic(pos: np.ndarray) -> np.ndarray:
    """Latitude, longitude (rad), height (m) by fixed point; enough iterations for 1e-10 m near the ground."""
    a, f = 6_378_137.0, 1 / 298.257223563
    e2 = f * (2 - f)
    rho = np.hypot(pos[:, 0], pos[:, 1])
    lat = np.arctan2(pos[:, 2], rho * (1 - e2))
    for _ in range(12):
        n = a / np.sqrt(1 - e2 * np.sin(lat) ** 2)
        lat = np.arctan2(pos[:, 2] + e2 * n * np.sin(lat), rho)
    h = rho * np.cos(lat) + pos[:, 2] * np.sin(lat) - a * np.sqrt(1 - e2 * np.sin(lat) ** 2)
    return np.stack([lat, np.arctan2(pos[:, 1], pos[:, 0]), h], axis=1)


def local_axes() -> np.ndarray:
    sl, cl, so, co = np.sin(LAT0), np.cos(LAT0), np.sin(LON0), np.cos(LON0)
    return np.array([[-so, co, 0], [-sl * co, -sl * so, cl], [cl * co, cl * so, sl]])


def klobuchar(alpha: list[float], beta: list[float], az: np.ndarray, el: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Delay on L1, m (IS-GPS-200 20.3.3.5.2.5)."""
    psi = 0.0137 / (el / np.pi + 0.11) - 0.022
    lat = np.clip(LAT0 / np.pi + psi * np.cos(az), -0.416, 0.416)
    lon = LON0 / np.pi + psi * np.sin(az) / np.cos(lat * np.pi)
    lat_m = lat + 0.064 * np.cos((lon - 1.617) * np.pi)
    local = (43_200 * lon + t) % 86_400
    slant = 1 + 16 * (0.53 - el / np.pi) ** 3
    amplitude = np.maximum(sum(a * lat_m**k for k, a in enumerate(alpha)), 0)
    period = np.maximum(sum(b * lat_m**k for k, b in enumerate(beta)), 72_000)
    x = 2 * np.pi * (local - 50_400) / period
    return C * slant * np.where(np.abs(x) < 1.57, 5e-9 + amplitude * (1 - x**2 / 2 + x**4 / 24), 5e-9)


def observe(sky: list[Satellite], rng: np.random.Generator) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Code (m), Doppler (Hz), C/N0 (dB-Hz) per satellite, NaN where not in view, and the true positions by epoch."""
    axes, origin = local_axes(), ecef(LAT0, LON0, H0)
    fine = origin + drive() @ axes
    rate_noise = np.cumsum(rng.normal(0, 0.05, len(fine)))  # oscillator: random walk of frequency, m/s
    clock = 60_000.0 + np.cumsum(25.0 + rate_noise) * 0.1  # m
    tags = START + np.arange(len(fine)) * 0.1
    true_time = tags - clock / C
    observed, faulty = {}, None
    for sat in sky:
        tau = np.full(len(tags), 0.075)
        for _ in range(6):
            pos, offset = orbit(sat, true_time - tau)
            angle = OMEGA_E[sat.system] * tau
            c, s = np.cos(angle), np.sin(angle)
            turned = np.stack([c * pos[:, 0] + s * pos[:, 1], -s * pos[:, 0] + c * pos[:, 1], pos[:, 2]], axis=1)
            los = turned - fine
            geometric = np.linalg.norm(los, axis=1)
            tau = geometric / C
        enu = los @ axes.T
        el, az = np.arcsin(enu[:, 2] / geometric), np.arctan2(enu[:, 0], enu[:, 1])
        alpha, beta = KLOBUCHAR["G"]
        # The true ionosphere is three quarters of what the broadcast model says, a little more to the south.
        iono = klobuchar(alpha, beta, az, el, true_time) * (1575.42e6 / F[sat.system]) ** 2 * (0.75 - 0.1 * np.cos(az))
        tropo = 2.40 / np.sqrt(1 - (np.cos(el) / 1.001) ** 2)
        smooth = geometric + clock - C * (offset - sat.tgd_s) + iono + tropo + sat.error_m
        rate = (smooth[11:] - smooth[9:-2])[: EPOCHS * 10 : 10] / 0.2
        at = slice(10, 10 + EPOCHS * 10, 10)
        el, az, smooth = el[at], az[at], smooth[at]
        k = np.arange(EPOCHS)
        noise = rng.normal(0, 0.25 + 0.2 / np.sin(np.maximum(el, 0.05)))
        multipath = markov(rng, EPOCHS, 0.4, 40.0) / np.maximum(np.sin(el), 0.15) ** 0.7
        visible = el > np.radians(5.0)
        canyon = (k >= CANYON_FROM) & (k < CANYON_TO)
        across = np.abs(np.sin(az))  # the street runs north: houses east and west
        visible &= ~(canyon & (np.tan(el) < 1.6 * across))
        code = smooth + noise + multipath + np.where(canyon, np.abs(rng.normal(0, 3.0, EPOCHS)), 0.0)
        if faulty is None and sat.system == FAULTY and visible[FAULT_FROM:FAULT_TO].all() and el[300] > np.radians(35):
            faulty = sat.name
            code[FAULT_FROM:FAULT_TO] += FAULT_M
        doppler = -(rate + rng.normal(0, 0.04, EPOCHS)) / (C / F[sat.system])
        cn0 = 33 + 17 * np.sin(np.maximum(el, 0.0)) ** 0.7 + rng.normal(0, 0.6, EPOCHS) - np.where(canyon, 5.0, 0.0)
        table = np.stack([code, doppler, np.round(cn0 * 4) / 4], axis=1)
        table[~visible] = np.nan
        if visible.any():
            observed[sat.name] = table
    print(f"fault of {FAULT_M:g} m on {faulty}, epochs {FAULT_FROM} to {FAULT_TO}")
    return observed, fine[10 : 10 + EPOCHS * 10 : 10]


def markov(rng: np.random.Generator, n: int, sigma: float, tau: float) -> np.ndarray:
    out, keep = np.empty(n), np.exp(-1 / tau)
    out[0] = rng.normal(0, sigma)
    for k in range(1, n):
        out[k] = keep * out[k - 1] + rng.normal(0, sigma * np.sqrt(1 - keep**2))
    return out


def head(content: str, label: str) -> str:
    return f"{content:<60}{label:<20}".rstrip() + "\n"


def calendar(tow: float) -> tuple[int, int, int, int, int, float]:
    day = np.datetime64("1980-01-06") + np.timedelta64(7 * WEEK + int(tow // 86_400), "D")
    y, mo, d = (int(v) for v in str(day).split("-"))
    left = tow % 86_400
    return y, mo, d, int(left // 3600), int(left % 3600 // 60), left % 60


def write_obs(path: Path, observed: dict[str, np.ndarray]) -> None:
    y, mo, d, h, mi, s = calendar(START)
    x0 = ecef(LAT0, LON0, H0)
    out = [
        head("     3.05           OBSERVATION DATA    M: MIXED", "RINEX VERSION / TYPE"),
        head("make_demo           starwise            20260321 000000 UTC", "PGM / RUN BY / DATE"),
        head("Synthetic: every value is made by tools/make_demo.py", "COMMENT"),
        head("DEMO", "MARKER NAME"),
        head("GROUND_CRAFT", "MARKER TYPE"),
        head("starwise            starwise", "OBSERVER / AGENCY"),
        head("0                   SIMULATED           1", "REC # / TYPE / VERS"),
        head("0                   SIMULATED", "ANT # / TYPE"),
        head("".join(f"{v:14.4f}" for v in np.round(x0 / 1000) * 1000), "APPROX POSITION XYZ"),
        head("".join(f"{0:14.4f}" for _ in range(3)), "ANTENNA: DELTA H/E/N"),
        head("G    3 C1C D1C S1C", "SYS / # / OBS TYPES"),
        head("E    3 C1C D1C S1C", "SYS / # / OBS TYPES"),
        head("C    3 C2I D2I S2I", "SYS / # / OBS TYPES"),
        head("     1.000", "INTERVAL"),
        head(f"{y:6d}{mo:6d}{d:6d}{h:6d}{mi:6d}{s:13.7f}     GPS", "TIME OF FIRST OBS"),
        head("", "END OF HEADER"),
    ]
    for k in range(EPOCHS):
        rows = [(name, table[k]) for name, table in observed.items() if np.isfinite(table[k, 0])]
        y, mo, d, h, mi, s = calendar(START + 1.0 + k)
        out.append(f"> {y:4d} {mo:02d} {d:02d} {h:02d} {mi:02d}{s:11.7f}  0{len(rows):3d}\n")
        out += [
            f"{name}{code:14.3f}  {doppler:14.3f}  {cn0:14.3f}".rstrip() + "\n" for name, (code, doppler, cn0) in rows
        ]
    save(path, "".join(out))


def write_nav(path: Path, sky: list[Satellite]) -> None:
    out = [
        head("     3.05           N: GNSS NAV DATA    M: MIXED", "RINEX VERSION / TYPE"),
        head("make_demo           starwise            20260321 000000 UTC", "PGM / RUN BY / DATE"),
        head("Synthetic: every value is made by tools/make_demo.py", "COMMENT"),
    ]
    for system, label in (("G", "GPS"), ("C", "BDS")):
        for letter, values in zip("AB", KLOBUCHAR[system], strict=True):
            out.append(head(f"{label}{letter} " + "".join(f"{v:12.4E}" for v in values), "IONOSPHERIC CORR"))
    out += [head("    18    18  1929     7", "LEAP SECONDS"), head("", "END OF HEADER")]
    for sat in sky:
        p, bds = sat.elements, sat.system == "C"
        sow = TOE - (BDT if bds else 0.0)
        y, mo, d, h, mi, s = calendar(sow)
        week = WEEK - (1356 if bds else 0)
        galileo = sat.system == "E"
        lines = [
            [p["af0"], p["af1"], 0.0],
            [sat.iode, p["crs"], p["delta_n"], p["M0"]],
            [p["cuc"], p["e"], p["cus"], p["sqrt_a"]],
            [sow, p["cic"], p["Omega0"], p["cis"]],
            [p["i0"], p["crc"], p["omega"], p["Omega_dot"]],
            [p["idot"], 517 if galileo else 0, week, 0],
            [3.12 if galileo else 2.0, 0, sat.tgd_s, sat.tgd_s if galileo else (0.0 if bds else sat.iode)],
            [sow - 600.0, 0 if galileo or bds else 4],
        ]
        first = f"{sat.name} {y:4d} {mo:02d} {d:02d} {h:02d} {mi:02d} {round(s):02d}"
        out.append(first + "".join(number(v) for v in lines[0]) + "\n")
        out += ["    " + "".join(number(v) for v in line) + "\n" for line in lines[1:]]
    save(path, "".join(out))


def number(value: float) -> str:
    return f"{value:19.12E}".replace("E", "D")


def write_truth(path: Path, pos: np.ndarray) -> None:
    llh = geodetic(pos)
    lines = ["week,tow_s,lat_deg,lon_deg,height_m"]
    for k, (lat, lon, h) in enumerate(llh):
        lines.append(f"{WEEK},{START + 1.0 + k:.1f},{np.degrees(lat):.9f},{np.degrees(lon):.9f},{h:.4f}")
    path.write_text("\n".join(lines) + "\n")


def save(path: Path, text: str) -> None:
    with open(path, "wb") as raw, gzip.GzipFile("", "wb", 9, raw, mtime=0) as file:
        file.write(text.encode("ascii"))


def main() -> None:
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "src/starwise/demo/data")
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(SEED)
    sky = make_sky(rng)
    observed, truth = observe(sky, rng)
    write_obs(folder / "demo_MO.rnx.gz", observed)
    write_nav(folder / "demo_MN.rnx.gz", [sat for sat in sky if sat.name in observed])
    write_truth(folder / "demo_truth.csv", truth)
    for path in sorted(folder.iterdir()):
        print(f"{path}: {path.stat().st_size} bytes")


if __name__ == "__main__":
    main()
