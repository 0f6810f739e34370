"""What is to be simulated, before any discretisation: a box, gravity, materials, bodies, walls, obstacles, a duration.

`definition` holds the frozen `Scene`, `boundaries` walls and obstacles, `terrain` ground of a `raster`, `release` what
starts on it, `plain` and `ground` their form as dicts, YAML and JSON, `catalogue` the standard scenes and their random
families, `filling` puts particles into bodies. No solver, no network and no file of trajectories is known here.
"""

from gns_pl.scene.boundaries import Box, Obstacle, Plane, Wall, signed_distance
from gns_pl.scene.catalogue import (
    block_release,
    column_collapse,
    cube_drop,
    sample_block_release,
    sample_column_collapse,
    sample_cube_drop,
    sample_pair_release,
)
from gns_pl.scene.definition import FACES, Body, Material, Scene
from gns_pl.scene.filling import Particles, fill_scene
from gns_pl.scene.ground_release import sample_ground_release
from gns_pl.scene.origin import near_origin
from gns_pl.scene.parts import part_from_dict
from gns_pl.scene.plain import read_scene, scene_from_dict, write_scene
from gns_pl.scene.raster import Raster, read_raster
from gns_pl.scene.release import Release, make_release, read_outline
from gns_pl.scene.terrain import Terrain

__all__ = [
    "FACES",
    "Body",
    "Box",
    "Material",
    "Obstacle",
    "Particles",
    "Plane",
    "Raster",
    "Release",
    "Scene",
    "Terrain",
    "Wall",
    "block_release",
    "column_collapse",
    "cube_drop",
    "fill_scene",
    "make_release",
    "near_origin",
    "part_from_dict",
    "read_outline",
    "read_raster",
    "read_scene",
    "sample_block_release",
    "sample_column_collapse",
    "sample_cube_drop",
    "sample_ground_release",
    "sample_pair_release",
    "scene_from_dict",
    "signed_distance",
    "write_scene",
]
