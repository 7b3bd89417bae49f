"""Learners whose policies are put into folders, how another program changes these, and what is said of them."""

import hashlib
import json
from functools import partial

import numpy as np
import pytest
import safetensors.numpy

from halfseen.errors import PolicyError
from halfseen.learning import CensoredQLearner
from halfseen.policies.folder import read_policy
from halfseen.policies.folder.files import ARRAYS, DIGESTS, RECORD
from halfseen.world import Scene, TableWorld, UniformPolicy, WorldConfig
from played_teams import logged, played, team_of
from small_logs import flat_log, table_log
from text_logs import COVARIATES, text_log

FILES = (RECORD, ARRAYS, DIGESTS)
FLAT = partial(CensoredQLearner.of_paper, 2, {1: ["A", "B"], 2: ["A", "C"]}, ["x1", "x2"], reg=0.1)
TABLES = partial(CensoredQLearner.for_table, 3, reg=0.1)


def played_log():
    """Tables of a world whose laws a log tells."""
    hides = np.array([[0.0, 0.0, 0.0], [0.6, 0.0, 0.0], [0.0, 0.4, 0.0]])
    return TableWorld(WorldConfig(horizon=3)).simulate(Scene(hides), UniformPolicy(), 60, seed=0, cut_share=0.3)


LEARNERS = {
    "flat": (flat_log, FLAT),
    "tables": (table_log, TABLES),
    "laws": (played_log, partial(CensoredQLearner.for_table, 3)),
    "text": (text_log, partial(CensoredQLearner.of_paper, 2, ["A", "B"], COVARIATES, reg=0.1)),
    "team": (
        lambda: logged(played(team_of(2, horizon=3), 60, seed=2), 0.4),
        partial(CensoredQLearner.for_team, 2, horizon=3, reg=0.1),
    ),
}


def refusal(folder):
    """The refusal of a folder, which is one line."""
    with pytest.raises(PolicyError) as refused:
        read_policy(folder)
    assert "\n" not in str(refused.value)
    return str(refused.value)


def sign(folder, name=None, content=None):
    """Sign the files again, as another program might that has changed one of them."""
    if name is not None:
        (folder / name).write_bytes(content)
    lines = [f"{hashlib.sha256((folder / name).read_bytes()).hexdigest()}  {name}\n" for name in (RECORD, ARRAYS)]
    (folder / DIGESTS).write_text("".join(lines))


def record(change):
    """Change policy.json."""

    def edit(folder):
        of = json.loads((folder / RECORD).read_text())
        change(of)
        sign(folder, RECORD, json.dumps(of).encode())

    return edit


def of_record(**changed):
    return record(lambda r: r.update(changed))


def of_schema(**changed):
    return record(lambda r: r["schema"].update(changed))


def of_colours(*colours):
    return record(lambda r: r["schema"]["categories"].update(colour=list(colours)))


def of_ranges(**changed):
    return record(lambda r: r["seen"][0]["ranges"].update(changed))


def arrays(change):
    """Change the arrays."""

    def edit(folder):
        of = {name: array.copy() for name, array in safetensors.numpy.load((folder / ARRAYS).read_bytes()).items()}
        change(of)
        sign(folder, ARRAYS, safetensors.numpy.save(of))

    return edit


def number(name, at, value):
    return arrays(lambda a: a[name].__setitem__(at, value))


def content(name, data):
    return lambda folder: sign(folder, name, data)
