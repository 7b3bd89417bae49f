from tiny import SETTING, TINY

from halfseen.planners import POMDPPolicy
from halfseen.study.experiments import EXPERIMENTS
from halfseen.study.policies import COLOURS, HEURISTICS, Kind, horizon_planner, planner


def test_planners_are_planners_and_drawn_as_such():
    for who in (planner(128), horizon_planner(3, 128)):
        assert who.kind == Kind.PLANNER
        assert who.colour == COLOURS[Kind.PLANNER] != COLOURS[Kind.HEURISTIC]
        assert isinstance(who.policy(SETTING.world), POMDPPolicy)
    to_the_end = planner(128).policy(SETTING.world)
    assert (to_the_end.planning_horizon, to_the_end.num_simulations) == (SETTING.world.horizon, 128)


def test_names_are_unique_and_every_one_has_a_label_of_its_own():
    for each in (*EXPERIMENTS, *TINY):
        contenders = getattr(each, "contenders", {})
        assert all(name == who.name for name, who in contenders.items())
        assert len({who.label for who in contenders.values()}) == len(contenders)
    assert len({each.name for each in EXPERIMENTS}) == len(EXPERIMENTS)
    assert [who.policy(SETTING.world).counts_penalty for who in HEURISTICS] == [False, False, True, True]
