import jax
import numpy as np
import pandas as pd
import pytest

from halfseen.errors import LogError, PolicyError
from halfseen.logs import Logs
from halfseen.tables.present import first_state, present_state
from halfseen.world import Scene, WorldConfig
from halfseen.world.state import attempt_counts, initial_state, occlusion, pad_scenes

HIDES = np.array([[0.0, 0.5, 0.0], [0.0, 0.0, 0.2], [0.4, 0.0, 0.0]])
NAMES = ["mug", "cup", "bowl"]


def history(action, target, *, location=("TABLE",) * 3, ending="cut"):
    """An older path, and one whose second stage begins with a failed attempt on the cup; names sort otherwise."""
    order = np.argsort(NAMES)
    rows = [
        {
            "path": path,
            "stage": stage,
            "object": NAMES[k],
            "location": location[k] if (path, stage) == (2, 2) else "TABLE",
            "occlusion": 0.3,
            "log_odds": 0.1 * (k + 1) * stage,
            "lifts": int(k == 2) * (stage - 1),
            "hidden_by": HIDES[k][order].tolist(),
            "attempt_occlusions": [0.2] if (k, stage) == (1, 2) else [],
            "attempt_succeeded": [False] if (k, stage) == (1, 2) else [],
        }
        for path, stage in ((1, 1), (2, 1), (2, 2))
        for k in order
    ]
    stages = pd.DataFrame(
        {
            "path": [1, 2, 2],
            "stage": [1, 1, 2],
            "elapsed_s": [2.0, 3.0, 5.0 if ending == "finished" else None],
            "action": ["FINISH", "WASH", action],
            "object": [None, "cup", target],
            "reward": [0.0, -1.0, 1.0 if ending == "finished" else None],
        }
    )
    return Logs(stages, {"path": [1, 2], "end_s": [2.0, 5.0], "ending": ["finished", ending]}, pd.DataFrame(rows))


# The objects in the order of a log, which sorts them by name: bowl, cup, mug.
SCENE = Scene(HIDES[np.ix_([2, 1, 0], [2, 1, 0])])


def test_a_first_state_is_what_the_world_begins_with_before_it_sees():
    layout = jax.tree.map(lambda leaf: leaf[0], pad_scenes([SCENE]))
    known = initial_state(WorldConfig(horizon=4), layout)
    now = first_state(SCENE, horizon=4, dirty_share=0.6)
    for mine, its in zip(jax.tree.leaves(now.state), jax.tree.leaves(known), strict=True):
        np.testing.assert_allclose(mine, its, rtol=1e-6)
        assert mine.dtype == its.dtype
    assert now.stage == 1
    assert int(first_state(SCENE, horizon=4, dirty_share=0.6, stage=3).state.steps_to_go) == 2


def test_a_stage_without_an_action_is_the_present():
    now = present_state(SCENE, 4, history(None, None))
    assert (now.stage, int(now.state.steps_to_go), now.notes) == (2, 3, ())
    np.testing.assert_allclose(now.state.log_odds, [0.6, 0.4, 0.2], rtol=1e-6)
    assert now.state.lifts.tolist() == [1, 0, 0]
    assert np.asarray(attempt_counts(now.state)).tolist() == [[0, 0, 0], [0, 1, 0]]
    np.testing.assert_allclose(occlusion(now.state), SCENE.occlusion, rtol=1e-6)


def test_a_wash_held_if_the_cloud_shows_one_object_less():
    left = Scene(SCENE.hides[np.ix_([1, 2], [1, 2])])
    now = present_state(left, 4, history("WASH", "bowl"))
    assert now.stage == 3
    np.testing.assert_allclose(now.state.log_odds, [0.4, 0.2], rtol=1e-6)
    assert np.asarray(attempt_counts(now.state)).tolist() == [[0, 0], [1, 0]]


def test_a_wash_failed_if_the_cloud_shows_as_many():
    now = present_state(SCENE, 4, history("WASH", "bowl"))
    assert now.stage == 3
    assert np.asarray(attempt_counts(now.state)).tolist() == [[0, 0, 0], [1, 1, 0]]
    assert float(now.state.attempt_occlusion[1]) == pytest.approx(SCENE.occlusion[0])


def test_what_became_of_a_lift_is_not_guessed():
    now = present_state(SCENE, 4, history("LIFT", "mug"))
    assert now.stage == 3
    assert np.asarray(attempt_counts(now.state)).tolist() == [[0, 0, 0], [0, 1, 0]]
    assert now.notes == ("whether LIFT 2 of stage 2 held is not known; it is not counted",)


def test_what_is_washed_is_left_out():
    left = Scene(SCENE.hides[np.ix_([0, 2], [0, 2])])
    now = present_state(left, 4, history(None, None, location=("TABLE", "DISHWASHER", "TABLE")))
    np.testing.assert_allclose(now.state.log_odds, [0.6, 0.2], rtol=1e-6)
    assert np.asarray(attempt_counts(now.state)).tolist() == [[0, 0], [0, 0]]


def test_another_order_of_the_objects_is_suspected():
    turned = Scene(SCENE.hides[::-1, ::-1])
    assert any("is it the same" in note for note in present_state(turned, 4, history(None, None)).notes)


@pytest.mark.parametrize(
    ("action", "target", "num_objects"), [(None, None, 2), (None, None, 4), ("WASH", "mug", 1), ("LIFT", "mug", 2)]
)
def test_other_objects_than_the_cloud_shows_are_refused(action, target, num_objects):
    with pytest.raises(PolicyError, match=r"path 2, stage 2: 3 objects .* of other objects than the cloud shows"):
        present_state(Scene(np.zeros((num_objects, num_objects))), 4, history(action, target))


def test_a_path_that_is_over_is_refused():
    with pytest.raises(LogError, match="came to its own end"):
        present_state(SCENE, 4, history("WASH", "mug", ending="finished"))
    with pytest.raises(LogError, match="came to its own end"):
        present_state(SCENE, 4, history("FINISH", None))


@pytest.mark.parametrize(("action", "target"), [("WASH", None), ("PICK", "mug")])
def test_an_action_that_no_table_knows_is_refused(action, target):
    with pytest.raises(LogError, match=f"path 2, stage 2: action '{action}' of object .* is none that the table knows"):
        present_state(SCENE, 4, history(action, target))


def test_objects_that_are_numbers_are_refused_where_missing():
    logs = history("WASH", None)
    numbers = {"bowl": 0, "cup": 1, "mug": 2}
    stages, objects = logs.stages, logs.objects
    logs = Logs(
        stages.assign(object=stages["object"].map(numbers).astype("Int64")),
        logs.paths,
        objects.assign(object=objects["object"].map(numbers)),
    )
    with pytest.raises(LogError, match="action 'WASH' of object null"):
        present_state(SCENE, 4, logs)


def test_no_step_left_is_refused():
    with pytest.raises(PolicyError, match="beyond the policy's horizon of 2 stages"):
        present_state(SCENE, 2, history("WASH", "mug"))
    with pytest.raises(PolicyError, match="beyond the policy's horizon of 1 stages"):
        present_state(SCENE, 1, history(None, None))
