"""What is learned of tables where laws are right, and where they are wrong: the model, or what the log speaks for?

python benchmarks/wrong_laws.py [--cases NAME …] [--sizes 25 100 800] [--logs 6] [--out runs/benchmarks/wrong_laws.json]

Truth is the law that comes with the package, or the assumed one. Cases: laws fitted by another family only (*news*:
each look is news; *exponential*; *both*; *hopeful*: the whole view is taken for surer than it is; *logistic*, of an
assumed truth), a *recorder* whose log-odds are too sure, *speckled* objects whose labels err by what no log holds,
objects that *stick*; and *right*. All logs have half of their trajectories cut. Rewards are those over the best rule
that knows the true laws, with a standard error over logs, on tables that all policies of a log share; by control
variates where the world's laws have probabilities, else as they fall.
"""

import argparse
import json
from collections.abc import Callable
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from halfseen.arrays import record
from halfseen.cell.calibration.law import read_law, shipped_law
from halfseen.learning import CensoredQLearner
from halfseen.planners import GreedyPolicy
from halfseen.planners.control import controlled
from halfseen.scene.shipped import table_paths
from halfseen.study.pipeline import EVALUATION, Source, random_key
from halfseen.study.setting import look_at
from halfseen.tables import learner as learning
from halfseen.tables.law_grasping import Exponential, LogisticFamily
from halfseen.tables.law_seeing import Independent
from halfseen.tables.laws import FittedLaws, fitted_laws
from halfseen.world import WorldConfig, random
from halfseen.world.logs import to_logs
from halfseen.world.rollout import evaluate
from halfseen.world.seeing import LookOutcome, label_evidence
from halfseen.world.state import pad_scenes
from halfseen.writing import write_file

SEED, NUM_TABLES, NUM_RAW_TABLES = 0, 200, 1000


@cache
def tables_of(is_assumed: bool) -> tuple[Any, Any, WorldConfig]:
    """Scenes, layouts and the true world."""
    law = None if is_assumed else read_law(shipped_law()).law
    scenes = look_at(table_paths(), law)[0]
    return scenes, pad_scenes(scenes), WorldConfig() if law is None else law.config(WorldConfig())


@record
class Mislabelled:
    """Looks err as one law has it, and are recorded by another; of a third of the objects, errors that no log holds."""

    true: Any
    recorder: Any
    is_speckled: bool = False

    def draw_latent(self, num_objects: int, key: Any) -> Any:
        return random.uniform(key, num_objects) < (0.33 if self.is_speckled else 0.0)

    def look(self, glimpse: Any, log_odds: Any, is_dirty: Any, latent: Any, key: Any) -> LookOutcome:
        view = glimpse.occluded, glimpse.seen
        if_dirty, if_clean = self.true.positive(*view, glimpse.is_held)
        if_dirty, if_clean = (
            np.where(latent, 0.4 * if_dirty, if_dirty),
            np.where(latent, np.minimum(3.0 * if_clean, 1.0), if_clean),
        )
        says_dirty = random.uniform(key, if_dirty.shape[-1]) < np.where(is_dirty, if_dirty, if_clean)
        labels = label_evidence(*self.recorder.positive(*view, glimpse.is_held), says_dirty)
        return LookOutcome(log_odds + labels, self.recorder.after(*view, says_dirty, glimpse.is_held), latent)

    def positive(self, occluded: Any, seen: Any, is_held: Any = False) -> Any:
        return self.recorder.positive(occluded, seen, is_held)

    def after(self, occluded: Any, seen: Any, says_dirty: Any, is_held: Any = False) -> Any:
        return self.recorder.after(occluded, seen, says_dirty, is_held)


def hopeful(seeing: Any) -> Any:
    return replace(
        seeing,
        sensitivity=(*seeing.sensitivity[:-1], 0.95),
        false_alarms=(*seeing.false_alarms[:-1], max(0.10, seeing.false_alarms[-2])),
    )


def sticking(grasping: Any) -> Any:
    """A quarter of the objects never holds."""

    class Sticking(type(grasping)):
        def draw_latent(self, num_objects: int, key: Any) -> Any:
            one, other = random.split(key)
            return np.where(
                random.uniform(other, num_objects) < 0.25, np.float32(-60.0), super().draw_latent(num_objects, one)
            )

    return Sticking(*(getattr(grasping, each.name) for each in fields(grasping)))


def news(evidence: Any, config: WorldConfig) -> WorldConfig:
    family = Independent(evidence.labels, evidence.dirty_share)
    return replace(config, seeing=family.law(family.fitted(family.prior)))


def of_family(kind: Any) -> Callable[[Any, WorldConfig], WorldConfig]:
    def forced(evidence: Any, config: WorldConfig) -> WorldConfig:
        law: Any = config.grasping
        family = kind(evidence.tried, float(law.limit_s))
        return replace(config, grasping=family.law(family.fitted()))

    return forced


exponential, logistic = of_family(Exponential), of_family(LogisticFamily)
FORCED: dict[str, Callable[[Any, WorldConfig], WorldConfig]] = {
    "right": lambda _, config: config,
    "news": news,
    "exponential": exponential,
    "both": lambda evidence, config: news(evidence, exponential(evidence, config)),
    "hopeful": lambda _, config: replace(config, seeing=hopeful(config.seeing)),
    "logistic": logistic,
}
WORLDS: dict[str, Callable[[WorldConfig], WorldConfig]] = {
    "recorder": lambda world: replace(world, seeing=Mislabelled(world.seeing, hopeful(world.seeing))),
    "speckled": lambda world: replace(world, seeing=Mislabelled(world.seeing, world.seeing, is_speckled=True)),
    "stick": lambda world: replace(world, grasping=sticking(world.grasping)),
}


def measured(case: str, index: int, sizes: list[int]) -> list[dict[str, Any]]:
    """Learn from one log, at each size, and play."""
    scenes, layouts, world = tables_of(case == "logistic")
    played = WORLDS[case](world) if case in WORLDS else world
    source = Source(played, layouts, SEED, index)
    cuts = source.cut(
        source.play(max(sizes)), Source(played, layouts, SEED).cut_rate(0.5, "independent"), "independent"
    )
    logs = to_logs(cuts, "independent", scenes, world.dirty_share)

    def forced(evidence: Any, known: WorldConfig, prior: WorldConfig | None = None) -> FittedLaws:
        found = fitted_laws(evidence, known, prior)
        return found._replace(config=FORCED.get(case, FORCED["right"])(evidence, found.config))

    def worth(policy: Any) -> Any:
        key = random_key(SEED, EVALUATION, index)
        if case in WORLDS:
            return evaluate(played, layouts, policy, key, NUM_RAW_TABLES).reward.astype(float)
        return controlled(world, layouts, policy, key, np.arange(NUM_TABLES)).reward

    def rule(config: WorldConfig) -> GreedyPolicy:
        return GreedyPolicy(config, uses_history=True, counts_penalty=True)

    rows, base = [], worth(rule(world))
    for size in sizes:
        learning.fitted_laws = forced
        try:
            learner: Any = CensoredQLearner.for_table(10).fit(logs.select(logs.trajectory_ids[:size]))
        finally:
            learning.fitted_laws = fitted_laws
        found = learner.assisted_
        policies = {
            "default": learner.policy_,
            "linear eq. 3": learner.linear_policy_,
            "rule, fitted laws": rule(found.laws.config),
        }
        gains = {name: float((worth(policy) - base).mean()) for name, policy in policies.items()}
        result = {
            "basis": found.basis,
            "p": found.test.p_value,
            "is_rejected": found.test.is_rejected,
            "is_mended": found.laws.is_mended,
        }
        rows.append({"case": case, "size": size, "log": index, **result, "gains": gains})
    return rows


def lines_of(rows: list[dict[str, Any]]) -> list[str]:
    names = list(rows[0]["gains"])
    lines = [
        f"| laws | n | {' | '.join(names)} | rejected | built on |",
        "|:--|--:|" + "--:|" * len(names) + "--:|:--|",
    ]
    for case, size in dict.fromkeys((row["case"], row["size"]) for row in rows):
        some = [row for row in rows if (row["case"], row["size"]) == (case, size)]
        cells = []
        for name in names:
            gains = np.array([row["gains"][name] for row in some])
            error = gains.std(ddof=1) / np.sqrt(len(gains)) if len(gains) > 1 else np.nan
            cells.append(f"{gains.mean():+.2f} ± {error:.2f}")
        rejected = sum(row["is_rejected"] for row in some)
        bases = [row["basis"] for row in some]
        built = ", ".join(f"{bases.count(basis)} {basis}" for basis in dict.fromkeys(bases))
        lines.append(f"| {case} | {size} | {' | '.join(cells)} | {rejected} of {len(some)} | {built} |")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    every = [*FORCED, *WORLDS]
    parser.add_argument("--cases", nargs="+", choices=every, default=every)
    parser.add_argument("--sizes", nargs="+", type=int, default=[25, 100, 800])
    parser.add_argument("--logs", type=int, default=6)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/wrong_laws.json"))
    asked = parser.parse_args()
    rows: list[dict[str, Any]] = []
    for case in asked.cases:
        for index in range(asked.logs):
            rows += measured(case, index, asked.sizes)
        print(*lines_of([row for row in rows if row["case"] == case]), sep="\n", flush=True)
    write_file(asked.out, json.dumps(rows, indent=1).encode())


if __name__ == "__main__":
    main()
