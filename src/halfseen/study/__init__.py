"""The study: one runner, one pipeline, and an experiment for each question.

Read down: `policies` (the registry of who takes part) → `pipeline` (play → encode → cut → treat → learn → evaluate) →
`timing` (how long a decision takes) → `experiment` (what an experiment is) → `experiments` (the questions, each
with its configuration, repetition, tables, figure and claim) → `store`, `runner` (what is done stays done) → `report`
→ `run` (all of it).
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.study.experiment import Experiment, Setting
    from halfseen.study.report import StudyResults
    from halfseen.study.run import run_study

__all__ = ["Experiment", "Setting", "StudyResults", "run_study"]

__getattr__ = lazy_names(
    __name__, {"Experiment": "experiment", "Setting": "experiment", "StudyResults": "report", "run_study": "run"}
)
