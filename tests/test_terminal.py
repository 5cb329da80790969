"""What people see while they wait: one line, its parts, and no more than 80 columns."""

import io
import re
from types import SimpleNamespace

import pytest

from starwise.__main__ import main
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
    # units that were found done go at a rate of their own
    assert pace.after("900 of 1000 found", 0.9, 11.0) == ""
    assert pace.after("901 of 1000 units, 3 failed", 0.901, 20.0) == ""
    assert pace.after("903 of 1000 units, 3 failed", 0.903, 30.0) == "0.2 units/s, 8:05 left"
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


def test_a_long_line_costs_the_bar_not_the_words(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = Terminal()
    monkeypatch.setattr("sys.stderr", screen)
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TERM", "xterm")
    clock = iter([0.0, 1000.0])
    monkeypatch.setattr("starwise.terminal.time", SimpleNamespace(monotonic=lambda: next(clock)))
    progress = Progress(False)
    with progress as say:
        say("0 of 3650 units", 0.0)
        say("1250 of 3650 units, 12 failed", 1250 / 3650)
        progress._bar.refresh()
    shown = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", screen.getvalue())
    assert "1250 of 3650 units, 12 failed" in shown
    assert "1.2 units/s, 32:00 left" in shown


def test_silence_where_nobody_watches(capsys: pytest.CaptureFixture[str]) -> None:
    with Progress(False) as say:
        say("reading", 0.1)
    assert capsys.readouterr() == ("", "")


def test_why_nothing_was_solved_and_what_may_help() -> None:
    from starwise.constants import ROW_STATUS_NAMES
    from starwise.report.text import _WHAT_TO_DO, unsolved_text

    assert set(_WHAT_TO_DO) <= set(ROW_STATUS_NAMES)
    text = unsolved_text({"rows_refused": {"no_ephemeris": 3, "ephemeris_too_old": 40}})
    assert text == (
        "no epoch could be solved; rows: 40 ephemeris_too_old, 3 no_ephemeris; "
        "are the navigation files of these hours and systems?"
    )
    assert "nothing to solve" in unsolved_text({})


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        (["solve", "a.obs", "b.nav"], "Missing option '--output' / '-o'. (see starwise solve --help)"),
        (["solve", "a.obs", "-o", "x", "--mehtod", "lsq"], "--method"),
        (["slove"], "Did you mean 'solve'?"),
    ],
)
def test_usage_errors_say_where_to_look(arguments: list[str], wanted: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    said = capsys.readouterr().err
    assert wanted in said
    assert said.count("\n") == 1
