"""Blocks of code in the documentation, and a reader who types them in, from top to bottom, in a folder of their own."""

import contextlib
import io
import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
FENCE = re.compile(r"^(?P<indent> *)```(?P<info>[^\n`]*)\n(?P<text>.*?)^(?P=indent)```", re.MULTILINE | re.DOTALL)
MARK = re.compile(r"<!-- no-run: (\S.*?) -->\n$")
RUN = ("python", "sh", "toml")
SHOWN = ("text", "json")
"""Languages of blocks that are output, not input."""


@dataclass(frozen=True)
class Block:
    """One block: where it stands, its language, its text, and why it is not run, if it says so."""

    line: int
    language: str
    text: str
    excuse: str


def documents() -> list[Path]:
    """README, CONTRIBUTING and everything of the site."""
    return [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]


def blocks(document: Path) -> list[Block]:
    """Fenced blocks of a document in order."""
    text = document.read_text(encoding="utf-8")
    found = []
    for match in FENCE.finditer(text):
        mark = MARK.search(text[: match.start()])
        line = text.count("\n", 0, match.start()) + 1
        found.append(Block(line, match["info"].strip(), match["text"], mark[1] if mark else ""))
    return found


def commands_outside_fences(document: Path) -> list[str]:
    """Indented lines that look like something to type; a reader would type them, and no test would."""
    outside = FENCE.sub("", document.read_text(encoding="utf-8"))
    return re.findall(r"^ {4,}((?:starwise|python|pip|make|cd|git) .*)$", outside, re.MULTILINE)


class Reader:
    """Types the blocks of one document in: shell blocks in a shell, Python blocks in one session, TOML into files.

    A TOML block whose first line is ``# name.toml`` is saved under that name.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.names: dict[str, Any] = {"__name__": "__main__"}
        program = folder.parent / f"{folder.name}-bin"
        program.mkdir()
        for name, arguments in (("starwise", " -m starwise"), ("python", "")):
            (program / name).write_text(f'#!/bin/sh\nexec "{sys.executable}"{arguments} "$@"\n')
            (program / name).chmod(0o755)
        path = os.pathsep.join([str(program), os.environ["PATH"]])
        self.environment = {**os.environ, "PATH": path, "COLUMNS": "80", "STARWISE_NO_WARMUP": "1"}

    def read(self, block: Block) -> str:
        """Run one block; what it printed."""
        if block.language == "sh":
            return self.shell(block.text)
        if block.language == "python":
            return self.python(block)
        return self.toml(block.text)

    def shell(self, text: str) -> str:
        """Run commands, stop at the first that fails; nothing printed is wider than 80 columns."""
        command = ["sh", "-e", "-c", text]
        done = subprocess.run(
            command, cwd=self.folder, env=self.environment, capture_output=True, text=True, timeout=300
        )
        assert done.returncode == 0, f"{text}\n{done.stderr[-2000:]}"
        assert all(len(line) <= 80 for line in done.stdout.splitlines()), done.stdout
        return done.stdout

    def python(self, block: Block) -> str:
        """Run a block in the session of the document."""
        code = compile("\n" * block.line + block.text, "documentation", "exec")
        with contextlib.chdir(self.folder), contextlib.redirect_stdout(io.StringIO()) as said:
            exec(code, self.names)
        return said.getvalue()

    def toml(self, text: str) -> str:
        """Save a block as the file that it names, or only read it."""
        import tomllib

        tomllib.loads(text)
        name = re.match(r"# ([\w-]+\.toml)\n", text)
        if name is not None:
            (self.folder / name[1]).write_text(text, encoding="utf-8")
        return ""
