"""What several robots earn and how long they take: one Q for the team, each alone, rules, beside one robot.

python benchmarks/teams.py [--robots 1 2] [--paths 800] [--cut 0 0.5] [--price 0 -0.05] [--logs 3] [--episodes 4000]
                           [--out runs/benchmarks/teams.json]

The ten shipped tables under the law of the shipped cell. One robot reaches everything; two stand to the left and to the
right and share the middle; a third stands behind. Each log is played by the team's rule of thumb, half of whose
decisions are made uniformly at random. What is learned from each log plays the same episodes as all others; intervals
are over logs, and for who learns nothing over episodes. Points are counted above leaving the table as it is.
"""

import argparse
import json
from itertools import product
from pathlib import Path

import jax
import numpy as np
from tqdm import tqdm

from halfseen.cell.calibration.law_folder import read_law
from halfseen.cell.calibration.shipped import shipped_law
from halfseen.cell.tables_seen import tables_seen
from halfseen.learners import CensoredQLearner
from halfseen.planners.heuristics import GreedyPolicy
from halfseen.team import EachAlone, ExploringTeam, Robot, Team, alone
from halfseen.team.episodes import evaluate
from halfseen.team.rules import OneAtATime, ReservingTeam, RoundRobin
from halfseen.team.team_world import TeamWorld
from halfseen.world import WorldConfig

SEED = 1612
LEFT, RIGHT, BEHIND = Robot((-0.45, 0.8), 0.55), Robot((0.45, 0.8), 0.55), Robot((0.0, 1.3), 0.6)
TEAMS = {1: (Robot((0.0, 0.8), 0.8),), 2: (LEFT, RIGHT), 3: (LEFT, RIGHT, BEHIND)}


def setting(num_robots, price):
    """World of a team, and the scenes."""
    law = read_law(shipped_law()).law
    scenes = [table.scene(law) for table in tables_seen()]
    return TeamWorld.of(Team(TEAMS[num_robots], reward_per_s=price), law.config(WorldConfig())), scenes


def rules(world):
    """Rules of thumb; the first plays the logs."""
    rule = GreedyPolicy(world.config, uses_history=True, counts_penalty=True)
    greedy = GreedyPolicy(world.config, counts_penalty=True)
    found = {"rule, reserving": ReservingTeam(world.team_config, rule)}
    if len(world.robots) == 1:
        return found
    return found | {
        "greedy, reserving": ReservingTeam(world.team_config, greedy),
        "rule, round robin": RoundRobin(rule),
        "rule, one at a time": OneAtATime(rule),
        "rule, each alone": EachAlone((rule,) * len(world.robots)),
    }


def learned(world, logs):
    """What is learned from a log: by the team, and by each robot from its own part."""
    num_robots = len(world.robots)
    found = {"learned, one Q": CensoredQLearner.for_team(num_robots).fit(logs).policy_}
    if num_robots == 1:
        return found
    each = tuple(CensoredQLearner.for_table().fit(alone(logs, robot)).policy_ for robot in range(num_robots))
    return found | {"learned, each alone": EachAlone(each)}


def measured(num_robots, price, num_paths, cuts, num_logs, num_episodes, bar):
    """Rows of one team at one price: reward and seconds of everyone, by the log that it learned from."""
    world, scenes = setting(num_robots, price)
    left = float(world.config.reward_dirty_left) * float(world.config.dirty_share)
    nothing = left * np.mean([scene.num_objects for scene in scenes])
    layouts, config = world.team.layouts(scenes), world.team_config
    rows, behaviour = [], ExploringTeam(next(iter(rules(world).values())))

    def play(name, policy, **place):
        totals = evaluate(config, layouts, policy, jax.random.key(SEED), num_episodes)
        reward, seconds = np.asarray(totals.reward, dtype=float), np.asarray(totals.robot_s, dtype=float)
        points = reward - nothing
        row = {"robots": num_robots, "price": price, "policy": name, **place, "points": points.mean()}
        row |= {"se": points.std(ddof=1) / num_episodes**0.5, "unpriced": (points - price * seconds).mean()}
        rows.append(row | {"seconds": seconds.mean()})
        bar.update()

    for name, policy in rules(world).items():
        play(name, policy)
    for size, cut, log in product(num_paths, cuts, range(num_logs)):
        logs = world.simulate(scenes, behaviour, size, seed=SEED + log, cut_share=cut)
        for name, policy in learned(world, logs).items():
            play(name, policy, paths=size, cut=cut, log=log)
    return rows


def summed(rows):
    """Means over logs, and standard errors over logs where there are several."""
    keys = ("robots", "price", "policy", "paths", "cut")
    groups = {}
    for row in rows:
        groups.setdefault(tuple(row.get(key) for key in keys), []).append(row)
    found = []
    for place, members in groups.items():
        points = np.array([row["points"] for row in members])
        se = points.std(ddof=1) / len(points) ** 0.5 if len(points) > 1 else members[0]["se"]
        means = {key: float(np.mean([row[key] for row in members])) for key in ("unpriced", "seconds")}
        found.append(dict(zip(keys, place, strict=True)) | {"points": points.mean(), "se": se} | means)
    return found


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--robots", type=int, nargs="+", default=[1, 2], choices=TEAMS)
    arguments.add_argument("--paths", type=int, nargs="+", default=[800])
    arguments.add_argument("--cut", type=float, nargs="+", default=[0.5])
    arguments.add_argument("--price", type=float, nargs="+", default=[0.0, -0.05])
    arguments.add_argument("--logs", type=int, default=3)
    arguments.add_argument("--episodes", type=int, default=4000)
    arguments.add_argument("--out", type=Path, default=Path("runs/benchmarks/teams.json"))
    given = arguments.parse_args()
    of_learners = len(given.paths) * len(given.cut) * given.logs
    total = sum(len(given.price) * ((1 if k == 1 else 5) + (1 if k == 1 else 2) * of_learners) for k in given.robots)
    with tqdm(total=total, unit="policy", mininterval=2) as bar:
        rows = [
            row
            for num_robots, price in product(given.robots, given.price)
            for row in measured(num_robots, price, given.paths, given.cut, given.logs, given.episodes, bar)
        ]
    told = summed(rows)
    print(f"{'robots':>6} {'price':>6} {'policy':22} {'paths':>5} {'cut':>4} {'points':>14} {'unpriced':>9} {'s':>6}")
    for row in told:
        place = f"{row['paths'] or '':>5} {'' if row['cut'] is None else row['cut']:>4}"
        points = f"{row['points']:.2f} ± {row['se']:.2f}"
        print(
            f"{row['robots']:>6} {row['price']:>6} {row['policy']:22} {place} {points:>14} {row['unpriced']:>9.2f} "
            f"{row['seconds']:>6.1f}"
        )
    given.out.parent.mkdir(parents=True, exist_ok=True)
    given.out.write_text(json.dumps({"seed": SEED, "episodes": given.episodes, "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
