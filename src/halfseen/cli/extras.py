"""Which of halfseen's extras brings a library that is not there."""

EXTRAS = {
    "perception": ("lzf", "matplotlib", "plyfile", "pypcd4", "skimage"),
    "scene": ("mujoco",),
    "study": ("jinja2",),
    "watch": ("viser",),
    "onnx": ("onnx",),
    "serve": ("starlette", "uvicorn"),
    "gym": ("gymnasium",),
    "jax": ("jax",),
    "pettingzoo": ("pettingzoo",),
    "minari": ("minari",),
    "hdf5": ("h5py",),
    "mcap": ("mcap", "mcap_protobuf"),
    "ros": ("rosbags",),
    "sql": ("sqlalchemy",),
    "ray": ("ray",),
    "dask": ("distributed",),
    "stores": ("upath",),
}
"""Libraries that some verbs need, by the extra that brings them."""
HELD = {"scene": ("perception",), "study": ("scene", "perception"), "watch": ("scene", "perception")}
"""What an extra holds of others."""
OF_VERB = {"cell": "scene", "report": "study", "study": "study", "watch": "watch"}
"""Extras of the verbs that need one which holds others: it is told at once, not one after the other."""


def remedy(error: ModuleNotFoundError, verb: str | None = None) -> str | None:
    """Say how to install what is missing; None where no extra brings it.

    Parameters
    ----------
    error
        What an import raised.
    verb
        What was called.
    """
    library = (error.name or "").partition(".")[0]
    extra = next((name for name, libraries in EXTRAS.items() if library in libraries), None)
    if extra is None:
        return None
    from halfseen.installation import command_for

    whole = OF_VERB.get(verb or "")
    told = whole if whole is not None and extra in HELD.get(whole, ()) else extra
    return f"{library} is not installed, and this command needs it; run: {command_for(told)}"
