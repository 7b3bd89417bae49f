from tiny import SETTING

from halfseen.planners import POMDPPolicy
from halfseen.study.policies import COLOURS, Kind, horizon_planner, planner


def test_planners_are_planners_and_drawn_as_such():
    for who in (planner(128), horizon_planner(3, 128)):
        assert who.kind == Kind.PLANNER
        assert who.colour == COLOURS[Kind.PLANNER] != COLOURS[Kind.HEURISTIC]
        assert isinstance(who.policy(SETTING.world), POMDPPolicy)
    to_the_end = planner(128).policy(SETTING.world)
    assert (to_the_end.planning_horizon, to_the_end.num_simulations) == (SETTING.world.horizon, 128)
