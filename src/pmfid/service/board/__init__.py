"""What is known of the plant now, for those who look: an outlet of the engine, without any mathematics."""

from pmfid.service.board.board import Board, News
from pmfid.service.board.panel import Overview, Panel
from pmfid.service.board.subscription import Subscription

__all__ = ["Board", "News", "Overview", "Panel", "Subscription"]
