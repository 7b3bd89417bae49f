"""Made-up pieces of the planners, for the tests of what is tabulated, drawn and written from them."""

import numpy as np

from halfseen.study.planning import episodes_in_turn
from halfseen.study.policies import HEURISTICS

NUM_ALL = 20
NUM_REPETITIONS = 6
OWN_REWARD = 9.0
TIMES_MS = {
    "cql": 0.02,
    "greedy": 0.011,
    "history": 0.026,
    "greedy-penalty": 0.0112,
    "history-penalty": 0.0265,
    "pomdp-1": 0.08,
    "pomdp-2": 4.1,
    "pomdp-3": 4.2,
    "pomdp-4": 4.25,
    "pomdp-5": 4.3,
    "pomdp-6": 4.31,
    "search-16": 0.4,
    "search-400": 6.0,
    "search-5000": 76.0,
    "search-50000": 810.0,
}
FEW = {"search-5000": 10, "search-50000": 2}


def example_pieces(lead: float = 0.0, hurts_at: int | None = None, noise: float = 0.3) -> list[dict]:
    """Make pieces in which searches end `lead` away from the learned policy.

    Parameters
    ----------
    lead
        Of the searches over the learned policy; other planners stay 1 below it.
    hurts_at
        Planning horizon from which on the planner earns 1 less.
    noise
        Standard deviation of what a policy's single episode adds to what all policies meet.
    """
    rng = np.random.default_rng(0)
    rewards = {"cql": OWN_REWARD} | dict(zip(HEURISTICS, (3.1, 3.4, 6.3, 6.6), strict=True))
    rewards |= {f"pomdp-{h}": OWN_REWARD - 1.0 - (hurts_at is not None and h >= hurts_at) for h in range(1, 7)}
    rewards |= {f"search-{size}": OWN_REWARD + lead for size in (16, 400, 5000, 50000)}
    pieces = []
    for repetition in range(NUM_REPETITIONS):
        luck = rng.normal(0.0, 8.0, NUM_ALL)
        rows = []
        for name, reward in rewards.items():
            episodes = episodes_in_turn(repetition, FEW.get(name), NUM_ALL)
            earned = reward + luck[episodes] + noise * rng.normal(size=len(episodes))
            row = {"policy": name, "episodes": episodes, "reward": earned.tolist()}
            rows.append(row | {"robot_s": (30.0 + luck[episodes]).tolist()})
        pieces.append({"repetition": repetition, "played": rows})
    return pieces


def example_times(slower: float = 1.0) -> dict[str, np.ndarray]:
    """Decision times on twelve states, and on four of the slowest planner; planners may all be slower."""
    times = {}
    for name, median in TIMES_MS.items():
        factor = slower if name.startswith(("pomdp", "search")) else 1.0
        times[name] = factor * median * np.linspace(0.9, 1.1, 4 if name == "search-50000" else 12)
    return times
