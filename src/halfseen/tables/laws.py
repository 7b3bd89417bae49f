"""A world with prices and laws fitted to the same log as the policy: the knowledge of a fair planner.

A planner that knows the true laws is an oracle; the operator of a cell does not know them. The operator knows the
rewards, the most steps of a trajectory, the transport time and the limit of an attempt, and has the log. The log also
determines the family of the laws (`law_grasping`, `law_seeing`). Prices and times can be read from it as well.

*Prices of a team.* A stage pays for everything that ends in it. Where no object left the table and the trajectory
continues, its reward is a deterministic function of the number of failed WASHes, the seconds of completed LIFTs and
those of the stage: a regression recovers their prices exactly. Where one object left, the remaining reward is that of a
dirty or a clean object. Where the last robot parked, it is the price of the objects left dirty. The duration of that
last stage is the time of going home.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from halfseen.arrays import Rows
from halfseen.logs import Logs
from halfseen.planners.belief import grasp_probability, known_seeing, prior_grip
from halfseen.shapes import Bool, Float
from halfseen.tables.evidence import Brought, Evidence, TimedAttempts, beside_prices, brought_by, evidence_of
from halfseen.tables.grasp_attempts import attempts, rows_of_attempts
from halfseen.tables.law_grasping import choose_grasping
from halfseen.tables.recorder import seeing_of
from halfseen.tables.rewards import DIRT_BEFORE, FAILED, LASTED_S, LIFTED_S, NUM_LEFT
from halfseen.world.actions import Verb
from halfseen.world.config import WorldConfig
from halfseen.world.grasping import AssumedGrasping
from halfseen.world.state import TableState

IN_PLAIN_SIGHT = 0.05
"""Hidden share below which an object is in plain sight."""
ENOUGH_LEFT = 5.0
"""Expected number of dirty objects left from which FINISHes without reward imply that leaving them is free."""
ENOUGH_HELD = 20
"""Number of successful WASHes from which a single common reward is that of both dirty and clean objects."""
SAME = 1e-3
"""Tolerance for multiples of a price, in units of it; and for a reward that counts as 0."""


def paid_in(logs: Logs, horizon: int, left: Rows) -> WorldConfig:
    """Read prices and times from a log; defaults are those of `WorldConfig`.

    `horizon` is T, of each robot, and `left` is the expected number of dirty objects on the table before each
    stage. The laws are the assumed ones with the log's limit of an attempt.
    """
    known, stages = WorldConfig(horizon=horizon), logs.stages
    reward = stages["reward"].to_numpy(dtype=np.float64, na_value=np.nan)
    action = stages["action"].to_numpy(dtype=object)
    seconds = _durations(logs)
    is_over = ~(stages["trajectory"] == stages["trajectory"].shift(-1)).to_numpy()
    done = np.isfinite(reward)
    found: dict[str, float] = {}
    finished = done & (action == Verb.FINISH.name)
    if finished.any():
        found["transport_s"] = float(np.median(seconds[finished]))
        price = price_of_each(reward[finished], left[finished])
        if price is not None:
            found["reward_dirty_left"] = price
    found |= _washed(logs, horizon, reward, action, is_over)
    lifted = done & (action == Verb.LIFT.name) & ~is_over
    if lifted.any():
        found["reward_lift_per_s"] = float(reward[lifted] @ seconds[lifted] / (seconds[lifted] @ seconds[lifted]))
    known = replace(known, **found)
    attempted = done & np.isin(action, [Verb.WASH.name, Verb.LIFT.name])
    if attempted.any():
        longest = float(seconds[attempted].max()) - float(known.transport_s)
        if longest > 0.0:
            known = replace(known, grasping=AssumedGrasping(limit_s=longest))
    return known


def _durations(logs: Logs) -> Float[np.ndarray, " rows"]:
    elapsed = logs.stages["elapsed_s"]
    before = elapsed.groupby(logs.stages["trajectory"]).shift(fill_value=0.0)
    return (elapsed - before).to_numpy(dtype=np.float64, na_value=np.nan)


def price_of_each(paid: Rows, left: Rows) -> float | None:
    """Price of one object left dirty: the common divisor of the rewards of FINISH, or else a regression.

    None where too few objects were left.
    """
    some = paid < 0.0
    if not some.any():
        return 0.0 if left.sum() > ENOUGH_LEFT else None
    slope = float(paid @ left / (left @ left))
    for of_least in (1, 2, 3):
        price = float(paid[some].max()) / of_least
        count = paid / price
        if np.abs(count - np.round(count)).max() < SAME and 0.67 < slope / price < 1.5:
            return price
    return slope


def _washed(logs: Logs, horizon: int, reward: Rows, action: np.ndarray, is_over: np.ndarray) -> dict[str, float]:
    """Rewards of WASH: of a dirty object, of a clean one, and of a miss."""
    tried: Any = attempts(logs, horizon)
    tried = tried[tried["is_finished"].to_numpy(dtype=bool)]
    row = rows_of_attempts(logs, tried)
    is_wash = (action[row] == Verb.WASH.name) & np.isfinite(reward[row])
    held = tried["succeeded"].fillna(False).to_numpy(dtype=bool)
    paid_held, paid_missed = reward[row[is_wash & held & ~is_over[row]]], reward[row[is_wash & ~held & ~is_over[row]]]
    found: dict[str, float] = {}
    if len(paid_missed):
        found["reward_wash_failed"] = float(np.median(paid_missed))
    return found | dirty_and_clean(paid_held)


def dirty_and_clean(paid: Rows) -> dict[str, float]:
    """Rewards of dirty and of clean objects: the upper and the lower rewards of WASHes.

    Where a few WASHes have one common reward, a positive one is that of dirty objects, a negative one that of clean
    ones.
    """
    if not len(paid):
        return {}
    if np.ptp(paid) == 0.0:
        if len(paid) >= ENOUGH_HELD:
            return dict.fromkeys(("reward_wash_dirty", "reward_wash_clean"), float(paid[0]))
        return {"reward_wash_dirty" if paid[0] > 0.0 else "reward_wash_clean": float(paid[0])}
    is_dirty = paid >= (paid.min() + paid.max()) / 2.0
    each = {"reward_wash_dirty": paid[is_dirty], "reward_wash_clean": paid[~is_dirty]}
    return {name: float(np.median(some)) for name, some in each.items()}


PRICE_ROUNDING = 1e-6
"""Prices of a second below this count as 0."""


def paid_in_team(logs: Logs, states: TableState) -> WorldConfig:
    """Read prices, times and speeds from the log of a team; defaults are those of `WorldConfig`.

    The laws are the assumed ones with the log's limit of an attempt; robot 0 has speed 1.
    """
    num_robots = states.num_robots
    known = WorldConfig(horizon=states.steps_to_go.shape[1] // num_robots, speed=(1.0,) * num_robots)
    brought = brought_by(logs, states)
    known = replace(known, **_certain(brought))
    is_last, home_s = _last_to_park(brought, states)
    washed = dirty_and_clean(beside_prices(brought, known)[brought.goes_on & (brought.outcome[..., NUM_LEFT] == 1)])
    known = replace(known, **washed, **_left(brought, known, is_last), **_times(home_s, num_robots))
    limit_s = _limit_s(logs, known)
    return known if limit_s is None else replace(known, grasping=AssumedGrasping(limit_s=limit_s))


def _certain(brought: Brought) -> dict[str, float]:
    """Prices of a failed WASH, of a second of a LIFT, and of a second of the clock."""
    names = {FAILED: "reward_wash_failed", LIFTED_S: "reward_lift_per_s", LASTED_S: "reward_per_s"}
    outcome = brought.outcome[brought.goes_on & (brought.outcome[..., NUM_LEFT] == 0)]
    priced = [column for column in names if np.any(outcome[:, column] != 0.0)]
    if not priced:
        return {}
    paid = brought.reward[brought.goes_on & (brought.outcome[..., NUM_LEFT] == 0)]
    found = np.linalg.lstsq(outcome[:, priced], paid, rcond=None)[0]
    prices = {names[column]: float(price) for column, price in zip(priced, found, strict=True)}
    if "reward_per_s" in prices:
        per_s = prices["reward_per_s"]
        prices["reward_per_s"] = min(0.0, per_s) if abs(per_s) > PRICE_ROUNDING else 0.0
    return prices


def _last_to_park(
    brought: Brought, states: TableState
) -> tuple[Bool[np.ndarray, "n T"], dict[int, Float[np.ndarray, " k"]]]:
    """Completed stages in which the last robot went home, and the times that each robot took [s]."""
    robots, decider = states.robots, states.decider
    assert robots is not None
    assert decider is not None
    others_done = np.sum(robots.is_parked, axis=-1) == robots.num_robots - 1
    parks = brought.is_last & others_done & ~np.any(robots.is_busy, axis=-1) & brought.is_finish
    seconds = brought.outcome[..., LASTED_S]
    return parks, {k: seconds[parks & (decider == k)] for k in range(robots.num_robots)}


def _left(brought: Brought, known: WorldConfig, is_last: Bool[np.ndarray, "n T"]) -> dict[str, float]:
    """Price of an object left dirty."""
    if not is_last.any():
        return {}
    # No object left the table in such a stage; its reward without that of its seconds is the price of those left.
    paid = brought.reward[is_last] - known.reward_per_s * brought.outcome[is_last, LASTED_S]
    price = price_of_each(np.where(np.abs(paid) < SAME, 0.0, paid), brought.outcome[is_last, DIRT_BEFORE])
    return {} if price is None else {"reward_dirty_left": price}


def _times(home_s: dict[int, Float[np.ndarray, " k"]], num_robots: int) -> dict[str, object]:
    """Seconds of going home, and the speed of each robot relative to robot 0; 1 where unknown."""
    each = [float(np.median(home_s[k])) if len(home_s[k]) else np.nan for k in range(num_robots)]
    if np.isnan(each).all():
        return {}
    transport_s = each[0] if np.isfinite(each[0]) else float(np.nanmedian(each))
    speed = tuple(float(np.round(transport_s / s, 3)) if np.isfinite(s) else 1.0 for s in each)
    return {"transport_s": transport_s, "speed": speed}


def _limit_s(logs: Logs, known: WorldConfig) -> float | None:
    """Longest attempt without its transport, at the speed of robot 0 [s]."""
    tried: Any = attempts(logs)
    tried = tried[tried["is_finished"].to_numpy(dtype=bool)]
    if not len(tried):
        return None
    seconds = tried["time_s"].to_numpy(dtype=np.float64) * np.asarray(known.speed)[tried["robot"].to_numpy()]
    longest = float(seconds.max()) - float(known.transport_s)
    return longest if longest > 0.0 else None


def fit_world(logs: Logs, known: WorldConfig) -> WorldConfig:
    """Fit laws of grasping and seeing to a log under censoring, each by maximum likelihood.

    Each law has two families, and the log determines which is used (`halfseen.tables.laws`): `AssumedGrasping` or
    `FittedGrasping`, `AssumedSeeing` or `PersistentSeeing`.

    Parameters
    ----------
    logs
        A log of tables.
    known
        World whose rewards, horizon, transport_s and limit of an attempt are kept. Its laws are ignored.

    Returns
    -------
    WorldConfig
        `known` with the fitted laws, and the share of dirty objects from `logged_dirty_share`.

    Raises
    ------
    LogError
        The log breaks a rule of tables.

    Examples
    --------
    >>> import numpy as np
    >>> from halfseen.world import Scene, TableWorld, UniformPolicy, WorldConfig
    >>> scene = Scene(np.array([[0.0, 0.4], [0.0, 0.0]]))
    >>> logs = TableWorld().simulate(scene, UniformPolicy(), episodes=400, seed=0, cut_share=0.5)
    >>> fitted = fit_world(logs, WorldConfig())
    >>> fitted.grasping.limit_s, round(fitted.seeing.accuracy(0.0), 1)
    (6.0, 0.8)
    """
    return fitted_to(evidence_of(logs, known), known)


def fitted_to(evidence: Evidence, known: WorldConfig) -> WorldConfig:
    """Fit the laws to the evidence of a log."""
    return fitted_laws(evidence, known).config


class FittedLaws(NamedTuple):
    """A world with laws fitted to a log, and whether the recorder's law of seeing is kept."""

    config: WorldConfig
    is_mended: bool
    """Whether the log's own log-odds are wrong and are recomputed."""
    sentence: str


def fitted_laws(evidence: Evidence, known: WorldConfig, prior: WorldConfig | None = None) -> FittedLaws:
    """Fit the laws to the evidence of a log.

    `known` is as in `fit_world`; `prior` centres the priors, None for weak ones.
    """
    limit_s, labels = float(known.grasping.limit_s), evidence.labels
    grasping = choose_grasping(evidence.tried, limit_s, None if prior is None else prior.grasping)
    seen = seeing_of(labels, evidence.dirty_share, None if prior is None else known_seeing(prior))
    config = replace(known, dirty_share=evidence.dirty_share, grasping=grasping, seeing=seen.law)
    is_mended = len(labels.trajectory) > 0 and (seen.recorder is None or seen.is_rejected)
    family = "a look that shows nothing new adds no evidence" if labels.is_persistent else "each look adds evidence"
    if not len(labels.trajectory):
        how = "there are no labels to estimate the law of seeing from"
    elif seen.recorder is None:
        how = (
            "no single law of seeing explains the log-odds of the log: the law is fitted to the labels "
            f"({family}) and the log-odds are recomputed"
        )
    elif seen.is_rejected:
        how = (
            "the labels contradict the recorder’s law of seeing: the law is fitted to them and the log-odds are "
            "recomputed"
        )
    else:
        how = f"the law of seeing is read from the log-odds of the log ({family}); the labels do not contradict it"
    return FittedLaws(config, is_mended, how)


def laws_in_words(laws: FittedLaws, tried: TimedAttempts) -> str:
    """Describe the predictions of fitted laws for the attempts of their log, and for a first look."""
    config: Any = laws.config
    grip = prior_grip(tried.grip.astype(np.float32))
    chance = grasp_probability(config, tried.occlusion.astype(np.float32), grip)
    parts = []
    for words, is_it in (
        ("in plain sight", tried.occlusion < IN_PLAIN_SIGHT),
        ("half hidden or more", tried.occlusion > 0.5),
    ):
        if is_it.any():
            parts.append(f"{chance[is_it].mean():.2f} of the {is_it.sum():,} objects that were {words}")
    held = f"a first grasp holds for {' and '.join(parts)}; " if parts else ""
    found, falsely = (float(each) for each in config.seeing.positive(0.0, 0.0))
    looks = f"a first look in full view labels {found:.0%} of dirty objects and {falsely:.0%} of clean ones as dirty"
    return f"under its laws, {held}{looks}"
