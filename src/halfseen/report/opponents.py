"""What a policy was compared with, by the names that the page gives them."""

from halfseen.evaluation import Estimate, Evaluation
from halfseen.evaluation.verdict import Verdict


def values_of(evaluation: Evaluation) -> dict[str, Estimate]:
    """What each opponent earns; the logging policy comes first, whether or not it is one."""
    known = {_short(each.opponent): each.value for each in evaluation.comparisons if each.value is not None}
    return {"logging policy": evaluation.logging, **known}


def gains_of(evaluation: Evaluation) -> dict[str, tuple[Estimate, Verdict]]:
    """How much more the learned policy earns than each opponent, with the verdict on that."""
    gains: dict[str, tuple[Estimate, Verdict]] = {
        f"learned − {_short(each.opponent)}": (each.difference, each.verdict)
        for each in evaluation.comparisons
        if each.difference is not None
    }
    return gains or {"learned − logging policy": (evaluation.difference, evaluation.verdict)}


def _short(name: str) -> str:
    return name.removeprefix("the ")
