"""What two policies earned on the same episodes."""

from collections.abc import Sequence
from typing import Any

from halfseen.study.pipeline import Played
from halfseen.study.policies import LEARNED


def beside(learned: Played, episodes: Sequence[int], played: Played) -> dict[str, Any]:
    """What another policy earned on some of the episodes, and a learned policy, which played all, on the same."""
    both = {LEARNED.name: learned.on(episodes), "other": played}
    return {"num_episodes": len(episodes)} | {who: each.means() for who, each in both.items()}
