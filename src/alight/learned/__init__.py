"""Fitted tables, each with a card beside it, and the models in them."""

from alight.learned.models import Floor, KnownGround, Net, Rate, read_floors, read_known, read_net, read_rate
from alight.learned.tables import arrays_of, table_path

__all__ = [
    "Floor",
    "KnownGround",
    "Net",
    "Rate",
    "arrays_of",
    "read_floors",
    "read_known",
    "read_net",
    "read_rate",
    "table_path",
]
