"""Subcommand `diagnose`: causes of the gap between a simulator and its device, and the motion to record next."""

from __future__ import annotations

import sys
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from hystmpc.trials.errors import ConfigError
from hystmpc.trials.json_text import file_text, plain

from .bars import Pace, progress_of
from .console import line, out, say, table
from .verb import OPTIONAL, SIM, Call, verb

if TYPE_CHECKING:
    from hystmpc.gap.diagnosis import Diagnosis
    from hystmpc.gap.two_axes.diagnosis import TwoAxisDiagnosis

FAILED = 1
_REPORT = 10  # steps of the report, after the hundred of the diagnosis
# Three rounds of the selection, as measured on logs of a catheter with a simulator identified from other logs.
_PACE: Pace = ((0, 0), (0.05, 0.12), (0.34, 0.31), (0.51, 0.44), (0.62, 0.57), (0.77, 0.6), (0.91, 0.69), (1, 1))


@verb(
    "diagnose:diagnose",
    trials={"metavar": "LOG...", "help": "Trials of one device, or folders of *.csv.", **OPTIONAL},
    simulator={"help": f"{SIM['help'].rstrip('.')}; or your own: an .fmu, or a .yaml that names a class.", **OPTIONAL},
    out={"help": "Folder to write: new, empty, or an older diagnosis."},
    seed={"min": 0},
    jobs={"help": "Processes in which a simulator of your own runs; one a core where left out.", "min": 1, **OPTIONAL},
)
def diagnose(
    call: Call,
    as_json: Annotated[bool, typer.Option("--json", help="Print diagnosis.json and nothing else.")] = False,
    self_test: Annotated[
        bool, typer.Option("--self-test", help="Recover known truths instead of reading logs.")
    ] = False,
) -> None:
    """The exit code is 0 for any verdict.

    Raises:
        ConfigError: if logs or folder are missing.
    """
    if self_test:
        _self_test(call.seed)
        return
    given = {"LOG...": call.trials, "--out": call.out}
    if absent := [name for name, value in given.items() if not value]:
        raise ConfigError(f"diagnose: lacks {', '.join(absent)}, expected LOG... --sim SIM --out DIR, or --self-test")
    diagnosis: Diagnosis | TwoAxisDiagnosis = call.run("diagnose", pace=_PACE, after=_REPORT)
    from hystmpc.gap.two_axes.diagnosis import TwoAxisDiagnosis

    if as_json:
        sys.stdout.write(file_text(plain(diagnosis.as_json()), indent=2))
        return
    if isinstance(diagnosis, TwoAxisDiagnosis):
        from hystmpc.gap.two_axes.words import headlines

        for text in headlines(diagnosis):
            line(text)
    else:
        print_diagnosis(diagnosis)
    line(f"report: {call.out / 'report.html'}")


def print_diagnosis(diagnosis: Diagnosis) -> None:
    """Print the verdict, the sizes of the gap, the effects, and the motion to record next."""
    from hystmpc.gap.report import words
    from hystmpc.gap.report.words import in_words, percent

    said = (
        words.closed_sentence,
        words.stand_in_sentence,
        words.confirmed_sentence,
        words.mis_set_sentence,
        words.stability_sentence,
        words.tracking_sentence,
    )
    sentences = (*(sentence(diagnosis) for sentence in said), *words.order_sentences(diagnosis))
    for text in filter(None, (words.headline(diagnosis), diagnosis.reason, *sentences)):
        line(text)
    if diagnosis.ranking:
        named = {effect.name: effect for effect in diagnosis.effects}
        rows = []
        for name, probability in diagnosis.ranking[:6]:
            effect = named.get(name)
            shares = ("", "", "")
            if effect is not None:
                low, high = effect.closed_ci90
                values = words.parameter_words(effect)
                shares = (percent(effect.closed_share), f"{percent(low)} to {percent(high)}", values)
            rows.append([in_words(name), percent(probability), *shares])
        out.print(table("effects", ("effect", "probability", "closes", "90 % interval", "parameters"), rows))
    if (motion := diagnosis.next_motion) is not None:
        names = ", ".join(in_words(name) for name in motion.separates)
        line(f"next: record {motion.file} ({motion.duration_s:.0f} s) to tell apart {names}")


def _self_test(seed: int) -> None:
    from hystmpc.gap.self_test import self_test

    with progress_of("self-test") as progress:
        rows = [asdict(row) for row in self_test(seed, progress)]
    out.print(table("self-test", list(rows[0]), [[_text(value) for value in row.values()] for row in rows]))
    if not all(row["passed"] for row in rows):
        say("self-test: not every truth was recovered", style="red")
        raise typer.Exit(FAILED)


def _text(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.3g}" if isinstance(value, float) else str(value)
