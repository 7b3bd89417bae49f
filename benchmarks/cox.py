"""Cox's model of the cuts, ours and scikit-survival's in turn: the fit, and the fit with Ĝ at all ends.

python benchmarks/cox.py [--out runs/benchmarks/cox.json]

50,000 trajectories, 5 covariates, Efron's ties; once with untied ends, and once with ends in whole hundredths, where
scikit-survival is given cuts half a hundredth later, so that it too lets finishes come before cuts at equal times.
scikit-survival keeps a curve of all times for each trajectory that it is asked about, 20 GB here; its Ĝ is therefore
read off its baseline, which is the fastest that it allows. It stops at its own default tolerance; a second, untimed fit
of it at a tight one tells how far the coefficients lie apart.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from sksurv.linear_model import CoxPHSurvivalAnalysis
from sksurv.util import Surv
from timings import Row, write

from halfseen.censoring import Cox

NUM_TRAJECTORIES, NUM_COVARIATES = 50_000, 5
NUM_RUNS = 3


def seconds(call: Callable[[], object]) -> float:
    begin = time.perf_counter()
    call()
    return time.perf_counter() - begin


def drawn(is_tied: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    covariates = rng.normal(size=(NUM_TRAJECTORIES, NUM_COVARIATES))
    finish = rng.exponential(1.0, NUM_TRAJECTORIES)
    cut = rng.exponential(1.5 * np.exp(covariates @ np.linspace(-0.4, 0.4, NUM_COVARIATES)))
    if is_tied:
        finish, cut = np.ceil(100 * finish) / 100, np.ceil(100 * cut) / 100
    return np.minimum(finish, cut), finish <= cut, covariates


def compare(is_tied: bool) -> dict[str, Any]:
    end, is_finished, covariates = drawn(is_tied)
    shifted = np.where(is_finished, end, end + 0.005) if is_tied else end
    target = Surv.from_arrays(~is_finished, shifted)

    def ours() -> Cox:
        return Cox().fit(end, is_finished, covariates)

    def peer(**options: Any) -> CoxPHSurvivalAnalysis:
        return CoxPHSurvivalAnalysis(ties="efron", **options).fit(covariates, target)

    def our_survival() -> np.ndarray:
        return ours().survival(end, covariates)

    def peer_survival() -> np.ndarray:
        model = peer()
        baseline = model.cum_baseline_hazard_
        place = np.searchsorted(baseline.x, shifted, side="left")
        return np.exp(-np.concatenate([[0.0], baseline.y])[place] * np.exp(model.predict(covariates)))

    runs = np.array([[seconds(call) for call in (ours, peer, our_survival, peer_survival)] for _ in range(NUM_RUNS)])
    ours_s, peer_s, our_survival_s, peer_survival_s = np.median(runs, axis=0).tolist()
    difference = np.abs(ours().coefficients_ - peer(tol=1e-14, n_iter=200).coef_).max()
    if not is_tied:
        # With ties the two take different baselines: Efron's, and Breslow's.
        np.testing.assert_allclose(our_survival(), peer_survival(), rtol=0, atol=1e-6)
    return {
        "is_tied": is_tied,
        "fit": {"ours_s": ours_s, "scikit_survival_s": peer_s, "ratio": peer_s / ours_s},
        "fit_and_survival": {
            "ours_s": our_survival_s,
            "scikit_survival_s": peer_survival_s,
            "ratio": peer_survival_s / our_survival_s,
        },
        "largest_difference_of_coefficients": float(difference),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/cox.json"))
    out = parser.parse_args().out
    results = [compare(is_tied) for is_tied in (False, True)]
    report = {
        "num_trajectories": NUM_TRAJECTORIES,
        "num_covariates": NUM_COVARIATES,
        "runs": NUM_RUNS,
        "results": results,
    }
    rows = [
        Row(
            f"Cox, {NUM_TRAJECTORIES:,} trajectories, {'ties' if each['is_tied'] else 'no ties'}: "
            f"{task.replace('_', ' ')}",
            each[task]["ours_s"],
            "s",
            "scikit-survival",
            each[task]["scikit_survival_s"],
        )
        for each in results
        for task in ("fit", "fit_and_survival")
    ]
    write(out, report, rows)
    for result in results:
        print("tied ends:" if result["is_tied"] else "untied ends:")
        for task in ("fit", "fit_and_survival"):
            timed = result[task]
            print(
                f"  {task.replace('_', ' ')}: ours {1e3 * timed['ours_s']:.0f} ms, scikit-survival "
                f"{1e3 * timed['scikit_survival_s']:.0f} ms: {timed['ratio']:.1f} times as fast"
            )
        print(f"  largest difference of coefficients: {result['largest_difference_of_coefficients']:.1e}")


if __name__ == "__main__":
    main()
