"""Help of every command: readable at 80 columns, with examples that the command takes."""

import shlex

import pytest
import typer
from typer.testing import CliRunner

from starwise.cli import app
from starwise.cli_examples import EXAMPLES
from starwise.sim.scenario import shipped

GROUP = typer.main.get_command(app)
COMMANDS = sorted(GROUP.commands)  # type: ignore[attr-defined]


def help_of(*command: str) -> str:
    result = CliRunner().invoke(app, [*command, "--help"], env={"COLUMNS": "80", "TERM": "dumb", "NO_COLOR": "1"})
    assert result.exit_code == 0
    return result.output


def test_every_command_has_an_example_and_no_example_is_of_another() -> None:
    assert set(EXAMPLES) >= set(COMMANDS)
    for name, lines in EXAMPLES.items():
        assert all(line.split()[:2] == ["starwise", name] for line in lines)


@pytest.mark.parametrize("command", COMMANDS)
def test_readable_at_80_columns(command: str) -> None:
    text = help_of(command)
    assert max(map(len, text.splitlines())) <= 80
    assert "…" not in text  # nothing is cut off
    for line in EXAMPLES[command]:
        assert f" {line} " in text or f" {line}\n" in text  # in one piece


@pytest.mark.parametrize(
    "line", [line for name, lines in EXAMPLES.items() if name in COMMANDS for line in lines], ids=str
)
def test_examples_are_taken(line: str) -> None:
    """Options and arguments are those of the command; nothing is run."""
    _, name, *arguments = shlex.split(line)
    context = GROUP.commands[name].make_context(name, arguments)  # type: ignore[attr-defined]
    assert context.command.name == name


def test_the_first_screen_says_how_to_begin() -> None:
    text = help_of()
    assert max(map(len, text.splitlines())) <= 80
    assert "starwise demo" in text
    assert "starwise solve rover.obs brdc.nav -o out" in text


def test_scenarios_of_the_package_are_named() -> None:
    text = " ".join(word for word in help_of("simulate").split() if word != "│")
    assert all(name in text for name in shipped())
