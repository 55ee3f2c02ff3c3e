"""Fitted tables, each with a card beside it, and the models in them."""

from alight.learned.models import (
    KnownGround,
    Net,
    Rate,
    arrays_of,
    read_floors,
    read_known,
    read_net,
    read_rate,
    table_path,
)
