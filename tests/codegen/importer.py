"""FMUs as a tool opens them, by fmpy, with one interface for both versions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmpy.fmi3 import FMU3Slave

from hystmpc.codegen import export_fmu
from hystmpc.codegen.fmu import FmuVersion
from hystmpc.sim import SimulatedPlant
from hystmpc.trajectories.excitation import s2_point_to_point, s2_sinusoid
from hystmpc.trials.types import Vec

TIME, COMMAND, OUTPUT = 0, 1, 2
VERSIONS: tuple[FmuVersion, ...] = ("2.0", "3.0")


def written(plant: SimulatedPlant, path: Path, version: FmuVersion) -> Path:
    """The FMU of a plant, with this machine's binary."""
    export = export_fmu(
        plant.simulator, plant.rest, name="one device", version=version, rest_command=plant.rest_command
    )
    assert export.platforms, "no C compiler: neither CC, cc nor the package ziglang"
    return export.write(path)


def by_python(plant: SimulatedPlant, commands: Vec) -> Vec:
    """True angles (T + 1,) [deg] from rest on."""
    plant.reset()
    angles = [plant.true_angle]
    for u in commands:
        plant.apply(float(u))
        angles.append(plant.true_angle)
    return np.array(angles)


def by_fmpy(fmu: Path, commands: Vec, dt_s: float) -> Vec:
    """The same, as fmpy simulates an FMU."""
    times = np.arange(commands.size) * dt_s
    table = np.array(list(zip(times, commands, strict=True)), dtype=[("time", float), ("command", float)])
    told: dict[str, Any] = {"stop_time": commands.size * dt_s, "output_interval": dt_s, "step_size": dt_s}
    return np.asarray(fmpy.simulate_fmu(str(fmu), input=table, output=["angle"], **told)["angle"])


def greatest_difference(fmu: Path, plant: SimulatedPlant) -> float:
    """Of both over a sinusoid and a point-to-point motion of S2 [deg]."""
    off = []
    for motion in (s2_sinusoid(0.5, "0BL"), s2_point_to_point(1)):
        commands = motion(np.arange(0.0, motion.duration_s, plant.dt))
        off.append(np.abs(by_fmpy(fmu, commands, plant.dt) - by_python(plant, commands)).max())
    return float(np.max(off))


class Instance:
    """One instance of an unpacked FMU; what it logs is in `lines`."""

    def __init__(self, folder: Path) -> None:
        description = fmpy.read_model_description(str(folder))
        self.lines: list[str] = []
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

    def set(self, which: int, value: float) -> None:
        (self._fmu.setFloat64 if self._new else self._fmu.setReal)([which], [value])

    def step(self, at_s: float, length_s: float) -> None:
        self._fmu.doStep(at_s, length_s)

    def run(self, commands: Vec, dt_s: float) -> Vec:
        """Outputs (T,) from where it stands."""
        outputs = []
        for u in commands:
            self.set(COMMAND, float(u))
            self.step(self.get(TIME), dt_s)
            outputs.append(self.get(OUTPUT))
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
