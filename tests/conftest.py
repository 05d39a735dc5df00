"""Shared fixtures: where the real logs lie, a seed, a private kernel cache."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


def data_folder() -> Path:
    """Folder of recorded trials: HYSTMPC_DATA, else the one that lies beside the project."""
    return Path(os.environ.get("HYSTMPC_DATA", ROOT.parent / "shared" / "data"))


REAL_LOGS = sorted((data_folder() / "catheter_tendon").glob("*.csv"))


@pytest.fixture(scope="session")
def real_logs() -> list[Path]:
    """The six logs of the tendon catheter; skips where they are absent (they carry no licence to be shipped)."""
    if not REAL_LOGS:
        pytest.skip(f"recorded trials are absent: no *.csv in {data_folder() / 'catheter_tendon'}")
    return REAL_LOGS
