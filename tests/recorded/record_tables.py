"""What tables are to a learner: features, Q, encodings, fitted laws, one robot's part; ran at commit a5c2804.

python tests/recorded/record_tables.py
"""

import hashlib
import json
import sys
from pathlib import Path

import jax
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from halfseen.team import TeamTask, alone
from halfseen.team.features import team_features
from halfseen.world.action_space import possible_actions

from halfseen.logs import read_logs
from halfseen.tables import TableTask, fit_world
from halfseen.tables.features import table_features, table_q
from halfseen.world import WorldConfig
from recorded.eq3_cases import FOLDERS
from recorded.world_cases import played, some_states, states_at

HERE = Path(__file__).parent


def coefficients():
    """Of a Q of no meaning, every one of them another."""
    return np.sin(np.arange(3 * 23, dtype=np.float32)).reshape(3, 23)


def of_encoded(encoded):
    """SHA-256 of each array in float32 or as it is, its shape, and 20 rows of those that hold stages."""
    arrays, words = {}, {}
    at = np.argwhere(np.abs(encoded.features).sum(axis=(2, 3)) > 0)
    at = at[np.linspace(0, len(at) - 1, 20).astype(int)]
    arrays["at"] = at
    for what, value in encoded._asdict().items():
        if value is None:
            continue
        single = value.astype(np.float32) if value.dtype == np.float64 else value
        digest = hashlib.sha256(np.ascontiguousarray(single).tobytes()).hexdigest()
        words[what] = {"shape": value.shape, "dtype": str(single.dtype), "sha256": digest, "sum": float(value.sum())}
        arrays[what] = single[at[:, 0], at[:, 1]]
    return arrays, words


def of_part(logs):
    """Frames of a log: shape, digest of its CSV to 9 digits, and the first rows."""
    frames = {"stages": logs.stages, "paths": logs.paths, "objects": logs.objects}
    told = {"summary": str(logs.summary())}
    for name, frame in frames.items():
        text = frame.to_csv(index=False, float_format="%.9g")
        numbers = frame.select_dtypes("number").sum().astype(float).to_dict()
        told[name] = {
            "columns": list(frame.columns),
            "num_rows": len(frame),
            "sha256": hashlib.sha256(text.encode()).hexdigest(),
            "sums": numbers,
            "head": text.splitlines()[1:6],
        }
    return told


def main():
    """Write tables.npz and tables.json."""
    arrays, words = {}, {}
    for name, (_, episodes) in played().items():
        if not name.endswith("greedy"):
            continue
        at = some_states(episodes, 60)
        states = states_at(episodes, at)
        arrays[f"{name}/at"] = at
        if name.startswith("team"):
            arrays[f"{name}/team_features"] = np.asarray(jax.jit(jax.vmap(team_features))(states))
            continue
        arrays[f"{name}/table_features"] = np.asarray(jax.jit(jax.vmap(table_features))(states))
        arrays[f"{name}/possible_actions"] = np.asarray(jax.vmap(possible_actions)(states))
        arrays[f"{name}/table_q"] = np.asarray(jax.jit(jax.vmap(lambda state: table_q(coefficients(), state)))(states))
    team = read_logs(FOLDERS["team"])
    for name, encoded in {
        "tables": TableTask(grasp=None).encode(read_logs(FOLDERS["tables"]), 10),
        "two_robots": TeamTask(grasp=None, base=None, num_robots=2).encode(team, 20),
    }.items():
        found, words[f"encoded/{name}"] = of_encoded(encoded)
        arrays |= {f"encoded/{name}/{what}": value for what, value in found.items()}
    fitted = fit_world(read_logs(FOLDERS["tables"]), WorldConfig())
    words["fit_world"] = {
        "dirty_share": float(fitted.dirty_share),
        **{
            law: {"family": type(of).__name__, **{k: np.asarray(v).tolist() for k, v in vars(of).items()}}
            for law, of in {"grasping": fitted.grasping, "seeing": fitted.seeing}.items()
        },
    }
    for robot in (0, 1):
        words[f"alone/{robot}"] = of_part(alone(team, robot))
    np.savez_compressed(HERE / "tables.npz", **arrays)
    (HERE / "tables.json").write_text(json.dumps(words, indent=1, ensure_ascii=False) + "\n")
    print(len(arrays), (HERE / "tables.npz").stat().st_size, json.dumps(words["fit_world"])[:600])


if __name__ == "__main__":
    main()
