"""Which of halfseen's extras brings a library that is not there."""

EXTRAS = {
    "perception": ("matplotlib", "plyfile", "pypcd4", "skimage"),
    "scene": ("mujoco",),
    "study": ("jinja2",),
    "watch": ("viser",),
    "onnx": ("onnx",),
    "onnx-tables": ("jax2onnx",),
    "serve": ("starlette", "uvicorn"),
    "gym": ("gymnasium",),
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


def remedy(error: ModuleNotFoundError) -> str | None:
    """Say how to install what is missing; None where no extra brings it."""
    library = (error.name or "").partition(".")[0]
    extra = next((name for name, libraries in EXTRAS.items() if library in libraries), None)
    return extra and f"{library} is not installed, and this command needs it; run: pip install 'halfseen[{extra}]'"
