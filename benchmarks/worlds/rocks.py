"""RockSample(7, 8) [Smith and Simmons, UAI 2004]: a rover, eight rocks that are good or bad, and a sensor that fades.

The rover knows where it is and where the rocks are, and begins with a chance of ½ that each is good. It moves by one
cell, checks one rock from where it stands, or samples the rock on its cell, each in one step. A good rock pays 10 and
is bad from then on, a bad one costs 10, and to leave by the eastern border pays 10. A check at distance d is right with
probability ½ (1 + 2^(−d/20)). What step t pays counts γ^t. The map is that of the published RockSample_7_8.

Decisions are *skills* of whole steps: check rock i, drive to rock i and sample it, drive out. So they are made on the
start or on a rock. A batch of rovers takes a step at once.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int
from scipy.optimize import brentq
from scipy.special import expit

from halfseen.logs import Logs

SIZE, HALF_DISTANCE, DISCOUNT, PAY = 7, 20.0, 0.95, 10.0
START = np.array([0, 3])
ROCKS = np.array([[2, 0], [0, 1], [3, 1], [6, 3], [2, 4], [3, 4], [5, 5], [1, 6]])
NUM = len(ROCKS)
NORTH, SOUTH, EAST, WEST, SAMPLE, CHECK = range(6)
"""Actions of a step; CHECK + i checks rock i."""
MOVES = np.array([[0, -1], [0, 1], [1, 0], [-1, 0], *[[0, 0]] * (1 + NUM)])

EXIT = 2 * NUM
"""Skill k checks rock k, skill 8 + k samples it, this one leaves."""
HORIZON = 20
"""Skills of a trajectory; the last can only be to leave."""
RANKS, SURE = 3, 0.8


class Rovers(NamedTuple):
    """The hidden state of a batch."""

    position: Int[np.ndarray, "n 2"]
    is_good: Bool[np.ndarray, "n 8"]

    @property
    def is_out(self) -> Bool[np.ndarray, " n"]:
        return self.position[:, 0] == SIZE


class Seen(NamedTuple):
    """What a batch of rovers knows."""

    position: Int[np.ndarray, "n 2"]
    log_odds: Float[np.ndarray, "n 8"]
    """Of each rock being good, exact."""
    steps: Int[np.ndarray, " n"]
    """That were taken, t."""

    @property
    def belief(self) -> Float[np.ndarray, "n 8"]:
        return expit(self.log_odds)

    @property
    def driving(self) -> Int[np.ndarray, "n 8"]:
        """Moves to each rock."""
        return np.abs(self.position[:, None] - ROCKS).sum(axis=-1)


Rule = Callable[[Seen, int], Float[np.ndarray, "n C"]]
"""π(choice | what is known, stage)."""


def accuracy(position: Int[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 8"]:
    """Chance that a check of each rock is right."""
    return 0.5 * (1.0 + 2.0 ** (-np.linalg.norm(position[:, None] - ROCKS, axis=-1) / HALF_DISTANCE))


def step(
    rovers: Rovers, action: Int[np.ndarray, " n"], uniform: Float[np.ndarray, " n"]
) -> tuple[Rovers, Float[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Take one step; `uniform` in [0, 1) decides whether a check is right.

    Returns
    -------
    tuple
        The rovers, their rewards, and what they observed: 1 for good, 0 for bad, −1 for nothing.
    """
    row, is_in = np.arange(len(action)), ~rovers.is_out
    goal = rovers.position + MOVES[action] * is_in[:, None]
    leaves = is_in & (goal[:, 0] == SIZE)
    goal = np.where((leaves | ~is_in)[:, None], goal, np.clip(goal, 0, SIZE - 1))
    is_sampled = (goal[:, None] == ROCKS).all(axis=-1) & (is_in & (action == SAMPLE))[:, None]
    reward = PAY * (leaves + np.where(is_sampled, np.where(rovers.is_good, 1.0, -1.0), 0.0).sum(axis=1))
    rock = np.maximum(action - CHECK, 0)
    says_good = rovers.is_good[row, rock] == (uniform < accuracy(goal)[row, rock])
    return Rovers(goal, rovers.is_good & ~is_sampled), reward, np.where(is_in & (action >= CHECK), says_good, -1)


def known_after(seen: Seen, moved: Rovers, action: Int[np.ndarray, " n"], said: Int[np.ndarray, " n"]) -> Seen:
    """Bayes' rule after one step."""
    row, rock, right = np.arange(len(action)), np.maximum(action - CHECK, 0), accuracy(moved.position)
    log_odds = seen.log_odds.copy()
    with np.errstate(divide="ignore"):
        evidence = np.log(right / (1.0 - right))[row, rock]
    log_odds[row, rock] += np.where(said < 0, 0.0, np.where(said == 1, evidence, -evidence))
    log_odds[(moved.position[:, None] == ROCKS).all(axis=-1) & (action == SAMPLE)[:, None]] = -np.inf
    return Seen(moved.position, log_odds, seen.steps + 1)


def next_step(position: Int[np.ndarray, "n 2"], skill: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """The action by which a skill goes on: east or west, north or south, and then what it is for."""
    goal = np.where((skill == EXIT)[:, None], [SIZE, 0], ROCKS[skill % NUM])
    east, south = (goal - position).T
    along = np.where(east > 0, EAST, np.where(east < 0, WEST, np.where(south > 0, SOUTH, NORTH)))
    there = np.where((east == 0) & (south == 0), SAMPLE, along)
    return np.where(skill < NUM, CHECK + skill, np.where(skill == EXIT, EAST, there))


def rows_of(batch: Any, rows: Any) -> Any:
    """Copy some rows of a batch."""
    return type(batch)(*(part[rows].copy() for part in batch))


def begin(is_good: Bool[np.ndarray, "n 8"]) -> tuple[Rovers, Seen]:
    position, num = np.tile(START, (len(is_good), 1)), len(is_good)
    return Rovers(position, is_good), Seen(position, np.zeros((num, NUM)), np.zeros(num, dtype=int))


def rocks_of(seed: int) -> Bool[np.ndarray, " 8"]:
    """Which rocks are good in one numbered world."""
    return np.random.default_rng([seed, 17]).random(NUM) < 0.5


def carried_out(
    rovers: Rovers, seen: Seen, skill: Int[np.ndarray, " n"], rng: np.random.Generator
) -> tuple[Rovers, Seen, Float[np.ndarray, " n"]]:
    """Take the steps of a skill; the reward is discounted to the first step of the trajectory."""
    hidden, known, total = rows_of(rovers, ...), rows_of(seen, ...), np.zeros(len(skill))
    on = np.arange(len(skill))
    while len(on):
        now, before = rows_of(hidden, on), rows_of(known, on)
        action = next_step(now.position, skill[on])
        moved, reward, said = step(now, action, rng.random(len(on)))
        after = known_after(before, moved, action, said)
        total[on] += DISCOUNT**before.steps * reward
        for whole, part in zip((*hidden, *known), (*moved, *after), strict=True):
            whole[on] = part
        on = on[~(moved.is_out | (action >= SAMPLE))]
    return hidden, known, total


class Choices(NamedTuple):
    """What a policy chooses from: names, and the skill that each one means now."""

    names: list[str]
    skills: Callable[[Seen], Int[np.ndarray, "n C"]]


BY_NUMBER = Choices(
    [*(f"check {k}" for k in range(NUM)), *(f"sample {k}" for k in range(NUM)), "exit"],
    lambda seen: np.tile(np.arange(EXIT + 1), (len(seen.steps), 1)),
)


def nearest(seen: Seen) -> tuple[Int[np.ndarray, "n 3"], Bool[np.ndarray, "n 3"]]:
    """The nearest rocks that are not believed to be bad, and whether there are so many."""
    is_open = seen.belief >= 0.5
    rock = np.argsort(np.where(is_open, seen.driving, np.iinfo(int).max), axis=1, kind="stable")[:, :RANKS]
    return rock, np.take_along_axis(is_open, rock, axis=1)


def _skills_by_rank(seen: Seen) -> Int[np.ndarray, "n 7"]:
    rock, there = nearest(seen)
    each = [np.where(there, rock, EXIT), np.where(there, NUM + rock, EXIT)]
    return np.hstack([*each, np.full((len(rock), 1), EXIT)])


BY_RANK = Choices(
    [*(f"check nearest {k + 1}" for k in range(RANKS)), *(f"sample nearest {k + 1}" for k in range(RANKS)), "exit"],
    _skills_by_rank,
)
"""A choice of a rock that is not there means to leave."""


class Played(NamedTuple):
    """Stages of trajectories, as columns."""

    trajectory: Int[np.ndarray, " rows"]
    stage: Int[np.ndarray, " rows"]
    seen: Seen
    choice: Int[np.ndarray, " rows"]
    skill: Int[np.ndarray, " rows"]
    chance: Float[np.ndarray, "rows 2"]
    """Of the choice, and of the skill."""
    reward: Float[np.ndarray, " rows"]
    """Discounted."""
    end: Int[np.ndarray, " rows"]
    """Steps at the end of the stage."""

    @property
    def returns(self) -> Float[np.ndarray, " n"]:
        return np.bincount(self.trajectory, self.reward)

    @property
    def lengths(self) -> Int[np.ndarray, " n"]:
        """Steps of each trajectory."""
        return self.end[np.append(np.diff(self.trajectory) > 0, True)]


def play(
    num: int, rule: Rule, choices: Choices, rng: np.random.Generator, is_good: Bool[np.ndarray, " 8"] | None = None
) -> Played:
    """Follow a policy until each rover is out; `is_good` says which rocks are good, where that is not drawn."""
    good = rng.random((num, NUM)) < 0.5 if is_good is None else np.tile(is_good, (num, 1))
    who, (rovers, seen), rows = np.arange(num), begin(good), []
    for stage in range(1, HORIZON + 1):
        chance = rule(seen, stage) if stage < HORIZON else np.eye(len(choices.names))[np.full(len(who), -1)]
        up_to = chance.cumsum(axis=1)
        choice = (rng.random(len(who))[:, None] * up_to[:, -1:] >= up_to).sum(axis=1)
        means, row = choices.skills(seen), np.arange(len(who))
        skill = means[row, choice]
        both = np.column_stack([chance[row, choice], (chance * (means == skill[:, None])).sum(axis=1)])
        rovers, after, reward = carried_out(rovers, seen, skill, rng)
        rows.append((who, np.full(len(who), stage), *seen, choice, skill, both, reward, after.steps))
        on = ~rovers.is_out
        who, rovers, seen = who[on], rows_of(rovers, on), rows_of(after, on)
        if not len(who):
            break
    columns = [np.concatenate(column) for column in zip(*rows, strict=True)]
    order = np.lexsort((columns[1], columns[0]))
    columns = [column[order] for column in columns]
    return Played(*columns[:2], Seen(*columns[2:5]), *columns[5:])


def heuristic(share: float = 0.0) -> Rule:
    """Sample the nearest rock not believed to be bad, if it is surely good, else check it; leave if there is none.

    At a share of decisions, any choice by rank.
    """

    def chances(seen: Seen, stage: int) -> Float[np.ndarray, "n 7"]:
        rock, there = nearest(seen)
        is_sure = np.take_along_axis(seen.belief, rock, axis=1)[:, 0] >= SURE
        choice = np.where(there[:, 0], np.where(is_sure, RANKS, 0), 2 * RANKS)
        return (1.0 - share) * np.eye(2 * RANKS + 1)[choice] + share / (2 * RANKS + 1)

    return chances


def log_of(played: Played, choices: Choices, covariates: pd.DataFrame, rate: float, rng: np.random.Generator) -> Logs:
    """A log, of a second a step, that is cut at a rate."""
    length = played.lengths
    cut = rng.exponential(1.0 / rate, len(length)) if rate else np.full(len(length), np.inf)
    begins = np.where(played.stage == 1, 0, np.roll(played.end, 1))
    is_begun, is_done = begins < cut[played.trajectory], played.end <= cut[played.trajectory]
    by_rank = choices is BY_RANK
    stages = {
        "trajectory": played.trajectory,
        "stage": played.stage,
        "elapsed_s": np.where(is_done, played.end, np.nan),
        "action": np.array(choices.names, dtype=object)[played.choice if by_rank else played.skill],
        "reward": np.where(is_done, played.reward, np.nan),
        "probability": played.chance[:, 0 if by_rank else 1],
    }
    frame = pd.concat([pd.DataFrame(stages), covariates], axis=1)[is_begun].reset_index(drop=True)
    ends = {"end_s": np.minimum(length, cut), "ending": np.where(length <= cut, "finished", "cut")}
    return Logs(frame, pd.DataFrame({"trajectory": np.arange(len(length)), **ends}))


def rate_of(share: float, rule: Rule, rng: np.random.Generator) -> float:
    """Rate of cuts a step by which this share of a policy's trajectories is cut."""
    length = play(4000, rule, BY_RANK, rng).lengths
    return float(brentq(lambda rate: np.mean(-np.expm1(-rate * length)) - share, 0.0, 1.0)) if share else 0.0


def best_routes() -> Float[np.ndarray, "256 9"]:
    """Value of the best route by which rocks are good, as a number of eight bits, and place: a rock, or the start.

    For one who sees which rocks are good; no policy is worth more.
    """
    places = np.vstack([ROCKS, START])
    gain = DISCOUNT ** np.abs(places[:, None] - ROCKS).sum(axis=-1)
    out = PAY * DISCOUNT ** (SIZE - 1 - places[:, 0])
    value = np.empty((2**NUM, len(places)))
    for good in range(2**NUM):
        ways = [gain[:, k] * (PAY + DISCOUNT * value[good ^ 1 << k, k]) for k in range(NUM) if good >> k & 1]
        value[good] = np.max([out, *ways], axis=0)
    return value
