"""What can be claimed of a policy, what is guessed, and how long a log would decide, in plain words."""

import numpy as np

from halfseen.evaluation.comparison import deciding
from halfseen.evaluation.evaluation import Evaluation
from halfseen.evaluation.verdict import Needed


def claim_of(found: Evaluation) -> str:
    """The least that a policy earns more than each of its opponents."""
    if found.verdict != "better":
        return "nothing; no policy on the way from what the log does to the best guess is surely better"
    opponent = deciding(found.comparisons).opponent
    return f"at least {found.difference.low:.3g}{_unit(found)} more a trajectory than {opponent}"


def guess_of(found: Evaluation) -> str:
    """What a policy earns more than the opponent that is hardest to beat, and what is still to be recorded."""
    main = deciding(found.comparisons)
    if main.difference is None or main.p is None:
        return f"unknown; {main.reason}"
    gain = main.difference.value
    told = f"{abs(gain):.3g}{_unit(found)} {'more' if gain > 0 else 'less'} a trajectory than {main.opponent}"
    if found.verdict == "better":
        return told
    return f"{told}, not yet provable; {more_trajectories(main.needed, found.num_trajectories)}"


def more_trajectories(needed: Needed | None, num_trajectories: int) -> str:
    """How many more trajectories would decide."""
    if needed is None or np.isinf(needed.times):
        return "no log of a size that can be recorded would show so small a difference"

    def more(times: float) -> str:
        number = (times - 1.0) * num_trajectories
        size = 10.0 ** max(np.floor(np.log10(max(number, 1.0))) - 1.0, 0.0)
        return f"{np.ceil(number / size) * size:,.0f}"

    most = more(needed.high) if np.isfinite(needed.high) else "many"
    return f"about {more(needed.times)} more trajectories like these would decide ({more(needed.low)} to {most})"


def _unit(found: Evaluation) -> str:
    return f" {found.reward_unit}" if found.reward_unit else ""
