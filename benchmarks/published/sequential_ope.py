"""The value of a policy from logs of four stages: ours beside the sequential estimators of scope-rl.

python benchmarks/published/sequential_ope.py [--out …/sequential_ope.json] [--repetitions 24] [--sizes 400 2000]

Logs are of the pick cell of the examples, where the value of every policy is known; the policy is the best one.
Probabilities are logged. scope-rl knows of no cuts, so it is given the trajectories
that were not cut; ours is `evaluate` as it stands, of all. scope-rl 0.2.1 asks for d3rlpy, gym and PyTorch.
"""

from importlib.util import find_spec
from typing import Any

import numpy as np
from peers.sequential_ope import estimates
from peers.side_by_side import asked, markdown, run, skip
from worlds.examples import Cell
from worlds.policies import policies_of

from halfseen.evaluation import evaluate
from halfseen.logs import Logs

PACKAGE = "scope-rl==0.2.1"
SHARES = {"uncut": 0.0, "half cut": 0.5}
POLICY = "best"
SIZES = (400, 2000)


def measured(setting: str, size: int, num: int) -> dict[str, Any]:
    """What is estimated of a policy from so many logs, beside its value."""
    world, found = Cell(), []
    policy = policies_of(world)[POLICY]
    for seed in range(num):
        log = world.log(size, seed, SHARES[setting])
        value = evaluate(policy, log, against="logging").doubly_robust
        ours = {"ours": (value.value, value.low, value.high)}
        found.append(ours | estimates(world, policy, uncut(log)))
    truth = world.value(policy.chances)
    summary = {name: summed(np.array([each[name] for each in found]), truth) for name in found[0]}
    return {"setting": setting, "size": size, "logs": num, "truth": truth, "of": summary}


def uncut(log: Logs) -> Logs:
    return log.select(log.trajectory_ids[log.is_finished])


def summed(intervals: np.ndarray, truth: float) -> dict[str, float]:
    """Bias and its standard error, root of the mean square error, how often the interval holds, and its mean width."""
    value, low, high = intervals.T
    found = {
        "bias": value.mean() - truth,
        "error": value.std(ddof=1) / np.sqrt(len(value)),
        "rmse": np.sqrt(np.mean((value - truth) ** 2)),
        "held": np.mean((low <= truth) & (truth <= high)),
        "width": np.mean(high - low),
    }
    return {name: round(float(each), 5) for name, each in found.items()}


def tables(report: dict[str, Any]) -> str:
    names = list(report["rows"][0]["of"])
    rows = [
        [
            f"{row['setting']}, {row['size']:,}",
            *(cell(row["of"][name]) for name in names),
        ]
        for row in report["rows"]
    ]
    error = max(row["of"][name]["error"] for row in report["rows"] for name in names)
    caption = (
        f"*The best policy of the pick cell, from {report['repetitions']} logs: bias, root mean square error, share of "
        f"intervals that hold. scope-rl knows of no cuts and is given what finished. Errors of the bias ≤ {error:.3f}*"
    )
    return f"{caption}\n\n{markdown(['log', *names], rows)}"


def cell(found: dict[str, float]) -> str:
    return f"{found['bias']:+.3f}, {found['rmse']:.3f}, {100 * found['held']:.0f} %".replace("-", "−")


def main() -> None:
    parser = asked(__doc__, "sequential_ope", 24)
    parser.add_argument("--sizes", nargs="+", type=int, default=list(SIZES), help="trajectories of a log")
    options = parser.parse_args()
    if find_spec("scope_rl") is None:
        skip(f"scope-rl is not installed: pip install {PACKAGE}")
    cells = [(setting, size, options.repetitions) for setting in SHARES for size in options.sizes]
    run(options.out, cells, measured, tables, repetitions=options.repetitions, package=PACKAGE)


if __name__ == "__main__":
    main()
