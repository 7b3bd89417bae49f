"""What can be claimed of a policy, what is guessed, and how long a log would decide, in plain words."""

from halfseen.evaluation.advice import paths_that_decide
from halfseen.evaluation.comparison import deciding
from halfseen.evaluation.evaluation import Evaluation


def claim_of(found: Evaluation) -> str:
    """The least that a policy earns more than each of its opponents."""
    if found.verdict != "better":
        return "nothing; no policy on the way from what the log does to the best guess is surely better"
    return f"at least {found.difference.low:.3g}{_unit(found)} more a path than {deciding(found.comparisons).opponent}"


def guess_of(found: Evaluation) -> str:
    """What a policy earns more than the opponent that is hardest to beat, and what is still to be recorded."""
    main = deciding(found.comparisons)
    if main.difference is None or main.p is None:
        return f"unknown; {main.reason}"
    gain = main.difference.value
    told = f"{abs(gain):.3g}{_unit(found)} {'more' if gain > 0 else 'less'} a path than {main.opponent}"
    if found.verdict == "better":
        return told
    return f"{told}, not yet provable; {paths_that_decide(main.difference, found.num_paths)}"


def _unit(found: Evaluation) -> str:
    return f" {found.reward_unit}" if found.reward_unit else ""
