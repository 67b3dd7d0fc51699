"""The numbers that others published on ETH/UCY, joint best of 20: ADE/FDE in metres by scene."""

SCENES = ("eth", "hotel", "univ", "zara1", "zara2")

Errors = tuple[float, float] | None
"""(ADE, FDE); None where there is no published number."""


def _by_scene(text: str) -> dict[str, Errors]:
    cells = [None if cell == "-" else cell.split("/") for cell in text.split()]
    return {
        scene: None if cell is None else (float(cell[0]), float(cell[1]))
        for scene, cell in zip(SCENES, cells, strict=True)
    }


SGAN_20V = {
    8: _by_scene(".58/1.13 .36/.71 .33/.70 .21/.42 .21/.42"),
    12: _by_scene(".71/1.29 .48/1.02 .56/1.18 .34/.69 .31/.64"),
}
"""SGAN without pooling, by forecast steps (Gupta et al., CVPR 2018)."""

SGAN_20VP = {
    8: _by_scene(".57/1.14 .38/.73 .42/.79 .22/.43 .24/.48"),
    12: _by_scene(".77/1.39 .43/.88 .75/1.50 .34/.68 .36/.73"),
}
"""SGAN with pooling."""

NEUROSYM = {
    8: _by_scene(".64/1.27 .35/.67 .36/.74 .21/.41 .20/.40"),
    12: _by_scene(".73/1.44 .51/1.01 .62/1.31 .35/.70 -"),
}
"""NeuroSyM, from its released logs, which have none of zara2 at 8 + 12."""

ALL_WINDOWS = {
    "AgentFormer, second hand": _by_scene(".482/.794 - - - -"),
    "Joint AgentFormer, second hand": _by_scene(".485/.798 - - - -"),
}
"""By Joint Metrics Matter's protocol, 8 + 12, as quoted by others and not read in its tables."""
