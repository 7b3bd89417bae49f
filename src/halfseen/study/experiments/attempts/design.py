"""The configuration of the experiment, and the models."""

from dataclasses import dataclass
from typing import NamedTuple

from halfseen.cell.calibration import law_folder
from halfseen.figures import BLUE, INK, ORANGE, PINK, RED, SKY

RATE, BETA, SVM, SVM_FACTS, SVM_SET, LAW = "rate", "beta", "svm", "svm-facts", "svm-set", "law"
MODEL_NAMES = {
    RATE: "one rate for all",
    BETA: "Beta mean",
    SVM: "SVM",
    SVM_FACTS: "SVM with pose, width, room",
    SVM_SET: "SVM, set kernel",
    LAW: "logistic law",
}
"""Model of the probability that an attempt holds → name for people."""
MODEL_COLOURS = {RATE: ORANGE, BETA: BLUE, SVM: RED, SVM_FACTS: SKY, SVM_SET: PINK, LAW: INK}
SVMS = (SVM, SVM_FACTS, SVM_SET)
MEASURES = {"log_loss": "log-loss", "brier": "Brier score"}
"""What models are judged by, on tables that they have not seen; smaller is better."""
SCORE = "log_loss"
"""The measure that the answer is told by."""
PAIRS = ((SVM, BETA), (SVM_FACTS, BETA), (SVM_SET, BETA), (LAW, BETA), (SVM_SET, LAW))
"""Who is tested against whom; the first is the paper's claim."""
WIDTH_WANTED = 0.03
"""Half of the width that the interval of a calibration is to have, where a bin holds `SHARE_OF_A_BIN`."""
SHARE_OF_A_BIN = 0.1
NUM_PREDICTION_BINS = 5
"""Groups of attempts by what was predicted of them, alike in number."""


class Planner(NamedTuple):
    """A way to plan grasps, of which a law's folder may hold attempts."""

    folder: str
    words: str


COMPLETED, VISIBLE_ONLY = "completed", "visible-only"
PLANNERS = {
    COMPLETED: Planner(law_folder.ATTEMPTS, "where hidden shape is completed"),
    VISIBLE_ONLY: Planner(law_folder.VISIBLE_ONLY, "where only visible points count"),
}


@dataclass(frozen=True)
class AttemptsDesign:
    """Models that are learned from the attempts at `num_tables` tables, and scored on tables apart.

    All tables are dealt into `num_folds`; each fold is held out in turn, and after that all are dealt anew. A
    repetition is one fold.
    """

    num_tables: tuple[int, ...] = (25, 50, 100, 200, 400, 600)
    num_folds: int = 4
    most_repetitions: int | None = 20
