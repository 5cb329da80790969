"""Entry of the command ``starwise``: errors become one line and an exit code."""

import os
import sys

BAD_INPUT = 2
"""Exit code: a file, an argument or a configuration that cannot be used."""
DEFECT = 1
"""Exit code: a fault of the program itself."""
INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells have it."""


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code.

    0: done. 2: bad input, one line on the error stream. 1: no epoch could be solved, or a defect of the program
    (with STARWISE_DEBUG=1 the traceback is shown). 130: interrupted.
    """
    given = sys.argv[1:] if arguments is None else arguments
    if given in (["--version"], ["-V"]):
        from starwise import __version__

        print(f"starwise {__version__}")  # noqa: T201 - without loading anything else
        return 0
    from starwise.errors import StarwiseError

    try:
        from starwise.cli import run

        code = run(given)
        sys.stdout.flush()
        return code
    except StarwiseError as error:
        _say(f"error: {error}")
        return BAD_INPUT
    except KeyboardInterrupt:
        _say("interrupted")
        return INTERRUPTED
    except BrokenPipeError:
        # The reader of our output has gone; keep the interpreter from complaining when it flushes at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except MemoryError:
        _say("error: out of memory; try fewer files, or --start, --end and --interval")
        return BAD_INPUT
    except Exception as error:
        if os.environ.get("STARWISE_DEBUG") == "1":
            raise
        text = " ".join(str(error).split())[:200]
        _say(
            f"error: a defect of the program ({type(error).__name__}: {text}); please report it with the output of "
            "the same command with STARWISE_DEBUG=1 set"
        )
        return DEFECT


def _say(text: str) -> None:
    sys.stderr.write(f"starwise: {text}\n")


if __name__ == "__main__":
    sys.exit(main())
