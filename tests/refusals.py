"""What is refused is told in one line."""

from contextlib import contextmanager

import pytest

from halfseen.errors import HalfseenError


@contextmanager
def refused(told=None, kind=HalfseenError):
    """Expect a refusal of one line that matches what is to be told."""
    with pytest.raises(kind, match=told) as caught:
        yield caught
    assert "\n" not in str(caught.value)
