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
    device = hystmpc.SimulatedPlant(model.simulator)           # a simulated device, to try a controller on

Angles are degrees, tendon travel mm, pressure bar, time seconds; arrays are time-first. Every error that the package
raises on purpose is a `hystmpc.HystmpcError` whose text says what was got and what was expected.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hystmpc.ctrl.command import Command
    from hystmpc.ctrl.command import CommandLimits as Limits
    from hystmpc.ctrl.planner.tip_controller import TipController
    from hystmpc.gap.diagnosis import Diagnosis
    from hystmpc.models.effects.place import with_effect
    from hystmpc.models.operators.operator import Number, Operator
    from hystmpc.models.simulator import Simulator
    from hystmpc.sim.closed_loop import run_closed_loop
    from hystmpc.sim.plants.simulated import Effects, SimulatedPlant
    from hystmpc.tasks.check import check
    from hystmpc.tasks.device import commission, investigate
    from hystmpc.tasks.diagnose import diagnose
    from hystmpc.tasks.evaluate import Evaluation, evaluate
    from hystmpc.tasks.export import export, export_c, export_fmu
    from hystmpc.tasks.fit import Fit, fit
    from hystmpc.tasks.inputs import load_model
    from hystmpc.tasks.report import report
    from hystmpc.tasks.simulate import build_controller, reproduce, simulate, sweep, tune
    from hystmpc.trajectories.point_to_point import PointToPoint
    from hystmpc.trajectories.scan import SinusoidScan, TriangleScan
    from hystmpc.trials.csv_files import write_csv
    from hystmpc.trials.errors import HystmpcError
    from hystmpc.trials.read import read_trials
    from hystmpc.trials.trial import Trial

    __version__: str

__all__ = [
    "Command",
    "Diagnosis",
    "Effects",
    "Evaluation",
    "Fit",
    "HystmpcError",
    "Limits",
    "Number",
    "Operator",
    "PointToPoint",
    "SimulatedPlant",
    "Simulator",
    "SinusoidScan",
    "TipController",
    "Trial",
    "TriangleScan",
    "__version__",
    "build_controller",
    "check",
    "commission",
    "diagnose",
    "evaluate",
    "export",
    "export_c",
    "export_fmu",
    "fit",
    "investigate",
    "load_model",
    "read_trials",
    "report",
    "reproduce",
    "run_closed_loop",
    "simulate",
    "sweep",
    "tune",
    "with_effect",
    "write_csv",
]

if not TYPE_CHECKING:  # a type checker knows the names above and no others
    from hystmpc.trials import lazily

    _named = lazily(
        __name__,
        ("hystmpc.ctrl.command", "Command Limits=CommandLimits"),
        ("hystmpc.ctrl.planner.tip_controller", "TipController"),
        ("hystmpc.gap.diagnosis", "Diagnosis"),
        ("hystmpc.models.effects.place", "with_effect"),
        ("hystmpc.models.operators.operator", "Number Operator"),
        ("hystmpc.models.simulator", "Simulator"),
        ("hystmpc.sim.closed_loop", "run_closed_loop"),
        ("hystmpc.sim.plants.simulated", "Effects SimulatedPlant"),
        ("hystmpc.tasks.check", "check"),
        ("hystmpc.tasks.device", "commission investigate"),
        ("hystmpc.tasks.diagnose", "diagnose"),
        ("hystmpc.tasks.evaluate", "Evaluation evaluate"),
        ("hystmpc.tasks.export", "export export_c export_fmu"),
        ("hystmpc.tasks.fit", "Fit fit"),
        ("hystmpc.tasks.inputs", "load_model"),
        ("hystmpc.tasks.report", "report"),
        ("hystmpc.tasks.simulate", "build_controller reproduce simulate sweep tune"),
        ("hystmpc.trajectories.point_to_point", "PointToPoint"),
        ("hystmpc.trajectories.scan", "SinusoidScan TriangleScan"),
        ("hystmpc.trials.csv_files", "write_csv"),
        ("hystmpc.trials.errors", "HystmpcError"),
        ("hystmpc.trials.read", "read_trials"),
        ("hystmpc.trials.trial", "Trial"),
    )

    def __getattr__(name: str) -> object:
        if name == "__version__":
            from importlib.metadata import version

            return version("hystmpc")
        value = _named(name)
        if getattr(value, "__module__", "").startswith("hystmpc.tasks.") and not isinstance(value, type):
            from hystmpc.trials.errors import in_a_line

            value = globals()[name] = in_a_line(value)  # an argument of a wrong type is refused in a line, too
        return value


def __dir__() -> list[str]:
    return __all__
