"""What commands show: text, one JSON object, or a progress bar where somebody watches."""

import json
import re
import sys
import time
from collections.abc import Callable
from typing import Annotated, Any

import typer

from starwise.errors import StarwiseError

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]
NoReport = Annotated[bool, typer.Option("--no-report", help="Leave out report.html.")]


class Progress:
    """Progress bar on the error stream if that is a terminal, else silence.

    It shows the part that is done, how fast that goes (in what is counted, where the text says "120 of 1000 runs",
    perhaps with more after a comma), and the time left. A line says that kernels are compiled, terminal or not, unless
    ``quiet``: a minute without a word looks like a fault.
    """

    def __init__(self, silent: bool, quiet: bool = False) -> None:
        self._quiet = quiet
        self._bar: Any = None
        self._pace = Pace()
        if not silent and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
            from rich.progress import Progress as Bar
            from rich.table import Column

            columns = (
                TextColumn("{task.description:12}"),
                BarColumn(bar_width=None, table_column=Column(ratio=1, min_width=4, max_width=20)),
                TextColumn("{task.fields[done]}"),
                TimeElapsedColumn(),
                TextColumn("{task.fields[pace]}"),
            )
            self._bar = Bar(*columns, console=Console(stderr=True), transient=True, expand=True)
            self._task = self._bar.add_task("", total=1.0, done="", pace="")

    def __enter__(self) -> Callable[[str, float], None]:
        if self._bar is not None:
            self._bar.start()
        return self._say

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def _say(self, what: str, fraction: float) -> None:
        compiling = what == "compiling"
        if compiling and not self._quiet:
            from starwise.warmup import ABOUT_S

            line = f"starwise: compiling kernels once, about {ABOUT_S} s"
            if self._bar is None:
                sys.stderr.write(line + "\n")
                sys.stderr.flush()
            else:
                self._bar.console.print(line, highlight=False)
        if self._bar is None:
            return
        pace = self._pace.after(what, fraction, time.monotonic())
        self._bar.update(
            self._task, description=what, total=None if compiling else 1.0, completed=fraction,
            done="" if compiling else f"{100.0 * fraction:3.0f} %", pace="" if compiling else pace,
        )  # fmt: skip


class Pace:
    """How fast something goes and how long it will still take, out of the fractions told so far."""

    def __init__(self) -> None:
        self._first: tuple[float, float] | None = None
        self._counted: tuple[str, int, float] | None = None

    def after(self, what: str, fraction: float, now_s: float) -> str:
        """Rate and time left in words, like ``37 runs/s, 0:12 left``; empty in the first second.

        Parameters
        ----------
        what : str
            What is being done; "120 of 1000 runs" is counted.
        fraction : float
            Part of the whole that is done, 0..1.
        now_s : float
            A clock, s.
        """
        if what == "compiling":
            self._first = self._counted = None  # no measure of what comes after
            return ""
        counted = re.fullmatch(r"(\d+) of \d+ (\w+)(?:, .*)?", what)
        other = counted is not None and self._counted is not None and counted[2] != self._counted[0]
        if self._first is None or other:  # other things go at another rate
            self._first = (fraction, now_s)
        gone, done = now_s - self._first[1], fraction - self._first[0]
        rate = f"{100.0 * done / gone:.0f} %/s" if gone > 0.0 else ""
        if counted is not None:
            number, unit = int(counted[1]), counted[2]
            if self._counted is None or self._counted[0] != unit:
                self._counted = (unit, number, now_s)
            since = now_s - self._counted[2]
            speed = (number - self._counted[1]) / since if since > 0.0 else 0.0
            rate = f"{speed:.0f} {unit}/s" if speed >= 10.0 else f"{speed:.2g} {unit}/s"
        if gone < 1.0 or done <= 0.0:
            return ""
        left = round(gone / done * (1.0 - fraction))
        return f"{rate}, {left // 60}:{left % 60:02d} left".removeprefix(", ")


def show(text: str) -> None:
    """Print text."""
    sys.stdout.write(text + "\n")


def show_json(value: Any) -> None:
    """Print one JSON object."""
    sys.stdout.write(json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False) + "\n")


def read_settings(pairs: list[str]) -> dict[str, Any]:
    """Values of ``--set KEY=VALUE``: TOML values, or plain text where that is no TOML."""
    import tomllib

    options: dict[str, Any] = {}
    for pair in pairs:
        key, equals, text = pair.partition("=")
        if not equals or not key.strip():
            raise StarwiseError("--set", found=pair, wanted="KEY=VALUE")
        try:
            options[key.strip()] = tomllib.loads(f"value = {text}")["value"]
        except tomllib.TOMLDecodeError:
            options[key.strip()] = text.strip()
    return options
