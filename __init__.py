"""Inverse-model model-predictive control for actuators with hysteresis.

Everything that a user calls is here, and nothing is imported before it is used:

    import hystmpc

    trials = hystmpc.read_trials("logs")                       # CSV, .mat, MCAP, ROS 2 bags, data frames
    print(hystmpc.check(trials[0]))                            # can it be used, and what is in it?
    model = hystmpc.fit("pi", trials)                          # identify a hysteresis model
    hystmpc.evaluate(model, trials).plot()                     # free run against the measurement
    hystmpc.export(model, "plant.onnx")                        # one stateful step, checked numerically
    hystmpc.simulate("examples/simulate_builtin.yaml")         # controllers in closed loop on a simulated device
    hystmpc.diagnose("logs", "plant.yaml")                     # where simulator and device disagree, and why
    hystmpc.TipController.from_config("examples/tip.yaml")     # the controller behind the calls of a planner

Angles are degrees, tendon travel mm, pressure bar, time seconds; arrays are time-first. Every error that the package
raises on purpose is a `hystmpc.HystmpcError` whose text says what was got and what was expected.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hystmpc.ctrl.command import CommandLimits as Limits
    from hystmpc.ctrl.planner.tip_controller import TipController
    from hystmpc.models.simulator import Simulator
    from hystmpc.trials.check import check
    from hystmpc.trials.errors import HystmpcError
    from hystmpc.trials.read import read_trials
    from hystmpc.trials.trial import Trial

    from .api import (
        Evaluation,
        Fit,
        build_controller,
        commission,
        diagnose,
        evaluate,
        export,
        fit,
        investigate,
        load_model,
        load_simulator,
        simulate,
        tune,
    )

    __version__: str

__all__ = [
    "Evaluation",
    "Fit",
    "HystmpcError",
    "Limits",
    "Simulator",
    "TipController",
    "Trial",
    "__version__",
    "build_controller",
    "check",
    "commission",
    "diagnose",
    "evaluate",
    "export",
    "fit",
    "investigate",
    "load_model",
    "load_simulator",
    "read_trials",
    "simulate",
    "tune",
]

if not TYPE_CHECKING:  # a type checker knows the names above and no others
    from hystmpc.trials import lazily

    _found = lazily(
        __name__,
        (
            "hystmpc.api",
            "Evaluation Fit build_controller commission diagnose evaluate export fit investigate load_model "
            "load_simulator simulate tune",
        ),
        ("hystmpc.ctrl.command", "Limits=CommandLimits"),
        ("hystmpc.ctrl.planner.tip_controller", "TipController"),
        ("hystmpc.models.simulator", "Simulator"),
        ("hystmpc.trials.check", "check"),
        ("hystmpc.trials.errors", "HystmpcError"),
        ("hystmpc.trials.read", "read_trials"),
        ("hystmpc.trials.trial", "Trial"),
    )

    def __getattr__(name: str) -> object:
        if name == "__version__":
            from importlib.metadata import version

            return version("hystmpc")
        return _found(name)


def __dir__() -> list[str]:
    return __all__
