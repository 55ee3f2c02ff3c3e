"""The page a person opens first."""

from alight.records import RunResult


def render(result: RunResult) -> str:
    """One self-contained page."""
    return f"<!doctype html><title>{result.source_name}</title>"
