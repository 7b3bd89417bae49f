"""The unit of rewards in words, on axes and in heads of tables; nothing where nobody has said it."""


def with_unit(number: str, unit: str | None) -> str:
    """A number and its unit, in one piece.

    Examples
    --------
    >>> with_unit("0.53", "parts").split(), with_unit("0.53", None)
    (['0.53', 'parts'], '0.53')
    """
    return f"{number}\u00a0{unit}" if unit else number


def labelled(quantity: str, unit: str | None) -> str:
    """A quantity with its unit in brackets, as axes have it.

    Examples
    --------
    >>> labelled("mean reward of a trajectory", "parts"), labelled("mean reward of a trajectory", None)
    ('mean reward of a trajectory [parts]', 'mean reward of a trajectory')
    """
    return f"{quantity} [{unit}]" if unit else quantity
