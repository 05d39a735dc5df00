"""Inverse-model model-predictive control for actuators with hysteresis.

All public functions are here and are imported on first use:

    import hystmpc

    trials = hystmpc.read_trials("logs")                       # CSV, .mat, MCAP, ROS 2 bags, data frames
    print(hystmpc.check(trials[0]))                            # can it be used, and what is in it?
    model = hystmpc.fit("pi", trials)                          # identify a hysteresis model
    hystmpc.evaluate(model, trials).plot()                     # free run against the measurement
    hystmpc.export(model, "plant.onnx")                        # one stateful step, checked numerically
    hystmpc.analyse("examples/tip.yaml")                       # margins and limit cycles before anything moves
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
    from hystmpc.ctrl.command import Command as Command
    from hystmpc.ctrl.command import CommandLimits
    from hystmpc.ctrl.planner.tip_controller import TipController as TipController
    from hystmpc.gap.diagnosis import Diagnosis as Diagnosis
    from hystmpc.models.effects.place import with_effect as with_effect
    from hystmpc.models.load import load_model as load_model
    from hystmpc.models.operators.operator import Number as Number
    from hystmpc.models.operators.operator import Operator as Operator
    from hystmpc.models.simulator import Simulator as Simulator
    from hystmpc.sim.plants.simulated import Effects as Effects
    from hystmpc.sim.plants.simulated import SimulatedPlant as SimulatedPlant
    from hystmpc.sim.study import run_closed_loop as run_closed_loop
    from hystmpc.tasks.analyse import analyse as analyse
    from hystmpc.tasks.check import check as check
    from hystmpc.tasks.device import commission as commission
    from hystmpc.tasks.device import investigate as investigate
    from hystmpc.tasks.diagnose import diagnose as diagnose
    from hystmpc.tasks.evaluate import Evaluation as Evaluation
    from hystmpc.tasks.evaluate import evaluate as evaluate
    from hystmpc.tasks.export import export as export
    from hystmpc.tasks.export import export_c as export_c
    from hystmpc.tasks.export import export_fmu as export_fmu
    from hystmpc.tasks.fit import Fit as Fit
    from hystmpc.tasks.fit import fit as fit
    from hystmpc.tasks.report import report as report
    from hystmpc.tasks.simulate import build_controller as build_controller
    from hystmpc.tasks.simulate import reproduce as reproduce
    from hystmpc.tasks.simulate import simulate as simulate
    from hystmpc.tasks.simulate import sweep as sweep
    from hystmpc.tasks.simulate import tune as tune
    from hystmpc.trajectories.point_to_point import PointToPoint as PointToPoint
    from hystmpc.trajectories.scan import SinusoidScan as SinusoidScan
    from hystmpc.trajectories.scan import TriangleScan as TriangleScan
    from hystmpc.trials.csv_files import write_csv as write_csv
    from hystmpc.trials.errors import HystmpcError as HystmpcError
    from hystmpc.trials.read import read_trials as read_trials
    from hystmpc.trials.trial import Trial as Trial

    Limits = CommandLimits
    __version__: str

if not TYPE_CHECKING:  # a type checker knows the names above and no others
    from hystmpc.trials import lazily

    _named = lazily(
        __name__,
        ("hystmpc.ctrl.command", "Command Limits=CommandLimits"),
        ("hystmpc.ctrl.planner.tip_controller", "TipController"),
        ("hystmpc.gap.diagnosis", "Diagnosis"),
        ("hystmpc.models.effects.place", "with_effect"),
        ("hystmpc.models.load", "load_model"),
        ("hystmpc.models.operators.operator", "Number Operator"),
        ("hystmpc.models.simulator", "Simulator"),
        ("hystmpc.sim.study", "run_closed_loop"),
        ("hystmpc.sim.plants.simulated", "Effects SimulatedPlant"),
        ("hystmpc.tasks.analyse", "analyse"),
        ("hystmpc.tasks.check", "check"),
        ("hystmpc.tasks.device", "commission investigate"),
        ("hystmpc.tasks.diagnose", "diagnose"),
        ("hystmpc.tasks.evaluate", "Evaluation evaluate"),
        ("hystmpc.tasks.export", "export export_c export_fmu"),
        ("hystmpc.tasks.fit", "Fit fit"),
        ("hystmpc.tasks.report", "report"),
        ("hystmpc.tasks.simulate", "build_controller reproduce simulate sweep tune"),
        ("hystmpc.trajectories.point_to_point", "PointToPoint"),
        ("hystmpc.trajectories.scan", "SinusoidScan TriangleScan"),
        ("hystmpc.trials.csv_files", "write_csv"),
        ("hystmpc.trials.errors", "HystmpcError"),
        ("hystmpc.trials.read", "read_trials"),
        ("hystmpc.trials.trial", "Trial"),
    )
    __all__ = [*_named.names, "__version__"]

    def __getattr__(name: str) -> object:
        if name == "__version__":
            from importlib.metadata import version

            return version("hystmpc")
        value = _named(name)
        home = getattr(value, "__module__", "")
        if home.startswith(("hystmpc.tasks.", "hystmpc.models.load")) and not isinstance(value, type):
            from hystmpc.trials.errors import in_a_line

            value = globals()[name] = in_a_line(value)  # an argument of a wrong type is refused in a line, too
        return value

    def __dir__() -> list[str]:
        return __all__
