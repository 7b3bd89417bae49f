"""``halfseen export``: a policy in a form that others run."""

from pathlib import Path

import click

from halfseen.cli import options
from halfseen.cli.output_files import refuse_output


@click.command(epilog="Example: halfseen export policy --onnx policy.onnx")
@click.argument("policy", type=options.PATH)
@click.option("--onnx", type=options.PATH, required=True, metavar="FILE", help="Write an ONNX model: an .onnx file.")
@click.option("--objects", type=click.IntRange(1, 100), help="Most objects of a table; by default as in the log.")
@options.overwrite("a file that is")
@options.unused_seed
def export(policy: Path, onnx: Path, objects: int | None, overwrite: bool, seed: int) -> None:
    """Write the policy in the folder POLICY as an ONNX model. Needs the extra onnx.

    Of named actions, it takes covariates, (n, features) in double precision, and the stage, from 1; it gives scores,
    (n, actions), and the number of the best action.

    Of tables, it takes the fields of TableState as halfseen.world describes them, for a fixed number of objects; it
    gives scores, one for each action, and the number of the best.

    Names of actions and covariates are in its metadata. It refuses nothing: what lies far outside the logs is for the
    controller to look at.
    """
    from halfseen.policies import read_policy
    from halfseen.policies.onnx_model import onnx_model
    from halfseen.writing import write_file

    refuse_output(onnx, "an ONNX model", (".onnx",), overwrite, [policy])
    model = onnx_model(read_policy(policy), objects)
    write_file(onnx, model)
    click.echo(f"{onnx}: {len(model):,} bytes")
