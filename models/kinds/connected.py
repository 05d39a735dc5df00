"""Combinations of kinds: any kind behind the drive of a device, and a network in parallel to its operators."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, final

from hystmpc.trials.errors import FitError, did_you_mean
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..chain import Chain, split
from ..connections import connected_bundle
from ..contract.export import ExportBundle, model_bytes
from ..contract.metadata import DeviceLimits
from ..evaluate import free_run, started
from ..identify.auto import AutoFit
from ..identify.auto_search import worth
from ..identify.cross_validation import CrossValidation
from ..identify.runs import Blocks, blocks_of, facts_of, ordered, runs_to_fit
from ..identify.simulators import simulator_of
from ..inverse.drive import Drive
from ..model import FitProgress
from ..simulator import ChainModel, Simulator
from .kind import FitRequest, Identified, ModelKind
from .networks import NETWORK_KINDS, RESIDUAL, NetworkKind
from .operator_kinds import AutoKind


@final
class DrivenKind(ModelKind):
    """Kind of model behind the drive of a device: theta = kind(v), v = drive(u).

    The drive is that of a simulator, up to its last lag, servo, delay or top speed; the kind is identified from the
    travel v, the drive's output for the recorded commands.

    Args:
        kind: a network or a regression; `auto` already includes a drive.
        device: a simulator with the drive; None to identify one from the same trials by `auto`.

    Raises:
        FitError: if the kind is one of operators, or the simulator has no drive.
    """

    def __init__(self, kind: ModelKind, device: Simulator | None = None) -> None:
        if kind.readable:
            raise FitError(f"{kind.name} and its drive are what `auto` identifies, expected a network or a regression")
        self.name, self.title = f"{kind.name} behind a drive", f"{kind.title} behind a drive"
        if device is not None and _parted(device)[0] is None:
            raise FitError("the simulator has no drive, expected a lag, servo, delay or top speed on its command")
        self.trainings, self.inverse_training, self.recurrent = kind.trainings, kind.inverse_training, True
        self.invertible = False
        self._kind, self._device, self._auto = kind, device, AutoKind()

    def fit(self, trials: Sequence[Trial], request: FitRequest, progress: FitProgress | None = None) -> Identified:
        self.check(trials, request)
        tell, device, parts = progress or _silent, self._device, None
        if device is None:
            before = self._auto.fit(trials, replace(request, training=self._auto.trainings[0], validation=()), tell)
            device, parts = _identified(before), before.parts
        done = 0 if self._device else self._auto.steps(request)

        def after_the_drive(step: int, rmse: float) -> None:
            tell(done + step, rmse)

        front, _ = _parted(device.at_sample_time(trials[0].dt))
        if front is None:
            fit = self._kind.fit(trials, request, after_the_drive)
            return replace(fit, parts=parts, report=f"no drive found; {fit.report}")
        drive = Drive(front.chain.operators, front.metadata())
        travels, judges = ([behind(drive, trial) for trial in each] for each in (trials, request.validation))
        fit = self._kind.fit(travels, replace(request, validation=tuple(judges)), after_the_drive)
        bundle = _connected(front, "series", fit.bundle, trials, request.limits)
        words = " + ".join(operator.name for operator in front.chain.operators)
        return replace(fit, bundle=bundle, parts=parts, report=f"behind {words}: {fit.report}")

    def steps(self, request: FitRequest) -> int | None:
        steps = self._kind.steps(request)
        return None if steps is None else steps + (0 if self._device else self._auto.steps(request))


@final
class ResidualKind(ModelKind):
    """Operators of a device and a network of their residual, behind the drive of the device.

        theta = core(v) + network(v),  v = drive(u)

    Drive and core are those of `auto`. The network is kept only if it lowers the error on the search's first fold, by
    the rule of `auto` for any other part, with operators fitted without that fold and a network trained on their
    residual of the other trials. It is then trained on the residual of all trials.

    Args:
        network: kind of the network, `lstm` or `gru`.

    Raises:
        FitError: on another kind.
    """

    def __init__(self, network: str) -> None:
        kinds = {kind.name: kind for kind in NETWORK_KINDS if RESIDUAL in kind.trainings}
        if network not in kinds:
            raise FitError(f"no network {network!r} of what operators leave, {did_you_mean(network, kinds)}")
        self._network: NetworkKind = kinds[network]
        self._auto = AutoKind()
        self.name, self.title = f"auto with {network}", f"auto + {self._network.title}"
        self.trainings, self.invertible = self._auto.trainings, False

    def fit(self, trials: Sequence[Trial], request: FitRequest, progress: FitProgress | None = None) -> Identified:
        self.check(trials, request)
        if len(trials) < 2:  # one for training, one for validation
            raise FitError(f"{self.name}: got {len(trials)} trial, expected 2 or more: the network is judged on one")
        tell, trials = progress or _silent, ordered(trials)  # the folds of `auto` count so
        fit = self._auto.fit(trials, request, tell)
        if fit.interrupted or fit.parts is None:
            return fit
        first = self._auto.steps(request)
        part = replace(request, training=RESIDUAL, hold_out=0)
        each = self._network.steps(part)
        try:
            before, after = self._judged(trials, fit.parts, part, lambda k, rmse: tell(first + k, rmse))
        except (KeyboardInterrupt, FitError) as error:  # the device is identified; only the network is missing
            why = str(error) or "interrupted"
            stopped = isinstance(error, KeyboardInterrupt)
            return replace(fit, interrupted=stopped, report=f"{fit.report}; {self._network.name} not kept: {why}")
        change = f"{before.mse**0.5:.4g} -> {after.mse**0.5:.4g} {trials[0].units.angle} on trials left out"
        if not worth(before, after):
            return replace(fit, report=f"{fit.report}; {self._network.name} not kept: {change}")
        device = _identified(fit)
        rest = self._network.fit(
            _left(trials, device, fit.parts.offsets), part, lambda k, rmse: tell(first + each + k, rmse)
        )
        front, middle = _parted(device)
        bundle = _connected(middle, "parallel", rest.bundle, trials, request.limits)
        if front is not None:
            bundle = _connected(front, "series", bundle, trials, request.limits)
        history = (*fit.history, *((first + each + k, rmse) for k, rmse in rest.history))
        report = f"{fit.report}; with {self._network.name} {change}"
        return Identified(bundle, None, history, report, rest.interrupted, fit.parts)

    def steps(self, request: FitRequest) -> int | None:
        return self._auto.steps(request) + 2 * self._network.steps(replace(request, training=RESIDUAL))

    def _judged(
        self, trials: Sequence[Trial], parts: AutoFit, request: FitRequest, progress: FitProgress
    ) -> tuple[Blocks, Blocks]:
        """Errors on the trials of the first fold without and with a network, both identified from the others."""
        from ..contract.load import OnnxModel  # onnxruntime is not loaded for operators

        problem, judged = parts.choice.hypothesis.problem, parts.choice.judged
        runs = runs_to_fit(trials, request.skip_first_flexure)
        fold = CrossValidation(problem.baseline, runs).folds[0]
        seen = [trial for k, trial in enumerate(trials) if k not in fold]
        chain = parts.decades.log_chain(problem.fitted_chain(judged.fold_q[0]))
        device = simulator_of(chain, seen, request.limits, "without the first fold")
        fit = self._network.fit(_left(seen, device, parts.offsets), request, progress)
        if fit.interrupted:
            raise KeyboardInterrupt
        network = OnnxModel(model_bytes(fit.bundle), self._network.name)
        unseen, runs = _left([trials[k] for k in fold], device, parts.offsets), tuple(runs[k] for k in fold)
        alone = [trial.angle for trial in unseen]
        both = [_centred(trial.angle - free_run(network, trial.command, 0.0), parts.offsets) for trial in unseen]
        before, after = (
            blocks_of([error[run.counts] for error, run in zip(errors, runs, strict=True)], runs)
            for errors in (alone, both)
        )
        return before, after


def behind(drive: Drive, trial: Trial) -> Trial:
    """Trial whose command is the travel behind a drive, which rested at its first command."""
    predictor, u = drive.predictor, float(trial.command[0])
    return replace(trial, command=predictor.rollout(predictor.initial(u, u), trial.command[None])[0])


def _parted(device: Simulator) -> tuple[Simulator | None, Simulator]:
    front, _, _ = split(device.chain)
    behind_it = replace(device, chain=replace(device.chain, before=device.chain.before[len(front) :]))
    if not front:
        return None, behind_it
    return replace(device, chain=Chain(front[-1], before=front[:-1])), behind_it


def _left(trials: Sequence[Trial], device: Simulator, offsets: bool) -> list[Trial]:
    """Residuals of a device on trials, over the drive's output for the commands."""
    front, middle = _parted(device)
    drive, model = front and Drive(front.chain.operators, front.metadata()), ChainModel(middle)
    travels = [behind(drive, trial) if drive else trial for trial in trials]
    residuals = [travel.angle - free_run(model, travel.command, started(model, travel)) for travel in travels]
    return [replace(t, angle=_centred(r, offsets)) for t, r in zip(travels, residuals, strict=True)]


def _centred(residual: Vec, offsets: bool) -> Vec:
    """Residual without its mean where every trial has a separate offset."""
    return residual - residual.mean() if offsets else residual


def _connected(
    operators: Simulator,
    way: Literal["series", "parallel"],
    rest: ExportBundle,
    trials: Sequence[Trial],
    limits: DeviceLimits,
) -> ExportBundle:
    """Bundle of a connection, with the ranges of the recorded trials."""
    facts = rest.metadata
    rules = facts.initial, facts.conditioned
    return connected_bundle(
        operators, way, rest, facts_of(facts.kind, trials, limits, rules, facts.warmup_samples, facts.training)
    )


def _identified(fit: Identified) -> Simulator:
    assert fit.simulator is not None
    return fit.simulator


def _silent(done: int, rmse: float) -> None:
    del done, rmse
