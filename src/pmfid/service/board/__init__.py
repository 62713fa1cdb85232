"""The present state of the plant for its viewers: an outlet of the engine, without any mathematics."""

from pmfid.service.board.board import Board, News, Subscription
from pmfid.service.board.panel import Overview, Panel

__all__ = ["Board", "News", "Overview", "Panel", "Subscription"]
