"""Two stages and log survival [Simoneau, Moodie, Nijjar, Platt, JASA 2019]: blips, ours beside those of DWSurv.

PYTHONPATH=benchmarks python benchmarks/published/dwsurv.py [--out …/dwsurv.json] [--repetitions 40] [--cells NAME …]
                                                            [--sizes 500 1000]

Settings are those of the paper's simulation; its numbers here come from its 1,000 stored repetitions of n = 500. The
blip of a stage is ψ₀ + ψ₁x; that of a Q is the line next to Q(x, 1) − Q(x, 0) over the range of x. *Right* is the share
of that range where the better treatment is chosen. In scenario 4 the treatment-free and the weight models of DWSurv are
wrong; our learner has none to be wrong. *True model* is least squares with the right treatment-free model and no
weights: no unbiased estimate has a smaller standard deviation.

*The log.* Stages earn log T₁ and log(T/T₁), which sum to log T. A patient who was cut is cut in the first stage, at the
recorded time: the design draws it, and how it is split into stages, apart from survival, so that some *outlive* their
own time. The second stage is learned by itself, from log T₂. *Weighted* is our learner with Cox weights and separate
stages, all else by default; *cut at once* is the default from a log that says who was cut, as DWSurv knows it, and not
when.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float
from peers.side_by_side import asked, markdown, run
from peers.weighted_survival import blip
from scipy.special import expit

from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs

ACTIONS = ("0", "1")
FIRST, SECOND = np.array([0.1, 0.1]), np.array([-0.9, 0.6])
"""ψ₀ and ψ₁ of each stage, in truth."""
RANGES = np.linspace((0.1, 0.9), (1.29, 2.0), 201)
NOISE = 0.3
Seen = Callable[[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"], np.random.Generator], Any]
"""(X₁ and X₂, whether there would be a second stage) → whether T is seen, and whether the second stage is reached."""


def independent(chance: float) -> Seen:
    return lambda x, enters, rng: (rng.random(len(x)) < chance, enters)


def by_first(intercept: float) -> Seen:
    return lambda x, enters, rng: (rng.random(len(x)) < expit(2.0 * x[:, 0] + intercept), enters)


def by_both(first: float, mean: float, second: float) -> Seen:
    """Who stays for the first stage may be lost in the second one, of which a mean share is."""

    def seen(x: Any, enters: Any, rng: np.random.Generator) -> Any:
        stays = rng.random(len(x)) < expit(2.0 * x[:, 0] + first) / (1.0 - 0.8 * mean)
        stays_on = rng.random(len(x)) >= expit(second - 2.0 * x[:, 1])
        return stays & (~enters | stays_on), enters & stays

    return seen


CELLS: dict[str, Seen] = {
    "independent, 30": independent(0.6),
    "independent, 60": independent(0.4),
    "on X₁, 30": by_first(-0.4),
    "on X₁, 60": by_first(-1.8),
    "on X₁ and X₂, 30": by_both(-0.2, 0.0805, 0.3),
    "on X₁ and X₂, 60": by_both(-1.8, 0.1466, 1.0),
}
PUBLISHED = {
    "independent, 30": ((0.098, 0.101, -0.897, 0.598), (0.086, 0.116, 0.200, 0.136), (99.2, 94.5)),
    "independent, 60": ((0.100, 0.100, -0.904, 0.605), (0.104, 0.144, 0.240, 0.165), (98.4, 93.4)),
    "on X₁, 30": ((0.100, 0.102, -0.905, 0.605), (0.085, 0.110, 0.186, 0.126), (99.4, 95.1)),
    "on X₁, 60": ((0.105, 0.091, -0.911, 0.606), (0.141, 0.168, 0.268, 0.183), (97.0, 92.7)),
    "on X₁ and X₂, 30": ((0.102, 0.098, -0.897, 0.598), (0.083, 0.105, 0.179, 0.121), (99.4, 95.4)),
    "on X₁ and X₂, 60": ((0.099, 0.100, -0.896, 0.597), (0.126, 0.153, 0.257, 0.173), (97.6, 93.3)),
}
"""Of DWSurv at n = 500: mean of ψ₀ and ψ₁ of the first stage and of the second, their sd, and right [%] of each."""
PUBLISHED_WRONG = {"independent, 30": (83.4, 95.6), "independent, 60": (83.9, 94.6)}
"""Right [%] of DWSurv in scenario 4."""


class Patients(NamedTuple):
    x: Float[np.ndarray, "n 2"]
    treated: Float[np.ndarray, "n 2"]
    enters: Bool[np.ndarray, " n"]
    is_seen: Bool[np.ndarray, " n"]
    years: Float[np.ndarray, "n 2"]
    """In each stage; if cut, watched in all (first), and in the second stage."""
    outlives: float
    """Share of those cut in the second stage who are watched in it for longer than T₂."""


def patients(cell: str, num: int, seed: int) -> Patients:
    """Draw a trial; the paper leaves out those with a first stage of less than no time, which are drawn again."""
    rng = np.random.default_rng([seed, list(CELLS).index(cell)])
    drawn = _drawn(cell, num, rng)
    while drawn.years[drawn.is_seen, 0].min() <= 0:
        drawn = _drawn(cell, num, rng)
    return drawn


def _drawn(cell: str, num: int, rng: np.random.Generator) -> Patients:
    x = rng.uniform((0.1, 0.9), (1.29, 2.0), (num, 2))
    first, second = x.T
    treated = (rng.random((num, 2)) < expit(np.column_stack([2.0 * first - 1.0, 2.8 - 2.0 * second]))).astype(float)
    is_seen, enters = CELLS[cell](x, rng.random(num) < 0.8, rng)
    noise, gain = NOISE * rng.normal(size=(2, num)), SECOND[0] + SECOND[1] * second
    free = 4.0 + 1.1052632 * second - 0.2105263 * second**3 - 0.1052632 * first + noise[1]
    total = 6.31578947 + 1.5 * first - 0.8 * first**4 + treated[:, 0] * (FIRST[0] + FIRST[1] * first) + noise[0]
    years = np.column_stack(
        [
            np.exp(total) - np.where(enters, np.exp(free + np.maximum(gain, 0.0)), 0.0),
            np.where(enters, np.exp(free + treated[:, 1] * gain), 0.0),
        ]
    )
    cut = 300.0 * rng.exponential(size=num)
    if cell.startswith("on X₁,"):
        cut = (cut / np.exp(2.0 * first)) ** (1.0 / 0.9)
    later = np.where(enters, cut * rng.random(num), 0.0)
    outlives = float(np.mean((later > years[:, 1])[enters & ~is_seen]))
    watched = np.where(is_seen[:, None], years, np.column_stack([cut, later]))
    return Patients(x, treated, enters, is_seen, watched, outlives)


class Found(NamedTuple):
    """Of each stage: ψ₀ and ψ₁, and the share of the range that is treated right."""

    psi: tuple[Any, Any]
    right: tuple[float, float]


def right_of(is_treated: Any, stage: int) -> float:
    psi = (FIRST, SECOND)[stage]
    return float(np.mean(is_treated == (psi[0] + psi[1] * RANGES[:, stage] > 0)))


def dwsurv(trial: Patients, cell: str, is_wrong: bool = False) -> Found:
    """DWSurv, with the models of the paper's scenario 1 or 4; cuts are modelled where they depend on X₁ alone."""
    one, first, second = np.ones((len(trial.x), 1)), trial.x[:, :1], trial.x[:, 1:]
    line, later_line = np.hstack([one, first]), np.hstack([one, second])
    seeing = line if cell.startswith("on X₁,") else one
    if is_wrong:
        return _by_blips(trial, (line, later_line), (one, one), seeing)
    return _by_blips(trial, true_models(trial), (line, later_line), seeing)


def true_models(trial: Patients) -> tuple[Any, Any]:
    """What log survival is without treatment."""
    one, (first, second) = np.ones(len(trial.x)), trial.x.T
    return np.column_stack([one, first, first**4]), np.column_stack([one, second, second**3, first])


def _by_blips(trial: Patients, free: Any, treating: Any, seeing: Any) -> Found:
    """The second stage, and the first one from what its best treatment would have brought; None for no weights."""
    one, late = np.ones(len(trial.x)), trial.enters
    lines = [np.column_stack([one, x]) for x in trial.x.T]

    def psi_of(log_time: Any, stage: int, kept: Any) -> Any:
        models = (free[stage], lines[stage], None if treating is None else treating[stage], seeing)
        each = (None if model is None else model[kept] for model in models)
        return blip(log_time[kept], trial.treated[kept, stage], trial.is_seen[kept], *each)

    second = psi_of(np.log(np.where(late, trial.years[:, 1], 1.0)), 1, late)
    gain = lines[1] @ second
    best = trial.years[:, 1] * np.exp(np.where(late, ((gain > 0) - trial.treated[:, 1]) * gain, 0.0))
    first = psi_of(np.log(trial.years[:, 0] + best), 0, np.ones_like(late))
    rights = [right_of(psi[0] + psi[1] * RANGES[:, stage] > 0, stage) for stage, psi in enumerate((first, second))]
    return Found((first, second), (rights[0], rights[1]))


def log_of(trial: Patients) -> Logs:
    """Both stages; what a patient earns is log survival."""
    total = np.where(trial.is_seen, trial.years.sum(axis=1), trial.years[:, 0])
    first = _stage(trial, 1, np.ones(len(total), dtype=bool), trial.years[:, 0], np.log(trial.years[:, 0]))
    both = trial.is_seen & trial.enters
    second = _stage(trial, 2, both, total, np.log(total / trial.years[:, 0]))
    second["log_first"] = np.log(trial.years[both, 0])
    stages = pd.concat([first.assign(x2=0.0, log_first=0.0), second]).sort_values(["trajectory", "stage"])
    return Logs(stages, _ends(np.arange(len(total)), total, trial.is_seen))


def second_log_of(trial: Patients) -> Logs:
    """The second stage by itself."""
    late, time = trial.enters, trial.years[:, 1]
    stages = _stage(trial, 2, late, time, np.log(np.where(late, time, 1.0))).assign(stage=1)
    return Logs(stages, _ends(np.flatnonzero(late), time[late], trial.is_seen[late]))


def _stage(trial: Patients, stage: int, kept: Any, elapsed: Any, reward: Any) -> pd.DataFrame:
    columns = {
        "trajectory": np.arange(len(kept)),
        "stage": stage,
        "elapsed_s": np.where(trial.is_seen, elapsed, np.nan),
        "reward": np.where(trial.is_seen, reward, np.nan),
        "action": np.array(ACTIONS, dtype=object)[trial.treated[:, stage - 1].astype(int)],
        "x1": trial.x[:, 0],
        "x2": trial.x[:, 1],
    }
    return pd.DataFrame(columns)[kept]


def _ends(trajectory: Any, end: Any, is_seen: Any) -> pd.DataFrame:
    return pd.DataFrame({"trajectory": trajectory, "end_s": end, "ending": np.where(is_seen, "finished", "cut")})


def cut_at_once(trial: Patients) -> Patients:
    """Who was cut as cut when the stage began: whether is all that DWSurv looks at, and not when."""
    return trial._replace(years=np.where(trial.is_seen[:, None], trial.years, 1e-3))


def learned(trial: Patients, **parameters: Any) -> Found:
    """Ours: the line next to the difference of Q, and what the policy does, in the second stage on average over X₁."""
    first = CensoredQLearner(2, ACTIONS, ["x1", "x2", "log_first"], **parameters).fit(log_of(trial))
    second = CensoredQLearner(1, ACTIONS, ["x1", "x2"], **parameters).fit(second_log_of(trial))
    later = pd.DataFrame({"x1": np.tile(RANGES[::40, 0], len(RANGES)), "x2": np.repeat(RANGES[:, 1], 6)})
    early = pd.DataFrame({"x1": RANGES[:, 0], "x2": 0.0, "log_first": 0.0})
    psi, right = [], []
    for stage, (learner, frame) in enumerate([(first, early), (second, later)]):
        gain, treats = np.diff(learner.q_values(frame, 1))[:, 0], learner.decide(frame, 1) == "1"
        psi.append(np.polynomial.polynomial.polyfit(frame[f"x{stage + 1}"], gain, 1))
        right.append(right_of(treats.reshape(len(RANGES), -1).T, stage))
    return Found((psi[0], psi[1]), (right[0], right[1]))


METHODS: dict[str, Callable[[Patients, str], Found]] = {
    "DWSurv": dwsurv,
    "scenario 4": lambda trial, cell: dwsurv(trial, cell, is_wrong=True),
    "true model": lambda trial, cell: _by_blips(trial, true_models(trial), None, None),
    "default": lambda trial, cell: learned(trial),
    "cut at once": lambda trial, cell: learned(cut_at_once(trial)),
    "weighted": lambda trial, cell: learned(trial, censoring="cox", stages="separate"),
}


def measured(cell: str, size: int, repetitions: int) -> dict[str, Any]:
    """Mean and sd of ψ of both stages, and the mean of what is right [%], by method."""
    found: dict[str, list[Found]] = {name: [] for name in METHODS}
    outlives = []
    for seed in range(repetitions):
        trial = patients(cell, size, seed)
        outlives.append(trial.outlives)
        for name, method in METHODS.items():
            found[name].append(method(trial, cell))
    methods = {name: summary(each) for name, each in found.items()}
    return {"cell": cell, "size": size, "outlives": round(float(np.mean(outlives)), 3), "methods": methods}


def summary(found: list[Found]) -> dict[str, list[float]]:
    psi = np.array([np.concatenate(each.psi) for each in found])
    return {
        "mean": psi.mean(axis=0).round(4).tolist(),
        "sd": psi.std(axis=0, ddof=1).round(4).tolist(),
        "right": (100.0 * np.mean([each.right for each in found], axis=0)).round(1).tolist(),
    }


def tables(report: dict[str, Any]) -> str:
    """ψ₁ as mean (sd) by size and stage, and what is right, with the paper's numbers where it has them."""
    sizes = dict.fromkeys(row["size"] for row in report["rows"])
    return "\n\n".join(_of_size(size, [row for row in report["rows"] if row["size"] == size]) for size in sizes)


def _of_size(size: int, rows: list[dict[str, Any]]) -> str:
    parts, is_paper = [], size == 500
    head = ["cuts", *(["DWSurv, published"] if is_paper else [])]
    for stage, psi in enumerate((FIRST, SECOND)):
        names, at = [name for name in METHODS if name != "scenario 4"], 2 * stage + 1
        lines = []
        for row in rows:
            mean, sd, _ = PUBLISHED[row["cell"]]
            published = [f"{mean[at]:.2f} ({sd[at]:.3f})"] if is_paper else []
            found = [row["methods"][name] for name in names]
            lines.append([row["cell"], *published, *(f"{one['mean'][at]:.2f} ({one['sd'][at]:.3f})" for one in found)])
        title = f"*n = {size:,}, stage {stage + 1}: mean (standard deviation) of ψ₁, which is {psi[1]}*"
        parts.append(f"{title}\n\n{markdown([*head, *names], lines).replace('-0', '−0')}")
    lines = []
    for row in rows:
        wrong = PUBLISHED_WRONG.get(row["cell"])
        published = [_right(PUBLISHED[row["cell"]][2]), "" if wrong is None else _right(wrong)] if is_paper else []
        lines.append([row["cell"], *published, *(_right(row["methods"][name]["right"]) for name in METHODS)])
    head = [*head, *(["scenario 4, published"] if is_paper else []), *METHODS]
    parts.append(f"*n = {size:,}: treated right [%], stage 1 / stage 2*\n\n{markdown(head, lines)}")
    return "\n\n".join(parts)


def _right(both: Sequence[float]) -> str:
    return f"{both[0]:.1f} / {both[1]:.1f}"


def main() -> None:
    parser = asked(__doc__, "dwsurv", 40)
    parser.add_argument("--cells", nargs="+", choices=CELLS, default=list(CELLS))
    parser.add_argument("--sizes", nargs="+", type=int, default=[500, 1000], help="patients of a trial")
    options = parser.parse_args()
    cells = [(cell, size, options.repetitions) for size in options.sizes for cell in options.cells]
    run(options.out, cells, measured, tables, repetitions=options.repetitions)


if __name__ == "__main__":
    main()
