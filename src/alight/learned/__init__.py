"""Fitted tables and the nets that read them."""
