"""How far a command has come, shown on a terminal alone."""

from typing import Any


def progress(total: int, what: str) -> Any:
    """A bar of so many steps, which begins with the step of this name."""
    from tqdm import tqdm

    return tqdm(total=total, desc=what, disable=None, leave=False)


def begin(bar: Any, what: str) -> None:
    """End a step, and begin the one of this name."""
    bar.update()
    bar.set_description(what)
