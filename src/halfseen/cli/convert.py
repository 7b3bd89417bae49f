"""``halfseen convert``: logs from one form into another."""

import json
import os
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import asdict
from functools import partial
from itertools import permutations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from halfseen.cli import options
from halfseen.cli.messages import say
from halfseen.progress import Progress

if TYPE_CHECKING:
    import numpy as np

    from halfseen.logs import Logs

CSV, MINARI = "csv:", "minari:"


def _print_template(ctx: click.Context, _: click.Parameter, is_asked: bool) -> None:
    if not is_asked or ctx.resilient_parsing:
        return
    from halfseen.logs.formats import MAPPING_TEMPLATE

    click.echo(MAPPING_TEMPLATE, nl=False)
    ctx.exit()


@click.command(epilog="Example: halfseen convert recording.mcap --mapping cell.toml --out logs")
@click.argument("sources", metavar="SOURCE...", nargs=-1, required=True)
@click.option("--out", "target", required=True, help="FOLDER of Parquet, csv:FOLDER, or minari:NAME-v0.")
@click.option("--mapping", type=options.PATH, help="Of a bag: which topic carries what (TOML).")
@click.option(
    "--mapping-template",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_template,
    help="Print a mapping file to start from.",
)
@click.option("--clouds", type=options.PATH, help="Of a bag: write each stage's cloud there as .pcd.")
@click.option("--see", is_flag=True, help="Of a bag: what each stage's cloud shows becomes its objects.")
@click.option("--clock", help="Of another's Minari dataset: the info that holds the time [s].")
@click.option("--step-s", type=float, help="Of another's Minari dataset: how long a step lasts [s].")
@options.unused_seed
@options.as_json
def convert(
    sources: tuple[str, ...], target: str, seed: int, as_json: bool, clouds: Path | None, **chosen: Any
) -> None:
    """Read the logs of SOURCE and write them to another form, all or nothing.

    SOURCE is a folder of logs (Parquet or CSV), a ROS bag (its folder, its .mcap, .db3 or .bag file, or a folder of
    bags), a folder of a Minari dataset, or minari:NAME-v0. Several folders of logs, such as those of many recorders,
    become one of Parquet files; paths that are still being recorded are left out.
    """
    from halfseen.writing import placed, refuse_taken

    if len(sources) > 1:
        _check_options("parquet", {**chosen, "clouds": clouds})
        _compact(sources, target, as_json)
        return
    source = next(iter(sources))
    kind = _kind(source)
    _check_options(kind, {**chosen, "clouds": clouds})
    place = Path(target.removeprefix(CSV))
    if not target.startswith(MINARI):
        refuse_taken(place, False, None, "logs")
        _refuse_one_in_another(place, clouds)
    # The folder of clouds appears only once the logs are written too.
    with nullcontext() if clouds is None else placed(clouds) as cloud_folder:
        logs = _read(kind, source, cloud_folder, **chosen)
        _write(logs, target)
    report = {"source": source, "format": kind, "target": target, "sentence": str(logs.summary())}
    report |= asdict(logs.summary())
    say(json.dumps(report, indent=2) if as_json else f"{target}: {report['sentence']}")


def _refuse_one_in_another(out: Path, clouds: Path | None) -> None:
    """Refuse folders of which one would lie in the other, or take its place."""
    from halfseen.errors import ArgumentError

    if clouds is None:
        return
    places = [Path(os.path.realpath(place)) for place in (out, clouds)]
    if any(one == other or one in other.parents for one, other in permutations(places)):
        raise ArgumentError(f"--clouds {clouds}: it is --out, or one lies in the other; give each a folder of its own")


def _compact(sources: tuple[str, ...], target: str, as_json: bool) -> None:
    from halfseen.errors import ArgumentError
    from halfseen.logs import compact

    if target.startswith((CSV, MINARI)):
        raise ArgumentError(f"--out is {target}; several folders become one of Parquet files: give a FOLDER")
    with Progress(2 * len(sources), "convert", "folders") as bar:
        done = compact(sources, target, on_progress=bar.update)
    left_out = f"; {done.num_running} still being recorded left out" if done.num_running else ""
    told = f"{done.num_paths} paths with {done.num_stages} stages from {done.num_folders} folders{left_out}"
    report = {"sources": list(sources), "target": target, "sentence": told, **done._asdict()}
    say(json.dumps(report, indent=2) if as_json else f"{target}: {told}")


def _kind(source: str) -> str:
    """What a source is, by what stands there; in an object store there is one form alone."""
    from halfseen.errors import LogError
    from halfseen.logs.place import is_remote

    path = Path(source)
    if source.startswith(MINARI) or (path / "data" / "metadata.json").is_file():
        return "minari"
    if is_remote(source):
        return "parquet"
    if not path.exists():
        raise LogError(f"{source}: there is no such file or folder; a Minari dataset is called {MINARI}NAME-v0")
    if (path / "stages.csv").exists() or (path / "paths.csv").exists():
        return "csv"
    return "bag" if _bags(path) else "parquet"


def _bags(path: Path) -> list[Path]:
    """The bags of a path: itself, or those that lie in it side by side."""
    if _is_bag(path):
        return [path]
    return sorted(entry for entry in path.iterdir() if _is_bag(entry)) if path.is_dir() else []


def _is_bag(path: Path) -> bool:
    if path.is_dir():
        return (path / "metadata.yaml").exists() or any(file.suffix == ".db3" for file in path.iterdir())
    return path.suffix in (".mcap", ".db3", ".bag")


def _check_options(kind: str, chosen: Mapping[str, Any]) -> None:
    from halfseen.errors import ArgumentError

    belongs_to = dict.fromkeys(("mapping", "clouds", "see"), "bag") | dict.fromkeys(("clock", "step_s"), "minari")
    for name, owner in belongs_to.items():
        is_given = chosen[name] is not None and chosen[name] is not False
        if is_given and owner != kind:
            raise ArgumentError(
                f"--{name.replace('_', '-')} is for a source of kind {owner}; this is {kind}: leave it out"
            )
    if kind == "bag" and chosen["mapping"] is None:
        raise ArgumentError(
            "a bag needs --mapping FILE, which says what its topics carry; --mapping-template prints one to start from"
        )


def _read(
    kind: str,
    source: str,
    clouds: Path | None,
    mapping: Path | None,
    see: bool,
    clock: str | None,
    step_s: float | None,
) -> "Logs":
    from halfseen.logs import formats, read_logs

    if kind == "csv":
        return formats.read_csv(source)
    if kind == "minari":
        return formats.read_minari(source.removeprefix(MINARI), clock=clock, step_s=step_s)
    if kind == "bag" and mapping is not None:
        return _read_bags(_bags(Path(source)), mapping, see, clouds)
    return read_logs(source)


def _read_bags(bags: list[Path], mapping: Path, see: bool, clouds: Path | None) -> "Logs":
    from halfseen.logs.formats import read_bag

    with Progress(None, "convert", "clouds") as bar:

        def counted(work: Callable[..., Any]) -> Callable[..., Any]:
            def count(*cloud: Any) -> Any:
                bar.update()
                return work(*cloud)

            return count

        keep = None if clouds is None else counted(partial(_kept, clouds))
        return read_bag(bags, mapping, see=counted(_see) if see else None, keep=keep)


def _write(logs: "Logs", target: str) -> None:
    from halfseen.logs import formats

    if target.startswith(MINARI):
        formats.write_minari(logs, target.removeprefix(MINARI))
    elif target.startswith(CSV):
        formats.write_csv(logs, target.removeprefix(CSV))
    else:
        logs.write(target)


def _kept(folder: Path, points_m: "np.ndarray", shape: tuple[int, int], name: str) -> str:
    """Write a cloud; its file is called like it."""
    from halfseen.perception import Cloud, write_pcd

    write_pcd(Cloud(points_m, _image_shape(shape), name=name), folder / f"{name}.pcd")
    return f"{name}.pcd"


def _see(points_m: "np.ndarray", shape: tuple[int, int], name: str) -> dict[str, list[Any]]:
    """Objects that a cloud shows, as columns; numbered anew in each cloud, the largest first."""
    import numpy as np

    from halfseen.perception import Cloud, perceive

    view = perceive(Cloud(points_m, _image_shape(shape), name=name))
    centroids = np.array([seen.centroid_m for seen in view.objects]).reshape(-1, 3)
    return {
        "object": [seen.id for seen in view.objects],
        "occlusion": [seen.occlusion for seen in view.objects],
        **{f"{axis}_m": centroids[:, k].tolist() for k, axis in enumerate("xyz")},
        "height_m": [seen.height_m for seen in view.objects],
        "is_upright": [seen.is_upright for seen in view.objects],
        "num_points": [seen.num_points for seen in view.objects],
        "hidden_by": view.hides.tolist(),
    }


def _image_shape(shape: tuple[int, int]) -> tuple[int, int] | None:
    return shape if shape[0] > 1 else None
