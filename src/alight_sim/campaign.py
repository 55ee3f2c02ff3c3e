"""Kinds of worlds for campaigns, some with safe sites and some without any. The seed varies each world."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from alight_sim.scene import Scene, parse_scene
from alight_sim.scene_world import SceneWorld, build


@dataclass(frozen=True)
class CampaignWorld:
    """One kind of campaign world."""

    name: str
    scene: str | Scene  # a built-in scene's name, or a scene
    safe: bool = True  # whether some sites are safe for a small lander

    def build(self, seed: int = 0) -> SceneWorld:
        """Build the world of this kind for a seed."""
        return build(self.scene, seed)


def _scene(name: str, description: str, **ground: Any) -> Scene:
    tree = {"name": name, "description": description, "ground": {"size": [160, 160], **ground}}
    return parse_scene(tree, name)


def campaign_worlds() -> dict[str, CampaignWorld]:
    """Return all kinds of campaign worlds by name."""
    rough = [{"height": 1.5, "longest": 60, "shortest": 6, "fall": 1.7}]
    rubble = _scene(
        "rubble", "Dense rubble everywhere: boulders and scree without a gap.", cover="bare", look="scree",
        relief=[*rough, {"height": 0.25, "longest": 2.5, "shortest": 0.3, "fall": 0.7}],
        layers=[
            {"thing": "rocks", "per_hectare": 9000, "radius": [0.3, 0.8], "exponent": 1, "apart": False},
        ],
    )  # fmt: skip
    forest = _scene(
        "closed_forest", "Forest without a clearing.", look="leaf_litter", relief=rough,
        layers=[
            {"thing": "trees", "per_hectare": 1700, "radius": [1.9, 3.2], "apart": False},
            {"thing": "shrubs", "per_hectare": 2000, "radius": [0.4, 1.2], "apart": False},
        ],
    )  # fmt: skip
    lake = _scene(
        "lake", "Open water to the horizon.", relief=[{"height": 0.6, "longest": 40, "shortest": 5}],
        layers=[{"thing": "water", "level": 4.0}],
    )  # fmt: skip
    places = (
        "meadow", "farmland", "village", "quarry", "desert", "snow", "car_park", "gravel", "concrete", "depot",
        "forest",
    )  # fmt: skip
    kinds = [CampaignWorld(name, name) for name in places]
    kinds += [CampaignWorld(s.name, s, safe=False) for s in (rubble, forest, lake)]
    kinds += [CampaignWorld("tall_grass", "tall_grass", safe=False)]
    return {kind.name: kind for kind in kinds}
