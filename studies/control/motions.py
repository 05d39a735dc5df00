"""The motions of the closed-loop benchmark, from a plant's own rest."""

from __future__ import annotations

from typing import Any

from hystmpc.trials.errors import ConfigError, did_you_mean

POINT_TO_POINT = "point_to_point"
RANDOM = "random_ruckig"
SCANS_HZ = {"scan_0p1hz": 0.1, "scan_0p25hz": 0.25, "scan_0p5hz": 0.5}
MOTIONS = (POINT_TO_POINT, *SCANS_HZ, RANDOM)

# Between 46 and 78 deg, which every plant reaches.
_TARGETS_DEG = (60.0, 48.0, 75.0, 70.0, 62.0, 66.0)
_HOLD_S = 3.0  # its last half is longer than any controller's preview
_RANGE_DEG = (47.0, 77.0)
_MOVES = 6
_CENTRE_DEG, _AMPLITUDE_DEG = 62.0, 15.0
_SCAN_S = 12.0  # about; whole cycles, at least two
_LIMITS = {"velocity_deg_s": 30.0, "acceleration_deg_s2": 200.0, "jerk_deg_s3": 3000.0}


def motion(name: str, rest_deg: float, seed: int, quick: bool = False) -> dict[str, Any]:
    """Settings of a motion, as in a simulation file.

    Args:
        name: one of `MOTIONS`.
        rest_deg: angle at which the plant rests at first [deg].
        seed: of the random one.
        quick: a short one.

    Raises:
        ConfigError: on an unknown motion.
    """
    if name == POINT_TO_POINT:
        targets = _TARGETS_DEG[:2] if quick else _TARGETS_DEG
        holds = (_HOLD_S,) * len(targets)
        return {"kind": name, "start_deg": rest_deg, "targets_deg": targets, "holds_s": holds, "limits": _LIMITS}
    if name in SCANS_HZ:
        frequency = SCANS_HZ[name]
        return {
            "kind": "scan_sinusoid",
            "start_deg": rest_deg,
            "centre_deg": _CENTRE_DEG,
            "amplitude_deg": _AMPLITUDE_DEG,
            "frequency_hz": frequency,
            "cycles": 1.0 if quick else max(2.0, float(round(_SCAN_S * frequency))),
        }
    if name == RANDOM:
        return {
            "kind": "random_point_to_point",
            "seed": seed,
            "start_deg": rest_deg,
            "range_deg": _RANGE_DEG,
            "moves": 2 if quick else _MOVES,
            "hold_range_s": (1.0, 3.0),
            "limits": _LIMITS,
        }
    raise ConfigError(f"no motion {name!r}, {did_you_mean(name, MOTIONS)}")
