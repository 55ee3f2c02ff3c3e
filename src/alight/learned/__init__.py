"""Fitted tables, each an `.npz` with a card beside it, and the evaluators of the nets in them."""

from alight.learned.known import KnownGround, known_bytes, read_known
from alight.learned.net import CLIP, AffineLayer, Net, relu_net
from alight.learned.rates import Rate, rate_bytes, rate_of, read_rate
from alight.learned.tables import arrays_of, net_bytes, net_of, read_net, table_path

__all__ = [
    "CLIP",
    "AffineLayer",
    "KnownGround",
    "Net",
    "Rate",
    "arrays_of",
    "known_bytes",
    "net_bytes",
    "net_of",
    "rate_bytes",
    "rate_of",
    "read_known",
    "read_net",
    "read_rate",
    "relu_net",
    "table_path",
]
