"""The report: one self-contained page that opens with the answer, without scripts or external resources."""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from halfseen.cell.calibration.law import shipped_law
from halfseen.errors import ArgumentError
from halfseen.figures import HUES, inline_svg
from halfseen.study.experiment import Drawing, Experiment, Section, Tables
from halfseen.study.policies import STRONGEST_RULE
from halfseen.study.setting import CUT_KIND_NAMES, Setting, law_sentence
from halfseen.view.templates import rendered
from halfseen.wording import INCONCLUSIVE, NOT_SUPPORTED, SUPPORTED, as_sentence, percent, share
from halfseen.world.scene import Scene

# Smaller proportions are within the error of perception.
SMALLEST_HIDDEN_SHARE = 0.02


@dataclass(frozen=True)
class StudyResults:
    """The findings of a study; all files are made from this alone.

    Parameters
    ----------
    setting
        The shared setting.
    experiments
        The experiments that were run.
    tables
        The tables of each experiment, by its name.
    sections
        The section of each experiment, by its name.
    versions
        Versions of the packages that the numbers depend on.
    """

    setting: Setting
    experiments: tuple[Experiment, ...]
    tables: tuple[Tables, ...]
    sections: Mapping[str, Section]
    versions: Mapping[str, str]

    @property
    def answer(self) -> list[str]:
        """The leading sentences of all sections, and the source of the laws."""
        leading = (section.sentences[: section.num_leading] for section in self.sections.values())
        return [*(sentence for sentences in leading for sentence in sentences), law_sentence(self.setting)]


def report_of(results: StudyResults, pictures: Mapping[str, bytes]) -> str:
    """Write the page; `pictures` are PNG of scenes by name, and a scene without one is described in words only."""
    setting, experiments = results.setting, results.experiments
    names = [scene.name for scene in setting.scenes]
    if unknown := [name for name in pictures if name not in names]:
        there = f"the scenes are {', '.join(names)}: name it after its scene"
        raise ArgumentError(f"no scene is named {unknown[0]!r} for its picture; {there}")
    content = {
        "setting": setting,
        "opening": next((each.opening for each in results.sections.values() if each.opening is not None), None),
        "answer": results.answer,
        "sections": results.sections,
        "scenes": [_scene(scene, pictures.get(scene.name)) for scene in setting.scenes],
        "smallest_hidden": SMALLEST_HIDDEN_SHARE,
        "hues": HUES,
        "logging_rule": STRONGEST_RULE.label,
        "parameters": {"The world": parameters(setting.world)}
        | {f"Experiment “{each.name}”": parameters(each) for each in experiments},
        "command": _command(setting, experiments),
        "versions": dict(sorted(results.versions.items())),
        "verdicts": (SUPPORTED, NOT_SUPPORTED, INCONCLUSIVE),
    }
    functions: dict[str, Any] = {"inline": inline, "percent": percent, "as_sentence": as_sentence}
    return rendered("halfseen.study", "report.html.j2", content, **functions)


def inline(drawing: Drawing) -> Markup:
    """A figure in the form for the page, where its title is beside it."""
    return inline_svg(partial(drawing.draw, ""), f"f-{drawing.name}", drawing.title)


def parameters(config: Any, before: str = "") -> list[tuple[str, str]]:
    """Name and value of all fields of a dataclass, and of the dataclasses in it."""
    found = []
    for field in fields(config) if is_dataclass(config) else ():
        value, name = getattr(config, field.name), f"{before}{field.name}"
        found += parameters(value, f"{name}.") if is_dataclass(value) else [(name, written(field.name, value))]
    return found


def written(name: str, value: Any) -> str:
    """Write the value of a parameter."""
    if isinstance(value, (tuple, list)):
        parts = [(written(name, each), isinstance(each, tuple)) for each in value]
        return ", ".join(f"({part})" if is_tuple else part for part, is_tuple in parts)
    if value is None or isinstance(value, str):
        return CUT_KIND_NAMES.get(value, value) if value else "as many as asked for"
    if "cut_share" in name:
        return share(float(value))
    return f"{value:g}".replace("-", "−")


def _command(setting: Setting, experiments: Sequence[Experiment]) -> str:
    """Write the command that makes the page again."""
    from halfseen.study.experiments import EXPERIMENTS

    only = "" if len(experiments) == len(EXPERIMENTS) else "".join(f" --only {each.name}" for each in experiments)
    law = "assumed" if setting.law is None else setting.law.name
    law = "" if setting.law == shipped_law() else f" --law {law}"
    return f"halfseen study --repetitions {setting.repetitions} --seed {setting.seed}{law}{only}"


def _scene(scene: Scene, picture: bytes | None) -> dict[str, Any]:
    """A scene in words, with who hides how much of each object that is hidden, the most hidden first."""
    occlusion, hides = scene.occlusion, np.where(scene.hides >= SMALLEST_HIDDEN_SHARE, scene.hides, 0.0)
    order = [int(i) for i in np.argsort(-occlusion, kind="stable") if hides[i].any()]
    hidden = [
        {
            "object": i,
            "occlusion": float(occlusion[i]),
            "by": [(int(j), float(hides[i, j])) for j in np.argsort(-hides[i], kind="stable") if hides[i, j]],
        }
        for i in order
    ]
    return {
        "name": Path(scene.name).stem.replace("_", " "),
        "picture": None if picture is None else base64.b64encode(picture).decode(),
        "num_objects": scene.num_objects,
        "mean": float(np.mean(occlusion)) if len(occlusion) else 0.0,
        "hidden": hidden,
    }
