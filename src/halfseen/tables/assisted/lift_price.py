"""What a LIFT costs, where the log's own LIFTs take longer, or less long, than its laws have them.

A world has one time of transport. A robot that turns what it LIFTs before its camera, or parks slowly, has several.
Times matter to one robot by the price of a LIFT alone, so it is this that is made right: what LIFTs paid, beside what
they were to pay under the laws, both weighted by δ / Ĝ(U⁻).
"""

from dataclasses import replace

import numpy as np

from halfseen.arrays import mapped
from halfseen.planners.belief import belief_of, expected_attempt_s
from halfseen.tables.assisted.weighted_log import WeightedLog
from halfseen.world.actions import ActionSpace, Verb
from halfseen.world.config import WorldConfig
from halfseen.world.state import occlusion

CLEARLY = 4.0
"""Standard errors beyond which what LIFTs paid is not what the laws say."""


def with_lift_price(config: WorldConfig, log: WeightedLog) -> tuple[WorldConfig, str | None]:
    """Scale the price of LIFTs to what they paid, where the laws clearly say otherwise.

    Parameters
    ----------
    config
        The laws, and the price as it was read or told.
    log
        The log, weighted.

    Returns
    -------
    WorldConfig
        The laws, with the price.
    str or None
        What was changed, in words.
    """
    space = ActionSpace(log.states.num_objects)
    at = np.nonzero((space.verb(log.action) == Verb.LIFT) & (log.weight > 0.0) & ~log.is_last)
    if not len(at[0]) or not config.reward_lift_per_s:
        return config, None
    state, rows = mapped(lambda leaf: leaf[at], log.states), np.arange(len(at[0]))
    seconds = expected_attempt_s(config, occlusion(state), belief_of(config, state).grip)
    expected = config.reward_lift_per_s * seconds[rows, space.target(log.action[at])]
    paid, weight = log.reward[at], log.weight[at]
    beyond = np.bincount(at[0], weight * (paid - expected), len(log.weight))
    if abs(beyond.sum()) <= CLEARLY * np.sqrt((beyond**2).sum()):
        return config, None
    told, was = weight @ paid / weight.sum(), weight @ expected / weight.sum()
    price = float(config.reward_lift_per_s * told / was)
    words = f"a LIFT paid {told:.2g} on average, where its times and its price a second make {was:.2g}: it is priced so"
    return replace(config, reward_lift_per_s=price), words
