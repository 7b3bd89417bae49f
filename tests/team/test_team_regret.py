"""Regrets are those of the exact optimum, played or asked; what cannot be compared is refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from halfseen.errors import ArgumentError
from halfseen.planners.heuristics import GreedyPolicy
from halfseen.team.config import TeamConfig
from halfseen.team.planners.grid_grasping import GridGrasping
from halfseen.team.planners.grid_optimum import solve_team
from halfseen.team.planners.myopic import MyopicTeam
from halfseen.team.planners.regret import Contender, SmallTable, regret_table
from halfseen.team.planners.reservation import ReservingTeam
from halfseen.team.state import Workspace
from halfseen.world import Scene, WorldConfig

WORLD = WorldConfig(horizon=2, grasping=GridGrasping())
CONFIG = TeamConfig(WORLD, (1.0, 1.0), -0.05)
TABLE = SmallTable(
    Scene(np.array([[0.0, 0.4], [0.1, 0.0]]), "pair"), Workspace(jnp.ones((2, 2), dtype=bool), jnp.eye(2, dtype=bool))
)
LOOK_AHEAD, RULE = MyopicTeam(WORLD, -0.05), ReservingTeam(GreedyPolicy(WORLD, counts_penalty=True), -0.05)


def test_a_policy_that_is_played_has_the_regret_that_it_has_when_asked():
    contenders = {"first": Contender(LOOK_AHEAD), "asked": Contender(RULE), "played": Contender(RULE, is_played=True)}
    found = regret_table([TABLE], CONFIG, contenders, jax.random.key(0), 2000).set_index("policy")
    optimum = solve_team(TABLE.scene, CONFIG, TABLE.workspace)
    assert found.loc["asked", "regret"] == pytest.approx(optimum.value - optimum.policy_value(RULE), abs=1e-12)
    assert found.loc["asked", "error"] == 0.0
    assert abs(found.loc["played", "value"] - found.loc["asked", "value"]) < 4 * found.loc["played", "error"]
    assert 0.0 < found.loc["played", "error"] < 0.2


@pytest.mark.parametrize(
    ("tables", "contenders", "num_played", "told"),
    [
        ([], {"a": Contender(RULE)}, 2, "0 tables and 1 contenders"),
        ([TABLE], {"a": Contender(RULE, is_played=True)}, 2, "a comes first and is to be played"),
        ([TABLE], {"a": Contender(RULE)}, 1, "num_played is 1"),
    ],
)
def test_what_cannot_be_compared_is_refused(tables, contenders, num_played, told):
    with pytest.raises(ArgumentError, match=told):
        regret_table(tables, CONFIG, contenders, jax.random.key(0), num_played)
