"""Tells Gymnasium of the tables; ``import halfseen`` does it.

It loads neither JAX nor the world; those load when a table is made.
"""

from gymnasium.envs import registration

ENV_ID = "halfseen/Cups-v0"


def register() -> None:
    """Register ``halfseen/Cups-v0``; registering twice changes nothing.

    There is no time limit to be wrapped around it: the horizon is the table's own end.
    """
    if ENV_ID not in registration.registry:
        registration.register(id=ENV_ID, entry_point="halfseen.world.gymnasium_env:CupsEnv")


register()
