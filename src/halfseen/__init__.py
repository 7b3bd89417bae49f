"""halfseen learns when to pick, when to look and when to stop, from cut logs and half-hidden views.

The folders are the way that data takes: ``scene`` → ``perception`` → ``world`` → ``logs`` → ``censoring`` →
``learning`` → ``tables`` (a task) | ``planners`` → ``policies`` → ``evaluation`` → ``study`` | ``report`` → ``cli``.
Importing this package loads none of them; it only tells Gymnasium, where that is installed, of ``halfseen/Cups-v0``.
"""

from typing import Any

import halfseen.gym_registration  # noqa: F401


def __getattr__(name: str) -> Any:
    # To look the version up takes longer than all else here.
    if name == "__version__":
        from halfseen.installation import version

        return version()
    raise AttributeError(f"module 'halfseen' has no attribute {name!r}")
