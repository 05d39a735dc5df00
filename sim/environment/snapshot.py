"""Snapshots of a simulated plant: everything that its future depends on, random numbers included."""

from __future__ import annotations

from copy import deepcopy

from hystmpc.models.model import Predictor
from hystmpc.models.simulator import Simulator

from ..plant import Effects, SimulatedPlant

# Never changed once made, and large: a copy shares them.
_SHARED = (Simulator, Predictor, Effects)


def plant_copy(plant: SimulatedPlant) -> SimulatedPlant:
    """A plant that goes on from where the other is, with the same noise to come; neither touches the other."""
    return deepcopy(plant, {id(part): part for part in vars(plant).values() if isinstance(part, _SHARED)})
