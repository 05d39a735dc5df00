"""Numbers printed in the two papers on their models, and the common parts of the pages of the studies.

No computation uses these numbers. Marks: [P] printed in the paper, [C] recovered from the authors' published code, [I]
inferred from the paper's text.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final, Literal

from hystmpc.trials.report import ACCENTS, COMMAND, MEASURED, MODEL, REFERENCE, Heading, Piece

from ..page import NOTHING, Cell, StudyTable, set_up
from .job import PaperOutcome, title_of
from .settings import PaperSettings

DEVICE_LINE: Final[dict[str, Any]] = {"color": REFERENCE, "linewidth": 2.2, "alpha": 0.5}
COLOURS: Final = (MODEL, MEASURED, COMMAND, *ACCENTS)
"""Line of the device, and colours of the models, in figures."""

Mark = Literal["P", "C", "I"]
MARKS: Final = "[P] printed in the paper, [C] in its authors' published code, [I] inferred from its text"
# S2 Table I: row against column; forward and inverse, point-to-point. The rows of the sinusoids are lost.
_P2P: Final[dict[str, dict[str, str]]] = {
    "backlash": {"fnn": "</<"},
    "pi": {"fnn": "</<", "backlash": ">/>"},
    "lstm": {"fnn": "</<", "backlash": "</~", "pi": "</<"},
    "gru": {"fnn": "</<", "backlash": "~/~", "pi": "</~", "lstm": ">/~"},
    "fnn_hib": {"fnn": "</<", "backlash": ">/>", "pi": "~/>", "lstm": ">/>", "gru": ">/>"},
    "hb1": {"fnn": "</<", "backlash": "</~", "pi": "</<", "lstm": "~/~", "gru": "</~", "fnn_hib": "</<"},
    "hb2": {"fnn": "</<", "backlash": "</<", "pi": "</<", "lstm": "~/<", "gru": "</<", "fnn_hib": "</<", "hb1": "~/<"},
}
# Of the sinusoids the text says: all networks but FNN-HIB and HB1 are equivalent and best; backlash and PI are inferior
# to all hysteretic networks.
_SIN: Final[dict[str, dict[str, str]]] = {
    "lstm": {"fnn": "</<", "backlash": "</<", "pi": "</<"},
    "gru": {"fnn": "</<", "backlash": "</<", "pi": "</<", "lstm": "~/~"},
    "fnn_hib": {"fnn": "</<", "backlash": "</<", "pi": "</<", "lstm": ">/>", "gru": ">/>"},
    "hb1": {"lstm": ">/>", "gru": ">/>"},
    "hb2": {"fnn": "</<", "lstm": "~/~", "gru": "~/~", "fnn_hib": "</<", "hb1": "</<"},
}
# Order of the models by mean error, least first, in S2's conclusion; models in one group are not distinguished.
# For point-to-point motions the GRU is not ranked.
S2_ORDER: Final = {
    "p2p": (("hb2",), ("lstm", "hb1"), ("backlash",), ("pi", "fnn_hib"), ("fnn",)),
    "sin": (("lstm", "gru", "hb2"), ("fnn_hib", "hb1"), ("backlash", "pi"), ("fnn",)),
}


@dataclass(frozen=True)
class Printed:
    """Number or sign of a paper.

    Attributes:
        mark: how it is known.
        above: printed as "more than this".
    """

    value: float | str
    mark: Mark = "P"
    above: bool = False

    def __str__(self) -> str:
        text = f"{self.value:g}" if isinstance(self.value, float | int) else self.value
        return f"{'> ' if self.above else ''}{text} [{self.mark}]"


# S2 Fig. 8 by its text: (motion, direction, kind) to error relative to the FNN's, mean and maximum [%].
S2_RELATIVE: Final[dict[tuple[str, str, str], tuple[Printed, Printed]]] = {
    ("sin", "forward", "lstm"): (Printed(17), Printed(23)),
    ("sin", "inverse", "lstm"): (Printed(23), Printed(66)),
    ("p2p", "forward", "hb2"): (Printed(43), Printed(55)),
    ("p2p", "inverse", "hb2"): (Printed(39), Printed(68)),
    ("p2p", "forward", "fnn_hib"): (Printed(66), Printed(65)),
    ("p2p", "inverse", "fnn_hib"): (Printed(64), Printed(100, above=True)),
}
# Mean error of the FNN on a branch of the loop [deg].
S2_FNN_BIAS_DEG: Final = {"sin": Printed(2.5), "p2p": Printed(2.25)}


def s2_symbol(motion: str, direction: str, row: str, column: str) -> Printed | None:
    """Sign of S2 Table I, None if unknown."""
    both = {"p2p": _P2P, "sin": _SIN}[motion].get(row, {}).get(column)
    if both is None:
        return None
    return Printed(both.split("/")[0 if direction == "forward" else 1], "P" if motion == "p2p" else "I")


# Root mean square error on validation windows, in names of published checkpoints: (direction, motion) by kind,
# forward in deg, inverse in mm.
S2_VALIDATION: Final[dict[tuple[str, str], dict[str, Printed]]] = {
    ("forward", "sin"): {
        "fnn": Printed(2.22, "C"), "backlash": Printed(0.76, "C"), "pi": Printed(1.45, "C"), "lstm": Printed(0.71, "C"),
        "gru": Printed(0.70, "C"), "fnn_hib": Printed(0.73, "C"), "hb1": Printed(0.45, "C"), "hb2": Printed(0.49, "C"),
    },
    ("forward", "p2p"): {
        "fnn": Printed(2.38, "C"), "backlash": Printed(0.63, "C"), "pi": Printed(1.96, "C"), "lstm": Printed(1.72, "C"),
        "gru": Printed(1.62, "C"), "fnn_hib": Printed(1.25, "C"), "hb1": Printed(0.50, "C"), "hb2": Printed(0.75, "C"),
    },
    ("inverse", "sin"): {
        "fnn": Printed(0.239, "C"), "backlash": Printed(0.106, "C"), "pi": Printed(0.118, "C"),
        "lstm": Printed(0.085, "C"), "gru": Printed(0.080, "C"), "fnn_hib": Printed(0.105, "C"),
        "hb1": Printed(0.077, "C"), "hb2": Printed(0.072, "C"),
    },
    ("inverse", "p2p"): {
        "fnn": Printed(0.251, "C"), "backlash": Printed(0.087, "C"), "pi": Printed(0.108, "C"),
        "lstm": Printed(0.163, "C"), "gru": Printed(0.143, "C"), "fnn_hib": Printed(0.126, "C"),
        "hb1": Printed(0.072, "C"), "hb2": Printed(0.077, "C"),
    },
}  # fmt: skip

# Mean square error on validation windows in units of theta/90, by samples in a window (1e-4).
S2_WINDOWS: Final[dict[str, dict[int, Printed]]] = {
    "lstm": {
        n: Printed(v, "C")
        for n, v in zip((2, 10, 20, 30, 40, 50, 100), (9.7, 4.3, 2.4, 1.8, 1.3, 1.1, 0.61), strict=True)
    },
    "fnn_hib": {
        n: Printed(v, "C")
        for n, v in zip((1, 2, 10, 20, 30, 40, 50, 100), (11.9, 6.7, 2.7, 1.15, 0.72, 0.56, 0.46, 0.29), strict=True)
    },
}

# S1 Table III: by kind and test RMSE [deg], maximum error [deg], NRMSE [%].
S1_ERRORS: Final[dict[str, dict[str, tuple[Printed, Printed, Printed]]]] = {
    kind: {f"test_{test}": (Printed(a), Printed(b), Printed(c)) for test, (a, b, c) in zip("abcd", rows, strict=True)}
    for kind, rows in {
        "drdpi": ((1.40, 6.23, 4.54), (1.22, 2.83, 6.28), (1.07, 4.28, 4.99), (1.48, 2.98, 6.07)),
        "svr": ((0.76, 1.83, 2.45), (0.80, 3.54, 4.10), (0.76, 1.69, 3.56), (0.92, 2.01, 3.78)),
        "lstm": ((0.36, 1.23, 1.17), (0.82, 2.27, 4.20), (0.50, 1.92, 2.34), (0.59, 1.93, 2.42)),
    }.items()
}


@dataclass(frozen=True)
class PrintedTraining:
    """Row of S1 Table IV.

    Attributes:
        loss: training loss; the paper's header says deg^2 for all.
        change_percent: mean relative change of the loss over the last 10 % of the iterations [%].
        unit: that its number has by comparison with Table III.
    """

    iterations: Printed
    loss: Printed
    change_percent: Printed
    unit: Printed
    time: str


S1_TRAINING: Final = {
    "drdpi": PrintedTraining(Printed(1000), Printed(0.344), Printed(0.013), Printed("deg^2", "I"), "3.5 h"),
    "svr": PrintedTraining(Printed(100), Printed(0.002782), Printed(0.708), Printed("normalised", "I"), "-"),
    "lstm": PrintedTraining(Printed(50), Printed(0.00056), Printed(0.190), Printed("normalised", "I"), "10 min"),
}
S1_HALF_RANGE_DEG: Final = Printed(15.4, "I")


SOURCES = {
    "s1": "simulated: the pressure-driven catheter of S1 as this package simulates it (hystmpc.sim.devices)",
    "s2": "simulated: the tendon catheter of S2 as this package simulates it (hystmpc.sim.devices)",
    "real": "real: recorded logs",
}


def label(study: str) -> str:
    """Label `simulated` or `real` of every table and figure."""
    return SOURCES[study].partition(":")[0]


def paper_set_up(outcome: PaperOutcome) -> Iterator[Piece]:
    """Set-up of the study: settings, kinds left out, failed jobs."""
    settings = outcome.settings
    facts = {
        "trials": SOURCES[settings.study],
        "kinds of model": ", ".join(settings.kinds),
        "not in the catalogue, left out": ", ".join(settings.left_out) or "none",
        "presets": ", ".join(outcome.presets),
        "directions": ", ".join(settings.directions),
        "stages": ", ".join(settings.stages),
        "training": training_note(settings),
        "seed": settings.seed,
    }
    marks = f"Marks of the paper's numbers and signs: {MARKS}. All others are ours, {label(settings.study)}."
    return set_up("", facts, outcome, "" if settings.study == "real" else marks)


def training_note(settings: PaperSettings) -> str:
    """Completed share of the papers' training, in words."""
    if settings.quick:
        return (
            "QUICK: a hundredth of the training on a few shortened trials. The numbers below show that everything "
            "runs, and say nothing about the models."
        )
    if settings.epochs_scale == 1.0:
        return "networks with the preset 'paper' are trained for all of the paper's epochs"
    return (
        f"networks with the preset 'paper' are trained for {settings.epochs_scale:g} of the paper's epochs "
        "(--epochs-scale), which favours models that need little training"
    )


def jobs_table(outcome: PaperOutcome) -> StudyTable:
    """Table of every job, failed ones included."""
    rows: list[list[Cell]] = []
    for result in outcome.results:
        job = result.job
        what: list[Cell] = [job.stage, title_of(job.kind), job.preset, job.direction, job.train]
        beta: Cell = NOTHING if job.constancy is None else job.constancy
        steps: Cell = "preset's" if job.steps is None else job.steps
        rows.append([*what, beta, steps, result.samples, round(result.seconds, 1), result.status, result.message])
    columns = ("stage", "model", "preset", "direction", "trained on", "beta", "steps", "samples", "time [s]")
    caption = f"Every job ({label(outcome.settings.study)}); time is wall time on one thread."
    return StudyTable("jobs", (*columns, "status", "fit or error"), rows, caption)


def jobs_pieces(outcome: PaperOutcome) -> Iterator[Piece]:
    """Heading and table of the jobs."""
    yield Heading("Jobs")
    yield jobs_table(outcome).piece
