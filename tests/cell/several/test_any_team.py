"""Whatever decides for a team decides for two arms in physics from what its log will tell, and from nothing else."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from test_team_episode import CONFIG, played, workcell

from halfseen.logs import read_logs
from halfseen.planners.myopic import MyopicPolicy
from halfseen.planners.named import PLANNER, named_policy
from halfseen.tables.policy import LinearTeamPolicy
from halfseen.tables.team_features import NUM_FEATURES
from halfseen.world import random
from halfseen.world.actions import VERB_NAMES, ActionSpace
from halfseen.world.logs import states_of
from picked import picked

PAIR_CONFIG = replace(CONFIG, speed=(1.0, 1.0))
CUPS_M = ((-0.26, 0.0), (0.26, 0.0), (0.0, 0.1))


def decided_by_log(policy, logs):
    """What a policy does in the states of a log, in words, drawing what it drew in the cell."""
    states, decided = states_of(logs, PAIR_CONFIG.num_stages), []
    for step in range(len(logs.stages)):
        state = picked(states, (0, step))
        actions = ActionSpace(state.num_objects)
        action = int(policy.decide(state, random.fold_in(random.key_of(0), step)).action)
        verb, target = int(actions.verb(action)), int(actions.target(action))
        decided.append((VERB_NAMES[verb], target if verb in (1, 2) else None))
    return decided


def recorded(logs):
    begun = zip(logs.stages["action"], logs.stages["object"], strict=True)
    return [(action, None if pd.isna(target) else int(target)) for action, target in begun]


def learned_of(seed):
    """A learned policy, as far as anybody can tell who does not know what it learned."""
    shape = (PAIR_CONFIG.num_stages, 1, NUM_FEATURES + 1)
    coefficients = np.random.default_rng(seed).normal(size=shape).astype(np.float32)
    return LinearTeamPolicy(np.asarray(coefficients), num_robots=2)


@pytest.mark.slow
@pytest.mark.parametrize(
    "policy",
    [pytest.param(learned_of(1), id="learned"), pytest.param(MyopicPolicy(PAIR_CONFIG), id="one step ahead")],
)
def test_in_the_cell_a_team_does_what_it_would_do_in_the_states_of_its_log(tmp_path, policy):
    played(workcell(CUPS_M), tmp_path / "log", policy)
    logs = read_logs(tmp_path / "log")
    assert len(logs.stages) >= 4
    assert recorded(logs) == decided_by_log(policy, logs)


@pytest.mark.slow
def test_the_planner_of_a_team_clears_the_table(tmp_path):
    run = played(workcell(CUPS_M), tmp_path / "log", named_policy(PLANNER, PAIR_CONFIG))
    assert (run.num_washed, run.num_collisions, run.cause) == (3, 0, None)
