"""What an action is worth along each covariate."""

from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from halfseen.pages.axes import NARROW_INCHES
from halfseen.report.policy_findings import QCurve
from halfseen.report.units import labelled

LEGEND_COLUMNS = 5


def draw_curves(curves: list[QCurve], colours: dict[str, str], unit: str | None = None) -> Figure:
    """Draw Q along each covariate, others at their medians, with a band where there is one."""
    stages = sorted({curve.stage for curve in curves})
    names = list(dict.fromkeys(curve.covariate for curve in curves))
    valued = {name for curve in curves for name in curve.q}
    actions = [name for name in colours if name in valued]
    legend = 0.24 * -(-len(actions) // LEGEND_COLUMNS)
    height = 2.1 * len(stages) + 0.61 + legend
    figure = Figure(figsize=(NARROW_INCHES, height))
    panels = figure.subplots(len(stages), len(names), sharex="col", sharey="row", squeeze=False)
    figure.subplots_adjust(
        left=0.1, right=0.985, top=1 - (legend + 0.18) / height, bottom=0.52 / height, hspace=0.18, wspace=0.1
    )
    for curve in curves:
        axes = panels[stages.index(curve.stage), names.index(curve.covariate)]
        for action, q in curve.q.items():
            if action not in actions:
                continue
            axes.plot(curve.values, q, color=colours[action], lw=1.6)
            if curve.low is not None and curve.high is not None:
                low, high = curve.low[action], curve.high[action]
                axes.fill_between(curve.values, low, high, color=colours[action], alpha=0.14, lw=0)
        axes.xaxis.set_major_locator(MaxNLocator(4))
    for row, stage in zip(panels, stages, strict=True):
        row[0].set_ylabel(f"stage {stage}: {labelled('Q', unit or 'reward')}")
    for axes, name in zip(panels[-1], names, strict=True):
        axes.set_xlabel(name)
    handles = [panels[0, 0].plot([], [], color=colours[action], label=action)[0] for action in actions]
    figure.legend(handles, actions, loc="upper left", ncols=LEGEND_COLUMNS, frameon=False, fontsize=9.5)
    return figure
