"""halfseen learns when to pick, when to look and when to stop, from cut logs and half-hidden views.

The packages follow the data: ``scene`` → ``perception`` → ``world`` → ``logs`` → ``censoring`` → ``learning`` →
``tables`` (a task) | ``planners`` → ``policies`` → ``evaluation`` → ``study`` | ``report`` → ``cli``.

Importing this package loads none of them. It only registers ``halfseen/Cups-v0`` with Gymnasium, where installed.
"""

import halfseen.gym_registration  # noqa: F401

__version__ = "0.1.0"
