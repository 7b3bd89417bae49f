import numpy as np
import pytest
from scores import Scores

from halfseen.perception import perceive, read_cloud
from halfseen.scene import capture, random_table, read_truth, table_paths

# Tables that no threshold was chosen on.
FRESH_SEEDS = range(60_000, 60_020)


@pytest.mark.slow
def test_shipped_tables_are_seen_as_they_are():
    scores = Scores()
    for number, path in enumerate(table_paths()):
        scores.add(perceive(read_cloud(path)), read_truth(number))
    assert scores.num_found == scores.num_cups
    assert scores.num_false == 0
    assert scores.mean_error < 0.04
    assert scores.rank_correlation > 0.95
    assert np.mean(scores.is_pose_right) > 0.97


@pytest.mark.slow
def test_fresh_tables_are_seen_as_they_are(capsys):
    scores = Scores()
    for seed in FRESH_SEEDS:
        seen = capture(random_table(seed), seed)
        scores.add(perceive(seen.cloud), seen.truth)
    with capsys.disabled():
        print(f"\n20 random tables: {scores}")
    assert scores.num_found >= 0.98 * scores.num_cups
    assert scores.num_false <= 0.01 * scores.num_cups
    assert scores.mean_error < 0.03
    assert scores.rank_correlation > 0.96
