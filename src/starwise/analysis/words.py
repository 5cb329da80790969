"""Paragraphs of limited width."""

import textwrap
from collections.abc import Sequence
from typing import Final

WIDTH: Final = 79


def paragraph(parts: Sequence[str]) -> str:
    """Sentences as lines of up to `WIDTH` columns, each part from a line of its own."""
    return "\n".join(textwrap.fill(part, WIDTH, break_long_words=False) for part in parts)
