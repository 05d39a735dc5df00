"""Operators connected in series or in parallel with a model in one file, and their separation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Literal, final

import numpy as np

from hystmpc.trials.errors import ModelError
from hystmpc.trials.types import Vec

from .chain import Chain, chain_from, chain_spec
from .contract.export import ExportBundle, graph_bytes
from .contract.metadata import Connection, InitialRule, ModelMetadata
from .model import LoadedModel, StepFunction
from .motions import probe_commands
from .simulator import ChainModel, Simulator

if TYPE_CHECKING:
    import onnx

    from .contract.load import OnnxModel


@final
class ConnectedStep(StepFunction):
    """Step of operators in series or in parallel with a model; the state is [operators' state, model's state].

    series:    theta = rest(v),            v = operators(u)
    parallel:  theta = v + rest(u),        v = operators(u)
    """

    def __init__(self, operators: StepFunction, way: Literal["series", "parallel"], rest: StepFunction) -> None:
        self._operators, self._in_series, self._rest = operators, way == "series", rest
        self._cut = operators.state_size
        self.state_size = self._cut + rest.state_size

    def advance(self, state: Vec, u: Vec) -> tuple[Vec, Vec]:
        v, moved = self._operators.advance(state[:, : self._cut], u)
        theta, following = self._rest.advance(state[:, self._cut :], v if self._in_series else u)
        return theta if self._in_series else v + theta, np.hstack([moved, following])

    def jacobian(self, state: Vec, u: float) -> Vec:
        """Jacobian of [theta, next states of operators and rest] by [their states, u], by the chain rule."""
        cut, size = self._cut, self.state_size
        first = self._operators.jacobian(state[:cut], u)
        v = u
        if self._in_series:
            v = float(self._operators.advance(state[None, :cut], np.array([[u]]))[0][0, 0])
        second = self._rest.jacobian(state[cut:], v)
        whole = np.zeros((1 + size, size + 1))
        whole[1 : 1 + cut, :cut], whole[1 : 1 + cut, -1] = first[1:, :-1], first[1:, -1]
        rest = np.r_[0, 1 + cut : 1 + size]
        whole[rest, cut:size] = second[:, :-1]
        if self._in_series:
            by_operators = np.outer(second[:, -1], first[0])
            whole[rest, :cut], whole[rest, -1] = by_operators[:, :-1], by_operators[:, -1]
        else:
            whole[rest, -1] = second[:, -1]
            whole[0, :cut] += first[0, :-1]
            whole[0, -1] += first[0, -1]
        return whole


def connected_bundle(
    operators: Simulator, way: Literal["series", "parallel"], rest: ExportBundle, facts: ModelMetadata
) -> ExportBundle:
    """Exportable bundle of a model with operators in series before it or in parallel.

    At rest, operators in parallel have the measured angle, and the rest has zero.

    Args:
        operators: chain at the sample time of `rest`.
        facts: sample time, units, limits and ranges of the whole; all else follows from the parts.

    Raises:
        ExportError: if the parts do not fit each other.
    """
    front, step = ChainModel(operators), ConnectedStep(ChainModel(operators), way, rest.reference)
    inner = rest.metadata
    metadata = ModelMetadata.of(**dict(facts) | {
        "kind": inner.kind,
        "initial": _joint_rule(front.metadata.initial, inner.initial, way, facts),
        "conditioned": _joint_rule(front.metadata.conditioned, inner.conditioned, way, facts),
        "warmup_samples": front.metadata.warmup_samples + inner.warmup_samples,
        "training": dict(inner.training),
        "noise": inner.noise,
        "connections": (Connection(way=way, chain=chain_spec(operators.chain)), *inner.connections),
    })  # fmt: skip

    def graph() -> onnx.GraphProto:
        return _connected_graph(operators, way, rest.graph() if callable(rest.graph) else rest.graph, inner)

    return ExportBundle(graph, metadata, step, probe_commands(metadata))


def operators_of(facts: ModelMetadata) -> Chain:
    """Operators of a model's outermost connection.

    Raises:
        ModelError: if they are unknown, or have as many states as the model or more.
    """
    chain = chain_from(facts.connections[0].chain, "connections[0].chain")
    if chain.state_size >= facts.state_size:
        raise ModelError(
            f"connections[0]: its operators have {chain.state_size} states, expected less than the {facts.state_size} "
            "of the model"
        )
    return chain


def rest_of(model: LoadedModel) -> OnnxModel:
    """Model without the operators of its outermost connection.

    Raises:
        ModelError: if the graph is not that of a connection.
    """
    from onnx import helper
    from onnx.utils import Extractor

    from .contract.load import OnnxModel
    from .contract.onnx_nodes import INTERFACE

    assert isinstance(model, OnnxModel)
    facts, cut = model.metadata, operators_of(model.metadata).state_size
    names = {f"{_rest(facts.connections[1:])}_{name}": name for pair in INTERFACE for name in pair}
    try:
        inputs, outputs = ([name for name, plain in names.items() if plain in pair] for pair in INTERFACE)
        graph = Extractor(helper.make_model(model.graph)).extract_model(inputs, outputs).graph
        # weights that no node uses are read by the faster predictors
        known, ours = {weight.name for weight in graph.initializer}, _operators(facts.connections[1:])
        left = [w for w in model.graph.initializer if w.name not in known and not w.name.startswith(ours)]
        graph.initializer.extend(left)
    except ValueError as error:
        raise ModelError(f"{model.source}: connections[0] is not in the graph: {error}") from None
    inner = facts.model_copy(
        update={
            "connections": facts.connections[1:],
            "initial": facts.initial.behind(cut),
            "conditioned": facts.conditioned.behind(cut),
        }
    )
    return OnnxModel(graph_bytes(_renamed(graph, names), inner), model.source, model.start)


def _joint_rule(operators: InitialRule, rest: InitialRule, way: str, facts: ModelMetadata) -> InitialRule:
    still = (0.0,) * len(rest.offset)
    if way == "parallel":
        by = (*(operators.by_command or (0.0,) * len(operators.offset)), *(rest.by_command or still))
        return InitialRule(
            offset=(*operators.offset, *rest.offset),
            slope=(*operators.slope, *still),
            by_command=by if rest.by_command else (),
            at_command=rest.at_command,
        )
    at = rest.at_command if rest.by_command else facts.rests_at
    return InitialRule(
        offset=(*operators.state(np.array([[at]]))[0].tolist(), *rest.offset),
        slope=(*(0.0 for _ in operators.offset), *rest.slope),
        by_command=(*operators.slope, *(rest.by_command or still)),
        at_command=at,
    )


def _rest(connections: tuple[Connection, ...]) -> str:
    """Prefix of the inputs and outputs of an inner model, by the number of connections within it."""
    return f"rest{len(connections)}"


def _operators(connections: tuple[Connection, ...]) -> str:
    """Prefix of the tensors of connected operators, by the number of connections within."""
    return f"operators{len(connections)}_"


def _connected_graph(operators: Simulator, way: str, rest: onnx.GraphProto, facts: ModelMetadata) -> onnx.GraphProto:
    """Step graph in double precision; weights and inner tensors of the rest keep their names."""
    from onnx import TensorProto, helper, numpy_helper

    from .contract.onnx_nodes import INTERFACE, as_columns, operator_nodes, tensor

    name, prefix = _rest(facts.connections), _operators(facts.connections)
    size = operators.chain.state_size
    columns = [f"{prefix}state_{i}" for i in range(size)]
    program = operator_nodes(operators.chain.bound(operators.dt_s), [columns, ["u"]], prefix)
    (answer, *following), spread = as_columns(program.outputs[0] + program.outputs[1], program.constants, prefix)
    rest = _renamed(rest, {plain: f"{name}_{plain}" for pair in INTERFACE for plain in pair})
    element = rest.input[0].type.tensor_type.elem_type

    def cast(before: str, after: str, to: int) -> onnx.NodeProto:
        return helper.make_node("Cast", [before], [after], name=after, to=to)

    theta, state, sizes = f"{prefix}theta", f"{prefix}next_state", f"{prefix}sizes"
    ends = ("Identity", [theta]) if way == "series" else ("Add", [answer, theta])
    nodes = [
        helper.make_node("Split", ["state", sizes], [*columns, f"{prefix}rest"], name=sizes, axis=1),
        *program.nodes,
        *spread,
        cast(answer if way == "series" else "u", f"{name}_u", element),
        cast(f"{prefix}rest", f"{name}_state", element),
        *rest.node,
        cast(f"{name}_theta", theta, TensorProto.DOUBLE),
        cast(f"{name}_next_state", state, TensorProto.DOUBLE),
        helper.make_node(*ends, ["theta"], name=f"{prefix}sum"),
        helper.make_node("Concat", [*following, state], ["next_state"], name=f"{prefix}joint_state", axis=1),
    ]  # fmt: skip
    numbers = {label: np.full((1, 1), value) for label, value in program.constants.items()}
    numbers[sizes] = np.array([1] * size + [facts.state_size], np.int64)
    weights = [numpy_helper.from_array(value, label) for label, value in numbers.items()]
    inputs, outputs = ([tensor(one, 1), tensor(all_, size + facts.state_size)] for one, all_ in INTERFACE)
    return helper.make_graph(
        nodes,
        rest.name,
        inputs,
        outputs,
        initializer=[*weights, *rest.initializer],
        value_info=[*rest.value_info, *rest.input, *rest.output],
    )


def _renamed(graph: onnx.GraphProto, names: Mapping[str, str]) -> onnx.GraphProto:
    from onnx import GraphProto

    copy = GraphProto()
    copy.CopyFrom(graph)
    for node in copy.node:
        for tensors in (node.input, node.output):
            tensors[:] = [names.get(name, name) for name in tensors]
    for value in (*copy.input, *copy.output, *copy.value_info):
        value.name = names.get(value.name, value.name)
    return copy
