"""The way from what a log does to what looks best in it: how many times its margin a policy lowers Q by.

With pessimism a policy goes by Q̂ − (1 − ℓ)·M, ℓ how much the log leans to an action and M the margin of its Q̂. The
more M is multiplied by, the surer a deviation from the log has to be; those that are left are where the lower bound of
their advantage is largest, as in safe policy improvement [LarocheTrichelairTachet2019]_.
"""

import copy
from dataclasses import replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from halfseen.learning.q_learner import CensoredQLearner


def has_margin(policy: Any) -> bool:
    """Whether a policy can be more cautious than it is."""
    return getattr(policy, "margin", None) is not None


def more_cautious(policy: Any, times: float) -> Any:
    """The same policy with so many times its margin; as it is where it has none."""
    return replace(policy, margin=times * policy.margin) if has_margin(policy) and times != 1.0 else policy


def more_cautious_learner(learner: "CensoredQLearner", times: float) -> "CensoredQLearner":
    """A learner whose policy is more cautious; the one given stays as it is."""
    cautious = copy.copy(learner)
    cautious.policy_ = more_cautious(learner.policy_, times)
    cautious.model_ = replace(learner.model_, pessimism=times * learner.model_.pessimism)
    return cautious
