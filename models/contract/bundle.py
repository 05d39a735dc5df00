"""What an export consists of: the graph, what it says about itself, the reference, and the motion it is tried on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import onnx

from hystmpc.trials.errors import ExportError
from hystmpc.trials.types import Vec

from ..model import StepFunction
from .metadata import ModelMetadata


@dataclass(frozen=True)
class ExportBundle:
    """One model ready for export.

    Attributes:
        graph: inputs u [N,1] and state [N,S], outputs theta [N,1] and next_state [N,S], batch axis N symbolic, all
            four float32 or all four double, operators from the list.
        metadata: see `ModelMetadata`.
        reference: the implementation that the graph has to agree with.
        probe: commands (T,) [command unit], T >= 2, a persistent excitation inside the trained range.

    Raises:
        ExportError: if the parts do not fit each other.
    """

    graph: onnx.GraphProto
    metadata: ModelMetadata
    reference: StepFunction
    probe: Vec

    def __post_init__(self) -> None:
        probe = np.array(self.probe, dtype=np.float64)
        probe.setflags(write=False)
        object.__setattr__(self, "probe", probe)
        trained = self.metadata.trained_command
        if probe.ndim != 1 or probe.size < 2:
            raise ExportError(f"probe has shape {probe.shape}, expected (T,) with T >= 2")
        outside = np.flatnonzero(~trained.contains(probe))
        if outside.size:
            k = int(outside[0])
            raise ExportError(
                f"probe is {probe[k]:.6g} {self.metadata.command_unit} at sample {k}, "
                f"expected the trained range {trained.lower:.6g} to {trained.upper:.6g}"
            )
        if self.reference.state_size != self.metadata.state_size:
            raise ExportError(
                f"reference has {self.reference.state_size} state entries, metadata {self.metadata.state_size}, "
                "expected as many"
            )
