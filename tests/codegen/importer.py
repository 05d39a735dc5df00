"""FMUs as a tool opens them, by fmpy, with one interface for both versions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmpy.fmi3 import FMU3Slave

from hystmpc.codegen import FmuExport, export_fmu, export_fmu_in_plane
from hystmpc.codegen.fmu import FmuVersion
from hystmpc.models.two_axes.model import TwoAxisModel
from hystmpc.sim import SimulatedPlant
from hystmpc.sim.two_axes.config import TwoAxisPlantSettings
from hystmpc.sim.two_axes.plant import TwoAxisPlant
from hystmpc.tasks.export import device_in_plane
from hystmpc.trajectories.excitation import s2_point_to_point, s2_sinusoid
from hystmpc.trials.types import Vec

TIME, COMMAND = 0, 1


@dataclass(frozen=True, eq=False)
class InPlane:
    """A device of two axes: its model, and the changes of a study."""

    model: TwoAxisModel
    changes: TwoAxisPlantSettings

    @property
    def dt(self) -> float:
        """Sample time [s]."""
        return self.model.dt_s


Device = SimulatedPlant | InPlane
VERSIONS: tuple[FmuVersion, ...] = ("2.0", "3.0")


def exported(
    plant: Device, version: FmuVersion, name: str = "one device", platforms: tuple[str, ...] | None = None
) -> FmuExport:
    """The FMU of a plant, with this machine's binary where platforms are left out."""
    named: Any = {"name": name, "version": version, "platforms": platforms}
    if isinstance(plant, SimulatedPlant):
        return export_fmu(plant.simulator, plant.rest, rest_command=plant.rest_command, **named)
    device, _ = device_in_plane(plant.model, plant.changes)
    return export_fmu_in_plane(device, **named)


def written(plant: Device, path: Path, version: FmuVersion) -> Path:
    """The FMU of a plant, with this machine's binary."""
    export = exported(plant, version)
    assert export.platforms, "no C compiler: neither CC, cc nor the package ziglang"
    return export.write(path)


def by_python(plant: Device, commands: Vec) -> Vec:
    """True angles (T + 1,), or of two axes (T + 1, 2), from rest on [deg]."""
    device: Any = TwoAxisPlant(plant.model, plant.changes) if isinstance(plant, InPlane) else plant
    device.reset()
    angles = [device.true_angle]
    for u in commands.tolist():
        device.apply(u)
        angles.append(device.true_angle)
    return np.array(angles)


def names(fmu: Path, causality: str) -> list[str]:
    """Names of the variables of a causality."""
    described = fmpy.read_model_description(str(fmu))
    return [variable.name for variable in described.modelVariables if variable.causality == causality]


def by_fmpy(fmu: Path, commands: Vec, dt_s: float, along: Mapping[str, Vec] = MappingProxyType({})) -> Vec:
    """The same, as fmpy simulates an FMU; `along`: measured inputs (T,) by name, which stay where left out."""
    inputs, outputs = names(fmu, "input"), names(fmu, "output")
    times, columns = np.arange(len(commands)) * dt_s, [*commands.reshape(len(commands), -1).T, *along.values()]
    inputs = [*inputs[: len(columns) - len(along)], *along]
    table = np.array(
        list(zip(times, *columns, strict=True)), dtype=[("time", float), *((name, float) for name in inputs)]
    )
    told: dict[str, Any] = {"stop_time": len(commands) * dt_s, "output_interval": dt_s, "step_size": dt_s}
    shown = fmpy.simulate_fmu(str(fmu), input=table, output=outputs, **told)
    return np.stack([shown[name] for name in outputs], axis=-1).reshape(-1, *(len(outputs),) * (commands.ndim - 1))


def motions(plant: Device) -> Iterator[Vec]:
    """Commands (T,), or (T, n) at different moments, over a sinusoid and a point-to-point motion of S2."""
    for motion in (s2_sinusoid(0.5, "0BL"), s2_point_to_point(1)):
        commands = motion(np.arange(0.0, motion.duration_s, plant.dt))
        if isinstance(plant, SimulatedPlant):
            yield commands
            continue
        share = (commands - commands.min()) / np.ptp(commands)
        ends = [(one.lower, one.upper) for one in plant.model.command_limits]
        yield np.stack([low + (high - low) * np.roll(share, 17 * k) for k, (low, high) in enumerate(ends)], axis=1)


def greatest_difference(fmu: Path, plant: Device) -> float:
    """Of both over the motions [deg]."""
    off = [np.abs(by_fmpy(fmu, one, plant.dt) - by_python(plant, one)).max() for one in motions(plant)]
    return float(np.max(off))


class Instance:
    """One instance of an unpacked FMU; what it logs is in `lines`."""

    def __init__(self, folder: Path) -> None:
        description = fmpy.read_model_description(str(folder))
        self.lines: list[str] = []
        kinds = [variable.causality for variable in description.modelVariables]
        self.outputs = [k for k, kind in enumerate(kinds) if kind == "output"]
        self.commands = [k for k, kind in enumerate(kinds) if kind == "input" and k < self.outputs[0]]
        self._new = description.fmiVersion == "3.0"
        identifier = description.coSimulation.modelIdentifier
        told = {"guid": description.guid, "unzipDirectory": str(folder), "modelIdentifier": identifier}
        self._fmu: Any = (FMU3Slave if self._new else FMU2Slave)(instanceName="one", **told)
        if self._new:
            self._fmu.instantiate(logMessage=self._log)
        else:  # fmpy's own logger is one for all instances
            calls = fmi2CallbackFunctions()
            calls.logger = fmi2CallbackLoggerTYPE(self._log)
            self._fmu.instantiate(callbacks=calls)

    def start(self, start_s: float = 0.0, stop_s: float | None = None) -> None:
        told = {"startTime": start_s, "stopTime": stop_s}
        if self._new:
            self._fmu.enterInitializationMode(**told)
        else:
            self._fmu.setupExperiment(**told)
            self._fmu.enterInitializationMode()
        self._fmu.exitInitializationMode()

    def get(self, which: int) -> float:
        return float((self._fmu.getFloat64 if self._new else self._fmu.getReal)([which])[0])

    def shown(self) -> list[float]:
        """Every output."""
        return list((self._fmu.getFloat64 if self._new else self._fmu.getReal)(self.outputs))

    def ask(self, u: float) -> None:
        """Every command set to the same number."""
        (self._fmu.setFloat64 if self._new else self._fmu.setReal)(self.commands, [u] * len(self.commands))

    def set(self, which: int, value: float) -> None:
        (self._fmu.setFloat64 if self._new else self._fmu.setReal)([which], [value])

    def step(self, at_s: float, length_s: float) -> None:
        self._fmu.doStep(at_s, length_s)

    def run(self, commands: Vec, dt_s: float) -> Vec:
        """Outputs (T, m) from where it stands; every command is the same number of `commands` (T,)."""
        outputs = []
        for u in commands:
            self.ask(float(u))
            self.step(self.get(TIME), dt_s)
            outputs.append(self.shown())
        return np.array(outputs)

    def reset(self) -> None:
        self._fmu.reset()

    def save(self) -> Any:
        return self._fmu.getFMUState() if self._new else self._fmu.getFMUstate()

    def restore(self, state: Any) -> None:
        (self._fmu.setFMUState if self._new else self._fmu.setFMUstate)(state)

    def packed(self) -> bytes:
        """Its state as bytes."""
        state = self.save()
        raw = (self._fmu.serializeFMUState if self._new else self._fmu.serializeFMUstate)(state)
        (self._fmu.freeFMUState if self._new else self._fmu.freeFMUstate)(state)
        return bytes(raw)

    def unpack(self, raw: bytes) -> None:
        self.restore((self._fmu.deserializeFMUState if self._new else self._fmu.deSerializeFMUstate)(raw))

    def _log(self, *words: Any) -> None:
        self.lines.append(words[-1].decode())
