"""JSON of results: what it knows, and hashes that stay the same from version to version."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from hystmpc.trials.errors import ConfigError
from hystmpc.trials.json_text import canonical, file_hash, file_text, json_hash, plain, text_hash

# Printed by `printf '{"a": 1, "b": [0.1, null]}' | sha256sum`: old run folders go on only while this stays.
KNOWN = "cf6b050c7e09793189be1313d4707461aac084a7c1c4041796571e3d6d2c8f4f"


def test_plain_data_has_only_what_json_knows() -> None:
    made = plain({1: np.float64(0.5), "b": (np.arange(2), [math.nan, -math.inf]), "c": {"d": np.bool_(True)}})
    assert made == {"1": 0.5, "b": [[0, 1], [None, None]], "c": {"d": True}}
    assert json.loads(file_text(made)) == made
    with pytest.raises(ValueError, match="not JSON compliant"):
        file_text({"a": math.nan})


def test_equal_data_have_equal_texts_and_known_hashes(tmp_path: Path) -> None:
    assert canonical({"b": [0.1, None], "a": 1}) == '{"a": 1, "b": [0.1, null]}'
    assert json_hash({"b": [0.1, None], "a": 1}) == json_hash({"a": 1, "b": (0.1, None)}) == KNOWN
    assert json_hash({"a": Path("x")}, default=str) == json_hash({"a": "x"})
    (tmp_path / "model").write_text("ä", encoding="utf-8")
    assert file_hash(tmp_path / "model") == text_hash("ä")
    with pytest.raises(ConfigError, match=r"cannot be read .*expected a model file"):
        file_hash(tmp_path / "nowhere")
