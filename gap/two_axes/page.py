"""Page of a diagnosis of two axes: headlines, what joins the axes, sizes; each axis has a page in its folder."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from hystmpc.models.evaluation_report import free_run_figure
from hystmpc.models.two_axes.evaluate import evaluate_two_axes
from hystmpc.models.two_axes.model import TwoAxisModel
from hystmpc.models.two_axes.report import joint_pieces
from hystmpc.trials.report import Folded, Heading, Paragraph, Piece, Plot, Points, Report, Table
from hystmpc.trials.trial import Trial

from ..report.words import in_words, listed, percent
from .diagnosis import UNITS, TwoAxisDiagnosis
from .words import effect_sentence, headlines, join_actions


def two_axis_report(
    diagnosis: TwoAxisDiagnosis, corrected: TwoAxisModel, final: Sequence[Trial], simulator: str, logs: int
) -> Report:
    """Page of a diagnosis.

    Args:
        corrected: the simulator with all that is named; as given where nothing is.
        final: trials of which the one with the greatest error is drawn.
        simulator: name of its file.
        logs: number of all trials.
    """
    pieces = tuple(_pieces(diagnosis, corrected, final))
    return Report("Sim-to-real gap of two axes", pieces, f"simulator {simulator}, {logs} logs")


def _pieces(diagnosis: TwoAxisDiagnosis, corrected: TwoAxisModel, final: Sequence[Trial]) -> Iterator[Piece]:
    joins = diagnosis.joins
    yield Heading("What it says")
    yield Points(headlines(diagnosis))
    yield Paragraph("The pages of the axes are `x/report.html` and `y/report.html`.")
    if joins.effects:
        yield Heading("What joins the axes otherwise than in the simulator")
        yield Points(tuple(effect_sentence(effect) for effect in joins.effects))
        yield Points(join_actions(diagnosis))
        yield _effects_table(diagnosis)
    for names in joins.ambiguity:
        words = listed([in_words(name) for name in names], "or")
        yield Paragraph(f"With these trials {words} explains the gap as well as the other within its uncertainty.")
    yield Heading("Sizes")
    yield _sizes_table(diagnosis)
    rows = [(in_words(name), error) for name, error in joins.held_out.items()]
    yield Table(("tried between the axes", "error [deg]"), rows, "Errors on parts left out, with corrected axes.")
    what = "with all that is named" if diagnosis.named else "as given"
    runs = [evaluate_two_axes(corrected, trial) for trial in final]
    worst = max(runs, key=lambda run: run.errors.rmse_deg)
    rmse = f"{worst.errors.rmse_deg:.3g} deg"
    text = f"The final trial with the largest error, and the simulator {what}. The RMSE of the tip is {rmse}."
    yield Plot(free_run_figure([worst]), text, zoom=True)
    yield Folded(f"The simulator {what}", tuple(joint_pieces(corrected)))


def _effects_table(diagnosis: TwoAxisDiagnosis) -> Table:
    rows = [
        (in_words(effect.name), key, value, UNITS[effect.name][key], _interval(effect.ci90[key]),
         percent(effect.closed_share), _interval(effect.closed_ci90))
        for effect in diagnosis.joins.effects
        for key, value in effect.parameters.items()
    ]  # fmt: skip
    return Table(
        ("effect", "number", "value", "unit", "90 % interval", "closed share", "90 % interval"),
        rows,
        "The share is that of the gap that neither axis explains alone, on the final trials.",
    )


def _sizes_table(diagnosis: TwoAxisDiagnosis) -> Table:
    gap = diagnosis.joins.gap
    rows = [
        ("simulator as given", gap.nominal_rmse_deg),
        ("with the effects between the axes", gap.joined_rmse_deg),
        ("as given, each axis corrected by its lags and plays", gap.between_rmse_deg),
        ("both", gap.left_rmse_deg),
        ("noise", gap.floor_rmse_deg),
    ]
    text = "Errors of the tip on the final trials, without the mean of each trial: lengths of those of x and y."
    return Table(("", "RMSE [deg]"), rows, text)


def _interval(ends: tuple[float, float]) -> str:
    return f"{ends[0]:.3g} to {ends[1]:.3g}"
