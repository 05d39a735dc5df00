"""The data set of S1: eight training groups and the tests (a) to (d), on the simulated muscle catheter."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from hystmpc.trajectories.excitation import (
    S1_ARBITRARY,
    S1_TRAIN_HZ,
    s1_raised_baseline,
    s1_test_a,
    s1_test_b,
    s1_test_c,
    s1_zero_baseline,
)
from hystmpc.trajectories.trajectory import Trajectory

from .excited import generator
from .muscle_recorder import MuscleRecorder
from .quantities import check_quantities, quantity


@dataclass(frozen=True)
class S1Settings:
    """What S1 leaves open, with our defaults.

    13.4 s at the 250 Hz of the laser give 8 x 3350 = 26 800 training samples; S1 has 26 798.

    Attributes:
        recorder: the bench.
        group_s: duration of a training group and of test (a) [s].
        chirp_s: duration of tests (b) and (c) [s].
        tau_c_per_s: decay of test (c) [1/s]; S1 prints 0.05 and calls the signal ascending, which is -0.05.

    Raises:
        ConfigError: if a number is out of its bounds.
    """

    recorder: MuscleRecorder = field(default_factory=MuscleRecorder)
    group_s: float = quantity(13.4, "s", 0.1, 1000.0, "duration of a training group and of test (a)")
    chirp_s: float = quantity(3.5, "s", 0.1, 20.0, "duration of tests (b) and (c)")
    tau_c_per_s: float = quantity(-0.05, "1/s", -1.0, 1.0, "decay of test (c)")

    def __post_init__(self) -> None:
        check_quantities(self)


def s1_motions(settings: S1Settings, seed: int) -> Mapping[str, Mapping[str, Trajectory]]:
    """Commands [bar] by split and by name of the trial; test (d) is a seeded ramp-hold stand-in, its shape is lost."""
    training: dict[str, Trajectory] = {}
    for kind, make in (("zero", s1_zero_baseline), ("raised", s1_raised_baseline)):
        for frequency in S1_TRAIN_HZ:
            name = f"train_{kind}_{f'{frequency:g}'.replace('.', 'p')}hz"
            training[name] = make(frequency, duration_s=settings.group_s)
    return {
        "train": training,
        "test_a": {"test_a": s1_test_a(settings.group_s)},
        "test_b": {"test_b": s1_test_b(settings.chirp_s)},
        "test_c": {"test_c": s1_test_c(settings.tau_c_per_s, settings.chirp_s)},
        "test_d": {"test_d": S1_ARBITRARY(generator(seed, "s1/test_d", "motion"))},
    }
