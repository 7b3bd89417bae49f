"""Small valid inputs, made by the project's own writers, each with a command line that reads it.

A command line names its input ``in/…`` and what it writes ``out…``, below the folder in which it runs.
"""

import json
import os
import shutil
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from halfseen.logs import LogRecorder, Logs
from small_logs import flat_log, table_log
from text_logs import text_log

sys.path.insert(0, str(Path(__file__).parents[1] / "logs" / "formats"))

NUM_ROWS, NUM_COLUMNS = 120, 160
K = np.array([[145.0, 0.0, 79.5], [0.0, 145.0, 59.5], [0.0, 0.0, 1.0]])
STATE = {"x1": 0.4, "x2": 1, "stage": 1}
TEAM = """clearance_m = 0.12
reward_per_s = -0.05

[[robot]]
name = "left"
base_m = [-0.45, 0.8]
reach_m = 0.55
speed = 1.0

[[robot]]
name = "right"
base_m = [0.45, 0.8]
reach_m = 0.55
drop_out_rate = 0.001
law = "assumed"
"""
BAG_OF_ROS_1 = {"action": "action", "reward": "reward", "ending": "end"}
OF_SQL = "--stages 'SELECT * FROM stages' --paths 'SELECT * FROM paths'"
RULE = '[[rule]]\nwhen = { x1 = "> 0.5" }\naction = "A"\n\n[[rule]]\naction = "A"\n'


@dataclass(frozen=True)
class Seed:
    """A valid input and what is done with it.

    Parameters
    ----------
    name
        Of the input.
    make
        Writes the input into a folder.
    lines
        Command lines that read it.
    is_heavy
        Whether making or reading it compiles.
    """

    name: str
    make: Callable[[Path], object]
    lines: tuple[str, ...]
    is_heavy: bool = False


def made(seed: Seed, corpus: Path) -> Path:
    """The folder of a valid input, made where it is not there yet; several processes may ask at once."""
    folder = corpus / seed.name
    if not folder.exists():
        fresh = Path(tempfile.mkdtemp(dir=corpus))
        seed.make(fresh)
        try:
            fresh.rename(folder)
        except OSError:  # another process was faster
            shutil.rmtree(fresh)
    return folder


def halfseen(*words: object) -> None:
    """Run a verb whose output is an input of others."""
    from halfseen.cli import halfseen as verbs

    verbs([str(word) for word in words], standalone_mode=False)


# Clouds.


def depth_image() -> np.ndarray:
    """Depth of two upright cards on a table, the one before the other [m]."""
    row, column = np.mgrid[:NUM_ROWS, :NUM_COLUMNS]
    down, across = (row - K[1, 2]) / K[1, 1], (column - K[0, 2]) / K[0, 0]
    down = np.tan(np.arctan(down) + 0.6)
    scale = np.cos(0.6) - np.sin(0.6) * (row - K[1, 2]) / K[1, 1]
    forward = np.where(down > 0.01, 0.6 / np.maximum(down, 0.01), np.inf)
    forward[(forward > 1.6) | (forward < 0.3)] = np.nan
    for left, right, ahead in ((-0.05, 0.06, 0.8), (0.0, 0.12, 0.95)):
        aside, drop = across / scale * ahead, down * ahead
        is_card = (aside > left) & (aside < right) & (drop > 0.48) & (drop < 0.6)
        forward = np.where(is_card & ~(forward < ahead), ahead, forward)
    return np.where(np.isfinite(forward), forward / scale, np.nan)


def colours() -> np.ndarray:
    picture = np.full((NUM_ROWS, NUM_COLUMNS, 3), (238, 236, 230), dtype=np.uint8)
    picture[56:68, 76:88] = (98, 62, 30)
    return picture


def table_cloud(is_coloured: bool = True):
    from halfseen.perception import Cloud

    return Cloud.from_depth(depth_image(), K, "table", colours() if is_coloured else None)


def npz(folder: Path) -> None:
    np.savez_compressed(folder / "table.npz", depth_m=depth_image(), K=K, rgb=colours())


def pcd(folder: Path) -> None:
    from halfseen.perception import write_pcd

    write_pcd(table_cloud(), folder / "table.pcd")


def pcd_text(folder: Path) -> None:
    points = table_cloud(False).points_m
    head = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
        f"WIDTH {NUM_COLUMNS}\nHEIGHT {NUM_ROWS}\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\nDATA ascii\n"
    )
    rows = "\n".join(" ".join(f"{value:.4f}" for value in point) for point in points)
    (folder / "table.pcd").write_text(f"{head}{rows}\n")


def ply(folder: Path, is_text: bool) -> None:
    from plyfile import PlyData, PlyElement

    cloud = table_cloud()
    kinds = [("x", "f4"), ("y", "f4"), ("z", "f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1")]
    vertices = np.zeros(len(cloud.points_m), dtype=kinds)
    for k, name in enumerate("xyz"):
        vertices[name] = cloud.points_m[:, k]
    for k, name in enumerate(("red", "green", "blue")):
        vertices[name] = cloud.colours[:, k]
    vertices = vertices[np.isfinite(vertices["x"])]
    PlyData([PlyElement.describe(vertices, "vertex")], text=is_text).write(folder / "table.ply")


def labelled(folder: Path) -> None:
    npz(folder)
    (folder / "labels.csv").write_text("object,label,share_in_view\n0,dirty,0.4\n1,clean,0.2\n")
    labels = [{"object": 0, "label": "dirty", "share_in_view": 0.4}, {"object": 1, "label": "unknown"}]
    (folder / "labels.json").write_text(json.dumps(labels))


def several(folder: Path) -> None:
    npz(folder)
    pcd(folder)
    ply(folder, is_text=False)


# Logs.


def parquet(folder: Path, logs: Logs) -> None:
    logs.write(folder / "logs")


def csv(folder: Path, logs: Logs) -> None:
    from halfseen.logs.formats import write_csv

    write_csv(logs, folder / "logs")


def journal(folder: Path) -> None:
    rng = np.random.default_rng(0)
    with LogRecorder(folder / "logs") as recorder:
        for number in range(6):
            path = recorder.begin_path(number)
            for stage in range(1, 3):
                path.begin_stage({"x1": rng.normal(), "x2": stage}, action="AB"[rng.integers(2)], probability=0.5)
                path.complete_stage(rng.normal(), elapsed_s=1.5 * stage)
            path.finish() if number % 2 else path.cut("battery")
        recorder.begin_path(6).begin_stage({"x1": 0.5, "x2": 1}, action="A", probability=0.5)
        shutil.copytree(folder / "logs", folder / "torn")
    (folder / "logs").rename(folder / "more")
    (folder / "torn").rename(folder / "logs")


def minari(folder: Path) -> None:
    from halfseen.logs.formats import write_minari

    at = os.environ.get("MINARI_DATASETS_PATH")
    os.environ["MINARI_DATASETS_PATH"] = str(folder)
    write_minari(flat_log(6), "logs/flat-v0")
    _restore("MINARI_DATASETS_PATH", at)


def minari_foreign(folder: Path) -> None:
    import minari as library
    from gymnasium import spaces
    from minari.data_collector import EpisodeBuffer

    at = os.environ.get("MINARI_DATASETS_PATH")
    os.environ["MINARI_DATASETS_PATH"] = str(folder)
    endings = [([False, False, True], [False] * 3), ([False] * 3, [False, False, True])]
    buffers = [
        EpisodeBuffer(
            observations=np.arange(8.0).reshape(4, 2),
            actions=np.array([0, 1, 0]),
            rewards=[1.0, 2.0, 3.0],
            terminations=terminated,
            truncations=truncated,
            infos={"t": np.array([5.0, 5.5, 7.0, 9.0])},
        )
        for terminated, truncated in endings
    ]
    box = spaces.Box(-9, 9, (2,), np.float64)
    library.create_dataset_from_buffers("hand-v0", buffers, action_space=spaces.Discrete(2), observation_space=box)
    _restore("MINARI_DATASETS_PATH", at)


def bag(folder: Path, storage: str, with_cloud: bool = False) -> None:
    from bags import cloud, two_paths, write_bag

    from halfseen.logs.formats import MAPPING_TEMPLATE

    messages = two_paths()
    if with_cloud:
        points = table_cloud(False).points_m
        messages += [cloud(at, "/camera/points", points, (NUM_ROWS, NUM_COLUMNS)) for at in (1.2, 3.2, 11.3, 13.6)]
    mapping = MAPPING_TEMPLATE
    (folder / "cell.toml").write_text(mapping if with_cloud else mapping[: mapping.index("# sensor_msgs/PointCloud2")])
    write_bag(folder / "bag", sorted(messages, key=lambda one: one[0]), storage)


def bag_of_ros_1(folder: Path) -> None:
    from bags import number, text
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    messages = [text(1.0, "/action", "A"), number(2.0, "/reward", 1.0), text(2.5, "/end", "finished")]
    with Writer(folder / "old.bag") as writer:
        for seconds, topic, kind, message in messages:
            connection = writer.add_connection(topic, kind, typestore=store)
            writer.write(connection, int(seconds * 1e9), store.serialize_ros1(message, kind))
    tables = (f'[{key}]\ntopic = "/{topic}"\nfield = "data"\n' for key, topic in BAG_OF_ROS_1.items())
    (folder / "cell.toml").write_text("".join(tables))


def lerobot(folder: Path) -> None:
    from foreign import episodes, last_of, write_lerobot

    found = episodes()
    write_lerobot(folder / "robot", found, extra={"next.done": last_of(found, [True, False, True])}, tasks=["pick"])


def steps(folder: Path, kind: str) -> None:
    import test_step_tables

    found = test_step_tables.episodes()
    test_step_tables.write(folder / f"steps.{kind}", test_step_tables.rows_of(found, [True, False, True]), kind=kind)


def step_arrays(folder: Path) -> None:
    import test_step_arrays

    found = test_step_arrays.episodes()
    test_step_arrays.write(folder / "steps.hdf5", test_step_arrays.arrays(found, terminated=[0], timed_out=[1]))


def sqlite(folder: Path) -> None:
    import sqlite3
    from contextlib import closing

    logs = flat_log(8)
    with closing(sqlite3.connect(folder / "logs.db")) as database:
        for name in ("stages", "paths"):
            logs.tables[name].to_sql(name, database, index=False)


def mcap_of_other_encodings(folder: Path, encoding: str) -> None:
    import test_mcap_files
    from bags import two_paths

    encode = getattr(test_mcap_files, f"as_{encoding}")
    test_mcap_files.write_mcap(folder / "cell.mcap", two_paths(), encode)
    test_mcap_files.mapping(folder, encode)


def journal_of_objects(folder: Path) -> None:
    seen = [{"object": name, "occlusion": 0.2 * k, "hidden_by": [0.0, 0.0]} for k, name in enumerate(("cup", "mug"))]
    with LogRecorder(folder / "logs", reward_unit="cups") as recorder:
        for number in range(4):
            path = recorder.begin_path(f"table-{number}", cell="left")
            for stage in range(1, 3):
                path.begin_stage({"light": 0.5}, objects=seen, action="WASH", object="cup", probability=0.5)
                path.complete_stage(1.0, elapsed_s=2.0 * stage)
            path.finish()


def calls(folder: Path) -> None:
    lines = [
        {"call": "begin_path", "name": 1, "columns": {"cell": "left"}},
        {"call": "begin_stage", "covariates": {"x": 0.3}, "action": "PICK", "probability": 0.5},
        {"call": "complete_stage", "reward": 1.0, "elapsed_s": 2.5},
        {"call": "begin_stage", "covariates": {"x": 0.4}, "action": "FINISH", "probability": 0.5},
        {"call": "complete_stage", "reward": 1.0, "elapsed_s": 3.5},
        {"call": "finish"},
    ]
    (folder / "calls.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))


# Policies, laws and teams.


def flat_policy(folder: Path) -> None:
    from halfseen.learning import CensoredQLearner
    from halfseen.policies.folder import write_policy

    logs = flat_log()
    learner = CensoredQLearner.of_paper(2, {1: ["A", "B"], 2: ["A", "C"]}, ["x1", "x2"], reg=0.1)
    write_policy(learner.fit(logs), logs, folder / "policy")
    (folder / "state.json").write_text(json.dumps(STATE))
    (folder / "state.csv").write_text("x1,x2,stage\n0.4,1,1\n")


def judged(folder: Path) -> None:
    flat_policy(folder)
    parquet(folder, flat_log(seed=1))
    (folder / "rule.toml").write_text(RULE)
    (folder / "rule.csv").write_text("x1,action\n> 0.5,A\n,A\n")


def table_policy(folder: Path) -> None:
    from halfseen.learning import CensoredQLearner
    from halfseen.policies.folder import write_policy

    logs = table_log()
    write_policy(CensoredQLearner.for_table(3, reg=0.1).fit(logs), logs, folder / "policy")
    npz(folder)


def begun(folder: Path) -> None:
    """A policy, a table, and logs whose last path is what was seen and done there so far."""
    from halfseen.perception import perceive, read_cloud

    table_policy(folder)
    scene = perceive(read_cloud(folder / "table.npz")).scene()
    logs = table_log(num_paths=4, num_objects=scene.num_objects, hides=scene.hides, seed=1)
    stages, objects, paths = (frame.copy() for frame in (logs.stages, logs.objects, logs.paths))
    stages, objects = (rows[(rows["path"] < 3) | (rows["stage"] == 1)] for rows in (stages, objects))
    is_now = stages["path"] == 3
    stages.loc[is_now, ["elapsed_s", "reward"]] = np.nan
    stages.loc[is_now, ["action", "object"]] = None
    paths.loc[paths["path"] == 3, ["end_s", "ending", "cause"]] = [1.0, "cut", "crash"]
    Logs(stages, paths, objects).write(folder / "history")


def attempts(folder: Path) -> None:
    """Attempts of a cell, fewer than its law needs to be sure."""
    from halfseen.cell.calibration.shipped import shipped_law
    from halfseen.logs import read_logs

    logs = read_logs(shipped_law() / "attempts")
    first = set(logs.paths["path"][:200])
    kept = (frame[frame["path"].isin(first)] for frame in (logs.stages, logs.paths, logs.objects))
    Logs(*kept).write(folder / "attempts")


def law(folder: Path) -> None:
    from halfseen.cell.calibration.shipped import shipped_law

    (folder / "law").mkdir()
    for name in ("law.json", "law.safetensors", "law.sha256"):
        shutil.copy(shipped_law() / name, folder / "law")
    npz(folder)


def team(folder: Path) -> None:
    npz(folder)
    (folder / "team.toml").write_text(TEAM)
    robots = [{"base_m": [-0.45, 0.8], "reach_m": 0.55}, {"name": "right", "base_m": [0.45, 0.8], "reach_m": 0.55}]
    (folder / "team.json").write_text(json.dumps({"robot": robots}))


def team_logs(folder: Path) -> None:
    team(folder)
    halfseen(
        *("simulate", folder / "table.npz", "--team", folder / "team.toml", "--episodes", 12, "--horizon", 2),
        *("--out", folder / "logs", "--json"),
    )


def nothing(folder: Path) -> None:
    """No input: the command line is what is broken."""


CLOUDS = (
    Seed("npz", npz, ("look in/table.npz --json", "look in/table.npz", "look in/table.npz --json --picture out.png")),
    Seed("pcd", pcd, ("look in/table.pcd --json", "look in/table.pcd")),
    Seed("pcd-text", pcd_text, ("look in/table.pcd --json",)),
    Seed("ply", lambda folder: ply(folder, is_text=False), ("look in/table.ply --json",)),
    Seed("ply-text", lambda folder: ply(folder, is_text=True), ("look in/table.ply --json",)),
    Seed(
        "labels",
        labelled,
        ("look in/table.npz --labels in/labels.csv --json", "look in/table.npz --labels in/labels.json --json"),
    ),
    Seed("several", several, ("look in --json --workers 1", "look in/table.npz in/table.ply --workers 1")),
)
LOGS = (
    Seed(
        "flat",
        lambda folder: parquet(folder, flat_log()),
        ("inspect in/logs --json", "inspect in/logs", "convert in/logs --out csv:out --json"),
    ),
    Seed(
        "tables",
        lambda folder: parquet(folder, table_log()),
        ("inspect in/logs --json", "inspect in/logs", "convert in/logs --out csv:out --json"),
    ),
    Seed("text", lambda folder: parquet(folder, text_log(20)), ("inspect in/logs --json",)),
    Seed("csv", lambda folder: csv(folder, flat_log(8)), ("convert in/logs --out out --json",)),
    Seed("csv-tables", lambda folder: csv(folder, table_log(6)), ("convert in/logs --out out --json",)),
    Seed(
        "journal",
        journal,
        ("inspect in/logs --json", "convert in/logs --out out --json", "convert in/logs in/more --out out"),
    ),
    Seed("minari", minari, ("convert in/logs/flat-v0 --out out --json",)),
    Seed(
        "minari-foreign",
        minari_foreign,
        ("convert in/hand-v0 --out out --json", "convert in/hand-v0 --out out --clock t --json"),
    ),
    Seed("mcap", lambda folder: bag(folder, "mcap"), ("convert in/bag --mapping in/cell.toml --out out --json",)),
    Seed("db3", lambda folder: bag(folder, "sqlite3"), ("convert in/bag --mapping in/cell.toml --out out --json",)),
    Seed(
        "bag-of-clouds",
        lambda folder: bag(folder, "mcap", with_cloud=True),
        ("convert in/bag --mapping in/cell.toml --out out --clouds out-clouds --json",),
    ),
    Seed(
        "lerobot", lerobot, ("convert in/robot --out out --json", "convert in/robot --out csv:out --step-s 0.5 --json")
    ),
    *(
        Seed(f"steps-{kind}", partial(steps, kind=kind), (f"convert in/steps.{kind} --out out --json",))
        for kind in ("parquet", "csv", "arrow")
    ),
    Seed(
        "steps-hdf5",
        step_arrays,
        ("convert in/steps.hdf5 --out out --json", "convert in/steps.hdf5 --out out --check --truncated finished"),
    ),
    *(
        Seed(
            f"mcap-{encoding}",
            partial(mcap_of_other_encodings, encoding=encoding),
            ("convert in/cell.mcap --mapping in/cell.toml --out out --json",),
        )
        for encoding in ("json", "protobuf")
    ),
    Seed("sqlite", sqlite, (f"convert sql:sqlite:///in/logs.db {OF_SQL} --out out --json",)),
    Seed("bag-of-ros-1", bag_of_ros_1, ("convert in/old.bag --mapping in/cell.toml --out out --json",)),
    Seed("journal-of-objects", journal_of_objects, ("inspect in/logs --json", "convert in/logs --out csv:out --json")),
    Seed("calls", calls, ("record in/calls.jsonl --out out",)),
)
HEAVY = (
    Seed(
        "flat-learned",
        lambda folder: parquet(folder, flat_log()),
        (
            "learn in/logs --out out --no-verdict --workers 1 --json",
            "learn in/logs --out out --no-verdict --workers 1 --in-passes --json",
            "learn in/logs --out out --no-verdict --workers 1 --censoring cox --q-function kernel --reg 0.1",
        ),
        True,
    ),
    Seed(
        "text-learned",
        lambda folder: parquet(folder, text_log(20)),
        ("learn in/logs --out out --no-verdict --workers 1 --json",),
        True,
    ),
    Seed(
        "tables-learned",
        lambda folder: parquet(folder, table_log()),
        ("learn in/logs --out out --no-verdict --workers 1 --json",),
        True,
    ),
    Seed(
        "flat-policy",
        flat_policy,
        (
            "act in/policy in/state.json --json",
            "act in/policy in/state.csv --json",
            "act in/policy in/state.json",
            "export in/policy --onnx out.onnx",
        ),
        True,
    ),
    Seed(
        "judged",
        judged,
        (
            "evaluate in/policy --logs in/logs --propensity estimated --workers 1 --json",
            "evaluate in/policy --logs in/logs --propensity estimated --against in/rule.toml --workers 1 --json",
            "evaluate in/policy --logs in/logs --propensity estimated --against in/rule.csv --workers 1",
            "report in/logs --out out.html --json --workers 1",
        ),
        True,
    ),
    Seed(
        "table-policy",
        table_policy,
        ("act in/policy in/table.npz --json", "act in/policy in/table.npz --picture out.png"),
        True,
    ),
    Seed(
        "begun",
        begun,
        (
            "act in/policy in/table.npz --history in/history --json",
            "watch in/table.npz --policy in/policy --export out.html",
            "evaluate in/policy in/table.npz --world --episodes 8 --json",
        ),
        True,
    ),
    Seed("attempts", attempts, ("cell calibrate --from in/attempts --out out --workers 1 --json",), True),
    Seed("law", law, ("simulate in/table.npz --law in/law --episodes 4 --out out --json",), True),
    Seed(
        "team",
        team,
        (
            "simulate in/table.npz --team in/team.toml --episodes 4 --horizon 2 --out out --json",
            "simulate in/table.npz --team in/team.json --episodes 4 --horizon 2 --out out --json",
        ),
        True,
    ),
    Seed("team-logs", team_logs, ("inspect in/logs --json", "learn in/logs --out out --no-verdict --workers 1"), True),
)
COMMAND_LINES = Seed(
    "command-line",
    nothing,
    (
        *(f"{verb} --help" for verb in ("look", "inspect", "cell run")),
        "study in/none.pcd --out out --only reward --repetitions 2 --seed 1",
        "cell run --policy nobody --out out",
        "cell calibrate --out out --attempts 50 --arm in/none.xml",
        "cell film --policy nobody --out out.gif",
        "watch in/none --export out.html",
        "serve in/none",
    ),
)
SEEDS = {seed.name: seed for seed in (*CLOUDS, *LOGS, *HEAVY, COMMAND_LINES)}


def _restore(name: str, value: str | None) -> None:
    if value is None:
        os.environ.pop(name, None)
    else:
        os.environ[name] = value
