"""What `CensoredQLearner` takes where nothing is said: one strong recipe, and a choice only where logs can tell.

Imputed targets, for weights make noise and completed stages alone mislead; a quadratic with a smooth remainder, or what
a task's own features are made for, a linear Q; and Q at its lower confidence bound. `benchmarks/learners.py` compares
the recipe with others, on logs that it was not chosen on.
"""

from typing import Literal

from halfseen.learning.q_space import SMOOTH, LinearQ, QSpace
from halfseen.learning.targets import BuckleyJames, Targets, Weighted
from halfseen.learning.task import Task
from halfseen.logs import Logs, LogStream

AUTO: Literal["auto"] = "auto"

PESSIMISM = 2.0
"""Standard errors by which the value of a whole path is lowered, were the errors of its stages independent."""

Source = Logs | LogStream | None


def automatic_targets(logs: Source) -> Targets:
    """Impute what cuts took away; weights where the action of a stage in which a path was cut is not known."""
    return BuckleyJames() if logs is None or logs.has_all_actions else Weighted()


def automatic_space(task: Task) -> QSpace:
    """Smooth in plain covariates; linear in the features that a task makes for each action."""
    return SMOOTH if task.is_shared else LinearQ()


def automatic_pessimism(is_fixed: bool, horizon: int) -> float:
    """2/√T for each of T stages, whose margins add up; 0, eq. 3 as it is, where targets are fixed."""
    return 0.0 if is_fixed else PESSIMISM / horizon**0.5
