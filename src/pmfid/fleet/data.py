"""Where the rows of a history are, and what is asked of them there: files and frames, whose parts an engine takes; a
Spark DataFrame answers for itself (`spark.frame`)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Protocol

from pmfid.fleet.aside import Aside, find_mixed_parts
from pmfid.fleet.keep import Keep
from pmfid.fleet.local import Engine, Local, RowBudget
from pmfid.fleet.plan import BUDGET, RowShard
from pmfid.fleet.segments import Segments
from pmfid.fleet.source import Columns, Part
from pmfid.fleet.store import digest
from pmfid.fleet.survey import Survey, content, join_surveys, survey_part
from pmfid.fleet.within import Places
from pmfid.fleet.work import TRIED, Work, check_columns, samples_of
from pmfid.session.tables import Table

#: Full shards in memory at once on one machine, however many threads it has.
FULL = 3


class Data(Protocol):
    """The rows of a fleet, wherever they are."""

    @property
    def engine(self) -> str:
        """Name of what does the work."""
        ...

    def survey(self, keep: Keep) -> Survey:
        """Which axes there are, and when; called first. Raises UsageError where nothing can be read."""
        ...

    def prepare_shards(
        self, shards: Sequence[RowShard], survey: Survey, length: float, folder: Path | None
    ) -> AbstractContextManager[None]:
        """A context for all work on these shards of the survey; length: of a slice [s]; folder: for rows put aside
        meanwhile, None: the folder for temporary files."""
        ...

    def stamp(self, shard: RowShard, length: float) -> object:
        """Changes with the rows of a shard; length: of a slice [s]."""
        ...

    def tables(self, shards: Sequence[RowShard], length: float) -> Iterator[Table]:
        """The longest piece of the first slice that has any, of the first axes; length: of a slice [s]."""
        ...

    def segments(self, work: Work, shards: Sequence[RowShard]) -> Iterator[Segments]:
        """Of each shard, in their order."""
        ...


class Parts:
    """Files, or frames in memory, each a part."""

    def __init__(self, parts: Sequence[Part], columns: Columns, engine: Engine) -> None:
        self._parts = {part.name: part for part in parts}
        self._columns, self._engine = columns, engine
        self._aside: Aside | None = None
        self._places: Places | None = None

    @property
    def engine(self) -> str:
        """Name of what does the work."""
        return self._engine.name

    def survey(self, keep: Keep) -> Survey:
        """Of all parts; those that cannot be read are problems. Raises UsageError where none can."""
        if keep.lasting:
            self._parts = {name: self._stamp_part(part) for name, part in self._parts.items()}
        parts = list(self._parts.values())
        keys = [digest("survey", part.name, part.stamp, self._columns) for part in parts]
        work = partial(_survey_part, self._columns)
        kept = keep.fetch(keys, lambda missing: self._engine.map(work, [parts[k] for k in missing]), here=True)
        found = join_surveys([Survey(one.rows(), one.problems) for one in kept])
        check_columns(self._columns, parts, found)
        self._places = Places({part.name for part in parts if part.sliced}, found.rows)
        return found

    def _stamp_part(self, part: Part) -> Part:
        """The part with a stamp: a frame has no date, so its content is the stamp."""
        return part if part.stamp else replace(part, stamp=content(part, self._columns))

    @contextmanager
    def prepare_shards(
        self, shards: Sequence[RowShard], survey: Survey, length: float, folder: Path | None
    ) -> Iterator[None]:
        """Puts aside the rows of files that mix their axes; an engine of many machines shuffles such files itself."""
        names = find_mixed_parts(survey.rows, shards) if isinstance(self._engine, Local) else set()
        if not names:
            yield
            return
        parts = {name: self._parts[name] for name in names}
        with closing(Aside(parts, shards, self._columns, length, folder)) as self._aside:
            yield
        self._aside = None

    def stamp(self, shard: RowShard, length: float) -> object:
        """Of the parts that have its rows."""
        return [(name, self._parts[name].stamp) for name in shard.parts]

    def tables(self, shards: Sequence[RowShard], length: float) -> Iterator[Table]:
        """Read here, one by one."""
        for shard in shards[:TRIED]:
            yield from samples_of([shard], self._select_rows(shard, length), self._columns, length, self._aside)

    def _select_rows(self, shard: RowShard, length: float) -> dict[str, Part]:
        """The parts of a shard, each limited to the rows among which the shard may have some."""
        parts = {name: self._parts[name] for name in shard.parts}
        if self._places is None:
            return parts
        return {name: self._places.narrow(part, shard, length) for name, part in parts.items()}

    def segments(self, work: Work, shards: Sequence[RowShard]) -> Iterator[Segments]:
        """By the engine; no others will be asked for."""
        items = [(shard, self._select_rows(shard, work.length)) for shard in shards]
        if self._aside is not None:
            self._aside.only(shards)
        room = RowBudget(FULL * BUDGET) if isinstance(self._engine, Local) else None
        return self._engine.map(partial(_solve_shard, work, self._aside, room), items)


def _survey_part(columns: Columns, part: Part) -> Survey:
    return survey_part(part, columns)


def _solve_shard(
    work: Work, aside: Aside | None, room: RowBudget | None, item: tuple[RowShard, dict[str, Part]]
) -> Segments:
    shard, parts = item
    with nullcontext() if room is None else room.reserve(shard.rows):
        found = work.shard(shard, parts, aside)
    if aside is not None:
        aside.release(shard)
    return found
