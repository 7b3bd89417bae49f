"""Scenes with places and a team in, logs out; one cut ends the table for all."""

import numpy as np
import pytest

from halfseen.cell.facts import tables_seen
from halfseen.errors import ArgumentError, HalfseenWarning, PolicyError, SceneError
from halfseen.planners import GreedyPolicy, ReservingPolicy, TeamOfRules
from halfseen.tables import IndependentPolicies, LinearTeamPolicy
from halfseen.world import ExploringPolicy, Robot, Scene, TableWorld, Team, UniformPolicy, WorldConfig, random
from halfseen.world.rollout import play
from refusals import refused_type

PLACES = np.array([[-0.3, 0.0], [0.0, 0.0], [0.05, 0.0], [0.3, 0.0]])
SCENES = [
    Scene(np.triu(np.full((4, 4), 0.3), 1), "four", places_m=PLACES),
    Scene(np.zeros((2, 2)), "two", places_m=PLACES[[0, 3]]),
]
EMPTY = Scene(np.zeros((0, 0)), "empty", places_m=np.zeros((0, 2)))
TEAM = (Robot((-0.6, 0.0), 0.7, name="left"), Robot((0.6, 0.0), 0.7, speed=1.5, name="right"))
WORLD = TableWorld(WorldConfig(horizon=4), TEAM)
ALONE = TableWorld()
RULE = GreedyPolicy(WORLD.config, uses_history=True, counts_penalty=True)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["independent", "occlusion", "attempt"])
def test_the_wanted_share_is_cut_and_one_cut_ends_the_table_for_all(kind):
    logs = WORLD.simulate(SCENES, UniformPolicy(), 300, seed=0, cut_share=0.5, cut_kind=kind)
    assert abs(logs.cut_share - 0.5) < 4 * 0.5 / np.sqrt(300)
    assert logs.stages.groupby("trajectory")["elapsed_s"].apply(lambda each: each.isna().sum()).max() == 1
    assert logs.trajectories["scene"].tolist()[:3] == ["four", "two", "four"]


def test_each_robot_touches_what_it_reaches_and_padding_is_nobodys():
    logs = WORLD.simulate(SCENES, UniformPolicy(), 40, seed=0)
    did = logs.stages.dropna(subset=["object"])
    truth = [Team(TEAM).workspace(scene).is_in_reach for scene in SCENES]
    assert all(
        truth[trajectory % 2][robot, target]
        for trajectory, robot, target in did[["trajectory", "robot", "object"]].values
    )
    layouts = WORLD.layouts(SCENES)
    assert not np.asarray(layouts.workspace.is_in_reach)[1, :, 2:].any()
    assert not np.asarray(layouts.workspace.is_near)[1, 2:].any()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("world", "kind", "cause"), [(WORLD, "occlusion", "sensor-lost"), (ALONE, "attempt", "operator")]
)
def test_same_seed_same_logs_and_evaluate_plays_the_same_tables(world, kind, cause):
    first, again, other = (
        world.simulate(SCENES, UniformPolicy(), 40, seed=seed, cut_share=0.5, cut_kind=kind) for seed in (5, 5, 6)
    )
    assert first.stages.equals(again.stages)
    assert first.trajectories.equals(again.trajectories)
    assert not first.trajectories.equals(other.trajectories)
    assert 0.2 < first.cut_share < 0.8
    assert set(first.trajectories["cause"].dropna()) == {cause}
    totals = world.evaluate(SCENES, UniformPolicy(), 40, seed=5)
    played = play(world.played_config, world.layouts(SCENES), UniformPolicy(), random.key_of(5), 40)
    np.testing.assert_allclose(totals.reward, np.sum(np.where(played.is_taken, played.reward, 0.0), axis=1), rtol=1e-5)


def test_robots_tell_when_they_drop_out():
    world = TableWorld(robots=[TEAM[0], Robot((0.6, 0.0), 0.7, drop_out_rate=0.05)])
    assert world.played_config.drop_out_rate == (0.0, 0.05)
    assert WORLD.played_config.drop_out_rate is None
    logs = world.simulate(SCENES, UniformPolicy(), 40, seed=0, drop_out_cause="e-stop")
    assert set(logs.trajectories["1_out_cause"].dropna()) == {"e-stop"}
    assert logs.trajectories["0_out_s"].isna().all()


def test_perception_tells_where_objects_stand():
    from halfseen.perception import perceive, read_cloud
    from halfseen.scene import table_paths

    view = perceive(read_cloud(table_paths()[0]))
    np.testing.assert_array_equal(view.scene().places_m, [seen.solid.middle_m[:2] for seen in view.objects])


def test_the_tables_that_come_with_the_package_tell_where_their_objects_stand():
    scenes = [seen.plain for seen in tables_seen()]
    sides = [Robot((-0.5, 0.8), 0.6), Robot((0.5, 0.8), 0.6)]
    logs = TableWorld(robots=sides).simulate(scenes, UniformPolicy(), 20, seed=0)
    reached = logs.objects["reached_by"].map(tuple)
    assert {len(each) for each in reached} == {1, 2}
    assert {each[0] for each in reached} == {0, 1}


def learned(num_decisions):
    return LinearTeamPolicy(np.zeros((num_decisions, 4, 53)))


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: WORLD.simulate(Scene(np.zeros((1, 1))), UniformPolicy(), 1, 0), SceneError, "scene: places_m is None"),
        (lambda: WORLD.simulate(EMPTY, UniformPolicy(), 1, 0), SceneError, "empty: no object is .* leave it out"),
        (lambda: TableWorld().evaluate([EMPTY], UniformPolicy(), 1, 0), SceneError, "empty: no object is on the table"),
        (lambda: WORLD.simulate(SCENES, UniformPolicy(), 0, 0), ArgumentError, "episodes is 0"),
        (
            lambda: WORLD.evaluate(SCENES, UniformPolicy(), 1.5, 0),
            ArgumentError,
            "episodes is 1.5; give a whole number",
        ),
        *(
            (
                lambda share=share: TableWorld(WorldConfig(dirty_share=share)).simulate(SCENES, UniformPolicy(), 1, 0),
                ArgumentError,
                f"dirty_share is {share}, whose log-odds no log can hold; give one between 0 and 1",
            )
            for share in (0.0, 1.0)
        ),
        (lambda: WORLD.simulate(SCENES, None, 1, 0), ArgumentError, "policy is a NoneType; give one that decides"),
        (lambda: WORLD.simulate(SCENES, UniformPolicy(), 1, -1), ArgumentError, "seed is -1; give a whole number"),
        (lambda: WorldConfig(horizon=0), ArgumentError, "horizon is 0; give a whole number of actions"),
        (lambda: WorldConfig(dirty_share=2), ArgumentError, r"dirty_share is 2; give a probability, in \[0, 1\]"),
        (lambda: WorldConfig(reward_wash_dirty="a"), ArgumentError, "reward_wash_dirty is 'a'; give a finite reward"),
        (lambda: WORLD.simulate(SCENES, UniformPolicy(), 1, 0, cut_share=1.0), ArgumentError, "cut share is 1.0"),
        (lambda: TableWorld().simulate(SCENES, UniformPolicy(), 5, 0, cut_share=-0.5), ArgumentError, "cut share is"),
        (lambda: WORLD.simulate(SCENES, learned(12), 1, 0), PolicyError, "learned for 12 decisions .* up to 8"),
        (lambda: WORLD.evaluate(SCENES, ExploringPolicy(learned(12)), 1, 0), PolicyError, "learned for 12 decisions"),
    ],
)
def test_what_cannot_be_is_refused(make, error, message):
    with refused_type(message) if error is ArgumentError else pytest.raises(error, match=message):
        make()


@pytest.mark.parametrize(
    "policy",
    [IndependentPolicies((RULE,) * 3), ReservingPolicy(TableWorld(robots=[*TEAM, TEAM[0]]).played_config, RULE)],
)
def test_a_policy_for_three_robots_plays_with_three_and_with_no_other_number(policy):
    three = TableWorld(WORLD.config, [*TEAM, TEAM[0]])
    for explores in (lambda policy: policy, ExploringPolicy):
        assert len(three.evaluate(SCENES, explores(policy), 2, 0).reward) == 2
        with pytest.raises(PolicyError, match="the policy is for 3 robots, but the team has 2"):
            WORLD.evaluate(SCENES, explores(policy), 2, 0)


@pytest.mark.parametrize("policy", [RULE, ExploringPolicy(RULE)])
def test_a_policy_of_one_robot_is_to_be_wrapped(policy):
    message = "GreedyPolicy decides for one robot, .*; give .* with such a policy for each robot, or ReservingPolicy"
    for play_with in (WORLD.simulate, WORLD.evaluate):
        with pytest.raises(PolicyError, match=message):
            play_with(SCENES, policy, 2, 0)


def test_what_nobody_reaches_is_reported_of_and_left():
    short = TableWorld(robots=[Robot((-0.6, 0.0), 0.4)])
    with pytest.warns(HalfseenWarning, match=r"two: object 1 at \(0.3, 0\) m is out of every robot's reach"):
        logs = short.simulate(SCENES[1], UniformPolicy(), 20, seed=0)
    assert not logs.stages["object"].eq(1).any()
    left = logs.objects[logs.objects["object"] == 1]
    assert left["location"].eq("TABLE").all()
    assert left["reached_by"].map(len).eq(0).all()


def test_what_nobody_reaches_is_paid_for_as_left():
    short = TableWorld(robots=[Robot((-0.6, 0.0), 0.4)])
    with pytest.warns(HalfseenWarning, match="out of every robot's reach"):
        layouts = short.layouts([SCENES[1]])
    played = play(short.played_config, layouts, UniformPolicy(), random.key_of(0), 60)
    parks_at_once, is_dirty = np.asarray(played.action)[:, 0] == 0, np.asarray(played.hidden.is_dirty)
    assert (parks_at_once & is_dirty[:, 1] & ~is_dirty[:, 0]).any()
    price = short.config.reward_dirty_left * is_dirty.sum(axis=1)
    np.testing.assert_allclose(np.asarray(played.reward)[parks_at_once, 0], price[parks_at_once])


@pytest.mark.slow
def test_a_team_of_one_that_reaches_all_simulates_what_one_robot_does():
    rule = GreedyPolicy(WorldConfig(), uses_history=True, counts_penalty=True)
    mine = TableWorld(robots=[Robot((0.0, -0.5), 5.0)]).simulate(SCENES, TeamOfRules(rule), 30, seed=3, cut_share=0.4)
    theirs = TableWorld().simulate(SCENES, rule, 30, seed=3, cut_share=0.4)
    assert mine.trajectories.equals(theirs.trajectories)
    for name in ("stages", "objects"):
        truth = theirs.tables[name]
        assert mine.tables[name][truth.columns].equals(truth)
