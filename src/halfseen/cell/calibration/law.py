"""The laws of a cell, estimated from its attempts, a world under them, and their folder; loading one runs no code.

::

    FOLDER/
      law.json          counts of attempts and their conditions; names and units of the numbers
      law.safetensors   the numbers
      law.sha256        digests of both
      attempts/         the log of the fit, if it is kept; and with it
      held.svg, .png    share of attempts that held, and the law's predictions
      labels.svg, .png  labels by the share in view
      attempts-visible-only/  attempts with grasps planned from visible points alone, if there are any
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.resources import files
from math import exp
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import safetensors.numpy
from safetensors import SafetensorError

from halfseen.arrays import Rows
from halfseen.cell.calibration.attempts import FACTS, glances, trials
from halfseen.cell.calibration.fits import (
    CENTRES,
    NAMES,
    SCALES,
    GraspFit,
    TimeFit,
    fit_grasping,
    fit_seeing,
    fit_times,
)
from halfseen.cell.facts import Facts, facts_of
from halfseen.errors import PolicyError
from halfseen.logs import Logs
from halfseen.perception.view import View
from halfseen.policies.folder.files import FolderKind, read_files, write_files
from halfseen.policies.folder.record import plain
from halfseen.reading import json_of
from halfseen.world.config import WorldConfig
from halfseen.world.grasping import FittedGrasping
from halfseen.world.scene import Scene
from halfseen.world.seeing import PersistentSeeing

_NUM_GRIPS, _DIGITS = 100, 6
_CURVES = ("sensitivity", "false_alarms")


@dataclass(frozen=True, eq=False)
class Law:
    """The laws of grasping and seeing, fitted to attempts and looks of a cell.

    Parameters
    ----------
    grasp
        Model of P(held) given an object's appearance.
    time
        Model of the durations of attempts.
    seeing
        Model of the labels from looks.
    limit_s
        Longest duration of an attempt in that cell [s].
    grips
        Quantiles, in increasing order, of the grips of the objects in first looks: log-odds of holding, relative to a
        standing cup of typical width with typical room.
    """

    grasp: GraspFit
    time: TimeFit
    seeing: PersistentSeeing
    limit_s: float
    grips: Rows

    @property
    def coefficients(self) -> dict[str, float]:
        """Coefficients of P(held), by name."""
        return dict(zip(NAMES, self.grasp.estimate.tolist(), strict=True))

    @property
    def grasping(self) -> FittedGrasping:
        """The law of grasping of a world."""
        estimates = self.coefficients
        return FittedGrasping(
            log_odds=estimates["log_odds"],
            log_odds_per_occlusion=estimates["occlusion"],
            offset_std=exp(estimates["log_offset_std"]),
            log_held_s=self.time.log_held_s,
            log_missed_s=self.time.log_missed_s,
            log_std=self.time.log_std,
            limit_s=self.limit_s,
        )

    def config(self, base: WorldConfig | None = None) -> WorldConfig:
        """Configuration of a world under this law.

        Parameters
        ----------
        base
            Rewards, prior and horizon of the world; None for those of the default world.
        """
        world = WorldConfig() if base is None else base
        return replace(world, grasping=self.grasping, seeing=self.seeing, transport_s=self.time.rest_s)

    def grip(self, facts: Facts) -> float:
        """Log-odds of holding an object, relative to a standing cup of typical width with typical room."""
        return float(_grips(self.grasp, pd.DataFrame([asdict(facts)]))[0])

    def scene(self, view: View) -> Scene:
        """Scene of a table for a world, with grips."""
        return self.gripped(view.scene(), facts_of(view))

    def gripped(self, scene: Scene, facts: Sequence[Facts]) -> Scene:
        """Add the grips of the objects to a scene, from their facts."""
        return replace(scene, grip=np.array([self.grip(each) for each in facts]))


def fit_law(logs: Logs, horizon: int, limit_s: float) -> Law:
    """Estimate the laws of a cell from its log.

    Parameters
    ----------
    logs
        Attempts of a cell, with the true state of each object.
    limit_s
        Longest duration of an attempt [s].
    """
    tried: pd.DataFrame = trials(logs, horizon)
    assert logs.objects is not None, "trials are read from logs with objects"
    grasp, time, seeing = fit_grasping(tried), fit_times(tried), fit_seeing(glances(logs))
    grasp = replace(
        grasp,
        estimate=_rounded(grasp.estimate),
        covariance=_rounded(grasp.covariance),
        effective_sample_size=round(grasp.effective_sample_size, _DIGITS),
    )
    seeing = replace(seeing, **{name: tuple(_rounded(getattr(seeing, name)).tolist()) for name in _CURVES})
    at_first = _grips(grasp, pd.DataFrame(logs.objects[logs.objects["stage"] == 1]))
    grips = np.quantile(at_first, (np.arange(_NUM_GRIPS) + 0.5) / _NUM_GRIPS)
    return Law(grasp, TimeFit(*_rounded(time).tolist()), seeing, limit_s, _rounded(grips))


def _grips(grasp: GraspFit, facts: pd.DataFrame) -> Rows:
    estimates = dict(zip(NAMES, grasp.estimate.tolist(), strict=True))
    offsets = [
        estimates[name] * (facts[name].to_numpy(dtype=np.float64) - CENTRES[name]) / SCALES[name] for name in FACTS
    ]
    return np.sum(offsets, axis=0)


def _rounded(values: np.ndarray | Sequence[float]) -> np.ndarray:
    """Round far below the standard errors, so that a law is identical on all machines."""
    return np.round(np.asarray(values, dtype=np.float64), _DIGITS)


def shipped_law() -> Path:
    """Folder of the shipped law, for `read_law`.

    It was made by ``halfseen cell calibrate --attempts 6000``; ``--from`` with its attempts reproduces it.
    """
    return Path(str(files("halfseen.cell.calibration"))) / "shipped_law"


ATTEMPTS, VISIBLE_ONLY = "attempts", "attempts-visible-only"
LAW = FolderKind("law", "halfseen cell calibrate")
VERSION = 1
_AGAIN = f"make it again by `{LAW.maker}`"


@dataclass(frozen=True, eq=False)
class StoredLaw:
    """A law read from a folder, and the content of its law.json."""

    law: Law
    record: Mapping[str, Any]


def write_law(
    law: Law,
    folder: Path,
    more: Mapping[str, Any],
    *,
    logs: Logs | None = None,
    contrast: Logs | None = None,
    overwrite: bool = False,
) -> None:
    """Write a law atomically.

    Parameters
    ----------
    more
        Further entries of the record: conditions, versions, how the law was made.
    logs
        Log of the fit, to keep and to draw; None for neither.
    contrast
        Attempts with grasps planned from visible points alone, to keep with the law; None if there are none.

    Raises
    ------
    ArgumentError
        The folder exists or cannot be written.
    """
    counts = {"num_decided": law.grasp.num_decided, "num_cut": law.grasp.num_cut}
    record = {"version": VERSION, "parameters": list(NAMES), **counts, **plain(dict(more))}
    text = json.dumps(record, indent=1, allow_nan=False) + "\n"
    arrays = {
        "estimate": law.grasp.estimate,
        "covariance": np.ascontiguousarray(law.grasp.covariance),
        "effective_sample_size": np.array([law.grasp.effective_sample_size]),
        "time": np.array(law.time, dtype=np.float64),
        "limit_s": np.array([law.limit_s]),
        "grips": law.grips,
        "facing": np.array([law.seeing.facing], dtype=np.float64),
        **{name: np.array(getattr(law.seeing, name), dtype=np.float64) for name in ("views", *_CURVES)},
    }
    numbers = safetensors.numpy.save(arrays)
    beside: dict[str, Callable[[Path], None]] = {}
    if logs is not None:
        from halfseen.cell.calibration.figures import pictures_of

        beside = {ATTEMPTS: logs.write, **pictures_of(law.grasp.estimate, law.seeing, logs)}
    if contrast is not None:
        beside[VISIBLE_ONLY] = contrast.write
    write_files(folder, text.encode(), numbers, overwrite=overwrite, kind=LAW, beside=beside)


def read_law(folder: str | Path) -> StoredLaw:
    """Read and check a law; no code from the folder is run.

    Raises
    ------
    PolicyError
        A file is missing, a byte has changed, the version is unknown, or the numbers do not make a law.
    """
    text, numbers = read_files(Path(folder), LAW)
    record = _record(text, Path(folder) / LAW.record)
    try:
        law = _law(safetensors.numpy.load(numbers), record)
    except (KeyError, ValueError, TypeError, SafetensorError) as error:
        raise PolicyError(
            f"{Path(folder) / LAW.arrays}: does not hold the numbers of a law ({error}); {_AGAIN}"
        ) from error
    return StoredLaw(law, record)


def _record(text: bytes, file: Path) -> Mapping[str, Any]:
    try:
        record = json_of(text)
    except ValueError as error:
        raise PolicyError(f"{file}: cannot be read ({error}); {_AGAIN}") from error
    if not isinstance(record, dict) or record.get("version") != VERSION:
        version = record.get("version") if isinstance(record, dict) else record
        raise PolicyError(
            f"{file}: version {version!r} is not {VERSION}, the version that this halfseen reads; {_AGAIN}"
        )
    if record.get("parameters") != list(NAMES):
        raise PolicyError(
            f"{file}: the parameters of the law are {record.get('parameters')}, not {list(NAMES)}: it describes "
            f"other objects; {_AGAIN}"
        )
    for name in ("num_decided", "num_cut"):
        if not isinstance(record.get(name), int):
            raise PolicyError(f"{file}: {name} is {record.get(name)!r}, not a count of attempts; {_AGAIN}")
    return record


def _law(arrays: Mapping[str, np.ndarray], record: Mapping[str, Any]) -> Law:
    if arrays["estimate"].shape != (len(NAMES),):
        raise ValueError(f"the estimate has shape {arrays['estimate'].shape} and not {(len(NAMES),)}")
    if not all(np.isfinite(array).all() for array in arrays.values()):
        raise ValueError("a number is not finite")
    (size,), (limit_s,), (facing,) = (arrays[name].tolist() for name in ("effective_sample_size", "limit_s", "facing"))
    if limit_s <= 0:
        raise ValueError(f"limit_s is {limit_s}; it must be above 0")
    fit = GraspFit(arrays["estimate"], arrays["covariance"], record["num_decided"], record["num_cut"], size)
    seeing = PersistentSeeing(facing, *(tuple(arrays[name].tolist()) for name in ("views", *_CURVES)))
    return Law(fit, TimeFit(*arrays["time"].tolist()), seeing, limit_s, arrays["grips"])
