"""Alight: a safe place to land, from an aircraft's cameras and its GPS/INS."""

__version__ = "0.1.0"
