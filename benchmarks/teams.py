"""What several robots earn and how long they take: one Q for the team, each alone, rules, beside one robot.

python benchmarks/teams.py [--robots 1 2] [--trajectories 800] [--cut 0.5] [--price 0 -0.05] [--logs 3] [--episodes
4000]
                           [--law shipped] [--without "learned, Q of the best"] [--out runs/benchmarks/teams.json]

The ten shipped tables under the law of the shipped cell, of which robot 1 has a worse one where robots are unlike, or
under the laws that the package assumes. One robot reaches everything; two stand to the left and to the right and share
the middle; a third stands behind. Each log is played by the team's rule of thumb, half of whose decisions are made
uniformly at random. What is learned from each log plays the same episodes as all others; intervals are over logs, and
for who learns nothing over episodes. Points are counted above leaving the table as it is.

What coordination buys is compared log by log: the points of what is learned with laws, or of one Q without them, less
those of each alone, and of the best rule, which knows the true laws and the price; and less those of the same log
before it was cut. Seconds are given as a share of those that one robot takes by the same way, to be held beside 1/K;
and the least share that was to be had without doing less: the seconds that all robots were at work, shared evenly.
"""

import argparse
import json
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
from scipy import stats
from tqdm import tqdm

from halfseen.cell.calibration.law import read_law, shipped_law
from halfseen.cell.facts import tables_seen
from halfseen.learning import CensoredQLearner
from halfseen.planners.heuristics import GreedyPolicy, OneAtATime, ReservingPolicy, RoundRobin
from halfseen.planners.myopic import MyopicPolicy
from halfseen.tables.policy import IndependentPolicies
from halfseen.world import ExploringPolicy, Robot, TableWorld, Team, WorldConfig, random
from halfseen.world.actions import WAIT, wait_of
from halfseen.world.rollout import play

SEED = 1612
LEFT, RIGHT, BEHIND = Robot((-0.45, 0.8), 0.55), Robot((0.45, 0.8), 0.55), Robot((0.0, 1.3), 0.6)
TEAMS = {1: (Robot((0.0, 0.8), 0.8),), 2: (LEFT, RIGHT), 3: (LEFT, RIGHT, BEHIND)}
LAWS = ("shipped", "assumed", "unlike")
CLUMSY = 8.0
"""By how much the log-odds of robot 1 to hold are lower, where robots are unlike."""
RULES = ("rule, reserving", "one step ahead", "greedy, reserving", "rule, round robin", "rule, one at a time")
WITH_LAWS = "learned, with laws"
ONE_Q, BEST_Q, ALONE, RULE_ALONE = "learned, one Q", "learned, Q of the best", "learned, each alone", "rule, each alone"


def setting(law, num_robots, price):
    """World of a team, and the scenes."""
    shipped = read_law(shipped_law()).law
    scenes = [table.scene(shipped) for table in tables_seen()]
    config = WorldConfig() if law == "assumed" else shipped.config(WorldConfig())
    robots = list(TEAMS[num_robots])
    if law == "unlike" and num_robots > 1:
        clumsy = replace(config.grasping, log_odds=config.grasping.log_odds - CLUMSY)
        robots[1] = replace(robots[1], grasping=clumsy)
    return TableWorld.of(Team(robots, reward_per_s=price), config), scenes


def rules(world):
    """Rules of thumb; the first plays the logs."""
    rule = GreedyPolicy(world.played_config, uses_history=True, counts_penalty=True)
    greedy = GreedyPolicy(world.played_config, counts_penalty=True)
    reserving, ahead = ReservingPolicy(world.played_config, rule), MyopicPolicy(world.played_config)
    if len(world.robots) == 1:
        return dict(zip(RULES, (reserving, ahead), strict=False))
    others = (ReservingPolicy(world.played_config, greedy), RoundRobin(rule), OneAtATime(rule))
    found = dict(zip(RULES, (reserving, ahead, *others), strict=True))
    return found | {RULE_ALONE: IndependentPolicies((rule,) * len(world.robots))}


def learned(world, logs, without=()):
    """What is learned from a log: by the team, upon each alone and without it, and by each from its own part."""
    num_robots = len(world.robots)
    with_laws = CensoredQLearner.for_team(num_robots).fit(logs)
    policy = with_laws.linear_policy_
    if num_robots == 1:
        return {WITH_LAWS: with_laws.policy_, ONE_Q: policy}
    found = {WITH_LAWS: with_laws.policy_, ONE_Q: policy, ALONE: policy.base}
    if BEST_Q not in without:
        found[BEST_Q] = CensoredQLearner.for_team(num_robots, base=None).fit(logs).policy_
    return found


def totals(world, layouts, policy, num_episodes):
    """Reward and seconds of each table, and the seconds that its robots were at work, shared evenly."""
    trajectories = play(world.played_config, layouts, policy, random.key_of(SEED), num_episodes)
    taken, seconds = np.asarray(trajectories.is_taken), np.asarray(trajectories.duration_s, dtype=float)
    wait, robots = wait_of(trajectories.states.num_objects), trajectories.states.robots
    is_at_work = np.asarray(robots.is_busy & (robots.verb != WAIT)).sum(axis=-1) + (
        np.asarray(trajectories.action) != wait
    )
    reward = np.where(taken, np.asarray(trajectories.reward, dtype=float), 0.0).sum(axis=-1)
    shared = np.where(taken, seconds * is_at_work, 0.0).sum(axis=-1) / len(world.robots)
    return reward, np.where(taken, seconds, 0.0).sum(axis=-1), shared


def measured(given, num_robots, price, bar):
    """Rows of one team at one price: what everyone earns and takes, by the log that it learned from."""
    world, scenes = setting(given.law, num_robots, price)
    left = float(world.config.reward_dirty_left) * float(world.config.dirty_share)
    nothing = left * np.mean([scene.num_objects for scene in scenes])
    layouts, rows, behaviour = world.team.layouts(scenes), [], ExploringPolicy(next(iter(rules(world).values())))

    def judge(name, policy, **place):
        reward, seconds, shared = totals(world, layouts, policy, given.episodes)
        points = reward - nothing
        row = {"robots": num_robots, "price": price, "policy": name, **place, "points": points.mean()}
        row |= {"se": points.std(ddof=1) / given.episodes**0.5, "unpriced": (points - price * seconds).mean()}
        rows.append(row | {"seconds": seconds.mean(), "shared": shared.mean()})
        bar.update()

    for name, policy in rules(world).items():
        judge(name, policy)
    for size, cut, log in product(given.trajectories, given.cut, range(given.logs)):
        logs = world.simulate(scenes, behaviour, size, seed=SEED + log, cut_share=cut)
        for name, policy in learned(world, logs, given.without).items():
            judge(name, policy, trajectories=size, cut=cut, log=log)
    return rows


KEYS = ("robots", "price", "policy", "trajectories", "cut")


def by_place(rows):
    """Rows that differ in the log alone."""
    groups = {}
    for row in rows:
        groups.setdefault(tuple(row.get(key) for key in KEYS), []).append(row)
    return groups


def summed(rows):
    """Means over logs, and standard errors over logs where there are several."""
    found = []
    for place, members in by_place(rows).items():
        points = np.array([row["points"] for row in members])
        se = points.std(ddof=1) / len(points) ** 0.5 if len(points) > 1 else members[0]["se"]
        means = {key: float(np.mean([row[key] for row in members])) for key in ("unpriced", "seconds", "shared")}
        found.append(dict(zip(KEYS, place, strict=True)) | {"points": points.mean(), "se": se} | means)
    return found


def interval(differences):
    """Mean and 95 % interval by Student's t; none from a single log."""
    mean, size = np.mean(differences), len(differences)
    if size < 2:
        return f"{mean:+.2f}"
    half = stats.t.ppf(0.975, size - 1) * np.std(differences, ddof=1) / size**0.5
    return f"{mean:+.2f} ({mean - half:+.2f} to {mean + half:+.2f})"


BOUGHT = (
    "robots",
    "price",
    "policy",
    "trajectories",
    "cut",
    "points",
    "less each alone",
    "less the best rule",
    "less none cut",
    "s",
    "of one robot's reward",
    "of its seconds",
    "work shared evenly",
)


def what_coordination_buys(rows):
    """Points less each alone, the best rule and none cut, log by log; reward and seconds beside those of one robot."""
    groups = by_place(rows)
    for (num_robots, price, policy, size, cut), members in groups.items():
        if policy not in (WITH_LAWS, ONE_Q):
            continue
        points = np.array([row["points"] for row in members])
        best = max(
            groups[num_robots, price, name, None, None][0]["points"]
            for name in (*RULES, RULE_ALONE)
            if (num_robots, price, name, None, None) in groups
        )
        alone, uncut = (
            groups.get((num_robots, price, *place))
            for place in ((ALONE, size, cut), (policy, size, 0.0 if cut else None))
        )
        paired = [interval(points - [row["points"] for row in others]) if others else "" for others in (alone, uncut)]
        differences = [paired[0], interval(points - best), paired[1]]
        seconds = f"{np.mean([row['seconds'] for row in members]):.1f}"
        message = [num_robots, price, policy, size, cut, f"{points.mean():.2f}", *differences, seconds]
        yield [*message, *beside_one(members, groups.get((1, price, policy, size, cut)))]


def beside_one(members, of_one):
    """Shares of one robot's reward, seconds, and seconds if work were shared evenly; empty where it was not asked."""
    if not of_one:
        return ["", "", ""]
    reward, seconds, shared = (np.mean([row[key] for row in members]) for key in ("unpriced", "seconds", "shared"))
    single, single_s = (np.mean([row[key] for row in of_one]) for key in ("unpriced", "seconds"))
    return [f"{reward / single:.2f}", f"{seconds / single_s:.2f}", f"{shared / single_s:.2f}"]


def as_table(names, lines):
    """A table as guides have it."""
    return ["| " + " | ".join(map(str, line)) + " |" for line in (names, ["--:"] * len(names), *lines)]


def store(given, rows):
    """What was measured so far."""
    given.out.parent.mkdir(parents=True, exist_ok=True)
    result = {"seed": SEED, "episodes": given.episodes, "law": given.law, "rows": rows}
    given.out.write_text(json.dumps(result, indent=1))


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--robots", type=int, nargs="+", default=[1, 2], choices=TEAMS)
    arguments.add_argument("--trajectories", type=int, nargs="+", default=[800])
    arguments.add_argument("--cut", type=float, nargs="+", default=[0.5])
    arguments.add_argument("--price", type=float, nargs="+", default=[0.0, -0.05])
    arguments.add_argument("--logs", type=int, default=3)
    arguments.add_argument("--episodes", type=int, default=4000)
    arguments.add_argument("--without", nargs="*", default=[], choices=[BEST_Q], help="what is not to be learned")
    arguments.add_argument("--law", choices=LAWS, default=LAWS[0])
    arguments.add_argument("--out", type=Path, default=Path("runs/benchmarks/teams.json"))
    given = arguments.parse_args()
    of_learners = len(given.trajectories) * len(given.cut) * given.logs
    of_team = 6 + (4 - len(given.without)) * of_learners
    total = sum(len(given.price) * ((2 + 2 * of_learners) if k == 1 else of_team) for k in given.robots)
    rows = []
    with tqdm(total=total, unit="policy", mininterval=2) as bar:
        for k, price in product(given.robots, given.price):
            rows += measured(given, k, price, bar)
            store(given, rows)
    place = f"{'robots':>6} {'price':>6} {'policy':22} {'trajectories':>5} {'cut':>4}"
    print(f"{place} {'points':>14} {'unpriced':>9} {'s':>6} {'shared':>6}")
    for row in summed(rows):
        place = f"{row['trajectories'] or '':>5} {'' if row['cut'] is None else row['cut']:>4}"
        points = f"{row['points']:.2f} ± {row['se']:.2f}"
        print(
            f"{row['robots']:>6} {row['price']:>6} {row['policy']:22} {place} {points:>14} {row['unpriced']:>9.2f} "
            f"{row['seconds']:>6.1f} {row['shared']:>6.1f}"
        )
    print(*as_table(BOUGHT, what_coordination_buys(rows)), sep="\n")


if __name__ == "__main__":
    main()
