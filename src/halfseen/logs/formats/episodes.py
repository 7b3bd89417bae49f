"""Episodes of other people's datasets as trajectories: what was seen before each action, and how the last step ended.

A step is a stage: what was observed, the action that was taken on it, what it earned, and when it ended. Where a
dataset also has what was observed after the last step, a cut falls into the stage of that observation; where it has
not, into the last step itself, whose reward is passed over, as a stage that was not completed has none.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from halfseen.errors import ArgumentError, LogError, within
from halfseen.logs.columns import CUT, FINISHED, shown
from halfseen.logs.formats.step_values import warn
from halfseen.logs.logs import Logs
from halfseen.shapes import Bool, Float, Shaped

TRUNCATED = "truncated"


@dataclass(frozen=True)
class StepRules:
    """What the reader of another's dataset is told; None leaves it to what the format usually has.

    Parameters
    ----------
    action, reward
        Columns that hold the action, one of finitely many, and what it earned.
    done
        Column that is true where an episode reached its own end.
    clock
        Column that holds the time [s].
    step_s
        How long a step lasts [s], where there is no clock.
    truncated
        "cut" or "finished" (at its horizon): what an episode is that did not terminate.

    Raises
    ------
    ArgumentError
        A step takes no time, both `clock` and `step_s` are given, or `truncated` is neither.
    """

    action: str | None = None
    reward: str | None = None
    done: str | None = None
    clock: str | None = None
    step_s: float | None = None
    truncated: str = CUT

    def __post_init__(self) -> None:
        if self.step_s is not None and not (np.isfinite(self.step_s) and self.step_s > 0):
            raise ArgumentError(f"step_s {self.step_s}: a step lasts a finite time above 0 s")
        if self.step_s is not None and self.clock is not None:
            raise ArgumentError(f"step_s {self.step_s} and clock {self.clock!r}: both tell the time; give one of them")
        if self.truncated not in (CUT, FINISHED):
            raise ArgumentError(f"truncated {self.truncated!r}: it is neither {CUT!r} nor {FINISHED!r}; say one")

    @property
    def named(self) -> dict[str, str]:
        """The columns that are named, by what they hold."""
        roles = {"action": self.action, "reward": self.reward, "done": self.done, "clock": self.clock}
        return {role: name for role, name in roles.items() if name is not None}

    @property
    def of_truncated(self) -> tuple[str, str | None]:
        """Ending and cause of an episode that did not terminate."""
        return (FINISHED, None) if self.truncated == FINISHED else (CUT, TRUNCATED)


@dataclass(frozen=True)
class Episode:
    """An episode of T steps.

    Parameters
    ----------
    name
        Of its trajectory.
    observed
        Columns of what was observed, T rows each, or one more where `has_last`.
    actions
        Action of each step, shape (T,): whole numbers or text.
    rewards
        What each step earned, shape (T,).
    ends_s
        Time from the beginning to the end of each step [s], shape (T,).
    ending, cause
        As in `trajectories` of `Logs`.
    has_last
        Whether what was observed after the last step is known.
    """

    name: int | str
    observed: Mapping[str, Shaped[np.ndarray, " O"]]
    actions: Shaped[np.ndarray, " T"]
    rewards: Float[np.ndarray, " T"]
    ends_s: Float[np.ndarray, " T"]
    ending: str
    cause: str | None
    has_last: bool


@dataclass(frozen=True)
class StepColumns:
    """Steps of all episodes of a dataset, one below the other in N rows.

    Parameters
    ----------
    observed
        Columns of what was observed.
    actions, rewards
        As in `Episode`.
    """

    observed: Mapping[str, Shaped[np.ndarray, " N"]]
    actions: Shaped[np.ndarray, " N"]
    rewards: Float[np.ndarray, " N"]

    def episode(
        self,
        name: int | str,
        rows: slice,
        ends_s: Float[np.ndarray, " T"],
        ending: tuple[str, str | None],
        *,
        after: Mapping[str, Any] | None = None,
    ) -> Episode:
        """Take the steps of one episode.

        Parameters
        ----------
        name
            Of its trajectory.
        rows
            Its steps.
        ends_s
            As in `Episode`.
        ending
            Ending and cause.
        after
            What was observed after its last step; None where that is not known.
        """
        observed = {column: values[rows] for column, values in self.observed.items()}
        if after is not None:
            observed = {column: np.append(values, after[column]) for column, values in observed.items()}
        return Episode(
            name, observed, self.actions[rows], self.rewards[rows], ends_s, *ending, has_last=after is not None
        )


def logs_of_episodes(place: str, episodes: Sequence[Episode]) -> Logs:
    """Make trajectories of episodes.

    Parameters
    ----------
    place
        What to call the dataset in messages.
    episodes
        With the same columns each.

    Raises
    ------
    LogError
        There is none, one has no step, or the log breaks an invariant.
    """
    if not episodes:
        raise LogError(f"{place}: it has no episodes; a log has at least one trajectory")
    for episode in episodes:
        if not len(episode.actions):
            raise LogError(f"{place}, episode {shown(episode.name)}: it has no step; leave the episode out")
    stages = [_stages(episode) for episode in episodes]
    columns: dict[str, Any] = {name: np.concatenate([part[name] for part in stages]) for name in stages[0]}
    is_whole = all(episode.actions.dtype.kind == "i" for episode in episodes)
    columns["action"] = pd.array(columns["action"].tolist(), dtype="Int64" if is_whole else object)
    ends: dict[str, list[Any]] = {
        "trajectory": [episode.name for episode in episodes],
        "end_s": [episode.ends_s[-1] for episode in episodes],
        "ending": [episode.ending for episode in episodes],
        "cause": [episode.cause for episode in episodes],
    }
    with within(place):
        return Logs(stages=pd.DataFrame(columns), trajectories=pd.DataFrame(ends))


def _stages(episode: Episode) -> dict[str, np.ndarray]:
    is_cut = episode.ending == CUT
    num_steps = len(episode.actions)
    num_completed = num_steps - (is_cut and not episode.has_last)
    num_stages = num_completed + is_cut
    unknown = np.full(int(is_cut), np.nan)
    actions = np.full(num_stages, None, dtype=object)
    actions[: min(num_steps, num_stages)] = episode.actions[:num_stages]
    return {
        "trajectory": np.repeat(np.array([episode.name], dtype=object), num_stages),
        "stage": np.arange(1, num_stages + 1),
        "elapsed_s": np.append(episode.ends_s[:num_completed], unknown),
        "action": actions,
        "reward": np.append(episode.rewards[:num_completed], unknown),
        **{name: values[:num_stages] for name, values in episode.observed.items()},
    }


def ends_of(times_s: Float[np.ndarray, " O"], num_steps: int) -> Float[np.ndarray, " T"]:
    """Ends of steps by the times of their observations, one more than there are steps, or by those ends themselves."""
    return times_s if len(times_s) == num_steps else times_s[1:] - times_s[0]


def even_ends(num_steps: int, step_s: float) -> Float[np.ndarray, " T"]:
    """Ends of steps that last the same time each."""
    return step_s * np.arange(1.0, num_steps + 1)


def step_of(place: str, rules: StepRules) -> float:
    """How long a step lasts where there is no clock [s]; 1 s, with a warning, where nobody says."""
    if rules.clock is None and rules.step_s is None:
        warn(place, "no clock is named, so that every step counts as 1 s; name what holds it as clock, or give step_s")
    return 1.0 if rules.step_s is None else rules.step_s


def refuse_early(place: str, name: int | str, ends: Bool[np.ndarray, " T"]) -> None:
    """Refuse an episode that ends before its last step.

    Raises
    ------
    LogError
        It does.
    """
    if ends[:-1].any():
        raise LogError(
            f"{place}, episode {shown(name)}: step {int(np.argmax(ends)) + 1} of {len(ends)} ends it; make two "
            "episodes of it"
        )
