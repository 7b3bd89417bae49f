"""Whether stages are to be pooled: by what each way predicts of held-out trajectories.

One Q for all stages is fitted to more rows, and is wrong where what an action brings depends on the stage. Both ways
are asked to predict the same targets: those of pooled stages, fitted without the trajectory's own fold. Stages are
separated only where this predicts better beyond noise, for a mistake costs more one way than the other: where rows are
few, separate stages lose more by noise than pooled ones by bias.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from halfseen.arrays import on_device
from halfseen.learners.memory import give_back
from halfseen.learners.q_learning.fitting import BackwardOptions, counted, in_float64
from halfseen.learners.q_learning.judging import judged
from halfseen.learners.q_learning.path_arrays import PathArrays
from halfseen.learners.q_learning.q_model import QModel
from halfseen.learners.q_learning.recursion import backward
from halfseen.learners.q_learning.room import padded, with_room
from halfseen.learners.q_learning.transitions import StageMode, Transitions

NUM_FOLDS = 2

FEWEST_PATHS = 20

CLEARLY = 2.0
"""Standard errors by which separate stages must predict better."""


_SOONER: Any = {"xla_cpu_use_fusion_emitters": False}
"""How XLA compiles in less time and memory a program that runs but twice."""


class StageChoice(NamedTuple):
    """How stages are treated, and why.

    Parameters
    ----------
    stages
        ``"pooled"`` or ``"separate"``.
    gain
        Mean squared error of pooled stages less that of separate ones, a trajectory.
    standard_error
        Of `gain`.
    """

    stages: StageMode
    gain: float
    standard_error: float

    @property
    def sentence(self) -> str:
        """What was chosen and why."""
        found = f"by {self.gain:.3g} ± {self.standard_error:.2g} squared error a trajectory"
        if self.stages == "separate":
            return f"stages are separate: held out, they predict better than pooled ones {found}"
        return f"stages are pooled: held out, separate ones do not clearly predict better ({found})"


def can_choose(model: QModel, paths: PathArrays) -> bool:
    """Tell whether there is a choice: several stages, none of them ended by an action, and paths to hold out."""
    return model.horizon > 1 and model.task.end_action is None and paths.num_paths >= FEWEST_PATHS


def with_stages(model: QModel, paths: PathArrays) -> tuple[QModel, tuple[str, ...]]:
    """Choose between pooled and separate stages, where that makes a difference; and all that was chosen by itself.

    Parameters
    ----------
    model
        How Q is fitted, with what comes before Q fitted to the log.
    paths
        The log, or the sample of it that decides.
    """
    if not can_choose(model, paths):
        return model, model.chosen
    choice = choose_stages(model, paths)
    return replace(model, stages=choice.stages), (*model.chosen, choice.sentence)


def choose_stages(model: QModel, paths: PathArrays) -> StageChoice:
    """Choose between pooled and separate stages.

    Parameters
    ----------
    model
        How Q is fitted, with what comes before Q fitted to the log.
    paths
        The log.
    """
    log = replace(model, stages="pooled").transitions(paths)
    fold = np.random.default_rng([model.random_state, 2]).permutation(paths.num_paths) % NUM_FOLDS
    blocks = model.blocks(paths.is_possible.shape[-1])
    options = replace(model, stages="pooled").options(paths.num_paths)
    gains = np.zeros(paths.num_paths)
    with in_float64():
        arrays = on_device((with_room(log), blocks, model.regs))
        for k in range(NUM_FOLDS):
            counts = on_device(padded((fold != k).astype(np.float64), paths.num_paths))
            each = np.asarray(_compiled(options, *arrays, counts)(*arrays, counts))[: paths.num_paths]
            gains = np.where(fold == k, each, gains)
    gain, error = float(gains.mean()), float(gains.std(ddof=1) / np.sqrt(len(gains)))
    return StageChoice("separate" if gain > CLEARLY * error else "pooled", gain, error)


def _compiled(options: BackwardOptions, *arrays: Any) -> Callable[..., Any]:
    """`_gains` for arrays of these shapes; compiling and running it at once would take twice the memory."""
    leaves, structure = jax.tree.flatten(arrays)
    shapes = tuple(jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) for leaf in leaves)
    return _compiled_for(options, shapes, structure)


@lru_cache(maxsize=64)
def _compiled_for(options: BackwardOptions, shapes: tuple[Any, ...], structure: Any) -> Callable[..., Any]:
    compiled = _gains.lower(*jax.tree.unflatten(structure, shapes), options=options).compile(_SOONER)
    give_back()
    return compiled


@partial(jax.jit, static_argnames="options")
def _gains(
    log: Transitions,
    blocks: Int[Array, " A"],
    regs: Float[Array, " L"],
    counts: Float[Array, " n"],
    options: BackwardOptions,
) -> Float[Array, " n"]:
    """Squared error of pooled less that of separate stages, of each trajectory, fitted to those that count."""
    some = counted(log, counts)
    pooled = backward(some, blocks, regs, **options._asdict())
    said = judged(pooled, log, blocks, "pooled", log.reward)
    separate = backward(some, blocks, regs, **options._replace(stages="separate")._asdict(), value=said.value)
    other = judged(separate, log, blocks, "separate", log.reward)
    errors = (said.taken - said.target) ** 2 - (other.taken - said.target) ** 2
    seen = log.weight if log.imputation is None else log.weight * log.imputation.outcome_weight
    return jnp.sum(jnp.where(seen > 0, seen * errors, 0.0), axis=1)
