"""Names for the looks of ground: ground of one class can have many looks."""

from enum import IntEnum


class Look(IntEnum):
    """Codes of the looks of ground and things. BY_CLASS stands for the usual look of the cell's class."""

    BY_CLASS = 0
    MEADOW = 1
    LAWN = 2
    DRY_GRASS = 3
    TALL_GRASS = 4
    CROP = 5
    STUBBLE = 6
    REED = 7
    HEATH = 8
    SOIL = 9
    MUD = 10
    SAND = 11
    GRAVEL = 12
    LEAF_LITTER = 13
    SNOW = 14
    BROADLEAF = 15
    CONIFER = 16
    BUSH = 17
    ROCK = 18
    PALE_ROCK = 19
    SCREE = 20
    ASPHALT = 21
    CONCRETE = 22
    SLABS = 23
    WHITE = 24
    ROOF_TILES = 25
    ROOF_SLATE = 26
    ROOF_METAL = 27
    FLAT_ROOF = 28
    WALL = 29
    PAINT = 30
    CLEAR_WATER = 31
    MURKY_WATER = 32
    PLAIN = 33
    GLASS = 34
    TWIGS = 35
    FINE_GRAVEL = 36
    PACKED_GRAVEL = 37
    PASTURE = 38
    LOAM = 39
    DUCKWEED = 40
    ALGAE = 41
    SLUDGE = 42
    WET_ASPHALT = 43
    PLOUGHED = 44
    STILL_WATER = 45
