"""Groups of the built-in scenes: fits and campaigns leave kinds of ground out by whole groups."""

from __future__ import annotations

GROUPS: dict[str, tuple[str, ...]] = {
    "farm": ("farmland", "farmyard", "furrows", "meadow", "pasture", "stubble", "tall_grass"),
    "town": ("car_park", "park", "plaza", "village"),
    "industry": ("building_site", "concrete", "depot", "landfill", "stockyard"),
    "water": ("bog", "canal", "flood_plain", "lakes", "marsh"),
    "forest": ("burnt", "clear_cut", "forest", "heath"),
    "rock": ("gravel", "karst", "quarry", "scree"),
    "sand": ("beach", "desert", "dunes"),
    "snow": ("ice", "snow", "thaw"),
    "sport": ("golf", "sports_ground", "tennis"),
    "ruin": ("collapsed", "foundations", "yard"),
}  # all but `demo` and `hopeless`


def group_of(scene: str) -> str:
    """Return the group of a built-in scene.

    Raises:
        KeyError: the scene belongs to no group.
    """
    return {name: group for group, names in GROUPS.items() for name in names}[scene]
