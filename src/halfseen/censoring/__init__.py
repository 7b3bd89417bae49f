"""How long a path was likely to be watched: Ĝ, and the weights that it gives.

Read down: `inputs` (what every fit accepts) → `model` (what a censoring model is) → `kaplan_meier` → `weights` →
`diagnostics`.
"""

from halfseen.censoring.diagnostics import WeightDiagnostics, weight_diagnostics
from halfseen.censoring.kaplan_meier import KaplanMeier
from halfseen.censoring.model import CensoringModel
from halfseen.censoring.weights import censoring_weights, stage_weights

__all__ = [
    "CensoringModel",
    "KaplanMeier",
    "WeightDiagnostics",
    "censoring_weights",
    "stage_weights",
    "weight_diagnostics",
]
