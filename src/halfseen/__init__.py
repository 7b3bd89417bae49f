"""halfseen learns when to pick, when to look and when to stop, from cut logs and half-hidden views.

The folders are the way that data takes: ``scene`` → ``perception`` → ``world`` → ``logs`` → ``censoring`` →
``learning`` → ``tables`` (a task) | ``planners`` → ``policies`` → ``evaluation`` → ``study`` | ``report`` → ``cli``.
Importing this package loads none of them; it only tells Gymnasium, where that is installed, of ``halfseen/Cups-v0``.
"""

import halfseen.gym_registration  # noqa: F401

__version__ = "0.1.0.dev0"
