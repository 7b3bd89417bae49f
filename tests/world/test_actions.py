import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from halfseen.world import ActionSpace, Verb
from halfseen.world.actions import FINISH, TARGETED


@given(st.integers(1, 40))
def test_actions_are_numbered_one_to_one_and_those_of_a_verb_stand_side_by_side(num_objects):
    space = ActionSpace(num_objects)
    pairs = [(Verb.FINISH, 0), *((verb, target) for verb in TARGETED for target in range(num_objects))]
    codes = [space.encode(verb, target) for verb, target in pairs]
    assert codes == list(range(space.num_actions))
    assert [(space.verb(code), space.target(code)) for code in codes] == pairs
    assert ActionSpace.of_size(space.num_actions) == space
    verbs, targets = space.verb(np.array(codes)), space.target(np.array(codes))
    assert np.array_equal(space.encode(verbs, targets), codes)
    assert np.array_equal(verbs, space.verbs)
    for verb in Verb:
        assert np.flatnonzero(space.verbs == verb).tolist() == list(range(*space.of(verb).indices(len(codes))))


def test_finish_has_no_target_and_names_say_verb_and_target():
    assert ActionSpace(3).encode(Verb.FINISH, 2) == FINISH
    assert ActionSpace(2).names == ("FINISH", "WASH 0", "WASH 1", "LIFT 0", "LIFT 1")


def test_values_are_laid_out_as_the_actions_are():
    space = ActionSpace(2)
    of_verb = {verb: np.array([10.0 * verb, 10.0 * verb + 1.0]) for verb in TARGETED}
    joined = space.join(np.asarray(-3.0), of_verb)
    assert joined.tolist() == [-3.0, *(10.0 * verb + target for verb in TARGETED for target in range(2))]
    batch = space.join(np.zeros(5), {verb: np.full((5, 2), float(verb)) for verb in TARGETED})
    assert np.array_equal(batch, np.broadcast_to(space.verbs, (5, space.num_actions)))
    # A verb that is not known is never worth taking.
    unknown = space.join(np.asarray(0.0), {Verb.WASH: np.ones(2)})
    assert unknown.tolist() == [0.0, 1.0, 1.0, -np.inf, -np.inf]
