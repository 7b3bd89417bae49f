"""The study: one runner, one pipeline, and an experiment for each question.

Read down: `setting` → `policies` (the contenders, and their decision times) → `pipeline` (play → cut → treat → learn →
evaluate) → `experiment` (the interface of experiments, and their texts) → `compare`, `figures` (tidy tables, paired
tests, points with intervals) → `experiments` (the questions) → `runner` (resumable runs) → `report`.
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.study.experiment import Experiment
    from halfseen.study.report import StudyResults
    from halfseen.study.runner import run_study
    from halfseen.study.setting import Setting

__all__ = ["Experiment", "Setting", "StudyResults", "run_study"]

__getattr__ = lazy_names(
    __name__, {"Experiment": "experiment", "Setting": "setting", "StudyResults": "report", "run_study": "runner"}
)
