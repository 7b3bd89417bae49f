"""Exceptions, as one tree.

::

    HalfseenError              everything below; the command line prints it in one line and exits with status 2
    ├── CloudError             a point cloud that cannot be read, or that shows no table
    ├── LogError               a log that breaks an invariant; names the trajectory and the stage
    │   ├── NothingRecordedError  a log that is being recorded holds no stage so far
    │   └── StorageError       the disk cannot store an event of a log
    ├── PlanError              a robot cannot do what it is asked to: out of reach, or something is in the way
    ├── PolicyError            a policy folder that cannot be read, or a policy that does not fit what it is shown
    │   └── OutOfRangeError    a state beyond what the logs of the policy showed
    ├── PositivityError        a weight that the data do not identify; names the trajectory, the stage and the time
    ├── SceneError             a scene whose numbers contradict one another
    ├── WorkerError            workers are unavailable: nothing answers at the address, wrong versions, no memory
    └── ArgumentError          a value that an option or parameter cannot take

Every message says what is wrong, where, the value, and the remedy. Warnings are `HalfseenWarning`.
"""

import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches


class HalfseenError(Exception):
    """Base of all errors that a user of halfseen can cause and fix."""

    def __str__(self) -> str:
        # An array that was given by mistake would be written over several lines.
        return " ".join(line.strip() for line in super().__str__().splitlines())


class CloudError(HalfseenError):
    """A point cloud cannot be read, or shows no table."""


class LogError(HalfseenError):
    """A log breaks an invariant."""


class StorageError(LogError):
    """The disk cannot store an event of a log."""


class NothingRecordedError(LogError):
    """A log that is being recorded holds no stage so far, or none of the policy in question."""


class PlanError(HalfseenError):
    """A robot cannot do what it is asked to."""


class PolicyError(HalfseenError):
    """A policy folder cannot be read, or the policy does not fit what it is shown."""


class OutOfRangeError(PolicyError):
    """A state lies beyond what the logs of a policy showed."""


class PositivityError(HalfseenError):
    """An inverse-probability weight is not identified: nothing was ever seen beyond some time."""


class SceneError(HalfseenError):
    """A scene's numbers contradict one another."""


class WorkerError(HalfseenError):
    """Workers are unavailable: nothing answers, versions differ, or the workers were lost."""


class ArgumentError(HalfseenError, ValueError):
    """An option or parameter has a value that it cannot take."""


class HalfseenWarning(UserWarning):
    """Something is legal and probably not meant."""


def warn(source: object, trouble: str) -> None:
    """Warn that input is read in a way that may surprise the user, naming the folder or file that it is in."""
    warnings.warn(f"{source}: {trouble}", HalfseenWarning, stacklevel=3)


@contextmanager
def within(source: object) -> Iterator[None]:
    """Prefix errors with the folder or file that they come from."""
    try:
        yield
    except HalfseenError as error:
        raise type(error)(f"{source}: {error}") from error


@contextmanager
def noted() -> Iterator[list[str]]:
    """Collect the warnings for users; they are complete at the end of the block, and shown only if it raises."""
    notes: list[str] = []
    is_over = False
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", HalfseenWarning)
            yield notes
            is_over = True
    finally:
        notes += [str(one.message) for one in caught if issubclass(one.category, HalfseenWarning)]
        for note in () if is_over else notes:
            warnings.warn(note, HalfseenWarning, stacklevel=2)


def closest(given: object, known: Iterable[object]) -> str | None:
    """Return the member of `known` closest to `given`, ignoring case; None if none is close."""
    names = {str(name).lower(): str(name) for name in known}
    close = get_close_matches(str(given).lower(), names, n=1)
    return names[close[0]] if close else None


def did_you_mean(given: object, known: Iterable[object]) -> str:
    """Ask whether another name was meant, as the end of a message; empty if no name is close.

    Parameters
    ----------
    given
        What was typed.
    known
        The valid names.
    """
    name = closest(given, known)
    return "" if name is None else f"; did you mean {name!r}?"
