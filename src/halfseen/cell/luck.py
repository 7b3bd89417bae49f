"""The luck of which cups are dirty: what a table earns beyond what was believed of its cups.

Which cups are dirty is drawn, and that draw is most of what makes rewards differ from table to table. Where P(DIRTY) is
calibrated, what is taken out here has the mean 0 whatever decides (each term is the difference of an outcome from its
expectation given all that was seen before), so that a mean without it is the same mean, better known: a control variate
[Burch2018]_.
"""

from halfseen.arrays import Rows
from halfseen.world.config import WorldConfig


def luck_of_table(num_dirty: int, num_cups: int, chances: Rows, config: WorldConfig) -> float:
    """Reward of a table that has more or fewer dirty cups than its first look leads to expect, if all were left.

    Parameters
    ----------
    num_dirty, num_cups
        Of the table, by the truth.
    chances
        P(DIRTY) of the objects of the first look; cups beyond their number are as likely dirty as any.
    config
        The world that is believed in.
    """
    unseen = max(num_cups - len(chances), 0)
    expected = float(chances.sum()) + unseen * float(config.dirty_share)
    return float(config.reward_dirty_left) * (num_dirty - expected)


def luck_of_washing(washed: list[bool], chance: float, config: WorldConfig) -> float:
    """Reward of cups that came into the rack beyond what their P(DIRTY) led to expect.

    Parameters
    ----------
    washed
        Of each cup that came into the rack, whether it is dirty.
    chance
        P(DIRTY) of the object that was meant.
    config
        The world that is believed in.
    """
    if_dirty = float(config.reward_wash_dirty) - float(config.reward_dirty_left) - float(config.reward_wash_clean)
    return if_dirty * sum(float(is_dirty) - chance for is_dirty in washed)
