"""The learned policy beside a planner with laws fitted to the same log: the study's question, with narrower intervals.

python benchmarks/against_planner.py [--sizes 25 100 400 800] [--cut 0.5] [--logs 24] [--seed 101] [--out FILE]

The study lets the planner play eight episodes of each log, as it takes its time; here it plays as many as the learned
policy, a hundred, on the same tables, all by the control variate. The planner makes 128 simulations a decision. Of a
log, the first trajectories are a smaller one. Differences are means over logs with two standard errors. The seed is not
the study's.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import pandas as pd
from tqdm import tqdm

from halfseen.cell.calibration.law import shipped_law
from halfseen.scene.shipped import table_paths
from halfseen.study.pipeline import CUT_KIND, Source
from halfseen.study.policies import FITTED_ONE_STEP, LEARNED, STRONGEST_RULE, fitted_planner
from halfseen.study.setting import Setting, look_at, under
from halfseen.writing import write_file

NUM_EPISODES, NUM_SIMULATIONS = 100, 128


def measured(source: Source, rate: float, sizes: list[int]) -> list[dict[str, float]]:
    """Learn from the first trajectories of one log, and let all play the same episodes."""
    episodes = source.play(max(sizes))
    learned = source.logged(episodes).learn([(source.cut(episodes, rate, CUT_KIND), "weighted")], sizes)
    rows, planner = [], fitted_planner(NUM_SIMULATIONS)
    for size, one in zip(sizes, learned, strict=True):
        assert one.assisted is not None
        fitted = one.assisted.laws.config
        made = {LEARNED.name: one.policy} | {
            each.name: each.policy(world)
            for each, world in ((planner, fitted), (FITTED_ONE_STEP, fitted), (STRONGEST_RULE, source.world))
        }
        played = source.control_each(list(made.values()), range(NUM_EPISODES), 0.0)
        earned = {name: float(each.reward.mean()) for name, each in zip(made, played, strict=True)}
        rows.append({"trajectories": size, "log": source.index, **earned})
    return rows


def differences(rows: pd.DataFrame) -> pd.DataFrame:
    """What the learned policy earns over each other, by size: means over logs, and two standard errors."""
    over = (
        rows.drop(columns=["log", LEARNED.name])
        .set_index("trajectories")
        .rsub(rows.set_index("trajectories")[LEARNED.name], axis=0)
    )
    by_size = over.groupby(level=0)
    return pd.DataFrame(
        {
            f"over {name}": by_size[name].mean().map("{:+.3f}".format)
            + (2 * by_size[name].sem()).map(" ± {:.3f}".format)
            for name in over.columns
        }
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=[25, 100, 400, 800])
    parser.add_argument("--cut", type=float, default=0.5)
    parser.add_argument("--logs", type=int, default=24)
    parser.add_argument("--seed", type=int, default=101)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/against_planner.json"))
    given = parser.parse_args()
    setting, law = under(Setting(()), shipped_law())
    setting = replace(setting, scenes=look_at(table_paths(), law)[0], seed=given.seed)
    rate = Source.of(setting).cut_rate(given.cut, CUT_KIND)
    rows = []
    for index in tqdm(range(given.logs), unit="log", disable=None):
        rows += measured(Source.of(setting, index), rate, given.sizes)
        write_file(given.out, json.dumps(rows, indent=1).encode())
    print(differences(pd.DataFrame(rows)).to_string())


if __name__ == "__main__":
    main()
