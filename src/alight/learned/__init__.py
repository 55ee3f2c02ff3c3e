"""Fitted tables, each with a card next to it, and the models in them."""

from alight.learned.models import (
    KnownGround,
    Net,
    Rate,
    SigmaCoefficients,
    arrays_of,
    read_floors,
    read_known,
    read_net,
    read_rate,
    read_sigma,
    read_wrong_match,
    table_path,
)
