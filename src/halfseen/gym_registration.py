"""Register the tables with Gymnasium; ``import halfseen`` does so, before or after ``import gymnasium``.

It loads neither the world, which is loaded when a table is made, nor Gymnasium, whose import takes longer than all else
here. If Gymnasium is not loaded yet, the tables are registered once it is.
"""

import sys
from importlib.util import find_spec
from typing import Any

ENV_ID = "halfseen/Cups-v0"
TEAM_ENV_ID = "halfseen/TeamCups-v0"
_ENTRY_POINTS = {
    ENV_ID: "halfseen.world.envs:CupsEnv",
    TEAM_ENV_ID: "halfseen.world.envs:TeamCupsEnv",
}


def register() -> None:
    """Register ``halfseen/Cups-v0`` and ``halfseen/TeamCups-v0``; registering twice changes nothing.

    There is no time-limit wrapper: the horizon is part of the table.
    """
    from gymnasium.envs import registration

    for name, entry_point in _ENTRY_POINTS.items():
        if name not in registration.registry:
            registration.register(id=name, entry_point=entry_point)


class _RegisterAfterImport:
    """A finder on `sys.meta_path` that leaves Gymnasium's import unchanged and registers once its module has run."""

    def find_spec(self, fullname: str, path: Any = None, target: Any = None) -> Any:
        if fullname != "gymnasium":
            return None
        sys.meta_path.remove(self)
        spec = find_spec(fullname)
        if spec is not None and spec.loader is not None:
            loader, run = spec.loader, spec.loader.exec_module

            def exec_module(module: Any) -> None:
                run(module)
                register()

            setattr(loader, "exec_module", exec_module)  # noqa: B010 - a loader's method is replaced on purpose
        return spec


if "gymnasium" in sys.modules:
    register()
else:
    sys.meta_path.insert(0, _RegisterAfterImport())
