"""Design → run → compare → report: Figures 1, 4 and 5, Tables 1 and 3.

Read down: `design` → `policies` (who takes part) → `scenes` (the captured tables) → `treatments` (of cut paths) →
`learning` → `repetition` (one of many) → `grasp` (the ablation of grasp models, with its tables, figure and words) →
`timing` → `store` (what is done stays done) → `statistics` → `tables` → `results` → `figures`, `sentences`, `report` →
`run` (all of it).
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.study.design import StudyDesign
    from halfseen.study.results import StudyResults
    from halfseen.study.run import run_study

__all__ = ["StudyDesign", "StudyResults", "run_study"]

__getattr__ = lazy_names(__name__, {"StudyDesign": "design", "StudyResults": "results", "run_study": "run"})
