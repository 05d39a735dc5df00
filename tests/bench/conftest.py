"""What the tests of this folder share."""

from __future__ import annotations

import pytest

from .small_commission import make_quick


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """A commissioning of seconds."""
    make_quick(monkeypatch)
