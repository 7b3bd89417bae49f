"""A server that deals and records is killed with −9 again and again, and what it said stands."""

import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_kills_lose_no_decision_but_the_one_in_progress_and_deal_as_one_server_would(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", [str(ROOT / "benchmarks"), *sys.path])
    from running_cell import killed, learned

    found = killed(tmp_path, learned(tmp_path / "policy"), num_kills=40)
    assert found["torn"] > 10
    assert found["trajectories"] > 40
