"""The figures: one for settings that differ in the share of cuts, one for dependent cuts, one for ten covariates."""

from matplotlib.figure import Figure

from cut_regression.comparison import Comparison
from cut_regression.figures import PANEL_TITLE, draw_curves, draw_errors, panels
from cut_regression.settings import CutName, MedianName, Setting
from cut_regression.words import headline

MEDIANS: tuple[MedianName, ...] = ("linear", "quadratic")
CUT_NAMES: dict[CutName, str] = {"uniform": "uniform cuts", "dependent": "cuts sooner where z1 is large"}


def sizes_figure(comparison: Comparison) -> Figure:
    """Curves beside errors for each size of the sample; a row of panels for each setting."""
    settings = comparison.settings
    heaviest, size = settings[-1], comparison.sizes[-1]
    title = f"{heaviest.median.capitalize()} median, {_cut(heaviest)}, {size} rows: {headline(comparison, heaviest)}"
    figure, axes = panels(title, _about(comparison), len(settings), 2, True)
    for (left, right), setting in zip(axes, settings, strict=True):
        draw_curves(left, comparison, setting, ("kaplan-meier", "uncut", "cox-times"))
        left.set_title(f"{_cut(setting)}: {_curves(comparison)}", **PANEL_TITLE)
        draw_errors(right, comparison, [(f"{size} rows", setting, size) for size in comparison.sizes])
        right.set_title(f"{_cut(setting)}: error", **PANEL_TITLE)
    return figure


def dependent_figure(comparison: Comparison) -> Figure:
    """Curves under the heavier cuts above errors for each share of cuts; a column for each median."""
    size = comparison.sizes[-1]
    of_median = {median: [s for s in comparison.settings if s.median == median] for median in MEDIANS}
    heaviest = of_median["linear"][-1]
    found = headline(comparison, heaviest, ("kaplan-meier", "cox"))
    title = f"Cuts come sooner where z1 is large. Linear median, {_cut(heaviest)}: {found}"
    figure, axes = panels(title, _about(comparison), 2, len(MEDIANS), True)
    for (upper, lower), median in zip(axes.T, MEDIANS, strict=True):
        settings = of_median[median]
        draw_curves(upper, comparison, settings[-1], ("kaplan-meier", "cox", "uncut", "cox-times"))
        upper.set_title(f"{median} median, {_cut(settings[-1])}: {_curves(comparison)}", **PANEL_TITLE)
        draw_errors(lower, comparison, [(_cut(s), s, size) for s in settings])
        lower.set_title(f"{median} median: error", **PANEL_TITLE)
    return figure


def ten_figure(comparison: Comparison) -> Figure:
    """Errors for each share of cuts; a column for each median, a row for each kind of cuts."""
    size = comparison.sizes[-1]
    heaviest = [s for s in comparison.settings if (s.median, s.cuts) == ("linear", "uniform")][-1]
    found = headline(comparison, heaviest)
    title = f"Ten covariates, one of which matters, {size} rows. Linear median, uniform cuts, {_cut(heaviest)}: {found}"
    figure, axes = panels(title, _about(comparison), len(CUT_NAMES), len(MEDIANS), False)
    for row, cuts in zip(axes, CUT_NAMES, strict=True):
        for panel, median in zip(row, MEDIANS, strict=True):
            settings = [s for s in comparison.settings if (s.median, s.cuts) == (median, cuts)]
            draw_errors(panel, comparison, [(_cut(s), s, size) for s in settings])
            panel.set_title(f"{median} median, {CUT_NAMES[cuts]}", **PANEL_TITLE)
    return figure


def _cut(setting: Setting) -> str:
    return f"{100 * setting.cut_share:.0f} % cut"


def _curves(comparison: Comparison) -> str:
    number, size = comparison.num_repetitions, comparison.sizes[-1]
    return f"fit to {size} rows" if number == 1 else f"mean of {number} fits to {size} rows"


def _about(comparison: Comparison) -> str:
    number = comparison.num_repetitions
    dots = "the dot is one sample" if number == 1 else f"a dot for each of {number} samples, a bar at their mean"
    rows = f" ({comparison.sizes[-1]} rows each)" if len(comparison.sizes) == 1 else ""
    return f"Error: mean of |estimate − true median| over z, {dots}{rows}. Dashed: error of the best constant."
