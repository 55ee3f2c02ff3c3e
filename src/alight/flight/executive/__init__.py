"""The executive: states, events and orders to the vehicle."""

from alight.flight.executive.executive import Executive
from alight.flight.executive.table import ENDS, TABLE

__all__ = ["ENDS", "TABLE", "Executive"]
