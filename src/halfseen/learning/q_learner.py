"""Censored Q-learning as a scikit-learn estimator: parameters in, `fit`, fitted attributes that end in ``_``.

The defaults are one strong recipe. Targets are imputed, because weights add noise and completed stages alone are
biased. Q is a quadratic with a smooth remainder, or linear in features that a task defines, and is taken at its lower
confidence bound. Only choices that logs can decide are left to them. `benchmarks/learners.py` compares the recipe with
others, on logs that were not used to choose it.
"""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import partial
from typing import Any, Literal

import numpy as np
import pandas as pd

from halfseen.censoring import CensoringModel, CutModel, WeightDiagnostics
from halfseen.errors import ArgumentError
from halfseen.estimator import Estimator, check_fitted, check_seed, is_count
from halfseen.learning.named_task import NamedActions
from halfseen.learning.promise import believable
from halfseen.learning.q_model import QModel, checked_log
from halfseen.learning.q_space import (
    SMOOTH,
    TREND,
    CrossValidation,
    LinearQ,
    QSpace,
    StageMode,
    TabularQ,
    half_life_of,
    pessimism_of,
    q_space_of,
    reg_of,
    stage_mode_of,
)
from halfseen.learning.recursion import QFunctions
from halfseen.learning.rows import unseen_in_words
from halfseen.learning.stage_trend import stage_trend_of
from halfseen.learning.streaming import learned_from
from halfseen.learning.tabular import is_state, with_states
from halfseen.learning.targets import BuckleyJames, Targets, Weighted, targets_of
from halfseen.learning.task import AUTO, Task, learner_of, named_task
from halfseen.logs import Logs, LogStream
from halfseen.shapes import Float
from halfseen.workers import Workers
from halfseen.workers.threads import in_one_thread

PESSIMISM = 2.0
"""Standard errors by which the value of a whole trajectory is lowered if the errors of its stages are independent."""

MANY_ACTIONS = 8
"""From this many actions on, each has few stages, and partial pooling pays (`benchmarks/many_actions.py`)."""


@dataclass(eq=False, repr=False)
class CensoredQLearner(Estimator):
    """Learn a policy from trajectories of which some were right-censored (paper, eq. 3) [GoldbergKosorok2012]_.

    Backwards from Q̂_{T+1} ≡ 0, each Q̂_t regresses R_t + max_a' Q̂_{t+1}(S_{t+1}, a') on (S_t, A_t) over the completed
    stages, weighted by δ_t / Ĝ(U_t⁻).

    Parameters
    ----------
    horizon
        T, the maximum number of stages of a trajectory.
    actions
        Names of the actions, or a mapping from stage (from 1) to the names of the actions possible there, or a `Task`,
        such as that of tables (see `for_table`).
    covariates
        Stage columns that Q uses, for named actions: numbers, or text of at most 20 categories, with an indicator for
        each but the first (`covariates`). Text of more categories is a state, and must be the only covariate.
    q_function
        ``"linear"``: Q is linear in the covariates (for another task, in its features). ``"quadratic"``: linear in the
        covariates and their products. ``"kernel"`` or ``KernelQ(…)``: in the RKHS of a Gaussian kernel on them.
        ``"smooth"``: the sum of a quadratic and an RKHS function. ``"tabular"``: one value per action and state, the
        state named by a column, with partial pooling (`tabular`). ``"auto"``: smooth; but linear if a task defines its
        own features, or if covariates and actions are so many that a fit would take minutes; and tabular if the only
        covariate is text of more than 20 categories.
    censoring
        How the rewards that cuts removed are replaced. ``"kaplan-meier"``, ``"cox"``, ``"kernel"`` or a
        `CensoringModel`: weights by that model of the cuts, or ``Weighted(…)`` with its clock and covariates.
        ``DoublyRobust(…)``: pseudo-outcomes for every stage that began. ``"buckley-james"`` or ``BuckleyJames(…)``:
        imputed by a regression alone. ``"none"``: completed stages get equal weights. ``"auto"``: imputed, or
        Kaplan–Meier weights if the action of a cut stage is not known.
    stages
        ``"separate"``: one Q per stage. ``"pooled"``: one per number of steps to go, fitted to all rows. ``"trend"``:
        pooled, with effects that change linearly from stage to stage (`stage_trend`). ``"auto"``: pooled, unless
        another predicts clearly better (`judging`).
    reg
        λ; ``"cv"`` or ``CrossValidation(…)``: chosen for each regression and block by weighted cross-validation.
    pessimism
        Standard errors by which Q is lowered wherever a maximum is taken, in eq. 3 and by the policy, so that estimates
        from few stages are not trusted (`regression`). The policy lowers Q less for actions that the log often takes,
        unless they earned less (`preference`). 0 gives eq. 3 unchanged. ``"auto"``: 2/√T, 0 if `censoring` is given.
    random_state
        Seed of the folds of trajectories and the landmarks of a kernel.
    half_life
        Number of trajectories over which a trajectory's weight in eq. 3 halves, counted back from the last of the log
        (`sample`). ``"auto"`` chooses it on held-out later trajectories (`judging`); None weights all equally. Models
        of cuts and of durations always weight all equally.

    Attributes
    ----------
    model_ : QModel
        The model composed from the parameters, with everything fitted before Q.
    q_functions_ : QFunctions
        Coefficients and λ of every Q.
    weights_ : Float[ndarray, "n T"]
        Weight of every stage in eq. 3.
    diagnostics_ : WeightDiagnostics
        Effective sample size, largest weight, share truncated.
    chosen_ : tuple of str
        What was chosen automatically, and why; one sentence each.
    policy_ : DiscretePolicy, or what the task makes
        The learned policy, independent of the learner.

    Examples
    --------
    >>> from halfseen.logs import Logs
    >>> stages = {"trajectory": [0, 1, 2, 3], "stage": [1, 1, 1, 1], "action": ["A", "B", "B", "A"]}
    >>> stages |= {"elapsed_s": [1.0, 1.0, 2.0, None], "reward": [0.0, 1.0, 2.0, None]}
    >>> trajectories = {"trajectory": [0, 1, 2, 3], "end_s": [1.0, 1.0, 2.0, 1.5], "ending": ["finished"] * 3 + ["cut"]}
    >>> logs = Logs(stages=stages, trajectories=trajectories)
    >>> learner = CensoredQLearner.of_paper(horizon=1, actions=["A", "B"], reg=0.0).fit(logs)
    >>> learner.decide(pd.DataFrame(index=[0]), stage=1)
    array(['B'], dtype=object)
    """

    horizon: int
    actions: Sequence[Hashable] | Mapping[int, Sequence[Hashable]] | Task
    covariates: Sequence[str] = ()
    _: KW_ONLY
    q_function: QSpace | Literal["auto", "linear", "quadratic", "kernel", "smooth", "tabular"] | str = AUTO
    censoring: Targets | CensoringModel | str = AUTO
    stages: StageMode | Literal["trend", "auto"] | str = AUTO
    reg: CrossValidation | float | int | Literal["cv"] | str = "cv"
    pessimism: float | int | Literal["auto"] | str = AUTO
    random_state: int = 0
    half_life: float | int | Literal["auto"] | str | None = None

    model_: QModel = field(init=False)
    q_functions_: QFunctions = field(init=False)
    weights_: Float[np.ndarray, "n T"] = field(init=False)
    diagnostics_: WeightDiagnostics = field(init=False)
    chosen_: tuple[str, ...] = field(init=False)
    policy_: Any = field(init=False)

    @classmethod
    def for_table(
        cls,
        horizon: int = 10,
        *,
        grasp: Any = AUTO,
        reduces_variance: bool = True,
        laws: str | None = AUTO,
        **parameters: Any,
    ) -> "CensoredQLearner":
        """Make a learner for logs of tables of objects, with the actions WASH, LIFT and FINISH.

        Parameters
        ----------
        horizon
            T.
        grasp, reduces_variance
            Parameters of the task (see `halfseen.tables.TableTask`).
        laws
            ``"auto"``: with the help of laws fitted to the log (see `halfseen.tables.TableLearner`), unless
            `q_function`, `stages`, `reg`, `pessimism` or `half_life` is given; None: eq. 3 without laws; else refused.
        **parameters
            Parameters of the learner.
        """
        task = named_task("table", grasp=grasp, reduces_variance=reduces_variance)
        return learner_of("table", cls, laws, parameters)(horizon, task, **parameters)

    @classmethod
    def for_team(
        cls,
        num_robots: int,
        horizon: int = 10,
        *,
        grasp: Any = AUTO,
        reduces_variance: bool = True,
        base: Any = AUTO,
        laws: str | None = AUTO,
        **parameters: Any,
    ) -> "CensoredQLearner":
        """Make a learner for logs of K robots at one table, as `for_table` does for one.

        Parameters
        ----------
        num_robots, horizon
            K, and the decisions of each robot; T is their product.
        grasp, reduces_variance, base
            Parameters of the task (see `halfseen.tables.TeamTask`). If `base` is given, no laws are used.
        laws, **parameters
            As in `for_table`.

        Raises
        ------
        ArgumentError
            `num_robots` or `horizon` is not a whole number of at least 1, or `laws` is not valid.
        """
        for name, count in (("num_robots", num_robots), ("horizon", horizon)):
            if not is_count(count):
                raise ArgumentError(f"{name} is {count!r}; give a whole number of at least 1")
        task = named_task("team", grasp=grasp, reduces_variance=reduces_variance, num_robots=num_robots, base=base)
        learner = learner_of("team", cls, laws if _is_auto(base) else None, parameters)
        return learner(num_robots * horizon, task, **parameters)

    @classmethod
    def of_paper(
        cls,
        horizon: int,
        actions: Sequence[Hashable] | Mapping[int, Sequence[Hashable]] | Task,
        covariates: Sequence[str] = (),
        **changed: Any,
    ) -> "CensoredQLearner":
        """Make the learner of eq. 3 unchanged: Kaplan–Meier weights, a linear Q for each stage, no pessimism."""
        fixed = {"q_function": "linear", "censoring": "kaplan-meier", "stages": "separate", "pessimism": 0.0}
        return cls(horizon, actions, covariates, **(fixed | changed))

    @in_one_thread
    def fit(self, logs: Logs | LogStream, workers: Workers | None = None) -> "CensoredQLearner":
        """Learn from a log.

        Parameters
        ----------
        logs
            The log. A `LogStream` is read in passes, one for each stage and some before, with the same result. Only
            the clocks and censoring covariates of all stages are held, if Ĝ is on the clock of stages.
        workers
            Workers that sum up the shards of a `LogStream`, with byte-identical results; None for this process alone.

        Raises
        ------
        ArgumentError
            A parameter has an invalid value.
        LogError
            The log lacks a column, is longer than the horizon, or holds an action that was not possible.
        PositivityError
            All trajectories were cut, or a weight is not identified.
        """
        model = self.compose(checked_log(logs))
        has_choice = _is_auto(self.stages) and not isinstance(model.space, TabularQ)
        found = believable(partial(learned_from, logs, has_choice=has_choice, workers=workers), model, logs)
        self.model_, self.q_functions_, self.chosen_ = found.model, found.q_functions, found.chosen
        self.weights_, self.diagnostics_ = found.weights, found.diagnostics
        self.policy_ = self.model_.policy(self.q_functions_)
        return self

    def compose(self, logs: Logs | LogStream | None = None) -> QModel:
        """Check the parameters and compose the model for a log; nothing is fitted.

        By default targets are imputed, but weighted if the action of a stage in which a trajectory was cut is not
        known. 𝒬 is smooth in plain covariates, but linear if a smooth fit would take too long (`q_model.MOST_WORK`) or
        promises too much (`promise`), and linear in the features that a task defines for each action. Pessimism is 2/√T
        for each of T stages, because their margins add up, and 0, i.e. eq. 3 unchanged, if `censoring` is given. With
        pessimism and eight actions or more, the actions are partially pooled (`recursion`), and the policy prefers the
        actions of the log where their Qs do not differ clearly (`preference`).
        """
        check_seed(self.random_state)
        task, is_fixed = self._task(), not _is_auto(self.censoring)
        is_of_policy = bool(getattr(task, "is_of_policy", False))
        by_itself = BuckleyJames() if logs is None or is_fixed or logs.has_all_actions else Weighted()
        space = q_space_of((SMOOTH if task.is_shared else LinearQ()) if _is_auto(self.q_function) else self.q_function)
        if isinstance(space, TabularQ) or (_is_auto(self.q_function) and is_state(logs, self.covariates)):
            return self._of_table(task, logs, targets_of(self.censoring) if is_fixed else Weighted())
        model = QModel(
            horizon=self.horizon,
            task=task,
            targets=targets_of(self.censoring) if is_fixed else by_itself,
            space=space,
            reg=reg_of(self.reg),
            stages="pooled" if _is_auto(self.stages) else stage_mode_of(self.stages),
            stage_trend=stage_trend_of(None, 0) if self.stages == TREND else None,
            pessimism=0.0 if _is_auto(self.pessimism) else pessimism_of(self.pessimism),
            random_state=self.random_state,
            half_life=half_life_of(self.half_life),
            is_space_free=_is_auto(self.q_function),
        )
        if model.stage_trend and task.end_action is not None:
            raise ArgumentError("stages is 'trend', which tables do not have; give 'pooled' or 'separate'")
        if is_of_policy and model.pessimism > 0:
            of_given = "Q is that of a given policy, without a maximum over actions"
            best = "leave it out, or learn Q of the best policy (base=None)"
            raise ArgumentError(f"pessimism is {self.pessimism}, but {of_given}; {best}")
        if _is_auto(self.pessimism) and not (is_fixed or is_of_policy):
            model = replace(model, pessimism=PESSIMISM / self.horizon**0.5)
        has_many_actions = model.pessimism > 0 and task.is_shared and model.num_blocks >= MANY_ACTIONS
        return replace(model, has_many_actions=has_many_actions)

    def _of_table(self, task: Task, logs: Logs | LogStream | None, targets: Targets) -> QModel:
        """Compose a tabular Q: pooled stages, and cells shrunk instead of pessimism."""
        if self.stages not in (AUTO, "pooled") or self.pessimism not in (AUTO, 0):
            given = f"stages is {self.stages!r} and pessimism {self.pessimism!r}; leave them out"
            raise ArgumentError(f"q_function is 'tabular', which pools stages and shrinks rare cells, but {given}")
        if self.half_life is not None:
            given = f"half_life is {self.half_life!r}; select those since a change instead (--since)"
            raise ArgumentError(f"q_function is 'tabular', which weights all trajectories equally, but {given}")
        states = with_states(task, logs, targets)
        rest = (targets, TabularQ(), reg_of(self.reg), "pooled", self.random_state)
        return QModel(
            self.horizon, states, *rest, space_chosen=(f"Q is a table: {states.covariates[0]} holds the states",)
        )

    def q_values(self, frame: pd.DataFrame, stage: int) -> Float[np.ndarray, "m A"]:
        """Q̂ of every action in a stage (from 1), for each row of covariates; no estimate where `unseen_` names it."""
        return self._named_policy().q_values(frame, stage)

    def decide(self, frame: pd.DataFrame, stage: int) -> np.ndarray:
        """Return the action that the policy takes, for each row of covariates; for named actions only."""
        return self._named_policy().decide(frame, stage)

    @property
    def cut_model_(self) -> CutModel | None:
        """Ĝ; None if there is none."""
        check_fitted(self, "model_")
        return self.model_.cut_model

    @property
    def unseen_(self) -> list[str]:
        """One sentence for each action that was never completed in the log, and for stages that none was."""
        check_fitted(self, "model_")
        assert self.model_.support is not None
        return unseen_in_words(self.model_.support, self.model_.task.block_names, self.model_.stages)

    def _task(self) -> Task:
        if isinstance(self.actions, type) or not isinstance(self.actions, (Sequence, Mapping, Task)):
            what = f"a {type(self.actions).__name__}" if hasattr(self.actions, "dtype") else repr(self.actions)
            names = "give a list of names, one for each stage"
            raise ArgumentError(f"actions is {what}; {names}, or an object that is a Task")
        if not isinstance(self.actions, Task):
            return NamedActions(self.actions, self.covariates)
        if len(self.covariates):
            raise ArgumentError(
                f"covariates is {list(self.covariates)}, but the task sets the covariates of Q; leave it out"
            )
        return self.actions

    def _named_policy(self) -> Any:
        if isinstance(self.actions, Task):
            name = type(self.actions).__name__
            raise ArgumentError(f"{name} decides by its own policy; use policy_, or name actions")
        check_fitted(self, "policy_")
        return self.policy_


def _is_auto(value: Any) -> bool:
    return isinstance(value, str) and value == AUTO
