"""Folders of policies that another program changed, and what is said of them."""

import hashlib
import json

import pytest
import safetensors.numpy

from halfseen.errors import PolicyError
from halfseen.policies.folder import read_policy
from halfseen.policies.folder.files import ARRAYS, DIGESTS, RECORD


def told(folder):
    """The refusal of a folder, which is one line."""
    with pytest.raises(PolicyError) as refused:
        read_policy(folder)
    assert "\n" not in str(refused.value)
    return str(refused.value)


def sign(folder):
    lines = [f"{hashlib.sha256((folder / name).read_bytes()).hexdigest()}  {name}\n" for name in (RECORD, ARRAYS)]
    (folder / DIGESTS).write_text("".join(lines))


def edit(folder, change):
    """Change policy.json and sign it anew, as another program might."""
    record = json.loads((folder / RECORD).read_text())
    change(record)
    (folder / RECORD).write_text(json.dumps(record))
    sign(folder)


def edit_arrays(folder, change):
    arrays = {name: array.copy() for name, array in safetensors.numpy.load((folder / ARRAYS).read_bytes()).items()}
    change(arrays)
    (folder / ARRAYS).write_bytes(safetensors.numpy.save(arrays))
    sign(folder)
