"""Rows one after another are the same rows, and give the same Q as where they stand in their paths."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from random_logs import random_log

from halfseen.learners.q_learning.fitting import in_float64
from halfseen.learners.q_learning.packing import num_rows, packed
from halfseen.learners.q_learning.recursion import backward
from halfseen.learners.q_learning.room import MOST_SPARE
from halfseen.learners.q_learning.transitions import goes_on, of_successor, taken_of, target_of

BLOCKS = np.array([0, 1, 1, 2])


def cut_log(seed=0, ends_with=0):
    """Of 60 paths, some finished, some cut on the way, some cut after their last stage, and some never weighed."""
    log = random_log(seed, blocks=BLOCKS, ends_with=ends_with)
    rng = np.random.default_rng(seed)
    num_paths, horizon = log.action.shape
    weight, is_last = np.array(log.weight), np.array(log.is_last)
    kept = rng.integers(0, horizon + 1, num_paths)
    is_cut = rng.random(num_paths) < 0.5
    weight[(np.arange(horizon) >= kept[:, None]) & is_cut[:, None]] = 0.0
    is_last[is_cut] = False
    weight[:2] = 0.0
    # One was cut the moment its last possible stage was complete.
    weight[2], is_last[2] = 1.0, False
    return log._replace(weight=weight, is_last=is_last)


@pytest.mark.parametrize("end_action", [None, 0])
def test_each_row_of_weight_keeps_what_it_holds_and_what_follows_it(end_action):
    log = cut_log(ends_with=end_action)
    flat = packed(log, end_action, BLOCKS)
    # The value of a state is told by the features of what is possible: so it can be found again.
    value = np.where(log.is_possible, np.asarray(log.features).sum(axis=3), 0.0).sum(axis=2)
    of_row = np.zeros((1, flat.action.shape[1] + 1))
    np.add.at(of_row[0], flat.choices.row, flat.choices.features.sum(axis=2))
    of_row = of_row[:, :-1]
    has_weight, has_row = (np.asarray(each.weight) > 0 for each in (log, flat))
    assert has_row.sum() == has_weight.sum()
    for name in ("action", "reward", "weight", "is_last"):
        np.testing.assert_array_equal(getattr(flat, name)[has_row], np.asarray(getattr(log, name))[has_weight])
    np.testing.assert_array_equal(taken_of(flat)[has_row], np.asarray(taken_of(log))[has_weight])
    np.testing.assert_array_equal(flat.fold[has_row], np.broadcast_to(log.fold[:, None], log.action.shape)[has_weight])
    np.testing.assert_array_equal(goes_on(flat, end_action)[has_row], goes_on(log, end_action)[has_weight])
    np.testing.assert_allclose(
        np.asarray(target_of(flat, of_successor(jnp.asarray(of_row))))[has_row],
        np.asarray(target_of(log, of_successor(jnp.asarray(value))))[has_weight],
        rtol=1e-4,
        atol=1e-4,
    )
    assert flat.num_paths == len(log.action)


@pytest.mark.parametrize("end_action", [None, 0])
@pytest.mark.parametrize("pessimism", [None, 1.0])
@pytest.mark.parametrize("fewest_rows", [0, 2000])
def test_q_is_the_same(end_action, pessimism, fewest_rows):
    log = cut_log(seed=3, ends_with=end_action)
    log = log._replace(fold=log.fold % 3)
    options = {"num_blocks": 3, "stages": "pooled", "num_folds": 3, "end_action": end_action, "pessimism": pessimism}
    with in_float64():
        blocks, regs = BLOCKS, np.array([0.01, 0.1, 1.0])
        whole = backward(jax.tree.map(np.asarray, log), blocks, regs, **options)
        flat = packed(log, end_action, BLOCKS, fewest_rows)
        assert flat.action.shape[1] >= fewest_rows
        flat = backward(flat, blocks, regs, **options, horizon=log.action.shape[1])
    np.testing.assert_allclose(flat.coefficients, whole.coefficients, atol=1e-9)
    np.testing.assert_array_equal(flat.reg, whole.reg)
    if pessimism:
        spreads = (np.einsum("tkfg,tkhg->tkfh", root, root) for root in (flat.root, whole.root))
        np.testing.assert_allclose(*spreads, atol=1e-9)


def test_there_is_room_for_few_rows_more_and_they_are_empty():
    log = cut_log(seed=5)
    flat = packed(log, None, BLOCKS)
    num_there = flat.action.shape[1]
    assert num_there < log.action.size
    num_used = num_rows(log)
    assert np.flatnonzero(flat.weight[0])[-1] + 1 <= num_used <= num_there
    assert num_there <= max(64, (1 + 1 / MOST_SPARE) * num_used + 1)
    assert not flat.weight[0, num_used:].any()
    spare = ~np.isin(np.arange(num_used, num_there), flat.choices.row)
    assert spare.all()


def test_parts_of_a_log_with_the_room_of_the_whole_are_of_one_shape():
    log = cut_log(seed=6)
    parts = [log._replace(weight=np.where(log.fold[:, None] == k, 0.0, log.weight)) for k in range(2)]
    shapes = [[leaf.shape for leaf in jax.tree.leaves(packed(part, None, BLOCKS, num_rows(log)))] for part in parts]
    assert shapes[0] == shapes[1]


def test_choices_are_what_is_possible_where_something_came_before_in_chunks_of_one_block():
    log = cut_log(seed=7)
    flat = packed(log, None, BLOCKS)
    chunks, is_real = flat.choices, flat.choices.row < flat.action.shape[1]
    used = is_real.any(axis=1)
    blocks = np.where(is_real, BLOCKS[chunks.action], BLOCKS[chunks.action[:, :1]])
    assert (blocks[used] == blocks[used][:, :1]).all()
    follows = np.asarray(log.weight[:, :-1] > 0) & ~np.asarray(log.is_last[:, :-1])
    assert is_real.sum() == np.asarray(log.is_possible)[:, 1:][follows].sum()
    assert chunks.row.shape == chunks.action.shape == chunks.features.shape[:2]
