"""What a repetition of Figure 1 takes without planners: 24 fits with laws and all evaluations, by part; medians, JSON.

python benchmarks/repetition.py [--out runs/benchmarks/repetition.json] [--repetitions 4] [--trajectories 25 …]

Bar: 40 s of CPU for all, so that 40 repetitions take a quarter of an hour on two cores. By the control variate they
tell as much of how policies differ as 10,000 did without it.
"""

import argparse
import time
from collections import defaultdict
from pathlib import Path

import numpy as np
from timings import Row, write

from halfseen.cell.calibration.law import read_law, shipped_law
from halfseen.scene import table_paths
from halfseen.study.experiments.reward import Reward
from halfseen.study.pipeline import CUT_KIND, Source
from halfseen.study.policies import FITTED_ONE_STEP, HEURISTICS, ONE_STEP, STRONGEST_RULE
from halfseen.study.setting import Setting, look_at, under

BAR_S = 40.0


class Clock:
    """CPU time of parts that follow one another [s]."""

    def __init__(self) -> None:
        self.parts: dict[str, float] = defaultdict(float)
        self._last = time.process_time()

    def passed(self, part: str) -> None:
        """Count what has passed since the last call to a part."""
        now = time.process_time()
        self.parts[part] += now - self._last
        self._last = now


def repeat(setting: Setting, design: Reward, rates: list[float], index: int) -> dict[str, float]:
    """Make one repetition, and tell the CPU time of its parts [s]."""
    clock, source = Clock(), Source.of(setting, index)
    episodes = source.play(max(design.num_trajectories))
    clock.passed(f"play {max(design.num_trajectories)} trajectories")
    num_episodes = design.episodes_per_scene * len(setting.scenes)
    logs = [(source.cut(episodes, rate, CUT_KIND), "weighted") for rate in rates]
    learned = source.logged(episodes).learn(logs, design.num_trajectories)
    clock.passed(f"{len(learned)} fits")
    rule, policies = STRONGEST_RULE, [each.policy(setting.world) for each in (*HEURISTICS, ONE_STEP)]
    for one in learned:
        assert one.assisted is not None
        world = one.assisted.laws.config
        policies += [one.policy, one.linear, FITTED_ONE_STEP.policy(world), rule.policy(world)]
    source.control_each(policies, range(num_episodes), 0.0)
    clock.passed(f"{len(policies)} evaluations")
    return clock.parts


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/repetition.json"))
    parser.add_argument("--repetitions", type=int, default=4)
    parser.add_argument("--trajectories", type=int, nargs="+", default=Reward().num_trajectories, help="sizes of logs")
    args = parser.parse_args()
    scenes, _ = look_at(table_paths(), read_law(shipped_law()).law)
    setting, _ = under(Setting(scenes), shipped_law())
    sizes = tuple(args.trajectories)
    design = Reward(sizes, table_num_trajectories=sizes[-1])
    rates = [Source.of(setting).cut_rate(share, CUT_KIND) for share in design.cut_shares]
    times = [repeat(setting, design, rates, index) for index in range(args.repetitions)]
    medians_s = {part: float(np.median([each[part] for each in times])) for part in times[0]}
    for part, median_s in medians_s.items():
        print(f"{part:<22} {median_s:6.3f} s of CPU")
    total_s = float(np.median([sum(each.values()) for each in times]))
    holds = "holds" if total_s <= BAR_S else "does not hold"
    print(f"{'all':<22} {total_s:6.3f} s of CPU\nbar: {BAR_S} s: {holds} ({total_s / BAR_S:.2f} times)")
    rows = [Row("a repetition of Figure 1, 24 fits with laws and 101 evaluations", total_s, "s", bar=BAR_S)]
    write(args.out, {"medians_s": medians_s, "total_s": total_s}, rows)


if __name__ == "__main__":
    main()
