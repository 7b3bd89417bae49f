"""How soon `halfseen watch` answers, and how many pictures a second a browser draws of it; medians, ratios, and JSON.

python benchmarks/watch.py [--out runs/benchmarks/watch.json] [--points 300000] [--runs 5]

Bars: the page answers within 3 seconds after the start of the process, and 300,000 points are drawn 20 times a second
or more. The points are those of a table that comes with the package, and of it again; with all layers, its completed
shapes, shadows and arrows are drawn as well. The browser draws by a software renderer, without a GPU; a desktop's is
faster. The peer is the viewer alone: viser with the same points from the same place and nothing else. Both take turns.
"""

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from urllib.request import urlopen

import numpy as np
from timings import Row, write

from halfseen.perception import perceive, read_cloud
from halfseen.scene import table_paths
from halfseen.view.stage_view import StageView, Watched
from halfseen.view.stages import watched_cloud
from halfseen.view.viewer import HERE, Page, local_server

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from chromium import BROWSER, Tab, tab

TABLE, HORIZON = 7, 10
ANSWER_BAR_S, FRAMES_BAR = 3.0, 20.0
SETTLE_S, WATCH_S = 8.0, 5.0
FRAMES = f"""new Promise(done => {{
  let frames = 0; const begin = performance.now();
  const next = () => {{
    frames += 1; const seconds = (performance.now() - begin) / 1000;
    seconds > {WATCH_S} ? done(frames / seconds) : requestAnimationFrame(next);
  }};
  requestAnimationFrame(next);
}})"""
RENDERER = """(() => {
  const gl = document.createElement('canvas').getContext('webgl2');
  return gl.getParameter(gl.getExtension('WEBGL_debug_renderer_info').UNMASKED_RENDERER_WEBGL);
})()"""
BARE = """import sys, time
import viser
server = viser.ViserServer(host=sys.argv[1], port=int(sys.argv[2]), verbose=False)
while True:
    time.sleep(3600)
"""


def stage_of(num_points: int) -> StageView:
    """What is seen on a table, with so many points."""
    cloud = read_cloud(table_paths()[TABLE])
    stage = watched_cloud(cloud, perceive(cloud), None, None, HORIZON).stages[0]
    points_m, colours = (np.resize(each, (num_points, 3)) for each in (stage.points_m, stage.colours))
    return replace(stage, points_m=points_m, colours=colours)


def cloud_alone(stage: StageView) -> StageView:
    return replace(stage, objects=(), hides=np.zeros((0, 0)))


@contextmanager
def ours(stage: StageView) -> Iterator[Tab]:
    with closing(Page(0)) as page, tab(page.url) as browser:
        page.show(Watched("table", (stage,)))
        yield browser


@contextmanager
def viewer_alone(stage: StageView) -> Iterator[Tab]:
    server = local_server(0)
    from_m, at_m = stage.viewpoint
    camera = server.initial_camera
    camera.position, camera.look_at = tuple(from_m.tolist()), tuple(at_m.tolist())
    try:
        with tab(f"http://{HERE}:{server.get_port()}") as browser:
            points_m = stage.points_m.astype(np.float32)
            server.scene.add_point_cloud("/points", points_m, stage.colours, point_size=0.002, precision="float32")
            yield browser
    finally:
        server.stop()


def frames_per_s(browser: Tab) -> float:
    browser.until("document.querySelector('canvas') !== null")
    time.sleep(SETTLE_S)
    return float(browser.ask(FRAMES))


def answer_s(command: Callable[[int], list[str]], port: int) -> float:
    """Seconds from the start of a process until its page answers."""
    begin = time.monotonic()
    process = subprocess.Popen(command(port), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        while process.poll() is None:
            try:
                with urlopen(f"http://{HERE}:{port}", timeout=60) as page:
                    page.read()
            except OSError:
                time.sleep(0.02)
            else:
                return time.monotonic() - begin
    finally:
        process.terminate()
        process.wait(timeout=30)
    raise RuntimeError(f"{' '.join(command(port))} ended with status {process.returncode}")


def free_port() -> int:
    server = local_server(0)
    port = server.get_port()
    server.stop()
    return port


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/watch.json"))
    parser.add_argument("--points", type=int, default=300_000)
    parser.add_argument("--runs", type=int, default=5)
    args = parser.parse_args()
    if BROWSER is None:
        print("no chromium is installed: nothing is measured")
        return
    commands: dict[str, Callable[[int], list[str]]] = {
        "halfseen watch": lambda port: [
            *(sys.executable, "-m", "halfseen.cli", "watch", str(table_paths()[TABLE]), "--port", str(port), "--quiet")
        ],
        "viewer alone": lambda port: [sys.executable, "-c", BARE, HERE, str(port)],
    }
    stage = stage_of(args.points)
    drawn: dict[str, Callable[[], object]] = {
        "all layers": lambda: ours(stage),
        "cloud": lambda: ours(cloud_alone(stage)),
        "viewer alone": lambda: viewer_alone(stage),
    }
    answers: dict[str, list[float]] = {name: [] for name in commands}
    frames: dict[str, list[float]] = {name: [] for name in drawn}
    renderer = ""
    for _ in range(args.runs):
        for name, command in commands.items():
            answers[name].append(answer_s(command, free_port()))
        for name, opened in drawn.items():
            with opened() as browser:  # type: ignore[attr-defined]
                frames[name].append(frames_per_s(browser))
                renderer = browser.ask(RENDERER)
    medians = {"answer_s": medians_of(answers), "frames_per_s": medians_of(frames)}
    ratios = {
        "answer": float(np.median(np.divide(answers["halfseen watch"], answers["viewer alone"]))),
        "frames": float(np.median(np.divide(frames["all layers"], frames["viewer alone"]))),
    }
    print(f"{args.points:,} points; {renderer}; load {os.getloadavg()[0]:.1f}")
    for name, seconds in medians["answer_s"].items():
        print(f"{name:16s} answers after {seconds:5.2f} s")
    for name, each in medians["frames_per_s"].items():
        print(f"{name:16s} {each:5.1f} pictures a second")
    print(
        f"to the viewer alone: answers in {ratios['answer']:.2f} times the time, {ratios['frames']:.2f} of the pictures"
    )
    holds = medians["answer_s"]["halfseen watch"] <= ANSWER_BAR_S, medians["frames_per_s"]["all layers"] >= FRAMES_BAR
    print(f"bars: {ANSWER_BAR_S:g} s {in_words(holds[0])}; {FRAMES_BAR:g} pictures a second {in_words(holds[1])}")
    results = {"median": medians, "ratio": ratios, "points": args.points, "renderer": renderer, "holds": holds}
    answer, frames = medians["answer_s"], medians["frames_per_s"]
    rows = [
        Row("`watch` answers", answer["halfseen watch"], "s", "viewer alone", answer["viewer alone"], ANSWER_BAR_S),
        Row("`watch` draws", frames["all layers"], "pictures/s", "viewer alone", frames["viewer alone"], FRAMES_BAR),
    ]
    write(args.out, results, rows)
    print(f"Results: {args.out}")


def medians_of(runs: dict[str, list[float]]) -> dict[str, float]:
    return {name: float(np.median(each)) for name, each in runs.items()}


def in_words(holds: bool) -> str:
    return "holds" if holds else "does not hold"


if __name__ == "__main__":
    main()
