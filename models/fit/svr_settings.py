"""Settings of the support-vector regression and its presets."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from pydantic import Field

from hystmpc.trials.config import Settings

Positive = Annotated[float, Field(gt=0)]
Count = Annotated[int, Field(ge=1)]


class SvrSettings(Settings):
    """How a support-vector regression is identified; see `SvrWeights` and `fit_svr`.

    Commands and angles are scaled so that the trained ranges become -1 to 1; `epsilon` is in the unit of that angle.

    Attributes:
        preset: name in reports.
        lags: commands in a window.
        stride: samples between them; 50 commands every 5 samples are 10 s at 25 Hz, a period of the slowest motions.
        c, gamma, epsilon: values that are compared; one of each is no comparison.
        folds: parts of the comparison.
        by_trial: leave whole trials out in the comparison; else samples drawn at random, as S1 supposedly did.
            Neighbouring windows are nearly the same, so that random folds know what they are judged on.
        compared_samples: greatest number of samples in the comparison, drawn at random.
        samples: greatest number of samples that the final model is fitted to, drawn at random.
        cache_mb: kernel cache of libsvm [MB].
        seed: of the draws.
    """

    preset: str = "best"
    lags: Annotated[int, Field(ge=2)] = 50
    stride: Count = 5
    c: tuple[Positive, ...] = Field(default=(1.0, 10.0, 100.0), min_length=1)
    gamma: tuple[Positive, ...] = Field(default=(0.0003, 0.001, 0.003), min_length=1)
    epsilon: tuple[Positive, ...] = Field(default=(0.05,), min_length=1)
    folds: Annotated[int, Field(ge=2)] = 6
    by_trial: bool = True
    compared_samples: Annotated[int, Field(ge=50)] = 1500
    samples: Annotated[int, Field(ge=50)] = 10_000
    cache_mb: Count = 400
    seed: int = 1


SVR_PRESETS: Mapping[str, SvrSettings] = {
    "best": SvrSettings(),
    # S1: the values found by its grid search
    "paper": SvrSettings(preset="paper", stride=1, c=(10.0,), gamma=(0.1,), epsilon=(0.1,), samples=100_000),
    # S1: the grid search itself
    "grid": SvrSettings(
        preset="grid",
        stride=1,
        c=(0.001, 0.01, 0.1, 1.0, 10.0),
        gamma=(0.001, 0.01, 0.1, 1.0),
        epsilon=(0.1,),
        folds=10,
        by_trial=False,
        samples=100_000,
    ),
}
