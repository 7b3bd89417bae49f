"""What a program sends that records line by line."""

import json


def as_lines(calls):
    """Calls, or bytes that are none, as a program sends them."""
    return b"".join(call if isinstance(call, bytes) else json.dumps(call).encode() + b"\n" for call in calls)
