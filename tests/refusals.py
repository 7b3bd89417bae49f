"""What is refused is reported in one line."""

from contextlib import contextmanager

import pytest
from jaxtyping import TypeCheckError

from halfseen.errors import ArgumentError, HalfseenError


@contextmanager
def refused(message=None, kind=HalfseenError):
    """Expect a refusal of one line that matches a pattern."""
    with pytest.raises(kind, match=message) as caught:
        yield caught
    assert "\n" not in str(caught.value)


@contextmanager
def refused_type(message, kind=ArgumentError):
    """Expect a refusal of an argument of another type, which beartype refuses first where shapes are checked."""
    with pytest.raises((kind, TypeCheckError), match=f"{message}|Type-check error") as caught:
        yield caught
    assert isinstance(caught.value, TypeCheckError) or "\n" not in str(caught.value)
