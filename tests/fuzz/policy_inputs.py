"""Clouds, policies, laws and teams as small valid inputs, made by the project's own writers."""

import json
import shutil
from functools import partial
from pathlib import Path

import numpy as np

from drawn_tables import TWO_CARDS, depth_of_cards
from fuzz.corpus import CLOUDS, HEAVY, LEARN, ONE, OTHERS, seed
from halfseen.logs import Logs
from small_logs import begun_log, flat_log, table_log

EVALUATE = "evaluate in/policy --logs in/logs --propensity estimated"
SIMULATE = "simulate in/table.npz --episodes 4 --out out --json"
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
RULE = '[[rule]]\nwhen = { x1 = "> 0.5" }\naction = "A"\n\n[[rule]]\naction = "A"\n'


def depth_image() -> np.ndarray:
    """Depth of two upright cards on a table, the one before the other [m]."""
    return depth_of_cards(*TWO_CARDS, shape=(NUM_ROWS, NUM_COLUMNS), k=K)


def colours() -> np.ndarray:
    picture = np.full((NUM_ROWS, NUM_COLUMNS, 3), (238, 236, 230), dtype=np.uint8)
    picture[56:68, 76:88] = (98, 62, 30)
    return picture


def table_cloud(is_coloured: bool = True):
    from halfseen.perception import Cloud

    return Cloud.from_depth(depth_image(), K, "table", colours() if is_coloured else None)


@seed(CLOUDS, "look in/table.npz --json", "look in/table.npz", "look in/table.npz --json --picture out.png")
def npz(folder: Path) -> None:
    np.savez_compressed(folder / "table.npz", depth_m=depth_image(), K=K, rgb=colours())


@seed(CLOUDS, "look in/table.pcd --json", "look in/table.pcd")
def pcd(folder: Path) -> None:
    from halfseen.perception import write_pcd

    write_pcd(table_cloud(), folder / "table.pcd")


@seed(CLOUDS, "look in/table.pcd --json")
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


for _name, _is_text in (("ply", False), ("ply-text", True)):
    seed(CLOUDS, "look in/table.ply --json", name=_name)(partial(ply, is_text=_is_text))


@seed(CLOUDS, *(f"look in/table.npz --labels in/labels.{kind} --json" for kind in ("csv", "json")), name="labels")
def labelled(folder: Path) -> None:
    npz(folder)
    (folder / "labels.csv").write_text("object,label,share_in_view\n0,dirty,0.4\n1,clean,0.2\n")
    labels = [{"object": 0, "label": "dirty", "share_in_view": 0.4}, {"object": 1, "label": "unknown"}]
    (folder / "labels.json").write_text(json.dumps(labels))


@seed(CLOUDS, "look in --json --workers 1", "look in/table.npz in/table.ply --workers 1")
def several(folder: Path) -> None:
    npz(folder)
    pcd(folder)
    ply(folder, is_text=False)


@seed(
    HEAVY,
    "act in/policy in/state.json --json",
    "act in/policy in/state.csv --json",
    "act in/policy in/state.json",
    "export in/policy --onnx out.onnx",
)
def discrete_policy(folder: Path) -> None:
    from halfseen.learning import CensoredQLearner
    from halfseen.policies.folder import write_policy

    logs = flat_log()
    learner = CensoredQLearner.of_paper(2, {1: ["A", "B"], 2: ["A", "C"]}, ["x1", "x2"], reg=0.1)
    write_policy(learner.fit(logs), logs, folder / "policy")
    (folder / "state.json").write_text(json.dumps(STATE))
    (folder / "state.csv").write_text("x1,x2,stage\n0.4,1,1\n")


@seed(
    HEAVY,
    f"{EVALUATE} --workers 1 --json",
    f"{EVALUATE} --against in/rule.toml --workers 1 --json",
    f"{EVALUATE} --against in/rule.csv --workers 1",
    "report in/logs --out out.html --json --workers 1",
)
def judged(folder: Path) -> None:
    discrete_policy(folder)
    flat_log(seed=1).write(folder / "logs")
    (folder / "rule.toml").write_text(RULE)
    (folder / "rule.csv").write_text("x1,action\n> 0.5,A\n,A\n")


@seed(HEAVY, "act in/policy in/table.npz --json", "act in/policy in/table.npz --picture out.png")
def table_policy(folder: Path) -> None:
    from halfseen.learning import CensoredQLearner
    from halfseen.policies.folder import write_policy

    logs = table_log()
    write_policy(CensoredQLearner.for_table(3, reg=0.1).fit(logs), logs, folder / "policy")
    npz(folder)


@seed(
    HEAVY,
    "act in/policy in/table.npz --history in/history --json",
    "watch in/table.npz --policy in/policy --export out.html",
    "evaluate in/policy in/table.npz --world --episodes 8 --json",
)
def begun(folder: Path) -> None:
    """A policy, a table, and logs whose last trajectory is what was seen and done there so far."""
    from halfseen.perception import perceive, read_cloud

    table_policy(folder)
    scene = perceive(read_cloud(folder / "table.npz")).scene()
    begun_log(scene).write(folder / "history")


@seed(HEAVY, f"cell calibrate --from in/attempts --workers 1 {ONE}")
def attempts(folder: Path) -> None:
    """Attempts of a cell, fewer than its law needs to be sure."""
    from halfseen.cell.calibration.law import shipped_law
    from halfseen.logs import read_logs

    logs = read_logs(shipped_law() / "attempts")
    first = set(logs.trajectories["trajectory"][:200])
    kept = (frame[frame["trajectory"].isin(first)] for frame in (logs.stages, logs.trajectories, logs.objects))
    Logs(*kept).write(folder / "attempts")


@seed(HEAVY, f"{SIMULATE} --law in/law")
def law(folder: Path) -> None:
    from halfseen.cell.calibration.law import shipped_law

    (folder / "law").mkdir()
    for name in ("law.json", "law.safetensors", "law.sha256"):
        shutil.copy(shipped_law() / name, folder / "law")
    npz(folder)


@seed(HEAVY, *(f"{SIMULATE} --team in/team.{kind} --horizon 2" for kind in ("toml", "json")))
def team(folder: Path) -> None:
    npz(folder)
    (folder / "team.toml").write_text(TEAM)
    robots = [{"base_m": [-0.45, 0.8], "reach_m": 0.55}, {"name": "right", "base_m": [0.45, 0.8], "reach_m": 0.55}]
    (folder / "team.json").write_text(json.dumps({"robot": robots}))


def halfseen(*words: object) -> None:
    """Run a verb whose output is an input of others."""
    from halfseen.cli import halfseen as verbs

    verbs([str(word) for word in words], standalone_mode=False)


@seed(HEAVY, "inspect in/logs --json", LEARN)
def team_logs(folder: Path) -> None:
    team(folder)
    halfseen(
        *("simulate", folder / "table.npz", "--team", folder / "team.toml", "--episodes", 12, "--horizon", 2),
        *("--out", folder / "logs", "--json"),
    )


@seed(
    OTHERS,
    *(f"{verb} --help" for verb in ("look", "inspect", "cell run")),
    "study in/none.pcd --out out --only reward --repetitions 2 --seed 1",
    "cell run --policy nobody --out out",
    "cell calibrate --out out --attempts 50 --arm in/none.xml",
    "cell film --policy nobody --out out.gif",
    "watch in/none --export out.html",
    "serve in/none",
)
def command_line(folder: Path) -> None:
    """No input: the command line is what is broken."""
