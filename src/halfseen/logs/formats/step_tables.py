"""Step tables like those of RLDS, as Parquet, CSV or Arrow: one row per step, its fields as columns.

A row has ``observation`` (or columns with this prefix: structs are flattened), ``action``, ``reward``, ``is_first``,
``is_last`` and ``is_terminal``. A column ``episode_id``, ``episode_index`` or ``episode`` identifies episodes; without
one, they begin where ``is_first`` is true. A row with ``is_last`` comes after the last action: its action and reward
have no meaning and are not read. An episode whose last row is not ``is_last`` broke off.
"""

import csv
import mmap
import re
import struct
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as arrow_csv

from halfseen.errors import LogError, warn
from halfseen.logs.columns import first_true, refuse_repeated, shown
from halfseen.logs.formats.as_text import from_list_texts
from halfseen.logs.formats.csv_folder import read_cells, refuse_semicolons, refuse_text_among_numbers
from halfseen.logs.formats.nested_steps import LAST, unnested
from halfseen.logs.formats.partitions import partition_of
from halfseen.logs.formats.quotes import check_quotes
from halfseen.logs.formats.step_clocks import ends_by_observations, even_ends
from halfseen.logs.formats.steps import StepColumns, StepRules, StepTable, begins_of, refuse_early, require
from halfseen.logs.logs import Logs
from halfseen.logs.missing import Missing
from halfseen.logs.parquet import parquet_file
from halfseen.reading import MOST_LEVELS, TABLE, check_file, check_unpacked, opened, opened_text, reason_of, refused
from halfseen.shapes import Bool, Float, Int, Shaped

SEEN = "observation"
EPISODES = ("episode_id", "episode_index", "episode")
FIRST, TERMINAL, DISCOUNT = "is_first", "is_terminal", "discount"
TABLE_FILES = (".parquet", ".csv", ".arrow", ".feather")
_COMPRESSED = re.compile(rb"\x28\xb5\x2f\xfd|\x04\x22\x4d\x18", re.DOTALL)
"""First bytes of an Arrow buffer compressed by zstd or lz4; the eight bytes before are its uncompressed size."""


def read_steps(
    files: str | Path | Sequence[str | Path], rules: StepRules | None = None, *, missing: Missing = None
) -> Logs:
    """Read a step table.

    Parameters
    ----------
    files
        A ``.parquet``, ``.csv``, ``.arrow`` or ``.feather`` file, or several in order.
    rules
        Columns of the action (default: ``action``), the reward (``reward``), whether the episode reached its own end
        (``is_terminal``) and the time of each row (default: every step counts as 1 s, with a warning); and the ending
        of an episode that did not reach its own.
    missing
        What replaces null in covariates, as in `Logs`.

    Returns
    -------
    Logs
        One trajectory per episode, one stage per step. A cut falls into the stage of the last row.

    Raises
    ------
    ArgumentError
        A column is missing, or the actions are not finitely many.
    LogError
        A file is missing or broken, the flags contradict one another, or the log breaks an invariant.
    """
    paths = [Path(files)] if isinstance(files, str | Path) else [Path(file) for file in files]
    place = ", ".join(map(str, paths[:3])) + (f" and {len(paths) - 3} more" if len(paths) > 3 else "")
    rules = rules or StepRules()
    named = {"action": "action", "reward": "reward", "done": TERMINAL} | rules.named
    table = _flattened(place, read_tables(paths, names=(named["action"], *EPISODES)))
    require(place, table.column_names, {"end of an episode": LAST}, "add it")
    require(place, table.column_names, named)
    label = next((name for name in EPISODES if name in table.column_names), None)
    if label is None:
        require(place, table.column_names, {"beginning of an episode": FIRST}, f"add it, or {EPISODES[0]}")
    seen = [name for name in table.column_names if name.startswith(SEEN)]
    others = {FIRST, DISCOUNT, *StepColumns.counters} & {*table.column_names}
    read = {*named.values(), LAST, label, *seen, *others} - {None}
    steps = StepColumns(place, {name: as_array(place, table, name) for name in read})
    is_last, is_terminal = steps.flags(LAST), steps.flags(named["done"])
    names, begins = _episodes(steps, label)
    steps.refuse_disorder(begins)
    last = begins[1:] - 1
    is_step = np.ones(len(is_last), dtype=bool)
    is_step[last] = ~is_last[last]
    rewards, remedy = steps.numbers(named["reward"], "reward"), _remedy_of_acting_ends(named["done"])
    _refuse_without_step(place, names, begins, is_step, remedy)
    _warn_of_unread(place, table, {*named.values()}, rewards[~is_step], remedy)
    _refuse_zero_discount(steps, names, last, is_step, named["done"])
    observed, actions = steps.observed(seen), steps.actions(named["action"], is_step)
    if rules.clock is None:
        ends_s = even_ends(np.append(0, np.cumsum(is_step))[begins], rules.step_in(place))
    else:
        ends_s = ends_by_observations(steps.numbers(rules.clock), begins)[is_step]
    refuse_early(place, names, begins, is_last | is_terminal)
    if (wrong := first_true(is_terminal[last] & ~is_last[last])) is not None:
        trouble = f"its last row terminates it and is not {LAST}; fix one of the two"
        raise LogError(f"{place}, episode {shown(names[wrong])}: {trouble}")
    found = observed, actions, rewards[is_step], ends_s, rules.endings(is_terminal[last], is_last[last])
    return StepTable(names, begins, is_step, *found).logs(place, missing)


def _episodes(steps: StepColumns, label: str | None) -> tuple[list[int | str], Int[np.ndarray, " E1"]]:
    """Names of the episodes; their first rows, followed by the number of rows."""
    place, is_first = steps.place, steps.flags(FIRST) if FIRST in steps.columns else np.zeros(0, dtype=bool)
    if label is None:
        if len(is_first) and not is_first[0]:
            raise LogError(f"{place}, row 0: {FIRST} is false, so it belongs to no episode; fix it")
        at = np.flatnonzero(is_first)
        return list(range(len(at))), np.append(at, len(is_first))
    labels = steps.columns[label]
    if labels.ndim != 1 or labels.dtype.kind not in "iuO" or any(name is None for name in labels.tolist()):
        raise LogError(f"{place}: {label} holds {labels.dtype} or null, not names; give whole numbers or text")
    wrong = is_first != np.append(True, labels[1:] != labels[:-1]).astype(bool) if len(is_first) else is_first
    if (row := first_true(wrong)) is not None:
        raise LogError(
            f"{place}, row {row}: {FIRST} is {bool(is_first[row])}, yet {label} is {shown(labels[row])}; fix one of "
            "the two"
        )
    begins = begins_of(place, "rows", labels, "sort them, or give each a name of its own")
    return labels[begins[:-1]].tolist(), begins


def _remedy_of_acting_ends(done: str) -> str:
    """The remedy for a table that has its endings in the rows of actions."""
    ending = f'finished = {{field = "{done}"}} and cut = {{field = "{LAST}"}}'
    return (
        f"if the ending stands in the row of the last action, read the table by a mapping with {ending} in [ending], "
        "which halfseen convert TABLE --mapping-template makes"
    )


def _refuse_without_step(
    place: str, names: Sequence[int | str], begins: Int[np.ndarray, " E1"], is_step: Bool[np.ndarray, " N"], remedy: str
) -> None:
    """Refuse an episode whose only row has no action (`LogError`)."""
    is_without = (np.diff(begins) == 1) & ~is_step[begins[:-1]]
    if is_without.any():
        name, num_episodes = shown(names[int(np.argmax(is_without))]), int(is_without.sum())
        raise LogError(
            f"{place}, episode {name}: it has no step, as its only row is {LAST}, which holds no action; the same is "
            f"true of {num_episodes} of {len(names)} episodes; {remedy}"
        )


def _refuse_zero_discount(
    steps: StepColumns,
    names: Sequence[int | str],
    last: Int[np.ndarray, " E"],
    is_step: Bool[np.ndarray, " N"],
    done: str,
) -> None:
    """Refuse an episode that terminates by the discount of its last action, and by its flag does not (`LogError`)."""
    discount = steps.columns.get(DISCOUNT, np.ones(0))
    if discount.dtype.kind not in "iuf" or discount.shape != is_step.shape or not discount[is_step].any():
        return
    # In a last row without an action the discount is 0, however the episode ended.
    is_wrong = (discount[last - ~is_step[last]] == 0) & ~steps.flags(done)[last]
    if (wrong := first_true(is_wrong)) is not None:
        raise LogError(
            f"{steps.place}, episode {shown(names[wrong])}: {DISCOUNT} is 0 at its last action, as where an episode "
            f"terminates, yet its last row is not {done}; fix one of the two, or leave {DISCOUNT} out"
        )


def _warn_of_unread(
    place: str, table: pa.Table, read: set[str], last_rewards: Float[np.ndarray, " E"], remedy: str
) -> None:
    known = {*read, *EPISODES, *StepColumns.counters, FIRST, LAST, TERMINAL}
    left_out = [name for name in table.column_names if name not in known and not name.startswith(SEEN)]
    if left_out:
        warn(place, f"left out are {', '.join(left_out)}: they were not known before the action")
    num_lost = int(np.count_nonzero(np.nan_to_num(last_rewards)))
    if num_lost:
        warn(
            place,
            f"{num_lost} rewards other than 0 are in rows that are {LAST}, which hold no action: they are not read; "
            f"if each is of the action in the row before, move all up a row; {remedy}",
        )


def read_tables(files: Sequence[Path], columns: Iterable[str] | None = None, names: Collection[str] = ()) -> pa.Table:
    """Concatenate Parquet, CSV or Arrow files of one table.

    Parameters
    ----------
    files
        The files, in order.
    columns
        Columns to read from Parquet; None for all.
    names
        Columns of names: in CSV, numbers that begin with 0 are text there.

    Raises
    ------
    LogError
        A file is missing, broken, too large, or has other columns than the first; no file has a row; or a column has
        types of which none holds all values.
    """
    wanted = None if columns is None else list(columns)
    tables = [_read(file, wanted, names) for file in files]
    for file, table in zip(files, tables, strict=True):
        if differing := {*table.column_names} ^ {*tables[0].column_names}:
            raise LogError(
                f"{file}: its columns differ from those of {files[0]} ({', '.join(sorted(differing))}); give files of "
                "one table, or convert each separately"
            )
    if not any(table.num_rows for table in tables):
        raise LogError(f"{', '.join(map(str, files[:3]))}: there are no rows; give a table with at least one")
    try:
        ordered = [table.select(tables[0].column_names) for table in tables]
        return pa.concat_tables(ordered, promote_options="permissive")
    except pa.ArrowException as error:
        place = f"{files[0]} and {len(files) - 1} more"
        raise LogError(f"{place}: {reason_of(error)}; write each column with one type in all files") from error


def as_array(place: str, table: pa.Table, name: str) -> Shaped[np.ndarray, "N ..."]:
    """Convert a column to an array with one row per step; lists of equal length become further axes.

    Null is NaN among numbers and None among text.

    Raises
    ------
    LogError
        Lists differ in length, a list is null, or no array can hold the type of the column.
    """
    try:
        return _array(place, name, table[name].combine_chunks())
    except (pa.ArrowException, ValueError, NotImplementedError) as error:
        raise LogError(
            f"{place}: {name} holds {table.schema.field(name).type}, which is not read; convert it"
        ) from error


def whole_table(file: Path) -> Any:
    """Refuse a file that is not a complete table."""
    missing = "it is missing; copy the whole dataset again"
    return refused(file, "it is not a complete table", "fix it, or copy or export it again", missing)


def _read(file: Path, columns: list[str] | None, names: Collection[str]) -> pa.Table:
    with whole_table(file):
        kind = file.suffix.lower()
        if kind == ".parquet":
            table = unnested(file, parquet_file(file).read(columns))
        else:
            table = _csv(file, names) if kind == ".csv" else unnested(file, _arrow(file))
    missing = [name for name in columns or () if name not in table.column_names]
    if missing:
        raise LogError(
            f"{file}: there is no column {missing[0]!r} among {', '.join(table.column_names)}; copy it again"
        )
    refuse_repeated(file, table.column_names)
    for name, value in partition_of(file).items():
        if name not in table.column_names and (name in EPISODES or name.startswith(SEEN)) and columns is None:
            table = table.append_column(name, pa.array([value or None] * len(table), pa.string()))
    return table.replace_schema_metadata(None)


def _csv(file: Path, names: Collection[str]) -> pa.Table:
    with opened_text(file, TABLE) as lines:
        refuse_semicolons(file, next(csv.reader(lines), []))
        lines.seek(0)
        check_quotes(file, lines)
    with opened(file, TABLE) as bytes_in:
        convert = arrow_csv.ConvertOptions(null_values=[""], strings_can_be_null=True, quoted_strings_can_be_null=False)
        table = read_cells(bytes_in, convert)
    for name in table.column_names:
        if pa.types.is_integer(table.schema.field(name).type) and name in names:
            table = table.set_column(table.column_names.index(name), name, _names(file, name, table[name]))
        elif name.startswith(SEEN) and pa.types.is_string(table.schema.field(name).type):
            refuse_text_among_numbers(file, name, table[name])
    lists = {name: from_list_texts(table[name]) for name in table.column_names}
    return pa.table({name: table[name] if lists[name] is None else lists[name] for name in table.column_names})


def _names(file: Path, name: str, numbers: Any) -> Any:
    """A column of whole numbers, as text if one of them begins with 0, as in 007."""
    with opened(file, TABLE) as bytes_in:
        convert = arrow_csv.ConvertOptions(
            include_columns=[name], column_types={name: pa.string()}, null_values=[""], strings_can_be_null=True
        )
        texts = read_cells(bytes_in, convert)[name]
    return texts if any(re.match(r"-?0\d", text) for text in texts.drop_null().to_pylist()) else numbers


def _arrow(file: Path) -> pa.Table:
    num_bytes = check_file(file, TABLE)
    with file.open("rb") as held, mmap.mmap(held.fileno(), 0, access=mmap.ACCESS_READ) as content:
        # Declared uncompressed sizes of compressed buffers [B].
        found = [match.start() for match in _COMPRESSED.finditer(content) if match.start() >= 8]
        sizes = [struct.unpack_from("<q", content, start - 8)[0] for start in found if start % 8 == 0]
        check_unpacked(num_bytes, sum(size for size in sizes if size > 0))
        is_file = content[:6] == b"ARROW1"
    try:
        with pa.OSFile(str(file)) as source:
            table = (pa.ipc.open_file if is_file else pa.ipc.open_stream)(source).read_all()
    except MemoryError as error:
        raise OSError(f"it needs more memory than is available: {error}") from error
    table.validate(full=True)
    return table


def _flattened(place: str, table: pa.Table) -> pa.Table:
    """Split structs into columns named ``outer.inner``."""
    for _ in range(MOST_LEVELS):
        if not any(pa.types.is_struct(kind) for kind in table.schema.types):
            break
        table = table.flatten()
    refuse_repeated(place, table.column_names)
    return table


def _array(place: str, name: str, values: Any) -> np.ndarray:
    if isinstance(values, pa.ChunkedArray):
        values = values.chunk(0) if values.num_chunks else pa.array([], values.type)
    if isinstance(values, pa.ExtensionArray):
        values = values.storage
    kind = values.type
    if pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind):
        lengths = np.array(values.value_lengths().fill_null(-1))
        if (row := first_true((lengths != lengths[:1]) | (lengths == -1))) is not None:
            found = "null" if lengths[row] == -1 else f"{lengths[row]} values where row 0 has {lengths[0]}"
            raise LogError(f"{place}, row {row}: {name} has {found}; give every step the same number")
        inner = _array(place, name, values.flatten())
        return inner.reshape(len(lengths), int(lengths[0]) if len(lengths) else 0, *inner.shape[1:])
    if pa.types.is_dictionary(kind):
        values = values.dictionary_decode()
    if pa.types.is_decimal(values.type):
        values = values.cast(pa.string()).cast(pa.float64())
    if pa.types.is_binary(values.type) or pa.types.is_large_binary(values.type):
        values = _as_text(values)
    if pa.types.is_string(values.type) or pa.types.is_large_string(values.type) or pa.types.is_null(values.type):
        return np.array(values.to_pylist(), dtype=object)
    return values.to_numpy(zero_copy_only=False)


def _as_text(values: Any) -> Any:
    """Bytes as text, as Spark and TensorFlow write it; unchanged unless all are UTF-8, as those of pictures are not."""
    try:
        return values.cast(pa.string())
    except pa.ArrowInvalid:
        return values
