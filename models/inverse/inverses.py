"""Inverses of a model, and predictors with the memory of what is inverted."""

from __future__ import annotations

import math
from functools import cached_property
from typing import NamedTuple, final

import numpy as np

from hystmpc.core.structs import Struct, struct
from hystmpc.trials.errors import ModelError
from hystmpc.trials.types import Vec

from ..contract.metadata import ModelMetadata
from ..fronts import EngineInverse, EnginePredictor, Front, pair_inputs, pair_part, pair_rest
from ..model import Inverse, InvertiblePredictor, LoadedModel, Predictor, kind_of
from ..prediction.compiled import CompiledPredictor
from .drive import DrivenInverse


@final
class CompiledInverse(Inverse):
    """Exact one-step inverse of a compiled model whose angle does not fall with the command.

    u = argmin |u - u_last| over { u in [low, high] : theta(x, u) = theta }, by Newton's method on the exact
    derivative inside a shrinking bracket; the end of the range where no command reaches the angle. For a backlash it
    is S2 (RA-L 2024) eq. (3), for a Prandtl-Ishlinskii model the analytic inverse with the true rate of the command.

    Args:
        predictor: what is inverted; of a model that is inverted in slow motion, its angle is that after a hold, see
            `steady_inverse`.
        low, high: least and greatest command.
        held: samples for which the command is held before the angle counts.
    """

    def __init__(self, predictor: InvertiblePredictor, low: float, high: float, held: int = 1) -> None:
        self.predictor, self.low, self.high, self.held = predictor, low, high, held

    @cached_property
    def part(self) -> Struct:
        if not isinstance(self.predictor, CompiledPredictor):
            return super().part
        kind, predictor = kind_of("EXACT"), self.predictor.part
        return struct("hystmpc_inverse", kind=kind, predictor=predictor, low=self.low, high=self.high)

    def command(self, state: Vec, theta: float, u_last: float) -> float:
        return self.predictor.command_for(state, theta, self.low, self.high, u_last)


@final
class AccompaniedPredictor(EnginePredictor):
    """Model with a companion model that receives the same commands.

    Predictions are the model's. The state is [model state, model angle, companion state, companion angle], so that the
    companion's memory is copied and restored together with the model's.
    """

    def __init__(self, predictor: Predictor, companion: Predictor) -> None:
        self._as(predictor)
        self.predictor, self.companion, self.size = predictor, companion, predictor.state_size
        self.inputs, self.input_states = pair_inputs(predictor, companion, between=1)

    @property
    def state_size(self) -> int:
        return self.size + self.companion.state_size + 2

    @cached_property
    def part(self) -> Struct:
        return pair_part("ACCOMPANIED", self.predictor, self.companion, self.state_size)

    @property
    def rest_part(self) -> Struct:
        return pair_rest(self.predictor, self.companion)

    def initial(self, y: float, u: float) -> Vec:
        # What the two show before their first step is the measured angle for both: no difference is known yet.
        return np.concatenate([self.predictor.initial(y, u), [y], self.companion.initial(y, u), [y]])

    def parts(self, state: Vec) -> tuple[Vec, float, Vec, float]:
        """Model state, model angle [deg], companion state, companion angle [deg]."""
        return state[: self.size], float(state[self.size]), state[self.size + 1 : -1], float(state[-1])


@final
class CompanionInverse(EngineInverse):
    """Inverse of the companion, for the wanted angle minus the present difference between companion and model.

    u = companion^-1(theta + theta_companion - theta_model)
    """

    def __init__(self, predictor: AccompaniedPredictor, inverse: Inverse) -> None:
        self.predictor, self.inverse = predictor, inverse

    @property
    def state_size(self) -> int:
        return self.predictor.state_size

    @cached_property
    def part(self) -> Struct:
        kind, predictor = kind_of("COMPANION"), self.predictor.part
        return struct("hystmpc_inverse", kind=kind, predictor=predictor, inner=self.inverse.part)


@final
class MappedPredictor(Predictor):
    """Model with an inverse map whose inputs are the angles of the model.

    Predictions are the model's. The state is [model state, map state], so that both memories are copied and restored
    together. The map receives the model's angles, not measured ones, whose noise would switch its branch.
    """

    def __init__(self, predictor: Predictor, inverse_map: LoadedModel) -> None:
        self._as(predictor)
        self.inverse_map = inverse_map
        self._predictor, self._size = predictor, inverse_map.metadata.state_size

    def initial(self, y: float, u: float) -> Vec:
        facts = self.inverse_map.metadata
        side = facts.conditioned.state(np.array([[u]]))  # its output is the command that the device holds
        for _ in range(facts.warmup_samples):
            _, side = self.inverse_map.advance(side, np.array([[y]]))
        return np.concatenate([self._predictor.initial(y, u), side[0]])

    def advance(self, state: Vec, u: float) -> tuple[float, Vec]:
        main, side = self.parts(state)
        theta, main = self._predictor.advance(main, u)
        _, side = self.inverse_map.advance(side[None], np.array([[theta]]))
        return theta, np.concatenate([main, side[0]])

    def rollout(self, state: Vec, plans: Vec) -> Vec:
        return self._predictor.rollout(self.parts(state)[0], plans)

    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        return self._predictor.linearise(self.parts(state)[0], plan)

    def parts(self, state: Vec) -> tuple[Vec, Vec]:
        """Model state and map state."""
        cut = state.size - self._size
        return state[:cut], state[cut:]


@final
class TrainedInverse(Inverse):
    """Inverse map evaluated for one step without a search: u = map(x_map, theta), clipped to the device's limits."""

    def __init__(self, predictor: MappedPredictor, low: float, high: float) -> None:
        self._predictor, self._low, self._high = predictor, low, high

    def command(self, state: Vec, theta: float, u_last: float) -> float:
        del u_last  # the map's main memory says where the device is
        _, side = self._predictor.parts(state)
        answer, _ = self._predictor.inverse_map.advance(side[None], np.array([[theta]]))
        return min(max(float(answer[0, 0]), self._low), self._high)


def check_inverse_map(inverse_map: ModelMetadata, model: ModelMetadata) -> None:
    """Check the metadata of an inverse map against those of the inverted model.

    Raises:
        ModelError: if it is a forward model, or its units or its sample time are not those of the model.
    """
    got = f"inverse of kind {inverse_map.kind}: maps {inverse_map.command_unit} to {inverse_map.angle_unit}"
    if not inverse_map.inverted:
        raise ModelError(f"{got}, a forward model; expected an inverse map, {model.angle_unit} to {model.command_unit}")
    if inverse_map.angle_unit != model.command_unit:
        raise ModelError(f"{got}, expected {model.angle_unit} to {model.command_unit} as the model's command is")
    if abs(inverse_map.dt_s - model.dt_s) > 1e-3 * model.dt_s:
        raise ModelError(f"{got} every {inverse_map.dt_s:.6g} s, expected every {model.dt_s:.6g} s as the model")


_HOLDS = (2, 4)  # samples after which the response to the command's speed has decayed, if ever
_MOST_INSTRUCTIONS = 1000  # of the step of a hold, which a search for a command runs many times
_RAMP_S, _REST_S = 2.0, 0.4
_SAMPLES = (10, 200)  # samples of the ramp
_SHARE = 0.5  # share of the range of angles
_BACK = 1e-6  # least move, as share of the range of commands


def steady_inverse(predictor: InvertiblePredictor, low: float, high: float) -> CompiledInverse:
    """Inverse sample by sample, or after a hold where the former oscillates.

    The angle of some models falls at first when the command speeds up: plays whose thresholds grow with the speed stand
    still while the next move is faster than the last. Sampled, with r_i = alpha i + beta |u_k - u_{k-1}| / dt,

        theta_k = (A - B / dt) u_k + (B / dt) u_{k-1} + ...,   A = sum_i a_i,   B = beta sum_{i>0} a_i

    has its zero at (B / dt) / (B / dt - A), outside the unit circle where B / dt > A / 2. Its exact inverse is then
    unstable: on a steady ramp of the angle the command alternates between fast and still. The angle after a hold of
    some samples has no such zero, and is equal at rest.

    Source: Astrom, Hagander and Sternby, Zeros of sampled systems, Automatica 20 (1984), for the zeros.
    """
    exact = CompiledInverse(predictor, low, high)
    if not isinstance(predictor, CompiledPredictor) or not goes_back(exact, predictor):
        return exact
    for samples in _HOLDS:
        if samples * predictor.transition.n_instructions() > _MOST_INSTRUCTIONS:
            break
        held = CompiledInverse(predictor.held(samples), low, high, samples)
        if not goes_back(held, predictor):
            return held
    return exact


def inverted_after_a_hold(inverse: Inverse) -> bool:
    """Whether an inverse, behind its drives, is that after a hold: it is late in motion, thus only a first guess."""
    inner = inverse.inner if isinstance(inverse, DrivenInverse) else inverse
    return isinstance(inner, CompiledInverse) and inner.held > 1


def goes_back(inverse: CompiledInverse, predictor: InvertiblePredictor) -> bool:
    """Whether the commands for a ramp of the angle, up and down again, move against it at any sample."""
    low, high = predictor.command_range
    rest = max(2, round(_REST_S / predictor.dt))
    samples = min(max(round(_RAMP_S / predictor.dt), _SAMPLES[0]), _SAMPLES[1])
    state = predictor.initial(0.0, low)
    plans = np.array([[low] * (rest + 1), [high] * (rest + 1)])
    first, last = predictor.rollout(state, plans)[:, -1].tolist()
    for _ in range(rest):
        _, state = predictor.advance(state, low)
    if not (math.isfinite(first) and math.isfinite(last)):
        return False
    up = first + _SHARE * (last - first) * np.arange(1, samples + 1) / samples
    u = low
    for direction, ramp in ((1.0, up), (-1.0, up[::-1])):
        for theta in ramp.tolist():
            before, u = u, inverse.command(state, theta, u)
            if direction * (u - before) < -_BACK * (high - low):
                return True
            _, state = predictor.advance(state, u)
    return False


class Bounds(NamedTuple):
    """Least and greatest command, and greatest change per sample [mm or bar]."""

    low: float
    high: float
    reach: float


class Follower:
    """Inverse along a horizon, sample by sample from the state after the commands before.

    Args:
        whole: `hystmpc_model` with an inverse.
    """

    def __init__(self, whole: Struct) -> None:
        self._front = Front(whole)

    def follow(self, state: Vec, wanted: Vec, u_last: float, bounds: Bounds) -> Vec:
        """Commands (2, H) along the angles `wanted` (H,) [deg]: within the bounds alone, and with the rate limit."""
        return self._front.follow(state, wanted, u_last, np.array(bounds))


def follower_for(predictor: Predictor, inverse: Inverse) -> Follower:
    """Follower for an inverse with the memory of its predictor."""
    return Follower(struct("hystmpc_model", predictor=predictor.part, inverse=inverse.part))
