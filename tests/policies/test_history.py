"""The present of a table from the history of its log and a cloud that was seen since."""

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
from picked import leaves_of, picked

HIDES = np.array([[0.0, 0.5, 0.0], [0.0, 0.0, 0.2], [0.4, 0.0, 0.0]])
NAMES = ["mug", "cup", "bowl"]


def history(action, target, *, location=("TABLE",) * 3, ending="cut"):
    """An older trajectory, and one whose second stage begins with a failed attempt on the cup; names sort otherwise."""
    order, rows = np.argsort(NAMES), []
    for trajectory, stage in ((1, 1), (2, 1), (2, 2)):
        for k in order:
            is_tried = (k, stage) == (1, 2)
            row = {"trajectory": trajectory, "stage": stage, "object": NAMES[k], "hidden_by": HIDES[k][order].tolist()}
            row |= {"location": location[k] if (trajectory, stage) == (2, 2) else "TABLE", "occlusion": 0.3}
            row |= {"log_odds": 0.1 * (k + 1) * stage, "lifts": int(k == 2) * (stage - 1)}
            row |= {"attempt_occlusions": [0.2] * is_tried, "attempt_succeeded": [False] * is_tried}
            rows.append(row)
    last = (5.0, 1.0) if ending == "finished" else (None, None)
    stages = [(1, 1, 2.0, "FINISH", None, 0.0), (2, 1, 3.0, "WASH", "cup", -1.0)]
    stages.append((2, 2, last[0], action, target, last[1]))
    columns = ["trajectory", "stage", "elapsed_s", "action", "object", "reward"]
    ends = {"trajectory": [1, 2], "end_s": [2.0, 5.0], "ending": ["finished", ending]}
    return Logs(pd.DataFrame(stages, columns=columns), ends, pd.DataFrame(rows))


# The objects in the order of a log, which sorts them by name: bowl, cup, mug.
SCENE = Scene(HIDES[np.ix_([2, 1, 0], [2, 1, 0])])


ORDER = "objects of the history have no places (x_m, y_m, z_m): they are matched by order"


def present(scene, horizon, logs, places_m=None, held=None):
    return present_state(scene, horizon, logs, dirty_share=0.6, places_m=places_m, held=held)


def test_a_first_state_is_what_the_world_begins_with_before_it_sees():
    layout = picked(pad_scenes([SCENE]), 0)
    known = initial_state(WorldConfig(horizon=4), layout)
    now = first_state(SCENE, horizon=4, dirty_share=0.6)
    for mine, its in zip(leaves_of(now.state), leaves_of(known), strict=True):
        np.testing.assert_allclose(mine, its, rtol=1e-6)
        assert mine.dtype == its.dtype
    assert now.stage == 1
    assert int(first_state(SCENE, horizon=4, dirty_share=0.6, stage=3).state.steps_to_go) == 2


# Where the objects of the history were, in the order of the log: bowl, cup, mug.
PLACES_M = np.array([[0.0, 0.0, 0.05], [0.2, 0.0, 0.05], [0.2, 0.2, 0.05]])


def placed(*arguments, **more):
    """The history, with the places of its objects."""
    logs = history(*arguments, **more)
    rank = logs.objects.groupby(["trajectory", "stage"]).cumcount()
    places = {name: PLACES_M[rank, axis] for axis, name in enumerate(("x_m", "y_m", "z_m"))}
    return Logs(logs.stages, logs.trajectories, logs.objects.assign(**places))


def shows(*ranks):
    """A cloud that shows these objects of the history, in this order."""
    return Scene(SCENE.hides[np.ix_(ranks, ranks)]), PLACES_M[list(ranks)]


def test_an_object_that_the_history_lacks_is_new_and_its_label_counts():
    scene = Scene(np.zeros((4, 4)))
    now = present(scene, 4, placed(None, None), np.array([[-0.3, 0.4, 0.05], *PLACES_M]))
    prior = np.log(0.6 / 0.4)
    np.testing.assert_allclose(now.state.log_odds, [prior, 0.6, 0.4, 0.2], rtol=1e-6)
    assert np.asarray(attempt_counts(now.state)).tolist() == [[0, 0, 0, 0], [0, 0, 1, 0]]
    assert (now.new, now.notes) == ((0,), ())
    result = labelled(now, [True] * 4, AssumedSeeing())
    moved = np.asarray(result.state.log_odds) - np.asarray(now.state.log_odds)
    assert moved[0] > 1.0
    assert not moved[1:].any()


def test_without_places_in_the_log_or_of_the_cloud_order_counts():
    for logs, places_m in ((history(None, None), PLACES_M), (placed(None, None), None)):
        assert present(SCENE, 4, logs, places_m).notes == (ORDER,)


def washed_mug(*arguments, **more):
    return history(*arguments, location=("TABLE", "DISHWASHER", "TABLE"), **more)


def scene_of(ranks):
    return Scene(SCENE.hides[np.ix_(ranks, ranks)])


ALL = (0, 1, 2)
PRESENT, WASHED, LIFTED = (None, None), ("WASH", "bowl"), ("LIFT", "bowl")
SLID = [[0.0, 0.05, 0.0], [0.0, 0.0, 0.0], [-0.1, -0.1, 0.0]]
PUSHED = [[0.18, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
KNOCKED = [[-0.12, 0.0, 0.0], [0.0, 0.0, 0.0]]
HIDDEN = "object 2 is '{}' of the history, which the cloud does not show: it is taken to be hidden where it was"
NO_CUP, NO_BOWL = HIDDEN.format("cup"), HIDDEN.format("bowl")
OPEN = "whether LIFT of 'bowl' in stage 2 held is unknown; the attempt is not counted"
OTHERS = (
    "object 0 is taken to be 'bowl' of the history, but another",
    "object 1 is taken to be 'cup' of the history, but another",
)
FAILED = "WASH of 'bowl' is taken to have failed: object 0, 0.12 m from where it was, is taken to be the same"
STANDS = "WASH of 'bowl' held, but object 2 stands where it was: it is taken to be another"
NEW = np.log(0.6 / 0.4)
OTHER_THINGS = r"trajectory 2, stage 2: 3 objects .*: these are other objects"


@pytest.mark.parametrize(
    ("made", "did", "held", "ranks", "moved_m", "log_odds", "successes", "failures", "lifts", "notes"),
    [
        (history, PRESENT, None, ALL, 0.0, [0.6, 0.4, 0.2], [0, 0, 0], [0, 1, 0], [1, 0, 0], [ORDER]),
        (washed_mug, PRESENT, None, (0, 2), 0.0, [0.6, 0.2], [0, 0], [0, 0], [1, 0], [ORDER]),
        (history, WASHED, None, (1, 2), 0.0, [0.4, 0.2], [0, 0], [1, 0], [0, 0], [ORDER]),
        (history, WASHED, True, (1, 2), 0.0, [0.4, 0.2], [0, 0], [1, 0], [0, 0], [ORDER]),
        (history, WASHED, None, ALL, 0.0, [0.6, 0.4, 0.2], [0, 0, 0], [1, 1, 0], [1, 0, 0], [ORDER]),
        (history, WASHED, False, ALL, 0.0, [0.6, 0.4, 0.2], [0, 0, 0], [1, 1, 0], [1, 0, 0], [ORDER]),
        (history, LIFTED, None, ALL, 0.0, [0.6, 0.4, 0.2], [0, 0, 0], [0, 1, 0], [1, 0, 0], [ORDER, OPEN]),
        (history, LIFTED, True, ALL, 0.0, [0.6, 0.4, 0.2], [1, 0, 0], [0, 1, 0], [2, 0, 0], [ORDER]),
        (history, LIFTED, False, ALL, 0.0, [0.6, 0.4, 0.2], [0, 0, 0], [1, 1, 0], [1, 0, 0], [ORDER]),
        (placed, PRESENT, None, (2, 0, 1), 0.0, [0.2, 0.6, 0.4], [0, 0, 0], [0, 0, 1], [0, 1, 0], []),
        (placed, PRESENT, None, ALL, PUSHED, [0.6, 0.4, 0.2], [0, 0, 0], [0, 1, 0], [1, 0, 0], [*OTHERS]),
        (placed, LIFTED, None, (2, 1, 0), SLID, [0.2, 0.4, 0.6], [0, 0, 0], [0, 1, 0], [0, 0, 1], [OPEN]),
        (placed, PRESENT, None, (2, 0), 0.0, [0.2, 0.6, 0.4], [0, 0, 0], [0, 0, 1], [0, 1, 0], [NO_CUP]),
        (placed, WASHED, None, (2, 1), 0.0, [0.2, 0.4], [0, 0], [0, 1], [0, 0], []),
        (placed, WASHED, False, (2, 1), 0.0, [0.2, 0.4, 0.6], [0, 0, 0], [0, 1, 1], [0, 0, 1], [NO_BOWL]),
        (placed, WASHED, None, (0, 2), KNOCKED, [0.6, 0.2, 0.4], [0, 0, 0], [1, 0, 1], [1, 0, 0], [FAILED, NO_CUP]),
        (placed, WASHED, True, (2, 1, 0), 0.0, [0.2, 0.4, NEW], [0, 0, 0], [0, 1, 0], [0, 0, 0], [STANDS]),
    ],
)
def test_a_history_and_a_cloud_make_the_present(
    made, did, held, ranks, moved_m, log_odds, successes, failures, lifts, notes
):
    places_m = PLACES_M[list(ranks)] + moved_m if made is placed else None
    now = present(scene_of(ranks), 4, made(*did), places_m, held)
    assert (now.stage, int(now.state.steps_to_go)) == ((2, 3) if did == PRESENT else (3, 2))
    np.testing.assert_allclose(now.state.log_odds, log_odds, rtol=1e-6)
    assert np.asarray(attempt_counts(now.state)).tolist() == [successes, failures]
    assert now.state.lifts.tolist() == lifts
    assert [note[: len(wanted)] for note, wanted in zip(now.notes, notes, strict=True)] == notes


def test_an_attempt_that_failed_has_the_occlusion_of_its_object():
    now = present(SCENE, 4, history("WASH", "bowl"))
    assert float(now.state.attempt_occlusion[1]) == pytest.approx(SCENE.occlusion[0])
    np.testing.assert_allclose(occlusion(now.state), SCENE.occlusion, rtol=1e-6)


def test_what_the_cloud_does_not_show_hides_what_it_hid():
    now = present(scene_of((2, 0)), 4, placed(None, None), PLACES_M[[2, 0]])
    assert np.asarray(now.state.is_on_table).tolist() == [True, True, True]
    np.testing.assert_allclose(now.state.hides, SCENE.hides[np.ix_([2, 0, 1], [2, 0, 1])], rtol=1e-6)
    # A cloud shows two objects, and labels are of two.
    assert float(labelled(now, [True, True], AssumedSeeing()).state.log_odds[2]) == float(now.state.log_odds[2])


def test_another_order_of_the_objects_is_suspected():
    turned = Scene(SCENE.hides[::-1, ::-1])
    assert any("is it the same" in note for note in present(turned, 4, history(None, None)).notes)


def numbered(*did):
    logs, numbers = history(*did), {"bowl": 0, "cup": 1, "mug": 2}
    stages, objects = logs.stages, logs.objects.assign(object=logs.objects["object"].map(numbers))
    return Logs(stages.assign(object=stages["object"].map(numbers).astype("Int64")), logs.trajectories, objects)


def finished(*did):
    return history(*did, ending="finished")


WASHED_MUG, PICKED = ("WASH", "mug"), r"of object .* is unknown to a table"
FAR = "trajectory 2, stage 2: none of the 3 objects that the cloud shows is within"


@pytest.mark.parametrize(
    ("made", "did", "num_objects", "horizon", "error", "message"),
    [
        (history, PRESENT, 2, 4, PolicyError, OTHER_THINGS),
        (history, PRESENT, 4, 4, PolicyError, OTHER_THINGS),
        (history, WASHED_MUG, 1, 4, PolicyError, OTHER_THINGS),
        (history, ("LIFT", "mug"), 2, 4, PolicyError, OTHER_THINGS),
        (placed, PRESENT, 3, 4, PolicyError, FAR),
        (history, WASHED_MUG, 3, 2, PolicyError, "beyond the policy's horizon of 2 stages"),
        (history, PRESENT, 3, 1, PolicyError, "beyond the policy's horizon of 1 stages"),
        (finished, WASHED_MUG, 3, 4, LogError, "the trajectory has finished"),
        (history, ("FINISH", None), 3, 4, LogError, "the trajectory has finished"),
        (history, ("WASH", None), 3, 4, LogError, f"stage 2: action 'WASH' {PICKED}"),
        (history, ("PICK", "mug"), 3, 4, LogError, f"stage 2: action 'PICK' {PICKED}"),
        (numbered, ("WASH", None), 3, 4, LogError, "action 'WASH' of object null"),
    ],
)
def test_a_history_that_does_not_lead_to_the_cloud_is_refused(made, did, num_objects, horizon, error, message):
    scene = SCENE if num_objects == 3 else Scene(np.zeros((num_objects, num_objects)))
    with pytest.raises(error, match=message):
        present(scene, horizon, made(*did), PLACES_M + 1.0 if made is placed else None)
