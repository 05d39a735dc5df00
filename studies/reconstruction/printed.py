"""What S1 prints of its reconstruction, to stand beside ours; no computation uses these numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

PRINTED: Final = "printed in the paper"
INFERRED: Final = "inferred [I]"


@dataclass(frozen=True)
class PrintedValue:
    """A number of the paper.

    Attributes:
        value: in the unit of its table.
        mark: `PRINTED`, or `INFERRED` where it was worked out from printed ones.
    """

    value: float
    mark: str = PRINTED

    def __str__(self) -> str:
        return f"{self.value:g}" + (" [I]" if self.mark == INFERRED else "")


# Mean reconstruction error by model and pattern [mm]. DRDPI: the LSTM's over one less its printed reduction; of these
# "the smallest ... is 0.54 mm" is printed in the conclusion.
PAPER_ERROR_MM: Final = {
    ("LSTM", "I"): PrintedValue(0.16),
    ("LSTM", "II"): PrintedValue(0.16),
    ("LSTM", "III"): PrintedValue(0.25),
    ("DRDPI", "I"): PrintedValue(0.54, INFERRED),
    ("DRDPI", "II"): PrintedValue(0.54, INFERRED),
    ("DRDPI", "III"): PrintedValue(0.69, INFERRED),
}
# How much lower the LSTM's error is than the DRDPI's, by pattern [%].
PAPER_REDUCTION_PERCENT: Final = {"I": PrintedValue(70.4), "II": PrintedValue(70.4), "III": PrintedValue(63.8)}
# Mean error of the planar section of pattern I at 45 deg, by model [mm].
PAPER_SECTION_I_MM: Final = {"LSTM": PrintedValue(0.22), "DRDPI": PrintedValue(0.58)}
# "around 1 mm" and "ca. 2 mm" at the edge of the cap [mm].
PAPER_EDGE_MM: Final = {"LSTM": PrintedValue(1.0), "DRDPI": PrintedValue(2.0)}
# The Mann-Whitney test rejected equal errors in all three patterns below this p.
PAPER_P: Final = PrintedValue(0.01)


def paper_error(model: str, pattern: str) -> str:
    """The paper's mean error as text, `-` where it has none; a model's name is compared without regard to case."""
    return str(PAPER_ERROR_MM.get((model.upper(), pattern), "-"))


def paper_section(model: str) -> str:
    """The paper's error of the 45 deg section of pattern I as text, `-` where it has none."""
    return str(PAPER_SECTION_I_MM.get(model.upper(), "-"))
