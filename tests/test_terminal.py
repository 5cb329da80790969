"""What people see while they wait: one line, its parts, and no more than 80 columns."""

import io
import re
from types import SimpleNamespace

import pytest

from starwise.terminal import Pace, Progress


def test_rate_and_time_left() -> None:
    pace = Pace()
    assert pace.after("0 of 1000 runs", 0.0, 100.0) == ""
    assert pace.after("20 of 1000 runs", 0.02, 100.5) == ""  # nothing is known in the first second
    assert pace.after("200 of 1000 runs", 0.2, 105.0) == "40 runs/s, 0:20 left"
    assert pace.after("report", 0.6, 115.0) == "4 %/s, 0:10 left"
    assert pace.after("done", 1.0, 160.0).endswith(", 0:00 left")


def test_what_was_done_before_does_not_count() -> None:
    pace = Pace()
    pace.after("500 of 1000 runs", 0.5, 0.0)  # resumed
    assert pace.after("600 of 1000 runs", 0.6, 10.0) == "10 runs/s, 0:40 left"
    pace.after("compiling", 0.0, 10.0)
    assert pace.after("0 of 10 runs", 0.0, 60.0) == ""


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_one_line_of_80_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = Terminal()
    monkeypatch.setattr("sys.stderr", screen)
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TERM", "xterm")
    clock = iter([10.0, 12.0, 14.0])
    monkeypatch.setattr("starwise.terminal.time", SimpleNamespace(monotonic=lambda: next(clock)))
    progress = Progress(False)
    with progress as say:
        for done in (0, 123_456, 999_999):
            say(f"{done} of 1000000 runs", done / 1e6)
            progress._bar.refresh()
    lines = [re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", line) for line in re.split(r"[\r\n]", screen.getvalue())]
    assert any(re.search(r"12 % 0:00:\d\d 61728 runs/s, 0:14 left", line) for line in lines), lines
    assert max(map(len, lines)) <= 80


def test_silence_where_nobody_watches(capsys: pytest.CaptureFixture[str]) -> None:
    with Progress(False) as say:
        say("reading", 0.1)
    assert capsys.readouterr() == ("", "")
