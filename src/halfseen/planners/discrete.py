"""Exact solution of a POMDP given as arrays, over a finite horizon, by alpha vectors [SmallwoodSondik1973]_.

The value of a belief b with h steps to go is max over α ∈ Γ_h of α·b, where Γ_0 = {0} and, with ⊕ the sums of all
pairs,

    Γ_h = ⋃_a  R_a + γ ⊕_o { T_a (O_{a·o} ∘ α) : α ∈ Γ_{h−1} },

pruned after every sum to the vectors that are best at some belief [CassandraLittmanZhang1997]_.

=========  =======================================================
symbol     here
=========  =======================================================
T_a        ``transition[a]``, shape (s, s'): P(s' | s, a)
O_a        ``observation[a]``, shape (s', o): P(o | a, s')
R_a        ``reward[a]``, shape (s,): expected reward
γ          ``discount``
Γ_h        ``stages[h - 1]``: the vectors and the action of each
=========  =======================================================
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from halfseen.errors import ArgumentError
from halfseen.shapes import Float, Int

_ROW_SUM = 1e-8
_SAME = 1e-10
"""Of the unit of the rewards."""
Belief = Float[np.ndarray, " S"]
Vectors = Float[np.ndarray, "v S"]


@dataclass(frozen=True)
class AlphaVectors:
    """Γ_h: the alpha vectors with h steps to go."""

    vectors: Vectors
    actions: Int[np.ndarray, " v"]


@dataclass(frozen=True)
class DiscreteSolution:
    """The exact optimum over a finite horizon.

    Attributes
    ----------
    value
        Expected discounted reward of the best policy from the initial belief.
    action
        Its first action.
    stages
        Γ_1, …, Γ_horizon.
    """

    value: float
    action: int
    stages: tuple[AlphaVectors, ...]

    def value_of(self, belief: ArrayLike, steps_to_go: int | None = None) -> float:
        """Value of a belief, by default with the whole horizon to go."""
        return float(self._values(belief, steps_to_go).max())

    def action_of(self, belief: ArrayLike, steps_to_go: int | None = None) -> int:
        """Best action at a belief; the lowest in a tie."""
        stage, values = self._stage(steps_to_go), self._values(belief, steps_to_go)
        return int(stage.actions[values >= values.max() - _SAME * _unit(stage.vectors)].min())

    def _values(self, belief: ArrayLike, steps_to_go: int | None) -> Float[np.ndarray, " v"]:
        vectors, known = self._stage(steps_to_go).vectors, np.asarray(belief, dtype=np.float64)
        is_distribution = known.shape == vectors.shape[1:] and known.min() >= 0.0 and abs(known.sum() - 1.0) <= _ROW_SUM
        if not is_distribution:
            raise ArgumentError(f"belief is {belief}; give each of {vectors.shape[1]} states a probability, 1 in all")
        return vectors @ known

    def _stage(self, steps_to_go: int | None) -> AlphaVectors:
        steps = len(self.stages) if steps_to_go is None else steps_to_go
        if not 1 <= steps <= len(self.stages):
            raise ArgumentError(f"steps_to_go is {steps}; give 1 to the horizon, {len(self.stages)}")
        return self.stages[steps - 1]


def solve_discrete(
    T: ArrayLike,
    O: ArrayLike,  # noqa: E741 the field's letter for observations
    R: ArrayLike,
    discount: float,
    horizon: int,
    initial_belief: ArrayLike,
) -> DiscreteSolution:
    """Solve a POMDP exactly by value iteration over alpha vectors.

    The number of vectors can explode with the horizon: use it for small problems.

    Parameters
    ----------
    T
        P(s' | s, a), shape (A, S, S); every row sums to 1.
    O
        P(o | a, s'), shape (A, S, Z); every row sums to 1.
    R
        Expected reward of an action in a state, shape (A, S).
    discount
        γ in (0, 1].
    horizon
        Number of actions, ≥ 1.
    initial_belief
        P(s) before the first action, shape (S,).

    Returns
    -------
    DiscreteSolution
        Its `value` and first `action`, and methods that give both for any belief.

    Raises
    ------
    ArgumentError
        A shape does not fit, a number is not finite, or probabilities do not sum to 1; the message names the entry.

    Examples
    --------
    The tiger: listen, open left, open right [KaelblingLittmanCassandra1998]_.

    >>> T = [[[1, 0], [0, 1]], [[0.5, 0.5]] * 2, [[0.5, 0.5]] * 2]
    >>> O = [[[0.85, 0.15], [0.15, 0.85]], [[0.5, 0.5]] * 2, [[0.5, 0.5]] * 2]
    >>> R = [[-1, -1], [-100, 10], [10, -100]]
    >>> [round(solve_discrete(T, O, R, 0.95, h, [0.5, 0.5]).value, 4) for h in (1, 2, 3)]
    [-1.0, -1.95, 2.3098]
    """
    reward = _numbers(R, "R", 2)
    num_actions, num_states = reward.shape
    transition = _probabilities(T, "T", reward, (num_actions, num_states, num_states))
    observation = _probabilities(O, "O", reward, (num_actions, num_states, None))
    belief = _probabilities(initial_belief, "initial_belief", reward, (num_states,))
    if not 0.0 < discount <= 1.0:
        raise ArgumentError(f"discount is {discount}; give a number in (0, 1]")
    if horizon < 1:
        raise ArgumentError(f"horizon is {horizon}; give at least 1")
    # In units of the rewards, which are a power of two, so that tolerances suit them and nothing is rounded.
    vectors, stages, unit = np.zeros((1, num_states)), [], _unit(reward)
    for _ in range(horizon):
        found = _backed_up(vectors, transition, observation, reward / unit, discount)
        vectors = found.vectors
        stages.append(AlphaVectors(unit * vectors, found.actions))
    solution = DiscreteSolution(0.0, 0, tuple(stages))
    return replace(solution, value=solution.value_of(belief), action=solution.action_of(belief))


def _unit(values: np.ndarray) -> float:
    """The power of two at or below the largest size; 1 if all are 0."""
    largest = float(np.abs(values).max())
    return 2.0 ** np.floor(np.log2(largest)) if largest > 0.0 else 1.0


def _backed_up(
    vectors: Vectors,
    transition: Float[np.ndarray, "A S S"],
    observation: Float[np.ndarray, "A S Z"],
    reward: Float[np.ndarray, "A S"],
    discount: float,
) -> AlphaVectors:
    """One step of value iteration."""
    found = []
    for moves, sees, total in zip(transition, observation, reward[:, None], strict=True):
        for seen in sees.T:
            after = pruned(discount * (seen * vectors) @ moves.T)
            total = pruned((total[:, None] + after[None]).reshape(-1, reward.shape[1]))
        found.append(total)
    every, actions = np.concatenate(found), np.repeat(np.arange(len(found)), [len(total) for total in found])
    kept = _best_somewhere(every)
    return AlphaVectors(every[kept], actions[kept])


def pruned(vectors: Vectors) -> Float[np.ndarray, "k S"]:
    """Keep the vectors that are best at some belief."""
    return vectors[_best_somewhere(vectors)]


def _best_somewhere(vectors: Vectors) -> Int[np.ndarray, " k"]:
    """Indices of the vectors that are best at some belief, found by witnesses [CassandraLittmanZhang1997]_."""
    _, first = np.unique(np.round(vectors / _SAME), axis=0, return_index=True)
    first = np.sort(first)
    num_as_good = np.count_nonzero(np.all(vectors[first][None] >= vectors[first][:, None], axis=2), axis=1)
    # Keep the first of equal vectors, and none that another vector dominates in every state.
    waiting, kept = list(first[num_as_good == 1]), []
    while waiting:
        witness = _witness(vectors[waiting[-1]], vectors[kept])
        if witness is None:
            waiting.pop()
            continue
        kept.append(max(waiting, key=lambda index: float(vectors[index] @ witness)))
        waiting.remove(kept[-1])
    return np.sort(np.array(kept, dtype=np.int64))


def _witness(vector: Belief, others: Float[np.ndarray, "k S"]) -> Belief | None:
    """Find a belief at which `vector` beats all others, or None: maximise d with b·(vector − other) ≥ d."""
    from scipy.optimize import linprog

    size = len(vector)
    if len(others) == 0:
        return np.full(size, 1.0 / size)
    found = linprog(
        c=np.append(np.zeros(size), -1.0),
        A_ub=np.column_stack([others - vector, np.ones(len(others))]),
        b_ub=np.zeros(len(others)),
        A_eq=np.append(np.ones(size), 0.0)[None],
        b_eq=[1.0],
        bounds=[(0.0, 1.0)] * size + [(None, None)],
        method="highs",
    )
    return found.x[:size] if found.status == 0 and -found.fun > _SAME else None


def _numbers(values: ArrayLike, name: str, ndim: int) -> np.ndarray:
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != ndim or array.size == 0:
        raise ArgumentError(f"{name} has shape {array.shape}; give {ndim} axes, none of them empty")
    for index in np.argwhere(~np.isfinite(array)):
        raise ArgumentError(f"{name}{index.tolist()} is {array[tuple(index)]}; give a finite number")
    return array


def _probabilities(values: ArrayLike, name: str, reward: np.ndarray, shape: tuple[int | None, ...]) -> np.ndarray:
    """Check probabilities: their shape (None for any size), and that each row sums to 1."""
    array = _numbers(values, name, len(shape))
    wanted = tuple(size or given for size, given in zip(shape, array.shape, strict=True))
    if array.shape != wanted:
        raise ArgumentError(f"{name} has shape {array.shape}; R of shape {reward.shape} needs {wanted}")
    for index in np.argwhere(array < 0.0):
        raise ArgumentError(f"{name}{index.tolist()} is {array[tuple(index)]}; give probabilities ≥ 0")
    sums = array.sum(axis=-1)
    for index in np.argwhere(np.abs(sums - 1.0) > _ROW_SUM):
        where = index.tolist() or ""
        raise ArgumentError(f"{name}{where} sums to {sums[tuple(index)]:g}; give probabilities that sum to 1")
    return array
