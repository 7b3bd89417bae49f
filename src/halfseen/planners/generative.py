"""What a planner must be able to do with a problem: draw from it. One protocol for the table and for problems of users.

Nobody writes down the model's probabilities, except that of what was observed. A problem is a pytree of pure functions
of one state each, as a policy is: a planner compiles them once for all problems of a kind and `jax.vmap`s them.

=============  =====================================================================================
symbol         here
=============  =====================================================================================
b(s)           ``initial_state(key)``: one draw from the belief in which the decision is made
A(s)           ``is_possible(state)``, shape (A,): the same in all states that look the same so far
s', o, r       ``step(state, action, key)``: a draw from P(s', o | s, a), its reward, and whether it ended
ln P(o|s', a)  ``log_likelihood(observation, state_after, action)``: what turns a belief into the next
q_0(s, a)      ``rule_values(state)``, shape (A,): the stated rule for what lies beyond the search
q°, V°         ``control(state)``: any pair with q°(s, a) = E[r + γ V°(s')], or None
γ, H           ``discount`` in (0, 1]; ``horizon``: actions left from the first, at least 1
=============  =====================================================================================

The rule q_0 is a rough value of each action, all that comes after included. It reads only what can be seen in
`state`, as `is_possible` does; a planner that was told the truth would wait for it. The best of it values a situation
that the search has just reached, and decides where nothing was searched.

The control takes noise away: with q°(s, a) − γ V°(s') in place of the reward that was drawn, the search learns only by
how much things turn out better or worse than V°, some rough value that can be averaged in closed form. It too reads
only what can be seen, and V° is 0 where the path is over.

An observation is an integer ≥ 0; two different ones are two different branches of a search.
"""

from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

State = Any
"""One hidden state, all that is seen of it included: any pytree."""


class Step(NamedTuple):
    """What one action brought."""

    state: State
    observation: Int[Array, "*B"]
    reward: Float[Array, "*B"]
    is_over: Bool[Array, "*B"]


class Control(NamedTuple):
    """A value of situations, and its exact expectation one action earlier."""

    action_values: Float[Array, "*B A"]
    """q°, the reward of the action included."""
    value: Float[Array, "*B"]
    """V°."""


@runtime_checkable
class GenerativeProblem(Protocol):
    """A problem that can be drawn from; the module's table says which symbol is what."""

    @property
    def num_actions(self) -> int:
        """Number of actions; they are 0, 1, ….."""
        ...

    @property
    def horizon(self) -> int:
        """H: actions left, the first included; nothing is earned after them."""
        ...

    @property
    def discount(self) -> Any:
        """γ, in (0, 1]."""
        ...

    def initial_state(self, key: Array) -> State:
        """Draw a state from the belief in which the decision is made."""
        ...

    def is_possible(self, state: State) -> Bool[Array, " A"]:
        """Which actions the state allows; at least one."""
        ...

    def step(self, state: State, action: Int[Array, ""], key: Array) -> Step:
        """Carry out one possible action."""
        ...

    def log_likelihood(self, observation: Int[Array, ""], state_after: State, action: Int[Array, ""]) -> Array:
        """Log probability of an observation once the action has led to `state_after`."""
        ...

    def rule_values(self, state: State) -> Float[Array, " A"]:
        """Rough value of each action by the stated rule, read from what is seen."""
        ...

    def control(self, state: State) -> Control | None:
        """Values q° and V° with q°(s, a) = E[r + γ V°(s')], exactly; None if there are none in closed form."""
        ...


def updated_particles(
    problem: GenerativeProblem, particles: State, action: Int[Array, ""], observation: Int[Array, ""], key: Array
) -> State:
    """Particles after an action and what was then observed: stepped, weighted, drawn anew [GordonSalmondSmith1993]_.

    Parameters
    ----------
    problem
        Of which the particles are states.
    particles
        States with one leading axis: draws from the belief before the action.
    action, observation
        What was done, and what was then seen.
    key
        The only source of chance.

    Returns
    -------
    State
        As many states, draws from the belief after it.
    """
    step_key, draw_key = jax.random.split(key)
    num_particles = jax.tree.leaves(particles)[0].shape[0]
    keys = jax.random.split(step_key, num_particles)
    after = jax.vmap(lambda state, key: problem.step(state, action, key).state)(particles, keys)
    log_weights = jax.vmap(lambda state: problem.log_likelihood(observation, state, action))(after)
    # Evenly spaced draws add less noise than independent ones.
    share = jnp.cumsum(jax.nn.softmax(log_weights))
    ladder = (jnp.arange(num_particles) + jax.random.uniform(draw_key)) / num_particles
    drawn = jnp.minimum(jnp.searchsorted(share, ladder), num_particles - 1)
    return jax.tree.map(lambda leaf: leaf[drawn], after)
