"""Food on a fork [Feng and others, 2019]: trials of a real robot, learned from and judged by what was held out.

python benchmarks/published/real_grasps.py [--out …/real_grasps.json] [--repetitions 20] [--sizes 100 200 …]

A robot skewered eleven foods, which lay alone, on lettuce or against a wall, in six ways: straight down, with tilted
tines or at an angle, along the food or across it; each at least ten times. A trajectory is a trial, of one stage; the
action is the way, covariates are the food and where it lay, and the reward is 1 if the food stayed on the fork. Nothing
was cut, how long trials took was not kept, and the design gives the probability of each way. Foods that were not tried
in all ways are left out (see data/README.md).

Methods learn from some trials, dealt by lot, and are judged by the others: by their mean success where the way is the
one that the method would take. From all trials five policies are learned, each from four fifths, and judged by the rest
as `evaluate` does. *One way* takes for all what succeeded most often, and so does any other where a food or place was
not seen.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from peers.side_by_side import asked, markdown, run
from sklearn.ensemble import RandomForestClassifier
from sklearn.linear_model import LogisticRegression
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import OneHotEncoder, PolynomialFeatures

from halfseen.evaluation import Baseline, FixedSequence, evaluate, held_out_verdict
from halfseen.evaluation.targets import CrossFitted
from halfseen.learning import CensoredQLearner
from halfseen.learning.svm.estimators import CensoredSVC
from halfseen.logs import Logs

DATA = Path(__file__).parent / "data" / "bite_acquisition.csv"
COVARIATES = ["food", "place"]
SIZES = (100, 200, 400, 800, 1600)
NUM_FOLDS = 5
ONE_REG = 0.3
"""λ of all ways, where cross-validation would choose one for each; of this order by these data."""
Choice = np.ndarray
"""Number of the way that is taken, for each row of `contexts`."""


@cache
def trials() -> pd.DataFrame:
    """One row a trial, of the foods that were tried in every way."""
    groups = pd.read_csv(DATA, dtype={"failed": str}).replace({"food": {"red_grape": "grape"}})
    groups["way"] = groups["approach"] + " " + groups["angle"].map({0: "along", 90: "across"})
    every = groups["failed"].map(list)
    each = groups.assign(success=every).explode("success", ignore_index=True)
    each["success"] = (each["success"] == "0").astype(float)
    num_ways = each.groupby("food")["way"].transform("nunique")
    return each.loc[num_ways == each["way"].nunique(), [*COVARIATES, "way", "success"]].reset_index(drop=True)


def ways() -> list[str]:
    return sorted(trials()["way"].unique())


def contexts() -> pd.DataFrame:
    """Every food in every place, with a name."""
    each = trials()[COVARIATES].drop_duplicates().sort_values(COVARIATES, ignore_index=True)
    return each.assign(state=each["food"] + ", " + each["place"])


def log_of(some: pd.DataFrame) -> Logs:
    """Trials as trajectories of one stage, of one second."""
    number, design = np.arange(len(some)), trials().groupby(COVARIATES)["way"]
    share = (design.value_counts() / design.size()).rename("probability").reset_index()
    stages = some.merge(share, on=[*COVARIATES, "way"]).rename(columns={"way": "action", "success": "reward"})
    stages = stages.assign(trajectory=number, stage=1, elapsed_s=1.0, state=stages["food"] + ", " + stages["place"])
    return Logs(stages, pd.DataFrame({"trajectory": number, "end_s": 1.0, "ending": "finished"}))


def one_way(some: pd.DataFrame) -> Choice:
    rate = some.groupby("way")["success"].mean().reindex(ways(), fill_value=0.0)
    return np.full(len(contexts()), rate.to_numpy().argmax())


def learner(covariates: list[str], **chosen: Any) -> CensoredQLearner:
    return CensoredQLearner(1, ways(), covariates, **chosen)


def by_q(covariates: list[str], **chosen: Any) -> Callable[[pd.DataFrame], Choice]:
    """A policy of ours."""

    def choose(some: pd.DataFrame) -> Choice:
        log, each = log_of(some), contexts()
        policy = learner(covariates, **chosen).fit(log).policy_
        known = np.all([each[name].isin(log.stages[name]) for name in covariates], axis=0)
        found = one_way(some)
        found[known] = policy.probabilities(each[known], 1).argmax(axis=1)
        return found

    return choose


def by_success(make: Callable[[], Any]) -> Callable[[pd.DataFrame], Choice]:
    """The way that a classifier holds for most successful."""

    def choose(some: pd.DataFrame) -> Choice:
        model = make().fit(some[[*COVARIATES, "way"]], some["success"].astype(int))
        every = contexts()[COVARIATES].merge(pd.DataFrame({"way": ways()}), how="cross")
        return model.predict_proba(every)[:, 1].reshape(-1, len(ways())).argmax(axis=1)

    return choose


def most_seen(some: pd.DataFrame) -> Choice:
    """The way with the highest share in the very context."""
    rate = some.pivot_table(index=COVARIATES, columns="way", values="success")
    rate = rate.reindex(index=pd.MultiIndex.from_frame(contexts()[COVARIATES]), columns=ways()).to_numpy()
    return np.where(np.isnan(rate).all(axis=1), one_way(some), np.nan_to_num(rate, nan=-1.0).argmax(axis=1))


def encoded(*steps: Any) -> Any:
    return make_pipeline(OneHotEncoder(handle_unknown="ignore", sparse_output=False), *steps)


METHODS: dict[str, Callable[[pd.DataFrame], Choice]] = {
    "ours": by_q(COVARIATES),
    "ours, one λ": by_q(COVARIATES, reg=ONE_REG),
    "ours, tabular": by_q(["state"], q_function="tabular"),
    "our SVM": by_success(lambda: encoded(CensoredSVC(loss="logistic"))),
    "logistic": by_success(
        lambda: encoded(PolynomialFeatures(3, interaction_only=True), LogisticRegression(max_iter=2000))
    ),
    "forest": by_success(lambda: encoded(RandomForestClassifier(100, min_samples_leaf=3, random_state=0))),
    "most seen": most_seen,
    "one way": one_way,
}


@dataclass(frozen=True)
class Chosen:
    """A choice, as `evaluate` takes it."""

    choice: Choice
    actions: tuple[str, ...]
    covariates: tuple[str, ...] = tuple(COVARIATES)
    horizon: int = 1

    def probabilities(self, frame: pd.DataFrame, stage: int) -> np.ndarray:
        return np.eye(len(self.actions))[taken(frame, self.choice)]


def taken(some: pd.DataFrame, choice: Choice) -> np.ndarray:
    """Number of the way that is taken in each trial."""
    where = pd.MultiIndex.from_frame(contexts()[COVARIATES])
    return choice[where.get_indexer(pd.MultiIndex.from_frame(some[COVARIATES]))]


def success(held_out: pd.DataFrame, choice: Choice) -> float:
    """Mean success of the trials in which the way was the one that is taken."""
    return float(held_out.loc[held_out["way"] == np.array(ways())[taken(held_out, choice)], "success"].mean())


def from_some(size: int, num: int) -> dict[str, Any]:
    """Success of what is learned from so many trials, and how far each method is ahead of ours."""
    found = []
    for seed in range(num):
        order = np.random.default_rng([seed, size]).permutation(len(trials()))
        seen, held_out = trials().iloc[order[:size]], trials().iloc[order[size:]]
        found.append([success(held_out, method(seen)) for method in METHODS.values()])
    each, ours = np.array(found), np.array(found)[:, :1]
    return {"size": size, "deals": num, "success": by_method(each), "ahead of ours": by_method(each - ours)}


def by_method(found: np.ndarray) -> dict[str, list[float]]:
    """Mean and its standard error over deals."""
    both = np.array([found.mean(axis=0), found.std(axis=0, ddof=1) / np.sqrt(len(found))])
    return dict(zip(METHODS, np.round(both.T, 5).tolist(), strict=True))


def cross_fitted() -> dict[str, Any]:
    """Policies of five folds of all trials, as `evaluate` judges them, and what `halfseen learn` would say."""
    log = log_of(trials())
    fold = np.random.default_rng(0).permutation(len(trials())) % NUM_FOLDS
    policies = {name: of_folds(method, fold) for name, method in METHODS.items()}
    best = Baseline(FixedSequence((ways()[one_way(trials())[0]],)), "one way")
    found = {name: judged(policy, log, ["logging", best]) for name, policy in policies.items()}
    verdict = held_out_verdict(learner(COVARIATES).fit(log), log)
    return {"size": len(trials()), "logged": float(trials()["success"].mean()), "verdict": str(verdict), "of": found}


def of_folds(method: Callable[[pd.DataFrame], Choice], fold: np.ndarray) -> CrossFitted:
    names = tuple(ways())
    return CrossFitted(tuple(Chosen(method(trials()[fold != k]), names) for k in range(NUM_FOLDS)), fold, 1)


def judged(policy: CrossFitted, log: Logs, against: list[Any]) -> dict[str, Any]:
    """Value, gain over the last of the baselines, and the verdict."""
    found = evaluate(policy, log, against=against)
    gain = found.comparisons[-1].difference
    assert gain is not None
    pair = {"value": found.doubly_robust, "gain": gain}
    numbers = {name: [each.value, each.low, each.high] for name, each in pair.items()}
    return {**numbers, "verdict": found.verdict, "reason": found.reason}


def measured(size: int | None, num: int) -> dict[str, Any]:
    return cross_fitted() if size is None else from_some(size, num)


def tables(report: dict[str, Any]) -> str:
    """Success by size, and what is said of all."""
    *some, whole = report["rows"]
    head = ["trials learned from", *METHODS]
    rows = [[f"{row['size']:,}", *(f"{100 * row['success'][name][0]:.1f}" for name in METHODS)] for row in some]
    error = 100 * max(row["success"][name][1] for row in some for name in METHODS)
    curve = (
        f"*Success [%] of {whole['size']:,} real trials of one stage, uncut: eleven foods in three places, skewered in "
        f"six ways (Feng and others 2019). Most seen: what succeeded most in the very place; one way: for all. "
        f"{100 * whole['logged']:.1f} in the log; standard errors at most {error:.1f}*"
    )
    each = [[name, cell(one["value"]), cell(one["gain"]), one["verdict"]] for name, one in whole["of"].items()]
    each[-1][2:] = "", ""
    judged_by = markdown(["four fifths of all", "success (95 % interval)", "more than one way", "verdict"], each)
    return f"{curve}\n\n{markdown(head, rows)}\n\n{judged_by}"


def cell(estimate: list[float]) -> str:
    value, low, high = (100.0 * each for each in estimate)
    return f"{value:.1f} ({low:.1f} to {high:.1f})".replace("-", "−")


def main() -> None:
    parser = asked(__doc__, "real_grasps", 20)
    parser.add_argument("--sizes", nargs="+", type=int, default=list(SIZES), help="trials that are learned from")
    options = parser.parse_args()
    cells = [(size, options.repetitions) for size in options.sizes]
    run(options.out, [*cells, (None, 1)], measured, tables, repetitions=options.repetitions)


if __name__ == "__main__":
    main()
