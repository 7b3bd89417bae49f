import jax
import numpy as np
import pandas as pd
import pytest

from halfseen.errors import LogError, PolicyError
from halfseen.logs import Logs
from halfseen.policies.history import present_state
from halfseen.tables.present import first_state, labelled
from halfseen.world import Scene, WorldConfig
from halfseen.world.seeing import AssumedSeeing
from halfseen.world.state import attempt_counts, initial_state, occlusion, pad_scenes
from picked import picked

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


ORDER = "objects of the history have no places (x_m, y_m, z_m): they are taken in their order"


def present(scene, horizon, logs, places_m=None, held=None):
    return present_state(scene, horizon, logs, dirty_share=0.6, places_m=places_m, held=held)


def test_a_first_state_is_what_the_world_begins_with_before_it_sees():
    layout = picked(pad_scenes([SCENE]), 0)
    known = initial_state(WorldConfig(horizon=4), layout)
    now = first_state(SCENE, horizon=4, dirty_share=0.6)
    for mine, its in zip(jax.tree.leaves(now.state), jax.tree.leaves(known), strict=True):
        np.testing.assert_allclose(mine, its, rtol=1e-6)
        assert mine.dtype == its.dtype
    assert now.stage == 1
    assert int(first_state(SCENE, horizon=4, dirty_share=0.6, stage=3).state.steps_to_go) == 2


def test_a_stage_without_an_action_is_the_present():
    now = present(SCENE, 4, history(None, None))
    assert (now.stage, int(now.state.steps_to_go), now.notes) == (2, 3, (ORDER,))
    np.testing.assert_allclose(now.state.log_odds, [0.6, 0.4, 0.2], rtol=1e-6)
    assert now.state.lifts.tolist() == [1, 0, 0]
    assert np.asarray(attempt_counts(now.state)).tolist() == [[0, 0, 0], [0, 1, 0]]
    np.testing.assert_allclose(occlusion(now.state), SCENE.occlusion, rtol=1e-6)


def test_a_wash_held_if_the_cloud_shows_one_object_less():
    left = Scene(SCENE.hides[np.ix_([1, 2], [1, 2])])
    now = present(left, 4, history("WASH", "bowl"))
    assert now.stage == 3
    np.testing.assert_allclose(now.state.log_odds, [0.4, 0.2], rtol=1e-6)
    assert np.asarray(attempt_counts(now.state)).tolist() == [[0, 0], [1, 0]]


def test_a_wash_failed_if_the_cloud_shows_as_many():
    now = present(SCENE, 4, history("WASH", "bowl"))
    assert now.stage == 3
    assert np.asarray(attempt_counts(now.state)).tolist() == [[0, 0, 0], [1, 1, 0]]
    assert float(now.state.attempt_occlusion[1]) == pytest.approx(SCENE.occlusion[0])


def test_what_became_of_a_lift_is_not_guessed():
    now = present(SCENE, 4, history("LIFT", "mug"))
    assert now.stage == 3
    assert np.asarray(attempt_counts(now.state)).tolist() == [[0, 0, 0], [0, 1, 0]]
    assert now.notes == (ORDER, "whether LIFT of 'mug' in stage 2 held is not known; it is not counted")


@pytest.mark.parametrize("held", [True, False])
def test_a_lift_counts_where_it_is_known_whether_it_held(held):
    now = present(SCENE, 4, history("LIFT", "cup"), held=held)
    assert (now.stage, now.notes, now.was) == (3, (ORDER,), (0, 1, 2))
    assert now.state.lifts.tolist() == [1, int(held), 0]
    assert np.asarray(attempt_counts(now.state)).tolist() == [[0, int(held), 0], [0, 2 - int(held), 0]]


def test_whether_a_wash_held_is_not_guessed_where_it_is_known():
    left = Scene(SCENE.hides[np.ix_([1, 2], [1, 2])])
    assert present(left, 4, history("WASH", "bowl"), held=True).was == (1, 2)
    failed = present(SCENE, 4, history("WASH", "bowl"), held=False)
    assert np.asarray(attempt_counts(failed.state)).tolist() == [[0, 0, 0], [1, 1, 0]]
    # By their places, objects may have been hidden or come into view as well.
    scene, places_m = shows(2, 1)
    hidden = present(scene, 4, placed("WASH", "bowl"), places_m, held=False)
    assert (hidden.was, hidden.state.num_objects) == ((2, 1, 0), 3)
    assert np.asarray(attempt_counts(hidden.state)).tolist() == [[0, 0, 0], [0, 1, 1]]
    scene, places_m = shows(2, 1, 0)
    back = present(scene, 4, placed("WASH", "bowl"), places_m, held=True)
    assert (back.was, back.new) == ((2, 1, -1), (2,))
    assert back.notes == ("WASH of 'bowl' held, but object 2 stands where it was: it is taken for another",)
    for other in (True, False):
        with pytest.raises(PolicyError, match="objects are on the table, and the cloud shows"):
            present(Scene(np.zeros((4, 4))), 4, history("WASH", "bowl"), held=other)


def test_what_is_washed_is_left_out():
    left = Scene(SCENE.hides[np.ix_([0, 2], [0, 2])])
    now = present(left, 4, history(None, None, location=("TABLE", "DISHWASHER", "TABLE")))
    np.testing.assert_allclose(now.state.log_odds, [0.6, 0.2], rtol=1e-6)
    assert np.asarray(attempt_counts(now.state)).tolist() == [[0, 0], [0, 0]]


def test_another_order_of_the_objects_is_suspected():
    turned = Scene(SCENE.hides[::-1, ::-1])
    assert any("is it the same" in note for note in present(turned, 4, history(None, None)).notes)


@pytest.mark.parametrize(
    ("action", "target", "num_objects"), [(None, None, 2), (None, None, 4), ("WASH", "mug", 1), ("LIFT", "mug", 2)]
)
def test_other_objects_than_the_cloud_shows_are_refused(action, target, num_objects):
    with pytest.raises(PolicyError, match=r"path 2, stage 2: 3 objects .* of other objects than the cloud shows"):
        present(Scene(np.zeros((num_objects, num_objects))), 4, history(action, target))


def test_a_path_that_is_over_is_refused():
    with pytest.raises(LogError, match="came to its own end"):
        present(SCENE, 4, history("WASH", "mug", ending="finished"))
    with pytest.raises(LogError, match="came to its own end"):
        present(SCENE, 4, history("FINISH", None))


@pytest.mark.parametrize(("action", "target"), [("WASH", None), ("PICK", "mug")])
def test_an_action_that_no_table_knows_is_refused(action, target):
    with pytest.raises(LogError, match=f"path 2, stage 2: action '{action}' of object .* is none that the table knows"):
        present(SCENE, 4, history(action, target))


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
        present(SCENE, 4, logs)


def test_no_step_left_is_refused():
    with pytest.raises(PolicyError, match="beyond the policy's horizon of 2 stages"):
        present(SCENE, 2, history("WASH", "mug"))
    with pytest.raises(PolicyError, match="beyond the policy's horizon of 1 stages"):
        present(SCENE, 1, history(None, None))


# Where the objects of the history were, in the order of the log: bowl, cup, mug.
PLACES_M = np.array([[0.0, 0.0, 0.05], [0.2, 0.0, 0.05], [0.2, 0.2, 0.05]])


def placed(*arguments, **more):
    """The history, with the places of its objects."""
    logs = history(*arguments, **more)
    rank = logs.objects.groupby(["path", "stage"]).cumcount()
    places = {name: PLACES_M[rank, axis] for axis, name in enumerate(("x_m", "y_m", "z_m"))}
    return Logs(logs.stages, logs.paths, logs.objects.assign(**places))


def shows(*ranks):
    """A cloud that shows these objects of the history, in this order."""
    return Scene(SCENE.hides[np.ix_(ranks, ranks)]), PLACES_M[list(ranks)]


def test_objects_are_found_again_in_any_order():
    scene, places_m = shows(2, 0, 1)
    now = present(scene, 4, placed(None, None), places_m)
    np.testing.assert_allclose(now.state.log_odds, [0.2, 0.6, 0.4], rtol=1e-6)
    assert now.state.lifts.tolist() == [0, 1, 0]
    assert np.asarray(attempt_counts(now.state)).tolist() == [[0, 0, 0], [0, 0, 1]]
    np.testing.assert_allclose(now.state.hides, scene.hides, rtol=1e-6)
    assert (now.notes, now.new) == ((), ())


def test_an_object_that_moved_is_the_same():
    scene, places_m = shows(2, 1, 0)
    moved_m = np.add(places_m, [[0.0, 0.05, 0.0], [0.0, 0.0, 0.0], [-0.1, -0.1, 0.0]])
    now = present(scene, 4, placed("LIFT", "bowl"), moved_m)
    np.testing.assert_allclose(now.state.log_odds, [0.2, 0.4, 0.6], rtol=1e-6)
    assert now.notes == ("whether LIFT of 'bowl' in stage 2 held is not known; it is not counted",)


def test_an_object_that_may_be_another_is_told():
    scene, places_m = shows(0, 1, 2)
    places_m[0, 0] += 0.18
    now = present(scene, 4, placed(None, None), places_m)
    assert [note.split(" of the history")[0] for note in now.notes] == [
        "object 0 may be another than 'bowl'",
        "object 1 may be another than 'cup'",
    ]
    np.testing.assert_allclose(now.state.log_odds, [0.6, 0.4, 0.2], rtol=1e-6)


def test_an_object_that_the_history_lacks_is_new_and_its_label_counts():
    scene = Scene(np.zeros((4, 4)))
    now = present(scene, 4, placed(None, None), np.array([[-0.3, 0.4, 0.05], *PLACES_M]))
    prior = np.log(0.6 / 0.4)
    np.testing.assert_allclose(now.state.log_odds, [prior, 0.6, 0.4, 0.2], rtol=1e-6)
    assert np.asarray(attempt_counts(now.state)).tolist() == [[0, 0, 0, 0], [0, 0, 1, 0]]
    assert (now.new, now.notes) == ((0,), ())
    told = labelled(now, [True] * 4, AssumedSeeing())
    moved = np.asarray(told.state.log_odds) - np.asarray(now.state.log_odds)
    assert moved[0] > 1.0
    assert not moved[1:].any()


def test_what_the_cloud_does_not_show_stays_where_it_was():
    scene, places_m = shows(2, 0)
    now = present(scene, 4, placed(None, None), places_m)
    np.testing.assert_allclose(now.state.log_odds, [0.2, 0.6, 0.4], rtol=1e-6)
    assert np.asarray(now.state.is_on_table).tolist() == [True, True, True]
    np.testing.assert_allclose(now.state.hides, SCENE.hides[np.ix_([2, 0, 1], [2, 0, 1])], rtol=1e-6)
    assert now.notes == (
        "object 2 is 'cup' of the history, which the cloud does not show: it is taken to be hidden where it was",
    )
    # A cloud shows two objects, and labels are of two.
    assert float(labelled(now, [True, True], AssumedSeeing()).state.log_odds[2]) == float(now.state.log_odds[2])


def test_what_was_washed_is_gone_if_it_is_not_seen():
    scene, places_m = shows(2, 1)
    now = present(scene, 4, placed("WASH", "bowl"), places_m)
    np.testing.assert_allclose(now.state.log_odds, [0.2, 0.4], rtol=1e-6)
    assert (now.stage, now.notes) == (3, ())


def test_a_wash_failed_if_its_object_is_seen_though_another_is_not():
    scene, places_m = shows(0, 2)
    now = present(scene, 4, placed("WASH", "bowl"), places_m)
    np.testing.assert_allclose(now.state.log_odds, [0.6, 0.2, 0.4], rtol=1e-6)
    assert np.asarray(attempt_counts(now.state)).tolist() == [[0, 0, 0], [1, 0, 1]]
    knocked = present(scene, 4, placed("WASH", "bowl"), places_m - np.array([[0.12, 0.0, 0.0], [0.0] * 3]))
    assert knocked.notes[0] == (
        "WASH of 'bowl' is taken to have failed: object 0, 0.12 m from where it was, is taken for it"
    )


def test_a_cloud_of_another_table_is_refused():
    scene, places_m = shows(0, 1, 2)
    with pytest.raises(PolicyError, match=r"path 2, stage 2: none of the 3 objects that the cloud shows is within"):
        present(scene, 4, placed(None, None), places_m + 1.0)


def test_without_places_in_the_log_or_of_the_cloud_order_counts():
    for logs, places_m in ((history(None, None), PLACES_M), (placed(None, None), None)):
        assert present(SCENE, 4, logs, places_m).notes == (ORDER,)
