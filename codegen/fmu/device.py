"""C text of a device in an FMU: its operators and its rest as numbers, for one axis and for two."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hystmpc.core.chain import ChainCode
from hystmpc.core.library import engine
from hystmpc.models.chain import Chain
from hystmpc.models.operators.measurement import Sensor
from hystmpc.models.operators.operator import Operator
from hystmpc.models.scheduled import input_states
from hystmpc.models.simulator import Simulator
from hystmpc.models.stages import operator_program
from hystmpc.models.two_axes.model import TwoAxisModel
from hystmpc.trials.errors import ExportError
from hystmpc.trials.types import Vec

from ..literals import functions_called, number, table
from ..numbers import Numbers


@dataclass(frozen=True)
class DeviceText:
    """What the C text of an FMU says of its device.

    Attributes:
        part: name of the file in c/ that completes device.c.
        engine: files of the engine behind those of every device.
        rest, tables: macros of the rest, and constant tables.
        functions: of <math.h> that a step calls.
    """

    part: str
    engine: tuple[str, ...]
    rest: str
    tables: str
    functions: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class DeviceInPlane:
    """Device of two axes at its rest.

    Attributes:
        model: of two axes, with the effects of its axes.
        drive: operators in front of every command, such as its lag; empty for none.
        rest_deg: angles (2,) at rest [deg].
        drives: state (S,) of the drive of every command at rest.
        axes: states (S,) of both axes at rest.
        shared: state (S,) at rest of the friction that both share; empty without one.
    """

    model: TwoAxisModel
    drive: tuple[Operator, ...]
    rest_deg: Vec
    drives: tuple[Vec, ...]
    axes: tuple[Vec, Vec]
    shared: Vec


def text_of(simulator: Simulator, rest: tuple[float, Vec], rest_command: float) -> DeviceText:
    """Text of a device of one axis, which starts at a rest: output and state (S,).

    Raises:
        ExportError: if the simulator is an inverse map or has a sensor.
    """
    _check(simulator)
    code, places = _chain_code(simulator.chain.operators), input_states(simulator.chain.operators)
    entries = [f"{{{k}, {entry}}}" for k, row in enumerate(places.values()) for entry in row]
    rows = ", ".join([*entries, "{-1, 0}"])
    inputs = [
        f"#define HYSTMPC_INPUTS {len(places)}",
        f"static const int device_inputs[][2] = {{{rows}}}; /* input, entry of the state */",
    ]
    return DeviceText(
        "one_axis",
        (),
        "\n".join(
            [
                f"#define HYSTMPC_STATES {rest[1].size}",
                f"#define HYSTMPC_REST {_listed(rest[1])}",
                f"#define HYSTMPC_REST_OUTPUT {number(rest[0])}",
                f"#define HYSTMPC_REST_COMMAND {number(rest_command)}",
            ]
        ),
        "\n".join(
            [
                _room([code]),
                *_tables("device_chain", "device_kept", code, simulator.chain, simulator.dt_s),
                *(inputs if places else ()),
            ]
        ),
        functions_called(code.code.tolist()),
    )


def text_in_plane(device: DeviceInPlane) -> DeviceText:
    """Text of a device of two axes.

    Raises:
        ExportError: if an axis is an inverse map or has a sensor.
    """
    model, dt_s = device.model, device.model.dt_s
    for axis in model.axes:
        _check(axis)
        if names := ", ".join(one.name for one in axis.chain.inputs):
            raise ExportError(f"export-fmu: an axis depends on {names}, expected two axes without measured inputs")
    chains = {"device_x": model.axes[0].chain, "device_y": model.axes[1].chain}
    chains |= {"device_drive": Chain(device.drive[0], after=device.drive[1:])} if device.drive else {}
    codes = {name: _chain_code(chain.operators) for name, chain in chains.items()}
    tables = [_room(codes.values()), *_matrices(model)]
    for name, chain in chains.items():
        tables += _tables(name, f"{name}_kept", codes[name], chain, dt_s)
    if model.cross_friction is not None:
        shared = Numbers(single=False, lanes=1)
        shared.put(model.cross_friction.struct(dt_s), "device_shared")
        tables.append(shared.text)
    called = {name for code in codes.values() for name in functions_called(code.code.tolist())}
    called |= set() if model.cross_friction is None else {"sqrt"}
    return DeviceText(
        "two_axes", ("cross_friction.c",), _rest_in_plane(device), "\n".join(tables), tuple(sorted(called))
    )


def _rest_in_plane(device: DeviceInPlane) -> str:
    states = np.concatenate([*device.drives, *device.axes, device.shared])
    sizes = {
        "COMMANDS": len(device.model.command_limits),
        "STATES": states.size,
        "DRIVE_STATES": device.drives[0].size,
        "X_STATES": device.axes[0].size,
        "Y_STATES": device.axes[1].size,
        "SHARED_STATES": device.shared.size,
    }
    lists: dict[str, Iterable[float]] = {
        "REST": states,
        "REST_OUTPUT": device.rest_deg,
        "REST_COMMAND": device.model.rest_commands,
    }
    said = {name: str(size) for name, size in sizes.items()} | {name: _listed(row) for name, row in lists.items()}
    return "\n".join(f"#define HYSTMPC_{name} {text}" for name, text in said.items())


def _matrices(model: TwoAxisModel) -> list[str]:
    rows = {"device_mix": model.matrix, "device_frame": model.turn}
    return [table(name, "real", map(number, matrix.ravel().tolist())) for name, matrix in rows.items()]


def _check(simulator: Simulator) -> None:
    if simulator.metadata().inverse:
        raise ExportError("export-fmu: got an inverse map, supported are simulators of a device: command to angle")
    if any(isinstance(operator, Sensor) for operator in simulator.chain.operators):
        raise ExportError("export-fmu: got a sensor in the chain, supported is the true angle: take the sensor out")


def _chain_code(operators: Sequence[Operator]) -> ChainCode:
    """Operators as numbers, without their states at rest: that at the start is known."""
    none: dict[str, Any] = {"rest": np.empty(0, dtype=np.intc), "rest_constants": np.empty(0)}
    return ChainCode([replace(operator_program(operator), **none) for operator in operators])


def _tables(name: str, kept_name: str, code: ChainCode, chain: Chain, dt_s: float) -> list[str]:
    """C text of a chain for `hystmpc_chain_step`."""
    kept = code.prepare(chain.values.reshape(-1, 1), dt_s)
    return [
        table(name, "int", map(str, code.code.tolist())),
        table(kept_name, "real", map(number, kept.ravel().tolist())),
    ]


def _room(codes: Iterable[ChainCode]) -> str:
    """C text of the room that a step of the longest chain needs."""
    room = max(
        -(-int(engine().chain_single_bytes(code.code)) // 8) for code in codes
    )  # no pointers are longer than ours
    return f"#define HYSTMPC_ROOM {room} /* doubles of a step */"


def _listed(values: Iterable[float]) -> str:
    return f"{{{', '.join(number(float(value)) for value in values)}}}"
