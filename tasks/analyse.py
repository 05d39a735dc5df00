"""Task of the analysis before the device moves: margins, limit cycles, settling of every controller."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hystmpc.trials.config import read_yaml
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.run_folder import RunFolder, require_vacant

from .inputs import Settings, allow_classes, settings_of

if TYPE_CHECKING:
    from hystmpc.ctrl.config import AnyControllerSettings
    from hystmpc.ctrl.linear.report import LoopsAnalysis


def analyse(
    config: Settings,
    out: Path | str | None = None,
    *,
    command: float | None = None,
    tolerance_deg: float | None = None,
    overrides: Iterable[str] = (),
    allow_python: bool = False,
) -> LoopsAnalysis:
    """Predict what every controller of a configuration will do around its model: margins, limit cycles, rest.

    The loop is linearised where all plays move. A limit cycle is that of the describing function of the hysteresis. The
    model is taken for the device: a device of another width, lag or delay has other margins.

    Args:
        config: settings of a `TipController`, or a study of a simulation: a YAML file or a mapping.
        out: run folder for the report, new or empty; without it nothing is written.
        command: operating point; the middle of the command's limits where left out.
        tolerance_deg: oscillation that a hold may have; `tolerance_deg` of a tip's file, or 0.5 deg.
        overrides: change a setting of the file: KEY.KEY=VALUE.
        allow_python: import classes that the file names as python: MODULE:CLASS; you trust it.

    Raises:
        HystmpcError: if a setting is wrong or a model cannot be used.
        ConfigError: if `out` is not empty, or the file is neither a tip's nor a study's.
    """
    from hystmpc.ctrl.command import limits_of_model, modelled_limits
    from hystmpc.ctrl.linear.report import TOLERANCE_DEG, loops_of
    from hystmpc.models.load import load_model, model_path

    allow_classes(allow_python)
    if out is not None:
        require_vacant(out)
    given, controllers, folder = _read(config, tuple(overrides))
    path = model_path(given.model, folder)
    model = load_model(path, "conditioned")
    limits = modelled_limits(given.limits, limits_of_model(model.metadata))
    wanted = getattr(given, "tolerance_deg", TOLERANCE_DEG) if tolerance_deg is None else tolerance_deg
    analysis = loops_of(
        model, given.model, controllers, limits, given.actuator_lag_s, command=command, tolerance_deg=wanted
    )
    if out is not None:
        run = RunFolder.create(Path(out), given, seed=0, models=(path,))
        run.write_report(analysis.report())
    return analysis


def _read(config: Settings, overrides: tuple[str, ...]) -> tuple[Any, Mapping[str, AnyControllerSettings], Path]:
    """Settings of a tip or of a study, controllers by name, folder of relative names."""
    from hystmpc.ctrl.planner.settings import TipSettings
    from hystmpc.sim.config import SimulationConfig

    data = read_yaml(config) if isinstance(config, Path | str) else config
    folder = Path(config).resolve().parent if isinstance(config, Path | str) else Path()
    if not isinstance(data, Mapping) or not {"controller", "controllers", "model"} & set(data):
        got = ", ".join(map(str, data)) if isinstance(data, Mapping) else type(data).__name__
        raise ConfigError(
            f"analyse: got {got or 'nothing'}, expected the keys of a tip (model, controller) or of a study "
            "(plant, model, motions, controllers)"
        )
    if "controllers" in data:
        study = settings_of(SimulationConfig, config, overrides)
        return study, study.controllers, folder
    tip = settings_of(TipSettings, config, overrides)
    return tip, {tip.controller.kind: tip.controller}, folder
