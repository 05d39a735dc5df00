"""Simulators: a chain of operators in readable YAML, with limits, trained range and residuals; and their models."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, final

import casadi as ca
import numpy as np
from pydantic import Field

from hystmpc.trials.brief import in_brief
from hystmpc.trials.config import Settings, dump_yaml, read_yaml
from hystmpc.trials.errors import ConfigError, ModelError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.types import Vec

from .chain import Chain, chain_from, chain_spec
from .contract.export import ExportBundle, export_onnx
from .contract.metadata import (
    ModelMetadata,
    NoiseModel,
    Range,
    Rate,
    SampleTime,
    Start,
    rest_within,
    slow_error,
)
from .model import NO_INPUTS, LoadedModel, StepFunction
from .motions import probe_commands
from .operators.operator import Operator
from .program import dense
from .rest import RestRule
from .stages import prepared

if TYPE_CHECKING:
    import onnx

    from .contract.export import EquivalenceReport


FORMAT = "hystmpc-simulator/1"


class Residual(Settings):
    """Residual of the simulator on one trial of its identification.

    Attributes:
        log: name of the log.
        motion: `holds` where the command rests for a fifth of the time or more, else `continuous`.
        samples: samples that counted.
        rmse_deg, bias_deg: of model minus measurement.
        lag_one: correlation of neighbouring residuals, near one where the error is structure, not noise.
        fingerprint: of the trial; empty in older files.
    """

    log: str
    motion: Literal["holds", "continuous"]
    samples: int = Field(ge=1)
    rmse_deg: float = Field(ge=0)
    bias_deg: float
    lag_one: float = Field(ge=-1, le=1)
    fingerprint: str = ""


class Identification(Settings):
    """Origin of the numbers of a simulator.

    Attributes:
        residuals: one for each trial.
        noise: noise model of the residuals, see `ModelMetadata.noise`.
        method: name of the identification.
        seed: of its random numbers.
        skip_first_flexure: whether each trial counted only from the first reversal of the command on.
        training_data_hash: of the trials.
    """

    method: str
    seed: int = 0
    skip_first_flexure: bool = False
    training_data_hash: str = ""
    residuals: tuple[Residual, ...] = ()
    noise: NoiseModel | None = None

    @property
    def slow_error(self) -> float | None:
        """Error of free runs on other motions, `NoiseModel.model_sigma_deg` from the table alone; None without trials.

        c_i = rho_i (rmse_i^2 - bias_i^2) + bias_i^2 with the correlation rho of neighbours, see `slow_error`.
        """
        rows = self.residuals
        squares = [row.lag_one * (row.rmse_deg**2 - row.bias_deg**2) + row.bias_deg**2 for row in rows]
        return slow_error(squares, [row.samples for row in rows]) if rows else None


class SimulatorFile(Settings):
    """Layout of the YAML file, bounds as in `ModelMetadata`; the operator catalogue reads the blocks of `chain`.

    Attributes:
        format: name and version of the layout, `hystmpc-simulator/1`.
        dt_s: sample time of the identification [s]; the operators hold at any.
        command_unit: mm or bar, or the unit of another device.
        command_limits: limits of the command sent to the device.
        command_rate_per_s: greatest change of the command per second.
        trained_command: range of the command in the identification trials.
        trained_angle_deg: range of the angle in the identification trials.
        trained_rate_per_s: greatest rate of the command in the identification trials.
        angle_unit: deg; an inverse map takes deg and gives mm or bar.
        inverse: whether it is an inverse map; null where one unit alone is deg and tells.
        rest_command: at which the device rests before a motion; null for the lower end of its command.
        chain: the operators: lists `before` and `after`, and one `core`.
        identification: method, data and residuals.
    """

    format: str
    dt_s: SampleTime
    command_unit: str = Field(min_length=1)
    angle_unit: str = "deg"
    inverse: bool | None = None
    rest_command: float | None = None
    command_limits: Range
    command_rate_per_s: Rate
    trained_command: Range
    trained_angle_deg: Range
    trained_rate_per_s: Rate
    chain: dict[Literal["before", "core", "after"], Any]
    identification: Identification


@dataclass(frozen=True)
class Simulator:
    """Chain of operators with sample time, units, limits, trained range and origin; attributes as of `SimulatorFile`.

    A delay whose store is too short at that sample time, as in a file written by hand, gets a longer one.
    """

    chain: Chain
    dt_s: float
    command_unit: str
    command_limits: Range
    command_rate_per_s: float
    trained_command: Range
    trained_angle_deg: Range
    trained_rate_per_s: float
    identification: Identification
    angle_unit: str = "deg"
    inverse: bool | None = None
    rest_command: float | None = None

    def __repr__(self) -> str:
        angle, command = self.trained_angle_deg, self.command_limits
        parts = " + ".join(operator.name for operator in self.chain.operators)
        ends = f"{command.lower:.4g} to {command.upper:.4g} {self.command_unit}"
        seen = f"{angle.lower:.4g} to {angle.upper:.4g} {self.angle_unit}"
        return in_brief(self, f"{ends}, {seen}, every {self.dt_s:.4g} s: {parts}")

    def __post_init__(self) -> None:
        object.__setattr__(self, "chain", self.chain.with_room(self.dt_s))

    def at_sample_time(self, dt_s: float) -> Simulator:
        """Simulator at sample time `dt_s` [s], see `Chain.at_sample_time`."""
        return replace(self, chain=self.chain.at_sample_time(dt_s, self.dt_s), dt_s=dt_s)

    @property
    def rests_at(self) -> float:
        """Command at which the device rests before a motion, see `rest_within`."""
        return rest_within(self.rest_command, self.command_limits.lower, self.command_limits.upper)

    def save(self, path: Path | str) -> Path:
        """Write the simulator file (`.yaml`), whole or not at all."""
        return save_simulator(self, path)

    def to_control(self, name: str = "device") -> Any:
        """System of python-control in discrete time, see `LoadedModel.to_control`."""
        return ChainModel(self).to_control(name)

    def metadata(self) -> ModelMetadata:
        """Metadata of the model contract; a fresh and a conditioned device start by the same rule.

        Raises:
            ModelError: if a fact is out of its bounds.
        """
        noise, slow = self.identification.noise, self.identification.slow_error
        unsaid = slow is not None and (noise is None or noise.model_sigma_deg is None)
        rest = self.rests_at
        rests = ((0.0, rest), (1.0, rest), (0.0, rest + 1.0))
        at = [np.asarray(self.chain.rest(y, u, self.chain.values)).ravel() for y, u in rests]
        rule = {
            "offset": at[0].tolist(),
            "slope": (at[1] - at[0]).tolist(),
            "by_command": (at[2] - at[0]).tolist(),
            "at_command": rest,
        }
        single = not self.chain.before and not self.chain.after
        return ModelMetadata.of(
            kind=self.chain.core.name if single else "chain",
            dt_s=self.dt_s,
            command_unit=self.command_unit,
            angle_unit=self.angle_unit,
            inverse=self.inverse,
            command_limits=self.command_limits,
            command_rate=self.command_rate_per_s,
            trained_command=self.trained_command,
            trained_angle=self.trained_angle_deg,
            trained_rate=self.trained_rate_per_s,
            initial=rule,
            conditioned=rule,
            warmup_samples=self.chain.settling_samples,
            training_data_hash=self.identification.training_data_hash,
            training={
                "method": self.identification.method,
                "seed": self.identification.seed,
                **({"model_sigma_deg": slow} if unsaid else {}),
            },
            noise=noise,
            rest_command=self.rest_command,
            chain=chain_spec(self.chain),
        )


def simulator_for(chain: Chain, facts: ModelMetadata, method: str) -> Simulator:
    """Simulator of a chain with the sample time, units, limits and ranges of another model."""
    return Simulator(
        chain=chain,
        dt_s=facts.dt_s,
        command_unit=facts.command_unit,
        angle_unit=facts.angle_unit,
        inverse=facts.inverse,
        rest_command=facts.rest_command,
        command_limits=facts.command_limits,
        command_rate_per_s=facts.command_rate,
        trained_command=facts.trained_command,
        trained_angle_deg=facts.trained_angle,
        trained_rate_per_s=facts.trained_rate,
        identification=Identification(method=method),
    )


def save_simulator(simulator: Simulator, path: Path | str) -> Path:
    """Write a simulator file, whole or not at all."""
    return write_atomically(path, dump_yaml(simulator_spec(simulator)))


def simulator_spec(simulator: Simulator) -> dict[str, Any]:
    """Plain data of a simulator file, from which `simulator_from` builds it again."""
    held = {name: getattr(simulator, name) for name in SimulatorFile.model_fields if name not in ("format", "chain")}
    file = SimulatorFile.model_construct(format=FORMAT, chain=chain_spec(simulator.chain), **held)
    return file.model_dump(mode="json", exclude_none=True)


def load_simulator(path: Path | str) -> Simulator:
    """Read a simulator file.

    Raises:
        ModelError: if the file is missing, foreign, of another version, or names what the catalogue does not know.
    """
    try:
        return simulator_from(read_yaml(path), str(path))
    except ConfigError as error:
        raise ModelError(str(error)) from None


def simulator_from(data: Any, where: str) -> Simulator:
    """Simulator from the plain data of its file.

    Raises:
        ModelError: if the data is foreign, of another version, or names what the catalogue does not know.
    """
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        got = data.get("format") if isinstance(data, dict) else type(data).__name__
        two = str(got).startswith("hystmpc-two-axes")
        hint = "; this command takes a model of one axis, see the guide on two axes" if two else ""
        raise ModelError(f"{where}: format {got!r}, expected a simulator file of format {FORMAT!r}{hint}")
    try:
        file = SimulatorFile.parse(data, where)
    except ConfigError as error:
        raise ModelError(str(error)) from None
    chain = chain_from(file.chain, f"{where}: chain")
    names = [name for name in SimulatorFile.model_fields if name not in ("format", "chain")]
    return Simulator(chain=chain, **{name: getattr(file, name) for name in names})


@final
class ChainModel(LoadedModel, StepFunction):
    """Model of a simulator, run by its compiled step; the reference of its export."""

    def __init__(self, simulator: Simulator, start: Start = "initial") -> None:
        super().__init__(simulator.metadata(), start)
        self.simulator = simulator
        self._rest = RestRule(self.metadata, start, simulator.chain)
        self._run = prepared(simulator.chain.operators, simulator.dt_s)
        self._step = simulator.chain.bound(simulator.dt_s)

    @property
    def operators(self) -> tuple[Operator, ...]:
        return self.simulator.chain.operators

    def advance(self, state: Vec, u: Vec) -> tuple[Vec, Vec]:
        return self._run.run(state, u)

    def run_on(self, states: Vec, commands: Vec, inputs: Mapping[str, Vec] = NO_INPUTS) -> tuple[Vec, Vec]:
        return super().run_on(states, commands, inputs) if inputs else self._run.run(states, commands)

    def run(self, commands: Vec, y: float, inputs: Mapping[str, Vec] = NO_INPUTS) -> Vec:
        """Free run (T,) [deg] over commands (T,) from the rest at the first of them that shows `y` [deg].

        Args:
            inputs: measured inputs (T,) by name; their references where left out.
        """
        first = {name: float(z[0]) for name, z in inputs.items()}
        return self.run_on(self.at_rest(y, float(commands[0]), first)[None], commands[None], inputs)[0][0]

    def casadi_function(self) -> ca.Function:
        x, u = ca.SX.sym("x", self.state_size), ca.SX.sym("u")
        return ca.Function("model", [x, u], self._step(x, u), ["state", "u"], ["theta", "next_state"])

    def jacobian(self, state: Vec, u: float) -> Vec:
        return np.asarray(self._derivative(state, u))

    @cached_property
    def _derivative(self) -> ca.Function:
        x, u = ca.SX.sym("x", self.state_size), ca.SX.sym("u")
        theta, following = self._step(x, u)
        return dense("jacobian", [x, u], [ca.jacobian(ca.vertcat(theta, following), ca.vertcat(x, u))])


def simulator_bundle(simulator: Simulator) -> ExportBundle:
    """Exportable bundle of a simulator in double precision; the graph is made during the export."""
    model = ChainModel(simulator)

    def graph() -> onnx.GraphProto:
        from .contract.onnx_nodes import step_graph

        return step_graph(simulator.chain.bound(simulator.dt_s), model.metadata.kind)

    return ExportBundle(graph, model.metadata, model, probe_commands(model.metadata))


def export_simulator(simulator: Simulator, path: Path | str) -> EquivalenceReport:
    """Write a simulator as an ONNX model.

    Raises:
        ExportError: if the graph does not equal the simulator; nothing is written then.
    """
    return export_onnx(simulator_bundle(simulator), path)
