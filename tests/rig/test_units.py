"""Every unit of the wire by its own number: what goes out and comes back is right both ways, or wrong both ways."""

from __future__ import annotations

import math

import pytest

from hystmpc.rig.transports.transport import Conversion, WireUnits
from hystmpc.trials.errors import ConfigError


@pytest.mark.parametrize(
    ("wire", "run", "raw"),
    [("mm", "mm", 2.0), ("m", "mm", 2e-3), ("bar", "bar", 2.0), ("kPa", "bar", 200.0), ("Pa", "bar", 2e5)],
)
def test_a_command_of_two_is_this_number_on_the_wire(wire: str, run: str, raw: float) -> None:
    conversion = Conversion.of(WireUnits.parse({"command_unit": wire}), run)
    assert conversion.raw_command(2.0) == pytest.approx(raw, rel=1e-12)
    assert conversion.command(raw) == pytest.approx(2.0, rel=1e-12)


@pytest.mark.parametrize(
    ("unit", "sign", "offset", "degrees"),
    [("deg", 1, 0.0, 0.5), ("deg", -1, 0.0, -0.5), ("deg", -1, 3.0, 2.5), ("rad", 1, 3.0, 3.0 + 90.0 / math.pi)],
)
def test_a_raw_angle_of_one_half_is_this_in_degrees(unit: str, sign: int, offset: float, degrees: float) -> None:
    """A sign that is lost turns feedback into a runaway."""
    settings = {"angle_unit": unit, "angle_sign": sign, "angle_offset_deg": offset}
    conversion = Conversion.of(WireUnits.parse(settings), "mm")
    assert conversion.angle_deg(0.5) == pytest.approx(degrees, rel=1e-12)
    assert conversion.raw_angle(degrees) == pytest.approx(0.5, rel=1e-12)


@pytest.mark.parametrize(("wire", "run"), [("bar", "mm"), ("Pa", "mm"), ("mm", "bar"), ("m", "bar")])
def test_pressure_never_passes_for_travel(wire: str, run: str) -> None:
    with pytest.raises(ConfigError, match=f"got command_unit {wire}, expected a unit of the run's {run}"):
        Conversion.of(WireUnits.parse({"command_unit": wire}), run)
