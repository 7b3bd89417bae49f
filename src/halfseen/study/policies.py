"""Who takes part: the policy that fills the logs, and the baselines."""

from halfseen.planners.heuristics import GreedyPolicy
from halfseen.planners.pomdp import POMDPPolicy
from halfseen.study.design import LOG_RANDOM_SHARE, StudyDesign
from halfseen.world.policy import ExploringPolicy, Policy

HEURISTICS = ("greedy", "history", "greedy-penalty", "history-penalty")


def heuristics(design: StudyDesign) -> dict[str, GreedyPolicy]:
    """The four rules of thumb, by name."""
    return {
        name: GreedyPolicy(
            design.world, uses_history=name.startswith("history"), counts_penalty=name.endswith("penalty")
        )
        for name in HEURISTICS
    }


def planners(design: StudyDesign) -> dict[str, Policy]:
    """The POMDP planner at each planning horizon, by name."""
    return {f"pomdp-{h}": POMDPPolicy(design.world, h, design.planning_simulations) for h in design.planning_horizons}


def logging_policy(design: StudyDesign) -> ExploringPolicy:
    """The best heuristic, with a share of the actions drawn by lot."""
    best = GreedyPolicy(design.world, uses_history=True, counts_penalty=True)
    return ExploringPolicy(best, LOG_RANDOM_SHARE)
