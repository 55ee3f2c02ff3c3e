"""The executive: states, events and orders to the vehicle."""

from alight.landing.executive.executive import Executive
from alight.landing.executive.table import ENDS, TABLE, as_markdown

__all__ = ["ENDS", "TABLE", "Executive", "as_markdown"]
