"""Open Bandit [Saito et al. 2021]: the value of one policy from the other's log, beside what that one earned.

python benchmarks/published/open_bandit.py [--out …/open_bandit.json]

The package `obp` ships a sample: of each of three campaigns 10,000 recommendations of fashion items at one of three
positions by a uniformly random policy, and 10,000 by Thompson sampling, with the probability of each and whether it was
clicked. The policies to evaluate are Thompson sampling as `obp` has it, and the uniform one. Ours is `evaluate` with
the position as the covariate; theirs are obp's own estimators, its regression a logistic one for each position, and its
intervals by bootstrap. What was earned is the mean of the other log, with Wilson's interval.

obp 0.5.7 asks for Python below 3.11 and for PyTorch, which nothing here uses; absent packages are replaced by empty
ones while it loads.
"""

import importlib
import logging
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pandas as pd
from peers.side_by_side import asked, markdown, run, skip
from scipy.stats import binomtest
from sklearn.linear_model import LogisticRegression

from halfseen.evaluation import evaluate
from halfseen.logs import Logs

PACKAGE = "obp==0.5.7"
ABSENT = ("torch", "pyieoe", "pingouin", "seaborn", "mypy_extensions")
OF_TORCH = ("nn", "nn.functional", "optim", "utils", "utils.data")
CAMPAIGNS = ("all", "men", "women")
EVALUATED = {"Thompson": ("random", "bts"), "random": ("bts", "random")}
"""Policy: whose log it is evaluated from, and where it is seen what it earns."""
ESTIMATORS = {
    "IPW": "InverseProbabilityWeighting",
    "SNIPW": "SelfNormalizedInverseProbabilityWeighting",
    "DM": "DirectMethod",
    "DR": "DoublyRobust",
    "SNDR": "SelfNormalizedDoublyRobust",
}
NUM_DRAWS, NUM_BOOTSTRAPS, LEVEL = 100_000, 1000, 0.95


@contextmanager
def stand_ins() -> Iterator[None]:
    """Let empty modules stand for what is not installed."""
    absent = [name for name in ABSENT if find_spec(name) is None]
    made = [*absent, *(f"torch.{part}" for part in OF_TORCH if "torch" in absent)]
    for name in made:
        sys.modules[name] = MagicMock(Tensor=type(name, (), {}), Module=type(name, (), {}), Dataset=type(name, (), {}))
    for name in made:
        parent, _, part = name.rpartition(".")
        if parent:
            setattr(sys.modules[parent], part, sys.modules[name])
    yield
    for name in made:
        del sys.modules[name]


def loaded() -> Any:
    """The package obp."""
    try:
        with stand_ins():
            return importlib.import_module("obp")
    except ModuleNotFoundError as error:
        skip(f"{error.name} is not installed: pip install --no-deps --ignore-requires-python {PACKAGE} PyYAML")


class PositionPolicy:
    """π(item | position), as `evaluate` takes it."""

    covariates = ("position",)
    horizon = 1

    def __init__(self, actions: Sequence[str], chance: np.ndarray) -> None:
        self.actions, self.chance = tuple(actions), chance

    def probabilities(self, frame: pd.DataFrame, stage: int) -> np.ndarray:
        return self.chance[:, frame["position"].to_numpy(dtype=int)].T


def log_of(rounds: dict[str, Any], actions: list[str]) -> Logs:
    """Each recommendation as a trajectory of one stage, of one second."""
    numbers, ones = np.arange(rounds["n_rounds"]), np.ones(rounds["n_rounds"])
    stages = {
        "trajectory": numbers,
        "stage": np.ones(len(numbers), dtype=int),
        "elapsed_s": ones,
        "action": np.array(actions, dtype=object)[rounds["action"]],
        "reward": rounds["reward"].astype(float),
        "probability": rounds["pscore"],
        "position": rounds["position"],
    }
    ends = {"trajectory": numbers, "end_s": ones, "ending": ["finished"] * len(numbers)}
    return Logs(pd.DataFrame(stages), pd.DataFrame(ends))


def theirs(obp: Any, rounds: dict[str, Any], chance: np.ndarray) -> dict[str, list[float]]:
    """Value and interval by each of obp's estimators."""
    size, num_actions, num_positions = rounds["n_rounds"], rounds["n_actions"], chance.shape[1]
    given = {name: rounds[name] for name in ("reward", "action", "position", "pscore")}
    given["action_dist"] = np.broadcast_to(chance, (size, *chance.shape))
    regression = obp.ope.RegressionModel(
        n_actions=num_actions, len_list=num_positions, base_model=LogisticRegression(max_iter=1000)
    )
    context = np.ones((size, 1))
    predicted = regression.fit_predict(context=context, n_folds=3, random_state=0, **given)
    found = {}
    for name in ESTIMATORS:
        estimator = getattr(obp.ope, ESTIMATORS[name])()
        wanted = given if name.endswith("IPW") else given | {"estimated_rewards_by_reg_model": predicted}
        wanted = (
            {**wanted} if name != "DM" else {k: v for k, v in wanted.items() if k not in ("reward", "action", "pscore")}
        )
        value = estimator.estimate_policy_value(**wanted)
        around = estimator.estimate_interval(**wanted, n_bootstrap_samples=NUM_BOOTSTRAPS, random_state=0)
        found[name] = [float(value), *(float(around[f"95.0% CI ({end})"]) for end in ("lower", "upper"))]
    return found


def measured(obp: Any, campaign: str, policy: str) -> dict[str, Any]:
    """A policy, evaluated from the other's log."""
    source, own = (
        obp.dataset.OpenBanditDataset(behavior_policy=name, campaign=campaign).obtain_batch_bandit_feedback()
        for name in EVALUATED[policy]
    )
    num_actions, actions = source["n_actions"], [f"item {k:02d}" for k in range(source["n_actions"])]
    chance = np.full((num_actions, 3), 1.0 / num_actions)
    if policy == "Thompson":
        chance = obp.policy.BernoulliTS(
            n_actions=num_actions, len_list=3, is_zozotown_prior=True, campaign=campaign, random_state=0
        ).compute_batch_action_dist(n_rounds=1, n_sim=NUM_DRAWS)[0]
    clicks = int(own["reward"].sum())
    earned = binomtest(clicks, own["n_rounds"]).proportion_ci(LEVEL, "wilson")
    ours = evaluate(PositionPolicy(actions, chance), log_of(source, actions), against="logging")
    value = ours.doubly_robust
    return {
        "campaign": campaign,
        "policy": policy,
        "earned": [clicks / own["n_rounds"], earned.low, earned.high],
        "estimates": {"ours": [value.value, value.low, value.high], **theirs(obp, source, chance)},
        "verdict": ours.verdict,
    }


def tables(report: dict[str, Any]) -> str:
    names = list(report["rows"][0]["estimates"])
    head = ["campaign, policy", "earned", *names, "verdict"]
    rows = [
        [
            f"{row['campaign']}, {row['policy']}",
            cell(row["earned"]),
            *(cell(row["estimates"][name]) for name in names),
            row["verdict"],
        ]
        for row in report["rows"]
    ]
    return f"*Clicks in a thousand (95 % interval)*\n\n{markdown(head, rows)}"


def cell(estimate: list[float]) -> str:
    value, low, high = (round(1000.0 * each, 1) + 0.0 for each in estimate)
    return f"{value:.1f} ({low:.1f} to {high:.1f})".replace("-", "−")


def main() -> None:
    options = asked(__doc__, "open_bandit", 1).parse_args()
    logging.disable(logging.INFO)
    obp = loaded()
    cells = [(obp, campaign, policy) for campaign in CAMPAIGNS for policy in EVALUATED]
    run(options.out, cells, measured, tables, package=PACKAGE)


if __name__ == "__main__":
    main()
