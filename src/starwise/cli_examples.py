"""An example or two for every command, shown below its help."""

from typing import Final

EXAMPLES: Final[dict[str, tuple[str, ...]]] = {
    "solve": (
        "starwise solve rover.obs brdc.nav -o out",
        "starwise solve rover.obs brdc.nav --dynamics vehicle --mask 15 -o out",
        "starwise solve rover.obs orbits.sp3 clocks.clk brdc.nav -o precise",
        "starwise solve rover.obs brdc.nav --imu imu.csv --imu-config imu.toml -o out",
    ),
    "assess": (
        "starwise assess out --truth 4627851.62,119640.35,4372993.71",
        "starwise assess out rtklib.pos --truth groundtruth.csv",
        "starwise assess monday=a.csv tuesday=b.csv --pool",
    ),
    "batch": ("starwise batch campaign/ -o results", "starwise batch units.toml -o results --workers 8"),
    "export": ("starwise export out -o track.gpx --geoid 48.5", "starwise export out --to kml -o track.kml"),
    "report": ("starwise report out",),
    "compare": ("starwise compare out rtklib.pos --truth groundtruth.csv -o compare.html",),
    "info": ("starwise info rover.obs brdc.nav",),
    "demo": ("starwise demo -o demo",),
    "warmup": ("starwise warmup",),
    "fuse": ("starwise fuse front.pos rear.nmea -o fused",),
    "simulate": (
        "starwise simulate urban-drive -o drive",
        "starwise simulate scenario.toml -o many --runs 1000 --method all",
    ),
    "reproduce": ("starwise reproduce s3ekf -o paper --runs 100",),
    "calibrate": ("starwise calibrate sets.toml -o errors.toml",),
}
"""Command lines by the name of the command."""


def epilog(command: str) -> str | None:
    """Text below the help of a command; None where there is no example.

    A blank line stands between the lines because the help joins lines that have none.
    """
    lines = EXAMPLES.get(command, ())
    if not lines:
        return None
    return "\n\n".join(["Examples:" if len(lines) > 1 else "Example:", *(line.replace("[", "\\[") for line in lines)])
