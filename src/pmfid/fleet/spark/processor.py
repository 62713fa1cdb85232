"""What Spark runs for a shard: its state out of the state store, the blocks of a batch, its state back."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from pyspark.sql.streaming.stateful_processor import StatefulProcessor, StatefulProcessorHandle

from pmfid.fleet.stream.shard import Plan, Shard
from pmfid.fleet.stream.tables import table_of

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["STATE", "ShardProcessor"]

#: The name of the state, and its one column: the body of a checkpoint of `pmfid serve`.
STATE, COLUMN = "shard", "body binary"


class ShardProcessor(StatefulProcessor):  # type: ignore[misc]
    """Key: the number of the shard; rows: the column `block`; a checkpoint's body of a shard to begin with where one is
    given."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan

    def init(self, handle: StatefulProcessorHandle) -> None:
        self._state = handle.getValueState(STATE, COLUMN)

    def handleInputRows(self, key: Any, rows: Iterator[pd.DataFrame], timerValues: Any) -> Iterator[pd.DataFrame]:
        """The rows of a batch: estimates, notices, counts."""
        body = self._state.get()[0] if self._state.exists() else None
        shard = Shard(self._plan, int(key[0]), None if body is None else bytes(body))
        shard.take([bytes(data) for frame in rows for data in frame["block"] if data is not None])
        self._state.update((shard.saved(),))
        yield table_of(shard).to_pandas()

    def handleInitialState(self, key: Any, initialState: pd.DataFrame, timerValues: Any) -> None:
        """Begins from states that came from elsewhere."""
        self._state.update((bytes(initialState["body"].iloc[0]),))

    def close(self) -> None:
        """Nothing is open."""
