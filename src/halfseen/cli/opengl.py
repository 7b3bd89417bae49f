"""MuJoCo's way to draw, which filming needs and nothing else does: most machines that run this have no screen."""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

import os
import warnings

GL = "MUJOCO_GL"


def load_mujoco() -> None:
    """Load MuJoCo for its physics; a way to draw that does not exist is then no matter."""
    try:
        import mujoco
    except RuntimeError:
        os.environ[GL] = "disable"
        import mujoco  # noqa: F401


def start_opengl() -> None:
    """Load MuJoCo with a way to draw.

    Raises
    ------
    ArgumentError
        There is none.
    """
    from halfseen.errors import ArgumentError

    os.environ.setdefault(GL, "egl")
    try:
        with warnings.catch_warnings(action="ignore"):
            import mujoco

            with mujoco.Renderer(mujoco.MjSpec().compile(), 32, 32):
                pass
    except Exception as error:  # whatever a missing or broken OpenGL raises
        raise ArgumentError(
            f"no picture can be drawn here: OpenGL does not start with {GL}={os.environ[GL]} "
            f"({(str(error).splitlines() or [type(error).__name__])[0][:120]}); set {GL} to egl, osmesa or glfw and "
            "install its library, or film on another machine"
        ) from error
