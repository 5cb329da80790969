"""What commands show: text, one JSON object, or a progress bar where somebody watches."""

import json
import sys
from collections.abc import Callable
from typing import Annotated, Any

import typer

from starwise.errors import StarwiseError

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]
NoReport = Annotated[bool, typer.Option("--no-report", help="Leave out report.html.")]


class Progress:
    """Progress bar on the error stream if that is a terminal, else silence.

    A line there says that kernels are compiled, terminal or not, unless ``quiet``: a minute without a word looks like
    a fault.
    """

    def __init__(self, silent: bool, quiet: bool = False) -> None:
        self._quiet = quiet
        self._bar: Any = None
        if not silent and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
            from rich.progress import Progress as Bar

            columns = (TextColumn("{task.description:12}"), BarColumn(), TimeElapsedColumn())
            self._bar = Bar(*columns, console=Console(stderr=True), transient=True)
            self._task = self._bar.add_task("", total=1.0)

    def __enter__(self) -> Callable[[str, float], None]:
        if self._bar is not None:
            self._bar.start()
        return self._say

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def _say(self, what: str, fraction: float) -> None:
        if what == "compiling" and not self._quiet:
            from starwise.warmup import ABOUT_S

            line = f"starwise: compiling kernels once, about {ABOUT_S} s"
            if self._bar is None:
                sys.stderr.write(line + "\n")
                sys.stderr.flush()
            else:
                self._bar.console.print(line, highlight=False)
        if self._bar is not None:
            self._bar.update(self._task, description=what, completed=fraction)


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
