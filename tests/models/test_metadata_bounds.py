"""Metadata that no device of the field has are refused at load, with the bound."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.models.contract.load import OnnxModel
from hystmpc.trials.errors import ModelError

from .test_contract_load import lag_model, refusal, saved, set_property

ABSURD = [
    ("dt_s", "1e12", r"dt_s: .* less than or equal to 100, got 1000000000000\.0"),
    ("dt_s", "1e-12", r"dt_s: .* or equal to 0\.00001, got 1e-12"),
    ("dt_s", "true", r"dt_s: expected a valid number, got True"),
    ("dt_s", "7" * 4000, r"dt_s: Input should be a valid number, got 777"),
    ("dt_s", "7" * 100_000, r"dt_s: got '7+', expected JSON"),
    ("warmup_samples", "1000000000000", r"warmup_samples: .* less than or equal to 1000000, got 1000000000000"),
    ("warmup_samples", "1e12", r"warmup_samples: .* less than or equal to 1000000, got 1000000000000\.0"),
    ("command_limits", '{"lower": 0, "upper": 1e300}', r"command_limits\.upper: .* less than or equal to 1000000000"),
    (
        "command_limits",
        '{"lower": -1e300, "upper": 1}',
        r"command_limits\.lower: .* greater than or equal to -1000000000",
    ),
    ("trained_angle", '{"lower": 0, "upper": 1e300}', r"trained_angle\.upper: .* less than or equal to 1000000000"),
    ("command_rate", "1e300", r"command_rate: .* less than or equal to 1000000000000, got 1e\+300"),
    (
        "command_rate",
        "1e-300",
        r"command_rate: .* or equal to 0\.000000001, got 1e-300",
    ),
    ("trained_rate", "1e300", r"trained_rate: .* less than or equal to 1000000000000"),
    ("initial", '{"offset": [1e300, 0], "slope": [0, 0]}', r"initial\.offset\.0: .* less than or equal to"),
    ("initial", '{"offset": [0, 0], "slope": [0, -1e300]}', r"initial\.slope\.1: .* greater than or equal to"),
    (
        "conditioned",
        f'{{"offset": [{"0," * 100_000}0], "slope": [0]}}',
        r"conditioned\.offset.* at most 100000 items",
    ),
    ("dt_s", "[" * 100_000, r"dt_s: got '\[+', expected JSON"),
]


@pytest.mark.parametrize(("key", "value", "text"), ABSURD)
def test_absurd_metadata_is_refused_with_the_bound(key: str, value: str, text: str, tmp_path: Path) -> None:
    proto = lag_model()
    set_property(proto, key, value)
    message = refusal(saved(proto, tmp_path))
    assert re.search(text, message), message
    assert len(message) < 500


BOUNDED = {
    "dt_s": (1e-5, 100.0),
    "command_rate": (1e-9, 1e12),
    "trained_rate": (1e-9, 1e12),
    "warmup_samples": (0, 1e6),
}


@given(st.sampled_from(sorted(BOUNDED)), st.floats(min_value=0.0, allow_infinity=False))
def test_a_number_is_taken_within_its_bounds_and_refused_beyond(key: str, value: float) -> None:
    proto, (low, high) = lag_model(), BOUNDED[key]
    number = round(value) if key == "warmup_samples" else value
    set_property(proto, key, repr(number))
    if low <= number <= high:
        assert getattr(OnnxModel(proto.SerializeToString()).metadata, key) == number
    else:
        with pytest.raises(ModelError, match=f"metadata: {key}: "):
            OnnxModel(proto.SerializeToString())
