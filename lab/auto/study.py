"""Study `auto`: random devices, `fit auto` against single kinds on fresh trials, in several orders of the logs."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from hystmpc.models.evaluate import evaluate
from hystmpc.models.kinds.catalogue import kind_named
from hystmpc.models.kinds.kind import Identified, opened
from hystmpc.trials.errors import FitError
from hystmpc.trials.report import Heading, Report
from hystmpc.trials.trial import Trial

from ..devices.drawn import DrawnDevice, DrawnPlant, DrawnSettings, drawn_devices
from ..devices.motions import recordings
from ..identify.job import found_parts, identified_as
from ..identify.settings import PARTS, IdentifyJob, IdentifyResult, covered, invented
from ..page import Bar, Figures, StudyTable, bars_table, cell, figures_table, judged_by, set_up
from ..study import Outcome, Study

_ABOUT = """Simulated devices drawn at random, each identified from six logs of three minutes together by `fit auto` and
by single kinds of model. Errors are RMSE over six fresh logs of other motions, the noise of the sensor included. The
logs are given in several orders."""
_FRESH = 3  # number of the draw of fresh motions
_DEVICE_S = {25.0: 60.0, 50.0: 80.0, 250.0: 250.0}  # processor seconds of a device on one core
_SAME = 0.02


class AutoSettings(DrawnSettings):
    """Settings of the study `auto`.

    Attributes:
        kinds: single kinds that are compared.
        orders: of the logs in which they are given to `auto`.
    """

    QUICK: ClassVar[Mapping[str, Any]] = {"devices": 2, "kinds": ("backlash",)}
    study: Literal["auto"] = "auto"
    kinds: tuple[str, ...] = ("backlash", "pi", "drdpi", "bouc_wen", "maxwell_slip", "play_kernel")
    orders: Annotated[int, Field(ge=1, le=20)] = 1

    def check_names(self) -> None:
        for name in self.kinds:
            kind_named(name)


@dataclass(frozen=True)
class AutoResult(IdentifyResult):
    """Outcome of one device.

    Attributes:
        structures: of `auto`, for each order of the logs.
        figures: `error.KIND` and, for each order, `error.auto` and `error.auto.K` [deg]; seconds by kind.
    """

    structures: tuple[str, ...] = ()


AutoOutcome = Outcome[AutoSettings, AutoResult]


def run_device(job: IdentifyJob, settings: AutoSettings, folder: Path) -> dict[str, Any]:
    """Identify a device by all kinds, and by `auto` from every order of its logs."""
    del folder
    device = drawn_devices(settings)[job.number]
    plant, quiet = DrawnPlant(device, device.seed), DrawnPlant(replace(device, noise_deg=0.0), 0)
    trials, fresh = recordings(plant, settings.quick), recordings(quiet, settings.quick, _FRESH)
    figures, structures, first = dict[str, float](), list[str](), None
    for k in range(settings.orders):
        order = np.random.default_rng(k).permutation(len(trials)) if k else range(len(trials))
        name = f"auto.{k}" if k else "auto"
        model = _fitted(name, [trials[i] for i in order], fresh, device, figures)
        first = first or model
        structures.append(model.report.split(";")[0])
    for kind in settings.kinds:
        try:
            _fitted(kind, trials, fresh, device, figures)
        except FitError:  # a kind may refuse a device
            figures[f"error.{kind}"] = math.inf
    assert first is not None
    return {
        "message": first.report,
        "found": found_parts(first),
        "structures": tuple(structures),
        "figures": figures,
    }


def _fitted(
    name: str,
    trials: Sequence[Trial],
    fresh: Sequence[Trial],
    device: DrawnDevice,
    figures: dict[str, float],
) -> Identified:
    """Identify a kind; its error and processor time are added to the figures."""
    began = time.process_time()
    made = identified_as(kind_named(name.split(".")[0]), trials, device, device.seed)
    figures[f"seconds.{name}"] = time.process_time() - began
    model = opened(made, name)
    square = np.mean([evaluate(model, trial).errors.rmse_deg ** 2 for trial in fresh])
    figures[f"error.{name}"] = math.sqrt(float(square) + device.noise_deg**2)
    return made


def over_best(settings: AutoSettings, figures: Figures) -> float:
    """Error of `auto` over that of the best single kind."""
    return figures["error.auto"] / min((figures[f"error.{kind}"] for kind in settings.kinds), default=math.nan)


def spread(settings: AutoSettings, figures: Figures) -> float:
    """Greatest change of the error by the order of the logs, as share."""
    first = figures["error.auto"]
    return max((abs(figures[f"error.auto.{k}"] / first - 1) for k in range(1, settings.orders)), default=0.0)


def bars(outcome: AutoOutcome) -> list[Bar]:
    """All bars of the study; a device with a failed job counts as infinitely bad."""
    settings = outcome.settings
    ratios = {r.job.key: over_best(settings, r.figures) if r.status == "done" else math.inf for r in outcome.results}
    same = {r.job.key: len(set(r.structures)) == 1 for r in outcome.done}
    spreads = {r.job.key: spread(settings, r.figures) if r.status == "done" else math.inf for r in outcome.results}
    judged = {part: [(r.job.key, covered(r, part), invented(r, part)) for r in outcome.done] for part in PARTS}
    inside = {part: {key: hit for key, hit, _ in rows if hit is not None} for part, rows in judged.items()}
    made_up = {part: {key: hit for key, _, hit in rows if hit is not None} for part, rows in judged.items()}
    return [
        Bar.at_most("auto over the best single kind: median", ratios, 1.0, 0.5),
        Bar.at_most("auto over the best single kind: worst", ratios, 1.05),
        Bar.share("one structure from all orders", same, (0.95, 1.0)),
        Bar.at_most("change of the error by the order: worst", spreads, _SAME),
        *(Bar.share(f"{part} within its 90 % interval", hits, (0.85, 0.95)) for part, hits in inside.items()),
        *(Bar.share(f"{part} invented", hits, (0.0, 0.02), counted=True) for part, hits in made_up.items()),
    ]


def devices_table(outcome: AutoOutcome) -> StudyTable:
    """Table of structure and errors, a row for each device."""
    settings, rows = outcome.settings, []
    for r in outcome.done:
        errors = [cell(r.figures[f"error.{name}"]) for name in ("auto", *settings.kinds)]
        ratio = cell(over_best(settings, r.figures))
        rows.append([r.job.key, round(float(r.facts["noise_deg"]), 3), r.structures[0], *errors, ratio])
    columns = ("device", "noise [deg]", "structure", *(f"{name} [deg]" for name in ("auto", *settings.kinds)))
    return StudyTable("devices", (*columns, "over the best"), rows, "Simulated: RMSE on fresh logs.")


def auto_report(outcome: AutoOutcome) -> tuple[Report, list[StudyTable]]:
    """Page of the study, and all tables that are written as CSV."""
    judged, devices = bars_table(bars(outcome)), devices_table(outcome)
    facts = {"kinds": ", ".join(outcome.settings.kinds), "orders of the logs": outcome.settings.orders}
    head = set_up(_ABOUT, facts, outcome)
    pieces = (*head, Heading("Bars"), judged.piece, Heading("Devices"), devices.piece)
    page = Report("Auto and single kinds", pieces, "simulated devices drawn at random, identified from logs")
    return page, [judged, devices, figures_table({r.job.key: r.figures for r in outcome.done})]


def auto_jobs(settings: AutoSettings, drawn: Sequence[DrawnDevice]) -> tuple[IdentifyJob, ...]:
    """Jobs of the study, one for each device."""
    return tuple(IdentifyJob(d.number, d.key) for d in settings.chosen(drawn))


def _inputs(job: IdentifyJob, settings: AutoSettings, folder: Path) -> dict[str, Any]:
    del folder
    return {"device": repr(drawn_devices(settings)[job.number]), "settings": settings.model_dump(mode="json")}


def _facts(job: IdentifyJob, settings: AutoSettings) -> dict[str, Any]:
    device = drawn_devices(settings)[job.number]
    facts = {"family": device.family, "noise_deg": device.noise_deg, "servo_damping": device.damping}
    return {"truth": device.truth, "facts": facts}


def _costs(jobs: Sequence[IdentifyJob], settings: AutoSettings) -> Mapping[str, float]:
    shares = (1 + settings.orders) / 2 * (0.2 if settings.quick else 1.0)
    return {job.key: shares * _DEVICE_S[float(job.key.rsplit("-", 1)[1].removesuffix("hz"))] for job in jobs}


STUDY = Study(
    name="auto",
    form="hystmpc-auto-job/1",
    settings=AutoSettings.of,
    result=AutoResult,
    draw=drawn_devices,
    jobs=auto_jobs,
    run=run_device,
    inputs=_inputs,
    costs=_costs,
    facts=_facts,
    page=auto_report,
    **judged_by(bars, "devices"),
)
