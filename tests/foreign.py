"""Episodes as plain lists, as files of several forms, and as the log that they are.

The log is made by a loop over rows, which shares nothing with the readers.
"""

import csv
import json
import shutil
import warnings

import h5py
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.feather
import pyarrow.parquet as pq

FINISHED, CUT = ("finished", None), ("cut", "truncated")


def episodes(seed=0, lengths=(3, 1, 4), *, is_text=False):
    """Of each episode: rows of what was observed (one more than there are steps), actions and rewards."""
    rng = np.random.default_rng(seed)
    names = ["NA", "pick", "null"]
    return [
        {
            "observed": rng.normal(size=(length + 1, 2)).tolist(),
            "actions": [names[k] if is_text else int(k) for k in rng.integers(0, 3, length)],
            "rewards": rng.normal(size=length).tolist(),
        }
        for length in lengths
    ]


def expected(found, endings, ends_s, columns, *, has_last=True, names=None):
    """Rows of stages and of trajectories, episode by episode and step by step."""
    stages, trajectories = [], []
    for number, (episode, (ending, cause), times) in enumerate(zip(found, endings, ends_s, strict=True)):
        name = number if names is None else names[number]
        trajectories.append((name, times[-1], ending, cause))
        num_steps = len(episode["actions"])
        for step in range(num_steps):
            is_cut_here = ending == "cut" and not has_last and step == num_steps - 1
            done = (None, None) if is_cut_here else (times[step], episode["rewards"][step])
            stages.append((name, step + 1, *done, episode["actions"][step], *episode["observed"][step]))
        if ending == "cut" and has_last:
            stages.append((name, num_steps + 1, None, None, None, *episode["observed"][num_steps]))
    return {
        "stages": pd.DataFrame(stages, columns=["trajectory", "stage", "elapsed_s", "reward", "action", *columns]),
        "trajectories": pd.DataFrame(trajectories, columns=["trajectory", "end_s", "ending", "cause"]),
    }


def assert_is(logs, wanted, rtol=0.0):
    for name, table in wanted.items():
        found = getattr(logs, name)[list(table)]
        for column in table:
            left, right = found[column].tolist(), table[column].tolist()
            assert len(left) == len(right), column
            for ours, theirs in zip(left, right, strict=True):
                if theirs is None or pd.isna(theirs):
                    assert pd.isna(ours), (column, ours)
                elif isinstance(theirs, float):
                    np.testing.assert_allclose(ours, theirs, rtol=rtol, atol=rtol, err_msg=column)
                else:
                    assert ours == theirs, column


def times_of(found, step_s=1.0):
    """Ends of the steps of each episode [s]."""
    return [[step_s * (k + 1) for k in range(len(each["actions"]))] for each in found]


def last_of(found, flags):
    """A column that is true in the last frame of some episodes."""
    lengths = [len(each["actions"]) for each in found]
    return [flag and k == length - 1 for length, flag in zip(lengths, flags, strict=True) for k in range(length)]


def write_lerobot(
    folder, found, *, fps=10, extra=None, features=None, info=None, tasks=None, lengths=None, stamps=None
):
    """Write a dataset of version 3 with two files of data; episodes lack what was observed after their last step."""
    rows = {
        "observation.state": [row for each in found for row in each["observed"][:-1]],
        "action": [action for each in found for action in each["actions"]],
        "next.reward": [reward for each in found for reward in each["rewards"]],
        "frame_index": [k for each in found for k in range(len(each["actions"]))],
        "episode_index": [number for number, each in enumerate(found) for _ in each["actions"]],
        **(extra or {}),
    }
    num_rows = len(rows["action"])
    stamps = [k / fps for k in rows["frame_index"]] if stamps is None else stamps
    rows |= {"timestamp": np.float32(stamps), "index": list(range(num_rows))}
    table = pa.table(rows)
    half = num_rows // 2
    for number, part in enumerate([table.slice(0, half), table.slice(half)]):
        file = folder / "data" / "chunk-000" / f"file-{number:03d}.parquet"
        file.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(part, file)
    described = {name: {"dtype": "float32", "shape": [1], "names": None} for name in rows} | (features or {})
    result = {"codebase_version": "v3.0", "fps": fps, "total_frames": num_rows, "features": described, **(info or {})}
    (folder / "meta" / "episodes" / "chunk-000").mkdir(parents=True)
    (folder / "meta" / "info.json").write_text(json.dumps(result))
    counted = [len(each["actions"]) for each in found] if lengths is None else lengths
    noted = pa.table({"episode_index": list(range(len(counted))), "length": counted, "stats/action/min": counted})
    pq.write_table(noted, folder / "meta" / "episodes" / "chunk-000" / "file-000.parquet")
    if tasks is not None:
        pd.DataFrame({"task_index": range(len(tasks))}, index=tasks).to_parquet(folder / "meta" / "tasks.parquet")
    return folder


def as_version_2(folder):
    """Rewrite a dataset of version 3 as one of version 2.1: a file an episode, and JSON lines."""
    info = json.loads((folder / "meta" / "info.json").read_text())
    (folder / "meta" / "info.json").write_text(json.dumps(info | {"codebase_version": "v2.1"}))
    rows = pd.concat([pd.read_parquet(file) for file in sorted(folder.glob("data/*/*.parquet"))], ignore_index=True)
    shutil.rmtree(folder / "data")
    for number, episode in rows.groupby("episode_index"):
        file = folder / "data" / f"chunk-{number // 2:03d}" / f"episode_{number:06d}.parquet"
        file.parent.mkdir(parents=True, exist_ok=True)
        episode.to_parquet(file, index=False)
    noted = pd.read_parquet(folder / "meta" / "episodes" / "chunk-000" / "file-000.parquet")[
        ["episode_index", "length"]
    ]
    noted.assign(tasks=[["pick"]] * len(noted)).to_json(
        folder / "meta" / "episodes.jsonl", orient="records", lines=True
    )
    shutil.rmtree(folder / "meta" / "episodes")
    if (folder / "meta" / "tasks.parquet").exists():
        tasks = pd.read_parquet(folder / "meta" / "tasks.parquet")
        result = pd.DataFrame({"task_index": tasks["task_index"], "task": tasks.index})
        result.to_json(folder / "meta" / "tasks.jsonl", orient="records", lines=True)
        (folder / "meta" / "tasks.parquet").unlink()
    return folder


def rows_of(found, terminal, *, last=None, clocks=None):
    """Steps of RLDS: one more row than there are steps, in which nothing was done any more."""
    rows = []
    for number, each in enumerate(found):
        num_steps = len(each["actions"])
        for k in range(num_steps + 1):
            is_over = k == num_steps
            row = {
                "episode_id": f"e{number}",
                "is_first": k == 0,
                "is_last": is_over if last is None else is_over and last[number],
                "is_terminal": is_over and terminal[number],
                "observation": each["observed"][k],
                "action": each["actions"][0 if is_over else k],
                "reward": 0.0 if is_over else each["rewards"][k],
            }
            rows.append(row if clocks is None else {**row, "t": clocks[number][k]})
    return rows


def write_rows(path, rows, kind="parquet"):
    path = path.with_suffix(f".{kind}")
    names = list(rows[0])
    if kind == "csv":
        with path.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(names)
            for row in rows:
                cells = (row[name] for name in names)
                writer.writerow([json.dumps(cell) if isinstance(cell, list | bool) else cell for cell in cells])
        return path
    table = pa.Table.from_pylist(rows)
    if kind == "parquet":
        pq.write_table(table, path)
    elif kind == "feather":
        pyarrow.feather.write_feather(table, path)
    else:
        with pa.OSFile(str(path), "wb") as sink, pa.ipc.new_stream(sink, table.schema) as stream:
            stream.write_table(table)
    return path


def arrays(found, terminated=(), timed_out=(), *, has_next=True):
    """Steps as of D4RL: the episodes one below the other."""
    ends = np.cumsum([len(each["actions"]) for each in found]) - 1
    rows = {
        "observations": [row for each in found for row in each["observed"][:-1]],
        "actions": [action for each in found for action in each["actions"]],
        "rewards": [reward for each in found for reward in each["rewards"]],
        "terminals": np.isin(np.arange(ends[-1] + 1), ends[list(terminated)]),
        "timeouts": np.isin(np.arange(ends[-1] + 1), ends[list(timed_out)]),
    }
    if has_next:
        rows["next_observations"] = [row for each in found for row in each["observed"][1:]]
    return rows


def write_arrays(file, rows):
    with h5py.File(file, "w") as root:
        for name, values in rows.items():
            if values is not None:
                root.create_dataset(name, data=values)
    return file


def write_minari_episodes(name, endings, **other):
    """Make a dataset of Minari with an episode of three steps for each ending, its flags of termination and truncation.

    What an episode holds may be other, or (`each`) other in each; spaces may be, too.
    """
    import minari
    from gymnasium import spaces
    from minari.data_collector import EpisodeBuffer

    parts = {"observations": np.arange(8.0).reshape(4, 2), "actions": np.array([0, 1, 0]), "rewards": [1.0, 2.0, 3.0]}
    parts |= {"infos": {"t": np.array([5.0, 5.5, 7.0, 9.0]), "note": ["a", "b", "c", "d"]}}
    seen = {"action_space": spaces.Discrete(2), "observation_space": spaces.Box(-9, 9, (2,), np.float64)}
    each = other.pop("each", [{}] * len(endings))
    parts, seen = ({key: other.get(key, value) for key, value in known.items()} for known in (parts, seen))
    buffers = [
        EpisodeBuffer(terminations=last, truncations=cut, **parts | more)
        for (last, cut), more in zip(endings, each, strict=True)
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # Minari misses an author, a licence and an environment
        return minari.create_dataset_from_buffers(name, buffers, **seen)


NO, LAST = [False, False, False], [False, False, True]
"""Flags of three steps."""
