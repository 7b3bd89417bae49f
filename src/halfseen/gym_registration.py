"""Tells Gymnasium of the tables; importing this module is enough.

Gymnasium 1 no longer asks installed packages for their environments, so some import has to. ``import halfseen`` does
where Gymnasium was imported before it; else name this module, in the id or by itself::

    gymnasium.make("halfseen.gym_registration:halfseen/Cups-v0")

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
