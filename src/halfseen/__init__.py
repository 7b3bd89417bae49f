"""halfseen learns when to pick, when to look and when to stop, from cut logs and half-hidden views.

The folders are the way that data takes: ``scene`` → ``perception`` → ``world`` → ``logs`` → ``censoring`` →
``learners`` | ``planners`` → ``study``. Importing this package loads none of them.
"""

import sys

__version__ = "0.1.0"

if "gymnasium" in sys.modules:
    import halfseen.gym_registration  # noqa: F401
