"""The one exception type for bad files and bad arguments."""

from pathlib import Path


class StarwiseError(Exception):
    """A file, an argument or a configuration that cannot be used.

    The message is one line that says where, what was found and what was wanted; the command line prints it
    and exits with code 2.

    Parameters
    ----------
    message : str
        What is wrong, in one line.
    file : path-like, optional
        The file concerned.
    line : int, optional
        Line number in the (decompressed) file, counted from 1.
    found, wanted : str, optional
        What stands there and what should.
    """

    def __init__(
        self,
        message: str,
        *,
        file: str | Path | None = None,
        line: int | None = None,
        found: str | None = None,
        wanted: str | None = None,
    ) -> None:
        self.message = message
        self.file = None if file is None else str(file)
        self.line = line
        self.found = found
        self.wanted = wanted
        super().__init__(self._one_line())

    def _one_line(self) -> str:
        where = "" if self.file is None else self.file
        if self.line is not None:
            where = f"{where}:{self.line}" if where else f"line {self.line}"
        text = f"{where}: {self.message}" if where else self.message
        if self.found is not None:
            text += f"; found {_printable(self.found)}"
        if self.wanted is not None:
            text += f"; wanted {self.wanted}"
        return " ".join(text.split())


def _printable(text: str) -> str:
    """Quote input text so that control characters and floods of bytes cannot reach a terminal."""
    shown = "".join(ch if ch.isprintable() else "?" for ch in text[:80])
    return f"'{shown}'" + (" ..." if len(text) > 80 else "")
