"""Fixtures shared by all tests."""

import json
import os
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]


def shared_data_path() -> Path | None:
    """Folder of real measurements beside the project, or where STARWISE_SHARED_DATA points; None if absent."""
    path = Path(os.environ.get("STARWISE_SHARED_DATA", ROOT.parent / "shared" / "data"))
    return path if (path / "truth.json").is_file() else None


@pytest.fixture(scope="session")
def shared_data() -> Path:
    path = shared_data_path()
    if path is None:
        pytest.skip("real measurements are not here (../shared/data or $STARWISE_SHARED_DATA)")
    return path


@pytest.fixture(scope="session")
def truth(shared_data: Path) -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads((shared_data / "truth.json").read_text())
    return loaded
