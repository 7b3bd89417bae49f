"""Covariates that never changed within a trajectory: kept, watched, and named where columns were swapped."""

import numpy as np
import pandas as pd
import pytest

from halfseen.learning.covariates import Covariates
from halfseen.logs import Logs
from halfseen.monitoring import betting
from halfseen.monitoring.diagnosis import broken_parts, differs
from halfseen.monitoring.streams import move_streams
from halfseen.policies.folder.promised_parts import FEWEST_STEPS, _unmoved, moves

LOOKS_AT = Covariates(("weight", "clutter"))


def two_stages(num, seed=0, is_swapped=False):
    """A part has one weight; the clutter around it grows."""
    rng = np.random.default_rng(seed)
    weight, clutter = np.repeat(rng.random(num), 2), np.repeat(rng.random(num), 2) + np.tile([0.0, 0.1], num)
    seen = {"weight": clutter, "clutter": weight} if is_swapped else {"weight": weight, "clutter": clutter}
    place = np.repeat(np.arange(num), 2)
    done = {"elapsed_s": np.tile([1.0, 2.0], num), "action": "A", "reward": 0.0}
    stages = pd.DataFrame({"trajectory": place, "stage": np.tile([1, 2], num), **done, **seen})
    return Logs(stages, pd.DataFrame({"trajectory": range(num), "end_s": 2.0, "ending": "finished"}))


def test_what_never_changed_is_kept_if_there_were_enough_steps():
    assert _unmoved(two_stages(60), LOOKS_AT.columns) == {"names": ["weight"], "num": 60}
    assert _unmoved(two_stages(FEWEST_STEPS - 1), LOOKS_AT.columns)["names"] == []


@pytest.mark.parametrize("values", [[1.0, 1.0, 1.0, 2.0], list("aaab")])
def test_steps_are_within_trajectories(values):
    logs = two_stages(2)
    place, has_moved = moves(Logs(logs.stages.assign(weight=values), logs.trajectories), "weight")
    assert (place.tolist(), has_moved.tolist()) == ([0, 1], [False, True])


def test_a_change_within_trajectories_is_noticed_and_the_swap_named():
    unmoved, usual, swapped = {"names": ["weight"], "num": 60}, two_stages(40, 1), two_stages(40, 1, is_swapped=True)
    for logs, is_noticed in ((usual, False), (swapped, True)):
        [found] = move_streams(unmoved, logs)
        payoffs = betting.residual_payoffs(found.residuals, found.trajectory, 40, found.tolerance, found.reach)
        assert (betting.log_wealth(payoffs)[-1, 0] > np.log(1000)) == is_noticed
    assert differs(found, 0) == "weight changes within a trajectory, as it never did in the log"
    promise = {"stages": [], "unmoved": unmoved}
    assert broken_parts(promise, LOOKS_AT, usual, 1) == ()
    assert "covariates weight and clutter look swapped" in broken_parts(promise, LOOKS_AT, swapped, 1)[0]
