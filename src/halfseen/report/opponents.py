"""What a policy was compared with, by the names that the page gives them."""

from halfseen.evaluation import Estimate, Evaluation
from halfseen.evaluation.verdict import Verdict


def values_of(evaluation: Evaluation) -> dict[str, Estimate]:
    """What each opponent earns; the logging policy comes first, whether or not it is one."""
    known = {_short(each.opponent): each.value for each in evaluation.comparisons if each.value is not None}
    return {"logging policy": evaluation.logging, **known}


def shares_of(evaluation: Evaluation) -> dict[str, Estimate | None]:
    """What each opponent earns as a multiple of what the logging policy does; None where that is not known."""
    shares = {_short(each.opponent): each.share for each in evaluation.comparisons if each.value is not None}
    today = next((each.share for each in evaluation.comparisons if each.value == evaluation.logging), None)
    if today is None and evaluation.share is not None:
        # Of what is known to be above 0, it is itself.
        today = Estimate(1.0, 1.0, 1.0, 0.0, evaluation.logging.effective_sample_size)
    return {"logging policy": today, **shares}


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
