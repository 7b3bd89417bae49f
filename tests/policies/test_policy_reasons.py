from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pandas as pd

from halfseen.learners import FlatPolicy
from halfseen.policies.reasons import flat_reason, table_reason
from halfseen.tables.present import first_state
from halfseen.world import Scene

STATE = first_state(
    Scene(np.array([[0.0, 0.0, 0.62], [0.05, 0.0, 0.3], [0.0, 0.0, 0.0]])), horizon=4, dirty_share=0.6
).state
POLICY = FlatPolicy(
    actions=("A", "B", "C"),
    covariates=("x1", "x2"),
    is_possible=np.array([[True, True, False], [False, False, True]]),
    coefficients=np.array([[[0.0, 1.0, 0.0], [0.5, 0.0, 0.0], [9.0, 0.0, 0.0]]] * 2),
)
ROW = pd.DataFrame({"x1": [0.8], "x2": [3.0]})


def test_a_lift_is_told_with_what_hides_it_and_what_it_hides():
    told = table_reason(STATE, np.array([0.0, 1.2, -1.0, 0.0, 2.0, 0.0, 0.0]))
    assert told == ("LIFT 0: worth 0.80 more than WASH 0; it is half hidden (0.62) and rather dirty than clean (0.60).")
    told = table_reason(replace(STATE, log_odds=jnp.array([0.0, 0.0, 3.0])), np.array([0, 0, 0, 1.5, 0, 1.0, 0.0]))
    assert told == (
        "WASH 2: worth 0.50 more than LIFT 1; it is in plain sight (0.00) and almost surely dirty (0.95), and it "
        "hides 0 and 1."
    )


def test_failed_attempts_count():
    tried = replace(
        STATE, attempt_object=jnp.array([0, 0, 1, -1]), attempt_succeeded=jnp.array([False, False, True, False])
    )
    q = np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert ", it slipped 2 times." in table_reason(tried, q)
    assert "slipped" not in table_reason(tried, np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0]))


def test_finish_tells_of_the_likeliest_dirty_object():
    state = replace(STATE, log_odds=jnp.array([-2.5, -3.0, -0.1]))
    assert table_reason(state, np.array([0.0, -1.0, -1.0, -1.0, -1.0, -1.0, -0.5])) == (
        "FINISH: worth 0.50 more than LIFT 2; the likeliest dirty of the 3 objects left, 2, is in plain sight (0.00) "
        "and as likely clean as dirty (0.48)."
    )


def test_ties_and_lone_actions_are_told_as_such():
    assert table_reason(STATE, np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])).startswith("FINISH: worth as much as")
    assert flat_reason(POLICY, ROW, 2, None) == "C: nothing else is possible."


def test_the_covariate_that_speaks_most_for_an_action_is_told():
    ranges = {"x1": (-1.0, 1.0), "x2": (0.0, 4.0)}
    assert flat_reason(POLICY, ROW, 1, ranges) == (
        "A: worth 0.30 more than B; x1 = 0.8 speaks for it most: at 0, it would be worth 0.50 less than B."
    )
    speaks_against = flat_reason(POLICY, ROW, 1, {"x1": (0.9, 1.1), "x2": (0.0, 4.0)})
    assert speaks_against == (
        "A: worth 0.30 more than B; none of what it looks at speaks for it more than the middle of the logs does."
    )
    assert flat_reason(POLICY, ROW, 1, None) == "A: worth 0.30 more than B."
