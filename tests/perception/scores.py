"""How well a view agrees with the truth of a table."""

from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.stats import spearmanr

from halfseen.perception import View
from halfseen.scene import Truth

# An object is the cup whose pixels it shares by more than this (intersection over union).
SAME_OBJECT_IOU = 0.4


@dataclass
class Scores:
    num_cups: int = 0
    num_found: int = 0
    num_false: int = 0
    occlusion: list[float] = field(default_factory=list)
    true_occlusion: list[float] = field(default_factory=list)
    hides_error: list[float] = field(default_factory=list)
    centroid_error_m: list[float] = field(default_factory=list)
    is_pose_right: list[bool] = field(default_factory=list)

    def add(self, view: View, truth: Truth) -> None:
        pairs = matched(view, truth)
        self.num_cups += truth.num_cups
        self.num_found += len(pairs)
        self.num_false += len(view.objects) - len(pairs)
        for cup, seen in pairs:
            self.occlusion.append(view.objects[seen].occlusion)
            self.true_occlusion.append(float(truth.occlusion[cup]))
            error = view.objects[seen].centroid_m - truth.centroid_m[cup]
            self.centroid_error_m.append(float(np.linalg.norm(error)))
            self.is_pose_right.append(view.objects[seen].is_upright != bool(truth.is_fallen[cup]))
            self.hides_error += [
                abs(view.hides[seen, other] - truth.hides[cup, hider]) for hider, other in pairs if hider != cup
            ]

    @property
    def mean_error(self) -> float:
        return float(np.mean(np.abs(np.subtract(self.occlusion, self.true_occlusion))))

    @property
    def rank_correlation(self) -> float:
        return float(spearmanr(self.occlusion, self.true_occlusion).statistic)

    def __str__(self) -> str:
        return (
            f"{self.num_found} of {self.num_cups} cups found, {self.num_false} false objects; occlusion: mean error "
            f"{self.mean_error:.4f}, Spearman {self.rank_correlation:.3f}; hides: mean error "
            f"{np.mean(self.hides_error):.4f}; centroid: mean error {1000 * np.mean(self.centroid_error_m):.1f} mm; "
            f"upright or fallen right: {np.mean(self.is_pose_right):.3f}"
        )


def matched(view: View, truth: Truth) -> list[tuple[int, int]]:
    # A pixel without return, in shadow for instance, cannot be claimed by anyone.
    labels = np.where(view.image.is_return, truth.labels, -1).ravel()
    overlap = np.zeros((truth.num_cups, len(view.objects)))
    for seen in view.objects:
        hits = labels[seen.pixels]
        shared = np.bincount(hits[hits >= 0], minlength=truth.num_cups)
        whole = np.bincount(labels[labels >= 0], minlength=truth.num_cups) + len(seen.pixels) - shared
        overlap[:, seen.id] = shared / whole
    cups, seen = linear_sum_assignment(-overlap)
    return [(int(i), int(j)) for i, j in zip(cups, seen, strict=True) if overlap[i, j] > SAME_OBJECT_IOU]
