"""The positivity report in words: the verdict first, then what it rests on."""

from halfseen.censoring.diagnostics import FEWEST_EFFECTIVE
from halfseen.censoring.positivity import PositivityReport, Truncation, WeightedPath


def text(report: PositivityReport) -> str:
    """Write a few plain sentences and a table of truncations."""
    sentences = [verdict(report), remedy(report)]
    if report.num_finished:
        sentences += [_worth(report), _heaviest(report.heaviest)]
    sentences += [_until(report), _mean_weight(report)]
    return "\n".join([sentence for sentence in sentences if sentence] + _table(report))


def verdict(report: PositivityReport) -> str:
    """Say in one sentence whether the weights can be trusted."""
    worth, tail = report.overall.effective_sample_size, report.tail
    if report.num_finished == 0:
        every = "the only path was" if report.num_paths == 1 else f"all {report.num_paths} paths were"
        return f"Nothing to weigh: {every} cut."
    if has_gap(report):
        first = min(report.unidentified, key=lambda path: path.time_s)
        return (
            f"Not identified: {_number(len(report.unidentified), 'path')} finished where no path is left uncut "
            f"(Ĝ = 0), first path {first.path} at {first.time_s:.4g} s."
        )
    finishes = "1 finish is" if report.num_finished == 1 else f"{report.num_finished} finishes are"
    if worth < FEWEST_EFFECTIVE:
        return f"Too little: {finishes} worth {worth:.1f} equally weighted ones."
    if report.is_thin:
        return (
            f"Thin at the end: {finishes} worth {worth:.1f} equally weighted ones, but the last "
            f"{tail.num_seen}, from {report.tail_from_s:.4g} s on, only {tail.effective_sample_size:.1f}."
        )
    if report.is_off:
        return (
            f"Incomplete: {finishes} worth {worth:.1f} equally weighted ones, but stand for {report.mean_weight:.0%} "
            "of the paths, not for all."
        )
    return f"Sound: {finishes} worth {worth:.1f} equally weighted ones."


def remedy(report: PositivityReport) -> str:
    """Say what to do about it; empty where nothing needs to be done."""
    if report.num_finished == 0:
        return "Record until some paths finish, or shorten the horizon so that reaching it counts as finished."
    if has_gap(report):
        return (
            f"Shorten the horizon so that it ends before {report.identified_until_s:.4g} s, fit the model to paths "
            "that were watched longer, or truncate the weights knowingly with truncate_at=…."
        )
    worth = report.overall.effective_sample_size
    if worth >= FEWEST_EFFECTIVE and not report.is_thin:
        return _completion(report) if report.is_off else ""
    if worth > 0.9 * report.num_finished:
        return "Record more paths; the weights are not what makes them few."
    return (
        f"Record more paths, shorten the horizon to before {report.tail_from_s:.4g} s, or truncate the weights "
        "knowingly with truncate_at=…; the table shows what that changes."
    )


def _completion(report: PositivityReport) -> str:
    if report.mean_weight > 1.0:
        return "The model takes cuts for likelier than they were; try another."
    return (
        f"Either the rest finish after {report.identified_until_s:.4g} s: restrict times to an earlier one (a path "
        "that outlives it then counts as seen). Or the model takes cuts for rarer than they were: try another."
    )


def has_gap(report: PositivityReport) -> bool:
    """Tell whether some finish is left without a weight."""
    return bool(report.unidentified) and report.truncate_at is None


def _worth(report: PositivityReport) -> str:
    overall, tail = report.overall, report.tail
    if has_gap(report):
        return f"The {overall.num_seen} that have a weight are worth {overall.effective_sample_size:.1f}."
    truncated = f"; {overall.share_truncated:.1%} of the weight is truncated" if report.truncate_at is not None else ""
    return (
        f"{report.num_finished} of {_number(report.num_paths, 'path')} finished; the last quarter of the finishes, "
        f"{tail.num_seen} from {report.tail_from_s:.4g} s on, is worth {tail.effective_sample_size:.1f}{truncated}."
    )


def _heaviest(heaviest: tuple[WeightedPath, ...]) -> str:
    named = ", ".join(f"{heavy.weight:.3g} (path {heavy.path}, {heavy.time_s:.4g} s)" for heavy in heaviest)
    return f"Largest weights: {named}." if heaviest else ""


def _until(report: PositivityReport) -> str:
    known = f"Nothing is known of finishes after {report.identified_until_s:.4g} s"
    if report.num_extrapolated:
        return f"{known}; {_number(report.num_extrapolated, 'path')} finished later, on the model's word alone."
    reason = "the last path was cut then" if report.ends_in_cut else "the last path finished then"
    return f"{known}." if report.unidentified else f"{known}: {reason}."


def _mean_weight(report: PositivityReport) -> str:
    if report.num_finished == 0 or has_gap(report):
        return ""
    missing = 1.0 - report.mean_weight
    if report.ends_in_cut and missing > 0.0005 and report.truncate_at is None and not has_gap(report):
        return f"The mean weight is {report.mean_weight:.3f}, so some {missing:.1%} of paths finish later than that."
    return f"The mean weight is {report.mean_weight:.3f}; it is near 1 where the model is right and all can be seen."


def _table(report: PositivityReport) -> list[str]:
    if not report.truncations:
        return []
    head = ("weights up to", f"mean {report.quantity}", "worth", "weight taken away")
    rows = [head, *(_cells(row) for row in report.truncations)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(head))]
    return ["", *("  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in rows)]


def _cells(row: Truncation) -> tuple[str, str, str, str]:
    bound = "no bound" if row.truncate_at is None else f"{row.truncate_at:.3g}"
    return (
        bound,
        f"{row.mean:.4g}",
        f"{row.effective_sample_size:.1f}",
        "no end" if row.share_removed is None else f"{row.share_removed:.1%}",
    )


def _number(count: int, one: str, many: str = "") -> str:
    return f"{count} {one if count == 1 else many or one + 's'}"
