import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from halfseen.world.action_space import FINISH, TARGETED, ActionSpace, Verb, possible_actions
from halfseen.world.config import WorldConfig
from halfseen.world.state import Layout, initial_state

SIZES = st.integers(1, 40)


@given(SIZES)
def test_actions_are_numbered_one_to_one(num_objects):
    space = ActionSpace(num_objects)
    pairs = [(Verb.FINISH, 0), *((verb, target) for verb in TARGETED for target in range(num_objects))]
    codes = [space.encode(verb, target) for verb, target in pairs]
    assert codes == list(range(space.num_actions))
    assert [(space.verb(code), space.target(code)) for code in codes] == pairs
    assert ActionSpace.of_size(space.num_actions) == space


@pytest.mark.parametrize("array", [np.array, jnp.array])
def test_arrays_go_both_ways(array):
    space = ActionSpace(4)
    actions = array(np.arange(space.num_actions))
    verbs, targets = space.verb(actions), space.target(actions)
    assert type(verbs) is type(targets) is type(actions)
    assert np.array_equal(space.encode(verbs, targets), actions)
    assert np.array_equal(verbs, space.verbs)


def test_finish_has_no_target():
    space = ActionSpace(3)
    assert (space.verb(FINISH), space.target(FINISH)) == (Verb.FINISH, 0)
    assert space.encode(Verb.FINISH, 2) == FINISH


def test_names_say_verb_and_target():
    assert ActionSpace(2).names == ("FINISH", "WASH 0", "WASH 1", "LIFT 0", "LIFT 1")


@given(SIZES)
def test_the_actions_of_a_verb_stand_side_by_side(num_objects):
    space = ActionSpace(num_objects)
    for verb in Verb:
        assert (space.verbs[space.of(verb)] == verb).all()
        assert (space.verbs == verb).sum() == len(space.verbs[space.of(verb)])


def test_values_are_laid_out_as_the_actions_are():
    space = ActionSpace(2)
    of_verb = {verb: jnp.array([10.0 * verb, 10.0 * verb + 1.0]) for verb in TARGETED}
    joined = np.asarray(space.join(jnp.asarray(-3.0), of_verb))
    assert joined.tolist() == [-3.0, *(10.0 * verb + target for verb in TARGETED for target in range(2))]
    batch = space.join(jnp.zeros(5), {verb: jnp.full((2, 5), float(verb)) for verb in TARGETED})
    assert np.array_equal(batch, np.broadcast_to(space.verbs[:, None], (space.num_actions, 5)))


def test_a_verb_that_is_not_known_is_never_worth_taking():
    joined = np.asarray(ActionSpace(2).join(jnp.asarray(0.0), {Verb.WASH: jnp.ones(2)}))
    assert np.isneginf(joined[ActionSpace(2).of(Verb.LIFT)]).all()
    assert joined[:3].tolist() == [0.0, 1.0, 1.0]


def test_padding_and_what_left_cannot_be_acted_on():
    layout = Layout(jnp.zeros((3, 3)), jnp.array([True, True, False]), jnp.zeros(3))
    possible = possible_actions(initial_state(WorldConfig(), layout))
    assert possible.tolist() == [True, *[True, True, False] * len(TARGETED)]
