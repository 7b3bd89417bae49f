"""Censoring models Ĝ(u⁻ | z) = P(C ≥ u | z), and inverse-probability-of-censoring weights from them.

A *trajectory* is one episode. A *cut* right-censors it at the time C, by something outside the task. The model is of C,
so the roles are swapped compared with survival analysis of failures: a cut is the event, and the trajectory's own end
censors it.

The modules, in order: `inputs` (validation), `clocks` (start and end of stages, and equal times) → the models
`kaplan_meier`, `cox`, `kernel_kaplan_meier` → `model` (the protocol, and models by name) → `weights` → `cut_model` (Ĝ
by trajectory or by stage, on the matching clock). The report: `positivity_facts` (in words) → `positivity` (as a
figure).
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.censoring.clocks import StageClocks
    from halfseen.censoring.cox import Cox
    from halfseen.censoring.cut_model import CensoringBy, CensoringSpec, CutModel
    from halfseen.censoring.kaplan_meier import KaplanMeier
    from halfseen.censoring.kernel_kaplan_meier import KernelKaplanMeier
    from halfseen.censoring.model import CENSORING_NAMES, CensoringModel, is_fitted, named_model, uses_covariates
    from halfseen.censoring.positivity import PositivityReport, positivity_report
    from halfseen.censoring.positivity_facts import PositivityFacts
    from halfseen.censoring.weights import (
        WeightDiagnostics,
        censoring_weights,
        stage_weights,
        warn_if_few,
        weight_diagnostics,
    )

__all__ = [
    "CENSORING_NAMES",
    "CensoringBy",
    "CensoringModel",
    "CensoringSpec",
    "Cox",
    "CutModel",
    "KaplanMeier",
    "KernelKaplanMeier",
    "PositivityFacts",
    "PositivityReport",
    "StageClocks",
    "WeightDiagnostics",
    "censoring_weights",
    "is_fitted",
    "named_model",
    "positivity_report",
    "stage_weights",
    "uses_covariates",
    "warn_if_few",
    "weight_diagnostics",
]

__getattr__ = lazy_names(
    __name__,
    {
        "CENSORING_NAMES": "model",
        "CensoringBy": "cut_model",
        "CensoringModel": "model",
        "CensoringSpec": "cut_model",
        "Cox": "cox",
        "CutModel": "cut_model",
        "KaplanMeier": "kaplan_meier",
        "KernelKaplanMeier": "kernel_kaplan_meier",
        "PositivityFacts": "positivity_facts",
        "PositivityReport": "positivity",
        "StageClocks": "clocks",
        "WeightDiagnostics": "weights",
        "censoring_weights": "weights",
        "is_fitted": "model",
        "named_model": "model",
        "positivity_report": "positivity",
        "stage_weights": "weights",
        "uses_covariates": "model",
        "warn_if_few": "weights",
        "weight_diagnostics": "weights",
    },
)
