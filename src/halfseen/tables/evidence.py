"""Evidence on the laws in the log of a table: attempts with the time that each was watched, and labels of each look.

All fits of laws maximise the log-likelihood of this evidence plus the log-density of a weak normal prior, which weighs
as much as a few observations.

Where several robots act at once:

*Looks.* An object that another robot holds up hides nothing and is fully visible, and no log records since when it is
held. So labels count only if no robot was at an object when they were made, and if the stage brought a single look. A
stage in which a robot finished, which frees no robot, has two. This selection does not depend on the labels.

*Washing.* The reward of a stage is the sum over all robots. Failures, LIFTs and seconds have known prices, so where one
object left the table the remaining reward shows whether it was dirty. The last stage of a trajectory is not used,
because its reward includes the price of the objects left. Nor is a stage in which a robot was at its last decision,
because the end of that is not recorded.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from halfseen.arrays import RowIds, RowMask, Rows, record
from halfseen.learning.rows import stage_places
from halfseen.logs import Logs
from halfseen.shapes import Bool, Float
from halfseen.tables.encoding import logged_actions
from halfseen.tables.grasp_attempts import attempts
from halfseen.tables.present import logged_dirty_share
from halfseen.tables.rewards import LASTED_S, NUM_LEFT, following, outcomes_of
from halfseen.world.actions import FINISH, ActionSpace, Verb, is_decider
from halfseen.world.config import WorldConfig
from halfseen.world.log_rows import begun_objects
from halfseen.world.logs import spread, states_of
from halfseen.world.seeing import SAME_VIEW
from halfseen.world.state import TableState


def is_plain_look(states: TableState) -> Bool[np.ndarray, "n T"]:
    """Whether there was a single look before each stage, with no robot at an object."""
    robots = states.robots
    assert robots is not None
    is_nobody_at_work = ~np.any(robots.is_busy & np.isin(robots.verb, (1, 2)), axis=-1)
    num_done = robots.is_done.sum(axis=-1)
    return is_nobody_at_work & (np.diff(num_done, axis=1, prepend=0) == 0)


@record
class Brought:
    """Outcomes of the stages of a team's log."""

    outcome: Float[np.ndarray, "n T 6"]
    """As in `outcomes_of`."""
    reward: Float[np.ndarray, "n T"]
    """NaN where not completed."""
    goes_on: Bool[np.ndarray, "n T"]
    """Completed stages that another one follows, in which no robot is at its last decision."""
    is_last: Bool[np.ndarray, "n T"]
    """Completed stages after which the trajectory ended by itself, or was cut at once."""
    is_finish: Bool[np.ndarray, "n T"]
    """Stages that began with a FINISH."""
    has_left: Bool[np.ndarray, "n T N"]
    """Which objects left the table; meaningless where the trajectory does not continue."""


def brought_by(logs: Logs, states: TableState) -> Brought:
    """Read the outcomes of each stage."""
    at, (num, horizon) = stage_places(logs), states.steps_to_go.shape
    action, space = logged_actions(logs, horizon, states.num_objects, is_team=True), ActionSpace(states.num_objects)
    columns = (logs.stages[name].to_numpy(dtype=np.float64, na_value=np.nan) for name in ("reward", "elapsed_s"))
    reward, clock_s = (spread(column, at, (num, horizon), np.nan) for column in columns)
    is_stage = np.zeros((num, horizon + 1), dtype=bool)
    is_stage[at] = True
    lasted_s = np.nan_to_num(np.diff(clock_s, axis=1, prepend=0.0))
    robots = states.robots
    assert robots is not None
    is_at_last = (is_decider(states) & (robots.decisions_to_go == 1)) | (robots.is_busy & (robots.decisions_to_go == 0))
    goes_on = np.isfinite(reward) & is_stage[:, 1:]
    return Brought(
        outcomes_of(states, space.verb(action), space.target(action), lasted_s),
        reward,
        goes_on & ~np.any(is_at_last, axis=-1),
        np.isfinite(reward) & ~is_stage[:, 1:],
        is_stage[:, :-1] & (action == FINISH),
        states.is_on_table & ~following(states.is_on_table),
    )


def beside_prices(brought: Brought, config: WorldConfig) -> Float[np.ndarray, "n T"]:
    """Reward of each stage without those of failures, LIFTs and seconds."""
    prices = (config.reward_wash_failed, config.reward_lift_per_s, config.reward_per_s)
    return brought.reward - brought.outcome[..., : LASTED_S + 1] @ np.array(prices, dtype=np.float64)


def shown_by_washing(brought: Brought, config: WorldConfig) -> Bool[np.ndarray, "2 n N"]:
    """Objects that washing showed to be dirty, and to be clean."""
    is_one = brought.goes_on & (brought.outcome[..., NUM_LEFT] == 1)
    paid = np.where(is_one, beside_prices(brought, config), np.nan)
    is_clean = np.abs(paid - config.reward_wash_dirty) >= np.abs(paid - config.reward_wash_clean)
    each = [is_one & ~is_clean, is_one & is_clean]
    return np.stack([np.any(brought.has_left & which[..., None], axis=1) for which in each])


AT_LIMIT = 0.98
"""An attempt that lasted this share of its limit counts as at the limit, because clocks are rounded."""
NO_NEWS = 1e-4
"""Smaller changes of log-odds are rounding errors."""


class TimedAttempts(NamedTuple):
    """Attempts with the time that each was watched, n rows."""

    trajectory: RowIds
    """Rank of the trajectory in the log."""
    object: RowIds
    """Number of the object, unique across trajectories."""
    occlusion: Rows
    """Hidden share when the attempt began, in [0, 1]."""
    grip: Rows
    watched_s: Rows
    """Time watched, without transport: until the attempt held, missed or was cut; at most the limit [s]."""
    is_held: RowMask
    is_missed: RowMask
    """Whether the miss was observed; an attempt that neither held nor missed was cut."""


class Labels(NamedTuple):
    """Labels that were news, n rows."""

    trajectory: RowIds
    """Rank of the trajectory in the log."""
    object: RowIds
    """Number of the object, unique across trajectories."""
    occlusion: Rows
    """Hidden share in the look; 0 for an object held up."""
    is_held: RowMask
    seen: Rows
    """Share of the surface that the recorder counted as seen before; 0 if the log counts none."""
    seen_after: Rows
    """The same after the label."""
    says_dirty: RowMask
    was_dirty: RowMask
    was_clean: RowMask
    """Whether washing showed the object to be clean; both are False for one never washed."""
    moved: Rows
    """Change of the recorded log-odds."""

    @property
    def is_persistent(self) -> bool:
        """Whether the recorder counted seen shares, and ignored looks that show nothing new."""
        return bool(self.seen_after.any())


def of_first(rows: Any, num_trajectories: int) -> Any:
    """Keep the rows of the first trajectories, of `TimedAttempts` or `Labels`."""
    kept = rows.trajectory < num_trajectories
    return type(rows)(*(values[kept] for values in rows))


class Evidence(NamedTuple):
    """Evidence of a log on the laws."""

    tried: TimedAttempts
    labels: Labels
    dirty_share: float
    """P(DIRTY) of an object before any label, the prior of the log-odds."""

    def first(self, num_trajectories: int) -> "Evidence":
        """Keep the evidence of the first trajectories; the share of dirty objects stays the recorder's."""
        return self._replace(
            tried=of_first(self.tried, num_trajectories), labels=of_first(self.labels, num_trajectories)
        )


def evidence_of(logs: Logs, known: WorldConfig) -> Evidence:
    """Read the evidence from a log.

    The log may be of one robot or several; a column grip of its objects is used if there is one. Of `known`, the
    horizon, transport_s, speed, the limit of an attempt and the rewards are used.

    Raises
    ------
    LogError
        As in `states_of` and `attempts`.
    """
    dirty_share, tried = logged_dirty_share(logs), attempts(logs, known.horizon)
    trajectory = pd.Index(logs.trajectory_ids).get_indexer(tried["trajectory"]).astype(np.int64)
    is_held = tried["succeeded"].fillna(False).to_numpy(dtype=bool)
    row = np.searchsorted(stage_places(logs)[0], trajectory) + tried["stage"].to_numpy() - 1
    return Evidence(
        _watched(tried, trajectory, is_held, known),
        _labels(logs, known, dirty_share, trajectory[is_held], row[is_held]),
        dirty_share,
    )


def _watched(tried: pd.DataFrame, trajectory: RowIds, is_held: RowMask, known: WorldConfig) -> TimedAttempts:
    """All attempts, cut ones included.

    An attempt precedes its transport. So one cut c seconds into its stage had not ended within c − transport_s seconds,
    and carries no information if that is below 0. A miss that lasted `AT_LIMIT` of the limit or more counts as having
    lasted the limit.
    """
    occlusion, grip, time_s = (tried[name].to_numpy(dtype=np.float64) for name in ("occlusion", "grip", "time_s"))
    is_missed, limit_s = tried["is_finished"].to_numpy(dtype=bool) & ~is_held, float(known.grasping.limit_s)
    # The time of the world is the time of a robot times its speed.
    speed = np.asarray(known.speed, dtype=np.float64)[tried["robot"]] if "robot" in tried.columns else 1.0
    until_s = np.clip(time_s * speed - float(known.transport_s), 0.0, limit_s)
    watched_s = np.where(is_missed & (until_s >= AT_LIMIT * limit_s), limit_s, until_s)
    return TimedAttempts(
        trajectory, tried["object"].to_numpy(dtype=np.int64), occlusion, grip, watched_s, is_held, is_missed
    )


def _labels(logs: Logs, known: WorldConfig, dirty_share: float, held_trajectory: RowIds, held_row: RowIds) -> Labels:
    """Labels of every look: DIRTY where it raised the log-odds, clean where it lowered them.

    The size of the change is the recorder's confidence in its labels (`recorder`). A look that changed nothing was no
    news and is left out, unless it added to the seen share: then it found nothing there. The reward of a successful
    WASH shows whether the object was dirty; one in the last step of the horizon is left out, because its reward
    includes the price of the objects left. For several robots, see the docstring of this module.
    """
    states = states_of(logs, known.num_stages)
    is_held = np.diff(states.lifts, axis=1, prepend=0) > 0
    moved = _moved(states, dirty_share)
    shows_more = np.diff(states.seen, axis=1, prepend=0.0) > SAME_VIEW
    is_news = ((np.abs(moved) > NO_NEWS) | shows_more) & states.is_on_table
    if states.robots is None:
        was = _shown(logs, known, held_trajectory, held_row, (len(states.lifts), states.num_objects))
    else:
        is_counted = is_plain_look(states)[..., None]
        # Washing depends on labels that are left out, so the dirt of those objects is treated as unknown.
        was = shown_by_washing(brought_by(logs, states), known) & ~np.any(is_news & ~is_counted, axis=1)
        is_news = is_news & is_counted
    trajectory, stage, target = at = np.nonzero(is_news)
    seen = states.seen.astype(np.float64)
    return Labels(
        trajectory=trajectory,
        object=trajectory * states.num_objects + target,
        occlusion=_occluded(states, is_held)[at].astype(np.float64),
        is_held=is_held[at],
        seen=np.where(stage > 0, seen[trajectory, stage - 1, target], 0.0),
        seen_after=seen[at],
        says_dirty=moved[at] > NO_NEWS,
        was_dirty=was[0, trajectory, target],
        was_clean=was[1, trajectory, target],
        moved=moved[at].astype(np.float64),
    )


def _shown(
    logs: Logs, known: WorldConfig, held_trajectory: RowIds, held_row: RowIds, shape: tuple[int, int]
) -> Bool[np.ndarray, "2 trajectories N"]:
    """Objects that washing showed to be dirty, and to be clean."""
    was = np.zeros((2, *shape), dtype=bool)
    is_wash = (logs.stages["action"] == Verb.WASH.name).to_numpy(dtype=bool)[held_row]
    paid = logs.stages["reward"].to_numpy(dtype=np.float64, na_value=np.nan)[held_row]
    is_clean = np.abs(paid - known.reward_wash_dirty) >= np.abs(paid - known.reward_wash_clean)
    was[is_clean[is_wash].astype(np.int64), held_trajectory[is_wash], begun_objects(logs)[held_row[is_wash]]] = True
    return was


def _moved(states: TableState, dirty_share: float) -> Float[np.ndarray, "n T N"]:
    """Change of the log-odds by each look; from the prior for the first look at an object."""
    prior = np.float32(np.log(dirty_share) - np.log1p(-dirty_share))
    log_odds = np.where(states.is_object, states.log_odds, prior)
    return np.diff(log_odds, axis=1, prepend=np.full_like(log_odds[:, :1], prior))


def _occluded(states: TableState, is_held: Bool[np.ndarray, "n T N"]) -> Float[np.ndarray, "n T N"]:
    """Hidden share of each object in the look before each stage; an object held up hid nothing and was fully visible.

    The object held up is the one whose count of lifts increased since the stage before.
    """
    is_hiding = (states.is_on_table & ~is_held)[:, :, None, :]
    hidden = 1.0 - np.prod(np.where(is_hiding, 1.0 - states.hides, 1.0), axis=-1)
    return np.where(is_held, 0.0, hidden)


class Prior(NamedTuple):
    """Independent normal prior of the parameters θ."""

    mode: Float[np.ndarray, "*S"]
    spread: Float[np.ndarray, "*S"] | float
    """Standard deviations of the densities."""

    def loss(self, theta: Any, log_likelihood: float, slope: Any) -> tuple[float, Any]:
        """Negative log-posterior up to a constant, and its gradient; `slope` is the gradient of the log-likelihood."""
        shift = (theta - self.mode) / self.spread
        return float((shift**2).sum() / 2.0 - log_likelihood), shift / self.spread - slope


def least(loss: Callable[[Rows], tuple[float, Rows]], start: Rows, bounds: Any, **options: float) -> Rows:
    """Minimise a loss that returns its gradient, by L-BFGS-B within pairs of bounds."""
    from scipy.optimize import minimize

    return minimize(loss, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options).x
